"""OGY's borders by encoder counts and by the largest pulse: each side by runs, and what the loop says beyond."""

from dataclasses import replace
from functools import cache

import pytest

from dpcontrol.bench.edges import COUNTS, counts_border, held_orbit, holds, limit_border, pulses
from dpcontrol.control.ogy import OgyController
from dpcontrol.references.sustained import SustainedOrbit

RUNS = 8


@cache
def orbit() -> SustainedOrbit:
    return held_orbit()


def law_of(sections: int) -> OgyController:
    return pulses(orbit(), sections, seconds=4.0)


@pytest.mark.slow
def test_large_pulses_hold_and_small_ones_lose_the_orbit():
    law = law_of(16)
    near, far = (holds(orbit(), replace(law, pulse_limit=most), counts=COUNTS, seeds=RUNS) for most in (0.2, 0.04))
    assert near.works, near.says
    assert not far.works
    assert "runs lost" in far.says


@pytest.mark.slow
def test_fine_encoders_hold_and_coarse_ones_lose_the_orbit():
    near, far = (holds(orbit(), law_of(4), counts=counts, seeds=RUNS) for counts in (20_000.0, 2000.0))
    assert near.works, near.says
    assert not far.works
    assert "runs lost" in far.says


@pytest.mark.slow
def test_one_section_per_period_is_lost_at_any_real_resolution_with_a_reason():
    for border_of in (limit_border, counts_border):
        border = border_of(orbit(), law_of(1), seeds=2, ratio=1.6)
        assert border.near is None
        assert "tracking lost" in border.says or "cart at its stop" in border.says
