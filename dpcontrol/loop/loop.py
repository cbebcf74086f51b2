"""The closed loop, of one run on any rig or of many simulated side by side: tick by tick read, decide, command.

All that is random in a simulated run comes from its seed; the controller and the estimator know the model's parameters
and the drive's nominal limits and delay, and nothing of what was drawn.

What is decided at a tick is the `Ticker`'s, the same code for one run as for many; here it is carried out: sentences
and events are made where an outcome asks for them, and a run ends where its cart stands. Rows of ticks go to the sink
in step with its chunks, every twenty milliseconds: a run that is killed loses no more.
"""

import itertools
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dpcontrol.control.calming import CalmingSettings, calming_controller
from dpcontrol.control.estimator_settings import Augment, EkfSettings, EstimatorSettings, FilterSettings
from dpcontrol.control.handover import NearestKeeper
from dpcontrol.control.interface import MANY, Controller, GainSchedule, Mode, SampledModel, schedule_of
from dpcontrol.control.lqr import HoldSettings
from dpcontrol.control.margins import Margins, law_margins
from dpcontrol.control.tick import KnownMechanics, Outcome, TickProgram, whole_periods
from dpcontrol.control.tracking import TvlqrSettings, costs_to_go
from dpcontrol.dynamics.chain import ArmChainParameters, Level, Uncertainty, arm_chain_equations
from dpcontrol.dynamics.compiled import VECTOR
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.foundation.settings import Settings, setting
from dpcontrol.loop.bench import (
    BenchDraw,
    BenchSettings,
    DisturbanceSettings,
    DriveSettings,
    MechanicsSettings,
    SensorSettings,
    StreamReader,
    draw_bench,
)
from dpcontrol.loop.controllers import KEEPERS, ControllerSettings, make_controller, make_estimator, nearest_keeper
from dpcontrol.loop.recovery import RETURN_SECONDS, Choice, FallRecovery, Reach, RecoveryPlan, StartController, started
from dpcontrol.loop.result import (
    EVENTS,
    BatchRun,
    Ending,
    JudgedTicks,
    LoopResult,
    LoopSink,
    NoSink,
    Rig,
    SupervisorSettings,
    Ticks,
    ending,
    explained,
)
from dpcontrol.loop.simulated import BatchBench, SimulatedRig
from dpcontrol.loop.ticker import Ticker
from dpcontrol.references.problem import Limits
from dpcontrol.references.reference import Reference, StartNote, joined, plan_notes, start_reference

_FLUSH_SECONDS = 0.02
"""Between two handings over of rows to the sink; a log's writer makes a chunk of as many."""
_PROGRESS_EVERY = 500
_THOUGHTS = 1_000_000
"""Ticks, the last, of which it is kept how long they took."""
_TELL_EVERY = 1.0
"""Seconds between events that deadlines were missed."""


