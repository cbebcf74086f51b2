"""Find and name faults in samples of time and angles.

Faults are repaired only on request, by the table `REPAIRS`. Jumps, a false period and too few samples have no repair.

The next checks compare the samples with the mapping: units, columns, signs and zero. The rates must be the derivative
of the angles. If they are not, the factor between them reveals the mistake: 180/π a unit, -1 a sign. Gravity pulls arms
down, so the mean of θ̈ sin θ over a free swing is negative. A positive mean shows that the zero is upright.

The last check compares the recorded motion roughly with the arms of a model. Over windows of h = 20 ms the recorded
angles accelerate by (θ_{k+h} - 2 θ_k + θ_{k-h}) / h². The model accelerates by its equations at θ_k and
(θ_{k+h} - θ_{k-h}) / 2h, with the cart's motion as input. Encoders of step q blur the recorded value by q √(i/2) / h²
for arm i. If both differ by more than a third of their size, the recording is not of these arms. Possible causes are
exchanged columns, a stuck encoder, a wrong sign or a model of other arms.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter

from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.foundation.arrays import Array, true_runs
from dpcontrol.foundation.errors import InputError
from dpcontrol.recordings.recording import Recording, cart_motion, smoothed_derivative

ANGLE, RATE, CART, COMMAND = "angle", "rate", "the cart's position", "the command"
"""Kinds of columns; names of angle and rate columns end with the arm's number."""
FEWEST_SAMPLES = 20
_FILLED_IN_A_ROW = 10
_GAP = 1.5
"""Least number of periods in a time step with a missing sample."""
_UNEVEN = 0.2
"""Tolerance for the time of a sample, as a share of a period: clocks jitter by a few hundredths."""
_JUMP, _FASTEST_RATE = 0.3, 100.0
"""Limit of an arm's turn in one sample: `_JUMP` rad plus the turn at `_FASTEST_RATE` rad/s."""
_SPIKE = 10.0
"""Limit of a rate's distance from the median of five, rad/s; four times the change of any arm in two samples."""
_MOST_LEFT_OUT = 0.05

_LARGEST = 1e9
"""Limit of every measurement. A larger one is damage in any unit."""

Marks = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Samples:
    """K samples of a file in SI units and the package's directions, as checks and repairs receive them.

    Attributes:
        where: file and part, for messages.
        rows: (K,) sample numbers, from 1.
        time: (K,) s.
        values: (K, m) angles, then other measurements.
        names: (m,) column names: `ANGLE` 1, ….
    """

    where: str
    rows: NDArray[np.int64]
    time: Array
    values: Array
    names: tuple[str, ...]

    @property
    def arms(self) -> int:
        """Number of arms."""
        return sum(name.startswith(ANGLE) for name in self.names)

    def of(self, kind: str) -> Array | None:
        """Return the columns (K, …) of one kind, or None.

        Args:
            kind: beginning of the columns' names, for example `RATE`.
        """
        columns = [k for k, name in enumerate(self.names) if name.startswith(kind)]
        return self.values[:, columns] if columns else None

    def at(self, index: int) -> str:
        """Return "WHERE: row R (t = T s)", the place of a sample in error messages.

        Args:
            index: index of the sample, from 0.
        """
        return f"{self.where}: row {self.rows[index]} (t = {self.time[index]:.6g} s)"

    def taken(self, which: NDArray) -> "Samples":
        """Return some of the samples, with all their columns.

        Args:
            which: True for each chosen sample (K,), or their indices.
        """
        return replace(self, rows=self.rows[which], time=self.time[which], values=self.values[which])

    def cut(self, after: NDArray) -> "list[Samples]":
        """Return the pieces of the samples between cuts, in order.

        Args:
            after: indices of the samples after which to cut.
        """
        return [self.taken(piece) for piece in np.split(np.arange(len(self.time)), after + 1)]


