"""Series derived from a log for recordings and pictures: arms, errors with bands, lattice copies, modes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dpcontrol.logs import Mode, RunLog
from dpcontrol.review.context import OrbitCurve, ReviewContext

_TURN = 2 * np.pi
_LARGEST = 1e6
"""In rad, rad/s, m …: no run that is worth a look comes near, and drawing libraries fail far beyond."""


def shown_state(log: RunLog) -> tuple[NDArray[np.float64], str]:
    """Return the (N, 2n+2) state to draw and what it is: the plant's own where known, else the estimate."""
    return (log.estimate, "estimate") if log.truth is None else (log.truth, "plant")


def drawable(log: RunLog, context: ReviewContext) -> tuple[RunLog, ReviewContext]:
    """Return the run with nan for every number that no picture can show: a run gone wrong must be shown as well."""

    def cleaned(values: NDArray[np.float64]) -> NDArray[np.float64]:
        with np.errstate(invalid="ignore"):
            return np.where(np.abs(values) < _LARGEST, values, np.nan)

    shown = replace(
        log,
        measured=cleaned(log.measured),
        estimate=cleaned(log.estimate),
        reference=cleaned(log.reference),
        truth=None if log.truth is None else cleaned(log.truth),
        control={name: cleaned(values) for name, values in log.control.items()},
    )
    energy = None if context.energy is None else cleaned(np.asarray(context.energy, float))
    if energy is None or len(energy) != len(log.time) or not np.isfinite(energy).any():
        energy = None
    return shown, replace(context, energy=energy)


def time_range(log: RunLog) -> tuple[float, float]:
    """Return the first and the last time in s, at least one period of the loop apart."""
    return float(log.time[0]), max(float(log.time[-1]), float(log.time[0]) + 1 / log.rate_hz)


def pivot_positions(log: RunLog, states: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (K,) the pivot's position in m, zero without a cart."""
    return states[:, 2 * len(log.arm_lengths)] if log.has_cart else np.zeros(len(states))


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


def estimation_error(log: RunLog) -> NDArray[np.float64] | None:
    """Return (N, 2n+2) estimate minus truth, or None without truth."""
    return None if log.truth is None else log.estimate - log.truth


def sigmas(log: RunLog) -> NDArray[np.float64]:
    """Return (N, 2n+2) standard deviations of the estimate in state order."""
    return np.column_stack([log.control[f"sigma_{i + 1}"] for i in range(log.estimate.shape[1])])


def smoothed_nis(log: RunLog, *, window: int = 50) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return times (K,), means (K,) of the NIS over windows of ticks that have one, and two sigmas of such a mean.

    With a consistent filter the NIS of m measurements has mean m and variance 2m (chi-square), so that the mean
    over a window of w ticks has variance 2m/w.
    """
    nis = log.control["nis"]
    known = np.isfinite(nis)
    values, times = nis[known], log.time[known]
    count = len(values) // window
    if count < 1:
        return times, values, 2 * float(np.sqrt(2 * log.measured.shape[1]))
    kept = count * window
    means = values[:kept].reshape(count, window).mean(axis=1)
    moments = times[:kept].reshape(count, window).mean(axis=1)
    return moments, means, 2 * float(np.sqrt(2 * log.measured.shape[1] / window))


def mode_spans(log: RunLog) -> list[tuple[float, float, str]]:
    """Return start and end in s and the name of each stretch of constant mode."""
    modes = np.nan_to_num(log.control["mode"], nan=-1.0)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(modes) != 0) + 1])
    ends = np.concatenate([starts[1:], [len(modes) - 1]])
    return [
        (float(log.time[a]), float(log.time[b]), mode_name(float(modes[a]))) for a, b in zip(starts, ends, strict=True)
    ]


def mode_name(number: float) -> str:
    """Return the name of a mode, in lower case; "unknown mode" for a number that is none."""
    try:
        return Mode(int(number)).name.lower()
    except ValueError:
        return "unknown mode"


def lattice_copies(
    orbit: OrbitCurve, angles: NDArray[np.float64], *, arm: int, most: int = 12
) -> list[NDArray[np.float64]]:
    """Return copies (M, 2) of an orbit in one arm's phase plane, one at each lattice point that the motion visits.

    Args:
        orbit: the orbit.
        angles: (N,) the arm's unwrapped angle; rad.
        arm: from zero.
        most: the greatest number of copies, those visited longest.
    """
    arms = orbit.states.shape[1] // 2
    angle, rate = orbit.states[:, arm], orbit.states[:, arms + arm]
    centre = (angle.max() + angle.min()) / 2
    turns, visits = np.unique(np.rint((angles[np.isfinite(angles)] - centre) / _TURN), return_counts=True)
    chosen = turns[np.argsort(visits)[::-1][:most]]
    return [np.column_stack([angle + _TURN * turn, rate]) for turn in chosen]


def thinned(
    time: NDArray[np.float64], values: NDArray[np.float64], *, bins: int = 1500
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a curve that looks the same with at most two points, the least and the greatest, in each of `bins`."""
    size = len(time) // bins
    if size < 3:
        return time, values
    kept = len(time) // size * size
    block = np.where(np.isfinite(values[:kept]), values[:kept], 0.0).reshape(-1, size)
    ends = np.sort(np.stack([block.argmin(axis=1), block.argmax(axis=1)], axis=1), axis=1)
    chosen = np.unique(np.concatenate([(ends + size * np.arange(len(block))[:, None]).ravel(), [len(time) - 1]]))
    return time[chosen], values[chosen]


def film_times(context: ReviewContext, time: NDArray[np.float64], *, frames: int) -> NDArray[np.float64]:
    """Return (frames,) instants for a filmstrip, shared out among the symbols' crossings; without any, evenly spread.

    Around a crossing they span a third of the period of a simple pendulum as long as all arms, on either side.
    """
    moments = np.array([moment for moment, _ in context.symbols if time[0] <= moment <= time[-1]])
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


def energy_range(values: NDArray[np.float64], saddle_energies: dict[str, float]) -> tuple[float, float]:
    """Return a range that holds the energy and the nearest saddle's level below and above it.

    The energy's extremes are left out: they are those of the first instants, with the initial error.
    """
    low, high = (float(value) for value in np.nanquantile(values, [0.005, 0.995]))
    below = [level for level in saddle_energies.values() if level <= low]
    above = [level for level in saddle_energies.values() if level >= high]
    low, high = max(below, default=low), min(above, default=high)
    return padded(np.array([low, high]))
