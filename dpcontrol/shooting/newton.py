"""Multiple shooting with free segment lengths.

Newton's method turns a guess into an orbit with an error estimate.

An orbit consists of nodes x_0 … x_K and durations τ_0 … τ_{K-1}. Its equations give residuals and a sparse Jacobian:

    Φ(x_k, τ_k) - x_{k+1} + ε ∇H(x_{k+1}) [k a joint] = 0,      n_k·(x_k - r_k) = 0 at the inner nodes.

Marked nodes stay on a named section with normal n_k. At all other nodes n_k is the direction of the flow. A node
therefore never slides along its orbit, and each segment corrects its own flight time.

Open orbits start at x_0 = γ(φ₀) + a₀ v(φ₀) and end at an x_K of the same form, with fixed phases and free amplitudes.
Closed orbits satisfy x_K = x_0 + whole turns and H(x_0) = h. Conservation of energy makes one equation redundant. The
unknown ε makes the system square and vanishes at the solution (Muñoz-Almaraz et al., Continuation of periodic orbits
in conservative and Hamiltonian systems, 2003).

Short segments limit the growth of rounding errors. The gap at a node stays near 1e-14, but single shooting from a
distance δ reaches only 1e-15/δ.

*Newton's method.* The natural monotonicity test, which does not depend on the scaling of the equations, damps the
steps. A step passes if the simplified step from its end (same Jacobian) is shorter. The length of a step is its largest
scaled component. Let ω be the affine-invariant Lipschitz constant and Δx the last Newton step. If h = ω ‖Δx‖ < 1/2, a
solution lies within (1 - √(1 - 2h))/ω. Here one step in double precision gives ω, so the result is an estimate and no
proof.

A periodic orbit that shadows a walk of eight symbols has λ ≈ 1e100. In double precision its monodromy matrix contains
λ_u only. The matrices of the segments are small, so products of vectors with them preserve the logarithms.

Source: Deuflhard, Newton Methods for Nonlinear Problems (2011), section 3.3, algorithm NLEQ-ERR, and theorem 2.3
(Newton–Kantorovich in affine-covariant form).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import ShootingCause
from dpcontrol.foundation.shown import Brief
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.orbits.manifold import OrbitCurve, UnstableManifold
from dpcontrol.words.searches import Concluded


@dataclass(frozen=True)
class ManifoldEnd(Brief):
    """A point γ(φ) + a v(φ) on a local manifold: the periodic orbit's state and unstable vector at a phase (`Frame`).

    It is lifted by whole turns.

    Attributes:
        stable: True if the manifold is the time-reversed unstable one. Phase and amplitude are then those of the
            reversed point and grow backward in time.
        phase: φ, 1 for a period.
        amplitude: a, signed by the branch.
        turns (N,): whole turns added to the coordinates.
    """

    manifold: UnstableManifold
    stable: bool
    phase: float
    amplitude: float
    turns: tuple[float, ...]

    @property
    def orbit_phase(self) -> float:
        """The phase of the point of the periodic orbit that this end follows, 1 for a period; not reduced to [0, 1)."""
        if not self.stable:
            return self.phase
        orbit = self.manifold.orbit
        reversed_start = orbit.reverser @ (orbit.state - orbit.centre) + orbit.centre
        # A reverser maps the start of the orbit to itself or to the point half a period later.
        fixed = float(orbit.system.scaled_distance(reversed_start, orbit.state)) < 1e-9
        return (0.0 if fixed else 0.5) - self.phase

    def _periods(self, seconds: Any) -> Any:
        """Return the change of the manifold's phase over a time, s, in periods; negative on a stable manifold."""
        return seconds / self.manifold.orbit.period * (-1.0 if self.stable else 1.0)

    def point(self) -> tuple[Array, Array]:
        """Return the state (N,) of the end and its derivative (N,) by the amplitude, an unknown of the equations."""
        vector = self.manifold.frame(np.array([self.phase])).vectors[0]
        return self.states(np.zeros(1))[0], self.manifold.orbit.reverser @ vector if self.stable else vector

    def moved(self, seconds: float) -> "ManifoldEnd":
        """Return the end moved along the flow by a time: another phase and amplitude of the same trajectory.

        Args:
            seconds: time, s; backward if negative.
        """
        periods = self._periods(seconds)
        amplitude = self.amplitude * float(np.exp(self.manifold.exponent * periods))
        return replace(self, phase=self.phase + periods, amplitude=amplitude)

    def states(self, seconds: Array) -> Array:
        """Return states (K, N) of the trajectory through the end, which follow from the linearised flow.

        Args:
            seconds: times (K,) from the end, s.
        """
        periods, orbit = self._periods(np.asarray(seconds)), self.manifold.orbit
        frame = self.manifold.frame(self.phase + periods)
        amplitudes = self.amplitude * np.exp(self.manifold.exponent * periods)
        states = frame.states + amplitudes[:, None] * frame.vectors
        if self.stable:
            states = (states - orbit.centre) @ orbit.reverser.T + orbit.centre
        return states + np.asarray(self.turns) * orbit.system.turn_lengths


