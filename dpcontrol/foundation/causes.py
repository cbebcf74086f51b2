"""Causes of what happens in a run, as data.

A value identifies its cause in logs, tables and documents. `dpcontrol.words.runs` has the sentences.
"""

from enum import StrEnum


class Cause(StrEnum):
    """Cause of a fall, of a run's end or of another event in its log."""

    # Decisions of a tick have the names of `dpcontrol.control.tick.Outcome`.
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
    RESTED = "at rest"
    STARTED = "from rest"
    CLOCKLESS = "no clock"
    LATE = "deadline missed"
    CUT = "command cut"
    UNTRUSTED = "model error"


class Fault(StrEnum):
    """What a run lacks to complete its plan, or why nobody can tell."""

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
