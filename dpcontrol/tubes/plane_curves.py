"""Where two curves in the plane cross or nearly touch: first guesses for Newton's method."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

Array = NDArray[np.float64]

_BLOCK = 32
"""Segments of the first curve at a time: compared only with those of the second that their box meets."""


def polyline_crossings(first: Array, second: Array) -> list[tuple[float, float]]:
    """Return (i + s, j + t) where segment i of `first` (K, 2) crosses segment j of `second` (L, 2).

    s and t in [0, 1) are the fractions along the segments.
    """
    a, b = first[:-1], second[:-1]
    da, db = np.diff(first, axis=0), np.diff(second, axis=0)
    low, high = np.minimum(b, second[1:]), np.maximum(b, second[1:])
    # Wider than rounding can move a crossing.
    margin = 1e-9 * max(float(np.abs(first).max(initial=0.0)), float(np.abs(second).max(initial=0.0)))
    found: list[tuple[float, float]] = []
    for start in range(0, len(a), _BLOCK):
        part = slice(start, start + _BLOCK)
        box = first[start : start + _BLOCK + 1]
        near = np.flatnonzero(((low <= box.max(axis=0) + margin) & (high >= box.min(axis=0) - margin)).all(axis=1))
        if not near.size:
            continue
        cross = da[part, None, 0] * db[None, near, 1] - da[part, None, 1] * db[None, near, 0]
        gap = b[None, near, :] - a[part, None, :]
        with np.errstate(divide="ignore", invalid="ignore"):
            s = (gap[..., 0] * db[None, near, 1] - gap[..., 1] * db[None, near, 0]) / cross
            t = (gap[..., 0] * da[part, None, 1] - gap[..., 1] * da[part, None, 0]) / cross
        hits = (cross != 0) & (s >= 0) & (s < 1) & (t >= 0) & (t < 1)
        found += [(start + i + float(s[i, j]), int(near[j]) + float(t[i, j])) for i, j in np.argwhere(hits)]
    return found


def near_touches(first: Array, second: Array, *, margin: float = 4.0) -> list[tuple[float, float]]:
    """Return vertex pairs (i, j) where two sampled curves come so near that they may touch between their vertices.

    A smooth curve leaves its polyline by about an eighth of the second difference of its vertices (the sagitta). Where
    `first` passes `second` at a locally smallest distance within `margin` times both sagittas, the curves may cross
    twice although no segments do.
    """
    if len(first) < 3 or len(second) < 3:
        return []
    tree = KDTree(second)
    nearest = np.clip(np.asarray(tree.query(first)[1]), 1, len(second) - 2)
    distance = np.minimum(
        _to_segment(first, second[nearest - 1], second[nearest]),
        _to_segment(first, second[nearest], second[nearest + 1]),
    )
    allowed = margin * (_sagitta(first) + _sagitta(second)[nearest])
    before = np.r_[np.inf, distance[:-1]]
    after = np.r_[distance[1:], np.inf]
    lowest = (distance <= allowed) & (distance <= before) & (distance <= after)
    return [(float(i), float(nearest[i])) for i in np.flatnonzero(lowest)]


def _sagitta(curve: Array) -> Array:
    """Return an eighth of the second difference at each vertex (K,), the ends taking their neighbours'."""
    inner = np.linalg.norm(curve[:-2] - 2 * curve[1:-1] + curve[2:], axis=1) / 8
    return np.r_[inner[:1], inner, inner[-1:]]


def _to_segment(points: Array, start: Array, end: Array) -> Array:
    """Return the distance (K,) of each point (K, 2) to its segment."""
    along = end - start
    length = np.maximum(np.sum(along**2, axis=1), np.finfo(float).tiny)
    share = np.clip(np.sum((points - start) * along, axis=1) / length, 0.0, 1.0)
    return np.linalg.norm(points - start - share[:, None] * along, axis=1)
