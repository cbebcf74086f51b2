"""Recovery from a fall: calm the arms, start again, resume.

A run is a sequence of motions on one rig. One `Ticker` controls them all without interruption, so its filter and its
pending commands continue from one motion to the next:

    itinerary   the plan's reference from some time onward
    return      brake and calm the arms until they hang at rest
    start       from rest to a stop, by a planned transfer

A run may be caught before it falls. If the state is far from the reference and an earlier point is much nearer, the
itinerary resumes there. Such a point can be another phase or round of an orbit, or lie on the tube that leads to it.
The Riccati solution measures the distance:

    V(t) = (x̂ - x*(t))ᵀ P(t) (x̂ - x*(t)).

A run is caught if V exceeds `_FAR` at the present time and the least V at any earlier time is below `_NEARER` of that.
Flying a section again costs time, so V is multiplied by (1 + back/`_WORTH`) for a point `back` seconds earlier.

After a fall, the run repeats the failed symbol from the preceding stop. Completed symbols remain completed.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from typing import Any

import numpy as np

from dpcontrol.control.calming import CalmingController
from dpcontrol.control.interface import Controller, GainSchedule, whole_turns
from dpcontrol.control.tick import BRAKING, Report
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import Cause
from dpcontrol.foundation.shown import Brief
from dpcontrol.logs import CATCH, LAP, REST, RESUME, RETURN, START, Event, Flight
from dpcontrol.loop.ticker import Ticker
from dpcontrol.references.problem import Limits

RETURN_SECONDS = 15.0
"""Time limit of a return before it restarts, s; returns from states after a fall take at most 6 s."""
FOLLOWED = 0.15
"""Mean distance below which a run follows its reference, rad. A run also has to have followed `_BEFORE` s earlier."""
_BEFORE = 0.5
REST_ANGLE, REST_RATE, REST_CART = 0.05, 0.1, 0.01
"""Bounds on the estimate for arms that hang at rest with the cart in the middle: rad, rad/s, and m or m/s."""
_QUIET = 0.3
"""Rate below which arms hang at rest if they keep it for `REST_SECONDS`, rad/s; swinging arms exceed it."""
REST_SECONDS, FRESH_SECONDS = 0.3, 0.2
"""Duration of rest, and the time for the restarted filter to estimate the rates, s."""
_TRIED = 0.3
"""Observation time of a restarted filter before its estimate is used, s."""
_STUCK = 20.0
"""Time after which a sensor with constant readings is attributed to an arm at rest, s."""
_HELD = 0.08
"""Maximum distance from the last stop's orbit over its last period for a successful hold, rad, by the estimate."""
_EVERY = 10
"""Ticks between checks of the hold."""
_FAR, _NEARER = 10.0, 0.5
"""Cost-to-go at which the search for another place starts, and the fraction of it that the place must not exceed."""
_NEAR, _WORTH = 0.8, 1.0
"""Maximum angle of an arm from a candidate place, rad, and the interval back that doubles its cost, s."""
_LOOKS, _DRIFTS = 0.1, 0.005
"""Interval between checks that a stopped cart stays still, s, and the velocity that counts as drift, m/s."""
_FAST = 0.9
"""Fraction of the maximum speed at which a runaway cart is stopped; swinging arms push it further."""
_MEETS = 0.05
"""Maximum difference between the last and first state of a reference for laps without rest: rad, rad/s, m, m/s."""
LAST_SECONDS = 1.5
"""Final part of a reference that is searched for such a state, s. The last orbit may end at another phase than the
first."""


class Motion(StrEnum):
    """The present motion of a run."""

    ITINERARY = "itinerary"
    RETURN = "return"
    START = "start"


def calming_bounds(limits: Limits) -> Mapping[str, float]:
    """Return the bounds that differ during a return.

    They replace those of a flight (`tick.Numbers`).

    Any distance from rest is allowed, and the filter may restart without limit. The law keeps the cart on its track.
    The supervisor intervenes only if nothing but maximum braking remains.

    Args:
        limits: the cart's limits.
    """
    return {
        "lost_tracking": 1e9, "resynchronise": 0.0, "can_hold": 0.0, "restarts": 1e9,
        "brake": 2 * BRAKING * limits.acceleration, "margin": 0.0, "trust": 1e9,
    }  # fmt: skip


