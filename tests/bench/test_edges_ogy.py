"""OGY's borders by encoder counts and by the largest pulse: each side by runs."""

from dataclasses import replace
from functools import cache

import pytest

from dpcontrol.bench.control import held_orbit
from dpcontrol.bench.edges import COUNTS, holds, pulses
from dpcontrol.references.sustained import SustainedOrbit

RUNS = 8


@cache
def orbit() -> SustainedOrbit:
    return held_orbit()


@pytest.mark.slow
def test_large_pulses_hold_and_small_ones_lose_the_orbit():
    law = pulses(orbit(), 16, seconds=4.0)
    near, far = (holds(orbit(), replace(law, pulse_limit=most), counts=COUNTS, seeds=RUNS) for most in (0.2, 0.04))
    assert near.works, near.says
    assert not far.works
    assert "runs lost" in far.says


@pytest.mark.slow
def test_fine_encoders_hold_and_coarse_ones_lose_the_orbit():
    law = pulses(orbit(), 4, seconds=4.0)
    near, far = (holds(orbit(), law, counts=counts, seeds=RUNS) for counts in (20_000.0, 2000.0))
    assert near.works, near.says
    assert not far.works
    assert "runs lost" in far.says
