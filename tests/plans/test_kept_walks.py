"""Walks whose stops are kept: the plan has whole periods of sustained orbits between flights, and OGY hands over to
TVLQR and back. Expected times come from the connections' own, and states from flying the stored input again.
"""

from dataclasses import replace

import numpy as np
import pytest

from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.judge.decoding import decode_run
from dpcontrol.judge.score import score
from dpcontrol.plans.itinerary import itinerary_from, load_itinerary
from dpcontrol.plans.model import load_model
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.references.content import FlightSegment
from dpcontrol.runs.run import run_plan
from tests.references.flown_again import gaps

FLOWN_AGAIN = 1e-6
"""Scaled: the tolerance of the mesh, for an interval flown again on its own input."""
NO_JUMP = 1e-9
"""Scaled: flights end on the orbits that are joined, but for the solver's bounds."""
NEAR_ORBIT = 0.1
"""rad: what a completed period asks for."""
TRAVEL = 0.4
WALK = """
energy = -0.07
walk = ["down-up +", "down-up -"]
wraps = [{}]
lead_in = 3
lead_out = 3
[controller]
keep = "ogy"
"""


def kept(wraps: int) -> Plan:
    return make_plan(itinerary_from(WALK.format(wraps), "scene", load_model("lab")))


@pytest.fixture(scope="module")
def linger() -> Plan:
    return make_plan(load_itinerary("linger"))


def stays(plan: Plan) -> list[int]:
    """The whole periods of each stay."""
    return [stay.periods for stay in plan.content.stays]


def planned_wraps(plan: Plan) -> tuple[int | None, ...]:
    """The wraps of a reference itself, counted as those of a run are."""
    times = np.arange(0.0, plan.reference.duration, 1e-3)
    angles = plan.reference.state(times)[:, :2]
    decoded = decode_run(times, angles, plan.reference)
    assert decoded.matched == len(plan.content.stops)
    return decoded.wraps


@pytest.mark.slow
def test_the_reference_has_the_requested_wraps(linger: Plan) -> None:
    assert planned_wraps(linger) == linger.itinerary.wraps == (8, 6)
    assert len(stays(linger)) == 4
    assert stays(linger)[1] >= 6
    assert stays(linger)[2] >= 5


@pytest.mark.slow
def test_flights_and_stays_are_one_motion(linger: Plan) -> None:
    reference = linger.reference
    assert reference.converged
    assert gaps(reference, linger.itinerary.model.arms).max() < FLOWN_AGAIN
    assert reference.constraint_violation < NO_JUMP


@pytest.mark.slow
def test_a_stay_repeats_one_period_of_its_orbit(linger: Plan) -> None:
    entry = linger.content.segments[2]
    first, last = entry.rows
    states, rows = linger.reference.states, last - first
    for k in range(entry.periods):
        begin = first + k * rows
        assert np.array_equal(states[begin : begin + rows], states[first:last])


@pytest.mark.slow
def test_a_long_stay_costs_no_more_than_a_short_one() -> None:
    short, long = kept(6), kept(40)
    assert planned_wraps(long) == (40,)
    assert stays(long)[1] - stays(short)[1] == 34
    assert long.reference.iterations == short.reference.iterations


@pytest.mark.slow
def test_a_stop_without_room_for_a_period_is_flown_through() -> None:
    plan = kept(0)
    flights = [part.fly for part in plan.content.segments if isinstance(part, FlightSegment)]
    assert flights == ["down-up +, down-up -"]
    assert planned_wraps(plan) == (0,)


@pytest.mark.slow
def test_the_last_stay_has_a_period_to_settle_before_the_one_that_is_judged() -> None:
    short = WALK.format(6).replace("lead_out = 3", "lead_out = 1")
    assert stays(make_plan(itinerary_from(short, "scene", load_model("lab"))))[-1] == 2


@pytest.mark.slow
def test_ogy_hands_over_to_tvlqr_and_back_with_a_plant_five_per_cent_off(linger: Plan) -> None:
    # The first pulses have no time for zeros.
    loop = replace(linger.itinerary.loop, keep="ogy", estimator=EkfSettings(augment=()))
    by_pulses = replace(linger, itinerary=replace(linger.itinerary, loop=loop))
    itinerary = by_pulses.itinerary.with_run({"mismatch": 0.05, "initial_error": 0.03}, seed=0)
    log = run_plan(replace(by_pulses, itinerary=itinerary)).log
    handed_over = [event.text.partition(":")[0] for event in log.events if event.text.startswith("hand over")]
    assert handed_over == ["hand over to tvlqr", "hand over to ogy"] * 3
    assert log.truth is not None
    assert np.abs(log.truth[:, 4]).max() < TRAVEL
    # The orbit that it began on, whole turns apart: the last period is on it by the true state.
    orbit = linger.content.orbits[0].curve
    period = linger.content.orbits[0].period
    angles = log.truth[log.time > log.time[-1] - period, :2] - linger.content.stops[-1].angles + [0, np.pi]
    gaps = np.abs(angles[:, None] - orbit[None, :, :2]).max(-1).min(1)
    assert gaps.max() < NEAR_ORBIT
    judged = score(log)
    assert judged.completed, judged.reason
    assert judged.wraps == (8, 6)
