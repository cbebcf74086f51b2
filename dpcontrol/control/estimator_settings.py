"""What the estimators assume: process noise, first uncertainty, and what they estimate besides the state.

    zeros        the arms' encoders start from wrong zeros: constants b_i added to the measured angles
    disturbance  further accelerations of the arms, rad/s², that fade: first-order Gauss-Markov
    drive        further acceleration of the cart, m/s², that fades: what the drive gives beyond the command
    friction     relative errors of the joints' friction: constants
    dry          Coulomb friction of the joints that the model lacks, over gravity's torques G_i: constants
    parameters   errors log(p/p₀) of the base parameters, over M12 (one arm: M11): constants

The parameters stand as logarithms: what the data leave unknown is then nearly the same combination of them wherever the
filter linearises, so it does not gather false knowledge on its way. Reports and logs give relative errors.

With the cart's acceleration as input only ratios of the inertial parameters matter, so one of them stays fixed; G_i and
S_i share a factor, for gravity is known. What is common to all zeros is seen through gravity alone: while the arms
barely move about a vertical, zeros and disturbance cannot be distinguished, so give both only with a reason.

Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, sections 8.2 and 11.9.

Whether an estimator may be believed: NIS on every run, NEES where the truth is known.

    NIS = yᵀ S⁻¹ y ~ χ²(m),    NEES = (z - ẑ)ᵀ P⁻¹ (z - ẑ) ~ χ²(N+E),    both two-sided: too small is wrong as well

Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, section 5.4.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from typing import Self

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.settings import Settings, setting


class Augment(StrEnum):
    """What an estimator may estimate besides the state, in the order in which it stands in `extra`."""

    ZEROS = "zeros"
    DISTURBANCE = "disturbance"
    DRIVE = "drive"
    FRICTION = "friction"
    DRY = "dry"
    PARAMETERS = "parameters"


_DRIFT = 1e-6
"""Of a constant per √s, as a share of its first standard deviation: keeps the filter's gain from vanishing."""


def extra_names(arms: int, augment: tuple[Augment, ...]) -> tuple[str, ...]:
    """Return the names of the extra quantities: zero_1 …, disturbance_1 …, drive, friction_1 …, dry_1 …, M11 …, S1 …"""
    joints = range(1, arms + 1)
    inertias = [f"M{i}{j}" for i in joints for j in range(i, arms + 1)]
    fixed = "M12" if arms > 1 else "M11"
    names = {
        Augment.ZEROS: [f"zero_{i}" for i in joints],
        Augment.DISTURBANCE: [f"disturbance_{i}" for i in joints],
        Augment.DRIVE: ["drive"],
        Augment.FRICTION: [f"friction_{i}" for i in joints],
        Augment.DRY: [f"dry_{i}" for i in joints],
        Augment.PARAMETERS: [*(name for name in inertias if name != fixed), *(f"S{i}" for i in joints)],
    }
    return tuple(name for kind in Augment if kind in augment for name in names[kind])


_LATE_PERIOD = 1e-3
"""s: at longer periods late_drive counts in proportion less: in full, it loses most runs at 200 Hz."""
_MOST = 1e6
"""Of all that a filter may assume, in its unit: more means nothing, and squares of it would overflow."""


