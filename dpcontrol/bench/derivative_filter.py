"""Rates by differences of what the encoders say: the plain method that estimators are charted against.

    v_k = a v_{k-1} + (1 - a) (z_k - z_{k-1}) / T,      a = e^{-2π f T}

f: cut-off in Hz of the first-order low pass, infinite for none. A difference is half a period old and carries the noise
q/T of one count q; the low pass trades noise against a lag of 1/(2πf). No model, so nothing to be wrong about, and no
covariance either: nothing tells when it fails.

Source: Franklin, Powell & Workman, Digital Control of Dynamic Systems, 3rd ed., section 6.1 (difference equivalents).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DerivativeFilter:
    """Differences of positions (m,) over `period` s, smoothed at `cutoff` Hz; inf: not at all."""

    period: float
    cutoff: float = math.inf

    def __post_init__(self) -> None:
        """Refuse what smooths nothing in a finite time.

        Raises:
            InputError: names the setting, its value and what is allowed.
        """
        for name in ("period", "cutoff"):
            if not getattr(self, name) > 0:
                raise InputError(f"derivative filter: {name} = {getattr(self, name)!r}: must be positive")

    @property
    def keeps(self) -> float:
        """Share of the last rate that is kept."""
        return math.exp(-2 * math.pi * self.cutoff * self.period)

    def step(self, rates: Array, last: Array, measured: Array) -> Array:
        """Return the rates (m,) after positions `measured` (m,), `last` having been measured a period before."""
        kept = self.keeps
        return kept * rates + (1 - kept) * (measured - last) / self.period
