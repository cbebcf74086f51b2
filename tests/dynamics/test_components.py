"""Components of the plant, compared with equations written by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from shadowing_stand_in import LAB

from dpcontrol.dynamics.components import Belt, Cable, EncoderPlay, Stiction, SymbolicPlant
from dpcontrol.dynamics.plant import PlantParameters
from dpcontrol.loop.bench import Blow
from dpcontrol.loop.simulated import SimulatedPlant

EXACT = 1e-9  # DOP853 at 1e-12 over a second of motion.
PENDULUM = replace(
    LAB, mass=LAB.mass[:1], centre_of_mass=LAB.centre_of_mass[:1], length=LAB.length[:1], inertia=LAB.inertia[:1],
    viscous=(0.0,),
)  # fmt: skip
INERTIA = PENDULUM.inertia[0] + PENDULUM.mass[0] * PENDULUM.centre_of_mass[0] ** 2
WEIGHT = PENDULUM.gravity * PENDULUM.mass[0] * PENDULUM.centre_of_mass[0]
COUPLING = PENDULUM.mass[0] * PENDULUM.centre_of_mass[0]


def flown(
    plant: PlantParameters, state: np.ndarray, commands: np.ndarray, *, period: float = 1e-3, lanes: int = 0
) -> np.ndarray:
    """Return the states (K+1, N) at the ends of periods with constant commands (K,), or of many lanes."""
    whole = np.concatenate([state, [0.0] * bool(plant.lag), plant.own_states(state)])
    first = np.repeat(whole[:, None], lanes, axis=1) if lanes else whole
    moving = SimulatedPlant([plant] * max(lanes, 1), first, track=10.0)
    states = [moving.state.copy()]
    for k, command in enumerate(commands):
        moving.move(np.full(lanes, command) if lanes else float(command), period, time=k * period)
        states.append(moving.state.copy())
    return np.array(states)


def commands(count: int, size: float, seed: int = 4) -> np.ndarray:
    return np.repeat(np.random.default_rng(seed).uniform(-size, size, count // 20), 20)


@pytest.mark.parametrize("lag", [0.0, 0.005])
def test_a_belt_is_two_masses_on_a_spring_and_a_damper(lag: float) -> None:
    frequency, damping = 22.0, 0.07
    omega, given = 2 * np.pi * frequency, commands(200, 8.0)
    plant = PlantParameters(PENDULUM, lag=lag, components=(Belt(frequency, damping, motor_scale=True),))
    start = np.array([0.3, -1.0, 0.02, 0.1])
    found = flown(plant, start, given)

    def slope(time: float, y: np.ndarray, u: float) -> list[float]:
        angle, rate, x, v, a, x_m, v_m = y
        motor = a if lag else u
        cart = omega**2 * (x_m - x) + 2 * damping * omega * (v_m - v)
        turning = -(WEIGHT * np.sin(angle) + COUPLING * np.cos(angle) * cart) / INERTIA
        return [rate, turning, v, cart, (u - a) / lag if lag else 0.0, v_m, motor]

    y = np.array([*start, 0.0, *start[2:]])
    for k, u in enumerate(given):
        y = solve_ivp(slope, (0, 1e-3), y, args=(u,), method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
        assert found[k + 1, [0, 1, 2, 3, -2, -1]] == pytest.approx(y[[0, 1, 2, 3, 5, 6]], abs=EXACT)
    assert np.abs(found[:, 2] - found[:, -2]).max() > 1e-4


def test_arm_and_belt_move_a_heavy_cart() -> None:
    frequency, mass, lag = 12.0, 1.5, 0.004
    omega, given, whole = 2 * np.pi * 12.0, commands(100, 5.0), mass + PENDULUM.mass[0]
    plant = PlantParameters(PENDULUM, lag=lag, cart_mass=mass, components=(Belt(frequency, 0.1, motor_scale=True),))
    start = np.array([1.2, 3.0, 0.0, 0.0])
    found = flown(plant, start, given)

    def slope(time: float, y: np.ndarray, u: float) -> list[float]:
        angle, rate, x, v, a, x_m, v_m = y
        force = whole * (omega**2 * (x_m - x) + 2 * 0.1 * omega * (v_m - v))
        across = COUPLING * np.cos(angle)
        both = np.array([[INERTIA, across], [across, whole]])
        turning, cart = np.linalg.solve(both, [-WEIGHT * np.sin(angle), force + COUPLING * np.sin(angle) * rate**2])
        return [rate, turning, v, cart, (u - a) / lag, v_m, a]

    y = np.array([*start, 0.0, 0.0, 0.0])
    for u in given:
        y = solve_ivp(slope, (0, 1e-3), y, args=(u,), method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    assert found[-1] == pytest.approx(y, abs=EXACT)


def test_a_knock_on_the_cart_has_no_effect_on_the_motor_and_its_loop() -> None:
    plant = PlantParameters(LAB, lag=0.005, components=(Belt(20.0, 0.1, motor_scale=True),))
    start = np.array([0.1, 0.2, 0.0, 0.0, 0.0, 0.0])
    moving = SimulatedPlant([plant], np.concatenate([start, [1.0], plant.own_states(start)]), track=1.0)
    moving.strike(Blow(np.zeros(2), np.zeros(2), 0.3))
    assert moving.state[5] == pytest.approx(0.3)
    assert moving.state[6:].tolist() == [1.0, 0.0, 0.0]
    assert moving.loop_velocity == pytest.approx(0.005)


def test_encoder_play_is_the_play_operator_of_the_joints() -> None:
    widths, offsets = (0.02, 0.05), (0.004, -0.02)
    plant = PlantParameters(LAB, components=(EncoderPlay(widths, offsets),))
    start = np.array([0.1, -0.2, 0.0, 0.0, 0.0, 0.0])
    found, plain = flown(plant, start, commands(1000, 6.0)), flown(PlantParameters(LAB), start, commands(1000, 6.0))
    assert found[:, :6] == pytest.approx(plain, abs=1e-12)
    joints = np.diff(found[:, :2], axis=1, prepend=0.0)
    expected = joints[0] + offsets
    for joint, encoder in zip(joints, found[:, 6:], strict=True):
        # The textbook backlash stops at the nearer end of the play.
        for k, half in enumerate(np.array(widths) / 2):
            if joint[k] - expected[k] > half:
                expected[k] = joint[k] - half
            elif joint[k] - expected[k] < -half:
                expected[k] = joint[k] + half
        assert encoder == pytest.approx(expected, abs=1e-12)
    assert np.ptp(joints - found[:, 6:], axis=0) == pytest.approx(widths, rel=1e-6)


def test_a_cable_turns_the_inner_arm_only() -> None:
    torque, stiffness = 0.02, 0.05
    plant = PlantParameters(PENDULUM, components=(Cable(torque, stiffness),))
    start, given = np.array([0.4, 0.0, 0.0, 0.0]), np.zeros(300)
    found = flown(plant, start, given)

    def slope(time: float, y: np.ndarray) -> list[float]:
        return [y[1], (-WEIGHT * np.sin(y[0]) + torque - stiffness * y[0]) / INERTIA]

    expected = solve_ivp(slope, (0, 0.3), start[:2], method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    assert found[-1, :2] == pytest.approx(expected, abs=EXACT)


def test_a_joint_slides_with_its_kinetic_torque_and_stops_exactly() -> None:
    kinetic, breakaway = 0.01, 0.02
    plant = PlantParameters(PENDULUM, components=(Stiction((breakaway,), (kinetic,)),))
    found = flown(plant, np.array([0.8, 0.0, 0.0, 0.0]), np.zeros(4500))
    angle, rate = found[:, 0], found[:, 1]

    def swing(begin: float) -> float:
        """Return the turning angle of a swing from rest at `begin`, by the energy lost to friction."""
        side = np.sign(begin)
        ends = np.linspace(begin, -begin, 400_001)
        left = WEIGHT * (np.cos(ends) - np.cos(begin)) - kinetic * np.abs(begin - ends)
        k = 1 + int(np.argmax(left[1:] < 0))
        assert side * (ends[k] - begin) < 0
        return float(ends[k])

    turns, at = [], 0.8
    while WEIGHT * abs(np.sin(at)) > breakaway:
        at = swing(at)
        turns.append(at)
    seen = [float(angle[k]) for k in range(1, len(rate)) if rate[k] * rate[k - 1] < 0 or (rate[k] == 0 != rate[k - 1])]
    assert seen == pytest.approx(turns, abs=1e-4)
    assert abs(np.sin(angle[-1])) * WEIGHT < breakaway
    # At rest exactly and permanently.
    assert np.count_nonzero(rate[-1000:]) == 0
    assert len(set(angle[-1000:].tolist())) == 1


@pytest.mark.parametrize(("share", "moves"), [(0.99, False), (1.01, True)])
def test_a_joint_at_rest_breaks_away_just_beyond_its_torque(share: float, moves: bool) -> None:
    breakaway = 0.01
    plant = PlantParameters(PENDULUM, components=(Stiction((breakaway,), (0.5 * breakaway,)),))
    found = flown(plant, np.zeros(4), np.full(20, share * breakaway / COUPLING))
    assert bool(found[-1, 0]) is moves


def test_two_joints_stick_in_turn_and_form_one_arm_while_the_outer_sticks() -> None:
    plant = PlantParameters(LAB.frictionless(), components=(Stiction((1e-4, 1.0), (1e-5, 1.0)),))
    found = flown(plant, np.array([0.5, 0.5, 0.0, 0.0, 0.0, 0.0]), np.zeros(250))
    assert np.array_equal(found[:, 2], found[:, 3])
    assert found[:, 1] == pytest.approx(found[:, 0], abs=1e-12)
    # As one rigid body, inertias and weights add up.
    base = LAB.frictionless().base()
    inertia, weight = base[0] + 2 * base[1] + base[2], base[3] + base[4]

    def slope(time: float, y: np.ndarray) -> list[float]:
        return [y[1], (-weight * np.sin(y[0]) - 1e-5 * np.sign(y[1])) / inertia]

    expected = solve_ivp(slope, (0, 0.25), [0.5, -1e-12], method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    assert found[250, [0, 2]] == pytest.approx(expected, abs=1e-7)


def test_friction_never_adds_energy() -> None:
    plant = PlantParameters(LAB.frictionless(), components=(Stiction((3e-3, 1e-3), (2e-3, 8e-4)),))
    found = flown(plant, np.array([2.5, -1.0, 1.0, -4.0, 0.0, 0.0]), np.zeros(2000))
    m11, m12, m22, g1, g2 = LAB.base()[:5]
    a, b, p, q = found[:, :4].T
    energy = m11 * p**2 / 2 + m22 * q**2 / 2 + m12 * np.cos(a - b) * p * q - g1 * np.cos(a) - g2 * np.cos(b)
    assert np.diff(energy).max() < 1e-10
    assert energy[0] - energy[-1] > 0.03


ALL = (
    Belt(25.0, 0.05, motor_scale=True), EncoderPlay((0.01, 0.02), (0.001, -0.002)), Cable(0.01, 0.02),
    Stiction((4e-3, 2e-3), (3e-3, 1e-3)),
)  # fmt: skip


@pytest.mark.parametrize("components", [(), ALL[3:], ALL], ids=["none", "stiction", "all"])
def test_a_plant_moves_identically_alone_and_among_others(components: tuple[SymbolicPlant, ...]) -> None:
    plant = PlantParameters(LAB, lag=0.005, components=components)
    start, given = np.array([0.2, -0.1, 0.5, 1.0, 0.0, 0.0]), commands(300, 6.0)
    alone = flown(plant, start, given)
    assert np.array_equal(flown(plant, start, given, lanes=8)[:, :, 3], alone)
    assert np.isfinite(alone).all()
