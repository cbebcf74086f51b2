"""Where OGY ends: the largest pulse, and encoder counts, by sections in a period; runs beside what is foretold."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bench.control_trials import Judge, held
from dpcontrol.bench.edges import Answer, Border, EdgeChart, EdgeMap, Trial, find_border
from dpcontrol.bench.ogy_borders import ESTIMATOR, LIMIT, RATE, Task, encoders, sections_of, task
from dpcontrol.bench.ogy_ladder import NEARLY, Ladder
from dpcontrol.bench.ogy_readings import LANES, Foresight, foresight, spread
from dpcontrol.control.ogy import OgyController
from dpcontrol.foundation.progress import Progress
from dpcontrol.loop.batch import run_batch
from dpcontrol.loop.draw import draw_bench
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.result import Ending
from dpcontrol.references.problem import Limits

Array = NDArray[np.float64]

SEEDS, RATIO = 8, 1.12
QUICK_SEEDS, QUICK_RATIO, QUICK_SECONDS = 8, 1.6, 4.0
SECTIONS = (1, 2, 3, 4, 8, 16)
QUICK_SECTIONS = (8,)
FEWEST, MOST = 50.0, 4e8
"""Counts per turn: from the coarsest encoders to none that there is."""
WEAKEST, STRONGEST = 0.01, 5.0
"""m/s²: pulses from next to nothing to the shipped ones."""
COUNTS = 40_000.0
THEORY = "what readings, rounded as the orbit has them, do to the loop to first order"
_POOL = 512
"""Seeds from which runs are chosen by their zeros."""
_UNKNOWN_RATIO = 1.5
"""How near the sides of a border are brought that nothing foretells."""


def chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: fewer sections, rungs and seeds, and shorter runs."""
    one, sections, seeds, ratio = task(), SECTIONS, SEEDS, RATIO
    if quick:
        one = replace(one, seconds=QUICK_SECONDS)
        sections, seeds, ratio = QUICK_SECTIONS, QUICK_SEEDS, QUICK_RATIO
    weak, counted = [], []
    for j, k in enumerate(sections):
        progress(f"edges of OGY, largest pulse, k = {k}", 0.4 * j / len(sections))
        weak.append(limit_border(one, k, counts=COUNTS, seeds=seeds, ratio=ratio))
    for j, k in enumerate(sections):
        progress(f"edges of OGY, counts, k = {k}", 0.4 + 0.6 * j / len(sections))
        counted.append(counts_border(one, k, seeds=seeds, ratio=ratio))
    maps = (
        EdgeMap(f"Authority, {COUNTS:,.0f} counts per turn", "sections in a period, k", "largest pulse, m/s²",
                tuple(weak), THEORY, far="lost"),
        EdgeMap(f"Encoders, pulses of {LIMIT:g} m/s²", "sections in a period, k", "counts per turn", tuple(counted),
                THEORY, far="lost"),
    )  # fmt: skip
    return EdgeChart(
        name="edges-ogy",
        title=f"Where OGY ends: Down-Up at -0.07 J, multiplier {one.orbit.multipliers[0].real:.0f} a period",
        maps=maps,
        reading=(
            "From one section to the next an error grows by about λ^(1/k), so that few sections ask for large pulses "
            "or for encoders that nobody builds. Zeros of the encoders lie anywhere within a count.",
            "Circles: half of the runs hold, or more; crosses: fewer. More counts are worse where an arm moves whole "
            "counts in a tick at a section: a border is therefore the mean of where runs begin to hold "
            "(Spearman-Kärber).",
            "Diamonds are foretold without a run: the loop to first order, its readings rounded as the orbit has them; "
            "none where flights between sections leave the linear range (one and two sections).",
        ),
        chosen="16 sections a period and pulses of up to 5 m/s²: encoders of a few hundred counts would still do.",
    )  # fmt: skip


def holds(one: Task, controller: OgyController, *, counts: float, seeds: int, first: int = 0) -> Answer:
    """Return whether at least half of the runs hold the orbit, else what ended the first that did not.

    first: of the runs' zeros, which follow one another on a lattice over a count.
    """
    return _told(*_runs(one, controller, counts=counts, seeds=_spread_seeds(one, first, seeds)))


@cache
def _zeros(one: Task) -> Array:
    """Return the zeros (_POOL, n) that seeds from 0 on draw, as shares of a count from -½ to ½."""
    sensors = encoders(COUNTS)
    settings = LoopSettings(seed=0, rate=RATE, sensors=sensors)
    draws = [draw_bench(one.arms, settings.bench, seed=k, ticks=1, period=1 / RATE) for k in range(_POOL)]
    return np.array([draw.zeros for draw in draws]) / (2 * sensors.zero_error)


def _spread_seeds(one: Task, first: int, count: int) -> list[int]:
    """Return `count` seeds whose zeros are next to the lattice's points from `first` on: few leave no part out."""
    zeros = _zeros(one)
    points = spread(first + count, one.arms.count).T[first:] - 0.5
    away = points[:, None, :] - zeros
    return np.argmin(np.square(away - np.rint(away)).sum(axis=2), axis=1).tolist()


def _told(lost: int, seeds: int, text: str) -> Answer:
    return Answer(2 * lost <= seeds, f"{lost} of {seeds} runs lost; {text}" if lost else "")


