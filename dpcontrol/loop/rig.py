"""What the loop asks of a bench, simulated or real: readings come, commands go, and it can be stopped."""

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Reading(NamedTuple):
    """What came from the sensors at one tick.

    time s since the first reading; positions (n+1,): absolute angles, summed from relative encoders, then the cart;
    present (n+1,): which of them are new, or None when all are (those that are not hold their last value); switch:
    -1 or +1 while the limit switch at the left or right end of the track is touched, else 0; late s: by how much the
    deadline was missed.
    """

    time: float
    positions: Array
    present: NDArray[np.bool_] | None = None
    switch: int = 0
    late: float = 0.0


class Rig(Protocol):
    """A bench. Each period: one `read`, which waits for the tick, then one `command`."""

    @property
    def period(self) -> float:
        """Return the time between ticks, s."""
        ...

    def read(self) -> Reading:
        """Return the next tick's reading; the first call gives the start.

        Raises:
            ArithmeticError: the bench failed, in one sentence.
        """
        ...

    def command(self, acceleration: float) -> None:
        """Send the cart's wanted acceleration, m/s² to the right."""
        ...

    def stop(self) -> None:
        """Brake the cart to a standstill and ignore further commands."""
        ...

    @property
    def truth(self) -> Array | None:
        """Return the true state (2n+2,) at the last reading's tick, None where nobody knows it."""
        ...

    @property
    def acted(self) -> float | None:
        """Return the acceleration that really acted on the cart over the last period, None where nobody knows it."""
        ...

    @property
    def fault(self) -> str:
        """Return why the bench has failed, such as the end of its track, or "" while it works."""
        ...
