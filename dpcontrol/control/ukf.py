"""The unscented Kalman filter with filterpy's arithmetic.

It propagates P through the equations of motion with 2(N+E)+1 sigma points, without Jacobians:
    χ_i = z ± α √(N+E) (√P)_i,   z⁻ = Σ w_i F(χ_i),   P⁻ = Σ c_i (F(χ_i) - z⁻)(F(χ_i) - z⁻)ᵀ + Q
One call of the compiled equations propagates all sigma points.

Source: Wan & van der Merwe, The Unscented Kalman Filter, in Haykin (ed.), Kalman Filtering and Neural Networks (2001),
chapter 7, table 7.3.

It shares the equations of motion and Q with the compiled filter, but not its arithmetic.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from dpcontrol.control.ekf import KalmanFilter
from dpcontrol.control.estimator_settings import UkfSettings
from dpcontrol.control.interface import Estimate, Present, SampledModel
from dpcontrol.dynamics.compiled import Compiled
from dpcontrol.foundation.arrays import Array


@contextmanager
def _arithmetic() -> Iterator[None]:
    """Report a covariance that is no longer positive as an error of arithmetic."""
    try:
        yield
    except (ValueError, np.linalg.LinAlgError) as error:
        raise ArithmeticError(f"the filter's covariance is no longer positive ({error})") from error


class _Unscented(UnscentedKalmanFilter):
    """filterpy's filter, with array products instead of loops over sigma points."""

    move: Callable[[Array], Array]

    def compute_process_sigmas(self, dt: float, fx: Any = None, **fx_args: Any) -> None:
        """Set the propagated sigma points (2(N+E)+1, N+E), in place of the base class's loop over `fx`.

        `move` replaces `fx`, so the arguments are not used.
        """
        points = self.points_fn.sigma_points(self.x, self.P)
        self.sigmas_f = self.move(np.ascontiguousarray(points.T)).T

    def cross_variance(self, x: Array, z: Array, sigmas_f: Array, sigmas_h: Array) -> Array:
        """Return the covariance (N+E, m) between state and measurement from their sigma points, as one product."""
        return (sigmas_f - x).T @ (self.Wc[:, None] * (sigmas_h - z))


