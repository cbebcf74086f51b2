"""Types of users' objects: `dp.Law`, `dp.Estimator`, `dp.Plant` and `dp.Rig`.

A class needs no base: it has one of these types if it has the methods. `dpcontrol.loop.own` calls them.
"""

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.foundation.arrays import Array

if TYPE_CHECKING:
    from dpcontrol.control.symbolic import Setpoint


class Reading(NamedTuple):
    """Readings of the sensors at one tick.

    S runs in lockstep have positions and present (n+1, S), age (S,), and switch (S,), which is True if one is touched.

    Attributes:
        time: since the first reading, s.
        positions: absolute angles, summed from relative encoders, then the cart (n+1,).
        present: new entries (n+1,), the others repeat their last value; None if all are new.
        switch: -1 or +1 while the limit switch at the left or right end of the track is touched, else 0.
        late: delay beyond the deadline, s.
        age: age of the reading at its tick, s, None if the rig does not report it.
    """

    time: float
    positions: Array
    present: NDArray[np.bool_] | None = None
    switch: Any = 0
    late: float = 0.0
    age: Any = None


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

    def update(self, reading: Reading, acceleration: float, /) -> ArrayLike:
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

    def read(self) -> ArrayLike | Reading:
        """Return the positions (n+1,) at the next tick, or a reading.

        The positions are those of the arms, rad, and of the cart, m.
        """
        ...

    def command(self, acceleration: float, /) -> None:
        """Accelerate the cart.

        Args:
            acceleration: demanded acceleration of the cart, m/s².
        """

    def stop(self) -> None:
        """Stop the cart."""
