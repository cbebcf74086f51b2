from functools import cache

import numpy as np
import pytest
from quick_rate import quick_rate
from scipy.integrate import solve_ivp
from scipy.linalg import solve_discrete_are
from shadowing_stand_in import LAB

from dpcontrol.control.interface import sampled_model
from dpcontrol.control.ogy import (
    ClassicOgySettings,
    OgyController,
    OgySettings,
    disturbance_shifts,
    ogy_controller,
    parameter_directions,
    sensitivities,
)
from dpcontrol.control.periodic import (
    OrbitController,
    closed_multipliers,
    orbit_controller,
    periodic_gains,
    phase_table,
)
from dpcontrol.control.tracking import TvlqrSettings
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.plans.model import load_model
from dpcontrol.references.sustained import SustainedOrbit, sustained_orbit

RICCATI = 1e-5  # Relative; matrices with entries of thousands, squared.
SLOPE = 1e-3  # Of Runge-Kutta flights with a held input against a tight integrator, relative to the largest.
NONE = np.zeros(0)
MODEL = sampled_model(LAB, 1000.0)


@cache
def orbit() -> SustainedOrbit:
    return sustained_orbit(lyapunov_orbit(load_model("lab").system, "down-up", energy=-0.07), LAB)


@cache
def ogy(sections: int, *, parameter_error: float = 0.05) -> OgyController:
    settings = OgySettings(sections=sections, pulse_limit=5.0, parameter_error=parameter_error)
    return ogy_controller(orbit(), MODEL, settings, seconds=60.0)


@cache
def classic(sections: int) -> OgyController:
    return ogy_controller(orbit(), MODEL, ClassicOgySettings(sections=sections), seconds=60.0)


@cache
def tvlqr(schedule: str = "phase") -> OrbitController:
    return orbit_controller(orbit(), MODEL, TvlqrSettings(schedule=schedule), seconds=60.0)


def test_gains_of_one_section_are_those_of_the_riccati_equation() -> None:
    here = orbit().section_maps(1)[0]
    a, b = here.matrix, here.response
    weights, effort = OgySettings().weights(2, here.duration)
    cost = solve_discrete_are(a, b[:, None], np.diag(weights), np.array([[effort]]))
    expected = (b @ cost @ a) / (effort + b @ cost @ b)
    gains = periodic_gains(a[None], b[None], weights=weights, effort=effort)
    assert gains[0] == pytest.approx(expected, rel=RICCATI, abs=RICCATI * np.abs(expected).max())


@pytest.mark.parametrize("sections", [2, 16])
def test_pulses_at_any_number_of_sections_make_the_orbit_stable_without_noise(sections: int) -> None:
    maps = orbit().section_maps(sections)
    arrays = np.array([m.matrix for m in maps]), np.array([m.response for m in maps])
    assert np.abs(closed_multipliers(*arrays, np.zeros_like(arrays[1])))[0] > 500
    assert np.abs(closed_multipliers(*arrays, ogy(sections).gains))[0] < 0.5


def test_a_classic_pulse_takes_the_unstable_direction_to_zero_and_leaves_the_cart_to_drift() -> None:
    maps = orbit().section_maps(4)
    arrays = np.array([m.matrix for m in maps]), np.array([m.response for m in maps])
    values = np.abs(closed_multipliers(*arrays, classic(4).gains))
    # What is left of the pendulum is the energy; the cart's pair stays at one.
    assert values[0] == pytest.approx(1.0, abs=1e-4)
    assert values[2] < 0.99


def test_sensitivities_are_those_of_flights_of_changed_plants() -> None:
    maps = orbit().section_maps(8)
    directions = parameter_directions(orbit().equations, orbit().parameters)
    found = sensitivities(orbit(), maps, directions)
    rate = quick_rate(orbit().equations)
    here = maps[2]
    for i in (0, 1, 4, 5):
        ends = []
        for sign in (1, -1):
            parameters = orbit().parameters + sign * 1e-4 * directions[i]

            def right(t: float, x: np.ndarray, p: np.ndarray = parameters) -> np.ndarray:
                return np.array(rate(x, float(orbit().input(here.start.time + t)), p)).ravel()

            done = solve_ivp(right, (0, here.duration), here.start.state, method="DOP853", rtol=1e-11, atol=1e-12)
            ends.append(done.y[:, -1])
        expected = here.end.projection @ (ends[0] - ends[1]) / 2e-4
        assert found[2, :, i] == pytest.approx(expected, abs=SLOPE * np.abs(found[2]).max())


