"""OGY's border by encoder counts and by the largest pulse: foretold from the filter, and each side of it by runs."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dpcontrol.bench.edges_ogy import counts_border, foretold_limit, holds, limit_border
from dpcontrol.bench.ogy_borders import LIMIT, Task, largest_linear_pulse, room, task, unknown
from dpcontrol.control.ogy import OgyController

COUNTS = 40_000.0
RUNS = 5


@cache
def orbit() -> Task:
    return task()


@cache
def law(sections: int) -> OgyController:
    return orbit().controller(sections)


def test_what_is_unknown_is_a_covariance_and_falls_with_the_counts():
    fine, coarse = (unknown(orbit(), counts)[0] for counts in (COUNTS, COUNTS / 10))
    for sigmas in (fine, coarse):
        assert np.abs(sigmas - sigmas.transpose(0, 2, 1)).max() < 1e-12
        assert np.linalg.eigvalsh(sigmas).min() > -1e-12
    assert (np.trace(coarse, axis1=1, axis2=2) > 2 * np.trace(fine, axis1=1, axis2=2)).all()


def test_zeros_of_a_count_move_the_estimate_by_as_much_and_the_outer_arm_carries_both():
    _, _, means = unknown(orbit(), COUNTS)
    assert means[:, 0, 0].mean() == pytest.approx(1.0, abs=0.2)
    assert means[:, 1].mean(axis=0) == pytest.approx([1.0, 1.0], abs=0.2)


def test_larger_pulses_make_holding_likelier_and_zeros_make_it_less_so():
    known = room(orbit(), law(4), COUNTS)
    chances = [known.survives(limit, 8.0) for limit in (0.01, 0.1, 0.3, 1.0, 10.0)]
    assert chances == sorted(chances)
    assert chances[0] < 0.01 < 0.99 < chances[-1]
    none = replace(known, shifts=np.zeros_like(known.shifts))
    assert none.survives(0.3, 8.0) > known.survives(0.3, 8.0)
    assert (none.margins > known.margins).all()


def test_more_sections_leave_more_room_and_one_leaves_none():
    rooms = {k: room(orbit(), law(k), COUNTS) for k in (1, 2, 4, 8, 16)}
    least = [LIMIT * one.margins.min() for one in rooms.values()]
    assert (np.diff(least) > 0).all()
    # With one section a period a count is 530 counts at the next: a twentieth of a deviation is all that can be borne.
    assert least[0] < 0.1
    assert rooms[1].survives(LIMIT, 8.0) < 1e-3
    assert rooms[16].survives(LIMIT, 8.0) > 0.999


@pytest.mark.parametrize("sections", [4, 8, 16])
def test_pulses_hold_above_the_foretold_limit_and_are_lost_below_it(sections):
    half = foretold_limit(orbit(), law(sections), COUNTS)
    assert half is not None
    near = holds(orbit(), replace(law(sections), pulse_limit=1.3 * half), counts=COUNTS, seeds=RUNS)
    far = holds(orbit(), replace(law(sections), pulse_limit=half / 1.4), counts=COUNTS, seeds=RUNS)
    assert near.works, near.says
    assert not far.works
    assert "lost" in far.says


def test_one_section_a_period_is_lost_at_any_real_resolution_and_the_loop_says_so():
    lost = holds(orbit(), law(1), counts=COUNTS, seeds=RUNS)
    assert not lost.works
    assert "tracking lost" in lost.says or "cart at its stop" in lost.says


@pytest.mark.parametrize("sections", [4, 16])
def test_encoders_of_more_counts_than_foretold_hold_and_of_fewer_are_lost(sections):
    periods = 6.0 / orbit().orbit.period
    grid = np.geomspace(50, 50_000, 60)
    half = grid[np.argmax([room(orbit(), law(sections), c).survives(LIMIT, periods) > 0.5 for c in grid])]
    # Authority goes by about the cube root of the counts, and readings that repeat are no noise: 2 is a quarter of it.
    near, far = (holds(orbit(), law(sections), counts=c, seeds=10) for c in (2 * half, half / 3))
    assert near.works, near.says
    assert not far.works
    assert "lost" in far.says


def test_nothing_is_foretold_where_pulses_leave_the_linear_range():
    assert largest_linear_pulse(orbit(), law(16)) > 5 > 1.1 > largest_linear_pulse(orbit(), law(2))
    assert largest_linear_pulse(orbit(), law(1)) < LIMIT
    for found in (limit_border(orbit(), 1, seeds=1), counts_border(orbit(), 1, seeds=1)):
        assert found.predicted is None
        assert "lost" in found.says
