"""Endings of searches for references: causes and the numbers of their sentences."""

from dataclasses import dataclass

import numpy as np

from dpcontrol.foundation.causes import ObstacleCause, ReferenceCause
from dpcontrol.references.trajectory import LimitUse
from dpcontrol.words.searches import Concluded


@dataclass(frozen=True)
class Obstacle(Concluded):
    """The obstacle to a reference near its guess.

    Attributes:
        cause: the obstacle.
        uses: limits that the motion passes without limits.
        share: share of friction that can be compensated.
    """

    cause: ObstacleCause
    uses: tuple[LimitUse, ...] = ()
    share: float = np.nan


@dataclass(frozen=True)
class ReferenceEnding(Concluded):
    """How the search for a reference ended. Each cause has the numbers that its sentence uses.

    Attributes:
        cause: the cause.
        iterations: of the solver.
        error: scaled error between nodes.
        intervals: number of intervals of the mesh.
        parts: number of pieces, or of flights.
        rounds: number of rounds.
        allowed: largest allowed error, distance from the guess, or share by which the period may change.
        uses: limits that the polynomials pass.
        answer: answer of the solver.
        distance: largest scaled distance from the guess.
        times: time of that distance, duration of a rest, period of the Lyapunov orbit, or durations tried, s.
        energies: energies before and after, J.
        saddle: saddle of a change of energy.
        obstacle: cause of a failure of the solver.
        inner: ending of the failed search within this one, or the shortfall of the reference.
        text: sentence of a stored reference.
    """

    cause: ReferenceCause
    iterations: int = 0
    error: float = np.inf
    intervals: int = 0
    parts: int = 0
    rounds: int = 0
    allowed: float = np.nan
    uses: tuple[LimitUse, ...] = ()
    answer: str = ""
    distance: float = np.nan
    times: tuple[float, ...] = ()
    energies: tuple[float, ...] = ()
    saddle: str = ""
    obstacle: Obstacle | None = None
    inner: Concluded | None = None
    text: str = ""