@dataclass(frozen=True)
class ShootingOrbit(Brief, Concluded):
    """An orbit as nodes that are connected by the flow.

    Attributes:
        times (K + 1,): times of the nodes, s.
        states (K + 1, N): states of the nodes on one lift.
        ends: both ends of an open orbit on its local manifolds, None for a closed orbit.
        turn (N,): difference of last and first node of a closed orbit, None for an open orbit.
        residual: largest gap at a node (rad, rad/s).
    """

    system: System
    times: Array
    states: Array
    ends: tuple[ManifoldEnd, ManifoldEnd] | None
    turn: Array | None
    residual: float
    iterations: int
    cause: ShootingCause

    @property
    def converged(self) -> bool:
        """True if the largest gap is within the tolerance and the orbit has the ends of its guess."""
        return self.cause is ShootingCause.CONVERGED

    @property
    def closed(self) -> bool:
        """True if the orbit is periodic, apart from whole turns of its angles."""
        return self.turn is not None

    @property
    def start(self) -> ManifoldEnd:
        """The first node of an open orbit, on the local unstable manifold of the first periodic orbit."""
        assert self.ends is not None
        return self.ends[0]

    @property
    def end(self) -> ManifoldEnd:
        """The last node of an open orbit, on the local stable manifold of the last periodic orbit."""
        assert self.ends is not None
        return self.ends[1]

    @property
    def duration(self) -> float:
        """Time from the first node to the last, s; the period of a closed orbit."""
        return float(self.times[-1] - self.times[0])

    def sample(self, times: Array) -> Array:
        """Return states (…, N) at any times.

        Each is propagated from the node before it.

        Beyond its nodes an open orbit continues on the local manifolds, and a closed orbit repeats.

        Args:
            times: times (…), s.
        """
        times = np.asarray(times, dtype=float)
        rounds = np.zeros_like(times)
        if self.turn is not None:
            rounds = np.floor((times - self.times[0]) / self.duration)
        distinct_times, indices = np.unique(times - rounds * self.duration, return_inverse=True)
        distinct_states = np.empty((len(distinct_times), self.system.dimension))
        outside = np.zeros(len(distinct_times), dtype=bool)
        if self.ends is not None:
            earlier, later_times = distinct_times < self.times[0], distinct_times > self.times[-1]
            outside = earlier | later_times
            for chosen, end, time in zip((earlier, later_times), self.ends, self.times[[0, -1]], strict=True):
                if chosen.any():
                    distinct_states[chosen] = end.states(distinct_times[chosen] - time)
        segment = np.clip(np.searchsorted(self.times, distinct_times, side="right") - 1, 0, len(self.times) - 2)
        for k in np.unique(segment[~outside]):
            chosen = np.flatnonzero((segment == k) & ~outside)
            distinct_states[chosen] = self.system.propagator.sample(
                self.states[k], distinct_times[chosen] - self.times[k]
            )
        states = distinct_states[np.reshape(indices, times.shape)]
        return states if self.turn is None else states + rounds[..., None] * self.turn