@dataclass(frozen=True, eq=False)
class StartController(Brief):
    """A transfer onto the itinerary and its continuation.

    It starts from rest or from a nearby state.
    """

    stop: int
    """Index of the stop of the walk."""
    at: float
    """Time of the plan's reference at which the start joins, s."""
    lead_in: int
    """Ticks before it joins."""
    turns: Array
    """Whole turns (n,) between the plan's reference and this one, rad."""
    gains: GainSchedule
    kind: str = "start"

    @property
    def first_state(self) -> Array:
        """The initial state (N,)."""
        return self.gains.references[0]

    @property
    def ticks(self) -> int:
        """The number of periods."""
        return len(self.gains.references) - 1

    def schedule(self, lead: int) -> GainSchedule:
        """Return the gain schedule.

        Args:
            lead: number of periods of prediction, for which the gains were computed.
        """
        return self.gains


def started(before: GainSchedule, main: GainSchedule, *, lead_in: int, place: int, turns: Array) -> GainSchedule:
    """Return one gain schedule followed by another.

    Args:
        before: gains of the first ticks.
        main: gains of the rest.
        lead_in: number of ticks of `before`.
        place: tick of `main` that follows.
        turns: angles (n,) subtracted from those of `main`, rad.
    """
    rest = main.turned(-turns)
    return replace(
        main,
        rows=np.concatenate([before.rows[:lead_in], rest.rows[place:]]),
        references=np.concatenate([before.references[:lead_in], rest.references[place:]]),
        queued=before.queued if lead_in else main.queued,
    )


@dataclass(frozen=True, eq=False)
class Reach(Brief):
    """Places of a reference, `every` ticks apart.

    States (M, N) and cost-to-go matrices P (M, N, N).
    """

    every: int
    states: Array
    costs: Array

    def cost(self, state: Array, place: int) -> float:
        """Return the cost-to-go to a place, modulo whole turns.

        Args:
            state: state (N,).
            place: index of the place.
        """
        away = self._away(state, slice(place, place + 1))[0]
        return float(away @ self.costs[place] @ away)

    def nearest(self, state: Array, last: int, *, worth: float) -> tuple[int, float]:
        """Return the place with the least cost, and that cost.

        The cost is infinite if no place is near. It doubles `worth` places earlier.

        Args:
            state: state (N,).
            last: index of the last place that is considered.
            worth: number of places after which the cost doubles.
        """
        away = self._away(state, slice(last + 1))
        # Quadratic forms for all places would take longer than a tick.
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
class RecoveryPlan(Brief):
    """Data shared by all recoveries of an itinerary.

    Starts may be appended during a run.
    """

    calming: CalmingController
    starts: list[StartController]
    """Ways from rest to the stops, in order."""
    names: tuple[str, ...]
    """Names of the stops."""
    symbols: tuple[str, ...]
    """Texts of the symbols, one fewer than the names."""
    limits: Limits
    path: Array
    """Path (M, n) of the last stop's orbit modulo whole turns, rad."""
    period: float
    """Period of that orbit, s."""
    gains: GainSchedule
    """Gains of the whole itinerary."""
    reach: Reach
    restarts: bool = False
    """True if the itinerary restarts after a fall."""
    attempts: int = 10
    """Maximum attempts per symbol; 0 for no limit."""
    ready: Callable[[], bool] = lambda: True
    """Called when the arms hang at rest; False if no start is available yet."""


_event = partial(Event, 0.0)
"""An event whose time the loop sets: level, name, cause and figures."""


