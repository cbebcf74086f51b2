"""Causes with which searches and runs end.

Each result has the numbers that support its cause. Programs compare members, whose values identify them in logs, tables
and documents. Sentences for people, which also explain the members, are in `dpcontrol.words`: `SENTENCES` of `searches`
and `runs`, and `FINDINGS` of `findings`.
"""

from enum import StrEnum, auto


class ShootingCause(StrEnum):
    """Causes with which Newton's method for an orbit of multiple shooting ends."""

    CONVERGED = auto()
    ITERATIONS = auto()
    ROUNDING = auto()
    OTHER_SIDE = auto()
    SINGULAR = auto()
    STRETCHED = auto()
    NO_STEP = auto()
    DIVERGED = auto()


class RefinementCause(StrEnum):
    """Causes with which a refinement in 113-bit arithmetic ends."""

    REFINED = auto()
    STALLED = auto()


class WalkCause(StrEnum):
    """Causes with which a search for a shadowing orbit ends."""

    CONVERGED = auto()
    CONNECTION = auto()
    SHOOTING = auto()
    RIVAL = auto()
    OTHER_WRAPS = auto()


class WrapsCause(StrEnum):
    """Causes with which a search for the fewest wraps of a walk ends."""

    TOO_FEW = auto()
    OTHERS_WORK = auto()
    NONE_SUFFICE = auto()


class OrbitCause(StrEnum):
    """Causes with which a search for a Lyapunov orbit ends."""

    CONTINUED = auto()
    MEMBER = auto()
    NEARBY = auto()
    ROTATING = auto()
    LOST = auto()


class FamilyEndCause(StrEnum):
    """Causes with which a family of periodic orbits ends."""

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
    """Causes with which the cut of a tube ends."""

    RESOLVED = auto()
    UNRESOLVED = auto()
    ESCAPES = auto()
    NEVER_ARRIVES = auto()


class GapCause(StrEnum):
    """Reasons for which a change of the number of connections is not explained by events."""

    COUNT = auto()
    TURN = auto()
    TOUCH_AT_TURN = auto()
    TOUCH = auto()
    UNMATCHED = auto()
    UNFOLLOWED = auto()
    UNSEARCHED = auto()


class BranchCause(StrEnum):
    """Reasons for which the refinement of one branch of a cut stopped early."""

    SCATTERS = auto()
    POINTS = auto()
    TIME = auto()


class OpenEndCause(StrEnum):
    """Reasons for which a cut is open in an interval of phases."""

    NEVER_ARRIVES = auto()
    ESCAPES = auto()
    JUMPS = auto()
    GRAZES = auto()


class TransportCause(StrEnum):
    """Knowledge of the rates of passage through a neck."""

    FINITE = auto()
    UNBOUNDED = auto()
    OTHER_KINETIC_ENERGY = auto()


class SearchCause(StrEnum):
    """Ways in which connections between two orbits are searched."""

    TUBES = auto()
    REVERSED = auto()
    LAPS = auto()


class GridCause(StrEnum):
    """Reasons for which a search for symmetric connections did not reach its highest energy."""

    REACHED = auto()
    TIME = auto()
    ORBIT = auto()
    UNSTABLE_DIRECTIONS = auto()


class ReferenceCause(StrEnum):
    """Causes with which the search for a reference ends."""

    CONVERGED = auto()
    REST = auto()
    SHADOWING_ORBIT = auto()
    PIECES = auto()
    FLIGHTS = auto()
    STORED = auto()
    ROUNDS = auto()
    SOLVER = auto()
    OTHER_MOTION = auto()
    NO_ORBIT = auto()
    OTHER_PERIOD = auto()
    ENERGY_CHANGE = auto()
    NO_TRANSFER = auto()
    NO_CHEAPER = auto()
    SHORTFALL = auto()


class ObstacleCause(StrEnum):
    """Obstacle to a reference near its guess."""

    AUTHORITY = auto()
    GUESS = auto()
    LIMITS = auto()
    MESH = auto()
    NO_MOTION = auto()
    FRICTION = auto()


class ShortfallCause(StrEnum):
    """Reasons for which an exact run of a reference would not be completed."""

    FIRST_FAR = auto()
    FAR = auto()
    WRAPS = auto()
    LAST_FAR = auto()
    NOT_DECODED = auto()


