"""A reference: what the bench shall do, as polynomials on a mesh, and how good it is.

State: the polynomial of degree K through the interval's start and its K points. Input: of degree K - 1 through the
points. Both are evaluated in barycentric form (Berrut & Trefethen, SIAM Review 46 (2004), eq. 4.2).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.references.method import Method, interpolation_matrix
from dpcontrol.references.problem import Limits

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Reference:
    """A trajectory of pendulum and cart, with its input, to be tracked.

    mesh (N+1,) s; method; states (N, K+1, nx) at each interval's start and points; inputs (N, K, nu) at the
    points, cart acceleration in m/s²; limits it was made for. status: a sentence; converged: whether it may be
    used. max_error_between_nodes: scaled, infinite where it was not measured; constraint_violation: scaled, at
    the nodes; max_cart_… in m, m/s, m/s², between nodes too; iterations of the solver in all; solve_seconds.
    extra: arrays, and notes: JSON values, that the caller stores with it.
    """

    mesh: Array
    method: Method
    states: Array
    inputs: Array
    limits: Limits
    status: str
    converged: bool
    max_error_between_nodes: float
    constraint_violation: float
    max_cart_position: float
    max_cart_velocity: float
    max_cart_acceleration: float
    rms_cart_acceleration: float
    iterations: int
    solve_seconds: float
    extra: Mapping[str, Array] = field(default_factory=lambda: MappingProxyType({}))
    notes: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def duration(self) -> float:
        """Return its length in s."""
        return float(self.mesh[-1] - self.mesh[0])

    @property
    def residual(self) -> float:
        """Return the larger of error between nodes and constraint violation (scaled)."""
        return max(self.max_error_between_nodes, self.constraint_violation)

    @property
    def stats(self) -> dict[str, float]:
        """Return the cost of finding it."""
        return {
            "intervals": len(self.mesh) - 1,
            "iterations": self.iterations,
            "solve_seconds": self.solve_seconds,
        }

    def _evaluate(self, times: ArrayLike, points: Array, values: Array) -> Array:
        at = np.clip(np.asarray(times, dtype=float), self.mesh[0], self.mesh[-1])
        flat = at.ravel()
        index = np.clip(np.searchsorted(self.mesh, flat, side="right") - 1, 0, len(self.mesh) - 2)
        tau = (flat - self.mesh[index]) / (self.mesh[index + 1] - self.mesh[index])
        rows = interpolation_matrix(points, tau)
        return np.einsum("mk,mkn->mn", rows, values[index]).reshape(*at.shape, -1)

    def state(self, times: ArrayLike) -> Array:
        """Return states (…, nx) at `times` (…) s; times outside count as the nearest end."""
        return self._evaluate(times, self.method.support, self.states)

    def input(self, times: ArrayLike) -> Array:
        """Return inputs (…, nu) at `times` (…) s; times outside count as the nearest end."""
        return self._evaluate(times, self.method.points, self.inputs)