class ControlLoop:
    """One run of a controller and an estimator on a rig; `run` may be called once.

    rate_noise, (n, 1) rad/s by tick: what is added to the rates that the controller steers by, as where rates are
    measured and not estimated (Wiebe et al., Open-source dual-purpose acrobot and pendubot platform, IEEE RAM 2024);
    the estimator itself goes on without it. fallback: used when the supervisor gives the reference up; without one the
    run ends then, or `recovery` says how it goes on. until: the tick at which a run that recovers ends at the latest,
    0 for none. keep: whether the result holds all ticks, or only the last block of them. The rig's `truth`, where it
    has one, is recorded and never used.
    """

    def __init__(
        self,
        ticker: Ticker,
        *,
        limits: Limits,
        sink: LoopSink,
        rate_noise: StreamReader | None = None,
        fallback: NearestKeeper | None = None,
        recovery: FallRecovery | None = None,
        until: int = 0,
        keep: bool = True,
        progress: Progress = no_progress,
    ) -> None:
        self.ticker, self.limits, self.sink, self.fallback, self.progress = ticker, limits, sink, fallback, progress
        self._rate_noise, self._recovery, self._until, self._keep = rate_noise, recovery, until, keep
        self.count = ticker.count
        self.ending, self.reason, self._stopped = Ending.FINISHED, "came to the reference's end", False
        self._period, self._arms = ticker.program.period, ticker.program.model.arms
        self._rows = Ticks.empty(0, self._arms, has_truth=False, period=self._period)
        self._full: list[Ticks] = []
        self._fall: tuple[Outcome, str] | None = None
        self._flush_every = max(1, round(_FLUSH_SECONDS / self._period))
        self._done = self._flushed = self._first = 0
        if fallback is not None:
            ticker.prepare_to_hold()

    @property
    def queued(self) -> list[float]:
        """The commands (m/s²) to be on their way when the run begins, oldest first."""
        return self.ticker.queued[:, 0].tolist()

    def rehearse(self) -> None:
        """Have all that the loop needs in memory before its first deadline, by ticks that nobody sees."""
        self.ticker.rehearse()

    def run(self, rig: Rig) -> LoopResult:
        """Run to the controller's last tick, or to where the supervisor ends it and the cart stands.

        With a recovery it goes on after a fall, for as long as that says.

        Interrupted, the sink gets the rows so far.

        Raises:
            InputError: the sink cannot be written.
        """
        try:
            return self._run(rig)
        finally:
            self._flush(self._done)

    def _run(self, rig: Rig) -> LoopResult:
        ticker, period = self.ticker, self._period
        block, recovery = self.count, self._recovery
        self._rows = rows = Ticks.empty(
            block, self._arms, has_truth=rig.truth is not None, period=period, extras=len(ticker.extra_names)
        )
        ticks = f"{self.count - 1} ticks at {1 / period:g} Hz"
        self._event(0.0, "info", "start", f"{ticker.kind}, {ticker.estimator_kind}, {ticks}")
        if recovery is not None:
            self._tell_all(0, [recovery.begin(ticker)])
        late, quiet_until = 0, 0.0
        at, take = ticker.at, rows.take
        command, notable, news, done_at = at["command"], at["notable"], at["news"], at["done"]
        noise = self._rate_noise
        clock, thinking = time.perf_counter, deque[float](maxlen=_THOUGHTS)
        thought = thinking.append
        began = clock()
        for k in itertools.count():
            if k - self._first == block:
                self._flush(k)
                rows, take = self._next_block(k)
            try:
                reading = rig.read()
            except ArithmeticError as failure:
                self.ending, self.reason = Ending.PLANT_FAILED, str(failure)
                break
            asked = clock()
            report = ticker(k, reading, None if noise is None else noise[k])
            thought(clock() - asked)
            rig.command(report.item(command, 0))
            take(k - self._first, reading, report, rig.truth, ticker.references[k - ticker.began])
            self._done = done = k + 1
            if report.item(notable, 0):
                self._heed(k, rig)
            if reading.late > 0:
                late, now = late + 1, k * period
                if now >= quiet_until:
                    quiet_until = now + _TELL_EVERY
                    text = f"a tick's command comes {1e3 * reading.late:.3g} ms too late; {late} such ticks so far"
                    self._event(now, "warn", "deadline missed", text)
            if ticker.event:
                self._event(k * period, "info", "controller", ticker.event)
            if rig.fault and self.ending is not Ending.CART_STOP:
                self.ending, self.reason = Ending.CART_STOP, rig.fault
                break
            if report.item(news, 0):
                self._tell(k)
            if recovery is not None:
                if self._fall is not None:
                    self._recover(k, *self._fall, rig)
                elif not self._stopped and (why := recovery.runs_off(k, report, ticker)):
                    ticker.brake(k)
                    self._recover(k, Outcome.TRACKING_LOST, why, rig)
                elif not self._stopped:
                    self._tell_all(done, recovery.follow_up(k, report, ticker, period))
                if done == ticker.began + ticker.count:
                    following = () if self._stopped else recovery.ended(k, ticker)
                    if not following:
                        break
                    self._tell_all(done, following)
                if self._stopped and report.item(done_at, 0):
                    break
                if done == self._until and not self._stopped:
                    self.reason, self._stopped = "the time asked for is over", True
                    ticker.brake(k)
            elif done == self.count or report.item(done_at, 0):
                break
            if done % self._flush_every == 0:
                self._flush(done)
                if not done % _PROGRESS_EVERY:
                    self.progress("run", done / (self._until or self.count))
        elapsed, done = clock() - began, self._done
        rig.stop()
        self._flush(done)
        fine = self.ending is Ending.FINISHED
        self._event(max(done - 1, 0) * period, "info" if fine else "error", self.ending.value, self.reason)
        self.progress("run", 1.0)
        kept = Ticks.joined([*self._full, self._rows.between(0, done - self._first)])
        result = LoopResult(kept, self.ending, self.reason, late, elapsed, np.array(thinking))
        return result if recovery is None else replace(result, falls=recovery.falls, flights=recovery.flights(done))

    def _next_block(self, k: int) -> tuple[Ticks, Callable[..., None]]:
        """Make room for further ticks, from tick k on."""
        before = self._rows
        if self._keep:
            self._full.append(before)
        has_truth, extras = before.truth is not None, len(self.ticker.extra_names)
        self._rows = rows = Ticks.empty(
            len(before.times), self._arms, has_truth=has_truth, period=self._period, extras=extras, first=k
        )
        self._first = k
        return rows, rows.take

    def _heed(self, k: int, rig: Rig) -> None:
        """Do what the outcome of tick k asks for."""
        ticker, now = self.ticker, k * self._period
        report = ticker.program.report
        outcome = Outcome(int(report.item(ticker.at["outcome"], 0)))
        if outcome is not Outcome.GO_ON:
            why = explained(outcome, now, ticker.figures(k), arms=self._arms, period=self._period)
            if self._recovery is not None and outcome >= Outcome.ESTIMATE_LOST:
                # The rest of this tick is still of what was followed.
                self._fall = outcome, why
                return
            self._event(now, "warn", EVENTS.get(outcome, "stop"), why)
            if outcome is Outcome.RESTART:
                self._rows.without_nis(k - self._first)
            elif outcome is Outcome.RESYNCHRONISE:
                moved = ticker.resynchronise(k)
                self._event(now, "info", "re-synchronise", moved or "the controller has no clock to move")
            elif outcome is Outcome.HOLD:
                assert self.fallback is not None
                held = ticker.hold(k, self.fallback)
                self._event(now, "warn", "fallback", held)
                self.ending, self.reason = Ending.FELL_BACK, f"{why}; {held}"
            else:
                self.ending, self.reason, self._stopped = ending(outcome), why, True
                # From here on the reference stands.
                ticker.stand(k)
        if report.item(ticker.at["stop"], 0) and (self._stopped or self._recovery is None):
            # The drive brakes by itself; what is sent meanwhile is what the loop believes it does.
            rig.stop()

    def _recover(self, k: int, outcome: Outcome, why: str, rig: Rig) -> None:
        """Return from a fall at tick k, or bring the run to its end where no attempt is left."""
        recovery = self._recovery
        assert recovery is not None
        self._fall = None
        told = recovery.fell(k, outcome, why, self.ticker, self._period)
        if told is not None:
            self._tell_all(k, told)
            return
        why += f"; given up after {recovery.falls} fall{'s' * (recovery.falls > 1)}"
        self._event(k * self._period, "warn", "stop", why)
        self.ending, self.reason, self._stopped = ending(outcome), why, True
        self.ticker.stand(k)
        rig.stop()

    def _tell_all(self, k: int, told: Sequence[Choice]) -> None:
        """Make events of what is told at tick k."""
        for one in told:
            self._event(k * self._period, one.level, one.name, one.text)

    def _tell(self, k: int) -> None:
        """Make events of what is new in tick k and changes nothing."""
        now, figures = k * self._period, self.ticker.figures(k)
        if figures["newly_cut"]:
            wish, fastest = figures["wish"], self.limits.velocity
            over = f"command {wish:.3g} m/s², cut to {figures['command']:.3g} m/s²"
            text = over if abs(wish) > self.limits.acceleration else f"cart at {fastest:g} m/s"
            self._event(now, "warn", "saturated", text)
        if figures["doubted"]:
            self._event(now, "info", "controller", self.ticker.doubt())

    def _event(self, time_s: float, level: str, name: str, text: str) -> None:
        # Events stand among the ticks they belong to.
        self._flush(round(time_s / self._period))
        self.sink.event(time_s, level, name, text)

    def _flush(self, until: int) -> None:
        first = self._flushed
        if until > first:
            # Noted first, so that rows on which an interrupt falls are not written twice.
            self._flushed = until
            self.sink.ticks(self._rows.between(first - self._first, until - self._first))


