"""Periodic orbits given by nodes, with their local manifolds, and periodic orbits as smooth closed curves.

A hyperbolic orbit that belongs to no saddle's family is kept as nodes, and the unstable Floquet vector at each of them,
so that a local manifold is never integrated over more than one segment, whatever the multiplier is. The orbit may turn:
then γ(φ + 1) = γ(φ) + whole turns. A negative multiplier makes the manifold one-sided: v(φ + 1) = -v(φ), phases have
period two, and what are called its branches at φ are the same one at φ and φ + 1. A reverser R about a resting point
carries the orbit into itself, γ(-φ) = R γ(φ), so that the stable manifold is the unstable one turned around by R.

Sources: Kaheman et al. (2023), section 4; Meyer & Offin, Introduction to Hamiltonian Dynamical Systems and the N-Body
Problem, 3rd ed., chapter 8.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree

from dpcontrol.foundation.errors import InputError
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.orbits.manifold import Frame, UnstableManifold
from dpcontrol.orbits.rotating import RotatingOrbit

Array = NDArray[np.float64]

_ROUNDS = 200  # of the power iteration: enough for |λ| > 1.2
_SETTLED = 1e-15


@dataclass(frozen=True)
class HyperbolicOrbit(LyapunovOrbit):
    """A hyperbolic periodic orbit that belongs to no saddle's family; `saddle` is the vertex's name.

    mirror (N, N) and rest (N,): the reverser and the resting point about which γ(-φ) = R γ(φ); winding (N,): whole
    turns that a period adds to the coordinates. node_times (M + 1,) s from 0 to the period; node_states (M + 1, N), the
    last the first plus those turns.
    """

    mirror: Array
    rest: Array
    winding: Array
    node_times: Array
    node_states: Array

    @property
    def centre(self) -> Array:
        """State (N,) at rest about which the orbit is mirrored."""
        return self.rest

    @property
    def reverser(self) -> Array:
        """The reverser (N, N) that carries the orbit into itself."""
        return self.mirror

    @property
    def whole_turns(self) -> Array:
        """Whole turns (N,) that a period adds to the coordinates."""
        return self.winding

    @property
    def laps(self) -> bool:
        """Whether the orbit may itself cross sections, so that its tubes cross them with every lap."""
        return True


@dataclass(frozen=True)
class SegmentedManifold(UnstableManifold):
    """The local unstable manifold of a hyperbolic orbit given by nodes."""

    orbit: HyperbolicOrbit
    distance: float = 3e-4

    @cached_property
    def _node_vectors(self) -> tuple[Array, float, int]:
        """Vectors (M, N) at the nodes, v(φ) = e^(-μφ) Φ v(0); the exponent μ = ln |λ|; the sign of λ."""
        orbit = self.orbit
        scale = orbit.system.scale
        _, stms = orbit.system.segments.flows_with_stm(orbit.node_states[:-1], np.diff(orbit.node_times))
        # A start with a share of every direction.
        vector = np.cos(np.arange(len(scale)) + 1.0)
        lengths, vectors, sign = np.ones(len(stms)), np.empty((len(stms), len(scale))), 1
        for _ in range(_ROUNDS):
            before = vector
            for k, stm in enumerate(stms):
                vectors[k] = vector
                grown = (stm @ (vector * scale)) / scale
                lengths[k] = np.linalg.norm(grown)
                vector = grown / lengths[k]
            sign = int(np.sign(vector @ before))
            if np.abs(vector - sign * before).max() < _SETTLED:
                break
        exponent = float(np.log(lengths).sum())
        grown_by = np.concatenate([[0.0], np.cumsum(np.log(lengths))[:-1]])
        vectors *= np.exp(grown_by - exponent * orbit.node_times[:-1] / orbit.period)[:, None]
        first = vectors[0, : len(scale) // 2] * scale[: len(scale) // 2]
        return vectors * scale * np.sign(first[np.argmax(np.abs(first))]), exponent, sign

    @cached_property
    def vector(self) -> Array:
        """The unstable Floquet vector (N,) at phase zero, of scaled length one."""
        return self._node_vectors[0][0]

    @cached_property
    def exponent(self) -> float:
        """ln |λ|: the growth of the unstable vector over one period."""
        return self._node_vectors[1]

    @cached_property
    def half_turn(self) -> tuple[Array, float] | None:
        """None: nothing is assumed of the orbit but its mirror."""
        return None

    def frame(self, phases: Array) -> Frame:
        """Return orbit and unstable vector at phases (K,), any real numbers; states are lifted by the orbit's turns."""
        orbit = self.orbit
        system, period = orbit.system, orbit.period
        nodes, exponent, sign = self._node_vectors
        phases = np.atleast_1d(np.asarray(phases, dtype=float))
        rounds = np.floor(phases)
        elapsed = (phases - rounds) * period
        segment = np.clip(np.searchsorted(orbit.node_times, elapsed, side="right") - 1, 0, len(nodes) - 1)
        states = np.empty((len(phases), system.dimension))
        vectors = np.empty_like(states)
        for k in np.unique(segment):
            where = np.flatnonzero(segment == k)
            where = where[np.argsort(elapsed[where], kind="stable")]
            along = elapsed[where] - orbit.node_times[k]
            states[where], matrices = system.propagator.sample_with_stm(orbit.node_states[k], along)
            vectors[where] = (matrices @ nodes[k]) * np.exp(-exponent * along / period)[:, None]
        vectors *= np.where(rounds % 2 == 1, float(sign), 1.0)[:, None]
        state_slopes = system.numeric.rate(states) * period
        vector_slopes = np.einsum("kij,kj->ki", system.numeric.jacobian(states), vectors) * period
        vector_slopes -= exponent * vectors
        lengths = np.linalg.norm(vectors / system.scale, axis=1)
        return Frame(phases, states + rounds[:, None] * orbit.turn, vectors, state_slopes, vector_slopes, lengths)


