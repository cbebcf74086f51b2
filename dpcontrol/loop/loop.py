"""The closed loop: read, decide and command in each tick.

It serves one run on any rig, or many simulated runs in lockstep.

All random numbers of a simulated run come from its seed. Controller and estimator use the model's parameters and the
drive's nominal limits and delay, but none of the drawn values.

The `Ticker` decides, with the same code for one run and many. This module carries out the decisions: it emits sentences
and events, and ends a run when its cart is at rest. Rows of ticks go to the sink every 20 ms, in step with its chunks,
and every 0.2 s if they are computed in blocks. A killed run loses no more than that and a block.
"""

import logging
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np

from dpcontrol.control.estimator_settings import HOLD, Augment, EkfSettings, EstimatorSettings
from dpcontrol.control.handover import NearestKeeper
from dpcontrol.control.lqr import HoldSettings
from dpcontrol.control.tick import KnownMechanics
from dpcontrol.control.tick_parts import Outcome
from dpcontrol.control.tracking import TvlqrSettings
from dpcontrol.dynamics.chain import ArmChainParameters, Uncertainty
from dpcontrol.foundation.causes import Cause
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.foundation.settings import Setting, Settings, suggest
from dpcontrol.logs import Event
from dpcontrol.loop.bench import (
    BenchDraw,
    BenchSettings,
    DisturbanceSettings,
    DriveSettings,
    MechanicsSettings,
    SensorSettings,
    StreamReader,
    Unlike,
    draw_bench,
)
from dpcontrol.loop.blocks import blocks_of
from dpcontrol.loop.controllers import KEEPERS, ControllerSettings, keeps_by_phase
from dpcontrol.loop.own import OwnEstimator, OwnFailure, OwnLaw, OwnObject, OwnPlant
from dpcontrol.loop.recovery import FallRecovery
from dpcontrol.loop.result import (
    LoopResult,
    LoopSink,
    Rig,
    SupervisorSettings,
    Ticks,
    ended,
)
from dpcontrol.loop.ticker import Ticker
from dpcontrol.references.problem import Limits

_LOG = logging.getLogger(__name__)
_FLUSH_SECONDS, _FLUSH_BLOCKS = 0.02, 0.2
"""Times between two transfers of rows to the sink, s, equal to chunks of a log; the second for blocks of ticks."""
_PROGRESS_EVERY = 500
EVENTS = {Cause.RESTART: "restart the estimator", Cause.RESYNCHRONISE: "re-synchronise", Cause.HOLD: "hold"}
"""Names of events in a log by the cause that does not stop the cart; all others are "stop"."""
_THOUGHTS = 1_000_000
"""Number of last ticks whose computing time is stored for `LoopResult.thinking`."""
_REPORT_INTERVAL = 1.0
"""Time between events on missed deadlines, s."""


