"""One run of the closed loop, on any rig or simulated: tick by tick read, estimate, decide, command.

All that is random in a simulated run comes from its seed; the controller and the estimator know the model's parameters
and the drive's nominal limits and delay, and nothing of what was drawn.

At tick k the positions are read and the estimate updated; the command computed then acts from tick k + delay on, and
is computed for the estimate predicted to that tick through the commands on their way. The supervisor judges every
tick; the cart is braked to rest before a run ends early. Rows of ticks go to the sink in step with its chunks, every
twenty milliseconds: a run that is killed loses no more.

A command acts d periods after its tick, d the delay. With d = i + f, 0 ≤ f < 1, the mean over the period from tick k is

    f c_{k-i-1} + (1 - f) c_{k-i}

and the command is computed for the state at tick k + round(d): up to half a period of wrong timing is left. At 1 kHz it
moves the motion in time and harms nothing; at 50 Hz it takes part of the margin for delays. The limits of acceleration
and velocity are the drive's own, applied before it is believed.
"""

import math
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.estimation import make_estimator
from dpcontrol.control.estimator_settings import EkfSettings, EstimatorSettings
from dpcontrol.control.interface import (
    MANY,
    ONE,
    Action,
    Controller,
    Estimate,
    Estimator,
    Mode,
    SampledModel,
    Session,
)
from dpcontrol.control.tracking import TvlqrSettings
from dpcontrol.dynamics.chain import ArmChainParameters, Level, Uncertainty, arm_chain_equations
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.foundation.settings import Settings, setting
from dpcontrol.loop.bench import (
    BenchDraw,
    BenchSettings,
    DisturbanceSettings,
    DriveSettings,
    SensorSettings,
    draw_bench,
)
from dpcontrol.loop.controllers import KEEPERS, ControllerSettings, make_controller, nearest_keeper
from dpcontrol.loop.result import Ending, LoopResult, LoopSink, NoSink, Reading, Rig, Ticks
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.loop.supervisor import Outcome, StuckWatch, Supervisor, SupervisorSettings
from dpcontrol.references.problem import Limits
from dpcontrol.references.reference import Reference

AT_REST = 1e-12
"""m/s: slower than any cart."""
LONGEST_DELAY = 1000.0
"""Periods."""
Array = NDArray[np.float64]


class CommandPath:
    """The commands on their way, for a delay in periods and a loop's period in s.

    Commands and velocities are numbers or, for `runs` runs in lockstep, arrays (S,).

    Raises:
        InputError: the delay is negative or absurd.
    """

    def __init__(self, limits: Limits, *, delay: float, period: float, runs: int = 0) -> None:
        if not 0 <= delay <= LONGEST_DELAY:
            raise InputError(f"run: delay = {delay!r}: must be 0 to {LONGEST_DELAY:g} periods")
        self.limits, self.period = limits, period
        self._most, self._fastest = float(limits.acceleration), float(limits.velocity)
        self._runs, self._clip = runs, (MANY if runs else ONE).clip
        self.lead = round(delay)
        """By how many ticks a command is computed ahead."""
        whole = math.floor(delay)
        self._share = delay - whole
        # Oldest first; the last is the newest sent. One more than the whole periods, for the blend.
        self.velocity: Any = np.zeros(runs) if runs else 0.0
        """The cart's velocity in m/s once all that was sent has acted."""
        self._sent: deque[Any] = deque([self.velocity] * (whole + 2), maxlen=whole + 2)

    def clipped(self, command: Any) -> Any:
        """Return the command within the limit of acceleration, m/s²."""
        return self._clip(command, -self._most, self._most)

    def start(self, commands: Sequence[Any], *, velocity: float) -> None:
        """Fill the path with the commands (m/s²) on their way when the run begins, the cart having `velocity` m/s."""
        self.velocity = self.velocity * 0.0 + velocity
        for command in commands:
            self.send(command)

    def braking(self, share: float) -> Any:
        """Return the command in m/s² that brakes the cart to rest with a share of the greatest acceleration."""
        most = share * self._most
        return self._clip(-self.velocity / self.period, -most, most)

    def send(self, command: Any) -> None:
        """Take the command (m/s²) that has just been computed."""
        clipped = self.clipped(command)
        self._sent.append(clipped)
        velocity = self._clip(self.velocity + clipped * self.period, -self._fastest, self._fastest)
        # Braking to rest leaves what rounding leaves.
        moves = abs(velocity) > AT_REST
        self.velocity = np.where(moves, velocity, 0.0) if self._runs else velocity if moves else 0.0

    def acted(self, velocity: Any) -> Any:
        """Return what acted in the period that now ends, m/s², at the cart's believed `velocity` m/s at its start."""
        sent, fastest, period = self._sent, self._fastest, self.period
        mean = sent[1] if not self._share else self._share * sent[0] + (1 - self._share) * sent[1]
        return self._clip(mean, (-fastest - velocity) / period, (fastest - velocity) / period)

    def on_their_way(self) -> list[Any]:
        """Return what will act in each of the `lead` periods from now on, m/s²."""
        sent = list(self._sent)
        # The next to act is one place newer than what acted last.
        if not self._share:
            return sent[2:]
        newer = (sent[min(k + 1, len(sent) - 1)] for k in range(1, self.lead + 1))
        return [self._share * sent[k] + (1 - self._share) * new for k, new in enumerate(newer, start=1)]