@dataclass(frozen=True)
class Repair:
    """A fault of samples and its repair, an entry of `REPAIRS`.

    Attributes:
        help: what the repair does.
        fault: what is wrong with a sample, where {column} stands for the name of the column.
        note: what was done with the faulty rows.
        find: function of the samples and their period, s, or 0, that marks the faults (K,) or (K, m).
        mend: function of the samples, the marks (K, m) and the period that returns the segments after the repair.
        most: greatest share of faulty rows that is repaired.
    """

    help: str
    fault: str
    note: str
    find: Callable[[Samples, float], Marks]
    mend: Callable[[Samples, Marks, float], list[Samples]]
    most: float = 1.0


def _before_gap(samples: Samples, period: float) -> Marks:
    """Mark the samples (K,) before a gap in time, at which the repair "gaps" cuts the segment.

    `period` is the nominal period, s, or 0. If more than a twentieth of the steps are gaps, none is marked, because
    the sampling is then uneven, which the repair "sampling" corrects.

    Raises:
        InputError: the samples have another period than the mapping.
    """
    steps = np.diff(samples.time)
    spacing = float(np.median(steps))
    if period and not abs(spacing / period - 1) < _UNEVEN:
        raise InputError(
            f"{samples.where}: samples are {spacing:.6g} s apart, but the given period is {period:.6g} s; "
            "check the time's unit and the period"
        )
    gaps = np.append(steps > _GAP * spacing, False)
    # A short recording may have five gaps.
    return gaps & (gaps.sum() <= max(5, _MOST_LEFT_OUT * len(steps)))


def _wrapped(samples: Samples, period: float) -> Marks:
    """Mark the angles (K, n) that jump by a turn from the sample before, which the repair "wrap" unwraps.

    The arguments are those of `Repair.find`; the period is not needed.

    Raises:
        InputError: an angle jumps by another amount, which nothing can repair.
    """
    largest_turn = _JUMP + _FASTEST_RATE * np.diff(samples.time, prepend=samples.time[0])[:, None]
    angles = samples.values[:, : samples.arms]
    steps = np.abs(np.diff(angles, axis=0, prepend=angles[:1]))
    # Apart from the whole turn, the arm turned no further than it can in a sample; 1.5 rad limits long periods.
    wraps = np.abs(steps - 2 * np.pi) < np.minimum(largest_turn, 1.5)
    jumps = (steps > largest_turn) & ~wraps
    if jumps.any():
        row, arm = np.argwhere(jumps)[0]
        raise InputError(
            f"{samples.at(row)}: {samples.names[arm]} jumps by {steps[row, arm]:.3g} rad in one sample "
            f"({jumps.sum()} such jumps); check the unit (degrees taken for rad?), columns, sampling, or cut it there"
        )
    return wraps


def _unwrapped(values: Array, arms: int) -> Array:
    """Return the values (K, m) with the angles of the arms, the first columns, unwrapped."""
    return np.hstack([np.unwrap(values[:, :arms], axis=0), values[:, arms:]])


def _filled(samples: Samples, marks: Marks, period: float) -> list[Samples]:
    """Return the segments of samples with short holes filled by a cubic, cut at longer holes: the repair "nan".

    `marks` (K, m) are True for missing values. A sample with any of them counts as missing. If fewer than
    `FEWEST_SAMPLES` samples are complete, there are no segments. The arguments are those of `Repair.mend`; the period
    is not needed.
    """
    missing: Marks = np.asarray(marks.any(axis=1), dtype=bool)
    values = samples.values.copy()
    if (~missing).sum() < FEWEST_SAMPLES:
        return []
    finite = _unwrapped(values[~missing], samples.arms)
    # Filled angles have as many turns as the last known ones, in case these are wrapped.
    turns = (finite - values[~missing])[np.maximum(np.cumsum(~missing) - 1, 0)[missing]]
    # A cubic is used because over ten samples a swinging arm leaves a straight line by several counts.
    values[missing] = CubicSpline(samples.time[~missing], finite)(samples.time[missing]) - turns
    # Long holes, and those at the ends, are not filled.
    for first, end in true_runs(missing):
        missing[first:end] = end - first > _FILLED_IN_A_ROW or first == 0 or end == len(missing)
    filled = replace(samples, values=values)
    return [filled.taken(np.arange(first, end)) for first, end in true_runs(~missing)]


