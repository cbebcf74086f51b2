"""Whether an estimator may be believed: NIS on every run, NEES where the truth is known.

    NIS = yᵀ S⁻¹ y ~ χ²(m),    NEES = (z - ẑ)ᵀ P⁻¹ (z - ẑ) ~ χ²(N+E),    both two-sided: too small is wrong as well

Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, section 5.4.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

Array = NDArray[np.float64]


@cache
def chi_square_band(freedom: int, *, share: float = 0.95) -> tuple[float, float]:
    """Return the interval that holds `share` of a chi-square variable, the same share left out on both sides."""
    # As scipy.stats computes it, which takes half a second to import.
    low, high = 2 * gammaincinv(freedom / 2, [(1 - share) / 2, (1 + share) / 2])
    return float(low), float(high)


def share_inside(values: Array, freedom: int, *, share: float = 0.95) -> float:
    """Return the part of NIS or NEES `values` (any shape) within the band of `share`; a consistent filter gives it."""
    low, high = chi_square_band(freedom, share=share)
    return float(((values >= low) & (values <= high)).mean())


def nees(error: Array, covariance: Array) -> Array:
    """Return the normalised estimation error squared (…) of truth minus estimate (…, n) and covariance (…, n, n)."""
    return (error * np.linalg.solve(covariance, error[..., None])[..., 0]).sum(-1)