def local_manifold(orbit: LyapunovOrbit, distance: float = 3e-4) -> UnstableManifold:
    """Return the local unstable manifold of a vertex of either kind, its seeds `distance` (scaled) from the orbit."""
    if isinstance(orbit, HyperbolicOrbit):
        return SegmentedManifold(orbit, distance)
    return UnstableManifold(orbit, distance)


def rotating_vertex(orbit: RotatingOrbit, *, name: str | None = None, segments: int = 16) -> HyperbolicOrbit:
    """Return a rotating orbit as a vertex, by default named "outer-rotating" or "inner-rotating" ("-back": clockwise).

    segments: nodes, of which half are flown from the mirror line and half are their mirror images.

    Raises:
        InputError: the orbit is not hyperbolic: it has no tubes.
    """
    if "hyperbolic" not in orbit.kind:
        raise InputError(
            f"the rotating orbit at {orbit.energy:g} J is {orbit.kind} (trace {orbit.trace:.6g}): only hyperbolic "
            "orbits have tubes; choose another orbit or energy"
        )
    system, n = orbit.system, orbit.system.dimension // 2
    default = f"{('inner', 'outer')[orbit.arm - 1]}-rotating{'' if sum(orbit.winding) > 0 else '-back'}"
    rest = np.concatenate([orbit.state[:n], np.zeros(n)])
    winding = np.zeros(2 * n)
    winding[:n] = orbit.winding
    half = max(1, segments // 2)
    times = np.linspace(0.0, orbit.period, 2 * half + 1)
    mirror = system.reversers[-1]
    first = system.propagator.sample(orbit.state, times[: half + 1])
    # γ(1 - φ) = R γ(φ) + a whole turn.
    second = (first[:-1][::-1] - rest) @ mirror.T + rest + winding * system.turn_lengths
    states = np.vstack([first, second])
    _, stms = system.segments.flows_with_stm(states[:-1], np.diff(times))
    monodromy = np.eye(2 * n)
    for stm in stms:
        monodromy = stm @ monodromy
    multiplier = float(complex(orbit.floquet_multipliers[0]).real)
    neutral = [1.0] * (2 * n - 2)
    return HyperbolicOrbit(
        system=system,
        saddle=name or default,
        family=0,
        energy=orbit.energy,
        state=states[0],
        period=orbit.period,
        floquet_multipliers=np.array([multiplier, *neutral, 1 / multiplier], dtype=complex),
        monodromy=monodromy,
        residual=orbit.residual,
        newton_residual=orbit.newton_residual,
        converged=True,
        status=orbit.status,
        mirror=mirror,
        rest=rest,
        winding=winding,
        node_times=times,
        node_states=states,
    )


SAMPLES = 512  # a periodic cubic spline through them is off by about 1e-9 (scaled)


@dataclass(frozen=True)
class OrbitCurve:
    """The curve of one orbit; phases have period 1, angles are compared modulo a turn."""

    orbit: LyapunovOrbit

    @cached_property
    def samples(self) -> Array:
        """States (SAMPLES, N) at equally spaced phases from 0."""
        return local_manifold(self.orbit).frame(np.arange(SAMPLES) / SAMPLES).states

    @cached_property
    def _spline(self) -> CubicSpline:
        # What the orbit turns is taken out: only the rest is periodic.
        still = self.samples - np.arange(SAMPLES)[:, None] / SAMPLES * self.orbit.turn
        closed = np.vstack([still, still[:1]])
        return CubicSpline(np.arange(SAMPLES + 1) / SAMPLES, closed, bc_type="periodic")

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self._embedded(self.samples))

    def _embedded(self, states: Array) -> Array:
        """Return states with angles on the unit circle: near each other there means near on the torus."""
        system = self.orbit.system
        angular = np.isfinite(system.periods)
        turns = states[:, angular] / system.periods[angular] * 2 * np.pi
        radius = system.periods[angular] / (2 * np.pi) / system.scale[angular]
        plain = states[:, ~angular] / system.scale[~angular]
        return np.hstack([np.cos(turns) * radius, np.sin(turns) * radius, plain])

    def states(self, phases: Array) -> Array:
        """Return states (…, N) at phases (…)."""
        within = np.asarray(phases) % 1.0
        return self._spline(within) + within[..., None] * self.orbit.turn

    def nearest(self, state: Array) -> tuple[float, float]:
        """Return (phase, scaled distance) of the orbit's point nearest to a state (N,)."""
        system = self.orbit.system
        # The nearest sample, by the Euclidean norm, and the nearest point by the largest component are not far apart.
        phase, reach = float(np.ravel(self._tree.query(self._embedded(state[None]))[1])[0]) / SAMPLES, 3 / SAMPLES
        grid = np.linspace(-1.0, 1.0, 33)
        distances = np.empty(33)
        while reach > 1e-13:
            phases = phase + reach * grid
            distances = system.scaled_distance(state, self.states(phases))
            phase = float(phases[np.argmin(distances)])
            # The smallest lies within a step of the smallest on the grid.
            reach *= 2 / 32
        return phase % 1.0, float(distances.min())

    def distances(self, states: Array) -> tuple[Array, Array]:
        """Return (phases, scaled distances), each (K,), of the orbit's points nearest to states (K, N).

        Nearest in the scaled Euclidean norm, which is smooth; the distance is the largest scaled component there.
        """
        system = self.orbit.system
        x = np.atleast_2d(states)
        phases = np.asarray(self._tree.query(self._embedded(x))[1], dtype=float) / SAMPLES
        for _ in range(4):
            gap = self._gaps(x, self.states(phases)) / system.scale
            slope = (self._spline(phases % 1.0, 1) + self.orbit.turn) / system.scale
            step = np.sum(gap * slope, axis=-1) / np.sum(slope**2, axis=-1)
            phases = phases + np.clip(step, -1 / SAMPLES, 1 / SAMPLES)
        gap = self._gaps(x, self.states(phases)) / system.scale
        return phases % 1.0, np.max(np.abs(gap), axis=-1)

    def _gaps(self, first: Array, second: Array) -> Array:
        """Return first - second with whole turns removed."""
        system = self.orbit.system
        difference = first - second
        return difference - system.nearest_turns(difference) * system.turn_lengths
