"""Where two curves in the plane cross or nearly touch: first guesses for Newton's method."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

Array = NDArray[np.float64]


def polyline_crossings(first: Array, second: Array) -> list[tuple[float, float]]:
    """Return (i + s, j + t) where segment i of `first` (K, 2) crosses segment j of `second` (L, 2).

    s and t in [0, 1) are the fractions along the segments.
    """
    a, b = first[:-1], second[:-1]
    da, db = np.diff(first, axis=0), np.diff(second, axis=0)
    found: list[tuple[float, float]] = []
    block = max(1, 2_000_000 // max(len(b), 1))
    for start in range(0, len(a), block):
        part = slice(start, start + block)
        cross = da[part, None, 0] * db[None, :, 1] - da[part, None, 1] * db[None, :, 0]
        gap = b[None, :, :] - a[part, None, :]
        with np.errstate(divide="ignore", invalid="ignore"):
            s = (gap[..., 0] * db[None, :, 1] - gap[..., 1] * db[None, :, 0]) / cross
            t = (gap[..., 0] * da[part, None, 1] - gap[..., 1] * da[part, None, 0]) / cross
        hits = (cross != 0) & (s >= 0) & (s < 1) & (t >= 0) & (t < 1)
        found += [(start + i + float(s[i, j]), j + float(t[i, j])) for i, j in np.argwhere(hits)]
    return found


def near_touches(first: Array, second: Array, *, within: float) -> list[tuple[float, float]]:
    """Return vertex pairs (i, j) where `first` passes `second` at a locally smallest distance below `within`.

    Curves that are almost tangent may cross twice between vertices without any segments crossing; these pairs are
    where that can happen.
    """
    distance, nearest = (np.asarray(a) for a in KDTree(second).query(first, distance_upper_bound=within))
    inside = np.isfinite(distance)
    before = np.r_[np.inf, distance[:-1]]
    after = np.r_[distance[1:], np.inf]
    lowest = inside & (distance <= before) & (distance <= after)
    return [(float(i), float(nearest[i])) for i in np.flatnonzero(lowest)]