@dataclass(frozen=True)
class Guess(Brief):
    """Nodes, durations and conditions from which Newton's method starts.

    Attributes:
        states (K + 1, N): states of the nodes.
        durations (K,): durations of the segments, s.
        owners (K + 1,): index of each node's symbol, for messages.
        markers: node -> (normal (N,), value) of the section on which it stays, normal · x = value.
        energy: energy of a closed orbit, in the system's unit.
        joints: segments whose gaps contain the unknown ε, which lets the energy jump at their ends; the first one if
            empty.
        ends: both ends on the manifolds, None for a closed orbit.
        turn (N,): difference of last and first node of a closed orbit.
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
        """True if the orbit must be periodic."""
        return self.ends is None


@dataclass(frozen=True)
class Unknowns(Brief):
    """The unknowns of Newton's method.

    States (K + 1, N), durations (K,) s, amplitudes (2,) on the manifolds of both ends, or (0,) for a closed orbit, and
    ε (`unfolding`), the factor of an energy gradient that is added to the gaps of some segments, because the equations
    of a flow that conserves energy are redundant.
    """

    states: Array
    durations: Array
    amplitudes: Array
    unfolding: Any


class ShootingEquations:
    """The equations of one guess with their sparsity; unknowns are scaled.

    The points on both manifold ends are base + amplitude · slope. Subclasses may replace bases, slopes, the markers'
    levels, the turn, the energy and its function by values in another arithmetic. `numbers` converts doubles to it, and
    residuals and unknowns are then in that arithmetic.

    All attributes follow from the guess and are constant. n is the length N of a state and `count` the number K of
    segments. The unknowns in one row are the states of the inner nodes, from `first_node` on, up to `states_end`, the
    durations up to `durations_end`, both amplitudes of an open orbit, and ε. `columns` are their scales and `rows` the
    factors on the residuals. `unfolded` are the segments whose gaps contain ε.

    `starting` and `arriving` are the segments whose first or last node has columns of its own. `_row`, `_col` and
    `_scaling` are the place and the factor of each entry of the sparse matrix.
    """

    numbers: Callable[[Any], Any] = staticmethod(np.asarray)

    def __init__(self, guess: Guess) -> None:
        """Set the equations' constants, their unknowns' places and their scaling.

        Args:
            guess: nodes, durations and conditions.
        """
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
        # Columns: the states of all nodes except open ends, the durations, (a₀, a_K) if open, and ε.
        # A jump changes the energy by its square. ε absorbs the change at the joints, so each piece keeps its energy.
        self.unfolded = list(guess.joints) or [0]
        self.first_node, self.nodes = (0, count) if closed else (1, count - 1)
        self.inner = slice(self.first_node, self.first_node + self.nodes)
        self.states_end = n * self.nodes
        self.durations_end = self.states_end + count
        self.size = self.durations_end + (1 if closed else 3)
        scale = guess.system.scale
        # Amplitudes are scaled lengths. Scaled by themselves they would be conditioned 1e10 times worse.
        # ε multiplies an energy gradient, in rad/s per unit of energy.
        amplitudes, unit = [] if closed else [1.0, 1.0], guess.system.energy_scale
        lengths = np.full(count, np.abs(guess.durations).mean())
        self.columns = np.concatenate([np.tile(scale, self.nodes), lengths, amplitudes, [unit]])
        self.rows = np.concatenate([np.tile(1 / scale, count), np.ones(self.nodes), [1 / unit] if closed else []])
        self._places()

    def _places(self) -> None:
        """Set the rows and columns of the matrix's entries, in the order of `matrix`, and their scaling.

        A block is a part of the matrix by its row, column, height and width.
        """
        n, count, closed = self.n, self.count, self.guess.closed
        # Open ends have no columns. The last node of a closed orbit shares the columns of the first.
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
        places = [
            np.indices(shape).reshape(2, -1) + np.array([[first_row], [first_column]])
            for first_row, first_column, *shape in blocks
        ]
        self._row, self._col = np.hstack(places)
        self._scaling = self.rows[self._row] * self.columns[self._col]

    def normals(self, states: Array) -> Array:
        """Return the normals (nodes, N) of inner nodes' planes: of a section at marked nodes, else of the flow.

        Args:
            states: states (K + 1, N) of all nodes.
        """
        rates = self.system.numeric.rate(states[self.inner])
        normals = rates / self.system.scale**2
        normals /= np.sum(normals * rates, axis=1, keepdims=True)
        for node, (normal, _) in self.guess.markers.items():
            normals[node - self.first_node] = normal / np.linalg.norm(normal)
        return normals

    def matrix(self, states: Array, stms: Array, arrived: Array) -> Any:
        """Return the scaled Jacobian of the residuals as a sparse matrix of doubles.

        Args:
            states: states (K + 1, N) of the nodes.
            stms: state-transition matrices (K, N, N) of the segments.
            arrived: ends (K, N) of the segments.
        """
        from scipy.sparse import csc_array

        numeric = self.system.numeric
        minus_identity = np.tile(-np.eye(self.n).ravel(), len(self.arriving))
        values = [
            stms[self.starting].ravel(),
            minus_identity,
            numeric.rate(arrived).ravel(),
            self.normals(states).ravel(),
        ]
        if self.guess.closed:
            values.append(numeric.gradient(states[0]))
        else:
            values += [stms[0] @ np.asarray(self.slopes[0], dtype=float), -np.asarray(self.slopes[1], dtype=float)]
        values.append(numeric.gradient(states[1:][self.unfolded]).ravel())
        entries = np.concatenate(values) * self._scaling
        return csc_array((entries, (self._row, self._col)), shape=(self.size, self.size))

    def residuals(self, now: Unknowns, arrived: Array) -> Array:
        """Return the unscaled residuals: gaps, distances from marked sections, and the energy error of a closed orbit.

        Args:
            now: unknowns.
            arrived: ends (K, N) of the segments.
        """
        numbers, gaps = self.numbers, arrived - now.states[1:]
        gradients = self.system.numeric.gradient(now.states[1:][self.unfolded].astype(float))
        gaps[self.unfolded] = gaps[self.unfolded] + numbers(gradients) * now.unfolding
        distances = numbers(np.zeros(self.nodes))
        for node, level in self.levels.items():
            normal = self.guess.markers[node][0]
            distance = numbers(normal) @ now.states[node] - level
            distances[node - self.first_node] = distance / numbers(np.linalg.norm(normal))
        parts = [gaps.ravel(), distances]
        if self.guess.closed:
            parts.append(np.array([self.hamiltonian(now.states[0]) - self.energy]))
        return np.concatenate(parts)

    def moved(self, now: Unknowns, change: Array) -> Unknowns:
        """Return the unknowns after a change of all of them, such as a damped Newton step.

        Args:
            now: unknowns.
            change: changes of all unknowns in one row, not scaled.
        """
        states = now.states.copy()
        states[self.inner] = states[self.inner] + change[: self.states_end].reshape(-1, self.n)
        durations = now.durations + change[self.states_end : self.durations_end]
        amplitudes = now.amplitudes + change[self.durations_end : -1]
        return self.placed(Unknowns(states, durations, amplitudes, now.unfolding + change[-1]))

    def placed(self, unknowns: Unknowns) -> Unknowns:
        """Return the unknowns with end nodes that follow from amplitudes or closure.

        Args:
            unknowns: unknowns, whose end nodes are replaced in place.
        """
        states = unknowns.states
        if self.guess.closed:
            states[-1] = states[0] + self.turn
        else:
            for k, amplitude in zip((0, -1), unknowns.amplitudes, strict=True):
                states[k] = self.bases[k] + self.slopes[k] * amplitude
        return unknowns

    def sizes(self, step: Array) -> Array:
        """Return the largest scaled change (K,) of each node, by which steps are measured.

        The segment after a node belongs to it. ε is left out.

        Args:
            step: scaled changes of all unknowns in one row.
        """
        changes = np.abs(step[self.states_end : self.durations_end])
        changes[self.inner] = np.maximum(
            changes[self.inner], np.abs(step[: self.states_end]).reshape(-1, self.n).max(axis=1)
        )
        return changes


@dataclass(frozen=True)
class NewtonSettings:
    """Tolerance, damping and stopping rules of Newton's method.

    Attributes:
        tolerance: largest gap at a node (rad, rad/s).
        smallest_damping: least damping; below it the method stops.
        settled: scaled length of a step that changes only rounding.
        certain: scaled length up to which a step is not tested.
        stretched: largest ratio of a segment's length to its guess, in either direction.
        stalled: number of steps in a row that may fail to halve the gap.
    """

    iterations: int = 30
    tolerance: float = 1e-11
    smallest_damping: float = 1e-3
    settled: float = 1e-13
    certain: float = 1e-8
    stretched: float = 5.0
    stalled: int = 4


@dataclass(frozen=True)
class Shot(Brief):
    """The last orbit of Newton's method, with figures of its convergence.

    Attributes:
        orbit: the orbit, with time zero at the first marked node.
        correction: scaled length of the last Newton step.
        lipschitz: affine-invariant Lipschitz constant ω from the last long step, None if no step was long enough.
        condition: 1-norm condition number of the scaled Jacobian.
        stms (K, N, N): state-transition matrices of the segments.
        fault: index of the symbol with the largest last step.
    """

    guess: Guess
    orbit: ShootingOrbit
    correction: float
    lipschitz: float | None
    condition: float
    stms: Array
    fault: int

    @property
    def solution(self) -> Guess:
        """The guess with the nodes and ends of the solution."""
        orbit = self.orbit
        return replace(self.guess, states=orbit.states, durations=np.diff(orbit.times), ends=orbit.ends)


@dataclass(frozen=True)
class _Linear:
    """The equations linearised at some unknowns, with their Newton step.

    `factors`, `matrix`: the scaled Jacobian, factorised and as it is. `step`: scaled changes of all unknowns in one
    row; `length`: its largest entry. `fault`: index of the symbol with this entry. `residual`: largest gap at a node.
    `stms` (K, N, N): of the segments.
    """

    factors: Any
    matrix: Any
    step: Array
    length: float
    fault: int
    residual: float
    stms: Array


@dataclass(frozen=True)
class _Step:
    """An accepted step: its end, its damping and its simplified step.

    `simplified`: scaled Newton step from its end with the Jacobian of its begin, in one row. `lipschitz`: the Lipschitz
    constant ω (`Shot`), None if the step was too short to show it.
    """

    unknowns: Unknowns
    damping: float
    simplified: Array
    lipschitz: float | None


class _Lost(Exception):
    """Newton's method stopped; the argument is the cause, a `ShootingCause`."""


