"""The plant's levels and fixed step, compared with conservation laws and an adaptive integrator."""

from dataclasses import replace

import numpy as np
import pytest
from shadowing_stand_in import LAB

from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.dynamics.plant import PlantLevel, PlantParameters, after_blow, longest_step, plant_step
from dpcontrol.dynamics.propagator import PolynomialInputPropagator

ROUND_OFF = 1e-10  # 0.02 s at rates up to 50 rad/s; a stiff loop has 5e-11.
COULOMB = 1e-9  # If a joint's rate changes sign within the step.
EXACT = 1e-11
LEVELS = [
    PlantParameters(LAB),
    PlantParameters(LAB, lag=0.005, tilt=0.02),
    PlantParameters(LAB, lag=0.002, cart_mass=1.0, cart_viscous=3.0),
]
SLOW = np.array([1, 1, 0.02, 0.02, 1, 1])
DRY = PlantParameters(replace(LAB, coulomb=(1e-3, 2e-4), quadratic=(1e-5, 1e-6)))


def states(plant: PlantParameters, count: int) -> np.ndarray:
    size = plant.equations.dimension
    box = np.array([9, 9, 25, 25, 0.5, 2, 10])[:size]
    return np.random.default_rng(7).uniform(-1, 1, (count, size)) * box


def stepped(plant: PlantParameters, state: np.ndarray, u: float, duration: float, *, steps: int) -> np.ndarray:
    step = plant_step(plant.arms.count, plant.level, friction=plant.arms.friction)
    inputs, out = np.zeros(step.size_in), np.zeros(step.size_out)
    inputs[step.slices["parameters"]] = plant.numbers()
    inputs[step.slices["inputs"]], inputs[step.slices["duration"]] = u, duration / steps
    out[:] = state
    for _ in range(steps):
        inputs[step.slices["state"]] = out
        step(inputs, out)
    return out


def rate(plant: PlantParameters, state: np.ndarray, u: float) -> np.ndarray:
    return np.array(plant.equations.function()(state, u, plant.numbers())).ravel()


def worst(plant: PlantParameters, duration: float, *, steps: int, slow: bool = False) -> float:
    tight = PolynomialInputPropagator(plant.equations, plant.numbers(), degree=0)
    return max(
        float(np.abs(stepped(plant, s, 20.0, duration, steps=steps) - tight.flow(s, [20.0], duration)).max())
        for s in (states(plant, 400) * SLOW if slow else states(plant, 100))
    )


@pytest.mark.parametrize("plant", LEVELS, ids=lambda plant: plant.level.value)
@pytest.mark.parametrize("duration", [3e-4, 1e-3, 2e-3])
def test_the_fixed_step_agrees_with_taylor_series_to_round_off(plant: PlantParameters, duration: float) -> None:
    steps = max(int(np.ceil(duration / longest_step(plant))), 1)
    assert worst(plant, duration, steps=steps) < ROUND_OFF


@pytest.mark.slow
def test_longer_steps_fail_and_coulomb_friction_requires_shorter_ones() -> None:
    assert worst(LEVELS[0], 0.02, steps=1) > 1e-4
    assert worst(LEVELS[0], 0.02, steps=10) < ROUND_OFF
    # Slow arms reverse within the step.
    assert worst(DRY, 1e-3, steps=1, slow=True) > 100 * COULOMB
    assert worst(DRY, 1e-3, steps=round(1e-3 / longest_step(DRY)), slow=True) < COULOMB


def test_without_lag_mass_and_tilt_the_plant_is_the_cart_level() -> None:
    plant = PlantParameters(LAB)
    assert plant.level is PlantLevel.CART
    cart = arm_chain_equations(2, Level.CART).function()
    for s in states(plant, 20):
        assert rate(plant, s, 7.0) == pytest.approx(np.array(cart(s, 7.0, LAB.base())).ravel(), rel=1e-13, abs=1e-12)


def test_the_drive_level_is_the_exact_exponential() -> None:
    lag, u, a, v, t = 0.005, 12.0, -3.0, 0.4, 0.013
    begin = np.array([0.1, 0.2, 1.0, -1.0, 0.05, v, a])
    end = stepped(PlantParameters(LAB, lag=lag), begin, u, t, steps=26)
    fade = np.exp(-t / lag)
    assert end[6] == pytest.approx(u + (a - u) * fade, abs=EXACT)
    assert end[5] == pytest.approx(v + u * t + (a - u) * lag * (1 - fade), abs=EXACT)
    assert end[4] == pytest.approx(0.05 + v * t + u * t**2 / 2 + (a - u) * lag * (t - lag * (1 - fade)), abs=EXACT)


