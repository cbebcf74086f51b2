import numpy as np
import pytest
from scipy.integrate import solve_ivp
from shadowing_stand_in import LAB

from dpcontrol.dynamics.arm_chain import Level, arm_chain_equations
from dpcontrol.lab.bench import Drive, Plant
from dpcontrol.references.problem import Limits

EXACT = 1e-10  # DOP853 at 1e-12 over a tenth of a second.


def test_drive_keeps_acceleration_and_velocity_inside() -> None:
    drive = Drive(Limits(position=0.4, velocity=3.0, acceleration=30.0), period=1e-3)
    assert drive.applied(5.0, 0.0) == 5.0
    assert drive.applied(50.0, 0.0) == 30.0
    assert drive.applied(-50.0, 0.0) == -30.0
    assert drive.applied(30.0, 2.99) == pytest.approx(10.0)
    assert 2.99 + drive.applied(30.0, 2.99) * 1e-3 <= 3.0 + 1e-12
    assert drive.applied(-30.0, 3.0) == -30.0
    assert drive.applied(30.0, 3.0) == pytest.approx(0.0, abs=1e-9)
    assert drive.at_stop(0.4)
    assert drive.at_stop(-0.41)
    assert not drive.at_stop(0.39)


def test_plant_moves_as_an_independent_integrator_says() -> None:
    equations = arm_chain_equations(2, Level.CART)
    plant = Plant(equations, LAB.base())
    rate = equations.function()
    start = np.array([0.4, 2.8, 6.0, -9.0, 0.1, -0.3])
    flow = solve_ivp(
        lambda _, x: np.array(rate(x, 4.0, LAB.base())).ravel(),
        (0, 0.1),
        start,
        method="DOP853",
        rtol=1e-12,
        atol=1e-12,
    )
    assert plant.after(start, 4.0, 0.1) == pytest.approx(flow.y[:, -1], abs=EXACT)
    state = start
    for _ in range(100):
        state = plant.after(state, 4.0, 1e-3)
    assert state == pytest.approx(flow.y[:, -1], abs=EXACT)
    with pytest.raises(ArithmeticError, match="propagation stopped"):
        plant.after(np.full(6, np.nan), 0.0, 1e-3)