def _runs(one: Task, controller: OgyController, *, counts: float, seeds: Sequence[int]) -> tuple[int, int, str]:
    """Return how many runs lose the orbit, of how many, and what ended the first of them."""
    settings = LoopSettings(seed=0, rate=RATE, sensors=encoders(counts), estimator=ESTIMATOR, initial_error=1e-5)
    runs = run_batch(one.arms, settings=settings, seeds=seeds, controller=controller,
                     limits=Limits(position=5.0, acceleration=30.0))  # fmt: skip
    judge = _judge(one)
    lost = [run for run in runs if not judge(run)]
    stopped = [run.reason for run in lost if run.ending is not Ending.FINISHED]
    return len(lost), len(runs), stopped[0] if stopped else "finished, but away from the orbit in its last period"


def _judge(one: Task) -> Judge:
    return held(one.orbit.state(np.linspace(0, one.orbit.period, 1000))[:, : one.arms.count], period=one.orbit.period)


def counts_border(one: Task, sections: int, *, seeds: int = SEEDS, ratio: float = RATIO) -> Border:
    """Return the fewest counts per turn with which `sections` pulses a period hold the orbit."""
    controller, known = one.controller(sections), sections_of(one, sections)
    ladder = Ladder(FEWEST, MOST, ratio)
    foretold = {}
    if known.largest_linear_pulse > LIMIT:
        foretold = foretold_counts(foresight(known, controller), ladder)
    if foretold:
        return climbed(
            lambda counts, first: _runs(one, controller, counts=counts, seeds=_spread_seeds(one, first, seeds)),
            ladder, foretold, sections=sections, seeds=seeds,
        )  # fmt: skip
    return find_border(
        lambda counts: holds(one, controller, counts=counts, seeds=seeds), x=sections, line=f"k = {sections}",
        near=MOST, far=FEWEST, ratio=_UNKNOWN_RATIO,
    )  # fmt: skip


def limit_border(
    one: Task, sections: int, *, counts: float = COUNTS, seeds: int = SEEDS, ratio: float = RATIO
) -> Border:
    """Return the smallest limit of the pulses, m/s², with which `sections` of them a period hold the orbit."""
    controller, known = one.controller(sections), sections_of(one, sections)

    def limited(limit: float) -> OgyController:
        return replace(controller, pulse_limit=limit)

    ladder, foretold = Ladder(WEAKEST, STRONGEST, ratio), {}
    if (most := min(STRONGEST, known.largest_linear_pulse)) > WEAKEST:
        foretold = foretold_limits(foresight(known, controller), replace(ladder, high=most), counts)
    if foretold:
        return climbed(
            lambda limit, first: _runs(one, limited(limit), counts=counts, seeds=_spread_seeds(one, first, seeds)),
            ladder, foretold, sections=sections, seeds=seeds,
        )  # fmt: skip
    return find_border(
        lambda limit: holds(one, limited(limit), counts=counts, seeds=seeds), x=sections, line=f"k = {sections}",
        near=STRONGEST / 2, far=STRONGEST / 12, ratio=_UNKNOWN_RATIO,
    )  # fmt: skip


def foretold_counts(loop: Foresight, ladder: Ladder, limit: float = LIMIT) -> dict[int, float]:
    """Return the share of runs that hold by the ladder's rung of counts per turn, with pulses of up to `limit` m/s².

    A rung stands for all counts that are nearer to it than to another.
    """
    *zeros, places = spread(LANES, loop.sections.task.arms.count + 1)

    def share(counts: float) -> float:
        near = counts * ladder.ratio ** (places - 0.5)
        return float(loop.held(loop.heard(counts), np.array(zeros) - 0.5, counts=near, limits=limit).mean())

    return ladder.foretold(share)


def foretold_limits(loop: Foresight, ladder: Ladder, counts: float) -> dict[int, float]:
    """Return the share of runs that hold by the ladder's rung of the pulses' limits in m/s², with so many counts."""
    *zeros, places = spread(LANES, loop.sections.task.arms.count + 1)
    heard = loop.heard(counts)

    def share(limit: float) -> float:
        near = limit * ladder.ratio ** (places - 0.5)
        return float(loop.held(heard, np.array(zeros) - 0.5, counts=counts, limits=near).mean())

    return ladder.foretold(share)


def climbed(
    probe: Callable[[float, int], tuple[int, int, str]], ladder: Ladder, foretold: dict[int, float], *, sections: int,
    seeds: int,
) -> Border:  # fmt: skip
    """Return the border on rungs from where nearly all runs are lost to where nearly all hold.

    Its sides lie a standard error off it. probe: takes a value and the first of its zeros. The rungs are those that
    `foretold` has, and further ones where runs are not as foretold. Each has zeros of its own: a few would bring their
    own luck to all of them.
    """
    told: dict[int, tuple[int, int, str]] = {}

    def share(rung: int) -> float:
        told[rung] = probe(ladder.at(rung), rung * seeds)
        return 1 - told[rung][0] / told[rung][1]

    shares = {rung: share(rung) for rung in foretold}
    while shares[low := min(shares)] > 1 - NEARLY + 1 / seeds and low > 0:
        shares[low - 1] = share(low - 1)
    while shares[high := max(shares)] < NEARLY - 1 / seeds and high + 1 < ladder.count:
        shares[high + 1] = share(high + 1)
    answers = {rung: _told(*told[rung]) for rung in sorted(shares)}
    trials = tuple(Trial(ladder.at(rung), answer.works, answer.says) for rung, answer in answers.items())
    border, error, line = ladder.border(shares), ladder.error(shares, seeds), f"k = {sections}"
    says = next((trial.says for trial in reversed(trials) if trial.y <= border and not trial.works), "")
    near, far = border * error, border / error
    if not any(trial.works for trial in trials):
        near, far = None, trials[-1].y
    elif all(trial.works for trial in trials):
        near, far = trials[0].y, None
    return Border(sections, line, near, far, ladder.border(foretold), says, trials)