class Ukf(KalmanFilter):
    """filterpy's unscented Kalman filter, whose points follow the compiled model.

    An `Estimator` with memory (z (N+E,), P (N+E, N+E)), which must not be shared between threads.

    `_inner` is filterpy's filter, whose state is overwritten before each use, and `_points` computes its sigma points.
    It reads the present period's command, m/s², from `_command`, since filterpy passes none. `size` is N+E, `_shares`
    are the indices in z of the errors of inertial parameters, and `_linear` is the prediction with its Jacobian and Q.
    """

    def __init__(self, model: SampledModel, settings: UkfSettings, *, noise: Array) -> None:
        """Prepare filterpy's filter, whose sigma points follow the compiled model.

        Args:
            model: model of arms and drive from tick to tick.
            settings: settings of the filter.
            noise: covariance (n+1, n+1) of the measured positions.
        """
        super().__init__(model, settings, noise=noise)
        self.size = self.equations.dimension
        self._shares = self.equations.shares
        self._linear = Compiled(self.equations.prediction(with_jacobian=True))
        self._command = 0.0
        points = MerweScaledSigmaPoints(self.size, alpha=settings.spread, beta=settings.weight, kappa=0.0)
        unscented = _Unscented(self.size, model.arms + 1, model.period, hx=None, fx=None, points=points)
        unscented.move = lambda sigma_points: self.following(sigma_points, self._command)
        self._points, self._inner = points, unscented

    def following(self, points: Array, command: float) -> Array:
        """Return the next z of several points.

        Args:
            points: points (N+E,) or (N+E, S).
            command: acceleration of the cart, m/s².

        Returns:
            Points of the same shape.
        """
        inputs = np.empty((self.ahead_of.size_in, *points.shape[1:]))
        column = (slice(None), *(None for _ in points.shape[1:]))
        inputs[: self.size] = points
        inputs[self.size] = command
        inputs[self.ahead_of.slices["parameters"]] = self.model.parameters[column]
        inputs[self.ahead_of.slices["process"]] = self.process[column]
        return self.ahead_of(inputs, np.empty(points.shape))

    def linearised(self, z: Array, covariance: Array, command: float) -> tuple[Array, Array, Array]:
        """Return the next z (N+E,), its Jacobian and the covariance Q of the process noise (N+E, N+E).

        Args:
            z: present estimate (N+E,).
            covariance: its covariance (N+E, N+E).
            command: acceleration of the cart, m/s².
        """
        variance = covariance.diagonal()[self._shares].mean() if self._shares else 0.0
        inputs = np.concatenate([z, [command], self.model.parameters, self.process, [variance, 0.0, 1.0]])
        results, n = self._linear(inputs, np.empty(self._linear.size_out)), self.size
        return results[:n], results[n : n + n * n].reshape(n, n).T, results[n + n * n :].reshape(n, n).T

    def _begun(self, z: Array, covariance: Array) -> Estimate:
        """Return the estimate z (N+E,) with this covariance (N+E, N+E), before a measurement."""
        return self._estimate(z, covariance, np.zeros(self.model.arms + 1), float("nan"), 0)

    def _estimate(self, z: Array, covariance: Array, innovation: Array, nis: float, used: int) -> Estimate:
        """Return the estimate z (N+E,) with a covariance (N+E, N+E), after a check that both are sound.

        `innovation` (n+1,), `nis` and `used`: see `Estimate`; `used` is 0 without a measurement.

        Raises:
            ArithmeticError: they are no longer finite, or a variance is negative.
        """
        n, variances = self.model.dimension, covariance.diagonal()
        if not (variances >= 0).all() or not np.isfinite(z).all() or (used and not 0 <= nis < np.inf):
            raise ArithmeticError("the filter's covariance is no longer positive, or its state no longer finite")
        return Estimate(z[:n], z[n:], np.sqrt(variances), innovation, nis, used, (z, covariance))

    def update(self, estimate: Estimate, measured: Array, present: Present = None) -> Estimate:
        """Return the estimate after a measurement.

        Args:
            estimate: estimate before it.
            measured: positions (n+1,), rad and m.
            present: True for each valid position (n+1,), None if all are valid.

        Raises:
            ArithmeticError: the covariance is singular or no longer finite.
        """
        m = self.model.arms + 1
        rows = np.arange(m) if present is None else np.flatnonzero(present)
        z, covariance = estimate.memory
        innovation = np.zeros(m)
        if not len(rows):
            return self._estimate(z, covariance, innovation, 0.0, 0)
        observation, noise = self.equations.observation[rows], self.noise[np.ix_(rows, rows)]
        # Wrapped, because whole turns in a measured angle have no meaning.
        difference = measured[rows] - observation @ z
        turns = np.where(rows < m - 1, np.round(difference / (2 * np.pi)), 0.0)
        with _arithmetic():
            updated, updated_covariance, row_innovation, nis = self._updated(
                z, covariance, measured[rows] - 2 * np.pi * turns, observation, noise
            )
        innovation[rows] = row_innovation
        return self._estimate(updated, updated_covariance, innovation, nis, len(rows))

    def step(self, estimate: Estimate, command: float, measured: Array, present: Present = None) -> Estimate:
        """Return the estimate after a period and a new measurement.

        It raises the errors of `update`.

        Args:
            estimate: estimate one tick earlier.
            command: acceleration of the cart during the period, m/s².
            measured: positions (n+1,), rad and m.
            present: True for each valid position (n+1,), None if all are valid.
        """
        z, covariance = estimate.memory
        with _arithmetic():
            memory = self._predicted(z, covariance, command)
        return self.update(estimate._replace(memory=memory), measured, present)

    def ahead(self, estimate: Estimate, commands: Sequence[float]) -> Array:
        """Return the state (N,) after the pending commands.

        The extras act during the prediction.

        Args:
            estimate: present estimate.
            commands: pending commands, one per period, oldest first, m/s².
        """
        z = estimate.memory[0]
        for command in commands:
            z = self.following(z, command)
        return z[: self.model.dimension]

    def covariance(self, estimate: Estimate) -> Array:
        """Return the covariance (N+E, N+E) of state and extra.

        Args:
            estimate: estimate of this filter.
        """
        return estimate.memory[1]

    def _predicted(self, z: Array, covariance: Array, command: float) -> tuple[Array, Array]:
        """Return z (N+E,) and its covariance a period later, before the next measurement.

        `command`: acceleration of the cart in the period, m/s².
        """
        unscented, self._command = self._inner, command
        unscented.x, unscented.P = z, covariance
        unscented.Q = self.linearised(z, covariance, command)[2]
        unscented.predict()
        return unscented.x, unscented.P

    def _updated(
        self, z: Array, covariance: Array, measured: Array, observation: Array, noise: Array
    ) -> tuple[Array, Array, Array, float]:
        """Return state (N+E,), covariance, innovation (m,) and NIS after a measurement of m of the positions.

        `measured` (m,): positions, rad and m, with angles within half a turn of the prediction. `observation` (m, N+E),
        `noise` (m, m): H and R of these positions.
        """
        unscented = self._inner
        unscented.x, unscented.P = z, covariance
        unscented.sigmas_f = self._points.sigma_points(z, covariance)
        unscented.update(measured, R=noise, hx=lambda point: observation @ point)
        return (
            unscented.x,
            (unscented.P + unscented.P.T) / 2,
            unscented.y,
            float(unscented.y @ unscented.SI @ unscented.y),
        )