def _smooth(samples: Samples) -> Array:
    """Return the values (K, m) with medians of five as rates, by which outlying rates are found and replaced.

    The rates are the columns whose names begin with `RATE`.
    """
    rates = [name.startswith(RATE) for name in samples.names]
    return np.where(rates, median_filter(samples.values, size=(5, 1), mode="nearest"), samples.values)


def _grid(samples: Samples, period: float) -> tuple[Array, float]:
    """Return even times (K,), s, from the first time on, and their spacing, s, from the period or a fitted line."""
    rows = np.arange(len(samples.time))
    spacing = period or float(np.polyfit(rows, samples.time, 1)[0])
    return samples.time[0] + spacing * rows, spacing


def _uneven(samples: Samples, period: float) -> Marks:
    """Mark the samples (K,) whose step of time differs from the spacing, or whose time leaves the even grid.

    `period` is the nominal period, s, or 0.
    """
    grid, spacing = _grid(samples, period)
    step_errors = np.abs(np.diff(samples.time, append=samples.time[-1] + spacing) - spacing)
    drift = np.abs(samples.time - grid)
    return (step_errors > _UNEVEN * spacing) | (drift > max(_UNEVEN * spacing, 1e-4 * np.ptp(samples.time)))


def _interpolated(samples: Samples, marks: Marks, period: float) -> list[Samples]:
    """Return the samples at even times, interpolated by cubics: the repair "sampling".

    The arguments are those of `Repair.mend`; the marks are not needed.
    """
    grid, spacing = _grid(samples, period)
    even = grid[: int(np.ptp(samples.time) / spacing + 1e-6) + 1]
    rows = samples.rows[np.searchsorted(samples.time, even, side="right") - 1]
    return [replace(samples, rows=rows, time=even, values=CubicSpline(samples.time, samples.values)(even))]


REPAIRS = {
    "time": Repair(
        "drop samples without a time that is later than all before",
        "the time is missing or not later than before",
        "without a later time dropped",
        # A time that falls back permanently hides all rows after it.
        lambda samples, period: ~(samples.time > np.append(-np.inf, np.fmax.accumulate(samples.time)[:-1])),
        lambda samples, marks, period: [samples.taken(~marks[:, 0])],
        _MOST_LEFT_OUT,
    ),
    "nan": Repair(
        f"fill up to {_FILLED_IN_A_ROW} missing samples in a row, cut the segment at longer holes",
        f"{{column}} is not finite, or above {_LARGEST:g}",
        "filled between their neighbours, or cut out",
        lambda samples, period: ~(np.abs(samples.values) <= _LARGEST),
        _filled,
    ),
    "gaps": Repair(
        "cut the segment at missing samples",
        "samples are missing after it",
        "cut at a gap",
        _before_gap,
        lambda samples, marks, period: samples.cut(np.flatnonzero(marks)),
    ),
    "wrap": Repair(
        "unwrap angles that jump by a turn",
        "{column} jumps by a turn",
        "unwrapped",
        _wrapped,
        lambda samples, marks, period: [replace(samples, values=_unwrapped(samples.values, samples.arms))],
    ),
    "spikes": Repair(
        "replace an outlying rate by the median of its neighbours",
        "{column} is far from its neighbours",
        "with spikes replaced",
        lambda samples, period: np.abs(samples.values - _smooth(samples)) > _SPIKE,
        lambda samples, marks, period: [replace(samples, values=np.where(marks, _smooth(samples), samples.values))],
        _MOST_LEFT_OUT,
    ),
    "sampling": Repair(
        "interpolate to even times", "the sampling is uneven", "interpolated to even times", _uneven, _interpolated
    ),
}
"""Repair of each fault by its name, in the order of the checks."""


