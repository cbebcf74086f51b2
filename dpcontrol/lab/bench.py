"""What stands between the model and the world: plant, encoders, drive.

    plant: ẋ = f(x, u; p) between ticks, u held; encoders: q round(s/q), relative joints, summed to absolute angles;
    drive: |u| ≤ a, |v + u Δt| ≤ v_max; travel: |x| ≤ x_max, or the run ends

Sources: the rig's data sheets as read for its parameters: 40,000 counts per turn, 1 µm on the cart, 3 m/s.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.equations import Equations
from dpcontrol.dynamics.polynomial_input import PolynomialInputPropagator
from dpcontrol.foundation.errors import InputError
from dpcontrol.references.problem import Limits

Array = NDArray[np.float64]


class Plant:
    """What is simulated: equations of the cart level with the plant's own parameters (p,), input held."""

    def __init__(self, equations: Equations, parameters: Array) -> None:
        self._propagator = PolynomialInputPropagator(equations, parameters, degree=0)

    def after(self, state: Array, acceleration: float, duration: float) -> Array:
        """Return the state (N,) after `duration` s of cart acceleration in m/s², to machine precision.

        Raises:
            ArithmeticError: the state became infinite or undefined.
        """
        return self._propagator.flow(state, acceleration, duration)


@dataclass(frozen=True)
class SensorSettings:
    """counts: of a relative arm encoder per turn; cart_resolution: of the cart's scale, m."""

    counts: int = 40_000
    cart_resolution: float = 1e-6

    def __post_init__(self) -> None:
        """Refuse what is no encoder.

        Raises:
            InputError: names the setting, its value and what is allowed.
        """
        if self.counts < 1:
            raise InputError(f"sensors: counts = {self.counts!r}: must be at least 1")
        if not 1e-12 <= self.cart_resolution <= 1.0:
            raise InputError(f"sensors: cart_resolution = {self.cart_resolution!r}: must be 1e-12 to 1 metres")


class Encoders:
    """Relative encoders of `arms` joints and the cart's scale; they count from hanging and from the centre."""

    def __init__(self, arms: int, settings: SensorSettings) -> None:
        self.settings = settings
        steps = np.full(arms + 1, 2 * np.pi / settings.counts)
        steps[arms] = settings.cart_resolution
        self._steps = steps
        # Relative angles from a state, the cart last; and their sums back to absolute angles.
        relative = np.zeros((arms + 1, 2 * arms + 2))
        relative[np.arange(arms), np.arange(arms)] = 1.0
        relative[np.arange(1, arms), np.arange(arms - 1)] = -1.0
        relative[arms, 2 * arms] = 1.0
        self._counts_from_state = relative / steps[:, None]
        sums = np.zeros((arms + 1, arms + 1))
        sums[:arms, :arms] = np.tril(np.ones((arms, arms)))
        sums[arms, arms] = 1.0
        self._positions_from_counts = sums * steps[None, :]

    def measure(self, state: Array) -> Array:
        """Return absolute angles and cart position (n+1,) as the encoders give them for `state` (2n+2,)."""
        return self._positions_from_counts.dot(np.rint(self._counts_from_state.dot(state)))


@dataclass(frozen=True)
class Drive:
    """Gives the cart the commanded acceleration within its limits; period s of the loop."""

    limits: Limits
    period: float

    def applied(self, command: float, velocity: float) -> float:
        """Return the acceleration given to the cart at `velocity` m/s: clipped so that both limits hold."""
        most, fastest = self.limits.acceleration, self.limits.velocity
        clipped = min(max(command, -most), most)
        low, high = (-fastest - velocity) / self.period, (fastest - velocity) / self.period
        return min(max(clipped, low), high)

    def at_stop(self, position: float) -> bool:
        """Tell whether the cart has reached the end of its travel."""
        return abs(position) >= self.limits.position
