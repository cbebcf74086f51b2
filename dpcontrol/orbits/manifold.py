"""The unstable manifold of a Lyapunov orbit near the orbit: γ(φ) ± δ v(φ), on the orbit's energy.

γ(φ) is the orbit at phase φ (period 1), v(φ) the Floquet vector of the unstable multiplier λ, transported by the
variational equations. The stable manifold is the unstable one turned around by a
reverser; it is never integrated. Both γ and v are integrated over the shortest stretch from which the system's
symmetries give the rest, so that rounding grows by λ^(1/4) at most (λ^(1/2) where there is one reverser).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dpcontrol.orbits.lyapunov import LyapunovOrbit

Array = NDArray[np.float64]

_STEEPEST = 0.95  # of the vectors' growth: how much of it a change of the seeds' distance may undo
_PROBES = 96  # phases at which the vectors' lengths are compared


@dataclass(frozen=True)
class Frame:
    """Orbit states γ(φ) and unstable vectors v(φ) at phases (K,), and their derivatives by phase, each (K, N).

    v(φ) = e^(-μφ) Φ(φT) v(0) with μ = ln λ, so that the flow carries γ(φ) + a v(φ) over a time t to phase φ + t/T and
    amplitude a e^(μt/T), up to a². lengths (K,) are the scaled lengths of the vectors, one at phase zero.
    """

    phases: Array
    states: Array
    vectors: Array
    state_slopes: Array
    vector_slopes: Array
    lengths: Array


@dataclass(frozen=True)
class UnstableManifold:
    """The local unstable manifold of a hyperbolic orbit; branch +1 or -1 is the side of the orbit."""

    orbit: LyapunovOrbit
    distance: float = 3e-4

    @cached_property
    def vector(self) -> Array:
        """The unstable Floquet vector (N,) at phase zero, of scaled length one, oriented along the flow's sense.

        The sign is fixed by the first coordinate that the vector changes most, so branches keep their names.
        """
        values, vectors = np.linalg.eig(self.orbit.monodromy)
        v = np.real(vectors[:, np.argmax(np.abs(values))])
        v = v / np.linalg.norm(v / self.orbit.system.scale)
        n = len(v) // 2
        return v * np.sign(v[np.argmax(np.abs(v[:n]))])

    @cached_property
    def exponent(self) -> float:
        """ln λ: the growth of the unstable vector over one period."""
        return float(np.log(abs(self.orbit.unstable_multiplier)))

    @cached_property
    def half_turn(self) -> tuple[Array, float] | None:
        """The symmetry S with γ(φ + ½) = S γ(φ) and the sign in v(φ + ½) = ± S v(φ); None without it."""
        reversers = self.orbit.system.reversers
        if len(reversers) < 2:
            return None
        symmetry = reversers[-1] @ reversers[0]
        _, stm = self.orbit.system.propagator.flow_with_stm(self.orbit.state, self.orbit.period / 2)
        moved = stm @ self.vector
        return symmetry, float(np.sign(moved @ (symmetry @ self.vector)))

    @property
    def branches_are_mirrored(self) -> bool:
        """Whether the symmetry S carries branch +1 at φ to branch -1 at φ + ½."""
        return self.half_turn is not None and self.half_turn[1] < 0

    def frame(self, phases: Array) -> Frame:
        """Return orbit and unstable vector at phases (K,), any real numbers."""
        orbit = self.orbit
        system, centre = orbit.system, orbit.centre
        phases = np.atleast_1d(np.asarray(phases, dtype=float))
        spacing = 1.0 if self.half_turn is None else 0.5
        turns = np.rint(phases / spacing)
        base = phases - turns * spacing
        states = np.empty((len(base), system.dimension))
        matrices = np.empty((len(base), system.dimension, system.dimension))
        for side in (base >= 0, base < 0):
            where = np.flatnonzero(side)[np.argsort(np.abs(base[side]), kind="stable")]
            states[where], matrices[where] = system.propagator.sample_with_stm(orbit.state, base[where] * orbit.period)
        growth = np.exp(-self.exponent * base)[:, None]
        raw = (matrices @ self.vector) * growth
        state_slopes = system.numeric.rate(states) * orbit.period
        raw_slopes = np.einsum("kij,kj->ki", system.numeric.jacobian(states), raw) * orbit.period
        raw_slopes -= self.exponent * raw
        if self.half_turn is not None:
            symmetry, sign = self.half_turn
            odd = (turns % 2).astype(bool)
            states[odd] = (states[odd] - centre) @ symmetry.T + centre
            state_slopes[odd] = state_slopes[odd] @ symmetry.T
            raw[odd] = sign * raw[odd] @ symmetry.T
            raw_slopes[odd] = sign * raw_slopes[odd] @ symmetry.T
        lengths = np.linalg.norm(raw / system.scale, axis=1)
        return Frame(phases, states, raw, state_slopes, raw_slopes, lengths)

    @cached_property
    def _evening(self) -> tuple[float, float]:
        """How seeds' distances follow the vectors' lengths l(φ): as (l/L)^e; returns (e, L), L the largest length.

        With e = 0 every seed is `distance` away. Where the vectors shrink faster than trajectories leave, such seeds
        meet one trajectory several times; e = 1 (constant amplitudes) meets each once, from nearer seeds.
        """
        frame = self.frame(np.arange(_PROBES) / _PROBES)
        along = np.sum(frame.vectors * frame.vector_slopes / self.orbit.system.scale**2, axis=1) / frame.lengths**2
        steepest = float(np.max(-along)) / self.exponent
        return 1 - min(1.0, _STEEPEST / steepest) if steepest > 0 else 0.0, float(frame.lengths.max())

    def amplitude(self, phase: float, branch: int) -> float:
        """Return the amplitude a of the seed γ(φ) + a v(φ) at a phase."""
        length = float(self.frame(np.array([phase])).lengths[0])
        exponent, longest = self._evening
        return branch * self.distance * (length / longest) ** exponent / length

    def seeds(self, phases: Array, branch: int) -> tuple[Array, Array]:
        """Return seeds (K, N) on the manifold and their derivatives (K, N) by phase.

        Seeds lie `distance` (scaled) from the orbit, or nearer where trajectories would otherwise meet their curve more
        than once, and are moved onto its energy along the energy's gradient; the derivative leaves out how that small
        correction (δ²) changes with phase, which only slows Newton a little.
        """
        frame = self.frame(phases)
        numeric, scale = self.orbit.system.numeric, self.orbit.system.scale
        lengths = frame.lengths[:, None]
        vectors = frame.vectors / lengths
        along = np.sum(vectors * frame.vector_slopes / scale**2, axis=1, keepdims=True) / lengths
        exponent, longest = self._evening
        distances = branch * self.distance * (lengths / longest) ** exponent
        seeds = frame.states + distances * vectors
        slopes = frame.state_slopes + distances * (frame.vector_slopes / lengths + (exponent - 1) * along * vectors)
        for _ in range(3):
            gradient = numeric.gradient(seeds) * scale
            excess = numeric.hamiltonian(seeds) - self.orbit.energy
            seeds = seeds - (excess / np.sum(gradient**2, axis=1))[:, None] * gradient * scale
        normal = numeric.gradient(seeds) * scale
        away = np.sum(normal * slopes / scale, axis=1) / np.sum(normal**2, axis=1)
        return seeds, slopes - away[:, None] * normal * scale
