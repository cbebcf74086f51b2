"""The extended Kalman filter on positions, as pure functions of an estimate.

    predict:  x⁻ = F(x, u),  P⁻ = A P Aᵀ + Q(x)         update:  y = wrap(z - H x⁻),  S = H P⁻ Hᵀ + R,
    K = P⁻ Hᵀ S⁻¹,  x = x⁻ + K y,  P = (I - K H) P⁻ (I - K H)ᵀ + K R Kᵀ,  NIS = yᵀ S⁻¹ y

Measured are the angles and the cart's position. The encoders are relative and their counts are summed, so the
noise of angle i contains that of all before it. Q stands for wrong parameters, whose effect is a share of the
acceleration: an arm at rest has little, a swinging one much.
Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, sections 5.4, 10.3.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray

from dpcontrol.control.consistency import chi_square_band as nis_band  # noqa: F401
from dpcontrol.control.estimator_settings import EkfSettings as EkfSettings
from dpcontrol.control.sampled import SampledModel
from dpcontrol.foundation.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Estimate:
    """What is believed: state (N,), covariance (N, N); innovation (m,) and nis of the last update (nan before)."""

    state: Array
    covariance: Array
    innovation: Array
    nis: float = float("nan")

    @property
    def standard_deviations(self) -> Array:
        """Return the square roots of the covariance's diagonal, (N,)."""
        return np.sqrt(self.covariance.diagonal())


def encoder_noise(arms: int, *, counts: int, cart_resolution: float) -> Array:
    """Return R (n+1, n+1): quantised relative encoders of `counts` per turn, summed; cart resolution in m.

    Rounding to a step of q has the variance q²/12; cov(angle_i, angle_j) = (min(i, j) + 1) q²/12.
    """
    q = 2 * np.pi / counts
    index = np.arange(arms)
    noise = np.zeros((arms + 1, arms + 1))
    noise[:arms, :arms] = (np.minimum.outer(index, index) + 1) * q**2 / 12
    noise[arms, arms] = cart_resolution**2 / 12
    return noise


class _Filter(ExtendedKalmanFilter):
    """filterpy's filter with the nonlinear prediction; it keeps its state as a column (N, 1)."""

    following: Array

    def predict_x(self, u: Any = 0) -> None:
        self.x = self.following[:, None]


class Ekf:
    """An extended Kalman filter for one sampled model. Its methods do not change what they are given.

    noise (n+1, n+1): of the measured positions. Not to be shared between threads: scratch space is reused.

    Raises:
        InputError: the noise has the wrong shape or is no covariance.
    """

    def __init__(self, model: SampledModel, settings: EkfSettings, *, noise: Array) -> None:
        m, n = model.arms + 1, model.dimension
        if np.shape(noise) != (m, m):
            raise InputError(f"measurement noise has shape {np.shape(noise)}: {model.arms} arms need ({m}, {m})")
        if not np.isfinite(noise).all() or np.linalg.eigvalsh(noise).min() <= 0:
            raise InputError("measurement noise must be a positive definite covariance")
        self.model = model
        self.settings = settings
        self._filter = _Filter(n, m)
        self._filter.R = np.array(noise, dtype=float)
        self._observed = np.eye(n)[model.position_indices]
        self._arms = model.arms
        self._positions = model.position_indices
        self._shapes = ((n,), (n, n), (m,))
        period = model.period
        block = np.array([[period**3 / 3, period**2 / 2], [period**2 / 2, period]])
        # Q = weights · [1, (rate changes in a period)²]; the share turns those into densities.
        share = 2 * settings.correlation_time * (settings.parameter_error / period) ** 2
        weights = np.zeros((model.arms + 1, n, n))
        for i in range(model.arms):
            pair = np.ix_([i, model.arms + i], [i, model.arms + i])
            weights[0][pair] = settings.rate_noise**2 * block
            weights[1 + i][pair] = share * block
        weights[0, n - 2 :, n - 2 :] = settings.cart_noise**2 * block
        self._noise_weights = weights.reshape(model.arms + 1, n * n)
        self._changes = np.ones(model.arms + 1)

    def first(self, state: Array) -> Estimate:
        """Return the estimate before any measurement: `state` (N,) with the settings' standard deviations."""
        n, arms, s = self.model.dimension, self._arms, self.settings
        x = np.array(state, dtype=float)
        if x.shape != (n,):
            raise InputError(f"state has shape {x.shape}: the filter's model needs ({n},)")
        sigma = [s.first_angle] * arms + [s.first_rate] * arms + [s.first_cart] * 2
        return Estimate(x, np.diag(np.square(sigma)), np.zeros(arms + 1))

    def predict(self, estimate: Estimate, command: float) -> Estimate:
        """Return the estimate one period later, the cart having accelerated by `command` m/s².

        Raises:
            InputError: the estimate's shapes do not fit the model.
        """
        x, covariance = estimate.state, estimate.covariance
        one, square, _ = self._shapes
        if x.shape != one or covariance.shape != square:
            raise InputError(
                f"estimate has shapes {x.shape} and {covariance.shape}: the filter's model needs {one} and {square}"
            )
        following, jacobian = self.model.step_with_jacobian(x, command)
        inner, arms = self._filter, self._arms
        changes = self._changes[1:]
        np.subtract(following[arms : 2 * arms], x[arms : 2 * arms], out=changes)
        changes *= changes
        inner.Q = self._changes.dot(self._noise_weights).reshape(square)
        inner.P = covariance
        inner.F = jacobian
        inner.following = following.copy()
        inner.predict()
        return Estimate(inner.following, inner.P, estimate.innovation, estimate.nis)

    def _residual(self, measured: Array, predicted: Array) -> Array:
        y = measured - predicted
        # A flag costs less than wrapping at every tick; only a lost estimate is half a turn away.
        if any(abs(v) > np.pi for v in y[: self._arms, 0].tolist()):
            angles = y[: self._arms]
            angles -= 2 * np.pi * np.round(angles / (2 * np.pi))
        return y

    def update(self, estimate: Estimate, measured: Array) -> Estimate:
        """Return the estimate after the positions `measured` (n+1,): angles in rad, cart in m.

        Raises:
            InputError: the measurement or the estimate has the wrong shape.
            ArithmeticError: the covariance is singular or no longer finite.
        """
        z = np.asarray(measured, dtype=float)
        one, square, wanted = self._shapes
        x, covariance = estimate.state, estimate.covariance
        if z.shape != wanted or x.shape != one or covariance.shape != square:
            raise InputError(
                f"measurement has shape {z.shape}, state {x.shape} and covariance {covariance.shape}: the filter "
                f"needs {wanted}, {one} and {square}"
            )
        inner = self._filter
        inner.x = x[:, None]
        inner.P = covariance
        try:
            inner.update(z[:, None], self._jacobian, self._observe, residual=self._residual)
        except ValueError as error:  # LinAlgError is one; scipy refuses what is not finite with the other.
            raise ArithmeticError(f"the filter's innovation covariance has no inverse ({error})") from error
        y = inner.y[:, 0]
        return Estimate(inner.x[:, 0], inner.P, y, float(y @ inner.SI @ y))

    def _jacobian(self, _: Array) -> Array:
        return self._observed

    def _observe(self, state: Array) -> Array:
        return state[self._positions]
