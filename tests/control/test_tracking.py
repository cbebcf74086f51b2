from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from shadowing_stand_in import LAB, StandIn

from dpcontrol.control.sampled import SampledModel
from dpcontrol.control.tracking import (
    FeedforwardSettings,
    TvlqrSettings,
    riccati_gains,
    terminal_cost,
    tracking_controller,
)
from dpcontrol.dynamics.arm_chain import Level, arm_chain_equations
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.references.reference import Reference

SOLVED = 1e-7  # Relative, of Riccati solvers on well-scaled matrices.
A = np.array([[1.0, 0.1, 0.0], [0.3, 1.02, 0.1], [0.0, 0.05, 0.9]])
B = np.array([0.0, 0.1, 0.05])
WEIGHTS = np.array([1.0, 0.5, 2.0])
EFFORT = 0.3


@pytest.fixture(scope="module")
def model() -> SampledModel:
    return SampledModel(arm_chain_equations(2, Level.CART), LAB.base(), period=2e-3)


def test_terminal_cost_solves_the_discrete_algebraic_riccati_equation() -> None:
    expected = solve_discrete_are(A, B[:, None], np.diag(WEIGHTS), np.array([[EFFORT]]))
    cost = terminal_cost(A, B, weights=WEIGHTS, effort=EFFORT)
    assert cost == pytest.approx(expected, rel=SOLVED)


def test_an_end_that_cannot_be_stabilised_is_named() -> None:
    with pytest.raises(GoalMissed, match="cannot be stabilised"):
        terminal_cost(np.diag([1.5, 0.5]), np.array([0.0, 1.0]), weights=np.ones(2), effort=1.0)


def test_gains_far_from_the_end_are_the_stationary_ones() -> None:
    cost = solve_discrete_are(A, B[:, None], np.diag(WEIGHTS), np.array([[EFFORT]]))
    stationary = (B @ cost @ A) / (EFFORT + B @ cost @ B)
    many = 400
    gains, _ = riccati_gains(
        np.tile(A, (many, 1, 1)), np.tile(B, (many, 1)), weights=WEIGHTS, effort=EFFORT, terminal=np.eye(3)
    )
    assert gains[0] == pytest.approx(stationary, rel=SOLVED)


def test_gains_of_a_short_varying_horizon_minimise_the_cost() -> None:
    random = np.random.default_rng(3)
    steps, terminal = 6, np.diag([3.0, 2.0, 1.0])
    a = A + 0.1 * random.standard_normal((steps, 3, 3))
    b = B + 0.1 * random.standard_normal((steps, 3))
    gains, _ = riccati_gains(a, b, weights=WEIGHTS, effort=EFFORT, terminal=terminal)
    start = np.array([1.0, -0.5, 0.3])
    # The same problem as one least-squares problem in all inputs.
    free, forced = [start], [np.zeros((3, steps))]
    for k in range(steps):
        free.append(a[k] @ free[-1])
        forced.append(a[k] @ forced[-1] + np.outer(b[k], np.eye(steps)[k]))
    roots = [np.diag(np.sqrt(WEIGHTS))] * steps + [np.sqrt(terminal)]
    left = np.vstack([r @ f for r, f in zip(roots, forced, strict=True)] + [np.sqrt(EFFORT) * np.eye(steps)])
    right = np.concatenate([-r @ f for r, f in zip(roots, free, strict=True)] + [np.zeros(steps)])
    expected = np.linalg.lstsq(left, right, rcond=None)[0]
    state, inputs = start, []
    for k in range(steps):
        inputs.append(float(-gains[k] @ state))
        state = a[k] @ state + b[k] * inputs[-1]
    assert inputs == pytest.approx(expected, rel=SOLVED, abs=SOLVED)


def test_feedback_is_zero_on_the_reference_and_pulls_back_beside_it(
    turn: tuple[StandIn, Reference], model: SampledModel
) -> None:
    controller = tracking_controller(turn[1], model, TvlqrSettings())
    k = 700
    wanted = controller.reference_states[k]
    assert wanted == pytest.approx(turn[1].state(k * 2e-3), abs=1e-12)
    feedforward, feedback = controller.command(k, wanted)
    assert feedback == 0.0
    assert feedforward == pytest.approx(float(turn[1].input(k * 2e-3 + 1e-3)[0]), abs=1e-12)
    beside = wanted + np.array([1e-4, 0, 0, 0, 0, 0])
    for j in range(k, k + 1500):
        u = sum(controller.command(j, beside))
        beside = model.step(beside, u)
    assert np.abs(beside - controller.reference_states[k + 1500])[:4].max() < 2e-5


def test_feedforward_ignores_the_state(turn: tuple[StandIn, Reference], model: SampledModel) -> None:
    controller = tracking_controller(turn[1], model, FeedforwardSettings())
    assert controller.kind == "feedforward"
    assert controller.command(5, np.full(6, 9.0)) == controller.command(5, np.zeros(6))


def test_after_the_last_tick_the_last_command_holds(turn: tuple[StandIn, Reference], model: SampledModel) -> None:
    controller = tracking_controller(turn[1], model, TvlqrSettings())
    last = len(controller.feedforward) - 1
    assert controller.command(last + 50, np.zeros(6)) == controller.command(last, np.zeros(6))


def test_what_cannot_be_tracked_is_refused(turn: tuple[StandIn, Reference], model: SampledModel) -> None:
    with pytest.raises(InputError, match="cannot be tracked: it failed"):
        tracking_controller(replace(turn[1], converged=False, status="it failed"), model, TvlqrSettings())
    single = replace(
        LAB, **{k: getattr(LAB, k)[:1] for k in ("mass", "centre_of_mass", "length", "inertia", "viscous")}
    )
    other = SampledModel(arm_chain_equations(1, Level.CART), single.base(), period=1e-3)
    with pytest.raises(InputError, match="use one model"):
        tracking_controller(turn[1], other, TvlqrSettings())
    with pytest.raises(InputError, match="effort = 0"):
        TvlqrSettings(effort=0)
