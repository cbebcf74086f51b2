"""What a run does after a fall: it calms the arms, starts again from rest, and goes on with the itinerary.

A run is a sequence of motions on one rig without interruption, one after the other by one `Ticker`, whose filter and
commands on their way go on:

    itinerary   the plan's reference, from some time of it on
    return      brake, and calm the arms, from anywhere, until they hang at rest
    start       from hanging at rest to a stop of the walk, by a transfer planned beforehand; then the itinerary

Before it falls it may be caught: where the way back to the reference is long, and another place of what was flown so
far is much nearer, the itinerary goes on from there: an orbit's other phase or other round, or a place on the tube
that leads to it. How far a place is away the Riccati solution tells.

    V(t) = (x̂ - x*(t))ᵀ P(t) (x̂ - x*(t)),    caught where V is above `_FAR` at the run's own time and the least V,
                                             at any earlier time, is below `_NEARER` of that

What is flown again costs time: V counts as (1 + back/`_WORTH`) times what it is at a place so many seconds back.

After a fall the symbol that failed is done again from the stop before it; what was completed stays completed.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from dpcontrol.control.calming import CalmingController
from dpcontrol.control.interface import Controller, GainSchedule, whole_turns
from dpcontrol.control.tick import BRAKING, Outcome
from dpcontrol.foundation.arrays import Array
from dpcontrol.logs import CATCH, LAP, REST, RESUME, RETURN, START, Flight, joined_text
from dpcontrol.loop.ticker import Ticker
from dpcontrol.references.problem import Limits

RETURN_SECONDS = 15.0
"""After which a return that has not come to rest begins anew: it takes 6 s at most from states that falls leave."""
FOLLOWED = 0.15
"""rad: while the mean distance from the reference is below this it is followed; and `_BEFORE` s before, it was."""
_BEFORE = 0.5
REST_ANGLE, REST_RATE, REST_CART = 0.05, 0.1, 0.01
"""rad, rad/s, m and m/s: by the estimate, what counts as hanging at rest, the cart in the middle."""
_QUIET = 0.3
"""rad/s: arms that stay below this for `REST_SECONDS` hang, for those that swing do not."""
REST_SECONDS, FRESH_SECONDS = 0.3, 0.2
"""For so long; and for how long the filter, which begins anew then, is left to find the rates."""
_TRIED = 0.3
"""s for which a filter that began anew is watched before it is believed."""
_STUCK = 20.0
"""s after which a sensor that still repeats itself is taken for one whose arm hangs still."""
_HELD = 0.08
"""rad, by the estimate: farther from the last stop's orbit than this over its last period a run has not held it."""
_EVERY = 10
"""Ticks between those that are looked at for it."""
_FAR, _NEARER = 10.0, 0.5
"""Cost-to-go from which another place is looked for, and the share of it that the other's must be below."""
_NEAR, _WORTH = 0.8, 1.0
"""rad: places from which an arm is farther are not looked at; and s: so far back a place counts as twice as far."""
_LOOKS, _DRIFTS = 0.1, 0.005
"""s and m/s: how often it is looked whether a cart that was stopped stands, and what counts as drifting."""
_FAST = 0.9
"""Share of the greatest speed at which a cart that runs off is stopped: arms that push it take it further."""
_MEETS = 0.05
"""Between the states (rad, rad/s, m, m/s) at which a reference ends and begins for laps without a rest."""
LAST_SECONDS = 1.5
"""s at the end of a reference in which such a state is looked for: the last orbit need not end where the first begins.
"""


class Motion(StrEnum):
    """What a run is doing."""

    ITINERARY = "itinerary"
    RETURN = "return"
    START = "start"


def calming_bounds(limits: Limits) -> Mapping[str, float]:
    """Return by what a return is judged, where it differs from a flight (`tick.BOUNDS`).

    No distance from rest is too far, and the filter may begin anew as often as it must. The law keeps the cart on its
    track; the supervisor steps in only where nothing but the hardest braking is left.
    """
    return {
        "lost_tracking": 1e9, "resynchronise": 0.0, "can_hold": 0.0, "restarts": 1e9,
        "brake": 2 * BRAKING * limits.acceleration, "margin": 0.0, "trust": 1e9,
    }  # fmt: skip