class ControlLoop:
    """One run of a controller and an estimator on a rig, simulated or real.

    `run` can be called once.

    Attributes:
        ticker: controller, estimator and supervisor, which decide in each tick.
        limits: the cart's limits.
        sink: receiver of the rows of ticks and of events, such as the writer of a log.
        rate_noise: noise (n, 1) on the controller's rates by tick, rad/s. It simulates measured rates (Wiebe et al.,
            Open-source dual-purpose acrobot and pendubot platform, IEEE RAM 2024). The estimator does not receive it.
        fallback: laws that take over if the supervisor abandons the reference. Without one, the run ends or recovers.
        recovery: motions after a fall.
        keep: True if the result holds all ticks, False for the last block only.
        progress: receiver of the label "run" and the completed share.

    The rig's `truth` is recorded if it exists, but never used.
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
        keep: bool = True,
        progress: Progress = no_progress,
    ) -> None:
        """Begin before the first tick, with no rows.

        `_rows` are the rows in memory and `_first` the tick of the first of them; `_full` holds earlier blocks of rows.
        `_done` is the number of completed ticks, and `_flushed` of those sent to the sink. `_fall` is the cause of a
        fall and its figures, from the supervisor's decision to the end of the tick. `_stopped` is True once the cart
        was stopped for good, and `_until` the tick at which a repeated itinerary ends, 0 without repetition.
        """
        self.ticker, self.limits, self.sink, self.fallback, self.progress = ticker, limits, sink, fallback, progress
        self._rate_noise, self._recovery, self._keep = rate_noise, recovery, keep
        self._until = 0 if recovery is None else recovery.until
        self.count = ticker.count
        self.end, self._stopped = ended(Cause.FINISHED), False
        self._period, self._arms = ticker.program.period, ticker.program.model.arms
        self._rows = Ticks.empty(0, self._arms, has_truth=False, period=self._period)
        self._full: list[Ticks] = []
        self._fall: tuple[Cause, Mapping[str, Any]] | None = None
        self._done = self._flushed = self._first = 0
        if fallback is not None:
            ticker.prepare_to_hold()

    @property
    def queued(self) -> list[float]:
        """Commands in flight when the run begins, oldest first, m/s²."""
        return self.ticker.queued[:, 0].tolist()

    def run(self, rig: Rig) -> LoopResult:
        """Run to the last tick, or until the cart is stopped.

        The supervisor stops the cart. If the run is interrupted or breaks, the cart is stopped as well.

        With a recovery, the run continues after falls. If it is interrupted, the sink receives the rows so far.

        Args:
            rig: bench, simulated or real.

        Raises:
            InputError: the sink cannot be written.
        """
        try:
            return self._run(rig)
        except BaseException:
            rig.stop()
            raise
        finally:
            self._flush(self._done)

    def _run(self, rig: Rig) -> LoopResult:
        """Read, decide and command in each tick until the run ends, then stop the rig and return its result.

        The result holds all ticks, or those of the last block of rows if `keep` is False. If `blocks_of` has blocks for
        this rig, ticks without events are computed in blocks, and all others one by one.

        In the report of a tick, `notable` is not 0 with a decision of the supervisor, and `news` with another event.
        `done` is 1 once a stopped cart has rested long enough.
        """
        ticker, period = self.ticker, self._period
        block_size, recovery = self.count, self._recovery
        self._rows = rows = Ticks.empty(
            block_size, self._arms, has_truth=rig.truth is not None, period=period, extras=len(ticker.extra_names)
        )
        start_figures = {
            "law": ticker.kind,
            "estimator": ticker.estimator_kind,
            "ticks": self.count - 1,
            "rate": 1 / period,
        }
        self._event(0.0, "info", "start", Cause.BEGUN, start_figures)
        if recovery is not None:
            self._emit_choices(0, [recovery.begin(ticker)])
        late_ticks, quiet_until = 0, 0.0
        write_row, has_user_parts, noise, logged = rows.take, ticker.watched, self._rate_noise, ticker.program.logged
        clock, thinking = time.perf_counter, deque[float](maxlen=_THOUGHTS)
        store_thinking = thinking.append
        began = clock()
        blocks = None if recovery is not None else blocks_of(ticker, rig, noise)
        flush_every = max(1, round((_FLUSH_SECONDS if blocks is None else _FLUSH_BLOCKS) / period))
        done = 0
        while True:
            k = done
            if k - self._first == block_size:
                self._flush(k)
                rows, write_row = self._next_block(k)
            started, lateness = clock(), 0.0
            count = (
                0 if blocks is None else blocks.run(k, min(self.count, self._first + block_size) - k, rows, self._first)
            )
            if count:
                thinking.extend([(clock() - started) / count] * count)
                self._done = done = k + count
                k, report = done - 1, ticker.report
            else:
                try:
                    reading = ticker.seen(rig.read())
                except ArithmeticError as failure:
                    self._fail(k, failure)
                    break
                started = clock()
                report = ticker(k, reading, None if noise is None else noise[k])
                store_thinking(clock() - started)
                command_failure = None
                try:
                    rig.command(report.command.item(0))
                except ArithmeticError as failure:
                    command_failure = failure
                write_row(k - self._first, reading, logged, rig.truth, ticker.references[k - ticker.began])
                self._done = done = k + 1
                if has_user_parts and command_failure is None:
                    command_failure = ticker.failure
                if command_failure is not None:
                    self._fail(k, command_failure)
                    break
                lateness = reading.late
            if report.notable.item(0):
                self._handle_outcome(k, rig)
            if lateness > 0:
                late_ticks, time_s = late_ticks + 1, k * period
                if time_s >= quiet_until:
                    quiet_until = time_s + _REPORT_INTERVAL
                    self._event(
                        time_s, "warn", "deadline missed", Cause.LATE, {"late_ms": 1e3 * lateness, "count": late_ticks}
                    )
            if ticker.event:
                self._event(k * period, "info", "controller", words=ticker.event)
            # A cart that was stopped because of its track may still reach the end of it: that is no other ending.
            if (fault := rig.fault) is not None and self.end.name != fault.name:
                self.end = fault
                break
            if report.news.item(0):
                self._emit_news(k)
            if recovery is not None:
                if self._fall is not None:
                    self._recover(k, *self._fall, recovery, rig)
                elif not self._stopped and (speeds := recovery.runaway(k, report, ticker)):
                    ticker.brake(k)
                    self._recover(k, Cause.TOO_FAST, speeds, recovery, rig)
                elif not self._stopped:
                    self._emit_choices(done, recovery.follow_up(k, report, ticker, period))
                if done == ticker.began + ticker.count:
                    choices = () if self._stopped else recovery.ended(k, ticker)
                    if not choices:
                        break
                    self._emit_choices(done, choices)
                if self._stopped and report.done.item(0):
                    break
                if done == self._until and not self._stopped:
                    self.end, self._stopped = ended(Cause.TIME_OVER), True
                    ticker.brake(k)
            elif done == self.count or report.done.item(0):
                break
            if done - self._flushed >= flush_every:
                self._flush(done)
            if not done % _PROGRESS_EVERY:
                self.progress("run", done / (self._until or self.count))
        elapsed, done = clock() - began, self._done
        rig.stop()
        self._flush(done)
        self.end = replace(self.end, time=max(done - 1, 0) * period)
        self.sink.event(self.end)
        self.progress("run", 1.0)
        all_ticks = Ticks.joined([*self._full, self._rows.between(0, done - self._first)])
        result = LoopResult(self.end, all_ticks, late_ticks, elapsed, np.array(thinking), constants=ticker.constants)
        return result if recovery is None else replace(result, falls=recovery.falls, stretches=recovery.stretches(done))

    def _fail(self, k: int, failure: ArithmeticError) -> None:
        """End the run at tick k because the plant or a user's object failed.

        The failure's message becomes the text of the run's last event.
        """
        is_user_object = isinstance(failure, OwnFailure)
        message = f"{failure}, at t = {k * self._period:.3f} s" if is_user_object else str(failure)
        self.end = ended(Cause.OBJECT_FAILED if is_user_object else Cause.PLANT_FAILED, words=message)
        _LOG.debug("%s", message, exc_info=failure)

    def _next_block(self, k: int) -> tuple[Ticks, Callable[..., None]]:
        """Allocate rows for the ticks from tick k on, and return them with the method that writes one row.

        A run of any length is stored block by block. The full block before is stored for the result, unless `keep` is
        False.
        """
        full_block = self._rows
        if self._keep:
            self._full.append(full_block)
        has_truth, extras = full_block.truth is not None, len(self.ticker.extra_names)
        self._rows = rows = Ticks.empty(
            len(full_block.times), self._arms, has_truth=has_truth, period=self._period, extras=extras, first=k
        )
        self._first = k
        return rows, rows.take

    def _handle_outcome(self, k: int, rig: Rig) -> None:
        """Carry out the decision of the tick's supervisor at tick k.

        The decision is an `Outcome`: restart the estimator, move the reference's clock, hold an orbit, or stop the
        cart. If a recovery exists, a fall is only stored in `_fall` here, and `_run` hands it to the recovery after the
        tick. `_stopped` is True once the cart was stopped for good; a fall while it brakes has no effect.
        """
        ticker, time_s = self.ticker, k * self._period
        outcome = Outcome(int(ticker.report.outcome.item(0)))
        if outcome is not Outcome.GO_ON:
            cause, figures = Cause[outcome.name], ticker.figures(k)
            if self._recovery is not None and outcome >= Outcome.ESTIMATE_LOST:
                # The rest of this tick still belongs to the former reference.
                self._fall = None if self._stopped else (cause, figures)
                return
            self._event(time_s, "warn", EVENTS.get(cause, "stop"), cause, figures)
            if outcome is Outcome.RESTART:
                # A restarting filter has no valid NIS, which is column 5.
                self._rows.control[k - self._first, 5] = np.nan
            elif outcome is Outcome.RESYNCHRONISE:
                moved = ticker.resynchronise(k)
                self._event(time_s, "info", "re-synchronise", "" if moved else Cause.CLOCKLESS, words=moved)
            elif outcome is Outcome.HOLD:
                assert self.fallback is not None
                description = ticker.hold(k, self.fallback)
                self._event(time_s, "warn", "fallback", words=description)
                self.end = ended(cause, {**figures, "held": description})
            else:
                self.end, self._stopped = ended(cause, figures), True
                # From here on the reference is constant.
                ticker.freeze_reference(k)
        if ticker.report.stop.item(0) and (self._stopped or self._recovery is None):
            # The drive brakes without commands; the loop sends its prediction of the braking meanwhile.
            rig.stop()

    def _recover(self, k: int, cause: Cause, figures: Mapping[str, Any], recovery: FallRecovery, rig: Rig) -> None:
        """Begin the recovery from a fall at tick k, or end the run if no attempt is left.

        A fall is the loss of the itinerary, for example if an arm leaves the reference. `cause` and `figures` describe
        it for the log. After the last attempt, the cart is stopped.
        """
        self._fall = None
        choices = recovery.fell(k, cause, figures, self.ticker, self._period)
        if choices is not None:
            self._emit_choices(k, choices)
            return
        figures = {**figures, "falls": recovery.falls}
        self._event(k * self._period, "warn", "stop", cause, figures)
        self.end, self._stopped = ended(cause, figures), True
        self.ticker.freeze_reference(k)
        rig.stop()

    def _emit_choices(self, k: int, choices: Sequence[Event]) -> None:
        """Send the recovery's decisions of tick k, such as the start of a flight, to the sink as events."""
        for choice in choices:
            self._event(k * self._period, choice.level, choice.name, choice.cause, choice.figures)

    def _emit_news(self, k: int) -> None:
        """Send events that change no state: the command is newly cut, or an estimate is outside its trusted range."""
        time_s, figures = k * self._period, self.ticker.figures(k)
        if figures["newly_cut"]:
            self._event(time_s, "warn", "saturated", Cause.CUT, figures)
        if figures["untrusted"]:
            self._event(time_s, "info", "controller", Cause.UNTRUSTED, self.ticker.untrusted())

    def _event(
        self,
        time_s: float,
        level: str,
        name: str,
        cause: str = "",
        figures: Mapping[str, Any] | None = None,
        words: str = "",
    ) -> None:
        """Send an event at `time_s` to the sink, after the rows of all earlier ticks.

        `level` is "info", "warn" or "error", and `name` the kind of event, such as "saturated". `words` replaces the
        sentence that is made from cause and figures, for texts that a law or user's object supplies.
        """
        # Events follow the ticks that they belong to.
        self._flush(round(time_s / self._period))
        self.sink.event(Event(time_s, level, name, cause, figures or {}, words))

    def _flush(self, until: int) -> None:
        """Send the rows of all ticks before tick `until` to the sink, except those that it has received.

        A killed run then loses later rows only.
        """
        first = self._flushed
        if until > first:
            # Set first, so that an interrupt cannot write rows twice.
            self._flushed = until
            self.sink.ticks(self._rows.between(first - self._first, until - self._first))