_GO_ON = Outcome.CONTINUE
_FLUSH_SECONDS = 0.02
"""Between two handings over of rows to the sink; a log's writer makes a chunk of as many."""
_PROGRESS_EVERY = 500
_TELL_EVERY = 1.0
"""Seconds between events that deadlines were missed."""
BRAKING = 0.9
"""Share of the greatest acceleration with which the cart is braked: more than the supervisor counts on."""
SETTLING = 0.05
"""Seconds for which the loop goes on after the cart was commanded to rest: delays and lags have passed by then."""


class Fallback(Protocol):
    """Finds something to hold where the reference was given up."""

    def session(self, tick: int, state: Array) -> tuple[Session, str]:
        """Return a session that holds what is nearest to `state` (N,) from `tick` on, and a sentence saying what."""
        ...


class ControlLoop:
    """One run of a controller and an estimator on a rig; `run` may be called once.

    rate_noise (K, n) rad/s: what is added at each tick to the rates that the controller steers by, as where rates are
    measured and not estimated (Wiebe et al., Open-source dual-purpose acrobot and pendubot platform, IEEE RAM 2024);
    the estimator itself goes on without it. fallback: used when the supervisor gives the reference up; without one the
    run ends then. The rig's `truth`, where it has one, is recorded and never used.
    """

    def __init__(
        self,
        estimator: Estimator,
        controller: Controller,
        *,
        path: CommandPath,
        supervisor: Supervisor,
        sink: LoopSink,
        rate_noise: Array | None = None,
        fallback: Fallback | None = None,
        progress: Progress = no_progress,
    ) -> None:
        self.estimator, self.path, self.supervisor, self.sink = estimator, path, supervisor, sink
        self.controller, self.fallback, self.progress = controller, fallback, progress
        self._rate_noise = rate_noise
        self.session: Session = controller.begin()
        self.count = controller.ticks + 1
        self.ending, self.reason = Ending.FINISHED, "came to the reference's end"
        self._n = len(controller.first_state)
        self._arms = (self._n - 2) // 2
        self._angles = range(self._arms)
        self._rows = Ticks.empty(0, self._arms, has_truth=False, period=path.period)
        self._flush_every = max(1, round(_FLUSH_SECONDS / path.period))
        self._done = self._flushed = 0
        self._braking_since: float | None = None
        self._sensors = StuckWatch(self._arms, period=path.period, reaction=supervisor.reaction)
        self._first = estimator.first(controller.first_state)
        # The commands that act before the first tick's own can, computed for where those before them lead.
        self._coming: deque[Action] = deque()
        for k in range(path.lead):
            ahead = estimator.ahead(self._first, self.queued)
            self._coming.append(self.session.command(k, ahead, self._first.extra))

    @property
    def queued(self) -> list[float]:
        """The commands (m/s²) to be on their way when the run begins, oldest first."""
        return [action.feedforward + action.feedback for action in self._coming]

    def rehearse(self) -> None:
        """Have all that the loop needs compiled and in memory before its first deadline, by ticks that nobody sees."""
        state, estimator = self.controller.first_state, self.estimator
        measured = state[[*self._angles, self._n - 2]]
        estimate = estimator.update(self._first, measured)
        session = self.controller.begin()
        for tick in range(50):
            estimate = estimator.step(estimate, 0.0, measured)
            session.command(tick, estimator.ahead(estimate, [0.0]), estimate.extra)

    def run(self, rig: Rig) -> LoopResult:
        """Run to the controller's last tick, or to where the supervisor ends it and the cart stands.

        Interrupted, the sink gets the rows so far.

        Raises:
            InputError: the sink cannot be written.
        """
        try:
            return self._run(rig)
        finally:
            self._flush(self._done)

    def _run(self, rig: Rig) -> LoopResult:
        path, period, n, estimate = self.path, self.path.period, self._n, self._first
        has_truth = rig.truth is not None
        self._rows = rows = Ticks.empty(self.count, self._arms, has_truth=has_truth, period=period)
        path.start(self.queued, velocity=float(self.controller.first_state[-1]))
        ticks = f"{self.count - 1} ticks at {1 / period:g} Hz"
        self._event(0.0, "info", "start", f"{self.controller.kind}, {self.estimator.kind}, {ticks}")
        most, fastest = path.limits.acceleration, path.limits.velocity
        acted, was_saturated, late, quiet_until, aborted = 0.0, False, 0, 0.0, Mode.ABORTED
        step, take = self.estimator.step, rows.take
        began = time.perf_counter()
        for k in range(self.count):
            now = k * period
            try:
                reading = rig.read()
            except ArithmeticError as failure:
                self.ending, self.reason = Ending.PLANT_FAILED, str(failure)
                break
            way = path.on_their_way()
            coming = way[0] if way else 0.0
            try:
                if k:
                    estimate = step(estimate, acted, reading.positions, reading.present, coming=coming)
                else:
                    estimate = self.estimator.update(estimate, reading.positions, reading.present, coming=coming)
                nis = estimate.nis
            except ArithmeticError:
                nis = math.inf
            action, wanted, estimate = self._decided(k, now, estimate, reading, nis, way)
            command = action.feedforward + action.feedback
            path.send(command)
            rig.command(command)
            if self._braking_since is not None:
                # The drive brakes by itself; what is sent meanwhile is what the loop believes it does.
                rig.stop()
            acted = path.acted(estimate.state.item(n - 1))
            mode = action.mode
            saturated = abs(command) > most or abs(path.velocity) >= fastest
            if saturated and mode is not aborted:
                mode = Mode.SATURATED
            take(k, reading, estimate, action, wanted, (acted, saturated, mode), rig.truth)
            if reading.late > 0:
                late += 1
                if now >= quiet_until:
                    quiet_until = now + _TELL_EVERY
                    text = f"a tick's command comes {1e3 * reading.late:.3g} ms too late; {late} such ticks so far"
                    self._event(now, "warn", "deadline missed", text)
            self._done = done = k + 1
            if rig.fault and self.ending is not Ending.CART_STOP:
                self.ending, self.reason = Ending.CART_STOP, rig.fault
                break
            if saturated and not was_saturated:
                over = f"command {command:.3g} m/s², cut to {path.clipped(command):.3g} m/s²"
                self._event(now, "warn", "saturated", over if abs(command) > most else f"cart at {fastest:g} m/s")
            was_saturated = saturated
            if self._braking_since is not None and now > self._braking_since + SETTLING:
                break
            if done % self._flush_every == 0:
                self._flush(done)
                if not done % _PROGRESS_EVERY:
                    self.progress("run", done / self.count)
        elapsed, done = time.perf_counter() - began, self._done
        rig.stop()
        self._flush(done)
        fine = self.ending is Ending.FINISHED
        self._event(max(done - 1, 0) * period, "info" if fine else "error", self.ending.value, self.reason)
        self.progress("run", 1.0)
        return LoopResult(rows.between(0, done), self.ending, self.reason, late, elapsed)

    def _decided(
        self, k: int, now: float, estimate: Estimate, reading: Reading, nis: float, way: list[float]
    ) -> tuple[Action, Array, Estimate]:
        """Return the command of tick k, the reference of tick k, and the estimate, restarted if need be.

        way: the commands on their way.
        """
        if self._braking_since is not None:
            wanted = self._rows.references[k - 1]
            return self._brake(now, wanted), wanted, estimate
        lead = len(way)
        ahead = self.estimator.ahead(estimate, way)
        if self._rate_noise is not None:
            ahead = ahead.copy()
            ahead[self._arms : 2 * self._arms] += self._rate_noise[k]
        action = self.session.command(k + lead, ahead, estimate.extra)
        self._coming.append(action)
        wanted = self._coming.popleft().reference
        if action.event:
            self._event(now, "info", "controller", action.event)
        seen, due, expected = estimate.state.tolist(), wanted.tolist(), ahead.tolist()
        error = 0.0
        for i in self._angles:
            away = abs(seen[i] - due[i])
            # NaN must not be passed over.
            if not away <= error:
                error = away
        path, supervisor = self.path, self.supervisor
        sent = path.velocity
        verdict = supervisor.judge(
            now, error=error, nis=nis, used=estimate.used, position=expected[-2], velocity=expected[-1], sent=sent
        )
        stuck = ""
        if reading.present is None:
            stuck = self._sensors.seen(reading.positions.tolist(), due, sent, supervisor.nis)
        if stuck or reading.switch:
            verdict = supervisor.overruled(verdict, now, stuck=stuck, switch=bool(reading.switch))
        outcome, ending, why = verdict
        if outcome is _GO_ON:
            return action, wanted, estimate
        self._event(now, "warn", outcome.value, why)
        if outcome is Outcome.RESTART:
            return action, wanted, self.estimator.restarted(estimate, reading.positions)
        if outcome is Outcome.RESYNCHRONISE:
            moved = self.session.resynchronise(k + lead, ahead)
            self._event(now, "info", "re-synchronise", moved or "the controller has no clock to move")
            return action, wanted, estimate
        if outcome is Outcome.HOLD and self.fallback is not None:
            self.session, held = self.fallback.session(k + lead, ahead)
            self._coming.clear()
            self._coming.extend([action] * lead)
            self._event(now, "warn", "fallback", held)
            self.ending, self.reason = Ending.FELL_BACK, f"{why}; {held}"
            return action, wanted, estimate
        self.ending, self.reason = ending, why
        self._braking_since = now
        return self._brake(now, wanted), wanted, estimate

    def _brake(self, now: float, wanted: Array) -> Action:
        if self.path.velocity:
            self._braking_since = now
        return Action(0.0, self.path.braking(BRAKING), wanted, Mode.ABORTED)

    def _event(self, time_s: float, level: str, name: str, text: str) -> None:
        # Events stand among the ticks they belong to.
        self._flush(round(time_s / self.path.period))
        self.sink.event(time_s, level, name, text)

    def _flush(self, until: int) -> None:
        first = self._flushed
        if until > first:
            # Noted first, so that rows on which an interrupt falls are not written twice.
            self._flushed = until
            self.sink.ticks(self._rows.between(first, until))