def test_known_disturbances_are_met_by_the_least_cost_of_all_periodic_motions() -> None:
    k, n = 4, 6
    maps = orbit().section_maps(k)
    controller = ogy(k)
    weights, effort = OgySettings().weights(2, maps[0].duration)
    effort /= 2
    random = np.random.default_rng(1)
    d = random.normal(0, 1e-3, (k, n, 1))
    for j, m in enumerate(maps):
        d[j, :, 0] = m.end.projection @ d[j, :, 0]
    shifts = disturbance_shifts(maps, controller.gains, d, weights=weights, effort=effort)
    # One quadratic program in all states and pulses of a period, its conditions solved at once.
    size = k * (n + 1)
    cost = np.zeros((size, size))
    rules, right = np.zeros((k * n, size)), np.zeros(k * n)
    for j, m in enumerate(maps):
        cost[j * n : (j + 1) * n, j * n : (j + 1) * n] = np.diag(weights)
        cost[k * n + j, k * n + j] = effort
        rows, after = slice(j * n, (j + 1) * n), (j + 1) % k
        rules[rows, after * n : (after + 1) * n] += np.eye(n)
        rules[rows, j * n : (j + 1) * n] -= m.matrix
        rules[rows, k * n + j] = -m.response
        right[rows] = d[j, :, 0]
    whole = np.block([[cost, rules.T], [rules, np.zeros((k * n, k * n))]])
    solution = np.linalg.lstsq(whole, np.concatenate([np.zeros(size), right]), rcond=None)[0]
    states, pulses = solution[: k * n].reshape(k, n), solution[k * n : size]
    expected = -(controller.gains * states).sum(1) - pulses
    assert shifts[:, 0] == pytest.approx(expected, rel=1e-4, abs=1e-5 * np.abs(expected).max())


def test_a_section_that_is_not_crossed_is_named_in_the_events() -> None:
    controller = ogy(4)
    session = controller.begin()
    # An arm that is held fast never comes to the next section.
    stuck = controller.first_state + np.array([0.0, 0.0, -3.0, -3.0, 0.0, 0.0])
    events = [session.command(k, stuck, NONE).event for k in range(1000)]
    assert next(e for e in events if e).startswith("section 2 was not crossed: clock of the orbit moved by")


@pytest.mark.parametrize("law", ["pulses", "time", "phase"])
def test_many_runs_do_what_each_does_alone(law: str) -> None:
    controller = ogy(8) if law == "pulses" else tvlqr(law)
    together, alone = controller.begin_many(3), [controller.begin() for _ in range(3)]
    kicks = np.random.default_rng(0).normal(0, 0.02, (3, 6))
    for k in range(900):
        states = orbit().state(k * 1e-3) + kicks
        forward, back, wanted = together.commands(k, states.T)
        each = [session.command(k, state, NONE) for session, state in zip(alone, states, strict=True)]
        assert forward + back == pytest.approx([a.feedforward + a.feedback for a in each], abs=1e-9)
        assert wanted == pytest.approx(np.array([a.reference for a in each]).T, abs=1e-9)


def test_an_orbit_is_joined_at_any_phase_and_on_any_turns() -> None:
    turns = np.array([2 * np.pi, -4 * np.pi, 0, 0, 0, 0])
    time = 0.37 * orbit().period
    for controller in (ogy(8), tvlqr()):
        session = controller.join(70, orbit().state(time) + turns)
        action = session.command(70, orbit().state(time) + turns, NONE)
        assert action.reference == pytest.approx(orbit().state(time) + turns, abs=1e-3)
        assert controller.distance(orbit().state(time) + turns) < 1e-4
        assert controller.distance(orbit().state(time) + 0.3 * np.eye(6)[0]) > 0.01


def test_the_nearest_phase_is_the_nearest() -> None:
    table = phase_table(orbit())
    random = np.random.default_rng(2)
    times = random.uniform(0, orbit().period, 20)
    states = orbit().state(times) + random.normal(0, 1e-3, (20, 6))
    found, distances, turns = table.nearest(states)
    dense = np.linspace(0, orbit().period, 40_001)[:-1]
    scale = np.array([np.pi, np.pi, 10, 10])
    for state, time, distance in zip(states, found, distances, strict=True):
        errors = (orbit().state(dense)[:, :4] - state[:4]) / scale
        best = dense[np.argmin(np.square(errors).sum(1))]
        assert (time - best + 0.1) % orbit().period == pytest.approx(0.1, abs=1e-4)
        assert distance < 2e-3
    assert not turns.any()
