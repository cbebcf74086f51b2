"""What vouches for a shadowing orbit: numbers from which another can judge it without solving it again.

Source: Deuflhard, Newton Methods for Nonlinear Problems (2011), theorem 2.3 (Newton–Kantorovich in affine-covariant
form): with h = ω ‖Δx‖ < 1/2 a solution exists within (1 - √(1 - 2h))/ω of the iterate and is unique nearby.

A periodic orbit as nodes of multiple shooting, and its multipliers as logarithms.

A periodic orbit that shadows a walk of eight symbols has λ ≈ 1e100: its monodromy matrix holds nothing but λ_u in
double precision. The segments' matrices are small, and products of vectors through them keep their logarithms.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System
from dpcontrol.orbits.curve import OrbitCurve
from dpcontrol.shooting.newton import Shot
from dpcontrol.tubes.connection import Connection

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


@dataclass(frozen=True)
class Certificate:
    """Lengths are scaled (largest component of a node's state, durations over the mean segment).

    residual: largest gap at a node (rad, rad/s); condition: of the scaled Jacobian, 1-norm; kantorovich: h = ω ‖Δx‖ of
    the last step; radius: within which the true orbit's nodes lie, 2 ‖Δx‖ at most; energy_error: largest over the
    nodes, in the energy's unit; departure: largest distance of a node from the connections that it was to follow;
    stops: distance from the periodic orbit at each stop's nearest node. multipliers: of a periodic orbit.
    """

    residual: float
    condition: float
    kantorovich: float
    radius: float
    energy_error: float
    departure: float
    stops: tuple[float, ...]
    multipliers: ClosedMultipliers | None

    @property
    def holds(self) -> bool:
        """Whether the Newton–Kantorovich condition h < 1/2 is met."""
        return self.kantorovich < 0.5


def certify(shot: Shot, chain: Sequence[Connection], nodes: NDArray[np.intp], stays: Array) -> Certificate:
    """Return the certificate of a converged shot; nodes (k,): those on the symbols' sections; stays (s,) s."""
    guess = shot.guess
    system = guess.system
    h = shot.kantorovich
    inside = h < 0.5 and shot.lipschitz > 0
    radius = (1 - np.sqrt(1 - 2 * h)) / shot.lipschitz if inside and h > 1e-8 else shot.correction
    departure = np.max(np.abs(shot.states - guess.states) / system.scale)
    energies = system.numeric.hamiltonian(shot.states)
    multipliers = closed_multipliers(shot.stms, system.scale) if guess.closed else None
    return Certificate(
        residual=shot.residual,
        condition=shot.condition,
        kantorovich=h,
        radius=float(radius),
        energy_error=float(np.max(np.abs(energies - guess.energy))),
        departure=float(departure),
        stops=_stop_distances(shot, chain, nodes, len(stays)),
        multipliers=multipliers,
    )


def _stop_distances(shot: Shot, chain: Sequence[Connection], nodes: NDArray[np.intp], count: int) -> tuple[float, ...]:
    """Return the scaled distance of the nearest node to the periodic orbit of each stop."""
    curves: dict[str, OrbitCurve] = {}
    out = []
    for k in range(count):
        orbit = chain[k].target
        curve = curves.setdefault(orbit.saddle, OrbitCurve(orbit))
        last = nodes[k + 1] if k + 1 < len(nodes) else len(shot.states) - 1
        out.append(float(curve.distances(shot.states[nodes[k] : last + 1])[1].min()))
    return tuple(out)
