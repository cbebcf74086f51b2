"""An orbit that leaves one periodic orbit and joins another, solved by multiple shooting.

Nodes x_0 … x_K at fixed times; x_0 = γ(φ₀) + a₀ v(φ₀) on the source's local unstable manifold, x_K on the target's
local stable manifold, phases and amplitudes free; one inner node stays on a section, which sets the origin of time
(fixing a₀ instead would leave a direction that is null but for a₀):

    Φ(x_k, t_{k+1} - t_k) - x_{k+1} + ε ∇H(x_{k+1}) [k = 0] = 0,      n·x_m = const.

Energy is the same at both ends, so one equation is redundant; the unfolding parameter ε makes the system square and
vanishes at the solution (Muñoz-Almaraz et al., Continuation of periodic orbits in conservative and Hamiltonian
systems, 2003). Short segments keep rounding from growing: the gap at a node stays near 1e-14 where single shooting
from a distance δ is limited to 1e-15/δ.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from dpcontrol.dynamics.system import System
from dpcontrol.orbits.manifold import UnstableManifold

Array = NDArray[np.float64]
IntArray = NDArray[np.intp]


@dataclass(frozen=True)
class ManifoldEnd:
    """A point γ(φ) + a v(φ) on a local manifold, lifted by whole turns.

    stable: the manifold is the unstable one turned around in time; then phase and amplitude are those of the
    turned-around point, and grow backward in time. turns (N,): whole turns added to the coordinates.
    """

    manifold: UnstableManifold
    stable: bool
    phase: float
    amplitude: float
    turns: tuple[float, ...]

    @property
    def orbit_phase(self) -> float:
        """The phase at which the periodic orbit runs in step with this point: its asymptotic phase."""
        if not self.stable:
            return self.phase
        orbit = self.manifold.orbit
        turned = orbit.reverser @ (orbit.state - orbit.centre) + orbit.centre
        # A reverser runs the orbit backward from its own start, or from half a period on.
        fixed = float(orbit.system.scaled_distance(turned, orbit.state)) < 1e-9
        return (0.0 if fixed else 0.5) - self.phase

    def point(self) -> tuple[Array, Array, Array]:
        """Return the state (N,) and its derivatives by phase (N,) and amplitude (N,)."""
        frame = self.manifold.frame(np.array([self.phase]))
        state = frame.states[0] + self.amplitude * frame.vectors[0]
        by_phase = frame.state_slopes[0] + self.amplitude * frame.vector_slopes[0]
        by_amplitude = frame.vectors[0]
        orbit = self.manifold.orbit
        system = orbit.system
        if self.stable:
            reverser = orbit.reverser
            state = reverser @ (state - orbit.centre) + orbit.centre
            by_phase, by_amplitude = reverser @ by_phase, reverser @ by_amplitude
        return state + np.asarray(self.turns) * system.turn_lengths, by_phase, by_amplitude

    def moved(self, seconds: float) -> "ManifoldEnd":
        """Return the end after the flow has carried it on by `seconds` (negative: back)."""
        periods = seconds / self.manifold.orbit.period * (-1.0 if self.stable else 1.0)
        return replace(
            self,
            phase=self.phase + periods,
            amplitude=self.amplitude * float(np.exp(self.manifold.exponent * periods)),
        )

    def states(self, seconds: Array) -> Array:
        """Return states (K, N) on the manifold at times (K,) s from the end, by the linear flow on it."""
        periods = np.asarray(seconds) / self.manifold.orbit.period * (-1.0 if self.stable else 1.0)
        frame = self.manifold.frame(self.phase + periods)
        amplitudes = self.amplitude * np.exp(self.manifold.exponent * periods)
        states = frame.states + amplitudes[:, None] * frame.vectors
        orbit = self.manifold.orbit
        system = orbit.system
        if self.stable:
            states = (states - orbit.centre) @ orbit.reverser.T + orbit.centre
        return states + np.asarray(self.turns) * system.turn_lengths


@dataclass(frozen=True)
class Anchor:
    """An inner node that stays where normal · x = height: sets the origin of time."""

    node: int
    normal: tuple[float, ...]
    height: float


@dataclass(frozen=True)
class ShootingSettings:
    """When to stop: residual is the largest gap at a node (rad, rad/s)."""

    iterations: int = 12
    tolerance: float = 1e-11
    diverged: float = 1e3


@dataclass(frozen=True)
class ConnectingOrbit:
    """Nodes of an orbit between two local manifolds.

    times (K + 1,) s; states (K + 1, N) on one lift; residual: largest gap at a node; unfolding: ε, zero but for
    rounding.
    """

    system: System
    start: ManifoldEnd
    end: ManifoldEnd
    times: Array
    states: Array
    residual: float
    unfolding: float
    iterations: int
    converged: bool
    status: str

    @property
    def duration(self) -> float:
        """Seconds from the first node to the last."""
        return float(self.times[-1] - self.times[0])

    def sample(self, times: Array) -> Array:
        """Return states (M, N) at times (M,) s, each flown from the node before it.

        Outside the nodes' times the local manifolds continue the orbit.
        """
        wanted, inverse = np.unique(np.asarray(times, dtype=float), return_inverse=True)
        out = np.empty((len(wanted), self.system.dimension))
        before, after = wanted < self.times[0], wanted > self.times[-1]
        if before.any():
            out[before] = self.start.states(wanted[before] - self.times[0])
        if after.any():
            out[after] = self.end.states(wanted[after] - self.times[-1])
        segment = np.clip(np.searchsorted(self.times, wanted, side="right") - 1, 0, len(self.times) - 2)
        for k in np.unique(segment[~(before | after)]):
            where = np.flatnonzero((segment == k) & ~(before | after))
            out[where] = self.system.propagator.sample(self.states[k], wanted[where] - self.times[k])
        return out[np.ravel(inverse)]


def solve_connecting_orbit(
    system: System,
    start: ManifoldEnd,
    end: ManifoldEnd,
    times: Array,
    states: Array,
    *,
    anchor: Anchor,
    settings: ShootingSettings | None = None,
) -> ConnectingOrbit:
    """Refine guessed nodes (K + 1, N) at `times` (K + 1,) into an orbit from `start` to `end` by Newton's method.

    Raises:
        ValueError: the anchor is not an inner node.
    """
    if not 0 < anchor.node < len(times) - 1:
        raise ValueError(f"anchor at node {anchor.node}: must be one of the inner nodes 1 to {len(times) - 2}")
    settings = settings or ShootingSettings()
    nodes, unfolding = np.array(states, dtype=float), 0.0
    durations = np.diff(times)
    best: tuple[float, Array, ManifoldEnd, ManifoldEnd, float] | None = None
    iteration = 0
    failure = ""
    for iteration in range(settings.iterations + 1):
        (nodes[0], *start_slopes), (nodes[-1], *end_slopes) = start.point(), end.point()
        try:
            flown, stms = system.segments.flows_with_stm(nodes[:-1], durations)
        except ArithmeticError as error:
            failure = str(error)
            break
        gradient = system.numeric.gradient(nodes[1])
        gaps = flown - nodes[1:]
        gaps[0] += unfolding * gradient
        off = float(np.dot(anchor.normal, nodes[anchor.node]) - anchor.height)
        residual = max(float(np.abs(gaps).max()), abs(off))
        if best is None or residual < best[0]:
            best = (residual, nodes.copy(), start, end, unfolding)
        elif best[0] < settings.tolerance:
            break
        if not np.isfinite(residual) or residual > settings.diverged:
            failure = f"the gap between segments grew to {residual:.1e}"
            break
        if iteration == settings.iterations:
            break
        matrix = shooting_matrix(stms, start_slopes, end_slopes, gradient, anchor)
        try:
            step = splu(matrix).solve(-np.append(gaps.ravel(), off))
        except RuntimeError:
            failure = "the linear system is singular: the tubes are tangent here"
            break
        n = system.dimension
        inner = len(nodes) - 2
        nodes[1:-1] += step[: inner * n].reshape(inner, n)
        *ends, by_energy = (float(value) for value in step[inner * n :])
        start = replace(start, phase=start.phase + ends[0], amplitude=start.amplitude + ends[1])
        end = replace(end, phase=end.phase + ends[2], amplitude=end.amplitude + ends[3])
        unfolding += by_energy
    assert best is not None
    residual, nodes, start, end, unfolding = best
    converged = residual <= settings.tolerance
    if converged:
        status = f"converged in {iteration} iterations to a gap of {residual:.1e}"
    else:
        status = f"not converged: gap {residual:.1e} after {iteration} iterations"
        status += f" ({failure})" if failure else "; use shorter segments or a nearer guess"
    return ConnectingOrbit(
        system, start, end, np.asarray(times, float), nodes, residual, unfolding, iteration, converged, status
    )


def shooting_matrix(
    stms: Array, start_slopes: list[Array], end_slopes: list[Array], gradient: Array, anchor: Anchor
) -> csc_array:
    """Return the Jacobian of gaps and anchor: inner nodes, then φ₀, a₀, φ_K, a_K, ε; square of size N·K + 1.

    stms (K, N, N): of the segments; slopes: derivatives (N,) of an end's state by its phase and amplitude.
    """
    count, n = len(stms), len(gradient)
    order, rows, starts = _pattern(count, n, anchor.node)
    values = [
        stms[1:].ravel(),
        np.full(n * (count - 1), -1.0),
        (stms[0] @ np.column_stack(start_slopes)).ravel(),
        gradient,
        -np.column_stack(end_slopes).ravel(),
        anchor.normal,
    ]
    return csc_array((np.concatenate(values)[order], rows, starts), shape=(n * count + 1, n * count + 1))


@lru_cache(maxsize=64)
def _pattern(count: int, n: int, anchored: int) -> tuple[IntArray, IntArray, IntArray]:
    """Return where entries of the Jacobian go: their order in CSC, row indices in that order, columns' starts."""
    last = n * (count - 1)
    inner, block = np.arange(count - 1), np.indices((n, n))
    each = np.arange(n)
    pair = np.indices((n, 2))
    parts = [
        ((n * (inner + 1))[:, None, None] + block[0], (n * inner)[:, None, None] + block[1]),
        (np.arange(last), np.arange(last)),
        (pair[0], last + pair[1]),
        (each, np.full(n, last + 4)),
        (last + pair[0], last + 2 + pair[1]),
        (np.full(n, n * count), n * (anchored - 1) + each),
    ]
    rows = np.concatenate([row.ravel() for row, _ in parts])
    columns = np.concatenate([column.ravel() for _, column in parts])
    order = np.lexsort((rows, columns))
    starts = np.searchsorted(columns[order], np.arange(last + 6))
    return order, rows[order], starts
