"""Recordings as swings to fit: each segment's angles, and the cart's motion where it moved; long segments cut."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.shooting_windows import Swing
from dpcontrol.foundation.errors import InputError
from dpcontrol.lab.cart_motion import cart_motion
from dpcontrol.lab.recordings import Recording

Array = NDArray[np.float64]

_STILL = 1e-3


@dataclass(frozen=True)
class Segment:
    """A segment as it was used: running index over all logs, log, first time s, length s, used or left out, rms rad."""

    index: int
    log: str
    start: float
    seconds: float
    used: bool
    rms: float


def cut_into_swings(recordings: Sequence[Recording], arms: int, longest: float) -> tuple[list[Swing], list[Segment]]:
    """Return the recordings' segments as swings, long ones cut into equal pieces, and what they are.

    Raises:
        InputError: a recording has another number of arms, or hardly moves.
    """
    swings: list[Swing] = []
    about: list[Segment] = []
    for group, recording in enumerate(recordings):
        if recording.arms != arms:
            raise InputError(
                f"{recording.name} is of {recording.arms} arms, the model has {arms}; give a model of as many"
            )
        for part in recording.split():
            pieces = max(int(np.ceil((len(part.time) - 1) * part.dt / longest)), 1)
            edges = np.linspace(0, len(part.time), pieces + 1).round().astype(int)
            cart = cart_motion(part)
            for a, b in pairwise(edges):
                angles = part.angles[a:b]
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
