"""The troubles of a bench, one row each, for preflights, remedies of failed runs, campaigns and the standard score."""

import math
from dataclasses import dataclass

import numpy as np

LEVELS = 21
"""Number of levels of a trouble in the standard score."""


def _evenly(first: float, last: float) -> tuple[float, ...]:
    """Return the levels of a trouble in equal steps."""
    return tuple(np.linspace(first, last, LEVELS).tolist())


def _by_ratio(first: float, last: float) -> tuple[float, ...]:
    """Return the levels of a trouble in equal ratios."""
    return tuple(np.geomspace(first, last, LEVELS).tolist())


@dataclass(frozen=True)
class Trouble:
    """A setting of the bench that can make runs fail; values are those of the setting.

    Attributes:
        setting: its path in a run's settings.
        name: name in the text of a change.
        remedy: advice for halving it. A preflight tries half the value only if there is advice.
        nothing: value of the setting without the trouble.
        halves, removed: True if `--why` tries half the value, or the bench without the trouble.
        border: name of its border in a preflight, "" if none is sought.
        unit: unit in which the border is shown.
        shown: factor from the setting to this unit.
        first, last: range in which the border is sought.
        always: True if the border is sought on a bench without this trouble too.
        score: name of the kind in the standard score, or "".
        levels: values (21,) of the standard score.
        besides: further settings of the standard score.
        in_periods: True if the setting is in periods, and the range and the levels are in s.
    """

    setting: str
    name: str = ""
    remedy: str = ""
    nothing: float = 0.0
    halves: bool = True
    removed: bool = True
    border: str = ""
    unit: str = ""
    shown: float = 1.0
    first: float = 0.0
    last: float = 0.0
    always: bool = True
    score: str = ""
    levels: tuple[float, ...] = ()
    besides: tuple[tuple[str, float], ...] = ()
    in_periods: bool = False

    @property
    def falling(self) -> bool:
        """True if smaller values of the setting are worse, such as counts of an encoder."""
        return self.last < self.first


TROUBLES = (
    Trouble(
        "mismatch",
        "mismatch",
        "identify the arms",
        border="mismatch",
        unit="%",
        shown=100.0,
        first=0.15,
        last=0.9,
        score="model error",
        levels=_evenly(0.0, 0.25),
    ),
    Trouble("sensors.rate_noise", "rate noise", score="velocity noise", levels=_evenly(0.0, 3.0)),
    Trouble(
        "command_noise",
        "command noise",
        "use a quieter drive",
        score="command noise",
        levels=_evenly(0.0, 75.0),
    ),
    Trouble("response", "response error", nothing=1.0, score="response", levels=_evenly(0.1, 2.0)),
    Trouble(
        "delay",
        "delay",
        "answer sooner",
        border="delay",
        unit="ms",
        shown=1e3,
        first=0.01,
        last=0.04,
        score="delay",
        levels=_evenly(0.0, 0.3),
        in_periods=True,
    ),
    Trouble(
        "push_impulse",
        "impulse of the pushes",
        border="{pushes} blows",
        unit="mN m s",
        shown=1e3,
        first=0.005,
        last=20.0,
        score="pushes",
        levels=_evenly(0.0, 0.012),
        besides=(("pushes", 3),),
    ),
    Trouble(
        "counts",
        halves=False,
        removed=False,
        border="counts",
        unit="a turn",
        first=1000,
        last=16,
        score="quantisation",
        levels=tuple(round(v) for v in _by_ratio(40_000, 16)),
    ),
    Trouble("acceleration", halves=False, removed=False, score="acceleration limit", levels=_by_ratio(30.0, 0.3)),
    Trouble(
        "zero_error",
        "zero error",
        "set the encoders' zeros",
        border="zeros",
        unit="mrad",
        shown=1e3,
        first=0.05,
        last=0.8,
        score="encoder zeros",
        levels=_evenly(0.0, 0.5),
    ),
    Trouble("model_uncertainty", "model uncertainty", "identify the arms"),
    Trouble("initial_error", "initial error", "hold the arms still at the start"),
    Trouble(
        "lag",
        "drive lag",
        "tune a stiffer velocity loop",
        removed=False,
        border="lag",
        unit="ms",
        shown=1e3,
        first=0.02,
        last=0.32,
    ),
    Trouble("friction", "friction error", nothing=1.0),
    Trouble("cart_mass", "cart mass", halves=False),
    Trouble("jerk", "jerk limit", nothing=math.inf, halves=False),
    Trouble("zero_drift", "zero drift"),
    Trouble("noise", "encoder noise", "use quieter encoders"),
    Trouble("missed_counts", "missed counts"),
    Trouble("dropout", "dropouts"),
    Trouble("jitter", "jitter"),
    Trouble("stuck_at", "stuck sensor", nothing=math.inf, halves=False),
    Trouble(
        "stiction", "stiction", "loosen the joints", border="stiction", unit="mN m", shown=1e3, first=0.004, last=0.5
    ),
    Trouble(
        "cable_torque",
        "cable torque",
        border="cable torque",
        unit="mN m",
        shown=1e3,
        first=0.05,
        last=5.0,
        always=False,
    ),
    Trouble(
        "cable_stiffness",
        "cable stiffness",
        border="cable stiffness",
        unit="mN m/rad",
        shown=1e3,
        first=0.02,
        last=2.0,
        always=False,
    ),
    Trouble("initial_rate", "initial rates", border="first rates", unit="rad/s", first=1.0, last=30.0, always=False),
    Trouble(
        "initial_cart",
        "initial cart offset",
        border="cart at first",
        unit="mm",
        shown=1e3,
        first=0.1,
        last=1.0,
        always=False,
    ),
    Trouble("play", "play", "use encoders with less play", border="play", unit="mrad", shown=1e3, first=0.01, last=0.8),
    Trouble("belt", "belt", halves=False, border="belt", unit="Hz", first=40.0, last=4.0),
    Trouble("tilt", "tilt", "level the track"),
    Trouble("travel", halves=False, removed=False, border="travel", unit="mm", shown=1e3, first=math.inf),
    Trouble("knock_velocity", "velocity of the knocks"),
    Trouble("knock_impulse", "impulse of the random blows"),
)
"""The standard score has the kinds of the first nine rows."""
STANDARD = tuple(trouble for trouble in TROUBLES if trouble.score)
"""Nine kinds; SI units, encoders in counts per turn."""