def solve_shooting(guess: Guess, settings: NewtonSettings | None = None) -> Shot:
    """Return the orbit to which damped Newton steps on all unknowns lead from a guess.

    Args:
        guess: nodes, durations and ends.
        settings: limits of Newton's method.
    """
    settings = settings or NewtonSettings()
    equations = ShootingEquations(guess)
    amplitudes = np.array([end.amplitude for end in guess.ends or ()])
    unknowns = equations.placed(Unknowns(guess.states.copy(), guess.durations.copy(), amplitudes, 0.0))
    linear: _Linear | None = None
    last_step: _Step | None = None
    lipschitz: float | None = None
    iteration, cause, lowest, fault, stalled = 0, ShootingCause.CONVERGED, np.inf, 0, 0
    try:
        for iteration in range(settings.iterations + 1):
            previous = linear
            linear = _linearised(equations, unknowns)
            fault = linear.fault
            accurate = linear.residual <= settings.tolerance
            stalled = 0 if linear.residual < lowest / 2 else stalled + 1
            # The end: an accurate orbit that no step improves, steps that only change rounding, or the last iteration.
            if (
                (accurate and (linear.length <= settings.settled or linear.residual > lowest / 4))
                or (stalled == settings.stalled and linear.length <= settings.certain)
                or iteration == settings.iterations
            ):
                break
            lowest = min(lowest, linear.residual)
            first = 1.0 if last_step is None or previous is None else _predicted(equations, previous, linear, last_step)
            try:
                last_step = _step(equations, unknowns, linear, first, settings)
            except _Lost:
                if not accurate:
                    raise
                # The orbit is accurate to rounding, so no step improves it.
                break
            # The first steps are far from the solution, and ω is needed near it.
            lipschitz = lipschitz if last_step.lipschitz is None else last_step.lipschitz
            unknowns = last_step.unknowns
    except _Lost as error:
        (cause,) = error.args
    except ArithmeticError:
        cause = ShootingCause.DIVERGED
    residual = np.inf if linear is None else linear.residual
    # During the iteration an amplitude may change its sign: it is so small that an error of the guess changes it, and
    # the next step changes it back.
    crossed = (
        float(amplitude) * end.amplitude <= 0
        for amplitude, end in zip(unknowns.amplitudes, guess.ends or (), strict=True)
    )
    if cause is ShootingCause.CONVERGED and any(crossed):
        cause = ShootingCause.OTHER_SIDE
    elif cause is ShootingCause.CONVERGED and not residual <= settings.tolerance:
        cause = ShootingCause.ROUNDING if residual < 1e-6 else ShootingCause.ITERATIONS
    ends = None
    if guess.ends is not None:
        first, last = (
            replace(guess_end, amplitude=float(amplitude))
            for guess_end, amplitude in zip(guess.ends, unknowns.amplitudes, strict=True)
        )
        ends = (first, last)
    times = np.concatenate([[0.0], np.cumsum(unknowns.durations)])
    times -= times[min(guess.markers, default=0)]
    return Shot(
        guess=guess,
        orbit=ShootingOrbit(guess.system, times, unknowns.states, ends, guess.turn, residual, iteration, cause),
        correction=np.inf if linear is None else linear.length,
        lipschitz=lipschitz,
        condition=_condition(linear) if cause is ShootingCause.CONVERGED and linear is not None else np.inf,
        stms=np.empty((0, 0, 0)) if linear is None else linear.stms,
        fault=fault,
    )