_SHAPED = 0.25
"""Belt's frequency as a share of the loop's rate up to which commands are shaped for it."""


@dataclass(frozen=True)
class LoopSettings(Settings, table="run"):
    """A run: rate Hz; initial_error rad, uniform ± on each angle of the true first state; mismatch of the plant's
    parameters (share); model_uncertainty: factor on the standard errors that the model's file gives, by which the plant
    is drawn besides; friction: factor on that of the plant drawn; plant: its arms where they are others than the
    model's, mismatch and friction about these. seed of all that is random. travel m: the cart's greatest distance from
    the centre, zero for the reference's own limit. drive_lag s: the time constant of the drive's velocity loop that
    filter, prediction and gains know of, whatever the drive has. keep: what keeps the stops of a walk planned so
    (`KEEPERS`), while TVLQR flies.
    """

    seed: int = setting(least=0)
    rate: float = setting(1000.0, least=1, most=10_000, unit="Hz")
    initial_error: float = setting(0.0, least=0, most=np.pi, unit="rad")
    mismatch: float = setting(0.0, least=0, most=0.9)
    model_uncertainty: float = setting(0.0, least=0, most=100)
    friction: float = setting(1.0, least=0, most=1000)
    plant: ArmChainParameters | None = None
    travel: float = setting(0.0, least=0, most=1000, unit="m")
    drive_lag: float = setting(0.0, least=1e-5, most=1, zero="a drive that follows at once", unit="s")
    keep: str = setting("none", choices=KEEPERS)
    controller: ControllerSettings = field(default_factory=TvlqrSettings)
    estimator: EstimatorSettings = field(default_factory=EkfSettings)
    sensors: SensorSettings = field(default_factory=SensorSettings)
    drive: DriveSettings = field(default_factory=DriveSettings)
    disturbances: DisturbanceSettings = field(default_factory=DisturbanceSettings)
    mechanics: MechanicsSettings = field(default_factory=MechanicsSettings)
    supervisor: SupervisorSettings = field(default_factory=SupervisorSettings)

    def _check_together(self) -> None:
        """Check that what keeps the stops goes with the controller, and that a plant is drawn in one way."""
        if self.plant is not None and self.model_uncertainty:
            raise self.refusal(
                "model_uncertainty", "the plant has arms of its own, not those near the model's; use a mismatch"
            )
        if self.keep != "none" and not isinstance(self.controller, TvlqrSettings):
            raise self.refusal("keep", f'what flies between the stops is "tvlqr", not "{self.controller.kind}"')
        if self.keep != "none" and self.supervisor.on_fall != "stop":
            raise self.refusal(
                "keep",
                f'what keeps stops has a clock of its own, and on_fall = "{self.supervisor.on_fall}" needs gains by '
                'time: run with --keep none, or with on_fall = "stop"',
            )

    @property
    def bench(self) -> BenchSettings:
        """What stands between the model and the world."""
        return BenchSettings(self.sensors, self.drive, self.disturbances, self.mechanics)

    def known_mechanics(self, arms: int) -> KnownMechanics:
        """Return what the loop knows of the bench's mechanics."""
        own = self.mechanics
        return KnownMechanics(own.of_each("known_play", arms), self.known_belt, own.belt_damping)

    @property
    def known_belt(self) -> float:
        """Frequency of the belt that the loop knows, Hz; 0 if there is none, or if the rate is too low for shaping."""
        own = self.mechanics
        belt = own.belt if np.isinf(own.known_belt) else own.known_belt
        return belt if belt < _SHAPED * self.rate else 0.0

    @property
    def known_lag(self) -> float:
        """The lag that filter, prediction and gains know of, s: of the drive, and of a belt with its shaping."""
        return self.drive_lag + KnownMechanics((), self.known_belt, self.mechanics.belt_damping).lag

    def draw(
        self,
        arms: ArmChainParameters,
        *,
        ticks: int,
        uncertainty: Uncertainty | None = None,
        **instead: Any,
    ) -> BenchDraw:
        """Return what is drawn for a run of `ticks` ticks with these arms as the model; see `draw_bench`.

        instead: seed or mismatch in place of the settings' own.
        """
        given = {"seed": self.seed, "mismatch": self.mismatch, **instead}
        return draw_bench(
            arms, self.bench, ticks=ticks, period=1 / self.rate, model_uncertainty=self.model_uncertainty,
            uncertainty=uncertainty, initial_error=self.initial_error, friction=self.friction, plant=self.plant,
            **given,
        )  # fmt: skip

    def limits(self, reference: Reference) -> Limits:
        """Return the cart's limits in this run: the reference's, with this travel where it is given."""
        return replace(reference.limits, position=self.travel) if self.travel else reference.limits


