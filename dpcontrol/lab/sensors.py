"""What the sensors say of a state: relative encoders that count, a cart's scale, and what goes wrong with them.

    joint_i = θ_i - θ_{i-1} + zero_i + noise,   s_i = q round(joint_i / q) - q missed_i,   θ̂_i = s_1 + … + s_i

q: one count. Angles count from hanging, the cart from the track's centre.

Source: the rig's data sheets as read for its parameters: 40,000 counts per turn, 1 µm on the cart.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SensorSettings:
    """The sensors and their faults; what is random is drawn beforehand, see `dpcontrol.lab.draw`.

    counts: of a relative arm encoder per turn, 0 for no rounding; cart_resolution: of the cart's scale, m, 0 likewise.
    zero_error: rad, uniform ± on the zero of each arm's encoder, so that outer angles carry the sum. noise: standard
    deviation on each relative angle, rad; cart_noise: on the cart, m. missed_counts: per s that each encoder loses
    while its joint moves. dropout: share of ticks at which no sensor is read. stuck_at s: from when the sensor
    `stuck_sensor` (0, 1 … the arms, then the cart) repeats its value. jitter s: a reading is up to so old, uniform.
    rate_noise rad/s: standard deviation of what is added to estimated rates, as where rates are measured.
    """

    counts: int = 40_000
    cart_resolution: float = 1e-6
    zero_error: float = 0.0
    noise: float = 0.0
    cart_noise: float = 0.0
    missed_counts: float = 0.0
    dropout: float = 0.0
    stuck_at: float = math.inf
    stuck_sensor: int = 0
    jitter: float = 0.0
    rate_noise: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no sensor.

        Raises:
            InputError: names the setting, its value and what is allowed.
        """
        if self.counts < 0:
            raise InputError(f"sensors: counts = {self.counts!r}: must be at least 1, or 0 for no rounding")
        if self.cart_resolution and not 1e-12 <= self.cart_resolution <= 1.0:
            raise InputError(
                f"sensors: cart_resolution = {self.cart_resolution!r}: must be 1e-12 to 1 metres, or 0 for no rounding"
            )
        bounds = {"zero_error": np.pi, "noise": np.pi, "cart_noise": 1.0, "missed_counts": 1e6, "dropout": 1.0,
                  "jitter": 1.0, "rate_noise": 1e3}  # fmt: skip
        for name, most in bounds.items():
            value = getattr(self, name)
            if not 0 <= value <= most:
                raise InputError(f"sensors: {name} = {value!r}: must be 0 to {most:.4g}")
        if not self.stuck_at >= 0:
            raise InputError(f"sensors: stuck_at = {self.stuck_at!r}: must be zero or positive seconds")
        if self.stuck_sensor < 0:
            raise InputError(f"sensors: stuck_sensor = {self.stuck_sensor!r}: must be 0 (inner arm) or more")
        if self.missed_counts and not self.counts:
            raise InputError(
                f"sensors: missed_counts = {self.missed_counts!r} with counts = 0: an encoder that does not count "
                "misses none; give its counts"
            )

    @property
    def steps(self) -> tuple[float, float]:
        """The rounding steps of a relative angle, rad, and of the cart, m; zero for none."""
        return (2 * np.pi / self.counts if self.counts else 0.0), self.cart_resolution

    def covariance(self, arms: int) -> Array:
        """Return the covariance (n+1, n+1) of the measured positions: a count's q²/12 and the noise, summed.

        cov(angle_i, angle_j) = (min(i, j) + 1)(q²/12 + noise²). Zero where nothing is rounded nor noisy.
        """
        angle, cart = self.steps
        index = np.arange(arms)
        out = np.zeros((arms + 1, arms + 1))
        out[:arms, :arms] = (np.minimum.outer(index, index) + 1) * (angle**2 / 12 + self.noise**2)
        out[arms, arms] = cart**2 / 12 + self.cart_noise**2
        return out


class Encoders:
    """Relative encoders of `arms` joints and the cart's scale, during one run: they remember what went wrong.

    zeros (n,) rad: the encoders' zero errors.

    Raises:
        InputError: the sensor that sticks is none of these.
    """

    def __init__(self, arms: int, settings: SensorSettings, *, zeros: Array | None = None) -> None:
        if math.isfinite(settings.stuck_at) and settings.stuck_sensor > arms:
            raise InputError(
                f"sensors: stuck_sensor = {settings.stuck_sensor!r}: must be 0 to {arms}; {arms} is the cart's scale"
            )
        self.settings = settings
        self._arms = arms
        self._angle, self._cart = settings.steps
        self._zeros = [0.0] * arms if zeros is None else np.asarray(zeros, dtype=float).tolist()
        self._missed = [0] * arms
        self._stuck: float | None = None
        self._stuck_at = settings.stuck_at

    def measure(
        self,
        state: Sequence[float],
        time: float = 0.0,
        *,
        missed: NDArray[np.int64] | None = None,
        noise: Array | None = None,
    ) -> Array:
        """Return absolute angles and cart position (n+1,) as the sensors give them for `state` (2n+2,) at `time` s.

        missed (n,): counts that the encoders lose in this tick where their joints move; noise (n+1,): added to the
        relative angles, rad, and to the cart, m. A list of plain floats is the fastest state.
        """
        # A few plain floats take a third of the time of numpy's calls on so short arrays.
        step, arms = self._angle, self._arms
        lost, added = self._missed, None if noise is None else noise.tolist()
        if missed is not None:
            self._miss(state, missed.tolist())
        readings: list[float] = []
        inner = 0.0
        for k, zero in enumerate(self._zeros):
            outer = state[k]
            value = outer - inner + zero
            inner = outer
            if added is not None:
                value += added[k]
            readings.append(step * (round(value / step) - lost[k]) if step else value)
        cart = state[2 * arms] if added is None else state[2 * arms] + added[arms]
        readings.append(self._cart * round(cart / self._cart) if self._cart else cart)
        if time >= self._stuck_at:
            which = self.settings.stuck_sensor
            if self._stuck is None:
                self._stuck = readings[which]
            readings[which] = self._stuck
        for k in range(1, arms):
            readings[k] += readings[k - 1]
        return np.array(readings)

    def _miss(self, state: Sequence[float], missed: Sequence[int]) -> None:
        """Lose counts against the direction in which each joint moves; one at rest loses none."""
        inner = 0.0
        for k, lost in enumerate(missed):
            outer = state[self._arms + k]
            if lost and outer != inner:
                self._missed[k] += lost if outer > inner else -lost
            inner = outer
