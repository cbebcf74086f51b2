"""Periodic orbits: their properties and symmetry."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import OrbitCause
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.shown import Brief, Timed
from dpcontrol.words.searches import Concluded

_HYPERBOLIC = 1e-4
"""A multiplier counts as unstable if its modulus exceeds one by more than this."""


@dataclass(frozen=True)
class OrbitRecord(Brief, Documented):
    """Properties of a periodic orbit about a saddle.

    Attributes:
        energy: J.
        period: s.
        state (N,): on the reverser's fixed set.
        floquet_multipliers (N,): largest first.
        residual: largest component of x(T) - x(0).
        saddle: name of the saddle.
        family: index of the family at the saddle, from 0.
    """

    KEYS: ClassVar[str] = "energy period state floquet_multipliers residual status saddle family"

    energy: float
    period: float
    state: Array
    floquet_multipliers: NDArray[np.complex128]
    residual: float
    saddle: str
    family: int

    @property
    def name(self) -> str:
        """The saddle's name, with the family unless it is the first."""
        return self.saddle if self.family == 0 else f"{self.saddle} family {self.family}"


@dataclass(frozen=True)
class OrbitOutcome:
    """How an orbit was found.

    Attributes:
        newton_residual: of the shooting equations, scaled.
        steps: number of continuation steps from the saddle.
        reached: energy of the last orbit before this one, J.
    """

    cause: OrbitCause
    newton_residual: float
    steps: int = 0
    reached: float = float("nan")


class Periodic(Timed):
    """Base of motions that are defined over one period."""

    period: float
    system: System

    @property
    def time_range(self) -> tuple[float, float]:
        """Zero and the period, s."""
        return 0.0, self.period

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the N entries of a state."""
        return self.system.columns


@dataclass(frozen=True)
class PeriodicOrbit(OrbitRecord, Periodic, Concluded):
    """A periodic orbit with its symmetry, from which its manifolds are computed.

    Attributes:
        system: system of the orbit.
        monodromy (N, N): state-transition matrix over one period.
        outcome: cause and figures of the search.
    """

    system: System
    monodromy: Array
    outcome: OrbitOutcome

    @property
    def cause(self) -> OrbitCause:
        """How the search for the orbit ended."""
        return self.outcome.cause

    @property
    def converged(self) -> bool:
        """True if the orbit was reached."""
        return self.cause is not OrbitCause.LOST

    def __repr__(self) -> str:
        return f"<orbit about {self.saddle} at {self.energy:g}: {self.status}>"

    @property
    def unstable_directions(self) -> int:
        """Number of Floquet multipliers outside the unit circle."""
        return int(np.sum(np.abs(self.floquet_multipliers) > 1 + _HYPERBOLIC))

    @property
    def unstable_multiplier(self) -> float:
        """The largest Floquet multiplier, real for a saddle's orbit."""
        return float(self.floquet_multipliers[0].real)

    @property
    def centre(self) -> Array:
        """State (N,) of the saddle."""
        return self.system.equilibrium(self.saddle)

    @property
    def reverser(self) -> Array:
        """The reverser (N, N), which maps the unstable to the stable manifold."""
        return self.system.reversers[0]

    @property
    def whole_turns(self) -> Array:
        """Whole turns (N,) per period, zero for Lyapunov orbits."""
        return np.zeros(self.system.dimension)

    @property
    def turn(self) -> Array:
        """Change (N,) of the coordinates over one period, in their units: zero unless the orbit rotates."""
        return self.whole_turns * self.system.turn_lengths

    @property
    def laps(self) -> bool:
        """True if the orbit itself, and its tubes with it, may cross sections in every period."""
        return False

    @property
    def nodes(self) -> tuple[Array, Array]:
        """Times (M,), s, and states (M, N) from which the orbit is integrated: its start alone."""
        return np.zeros(1), self.state[None]
