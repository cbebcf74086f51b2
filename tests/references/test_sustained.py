from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from quick_rate import quick_rate
from scipy.integrate import solve_ivp

from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.plans.model import load_model
from dpcontrol.references.sustained import PhaseSection, SectionMap, SustainedOrbit, sustained_orbit

ERROR_BETWEEN_NODES = 1e-9  # Required, scaled.
CLOSURE = 1e-9  # rad, rad/s, m: tolerance of the solver without scaling.
INPUT = 1e-7  # m/s²: inputs of neighbouring intervals differ by 1e-9 at their common node.
EFFORT = 0.02  # Relative; known efforts have two or three digits.
DIFFERENCE = 1e-6  # Step of central differences, with an error of 1e-6 at rates of tens of rad/s.
SLOPE = 2e-5  # Error of finite differences over half a period, relative to the largest entry.
MULTIPLIER = 1e-7  # Relative; machine precision amplified by a monodromy matrix with a norm of thousands.
LAB = load_model("lab")

Array = np.ndarray
Input = Callable[[float], float]


@cache
def sustained(saddle: str, energy: float, friction: float = 1.0) -> SustainedOrbit:
    orbit = lyapunov_orbit(LAB.system, saddle, energy=energy)
    return sustained_orbit(orbit, arms(friction))


def arms(friction: float) -> ArmChainParameters:
    return replace(LAB.arms, viscous=tuple(friction * k for k in LAB.arms.viscous))


def flow(orbit: SustainedOrbit, state: Array, begin: float, duration: float, pulse: Input = lambda _: 0.0) -> Array:
    """Integrate by DOP853 from time `begin` with the orbit's input and a pulse."""
    rate = quick_rate(orbit.equations)

    def right(t: float, x: Array) -> Array:
        u = float(orbit.input(begin + t)) + pulse(t)
        return np.array(rate(x, u, orbit.parameters)).ravel()

    done = solve_ivp(right, (0.0, duration), state, method="DOP853", rtol=1e-11, atol=1e-13, max_step=0.01)
    return done.y[:, -1]


def lateness(section: PhaseSection, states: Array) -> Array:
    """The time of states since the section, to first order, s."""
    return (states - section.state) @ section.normal


def returned(orbit: SustainedOrbit, here: SectionMap, state: Array, height: float = 0.0) -> Array:
    """Integrate from a section, with the clock reset there, to the crossing of the next one."""

    def push(time: float) -> float:
        return height * float(here.pulse(time))

    time = here.duration
    for _ in range(3):
        found = flow(orbit, state, here.start.time, time, push)
        # Newton's step, in which the delay along the orbit grows by one second per second.
        time -= float(lateness(here.end, found))
    return flow(orbit, state, here.start.time, time, push)


@pytest.mark.parametrize(
    ("saddle", "energy", "effort"), [("down-up", -0.07, 0.056), ("down-up", 0.2, 0.119), ("up-down", 0.2, 0.0095)]
)
def test_the_orbit_solves_the_equations_with_friction_and_closes_at_the_known_effort(
    saddle: str, energy: float, effort: float
) -> None:
    orbit = sustained(saddle, energy)
    assert orbit.converged, orbit.status
    assert orbit.residual <= ERROR_BETWEEN_NODES
    assert orbit.reference.rms_cart_acceleration == pytest.approx(effort, rel=EFFORT)
    start = orbit.state(0.0)
    assert start == pytest.approx(orbit.reference.state(orbit.period), abs=CLOSURE)
    assert float(LAB.system.numeric.hamiltonian(start[:4])) == pytest.approx(energy, abs=1e-10)
    # Independent integration over half a period; errors grow by two thousand in a whole period.
    half = flow(orbit, start, 0.0, orbit.period / 2)
    assert half == pytest.approx(orbit.state(orbit.period / 2), abs=1e-7)


def test_the_cart_is_centred_and_the_orbit_is_periodic() -> None:
    orbit = sustained("down-up", 0.2)
    times = np.arange(4000) / 4000 * orbit.period
    assert abs(orbit.state(times)[:, 4].mean()) < 1e-4 * orbit.reference.max_cart_position
    assert orbit.state(times + 3 * orbit.period) == pytest.approx(orbit.state(times), abs=1e-9)
    assert orbit.input(times - orbit.period) == pytest.approx(orbit.input(times), abs=INPUT)
    assert orbit.state(0.0)[0] == pytest.approx(0.0, abs=1e-12)


def test_the_input_compensates_friction_with_nearly_minimal_effort() -> None:
    orbit = sustained("down-up", 0.2)
    times = (np.arange(4000) + 0.5) / 4000 * orbit.period
    states, effort = orbit.state(times), orbit.input(times)
    taken = LAB.arms.viscous[0] * states[:, 2] ** 2 + LAB.arms.viscous[1] * (states[:, 3] - states[:, 2]) ** 2
    gains = -_coupling(states)
    assert np.mean(gains * effort) == pytest.approx(np.mean(taken), rel=1e-4)
    # By the Cauchy-Schwarz inequality, no input of this power is smaller. The orbit must also be closed.
    least = np.mean(taken) / np.sqrt(np.mean(gains**2))
    assert least <= orbit.reference.rms_cart_acceleration <= 1.2 * least


def _coupling(states: Array) -> Array:
    """Return Σ S_i cos θ_i ω_i: the pendulum's momentum along the track."""
    weights = LAB.arms.base()[5:7]
    return (weights * np.cos(states[:, :2]) * states[:, 2:4]).sum(1)