@dataclass(frozen=True, eq=False)
class StartController:
    """A way onto the itinerary, and on with it: from hanging at rest to one stop of the walk, or from a place near it.

    stop: which; at s: the time of the plan's reference at which that is joined, after `lead_in` ticks. turns (n,) rad:
    of the plan's reference against this one. gains: of all of it.
    """

    stop: int
    at: float
    lead_in: int
    turns: Array
    gains: GainSchedule
    kind: str = "start"

    @property
    def first_state(self) -> Array:
        """Return the state (N,) from which it starts."""
        return self.gains.references[0]

    @property
    def ticks(self) -> int:
        """Return for how many periods it has something to do."""
        return len(self.gains.references) - 1

    def schedule(self, lead: int) -> GainSchedule:
        """Return what the loop needs; it was made for this lead."""
        return self.gains


def started(before: GainSchedule, main: GainSchedule, *, lead_in: int, place: int, turns: Array) -> GainSchedule:
    """Return `before` for `lead_in` ticks, then `main` from its tick `place` on, whole `turns` (n,) rad taken off."""
    rest = main.turned(-turns)
    return replace(
        main,
        rows=np.concatenate([before.rows[:lead_in], rest.rows[place:]]),
        references=np.concatenate([before.references[:lead_in], rest.references[place:]]),
        queued=before.queued if lead_in else main.queued,
    )


