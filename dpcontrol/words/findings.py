"""Sentences and remedies of commissioning's findings, by step and cause.

`f` are the numbers and names of a finding, `c` the measured values that [run] of the itinerary should have.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from dpcontrol.foundation.causes import FindingCause as Cause

Figures = Mapping[str, Any]
"""Numbers and names of a finding, by which its sentence is made; functions of this module call them `f`."""

_AGAIN = "fix the other findings and start again"
_IDENTIFY = "identify the model from free swings of this rig (`dpcontrol identify`), or check the joints' bearings"
_HURRY = "reduce other work on the computers, request priority with --real-time, or run at a lower rate"
_NAMES = {"drive": "the drive", "cart": "the cart's scale"}


def _with_error(value: float, error: float) -> str:
    """Return a number with its standard error, rounded to two digits of the error."""
    digits = min(max(1 - math.floor(math.log10(max(error, 1e-9))), 0), 4)
    return f"{value:.{digits}f} ± {error:.{digits}f}"


def _each(values: Sequence[float], errors: Sequence[float], scale: float = 1.0) -> str:
    """Return several numbers with their standard errors.

    Args:
        values: numbers in SI units.
        errors: their standard errors.
        scale: factor to the unit of the text.
    """
    pairs = zip(values, errors, strict=True)
    return " and ".join(_with_error(scale * value, scale * error) for value, error in pairs)


def _counts(values: Sequence[int | None], none: str) -> str:
    """Return the counts per turn of encoders; `none` stands for an encoder that shows no rounding to counts."""
    return " and ".join(f"{value:,}" if value else none for value in values)


def _late(f: Figures) -> str:
    """Return the sentence on the deadlines of a commissioning: late ticks, lost readings, repeated commands."""
    return (
        f"of {f['ticks']:,} ticks {f['late']} began at least a period late, and {f['lost']} had no reading; the bench "
        f"repeated a command {f['held']} times"
    )


def _delay(f: Figures) -> str:
    """Return the clause on the measured delay and lag of the drive, with their standard errors."""
    lag = _with_error(1e3 * f["lag"], 1e3 * f["lag_error"])
    return f"the delay is {_with_error(f['delay'], f['delay_error'])} periods, the lag {lag} ms"


def _factors(f: Figures) -> str:
    """Return the measured shares of the model's swing, of the encoders whose share could be measured."""
    pairs = zip(f["factors"], f["errors"], strict=True)
    return ", ".join(f"{factor:.2f}" for factor, error in pairs if error is not None)


def _zeros(f: Figures) -> str:
    """Return the sentence on the readings of the hanging arms, which are zero if the encoders are set correctly."""
    return f"hanging still, the arms read {_each(f['zeros'], f['zero_errors'])} rad"


def _friction(f: Figures) -> str:
    """Return the clause on the measured dry friction of the joints, with standard errors."""
    return f"the joints have a dry friction of {_each(f['torques'], f['errors'], 1e3)} mN m"


def _model(f: Figures) -> str:
    """Return the sentence on the arms' measured frequencies and damping in comparison with the model."""
    shares = ", ".join(f"{100 * (ratio - 1):+.1f} %" for ratio in f["ratios"])
    return (
        f"the arms swing at {', '.join(f'{value:.3f}' for value in f['frequencies'])} Hz, {shares} off the model's, "
        f"and viscous friction damps their swing at least {f['damped']:.1f} times as much"
    )


def _mirrored(f: Figures) -> str:
    """Return the sentence on two sets of reversed signs that no measurement can tell apart."""
    first_set, second_set = (
        " and ".join(_NAMES.get(name, f"the encoder of {name}") for name in names) for names in f["reversed"]
    )
    return f"either {first_set} are reversed, or {second_set}: the readings are the same"