def sampled_model(parameters: ArmChainParameters, rate: float, lag: float = 0.0) -> SampledModel:
    """Return the cart-level model of these arms between ticks at `rate` Hz, its drive lagging by `lag` s."""
    equations = arm_chain_equations(parameters.count, Level.CART, friction=parameters.friction)
    # A step of one period does not resolve a faster reversal.
    eased = replace(parameters, smoothing=max(parameters.smoothing, parameters.coulomb_acceleration / rate))
    return SampledModel(equations, eased.base(), period=1 / rate, lag=lag)


def _loop_model(parameters: ArmChainParameters, settings: LoopSettings) -> SampledModel:
    """Return the model of controller and filter. A hold that estimates disturbances leaves dry friction to them."""
    leaves = isinstance(settings.controller, HoldSettings) and Augment.DISTURBANCE in settings.estimator.augments
    arms = replace(parameters, coulomb=()) if leaves else parameters
    return sampled_model(arms, settings.rate, settings.known_lag)


def loop_controller(reference: Reference, parameters: ArmChainParameters, settings: LoopSettings) -> Controller:
    """Return the controller of these settings, which any number of runs may share.

    Raises:
        InputError: the reference did not converge, or is not one of these arms.
        GoalMissed: no controller can be made for it.
    """
    model = _loop_model(parameters, settings)
    return make_controller(
        reference, parameters, model, settings=settings.controller, estimator=settings.estimator, keep=settings.keep
    )