_SHAPED = 0.25
"""Largest frequency of the drive's belt for which commands are shaped by a notch, as a share of the loop's rate."""


_BLIND_ERROR = 0.03
"""Relative error of the model's accelerations that a hold with a missing encoder expects at least."""


@dataclass(frozen=True)
class LoopSettings(Settings, table="run"):
    """Rate, controller, estimator, bench and plant errors of a run.

    Attributes:
        seed: seed of the random numbers.
        rate: rate of the loop, Hz.
        start: "planned", or "anywhere" or a state (N,), from which a flight leads to the first stop.
        initial_error: largest initial error of each angle, rad.
        encoders: True for each arm whose angle is measured; one value for all arms, or one for each.
        mismatch: largest relative error of the plant's parameters.
        model_uncertainty: factor on the standard errors in the model's file, from which the plant is drawn as well.
        friction: factor on the friction of the plant.
        plant: arms of the plant, if they differ from the model's, for mismatch and friction.
        travel: the cart's greatest distance from the centre, m, 0 for the reference's limit.
        drive_lag: time constant of the drive assumed by filter, prediction and gains, s.
        keep: law that keeps the stops of a walk (`KEEPERS`), with TVLQR in between.
    """

    seed: Annotated[int, Setting(least=0, help="Seed of the random numbers.")]
    rate: Annotated[
        float, Setting(least=1, most=10_000, unit="Hz", usual=(20.0, 20_000.0), help="Rate of the loop.")
    ] = 1000.0
    start: Annotated[
        str | tuple[float, ...],
        Setting(help='"planned", or "anywhere" or a state, from which a flight leads to the first stop.'),
    ] = "planned"
    initial_error: Annotated[
        float, Setting(least=0, most=np.pi, unit="rad", usual=(0.0, 3.2), help="Largest error of each initial angle.")
    ] = 0.0
    encoders: Annotated[
        bool | tuple[bool, ...], Setting(help="Whether each arm's angle is measured, one value or one for each arm.")
    ] = True
    mismatch: Annotated[float, Setting(least=0, most=0.9, help="Largest relative error of the plant's parameters.")] = (
        0.0
    )
    model_uncertainty: Annotated[
        float,
        Setting(
            least=0,
            most=100,
            help="Factor on the standard errors of an identified model, from which the plant is drawn.",
        ),
    ] = 0.0
    friction: Annotated[float, Setting(least=0, most=1000, help="Factor on the plant's friction.")] = 1.0
    plant: ArmChainParameters | OwnPlant | None = None
    travel: Annotated[
        float,
        Setting(least=0, most=1000, unit="m", usual=(0.02, 5.0), help="Largest distance of the cart from the centre."),
    ] = 0.0
    drive_lag: Annotated[
        float,
        Setting(
            least=1e-5,
            most=1,
            zero="a drive that follows at once",
            unit="s",
            usual=(0.0, 0.2),
            help="Drive lag that the controller assumes.",
        ),
    ] = 0.0
    keep: Annotated[str, Setting(choices=KEEPERS, help="Law that keeps the stops of a walk.")] = "none"
    controller: ControllerSettings = field(default_factory=TvlqrSettings)
    estimator: EstimatorSettings | OwnEstimator = field(default_factory=EkfSettings)
    sensors: SensorSettings = field(default_factory=SensorSettings)
    drive: DriveSettings = field(default_factory=DriveSettings)
    disturbances: DisturbanceSettings = field(default_factory=DisturbanceSettings)
    mechanics: MechanicsSettings = field(default_factory=MechanicsSettings)
    supervisor: SupervisorSettings = field(default_factory=SupervisorSettings)

    def _check_together(self) -> None:
        """Raise an `InputError` if two settings contradict each other, such as a keeper of stops and another law."""
        if isinstance(self.start, str) and self.start not in ("planned", "anywhere"):
            raise self.refusal("start", f"{suggest(self.start, ('planned', 'anywhere'))}, or a state")
        if self.sensors.jitter > 1 / self.rate:
            advice = "use the drive's delay for readings that are older"
            raise self.sensors.refusal("jitter", f"must be at most a period, {1 / self.rate:g} s; {advice}")
        if self.plant is not None and self.model_uncertainty:
            raise self.refusal("model_uncertainty", "the plant's arms differ from the model's; use a mismatch")
        # A user's `step` replaces all mechanics except the initial state, which it receives.
        replaced_mechanics = replace(
            self.mechanics, initial_rate=0.0, initial_cart=0.0, initial_position=0.0, initial_velocity=0.0
        )
        has_replaced_parts = (
            self.drive.lag
            or self.drive.cart_mass
            or self.disturbances.tilt
            or replaced_mechanics != MechanicsSettings()
        )
        if self._own_plant and (has_replaced_parts or self.model_uncertainty):
            raise InputError(
                f"run: plant = {self._own_plant.name}: its `step` replaces arms, cart and drive; remove lag, "
                f"cart_mass, tilt, model_uncertainty, belts, play, cables and stiction"
            )
        if self.keep != "none" and not isinstance(self.controller, TvlqrSettings):
            raise self.refusal("keep", f'the law between the stops must be "tvlqr", not "{self.controller.kind}"')
        if self.keeps_by_phase and self.supervisor.on_fall != "stop":
            raise self.refusal(
                "keep",
                f'a keeper of stops has internal timing, and on_fall = "{self.supervisor.on_fall}" needs gains by '
                'time: run with --set keep=none, or with on_fall = "stop"',
            )

    @property
    def bench(self) -> BenchSettings:
        """Sensors, drive, disturbances and mechanics of the simulated bench."""
        return BenchSettings(self.sensors, self.drive, self.disturbances, self.mechanics)

    def known_mechanics(self, arms: int) -> KnownMechanics:
        """Return the loop's model of play, belt and existing encoders, which filter and command shaping use.

        The values are those of the bench, unless the settings give others.

        Args:
            arms: number of arms.
        """
        mechanics = self.mechanics
        encoders = () if self.encoders is True else self.of_each("encoders", arms)
        return KnownMechanics(mechanics.of_each("known_play", arms), self.known_belt, mechanics.belt_damping, encoders)

    def counts(self, arms: int) -> list[int]:
        """Return the counts per turn of the encoders that measure and round; the coarsest limits the estimate.

        Args:
            arms: number of arms.
        """
        encoders = zip(self.of_each("encoders", arms), self.sensors.of_each("counts", arms), strict=True)
        return [counts for measured, counts in encoders if measured and counts]

    @property
    def known_belt(self) -> float:
        """Belt frequency in the loop's model, Hz, for which commands are shaped.

        The result is 0 without a belt, or if the loop's rate is too low for shaping.
        """
        mechanics = self.mechanics
        frequency = mechanics.belt if np.isinf(mechanics.known_belt) else mechanics.known_belt
        return frequency if frequency < _SHAPED * self.rate else 0.0

    @property
    def known_lag(self) -> float:
        """Lag from a command to the cart's motion in the model of filter, prediction and gains, s.

        It is the sum of the drive's lag and of the lag of a belt with shaped commands.
        """
        return self.drive_lag + KnownMechanics((), self.known_belt, self.mechanics.belt_damping).lag

    def draw(
        self,
        arms: ArmChainParameters,
        *,
        ticks: int,
        uncertainty: Uncertainty | None = None,
        seed: int | None = None,
        mismatch: float | None = None,
    ) -> BenchDraw:
        """Draw plant, sensor errors and disturbances of one run from its seed; see `draw_bench`.

        Args:
            arms: parameters of the model's arms.
            ticks: number of ticks of the run.
            uncertainty: standard errors of the model, None if unknown.
            seed: seed of the random numbers, by default that of the settings.
            mismatch: relative error of the plant's parameters, by default that of the settings.
        """
        plant = self.plant
        user_plant = plant.own if isinstance(plant, OwnPlant) else None
        unlike = Unlike(
            self.mismatch if mismatch is None else mismatch, self.model_uncertainty, uncertainty, self.initial_error,
            self.friction, None if isinstance(plant, OwnPlant) else plant,
        )  # fmt: skip
        drawn = draw_bench(
            arms, self.bench, seed=self.seed if seed is None else seed, ticks=ticks, period=1 / self.rate, unlike=unlike
        )
        if user_plant is None or not user_plant.symbolic:
            return replace(drawn, own=user_plant)
        return replace(drawn, plant=replace(drawn.plant, components=(*drawn.plant.components, user_plant.thing)))

    @property
    def _own_plant(self) -> OwnObject | None:
        """A user's plant in Python that replaces arms, cart and drive; None for built-in and symbolic plants."""
        user_plant = self.plant.own if isinstance(self.plant, OwnPlant) else None
        return None if user_plant is None or user_plant.symbolic else user_plant

    @property
    def keeps_by_phase(self) -> bool:
        """True if laws with internal timing keep the stops; without gains by time, no fall can be recovered."""
        return keeps_by_phase(self.keep, self.estimator)

    @property
    def lockstep(self) -> bool:
        """True if runs of these settings can be computed in lockstep, until one leaves the itinerary for a flight.

        This requires compiled parts and no faults that act on one run alone. The law must support lockstep too.
        """
        sensors, supervisor = self.sensors, self.supervisor
        faults = sensors.missed_counts or np.isfinite(sensors.stuck_at)
        hands_over = self.keeps_by_phase or supervisor.hold != "none" or supervisor.resynchronise
        compiled = isinstance(self.estimator, EkfSettings) and not isinstance(self.controller, OwnLaw)
        return compiled and self._own_plant is None and not faults and not hands_over and self.start == "planned"

    @property
    def filters(self) -> EstimatorSettings | OwnEstimator:
        """Settings of the estimator, completed for the law and the encoders.

        For a hold with flights, it also estimates the arms' parameters by default. If an encoder is missing, the motion
        of the arms does not determine their parameters or further accelerations. The estimator then estimates the drive
        alone, and expects that the model's accelerations are wrong.
        """
        estimator = self.estimator
        holds = isinstance(self.controller, HoldSettings) and isinstance(estimator, EkfSettings)
        if holds and estimator.augment == HOLD["augment"]:
            if not np.all(self.encoders):
                return replace(
                    estimator, augment=(Augment.DRIVE,), parameter_error=max(estimator.parameter_error, _BLIND_ERROR)
                )
            if self.supervisor.on_fall != "stop" or self.start != "planned":
                return replace(estimator, augment=(*estimator.augment, Augment.PARAMETERS))
        return self.estimator

    @property
    def own(self) -> tuple[OwnObject, ...]:
        """Users' own objects that were given in Python, which other processes cannot load from a file."""
        objects = [getattr(part, "own", None) for part in (self.controller, self.estimator, self.plant)]
        return tuple(part for part in objects if isinstance(part, OwnObject) and not part.source)

    def limits(self, planned: Limits) -> Limits:
        """Return the cart's limits in this run.

        Args:
            planned: limits of the plan, whose travel the settings can replace.
        """
        return replace(planned, position=self.travel) if self.travel else planned
