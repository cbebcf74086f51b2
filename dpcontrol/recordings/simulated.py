"""Recordings of swings whose truth is known: what an identification is tried on.

    y_i = Σ_{j≤i} q round((θ_j - θ_{j-1} + ζ_j - ζ_{j-1}) / q),      q = 2π / counts

Swings are flown to machine precision from rest, on a clamped cart, and read by relative encoders whose zeros are off.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.dynamics.propagator import Propagator
from dpcontrol.foundation.errors import InputError
from dpcontrol.recordings.recording import Recording

Array = NDArray[np.float64]


_REACH = 1.2
"""rad: swings let go within this of hanging are lively and not chaotic, and tell most."""
_ZEROS = 2e-3


def random_swings(arms: ArmChainParameters, *, swings: int, seconds: float, seed: int, name: str) -> Recording:
    """Return a recording of swings let go at random angles, with encoders whose zeros are off by up to 2 mrad.

    Raises:
        InputError: there are to be no swings, or of no time.
    """
    for key, value, most in (("swings", swings, 1000), ("seconds", seconds, 1000.0)):
        if not 0 < value <= most:
            raise InputError(f"{key} = {value!r}: must be above 0, at most {most:g}")
    random = np.random.default_rng(seed)
    zeros = random.uniform(-_ZEROS, _ZEROS, arms.count)
    starts = list(random.uniform(-_REACH, _REACH, (swings, arms.count)))
    return simulated_recording(arms, starts, seconds=seconds, zeros=zeros, name=name)


def simulated_recording(
    arms: ArmChainParameters,
    starts: Sequence[Array],
    *,
    seconds: float,
    period: float = 1e-3,
    counts: int = 40_000,
    zeros: Array | None = None,
    name: str = "simulated",
) -> Recording:
    """Return a recording of one free swing of these arms from each of `starts` (n,) rad, let go at rest.

    seconds: of each swing; period s between samples; counts per turn of the relative encoders, 0 for exact angles;
    zeros (n,) rad: what they show, as absolute angles, where the true ones are zero.
    """
    n = arms.count
    propagator = Propagator(equations_of(arms, Level.DISSIPATIVE), arms.base())
    times = np.arange(round(seconds / period) + 1) * period
    swings: list[Array] = []
    for start in starts:
        state = np.concatenate([np.asarray(start, dtype=float), np.zeros(n)])
        angles = propagator.sample(state, times)[:, :n] + (0.0 if zeros is None else zeros)
        if counts:
            step = 2 * np.pi / counts
            relative = np.diff(angles, axis=1, prepend=0.0)
            angles = np.cumsum(step * np.rint(relative / step), axis=1)
        swings.append(angles)
    edges = np.arange(len(swings) + 1) * len(times)
    return Recording(
        name=name,
        source="simulated",
        dt=period,
        time=np.arange(edges[-1]) * period,
        angles=np.concatenate(swings),
        rates=None,
        segments=tuple((int(a), int(b)) for a, b in pairwise(edges)),
        arm_lengths=arms.length,
    )
