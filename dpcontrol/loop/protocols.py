"""Types of users' objects: `dp.Law`, `dp.Estimator`, `dp.Plant` and `dp.Rig`.

A class needs no base: it has one of these types if it has the methods. `dpcontrol.loop.own` calls them.
"""

from typing import TYPE_CHECKING, Protocol

from numpy.typing import ArrayLike

from dpcontrol.foundation.arrays import Array

if TYPE_CHECKING:
    from dpcontrol.control.symbolic import Setpoint
    from dpcontrol.loop.result import Reading


class UserLaw(Protocol):
    """Methods of a user's control law.

    It may have `reset()`, which is called before each run.
    """

    def control(self, time: float, state: Array, reference: "Setpoint", /) -> float:
        """Return the cart's acceleration.

        Args:
            time: time of the run, s.
            state: estimated state (N,) when the command acts.
            reference: planned state (N,) and feedforward, m/s², at this time.

        Returns:
            Acceleration, m/s².
        """
        ...


class UserEstimator(Protocol):
    """Converts readings to states in a run.

    It may have `reset()`, and `sigmas` (N,), the standard deviations of its estimate.
    """

    def update(self, reading: "Reading", acceleration: float, /) -> ArrayLike:
        """Return the estimated state.

        Args:
            reading: time (s) and positions (n+1,) of the arms (rad) and the cart (m).
            acceleration: command of the last period, m/s².

        Returns:
            State (N,).
        """
        ...


class UserPlant(Protocol):
    """Simulated arms. It may have `reset()`, which is called before each run."""

    def step(self, state: Array, acceleration: float, seconds: float, /) -> ArrayLike:
        """Return the state after a step.

        Args:
            state: state (N,).
            acceleration: acceleration of the cart, m/s².
            seconds: duration of the step, s.

        Returns:
            State (N,).
        """
        ...


class UserRig(Protocol):
    """Methods of a user's bench in simulated time.

    It may have `truth`, the true state (2n+2,), for scores.
    """

    def read(self) -> "ArrayLike | Reading":
        """Return the positions (n+1,) at the next tick, or a reading.

        The positions are those of the arms, rad, and of the cart, m.
        """
        ...

    def command(self, acceleration: float, /) -> None:
        """Accelerate the cart.

        Args:
            acceleration: demanded acceleration of the cart, m/s².
        """
        ...

    def stop(self) -> None:
        """Stop the cart."""
        ...
