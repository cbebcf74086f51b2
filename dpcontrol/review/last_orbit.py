"""How far a run's last period was from the orbit that it was to end on: the worst angle, least over phase."""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.references.reference import Reference

Array = NDArray[np.float64]

NEAR_LAST_ORBIT = 0.1  # rad
_FEW = 1_000_000
"""Pairs of points whose distances are computed sooner than scipy.spatial is imported."""


def far_from_orbit(plan: Reference, orbit: int, angles: Array, *, ticks: float) -> float | None:
    """Return by how many rad angles (K, n) leave a plan's orbit, by its index; None where that is no more than allowed.

    ticks: how many the orbit's period takes. Infinite where the angles are no numbers.
    """
    if not np.isfinite(angles).all():
        return np.inf
    samples = plan.extra[f"orbit_{orbit}"][:, : angles.shape[1]]
    if _in_step(samples, angles, ticks=ticks) or _near(samples, angles):
        return None
    gap = float(_tree(plan, orbit, angles.shape[1]).query(angles, p=np.inf)[0].max())
    return gap if gap > NEAR_LAST_ORBIT else None


def _in_step(orbit: Array, angles: Array, *, ticks: float) -> bool:
    """Tell whether angles (K, n) stay near those (M, n) of an orbit, evenly spaced, as both go on at the same pace.

    The point of the same phase is no nearer than the nearest one, and much sooner found.
    """
    closed = max(len(orbit) - bool(np.abs(orbit[0] - orbit[-1]).max() < 1e-6), 1)
    first = int(np.argmin(np.abs(orbit - angles[0]).max(axis=1)))
    ahead = np.rint(np.arange(len(angles)) * (closed / ticks)).astype(np.intp)
    return bool(np.abs(orbit[(first + ahead) % closed] - angles).max() <= NEAR_LAST_ORBIT)


def _near(orbit: Array, angles: Array) -> bool:
    """Tell whether angles (K, n) stay near the points (M, n) themselves; between them they may be nearer still."""
    if len(orbit) * len(angles) > _FEW:
        return False
    apart = np.maximum.reduce([np.abs(angles[:, i, None] - orbit[:, i]) for i in range(orbit.shape[1])])
    return bool(apart.min(axis=1).max() <= NEAR_LAST_ORBIT)


@lru_cache(maxsize=4)
def _tree(plan: Reference, orbit: int, arms: int) -> Any:
    """Return the angles (M, n) on a plan's orbit as a tree, which is quicker by far than all distances."""
    # scipy.spatial is imported where it is used: it takes a tenth of a second.
    from scipy.spatial import KDTree

    return KDTree(_denser(plan.extra[f"orbit_{orbit}"][:, :arms], 8))


def _denser(closed: Array, factor: int) -> Array:
    """Return points (factor · M, n) on the closed polyline through (M, n)."""
    share = np.arange(factor)[:, None, None] / factor
    following = np.roll(closed, -1, axis=0)
    return (closed[None] * (1 - share) + following[None] * share).reshape(-1, closed.shape[1])
