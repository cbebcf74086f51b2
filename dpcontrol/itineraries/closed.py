"""A periodic orbit as nodes of multiple shooting, and its multipliers as logarithms.

A periodic orbit that shadows a walk of eight symbols has λ ≈ 1e100: its monodromy matrix holds nothing but λ_u in
double precision. The segments' matrices are small, and products of vectors through them keep their logarithms.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ClosedOrbit:
    """times (K + 1,) s from 0 to the period; states (K + 1, N); the last is the first plus `turn` (N,).

    residual: largest gap at a node, the closing one included.
    """

    system: System
    times: Array
    states: Array
    turn: Array
    residual: float
    iterations: int
    converged: bool
    status: str

    @property
    def period(self) -> float:
        """Seconds until the orbit closes (but for whole turns of its angles)."""
        return float(self.times[-1])

    def sample(self, times: Array) -> Array:
        """Return states (M, N) at any times (M,) s, each flown from the node before it."""
        rounds = np.floor(np.asarray(times, dtype=float) / self.period)
        wanted, inverse = np.unique(np.asarray(times) - rounds * self.period, return_inverse=True)
        out = np.empty((len(wanted), self.system.dimension))
        segment = np.clip(np.searchsorted(self.times, wanted, side="right") - 1, 0, len(self.times) - 2)
        for k in np.unique(segment):
            where = np.flatnonzero(segment == k)
            out[where] = self.system.propagator.sample(self.states[k], wanted[where] - self.times[k])
        return out[np.ravel(inverse)] + rounds[:, None] * self.turn


@dataclass(frozen=True)
class ClosedMultipliers:
    """Logarithms of |λ_u| (forward) and |λ_s| (backward, independently), and the sign of both."""

    log_unstable: float
    log_stable: float
    sign: int

    @property
    def reciprocity(self) -> float:
        """|λ_u λ_s| - 1: zero in a Hamiltonian system."""
        return float(np.expm1(self.log_unstable + self.log_stable))


def closed_multipliers(stms: Array, scale: Array) -> ClosedMultipliers:
    """Return the multipliers of a closed orbit from the state-transition matrices (K, N, N) of its segments.

    The unstable direction is carried around forward until it repeats, the stable one backward.
    """
    scaled = stms * scale[None, None, :] / scale[None, :, None]
    forward, sign = _growth(scaled)
    backward, _ = _growth(np.asarray(np.linalg.inv(scaled)[::-1], dtype=float))
    return ClosedMultipliers(forward, -backward, sign)


def _growth(matrices: Array) -> tuple[float, int]:
    """Return the logarithm of the growth of a vector in one round, and whether it comes back turned around."""
    # A vector that is no eigenvector of anything simple; the dominant direction wins by λ² a round.
    vector = np.cos(np.arange(matrices.shape[1]) + 1.0)
    before, total = vector, 0.0
    for _ in range(4):
        before, total = vector, 0.0
        for matrix in matrices:
            vector = matrix @ vector
            length = float(np.linalg.norm(vector))
            total += float(np.log(length))
            vector = vector / length
    return total, int(np.sign(vector @ before))
