"""OGY's borders by encoder counts and by the largest pulse: foretold from rounded readings, and each side by runs."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from dpcontrol.bench.edges import AGREES, EdgeMap
from dpcontrol.bench.edges_ogy import (
    COUNTS,
    FEWEST,
    MOST,
    QUICK_RATIO,
    QUICK_SECONDS,
    QUICK_SEEDS,
    STRONGEST,
    WEAKEST,
    climbed,
    counts_border,
    foretold_counts,
    foretold_limits,
    holds,
    limit_border,
)
from dpcontrol.bench.ogy_borders import ESTIMATOR, LIMIT, RATE, SECONDS, Sections, Task, encoders, sections_of, task
from dpcontrol.bench.ogy_ladder import Ladder
from dpcontrol.bench.ogy_readings import Foresight, foresight, spread
from dpcontrol.control.ekf import CompiledEkf

Array = NDArray[np.float64]

RUNS = 8
LADDER = 1.5


@cache
def orbit() -> Task:
    return task()


@cache
def known(sections: int) -> Sections:
    return sections_of(orbit(), sections)


@cache
def loop(sections: int) -> Foresight:
    return foresight(known(sections), orbit().controller(sections))


@cache
def foretold_count(sections: int) -> float:
    ladder = Ladder(FEWEST, MOST, LADDER)
    return ladder.border(foretold_counts(loop(sections), ladder))


@cache
def foretold_limit(sections: int) -> float:
    ladder = Ladder(WEAKEST, STRONGEST, LADDER)
    return ladder.border(foretold_limits(loop(sections), ladder, COUNTS))


def share(sections: int, counts: float, limit: float, *, zeros: Array) -> float:
    one = loop(sections)
    return float(one.held(one.heard(counts), zeros, counts=counts, limits=limit).mean())


def tick_by_tick(sections: int, counts: float, limit: float, zeros: Array, read: Callable[[Array], Array]) -> Array:
    """Return which runs hold: the same recursions, one tick at a time; gains by P Hᵀ R⁻¹ from the filter itself."""
    one, law, gait = orbit(), orbit().controller(sections), loop(sections).gait
    noise = encoders(counts).covariance(2)
    ekf = CompiledEkf(one.model, ESTIMATOR, noise=noise)
    estimate, count, q = ekf.first(gait.states[0]), len(gait.states), 2 * np.pi / counts
    x, e, p = np.zeros((6, zeros.shape[1])), np.zeros((6, zeros.shape[1])), np.zeros(zeros.shape[1])
    holds, seen, crossed = np.ones(zeros.shape[1], dtype=bool), [0, 1, 4], 0
    for t in range(int(SECONDS / one.orbit.period * sections) * count // sections):
        i = t % count
        if t:
            shape = np.sin(np.pi * min((t - crossed - 0.5) * sections / count, 1.0))
            x = gait.matrices[i - 1] @ x + np.outer(gait.responses[i - 1], p * shape)
            e = gait.matrices[i - 1] @ e
            estimate = ekf.step(estimate, float(gait.inputs[i - 1]), gait.states[i][seen])
        else:
            estimate = ekf.update(estimate, gait.states[0][seen])
        gain = ekf.covariance(estimate)[:, seen] @ np.linalg.inv(noise)
        inner, outer = gait.states[i][0] + x[0], gait.states[i][1] + x[1]
        first = q * read(inner / q + zeros[0]) - inner
        second = q * read((outer - inner) / q + zeros[1]) - (outer - inner)
        e = e + gain @ (np.array([first, first + second, np.zeros_like(first)]) - e[seen])
        if i in gait.ends[:-1]:
            j = gait.ends[:-1].tolist().index(i)
            start = known(sections).maps[j].start
            late = start.normal @ (x + e)
            x, crossed = x - np.outer(start.rate, late), t
            p = np.clip(-law.gains[j] @ (x + e), -limit, limit)
            holds &= np.abs(known(sections).directions[j] @ x) <= limit * known(sections).ranges[j]
            x[:, ~holds] = e[:, ~holds] = 0.0
    return holds


@pytest.mark.parametrize(("sections", "counts"), [(16, 600.0), (8, 800.0), (4, 3500.0)])
def test_carrying_readings_from_section_to_section_gives_what_every_tick_gives(sections: int, counts: float):
    zeros = spread(256, 2) - 0.5
    one = loop(sections)
    quick = one.held(one.heard(counts), zeros, counts=counts, limits=LIMIT)
    slow = tick_by_tick(sections, counts, LIMIT, zeros, np.rint)
    assert 0.2 < slow.mean() < 0.8
    # Near half a count the last bits decide, and a run goes another way: shares agree, and most runs at 16 sections.
    assert quick.mean() == pytest.approx(slow.mean(), abs=0.1)
    if sections == 16:
        assert (quick == slow).mean() > 0.9


def test_fine_counts_round_as_white_noise_does_and_few_counts_do_not():
    zeros, random = spread(256, 2) - 0.5, np.random.default_rng(0)

    def white(angles: Array) -> Array:
        return angles + random.uniform(-0.5, 0.5, angles.shape)

    for limit in (0.2, 0.3):
        noisy = tick_by_tick(4, COUNTS, limit, zeros, white).mean()
        assert share(4, COUNTS, limit, zeros=zeros) == pytest.approx(noisy, abs=0.12)
    # What repeats and survives one period survives most.
    assert share(8, 715, LIMIT, zeros=zeros) > tick_by_tick(8, 715, LIMIT, zeros, white).mean() + 0.15


def test_more_counts_are_worse_where_an_arm_moves_whole_counts_in_a_tick_at_a_section():
    start = known(4).maps[0].start.state
    two_in_a_tick = 2 * 2 * np.pi * RATE / abs(start[3] - start[2])
    fewer, law = two_in_a_tick / 1.15, orbit().controller(4)
    zeros = spread(256, 2) - 0.5
    assert share(4, fewer, LIMIT, zeros=zeros) > share(4, two_in_a_tick, LIMIT, zeros=zeros) + 0.3
    assert holds(orbit(), law, counts=fewer, seeds=24).works
    assert not holds(orbit(), law, counts=two_in_a_tick, seeds=24).works


def test_larger_pulses_make_holding_likelier_and_more_sections_leave_more_room():
    zeros = spread(128, 2) - 0.5
    chances = [share(4, COUNTS, limit, zeros=zeros) for limit in (0.01, 0.15, 0.25, 0.4, 5.0)]
    assert chances == sorted(chances)
    assert chances[0] < 0.01 < 0.99 < chances[-1]
    limits = [foretold_limit(k) for k in (3, 4, 8, 16)]
    assert limits == sorted(limits, reverse=True)
    assert share(1, COUNTS, LIMIT, zeros=zeros) == 0.0
    assert share(16, COUNTS, LIMIT, zeros=zeros) == 1.0


def test_what_a_pulse_brings_back_is_what_the_sections_can_hold():
    for k in (2, 8):
        one = known(k)
        again = one.growths * one.ranges - np.abs(one.reaches)
        assert again == pytest.approx(np.roll(one.ranges, -1), rel=1e-9)


@pytest.mark.parametrize("sections", [4, 16])
def test_pulses_hold_above_the_foretold_limit_and_are_lost_below_it(sections: int):
    half, law = foretold_limit(sections), orbit().controller(sections)
    near = holds(orbit(), replace(law, pulse_limit=1.3 * half), counts=COUNTS, seeds=RUNS)
    far = holds(orbit(), replace(law, pulse_limit=half / 1.4), counts=COUNTS, seeds=RUNS)
    assert near.works, near.says
    assert not far.works
    assert "lost" in far.says


def test_one_section_a_period_is_lost_at_any_real_resolution_and_the_loop_says_so():
    lost = holds(orbit(), orbit().controller(1), counts=COUNTS, seeds=RUNS)
    assert not lost.works
    assert "tracking lost" in lost.says or "cart at its stop" in lost.says


@pytest.mark.parametrize("sections", [4, 16])
def test_encoders_of_more_counts_than_foretold_hold_and_of_fewer_are_lost(sections: int):
    half, law = foretold_count(sections), orbit().controller(sections)
    # A single number of counts may be unlucky near the border, where an arm moves whole counts in a tick.
    near, far = (holds(orbit(), law, counts=c, seeds=RUNS) for c in (2 * half, half / 2))
    assert near.works, near.says
    assert not far.works
    assert "lost" in far.says


def test_borders_by_runs_are_where_they_are_foretold():
    one = replace(orbit(), seconds=QUICK_SECONDS)
    few = {"seeds": QUICK_SEEDS, "ratio": QUICK_RATIO}
    borders = (limit_border(one, 8, **few), counts_border(one, 8, **few))
    for border in borders:
        assert border.off is not None
        assert border.off <= AGREES
        assert "lost" in border.says
    assert EdgeMap("both", "k", "y", borders).complaints() == ()


@pytest.mark.benchmark
@pytest.mark.parametrize("sections", [3, 4, 16])
def test_borders_by_runs_are_where_they_are_foretold_at_other_sections(sections: int):
    for border in (limit_border(orbit(), sections), counts_border(orbit(), sections)):
        assert border.off is not None
        assert border.off <= AGREES


def test_nothing_is_foretold_where_flights_leave_the_linear_range():
    assert known(16).largest_linear_pulse > 5 > 1.1 > LIMIT > known(2).largest_linear_pulse
    assert known(1).largest_linear_pulse < 0.1
    assert known(2).largest_linear_pulse < known(3).largest_linear_pulse < known(4).largest_linear_pulse
    for found in (limit_border(orbit(), 1, seeds=1), counts_border(orbit(), 1, seeds=1)):
        assert found.predicted is None
        assert "lost" in found.says


def test_a_ladder_of_one_step_has_its_border_between_the_rungs():
    ladder = Ladder(1.0, 1000.0, 2.0)
    assert ladder.border({2: 0.0, 3: 0.0, 4: 1.0, 5: 1.0}) == pytest.approx(np.sqrt(8 * 16))
    assert ladder.error({2: 0.0, 3: 1.0}, 10) == 1.0


def test_a_ladder_finds_the_mean_of_the_values_from_which_on_runs_hold():
    ladder, random = Ladder(1.0, 1e4, 1.3), np.random.default_rng(1)
    found = []
    for _ in range(200):
        begins = np.exp(np.log(100.0) + 0.5 * random.standard_normal((ladder.count, 12)))
        shares = {i: float((begins[i] <= ladder.at(i)).mean()) for i in range(ladder.count)}
        found.append((np.log(ladder.border(shares)), np.log(ladder.error(shares, 12))))
    borders, errors = np.array(found).T
    assert borders.mean() == pytest.approx(np.log(100.0), abs=0.02)
    assert errors.mean() == pytest.approx(borders.std(), rel=0.2)


def test_what_is_foretold_spans_from_nearly_nothing_to_nearly_all():
    ladder = Ladder(1.0, 1e6, 1.5)
    shares = ladder.foretold(lambda y: float(1 / (1 + (300 / y) ** 3)))
    assert list(shares) == list(range(min(shares), max(shares) + 1))
    assert shares[min(shares)] <= 0.05 < shares[min(shares) + 1]
    assert shares[max(shares) - 1] < 0.95 <= shares[max(shares)]
    assert ladder.border(shares) == pytest.approx(300, rel=0.05)
    assert ladder.foretold(lambda _: 0.5) == {}


def test_runs_that_are_not_as_foretold_are_followed_up_and_complained_of():
    ladder, foretold = Ladder(1.0, 1e6, 1.5), {4: 0.0, 5: 0.5, 6: 1.0}

    def stepping(border: float) -> Callable[[float, int], tuple[int, int, str]]:
        return lambda y, first: (0 if y > border else 8, 8, "tracking lost")

    for true in (1000.0, 2.0):
        found = climbed(stepping(true), ladder, foretold, sections=4, seeds=8)
        assert found.measured == pytest.approx(true, rel=0.25)
        assert found.off is not None
        assert found.off > 1
        assert EdgeMap("counts", "k", "y", (found,)).complaints()
    never = climbed(stepping(1e9), ladder, foretold, sections=4, seeds=8)
    assert never.near is None
    assert "nothing works" in EdgeMap("counts", "k", "y", (never,)).complaints()[0]
    always = climbed(stepping(0.0), ladder, foretold, sections=4, seeds=8)
    assert always.far is None
    assert "no border" in EdgeMap("counts", "k", "y", (always,)).complaints()[0]