def _linearised(equations: ShootingEquations, now: Unknowns) -> _Linear:
    """Return the linearised equations at the unknowns `now`, after propagation of all segments with their matrices.

    Raises:
        _Lost: the Jacobian is singular.
    """
    from scipy.sparse.linalg import splu

    arrived, stms = equations.system.propagator.flows_with_stm(now.states[:-1], now.durations)
    right_side = equations.residuals(now, arrived) * equations.rows
    matrix = equations.matrix(now.states, stms, arrived)
    try:
        factors = splu(matrix)
    except RuntimeError:
        raise _Lost(ShootingCause.SINGULAR) from None
    step = factors.solve(-right_side)
    sizes = equations.sizes(step)
    residual = float(np.abs(arrived - now.states[1:]).max())
    fault = int(equations.guess.owners[int(np.argmax(sizes))])
    return _Linear(factors, matrix, step, float(sizes.max()), fault, residual, stms)


def _predicted(equations: ShootingEquations, before: _Linear, linear: _Linear, taken: _Step) -> float:
    """Return the damping of the next step that the last step's error predicts.

    `before`, `linear`: equations at the begin and the end of the step `taken`. The error is the difference of its
    simplified step from the present Newton step. Source: NLEQ-ERR, equation 3.48.
    """
    error, simplified_length = (
        float(equations.sizes(step).max()) for step in (taken.simplified - linear.step, taken.simplified)
    )
    if error == 0.0 or linear.length == 0.0:
        return 1.0
    return min(1.0, before.length * simplified_length / (error * linear.length) * taken.damping)


