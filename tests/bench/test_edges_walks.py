"""Rounding limits of gaps in shadowing orbits, which decrease with the nodes' spacing."""

from functools import cache

import pytest

from dpcontrol.bench.edges import APART, ENERGY, round_trip, rounding_floor, tolerance_border


@cache
def border(segments: int, wraps: int):
    return tolerance_border([round_trip(), round_trip(ENERGY * (1 + APART))], segments=segments, wraps=wraps, x=1.0)


@pytest.mark.benchmark
def test_nodes_nearer_together_reach_smaller_gaps():
    assert border(1, 2).measured > 10 * border(4, 2).measured
    # 1e-11 is the product's tolerance, at eight nodes a period.
    assert border(8, 2).near < 1e-12


@pytest.mark.benchmark
def test_rounding_bounds_the_gaps_from_below():
    for segments in (1, 4):
        assert border(segments, 2).near > rounding_floor(round_trip(), segments=segments) / 2


@pytest.mark.benchmark
def test_many_wraps_are_as_good_as_few():
    assert border(1, 8).near < 4 * border(1, 4).near


def test_too_small_a_tolerance_is_named_with_the_symbol_and_the_remedy():
    says = border(1, 4).says
    assert says.startswith("2 of 2 not converged; symbol ")
    assert "not converged: gap" in says
    assert "more nodes" in says
