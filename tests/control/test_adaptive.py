from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from shadowing_stand_in import LAB

from dpcontrol.control.ekf import FilterEquations
from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.interface import SampledModel
from dpcontrol.control.tick import TickEquations
from dpcontrol.control.tracking import (
    AdaptiveController,
    AdaptiveSettings,
    adaptive_controller,
    closing_weights,
    extra_jacobians,
    riccati_gains,
    terminal_cost,
)
from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.references.reference import Reference

SOLVED = 1e-7  # Relative, of Riccati solvers on well-scaled matrices.
DIFFERENCED = 1e-6  # Relative: central differences with a step of 1e-4.
FIRST_ORDER = 0.05  # Relative: what second order leaves at parameters wrong by 2e-4.
PERIOD = 2e-3
AUGMENT = ("drive", "friction", "parameters")
ESTIMATOR = EkfSettings(
    augment=AUGMENT, parameter_error=1e-3, rate_noise=0.01, model_error=0.15, friction_error=0.5
)  # fmt: skip
SETTINGS = AdaptiveSettings()


@pytest.fixture(scope="module")
def model() -> SampledModel:
    return SampledModel(arm_chain_equations(2, Level.CART), LAB.base(), period=PERIOD)


@pytest.fixture(scope="module")
def law(reference: Reference, model: SampledModel) -> AdaptiveController:
    return adaptive_controller(reference, model, SETTINGS, estimator=ESTIMATOR)


def test_gains_minimise_the_cost_with_the_extras_foreseen() -> None:
    random = np.random.default_rng(5)
    steps, n, extras, effort = 7, 3, 2, 0.3
    a = np.eye(n) + 0.2 * random.standard_normal((steps, n, n))
    b, e = random.standard_normal((steps, n)), random.standard_normal((steps, n, extras))
    kept, terminal = np.array([1.0, 0.6]), np.diag([3.0, 2.0, 1.0])
    weights = np.array([np.diag(w) for w in random.uniform(0.5, 2.0, (steps, n))])
    gains, extra_gains, _ = riccati_gains(a, b, weights=weights, effort=effort, terminal=terminal, extras=(e, kept))
    start, extra = np.array([1.0, -0.5, 0.3]), np.array([0.7, -1.1])
    # The same problem as one least-squares problem in all inputs, with every disturbance to come known.
    free, forced = [start], [np.zeros((n, steps))]
    for k in range(steps):
        free.append(a[k] @ free[-1] + e[k] @ (kept**k * extra))
        forced.append(a[k] @ forced[-1] + np.outer(b[k], np.eye(steps)[k]))
    roots = [*(np.sqrt(w) for w in weights), np.sqrt(terminal)]
    left = np.vstack([r @ f for r, f in zip(roots, forced, strict=True)] + [np.sqrt(effort) * np.eye(steps)])
    right = np.concatenate([-r @ f for r, f in zip(roots, free, strict=True)] + [np.zeros(steps)])
    expected = np.linalg.lstsq(left, right, rcond=None)[0]
    state, inputs = start, []
    for k in range(steps):
        w = kept**k * extra
        inputs.append(float(-gains[k] @ state - extra_gains[k] @ w))
        state = a[k] @ state + b[k] * inputs[-1] + e[k] @ w
    assert inputs == pytest.approx(expected, rel=SOLVED, abs=SOLVED)


@pytest.mark.parametrize(("name", "base"), [("M22", [2]), ("S1", [3, 5])])
def test_the_effect_of_a_wrong_parameter_is_that_of_other_arms(name: str, base: list[int], model: SampledModel) -> None:
    state, command, step = np.array([0.4, 2.9, 3.0, -6.0, 0.02, 0.3]), 1.5, 1e-4
    process = ESTIMATOR.process(2, PERIOD)
    effects, kept = extra_jacobians(model, ESTIMATOR.augments, state[None], np.array([command]), process)
    rate = model.equations.function()

    def after(share: float) -> np.ndarray:
        parameters = LAB.base()
        parameters[base] *= 1 + share
        solved = solve_ivp(
            lambda _, x: np.array(rate(x, command, parameters))[:, 0], (0, PERIOD), state,
            method="DOP853", rtol=1e-13, atol=1e-14,
        )  # fmt: skip
        return solved.y[:, -1]

    names = ("drive", "friction_1", "friction_2", "M11", "M22", "S1", "S2")
    expected = (after(step) - after(-step)) / (2 * step)
    assert effects[0][:, names.index(name)] == pytest.approx(expected, rel=1e-4, abs=DIFFERENCED * abs(expected).max())
    assert kept[names.index(name)] == 1.0
    assert kept[0] == pytest.approx(np.exp(-PERIOD / ESTIMATOR.drive_time))


@pytest.mark.slow
def test_a_reference_that_shall_end_on_its_orbit_is_shifted_as_if_feedback_were_as_eager(
    reference: Reference, model: SampledModel
) -> None:
    """Constants known from the start take the motion where the eager gains would, by the feedback of the calm ones."""
    calm = adaptive_controller(reference, model, SETTINGS, estimator=ESTIMATOR)
    states, commands = calm.reference_states[:-1], calm.feedforward
    a, b = model.linearised(states, commands)
    e, kept = extra_jacobians(model, ESTIMATOR.augments, states, commands, ESTIMATOR.process(2, PERIOD))
    weights, effort = closing_weights(SETTINGS, calm.reference_states, model), SETTINGS.weights(2, PERIOD)[1]
    terminal = terminal_cost(a[-1], b[-1], weights=np.diag(SETTINGS.weights(2, PERIOD)[0]), effort=effort)
    eager, foreseen, _ = riccati_gains(a, b, weights=weights, effort=effort, terminal=terminal, extras=(e, kept))
    extra = np.array([0.0, 0.2, -0.1, 0.03, -0.02, 0.04, 0.01])
    ends = []
    for gains, extra_gains in ((eager, foreseen), (calm.gains, calm.extra_gains)):
        error = np.zeros(6)
        for k in range(len(b)):
            error = a[k] @ error - b[k] * float(gains[k] @ error + extra_gains[k] @ extra) + e[k] @ extra
        ends.append(error)
    assert ends[1] == pytest.approx(ends[0], rel=1e-6, abs=1e-9)
    assert np.abs(eager - calm.gains).max() > 0.1 * np.abs(calm.gains).max()


