"""What a plan asks for, as pictures show it: its stays and symbols over time, its orbits and tubes in space."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlacedOrbit:
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

    def delayed(self, seconds: float) -> "Stay":
        """Return the stay `seconds` later."""
        return replace(self, first=self.first + seconds, last=self.last + seconds)


@dataclass(frozen=True)
class PlanView:
    """What a plan asks for.

    Attributes:
        orbits: the itinerary's orbits, at each place where it stops.
        saddle_energies: energy of each saddle in J, by name.
        symbols: for each symbol of the itinerary, the planned time of its section crossing in s, and its name.
        tubes: parts of tubes that the plan uses.
        planned: the itinerary as stays.
        transfers: times in s between which the plan has the pendulum on its way from piece to piece.
        duration: in s, or None.
    """

    orbits: tuple[PlacedOrbit, ...] = ()
    saddle_energies: dict[str, float] = field(default_factory=dict)
    symbols: tuple[tuple[float, str], ...] = ()
    tubes: tuple[TubeCurve, ...] = ()
    planned: tuple[Stay, ...] = ()
    transfers: tuple[tuple[float, float], ...] = ()
    duration: float | None = None

    def delayed(self, seconds: float) -> "PlanView":
        """Return the plan with its times `seconds` later."""
        return replace(
            self,
            symbols=tuple((at + seconds, name) for at, name in self.symbols),
            planned=tuple(stay.delayed(seconds) for stay in self.planned),
            transfers=tuple((a + seconds, b + seconds) for a, b in self.transfers),
            duration=None if self.duration is None else self.duration + seconds,
        )
