"""filterpy's extended Kalman filter on the equations of motion and the process noise of the compiled filter."""

from typing import Any

from filterpy.kalman import ExtendedKalmanFilter

from dpcontrol.control.estimator_settings import UkfSettings
from dpcontrol.control.interface import SampledModel
from dpcontrol.control.ukf import Ukf
from dpcontrol.foundation.arrays import Array


class _Extended(ExtendedKalmanFilter):
    """filterpy's filter with the nonlinear prediction."""

    following: Array

    def predict_x(self, u: Any = 0) -> None:
        self.x = self.following[:, None]


class FilterpyEkf(Ukf):
    """The extended Kalman filter, numerically equal to the compiled one."""

    def __init__(self, model: SampledModel, settings: UkfSettings, *, noise: Array) -> None:
        super().__init__(model, settings, noise=noise)
        self.filters = [_Extended(self.size, m + 1) for m in range(model.arms + 1)]

    def _predicted(self, z: Array, covariance: Array, command: float) -> tuple[Array, Array]:
        inner = self.filters[0]
        inner.following, inner.F, inner.Q = self.linearised(z, covariance, command)
        inner.P = covariance
        inner.predict()
        return inner.following, inner.P

    def _updated(
        self, z: Array, covariance: Array, measured: Array, observation: Array, noise: Array
    ) -> tuple[Array, Array, Array, float]:
        inner = self.filters[len(measured) - 1]
        # filterpy uses columns, and broadcasts (n,) to (n, n) without a warning.
        inner.x, inner.P = z[:, None], covariance
        inner.update(measured[:, None], lambda _: observation, lambda x: observation @ x, R=noise)
        y = inner.y[:, 0]
        return inner.x[:, 0], inner.P, y, float(y @ inner.SI @ y)
