"""A connection known in double precision, refined in 113-bit arithmetic: 30 digits instead of 12.

The nodes x_0 … x_K of multiple shooting are those of the double search, with x_0 = γ(φ₀) + a₀ v(φ₀), γ in extended
precision, and x_K alike on the stable manifold. Gaps are evaluated in 113 bits; their Jacobian stays in double, so each
Newton step leaves about 1e-12 of the residual. The leads are lengthened until a < 1e-20, where what the local manifold
leaves out, a² ≈ 1e-40, and the double Floquet vector's share, a · 1e-12, are both far below what is asked.

Angles are lifted about the saddles, whose positions are π times whole numbers at full precision.
Source: Higham, Accuracy and Stability of Numerical Algorithms (2002), chapter 12 (refinement with extended residuals).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from dpcontrol.dynamics.extended import Exact, Extended, ExtendedPropagator, digits, extended, pi_times
from dpcontrol.tubes.connecting_orbit import Anchor, ManifoldEnd, shooting_matrix
from dpcontrol.tubes.connection import Connection
from dpcontrol.tubes.extended_orbit import ExtendedOrbit, RefinementSettings, distance, exact_position, refine_orbit
from dpcontrol.tubes.orbit_curve import OrbitCurve

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ExtendedConnection:
    """A connection in extended precision.

    state (N,) on the section; states (K + 1, N) and times (K + 1,) s of the nodes; residual: largest gap at a node,
    distance from the section or energy error; correction: how far the double state was off, largest component.
    """

    connection: Connection
    orbits: tuple[ExtendedOrbit, ExtendedOrbit]
    state: Extended
    times: Array
    states: Extended
    residual: Any
    correction: float
    iterations: int
    converged: bool
    status: str

    @property
    def digits(self) -> list[str]:
        """The state as decimal digits, one string for each component."""
        return digits(self.state)

    def free_flight(self, *, forward: bool, periods: int = 8, samples: int = 8) -> float:
        """Return how near free flight from the state comes to the target (or backward, source) orbit, scaled.

        One propagation, never restarted; looked at `samples` times a period for `periods` periods.
        """
        refined = self.orbits[1 if forward else 0]
        orbit = refined.orbit
        sign = 1.0 if forward else -1.0
        times = extended(sign * np.arange(1, periods * samples + 1) / samples) * refined.period
        states = refined.propagator.sample(self.state, times)
        phases, distances = OrbitCurve(orbit).distances(states.astype(float))
        near = np.argsort(distances)[:8]
        # The double curve is good to 1e-9: which of the nearest is nearest is settled in extended precision.
        return min(distance(refined, states[k], float(phases[k])) for k in near)


def refine_connection(
    connection: Connection,
    *,
    energy: Exact | None = None,
    parameters: Sequence[Exact] | None = None,
    settings: RefinementSettings | None = None,
) -> ExtendedConnection:
    """Refine a connection in 113-bit arithmetic.

    energy: exact, the double search's by default; parameters (p,): exact values of the equations' parameters, by
    default the doubles of the system as the binary numbers that they are. Rounding a parameter to double moves a
    connection by 1e-15 and limits how long free flight follows it to what double precision gives: where the numbers
    are decimals, give them as decimals or fractions.

    Raises:
        GoalMissed: a Lyapunov orbit could not be refined, or heyoka has no 113-bit reals.
    """
    settings = settings or RefinementSettings()
    system = connection.source.system
    propagator = ExtendedPropagator(system.equations, system.parameters if parameters is None else parameters)
    height = extended(np.array(connection.source.energy if energy is None else energy))[()]
    source = refine_orbit(connection.source, propagator, height, settings)
    same = connection.source is connection.target
    target = source if same else refine_orbit(connection.target, propagator, height, settings)
    times, nodes, ends = _lengthened(connection, settings)
    anchor = Anchor(int(np.argmin(np.abs(times))), connection.section.normal, 0.0)
    normal = extended(np.asarray(anchor.normal))
    level = _section_level(connection)
    states = extended(nodes)
    durations = extended(times[1:]) - extended(times[:-1])
    free = [extended(value)[()] for end in ends for value in (end.phase, end.amplitude)]
    best: tuple[Any, Extended] = (np.inf, states)
    unfolding = extended(0.0)[()]
    iteration = 0
    for iteration in range(settings.iterations + 1):
        now = [_moved_end(end, phase, a) for end, phase, a in zip(ends, free[::2], free[1::2], strict=True)]
        states[0] = _end_state(now[0], source, free[0], free[1])
        states[-1] = _end_state(now[1], target, free[2], free[3])
        flown = np.array([propagator.flow(x, h) for x, h in zip(states[:-1], durations, strict=True)])
        gaps = flown - states[1:]
        off = normal @ states[anchor.node] - level
        wrong = abs(propagator.energy(states[anchor.node]) - height)
        residual = max(np.abs(gaps).max(), abs(off), wrong)
        previous = best[0]
        if residual < previous:
            best = (residual, states.copy())
        if residual > settings.stalled * previous or iteration == settings.iterations:
            break
        doubles = states.astype(float)
        gradient = system.numeric.gradient(doubles[1])
        _, stms = system.segments.flows_with_stm(doubles[:-1], durations.astype(float))
        slopes = [end.point()[1:] for end in now]
        matrix = shooting_matrix(stms, list(slopes[0]), list(slopes[1]), gradient, anchor)
        gaps[0] = gaps[0] + unfolding * extended(gradient)
        size = residual if residual > 0 else extended(1.0)[()]
        right = np.append((gaps / size).astype(float).ravel(), float(off / size))
        step = extended(splu(matrix).solve(-right)) * size
        inner = (len(states) - 2) * system.dimension
        states[1:-1] = states[1:-1] + step[:inner].reshape(-1, system.dimension)
        free = [value + change for value, change in zip(free, step[inner:-1], strict=True)]
        unfolding = unfolding + step[-1]
    residual, states = best
    converged = bool(residual <= settings.tolerance)
    state = states[anchor.node]
    correction = float(np.abs(state - extended(connection.state)).max())
    status = f"refined in {iteration} iterations to a gap of {float(residual):.1e}; the double state was off by "
    status += f"{correction:.1e}"
    if not converged:
        status = (
            f"not refined: the gap stays at {float(residual):.1e} after {iteration} iterations; use double precision"
        )
    return ExtendedConnection(
        connection, (source, target), state, times, states, residual, correction, iteration, converged, status
    )


def _section_level(connection: Connection) -> Any:
    """Return the value of normal · x on the section at the connection's own lift, in extended precision."""
    section = connection.section
    level = extended(section.offset)
    if section.period is None:
        return level[()]
    turns = np.rint((np.dot(section.normal, connection.state) - section.offset) / section.period)
    return (level + pi_times(2.0 * turns) if np.isclose(section.period, 2 * np.pi, rtol=1e-15)
            else level + extended(turns) * extended(section.period))[()]  # fmt: skip


