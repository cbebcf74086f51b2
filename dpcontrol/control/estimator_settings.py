"""Assumptions of the estimators: noise, initial uncertainty, extra quantities.

Extra quantities are estimated in addition to the state:

    zeros        errors b_i of the arms' encoders, constants added to the measured angles

    disturbance  further accelerations of the arms, rad/s², that decay: first-order Gauss-Markov

    drive        further acceleration of the cart, m/s², that decays: error of the drive beyond the command

    friction     relative errors of the joints' friction: constants

    dry          Coulomb friction of the joints that the model lacks, over gravity's torques G_i: constants

    parameters   errors log(p/p₀) of the base parameters, over M12 (one arm: M11): constants

The parameters are logarithms, because their undetermined combination is then nearly constant over all linearisations.
So the filter does not become overconfident along the way. Reports and logs give relative errors.

With the cart's acceleration as input, only ratios of the inertial parameters are identifiable, so one of them is fixed.
G_i and S_i share a factor, because gravity is known. Only gravity determines the common part of all zeros. While the
arms barely move about a vertical, zeros and disturbance cannot be distinguished, so do not combine them without reason.

Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, sections 8.2 and 11.9.

Consistency of an estimator: NIS on every run, NEES if the truth is known.

    NIS = yᵀ S⁻¹ y ~ χ²(m),    NEES = (z - ẑ)ᵀ P⁻¹ (z - ẑ) ~ χ²(N+E),    both two-sided: small values are wrong as well

Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, section 5.4.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from typing import Annotated, Any, Self

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.settings import Setting, Settings


class Augment(StrEnum):
    """Quantities that an estimator can add to the state.

    They are in the order of `extra`.
    """

    ZEROS = "zeros"
    DISTURBANCE = "disturbance"
    DRIVE = "drive"
    FRICTION = "friction"
    DRY = "dry"
    PARAMETERS = "parameters"


_DRIFT = 1e-6
"""Process noise of a constant per √s, relative to its initial standard deviation, for a positive filter gain."""


def extra_names(arms: int, augment: tuple[Augment, ...]) -> tuple[str, ...]:
    """Return the names of the extra quantities.

    They are zero_1 …, disturbance_1 …, drive, friction_1 …, dry_1 …, M11 …, S1 …

    Args:
        arms: number of arms.
        augment: kinds of quantities, in any order.
    """
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


def constants(arms: int, augment: tuple[Augment, ...]) -> tuple[str, ...]:
    """Return the names of the errors of friction and parameters, which are the same in each run of a rig.

    They are the last of `extra_names`.

    Args:
        arms: number n of arms.
        augment: kinds of extras.
    """
    constant = {Augment.FRICTION, Augment.DRY, Augment.PARAMETERS}
    return extra_names(arms, tuple(kind for kind in augment if kind in constant))


_LATE_PERIOD = 1e-3
"""Period above which late_drive is reduced in proportion, s: in full, it loses most runs at 200 Hz."""
_MOST = 1e6
"""Largest assumption of a filter in its unit; squares of larger values would overflow."""


@dataclass(frozen=True)
class FilterSettings(Settings, table="estimator"):
    """Noise that a filter assumes, and quantities that it estimates.

    The quantities are estimated in addition to the state.

    Q's density for relative errors of the accelerations is 2 · time · (share · acceleration)².

    Attributes:
        parameter_error: relative error of the accelerations.
        correlation_time: duration of such an error, s.
        nonlinearity: further relative error per variance of the estimated parameters.
        dry_shape: relative error of the law of dry friction, known or estimated.
        surprise: power of the mean NIS per position that scales Q if it exceeds 1, 0 for none.
        rate_noise, cart_noise: floors of Q, rad/s/√s and m/s/√s.
        first_angle, first_rate, first_cart: initial standard deviations, rad, rad/s and m (cart's velocity m/s).
        augment: any of zeros, disturbance, drive, friction, dry, parameters.
        zero_error: standard deviation of the encoders' zeros, rad.
        disturbance, disturbance_time: standard deviation, rad/s², and duration, s, of the arms' further accelerations.
        drive_error, drive_time: standard deviation, m/s², and duration, s, of the drive's error.
        late_drive: share of each command change that adds to the drive's error, as for an unmodelled lag. It is reduced
            in proportion at periods above 1 ms.
        friction_error, dry_error, model_error: standard deviations of the relative errors of friction, of dry friction
            over gravity's torques, and of the relative errors of the parameters.
        learnt: covariance of the constant errors at the start, row by row in the order of `constants`; empty for
            independent errors of the standard deviations above.
    """

    kind: str = "ekf"
    parameter_error: Annotated[float, Setting(least=0, most=_MOST, help="Relative error of the accelerations.")] = 0.01
    correlation_time: Annotated[float, Setting(above=0, most=_MOST, help="Duration of such an error.")] = 0.02
    nonlinearity: Annotated[
        float, Setting(least=0, most=_MOST, help="Further relative error per variance of the estimated parameters.")
    ] = 2.5
    dry_shape: Annotated[float, Setting(least=0, most=_MOST, help="Relative error of the law of dry friction.")] = 0.0
    surprise: Annotated[
        float, Setting(least=0, most=4, help="Power of the mean NIS that scales the process noise.")
    ] = 0.0
    rate_noise: Annotated[float, Setting(above=0, most=_MOST, help="Floor of the process noise of the rates.")] = 0.03
    cart_noise: Annotated[
        float, Setting(above=0, most=_MOST, help="Floor of the process noise of the cart's velocity.")
    ] = 0.1
    first_angle: Annotated[
        float,
        Setting(above=0, most=_MOST, unit="rad", usual=(0.0, 1.0), help="Initial standard deviation of the angles."),
    ] = 0.03
    first_rate: Annotated[
        float,
        Setting(above=0, most=_MOST, unit="rad/s", usual=(0.0, 50.0), help="Initial standard deviation of the rates."),
    ] = 0.1
    first_cart: Annotated[
        float, Setting(above=0, most=_MOST, help="Initial standard deviation of the cart's position and velocity.")
    ] = 1e-3
    augment: Annotated[
        tuple[str, ...], Setting(choices=tuple(Augment), help="Quantities estimated in addition to the state.")
    ] = ("zeros", "drive")
    zero_error: Annotated[
        float,
        Setting(above=0, most=_MOST, unit="rad", usual=(0.0, 0.6), help="Standard deviation of the encoders' zeros."),
    ] = 0.012
    disturbance: Annotated[
        float, Setting(above=0, most=_MOST, help="Standard deviation of the arms' further accelerations.")
    ] = 1.0
    disturbance_time: Annotated[float, Setting(above=0, most=_MOST, help="Their correlation time.")] = 0.1
    drive_error: Annotated[float, Setting(above=0, most=_MOST, help="Standard deviation of the drive's error.")] = 3.0
    drive_time: Annotated[float, Setting(above=0, most=_MOST, help="Its correlation time.")] = 0.01
    late_drive: Annotated[
        float, Setting(least=0, most=_MOST, help="Share of each command change that adds to the drive's error.")
    ] = 0.0
    friction_error: Annotated[
        float, Setting(above=0, most=_MOST, help="Standard deviation of the relative friction errors.")
    ] = 0.3
    dry_error: Annotated[
        float, Setting(above=0, most=_MOST, help="Standard deviation of dry friction over gravity's torques.")
    ] = 0.005
    model_error: Annotated[
        float, Setting(above=0, most=_MOST, help="Standard deviation of the parameters' relative errors.")
    ] = 0.1
    learnt: Annotated[
        tuple[float, ...],
        Setting(help="Covariance of friction's and parameters' errors at the start, as `dpcontrol learn` writes it."),
    ] = ()

    def _check_together(self) -> None:
        """Check that each quantity is augmented once; the other settings are checked one by one."""
        if len(set(self.augment)) != len(self.augment):
            raise self.refusal("augment", "name each once")

    @property
    def augments(self) -> tuple[Augment, ...]:
        """Return the quantities estimated in addition to the state, in order."""
        return tuple(kind for kind in Augment if kind in self.augment)

    def first_covariance(self, arms: int) -> Array:
        """Return the initial covariance of state and extra, (N+E, N+E).

        Args:
            arms: number of arms.

        Raises:
            InputError: `learnt` is not a covariance of these arms' constant errors.
        """
        state = [self.first_angle] * arms + [self.first_rate] * arms + [self.first_cart] * 2
        covariance = np.diag(np.square([*state, *map(self._sigma, extra_names(arms, self.augments))]))
        count = len(constants(arms, self.augments))
        if len(self.learnt) not in (0, count**2):
            raise self.refusal("learnt", f"must have {count} rows and columns for these arms; learn again")
        if self.learnt:
            covariance[-count:, -count:] = np.reshape(self.learnt, (count, count))
        return covariance

    def _sigma(self, name: str) -> float:
        """Return the standard deviation of an extra quantity at the start of a run, in its unit.

        Names are those of `extra_names`, such as "zero_1"; M11 … and S1 … are relative errors of the arms' parameters.
        """
        kind = name.partition("_")[0]
        sigmas = {
            "zero": self.zero_error,
            "disturbance": self.disturbance,
            "drive": self.drive_error,
            "friction": self.friction_error,
            "dry": self.dry_error,
        }
        return sigmas.get(kind, self.model_error)

    def process(self, arms: int, period: float) -> Array:
        """Return the noise parameters of the filter's equations.

        These are, in order:

            Densities of the arms' noise, absolute and relative.

            Covariance added per period to the cart's position and velocity (pp, pv, vv) and to the drive's error (pd,
            vd).

            The relative density for a variance of 1 of the parameters. surprise. late_drive.

            The density for dry friction of 1 rad/s². Decay (E,) and variance (E,) of the extras per period.

        Args:
            arms: number of arms.
            period: time between ticks, s.
        """
        names = extra_names(arms, self.augments)
        densities = [self.rate_noise**2, 2 * self.correlation_time * (self.parameter_error / period) ** 2]
        cart_covariance = self.cart_noise**2 * np.array([period**3 / 3, period**2 / 2, period, 0.0, 0.0])
        if "drive" in names:
            cart_covariance += self._fading_drive(period)
        decay, variance = [], []
        fading = {"disturbance": self.disturbance_time, "drive": self.drive_time}
        for name in names:
            sigma, duration = self._sigma(name), fading.get(name.partition("_")[0])
            factor = 1.0 if duration is None else float(np.exp(-period / duration))
            decay.append(factor)
            # A decaying quantity keeps its variance: φ² σ² + q = σ².
            variance.append((sigma * _DRIFT) ** 2 * period if duration is None else sigma**2 * (1 - factor**2))
        squares = 2 * self.correlation_time * (self.nonlinearity / period) ** 2
        # A change ends within a longer period, and its noise would feed back through the law's commands.
        late_share = self.late_drive * min(1.0, _LATE_PERIOD / period)
        dry = 2 * self.correlation_time * self.dry_shape**2
        return np.array([*densities, *cart_covariance, squares, self.surprise, late_share, dry, *decay, *variance])

    def with_command_noise(self, noise: float, *, period: float, keeps: float = 0.0) -> Self:
        """Return the settings for a drive with white noise on its commands, which the process noise then covers.

        Args:
            noise: standard deviation of white noise, drawn in each period, m/s².
            period: time between ticks, s.
            keeps: share of an acceleration that a known lag leaves after a period, default 0. The noise passes through
                this lag.
        """
        if keeps:
            lagging = noise * ((1 - keeps) / (1 + keeps)) ** 0.5
            return replace(self, drive_error=float(np.hypot(self.drive_error, lagging)))
        return replace(self, cart_noise=float(np.hypot(self.cart_noise, noise * period**0.5)))

    def _fading_drive(self, period: float) -> Array:
        """Return the covariance that an unknown drive error adds within a period, as pp, pv, vv, pd, vd.

        p, v and d are the cart's position and velocity and the drive's error. Without this covariance, a period as long
        as the error's duration would leave the cart's motion exact. It is integrated over the times of the error's
        random changes.
        """
        nodes, weights = np.polynomial.legendre.leggauss(16)
        times, duration = (1 + nodes) * period / 2, self.drive_time
        remaining = np.exp(-times / duration)
        # Position, velocity and error due to a push at `since` before the period's end.
        p, v, d = duration * (times - duration * (1 - remaining)), duration * (1 - remaining), remaining
        density = weights * period / 2 * 2 * self.drive_error**2 / duration
        return np.array([density @ (a * b) for a, b in ((p, p), (p, v), (v, v), (p, d), (v, d))])


@dataclass(frozen=True)
class EkfSettings(FilterSettings):
    """The extended Kalman filter as one compiled function."""


@dataclass(frozen=True)
class UkfSettings(FilterSettings):
    """filterpy's unscented Kalman filter.

    The sigma points are at `spread` · √(N+E) standard deviations.

    weight: Merwe's beta for the distribution's fourth moment; 2 for a Gaussian.
    """

    kind: str = "ukf"
    spread: Annotated[float, Setting(help="Distance of the sigma points in standard deviations, over √(N+E).")] = 0.5
    weight: Annotated[float, Setting(help="Merwe's beta; 2 for a Gaussian.")] = 2.0


HOLD: Mapping[str, Any] = {"augment": ("zeros", "disturbance", "drive"), "disturbance": 3.0}
"""Settings of the extended filter with which a hold begins.

It estimates unmodelled accelerations, above all those of dry friction. The feedback compensates them. In runs with
flights, it also estimates the errors of the arms' parameters, by which flights are planned.
"""
ADAPTIVE: Mapping[str, Any] = {
    "parameter_error": 0.0,
    "nonlinearity": 4.0,
    "dry_shape": 0.02,
    "surprise": 2.0,
    "rate_noise": 1e-4,
    "cart_noise": 3e-3,
    "augment": ("zeros", "drive", "friction", "dry", "parameters"),
    "drive_error": 0.1,
    "late_drive": 0.5,
    "friction_error": 0.5,
    "model_error": 0.08,
}
"""Settings with which an adaptive controller begins, since it needs the model's errors.

The filter estimates the errors, so process noise only covers the rest: their squares while they are uncertain
(nonlinearity), and contradictions by the readings (surprise). model_error is the standard deviation of log(p/p₀).
It is 0.035, 0.07 and 0.14 if masses, lengths and inertias are drawn within ±5, ±10 and ±20 %. Unmodelled dry friction
is estimated. Without this, only 36 of 64 runs cross from rest with 2 mN m of it.
"""
EstimatorSettings = EkfSettings | UkfSettings


@cache
def chi_square_band(freedom: int, *, share: float = 0.95) -> tuple[float, float]:
    """Return the central interval of a chi-square variable, in which a consistent filter's NIS or NEES lies.

    Args:
        freedom: degrees of freedom.
        share: probability of the interval, default 0.95.
    """
    # Imported here because most runs need no band.
    from scipy.special import chdtri

    return float(chdtri(freedom, (1 + share) / 2)), float(chdtri(freedom, (1 - share) / 2))


def share_inside(values: Array, freedom: int) -> float:
    """Return the share of values in their 95 % band.

    The band is that of a consistent filter.

    Args:
        values: NIS or NEES, of any shape.
        freedom: degrees of freedom.
    """
    low, high = chi_square_band(freedom)
    return float(((values >= low) & (values <= high)).mean())


MEANS_OF = 50
"""Updates per mean of the NIS. Single values scatter: most are in their band even at a third of the expected mean."""


def mean_band(freedom: int) -> tuple[float, float]:
    """Return the 95 % interval of means of `MEANS_OF` chi-square variables, for means of a consistent filter's NIS.

    Args:
        freedom: degrees of freedom of each variable.
    """
    low, high = chi_square_band(MEANS_OF * freedom)
    return low / MEANS_OF, high / MEANS_OF


def means_of(values: Array) -> Array:
    """Return means of `MEANS_OF` successive values, or the values themselves if they are too few.

    Args:
        values: values (K,).

    Returns:
        Means (K // MEANS_OF,).
    """
    count = len(values) // MEANS_OF
    return values[: count * MEANS_OF].reshape(count, MEANS_OF).mean(axis=1) if count else values


@dataclass(frozen=True)
class NisMeans:
    """Average of a NIS, and its consistency.

    It includes the expected value, and the share of its means of `MEANS_OF` in their 95 % band.
    """

    mean: float
    expected: int
    inside_95: float

    @property
    def sentence(self) -> str:
        """The figures, with a diagnosis of the estimator's noise."""
        share = f"{self.inside_95:.1%} of its means of {MEANS_OF} inside"
        text = f"{self.mean:.2f} on average ({self.expected} expected); {share}"
        ratio = self.mean / self.expected
        if ratio < _CAUTIOUS:
            return f"{text}: the estimator assumes far too much noise; {_LESS}"
        return f"{text}: the estimator assumes too little noise" if ratio > _BOLD else text


_CAUTIOUS, _BOLD = 0.25, 1.25
"""Shares of the expected mean. The adaptive law's filter gives 0.9. Filters without parameters allow for bad drives and
give 0.6 at 1 kHz, 0.34 at 100 Hz. Below a quarter, the settings of the sensors are wrong."""
_LESS = "set counts and noise in [run] to those of the encoders, or lower rate_noise and cart_noise"


def nis_means(values: Array, freedom: int) -> NisMeans | None:
    """Return the average of a NIS's finite values with its consistency, for the report of a run.

    Args:
        values: NIS (K,), NaN where unknown.
        freedom: degrees of freedom.

    Returns:
        The average, or None if there are too few values for one mean.
    """
    finite = values[np.isfinite(values)]
    if len(finite) < MEANS_OF:
        return None
    (low, high), means = mean_band(freedom), means_of(finite)
    return NisMeans(float(finite.mean()), freedom, float(np.mean((means >= low) & (means <= high))))


def nees(error: Array, covariance: Array) -> Array:
    """Return the normalised estimation error squared (…), the consistency of an estimate with its covariance.

    Args:
        error: truth minus estimate (…, n).
        covariance: covariance (…, n, n).
    """
    return (error * np.linalg.solve(covariance, error[..., None])[..., 0]).sum(-1)
