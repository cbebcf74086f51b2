"""Flights lead from any state to their target within the limits, by an independent integrator."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dpcontrol as dp
from dpcontrol.control.flight import REACHED, FlightPlanner, Target
from dpcontrol.control.interface import sampled_model
from dpcontrol.control.lqr import HoldSettings, hold_controller
from dpcontrol.foundation.causes import FlightCause
from dpcontrol.loop.targets import hold_target
from dpcontrol.plans.model import load_model

LAB = load_model("lab").arms
LIMITS = dp.Limits(position=0.4)
MODEL = sampled_model(LAB, 1000.0)
SAME = 1e-6
"""Difference between mirrored flights, whose searches round alike but for the whole turns."""
UPRIGHT = {"up-up": (np.pi, np.pi), "down-up": (0.0, np.pi), "up-down": (np.pi, 0.0), "down-down": (0.0, 0.0)}


def target_of(name: str) -> Target:
    state = np.array([*UPRIGHT[name], 0.0, 0.0, 0.0, 0.0])
    return hold_target(hold_controller(state, MODEL, HoldSettings(), seconds=1.0), LIMITS)


def any_states(count: int, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    most = np.array([np.pi, np.pi, 20.0, 20.0, 0.28, 1.5])
    return random.uniform(-most, most, (count, 6))


def propagated(state: np.ndarray, inputs: np.ndarray, step: float) -> np.ndarray:
    """The states at the steps' ends by scipy's DOP853."""
    rate, states = MODEL.equations.function(), [state]
    for push in inputs:

        def slope(_, x, push=push):
            return np.array(rate(x, push, MODEL.parameters)).ravel()

        states.append(solve_ivp(slope, (0.0, step), states[-1], method="DOP853", rtol=1e-9, atol=1e-9).y[:, -1])
    return np.array(states)


@pytest.mark.parametrize("name", UPRIGHT)
def test_flights_from_random_states_end_where_the_law_takes_over_and_keep_the_limits(name: str) -> None:
    states, target = any_states(16, seed=len(name)), target_of(name)
    flights = FlightPlanner(LAB, LIMITS).plan(states, target)
    assert flights.reached.all()
    assert np.median(flights.durations) < 1.3
    for k in range(2):
        flown = propagated(states[k], flights.inputs[k], flights.durations[k] / flights.inputs.shape[1])
        assert target.nearest(flown[-1:])[0][0] < REACHED
        assert np.abs(flown[:, 4]).max() < LIMITS.position
        assert np.abs(flown[:, 5]).max() < LIMITS.velocity
        assert np.abs(flights.inputs[k]).max() < LIMITS.acceleration


def test_mirrored_and_turned_states_give_mirrored_and_turned_flights() -> None:
    states, planner, target = any_states(4, seed=8), FlightPlanner(LAB, LIMITS), target_of("up-up")
    flights, mirrored = planner.plan(states, target), planner.plan(-states, target)
    np.testing.assert_allclose(mirrored.inputs, -flights.inputs, atol=SAME)
    turns = 2 * np.pi * np.array([3, -2, 0, 0, 0, 0])
    turned = planner.plan(states + turns, target)
    np.testing.assert_allclose(turned.nodes, flights.nodes + turns, atol=SAME)


def test_a_flight_that_misses_says_so() -> None:
    weak = replace(LIMITS, acceleration=1.5, position=0.02)
    flight = dp.flight("lab", [1.0, 2.0, 3.0, 4.0, 0.01, 0.1], "up-up", limits=weak)
    assert not flight.converged
    assert flight.cause is FlightCause.MISSED
    assert flight.cost > REACHED
    # Neither limit alone would do at twice its size.
    assert flight.remedy is None


def test_a_flight_that_leaves_the_track_has_not_reached_its_target() -> None:
    # A cart 5 mm before its end at 2 m/s needs 67 mm at 30 m/s².
    flight = dp.flight("lab", [0.0, 0.0, 0.0, 0.0, 0.395, 2.0], "down-down", limits=LIMITS)
    assert not flight.converged
    assert flight.cause is FlightCause.OUTSIDE
    assert flight.remedy == ("position", 0.8)


def test_a_flight_leads_to_an_orbit_and_to_the_first_stop_of_a_plan() -> None:
    state = [1.0, 2.0, 3.0, 4.0, 0.1, 0.2]
    orbit = dp.orbit("lab", "down-up", energy=-0.07)
    assert dp.flight("lab", state, orbit, limits=LIMITS).converged
    assert dp.flight("lab", state, dp.plan("outer-turn")).converged