def loop_fallback(reference: Reference, parameters: ArmChainParameters, settings: LoopSettings) -> NearestKeeper | None:
    """Return what these settings hold when tracking is lost, which any number of runs may share; None for nothing.

    Raises:
        InputError: the reference is of other arms.
        GoalMissed: an orbit was not found, or cannot be held.
    """
    if settings.supervisor.hold == "none":
        return None
    law = settings.controller
    flies = law if isinstance(law, TvlqrSettings) else TvlqrSettings()
    model = _loop_model(parameters, settings)
    return nearest_keeper(reference, parameters, model, flies=flies)


def loop_recovery(
    reference: Reference,
    parameters: ArmChainParameters,
    settings: LoopSettings,
    controller: Controller,
    *,
    later: bool = False,
) -> RecoveryPlan | None:
    """Return how runs of these settings recover from a fall, which any number of them may share; None if they end.

    controller: of `loop_controller`. The ways from rest to the stops are the reference's own (notes, `starts`). later:
    it may have none, for they are added to the recovery's while it runs.

    Raises:
        InputError: the reference has none, or the controller keeps a clock of its own.
        GoalMissed: no controller can be made for a start.
    """
    s = settings.supervisor
    if s.on_fall == "stop":
        return None
    main = schedule_of(controller, whole_periods(settings.drive.delay)[1])
    if main is None:
        raise InputError(
            f'supervisor: on_fall = "{s.on_fall}": {controller.kind} keeps a clock of its own, and cannot be taken up '
            'anywhere; use kind = "adaptive", "tvlqr" or "lqr" without keep'
        )
    notes = plan_notes(reference)
    starts: Sequence[StartNote] = notes.get("starts", ())
    if not starts and not later:
        raise InputError(
            f'supervisor: on_fall = "{s.on_fall}": the reference was planned without ways from rest to its stops; plan '
            "the itinerary again with that setting"
        )
    model = _loop_model(parameters, settings)
    limits = settings.limits(reference)
    ways = [
        start_controller(note, start_reference(reference, k), reference, parameters, settings, main)
        for k, note in enumerate(starts)
    ]
    reaction = (settings.drive.delay + 1) / settings.rate + settings.known_lag
    calming = calming_controller(model, limits, CalmingSettings(), reaction=reaction, seconds=RETURN_SECONDS)
    last = notes["stops"][-1]["orbit"]
    return RecoveryPlan(
        calming, ways, tuple(stop["saddle"] for stop in notes["stops"]),
        tuple(symbol["text"] for symbol in notes["symbols"]), limits,
        reference.extra[f"orbit_{last}"][:, : model.arms], notes["orbits"][last]["period"], main,
        _reach(reference, parameters, settings),
        s.on_fall == "restart", s.attempts,
    )  # fmt: skip


def start_controller(
    note: StartNote,
    lead_in: Reference | None,
    reference: Reference,
    parameters: ArmChainParameters,
    settings: LoopSettings,
    main: GainSchedule,
) -> StartController:
    """Return a way from rest to a stop and on along the reference; lead_in: its transfer, None from a stop at rest.

    main: gains of the whole reference.

    Raises:
        GoalMissed: no controller can be made for it.
    """
    # Runs that do not recover do without what finds references.
    from dpcontrol.references.find import tail

    turns = 2 * np.pi * np.array(note["turns"], dtype=float)
    gains, ticks = main, 0
    if lead_in is not None:
        ticks = round(lead_in.duration * settings.rate)
        onward = tail(reference, note["at"], seconds=_ONWARD, turns=turns)
        model = _loop_model(parameters, settings)
        law = TvlqrSettings() if isinstance(settings.controller, HoldSettings) else settings.controller
        flown = make_controller(
            joined([lead_in, onward])[0], parameters, model, settings=law, estimator=settings.estimator
        )
        before = schedule_of(flown, whole_periods(settings.drive.delay)[1])
        assert before is not None
        gains = before
    whole = started(gains, main, lead_in=ticks, place=round(note["at"] * settings.rate), turns=turns)
    return StartController(note["stop"], note["at"], ticks, turns, whole)


def _reach(reference: Reference, parameters: ArmChainParameters, settings: LoopSettings) -> Reach:
    every = max(1, round(settings.rate / _PLACES))
    states, costs = costs_to_go(reference, sampled_model(parameters, settings.rate / every), TvlqrSettings())
    return Reach(every, states, costs)


_PLACES = 100.0
"""Hz, at which a reference has places where a run may be caught."""
_ONWARD = 4.0
"""Seconds of the itinerary after a start joins it that the start's gains look ahead to: these forget what is later."""