@dataclass(frozen=True)
class LoopSettings(Settings, table="run"):
    """A run: rate Hz; initial_error rad, uniform ± on each angle of the true first state; mismatch of the plant's
    parameters (share); model_uncertainty: factor on the standard errors that the model's file gives, by which the plant
    is drawn besides; seed of all that is random. travel m: the cart's greatest distance from the centre, zero for the
    reference's own limit. keep: what keeps the stops of a walk planned so (`programs.KEEPERS`), while TVLQR flies.
    """

    seed: int = setting(least=0)
    rate: float = setting(1000.0, least=1, most=10_000, unit="Hz")
    initial_error: float = setting(0.0, least=0, most=np.pi, unit="rad")
    mismatch: float = setting(0.0, least=0, most=0.9)
    model_uncertainty: float = setting(0.0, least=0, most=100)
    travel: float = setting(0.0, least=0, most=1000, unit="m")
    keep: str = setting("none", choices=KEEPERS)
    controller: ControllerSettings = field(default_factory=TvlqrSettings)
    estimator: EstimatorSettings = field(default_factory=EkfSettings)
    sensors: SensorSettings = field(default_factory=SensorSettings)
    drive: DriveSettings = field(default_factory=DriveSettings)
    disturbances: DisturbanceSettings = field(default_factory=DisturbanceSettings)
    supervisor: SupervisorSettings = field(default_factory=SupervisorSettings)

    def __post_init__(self) -> None:
        """Check the bounds, and that what keeps the stops goes with the controller.

        Raises:
            InputError: names the setting, its value and what is allowed.
        """
        super().__post_init__()
        if self.keep != "none" and not isinstance(self.controller, TvlqrSettings):
            raise self.refusal("keep", f'what flies between the stops is "tvlqr", not "{self.controller.kind}"')

    @property
    def bench(self) -> BenchSettings:
        """What stands between the model and the world."""
        return BenchSettings(self.sensors, self.drive, self.disturbances)

    def draw(
        self,
        arms: ArmChainParameters,
        *,
        ticks: int,
        uncertainty: Uncertainty | None = None,
        plant: ArmChainParameters | None = None,
        **instead: Any,
    ) -> BenchDraw:
        """Return what is drawn for a run of `ticks` ticks with these arms as the model; see `draw_bench`.

        instead: seed or mismatch in place of the settings' own.
        """
        given = {"seed": self.seed, "mismatch": self.mismatch, **instead}
        return draw_bench(
            arms, self.bench, ticks=ticks, period=1 / self.rate, model_uncertainty=self.model_uncertainty,
            uncertainty=uncertainty, initial_error=self.initial_error, plant=plant, **given,
        )  # fmt: skip

    def limits(self, reference: Reference) -> Limits:
        """Return the cart's limits in this run: the reference's, with this travel where it is given."""
        return replace(reference.limits, position=self.travel) if self.travel else reference.limits


