"""Recordings as swings to fit: each segment's angles, and the cart's motion where it moved; long segments cut."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.identification.fit import Swing
from dpcontrol.recordings.recording import Recording, cart_motion

Array = NDArray[np.float64]

LONGEST, LONGEST_DRIVEN = 4.0, 1.0
"""s: of pieces, and of those on a moving cart. About a saddle errors grow e⁸-fold in a second; over four seconds
rounding leaves nothing of what a start determines."""
_STILL = 1e-3
_MOST_LOST = 5
"""Readings in a row that may be missing."""
_NEAR = 20


@dataclass(frozen=True)
class Segment:
    """A segment as it was used: running index over all logs, log, first time s, length s, used or left out, rms rad."""

    index: int
    log: str
    start: float
    seconds: float
    used: bool
    rms: float


def cut_into_swings(
    recordings: Sequence[Recording], arms: int, longest: float | None
) -> tuple[list[Swing], list[Segment]]:
    """Return the recordings' segments as swings, long ones cut into equal pieces, and what they are.

    Raises:
        InputError: a recording has another number of arms, hardly moves, or lacks more than a few readings in a row.
    """
    swings: list[Swing] = []
    about: list[Segment] = []
    for group, recording in enumerate(recordings):
        if recording.arms != arms:
            raise InputError(
                f"{recording.name} is of {recording.arms} arms, the model has {arms}; give a model of as many"
            )
        for part in recording.split():
            cart = cart_motion(part)
            most = longest or (LONGEST if cart is None else LONGEST_DRIVEN)
            pieces = max(int(np.ceil((len(part.time) - 1) * part.dt / most)), 1)
            edges = np.linspace(0, len(part.time), pieces + 1).round().astype(int)
            filled = _filled(part)
            for a, b in pairwise(edges):
                angles = filled[a:b]
                # Turns counted before a segment say nothing about it.
                angles = angles - 2 * np.pi * np.rint(angles[0] / (2 * np.pi))
                u = None if cart is None else cart.acceleration[a:b]
                v = None if cart is None else cart.velocity[a:b]
                about.append(
                    Segment(len(about), recording.name, float(part.time[a]), float((b - a - 1) * part.dt), True, np.nan)
                )
                swings.append(Swing(angles, part.dt, group, u, v))
    if not swings:
        raise InputError("the recordings hold no segment; import them again")
    if max(float(np.ptp(s.angles, axis=0).max()) for s in swings) < _STILL:
        raise InputError(f"no angle moves by more than {_STILL:g} rad: nothing to identify; record free swings")
    return swings, about


def _filled(part: Recording) -> Array:
    """Return the angles (K, n), single missing ones between their neighbours.

    Raises:
        InputError: too many in a row are missing.
    """
    lost = np.asarray(~np.isfinite(part.angles).all(axis=1))
    if not lost.any():
        return part.angles
    known = np.flatnonzero(~lost)
    gaps = np.diff(known, prepend=-1, append=len(lost)) - 1
    if gaps.max() > _MOST_LOST:
        longest = int(gaps.argmax())
        at = part.time[known[longest - 1] + 1 if longest else 0]
        raise InputError(
            f"{part.name}: {gaps.max()} readings in a row are missing at {at:.6g} s; identify from a recording without"
        )
    angles = np.stack([np.interp(np.arange(len(lost)), known, column) for column in part.angles[known].T], axis=1)
    for rows, near in ((np.arange(known[0]), known[:_NEAR]), (np.arange(known[-1] + 1, len(lost)), known[-_NEAR:])):
        # Beyond the ends a parabola through the nearest: two rounded ones tell no slope.
        curve = np.polynomial.polynomial.polyfit(near - near[0], part.angles[near], min(2, len(near) - 1))
        angles[rows] = np.polynomial.polynomial.polyval(rows - near[0], curve).T
    return angles
