"""Find and name faults in samples of time and angles.

Faults are repaired only on request.

Samples are first checked for time that is missing, repeats or runs backward (time), values that are not finite (nan)
and missing samples (gaps). Then follow angles wrapped into one turn (wrap), outlying rates (spikes) and uneven sampling
(sampling). Jumps and too few samples cannot be repaired and are rejected.

The next checks compare the samples with the mapping: units, columns, signs and zero. The rates must be the derivative
of the angles. If they are not, the factor between them reveals the mistake: 180/π a unit, -1 a sign. Gravity pulls arms
down, so the mean of θ̈ sin θ over a free swing is negative. A positive mean shows that the zero is upright.

The last check compares the recorded motion roughly with the arms of a model. Over windows of h = 20 ms the recorded
angles accelerate by (θ_{k+h} - 2 θ_k + θ_{k-h}) / h². The model accelerates by its equations at θ_k and
(θ_{k+h} - θ_{k-h}) / 2h, with the cart's motion as input. Encoders of step q blur the recorded value by q √(i/2) / h²
for arm i. If both differ by more than a third of their size, the recording is not of these arms. Possible causes are
exchanged columns, a stuck encoder, a wrong sign or a model of other arms.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import suggest
from dpcontrol.foundation.shown import Brief
from dpcontrol.recordings.recording import Recording, cart_motion

REPAIRS = {
    "nan": "fill up to 10 missing samples in a row, cut the segment at longer holes",
    "time": "drop samples without a time that is later than all before",
    "gaps": "cut the segment at missing samples",
    "sampling": "interpolate to even times",
    "wrap": "unwrap angles that jump by a turn",
    "spikes": "replace an outlying rate by the median of its neighbours",
}
"""Description of each repair, by name."""

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


@dataclass(frozen=True, eq=False)
class Samples(Brief):
    """K samples of a file in SI units and the package's directions.

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
        """Return "WHERE: row R (t = T s)" for a message.

        Args:
            index: index of the sample, from 0.
        """
        return f"{self.where}: row {self.rows[index]} (t = {self.time[index]:.6g} s)"

    def taken(self, which: NDArray) -> "Samples":
        """Return some of the samples.

        Args:
            which: True for each chosen sample (K,), or their indices.
        """
        return replace(self, rows=self.rows[which], time=self.time[which], values=self.values[which])


@dataclass(frozen=True)
class _Fault:
    """A fault: name of its repair, the sentence on it, the repaired segments, and the note on the repair."""

    repair: str
    sentence: str
    repaired: Sequence[Samples]
    note: str


def checked_repairs(names: tuple[str, ...]) -> frozenset[str]:
    """Return the requested repairs.

    Args:
        names: names of repairs, see `REPAIRS`.

    Raises:
        InputError: a name is unknown.
    """
    for name in names:
        if name not in REPAIRS:
            raise InputError(f"--repair {name}: there is no such repair; {suggest(name, REPAIRS)}")
    return frozenset(names)


def sound_segments(samples: Samples, *, period: float, repairs: frozenset[str]) -> tuple[list[Samples], list[str]]:
    """Return the samples as faultless segments, and a sentence for each repair.

    Args:
        samples: one stretch of the recording.
        period: nominal period of the samples, s; 0 if only the times give it.
        repairs: permitted repairs, names of `REPAIRS`.

    Raises:
        InputError: a fault has no permitted repair, or none exists; names row and time.
    """
    segments, notes = [samples], []
    for check in (_forward, partial(_finite, unwraps="wrap" in repairs), _whole, _continuous, _steady, _even):
        sound: list[Samples] = []
        for segment in segments:
            fault = check(segment, period) if len(segment.time) >= FEWEST_SAMPLES else None
            if fault is not None and fault.repair not in repairs:
                remedy = f"give --repair {fault.repair}: {REPAIRS[fault.repair]}"
                raise InputError(f"{fault.sentence}; correct the recording, or {remedy}")
            sound += [segment] if fault is None else fault.repaired
            notes += [] if fault is None else [f"{samples.where}: {fault.note}"]
        segments = sound
    usable = [segment for segment in segments if len(segment.time) >= FEWEST_SAMPLES]
    if not usable:
        raise InputError(f"{samples.where} has {len(samples.time)} samples; a segment needs {FEWEST_SAMPLES} or more")
    if len(usable) < len(segments):
        notes.append(f"{samples.where}: {len(segments) - len(usable)} pieces of too few samples dropped")
    return usable, notes


