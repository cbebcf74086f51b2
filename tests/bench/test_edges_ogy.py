"""OGY's borders by encoder counts and by the largest pulse: each side by runs, and what the loop says beyond."""

from dataclasses import replace
from functools import cache

import pytest

from dpcontrol.bench.control import held_orbit
from dpcontrol.bench.edges import COUNTS, counts_border, holds, limit_border, pulses
from dpcontrol.control.ogy import OgyController
from dpcontrol.references.sustained import SustainedOrbit

RUNS = 8


@cache
def orbit() -> SustainedOrbit:
    return held_orbit()


def law_of(sections: int) -> OgyController:
    return pulses(orbit(), sections, seconds=4.0)


@pytest.mark.slow
@pytest.mark.parametrize(("sections", "enough"), [(4, 0.5), (16, 0.2)])
def test_large_pulses_hold_and_small_ones_lose_the_orbit(sections: int, enough: float):
    law = law_of(sections)
    near = holds(orbit(), replace(law, pulse_limit=enough), counts=COUNTS, seeds=RUNS)
    far = holds(orbit(), replace(law, pulse_limit=enough / 5), counts=COUNTS, seeds=RUNS)
    assert near.works, near.says
    assert not far.works
    assert "runs lost" in far.says


@pytest.mark.slow
@pytest.mark.parametrize(("sections", "enough"), [(4, 20_000.0), (16, 2000.0)])
def test_fine_encoders_hold_and_coarse_ones_lose_the_orbit(sections: int, enough: float):
    law = law_of(sections)
    near, far = (holds(orbit(), law, counts=counts, seeds=RUNS) for counts in (enough, enough / 10))
    assert near.works, near.says
    assert not far.works
    assert "runs lost" in far.says


@pytest.mark.slow
def test_one_section_per_period_is_lost_at_any_real_resolution_with_a_reason():
    for border_of in (limit_border, counts_border):
        border = border_of(orbit(), law_of(1), seeds=2, ratio=1.6)
        assert border.near is None
        assert "tracking lost" in border.says or "cart at its stop" in border.says


@pytest.mark.benchmark
def test_the_border_at_eight_sections_lies_where_it_did():
    # As measured over a ladder of values when this was written: chance moves a border of a few runs.
    assert limit_border(orbit(), law_of(8), seeds=RUNS, ratio=1.6).measured == pytest.approx(0.12, rel=0.5)
