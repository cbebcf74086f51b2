"""What vouches for a shadowing orbit: numbers from which another can judge it without solving it again.

Source: Deuflhard, Newton Methods for Nonlinear Problems (2011), theorem 2.3 (Newton–Kantorovich in affine-covariant
form): with h = ω ‖Δx‖ < 1/2 a solution exists within (1 - √(1 - 2h))/ω of the iterate and is unique nearby.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.itineraries.closed import ClosedMultipliers, closed_multipliers
from dpcontrol.itineraries.shooting import Shot
from dpcontrol.tubes.connection import Connection
from dpcontrol.tubes.orbit_curve import OrbitCurve

Array = NDArray[np.float64]


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
