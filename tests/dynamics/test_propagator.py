"""Propagation, compared with scipy's DOP853 and properties of the exact flow."""

import casadi as ca
import heyoka as hy
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.dynamics.compiled import to_heyoka
from dpcontrol.dynamics.propagator import PolynomialInputPropagator

DOP853 = 1e-9  # error of scipy's DOP853 at 1e-12 over a second of this motion
SYMPLECTIC = 1e-11
STATE = np.array([0.4, 2.9, 6.0, -3.0])


@pytest.fixture(scope="module")
def pendulum(system):
    return system.propagator


def by_scipy(equations, parameters, state, duration, inputs=()):
    f = equations.function()
    return solve_ivp(
        lambda t, x: np.array(f(x, inputs, parameters)).ravel(), (0, duration), state,
        method="DOP853", rtol=1e-12, atol=1e-12, dense_output=True,
    )  # fmt: skip


def test_flow_agrees_with_dop853(lab, pendulum):
    expected = by_scipy(lab.system.equations, lab.parameters.base(), STATE, 1.0).y[:, -1]
    assert np.abs(pendulum.flow(STATE, 1.0) - expected).max() < DOP853


def test_cart_level_flow_has_constant_input(lab):
    equations = arm_chain_equations(2, Level.CART)
    state = np.append(STATE, [0.1, -0.3])
    expected = by_scipy(equations, lab.parameters.base(), state, 0.5, [4.0]).y[:, -1]
    found = PolynomialInputPropagator(equations, lab.parameters.base(), degree=0).flow(state, [4.0], 0.5)
    assert np.abs(found - expected).max() < DOP853
    assert found[5] == pytest.approx(-0.3 + 4.0 * 0.5, rel=1e-14)


def test_energy_is_conserved_to_rounding(lab, pendulum):
    states = pendulum.sample(STATE, np.linspace(0, 5, 200))
    assert np.ptp(lab.system.numeric.hamiltonian(states)) < 1e-13


def test_state_transition_matrix_agrees_with_differences_and_is_symplectic(lab, pendulum):
    end, stm = pendulum.flow_with_stm(STATE, 0.5)
    steps = 1e-5 * np.eye(4)
    columns = [(pendulum.flow(STATE + s, 0.5) - pendulum.flow(STATE - s, 0.5)) / 2e-5 for s in steps]
    assert np.allclose(stm, np.array(columns).T, rtol=1e-6, atol=1e-6)
    # In (q, p) the flow's derivative is symplectic. T maps (q, ω) to (q, p).
    to_canonical = [np.vstack([np.eye(4)[:2], lab.system.numeric.momentum_jacobian(x)]) for x in (STATE, end)]
    canonical = to_canonical[1] @ stm @ np.linalg.inv(to_canonical[0])
    form = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
    assert np.abs(canonical.T @ form @ canonical - form).max() < SYMPLECTIC


def test_samples_lie_on_the_flow_and_need_not_start_at_zero(pendulum):
    times = np.array([0.1, 0.15, 0.4])
    states = pendulum.sample(STATE, times)
    assert states.shape == (3, 4)
    for time, state in zip(times, states, strict=True):
        assert np.abs(state - pendulum.flow(STATE, time)).max() < 1e-12
    with_stm, matrices = pendulum.sample_with_stm(STATE, times)
    assert np.abs(with_stm - states).max() < 1e-12
    assert np.abs(matrices[-1] - pendulum.flow_with_stm(STATE, 0.4)[1]).max() < 1e-10


def test_every_mapped_operation_agrees_with_heyoka():
    x = ca.SX.sym("x", 2)
    a, b = x[0], x[1]
    expressions = [
        a + b, a - b, a * b, a / b, -a, a**2, 2 * a, 1 / a, a**b, a**3.5, ca.sqrt(a), ca.exp(a), ca.log(a), ca.sin(a),
        ca.cos(a), ca.tan(a), ca.asin(a / 2), ca.acos(a / 2), ca.atan(a), ca.sinh(a), ca.cosh(a), ca.tanh(a),
        ca.atan2(a, b), ca.fabs(-a),
    ]  # fmt: skip
    function = ca.Function("all", [x], [ca.vertcat(*expressions, 0)])
    variables = hy.make_vars("a", "b")
    compiled = hy.cfunc(to_heyoka(function, [variables]), vars=variables)
    point = np.array([0.7, 1.3])
    assert np.allclose(compiled(point), np.array(function(point)).ravel(), rtol=1e-15, atol=1e-15)


def test_an_operation_without_a_counterpart_is_refused_by_name():
    x = ca.SX.sym("x")
    with pytest.raises(NotImplementedError, match="no heyoka counterpart"):
        to_heyoka(ca.Function("f", [x], [ca.floor(x)]), [hy.make_vars("x", "y")])
