"""Whether a recording can be of a pendulum as its mapping says: units, columns, signs and zero.

The rates must be the angles' derivative. Where they are not, what would make them so tells the mistake: a factor of
180/π a unit, a factor of -1 a sign, another arm's derivative a swapped column. And gravity pulls arms down: over a free
swing the mean of θ̈ sin θ is negative, so a positive one tells that the zero is upright.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.lab.recording_checks import Samples

Array = NDArray[np.float64]

_FASTEST = 80.0
"""rad/s: more than a bench's arms survive; radians taken for degrees, or degrees for radians, pass it in a swing."""
_DEGREES = 180 / np.pi
_FACTORS = {
    _DEGREES: "the angles look like degrees and the rates like rad/s",
    1 / _DEGREES: "the angles look like rad and the rates like degrees per second",
    2 * np.pi: "the angles look like rad and the rates like turns per second, or the reverse",
    1 / (2 * np.pi): "the angles look like turns and the rates like rad/s, or the reverse",
    1e3: "the times look like ms",
    1e-3: "the times look like s where ms were said",
    -1.0: "angles and rates have opposite signs",
}
_AGREES = 0.15
"""Share by which the slope of derivative over rate may differ from one: filters lag and damp."""
_FALLS_UP = 0.5
"""Correlation of the inner arm's acceleration with sin θ above which it falls upward; below -0.2 in free swings."""
_MATCHES = 0.97
"""Correlation that rates filtered on line still reach with the angles' differences; other columns come to 0.9."""
_LEAST_MOTION = 0.2
"""rad/s: slower recordings tell nothing."""
_WINDOW = 0.02
"""s: quantised angles have no derivatives from one sample to the next."""


def check_plausible(segments: Sequence[Samples], *, arms: int, rates: bool, clamped: bool, file: str) -> None:
    """Refuse a recording whose numbers contradict what the mapping says of them.

    Args:
        segments: values hold the angles in their first `arms` columns, and the rates next where `rates`.
        arms: number of arms.
        rates: whether rates were recorded.
        clamped: whether the cart stood still, so that gravity is all that moves the arms.
        file: for messages.

    Raises:
        InputError: says what disagrees, by how much, and what it looks like.
    """
    turned = [_turned(segment, arms, rates) for segment in segments]
    derivative = np.concatenate([part[0] for part in turned])
    fastest = float(np.percentile(np.abs(derivative), 99))
    if fastest > _FASTEST:
        raise InputError(
            f"{file}: the angles turn at {fastest:.4g} rad/s, and no bench's arm does more than {_FASTEST:g}; "
            "check the unit of angles and time in the mapping (degrees taken for rad? counts? ms?)"
        )
    if rates:
        _compare(derivative, np.concatenate([part[1] for part in turned]), file=file)
    if clamped:
        _check_zero(segments, file=file)


def _stride(segment: Samples) -> int:
    spacing = float(np.median(np.diff(segment.time)))
    return int(min(max(1, round(_WINDOW / spacing)), max(1, len(segment.time) // 8)))


def _turned(segment: Samples, arms: int, rates: bool) -> tuple[Array, Array]:
    """Return how fast the arms turned (W, n) over short windows, by the angles and by the mean of the rates."""
    stride = _stride(segment)
    ends = np.arange(0, len(segment.time), stride)
    by_angles = np.diff(segment.values[ends, :arms], axis=0) / np.diff(segment.time[ends])[:, None]
    if not rates:
        return by_angles, by_angles
    given = segment.values[:, arms : 2 * arms]
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
        factor = min(_FACTORS, key=lambda f: abs(slope / f - 1))
        guess = _FACTORS[factor] if abs(slope / factor - 1) < 0.3 else "check the units of angles, rates and time"
        raise InputError(f"{file}: the derivative of angle {arm + 1} is {slope:.4g} times its rate; {guess}")
    others = [j for j in range(arms) if j != arm and agree(arm, j)]
    looks = f"it is rate {others[0] + 1}: are columns swapped?" if others else "are columns swapped?"
    raise InputError(
        f"{file}: the derivative of angle {arm + 1} is not its rate (they correlate by {match:.2f}); {looks} "
        "Check the mapping's columns"
    )


def _fit(derivative: Array, rate: Array) -> tuple[float, float]:
    """Return the slope of derivative over rate, and their correlation, its sign taken into the slope."""
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