def sampled_model(parameters: ArmChainParameters, rate: float) -> SampledModel:
    """Return the cart-level model of these arms between ticks at `rate` Hz."""
    equations = arm_chain_equations(parameters.count, Level.CART, friction=parameters.friction)
    return SampledModel(equations, parameters.base(), period=1 / rate)


def loop_controller(reference: Reference, parameters: ArmChainParameters, settings: LoopSettings) -> Controller:
    """Return the controller of these settings, which any number of runs may share.

    Raises:
        InputError: the reference did not converge, or is not one of these arms.
        GoalMissed: no controller can be made for it.
    """
    model = sampled_model(parameters, settings.rate)
    return make_controller(
        reference, parameters, model, settings=settings.controller, estimator=settings.estimator, keep=settings.keep
    )


def loop_fallback(reference: Reference, parameters: ArmChainParameters, settings: LoopSettings) -> Fallback | None:
    """Return what these settings hold when tracking is lost, which any number of runs may share; None for nothing.

    Raises:
        InputError: the reference is of other arms.
        GoalMissed: an orbit was not found, or cannot be held.
    """
    if settings.supervisor.hold == "none":
        return None
    law = settings.controller
    flies = law if isinstance(law, TvlqrSettings) else TvlqrSettings()
    return nearest_keeper(reference, parameters, sampled_model(parameters, settings.rate), flies=flies)


