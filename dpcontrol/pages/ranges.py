"""Ranges of axes and times, and rows that suffice for curves."""

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.run_view import RunView

Range = tuple[float, float]


def gap_times(view: RunView) -> Array:
    """Return the middle of each gap in a view's ticks, s."""
    return (view.time[view.breaks] + view.time[view.breaks - 1]) / 2


def spans(time: Array, flags: NDArray[np.bool_]) -> list[Range]:
    """Return start and end in s of each stretch with true flags.

    A stretch lasts at least a tick.

    Args:
        time: (N,) s.
        flags: (N,) bool.
    """
    padded_flags = np.concatenate([[False], flags, [False]])
    edges = np.flatnonzero(padded_flags[1:] != padded_flags[:-1])
    return [(float(time[a]), float(time[min(b, len(time) - 1)])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def extreme_rows(values: Array, *, bins: int) -> NDArray[np.int64]:
    """Return the rows of the extremes of values (N,) in `bins`.

    The last row is included. Few values are all returned.

    Args:
        values: (N,) in any unit.
        bins: number of bins.
    """
    size = len(values) // bins
    if size < 3:
        return np.arange(len(values))
    kept = len(values) // size * size
    block = values[:kept].reshape(-1, size)
    if not np.isfinite(block).all():
        block = np.where(np.isfinite(block), block, 0.0)
    ends = np.sort(np.stack([block.argmin(axis=1), block.argmax(axis=1)], axis=1), axis=1)
    return np.unique(np.concatenate([(ends + size * np.arange(len(block))[:, None]).ravel(), [len(values) - 1]]))


def padded(values: Array) -> Range:
    """Return the range of finite `values`, extended by a tenth."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    margin = 0.1 * (high - low) or 0.1 * abs(high) or 1e-3
    return low - margin, high + margin