def sound_segments(samples: Samples, *, period: float, repairs: frozenset[str]) -> tuple[list[Samples], list[str]]:
    """Return the samples as faultless segments, and a sentence for each repair.

    Segments with fewer than `FEWEST_SAMPLES` samples, which a repair may leave, are dropped.

    Args:
        samples: one stretch of the recording.
        period: nominal period of the samples, s; 0 if only the times give it.
        repairs: permitted repairs, names of `REPAIRS`.

    Raises:
        InputError: a fault has no permitted repair, or none exists, and the error names row and time; too many rows
            have a fault; or no segment has enough samples.
    """
    segments, notes = [samples] if len(samples.time) >= FEWEST_SAMPLES else [], list[str]()
    for name, repair in REPAIRS.items():
        sound: list[Samples] = []
        for segment in segments:
            marks = repair.find(segment, period).reshape(len(segment.time), -1)
            if not marks.any():
                sound.append(segment)
                continue
            row, column = np.argwhere(marks)[0]
            count, fault_text = int(marks.any(axis=1).sum()), repair.fault.format(column=segment.names[column])
            fault = f"{segment.at(row)}: {fault_text} ({count} such rows)"
            if count > repair.most * len(marks):
                raise InputError(f"{fault}; too many to repair: check columns, units and sampling in the mapping")
            if name not in repairs:
                raise InputError(f"{fault}; correct the recording, or give --repair {name}: {repair.help}")
            pieces = repair.mend(segment, marks, period)
            usable_pieces = [piece for piece in pieces if len(piece.time) >= FEWEST_SAMPLES]
            sound += usable_pieces
            dropped = (
                f", and {len(pieces) - len(usable_pieces)} pieces of too few samples dropped"
                if usable_pieces != pieces
                else ""
            )
            notes.append(f"{samples.where}: {count} rows {repair.note}{dropped}")
        segments = sound
    if not segments:
        raise InputError(f"{samples.where} has too few samples: a segment needs {FEWEST_SAMPLES} or more")
    return segments, notes


_FASTEST = 80.0
"""Limit of the angle rate, rad/s, above any bench. A swing exceeds it if radians and degrees are confused."""
_AGREES = 0.15
"""Tolerance for the slope of derivative over rate, as a share of one: filters lag and damp."""
_FALLS_UP = 0.5
"""Correlation of the inner arm's acceleration with sin θ that indicates a wrong zero; free swings stay below -0.2."""
_MATCHES = 0.97
"""Least correlation of the rates with the angles' differences. Online filters pass; wrong columns reach 0.9."""
_LEAST_MOTION = 0.2
"""Least rate for these checks, rad/s; slower recordings are inconclusive."""
_WINDOW = 0.04
"""Window of the cubics that differentiate the angles, s; quantised angles have no derivative between two samples."""


def check_plausible(segments: Sequence[Samples], spacing: float, *, file: str) -> None:
    """Reject a recording that contradicts its mapping in units, columns, signs or zero.

    Args:
        segments: segments of the recording.
        spacing: time between samples, s.
        file: name of the file, for messages.

    Raises:
        InputError: reports the contradiction, its size and the likely cause.
    """
    angles = [segment.values[:, : segment.arms] for segment in segments]
    derivative = np.concatenate([smoothed_derivative(part, spacing, window=_WINDOW) for part in angles])
    high_rate = float(np.percentile(np.abs(derivative), 99))
    if high_rate > _FASTEST:
        raise InputError(
            f"{file}: the angles turn at {high_rate:.4g} rad/s, and no bench's arm does more than {_FASTEST:g}; "
            "check the unit of angles and time in the mapping (degrees taken for rad? counts? ms?)"
        )
    rates = [
        smoothed_derivative(part, spacing, 0, window=_WINDOW)
        for segment in segments
        if (part := segment.of(RATE)) is not None
    ]
    if rates:
        _compare(derivative, np.concatenate(rates), file=file)
    # With the cart clamped, gravity alone moves the arms.
    if segments[0].of(CART) is None and segments[0].of(COMMAND) is None:
        acceleration = np.concatenate([smoothed_derivative(part[:, 0], spacing, 2, window=_WINDOW) for part in angles])
        sine = np.sin(np.concatenate(angles)[:, 0])
        product_of_norms = float(np.linalg.norm(acceleration) * np.linalg.norm(sine))
        if product_of_norms > 1e-6 and float(acceleration @ sine) > _FALLS_UP * product_of_norms:
            raise InputError(
                f"{file}: the inner arm falls upward; the recording counts its angles from the other end: "
                "exchange 'hanging' and 'upright' as the mapping's zero"
            )


