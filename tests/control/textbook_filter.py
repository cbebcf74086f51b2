"""The extended Kalman filter as the textbook writes it, in plain matrices: what the compiled one is compared with.

Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, sections 5.2 and 10.3.
"""

import numpy as np

from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.interface import SampledModel


def cart_noise(model: SampledModel, state: np.ndarray, command: float, density: float) -> np.ndarray:
    """Return the covariance per period due to white acceleration of the cart, m/s²/√Hz, arms included.

    By the mean over the stages of Runge-Kutta of the rates' slopes by the command.
    """
    t, half, rate = model.period, model.period / 2, model.equations.function()

    def slope(x: np.ndarray) -> np.ndarray:
        return np.array(rate(x, command, model.parameters))[:, 0]

    first = slope(state)
    second = slope(state + half * first)
    third = slope(state + half * second)
    places = (state, state + half * first, state + half * second, state + t * third)
    pushed = [np.array(rate(x, 1.0, model.parameters) - rate(x, 0.0, model.parameters))[:, 0] for x in places]
    mean = np.average(pushed, axis=0, weights=(1, 2, 2, 1))
    reach = np.zeros((6, 2))
    for p, v in zip((0, 1, 4), (2, 3, 5), strict=True):
        reach[p, 0] = reach[v, 1] = mean[v]
    return density**2 * reach @ np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]]) @ reach.T


class TextbookFilter:
    """Keeps state (6,), covariance (6, 6), innovation (3,) and nis of the last step; noise (3, 3)."""

    def __init__(self, model: SampledModel, settings: EkfSettings, *, noise: np.ndarray, state: np.ndarray) -> None:
        self.model, self.settings, self.noise = model, settings, noise
        self.observation = np.eye(6)[[0, 1, 4]]
        s = settings
        self.state = np.array(state, dtype=float)
        self.covariance = np.diag(np.square([s.first_angle] * 2 + [s.first_rate] * 2 + [s.first_cart] * 2))
        self.innovation, self.nis = np.zeros(3), float("nan")

    @property
    def sigmas(self) -> np.ndarray:
        return np.sqrt(np.diag(self.covariance))

    def predict(self, command: float) -> None:
        """One period on: white accelerations of the settings' density, the cart's and each arm's."""
        t, s = self.model.period, self.settings
        following = self.model.step(self.state, command)
        a = self.model.linearised(self.state[None], np.array([command]))[0][0]
        change = (following - self.state)[2:4] / t
        densities = s.rate_noise**2 + 2 * s.correlation_time * (s.parameter_error * change) ** 2
        q = np.zeros((6, 6))
        for p, v, d in zip((0, 1), (2, 3), densities, strict=True):
            q[p, p], q[p, v], q[v, p], q[v, v] = d * t**3 / 3, d * t**2 / 2, d * t**2 / 2, d * t
        q += cart_noise(self.model, self.state, command, s.cart_noise)
        self.state, self.covariance = following, a @ self.covariance @ a.T + q

    def update(self, measured: np.ndarray) -> None:
        """Take the positions in, by Joseph's form of the covariance; angles in a swing need no wrapping."""
        h, p = self.observation, self.covariance
        s = h @ p @ h.T + self.noise
        gain = np.linalg.solve(s, h @ p).T
        self.innovation = measured - h @ self.state
        self.nis = float(self.innovation @ np.linalg.solve(s, self.innovation))
        self.state = self.state + gain @ self.innovation
        left = np.eye(6) - gain @ h
        self.covariance = left @ p @ left.T + gain @ self.noise @ gain.T