def _step(
    equations: ShootingEquations, now: Unknowns, linear: _Linear, damping: float, settings: NewtonSettings
) -> _Step:
    """Return the longest damped step that passes the natural monotonicity test.

    `now`, `linear`: unknowns and linearised equations. `damping`: first damping that is tried, up to 1.

    Raises:
        _Lost: no damping above the smallest one passes.
    """
    cause = ShootingCause.NO_STEP
    while damping >= settings.smallest_damping:
        trial = equations.moved(now, damping * linear.step * equations.columns)
        ratios = trial.durations / equations.guess.durations
        if ratios.min() < 1 / settings.stretched or ratios.max() > settings.stretched:
            cause = ShootingCause.STRETCHED
            damping /= 4
            continue
        try:
            ends = equations.system.propagator.flows(trial.states[:-1], trial.durations)
        except ArithmeticError:
            cause, damping = ShootingCause.DIVERGED, damping / 4
            continue
        cause = ShootingCause.NO_STEP
        simplified = linear.factors.solve(-(equations.residuals(trial, ends) * equations.rows))
        simplified_length, curvature_length = (
            float(equations.sizes(step).max()) for step in (simplified, simplified - (1 - damping) * linear.step)
        )
        length = damping * linear.length
        # Steps this short are good, but rounding errors could make the test reject them.
        if simplified_length <= (1 - damping / 4) * linear.length or length <= settings.certain:
            # Below 1e-7 rounding errors hide the curvature of the equations.
            return _Step(trial, damping, simplified, 2 * curvature_length / length**2 if length > 1e-7 else None)
        damping = min(damping / 2, damping * length / (2 * curvature_length))
    raise _Lost(cause)


