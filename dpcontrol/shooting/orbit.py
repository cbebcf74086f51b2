"""An orbit as nodes of multiple shooting: from one periodic orbit to another, between local manifolds, or closed.

Short segments keep rounding from growing: the gap at a node stays near 1e-14 where single shooting from a distance δ
is limited to 1e-15/δ.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

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
