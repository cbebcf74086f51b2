"""Causes with which searches end.

Each search ends with a member of one of these enumerations, and its result has the numbers that support it. Programs
compare members; `dpcontrol.words.searches` turns them into sentences for people.
"""

from enum import StrEnum, auto


class ShootingCause(StrEnum):
    """How Newton's method for an orbit of multiple shooting ended."""

    CONVERGED = auto()
    ITERATIONS = auto()
    ROUNDING = auto()
    OTHER_SIDE = auto()
    SINGULAR = auto()
    STRETCHED = auto()
    NO_STEP = auto()
    DIVERGED = auto()


class RefinementCause(StrEnum):
    """How a refinement in 113-bit arithmetic ended."""

    REFINED = auto()
    STALLED = auto()


class WalkCause(StrEnum):
    """How a search for a shadowing orbit ended."""

    CONVERGED = auto()
    CONNECTION = auto()
    SHOOTING = auto()
    RIVAL = auto()
    OTHER_WRAPS = auto()


class WrapsCause(StrEnum):
    """How a search for the fewest wraps of a walk ended."""

    TOO_FEW = auto()
    OTHERS_WORK = auto()
    NONE_SUFFICE = auto()


class OrbitCause(StrEnum):
    """How a search for a Lyapunov orbit ended."""

    CONTINUED = auto()
    MEMBER = auto()
    NEARBY = auto()
    ROTATING = auto()
    LOST = auto()


class FamilyEndCause(StrEnum):
    """Why a family of periodic orbits ends."""

    SADDLE = auto()
    ENERGY_BOUND = auto()
    HYPERBOLICITY_LOST = auto()
    HOMOCLINICS = auto()
    PASSES_EQUILIBRIUM = auto()
    LONG_PERIOD = auto()
    LARGE_MULTIPLIER = auto()
    MANY_MEMBERS = auto()
    STUCK = auto()


class CutCause(StrEnum):
    """How the cut of a tube ended."""

    RESOLVED = auto()
    UNRESOLVED = auto()
    ESCAPES = auto()
    NEVER_ARRIVES = auto()


class BranchCause(StrEnum):
    """Why the refinement of one branch of a cut stopped early."""

    SCATTERS = auto()
    POINTS = auto()
    TIME = auto()


class OpenEndCause(StrEnum):
    """Why a cut is open in an interval of phases."""

    NEVER_ARRIVES = auto()
    ESCAPES = auto()
    JUMPS = auto()
    GRAZES = auto()


class SearchCause(StrEnum):
    """How connections between two orbits were searched."""

    TUBES = auto()
    REVERSED = auto()
    LAPS = auto()


class GridCause(StrEnum):
    """Why a search for symmetric connections did not reach its highest energy."""

    REACHED = auto()
    TIME = auto()
    ORBIT = auto()
    UNSTABLE_DIRECTIONS = auto()