@dataclass(frozen=True, eq=False)
class Reach:
    """Places of a reference, `every` ticks apart: states (M, N), and P (M, N, N) of the cost-to-go about them."""

    every: int
    states: Array
    costs: Array

    def cost(self, state: Array, place: int) -> float:
        """Return what it costs to get from `state` (N,), on whatever turns, to a place."""
        away = self._away(state, slice(place, place + 1))[0]
        return float(away @ self.costs[place] @ away)

    def nearest(self, state: Array, last: int, *, worth: float) -> tuple[int, float]:
        """Return the place up to `last` to which it costs least to get, and what; infinite where none is near.

        Costs count more the more is flown again: twice as much `worth` places back.
        """
        away = self._away(state, slice(last + 1))
        # The forms of all places would take longer than a tick.
        near = np.flatnonzero(np.abs(away[:, : len(state) // 2 - 1]).max(axis=1) < _NEAR)
        if not near.size:
            return last, math.inf
        costs = np.einsum("ki,kij,kj->k", away[near], self.costs[near], away[near]) * (1 + (last - near) / worth)
        least = int(np.argmin(costs))
        return int(near[least]), float(costs[least])

    def _away(self, state: Array, places: slice) -> Array:
        n = len(state) // 2 - 1
        away = state - self.states[places]
        away[:, :n] -= whole_turns(away[:, :n])
        return away


@dataclass(frozen=True, eq=False)
class RecoveryPlan:
    """What recoveries of an itinerary share: the law that calms, ways from rest to its stops, in their order.

    names: of the stops; symbols: their texts, fewer by one. limits: the cart's. path (M, n) rad: of the last stop's
    orbit, on any turns; period s: its own. gains: of the whole itinerary; reach: of its reference. restarts: whether
    the itinerary begins anew after a fall. attempts: of one symbol, 0 for no limit.

    Further starts may be appended during a run. ready: called when the arms hang at rest; False while there is no start
    yet, so that they go on resting.
    """

    calming: CalmingController
    starts: list[StartController]
    names: tuple[str, ...]
    symbols: tuple[str, ...]
    limits: Limits
    path: Array
    period: float
    gains: GainSchedule
    reach: Reach
    restarts: bool = False
    attempts: int = 10
    ready: Callable[[], bool] = lambda: True


@dataclass(frozen=True)
class Choice:
    """What is told of a choice: level, name, text."""

    level: str
    name: str
    text: str


class FallRecovery:
    """The choice of motions in one run.

    until: the tick at which the run ends at the latest, the itinerary beginning anew where its reference ends; 0: the
    run ends with its reference.
    """

    def __init__(self, plan: RecoveryPlan, main: Controller, *, until: int = 0) -> None:
        self._plan, self._main, self.until = plan, main, until
        self.motion = Motion.ITINERARY
        self.falls = 0
        self._near = False
        self._attempts: dict[int, int] = {}
        self._stop, self._lap, self._begins = 0, 1, False
        self._at, self._joins = 0.0, 0
        self._followed, self._rested, self._lost_at = 0, 0, 0
        self._calms, self._fresh, self._began, self._bounds = False, False, 0, dict[str, float]()
        self._why, self._sensor = Outcome.GO_ON, 0
        self._flown: list[Flight] = []
        self._quiet, self._quiet_ticks = 0, round(REST_SECONDS / plan.calming.period)
        self._meets: int | None = None
        self._seen = 0, 0.0
        self._arms = len(main.first_state) // 2 - 1
        self._latest: deque[Array] = deque(maxlen=max(round(plan.period / plan.calming.period / _EVERY), 1))

    def flights(self, end: int) -> tuple[Flight, ...]:
        """Return when the run was on its itinerary, up to the tick `end`."""
        under_way = [Flight(self._joins, end, self._at)] if self.motion is Motion.ITINERARY else []
        return (*self._flown, *under_way)

    def begin(self, ticker: Ticker) -> Choice:
        """Remember by what flights are judged; return what is told of the first motion."""
        self._bounds = {name: ticker.number(name) for name in calming_bounds(self._plan.limits)}
        ticker.prepare_to_hold()
        if self.until:
            self._meets = meeting_tick(ticker.references, round(LAST_SECONDS / ticker.program.period))
        return self._resumed()

    def _progress(self) -> str:
        symbols, place = self._plan.symbols, self._stop
        last = place == len(symbols)
        what = "the last stop" if last else f"symbol {place + 1} of {len(symbols)} ({symbols[place]!r})"
        return f"{what}, attempt {self._attempts.get(self._stop, 0) + 1}"

    def _resumed(self) -> Choice:
        name, what = (LAP, f"lap {self._lap}") if self._begins else (RESUME, self._progress())
        self._begins = False
        return Choice("info", name, joined_text(self._at, what))

    def runs_off(self, k: int, report: Array, ticker: Ticker) -> str:
        """Return a fall's sentence if the cart runs after its arms near its greatest speed at tick k, or ""."""
        fastest, place = self._plan.limits.velocity, 2 * self._arms + 1
        speed = abs(report.item(place, 0))
        if speed < _FAST * fastest or self.motion is Motion.RETURN:
            return ""
        wanted = abs(float(ticker.references[k - ticker.began, place]))
        if speed < wanted + (1 - _FAST) * fastest:
            return ""
        when = f"tracking lost at t = {k * ticker.program.period:.3f} s"
        return f"{when}: the cart moves at {speed:.3g} m/s, where the reference has {wanted:.3g} m/s"

    def fell(self, k: int, outcome: Outcome, why: str, ticker: Ticker, period: float) -> Sequence[Choice] | None:
        """Return what is told of a fall at tick k, from which a return begins; None where no attempt is left."""
        plan = self._plan
        if self.motion is not Motion.RETURN:
            self.falls += 1
            if self.motion is Motion.ITINERARY:
                self._flown.append(Flight(self._joins, k + 1, self._at))
                good = self._at + (self._followed - self._joins) * period - _BEFORE
                # Stops that no start leads to are passed over.
                reached = [start.stop for start in plan.starts if start.at <= good]
                self._stop = 0 if plan.restarts else max([self._stop, *reached])
            tried = self._attempts[self._stop] = self._attempts.get(self._stop, 0) + 1
            if plan.attempts and tried >= plan.attempts:
                self.motion = Motion.RETURN
                return None
        told = self.motion is not Motion.RETURN or k * period - self._began * period > 1.0
        self.motion, self._why, self._began = Motion.RETURN, outcome, k
        self._sensor = int(ticker.program.report[ticker.at["sensor"], 0])
        self._rested, self._lost_at = k, k
        # What it has learned of the arms' parameters may be nonsense by now.
        ticker.lose()
        if outcome in (Outcome.ESTIMATE_LOST, Outcome.SILENT, Outcome.STUCK):
            # The cart stands until the estimate may be believed again.
            self._calm(k, ticker, stands=True)
        else:
            self._calm(k, ticker)
        return [Choice("warn", RETURN, f"{why}; {self._progress_lost()}")] if told else []

    def _progress_lost(self) -> str:
        total, number = len(self._plan.symbols), self._stop + 1
        if self._plan.restarts:
            return "the itinerary begins anew from rest"
        return f"symbol {number} of {total} is done again" if number <= total else "the last stop is gone to again"

    def _calm(self, k: int, ticker: Ticker, *, stands: bool = False) -> None:
        """Calm the arms from the tick after k on; stands: or brake, and stand for the time being."""
        self._calms, self._rested, self._quiet, self._fresh = not stands, k, k, False
        ticker.follow(
            k + 1, self._plan.calming, lift=np.zeros(self._arms),
            bounds=calming_bounds(self._plan.limits), heeds_switch=False,
        )  # fmt: skip
        if stands:
            ticker.brake(k + 1)

    def follow_up(self, k: int, report: Array, ticker: Ticker, period: float) -> Sequence[Choice]:
        """Look at tick k, which has just been done; return what is told, where something else begins with the next."""
        if self.motion is Motion.ITINERARY:
            if report.item(ticker.at["error"], 0) < FOLLOWED:
                self._followed = k
            if not k % _EVERY:
                self._latest.append(report[: self._arms, 0].copy())
            if self._meets is not None and round(self._at / period) + k + 1 - self._joins == self._meets:
                return self._lapped(k, ticker.references[k + 1 - ticker.began], ticker)
            return () if k % _EVERY else self._caught(k, report, ticker, period)
        if self.motion is Motion.START:
            if k + 1 < self._joins:
                return ()
            self.motion, self._followed = Motion.ITINERARY, k
            return [self._resumed()]
        over = k + 2 == ticker.began + ticker.count
        if not self._calms:
            self._keep_standing(k, report, ticker, period)
            if (believed := self._believed(k, report, ticker, period)) or over:
                self._calm(k, ticker, stands=not believed)
            return ()
        for_s = self._at_rest(k, report, ticker) * period
        if for_s < REST_SECONDS + FRESH_SECONDS:
            if for_s >= REST_SECONDS and not self._fresh:
                ticker.lose()
                self._fresh = True
            if over:
                ticker.lose()
                self._calm(k, ticker)
            return ()
        if not self._plan.ready():
            if over:
                self._calm(k, ticker)
            return ()
        rested = Choice("info", REST, f"after {(k - self._began) * period:.2f} s")
        return [rested, *self._start(k, report, ticker)]

    def _caught(self, k: int, report: Array, ticker: Ticker, period: float) -> Sequence[Choice]:
        """Go on from an earlier place where the way back is long and that to it much shorter; return what is told."""
        plan, reach, n = self._plan, self._plan.reach, self._arms
        state = report[: 2 * n + 2, 0]
        here = min(round((self._at / period + k - self._joins) / reach.every), len(reach.states) - 1)
        own = reach.cost(state, here)
        self._near = self._near or not own > _FAR
        # Only after it has been near again: a run that never gets there would be sent back for ever.
        if not own > _FAR or not self._near:
            return ()
        place, least = reach.nearest(state, here, worth=_WORTH / (reach.every * period))
        if not least < _NEARER * own:
            return ()
        back, tick = (here - place) * reach.every * period, place * reach.every + 1
        stop = max((start.stop for start in plan.starts if start.at <= tick * period), default=0)
        if back > plan.period:
            # A symbol, or a part of it, is flown again.
            if plan.attempts and self._attempts.get(stop, 0) + 2 > plan.attempts:
                return ()
            self._attempts[stop] = self._attempts.get(stop, 0) + 1
        self._flown.append(Flight(self._joins, k + 1, self._at))
        self._stop, self._at, self._joins, self._followed = stop, tick * period, k + 1, k
        self._near = False
        turns = whole_turns(state[:n] - reach.states[place, :n])
        rest = replace(plan.gains, rows=plan.gains.rows[tick:], references=plan.gains.references[tick:])
        ticker.follow(k + 1, StartController(stop, self._at, 0, turns, rest), lift=turns, bounds=self._bounds)
        what = f"{self._progress()}; caught, {back:.2f} s back, at a cost-to-go of {least:.3g} instead of {own:.3g}"
        return [Choice("warn", CATCH, joined_text(self._at, what))]

    def _keep_standing(self, k: int, report: Array, ticker: Ticker, period: float) -> None:
        """Brake a cart that was stopped and drifts all the same, for drives do not just what they are told.

        Its scale tells how fast; one that is stuck tells that it stands.
        """
        seen, where = self._seen
        since = (k - seen) * period
        if since < _LOOKS:
            return
        self._seen = k, ticker.cart_reading
        drift = (ticker.cart_reading - where) / since
        if since < 2 * _LOOKS and report.item(ticker.at["done"], 0) and abs(drift) > _DRIFTS:
            ticker.brake_from(drift)

    def _believed(self, k: int, report: Array, ticker: Ticker, period: float) -> bool:
        """Tell whether the cart stands, and the filter agrees with the readings again."""
        # Arms that hang still stand as one that is stuck: in the end it is tried.
        since = k - self._began
        stuck = self._why is Outcome.STUCK and since * period < _STUCK and ticker.repeats(self._sensor) >= since
        lost = not report.item(ticker.at["mean_nis"], 0) <= ticker.number("lost_estimate")
        if stuck or lost or report.item(ticker.at["silent"], 0):
            self._lost_at = k
            ticker.lose()
        return bool(report.item(ticker.at["done"], 0)) and (k - self._lost_at) * period >= _TRIED

    def _at_rest(self, k: int, report: Array, ticker: Ticker) -> int:
        """Return for how many ticks the arms hang at rest, the cart in the middle, up to tick k."""
        n = self._arms
        state = report[: 2 * n + 2, 0].tolist()
        if any(abs(rate) > _QUIET for rate in state[n : 2 * n]):
            self._quiet = k
        elif k - self._quiet == self._quiet_ticks and not self._fresh:
            # The arms hang, whatever zeros the filter has made up while they swung: it would take long to unlearn them.
            ticker.lose()
        moves = (
            any(abs(math.remainder(angle, 2 * math.pi)) > REST_ANGLE for angle in state[:n])
            or any(abs(rate) > REST_RATE for rate in state[n : 2 * n])
            or any(abs(cart) > REST_CART for cart in state[2 * n :])
        )
        # A filter that begins anew takes its time to see that rates are small.
        if moves and not self._fresh:
            self._rested = k
        return k - self._rested

    def _start(self, k: int, report: Array, ticker: Ticker) -> list[Choice]:
        plan = self._plan
        start = max((one for one in plan.starts if one.stop <= self._stop), key=lambda one: one.stop)
        self._stop = start.stop
        n = len(start.turns)
        ticker.follow(k + 1, start, lift=whole_turns(report[:n, 0]), bounds=self._bounds)
        self._at, self._joins = start.at, k + 1 + start.lead_in
        self.motion = Motion.START
        text = f"from rest to stop {start.stop + 1} ({plan.names[start.stop]}): {self._progress()}"
        told = [Choice("info", START, text)]
        if start.lead_in == 0:
            self.motion, self._followed = Motion.ITINERARY, k
            told.append(self._resumed())
        return told

    def _held(self, k: int, ticker: Ticker) -> Sequence[Choice]:
        """Return what is told where the last stop was not held to the end of the reference, and a return begins."""
        seen, end = np.array(self._latest), ticker.references[-1, : self._arms]
        path = self._plan.path + whole_turns(end - self._plan.path.mean(axis=0))
        away = float(np.abs(seen[:, None] - path).max(axis=2).min(axis=1).max())
        if away <= _HELD:
            return ()
        why = f"the last stop was not held: over its last period the arms were up to {away:.2g} rad from its orbit"
        return self.fell(k, Outcome.TRACKING_LOST, why, ticker, ticker.program.period) or ()

    def ended(self, k: int, ticker: Ticker) -> Sequence[Choice]:
        """Return what is told where the reference ends with tick k and the run goes on; none: it ends."""
        if self.motion is not Motion.ITINERARY:
            return ()
        if not self.until:
            return self._held(k, ticker)
        return self._lapped(k, ticker.references[-1], ticker)

    def _lapped(self, k: int, state: Array, ticker: Ticker) -> Sequence[Choice]:
        """Begin another lap after tick k, where the reference is at `state` (N,)."""
        self._lap, self._begins = self._lap + 1, True
        # What the run is judged by is its last lap.
        self._flown.clear()
        self._attempts.clear()
        self._stop, self._at, self._joins = 0, 0.0, k + 1
        first, n = self._main.first_state, self._arms
        apart = state - first
        turns = whole_turns(apart[:n])
        apart[:n] -= turns
        if np.abs(apart).max() <= _MEETS:
            ticker.follow(k + 1, self._main, lift=turns, bounds=self._bounds)
            self._followed = k
            return [self._resumed()]
        self.motion, self._began = Motion.RETURN, k
        self._calm(k, ticker)
        return [Choice("info", RETURN, f"lap {self._lap - 1} is done; the next one begins from rest")]


def meeting_tick(references: Array, ticks: int) -> int | None:
    """Return at which of the last `ticks` of references (K, N) they are as at the first, whole turns apart; or None.

    Of several as good the last.
    """
    n = references.shape[1] // 2 - 1
    first = max(len(references) - ticks, len(references) // 2)
    apart = references[first:] - references[0]
    apart[:, :n] -= whole_turns(apart[:, :n])
    distances = np.abs(apart).max(axis=1)
    good = np.flatnonzero(distances <= max(1.2 * distances.min(), _MEETS / 10))
    return first + int(good[-1]) if distances.min() <= _MEETS else None
