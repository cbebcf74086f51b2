"""Recovery from a fall: brake the cart, fly back to a stop, resume.

A run is a sequence of motions on one rig. One `Ticker` controls them all without interruption, so its filter and its
pending commands continue from one motion to the next:

    itinerary   the plan's reference from some time onward
    brake       the cart brakes towards the middle of its track until the estimate is reliable and a flight is planned
    flight      from the present state to a place of a stop, or to rest (`dpcontrol.control.flight`)

A flight is planned for the state that the braking law leads to within `THINKING` s, so that a bench in real time can
plan it in a second process. After two flights that failed, the next one leads to rest.

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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.flight import JOINED, braking_gains
from dpcontrol.control.interface import Controller, GainSchedule, SampledModel, whole_turns
from dpcontrol.control.lqr import HoldController
from dpcontrol.control.tick import BRAKING
from dpcontrol.control.tick_parts import Report
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import Cause
from dpcontrol.foundation.shown import Brief
from dpcontrol.logs import CATCH, FLIGHT, LAP, RESUME, RETURN, Event, Stretch
from dpcontrol.loop.pilots import THINKING, Briefing, Course, Pilot, Request
from dpcontrol.loop.targets import SETTLES, Reach, padded
from dpcontrol.loop.ticker import Ticker
from dpcontrol.references.content import PlanSymbol, symbol_figures
from dpcontrol.references.problem import Limits

_SETTLING = 0.03
"""Time for a restarted filter to estimate the rates, s."""
_BRAKING_SECONDS = 15.0
"""Time limit of braking before it restarts, s."""
_TRIES = 2
"""Flights to a stop that may fail before one leads to rest."""
_SLOWER, _MOST_THINKING = 1.5, 0.6
"""Factor on the time for a search after a late answer, and its limit, s."""
_MOST_TRIES = 20
"""Flights after a fall that may fail before the run ends."""
RESTING = 0.3
"""Time at rest before the flight from there to a stop is planned, s."""
FOLLOWED = 0.15
"""Mean distance below which a run follows its reference, rad. A run also has to have followed `_BEFORE` s earlier."""
_BEFORE = 0.5
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
_WORTH = 1.0
"""Interval back that doubles the cost of a place, s."""
_LOOKS, _DRIFTS = 0.1, 0.005
"""Interval between checks that a stopped cart stays still, s, and the velocity that counts as drift, m/s."""
_FAST = 0.9
"""Fraction of the maximum speed at which a runaway cart is stopped; swinging arms push it further."""
_MEETS = 0.05
"""Maximum difference between the last and first state of a reference that repeats without rest: rad, rad/s, m, m/s."""
LAST_SECONDS = 1.5
"""Final part of a reference that is searched for such a state, s. The last orbit may end at another phase than the
first."""


class Motion(StrEnum):
    """The present motion of a run."""

    ITINERARY = "itinerary"
    BRAKE = "brake"
    FLIGHT = "flight"


def braking_bounds(limits: Limits) -> Mapping[str, float]:
    """Return the numbers of the supervisor that differ while the cart brakes, by their names in `tick_parts.Numbers`.

    Any distance from the reference is allowed, and the filter may restart without limit. The supervisor intervenes only
    if nothing but maximum braking remains.

    Args:
        limits: the cart's limits.
    """
    return {
        "lost_tracking": 1e9, "resynchronise": 0.0, "can_hold": 0.0, "restarts": 1e9,
        "brake": 2 * BRAKING * limits.acceleration, "margin": 0.0, "trust": 1e9,
    }  # fmt: skip


def braking_controller(arms: ArmChainParameters, model: SampledModel) -> HoldController:
    """Return the law that brakes the cart towards the middle of its track, whatever the arms do.

    A fallen run follows it until a flight is planned.

    Args:
        arms: the arms.
        model: model of arms and drive from tick to tick.
    """
    gain = np.zeros(model.dimension)
    gain[-2:] = braking_gains(arms)
    ticks = max(round(_BRAKING_SECONDS / model.period), 1)
    return HoldController("brake", np.zeros(model.dimension), gain, ticks, 0.0 if model.lag else None)


@dataclass(frozen=True, eq=False)
class ScheduledController(Brief):
    """A gain schedule as a controller, for motions whose gains exist already.

    Attributes:
        gains: gains and references by the loop's clock.
        kind: name of the law, for the log.
    """

    gains: GainSchedule
    kind: str

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


@dataclass(frozen=True, eq=False)
class RecoveryPlan(Brief):
    """Data shared by all recoveries of an itinerary, in any number of runs of one assembly.

    A stop is an orbit or equilibrium at which the itinerary stays; a symbol is the motion between two stops.
    """

    model: SampledModel
    """Model of arms and drive from tick to tick."""
    braking: ScheduledController
    """Law that brakes the cart while a flight is planned."""
    briefing: Briefing
    """Limits, and the goals of the stops, in order, and at last of rest."""
    pilot: Pilot
    """Search for flights."""
    names: tuple[str, ...]
    """Names of the stops."""
    symbols: tuple[PlanSymbol, ...]
    """The symbols and transfers, one fewer than the names."""
    path: Array
    """Path (M, n) of the last stop's orbit modulo whole turns, rad."""
    period: float
    """Period of that orbit, s."""
    gains: GainSchedule
    """Gains of the whole itinerary."""
    rest: GainSchedule
    """Gains that hold the arms at rest."""
    reach: Reach
    """Places of the reference, by which an earlier one is found that is near."""
    restarts: bool = False
    """True if the itinerary restarts after a fall."""
    attempts: int = 10
    """Maximum attempts per symbol; 0 for no limit."""
    anywhere: bool = False
    """True if the run begins with a flight."""

    def empty_record(self) -> deque[Array]:
        """Return an empty record of angles, with room for the last period of the last stop's orbit.

        `FallRecovery` fills it every `_EVERY` ticks, to check at the end that the last stop was held.
        """
        return deque(maxlen=max(round(self.period / self.model.period / _EVERY), 1))

    def distance(self, angles: Sequence[Array], end: Array) -> float:
        """Return the greatest distance of recorded angles from the last stop's orbit, rad, modulo whole turns.

        Args:
            angles: angles (n,) at times in the last period, rad.
            end: last angles (n,) of the reference, which select the whole turns, rad.
        """
        orbit_angles = self.path + whole_turns(end - self.path.mean(axis=0))
        return float(np.abs(np.array(angles)[:, None] - orbit_angles).max(axis=2).min(axis=1).max())

    def runaway_speed(self, planned: Any) -> Any:
        """Return the speed from which on a cart counts as a runaway, m/s.

        It is near the maximum speed, and above the reference's by a margin.

        Args:
            planned: velocity of the reference, m/s.
        """
        max_speed = self.briefing.limits.velocity
        return max(_FAST * max_speed, abs(planned) + (1 - _FAST) * max_speed)

    def earlier_place(self, state: Array, here: int, cost: float) -> tuple[int, float] | None:
        """Return an earlier place of the reference to catch the run at, and the cost-to-go to it, or None.

        The place must be much nearer than the present one: its cost-to-go must be below `_NEARER` times the present
        cost.

        Args:
            state: estimated state (N,).
            here: index of the present place in `reach`.
            cost: cost-to-go to the present place.
        """
        place, least = self.reach.nearest(state, here, worth=_WORTH / (self.reach.every * self.model.period))
        return (place, least) if least < _NEARER * cost else None


