import numpy as np
import pytest
from scipy.integrate import solve_ivp
from shadowing_stand_in import LAB

from dpcontrol.dynamics.arm_chain import Level, arm_chain_equations
from dpcontrol.foundation.errors import InputError
from dpcontrol.lab.bench import Drive, Encoders, Plant, SensorSettings
from dpcontrol.references.problem import Limits

EXACT = 1e-10  # DOP853 at 1e-12 over a tenth of a second.
COUNT = 2 * np.pi / 40_000


def test_relative_joints_are_rounded_to_counts_and_then_summed() -> None:
    encoders = Encoders(2, SensorSettings())
    random = np.random.default_rng(5)
    for state in random.uniform(-20, 20, (200, 6)):
        measured = encoders.measure(state)
        joints = np.array([measured[0], measured[1] - measured[0]]) / COUNT
        assert joints == pytest.approx(np.rint(joints), abs=1e-6)
        assert abs(measured[0] - state[0]) <= COUNT / 2 + 1e-12
        assert abs((measured[1] - measured[0]) - (state[1] - state[0])) <= COUNT / 2 + 1e-12
        assert measured[2] == pytest.approx(state[4], abs=0.5e-6 + 1e-12)
    assert encoders.measure(np.zeros(6)) == pytest.approx(np.zeros(3), abs=0)


def test_a_coarse_encoder_sees_nothing_below_half_a_count() -> None:
    encoders = Encoders(1, SensorSettings(counts=128, cart_resolution=0.01))
    half = np.pi / 128
    assert encoders.measure(np.array([0.99 * half, 0, 0.0049, 0])) == pytest.approx([0, 0], abs=0)
    assert encoders.measure(np.array([1.01 * half, 0, 0.0051, 0])) == pytest.approx([2 * half, 0.01])
    with pytest.raises(InputError, match="counts = -1"):
        SensorSettings(counts=-1)
    with pytest.raises(InputError, match="cart_resolution"):
        SensorSettings(cart_resolution=-1)


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