def loop_supervisor(settings: LoopSettings, limits: Limits, *, can_hold: bool = False) -> Supervisor:
    """Return a supervisor for one run within `limits`."""
    period = 1 / settings.rate
    reaction = (settings.drive.delay + 1) * period
    return Supervisor(settings.supervisor, period, limits.position, limits.acceleration, reaction, can_hold=can_hold)


def control_loop(
    parameters: ArmChainParameters,
    settings: LoopSettings,
    controller: Controller,
    *,
    limits: Limits,
    believed_delay: float | None = None,
    rate_noise: Array | None = None,
    sink: LoopSink | None = None,
    fallback: Fallback | None = None,
    progress: Progress = no_progress,
) -> ControlLoop:
    """Return a loop for any rig, simulated or real; believed_delay in periods, the drive's own by default.

    rate_noise (K, n) rad/s: see `ControlLoop`.
    """
    # The estimator believes in the sensors' resolution and noise.
    noise, model = settings.sensors.covariance(parameters.count), sampled_model(parameters, settings.rate)
    estimator = make_estimator(settings.estimator, model, noise=noise)
    delay = settings.drive.delay if believed_delay is None else believed_delay
    return ControlLoop(
        estimator, controller, path=CommandPath(limits, delay=delay, period=1 / settings.rate),
        supervisor=loop_supervisor(settings, limits, can_hold=fallback is not None), sink=sink or NoSink(),
        rate_noise=rate_noise, fallback=fallback, progress=progress,
    )  # fmt: skip


def run_loop(
    reference: Reference,
    parameters: ArmChainParameters,
    *,
    settings: LoopSettings,
    controller: Controller | None = None,
    plant: ArmChainParameters | None = None,
    uncertainty: Uncertainty | None = None,
    sink: LoopSink | None = None,
    fallback: Fallback | None = None,
    progress: Progress = no_progress,
) -> LoopResult:
    """Track `reference` on a simulated bench, with `parameters` as the model of controller and estimator.

    controller, fallback: made before, by `loop_controller` and `loop_fallback` with the same settings, to spare making
    them for each of many seeds. plant: the arms to simulate; without it the model's, drawn from its `uncertainty` and
    mismatched by the settings.

    Raises:
        InputError: the reference did not converge, or is not one of these arms; an uncertainty is asked for and not
            known.
        GoalMissed: no controller can be made for it, or no plant drawn.
    """
    if controller is None:
        controller = loop_controller(reference, parameters, settings)
    if fallback is None:
        fallback = loop_fallback(reference, parameters, settings)
    limits, first = settings.limits(reference), controller.first_state
    if len(first) != 2 * parameters.count + 2:
        raise InputError(f"the controller is for states of {len(first)} entries, these arms have {parameters.count}")
    draw = settings.draw(parameters, ticks=controller.ticks + 1, uncertainty=uncertainty, plant=plant)
    loop = control_loop(
        parameters, settings, controller, limits=limits, rate_noise=draw.rate_noise, sink=sink, fallback=fallback,
        progress=progress,
    )  # fmt: skip
    rig = SimulatedRig(draw, settings.bench, limits=limits, start=first, queued=loop.queued)
    return replace(loop.run(rig), plant=draw.plant.arms)
