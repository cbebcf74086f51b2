"""The supervisor's settings, and what its decisions are called: the tick itself decides (`dpcontrol.control.tick`).

Outcomes: go on; restart the estimator; re-synchronise the reference's clock; hold the nearest orbit; stop the cart in
time. What is decided is an event of the log. A run that cannot be saved ends with the cart at rest inside its limits.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from dpcontrol.control.tick import Outcome
from dpcontrol.foundation.settings import Settings, setting
from dpcontrol.loop.result import Ending

HOLDS = ("none", "nearest")
"""What may be held where the reference was given up."""


@dataclass(frozen=True)
class SupervisorSettings(Settings, table="supervisor"):
    """When to step in.

    lost_tracking rad: mean distance of an angle from the reference from which no feedback returns (half a turn is π,
    and a completed period asks for 0.1); resynchronise rad: distance from which the clock is moved to the nearest
    phase, 0 for never. lost_estimate: mean NIS per degree of freedom; encoders that agree to a count make it thousands
    where the model is wrong by a tenth, and nothing is lost; 1e5 is some 0.04 rad. restarts: how often the estimator is
    restarted before it counts as lost. missing s: longest time without a measurement. braking: share of the greatest
    acceleration that is counted on to stop the cart (it brakes harder), and margin m: what must be left of the track
    then. hold: "nearest" to hold the nearest orbit or equilibrium, once, where tracking is lost; "none" to stop.
    """

    lost_tracking: float = setting(1.5, least=0.05, most=100, unit="rad")
    resynchronise: float = setting(0.0, least=0, most=100, unit="rad")
    lost_estimate: float = setting(100_000.0, least=5, most=1e12)
    restarts: int = setting(2, least=0, most=1000)
    missing: float = setting(0.1, least=1e-4, most=60, unit="s")
    braking: float = setting(0.5, least=0.01, most=1)
    margin: float = setting(0.002, least=0, most=1, unit="m")
    hold: str = setting("none", choices=HOLDS)


EVENTS = {
    Outcome.RESTART: "restart the estimator",
    Outcome.RESYNCHRONISE: "re-synchronise",
    Outcome.HOLD: "hold",
}
"""What an outcome is called in a log; all others: stop."""


def explained(outcome: Outcome, now: float, figures: Mapping[str, float], *, arms: int, period: float) -> str:
    """Return why a tick at `now` s decided so, in one sentence; figures: its report's numbers by their names.

    position m and velocity m/s: of the cart ahead.
    """
    nis, error = figures["mean_nis"], figures["error"]
    shown = f"mean NIS {nis:.3g} for each position" if math.isfinite(nis) else "it is no longer finite"
    away = f"an angle has stayed {error:.2g} rad from the reference"
    lost = f"estimate lost at t = {now:.3f} s:"
    match outcome:
        case Outcome.RESTART:
            return f"{shown}: the estimator restarts from the encoders"
        case Outcome.RESYNCHRONISE:
            return f"an angle is {error:.2g} rad from the reference"
        case Outcome.HOLD | Outcome.TRACKING_LOST:
            return f"tracking lost at t = {now:.3f} s: {away}"
        case Outcome.ESTIMATE_LOST:
            remedy = "check the encoders and the model's parameters, or assume more noise"
            return f"{lost} {shown} where 1 or so is expected; {remedy}"
        case Outcome.SILENT:
            return f"{lost} no measurement for {figures['silent']:.3f} s; check the encoders' cables"
        case Outcome.CART:
            fast = f"at {figures['position']:.3f} m with {figures['velocity']:.2f} m/s"
            return (
                f"cart at its stop at t = {now:.3f} s: {fast} it must brake now to stay on the track; raise its weight "
                "(position in [controller]) or lengthen the track (travel in [run])"
            )
        case Outcome.STUCK:
            which = int(figures["sensor"])
            name = "the cart's scale" if which > arms else f"the encoder of joint {which}"
            same = f"it has given the same reading for {figures['repeats'] * period:.3g} s"
            return f"{lost} {name} is stuck: {same}; check its cable and its head"
        case Outcome.SWITCH:
            return f"cart at its stop at t = {now:.3f} s: a limit switch answered; allow more travel"
        case Outcome.GO_ON:
            return ""


def ending(outcome: Outcome) -> Ending:
    """Return how a run ends that is stopped by this outcome."""
    if outcome in (Outcome.CART, Outcome.SWITCH):
        return Ending.CART_STOP
    return Ending.TRACKING_LOST if outcome is Outcome.TRACKING_LOST else Ending.ESTIMATE_LOST
