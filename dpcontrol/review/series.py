"""Series derived from a motion for recordings and pictures: arms, means of the NIS, lattice copies, modes."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from dpcontrol.logs import Mode
from dpcontrol.review.context import ReviewContext
from dpcontrol.review.motion import LARGEST, Motion

Array = NDArray[np.float64]

NIS_LOST = 10.0
"""Times the expected NIS: beyond, an estimate is lost."""
_TURN = 2 * np.pi


def arm_points(angles: NDArray[np.float64], arm_lengths: Sequence[float]) -> NDArray[np.float64]:
    """Return the pivot, the elbows and the tip, seen from the pivot, x right and y up.

    Args:
        angles: (K, n) absolute, from hanging, counter-clockwise; rad.
        arm_lengths: (n,) in m.

    Returns:
        (K, n+1, 2) in m.
    """
    lengths = np.asarray(arm_lengths)
    steps = np.stack([np.sin(angles), -np.cos(angles)], axis=-1) * lengths[:, None]
    return np.concatenate([np.zeros((len(angles), 1, 2)), np.cumsum(steps, axis=1)], axis=1)


def smoothed_nis(motion: Motion, *, window: int = 50) -> tuple[Array, Array, float]:
    """Return times (K,), means (K,) of the NIS over windows of ticks that have one, and two sigmas of such a mean.

    With a consistent filter the NIS of m measurements has mean m and variance 2m (chi-square), so that the mean
    over a window of w ticks has variance 2m/w.
    """
    nis = np.full(len(motion.time), np.nan) if motion.nis is None else motion.nis
    known = np.isfinite(nis)
    values, times = nis[known], motion.time[known]
    count = len(values) // window
    if count < 1:
        return times, values, 2 * float(np.sqrt(2 * motion.sensors))
    kept = count * window
    means = values[:kept].reshape(count, window).mean(axis=1)
    moments = times[:kept].reshape(count, window).mean(axis=1)
    return moments, means, 2 * float(np.sqrt(2 * motion.sensors / window))


def spans(time: Array, flags: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return start and end in s of each stretch of ticks at which (N,) `flags` hold, a tick's width at least."""
    padded_flags = np.concatenate([[False], flags, [False]])
    edges = np.flatnonzero(padded_flags[1:] != padded_flags[:-1])
    return [(float(time[a]), float(time[min(b, len(time) - 1)])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def mode_spans(motion: Motion) -> list[tuple[float, float, str]]:
    """Return start and end in s and the name of each stretch of constant mode."""
    if motion.control is None or "mode" not in motion.control:
        return []
    modes = np.nan_to_num(motion.control["mode"], nan=-1.0)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(modes) != 0) + 1])
    ends = np.concatenate([starts[1:], [len(modes) - 1]])
    return [
        (float(motion.time[a]), float(motion.time[b]), mode_name(float(modes[a])))
        for a, b in zip(starts, ends, strict=True)
    ]


@cache
def mode_name(number: float) -> str:
    """Return the name of a mode, in lower case; "unknown mode" for a number that is none."""
    try:
        return Mode(int(number)).name.lower()
    except ValueError:
        return "unknown mode"


def thinned(time: Array, values: Array, *, bins: int = 1500) -> tuple[Array, Array]:
    """Return a curve that looks the same with at most two points, the least and the greatest, in each of `bins`."""
    chosen = telling_rows(values, bins=bins)
    return time[chosen], values[chosen]


def telling_rows(values: Array, *, bins: int) -> NDArray[np.int64]:
    """Return the rows of the least and the greatest of values (N,) in each of `bins`, and the last; all where few."""
    size = len(values) // bins
    if size < 3:
        return np.arange(len(values))
    kept = len(values) // size * size
    block = values[:kept].reshape(-1, size)
    if not np.isfinite(block).all():
        block = np.where(np.isfinite(block), block, 0.0)
    ends = np.sort(np.stack([block.argmin(axis=1), block.argmax(axis=1)], axis=1), axis=1)
    return np.unique(np.concatenate([(ends + size * np.arange(len(block))[:, None]).ravel(), [len(values) - 1]]))


