"""What a review needs besides the log: orbits, tubes, energies, the plan, what was done of it, and the verdict."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OrbitCurve:
    """A periodic orbit of the pendulum, or an equilibrium, at a place where a plan stops.

    Attributes:
        name: as shown, such as "down-up at -0.07 J".
        states: (M, 2n) along one period, angles then rates; rad, rad/s.
        saddle: that it lies about.
    """

    name: str
    states: Array
    saddle: str = ""


@dataclass(frozen=True)
class TubeCurve:
    """The part of a tube that a plan uses: trajectories between a stop's orbit and a symbol's section.

    Attributes:
        stable: whether it leads to the orbit; else from it.
        strands: (S, M, 2n) trajectories at the plan's turns, angles then rates; rad, rad/s.
        cut: (C, 2n) where they meet the section, in order of phase, nan where the cut is open.
    """

    stable: bool
    strands: Array
    cut: Array


@dataclass(frozen=True)
class Stay:
    """A stretch of time near one saddle.

    Attributes:
        first, last: s.
        saddle: its name.
        text: what to write on it.
        wanted: whether the plan has it there.
    """

    first: float
    last: float
    saddle: str
    text: str
    wanted: bool = True


@dataclass(frozen=True)
class ReviewContext:
    """What the log does not say and the caller knows.

    Attributes:
        title: of the recording and the picture.
        arm_lengths: (n,) in m.
        limits: the cart's greatest distance from the centre in m, velocity in m/s, acceleration in m/s²; or None.
        orbits: the itinerary's orbits, at each place where it stops.
        saddle_energies: energy of each saddle in J, by name.
        symbols: for each symbol of the itinerary, the planned time of its section crossing in s, and its name.
        energy: (N,) in J, of the pendulum in each tick, true if known, else estimated; or None.
        verdict: one line, such as "completed: 1 of 1 symbols".
        good: whether that is good news; None where nothing was asked.
        tubes: parts of tubes that the plan uses.
        planned, done: the itinerary as stays, as planned and as decoded from the angles.
        transfers: times in s between which the plan has the pendulum on its way from piece to piece.
        crossings: when each symbol that was done crossed its section, in s; None for a transfer.
        duration: of the plan in s, or None.
    """

    title: str
    arm_lengths: tuple[float, ...]
    limits: tuple[float, float, float] | None = None
    orbits: tuple[OrbitCurve, ...] = ()
    saddle_energies: dict[str, float] = field(default_factory=dict)
    symbols: tuple[tuple[float, str], ...] = ()
    energy: Array | None = None
    verdict: str = ""
    good: bool | None = None
    tubes: tuple[TubeCurve, ...] = ()
    planned: tuple[Stay, ...] = ()
    done: tuple[Stay, ...] = ()
    transfers: tuple[tuple[float, float], ...] = ()
    crossings: tuple[float | None, ...] = ()
    duration: float | None = None
