"""Radau's methods, and orders of convergence of the collocation equations as an initial-value problem.

Source: Hairer & Wanner, Solving Ordinary Differential Equations II, section IV.5 (orders at the ends of
steps).
"""

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from quick_rate import quick_rate
from scipy.integrate import solve_ivp
from scipy.special import roots_jacobi
from shadowing_stand_in import LAB, orbit_stretch

from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.references.method import Method, method_named, radau
from dpcontrol.references.problem import Limits, ReferenceSettings, state_scale
from dpcontrol.references.transcription import interval_function

Array = NDArray[np.float64]

NEAR_THEORY = 0.3  # Required accuracy of the order.
ROUNDING = 1e-10  # Difference of two integrators at machine precision and of Newton's steps.
MESHES = (8, 16, 32, 64)
EQUATIONS = arm_chain_equations(2, Level.CART)
SECONDS = 0.4
NAMES = [
    "radau-2", "radau-3", "radau-4", "gauss-1", "gauss-2", "gauss-3", "lobatto-2", "lobatto-3", "lobatto-4",
    "hermite-simpson",
]  # fmt: skip


def pushed(times: Array) -> Array:
    """Return a smooth, non-polynomial acceleration of the cart, m/s²."""
    return np.asarray(3.0 * np.sin(7.0 * np.asarray(times) + 0.4), dtype=np.float64)


@pytest.fixture(scope="module")
def flown() -> tuple[Array, Array]:
    """The first and last states of the motion, by another integrator."""
    start = np.array([*orbit_stretch(SECONDS).guess(0.0), 0.0, 0.0])
    rate = quick_rate(EQUATIONS)
    flow = solve_ivp(
        lambda t, x: np.array(rate(x, pushed(t), LAB.base())).ravel(),
        (0.0, SECONDS), start, method="DOP853", rtol=1e-13, atol=1e-14,
    )  # fmt: skip
    return start, flow.y[:, -1]


def stepped(method: Method, start: Array, intervals: int) -> Array:
    """Return the last state, by Newton's method on the transcription's equations for each interval."""
    interval = interval_function(EQUATIONS, LAB.base().tolist(), Limits(), method, ReferenceSettings())
    count, nx = len(method.points), EQUATIONS.dimension
    x, inputs, length = ca.SX.sym("x", nx), ca.SX.sym("u", 1, count), ca.SX.sym("h")
    values = ca.SX.sym("v", nx * count)
    defects, end, _, _ = interval(x, ca.reshape(values, nx, count), inputs, length, ca.DM.zeros(nx - 2, count))
    newton = ca.rootfinder(
        "newton", "newton", {"x": values, "p": ca.vertcat(x, inputs.T, length), "g": defects}, {"abstol": 1e-13}
    )
    ending = ca.Function("end", [x, values], [end])
    scale, h = state_scale(nx, Limits()), SECONDS / intervals
    state = start / scale
    for i in range(intervals):
        found = newton(x0=np.tile(state, count), p=np.concatenate([state, pushed(h * (i + method.points)), [h]]))["x"]
        state = np.array(ending(state, found)).ravel()
    return state * scale


@pytest.mark.parametrize("name", NAMES)
def test_errors_at_the_ends_of_intervals_have_the_order_of_the_method(name: str, flown: tuple[Array, Array]) -> None:
    start, exact = flown
    method, scale = method_named(name), state_scale(EQUATIONS.dimension, Limits())
    errors = np.array([np.abs((stepped(method, start, n) - exact) / scale).max() for n in MESHES])
    seen = errors[errors > ROUNDING]
    assert len(seen) >= 2
    assert np.log2(seen[-2] / seen[-1]) == pytest.approx(method.order, abs=NEAR_THEORY)


SUMMED = 1e-12  # Sums of a few terms of order ten in double precision.


@pytest.mark.parametrize("count", range(2, 9))
def test_radau_methods_have_jacobis_points_and_are_exact_for_polynomials(count: int) -> None:
    method = radau(count)
    zeros, _ = roots_jacobi(count - 1, 1.0, 0.0)
    assert method.points == pytest.approx([*((zeros + 1) / 2), 1.0], abs=SUMMED)
    for degree in range(2 * count - 1):
        assert method.weights @ method.points**degree == pytest.approx(1 / (degree + 1), abs=SUMMED)
    assert method.weights @ method.points ** (2 * count - 1) != pytest.approx(1 / (2 * count), abs=1e-9)
    curve = np.polynomial.Polynomial(np.cos(np.arange(count + 1.0)))
    values = curve(method.support)
    assert method.differentiation @ values == pytest.approx(curve.deriv()(method.points), abs=100 * SUMMED)
    assert method.end @ values == pytest.approx(curve(1.0), abs=SUMMED)
