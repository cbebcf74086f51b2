"""The unscented and the extended Kalman filter with filterpy's arithmetic.

The unscented filter takes P through the equations of motion by 2(N+E)+1 sigma points, without Jacobians:
    χ_i = z ± α √(N+E) (√P)_i,   z⁻ = Σ w_i F(χ_i),   P⁻ = Σ c_i (F(χ_i) - z⁻)(F(χ_i) - z⁻)ᵀ + Q
All sigma points go through the compiled equations in one call.

Source: Wan & van der Merwe, The Unscented Kalman Filter, in Haykin (ed.), Kalman Filtering and Neural Networks (2001),
chapter 7, table 7.3.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter
from numpy.typing import NDArray

from dpcontrol.control.estimator_settings import FilterSettings, UkfSettings
from dpcontrol.control.filterpy_base import FilterpyEstimator
from dpcontrol.control.sampled import SampledModel

Array = NDArray[np.float64]


class FilterpyEkf(FilterpyEstimator):
    """The extended Kalman filter; the same numbers as the compiled one, by other means."""

    def __init__(self, model: SampledModel, settings: FilterSettings, *, noise: Array) -> None:
        super().__init__(model, settings, noise=noise)
        self._filters = [_Extended(self.size, m + 1) for m in range(model.arms + 1)]

    def _predicted(self, z: Array, covariance: Array, command: float) -> tuple[Array, Array]:
        inner = self._filters[0]
        inner.following, inner.F, inner.Q = self.linearised(z, command)
        inner.P = covariance
        inner.predict()
        return inner.following, inner.P

    def _updated(
        self, z: Array, covariance: Array, measured: Array, observation: Array, noise: Array
    ) -> tuple[Array, Array, Array, float]:
        inner = self._filters[len(measured) - 1]
        # filterpy keeps columns, and broadcasts (n,) silently into (n, n).
        inner.x, inner.P = z[:, None], covariance
        inner.update(measured[:, None], lambda _: observation, lambda x: observation @ x, R=noise)
        y = inner.y[:, 0]
        return inner.x[:, 0], inner.P, y, float(y @ inner.SI @ y)


class _Extended(ExtendedKalmanFilter):
    """filterpy's filter with the nonlinear prediction."""

    following: Array

    def predict_x(self, u: Any = 0) -> None:
        self.x = self.following[:, None]


class _Unscented(UnscentedKalmanFilter):
    """filterpy's filter, its loops over sigma points as products of arrays."""

    move: Callable[[Array], Array]

    def compute_process_sigmas(self, dt: float, fx: Any = None, **fx_args: Any) -> None:
        points = self.points_fn.sigma_points(self.x, self.P)
        self.sigmas_f = self.move(np.ascontiguousarray(points.T)).T

    def cross_variance(self, x: Array, z: Array, sigmas_f: Array, sigmas_h: Array) -> Array:
        return (sigmas_f - x).T @ (self.Wc[:, None] * (sigmas_h - z))


class Ukf(FilterpyEstimator):
    """The unscented Kalman filter."""

    def __init__(self, model: SampledModel, settings: UkfSettings, *, noise: Array) -> None:
        super().__init__(model, settings, noise=noise)
        self._command = 0.0
        points = MerweScaledSigmaPoints(self.size, alpha=settings.spread, beta=settings.weight, kappa=0.0)
        inner = _Unscented(self.size, model.arms + 1, model.period, hx=None, fx=None, points=points)
        inner.move = lambda chosen: self.following(chosen, self._command)
        self._points, self._inner = points, inner

    def _predicted(self, z: Array, covariance: Array, command: float) -> tuple[Array, Array]:
        inner, self._command = self._inner, command
        inner.x, inner.P = z, covariance
        inner.Q = self.linearised(z, command)[2]
        inner.predict()
        return inner.x, inner.P

    def _updated(
        self, z: Array, covariance: Array, measured: Array, observation: Array, noise: Array
    ) -> tuple[Array, Array, Array, float]:
        inner = self._inner
        inner.x, inner.P = z, covariance
        inner.sigmas_f = self._points.sigma_points(z, covariance)
        inner.update(measured, R=noise, hx=lambda point: observation @ point)
        return inner.x, (inner.P + inner.P.T) / 2, inner.y, float(inner.y @ inner.SI @ inner.y)