@dataclass(frozen=True)
class FilterSettings(Settings, table="estimator"):
    """Noise that a filter assumes, and what it estimates besides the state.

    parameter_error: share by which accelerations may be wrong, and correlation_time s for which such an error
    lasts: Q's density is 2 · time · (share · acceleration)². nonlinearity: a further share is this times the variance
    of the parameters, where they are estimated. rate_noise rad/s/√s and cart_noise m/s/√s: floors.
    dry_shape: share of dry friction's acceleration, known or found, that its law may have wrong.
    surprise: Q is multiplied by the mean NIS per position to this power where that is above 1; 0 for never.
    first_angle rad, first_rate rad/s, first_cart m: standard deviations at the start (the cart's velocity: m/s).

    augment: any of zeros, disturbance, drive, friction, dry, parameters. Standard deviations: zero_error rad,
    disturbance rad/s² with its disturbance_time s, drive_error m/s² with its drive_time s, friction_error, dry_error
    and model_error, shares.
    late_drive: the drive's error grows by this share of each change of the command, as where it lags more than stated;
    at periods above 1 ms by less in proportion.
    """

    kind: str = "ekf"
    parameter_error: float = setting(0.01, least=0, most=_MOST, help="Relative error of the accelerations.")
    correlation_time: float = setting(0.02, above=0, most=_MOST, help="Duration of such an error.")
    nonlinearity: float = setting(
        2.5, least=0, most=_MOST, help="Further relative error per variance of the estimated parameters."
    )
    dry_shape: float = setting(0.0, least=0, most=_MOST, help="Relative error of the law of dry friction.")
    surprise: float = setting(0.0, least=0, most=4, help="Power of the mean NIS that scales the process noise.")
    rate_noise: float = setting(0.03, above=0, most=_MOST, help="Floor of the process noise of the rates.")
    cart_noise: float = setting(0.1, above=0, most=_MOST, help="Floor of the process noise of the cart's velocity.")
    first_angle: float = setting(0.03, above=0, most=_MOST, help="Initial standard deviation of the angles.")
    first_rate: float = setting(0.1, above=0, most=_MOST, help="Initial standard deviation of the rates.")
    first_cart: float = setting(
        1e-3, above=0, most=_MOST, help="Initial standard deviation of the cart's position and velocity."
    )
    augment: tuple[str, ...] = setting(
        ("zeros", "drive"), choices=tuple(Augment), help="Quantities estimated besides the state."
    )
    zero_error: float = setting(0.012, above=0, most=_MOST, help="Standard deviation of the encoders' zeros.")
    disturbance: float = setting(
        1.0, above=0, most=_MOST, help="Standard deviation of the arms' further accelerations."
    )
    disturbance_time: float = setting(0.1, above=0, most=_MOST, help="Their correlation time.")
    drive_error: float = setting(3.0, above=0, most=_MOST, help="Standard deviation of the drive's error.")
    drive_time: float = setting(0.01, above=0, most=_MOST, help="Its correlation time.")
    late_drive: float = setting(
        0.0, least=0, most=_MOST, help="Share of each command change that adds to the drive's error."
    )
    friction_error: float = setting(
        0.3, above=0, most=_MOST, help="Standard deviation of the relative friction errors."
    )
    dry_error: float = setting(
        0.005, above=0, most=_MOST, help="Standard deviation of dry friction over gravity's torques."
    )
    model_error: float = setting(
        0.1, above=0, most=_MOST, help="Standard deviation of the parameters' relative errors."
    )

    def _check_together(self) -> None:
        """Check that nothing is augmented twice."""
        if len(set(self.augment)) != len(self.augment):
            raise self.refusal("augment", "name each once")

    @property
    def augments(self) -> tuple[Augment, ...]:
        """Return what is estimated besides the state, in the order in which it stands."""
        return tuple(kind for kind in Augment if kind in self.augment)

    def first_sigmas(self, arms: int) -> Array:
        """Return the standard deviations at the start of state and extra, (N+E,)."""
        state = [self.first_angle] * arms + [self.first_rate] * arms + [self.first_cart] * 2
        return np.array([*state, *(self._sigma(name) for name in extra_names(arms, self.augments))])

    def _sigma(self, name: str) -> float:
        kind = name.partition("_")[0]
        known = {
            "zero": self.zero_error,
            "disturbance": self.disturbance,
            "drive": self.drive_error,
            "friction": self.friction_error,
            "dry": self.dry_error,
        }
        return known.get(kind, self.model_error)

    def process(self, arms: int, period: float) -> Array:
        """Return what the equations of the filter take.

        Densities of the arms' noise, absolute and relative; the covariance that a period adds to the cart's position
        and velocity (pp, pv, vv) and between them and the drive's error (pd, vd); the relative density for a variance
        of 1 of the parameters; surprise; late_drive; the density for dry friction of 1 rad/s²; decay (E,) and variance
        (E,) of the extras a period.
        """
        names = extra_names(arms, self.augments)
        densities = [self.rate_noise**2, 2 * self.correlation_time * (self.parameter_error / period) ** 2]
        path = self.cart_noise**2 * np.array([period**3 / 3, period**2 / 2, period, 0.0, 0.0])
        if "drive" in names:
            path += self._fading_drive(period)
        decay, variance = [], []
        fading = {"disturbance": self.disturbance_time, "drive": self.drive_time}
        for name in names:
            sigma, lasts = self._sigma(name), fading.get(name.partition("_")[0])
            kept = 1.0 if lasts is None else float(np.exp(-period / lasts))
            decay.append(kept)
            # A fading quantity keeps its variance: φ² σ² + q = σ².
            variance.append((sigma * _DRIFT) ** 2 * period if lasts is None else sigma**2 * (1 - kept**2))
        squares = 2 * self.correlation_time * (self.nonlinearity / period) ** 2
        # A change is over within a longer period; its noise would feed itself through the law's own commands.
        late = self.late_drive * min(1.0, _LATE_PERIOD / period)
        dry = 2 * self.correlation_time * self.dry_shape**2
        return np.array([*densities, *path, squares, self.surprise, late, dry, *decay, *variance])

    def with_command_noise(self, noise: float, *, period: float, keeps: float = 0.0) -> Self:
        """Return the same for a drive whose commands carry white noise, m/s², new each period.

        keeps: what the drive's known lag leaves of an acceleration after a period; the noise passes through it too.
        """
        if keeps:
            lagging = noise * ((1 - keeps) / (1 + keeps)) ** 0.5
            return replace(self, drive_error=float(np.hypot(self.drive_error, lagging)))
        return replace(self, cart_noise=float(np.hypot(self.cart_noise, noise * period**0.5)))

    def _fading_drive(self, period: float) -> Array:
        """Return what the drive's error adds to the cart within a period, unknown at its beginning: pp, pv, vv, pd, vd.

        Without this a period that is as long as the error lasts would leave the cart's own motion exact.
        """
        nodes, weights = np.polynomial.legendre.leggauss(16)
        since, lasts = (1 + nodes) * period / 2, self.drive_time
        left = np.exp(-since / lasts)
        # What a push at `since` before the period's end has become of position, velocity and error.
        p, v, d = lasts * (since - lasts * (1 - left)), lasts * (1 - left), left
        density = weights * period / 2 * 2 * self.drive_error**2 / lasts
        return np.array([density @ (a * b) for a, b in ((p, p), (p, v), (v, v), (p, d), (v, d))])


