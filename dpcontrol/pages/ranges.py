"""Ranges of axes and times, and rows that suffice for curves."""

import math

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


_LABELLED = 5.5
"""Greatest number of labels on a plot of the viewer; with more steps only every tenth is labelled."""
_EDGE = 0.06
"""Share of a plot at its edges that truncates labels."""


def ticked(low: float, high: float) -> Range:
    """Return bounds near these with at least two labels.

    The viewer labels multiples of a power of ten.

    The bound is extended to the nearer next multiple, or to both if they are equally near.

    Args:
        low: lower bound, in any unit.
        high: upper bound, in the same unit.
    """
    step = 10.0 ** math.ceil(math.log10(max(high - low, 1e-12) / _LABELLED))
    margin = _EDGE * (high - low)
    first, last = math.ceil((low + margin) / step), math.floor((high - margin) / step)
    if last > first:
        return low, high
    if last < first:
        first, last = last, first
    else:
        down, up = low - (first - 1) * step, (last + 1) * step - high
        first, last = first - (down < 1.01 * up), last + (up < 1.01 * down)
    margin = _EDGE * (max(high, last * step) - min(low, first * step))
    return min(low, first * step - margin), max(high, last * step + margin)


def padded(values: Array) -> Range:
    """Return the range of finite `values`, extended by a tenth."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    margin = 0.1 * (high - low) or 0.1 * abs(high) or 1e-3
    return low - margin, high + margin
