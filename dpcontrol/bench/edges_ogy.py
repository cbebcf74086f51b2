"""Where OGY ends: the largest pulse, and encoder counts, by sections in a period; runs beside what is foretold."""

from collections.abc import Callable
from dataclasses import replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bench.control_trials import held
from dpcontrol.bench.edges import Answer, Border, EdgeChart, EdgeMap, find_border
from dpcontrol.bench.ogy_borders import (
    ESTIMATOR,
    LIMIT,
    RATE,
    SECONDS,
    Task,
    encoders,
    largest_linear_pulse,
    room,
    task,
)
from dpcontrol.control.ogy import OgyController
from dpcontrol.foundation.files import Progress
from dpcontrol.lab.batch import run_batch
from dpcontrol.lab.loop import LoopSettings
from dpcontrol.lab.result import Ending
from dpcontrol.references.problem import Limits

Array = NDArray[np.float64]

SEEDS = 20
SECTIONS = (1, 2, 3, 4, 8, 16)
QUICK_SECTIONS = (8,)
FEWEST, MOST = 50.0, 4e8
"""Counts per turn: from the coarsest encoders to none that there is."""
COUNTS = 40_000.0
THEORY = "what the filter does not know grows by Λ between sections, past what a pulse can bring back"
_NEARBY = {False: (0.95, 1.05), True: (0.9, 0.95, 1.0, 1.05, 1.1)}
"""Shares of a number of counts that are tried for it, by whether there are at least ten seeds."""


def chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: fewer sections and seeds."""
    one = task()
    sections, seeds, ratio = (QUICK_SECTIONS, 8, 1.5) if quick else (SECTIONS, SEEDS, 1.2)
    weak, counted = [], []
    for j, k in enumerate(sections):
        progress(f"edges of OGY, largest pulse, k = {k}", 0.5 * j / len(sections))
        weak.append(limit_border(one, k, counts=COUNTS, seeds=seeds, ratio=ratio))
    for j, k in enumerate(sections):
        progress(f"edges of OGY, counts, k = {k}", 0.5 + 0.5 * j / len(sections))
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
            "or for encoders that nobody builds. Each border: half of the runs hold.",
            "Counts are judged by the authority that they ask for. Readings of an orbit repeat, so that one number of "
            "counts may be lucky: each stands for those within a tenth of it, with zeros anywhere within a count.",
            "Circles hold, crosses are lost; diamonds are foretold from the filter's own uncertainty, without a run; "
            "none where the pulses themselves leave the linear range (one and two sections).",
        ),
        chosen="16 sections a period and pulses of up to 5 m/s²: encoders of a few hundred counts would still do.",
    )  # fmt: skip


def holds(one: Task, controller: OgyController, *, counts: float, seeds: int) -> Answer:
    """Return whether at least half of the runs hold the orbit, else what ended the first that did not."""
    # Readings of an orbit repeat from period to period: one number of counts, or zeros all alike, have their own luck.
    runs = []
    shares = _NEARBY[seeds >= 10]
    for share, some in zip(shares, np.array_split(np.arange(seeds), len(shares)), strict=True):
        sensors = replace(encoders(share * counts), zero_error=np.pi / counts)
        settings = LoopSettings(seed=0, rate=RATE, sensors=sensors, estimator=ESTIMATOR, initial_error=1e-5)
        if len(some):
            runs += run_batch(one.arms, settings=settings, seeds=some.tolist(), controller=controller,
                              limits=Limits(position=5.0, acceleration=30.0))  # fmt: skip
    judge = held(one.orbit.state(np.linspace(0, one.orbit.period, 1000))[:, : one.arms.count],
                 period=one.orbit.period)  # fmt: skip
    lost = [run for run in runs if not judge(run)]
    if not lost:
        return Answer(True)
    stopped = [run.reason for run in lost if run.ending is not Ending.FINISHED]
    text = stopped[0] if stopped else "finished, but away from the orbit in its last period"
    return Answer(2 * len(lost) <= seeds, f"{len(lost)} of {seeds} runs lost; {text}")


def _foretold(probability: Callable[[float], float], low: float, high: float) -> float | None:
    """Return where a probability that rises from `low` to `high` is one half, None where it is not between."""
    if probability(low) > 0.5 or probability(high) < 0.5:
        return None
    while high / low > 1.005:
        middle = sqrt(low * high)
        low, high = (low, middle) if probability(middle) >= 0.5 else (middle, high)
    return sqrt(low * high)


def counts_border(one: Task, sections: int, *, seeds: int = SEEDS, ratio: float = 1.2) -> Border:
    """Return the fewest counts per turn with which `sections` pulses a period hold the orbit."""
    controller, periods = one.controller(sections), SECONDS / one.orbit.period
    predicted = None
    if largest_linear_pulse(one, controller) > LIMIT:
        predicted = _foretold(lambda counts: room(one, controller, counts).survives(LIMIT, periods), FEWEST, MOST)
    middle = predicted or sqrt(FEWEST * MOST)
    return find_border(
        lambda counts: holds(one, controller, counts=counts, seeds=seeds), x=sections, line=f"k = {sections}",
        near=2.5 * middle, far=max(middle / 6, 1.0), predicted=predicted, ratio=ratio,
        power=_power(one, controller, predicted) if predicted else 1.0,
    )  # fmt: skip


def _power(one: Task, controller: OgyController, counts: float) -> float:
    """Return by which power of the margins the counts go about `counts`."""
    low, high = (room(one, controller, c).margins.min() for c in (counts / 1.5, 1.5 * counts))
    return float(2 * np.log(1.5) / np.log(high / low))


def limit_border(one: Task, sections: int, *, counts: float = 40_000, seeds: int = SEEDS, ratio: float = 1.2) -> Border:
    """Return the smallest limit of the pulses, m/s², with which `sections` of them a period hold the orbit."""
    at_one = one.controller(sections, 1.0)
    predicted = foretold_limit(one, at_one, counts)
    middle = predicted or 1.0
    return find_border(
        lambda limit: holds(one, replace(at_one, pulse_limit=limit), counts=counts, seeds=seeds), x=sections,
        line=f"k = {sections}", near=2.5 * middle, far=middle / 2.5, predicted=predicted, ratio=ratio,
    )  # fmt: skip


def foretold_limit(one: Task, controller: OgyController, counts: float) -> float | None:
    """Return the limit of the pulses, m/s², with which half of the runs hold; None where they would not be linear."""
    known, periods = room(one, controller, counts), SECONDS / one.orbit.period
    return _foretold(lambda limit: known.survives(limit, periods), 1e-6, largest_linear_pulse(one, controller))