_NEVER = -1
"""Tick of the pilot's answer while no request is pending."""
_event = partial(Event, 0.0)
"""An event whose time the loop sets: level, name, cause and figures."""


class FallRecovery:
    """The choice of motions in one run: itinerary, brake or flight, and the places at which they join.

    Args:
        plan: data shared by all recoveries of the itinerary.
        main: controller of the whole itinerary.
        until: last tick of the run, up to which the itinerary repeats; 0 to end with the reference.
    """

    def __init__(self, plan: RecoveryPlan, main: Controller, *, until: int = 0) -> None:
        """Begin on the itinerary at its first stop, with no attempts and no falls.

        Ticks count from the start of the run. The itinerary is joined at the tick `_joins`, at the time `_at` on the
        plan's reference, s; `_arrives` is True if a flight led there, and `_flown` holds the completed stretches. Its
        reference was last followed at the tick `_followed`, and up to the time `_good` before the last fall.

        `_stop` is the index of the stop from which the itinerary was last begun or resumed, or will be after a fall. It
        changes only at a fall, a catch or a new lap. `_attempts` has the failed attempts of the symbol after each stop,
        and `_lap` is the number of the repetition. If `_begins` is True, its start is not logged yet. `_meets` is the
        tick of the reference at which the next lap can begin without a flight, or None. `_latest` holds the recent
        estimated angles of the arms on the itinerary, by which the last stop is judged as held or not.

        Braking began at the tick `_began`, because of `_why`; if a sensor was stuck, `_sensor` is its number, from 1.
        The estimate was last wrong at the tick `_lost_at`, and is usable if `_reliable`. From the tick `_asks` on, a
        flight to the stop `_goal` (-1 for rest) may be requested. Its search has `_thinking` s, and its answer is read
        at the tick `_answers`, which is `_NEVER` without a request.

        `_course` is the flight under way. `_tries` counts the flights since the fall that failed, were not found, or
        led to rest.

        `_near` is True once the state was near the reference since the last catch. `_seen` is the last tick and
        position, m, of a check that a stopped cart stays still. `_bounds` are the supervisor's usual bounds, stored by
        `begin`.
        """
        self._plan, self._main, self.until = plan, main, until
        self.motion = Motion.ITINERARY
        self.falls = 0
        self._near = False
        self._attempts: dict[int, int] = {}
        self._stop, self._lap, self._begins = 0, 1, False
        self._at, self._joins = 0.0, 0
        self._followed, self._lost_at, self._began = 0, 0, 0
        self._reliable, self._asks, self._answers, self._tries = False, 0, _NEVER, 0
        self._goal = 0
        self._bounds = dict[str, float]()
        self._course: Course
        self._good, self._arrives = math.inf, False
        self._thinking = THINKING
        self._why, self._sensor = Cause.FINISHED, 0
        self._flown: list[Stretch] = []
        self._meets: int | None = None
        self._seen = 0, 0.0
        self._arms = len(main.first_state) // 2 - 1
        self._latest = plan.empty_record()

    def stretches(self, end: int) -> tuple[Stretch, ...]:
        """Return the intervals on the itinerary up to the tick `end`, which are the parts of a run that are scored.

        Args:
            end: tick that ends a stretch under way.
        """
        under_way = [Stretch(self._joins, end, self._at)] if self.motion is Motion.ITINERARY else []
        return (*self._flown, *under_way)

    def begin(self, ticker: Ticker) -> Event:
        """Store the supervisor's usual bounds, start the first motion and return its event.

        A run from any state begins with braking, until its first flight is planned. If the itinerary repeats (`until`),
        the tick is sought at which its reference meets its start (`_meets`).

        Args:
            ticker: ticker of the run.
        """
        self._bounds = {
            name: getattr(ticker.program.numbers, name).item(0) for name in braking_bounds(self._plan.briefing.limits)
        }
        ticker.prepare_to_hold()
        if self.until:
            self._meets = meeting_tick(ticker.references, round(LAST_SECONDS / ticker.program.period))
        if not self._plan.anywhere:
            return self._resumption()
        ticker.lose()
        self._brake(-1, ticker)
        return _event("info", RETURN, Cause.ANYWHERE)

    def _progress(self) -> Mapping[str, Any]:
        """Return the figures of an event that joins the itinerary: time on the plan, attempt, and the next symbol."""
        return {"at": self._at, "attempt": self._attempts.get(self._stop, 0) + 1, **self._next()}

    def _next(self) -> Mapping[str, Any]:
        """Return the figures of the next symbol for an event, or none at the last stop."""
        symbols, place = self._plan.symbols, self._stop
        return symbol_figures(symbols, place) if place < len(symbols) else {}

    def _resumption(self) -> Event:
        """Return the event of a run that joins its itinerary: a new lap if `_begins`, otherwise a resumption.

        `_begins` is True from the end of a lap until the start of the next one is logged.
        """
        begins_lap, self._begins = self._begins, False
        if begins_lap:
            return _event("info", LAP, Cause.JOINED, {"at": self._at, "lap": self._lap})
        return _event("info", RESUME, Cause.JOINED, self._progress())

    def runaway(self, k: int, report: Report, ticker: Ticker) -> Mapping[str, float]:
        """Return the figures of a fall if the cart runs away from its itinerary, otherwise none.

        It must brake early, because swinging arms push it further.

        Args:
            k: tick.
            report: report of the tick.
            ticker: ticker of the run.
        """
        velocity_index = 2 * self._arms + 1
        if self.motion is not Motion.ITINERARY:
            return {}
        speed, reference_speed = (
            abs(report.state.item(velocity_index, 0)),
            ticker.references.item(k - ticker.began, velocity_index),
        )
        if speed < self._plan.runaway_speed(reference_speed):
            return {}
        return {"time": k * ticker.program.period, "fast": speed, "planned": abs(reference_speed)}

    def fell(
        self, k: int, cause: Cause, figures: Mapping[str, Any], ticker: Ticker, period: float
    ) -> Sequence[Event] | None:
        """Begin to brake after a fall at tick k, and choose the stop from which the run resumes.

        A fall from the itinerary counts as an attempt of its symbol; one from a flight counts as a failed flight.

        Args:
            k: tick.
            cause: cause of the fall.
            figures: numbers and names for the sentence on the fall.
            ticker: ticker of the run.
            period: time between ticks, s.

        Returns:
            Events to log, or None if no attempt is left.
        """
        plan, motion = self._plan, self.motion
        if motion is Motion.ITINERARY:
            self._flown.append(Stretch(self._joins, k + 1, self._at))
            # Time on the plan's reference up to which the run is judged, with `_BEFORE` s before the last tick at which
            # the reference was followed. A flight that joined at a later time would leave a gap.
            self._good = self._at + (self._followed - self._joins) * period - _BEFORE
            # `_arrives`: the itinerary was joined by a flight, at the tick `_joins`.
            if self._arrives and (k - self._joins) * period < 2 * SETTLES:
                # The law did not take over, so the flight has failed.
                motion = Motion.FLIGHT
        if motion is Motion.ITINERARY:
            self.falls += 1
            # Stops whose first place (`at[0]`, s) was followed; the last goal is rest, which is no stop.
            reached_stops = [stop for stop, goal in enumerate(plan.briefing.goals[:-1]) if goal.at[0] <= self._good]
            self._stop, self._tries = 0 if plan.restarts else max([self._stop, *reached_stops]), 0
            attempts = self._attempts[self._stop] = self._attempts.get(self._stop, 0) + 1
            if plan.attempts and attempts >= plan.attempts:
                self.motion = Motion.BRAKE
                return None
        elif motion is Motion.FLIGHT:
            self._tries += 1
        is_logged = motion is not Motion.BRAKE or (k - self._began) * period > 1.0
        self._why = cause
        self._sensor = int(ticker.report.sensor.item(0))
        estimate_lost = cause in (Cause.ESTIMATE_LOST, Cause.SILENT, Cause.STUCK)
        # The cause of a fall, such as a blow, spoils the estimated parameters. A first flight that fails does not.
        if estimate_lost or motion is Motion.ITINERARY or self._tries > 1:
            ticker.lose()
        # The cart stays still until the estimate is reliable again.
        self._brake(k, ticker, still=estimate_lost)
        if self._tries >= _MOST_TRIES:
            return None
        next_symbol = {"again": 0 if plan.restarts else self._stop + 1, **self._next()}
        name = RETURN if motion is Motion.ITINERARY else FLIGHT
        return [_event("warn", name, cause, {**figures, **next_symbol})] if is_logged else []

    def _brake(self, k: int, ticker: Ticker, *, still: bool = False) -> None:
        """Brake the cart from the tick after k on, until the estimate is reliable and a flight is planned.

        With `still`, the cart stops where it is, since the braking law cannot use a wrong estimate. A flight may be
        requested from the tick `_asks` on; no answer is awaited (`_NEVER`).
        """
        self.motion, self._began, self._lost_at = Motion.BRAKE, k, k
        self._reliable, self._answers = not still, _NEVER
        self._asks = k + round(_SETTLING / self._plan.model.period)
        ticker.follow(
            k + 1, self._plan.braking, lift=np.zeros(self._arms), bounds=braking_bounds(self._plan.briefing.limits),
            uses_switch=False,
        )  # fmt: skip
        if still:
            ticker.brake(k + 1)

    def follow_up(self, k: int, report: Report, ticker: Ticker, period: float) -> Sequence[Event]:
        """Handle the completed tick k of any motion, and return events to log if the motion changes.

        On the itinerary, the run is watched for a lap's end and caught at an earlier place. On a flight, it arrives or
        the flight is replaced. While the cart brakes, a flight is requested and then followed.

        `_joins` is the tick at which the itinerary was joined, or at which a flight ends, and `_at` the reference's
        time then, s. A lap ends early at the tick `_meets` of the reference, whose state is the first one. The answer
        to a request is read at the tick `_answers`.

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
                return self._end_lap(k, ticker.references[k + 1 - ticker.began], ticker)
            return () if k % _EVERY else self._catch(k, report, ticker, period)
        if self.motion is Motion.FLIGHT:
            if k + 1 >= self._joins:
                return self._arrive_at_goal(k, report, ticker)
            self._check(k, report, ticker)
            return ()
        # The braking law's gains end with the tick `began + count - 1`, before which it is begun again.
        braking_ends = k + 2 == ticker.began + ticker.count
        if not self._reliable:
            self._hold_still(k, report, ticker, period)
            if (reliable := self._is_reliable(k, report, ticker, period)) or braking_ends:
                self._brake(k, ticker, still=not reliable)
            return ()
        if k == self._answers:
            return self._fly(k, report, ticker)
        if braking_ends:
            self._brake(k, ticker)
        elif k >= self._asks and self._answers == _NEVER:
            # After `_TRIES` failed flights to the stop, one leads to rest (-1).
            self._goal = -1 if self._tries % (_TRIES + 1) == _TRIES else self._stop
            self._ask(k, report, ticker)
        return ()

    def _ask(self, k: int, report: Report, ticker: Ticker, *, course: Course | None = None) -> None:
        """Request a flight to the stop `_goal` from the pilot, whose answer is read at the tick `_answers`.

        Until then, the search has `_thinking` s. No place after the time `_good` of the reference is joined.

        Args:
            k: the completed tick.
            report: report of the tick, with the state at which the next command acts.
            ticker: ticker of the run.
            course: flight under way, which the answer replaces if it misses its goal; None for a flight from the
                braking cart.
        """
        program, model = ticker.program, self._plan.model
        ticks = max(round(self._thinking / model.period), 1)
        self._answers = k + ticks
        accelerations, drive_acceleration = program.pending_accelerations()
        acceleration = accelerations[-1].item(0) if accelerations else report.acting.item(0)
        # The next command is decided already, so the first free one acts a tick later.
        state = model.step(report.ahead[:, 0], acceleration)
        if course is None:
            ticker.correct_velocity(state[-1])
        self._plan.pilot.ask(
            Request(
                state,
                drive_acceleration.item(0),
                ticks,
                ticker.lead,
                self._goal,
                course,
                k + 1 + ticker.lead - ticker.began,
                self._good,
                program.equations.filter.likely_parameters(model.parameters, report.extra[:, 0]),
            )
        )

    def _fly(self, k: int, report: Report, ticker: Ticker) -> Sequence[Event]:
        """Follow the pilot's flight from tick k + 1 and return its event; if there is none, request another one.

        The answer is None if the pilot needs more time, and its course is None if it found no flight, which counts as a
        failed one (`_tries`).
        """
        answer = self._plan.pilot.answer()
        if answer is None or answer.course is None:
            # A late answer would be for a state that has passed, so a slow processor gets more time (`_thinking`, s).
            self._tries += answer is not None
            self._thinking = min((1.0 if answer else _SLOWER) * self._thinking, _MOST_THINKING)
            self._ask(k, report, ticker)
            return ()
        course = answer.course
        self._follow(k, course, ticker)
        duration = {"duration": course.duration, "waited": (k - self._began) * self._plan.model.period}
        return [_event("info", FLIGHT, Cause.FLOWN, {**self._progress(), **self._stop_figures(), **duration})]

    def _follow(self, k: int, course: Course, ticker: Ticker) -> None:
        """Let the ticker follow the flight `course` from tick k + 1 on, with the supervisor's usual bounds.

        Its gains get the columns of the itinerary's, because all laws of a run share one compiled tick. The flight ends
        at the tick `_joins`.
        """
        law = padded(course.law.schedule(ticker.lead), self._plan.gains)
        ticker.follow(k + 1, ScheduledController(law, "flight"), lift=np.zeros(self._arms), bounds=self._bounds)
        self.motion, self._course = Motion.FLIGHT, course
        self._joins, self._answers = k + 1 + course.law.ticks, _NEVER

    def _check(self, k: int, report: Report, ticker: Ticker) -> None:
        """Replace the flight under way if it is going to miss its place at the goal, unless it is nearly over.

        The pilot simulates the rest of the flight from the present state, and answers with a new flight only if it is
        needed. Its answer is read at the tick `_answers`. The flight ends at the tick `_joins`; a request is only made
        if more than twice the time for a search (`_thinking`, s) remains until then.
        """
        if k == self._answers:
            self._answers = _NEVER
            if (answer := self._plan.pilot.answer()) is not None and answer.course is not None:
                self._follow(k, answer.course, ticker)
        elif self._answers == _NEVER and (self._joins - k) * ticker.program.period > 2 * self._thinking:
            self._ask(k, report, ticker, course=self._course)

    def _stop_figures(self) -> Mapping[str, Any]:
        """Return number and name of the stop that the flight leads to for an event, none for rest."""
        return {"stop": self._goal + 1, "stop_name": self._plan.names[self._goal]} if self._goal >= 0 else {}

    def _arrive_at_goal(self, k: int, report: Report, ticker: Ticker) -> Sequence[Event]:
        """Continue after a flight, which ended at the tick `_joins`, and return events to log.

        A flight to a stop resumes the itinerary there. One to rest (`_goal` -1) is held there for `RESTING` s, then the
        cart brakes for a flight to the stop. A flight whose cost-to-go at its end is `JOINED` or more has missed, and
        the cart brakes for another one.

        The goal's targets hold states (M, N) and costs-to-go P (M, N, N) of its places, and `at` (M,) the reference's
        time at each, s.
        """
        goal, place, n = self._plan.briefing.goals[self._goal], self._course.place, self._arms
        difference = report.state[:, 0] - goal.target.states[place]
        turns = whole_turns(difference[:n])
        difference[:n] -= turns
        if not difference @ goal.target.costs[place] @ difference < JOINED:
            self._tries += 1
            self._brake(k, ticker)
            return [_event("warn", FLIGHT, Cause.MISSED, self._stop_figures())]
        if k + 1 == self._joins:
            gains = self._plan.rest if self._goal < 0 else self._plan.gains
            tick = round(float(goal.at[place]) / ticker.program.period)
            remaining_gains = replace(gains, rows=gains.rows[tick:], references=gains.references[tick:])
            ticker.follow(k + 1, ScheduledController(remaining_gains, self._main.kind), lift=turns, bounds=self._bounds)
        if self._goal < 0:
            if k + 1 >= self._joins + round(RESTING / ticker.program.period):
                self._tries += 1
                self._goal = self._stop
                self._brake(k, ticker)
            return ()
        self._at = float(goal.at[place])
        self.motion, self._followed, self._arrives = Motion.ITINERARY, k, True
        return [self._resumption()]

    def _catch(self, k: int, report: Report, ticker: Ticker, period: float) -> Sequence[Event]:
        """Resume from an earlier place of the reference if the run is much nearer to it than to the present place.

        This avoids a fall, for example if an arm has not turned and is still near its orbit. The cost-to-go measures
        the distance. The state must be far from the present place, and must have been near since the last catch
        (`_near`). Returned are events to log, none if the run is not caught.

        Places of the reference (`reach`) are `every` ticks apart, and `here` and `place` are their indices. At the tick
        `_joins`, the reference's time was `_at` s.
        """
        plan, reach, n = self._plan, self._plan.reach, self._arms
        state = report.state[:, 0]
        here = min(round((self._at / period + k - self._joins) / reach.every), len(reach.states) - 1)
        cost = reach.costs_at(state[None], here).item()
        self._near = self._near or not cost > _FAR
        # Only after the run has been near again; otherwise it could be sent back repeatedly.
        if not cost > _FAR or not self._near:
            return ()
        if (place_and_cost := plan.earlier_place(state, here, cost)) is None:
            return ()
        place, least_cost = place_and_cost
        time_back, tick = (here - place) * reach.every * period, place * reach.every + 1
        stop = max(
            (stop for stop, goal in enumerate(plan.briefing.goals[:-1]) if goal.at[0] <= tick * period), default=0
        )
        if time_back > plan.period:
            # More than a period of the last orbit is flown again, so a symbol, or a part of it, is repeated.
            if plan.attempts and self._attempts.get(stop, 0) + 2 > plan.attempts:
                return ()
            self._attempts[stop] = self._attempts.get(stop, 0) + 1
        self._flown.append(Stretch(self._joins, k + 1, self._at))
        self._stop, self._at, self._joins, self._followed = stop, tick * period, k + 1, k
        self._near = self._arrives = False
        turns = whole_turns(state[:n] - reach.states[place, :n])
        remaining_gains = replace(plan.gains, rows=plan.gains.rows[tick:], references=plan.gains.references[tick:])
        ticker.follow(k + 1, ScheduledController(remaining_gains, self._main.kind), lift=turns, bounds=self._bounds)
        figures = {**self._progress(), "back": time_back, "least": least_cost, "here": cost}
        return [_event("warn", CATCH, Cause.JOINED, figures)]

    def _hold_still(self, k: int, report: Report, ticker: Ticker, period: float) -> None:
        """Brake a stopped cart that drifts, because a drive does not follow commands exactly.

        The cart's scale gives the drift over `_LOOKS` s; a stuck scale reports no motion. `_seen` is the tick and the
        position, m, of the last check.
        """
        last_tick, last_position = self._seen
        elapsed = (k - last_tick) * period
        if elapsed < _LOOKS:
            return
        cart = ticker.program.reading.measured[-1, 0].item()
        self._seen, drift = (k, cart), (cart - last_position) / elapsed
        # A longer time means that the last check was of an earlier stop.
        if elapsed < 2 * _LOOKS and report.done.item(0) and abs(drift) > _DRIFTS:
            # Braking continues from the measured velocity instead of the commanded one.
            ticker.correct_velocity(drift)

    def _is_reliable(self, k: int, report: Report, ticker: Ticker, period: float) -> bool:
        """Return True if the cart is still and the filter agrees with the readings, so that a flight can be planned.

        It must have agreed for `_TRIED` s. An estimate that is wrong at tick k (`_lost_at`) restarts the filter and
        this time. `_why` is the cause of the fall, and `_sensor` the number of the sensor that was stuck, from 1.
        Braking began at the tick `_began`; `same` counts the ticks with the same reading of a sensor.
        """
        # Arms at rest give constant readings, like a stuck sensor. After a time limit, the sensor is used again.
        ticks = k - self._began
        is_stuck = (
            self._why is Cause.STUCK
            and ticks * period < _STUCK
            and ticker.program.memory.same[self._sensor - 1, 0] >= ticks
        )
        is_lost = not report.mean_nis.item(0) <= ticker.program.numbers.lost_estimate.item(0)
        if is_stuck or is_lost or report.silent.item(0):
            self._lost_at = k
            ticker.lose()
        return bool(report.done.item(0)) and (k - self._lost_at) * period >= _TRIED

    def ended(self, k: int, ticker: Ticker) -> Sequence[Event]:
        """Continue after the reference ends with tick k: repeat it, or recover if the last stop was not held.

        Args:
            k: tick.
            ticker: ticker of the run.

        Returns:
            Events to log, or none if the run ends.
        """
        if self.motion is not Motion.ITINERARY:
            return ()
        if self.until:
            return self._end_lap(k, ticker.references[-1], ticker)
        distance = self._plan.distance(self._latest, ticker.references[-1, : self._arms])
        if distance <= _HELD:
            return ()
        return self.fell(k, Cause.NOT_HELD, {"away": distance}, ticker, ticker.program.period) or ()

    def _end_lap(self, k: int, state: Array, ticker: Ticker) -> Sequence[Event]:
        """Begin another repetition of the itinerary after tick k, and return its events.

        If the reference's state `state` (N,) matches the first one within `_MEETS` in each entry, but for whole turns,
        the itinerary continues at once. Otherwise the cart brakes until a flight to its start is planned. Attempts
        and stretches begin anew; falls are still counted.
        """
        self._lap, self._begins = self._lap + 1, True
        self._good = math.inf
        # A run is judged by its last repetition.
        self._flown.clear()
        self._attempts.clear()
        self._stop, self._at, self._joins = 0, 0.0, k + 1
        first, n = self._main.first_state, self._arms
        difference = state - first
        turns = whole_turns(difference[:n])
        difference[:n] -= turns
        if np.abs(difference).max() <= _MEETS:
            ticker.follow(k + 1, self._main, lift=turns, bounds=self._bounds)
            self._followed, self._arrives = k, False
            return [self._resumption()]
        self._tries = 0
        self._brake(k, ticker)
        return [_event("info", RETURN, Cause.LAP_DONE, {"lap": self._lap - 1})]


class Departures:
    """Finds the runs in lockstep in which a recovery would act at a tick; they are run alone instead.

    Args:
        plan: data of the recovery.
        runs: number S of runs.
    """

    def __init__(self, plan: RecoveryPlan, runs: int) -> None:
        """Begin before the first tick.

        `_near` (S,) is True once a run has been near its reference. `_latest` holds the recent angles (n, S) of all
        runs, by which the last stop is judged as held or not.
        """
        self._plan, self._near, self._latest = plan, np.zeros(runs, dtype=bool), plan.empty_record()

    def lanes(self, k: int, report: Report, ticker: Ticker) -> NDArray[np.bool_]:
        """Return True (S,) for runs in which a recovery would act at tick k, which must leave the lockstep.

        Their cart runs away, they are nearer to an earlier place of the reference, or they missed the last stop.

        Args:
            k: tick.
            report: report of the tick, parts (length, S).
            ticker: ticker of the runs.
        """
        plan, states, references = self._plan, report.state, ticker.references
        arms = len(states) // 2 - 1
        departs = ~(np.abs(states[-1]) < plan.runaway_speed(references.item(k, 2 * arms + 1)))
        if not k % _EVERY:
            self._latest.append(states[:arms].copy())
            here = min(round(k / plan.reach.every), len(plan.reach.states) - 1)
            costs = plan.reach.costs_at(states.T, here)
            far = costs > _FAR
            # As in `FallRecovery`, a run is caught only after it has been near its reference.
            self._near |= ~far
            for lane in np.flatnonzero(far & self._near & ~departs).tolist():
                departs[lane] = plan.earlier_place(states[:, lane], here, costs.item(lane)) is not None
        if k + 1 == ticker.count:
            recorded, end = np.array(self._latest), references[-1, :arms]
            for lane in np.flatnonzero(~departs).tolist():
                departs[lane] = not plan.distance([*recorded[:, :, lane]], end) <= _HELD
        return departs


def meeting_tick(references: Array, ticks: int) -> int | None:
    """Return the last tick of a reference whose state matches the first one, or None.

    A repeated itinerary continues there without a flight. Only the last `ticks` are searched, and whole turns are
    ignored. Several matches of similar quality give the last of them.

    Args:
        references: reference states (K, N), rad, rad/s, m and m/s.
        ticks: number of last ticks that are searched.
    """
    n = references.shape[1] // 2 - 1
    first = max(len(references) - ticks, len(references) // 2)
    differences = references[first:] - references[0]
    differences[:, :n] -= whole_turns(differences[:, :n])
    distances = np.abs(differences).max(axis=1)
    matches = np.flatnonzero(distances <= max(1.2 * distances.min(), _MEETS / 10))
    return first + int(matches[-1]) if distances.min() <= _MEETS else None
