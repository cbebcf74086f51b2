"""Multiple shooting with free segment lengths: orbits as nodes, and their equations as residuals and a sparse Jacobian.

Nodes x_0 … x_K and durations τ_0 … τ_{K-1} satisfy

    Φ(x_k, τ_k) - x_{k+1} + ε ∇H(x_{k+1}) [k a joint] = 0,      n_k·(x_k - r_k) = 0 at the inner nodes.

Marked nodes stay on a named section (n_k its normal); at all others n_k is the flow's own direction, so that a node
never slides along its orbit and a wrong flight time is mended by its own segment instead of by all that follow.
Open: x_0 = γ(φ₀) + a₀ v(φ₀) and x_K alike, phases fixed, amplitudes free. Closed: x_K = x_0 + whole turns and
H(x_0) = h. Energy makes one equation redundant; ε makes the system square and vanishes at the solution
(Muñoz-Almaraz et al., Continuation of periodic orbits in conservative and Hamiltonian systems, 2003).

Short segments keep rounding from growing: the gap at a node stays near 1e-14 where single shooting from a distance δ
is limited to 1e-15/δ.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from dpcontrol.dynamics.system import System
from dpcontrol.orbits.manifold import UnstableManifold

Array = NDArray[np.float64]


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

    def _periods(self, seconds: Any) -> Any:
        """Return by how many periods the manifold's own phase grows in a time: a stable one runs backward."""
        return seconds / self.manifold.orbit.period * (-1.0 if self.stable else 1.0)

    def point(self) -> tuple[Array, Array]:
        """Return the state (N,) and its derivative by amplitude (N,)."""
        along = self.manifold.frame(np.array([self.phase])).vectors[0]
        return self.states(np.zeros(1))[0], self.manifold.orbit.reverser @ along if self.stable else along

    def moved(self, seconds: float) -> "ManifoldEnd":
        """Return the end after the flow has carried it on by `seconds` (negative: back)."""
        periods = self._periods(seconds)
        grown = self.amplitude * float(np.exp(self.manifold.exponent * periods))
        return replace(self, phase=self.phase + periods, amplitude=grown)

    def states(self, seconds: Array) -> Array:
        """Return states (K, N) on the manifold at times (K,) s from the end, by the linear flow on it."""
        periods, orbit = self._periods(np.asarray(seconds)), self.manifold.orbit
        frame = self.manifold.frame(self.phase + periods)
        amplitudes = self.amplitude * np.exp(self.manifold.exponent * periods)
        states = frame.states + amplitudes[:, None] * frame.vectors
        if self.stable:
            states = (states - orbit.centre) @ orbit.reverser.T + orbit.centre
        return states + np.asarray(self.turns) * orbit.system.turn_lengths


@dataclass(frozen=True)
class ShootingOrbit:
    """Nodes of an orbit, and between them the flow.

    times (K + 1,) s; states (K + 1, N) on one lift. ends: of an open orbit, on its local manifolds; turn (N,): of a
    closed one, what its last node adds to its first. residual: largest gap at a node (rad, rad/s).
    """

    system: System
    times: Array
    states: Array
    ends: tuple[ManifoldEnd, ManifoldEnd] | None
    turn: Array | None
    residual: float
    iterations: int
    converged: bool
    status: str

    @property
    def closed(self) -> bool:
        """Whether the orbit is periodic (but for whole turns of its angles)."""
        return self.turn is not None

    @property
    def start(self) -> ManifoldEnd:
        """The first node of an open orbit, on the local unstable manifold of the periodic orbit that it leaves."""
        assert self.ends is not None
        return self.ends[0]

    @property
    def end(self) -> ManifoldEnd:
        """The last node of an open orbit, on the local stable manifold of the periodic orbit that it joins."""
        assert self.ends is not None
        return self.ends[1]

    @property
    def duration(self) -> float:
        """Seconds from the first node to the last: of a closed orbit, its period."""
        return float(self.times[-1] - self.times[0])

    def sample(self, times: Array) -> Array:
        """Return states (M, N) at any times (M,) s, each flown from the node before it.

        Outside the nodes' times the local manifolds continue an open orbit, and a closed one goes round again.
        """
        asked = np.asarray(times, dtype=float)
        rounds = np.zeros_like(asked)
        if self.turn is not None:
            rounds = np.floor((asked - self.times[0]) / self.duration)
        wanted, inverse = np.unique(asked - rounds * self.duration, return_inverse=True)
        out = np.empty((len(wanted), self.system.dimension))
        outside = np.zeros(len(wanted), dtype=bool)
        if self.ends is not None:
            before, after = wanted < self.times[0], wanted > self.times[-1]
            outside = before | after
            for where, end, time in zip((before, after), self.ends, self.times[[0, -1]], strict=True):
                if where.any():
                    out[where] = end.states(wanted[where] - time)
        segment = np.clip(np.searchsorted(self.times, wanted, side="right") - 1, 0, len(self.times) - 2)
        for k in np.unique(segment[~outside]):
            where = np.flatnonzero((segment == k) & ~outside)
            out[where] = self.system.propagator.sample(self.states[k], wanted[where] - self.times[k])
        states = out[np.ravel(inverse)]
        return states if self.turn is None else states + rounds[:, None] * self.turn