def _first(which: NDArray[np.bool_]) -> tuple[int, int]:
    """Return row and column of the first true entry of (K, m)."""
    row, column = np.unravel_index(int(np.argmax(which)), which.shape)
    return int(row), int(column)


def _runs(which: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return (first, end) of each run of true entries."""
    return np.flatnonzero(np.diff(np.concatenate([[False], which, [False]]).astype(np.int8))).reshape(-1, 2)


def _forward(samples: Samples, period: float) -> _Fault | None:
    # A time that falls back permanently hides all rows after it.
    behind = ~(samples.time > np.concatenate([[-np.inf], np.fmax.accumulate(samples.time)[:-1]]))
    if not behind.any():
        return None
    fault = (
        f"{samples.at(int(np.argmax(behind)))}: the time is missing or not later than before ({behind.sum()} such rows)"
    )
    if behind.mean() > _MOST_LEFT_OUT:
        raise InputError(f"{fault}; too many to drop: give [sampling] period in place of the time column")
    return _Fault("time", fault, [samples.taken(~behind)], f"{behind.sum()} rows without a later time dropped")


def _finite(samples: Samples, period: float, *, unwraps: bool) -> _Fault | None:
    bad = ~np.isfinite(samples.values)
    if not bad.any():
        return None
    index, column = _first(bad)
    rows: NDArray[np.bool_] = np.asarray(bad.any(axis=1), dtype=bool)
    fault = f"{samples.at(index)}: {samples.names[column]} is not finite ({rows.sum()} such rows)"
    if (~rows).sum() < FEWEST_SAMPLES:
        raise InputError(f"{fault}; too few rows are left")
    values, keep = samples.values.copy(), np.ones(len(rows), bool)
    for first, end in _runs(rows):
        keep[first:end] = end - first <= _FILLED_IN_A_ROW and first > 0 and end < len(rows)
    if unwraps:
        values[~rows, : samples.arms] = np.unwrap(values[~rows, : samples.arms], axis=0)
    # A cubic is used because over ten samples a swinging arm leaves a straight line by several counts.
    values[rows] = _cubic(samples.time[~rows], values[~rows], samples.time[rows])
    mended, filled = replace(samples, values=values), int((rows & keep).sum())
    note = f"{filled} rows filled between their neighbours, {rows.sum() - filled} dropped"
    return _Fault("nan", fault, [mended.taken(np.arange(first, end)) for first, end in _runs(keep)], note)


def _cubic(times: Array, values: Array, at: Array) -> Array:
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(times, values)(at))


def _whole(samples: Samples, period: float) -> _Fault | None:
    steps = np.diff(samples.time)
    spacing = float(np.median(steps))
    if period and not abs(spacing / period - 1) < _UNEVEN:
        raise InputError(
            f"{samples.where}: samples are {spacing:.6g} s apart, but the given period is {period:.6g} s; "
            "check the time's unit and the period"
        )
    gaps = np.flatnonzero(steps > _GAP * spacing)
    if not len(gaps):
        return None
    fault = (
        f"{samples.at(int(gaps[0]))}: the next sample comes {steps[gaps[0]]:.6g} s later, not {spacing:.6g} s "
        f"({len(gaps)} such gaps)"
    )
    if len(gaps) > max(5, _MOST_LEFT_OUT * len(steps)):
        return _Fault("sampling", fault, [samples], "has steps of many lengths")
    pieces = np.split(np.arange(len(samples.time)), gaps + 1)
    return _Fault("gaps", fault, [samples.taken(piece) for piece in pieces], f"cut at {len(gaps)} gaps")


def _steady(samples: Samples, period: float) -> _Fault | None:
    from scipy.ndimage import median_filter

    columns = [k for k, name in enumerate(samples.names) if name.startswith(RATE)]
    rates = samples.values[:, columns]
    median = median_filter(rates, size=(5, 1), mode="nearest") if columns else rates
    spikes = np.abs(rates - median) > _SPIKE
    if not spikes.any():
        return None
    index, column = _first(spikes)
    fault = (
        f"{samples.at(index)}: {samples.names[columns[column]]} is {rates[index, column]:.4g} rad/s among "
        f"{median[index, column]:.4g} ({spikes.sum()} such spikes)"
    )
    if spikes.mean() > _MOST_LEFT_OUT:
        raise InputError(f"{fault}; these are not rates: check unit and columns")
    values = samples.values.copy()
    values[:, columns] = np.where(spikes, median, rates)
    return _Fault("spikes", fault, [replace(samples, values=values)], f"{spikes.sum()} spikes of rates replaced")


def _even(samples: Samples, period: float) -> _Fault | None:
    spacing = period or float(np.polyfit(np.arange(len(samples.time)), samples.time, 1)[0])
    grid = samples.time[0] + spacing * np.arange(len(samples.time))
    off = np.abs(np.diff(samples.time) - spacing)
    drift = np.abs(samples.time - grid)
    worst = int(np.argmax(off))
    if off[worst] <= _UNEVEN * spacing and drift.max() <= max(_UNEVEN * spacing, 1e-4 * np.ptp(samples.time)):
        return None
    fault = f"{samples.at(worst)}: the step of time there is {off[worst]:.3g} s off {spacing:.6g} s: uneven sampling"
    inside = grid[: int((samples.time[-1] - samples.time[0]) / spacing + 1e-6) + 1]
    even = _cubic(samples.time, samples.values, inside)
    rows = samples.rows[np.searchsorted(samples.time, inside, side="right") - 1]
    repaired = replace(samples, rows=rows, time=inside, values=even)
    return _Fault("sampling", fault, [repaired], "interpolated to even times")


def _continuous(samples: Samples, period: float) -> _Fault | None:
    most = _JUMP + _FASTEST_RATE * np.diff(samples.time)[:, None]
    steps = np.diff(samples.values[:, : samples.arms], axis=0)
    wraps = np.abs(np.abs(steps) - 2 * np.pi) < np.minimum(most, 1.5)
    jumps = (np.abs(steps) > most) & ~wraps
    if jumps.any():
        index, arm = _first(jumps)
        raise InputError(
            f"{samples.at(index + 1)}: {samples.names[arm]} jumps by {abs(steps[index, arm]):.3g} rad in one sample "
            f"({jumps.sum()} such jumps); check the unit (degrees taken for rad?), columns, sampling, or cut it there"
        )
    if not wraps.any():
        return None
    index, arm = _first(wraps)
    fault = f"{samples.at(index + 1)}: {samples.names[arm]} jumps by a turn ({wraps.sum()} such jumps): it is wrapped"
    values = samples.values.copy()
    values[:, : samples.arms] = np.unwrap(values[:, : samples.arms], axis=0)
    return _Fault("wrap", fault, [replace(samples, values=values)], f"unwrapped {wraps.sum()} jumps by a turn")


_FASTEST = 80.0
"""Limit of the angle rate, rad/s, above any bench. A swing exceeds it if radians and degrees are confused."""
_LARGEST = 1e9
"""Limit of every measurement. A larger one is damage in any unit."""
_AGREES = 0.15
"""Tolerance for the slope of derivative over rate, as a share of one: filters lag and damp."""
_FALLS_UP = 0.5
"""Correlation of the inner arm's acceleration with sin θ that indicates a wrong zero; free swings stay below -0.2."""
_MATCHES = 0.97
"""Least correlation of the rates with the angles' differences. Online filters pass; wrong columns reach 0.9."""
_LEAST_MOTION = 0.2
"""Least rate for these checks, rad/s; slower recordings are inconclusive."""
_WINDOW = 0.02
"""Window for derivatives, s; quantised angles have no derivative from one sample to the next."""


def check_plausible(segments: Sequence[Samples], *, file: str) -> None:
    """Reject a recording that contradicts its mapping.

    Args:
        segments: segments of the recording.
        file: name of the file, for messages.

    Raises:
        InputError: reports the contradiction, its size and the likely cause.
    """
    for segment in segments:
        if (large := np.abs(segment.values) > _LARGEST).any():
            row, column = _first(large)
            raise InputError(
                f"{segment.at(row)}: {segment.names[column]} is {segment.values[row, column]:.4g}, which no "
                f"bench reaches in any unit (at most {_LARGEST:g}); look for a damaged value"
            )
    turned = [_turned(segment) for segment in segments]
    derivative = np.concatenate([part[0] for part in turned])
    fastest = float(np.percentile(np.abs(derivative), 99))
    if fastest > _FASTEST:
        raise InputError(
            f"{file}: the angles turn at {fastest:.4g} rad/s, and no bench's arm does more than {_FASTEST:g}; "
            "check the unit of angles and time in the mapping (degrees taken for rad? counts? ms?)"
        )
    if segments[0].of(RATE) is not None:
        _compare(derivative, np.concatenate([part[1] for part in turned]), file=file)
    if segments[0].of(CART) is None and segments[0].of(COMMAND) is None:
        # With the cart clamped, gravity alone moves the arms.
        _check_zero(segments, file=file)


def _stride(segment: Samples) -> int:
    spacing = float(np.median(np.diff(segment.time)))
    return int(min(max(1, round(_WINDOW / spacing)), max(1, len(segment.time) // 8)))


def _turned(segment: Samples) -> tuple[Array, Array]:
    """Return the arms' rates (W, n) over short windows.

    One result is from the angles, one from the mean of the rates.
    """
    stride, arms, given = _stride(segment), segment.arms, segment.of(RATE)
    ends = np.arange(0, len(segment.time), stride)
    by_angles = np.diff(segment.values[ends, :arms], axis=0) / np.diff(segment.time[ends])[:, None]
    if given is None:
        return by_angles, by_angles
    area = np.concatenate([np.zeros((1, arms)), np.cumsum((given[1:] + given[:-1]) / 2, axis=0)])
    return by_angles, np.diff(area[ends], axis=0) / stride


def _compare(derivative: Array, rates: Array, *, file: str) -> None:
    arms = derivative.shape[1]
    size = np.sqrt(np.maximum(np.mean(derivative**2, axis=0), np.mean(rates**2, axis=0)))
    fits = [[_fit(derivative[:, i], rates[:, j]) for j in range(arms)] for i in range(arms)]

    def agree(i: int, j: int) -> bool:
        slope, match = fits[i][j]
        return match > _MATCHES and abs(slope - 1) < _AGREES

    wrong = [i for i in range(arms) if size[i] > _LEAST_MOTION and not agree(i, i)]
    if not wrong:
        return
    arm = wrong[0]
    slope, match = fits[arm][arm]
    if match > _MATCHES:
        reason = f"is {slope:.4g} times its rate; is a unit (degrees, turns, ms) or a sign wrong?"
    else:
        alike = [f"; it is rate {j + 1}" for j in range(arms) if agree(arm, j)]
        reason = f"is not its rate (they correlate by {match:.2f}{''.join(alike)}); are columns swapped?"
    raise InputError(f"{file}: the derivative of angle {arm + 1} {reason} Check the mapping")


def _fit(derivative: Array, rate: Array) -> tuple[float, float]:
    """Return the slope of derivative over rate, with its sign.

    The size of their correlation follows.
    """
    power = float(rate @ rate)
    scale = np.sqrt(power * float(derivative @ derivative))
    if scale <= 0:
        return 0.0, 0.0
    return float(derivative @ rate) / power, abs(float(derivative @ rate)) / scale


def _check_zero(segments: Sequence[Samples], *, file: str) -> None:
    pull, square, sines = 0.0, 0.0, 0.0
    for segment in segments:
        stride = _stride(segment)
        angle, time = segment.values[::stride, 0], segment.time[::stride]
        if len(angle) < 5:
            continue
        acceleration = np.gradient(np.gradient(angle, time), time)[1:-1]
        sine = np.sin(angle)[1:-1]
        pull += float(acceleration @ sine)
        square += float(acceleration @ acceleration)
        sines += float(sine @ sine)
    if square * sines > 1e-12 and pull / np.sqrt(square * sines) > _FALLS_UP:
        raise InputError(
            f"{file}: the inner arm falls upward; the recording counts its angles from the other end: "
            "exchange 'hanging' and 'upright' as the mapping's zero"
        )


_CONTRADICTS = 0.3
"""Limit of difference over size. Swings of the rig reach 0.02, arms of twice the length 0.4, exchanged columns 0.4
to 1.2, a constant angle 0.8."""
_BETTER = 3.0
"""Factor by which another column order must fit better to be suggested."""
_LEAST = 2.0
"""Least model acceleration for this check, rad/s²; below it recordings are inconclusive."""
_GATHERED, _LEFT_OVER = 0.5, 0.5
"""Least mean of exp(iθ) of an arm that swings about one angle, and least such angle, rad, that is no hanging arm's."""
_MOVES = 0.05
"""Range of an angle that counts as motion, rad."""


def constant_angles(recording: Recording) -> tuple[str, ...]:
    """Return a sentence on each constant angle.

    It requires that others vary or that all are constant.

    Args:
        recording: the recording.
    """
    reach = np.ptp(recording.angles, axis=0)
    most = float(reach.max())
    return tuple(
        f"angle {arm + 1} is {recording.angles[0, arm]:g} rad in all {len(recording.time)} samples: is its encoder "
        "connected, and its column the right one?"
        for arm in range(recording.arms)
        if reach[arm] == 0 and (most == 0 or most > _MOVES)
    )


def contradiction(recording: Recording, arms: ArmChainParameters, *, model: str) -> str:
    """Return a sentence on the contradiction between arms and recording.

    The result is "" if the contradiction is small.

    Args:
        recording: the recording.
        arms: arms of the model.
        model: name of the model, for messages.
    """
    if arms.count != recording.arms:
        return f"the recording has {recording.arms} arms and the model {model} {arms.count}; give the matching model"
    orders = list(permutations(range(arms.count)))
    # The steps of relative encoders add up in an outer arm's angle.
    blurred = np.sqrt(0.5 * np.arange(1, arms.count + 1)) * _encoder_steps(recording.angles) / _WINDOW**2
    off: list[float] = []
    sizes: list[tuple[Array, Array]] = []
    for order in orders:
        measured, predicted = _accelerations(recording, arms, order)
        if not len(measured):
            return ""
        sizes.append((_rms(measured), _rms(predicted)))
        largest = max(float(np.linalg.norm(size)) for size in sizes[-1])
        apart = float(np.sum(_rms(measured - predicted) ** 2)) - float(np.sum(blurred**2))
        off.append(np.sqrt(max(apart, 0.0)) / max(largest, 1e-300))
        if len(off) == 1 and (off[0] < _CONTRADICTS or sizes[0][1].max() < _LEAST):
            return ""
    shown = [" and ".join(f"{value:.3g}" for value in size) for size in sizes[0]]
    text = (
        f"the model {model} contradicts the recording: its arms would accelerate by {shown[1]} rad/s² (rms), the "
        f"recorded ones accelerate by {shown[0]}, and the difference is {off[0]:.2g} times as large as the larger"
    )
    # Swings are about hanging, up to whole turns.
    middles = np.mean(np.exp(1j * recording.angles), axis=0)
    left_over = [k for k in range(arms.count) if abs(middles[k]) > _GATHERED and abs(np.angle(middles[k])) > _LEFT_OVER]
    if left_over:
        shown = [f"angle {k + 1} swings about {np.angle(middles[k]):.2g} rad" for k in left_over]
        return f"{text}; {' and '.join(shown)} instead of 0: is the mapping's zero what a hanging arm reads?"
    best = int(np.argmin(off))
    if _BETTER * off[best] < off[0]:
        as_read = ", ".join(str(arm + 1) for arm in orders[best])
        return f"{text}; with the angles in the order {as_read} it is {off[best]:.2g}: are columns exchanged?"
    return f"{text}; check columns, signs and zeros, or give the matching model"


def _encoder_steps(angles: Array) -> Array:
    """Return the smallest change of each angle (n,) between samples.

    Zero for a constant angle.
    """
    changes = np.abs(np.diff(angles, axis=0))
    smallest = np.min(changes, axis=0, where=changes > 1e-12, initial=np.inf)
    return np.where(np.isfinite(smallest), smallest, 0.0)


def _rms(values: Array) -> Array:
    return np.sqrt(np.mean(np.square(values), axis=0))


def _accelerations(recording: Recording, arms: ArmChainParameters, order: tuple[int, ...]) -> tuple[Array, Array]:
    """Return measured and predicted accelerations (K, n), rad/s².

    The angles are in the given order; K may be zero.
    """
    equations = equations_of(arms, Level.CART)
    rate, n = equations.function(), arms.count
    stride = max(round(_WINDOW / recording.dt), 1)
    step = stride * recording.dt
    measured, predicted = [np.zeros((0, n))], [np.zeros((0, n))]
    for part in recording.split():
        if len(part.time) < 4 * stride:
            continue
        cart, angles = cart_motion(part), part.angles[:, order]
        before, here, after = angles[: -2 * stride], angles[stride:-stride], angles[2 * stride :]
        every = slice(None, None, max(stride // 2, 1))
        states = np.hstack([here, (after - before) / (2 * step), np.zeros((len(here), 2))])
        driven = np.zeros(len(here))
        if cart is not None:
            states[:, -1] = cart.velocity[stride:-stride]
            driven = np.convolve(cart.acceleration, np.ones(2 * stride + 1) / (2 * stride + 1), mode="valid")
        found = np.asarray(rate(states[every].T, driven[every][None], arms.base()), dtype=float).T
        predicted.append(found[:, n : 2 * n])
        measured.append(((after - 2 * here + before) / step**2)[every])
    together = np.concatenate(measured), np.concatenate(predicted)
    known = np.isfinite(np.hstack(together)).all(axis=1)
    return together[0][known], together[1][known]