def _compare(derivative: Array, rates: Array, *, file: str) -> None:
    """Reject rates (W, n) that are not the `derivative` (W, n) of the angles, both rad/s, of all segments in sequence.

    Column k of both belongs to arm k. Every derivative is compared with every rate, so that swapped columns are
    recognised. An arm that hardly moves is not judged.

    Raises:
        InputError: names the likely cause: a unit, a sign or swapped columns.
    """
    # Below, entry (i, j) compares the derivative of angle i with rate j: as slopes by least squares, and correlations.
    rate_squares, products = np.sum(rates**2, axis=0), derivative.T @ rates
    derivative_squares = np.sum(derivative**2, axis=0)
    slopes = products / np.maximum(rate_squares, 1e-300)
    matches = np.abs(products) / np.maximum(np.sqrt(np.outer(derivative_squares, rate_squares)), 1e-300)
    agree = (matches > _MATCHES) & (np.abs(slopes - 1) < _AGREES)
    moving = np.maximum(derivative_squares, rate_squares) > _LEAST_MOTION**2 * len(rates)
    for arm in np.flatnonzero(moving & ~np.diag(agree)):
        reason = f"is {slopes[arm, arm]:.4g} times its rate; is a unit (degrees, turns, ms) or a sign wrong?"
        if matches[arm, arm] <= _MATCHES:
            matching_rates = "".join(f"; it is rate {rate + 1}" for rate in np.flatnonzero(agree[arm]))
            reason = (
                f"is not its rate (they correlate by {matches[arm, arm]:.2f}{matching_rates}); are columns swapped?"
            )
        raise InputError(f"{file}: the derivative of angle {arm + 1} {reason} Check the mapping")


_CONTRADICTS = 0.3
"""Limit of difference over size. Swings of the rig reach 0.02, arms of twice the length 0.4, exchanged columns 0.4
to 1.2, a constant angle 0.8."""
_BETTER = 3.0
"""Factor by which another column order must fit better to be suggested."""
_LEAST = 2.0
"""Least model acceleration for this check, rad/s²; below it recordings are inconclusive."""
_GATHERED, _LEFT_OVER = 0.5, 0.5
"""Least mean of exp(iθ) of an arm that swings about one angle, and least such angle, rad, that is no hanging arm's."""
_STEP = 0.02
"""Step of the differences of angles, s."""
_MOVES = 0.05
"""Range of an angle that counts as motion, rad."""


def constant_angles(recording: Recording) -> tuple[str, ...]:
    """Return a sentence on each constant angle, whose encoder may be disconnected, if others vary or all are constant.

    Args:
        recording: the recording.
    """
    ranges = np.ptp(recording.angles, axis=0)
    largest_range = float(ranges.max())
    return tuple(
        f"angle {arm + 1} is {recording.angles[0, arm]:g} rad in all {len(recording.time)} samples: is its encoder "
        "connected, and its column the right one?"
        for arm in range(recording.arms)
        if ranges[arm] == 0 and (largest_range == 0 or largest_range > _MOVES)
    )