@dataclass(frozen=True)
class Guess:
    """Where Newton's method starts.

    states (K + 1, N); durations (K,) s; owners (K + 1,): index of the symbol that a node belongs to, for naming who is
    at fault; markers: node -> (normal (N,), value) of the section on which it stays. ends: the two manifold ends, or
    None for a closed orbit, whose last node is its first plus `turn` (N,). energy in the system's unit.
    """

    system: System
    states: Array
    durations: Array
    owners: NDArray[np.intp]
    markers: dict[int, tuple[Array, float]]
    energy: float
    joints: tuple[int, ...] = ()
    ends: tuple[ManifoldEnd, ManifoldEnd] | None = None
    turn: Array | None = None

    @property
    def closed(self) -> bool:
        """Whether the orbit is to be periodic."""
        return self.ends is None


@dataclass(frozen=True)
class Unknowns:
    """A point of Newton's method: states (K + 1, N), durations (K,) s, amplitudes (2,) or (0,), and ε."""

    states: Array
    durations: Array
    amplitudes: Array
    unfolding: Any


class ShootingEquations:
    """The equations of one guess, their sparsity worked out once; unknowns are scaled.

    bases, slopes: of both manifold ends at their fixed phases, point = base + amplitude · slope. These, the markers'
    levels, the turn, the energy and its function may be replaced by ones in another arithmetic, which `numbers` turns
    doubles into: residuals and unknowns are then in that arithmetic.
    """

    numbers: Callable[[Any], Any] = staticmethod(np.asarray)

    def __init__(self, guess: Guess) -> None:
        self.guess, self.system = guess, guess.system
        points = [(end, *end.point()) for end in guess.ends or ()]
        self.slopes: list[Any] = [slope for *_, slope in points]
        self.bases: list[Any] = [state - end.amplitude * slope for end, state, slope in points]
        self.levels: dict[int, Any] = {node: level for node, (_, level) in guess.markers.items()}
        self.turn: Any = guess.turn
        self.energy: Any = guess.energy
        self.hamiltonian: Callable[[Any], Any] = guess.system.numeric.hamiltonian
        self.n, self.count = guess.system.dimension, len(guess.durations)
        n, count, closed = self.n, self.count, guess.closed
        # Columns: each node's state but for the open ends', then the durations, then (a₀, a_K) if open, then ε.
        # A jump leaves the energy by its square: where ε takes it up, the pieces between the jumps keep theirs.
        self.unfolded = list(guess.joints) or [0]
        self.first_node, self.nodes = (0, count) if closed else (1, count - 1)
        self.inner = slice(self.first_node, self.first_node + self.nodes)
        self.states_end = n * self.nodes
        self.durations_end = self.states_end + count
        self.size = self.durations_end + (1 if closed else 3)
        scale = guess.system.scale
        # Amplitudes stay in scaled length: relative to themselves they would be 1e10 times worse conditioned.
        # ε multiplies an energy gradient: rad/s per unit of energy.
        amplitudes, unit = [] if closed else [1.0, 1.0], guess.system.energy_scale
        lengths = np.full(count, np.abs(guess.durations).mean())
        self.columns = np.concatenate([np.tile(scale, self.nodes), lengths, amplitudes, [unit]])
        self.rows = np.concatenate([np.tile(1 / scale, count), np.ones(self.nodes), [1 / unit] if closed else []])
        self._places()

    def _places(self) -> None:
        """List the rows and columns of all entries, in the order in which `matrix` fills them."""
        n, count, closed = self.n, self.count, self.guess.closed
        # Open ends have no columns of their own; the last node of a closed orbit has its first one's.
        column = {node: n * k for k, node in enumerate(range(count + 1)[self.inner])} | ({count: 0} if closed else {})
        self.starting = [k for k in range(count) if k in column]
        self.arriving = [k for k in range(count) if k + 1 in column]
        ends = [(0, self.durations_end, n, 1), (n * (count - 1), self.durations_end + 1, n, 1)]
        blocks = [
            *((n * k, column[k], n, n) for k in self.starting),
            *((n * k, column[k + 1], n, n) for k in self.arriving),
            *((n * k, self.states_end + k, n, 1) for k in range(count)),
            *((n * count + j, n * j, 1, n) for j in range(self.nodes)),
            *([(self.size - 1, 0, 1, n)] if closed else ends),
            *((n * k, self.size - 1, n, 1) for k in self.unfolded),
        ]
        places = [np.indices(shape).reshape(2, -1) + np.array([[row], [left]]) for row, left, *shape in blocks]
        self._row, self._col = np.hstack(places)
        self._scaling = self.rows[self._row] * self.columns[self._col]

    def normals(self, states: Array) -> Array:
        """Return the rows (nodes, N) on which inner nodes stay: a section's where marked, else the flow's."""
        rates = self.system.numeric.rate(states[self.inner])
        normals = rates / self.system.scale**2
        normals /= np.sum(normals * rates, axis=1, keepdims=True)
        for node, (normal, _) in self.guess.markers.items():
            normals[node - self.first_node] = normal / np.linalg.norm(normal)
        return normals

    def matrix(self, states: Array, stms: Array, arrived: Array) -> csc_array:
        """Return the scaled Jacobian, from doubles in any arithmetic; arrived (K, N): where the segments end."""
        numeric = self.system.numeric
        minus = np.tile(-np.eye(self.n).ravel(), len(self.arriving))
        values = [stms[self.starting].ravel(), minus, numeric.rate(arrived).ravel(), self.normals(states).ravel()]
        if self.guess.closed:
            values.append(numeric.gradient(states[0]))
        else:
            values += [stms[0] @ np.asarray(self.slopes[0], dtype=float), -np.asarray(self.slopes[1], dtype=float)]
        values.append(numeric.gradient(states[1:][self.unfolded]).ravel())
        entries = np.concatenate(values) * self._scaling
        return csc_array((entries, (self._row, self._col)), shape=(self.size, self.size))

    def residuals(self, now: Unknowns, arrived: Array) -> Array:
        """Return gaps, distances from marked sections, and the energy's error if closed, not scaled."""
        numbers, gaps = self.numbers, arrived - now.states[1:]
        gradients = self.system.numeric.gradient(now.states[1:][self.unfolded].astype(float))
        gaps[self.unfolded] = gaps[self.unfolded] + numbers(gradients) * now.unfolding
        off = numbers(np.zeros(self.nodes))
        for node, level in self.levels.items():
            normal = self.guess.markers[node][0]
            distance = numbers(normal) @ now.states[node] - level
            off[node - self.first_node] = distance / numbers(np.linalg.norm(normal))
        parts = [gaps.ravel(), off]
        if self.guess.closed:
            parts.append(np.array([self.hamiltonian(now.states[0]) - self.energy]))
        return np.concatenate(parts)

    def moved(self, now: Unknowns, change: Array) -> Unknowns:
        """Return the unknowns after a change of all, not scaled."""
        states = now.states.copy()
        states[self.inner] = states[self.inner] + change[: self.states_end].reshape(-1, self.n)
        durations = now.durations + change[self.states_end : self.durations_end]
        amplitudes = now.amplitudes + change[self.durations_end : -1]
        return self.placed(Unknowns(states, durations, amplitudes, now.unfolding + change[-1]))

    def placed(self, unknowns: Unknowns) -> Unknowns:
        """Return the unknowns with the last node (and the first, if open) where amplitudes, or closure, put them."""
        states = unknowns.states
        if self.guess.closed:
            states[-1] = states[0] + self.turn
        else:
            for k, amplitude in zip((0, -1), unknowns.amplitudes, strict=True):
                states[k] = self.bases[k] + self.slopes[k] * amplitude
        return unknowns

    def sizes(self, step: Array) -> Array:
        """Return the largest scaled change (K,) of each node and of the segment that leaves it.

        ε does not belong to the orbit.
        """
        out = np.abs(step[self.states_end : self.durations_end])
        out[self.inner] = np.maximum(out[self.inner], np.abs(step[: self.states_end]).reshape(-1, self.n).max(axis=1))
        return out
