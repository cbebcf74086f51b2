"""The supervisor: watches estimate, tracking and cart, and decides whether to go on.

    consistency   mean of NIS / degrees of freedom over a fifth of a second
    tracking      mean over about a second of the largest angle's distance from the reference, by the estimate
    cart          |x| + v²/(2a) + |v| t_d: where it comes to rest if it brakes from now, after the delay t_d

Outcomes: go on; restart the estimator; re-synchronise the reference's clock; hold the nearest orbit; stop the cart in
time. What is decided is an event of the log. A run that cannot be saved ends with the cart at rest inside its limits.

Which sensor is stuck: it repeats one reading while the arm must have moved on, or the cart was sent elsewhere.

For joint i, whose reading has been the same since tick s, and the cart, whose has since s':

    max |ref_i(k) - ref_i(s)| ≥ max(0.02 rad, 4 counts),        |Σ w Δt| ≥ max(2 mm, 4 counts)

w: the velocity that the cart was sent to. A count is the smallest step that was seen. An arm that turns back, or is
held at rest, stays within a count as well, but so does its reference. Without this a filter follows a stuck encoder for
a tenth of a second, and a stuck scale of the cart for ever, the cart being unobservable from the arms.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from dpcontrol.foundation.settings import Settings, setting
from dpcontrol.loop.result import Ending

HOLDS = ("none", "nearest")
"""What may be held where the reference was given up."""


class Outcome(StrEnum):
    """What the supervisor may decide."""

    CONTINUE = "continue"
    RESTART = "restart the estimator"
    RESYNCHRONISE = "re-synchronise"
    HOLD = "hold"
    STOP = "stop"


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


_NEARLY = 1 - 1e-9
"""Sums of the same numbers in another order may differ by their round-off."""
TRACKING_MEMORY = 1.0
ESTIMATE_MEMORY = 0.2
"""Time constants of the means, s."""
LOST_AFTER_FALLBACK = 1.5
"""rad: from which what was fallen back to is lost as well, where less than that loses the reference."""


Judgement = tuple[Outcome, Ending, str]
"""What to do, the run's ending if it is to stop, and why."""


@dataclass
class Supervisor:
    """Watches one run. travel m, acceleration m/s²: the cart's limits; reaction s: until a command acts."""

    settings: SupervisorSettings
    period: float
    travel: float
    acceleration: float
    reaction: float
    can_hold: bool = False
    error: float = 0.0
    nis: float = 0.0
    silent: float = 0.0
    restarts: int = 0
    _moved: float = -math.inf

    def __post_init__(self) -> None:
        self.tracking_share = min(self.period / TRACKING_MEMORY, 1.0)
        self.estimate_share = min(self.period / ESTIMATE_MEMORY, 1.0)
        self.lost = self.settings.lost_tracking
        self.brake = 2 * self.settings.braking * self.acceleration

    def stopping_point(self, position: Any, velocity: Any) -> Any:
        """Return where the cart comes to rest if it brakes now: m from the centre, in the direction of its motion.

        Of one run or, as arrays, of many. Negative on the side that it comes from; the margin is added.
        """
        side = np.copysign(1.0, velocity)
        return side * (position + velocity * self.reaction) + velocity * velocity / self.brake + self.settings.margin

    def far_from_ends(self, distance: Any, speed: Any) -> Any:
        """Tell whether a cart so far (m) from the centre and so fast (m/s) stops well inside, whichever way it goes.

        Of one run or, as arrays, of many.
        """
        reach = distance + speed * self.reaction + speed * speed / self.brake + self.settings.margin
        return reach < _NEARLY * self.travel

    def judge(
        self, now: float, *, error: float, nis: float, used: int, position: float, velocity: float, sent: float = 0.0
    ) -> Judgement:
        """Return what to do, the run's ending if it is to stop, and why.

        error rad: largest distance of an angle from the reference; nis over `used` positions, of this tick; position m
        and velocity m/s of the cart as expected when all that was sent has acted; sent m/s: the velocity that it was
        sent to, which a drive that lags or answers late has yet to reach.
        """
        s = self.settings
        if used:
            self.silent = 0.0
            self.nis += (nis / used - self.nis) * self.estimate_share
        else:
            self.silent += self.period
        self.error += (error - self.error) * self.tracking_share
        # Written so that NaN stops the run.
        if not self.nis <= s.lost_estimate or not math.isfinite(error):
            return self._estimate(now)
        if self.silent > s.missing:
            why = f"no measurement for {self.silent:.3f} s; check the encoders' cables"
            return Outcome.STOP, Ending.ESTIMATE_LOST, f"estimate lost at t = {now:.3f} s: {why}"
        # At its fastest on the worse side first: mostly that is far from the track's end already.
        if not self.far_from_ends(abs(position), max(abs(velocity), abs(sent))):
            farthest = self.stopping_point(position, velocity)
            if sent:
                farthest = max(farthest, self.stopping_point(position, sent))
            if farthest >= self.travel:
                why = (
                    f"at {position:.3f} m with {velocity:.2f} m/s it must brake now to stay on the track; raise "
                    "its weight (position in [controller]) or lengthen the track (travel in [run])"
                )
                return Outcome.STOP, Ending.CART_STOP, f"cart at its stop at t = {now:.3f} s: {why}"
        if self.error > self.lost:
            reason = f"tracking lost at t = {now:.3f} s: an angle has stayed {self.error:.2g} rad from the reference"
            if self.can_hold:
                self.can_hold, self.error = False, 0.0
                self.lost = max(self.lost, LOST_AFTER_FALLBACK)
                return Outcome.HOLD, Ending.TRACKING_LOST, reason
            return Outcome.STOP, Ending.TRACKING_LOST, reason
        if s.resynchronise and self.error > s.resynchronise and now - self._moved > TRACKING_MEMORY:
            self._moved = now
            return Outcome.RESYNCHRONISE, Ending.TRACKING_LOST, f"an angle is {self.error:.2g} rad from the reference"
        return Outcome.CONTINUE, Ending.FINISHED, ""

    def _estimate(self, now: float) -> Judgement:
        shown = f"mean NIS {self.nis:.3g} for each position" if math.isfinite(self.nis) else "it is no longer finite"
        if self.restarts < self.settings.restarts:
            self.restarts += 1
            self.nis = 0.0
            return Outcome.RESTART, Ending.ESTIMATE_LOST, f"{shown}: the estimator restarts from the encoders"
        why = f"{shown} where 1 or so is expected; check the encoders and the model's parameters, or assume more noise"
        return Outcome.STOP, Ending.ESTIMATE_LOST, f"estimate lost at t = {now:.3f} s: {why}"

    @staticmethod
    def overruled(verdict: Judgement, now: float, *, stuck: str, switch: bool) -> Judgement:
        """Return a verdict, or the stop of a run whose sensor is stuck (a sentence) or whose limit switch answered."""
        if stuck and verdict[0] is not Outcome.STOP:
            # A restart does not help against that.
            why = f"estimate lost at t = {now:.3f} s: {stuck}; check its cable and its head"
            return Outcome.STOP, Ending.ESTIMATE_LOST, why
        if switch and verdict[0] is Outcome.CONTINUE:
            why = f"cart at its stop at t = {now:.3f} s: a limit switch answered; allow more travel"
            return Outcome.STOP, Ending.CART_STOP, why
        return verdict


