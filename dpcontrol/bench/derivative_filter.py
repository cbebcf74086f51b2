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

from dpcontrol.foundation.settings import Settings, setting

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DerivativeFilter(Settings, table="derivative filter"):
    """Differences of positions (m,) over `period` s, smoothed at `cutoff` Hz; inf: not at all."""

    period: float = setting(above=0, unit="s")
    cutoff: float = setting(math.inf, above=0, infinite="no smoothing", unit="Hz")

    @property
    def keeps(self) -> float:
        """Share of the last rate that is kept."""
        return math.exp(-2 * math.pi * self.cutoff * self.period)

    def step(self, rates: Array, last: Array, measured: Array) -> Array:
        """Return the rates (m,) after positions `measured` (m,), `last` having been measured a period before."""
        kept = self.keeps
        return kept * rates + (1 - kept) * (measured - last) / self.period