def _condition(linear: _Linear, columns: int = 4, rounds: int = 5) -> float:
    """Return an estimate of the 1-norm condition number of the scaled Jacobian, for the error estimate.

    The norm of the inverse is a lower bound from `rounds` of products with `columns` vectors. This is Higham &
    Tisseur's block algorithm (SIAM J. Matrix Anal. Appl. 21, 2000). The one in scipy uses the global random generator,
    so its estimate of an orbit changes between calls.
    """
    solve, size = linear.factors.solve, len(linear.step)
    probes = np.random.default_rng(0).choice([-1.0, 1.0], (size, columns)) / size
    probes[:, 0] = 1.0 / size
    norm = 0.0
    for _ in range(rounds):
        images = solve(probes)
        larger_norm = float(np.abs(images).sum(axis=0).max())
        if larger_norm <= norm:
            break
        norm = larger_norm
        # A unit vector attains the norm. Try those along which the sum of magnitudes grows fastest.
        slopes = np.abs(solve(np.where(images < 0, -1.0, 1.0), "T")).max(axis=1)
        probes = np.zeros((size, columns))
        probes[np.argsort(-slopes, kind="stable")[:columns], np.arange(columns)] = 1.0
    return norm * float(np.max(abs(linear.matrix).sum(axis=0)))  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True)
class ClosedMultipliers(Brief):
    """Logarithms of |λ_u| and |λ_s|, computed independently, and the sign of both."""

    log_unstable: float
    log_stable: float
    sign: int

    @property
    def reciprocity(self) -> float:
        """|λ_u λ_s| - 1: zero in a Hamiltonian system."""
        return float(np.expm1(self.log_unstable + self.log_stable))


