"""What a sweep of connections in energy is asked, and what it answers step by step."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dpcontrol.tubes.intersections import ConnectionSettings
from dpcontrol.tubes.link_events import Located
from dpcontrol.tubes.link_paths import PathPoint

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SweepSettings:
    """How energies are swept. energies: how many at first; halvings: of an interval that does not add up.

    same: largest difference of phases at which two links are one; closest: energies nearer to a saddle's than this
    part of the energy scale are left out, tubes being thinner there than their seeds are far.
    """

    energies: int = 24
    halvings: int = 3
    same: float = 1e-4
    closest: float = 1e-4
    search: ConnectionSettings = field(default_factory=ConnectionSettings)


@dataclass(frozen=True)
class Found:
    """Links found at one energy, each solved, one of every two that the symmetry S exchanges."""

    energy: float
    points: tuple[PathPoint, ...]
    weight: int
    complete: bool
    caveat: str

    @property
    def count(self) -> int:
        return self.weight * len(self.points)


@dataclass(frozen=True)
class Change:
    """An event of one link between two energies and what it adds to the number of links, going up in energy."""

    event: Located
    gain: int
    symmetric: bool


@dataclass(frozen=True)
class Run:
    """A connection followed in energy while it crosses its section as often as asked.

    energies (K,) in J, in order along it; points (K, 2): the first of its crossings, in (q, p/p₀).
    """

    energies: Array
    points: Array


@dataclass(frozen=True)
class Interval:
    """What happened between two energies: the changes, and sentences on what could not be followed or located.

    runs: the connections followed there, carried from end to end or round their turns.
    """

    changes: tuple[Change, ...]
    reasons: tuple[str, ...]
    runs: tuple[Run, ...]

    @property
    def gain(self) -> int:
        """How many links the changes add, going up in energy."""
        return sum(c.gain for c in self.changes)
