import numpy as np
import pytest
from quick_rate import quick_rate
from scipy.integrate import solve_ivp
from shadowing_stand_in import LAB

from dpcontrol.control.interface import SampledModel
from dpcontrol.dynamics.chain import Level, arm_chain_equations

STEP = 1e-7  # Error of one Runge-Kutta step of 1 ms.
SLOPE = 1e-5  # Of central differences, relative to Jacobians of order one.
EQUATIONS = arm_chain_equations(2, Level.CART)
STATE = np.array([0.4, 2.8, 6.0, -9.0, 0.1, -0.3])


def exact_flow(state: np.ndarray, command: float, duration: float) -> np.ndarray:
    rate = quick_rate(EQUATIONS)
    flow = solve_ivp(
        lambda _, x: np.array(rate(x, command, LAB.base())).ravel(),
        (0, duration),
        state,
        method="DOP853",
        rtol=1e-12,
        atol=1e-12,
    )
    return flow.y[:, -1]


@pytest.fixture
def model() -> SampledModel:
    return SampledModel(EQUATIONS, LAB.base(), period=1e-3)


def test_a_step_agrees_with_an_independent_integrator(model: SampledModel) -> None:
    expected = exact_flow(STATE, 3.0, 1e-3)
    assert model.step(STATE, 3.0) == pytest.approx(expected, abs=STEP)


def test_jacobians_are_those_of_differences_of_the_exact_flow(model: SampledModel) -> None:
    a, b = model.linearised(np.array([STATE, STATE / 2]), np.array([3.0, -1.0]))
    for k, (state, command) in enumerate(((STATE, 3.0), (STATE / 2, -1.0))):
        for j in range(6):
            d = 1e-5 * np.eye(6)[j]
            column = (exact_flow(state + d, command, 1e-3) - exact_flow(state - d, command, 1e-3)) / 2e-5
            assert a[k][:, j] == pytest.approx(column, abs=SLOPE)
        column = exact_flow(state, command + 0.5, 1e-3) - exact_flow(state, command - 0.5, 1e-3)
        assert b[k] == pytest.approx(column, abs=1e-6 * SLOPE**0.5)
