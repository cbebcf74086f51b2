"""Poincaré sections, and where trajectories meet them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Section:
    """A Poincaré section n·x = offset (+ period · k where the coordinate is an angle), and coordinates on it.

    normal, position (N,): n and the row that gives the section's coordinate q = position · x. momentum (n,): the
    combination of canonical momenta conjugate to q. period: of n·x, or None on a line. side: (N,) and the
    crossing counts only where side · x > 0, or None.
    """

    name: str
    normal: tuple[float, ...]
    position: tuple[float, ...]
    momentum: tuple[float, ...]
    offset: float = 0.0
    period: float | None = None
    side: tuple[float, ...] | None = None

    def height(self, states: Array) -> Array:
        """Return n·x - offset for states (…, N): zero, or a multiple of the period, on the section."""
        return np.asarray(states) @ np.asarray(self.normal) - self.offset

    def admits(self, state: Array) -> bool:
        """Tell whether a crossing at `state` (N,) counts."""
        return self.side is None or float(np.dot(self.side, state)) > 0


@dataclass(frozen=True)
class Crossing:
    """Where a trajectory met a section: state (N,), time in s. None in its place means it never did."""

    state: Array
    time: float
