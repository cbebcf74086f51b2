"""What linear-quadratic feedback weighs: the diagonal of Q and r of a period of T s, from weights per second.

    Q = T diag(w / s²),   r = T w_u:   weights w of errors measured in s, the scales of angles, rates and cart

Source: Anderson & Moore, Optimal Control: Linear Quadratic Methods, chapter 6, on selecting weights.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.references.problem import ANGLE_SCALE, CART_VELOCITY_SCALE, RATE_SCALE

Array = NDArray[np.float64]


@dataclass(frozen=True)
class QuadraticWeights:
    """Weights per second of the squared errors, each scaled: angles by π, rates by 10 rad/s, the cart's velocity
    by 3 m/s; the cart's position by 1 m and the effort by 1 m/s².
    """

    angle: float = 1000.0
    rate: float = 100.0
    position: float = 100.0
    velocity: float = 10.0
    effort: float = 1.0

    def __post_init__(self) -> None:
        """Refuse weights without a solution.

        Raises:
            InputError: names the weight, its value and what is allowed.
        """
        for name in ("angle", "rate", "position", "velocity", "effort"):
            value = getattr(self, name)
            allowed = "positive" if name in ("position", "effort") else "zero or positive"
            if not np.isfinite(value) or value < 0 or (value == 0 and allowed == "positive"):
                raise InputError(f"controller: {name} = {value!r}: must be a finite number, {allowed}")

    def weights(self, arms: int, period: float) -> tuple[Array, float]:
        """Return Q's diagonal (N,) and r of one period in s."""
        scaled = [self.angle / ANGLE_SCALE**2] * arms + [self.rate / RATE_SCALE**2] * arms
        cart = [self.position, self.velocity / CART_VELOCITY_SCALE**2]
        return np.array(scaled + cart) * period, self.effort * period


@dataclass(frozen=True)
class ClosingWeights(QuadraticWeights):
    """The same along a reference. closing: how many times the angles weigh in its last closing_time s, when they shall
    be the model's own orbit whatever the arms would rather do.
    """

    closing: float = 50.0
    closing_time: float = 1.6

    def __post_init__(self) -> None:
        """Refuse weights without a solution.

        Raises:
            InputError: names the weight, its value and what is allowed.
        """
        super().__post_init__()
        for name, low, high in (("closing", 1.0, 1e6), ("closing_time", 0.0, 1e4)):
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(f"controller: {name} = {value!r}: must be {low:g} to {high:g}")

    def along(self, arms: int, period: float, *, count: int) -> Array:
        """Return Q's diagonals (count, N) at a reference's ticks, `period` s apart."""
        weights = np.tile(self.weights(arms, period)[0], (count, 1))
        weights[max(count - round(self.closing_time / period), 0) :, :arms] *= self.closing
        return weights