def _lengthened(connection: Connection, settings: RefinementSettings) -> tuple[Array, Array, list[ManifoldEnd]]:
    """Return times, nodes and ends of the double orbit, led farther out on both local manifolds."""
    rough = connection.orbit
    times, nodes, ends = [rough.times], [rough.states], []
    for end, sign in ((rough.start, -1.0), (rough.end, 1.0)):
        manifold = end.manifold
        length = abs(end.amplitude) * float(manifold.frame(np.array([end.phase])).lengths[0])
        periods = max(0.0, np.log(length / settings.amplitude) / manifold.exponent)
        count = int(np.ceil(periods * settings.segments))
        seconds = sign * np.arange(1, count + 1) / settings.segments * manifold.orbit.period
        led = end.states(seconds)
        here = rough.times[0 if sign < 0 else -1] + seconds
        if sign < 0:
            times.insert(0, here[::-1])
            nodes.insert(0, led[::-1])
        else:
            times.append(here)
            nodes.append(led)
        ends.append(end.moved(float(seconds[-1])) if count else end)
    return np.concatenate(times), np.vstack(nodes), ends


def _moved_end(end: ManifoldEnd, phase: Any, amplitude: Any) -> ManifoldEnd:
    return ManifoldEnd(end.manifold, end.stable, float(phase), float(amplitude), end.turns)


def _end_state(end: ManifoldEnd, refined: ExtendedOrbit, phase: Any, amplitude: Any) -> Extended:
    """Return γ(φ) + a v(φ) (N,), turned around for a stable manifold, lifted by the end's whole turns."""
    system = refined.orbit.system
    vector = end.manifold.frame(np.array([end.phase])).vectors[0]
    state = refined.at(phase) + extended(vector) * amplitude
    if end.stable:
        centre = exact_position(system, refined.orbit.centre)
        state = extended(system.reversers[0]) @ (state - centre) + centre
    return state + exact_position(system, np.asarray(end.turns) * system.turn_lengths)