_STILL = 0.015
"""Seconds of one reading of a joint at least."""
_TURNING = 10.0
"""rad/s² and m/s²: what turns back as slowly stays within a count q for 2 √(2 q / this), 11 ms with 40,000 counts."""
_CART_STILL = 0.05
"""Seconds of one reading of the cart: it begins to move only once the first commands have come to act."""
_JOINT_MOVED, _CART_MOVED = 0.02, 2e-3
"""rad and m."""
_COUNTS = 4.0
_DOUBT = 300.0
"""Mean NIS per position: with 256 counts, stuck encoders gave 450 and more when they were found, slow arms up to 270.
The cart's scale is detected without it: only its own commands contradict it."""
_UNSEEN = 0.2
"""rad: taken for a count while a sensor has not moved at all."""
SAME = 1e-9
"""rad and m: readings this near to each other are the same count."""


class StuckWatch:
    """Watches the sensors of one run of `arms` arms, `period` s from tick to tick; reaction s: until a command acts."""

    def __init__(self, arms: int, *, period: float, reaction: float = 0.0) -> None:
        self._arms, self._period = arms, period
        # Bounds, sensor by sensor: ticks, rad or m, mean NIS per position.
        self.still = [_STILL / period] * arms + [(_CART_STILL + reaction) / period]
        self.least = [_JOINT_MOVED] * arms + [_CART_MOVED]
        self.doubt = [_DOUBT] * arms + [0.0]
        self._last = [math.nan] * (arms + 1)
        self._steps = [math.inf] * (arms + 1)
        self._same = [0] * (arms + 1)
        self._begin = [0.0] * (arms + 1)
        self._moved = [0.0] * (arms + 1)
        self._sent = 0.0

    def seen(self, positions: Sequence[float], wanted: Sequence[float], sent: float, nis: float) -> str:
        """Return which sensor is stuck, or "".

        positions (n+1,): absolute angles and the cart's position, all new; wanted: the reference's angles first; sent
        m/s: the velocity that the cart was sent to; nis: its mean of late, for each position.
        """
        n, inner, inner_wanted = self._arms, 0.0, 0.0
        last, same, begin = self._last, self._same, self._begin
        self._sent += sent * self._period
        for i, position in enumerate(positions):
            if i < n:
                due = wanted[i]
                value, should = position - inner, due - inner_wanted
                inner, inner_wanted = position, due
            else:
                value, should = position, self._sent
            step = abs(value - last[i])
            if not step < SAME:
                last[i], begin[i] = value, should
                if same[i]:
                    same[i], self._moved[i] = 0, 0.0
                if step < self._steps[i]:
                    self._steps[i] = step
                continue
            same[i] += 1
            moved = self._moved[i] = max(self._moved[i], abs(should - begin[i]))
            if same[i] >= self.still[i] and moved >= self.least[i] and not nis <= self.doubt[i]:
                found = self.sentence(i, same=same[i], moved=moved, step=self._steps[i])
                if found:
                    return found
        return ""

    def sentence(self, i: int, *, same: int, moved: float, step: float) -> str:
        """Return a sentence saying that sensor i is stuck, or "" where its joint may be turning back.

        same: ticks with one reading; moved: by how much it should have changed meanwhile; step: the smallest seen.
        """
        count = step if step < math.inf else _UNSEEN / _COUNTS
        turning = 2 * math.sqrt(2 * count / _TURNING) / self._period
        if not (moved >= _COUNTS * count and same >= turning):
            return ""
        name = "the cart's scale" if i == self._arms else f"the encoder of joint {i + 1}"
        return f"{name} is stuck: it has given the same reading for {same * self._period:.3g} s"
