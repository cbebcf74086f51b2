"""Do runs complete with coarse encoders, at low and high rates, and with readings of varying age?

Each table is printed; small ones run with the slow tests of the loop.
"""

import sys
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import pytest
from coarse_benches import completed, stuck_scales

from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan

pytestmark = pytest.mark.benchmark

ITINERARIES = ("turn-from-rest", "up-up", "cross-from-rest")
RUNS, SHARE = 50, 0.98
SCALES, ENCODERS = (1e-6, 2e-5, 1e-4, 2e-4), (1000, 4000, 40_000)
"""Resolutions of the cart's scale, m, and counts of the encoders."""
SOON, BRISK = 0.05, 0.04
"""Delay of a soon detection after the cart's first millimetre, and time for this millimetre at 25 mm/s, s."""
JITTERED = (*ITINERARIES, "outer-turn", "cross")
"""Itineraries of readings of varying age: arms at rest do not show their age, so two of these start on an orbit."""
JITTERED_RUNS = 200
JITTER_SHARES = {0.5: 0.97, 1.0: 0.95}
"""Share of completed runs by the jitter in periods."""


@cache
def planned(name: str) -> Plan:
    return make_plan(load_itinerary(name))


def least(options: Mapping[str, Any], seeds: Sequence[int], names: Sequence[str]) -> float:
    """Print a row of the table and return the least share of completed runs of an itinerary."""
    found = [completed(planned(name), options, seeds) for name in names]
    assert not any("stuck" in reason for _, reasons in found for reason in reasons)
    sys.stdout.write(f"{options}  {'  '.join(f'{len(seeds) - len(r):4d} of {len(seeds)}' for _, r in found)}\n")
    return min(share for share, _ in found)


@pytest.mark.parametrize("rate", [200.0, 1000.0, 2000.0])
def test_ordinary_encoders_complete_98_runs_of_100_and_no_scale_is_called_stuck(rate: float) -> None:
    for scale in SCALES:
        for counts in ENCODERS:
            options = {"rate": rate, "cart_resolution": scale, "counts": counts}
            assert least(options, range(RUNS), ITINERARIES) >= SHARE


@pytest.mark.parametrize("rate", [500.0, 1000.0])
@pytest.mark.parametrize("counts", [4000, 40_000])
def test_readings_that_vary_in_age_by_up_to_a_period_complete(rate: float, counts: int) -> None:
    for periods, share in JITTER_SHARES.items():
        options = {"rate": rate, "counts": counts, "jitter": periods / rate}
        assert least(options, range(JITTERED_RUNS), JITTERED) >= share


@pytest.mark.parametrize(("scale", "share"), [(1e-6, 1.0), (2e-5, 0.9), (1e-4, 0.8), (2e-4, 0.75)])
def test_a_stuck_scale_is_found_soon_after_the_cart_has_moved_a_millimetre(scale: float, share: float) -> None:
    found = [one for name in ITINERARIES for one in stuck_scales(planned(name), {"cart_resolution": scale}, range(20))]
    soon = sum(one.delay <= SOON for one in found) / len(found)
    sys.stdout.write(f"\n{1e6 * scale:.0f} µm: {soon:.0%} of {len(found)} within 50 ms of a millimetre\n")
    assert soon >= share
    assert all(one.delay <= SOON for one in found if one.moving <= BRISK)
    assert max(one.delay for one in found) < float("inf")
