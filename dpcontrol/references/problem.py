"""What a reference is asked for: equations, an orbit to follow, limits; and how the program is solved.

    minimise ∫ u² + w_z |z - z_guess|² + w_x x² dt      subject to  (z, x, ẋ)˙ = f(z, x, ẋ, u), limits, ends

z: the pendulum's state, differences scaled by (π per angle, 10 rad/s per rate); x: cart position; u: cart
acceleration. Without w_z the optimiser wanders off the itinerary.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.errors import InputError

Array = NDArray[np.float64]
Guess = Callable[[Array], Array]
"""From times (K,) in s to pendulum states (K, 2n): a conservative shadowing orbit."""

ANGLE_SCALE = np.pi
RATE_SCALE = 10.0
CART_VELOCITY_SCALE = 3.0


@dataclass(frozen=True)
class Limits:
    """Symmetric bounds of the cart: position m (half the stroke), velocity m/s, acceleration m/s²."""

    position: float = 0.4
    velocity: float = 3.0
    acceleration: float = 30.0

    def __post_init__(self) -> None:
        """Refuse bounds that leave no room.

        Raises:
            InputError: names the limit and its value.
        """
        for name, value in self.named().items():
            if not 1e-6 <= value <= 1e6:
                raise InputError(f"limits: {name} = {value!r}: must be 1e-06 to 1e+06 {LIMIT_UNITS[name]}")

    def named(self) -> dict[str, float]:
        """Return {name: bound}."""
        return {"position": self.position, "velocity": self.velocity, "acceleration": self.acceleration}


LIMIT_UNITS = {"position": "m", "velocity": "m/s", "acceleration": "m/s²"}


def state_scale(dimension: int, limits: Limits) -> Array:
    """Return what each component of a state (dimension,) is divided by before errors are compared.

    π per angle, 10 rad/s per rate, the full stroke, 3 m/s.
    """
    n = (dimension - 2) // 2
    return np.array([ANGLE_SCALE] * n + [RATE_SCALE] * n + [2 * limits.position, CART_VELOCITY_SCALE], dtype=float)


@dataclass(frozen=True)
class ReferenceProblem:
    """A reference to be found.

    equations: at the cart level, state (N,) = angles, rates, cart position and velocity, one input;
    parameters (p,): base parameters with friction; guess: the orbit to follow from time 0 to `duration` s;
    limits of the cart.
    """

    equations: Equations
    parameters: Array
    guess: Guess
    duration: float
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        """Refuse what cannot be transcribed.

        Raises:
            InputError: names what is wrong and what is allowed.
        """
        e = self.equations
        if e.input_count != 1 or e.dimension < 4 or e.dimension % 2:
            raise InputError(
                f"equations have {e.dimension} states and {e.input_count} inputs: a reference needs the cart "
                "level, with the cart's acceleration as the one input"
            )
        if np.shape(self.parameters) != (e.parameters.shape[0],):
            raise InputError(
                f"parameters have shape {np.shape(self.parameters)}: the equations take ({e.parameters.shape[0]},)"
            )
        if not np.isfinite(self.duration) or self.duration <= 0:
            raise InputError(f"duration = {self.duration!r}: must be a positive, finite number of seconds")

    @property
    def pendulum_dimension(self) -> int:
        """Return 2n."""
        return self.equations.dimension - 2

    def guess_at(self, times: Array) -> Array:
        """Return the guess (K, 2n) at `times` (K,).

        Raises:
            InputError: the guess has another shape or is not finite.
        """
        states = np.asarray(self.guess(times), dtype=float)
        expected = (len(times), self.pendulum_dimension)
        if states.shape != expected:
            raise InputError(f"the guess gives shape {states.shape} at {len(times)} times, not {expected}")
        if not np.isfinite(states).all():
            first = times[~np.isfinite(states).all(1)][0]
            raise InputError(f"the guess is not finite at t = {first:.6g} s; sample it to the end")
        return states


@dataclass(frozen=True)
class ReferenceSettings:
    """How a reference is sought.

    method: by name; interval: first length of an interval, s; tolerance: allowed error between nodes (scaled);
    pendulum_weight w_z and cart_weight w_x of the cost; end_tolerance: how far (scaled) the pendulum may end from
    the guess's end; rounds: of refinement of the mesh or tightening of limits; iterations: of the solver, each
    round.
    """

    method: str = "radau-5"
    interval: float = 0.02
    tolerance: float = 1e-6
    pendulum_weight: float = 0.1
    cart_weight: float = 10.0
    end_tolerance: float = 0.0
    rounds: int = 8
    iterations: int = 100

    def __post_init__(self) -> None:
        """Refuse impossible settings.

        Raises:
            InputError: names the setting, its value and what is allowed.
        """
        # Below the least interval a mesh may have more intervals than memory holds.
        for name, least, most in (("interval", 1e-3, 10.0), ("tolerance", 1e-20, 1.0)):
            if not least <= getattr(self, name) <= most:
                raise InputError(f"{name} = {getattr(self, name)!r}: must be {least:g} to {most:g}")
        for name in ("pendulum_weight", "cart_weight", "end_tolerance"):
            if not np.isfinite(getattr(self, name)) or getattr(self, name) < 0:
                raise InputError(f"{name} = {getattr(self, name)!r}: must be zero or positive")
        for name in ("rounds", "iterations"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} = {getattr(self, name)!r}: must be at least 1")