def closed_multipliers(stms: Array, scale: Array) -> ClosedMultipliers:
    """Return a closed orbit's unstable and stable multiplier as logarithms, since they can exceed all doubles.

    Power iteration runs forward for the unstable direction and backward for the stable one.

    Args:
        stms: state-transition matrices (K, N, N) of its segments.
        scale: scale (N,) of the states.
    """
    scaled = stms * scale / scale[:, None]
    forward, sign = _growth(scaled)
    backward, _ = _growth(np.asarray(np.linalg.inv(scaled)[::-1], dtype=float))
    return ClosedMultipliers(forward, -backward, sign)


def _growth(matrices: Array) -> tuple[float, int]:
    """Return the logarithm of a vector's growth in one round of matrices (K, N, N), and the sign of the multiplier."""
    # The start has components in every direction. The dominant one gains λ² a round.
    vector = np.cos(np.arange(matrices.shape[1]) + 1.0)
    previous, log_growth = vector, 0.0
    for _ in range(4):
        previous, log_growth = vector, 0.0
        for matrix in matrices:
            vector = matrix @ vector
            length = float(np.linalg.norm(vector))
            log_growth += float(np.log(length))
            vector = vector / length
    return log_growth, int(np.sign(vector @ previous))


@dataclass(frozen=True)
class ErrorEstimate(Brief):
    """The error estimate of an orbit; lengths are scaled.

    Attributes:
        condition: 1-norm condition number of the scaled Jacobian.
        kantorovich: Kantorovich's h, the product of the Lipschitz constant ω and the last Newton step (`Shot`); None if
            no step was long enough for ω.
        radius: Kantorovich's distance of the true orbit's nodes, None if h ≥ 1/2. It does not include rounding errors.
        energy_error: largest error over the nodes, in the energy's unit.
        departure: largest distance of a node from the guess.
        stops: distance of the nearest node from the periodic orbit, for each stop.
        multipliers: of a periodic orbit, else None.
    """

    condition: float
    kantorovich: float | None
    radius: float | None
    energy_error: float
    departure: float
    stops: tuple[float, ...]
    multipliers: ClosedMultipliers | None


def estimate_error(shot: Shot, stops: Sequence[LyapunovOrbit]) -> ErrorEstimate:
    """Return the error estimate of a converged shot: the distance of the true orbit, and figures that support it.

    Args:
        shot: solution with its guess.
        stops: the periodic orbits after its marked nodes.
    """
    guess, orbit = shot.guess, shot.orbit
    kantorovich = None if shot.lipschitz is None else shot.lipschitz * shot.correction
    # Without ω, and below rounding errors, the radius is that of the last step.
    radius: float | None = shot.correction
    if shot.lipschitz is not None and kantorovich is not None and kantorovich > 1e-8:
        radius = float((1 - np.sqrt(1 - 2 * kantorovich)) / shot.lipschitz) if kantorovich < 0.5 else None
    energies = guess.system.numeric.hamiltonian(orbit.states)
    return ErrorEstimate(
        condition=shot.condition,
        kantorovich=kantorovich,
        radius=radius,
        energy_error=float(np.max(np.abs(energies - guess.energy))),
        departure=float(np.max(np.abs(orbit.states - guess.states) / guess.system.scale)),
        stops=_stop_distances(shot, stops),
        multipliers=closed_multipliers(shot.stms, guess.system.scale) if guess.closed else None,
    )


def _stop_distances(shot: Shot, stops: Sequence[LyapunovOrbit]) -> tuple[float, ...]:
    """Return each stop's scaled distance of its periodic orbit from the nearest node, a figure of the error estimate.

    `stops`: the periodic orbits after the marked nodes. A stop's nodes are those from its mark to the next one.
    """
    states, nodes = shot.orbit.states, sorted(shot.guess.markers)
    curves: dict[str, OrbitCurve] = {}
    distances = []
    for first, last, orbit in zip(nodes, [*nodes[1:], len(states) - 1], stops, strict=False):
        curve = curves.setdefault(orbit.saddle, OrbitCurve(orbit))
        distances.append(float(curve.distances(states[first : last + 1])[1].min()))
    return tuple(distances)