FINDINGS: Mapping[tuple[str, Cause], Callable[[Figures, Figures], tuple[str, str]]] = {
    ("", Cause.FAULT): lambda f, c: (
        f["text"],
        "fix what the rig reports and start again; a search for switches must end before the hard stop",
    ),
    ("", Cause.UNREAD): lambda f, c: (
        f"{' and '.join(f['sensors'])} gave no reading for {f['seconds']:.2g} s, so the cart was stopped",
        "check whether it is plugged in, whether the rig sends its reading each period, and whether packets are lost",
    ),
    ("", Cause.LEFT): lambda f, c: (
        f"the cart left its {1e3 * f['reach']:.3g} mm (it is at {1e3 * f['away']:+.3g} mm), so it was stopped; "
        f"{f['late']} of {f['ticks']} commands came at least a period late",
        "check whether the drive follows an acceleration in m/s², holds the cart at zero, and has the cart's scale in "
        f"metres; if commands were late, {_HURRY}",
    ),
    ("still", Cause.OFF_CENTRE): lambda f, c: (
        f"the cart is at {f['position']:+.4g} m by its scale",
        "move it to the centre of its track, and set its scale to zero there, in metres",
    ),
    ("still", Cause.TOUCHED): lambda f, c: (
        f"the limit switch at the {f['side']} responds although the cart does not touch it",
        "check whether it is stuck or its contact is inverted (normally closed), and whether the cart is at the centre",
    ),
    ("still", Cause.SWINGING): lambda f, c: (
        f"the arms still swing by ±{f['swing']:.2g} rad after {f['seconds']:.0f} s",
        "hold them until they hang still, let go and start again; if they do hang still, their readings are not in "
        "radians, or are wrapped to one turn",
    ),
    ("still", Cause.UNKNOWN): lambda f, c: (
        "the arms' zeros cannot be determined while an encoder does not count",
        "fix the encoder and start again",
    ),
    ("still", Cause.FAR): lambda f, c: (
        f"{_zeros(f)}: angles are measured from hanging, so each must be zero",
        "set the encoders to zero while the arms hang",
    ),
    ("still", Cause.DIFFERS): lambda f, c: (
        _zeros(f),
        f"set the encoders to zero while the arms hang, or zeros = {c['zeros']} in [run], as --write does"
        + ", or level the track: all arms hang to one side" * f["tilted"],
    ),
    ("still", Cause.HIDDEN): lambda f, c: (_zeros(f), "loosen the joints and start again: friction hides the zeros"),
    ("still", Cause.RIGHT): lambda f, c: (_zeros(f), ""),
    ("drive", Cause.WANDERS): lambda f, c: (
        f"the cart wanders by {1e3 * f['wander']:.2g} mm, in which a commanded shift is not visible",
        "check whether the drive holds the cart where zero is commanded, and follows accelerations in m/s²",
    ),
    ("drive", Cause.DEAD): lambda f, c: (
        "the arms began to swing when the cart was to shift, but its reading did not change: the cart's scale does not "
        "count",
        "check whether the cart's scale is plugged in, and its reading is the last position sent, in metres",
    ),
    ("drive", Cause.STANDS): lambda f, c: (
        f"the cart does not move: of a commanded shift, its reading shows {1e3 * f['seen']:.2g} mm and the arms do not "
        "swing",
        "check whether the motor is on, its brake released and the emergency stop pulled out, and commands reach the "
        "drive as accelerations in m/s²",
    ),
    ("drive", Cause.UNKNOWN): lambda f, c: (
        f"{100 * f['misfit']:.0f} % of the cart's motion is not explained by its commands and a drive with a delay and "
        "a lag",
        "check whether the drive works within its limits, and whether deadlines were missed",
    ),
    ("drive", Cause.MIRRORED): lambda f, c: (
        _mirrored(f),
        "check in which direction the cart goes first: to the right means that its drive is correct",
    ),
    ("drive", Cause.REVERSED): lambda f, c: (
        "the drive is reversed: a command to the right moves the cart to the left, by its scale and by the arms",
        "reverse the sign of commands in the rig's program, or swap two of the motor's leads; if the cart went to the "
        "right first, reverse the cart's scale and all encoders instead",
    ),
    ("drive", Cause.CART_REVERSED): lambda f, c: (
        "the cart's scale is reversed: its reading decreases when the arms show that the cart goes to the right",
        "reverse the sign of the cart's reading in the rig's program",
    ),
    ("drive", Cause.CART_SCALE): lambda f, c: (
        f"the cart's scale shows {abs(f['gain']):.3g} times the distance that commands and arms show",
        f"divide the cart's reading by {abs(f['gain']):.3g} in the rig's program; it is in metres",
    ),
    ("drive", Cause.SCALE): lambda f, c: (
        f"the drive gives {f['gain']:.3g} times the commanded acceleration",
        f"multiply commands by {1 / f['gain']:.3g} in the rig's program, or correct the drive's own scale",
    ),
    ("drive", Cause.RIGHT): lambda f, c: (
        f"the cart goes in the commanded direction, with {f['gain']:.3f} of the acceleration",
        "",
    ),
    ("delay", Cause.UNKNOWN): lambda f, c: ("delay and lag cannot be determined from this motion", _AGAIN),
    ("delay", Cause.RIGHT): lambda f, c: (f"{_delay(f)}, as in [run]", ""),
    ("delay", Cause.DIFFERS): lambda f, c: (
        f"{_delay(f)}, but [run] has {f['said_delay']:g} periods and {1e3 * f['said_lag']:g} ms",
        f"set delay = {c['delay']:g}, lag and drive_lag = {c['lag']:g} in [run], as --write does",
    ),
    ("encoders", Cause.STANDS): lambda f, c: (
        "no arm's reading moves: the joints are stuck, or the encoders are not read",
        "turn each arm by hand: loosen its joint if the reading follows, and check the encoder's plug if not",
    ),
    ("encoders", Cause.STUCK): lambda f, c: (
        f"the encoder of arm {f['arm']} does not move: it shows {abs(f['factors'][f['arm'] - 1]):.2f} of the expected "
        "swing",
        f"check whether the encoder of arm {f['arm']} is plugged in, powered and tight on its shaft",
    ),
    ("encoders", Cause.UNKNOWN): lambda f, c: (
        f"no known fault explains the swing of the arms: {100 * f['misfit']:.0f} % is unexplained",
        "check whether the model is that of these arms (`dpcontrol identify`) and turn each arm by hand: its own angle "
        "should grow counter-clockwise",
    ),
    ("encoders", Cause.SWAPPED): lambda f, c: (
        f"the encoders of arms {' and '.join(str(k) for k, at in enumerate(f['order'], 1) if at != k)} are swapped",
        "swap their plugs, or their order in the rig's program",
    ),
    ("encoders", Cause.NOT_SUMMED): lambda f, c: (
        "the rig sends the angle between each arm and the previous one",
        "send absolute angles: the sum of an arm's joint angle and those of all previous joints",
    ),
    ("encoders", Cause.SUMMED_TWICE): lambda f, c: (
        "the rig sums angles that are already absolute",
        "send each encoder's angle as it is",
    ),
    ("encoders", Cause.REVERSED): lambda f, c: (
        f"the {f['kind']} encoder of arm {f['arm']} counts backwards",
        "reverse the sign of that encoder's counts in the rig's program, before angles are summed, or swap its "
        "channels A and B",
    ),
    ("encoders", Cause.SCALE): lambda f, c: (
        f"the encoder of arm {f['arm']} shows {abs(f['factors'][f['arm'] - 1]):.3g} times the swing of the model",
        f"divide its angle by {f['scale']:.3g} in the rig's program, or multiply its counts per turn there: it may "
        "send degrees, or count once, twice or four times, and angles are in radians",
    ),
    ("encoders", Cause.HIDDEN): lambda f, c: (
        f"friction hides the scale of the encoder of {' and of '.join(f'arm {arm}' for arm in f['hidden'])}",
        "loosen the joint and start again, or turn the arm once by hand: its angle should change by 2π",
    ),
    ("encoders", Cause.RIGHT): lambda f, c: (
        f"{f['kind']} encoders in order, each with its sign; they show {_factors(f)} of the model's swing",
        "",
    ),
    ("counts", Cause.UNKNOWN): lambda f, c: (
        "the arms' readings show no rounding to counts",
        f"check that the encoders have {_counts(f['said'], 'no')} counts per turn, as in [run]",
    ),
    ("counts", Cause.DIFFERS): lambda f, c: (
        f"the encoders show {_counts(f['counts'], 'unknown')} counts per turn, but [run] has "
        f"{_counts(f['said'], 'no rounding')}",
        f"set counts = {c['counts']} in [run], as --write does",
    ),
    ("counts", Cause.HIDDEN): lambda f, c: (
        f"the encoders show {_counts(f['counts'], 'unknown')} counts per turn",
        "loosen the joints: friction hides the others",
    ),
    ("counts", Cause.RIGHT): lambda f, c: (f"{_counts(f['counts'], 'no')} counts per turn, as in [run]", ""),
    ("play", Cause.UNKNOWN): lambda f, c: (
        "the play of the encoders cannot be determined: the joints do not swing like those of the model",
        _AGAIN,
    ),
    ("play", Cause.RIGHT): lambda f, c: (
        f"the encoders have a play of {_each(f['play'], f['play_errors'], 1e3)} mrad, as in [run]; less than "
        f"{1e3 * f['least']:.2g} mrad is not visible",
        "",
    ),
    ("play", Cause.DIFFERS): lambda f, c: (
        f"the encoders have a play of {_each(f['play'], f['play_errors'], 1e3)} mrad, but [run] has "
        f"{' and '.join(f'{1e3 * play:g}' for play in f['said'])} mrad",
        f"set play = {c['play']} in [run], as --write does, or fix the encoders' couplings",
    ),
    ("friction", Cause.RIGHT): lambda f, c: (
        f"{_friction(f)}, as in [run] and the model; less than {1e3 * f['least']:.1g} mN m is not visible",
        "",
    ),
    ("friction", Cause.DOUBTFUL): lambda f, c: (
        _friction(f),
        f"set stiction = [{', '.join(f'{torque:.2g}' for torque in f['stiction'])}] in [run], or identify the model "
        "(`dpcontrol identify`)",
    ),
    ("model", Cause.RIGHT): lambda f, c: (_model(f), ""),
    ("model", Cause.DOUBTFUL): lambda f, c: (_model(f), _IDENTIFY),
    ("switches", Cause.UNKNOWN): lambda f, c: (
        f"the limit switches were not tried: {'the drive has a fault' if f['asked'] else '--switches was not given'}",
        "fix the drive first" if f["asked"] else "give --switches with the distance in metres that the cart can move",
    ),
    ("switches", Cause.OTHER): lambda f, c: (
        f"at the {f['side']}, at {f['position']:+.4f} m, the switch of the other side responds",
        "swap the plugs of the limit switches, or their signs in the rig's program: right is +1",
    ),
    ("switches", Cause.SILENT): lambda f, c: (
        f"no switch responds at the {f['side']} up to {f['position']:+.4f} m",
        "press that switch by hand: if no reading shows it, check its wiring; otherwise give --switches a longer "
        "distance, less than that to the hard stop",
    ),
    ("switches", Cause.WITHIN): lambda f, c: (
        f"the switch at the {f['side']} responds at {f['position']:+.4f} m, within the ±{f['limit']:g} m that [limits] "
        "allows",
        f"set position below {abs(f['position']):.3f} in [limits], or move the switch outwards",
    ),
    ("switches", Cause.RIGHT): lambda f, c: (
        f"the switch at the {f['side']} responds at {f['position']:+.4f} m",
        "",
    ),
    ("deadlines", Cause.RIGHT): lambda f, c: (_late(f), ""),
    ("deadlines", Cause.DOUBTFUL): lambda f, c: (_late(f), _HURRY),
    ("deadlines", Cause.LATE): lambda f, c: (_late(f), _HURRY),
}
"""Sentence and remedy of each finding, made of its figures and of the changes to [run]; step "" for any step."""


def told(step: str, cause: Cause, figures: Figures, changes: Figures) -> tuple[str, str]:
    """Return the sentence on a finding of commissioning, and the remedy, "" for a finding without a defect.

    Args:
        step: step of commissioning to which the finding belongs.
        cause: cause of the finding.
        figures: numbers and names of the finding.
        changes: measured values that [run] of the itinerary should have, by key; none if [run] may stay.
    """
    make_sentence = FINDINGS.get((step, cause)) or FINDINGS["", cause]
    return make_sentence(figures, changes)
