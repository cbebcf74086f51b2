"""OGY's border by encoder counts and by the largest pulse: foretold from the filter, and each side of it by runs."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dpcontrol.bench.edges_ogy import (
    LIMIT,
    Task,
    counts_border,
    holds,
    largest_linear_pulse,
    limit_border,
    margins,
    survives,
    task,
    unknown,
)
from dpcontrol.control.ogy import OgyController

COUNTS = 40_000.0
RUNS = 3


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


def test_margins_are_proportional_to_the_largest_pulse():
    half = replace(law(4), pulse_limit=LIMIT / 2)
    assert margins(orbit(), half, COUNTS) == pytest.approx(margins(orbit(), law(4), COUNTS) / 2, rel=1e-9)


def test_more_sections_leave_more_room_and_one_leaves_none():
    least = [margins(orbit(), law(k), COUNTS).min() for k in (1, 2, 4, 8, 16)]
    assert (np.diff(least) > 0).all()
    # With one section a period a count is 530 counts at the next: a twentieth of a deviation is all that can be borne.
    assert least[0] < 0.1
    assert survives(orbit(), law(1), COUNTS) < 1e-3
    assert survives(orbit(), law(16), COUNTS) > 0.999


# With 16 sections the zeros, learnt at the start, ask for a third more than the steady state that is foretold.
@pytest.mark.parametrize(("sections", "above"), [(4, 1.3), (8, 1.3), (16, 1.6)])
def test_pulses_hold_somewhat_above_the_foretold_limit_and_are_lost_below_it(sections, above):
    each = margins(orbit(), law(sections), COUNTS) / LIMIT
    runs = 6.0 / orbit().orbit.period
    from math import erf, sqrt

    grid = np.geomspace(0.01, 2.0, 400)
    half = grid[np.argmax([np.prod([erf(g * z / sqrt(2)) for z in each]) ** runs > 0.5 for g in grid])]
    near = holds(orbit(), replace(law(sections), pulse_limit=above * half), counts=COUNTS, seeds=RUNS)
    far = holds(orbit(), replace(law(sections), pulse_limit=half / 1.4), counts=COUNTS, seeds=RUNS)
    assert near.works, near.says
    assert not far.works
    assert "lost" in far.says


def test_one_section_a_period_is_lost_at_any_real_resolution_and_the_loop_says_so():
    lost = holds(orbit(), law(1), counts=COUNTS, seeds=RUNS)
    assert not lost.works
    assert "tracking lost" in lost.says or "cart at its stop" in lost.says


def test_counts_end_where_they_are_foretold_told_by_authority():
    found = counts_border(orbit(), 4, seeds=6, ratio=1.5)
    assert found.off is not None
    assert found.off < 0.25
    # Filters average: authority goes by about the cube root of the counts.
    assert 2 < found.power < 4


def test_nothing_is_foretold_where_pulses_leave_the_linear_range():
    assert largest_linear_pulse(orbit(), law(16)) > 5 > 1.1 > largest_linear_pulse(orbit(), law(2))
    found = limit_border(orbit(), 1, seeds=1)
    assert found.predicted is None
    assert "lost" in found.says
