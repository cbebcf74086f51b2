"""One run of each class of ending, its sentence read and held against the true states."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from ending_truth import Flight, class_of, flights, untrue, untrue_score

from dpcontrol.loop.result import Ending
from dpcontrol.plans.plan import Plan

BENCH = {"initial_error": 0.05, "command_noise": 0.3, "controller": "tvlqr"}


def flown(plan: Plan, *, seed: int = 0, **options: Any) -> Flight:
    (flight,) = flights(plan.itinerary.with_run({**{**BENCH, **options}}), plan.reference, [seed])
    return flight


@pytest.mark.parametrize(
    ("options", "kind"),
    [
        ({"travel": 0.05, "mismatch": 0.1}, "cart at its stop"),
        ({"pushes": 3, "push_impulse": 0.03, "travel": 2.0, "seed": 3}, "tracking lost"),
        ({"stuck_at": 1.0, "stuck_sensor": 0}, "sensor stuck"),
        ({"stuck_at": 1.0, "stuck_sensor": 1}, "sensor stuck"),
        ({"stuck_at": 1.0, "stuck_sensor": 2}, "sensor stuck"),
        ({"dropout": 0.99}, "no measurement"),
    ],
)
def test_the_reason_of_an_ending_is_true(plan: Plan, options: dict[str, Any], kind: str) -> None:
    flight = flown(plan, **options)
    assert class_of(flight) == kind, flight.run.reason
    assert untrue(flight) == untrue_score(flight) == ""


def test_a_lost_estimate_is_one_that_was_wrong(plan: Plan) -> None:
    scene = plan.itinerary.with_run({**BENCH, "mismatch": 0.8, "lag": 0.03, "travel": 10.0})
    # A filter that knows nothing of its model's errors.
    strict = replace(scene.loop.estimator, augment=("zeros",), parameter_error=0.0, rate_noise=1e-5, cart_noise=1e-3)
    found = flights(replace(scene, loop=replace(scene.loop, estimator=strict)), plan.reference, range(8))
    lost = [flight for flight in found if flight.run.ending is Ending.ESTIMATE_LOST]
    assert lost
    assert [untrue(flight) for flight in lost] == [""] * len(lost)


def test_a_limit_switch_is_at_its_nominal_place(plan: Plan) -> None:
    scene = plan.itinerary.with_run({**BENCH, "mismatch": 0.1})
    short = replace(scene.loop, drive=replace(scene.loop.drive, track=0.02))
    (flight,) = flights(replace(scene, loop=short), plan.reference, range(1))
    assert class_of(flight) == "limit switch"
    assert untrue(flight) == ""
    assert np.abs(flight.run.truth[:, -2]).max() == pytest.approx(0.02, abs=1e-6)
