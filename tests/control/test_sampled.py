from dataclasses import replace

import numpy as np
import pytest
from quick_rate import quick_rate
from scipy.integrate import solve_ivp
from shadowing_stand_in import LAB

from dpcontrol.control.interface import SampledModel, sampled_model
from dpcontrol.dynamics.chain import Level, arm_chain_equations

STEP = 1e-7  # Error of one Runge-Kutta step of 1 ms.
SLOPE = 1e-5  # Of central differences, relative to Jacobians of order one.
EQUATIONS = arm_chain_equations(2, Level.CART)
STATE = np.array([0.4, 2.8, 6.0, -9.0, 0.1, -0.3])


def exact_flow(state: np.ndarray, command: float, duration: float) -> np.ndarray:
    rate = quick_rate(EQUATIONS)

    def slope(_: float, x: np.ndarray) -> np.ndarray:
        return np.array(rate(x, command, LAB.base())).ravel()

    return solve_ivp(slope, (0, duration), state, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]


def test_a_step_and_its_jacobians_agree_with_an_independent_integrator() -> None:
    model = SampledModel(EQUATIONS, LAB.base(), period=1e-3)
    assert model.step(STATE, 3.0) == pytest.approx(exact_flow(STATE, 3.0, 1e-3), abs=STEP)
    a, b = model.linearised(np.array([STATE, STATE / 2]), np.array([3.0, -1.0]))
    for k, (state, command) in enumerate(((STATE, 3.0), (STATE / 2, -1.0))):
        for j in range(6):
            d = 1e-5 * np.eye(6)[j]
            column = (exact_flow(state + d, command, 1e-3) - exact_flow(state - d, command, 1e-3)) / 2e-5
            assert a[k][:, j] == pytest.approx(column, abs=SLOPE)
        column = exact_flow(state, command + 0.5, 1e-3) - exact_flow(state, command - 0.5, 1e-3)
        assert b[k] == pytest.approx(column, abs=1e-6 * SLOPE**0.5)


def test_dry_friction_is_linearised_at_its_mean_slope() -> None:
    at_rest, base = np.array([[np.pi, np.pi, 0.0, 0.0, 0.0, 0.0]]), LAB.base()
    model = sampled_model(replace(LAB, coulomb=(0.002, 0.001), smoothing=0.005), 1000.0)
    width = max(0.002 / np.sqrt(base[3] * base[0]), 0.001 / np.sqrt(base[4] * base[2])) / 0.2
    viscous = replace(LAB, viscous=(LAB.viscous[0] + 0.002 / width, LAB.viscous[1] + 0.001 / width))
    found, expected = (m.linearised(at_rest, np.zeros(1))[0][0] for m in (model, sampled_model(viscous, 1000.0)))
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)
    # The step itself keeps the friction: a slow joint meets nearly all of it.
    slow = at_rest[0] + np.array([0, 0, 0.1, 0.1, 0, 0])
    lost = model.step(slow, 0.0)[2] - sampled_model(LAB, 1000.0).step(slow, 0.0)[2]
    assert lost < -1e-3 * 0.002 / base[0]