@cache
def laws_expression() -> ca.Function:
    filters = FilterEquations(arm_chain_equations(2, Level.CART), PERIOD, ESTIMATOR.augments)
    shares = tuple(name.startswith(("M", "S")) for name in filters.extra_names)
    tick = TickEquations(filters, 0, 0, shares)
    sizes = {"row": tick.row.size, "state": 6, "extra": 7, "trust": 1}
    row, state, extra, trust = (ca.SX.sym(name, size) for name, size in sizes.items())
    law = tick.law(tick.row.of(row), state, ca.SX(0), extra, trust)
    return ca.Function("law", [row, state, extra, trust], list(law))


def asked(law: AdaptiveController, k: int, state: np.ndarray, extra: np.ndarray) -> tuple[float, float]:
    """Return the feedback at tick k in m/s², and which extra is trusted no further, by the tick's own expression."""
    expression = laws_expression()
    feedback, untrusted = expression(rows_of(law)[k], state, extra, law.trust)
    return float(feedback), float(untrusted)


@cache
def rows_of(law: AdaptiveController) -> np.ndarray:
    return law.schedule(0).rows


def _deviation(law: AdaptiveController, model: SampledModel, shares: np.ndarray) -> np.ndarray:
    """Fly arms that are wrong by `shares` of M11, M22, S1, S2, which are known from the start; (K+1, N) per unit."""
    factors = np.ones(9)
    factors[[0, 2, 3, 4]] += shares
    factors[[5, 6]] += shares[2:]
    plant = SampledModel(model.equations, LAB.base() * factors, period=model.period)
    extra = np.concatenate([np.zeros(3), np.log1p(shares)])
    state, out = law.first_state, np.empty((law.ticks + 1, 6))
    for k in range(law.ticks):
        out[k] = state - law.reference_states[k]
        state = plant.step(state, float(law.feedforward[k]) + asked(law, k, state, extra)[0])
    out[-1] = state - law.reference_states[-1]
    return out / np.abs(shares).max()


@pytest.mark.slow
def test_small_errors_of_the_model_do_what_the_first_order_foretells(
    law: AdaptiveController, model: SampledModel
) -> None:
    shares = np.array([1.0, -0.5, 0.7, -1.0]) * 2e-4
    states, commands = law.reference_states[:-1], law.feedforward
    a, b = model.linearised(states, commands)
    e, _ = extra_jacobians(model, ESTIMATOR.augments, states, commands, ESTIMATOR.process(2, PERIOD))
    extra = np.concatenate([np.zeros(3), shares]) / np.abs(shares).max()
    error, foretold = np.zeros(6), [np.zeros(6)]
    for k in range(law.ticks):
        v = -law.gains[k] @ error - law.extra_gains[k] @ extra
        error = a[k] @ error + b[k] * v + e[k] @ extra
        foretold.append(error)
    happened = _deviation(law, model, shares)
    # Without errors of the model the sampled one misses the reference a little; the difference of two runs does not.
    away = (happened - _deviation(law, model, -shares)) / 2
    assert np.abs(away - foretold).max() < FIRST_ORDER * np.abs(foretold).max()
    assert np.abs(foretold).max() > 0.1


@pytest.mark.slow
def test_the_quadratic_effect_of_a_known_error_is_compensated(law: AdaptiveController, model: SampledModel) -> None:
    diagonal, _ = SETTINGS.weights(2, PERIOD)
    costs = {}
    for name, controller in (("foreseen", law), ("blind", replace(law, pair_gains=np.zeros_like(law.pair_gains)))):
        # The sum over both signs has what is of even order, and twice the sampled model's own miss.
        shares = np.array([0.15, -0.075, 0.105, -0.15])
        even, miss = (
            sum(_deviation(controller, model, np.expm1(s)) * np.abs(np.expm1(s)).max() for s in (v, -v))
            for v in (shares, 1e-6 * shares)
        )
        costs[name] = float(((even - miss) ** 2 @ diagonal).sum())
    assert costs["foreseen"] < 0.2 * costs["blind"]


def test_a_share_beyond_trust_is_bounded_and_named(law: AdaptiveController) -> None:
    state = law.reference_states[100]
    assert asked(law, 99, state, np.array([0, 0, 0, 0.3, -0.3, 0.1, 0.1]))[1] == 0
    far, untrusted = asked(law, 100, state, np.array([0, 0, 0, 0.1, 0.1, 1.5, 0.1]))
    assert law.names[int(untrusted) - 1] == "S1"
    assert asked(law, 100, state, np.array([0, 0, 0, 0.1, 0.1, 50.0, 0.1]))[0] == far
    assert np.isfinite(asked(law, 100, state, np.array([0, 0, 0, -7.0, -2.0, 1.0, 0.1]))[0])
