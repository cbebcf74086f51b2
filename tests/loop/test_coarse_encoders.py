"""A few benches with coarse encoders, and a scale that rests for long; the whole table is among the benchmarks."""

import math

import pytest
from coarse_benches import completed, flown, stuck_scales

from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def turn_from_rest() -> Plan:
    return make_plan(load_itinerary("turn-from-rest"))


@pytest.mark.parametrize(
    ("rate", "scale", "counts"), [(200.0, 2e-4, 1000), (200.0, 1e-4, 40_000), (1000.0, 2e-4, 4000)]
)
def test_runs_with_coarse_encoders_complete(turn_from_rest: Plan, rate: float, scale: float, counts: int) -> None:
    options = {"rate": rate, "cart_resolution": scale, "counts": counts}
    assert completed(turn_from_rest, options, range(32)) == (1.0, [])


@pytest.mark.parametrize(("scale", "at_once"), [(1e-6, 6), (2e-4, 4)])
def test_a_stuck_scale_is_found_within_50_ms_of_a_millimetre(turn_from_rest: Plan, scale: float, at_once: int) -> None:
    found = stuck_scales(turn_from_rest, {"cart_resolution": scale}, range(6))
    # The others wait for a cart that creeps to move on.
    assert sum(one.delay <= 0.05 for one in found) >= at_once
    assert not any(math.isinf(one.delay) for one in found)


def test_arms_held_for_a_minute_have_no_stuck_sensor() -> None:
    plan = make_plan(load_itinerary("hold-up-up"))
    options = {"cart_resolution": 2e-4, "counts": 1000, "rate": 200.0}
    assert not [flight.run.reason for flight in flown(plan, options, range(8)) if "stuck" in flight.run.reason]