def curve(motion: Motion, values: Array) -> tuple[Array, Array]:
    """Return a series (N,) of a motion, thinned, with nan in its gaps so that no line is drawn across them."""
    time, shown = thinned(motion.time, values)
    if not len(motion.breaks):
        return time, shown
    gaps = (motion.time[motion.breaks] + motion.time[motion.breaks - 1]) / 2
    places = np.searchsorted(time, gaps)
    return np.insert(time, places, gaps), np.insert(shown, places, np.nan)


def film_times(context: ReviewContext, time: Array, *, frames: int) -> Array:
    """Return (frames,) instants for a filmstrip, shared out among the symbols' crossings; without any, evenly spread.

    Around a crossing they span a third of the period of a simple pendulum as long as all arms, on either side. Of a run
    that went wrong the last quarter of the frames shows how it ended.
    """
    if context.good is False and frames > 3 and time[-1] > time[0]:
        last = frames // 4
        # Of a run that ended at once no more than its share.
        length = min(0.2 * last, (time[-1] - time[0]) * last / frames)
        ending = np.linspace(time[-1] - length, time[-1], last + 1)
        before = film_times(replace(context, good=None), time[time <= ending[0]], frames=frames - last)
        return np.concatenate([before, ending[1:]])
    actual = (*context.crossings, *[None] * len(context.symbols))
    moments = np.array([done or planned for (planned, _), done in zip(context.symbols, actual, strict=False)])
    moments = moments[(moments >= time[0]) & (moments <= time[-1])] if len(moments) else moments
    if not len(moments):
        return np.linspace(time[0], time[-1], frames)
    moments = moments[np.linspace(0, len(moments) - 1, min(len(moments), frames)).astype(int)]
    half = 0.33 * _TURN * np.sqrt(sum(context.arm_lengths) / 9.81)
    parts = []
    for i, moment in enumerate(moments):
        share = frames // len(moments) + (i < frames % len(moments))
        parts.append(
            moment + half * np.linspace(-1, 1, share)
            if share > 2
            else np.linspace(moment - half / 2, moment, share + 1)[1:]
        )
    return np.sort(np.clip(np.concatenate(parts), time[0], time[-1]))


def padded(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return the least and the greatest of finite `values`, with a tenth of their distance to either side."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    margin = 0.1 * (high - low) or 0.1 * abs(high) or 1e-3
    return low - margin, high + margin


def energy_of(motion: Motion, context: ReviewContext) -> Array | None:
    """Return (N,) the energy in J with nan where no picture can show it, or None where it is not known."""
    energy = None if context.energy is None else np.asarray(context.energy, dtype=float)
    if energy is None or len(energy) != len(motion.time) or not np.isfinite(energy).any():
        return None
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(energy) < LARGEST, energy, np.nan)


def error_reach(motion: Motion) -> float:
    """Return how far an estimation error's axis must reach, in rad; the first instants' large errors are left out."""
    parts = [] if motion.sigma is None else [2 * motion.sigma[:, : motion.arms]]
    parts += [] if motion.error is None else [np.abs(motion.error[:, : motion.arms])]
    finite = [part[np.isfinite(part)] for part in parts]
    most = max((1.6 * float(np.quantile(part, 0.97)) for part in finite if part.size), default=0.0)
    return most if most > 0 else 1e-6


def energy_range(values: NDArray[np.float64], saddle_energies: dict[str, float]) -> tuple[float, float]:
    """Return a range that holds the energy and the nearest saddle's level below and above it.

    The energy's extremes are left out: they are those of the first instants, with the initial error.
    """
    low, high = (float(value) for value in np.nanquantile(values, [0.005, 0.995]))
    below = [level for level in saddle_energies.values() if level <= low]
    above = [level for level in saddle_energies.values() if level >= high]
    low, high = max(below, default=low), min(above, default=high)
    return padded(np.array([low, high]))