class DepartureCause(StrEnum):
    """Departures of a polished motion from its walk."""

    NO_CROSSING = auto()
    ORDER = auto()
    WRAPS = auto()


class FlightCause(StrEnum):
    """Causes with which the search for a flight ends."""

    REACHED = auto()
    MISSED = auto()
    OUTSIDE = auto()


class Cause(StrEnum):
    """Cause of a fall, of a run's end or of another event in its log."""

    # Decisions of a tick have the names of `dpcontrol.control.tick_parts.Outcome`.
    RESTART = "estimator restarted"
    RESYNCHRONISE = "away from the reference"
    HOLD = "tracking lost, orbit held"
    ESTIMATE_LOST = "estimate lost"
    SILENT = "no measurement"
    CART = "cart near its stop"
    TRACKING_LOST = "tracking lost"
    STUCK = "sensor stuck"
    SWITCH = "limit switch"
    FALLEN = "cart runs after the arms"
    DRIVE_OFF = "drive off"
    DRIVE_REVERSED = "drive reversed"
    # Causes that a tick does not see.
    TOO_FAST = "cart too fast"
    NOT_HELD = "last stop not held"
    HARD_STOP = "hard stop hit"
    RIG_FAULT = "fault of the rig"
    PLANT_FAILED = "plant failed"
    OBJECT_FAILED = "object failed"
    FINISHED = "came to the end"
    TIME_OVER = "time over"
    # Other events.
    BEGUN = "begun"
    JOINED = "on the itinerary"
    LAP_DONE = "lap done"
    FLOWN = "flight planned"
    MISSED = "flight missed its place"
    ANYWHERE = "from anywhere"
    CLOCKLESS = "no clock"
    LATE = "deadline missed"
    CUT = "command cut"
    UNTRUSTED = "model error"


class Fault(StrEnum):
    """Fault that keeps a run from completing its plan, or reason for an unknown verdict."""

    NONE = "completed"
    STAMPS = "stamps jump"
    PART = "part of a run"
    OTHER_TIMES = "times of another run"
    AT_ONCE = "ended at once"
    NOT_BEGUN = "first orbit not begun"
    FIRST_LEFT = "first orbit left"
    SYMBOL = "symbol not done"
    LAST_LEFT = "last orbit left"
    WRAPS = "other wraps"
    DRIVE_LIMIT = "drive's limit passed"
    LIMIT = "limit passed"
    LAST_ENDED = "last orbit not held"
    LAST_FAR = "far from the last orbit"


class FindingCause(StrEnum):
    """Causes with which a step of commissioning ends. The name of the step tells which part of the rig was measured."""

    RIGHT = auto()
    DIFFERS = "differs from [run]"
    DOUBTFUL = auto()
    UNKNOWN = auto()
    HIDDEN = "hidden by friction"
    # Reasons to stop, in any step.
    FAULT = "fault of the rig"
    UNREAD = "no reading"
    LEFT = "range left"
    # Cart, drive and arms.
    OFF_CENTRE = "off the centre"
    TOUCHED = "switch touched"
    SWINGING = auto()
    FAR = "far from zero"
    WANDERS = auto()
    DEAD = "does not count"
    STANDS = "stands still"
    MIRRORED = "one of two mirror images"
    REVERSED = auto()
    CART_REVERSED = "cart's scale reversed"
    CART_SCALE = "cart's scale in other units"
    SCALE = "another scale"
    # Encoders, switches and ticks.
    STUCK = auto()
    SWAPPED = auto()
    NOT_SUMMED = "not summed"
    SUMMED_TWICE = "summed twice"
    OTHER = "other side"
    SILENT = auto()
    WITHIN = "within the limits"
    LATE = auto()


class CautionCause(StrEnum):
    """Reasons for which runs of a plan are likely to fail, known without a run."""

    AUTHORITY = auto()
    """A stop needs more feedback than a cart gives reliably."""
    GAINS = auto()
    """The largest gain along the way multiplies the angles that the rig hides from the feedback."""
    START = auto()
    """The first gain multiplies the errors of the start."""
    LAG = auto()
    """The controller does not know the drive's lag."""
    LATE = auto()
    """Errors grow too much until a command acts."""
