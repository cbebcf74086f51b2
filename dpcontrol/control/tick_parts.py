"""Parts of a tick's inputs and outputs, and expressions of conditions."""

from collections import namedtuple
from enum import IntEnum
from functools import reduce

import casadi as ca


class Outcome(IntEnum):
    """Decision of a tick; from `ESTIMATE_LOST` on, the cart is stopped."""

    GO_ON = 0
    RESTART = 1
    """Restart the estimator."""
    RESYNCHRONISE = 2
    """Move the reference's clock."""
    HOLD = 3
    """Abandon the reference and hold the nearest orbit or equilibrium."""
    ESTIMATE_LOST = 4
    SILENT = 5
    """Measurements of a position were missing for too long."""
    CART = 6
    """The cart must brake now to stay on its track."""
    TRACKING_LOST = 7
    STUCK = 8
    """A sensor repeats its reading."""
    SWITCH = 9
    """A limit switch was touched."""
    FALLEN = 10
    """The arms have left the reference, and the cart that follows them must brake now."""
    DRIVE_OFF = 11
    """The cart does not follow the commands."""
    DRIVE_REVERSED = 12
    """The cart moves against the commands."""


BIG = 1e30
"""Bound on all numbers of a sound run, also representable in single precision."""

Numbers = namedtuple(
    "Numbers",
    "share acceleration velocity travel reaction onset brake margin lost_tracking lost_estimate resynchronise restarts "
    "missing can_hold trust mode scale drive_noise lag lag_keeps noise parameters process fresh play moves notch",
)
"""Constants of a run: the numbers that judge it, and those of its model (see `TickEquations.numbers`).

share: part of the period in which the previous command still acts.
acceleration m/s², velocity m/s, travel m: limits of the cart. reaction s: until a command acts.
onset s: from the state ahead until the effect of braking that starts a tick later.
brake m/s²: twice the acceleration assumed for stopping.
lost_tracking rad, lost_estimate, resynchronise rad, restarts, missing s, margin m: see `SupervisorSettings`.
can_hold: 1 if there is a fallback. trust: of an adaptive law. mode: of a tick that tracks or holds, see `Mode`.
scale m: resolution of the cart's scale. drive_noise m/s²: stated noise on each command.
"""


Memory = namedtuple(
    "Memory",
    "z covariance sent drive velocity error nis silent restarts held moved restart stopped still acted cut "
    "was_untrusted last step same begin away pulled strained held_back scale scale_covariance scale_read scale_waited "
    "scale_level scale_surprise evidence heading drive_watch turns timing timed lateness strain mark shaped own origin",
)
"""Values stored from tick to tick, see `TickEquations.memory`."""
Measurement = namedtuple("Measurement", "measured present switch age rate_error offset")
"""Input from the rig, see `TickEquations.reading`."""
Row = namedtuple("Row", "feedforward gains state drive drive_gain extra_gains pair_gains own wanted")
"""Input from the table, see `TickEquations.row`."""
Sensed = namedtuple("Sensed", "z covariance sigmas nis used sound turns timing timed lateness strain mark relative")
"""Output of the first part of a tick, see `TickEquations.sensed`."""
Report = namedtuple(
    "Report",
    "state wish feedforward feedback acting saturated nis mode sigmas extra command outcome stop done newly_cut "
    "untrusted sensor repeats error mean_nis silent used ahead notable news own",
)
"""Output of a tick, see `TickEquations.report`."""


Known = namedtuple("Known", "memory reading row numbers sensed acts")
"""The inputs of a tick by part, and what is computed from them before the command.

memory, reading, row, numbers: parts of the inputs, with the names of `Memory`, `Measurement`, `Row` and `Numbers`.
sensed: estimate, with the names of `Sensed`. acts: state at which the command acts, and additions to the law
(`dpcontrol.control.tick`).
"""


def all_of(*conditions: ca.SX) -> ca.SX:
    """Return the expression that is 1 if all conditions hold, else 0."""
    return reduce(ca.logic_and, conditions)


def any_of(*conditions: ca.SX) -> ca.SX:
    """Return the expression that is 1 if at least one condition holds, else 0."""
    return reduce(ca.logic_or, conditions)


def clipped(value: ca.SX, low: ca.SX, high: ca.SX) -> ca.SX:
    """Return a value limited to two bounds; NaN stays NaN."""
    # Both comparisons are false for NaN.
    return ca.if_else(value > high, high, ca.if_else(value < low, low, value))


def within(value: ca.SX, most: ca.SX) -> ca.SX:
    """Return a value limited to ±`most`; NaN stays NaN."""
    return clipped(value, -most, most)


def finite(value: ca.SX) -> ca.SX:
    """Return the expression that is 1 for the finite numbers of a sound run, else 0, also for NaN."""
    return ca.fabs(value) <= BIG