def make_ticker(
    parameters: ArmChainParameters,
    settings: LoopSettings,
    controller: Controller,
    *,
    limits: Limits,
    delay: float,
    can_hold: bool = False,
    runs: int = 1,
    library: Path | None = None,
) -> Ticker:
    """Return controller, estimator and supervisor of one run, or of `runs` side by side; delay in periods, believed.

    library: one made of what `dpcontrol export` writes, which does the ticks of one run.

    Raises:
        InputError: the delay is impossible, or the controller is not for these arms; or the library is not of these
            settings, or such a one cannot be.
    """
    # The estimator relies on the stated noise of sensors and drive.
    noise = settings.sensors.covariance(parameters.count)
    model = _loop_model(parameters, settings)
    filters = settings.estimator.with_command_noise(
        settings.drive.command_noise, period=model.period, keeps=model.lag_keeps
    )
    schedule = schedule_of(controller, whole_periods(delay)[1])
    compiled = isinstance(settings.estimator, EkfSettings)
    make: Any = TickProgram
    if library is not None:
        from dpcontrol.control.export import LibraryProgram, checked_exportable

        schedule = checked_exportable(controller, lead=whole_periods(delay)[1])
        make = partial(LibraryProgram, library)
    program = make(
        model, filters, noise=noise, delay=delay, runs=runs,
        bounds=_bounds(settings, limits, can_hold=can_hold, trust=0.0 if schedule is None else schedule.trust),
        shares=None if schedule is None else schedule.shares, mechanics=settings.known_mechanics(parameters.count),
    )  # fmt: skip
    estimator = None if compiled else make_estimator(filters, model, noise=noise)
    ticker = Ticker(program, controller, schedule=schedule, estimator=estimator, estimator_kind=settings.estimator.kind)
    if library is not None and schedule is not None:
        program.check(schedule, law=controller.kind)
    return ticker


def _bounds(settings: LoopSettings, limits: Limits, *, can_hold: bool, trust: float) -> dict[str, float]:
    s, delay = settings.supervisor, settings.drive.delay
    return {
        "acceleration": limits.acceleration, "velocity": limits.velocity, "travel": limits.position,
        "reaction": (delay + 1) / settings.rate + settings.known_lag,
        # The state ahead is that at which a command acts: the delay is in it.
        "onset": (delay - whole_periods(delay)[1] + 1) / settings.rate + settings.known_lag,
        "brake": 2 * s.braking * limits.acceleration,
        "margin": s.margin, "lost_tracking": s.lost_tracking, "lost_estimate": s.lost_estimate,
        "resynchronise": s.resynchronise, "restarts": s.restarts, "missing": s.missing, "can_hold": can_hold,
        "trust": trust, "mode": Mode.TRACKING, "scale": settings.sensors.cart_resolution,
    }  # fmt: skip


def control_loop(
    parameters: ArmChainParameters,
    settings: LoopSettings,
    controller: Controller,
    *,
    limits: Limits,
    believed_delay: float | None = None,
    rate_noise: StreamReader | None = None,
    sink: LoopSink | None = None,
    fallback: NearestKeeper | None = None,
    recovery: RecoveryPlan | None = None,
    until: int = 0,
    keep: bool = True,
    library: Path | None = None,
    progress: Progress = no_progress,
) -> ControlLoop:
    """Return a loop for any rig, simulated or real; believed_delay in periods, the drive's own by default.

    rate_noise, (n, 1) rad/s by tick, until, keep: see `ControlLoop`; until: the itinerary is repeated up to then.
    recovery: of `loop_recovery`. library: see `make_ticker`.

    Raises:
        InputError: the delay is impossible, or the controller is not for these arms; or the library is not for this.
    """
    if library is not None and (rate_noise is not None or fallback is not None or recovery is not None):
        what = "noise on measured rates" if fallback is None else 'hold = "nearest"'
        what = what if recovery is None else "on_fall"
        raise InputError(f"run: a controller's library knows nothing of {what}; run it without")
    delay = settings.drive.delay if believed_delay is None else believed_delay
    ticker = make_ticker(
        parameters, settings, controller, limits=limits, delay=delay, can_hold=fallback is not None, library=library
    )
    falls = None if recovery is None else FallRecovery(recovery, controller, laps=until > 0)
    return ControlLoop(
        ticker, limits=limits, sink=sink or NoSink(), rate_noise=rate_noise, fallback=fallback, recovery=falls,
        until=until, keep=keep, progress=progress,
    )  # fmt: skip


