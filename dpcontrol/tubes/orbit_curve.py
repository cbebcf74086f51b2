"""A periodic orbit as a smooth closed curve: states by phase, and the nearest phase to a state."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree

from dpcontrol.tubes.lyapunov import LyapunovOrbit
from dpcontrol.tubes.vertex import local_manifold

Array = NDArray[np.float64]

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