@dataclass(frozen=True)
class EkfSettings(FilterSettings):
    """The extended Kalman filter as one compiled function."""


@dataclass(frozen=True)
class HoldEkfSettings(EkfSettings):
    """The same filter with the defaults for a hold.

    It estimates the accelerations that the model does not explain, above all those of dry friction; the feedback
    compensates them.
    """

    augment: tuple[str, ...] = ("zeros", "disturbance", "drive")
    disturbance: float = 3.0


@dataclass(frozen=True)
class FilterpyEkfSettings(FilterSettings):
    """The extended Kalman filter with filterpy's arithmetic: from the same settings the same numbers, slower."""

    kind: str = "ekf-filterpy"


@dataclass(frozen=True)
class UkfSettings(FilterSettings):
    """The unscented Kalman filter, filterpy's; the sigma points lie `spread` · √(N+E) standard deviations out.

    weight: Merwe's beta, what is known of the distribution's fourth moment; 2 for a Gaussian.
    """

    kind: str = "ukf"
    spread: float = setting(0.5, help="Distance of the sigma points in standard deviations, over √(N+E).")
    weight: float = setting(2.0, help="Merwe's beta; 2 for a Gaussian.")


@dataclass(frozen=True)
class AdaptiveFilterSettings(FilterSettings):
    """The defaults for an adaptive controller, which needs the model's errors.

    The filter estimates the errors, so process noise covers only what the estimate leaves out: their squares while they
    are uncertain (nonlinearity), and whatever the readings contradict (surprise). model_error is the standard deviation
    of log(p/p₀): 0.035, 0.07 and 0.14 where masses, lengths and inertias are drawn within ±5, ±10 and ±20 %. Dry
    friction that the model lacks is estimated: without that, 36 of 64 runs cross from rest with 2 mN m of it.
    """

    parameter_error: float = setting(0.0, least=0, most=_MOST)
    nonlinearity: float = setting(4.0, least=0, most=_MOST)
    dry_shape: float = setting(0.02, least=0, most=_MOST)
    surprise: float = setting(2.0, least=0, most=4)
    rate_noise: float = setting(1e-4, above=0, most=_MOST)
    cart_noise: float = setting(3e-3, above=0, most=_MOST)
    augment: tuple[str, ...] = setting(("zeros", "drive", "friction", "dry", "parameters"), choices=tuple(Augment))
    drive_error: float = setting(0.1, above=0, most=_MOST)
    late_drive: float = setting(0.5, least=0, most=_MOST)
    friction_error: float = setting(0.5, above=0, most=_MOST)
    model_error: float = setting(0.08, above=0, most=_MOST)