class FallRecovery:
    """The choice of motions in one run.

    Args:
        plan: data of the recovery.
        main: controller of the whole itinerary.
        until: last tick of the run, up to which the itinerary repeats; 0 to end with the reference.
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
        self._why, self._sensor = Cause.FINISHED, 0
        self._flown: list[Flight] = []
        self._quiet, self._quiet_ticks = 0, round(REST_SECONDS / plan.calming.period)
        self._meets: int | None = None
        self._seen = 0, 0.0
        self._arms = len(main.first_state) // 2 - 1
        self._latest: deque[Array] = deque(maxlen=max(round(plan.period / plan.calming.period / _EVERY), 1))

    def flights(self, end: int) -> tuple[Flight, ...]:
        """Return the intervals on the itinerary up to the tick `end`.

        Args:
            end: tick that ends a flight under way.
        """
        under_way = [Flight(self._joins, end, self._at)] if self.motion is Motion.ITINERARY else []
        return (*self._flown, *under_way)

    def begin(self, ticker: Ticker) -> Event:
        """Store the flights' bounds and return the first motion's event.

        Args:
            ticker: ticker of the run.
        """
        self._bounds = {
            name: getattr(ticker.program.numbers, name).item(0) for name in calming_bounds(self._plan.limits)
        }
        ticker.prepare_to_hold()
        if self.until:
            self._meets = meeting_tick(ticker.references, round(LAST_SECONDS / ticker.program.period))
        return self._resumed()

    def _progress(self) -> Mapping[str, Any]:
        """Return the next symbol, 0 at the last stop, and the number of this attempt."""
        symbols, place = self._plan.symbols, self._stop
        attempt = {"at": self._at, "symbols": len(symbols), "attempt": self._attempts.get(self._stop, 0) + 1}
        return attempt if place == len(symbols) else {**attempt, "symbol": place + 1, "name": symbols[place]}

    def _resumed(self) -> Event:
        begins, self._begins = self._begins, False
        if begins:
            return _event("info", LAP, Cause.JOINED, {"at": self._at, "lap": self._lap})
        return _event("info", RESUME, Cause.JOINED, self._progress())

    def runs_off(self, k: int, report: Report, ticker: Ticker) -> Mapping[str, float]:
        """Return the figures of a fall if the cart runs away, otherwise none.

        A cart runs away near its maximum speed, if the reference is slower.

        Args:
            k: tick.
            report: report of the tick.
            ticker: ticker of the run.
        """
        fastest, place = self._plan.limits.velocity, 2 * self._arms + 1
        speed = abs(report.state.item(place, 0))
        if speed < _FAST * fastest or self.motion is Motion.RETURN:
            return {}
        planned = abs(float(ticker.references[k - ticker.began, place]))
        if speed < planned + (1 - _FAST) * fastest:
            return {}
        return {"time": k * ticker.program.period, "fast": speed, "planned": planned}

    def fell(
        self, k: int, cause: Cause, figures: Mapping[str, Any], ticker: Ticker, period: float
    ) -> Sequence[Event] | None:
        """Begin a return after a fall at tick k.

        Args:
            k: tick.
            cause: cause of the fall.
            figures: its numbers.
            ticker: ticker of the run.
            period: time between ticks, s.

        Returns:
            Events to log, or None if no attempt is left.
        """
        plan = self._plan
        if self.motion is not Motion.RETURN:
            self.falls += 1
            if self.motion is Motion.ITINERARY:
                self._flown.append(Flight(self._joins, k + 1, self._at))
                good = self._at + (self._followed - self._joins) * period - _BEFORE
                # Stops that no start leads to are skipped.
                reached = [start.stop for start in plan.starts if start.at <= good]
                self._stop = 0 if plan.restarts else max([self._stop, *reached])
            tried = self._attempts[self._stop] = self._attempts.get(self._stop, 0) + 1
            if plan.attempts and tried >= plan.attempts:
                self.motion = Motion.RETURN
                return None
        logged = self.motion is not Motion.RETURN or k * period - self._began * period > 1.0
        self.motion, self._why, self._began = Motion.RETURN, cause, k
        self._sensor = int(ticker.report.sensor.item(0))
        self._rested, self._lost_at = k, k
        # After a fall, the parameter estimates may be wrong.
        ticker.lose()
        if cause in (Cause.ESTIMATE_LOST, Cause.SILENT, Cause.STUCK):
            # The cart stays still until the estimate is reliable again.
            self._calm(k, ticker, still=True)
        else:
            self._calm(k, ticker)
        next_symbol = {"again": 0 if plan.restarts else self._stop + 1, "symbols": len(plan.symbols)}
        return [_event("warn", RETURN, cause, {**figures, **next_symbol})] if logged else []

    def _calm(self, k: int, ticker: Ticker, *, still: bool = False) -> None:
        """Calm the arms from the tick after k onward.

        With `still`, brake and hold the cart first.
        """
        self._calms, self._rested, self._quiet, self._fresh = not still, k, k, False
        ticker.follow(
            k + 1, self._plan.calming, lift=np.zeros(self._arms),
            bounds=calming_bounds(self._plan.limits), uses_switch=False,
        )  # fmt: skip
        if still:
            ticker.brake(k + 1)

    def follow_up(self, k: int, report: Report, ticker: Ticker, period: float) -> Sequence[Event]:
        """Handle the completed tick k and return events.

        Events occur only if the motion changes.

        Args:
            k: tick.
            report: report of the tick.
            ticker: ticker of the run.
            period: time between ticks, s.
        """
        if self.motion is Motion.ITINERARY:
            if report.error.item(0) < FOLLOWED:
                self._followed = k
            if not k % _EVERY:
                self._latest.append(report.state[: self._arms, 0].copy())
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
            self._hold_still(k, report, ticker, period)
            if (reliable := self._is_reliable(k, report, ticker, period)) or over:
                self._calm(k, ticker, still=not reliable)
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
        rested = _event("info", REST, Cause.RESTED, {"seconds": (k - self._began) * period})
        return [rested, *self._start(k, report, ticker)]

    def _caught(self, k: int, report: Report, ticker: Ticker, period: float) -> Sequence[Event]:
        """Resume from an earlier place if the state is near it.

        The state must be far from the present place of the reference.
        """
        plan, reach, n = self._plan, self._plan.reach, self._arms
        state = report.state[:, 0]
        here = min(round((self._at / period + k - self._joins) / reach.every), len(reach.states) - 1)
        own = reach.cost(state, here)
        self._near = self._near or not own > _FAR
        # Only after the run has been near again; otherwise it could be sent back repeatedly.
        if not own > _FAR or not self._near:
            return ()
        place, least = reach.nearest(state, here, worth=_WORTH / (reach.every * period))
        if not least < _NEARER * own:
            return ()
        back, tick = (here - place) * reach.every * period, place * reach.every + 1
        stop = max((start.stop for start in plan.starts if start.at <= tick * period), default=0)
        if back > plan.period:
            # A symbol, or a part of it, is repeated.
            if plan.attempts and self._attempts.get(stop, 0) + 2 > plan.attempts:
                return ()
            self._attempts[stop] = self._attempts.get(stop, 0) + 1
        self._flown.append(Flight(self._joins, k + 1, self._at))
        self._stop, self._at, self._joins, self._followed = stop, tick * period, k + 1, k
        self._near = False
        turns = whole_turns(state[:n] - reach.states[place, :n])
        rest = replace(plan.gains, rows=plan.gains.rows[tick:], references=plan.gains.references[tick:])
        ticker.follow(k + 1, StartController(stop, self._at, 0, turns, rest), lift=turns, bounds=self._bounds)
        figures = {**self._progress(), "back": back, "least": least, "here": own}
        return [_event("warn", CATCH, Cause.JOINED, figures)]

    def _hold_still(self, k: int, report: Report, ticker: Ticker, period: float) -> None:
        """Brake a stopped cart that drifts.

        A drive does not follow commands exactly. The cart's scale gives the drift; a stuck scale reports no motion.
        """
        seen, where = self._seen
        since = (k - seen) * period
        if since < _LOOKS:
            return
        cart = ticker.program.reading.measured[-1, 0].item()
        self._seen, drift = (k, cart), (cart - where) / since
        if since < 2 * _LOOKS and report.done.item(0) and abs(drift) > _DRIFTS:
            # Braking continues from the measured velocity instead of the commanded one.
            ticker.program.memory.velocity[:] = drift

    def _is_reliable(self, k: int, report: Report, ticker: Ticker, period: float) -> bool:
        """True if the cart is still and the filter is right.

        The filter must agree with the readings again.
        """
        # Arms at rest give constant readings, like a stuck sensor. After a time limit, the sensor is used again.
        since = k - self._began
        stuck = (
            self._why is Cause.STUCK
            and since * period < _STUCK
            and ticker.program.memory.same[self._sensor - 1, 0] >= since
        )
        lost = not report.mean_nis.item(0) <= ticker.program.numbers.lost_estimate.item(0)
        if stuck or lost or report.silent.item(0):
            self._lost_at = k
            ticker.lose()
        return bool(report.done.item(0)) and (k - self._lost_at) * period >= _TRIED

    def _at_rest(self, k: int, report: Report, ticker: Ticker) -> int:
        """Return the number of ticks at rest up to k.

        At rest, the arms hang still and the cart is centred.
        """
        n = self._arms
        state = report.state[:, 0].tolist()
        if any(abs(rate) > _QUIET for rate in state[n : 2 * n]):
            self._quiet = k
        elif k - self._quiet == self._quiet_ticks and not self._fresh:
            # The arms hang at rest. The filter may have estimated wrong zero errors during the swing and would
            # correct them slowly.
            ticker.lose()
        moves = (
            any(abs(math.remainder(angle, 2 * math.pi)) > REST_ANGLE for angle in state[:n])
            or any(abs(rate) > REST_RATE for rate in state[n : 2 * n])
            or any(abs(cart) > REST_CART for cart in state[2 * n :])
        )
        # A restarted filter needs time to find that the rates are small.
        if moves and not self._fresh:
            self._rested = k
        return k - self._rested

    def _start(self, k: int, report: Report, ticker: Ticker) -> list[Event]:
        plan = self._plan
        start = max((one for one in plan.starts if one.stop <= self._stop), key=lambda one: one.stop)
        self._stop = start.stop
        n = len(start.turns)
        ticker.follow(k + 1, start, lift=whole_turns(report.state[:n, 0]), bounds=self._bounds)
        self._at, self._joins = start.at, k + 1 + start.lead_in
        self.motion = Motion.START
        goal = {"stop": start.stop + 1, "stop_name": plan.names[start.stop]}
        logged = [_event("info", START, Cause.STARTED, {**self._progress(), **goal})]
        if start.lead_in == 0:
            self.motion, self._followed = Motion.ITINERARY, k
            logged.append(self._resumed())
        return logged

    def _held(self, k: int, ticker: Ticker) -> Sequence[Event]:
        """Begin a return if the last stop was not held.

        It must be held until the reference ends.
        """
        seen, end = np.array(self._latest), ticker.references[-1, : self._arms]
        path = self._plan.path + whole_turns(end - self._plan.path.mean(axis=0))
        away = float(np.abs(seen[:, None] - path).max(axis=2).min(axis=1).max())
        if away <= _HELD:
            return ()
        return self.fell(k, Cause.NOT_HELD, {"away": away}, ticker, ticker.program.period) or ()

    def ended(self, k: int, ticker: Ticker) -> Sequence[Event]:
        """Continue after the reference ends with tick k.

        Args:
            k: tick.
            ticker: ticker of the run.

        Returns:
            Events to log, or none if the run ends.
        """
        if self.motion is not Motion.ITINERARY:
            return ()
        if not self.until:
            return self._held(k, ticker)
        return self._lapped(k, ticker.references[-1], ticker)

    def _lapped(self, k: int, state: Array, ticker: Ticker) -> Sequence[Event]:
        """Begin another lap after tick k, with the reference at `state` (N,)."""
        self._lap, self._begins = self._lap + 1, True
        # A run is judged by its last lap.
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
        return [_event("info", RETURN, Cause.LAP_DONE, {"lap": self._lap - 1})]


def meeting_tick(references: Array, ticks: int) -> int | None:
    """Return the last tick that matches the first, or None.

    Only the last `ticks` are searched, and whole turns are ignored. Several matches of similar quality give the last of
    them.

    Args:
        references: reference states (K, N), rad, rad/s, m and m/s.
        ticks: number of last ticks that are searched.
    """
    n = references.shape[1] // 2 - 1
    first = max(len(references) - ticks, len(references) // 2)
    apart = references[first:] - references[0]
    apart[:, :n] -= whole_turns(apart[:, :n])
    distances = np.abs(apart).max(axis=1)
    good = np.flatnonzero(distances <= max(1.2 * distances.min(), _MEETS / 10))
    return first + int(good[-1]) if distances.min() <= _MEETS else None