def contradiction(recording: Recording, arms: ArmChainParameters, *, model: str) -> str:
    """Return a sentence on the contradiction between arms and recording, or "" if none is found.

    A recording in which the model's arms would hardly accelerate shows none. The sentence warns users who combine a
    recording with the model of another rig, and names the likely mistake.

    Args:
        recording: the recording.
        arms: arms of the model.
        model: name of the model, for messages.
    """
    if arms.count != recording.arms:
        return f"the recording has {recording.arms} arms and the model {model} {arms.count}; give the matching model"
    difference, measured, predicted = _difference(recording, arms, tuple(range(arms.count)))
    if difference < _CONTRADICTS or predicted.max() < _LEAST:
        return ""
    sizes_text = [" and ".join(f"{value:.3g}" for value in sizes) for sizes in (measured, predicted)]
    text = (
        f"the model {model} contradicts the recording: its arms would accelerate by {sizes_text[1]} rad/s² (rms), the "
        f"recorded ones accelerate by {sizes_text[0]}, and the difference is {difference:.2g} times as large as the "
        f"larger"
    )
    # Swings are about hanging, up to whole turns.
    mean_directions = np.mean(np.exp(1j * recording.angles), axis=0)
    off_hanging = np.flatnonzero(
        (np.abs(mean_directions) > _GATHERED) & (np.abs(np.angle(mean_directions)) > _LEFT_OVER)
    )
    if off_hanging.size:
        off_hanging_text = " and ".join(
            f"angle {arm + 1} swings about {np.angle(mean_directions[arm]):.2g} rad" for arm in off_hanging
        )
        return f"{text}; {off_hanging_text} instead of 0: is the mapping's zero what a hanging arm reads?"
    orders = {order: _difference(recording, arms, order)[0] for order in permutations(range(arms.count))}
    best_order = min(orders, key=lambda order: orders[order])
    if _BETTER * orders[best_order] < difference:
        as_read = ", ".join(str(arm + 1) for arm in best_order)
        return f"{text}; with the angles in the order {as_read} it is {orders[best_order]:.2g}: are columns exchanged?"
    return f"{text}; check columns, signs and zeros, or give the matching model"


def _difference(recording: Recording, arms: ArmChainParameters, order: tuple[int, ...]) -> tuple[float, Array, Array]:
    """Return the difference of recorded and predicted accelerations as a share of the larger, and both (n,), rad/s².

    Arm i is compared with angle `order[i]` of the recording, as if columns were exchanged. The accelerations are root
    mean squares over all windows; the blur of the encoders, see the head of this module, is subtracted from the
    difference. If no segment is longer than a window, all are zero.
    """
    rate, n = equations_of(arms, Level.CART).function(), arms.count
    stride = max(round(_STEP / recording.dt), 1)
    # Each row of `pairs` has the n recorded accelerations at a time, then the n predicted ones.
    step, pairs = stride * recording.dt, [np.zeros((0, 2 * n))]
    for part in recording.split():
        rows = np.arange(stride, len(part.time) - stride, max(stride // 2, 1))
        if not rows.size:
            continue
        before, middle, after = (part.angles[rows + shift][:, order] for shift in (-stride, 0, stride))
        # Angles and rates of the arms, then the cart's position, which has no effect, and its velocity.
        states = np.hstack([middle, (after - before) / (2 * step), np.zeros((len(rows), 2))])
        cart_accelerations = np.zeros(len(rows))
        if (cart := cart_motion(part)) is not None:
            states[:, -1] = cart.velocity[rows]
            cart_accelerations = (cart.velocity[rows + stride] - cart.velocity[rows - stride]) / (2 * step)
        rates = np.asarray(rate(states.T, cart_accelerations[None], arms.base()), dtype=float).T
        pairs.append(np.hstack([(after - 2 * middle + before) / step**2, rates[:, n : 2 * n]]))
    accelerations = np.concatenate(pairs)
    accelerations = accelerations[np.isfinite(accelerations).all(axis=1)]
    if not len(accelerations):
        return 0.0, np.zeros(n), np.zeros(n)
    measured, predicted, differences = (
        np.sqrt(np.mean(np.square(values), axis=0))
        for values in (accelerations[:, :n], accelerations[:, n:], accelerations[:, :n] - accelerations[:, n:])
    )
    # The steps of relative encoders add up in an outer arm's angle.
    changes = np.abs(np.diff(recording.angles, axis=0))
    steps = np.nan_to_num(np.min(changes, axis=0, where=changes > 1e-12, initial=np.inf), posinf=0.0)
    blur = steps * np.sqrt(0.5 * np.arange(1, n + 1)) / _STEP**2
    largest = max(float(np.linalg.norm(measured)), float(np.linalg.norm(predicted)), 1e-300)
    return np.sqrt(max(float(differences @ differences - blur @ blur), 0.0)) / largest, measured, predicted