@dataclass(frozen=True)
class AdaptiveEkfSettings(AdaptiveFilterSettings, EkfSettings):
    """The compiled filter with these defaults."""


@dataclass(frozen=True)
class AdaptiveFilterpyEkfSettings(AdaptiveFilterSettings, FilterpyEkfSettings):
    """filterpy's extended filter with these defaults."""

    kind: str = "ekf-filterpy"


@dataclass(frozen=True)
class AdaptiveUkfSettings(AdaptiveFilterSettings, UkfSettings):
    """The unscented filter with these defaults."""

    kind: str = "ukf"


EstimatorSettings = EkfSettings | FilterpyEkfSettings | UkfSettings


@cache
def chi_square_band(freedom: int, *, share: float = 0.95) -> tuple[float, float]:
    """Return the interval that holds `share` of a chi-square variable, the same share left out on both sides."""
    # Imported here: runs that ask for no band do without.
    from scipy.special import chdtri

    return float(chdtri(freedom, (1 + share) / 2)), float(chdtri(freedom, (1 - share) / 2))


def share_inside(values: Array, freedom: int) -> float:
    """Return the part of NIS or NEES `values` (any shape) within the band of 95 %, which a consistent filter gives."""
    low, high = chi_square_band(freedom)
    return float(((values >= low) & (values <= high)).mean())


MEANS_OF = 50
"""Updates to each mean of the NIS. Single values scatter so far that most are in their band at a third of the mean."""


def mean_band(freedom: int) -> tuple[float, float]:
    """Return the interval that holds 95 % of the means of `MEANS_OF` chi-square variables."""
    low, high = chi_square_band(MEANS_OF * freedom)
    return low / MEANS_OF, high / MEANS_OF


def means_of(values: Array) -> Array:
    """Return means (K // MEANS_OF,) of values (K,), one after the other; the values themselves where they are fewer."""
    count = len(values) // MEANS_OF
    return values[: count * MEANS_OF].reshape(count, MEANS_OF).mean(axis=1) if count else values


@dataclass(frozen=True)
class NisMeans:
    """A NIS's average, what is expected of it, and the share of its means of `MEANS_OF` inside their 95 % band."""

    mean: float
    expected: int
    inside_95: float

    @property
    def sentence(self) -> str:
        """The figures, and what they say of the estimator's noise."""
        share = f"{self.inside_95:.1%} of its means of {MEANS_OF} inside"
        text = f"{self.mean:.2f} on average ({self.expected} expected); {share}"
        ratio = self.mean / self.expected
        if ratio < _CAUTIOUS:
            return f"{text}: the estimator expects far more noise than there is; {_LESS}"
        return f"{text}: the estimator expects less noise than there is" if ratio > _BOLD else text


_CAUTIOUS, _BOLD = 0.25, 1.25
"""Shares of the expected mean. The adaptive law's filter gives 0.9; those without parameters leave room for worse
drives than most: 0.6 at 1 kHz, 0.34 at 100 Hz. Below a quarter the settings of the sensors are wrong."""
_LESS = "set counts and noise under [sensors] as the encoders have them, or lower rate_noise and cart_noise"


def nis_means(values: Array, freedom: int) -> NisMeans | None:
    """Return what the finite values (K,) of a NIS average to; None where there are too few for one mean."""
    known = values[np.isfinite(values)]
    if len(known) < MEANS_OF:
        return None
    (low, high), means = mean_band(freedom), means_of(known)
    return NisMeans(float(known.mean()), freedom, float(np.mean((means >= low) & (means <= high))))


def nees(error: Array, covariance: Array) -> Array:
    """Return the normalised estimation error squared (…) of truth minus estimate (…, n) and covariance (…, n, n)."""
    return (error * np.linalg.solve(covariance, error[..., None])[..., 0]).sum(-1)
