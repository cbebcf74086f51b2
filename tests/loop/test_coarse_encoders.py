"""A few benches with coarse encoders, and a scale that rests for long; the whole table is among the benchmarks."""

import pytest
from coarse_benches import completed, flown

from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def turn_from_rest() -> Plan:
    return make_plan(load_itinerary("turn-from-rest"))


def test_runs_with_coarse_encoders_complete(turn_from_rest: Plan) -> None:
    options = {"rate": 200.0, "cart_resolution": 2e-4, "counts": 1000}
    assert completed(turn_from_rest, options, range(32)) == (1.0, [])


def test_arms_held_for_a_minute_have_no_stuck_sensor() -> None:
    plan = make_plan(load_itinerary("hold-up-up"))
    options = {"cart_resolution": 2e-4, "counts": 1000, "rate": 200.0}
    assert not [flight.run.reason for flight in flown(plan, options, range(8)) if "stuck" in flight.run.reason]