def run_loop(
    reference: Reference,
    parameters: ArmChainParameters,
    *,
    settings: LoopSettings,
    controller: Controller | None = None,
    uncertainty: Uncertainty | None = None,
    sink: LoopSink | None = None,
    fallback: NearestKeeper | None = None,
    recovery: RecoveryPlan | None = None,
    until: int = 0,
    keep: bool = True,
    library: Path | None = None,
    progress: Progress = no_progress,
) -> LoopResult:
    """Track `reference` on a simulated bench, with `parameters` as the model of controller and estimator.

    controller, fallback, recovery: made before, by `loop_controller` and the like with the same settings, to spare
    making them for each of many seeds. until: the tick up to which it is done again and again, where it recovers from
    falls; 0: it is done once. keep: whether all ticks are in the result, or the last block of them. uncertainty: of the
    model, for settings that draw the plant from it. library: see `make_ticker`.

    Raises:
        InputError: the reference did not converge, or is not one of these arms; an uncertainty is asked for and not
            known.
        GoalMissed: no controller can be made for it, or no plant drawn.
    """
    if controller is None:
        controller = loop_controller(reference, parameters, settings)
    if fallback is None:
        fallback = loop_fallback(reference, parameters, settings)
    if recovery is None:
        recovery = loop_recovery(reference, parameters, settings, controller)
    limits, first = settings.limits(reference), controller.first_state
    draw = settings.draw(parameters, ticks=controller.ticks + 1, uncertainty=uncertainty)
    if recovery is not None:
        draw = draw.endless()
    loop = control_loop(
        parameters, settings, controller, limits=limits,
        rate_noise=draw.reader("rate_noise", lambda rows: rows[:, :, None]), sink=sink, fallback=fallback,
        recovery=recovery, until=until, keep=keep, library=library, progress=progress,
    )  # fmt: skip
    rig = SimulatedRig(draw, settings.bench, limits=limits, start=first, queued=loop.queued)
    return replace(loop.run(rig), plant=draw.plant.arms, hardest=rig.hardest)


def loop_margins(
    reference: Reference, parameters: ArmChainParameters, settings: LoopSettings, controller: Controller | None = None
) -> Margins:
    """Return what gain, further delay and further lag the loop bears along `reference` with these settings.

    The arms are as the model says. controller: made before by `loop_controller`. Another filter than the extended one
    counts as that of its settings.

    Raises:
        InputError: the law has no margins, for it acts by pulses or not at all, or the reference is not of these arms.
        GoalMissed: no controller can be made for it, or the loop does not stay on its reference.
    """
    if not isinstance(settings.estimator, EkfSettings):
        known = {f.name: getattr(settings.estimator, f.name) for f in fields(FilterSettings) if f.name != "kind"}
        settings = replace(settings, estimator=EkfSettings(**known))

    # To first order a known belt with its shaping is a lag, and play is nothing.
    unshaped = replace(settings.mechanics, known_belt=0.0, known_play=0.0)
    settings = replace(settings, drive_lag=settings.known_lag, mechanics=unshaped)

    def program_of(law: Controller) -> TickProgram:
        return make_ticker(parameters, settings, law, limits=_UNBOUND, delay=settings.drive.delay).program

    notes = reference.notes
    return law_margins(
        controller or loop_controller(reference, parameters, settings), program_of, rate=settings.rate,
        wobble=max((orbit["period"] for orbit in notes.get("orbits", ())), default=_WOBBLE),
        repeats="stay" in notes, lags=settings.known_lag > 0,
    )  # fmt: skip


_UNBOUND = Limits(position=1e6, velocity=1e6, acceleration=1e6)
"""Of a cart that nothing stops."""
_WOBBLE = 0.8
"""s: of a reference that names no orbit."""


def can_batch(settings: LoopSettings, controller: Controller | None = None) -> bool:
    """Tell whether runs can go in lockstep, by the settings alone where no controller is given."""
    sensors = settings.sensors
    faults = sensors.missed_counts or np.isfinite(sensors.stuck_at)
    hands_over = settings.keep != "none" or settings.supervisor.hold != "none" or settings.supervisor.resynchronise
    hands_over = hands_over or settings.supervisor.on_fall != "stop"
    compiled = isinstance(settings.estimator, EkfSettings)
    answers_many = controller is None or hasattr(controller, "schedule") or hasattr(controller, "begin_many")
    return compiled and not faults and not hands_over and answers_many


