"""Conservative orbits to track, stitched from published states: orbits tiled, connections flown both ways.

The states were computed independently of this project, in extended precision (lab parameters).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from dpcontrol.dynamics.chain import ArmChainParameters, Level, arm_chain_equations
from dpcontrol.dynamics.equations import NumericEquations
from dpcontrol.dynamics.propagator import Propagator

Array = NDArray[np.float64]
SCALE = np.array([np.pi, np.pi, 10.0, 10.0])
LAB = ArmChainParameters(
    mass=(0.0938439747983407, 0.137595970499412),
    centre_of_mass=(0.108565214610396, 0.116779018445656),
    length=(0.172719203817519, 0.2286),
    inertia=(0.00043752942975691, 0.00126882939257741),
    gravity=9.8085802336215,
    viscous=(0.000237142782693581, 1.00000019330558e-05),
)


@dataclass(frozen=True)
class Orbit:
    state: tuple[float, ...]
    period: float


DOWN_UP_LOW = Orbit((0.0, np.pi, 7.754101061370101, 4.417698392811411), 0.7523800284928803)
DOWN_UP_HIGH = Orbit((0.0, np.pi, 14.750916765681563, 8.846290550616802), 0.9445642569260552)
UP_DOWN_HIGH = Orbit((np.pi, 0.0, 1.2873939234889786, 4.869279571953793), 0.8137911933362946)
OUTER_TURN_LOW = (0.0, 2 * np.pi, -15.20304513878392, 19.103321157547335)
DOWN_UP_TO_UP_DOWN = (-0.4155636518095254, -0.4155636518095254, 19.89782414430897, -20.69737296130328)


@dataclass(frozen=True)
class StandIn:
    """A sampled orbit: `guess(times)` gives (K, 4); `final` is the period that ends it, (M, 4)."""

    guess: CubicHermiteSpline
    duration: float
    final: Array


def _orbit_samples(orbit: Orbit, flow: Propagator, step: float) -> tuple[Array, Array]:
    count = int(np.ceil(orbit.period / step))
    times = np.linspace(0.0, orbit.period, count + 1)[:-1]
    return times, flow.sample(orbit.state, times)


def _approach(path: Array, samples: Array) -> tuple[int, int, Array]:
    """Return the first approach of `path` to the orbit, as (path index, phase, shift)."""
    shifts = np.round((path[:, :2] - samples[:, :2].mean(0)) / (2 * np.pi)) * 2 * np.pi
    best = (np.inf, 0, 0, np.zeros(4))
    for i in range(0, len(path)):
        shift = np.concatenate([shifts[i], [0.0, 0.0]])
        distance = np.abs((samples + shift - path[i]) / SCALE).max(1)
        if distance.min() < best[0]:
            best = (distance.min(), i, int(distance.argmin()), shift)
        # After the first approach, rounding grows until the path departs.
        if best[0] < 1e-3 and distance.min() > 0.02:
            break
    assert best[0] < 2e-3
    return best[1:]


def stitched(section_state: tuple[float, ...], first: Orbit, last: Orbit, *, wraps: int = 2) -> StandIn:
    """Tile `first`, fly the connection through `section_state`, tile `last`; `wraps` periods at each end."""
    step = 0.001
    equations = arm_chain_equations(2, Level.CONSERVATIVE)
    numeric = NumericEquations(equations, LAB.base())
    flow = Propagator(equations, LAB.base())
    longest = 3.5 * max(first.period, last.period)
    times = np.arange(0.0, longest, step)
    forward = flow.sample(section_state, times)
    # Backward propagation equals forward propagation of the reversed state.
    reverse = np.array([1.0, 1.0, -1.0, -1.0])
    backward = flow.sample(np.asarray(section_state) * reverse, times) * reverse
    pieces: list[tuple[Array, Array]] = []
    first_times, first_samples = _orbit_samples(first, flow, step)
    last_times, last_samples = _orbit_samples(last, flow, step)
    i, phase, shift = _approach(backward, first_samples)
    start = -times[i] - wraps * first.period - 0.0
    for lap in range(-wraps - 1, 1):
        at = first_times - first_times[phase] + lap * first.period - times[i]
        keep = (at >= start - step) & (at < -times[i] - step / 2)
        pieces.append((at[keep], first_samples[keep] + shift))
    pieces.append((-times[1 : i + 1][::-1], backward[1 : i + 1][::-1]))
    i, phase, shift = _approach(forward, last_samples)
    pieces.append((times[: i + 1], forward[: i + 1]))
    end = times[i] + wraps * last.period
    for lap in range(wraps + 2):
        at = last_times - last_times[phase] + lap * last.period + times[i]
        keep = (at > times[i] + step / 2) & (at <= end + step)
        pieces.append((at[keep], last_samples[keep] + shift))
    at = np.concatenate([p[0] for p in pieces])
    states = np.concatenate([p[1] for p in pieces])
    order = np.argsort(at)
    at, states = at[order] - start, states[order]
    spline = CubicHermiteSpline(at, states, numeric.rate(states))
    return StandIn(spline, float(end - start), last_samples + shift)


def low_turn() -> StandIn:
    """The outer arm's turn at -0.07 J about Down-Up."""
    return stitched(OUTER_TURN_LOW, DOWN_UP_LOW, DOWN_UP_LOW)


def high_crossing() -> StandIn:
    """From Down-Up to Up-Down at 0.2 J."""
    return stitched(DOWN_UP_TO_UP_DOWN, DOWN_UP_HIGH, UP_DOWN_HIGH)


def orbit_stretch(duration: float) -> StandIn:
    """The Lyapunov orbit about Down-Up at -0.07 J for at most a period: a small problem for edge cases."""
    assert duration <= DOWN_UP_LOW.period
    equations = arm_chain_equations(2, Level.CONSERVATIVE)
    times = np.linspace(0.0, duration, 500)
    states = Propagator(equations, LAB.base()).sample(DOWN_UP_LOW.state, times)
    rates = NumericEquations(equations, LAB.base()).rate(states)
    return StandIn(CubicHermiteSpline(times, states, rates), duration, states)
