"""What a review needs besides the log: orbits, energies, the plan and the verdict."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class OrbitCurve:
    """A periodic orbit of the pendulum.

    Attributes:
        name: as shown, such as "down-up at -0.07 J".
        states: (M, 2n) along one period, angles then rates; rad, rad/s.
    """

    name: str
    states: NDArray[np.float64]


@dataclass(frozen=True)
class ReviewContext:
    """What the log does not say and the caller knows.

    Attributes:
        title: of the recording and the picture.
        arm_lengths: (n,) in m.
        limits: the cart's greatest distance from the centre in m, velocity in m/s, acceleration in m/s².
        orbits: the itinerary's orbits.
        saddle_energies: energy of each saddle in J, by name.
        symbols: for each symbol of the itinerary, the planned time of its section crossing in s, and its name.
        energy: (N,) in J, of the pendulum in each tick, true if known, else estimated; or None.
        verdict: one line, such as "completed: 1 of 1 symbols".
    """

    title: str
    arm_lengths: tuple[float, ...]
    limits: tuple[float, float, float]
    orbits: tuple[OrbitCurve, ...] = ()
    saddle_energies: dict[str, float] = field(default_factory=dict)
    symbols: tuple[tuple[float, str], ...] = ()
    energy: NDArray[np.float64] | None = None
    verdict: str = ""
