"""How far a solved orbit may be from a true one, as double precision can estimate it, and its multipliers.

With h = ω ‖Δx‖ < 1/2, ω the affine-invariant Lipschitz constant and Δx the last Newton step, a solution lies within
(1 - √(1 - 2h))/ω. Here ω is what one step showed and all is computed in double: an estimate, no proof.

A periodic orbit that shadows a walk of eight symbols has λ ≈ 1e100: its monodromy matrix holds nothing but λ_u in
double precision. The segments' matrices are small, and products of vectors through them keep their logarithms.

Source: Deuflhard, Newton Methods for Nonlinear Problems (2011), theorem 2.3 (Newton–Kantorovich in affine-covariant
form).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.orbits.curve import OrbitCurve
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.shooting.newton import Shot

Array = NDArray[np.float64]


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
class ErrorEstimate:
    """Lengths are scaled (largest component of a node's state, durations over the mean segment).

    condition: of the scaled Jacobian, 1-norm; kantorovich: h, None where no step was long enough to show ω; radius:
    within which the true orbit's nodes should lie, None where h ≥ 1/2; energy_error: largest over the nodes, in the
    energy's unit; departure: largest distance of a node from the guess; stops: distance from the periodic orbit at each
    stop's nearest node. multipliers: of a periodic orbit.
    """

    condition: float
    kantorovich: float | None
    radius: float | None
    energy_error: float
    departure: float
    stops: tuple[float, ...]
    multipliers: ClosedMultipliers | None


def estimate_error(shot: Shot, stops: Sequence[LyapunovOrbit]) -> ErrorEstimate:
    """Return the error estimate of a converged shot; stops: the periodic orbits after its marked nodes, in order."""
    guess, orbit = shot.guess, shot.orbit
    h = None if shot.lipschitz is None else shot.lipschitz * shot.correction
    # Without ω, and below rounding, the last step is what is known of the distance.
    radius: float | None = shot.correction
    if shot.lipschitz is not None and h is not None and h > 1e-8:
        radius = float((1 - np.sqrt(1 - 2 * h)) / shot.lipschitz) if h < 0.5 else None
    energies = guess.system.numeric.hamiltonian(orbit.states)
    return ErrorEstimate(
        condition=shot.condition,
        kantorovich=h,
        radius=radius,
        energy_error=float(np.max(np.abs(energies - guess.energy))),
        departure=float(np.max(np.abs(orbit.states - guess.states) / guess.system.scale)),
        stops=_stop_distances(shot, stops),
        multipliers=closed_multipliers(shot.stms, guess.system.scale) if guess.closed else None,
    )


def _stop_distances(shot: Shot, stops: Sequence[LyapunovOrbit]) -> tuple[float, ...]:
    """Return the scaled distance of the nearest node to the periodic orbit of each stop."""
    states, nodes = shot.orbit.states, sorted(shot.guess.markers)
    curves: dict[str, OrbitCurve] = {}
    out = []
    for first, last, orbit in zip(nodes, [*nodes[1:], len(states) - 1], stops, strict=False):
        curve = curves.setdefault(orbit.saddle, OrbitCurve(orbit))
        out.append(float(curve.distances(states[first : last + 1])[1].min()))
    return tuple(out)
