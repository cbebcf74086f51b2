"""Closed curves and local unstable manifolds of periodic orbits.

The local unstable manifold is γ(φ) ± δ v(φ). Here γ(φ) is the orbit at phase φ (period 1) and v(φ) is the Floquet
vector of the unstable multiplier λ, propagated by the variational equations. The manifold has the energy of the orbit.
The stable manifold is its image under a reverser R with γ(-φ) = R γ(φ), without integration.

A saddle's orbit is integrated over the shortest arc that determines the rest by symmetry. Rounding errors therefore
grow by at most λ^(1/4), or λ^(1/2) with one reverser. Other hyperbolic orbits are stored as nodes, with v at each node,
so no integration exceeds one segment for any λ. Such an orbit may rotate, with γ(φ + 1) = γ(φ) + whole turns. If λ is
negative, the manifold is one-sided: v(φ + 1) = -v(φ) and phases have period two. The two branches at φ are then
the same branch at φ and φ + 1.

Sources: Kaheman et al. (2023), section 4; Meyer & Offin, Introduction to Hamiltonian Dynamical Systems and the N-Body
Problem, 3rd ed., chapter 8.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.shown import Brief
from dpcontrol.orbits.orbit import PeriodicOrbit

Orbit = TypeVar("Orbit", bound=PeriodicOrbit)
_STEEPEST = 0.95  # largest compensation of the vectors' growth by a change of the seeds' distance
_PROBES = 96  # number of phases at which vector lengths are compared


@dataclass(frozen=True)
class Frame(Brief):
    """States γ(φ) and unstable vectors v(φ), with derivatives by phase.

    The vectors are v(φ) = e^(-μφ) Φ(φT) v(0) with μ = ln λ. During a time t, the flow therefore moves γ(φ) + a v(φ)
    to the phase φ + t/T and the amplitude a e^(μt/T), up to an error of order a².

    Attributes:
        phases (K,): φ.
        states (K, N), vectors (K, N): γ(φ) and v(φ).
        state_slopes (K, N), vector_slopes (K, N): their derivatives by phase.
        lengths (K,): scaled lengths of the vectors, one at phase zero.
    """

    phases: Array
    states: Array
    vectors: Array
    state_slopes: Array
    vector_slopes: Array
    lengths: Array


@dataclass(frozen=True)
class UnstableManifold(Brief, Generic[Orbit]):
    """The local unstable manifold of a hyperbolic orbit, branches +1 and -1.

    Attributes:
        distance: largest scaled distance of the seeds from the orbit.
        side: +1, or -1 to exchange the branches.
    """

    orbit: Orbit
    distance: float = 3e-4
    side: int = 1

    @cached_property
    def vector(self) -> Array:
        """The unstable Floquet vector (N,) at phase zero, with scaled length one.

        Its largest coordinate and `side` determine the sign, so the branches have unique names.
        """
        values, vectors = np.linalg.eig(self.orbit.monodromy)
        unstable_vector = np.real(vectors[:, np.argmax(np.abs(values))])
        unstable_vector = unstable_vector / np.linalg.norm(unstable_vector / self.orbit.system.scale)
        n = len(unstable_vector) // 2
        return unstable_vector * (self.side * np.sign(unstable_vector[np.argmax(np.abs(unstable_vector[:n]))]))

    @cached_property
    def exponent(self) -> float:
        """Growth exponent ln λ of the unstable vector over one period."""
        return float(np.log(abs(self.orbit.unstable_multiplier)))

    @cached_property
    def half_turn(self) -> tuple[Array, float] | None:
        """The symmetry S (N, N) by half a period and its sign, or None for a system with a single reverser.

        With states from the saddle, they satisfy γ(φ + ½) = S γ(φ) and v(φ + ½) = ± S v(φ).
        """
        reversers = self.orbit.system.reversers
        if len(reversers) < 2:
            return None
        symmetry = reversers[-1] @ reversers[0]
        _, stm = self.orbit.system.propagator.flow_with_stm(self.orbit.state, self.orbit.period / 2)
        image = stm @ self.vector
        return symmetry, float(np.sign(image @ (symmetry @ self.vector)))

    @property
    def branches_are_mirrored(self) -> bool:
        """True if the symmetry S exchanges the two branches, so that one of them determines the other."""
        return self.half_turn is not None and self.half_turn[1] < 0

    def frame(self, phases: Array) -> Frame:
        """Return the orbit's states and unstable vectors at given phases, with derivatives, of which seeds consist.

        Args:
            phases: any real phases (K,), 1 for a period.
        """
        orbit = self.orbit
        system, centre = orbit.system, orbit.centre
        phases = np.atleast_1d(np.asarray(phases, dtype=float))
        spacing = 1.0 if self.half_turn is None else 0.5
        # States are taken on the shortest arc, and the rest follows by the symmetry of half a period. Vectors are
        # propagated forwards only: backwards, errors grow by λ^(1/2) against the vector itself.
        rounds, turns = np.floor(phases / spacing), np.rint(phases / spacing)
        ahead, base = phases - rounds * spacing, phases - turns * spacing
        states, matrices = system.propagator.sample_with_stm(orbit.state, ahead * orbit.period)
        behind = np.flatnonzero(base < 0)[np.argsort(-base[base < 0])]
        states[behind] = system.propagator.sample(orbit.state, base[behind] * orbit.period)
        vectors = (matrices @ self.vector) * np.exp(-self.exponent * ahead)[:, None]
        if self.half_turn is not None:
            symmetry, sign = self.half_turn
            states = np.where(turns[:, None] % 2, (states - centre) @ symmetry.T + centre, states)
            vectors = np.where(rounds[:, None] % 2, sign * vectors @ symmetry.T, vectors)
        state_slopes = system.numeric.rate(states) * orbit.period
        vector_slopes = np.einsum("kij,kj->ki", system.numeric.jacobian(states), vectors) * orbit.period
        vector_slopes -= self.exponent * vectors
        lengths = np.linalg.norm(vectors / system.scale, axis=1)
        return Frame(phases, states, vectors, state_slopes, vector_slopes, lengths)

    @cached_property
    def _evening(self) -> tuple[float, float]:
        """Return e and L for the seeds' distance from the orbit, `distance` (l(φ)/L)^e.

        Here l(φ) is the length of the vector and L its maximum. With e = 0, all seeds have the same distance. If the
        vectors shrink faster than trajectories depart, several seeds then lie on one trajectory. With e = 1 (constant
        amplitude), each trajectory has one seed, but seeds are nearer to the orbit.
        """
        frame = self.frame(np.arange(_PROBES) / _PROBES)
        length_rates = (
            np.sum(frame.vectors * frame.vector_slopes / self.orbit.system.scale**2, axis=1) / frame.lengths**2
        )
        steepest = float(np.max(-length_rates)) / self.exponent
        return 1 - min(1.0, _STEEPEST / steepest) if steepest > 0 else 0.0, float(frame.lengths.max())

    def amplitude(self, phase: float, branch: int) -> float:
        """Return the factor on the unstable vector of the seed at a phase, signed by the branch.

        Args:
            phase: phase of the orbit, 1 for a period.
            branch: +1 or -1.
        """
        length = float(self.frame(np.array([phase])).lengths[0])
        exponent, longest = self._evening
        return branch * self.distance * (length / longest) ** exponent / length

    def seeds(self, phases: Array, branch: int) -> tuple[Array, Array]:
        """Return seeds (K, N) and their derivatives (K, N) by phase.

        The scaled distance from the orbit is at most `distance`, and smaller if trajectories would otherwise cross the
        curve of seeds repeatedly. Seeds are corrected to the orbit's energy along the energy gradient. The derivative
        neglects this correction, which is of the order of the squared distance and slows Newton's method only slightly.

        Args:
            phases: any real phases (K,), 1 for a period.
            branch: +1 or -1.
        """
        frame = self.frame(phases)
        numeric, scale = self.orbit.system.numeric, self.orbit.system.scale
        lengths = frame.lengths[:, None]
        vectors = frame.vectors / lengths
        length_rates = np.sum(vectors * frame.vector_slopes / scale**2, axis=1, keepdims=True) / lengths
        exponent, longest = self._evening
        distances = branch * self.distance * (lengths / longest) ** exponent
        seeds = frame.states + distances * vectors
        slopes = frame.state_slopes + distances * (
            frame.vector_slopes / lengths + (exponent - 1) * length_rates * vectors
        )
        # Newton steps onto the energy surface along its scaled gradient.
        for _ in range(3):
            gradient = numeric.gradient(seeds) * scale
            excess = numeric.hamiltonian(seeds) - self.orbit.energy
            seeds = seeds - (excess / np.sum(gradient**2, axis=1))[:, None] * gradient * scale
        # The derivative stays in the energy surface as well.
        normal = numeric.gradient(seeds) * scale
        energy_drift = np.sum(normal * slopes / scale, axis=1) / np.sum(normal**2, axis=1)
        return seeds, slopes - energy_drift[:, None] * normal * scale


_ROUNDS = 200  # power iterations, sufficient for |λ| > 1.2
_SETTLED = 1e-15


@dataclass(frozen=True)
class SegmentedManifold(UnstableManifold[Orbit]):
    """The local unstable manifold of an orbit stored as nodes."""

    @cached_property
    def _node_vectors(self) -> tuple[Array, float, int]:
        """Return the unstable vectors (M, N) at the M segments' first nodes, the exponent ln |λ|, and the sign of λ.

        The power method iterates over whole periods, segment by segment, so that no product of matrices overflows or
        loses the smaller directions. The vectors decay by e^(-μφ), as in `Frame`.
        """
        orbit = self.orbit
        scale = orbit.system.scale
        times, states = orbit.nodes
        _, stms = orbit.system.propagator.flows_with_stm(states[:-1], np.diff(times))
        # The initial vector has a component in every direction.
        vector = np.cos(np.arange(len(scale)) + 1.0)
        lengths, vectors, sign = np.ones(len(stms)), np.empty((len(stms), len(scale))), 1
        for _ in range(_ROUNDS):
            previous = vector
            for k, stm in enumerate(stms):
                vectors[k] = vector
                next_vector = (stm @ (vector * scale)) / scale
                lengths[k] = np.linalg.norm(next_vector)
                vector = next_vector / lengths[k]
            sign = int(np.sign(vector @ previous))
            if np.abs(vector - sign * previous).max() < _SETTLED:
                break
        exponent = float(np.log(lengths).sum())
        log_growth = np.concatenate([[0.0], np.cumsum(np.log(lengths))[:-1]])
        vectors *= np.exp(log_growth - exponent * times[:-1] / orbit.period)[:, None]
        first_angles = vectors[0, : len(scale) // 2] * scale[: len(scale) // 2]
        return vectors * scale * (self.side * np.sign(first_angles[np.argmax(np.abs(first_angles))])), exponent, sign

    @cached_property
    def vector(self) -> Array:
        """The unstable Floquet vector (N,) at phase zero, with scaled length one."""
        return self._node_vectors[0][0]

    @cached_property
    def exponent(self) -> float:
        """Growth exponent ln |λ| of the unstable vector over one period."""
        return self._node_vectors[1]

    @cached_property
    def half_turn(self) -> tuple[Array, float] | None:
        """None, because the reverser is the only symmetry assumed."""
        return None

    def frame(self, phases: Array) -> Frame:
        """Return the orbit's lifted states and unstable vectors at given phases, with derivatives, as the base class.

        Args:
            phases: any real phases (K,), 1 for a period.
        """
        orbit = self.orbit
        system, period = orbit.system, orbit.period
        (node_times, node_states), (nodes, exponent, sign) = orbit.nodes, self._node_vectors
        phases = np.atleast_1d(np.asarray(phases, dtype=float))
        rounds = np.floor(phases)
        elapsed = (phases - rounds) * period
        segment = np.clip(np.searchsorted(node_times, elapsed, side="right") - 1, 0, len(nodes) - 1)
        states = np.empty((len(phases), system.dimension))
        vectors = np.empty_like(states)
        for k in np.unique(segment):
            order = np.flatnonzero(segment == k)
            order = order[np.argsort(elapsed[order], kind="stable")]
            times = elapsed[order] - node_times[k]
            states[order], matrices = system.propagator.sample_with_stm(node_states[k], times)
            vectors[order] = (matrices @ nodes[k]) * np.exp(-exponent * times / period)[:, None]
        vectors *= np.where(rounds % 2 == 1, float(sign), 1.0)[:, None]
        state_slopes = system.numeric.rate(states) * period
        vector_slopes = np.einsum("kij,kj->ki", system.numeric.jacobian(states), vectors) * period
        vector_slopes -= exponent * vectors
        lengths = np.linalg.norm(vectors / system.scale, axis=1)
        return Frame(phases, states + rounds[:, None] * orbit.turn, vectors, state_slopes, vector_slopes, lengths)


def local_manifold(orbit: Orbit, distance: float = 3e-4) -> UnstableManifold[Orbit]:
    """Return the local unstable manifold of an orbit: by segments if the orbit is stored as nodes.

    Args:
        orbit: hyperbolic orbit.
        distance: largest scaled distance of the seeds from the orbit.
    """
    return (SegmentedManifold if len(orbit.nodes[0]) > 1 else UnstableManifold)(orbit, distance)


SAMPLES = 512  # a periodic cubic spline through them has a scaled error of about 1e-9


@dataclass(frozen=True)
class OrbitCurve(Brief):
    """The curve of a periodic orbit, with phases of period 1."""

    orbit: PeriodicOrbit

    @cached_property
    def samples(self) -> Array:
        """States (SAMPLES, N) at equally spaced phases from 0."""
        return local_manifold(self.orbit).frame(np.arange(SAMPLES) / SAMPLES).states

    @cached_property
    def _spline(self) -> Any:
        """The periodic cubic spline through the samples, without the rotation of a rotating orbit."""
        # Its import takes longer than an orbit.
        from scipy.interpolate import CubicSpline

        # The rotation is subtracted, because the spline must be periodic.
        without_turns = self.samples - np.arange(SAMPLES)[:, None] / SAMPLES * self.orbit.turn
        periodic_samples = np.vstack([without_turns, without_turns[:1]])
        return CubicSpline(np.arange(SAMPLES + 1) / SAMPLES, periodic_samples, bc_type="periodic")

    @cached_property
    def _tree(self) -> Any:
        """The samples in a search tree, from which the nearest one begins a search for the nearest point."""
        from scipy.spatial import KDTree

        return KDTree(self._embedded(self.samples))

    def _embedded(self, states: Array) -> Array:
        """Return states (K, N) with each angle as a point of a scaled circle, so that distances respect whole turns."""
        system = self.orbit.system
        angular = np.isfinite(system.periods)
        turns = states[:, angular] / system.periods[angular] * 2 * np.pi
        radius = system.periods[angular] / (2 * np.pi) / system.scale[angular]
        other_coordinates = states[:, ~angular] / system.scale[~angular]
        return np.hstack([np.cos(turns) * radius, np.sin(turns) * radius, other_coordinates])

    def states(self, phases: Array) -> Array:
        """Return the orbit's states (…, N) at phases (…), interpolated.

        Args:
            phases: any real phases (…).
        """
        phases_in_period = np.asarray(phases) % 1.0
        return self._spline(phases_in_period) + phases_in_period[..., None] * self.orbit.turn

    def nearest(self, states: Array) -> tuple[Array, Array]:
        """Return phases (…) and scaled distances (…) of the orbit's points nearest to states, in the largest component.

        Args:
            states: states (…, N).
        """
        system, all_states = self.orbit.system, np.asarray(states, dtype=float)
        # The nearest sample in the Euclidean norm is close to the nearest point in the maximum norm.
        nearest_sample = self._tree.query(self._embedded(all_states.reshape(-1, system.dimension)))[1]
        phases, reach = np.reshape(nearest_sample, all_states.shape[:-1]) / SAMPLES, 3 / SAMPLES
        grid, distances = np.linspace(-1.0, 1.0, 33), np.empty(0)
        while reach > 1e-13:
            trials = phases[..., None] + reach * grid
            distances = system.scaled_distance(all_states[..., None, :], self.states(trials))
            phases = np.take_along_axis(trials, np.argmin(distances, axis=-1)[..., None], axis=-1)[..., 0]
            # The minimum lies within one step of the smallest value on the grid.
            reach *= 2 / 32
        return phases % 1.0, distances.min(axis=-1)

    def distances(self, states: Array) -> tuple[Array, Array]:
        """Return phases (K,) and scaled distances (K,) of the nearest orbit points.

        The nearest points are those in the scaled Euclidean norm, which is smooth. The distance is the largest scaled
        component.

        Args:
            states: states (K, N).
        """
        system = self.orbit.system
        rows = np.atleast_2d(states)
        phases = np.asarray(self._tree.query(self._embedded(rows))[1], dtype=float) / SAMPLES
        for _ in range(4):
            gap = self._gaps(rows, self.states(phases)) / system.scale
            slope = (self._spline(phases % 1.0, 1) + self.orbit.turn) / system.scale
            step = np.sum(gap * slope, axis=-1) / np.sum(slope**2, axis=-1)
            phases = phases + np.clip(step, -1 / SAMPLES, 1 / SAMPLES)
        gap = self._gaps(rows, self.states(phases)) / system.scale
        return phases % 1.0, np.max(np.abs(gap), axis=-1)

    def _gaps(self, first: Array, second: Array) -> Array:
        """Return the differences first - second (…, N) with whole turns removed."""
        system = self.orbit.system
        difference = first - second
        return difference - system.nearest_turns(difference) * system.turn_lengths