def test_force_changes_the_momentum_and_acts_on_the_arms_only_by_acceleration() -> None:
    plant = PlantParameters(LAB, lag=0.004, cart_mass=0.8, cart_viscous=2.0, tilt=0.1)
    first, second = LAB.mass
    s = np.array([first * LAB.centre_of_mass[0] + second * LAB.length[0], second * LAB.centre_of_mass[1]])
    mass, pull = 0.8 + first + second, LAB.gravity * np.sin(0.1)
    arms = PlantParameters(LAB, tilt=0.1)
    for x in states(plant, 20):
        f = rate(plant, x, 5.0)
        angles, rates = x[:2], x[2:4]
        momentum = mass * f[5] + s @ (np.cos(angles) * f[2:4] - np.sin(angles) * rates**2)
        assert momentum == pytest.approx(mass * x[6] - 2.0 * x[5] + mass * pull, rel=1e-10, abs=1e-9)
        assert f[:6] == pytest.approx(rate(arms, x[:6], f[5]), rel=1e-10, abs=1e-8)
        assert f[6] == pytest.approx((5.0 - f[5]) / 0.004, rel=1e-12, abs=1e-9)


def test_a_tilted_pendulum_is_a_rotated_level_one() -> None:
    tilt = 0.07
    begin = np.array([0.4, 2.8, 6.0, -9.0, 0.1, 0.0])
    turn = np.array([tilt, tilt, 0, 0, 0, 0])
    askew = stepped(PlantParameters(LAB, tilt=tilt), begin + turn, 0.0, 0.1, steps=100) - turn
    assert askew == pytest.approx(stepped(PlantParameters(LAB), begin, 0.0, 0.1, steps=100), abs=1e-10)
    sliding = PlantParameters(LAB, lag=0.01, cart_mass=1.0, tilt=tilt)
    f = rate(sliding, np.zeros(7), 0.0)
    assert f[5] == pytest.approx(LAB.gravity * np.sin(tilt), rel=1e-12)
    assert f[2:4] == pytest.approx([0, 0], abs=1e-12)


def test_a_knock_equals_a_short_large_acceleration() -> None:
    begin = np.array([0.4, 2.8, 6.0, -9.0, 0.1, -0.3])
    plant, moment = PlantParameters(LAB), 1e-9
    after = after_blow(plant, begin, knock=0.5)
    assert after == pytest.approx(stepped(plant, begin, 0.5 / moment, moment, steps=1), abs=1e-6)
    assert after[5] - begin[5] == pytest.approx(0.5, abs=1e-15)
    lagging = after_blow(PlantParameters(LAB, lag=0.01), np.append(begin, 1.0), knock=0.5)
    # The loop's velocity reference v + lag · a is unchanged, so the drive compensates the knock.
    assert lagging[5] + 0.01 * lagging[6] == pytest.approx(begin[5] + 0.01, abs=1e-14)


def test_a_couple_on_an_arm_changes_only_its_momentum_and_moves_a_free_cart() -> None:
    first, second = LAB.mass
    a, b, c, *_ = LAB.base()
    x = np.array([0.4, 2.8, 6.0, -9.0, 0.1, -0.3])
    cross = b * np.cos(x[0] - x[1])
    change = after_blow(PlantParameters(LAB), x, impulses=np.array([0.0, 0.01])) - x
    assert np.array([[a, cross], [cross, c]]) @ change[2:4] == pytest.approx([0.0, 0.01], abs=1e-15)
    assert change[[0, 1, 4, 5]] == pytest.approx(np.zeros(4), abs=0)
    s = np.array([first * LAB.centre_of_mass[0] + second * LAB.length[0], second * LAB.centre_of_mass[1]])
    free = PlantParameters(LAB, lag=0.01, cart_mass=0.5)
    start = np.append(x, 0.0)
    moved = after_blow(free, start, impulses=np.array([0.0, 0.01])) - start
    assert abs(moved[5]) > 1e-3
    assert (0.5 + first + second) * moved[5] + s @ (np.cos(x[:2]) * moved[2:4]) == pytest.approx(0.0, abs=1e-14)