def test_without_friction_the_sustained_orbit_is_the_lyapunov_orbit() -> None:
    orbit = sustained("down-up", 0.2, 0.0)
    assert orbit.reference.max_cart_acceleration < 1e-9
    assert orbit.state(0.0)[:4] == pytest.approx(orbit.lyapunov.state, abs=1e-9)
    assert orbit.period == pytest.approx(orbit.lyapunov.period, rel=1e-11)
    largest = orbit.lyapunov.floquet_multipliers[0].real
    for values in (orbit.multipliers, orbit.section_multipliers(1), orbit.section_multipliers(5)):
        assert values[0].real == pytest.approx(largest, rel=MULTIPLIER)
        assert values[-1].real == pytest.approx(1 / largest, rel=MULTIPLIER)
        # A double multiplier has an error of the square root of the matrix error.
        assert values[1:-1] == pytest.approx(np.ones(len(values) - 2), abs=1e-4)


@pytest.mark.slow
def test_multipliers_agree_with_the_integration_of_a_period() -> None:
    orbit = sustained("down-up", -0.07)
    columns = []
    for k in range(6):
        step = DIFFERENCE * np.eye(6)[k]
        ends = [flow(orbit, orbit.state(0.0) + sign * step, 0.0, orbit.period) for sign in (1, -1)]
        columns.append((ends[0] - ends[1]) / (2 * DIFFERENCE))
    monodromy = np.column_stack(columns)
    matrix, _ = orbit.over(0.0, orbit.period)
    assert matrix == pytest.approx(monodromy, abs=SLOPE * np.abs(monodromy).max())
    values = orbit.multipliers
    assert values[0].real == pytest.approx(np.abs(np.linalg.eigvals(monodromy)).max(), rel=1e-5)
    # By Liouville's theorem, friction reduces volumes by its trace. The cart has no effect.
    trace = [np.trace(np.array(_jacobian(orbit, t))) for t in (np.arange(2000) + 0.5) / 2000 * orbit.period]
    assert np.prod(values).real == pytest.approx(np.exp(np.mean(trace) * orbit.period), rel=1e-6)
    assert np.sort(np.abs(values))[2:4] == pytest.approx([0.976, 1.0], abs=5e-3)


def _jacobian(orbit: SustainedOrbit, time: float) -> Array:
    return np.array(orbit._jacobians(orbit.state(time), orbit.input(time), orbit.parameters)[0])


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 7])
def test_section_maps_agree_with_finite_differences(which: int) -> None:
    orbit = sustained("down-up", 0.2)
    # The last of the eight sections is beyond the end of the period.
    here = orbit.section_maps(8)[which]
    start = here.start
    assert returned(orbit, here, start.state) == pytest.approx(here.end.state, abs=1e-7)
    for k in range(6):
        # Differences are projected onto the section, because the clock is reset there.
        step = DIFFERENCE * (start.projection @ np.eye(6)[k])
        ends = [returned(orbit, here, start.state + sign * step) for sign in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * DIFFERENCE)
        expected = here.matrix @ start.projection[:, k]
        assert slope == pytest.approx(expected, abs=SLOPE * np.abs(here.matrix).max())
    ends = [returned(orbit, here, start.state, sign * DIFFERENCE * 10) for sign in (1, -1)]
    slope = (ends[0] - ends[1]) / (20 * DIFFERENCE)
    assert slope == pytest.approx(here.response, abs=SLOPE * np.abs(here.response).max())


@pytest.mark.parametrize(("saddle", "energy"), [("down-up", -0.07), ("down-up", 0.2), ("up-down", 0.2)])
def test_section_multipliers_belong_to_the_saddle_the_energy_and_the_cart(saddle: str, energy: float) -> None:
    orbit = sustained(saddle, energy)
    values = orbit.section_multipliers(4)
    assert len(values) == 5
    largest = orbit.lyapunov.unstable_multiplier
    assert values[0].real == pytest.approx(largest, rel=0.05)
    assert values[-1].real == pytest.approx(1 / largest, rel=0.1)
    assert np.sort(np.abs(values[1:3])) == pytest.approx([1.0, 1.0], abs=1e-12)
    assert 0.96 < values[3].real < 0.999
    # The product of all maps has these multipliers, and zero for the direction normal to the section.
    product = np.eye(6)
    for here in orbit.section_maps(4):
        product = here.matrix @ product
    assert np.sort(np.abs(np.linalg.eigvals(product)))[1:] == pytest.approx(np.sort(np.abs(values)), rel=1e-6)
    assert np.sort(np.abs(np.linalg.eigvals(product)))[0] < 1e-10


@pytest.mark.parametrize(
    ("saddle", "energy", "friction"),
    [("down-up", -0.175429, 1.0), ("up-down", 0.1755, 1.0), ("down-up", 0.2, 5.0)],
)
def test_small_and_large_orbits_are_sustained_with_five_times_the_friction(
    saddle: str, energy: float, friction: float
) -> None:
    orbit = sustained(saddle, energy, friction)
    assert orbit.converged, orbit.status
    assert orbit.residual <= ERROR_BETWEEN_NODES
    assert 0 < orbit.departure < 0.02 * friction
    assert orbit.multipliers[0].real > 100


@pytest.mark.slow
def test_effort_grows_in_proportion_to_friction_and_to_small_amplitudes() -> None:
    one, five = (sustained("down-up", 0.2, f).reference.rms_cart_acceleration for f in (1.0, 5.0))
    assert five == pytest.approx(5 * one, rel=0.01)
    saddle = -0.1754297469
    near = [sustained("down-up", e).reference.rms_cart_acceleration / np.sqrt(e - saddle) for e in (-0.1753, -0.175429)]
    assert near[0] == pytest.approx(near[1], rel=0.01)
