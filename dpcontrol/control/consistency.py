"""Whether an estimator may be believed: NIS on every run, NEES where the truth is known, and the alarm between.

    NIS = yᵀ S⁻¹ y ~ χ²(m),    NEES = (z - ẑ)ᵀ P⁻¹ (z - ẑ) ~ χ²(N+E),    both two-sided: too small is wrong as well
    w_i² = ((S⁻¹ y)_i)² / (S⁻¹)_ii ~ χ²(1):  large where encoder i alone is wrong;   S⁻¹ = R⁻¹ (R - H P Hᵀ) R⁻¹

The encoders measure relative angles, so w is taken of relative innovations: one stuck encoder shows in all angles that
are summed from it, but in one relative angle only.
Sources: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, section 5.4; Baarda, A
testing procedure for use in geodetic networks (1968), for w.
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.interface import Estimate, Estimator
from dpcontrol.foundation.settings import Settings, setting

Array = NDArray[np.float64]

_FALSE_ALARM = 1e-9
"""Chance that a consistent filter exceeds the bound at one tick: one in some hundred hours at 1 kHz."""
_LARGE = 11.0
"""Of NIS per position: a value that counts as evidence on a sensor; three consistent positions have it once in 10⁷."""
_LEADS = 4.0
"""Times the next sensor's w² that the guilty one's must be."""
_SAME = 1e-9
"""rad and m: readings this near to each other are the same count."""


@cache
def chi_square_band(freedom: int, *, share: float = 0.95) -> tuple[float, float]:
    """Return the interval that holds `share` of a chi-square variable, the same share left out on both sides."""
    from scipy.stats import chi2

    low, high = chi2.ppf([(1 - share) / 2, (1 + share) / 2], freedom)
    return float(low), float(high)


def share_inside(values: Array, freedom: int, *, share: float = 0.95) -> float:
    """Return the part of NIS or NEES `values` (any shape) within the band of `share`; a consistent filter gives it."""
    low, high = chi_square_band(freedom, share=share)
    return float(((values >= low) & (values <= high)).mean())


def nees(error: Array, covariance: Array) -> Array:
    """Return the normalised estimation error squared (…) of truth minus estimate (…, n) and covariance (…, n, n)."""
    return (error * np.linalg.solve(covariance, error[..., None])[..., 0]).sum(-1)


class Verdict(StrEnum):
    """What is thought of the estimate; from the second on it should not be relied upon."""

    CONSISTENT = "consistent"
    DOUBTFUL = "doubtful"
    """NIS is larger than chance allows: the model or the noise is wrong, but the estimate follows."""
    SENSOR = "sensor"
    """One encoder contradicts the model and the others."""
    DIVERGED = "diverged"
    BLIND = "blind"
    """A position has not been measured for too long."""


@dataclass(frozen=True)
class WatchSettings(Settings, table="watch"):
    """window s: memory of the mean NIS; gap s: longest time without a position; still s: an encoder that gives the same
    reading for so long while the model says that it moves is stuck; diverged: mean NIS per position.
    """

    window: float = setting(0.2, above=0, unit="s")
    gap: float = setting(0.05, above=0, unit="s")
    still: float = setting(0.02, above=0, unit="s")
    diverged: float = setting(100.0, above=0)


class Health(NamedTuple):
    """What is known of an estimator after a tick.

    mean: of NIS per position, over the window; unheard and same: for how many ticks each position was not measured,
    each encoder gave the same reading; evidence (m, m): weighted sum of products of large relative innovations,
    as of the tick `weighed`; reason: a sentence, empty while consistent.
    """

    verdict: Verdict
    reason: str
    mean: float
    unheard: tuple[int, ...]
    same: tuple[int, ...]
    readings: tuple[float, ...]
    evidence: Array
    weighed: int
    tick: int


class Watch:
    """Watches the estimates of one estimator; its methods do not change what they are given.

    noise (n+1, n+1): of the measured positions; period s.
    """

    def __init__(self, estimator: Estimator, settings: WatchSettings, *, noise: Array, period: float) -> None:
        from scipy.stats import chi2

        self.estimator = estimator
        self.settings = settings
        self.period = period
        self._count = m = len(noise)
        self._share = min(period / settings.window, 1.0)
        # An exponential window of weight a has the variance of 2/a - 1 equal weights.
        freedom = m * max(2 / self._share - 1, 1.0)
        self.bound = float(chi2.isf(_FALSE_ALARM, freedom)) / freedom
        """Of the mean NIS per position."""
        self._gap, self._still = settings.gap / period, settings.still / period
        self._relative = np.eye(m) - np.diag([*([1.0] * (m - 2)), 0.0], -1)
        self._noise = np.asarray(noise, dtype=float)
        self._names = [*(f"the encoder of joint {i + 1}" for i in range(m - 1)), "the cart's scale"]

    def begin(self) -> Health:
        """Return the health before any tick."""
        m = self._count
        nothing = (float("nan"),) * m
        return Health(Verdict.CONSISTENT, "", 1.0, (0,) * m, (0,) * m, nothing, np.zeros((m, m)), 0, 0)

    def seen(
        self, health: Health, estimate: Estimate, measured: Array, present: NDArray[np.bool_] | None = None
    ) -> Health:
        """Return the health after a tick that gave `estimate` from `measured` (n+1,), of which `present` count."""
        m, tick = self._count, health.tick + 1
        here = (True,) * m if present is None else tuple(present.tolist())
        z = measured.tolist()
        readings = (z[0], *(z[i] - z[i - 1] for i in range(1, m - 1)), z[-1])
        unheard = tuple(0 if h else n + 1 for h, n in zip(here, health.unheard, strict=True))
        same = tuple(
            n + 1 if h and abs(now - was) < _SAME else 0
            for h, now, was, n in zip(here, readings, health.readings, health.same, strict=True)
        )
        mean, evidence, weighed = health.mean, health.evidence, health.weighed
        if estimate.used:
            each = estimate.nis / estimate.used
            mean += self._share * (each - mean)
            if each > _LARGE:
                y = self._relative @ estimate.innovation
                evidence = evidence * (1 - self._share) ** (tick - weighed) + np.outer(y, y)
                weighed = tick
        next_ = Health(Verdict.CONSISTENT, "", mean, unheard, same, readings, evidence, weighed, tick)
        longest = max(unheard)
        if longest > self._gap:
            which = " and ".join(name for name, n in zip(self._names, unheard, strict=True) if n > self._gap)
            return next_._replace(
                verdict=Verdict.BLIND,
                reason=f"{which} gave nothing for {longest * self.period:.3g} s; the estimate is a prediction",
            )
        if mean <= self.bound:
            return next_
        return self._judged(next_, estimate)

    def sensor_statistics(self, health: Health, estimate: Estimate) -> Array:
        """Return w² (m,) of the encoders, inner joint first and the cart's scale last, by the evidence of late."""
        m, lift = self._count, self._relative
        p = self.estimator.covariance(estimate)
        h = np.zeros((m, len(p)))
        arms = m - 1
        h[np.arange(m), [*range(arms), 2 * arms]] = 1.0
        for i, name in enumerate(self.estimator.extra_names):
            if name.startswith("zero_"):
                h[int(name[5:]) - 1, 2 * arms + 2 + i] = 1.0
        weight = np.linalg.inv(self._noise)
        inverse = weight @ (self._noise - h @ p @ h.T) @ weight
        # Of relative innovations D y: (D S Dᵀ)⁻¹ = D⁻ᵀ S⁻¹ D⁻¹.
        back = np.linalg.inv(lift)
        inverse = back.T @ inverse @ back
        variance = np.maximum(inverse.diagonal(), np.finfo(float).tiny)
        return np.einsum("ij,jk,ki->i", inverse, health.evidence, inverse) / variance

    def _judged(self, health: Health, estimate: Estimate) -> Health:
        large = f"mean NIS {health.mean * self._count:.3g} where {self._count} is expected"
        statistics = self.sensor_statistics(health, estimate)
        worst = int(np.argmax(statistics))
        others = float(np.delete(statistics, worst).max())
        diverged = health.mean > self.settings.diverged
        # An arm that turns back is still for a moment as well: the evidence must be against this encoder, and as new.
        still = health.same[worst]
        if still > self._still and statistics[worst] > others and health.tick - health.weighed < still:
            reason = f"{self._names[worst]} is stuck: it gave the same reading {still} times; {large}"
            return health._replace(verdict=Verdict.SENSOR, reason=reason)
        if diverged and statistics[worst] > _LEADS * others:
            reason = f"{self._names[worst]} contradicts the model and the other sensors; {large}"
            return health._replace(verdict=Verdict.SENSOR, reason=reason)
        if diverged:
            reason = f"the estimate has diverged: {large}; check the model's parameters, or begin again"
            return health._replace(verdict=Verdict.DIVERGED, reason=reason)
        reason = f"{large}: the model's parameters are off, or more noise should be assumed"
        return health._replace(verdict=Verdict.DOUBTFUL, reason=reason)