def run_batch(
    parameters: ArmChainParameters,
    *,
    settings: LoopSettings,
    seeds: Sequence[int],
    controller: Controller,
    limits: Limits,
    uncertainty: Uncertainty | None = None,
    mismatches: Sequence[float] | None = None,
    believed_delay: float | None = None,
) -> list[BatchRun]:
    """Run the seeds and return them in their order; `parameters` are the model's, `limits` the cart's in these runs.

    uncertainty: of the model, for settings that draw the plants from it. mismatches: of each run's plant, in place of
    the settings' own. believed_delay in periods, the drive's own by default.

    Raises:
        InputError: the settings ask for what `can_batch` rejects.
    """
    if not can_batch(settings, controller):
        raise InputError("these runs cannot go in lockstep; run them tick by tick, --path ticks")
    if not seeds:
        return []
    # Full vectors of the processor only: those left over would be rounded differently, and a run with its company.
    own = [settings.mismatch] * len(seeds) if mismatches is None else mismatches
    lanes = [*zip(seeds, own, strict=True)]
    lanes += [lanes[-1]] * (-len(lanes) % VECTOR)
    draws = [
        settings.draw(parameters, ticks=controller.ticks + 1, uncertainty=uncertainty, seed=seed, mismatch=mismatch)
        for seed, mismatch in lanes
    ]
    delay = settings.drive.delay if believed_delay is None else believed_delay
    ticker = make_ticker(parameters, settings, controller, limits=limits, delay=delay, runs=len(lanes))
    bench = BatchBench(
        draws, settings.bench, limits=limits, start=controller.first_state, queued=list(ticker.queued), lanes=MANY
    )
    return _Lockstep(ticker, bench, draws).run()[: len(seeds)]


class _Lockstep:
    """The loop of many runs."""

    def __init__(self, ticker: Ticker, bench: BatchBench, draws: Sequence[BenchDraw]) -> None:
        self._ticker, self._bench, self._runs = ticker, bench, len(draws)
        self._period, self._arms = ticker.program.period, ticker.program.model.arms
        noise = [draw.rate_noise for draw in draws if draw.rate_noise is not None]
        self._rate_noise = np.stack(noise, axis=2) if noise else None
        self._alive, self._over = np.ones(self._runs, dtype=bool), False
        self._counts, self._stopped_at = [ticker.count] * self._runs, [ticker.count] * self._runs
        self._endings = [Ending.FINISHED] * self._runs
        self._reasons = ["came to the reference's end"] * self._runs

    def run(self) -> list[BatchRun]:
        """Run to the last tick, or until every run has ended."""
        ticker, bench, noise = self._ticker, self._bench, self._rate_noise
        rows = JudgedTicks(ticker.count, self._runs, self._arms)
        command, notable, done = (ticker.at[name] for name in ("command", "notable", "done"))
        with np.errstate(all="ignore"):
            for k in range(ticker.count):
                reading = bench.read()
                report = ticker(k, reading, None if noise is None else noise[k])
                bench.command(report[command])
                rows.take(k, report, ticker.at, bench.truth)
                if (failed := bench.failed) is not None:
                    why = f"plant failed at t = {k * self._period:.3f} s: its state is no longer finite"
                    self._end(failed, k, Ending.PLANT_FAILED, why)
                if np.add.reduce(report[notable]):
                    self._heed(k, report, rows)
                    for lane in np.flatnonzero(report[done] * self._alive).tolist():
                        self._end([lane], k + 1, self._endings[lane], self._reasons[lane])
                for lane, fault in bench.faults.items():
                    if self._endings[lane] is not Ending.CART_STOP:
                        self._end([lane], k + 1, Ending.CART_STOP, fault)
                if self._over:
                    break
        references = ticker.references
        angles = references[:, : self._arms, None] if references.ndim == 2 else references
        runs = [
            rows.run(
                lane, self._counts[lane], angles[:, :, lane % angles.shape[2]], stands_from=self._stopped_at[lane],
                period=self._period, ending=self._endings[lane], reason=self._reasons[lane],
            )
            for lane in range(self._runs)
        ]  # fmt: skip
        return [replace(run, hardest=float(most)) for run, most in zip(runs, bench.hardest, strict=True)]

    def _heed(self, k: int, report: Array, rows: JudgedTicks) -> None:
        """Do what the outcomes of tick k ask for."""
        outcomes = report[self._ticker.at["outcome"]] * self._alive
        for lane in np.flatnonzero(outcomes).tolist():
            outcome = Outcome(int(outcomes[lane]))
            if outcome is Outcome.RESTART:
                rows.without_nis(k, lane)
                continue
            figures = self._ticker.figures(k, lane)
            why = explained(outcome, k * self._period, figures, arms=self._arms, period=self._period)
            self._endings[lane], self._reasons[lane], self._stopped_at[lane] = ending(outcome), why, k
            self._bench.stop([lane])

    def _end(self, lanes: Any, count: int, ending: Ending, reason: str) -> None:
        for lane in np.arange(self._runs)[lanes].tolist():
            if self._alive[lane]:
                self._endings[lane], self._reasons[lane], self._counts[lane] = ending, reason, count
                self._alive[lane] = False
        self._over = not self._alive.any()
