from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bench_stand_in import PERIOD, Flight, fly, model_of, plant_of
from shadowing_stand_in import LAB, StandIn

from dpcontrol.control.handover import Fly, Keep, Program, program
from dpcontrol.control.interface import Action
from dpcontrol.control.ogy import OgyController, OgySettings, ogy_controller
from dpcontrol.control.tracking import TrackingController, TvlqrSettings, tracking_controller
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.plans.model import load_model
from dpcontrol.references.reference import Reference
from dpcontrol.references.sustained import SustainedOrbit, sustained_orbit

ON_ORBIT = 0.1  # rad: what a completed period asks for.
JOIN = 0.06  # Largest scaled distance of a flight from its final orbit, with a plant 3 % off.


@cache
def orbit(energy: float = -0.07) -> SustainedOrbit:
    return sustained_orbit(lyapunov_orbit(load_model("lab").system, "down-up", energy=energy), LAB)


@cache
def wobble() -> OgyController:
    return ogy_controller(orbit(), model_of(), OgySettings(), seconds=60.0)


def flight(reference: Reference) -> TrackingController:
    made = tracking_controller(reference, model_of(), TvlqrSettings())
    assert isinstance(made, TrackingController)
    return made


def reflected(reference: Reference) -> Reference:
    """The same the other way round: all angles, rates and the cart's motion negated."""
    return replace(reference, states=-reference.states, inputs=-reference.inputs)


@pytest.fixture(scope="module")
def there_and_back(turn: tuple[StandIn, Reference]) -> Program:
    """Six wobbles by OGY, the turn, eight wobbles, the turn back, three wobbles."""
    keep = [Keep(f"wobble {k + 1}", wobble(), wraps=n) for k, n in enumerate((6, 8, 3))]
    turns = [Fly("turn", flight(turn[1])), Fly("turn back", flight(reflected(turn[1])))]
    return program([keep[0], turns[0], keep[1], turns[1], keep[2]], period=PERIOD)


def spans(actions: list[Action]) -> list[int]:
    """Ticks at which a segment was handed over to the next."""
    return [k for k, action in enumerate(actions) if action.event.startswith("hand over to")]


@pytest.fixture(scope="module")
def done(there_and_back: Program) -> Flight:
    """The program done by encoders on a plant that is 3 % off."""
    plant = plant_of(1, 0.03)
    return fly(there_and_back.begin(), plant, there_and_back.first_state, there_and_back.ticks * PERIOD)


@pytest.mark.slow
def test_ogy_keeps_the_wobbles_and_tvlqr_flies_the_turns_there_and_back(there_and_back: Program, done: Flight) -> None:
    assert len(done.states) == there_and_back.ticks
    assert [event.split(":")[1] for event in done.events] == [" turn", " wobble 2", " turn back", " wobble 3"]
    begins = spans(done.actions)
    # The outer arm went round once, and back again.
    outer = done.states[[0, begins[1] + 1500, -1], 1]
    assert np.rint((outer - outer[0]) / (2 * np.pi)).tolist() in ([0, 1, 0], [0, -1, 0])
    for k in (*range(begins[1], begins[2], 50), *range(begins[3], len(done.states), 50)):
        assert wobble().distance(done.states[k]) < JOIN


@pytest.mark.slow
def test_a_stay_lasts_the_requested_periods_to_within_half_a_period(done: Flight) -> None:
    begins = spans(done.actions)
    periods = np.array([begins[0], begins[2] - begins[1]]) * PERIOD / orbit().period
    assert np.abs(periods - [6, 8]).max() <= 0.52


@pytest.mark.slow
def test_a_stay_is_left_where_the_next_flight_begins(done: Flight) -> None:
    for k in spans(done.actions):
        # The reference goes on from one controller to the next without a jump.
        jump = np.abs(done.actions[k].reference - done.actions[k - 1].reference) / [np.pi, np.pi, 10, 10, 0.8, 3]
        assert jump.max() < JOIN
