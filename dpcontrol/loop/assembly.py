"""Assemble the parts of a closed loop for any number of runs.

An assembly holds a reference, the arms of the model and the settings of a run. It builds the controller, fallback,
recovery, ticker and bench when they are first needed. Single runs, runs in lockstep, runs on a rig and the margins all
use these parts.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from dpcontrol.control.estimator_settings import Augment, EkfSettings, FilterSettings
from dpcontrol.control.handover import NearestKeeper
from dpcontrol.control.interface import MANY, Controller, Mode, SampledModel, sampled_model, schedule_of
from dpcontrol.control.lqr import HoldController, HoldSettings, QuadraticWeights, hold_controller
from dpcontrol.control.margins import Margins, NominalLoop, margins_of
from dpcontrol.control.tick import TickProgram, whole_periods
from dpcontrol.control.tracking import AdaptiveSettings, TvlqrSettings
from dpcontrol.dynamics.chain import ArmChainParameters, Uncertainty
from dpcontrol.dynamics.compiled import VECTOR
from dpcontrol.foundation.cache import cache_file, load_or_make
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import content_hash
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.loop.bench import BenchDraw, SensorSettings, StreamReader
from dpcontrol.loop.controllers import make_controller, make_estimator, nearest_keeper
from dpcontrol.loop.lockstep import Lockstep
from dpcontrol.loop.loop import ControlLoop, LoopSettings
from dpcontrol.loop.own import OwnEstimator, OwnLaw
from dpcontrol.loop.pilots import Briefing, DirectPilot, pilot_beside
from dpcontrol.loop.recovery import (
    RESTING,
    Departures,
    FallRecovery,
    RecoveryPlan,
    ScheduledController,
    braking_controller,
)
from dpcontrol.loop.result import BatchRun, LoopResult, LoopSink
from dpcontrol.loop.simulated import BatchBench, Encoders, SimulatedRig
from dpcontrol.loop.targets import goal_of, padded, reached, rest_goal
from dpcontrol.loop.ticker import Ticker
from dpcontrol.references.problem import Limits
from dpcontrol.references.reference import Reference

LAW = 1
"""Version of the adaptive controller, part of its cache key.

Raise it whenever its gains change: a test of golden gains fails until then.
"""
_PLACES = 100.0
"""Rate of the places of a reference at which a run can be caught, Hz."""
_HELD = 10.0
"""Simulated duration of a hold when its margins are computed, s."""


@dataclass(frozen=True, eq=False)
class Assembly:
    """Reference, model arms and settings of a run, from which the parts of its closed loop are made.

    The parts are built when they are first needed, and shared by all runs of the assembly.
    """

    reference: Reference
    arms: ArmChainParameters
    settings: LoopSettings
    uncertainty: Uncertainty | None = None
    """Uncertainty of the model, for settings that draw the plant from it."""
    law: Controller | None = None
    """Controller that replaces the one of the settings."""
    believed_delay: float | None = None
    """Delay that the loop assumes, in periods; None for the drive's delay."""
    stays: tuple[tuple[float, float], ...] = ()
    """Begin and end of the stay at each stop, s, for runs that return to it."""
    base: "Assembly | None" = None
    """Assembly whose fallback and recovery this one uses."""
    cached: bool = False
    """True to store an adaptive controller in the cache, since its tables take a second to compute."""

    def under(self, settings: LoopSettings) -> "Assembly":
        """Return an assembly that keeps this controller under other settings, so that many runs share one controller.

        It uses the same fallback and recovery if its supervisor and its drive's delay are the same.

        Args:
            settings: settings that differ in bench, supervisor or seed only.
        """
        old_settings = self.settings
        shares_recovery = (settings.supervisor, settings.drive.delay) == (
            old_settings.supervisor,
            old_settings.drive.delay,
        )
        return replace(self, settings=settings, law=self.controller, base=self if shares_recovery else None)

    @property
    def limits(self) -> Limits:
        """The cart's limits: those of the reference, with the travel of the settings if it is given."""
        return self.settings.limits(self.reference.limits)

    @property
    def delay(self) -> float:
        """The drive delay that the loop assumes, in periods."""
        return self.settings.drive.delay if self.believed_delay is None else self.believed_delay

    @property
    def model(self) -> SampledModel:
        """Model of arms and drive from tick to tick, which controller and filter use.

        It has no dry friction if a hold estimates disturbances, because the estimated disturbance includes it.
        """
        settings = self.settings
        omits_friction = (
            isinstance(settings.controller, HoldSettings) and Augment.DISTURBANCE in settings.filters.augments
        )
        arms = replace(self.arms, coulomb=()) if omits_friction else self.arms
        return sampled_model(arms, settings.rate, settings.known_lag)

    @cached_property
    def controller(self) -> Controller:
        """The given law, or that of the settings for the reference; all runs of the assembly follow it.

        Raises:
            InputError: the reference did not converge or belongs to other arms.
            GoalMissed: no controller exists for the reference.
        """
        settings, motion = self.settings, self.reference
        make = partial(
            make_controller, motion, self.arms, self.model, settings=settings.controller, estimator=settings.filters,
            keep=settings.keep,
        )  # fmt: skip
        if self.law or not self.cached or not isinstance(settings.controller, AdaptiveSettings):
            return self.law or make()
        inputs = (
            LAW, motion.method, motion.limits, self.arms, settings.rate, settings.known_lag, settings.controller,
            settings.filters,
        )  # fmt: skip
        key = content_hash(repr(inputs), *(array.tobytes() for array in (motion.mesh, motion.states, motion.inputs)))
        return load_or_make(cache_file("controllers", "adaptive", key), make)

    @cached_property
    def fallback(self) -> NearestKeeper | None:
        """The laws of which the nearest takes over if tracking is lost; None if the supervisor then stops the cart.

        Raises:
            GoalMissed: an orbit was not found or cannot be held.
        """
        if self.base is not None:
            return self.base.fallback
        if self.settings.supervisor.hold == "none":
            return None
        law = self.settings.controller
        tracking_settings = law if isinstance(law, TvlqrSettings) else TvlqrSettings()
        return nearest_keeper(self.reference, self.arms, self.model, flies=tracking_settings)

    @cached_property
    def recovery(self) -> RecoveryPlan | None:
        """The recovery from falls and the start from any state, or None if falls end runs that start as planned.

        Raises:
            InputError: the stays at the stops are unknown, or the controller has no time-indexed gains.
            GoalMissed: a stop or rest cannot be held.
        """
        if self.base is not None:
            return self.base.recovery
        supervisor, anywhere = self.settings.supervisor, self.settings.start != "planned"
        if supervisor.on_fall == "stop" and not anywhere:
            return None
        start, size = self.settings.start, self.model.dimension
        if not isinstance(start, str) and (len(start) != size or not np.isfinite(start).all()):
            raise InputError(
                f"run: start = {list(start)}: must be {size} finite numbers: angles, rates, and the cart's position "
                "and velocity"
            )
        gains = schedule_of(self.controller, whole_periods(self.settings.drive.delay)[1])
        if gains is None or gains.law is not None:
            key = "run: start" if anywhere else f'supervisor: on_fall = "{supervisor.on_fall}"'
            raise InputError(
                f"{key}: {self.controller.kind} as set here has no gains by time, so it cannot resume at a stop; use "
                '"adaptive", "lqr" or "tvlqr" by time, without keep'
            )
        model, limits, content = self.model, self.limits, self.reference.content
        every = max(1, round(self.settings.rate / _PLACES))
        coarse_model = sampled_model(self.arms, self.settings.rate / every)
        controller_settings = self.settings.controller
        law_weights = controller_settings if isinstance(controller_settings, QuadraticWeights) else TvlqrSettings()
        reach, targets = reached(self.reference, coarse_model, law_weights, every=every, limits=limits)
        stops = [
            goal_of(reach, targets, stay=stay, period=content.orbit(stop).period, rate=self.settings.rate)
            for stop, stay in zip(content.stops, self.stays, strict=True)
        ]
        rest_law = hold_controller(np.zeros(model.dimension), model, HoldSettings(damping=0.0), seconds=4 * RESTING)
        goals = (*stops, rest_goal(rest_law, limits))
        briefing = Briefing(self.arms, self.settings.rate, model.lag, limits, goals)
        last_orbit = content.orbit(content.stops[-1])
        braking = ScheduledController(padded(braking_controller(self.arms, model).schedule(0), gains), "brake")
        return RecoveryPlan(
            model, braking, briefing, DirectPilot(briefing),
            tuple(stop.saddle for stop in content.stops), content.symbols,
            last_orbit.curve[:, : model.arms], last_orbit.period, gains, padded(rest_law.schedule(0), gains), reach,
            supervisor.on_fall == "restart", 1 if supervisor.on_fall == "stop" else supervisor.attempts, anywhere,
        )  # fmt: skip

    def ticker(self, *, runs: int = 1) -> Ticker:
        """Return a new ticker: controller, estimator and supervisor of one run, or of several in lockstep.

        Args:
            runs: number of runs, default 1.
        """
        settings, controller, model, lead = self.settings, self.controller, self.model, whole_periods(self.delay)[1]
        # The estimator relies on the stated noise of sensors and drive.
        noise = settings.sensors.covariance(self.arms.count)
        filters = settings.filters.with_command_noise(
            settings.drive.command_noise, period=model.period, keeps=model.lag_keeps
        )
        schedule = schedule_of(controller, lead)
        program = TickProgram(
            model, filters, noise=noise, delay=self.delay, runs=runs,
            bounds=self._bounds(0.0 if schedule is None else schedule.trust),
            law=schedule, mechanics=settings.known_mechanics(self.arms.count),
        )  # fmt: skip
        compiled = isinstance(settings.estimator, EkfSettings)
        estimator = None if compiled else make_estimator(filters, model, noise=noise)
        kind = settings.estimator.kind
        return Ticker(program, controller, schedule=schedule, estimator=estimator, estimator_kind=kind)

    def _bounds(self, trust: float) -> dict[str, float]:
        """Return the numbers by which a tick is judged, by their names in `tick_parts.Numbers`.

        `trust` is the range in which an adaptive law trusts its estimates.
        """
        settings, limits, supervisor = self.settings, self.limits, self.settings.supervisor
        delay = settings.drive.delay
        return {
            "acceleration": limits.acceleration, "velocity": limits.velocity, "travel": limits.position,
            "reaction": (delay + 1) / settings.rate + settings.known_lag,
            # The predicted state is that at which a command acts, so it includes the delay.
            "onset": (delay - whole_periods(delay)[1] + 1) / settings.rate + settings.known_lag,
            "brake": 2 * supervisor.braking * limits.acceleration,
            "margin": supervisor.margin, "lost_tracking": supervisor.lost_tracking,
            "lost_estimate": supervisor.lost_estimate,
            "resynchronise": supervisor.resynchronise, "restarts": supervisor.restarts, "missing": supervisor.missing,
            "can_hold": supervisor.hold != "none",
            "trust": trust, "mode": Mode.TRACKING, "scale": settings.sensors.cart_resolution,
            "drive_noise": settings.drive.command_noise,
        }  # fmt: skip

    @contextmanager
    def recovery_beside(self) -> Iterator[RecoveryPlan | None]:
        """Yield the recovery with a pilot in a second process, for a bench in real time; None without recovery."""
        if self.recovery is None:
            yield None
            return
        with pilot_beside(self.recovery.briefing) as pilot:
            yield replace(self.recovery, pilot=pilot)

    def loop(
        self,
        *,
        sink: LoopSink | None = None,
        rate_noise: StreamReader | None = None,
        recovery: RecoveryPlan | None = None,
        until: int = 0,
        keep: bool = True,
        progress: Progress = no_progress,
    ) -> ControlLoop:
        """Return a loop for any rig, simulated or real.

        Args:
            sink: receiver of ticks and events, default none.
            rate_noise: noise (n, 1) added to the rates in each tick, rad/s.
            recovery: recovery from falls, by default `recovery` of this assembly.
            until: tick until which the itinerary repeats; 0 to run it once.
            keep: if False, rows are not kept in memory.
            progress: receiver of progress reports.
        """
        recovery, fallback = recovery or self.recovery, self.fallback
        fall_recovery = None if recovery is None else FallRecovery(recovery, self.controller, until=until)
        return ControlLoop(
            self.ticker(), limits=self.limits, sink=sink or LoopSink(), rate_noise=rate_noise, fallback=fallback,
            recovery=fall_recovery, keep=keep, progress=progress,
        )  # fmt: skip

    def draw(self, *, seed: int | None = None, mismatch: float | None = None) -> BenchDraw:
        """Draw plant, errors and disturbances of one run, with the ticks of this assembly's controller.

        Args:
            seed: seed of the random numbers, by default that of the settings.
            mismatch: relative error of the plant's parameters, by default that of the settings.
        """
        ticks = self.controller.ticks + 1
        return self.settings.draw(self.arms, ticks=ticks, uncertainty=self.uncertainty, seed=seed, mismatch=mismatch)

    def simulate(
        self,
        *,
        draw: BenchDraw | None = None,
        sink: LoopSink | None = None,
        recovery: RecoveryPlan | None = None,
        until: int = 0,
        keep: bool = True,
        progress: Progress = no_progress,
    ) -> LoopResult:
        """Run the loop on a simulated bench, whose plant is drawn about the model's arms, and return the result.

        Args:
            draw: draw of the run, by default that of the settings.
            sink: receiver of ticks and events, default none.
            recovery: recovery from falls, by default `recovery` of this assembly.
            until: tick until which the itinerary repeats after falls; 0 to run it once.
            keep: if False, rows are not kept in memory.
            progress: receiver of progress reports.

        Raises:
            InputError: the reference did not converge or belongs to other arms, or the settings need an uncertainty
                that is missing.
            GoalMissed: no controller exists for the reference, or no plant could be drawn.
        """
        recovers = (recovery or self.recovery) is not None
        draw = draw or self.draw()
        if recovers:
            draw = draw.endless()
        loop = self.loop(
            sink=sink, rate_noise=draw.reader("rate_noise", lambda rows: rows[:, :, None]), recovery=recovery,
            until=until, keep=keep, progress=progress,
        )  # fmt: skip
        start = self.settings.start
        rig = SimulatedRig(
            draw,
            self.settings.bench,
            limits=self.limits,
            start=self.controller.first_state if isinstance(start, str) else np.array(start),
            queued=loop.queued,
        )
        return replace(loop.run(rig), plant=draw.plant.arms, hardest=rig.hardest)

    @property
    def lockstep(self) -> bool:
        """True if runs can be computed in lockstep: settings and law must support it."""
        law_supports_it = hasattr(self.controller, "schedule") or hasattr(self.controller, "begin_many")
        return self.settings.lockstep and law_supports_it

    def batch(self, seeds: Sequence[int], *, mismatches: Sequence[float] | None = None) -> list[BatchRun]:
        """Run the seeds in lockstep and return their results in order, each up to a departure from the itinerary.

        Args:
            seeds: one seed per run.
            mismatches: one mismatch per run, default that of the settings.
        """
        # Only full vectors of the processor are used. Partial ones round differently and would affect the other runs.
        run_mismatches = [self.settings.mismatch] * len(seeds) if mismatches is None else mismatches
        seeds_and_mismatches = [*zip(seeds, run_mismatches, strict=True)]
        seeds_and_mismatches += [seeds_and_mismatches[-1]] * (-len(seeds_and_mismatches) % VECTOR)
        draws = [self.draw(seed=seed, mismatch=mismatch) for seed, mismatch in seeds_and_mismatches]
        ticker = self.ticker(runs=len(seeds_and_mismatches))
        bench = BatchBench(
            draws, self.settings.bench, limits=self.limits, start=self.controller.first_state,
            queued=list(ticker.queued), lanes=MANY,
        )  # fmt: skip
        departures = Departures(self.recovery, len(seeds_and_mismatches)) if self.recovery is not None else None
        return Lockstep(ticker, bench, draws, departures).run()[: len(seeds)]

    def margins(self) -> Margins:
        """Return the margins of this loop along the reference: changes of gain, delay and lag that make it unstable.

        Delay and lag are those beyond the assumed ones. The plant has the parameters of the model. Any filter other
        than the extended one is replaced by it, with the same settings.

        Raises:
            InputError: the law goes by phase or by pulses, or the reference belongs to other arms.
            GoalMissed: no controller exists.
        """
        # The plant has the parameters of the model, also instead of a user's plant.
        settings = replace(self.settings, plant=None)
        if isinstance(settings.controller, OwnLaw) or isinstance(settings.estimator, OwnEstimator):
            raise InputError("margins need symbolic equations, which Python objects do not provide; remove the object")
        if not isinstance(settings.estimator, EkfSettings):
            filter_settings = {
                setting.name: getattr(settings.estimator, setting.name)
                for setting in fields(FilterSettings)
                if setting.name != "kind"
            }
            settings = replace(settings, estimator=EkfSettings(**filter_settings))
        # To first order, a known belt with its input shaping is a lag, and play has no effect.
        unshaped = replace(settings.mechanics, known_belt=0.0, known_play=0.0)
        settings = replace(settings, drive_lag=settings.known_lag, mechanics=unshaped)
        law: Any = self.controller
        law_or_hold = replace(law, ticks=round(_HELD * settings.rate)) if isinstance(law, HoldController) else law
        schedule = schedule_of(law_or_hold, whole_periods(self.delay)[1])
        if schedule is None:
            raise InputError(
                f'controller: kind = "{law.kind}" goes by phase or by pulses, and margins are simulated by the clock; '
                "vary the drive in a campaign instead: `campaign NAME --over lag=0,0.01`"
            )
        nominal = replace(self, settings=settings, law=law_or_hold)
        plant = sampled_model(self.arms, settings.rate, settings.known_lag)
        bench_sensors = settings.sensors
        sensors = SensorSettings(counts=bench_sensors.counts, cart_resolution=bench_sensors.cart_resolution)
        encoders = Encoders(self.arms.count, sensors, lanes=MANY)
        loop = NominalLoop(
            plant, lambda n: nominal.ticker(runs=n).program, lambda states: encoders.measure([*states]), schedule,
            self.delay, self.limits,
        )  # fmt: skip
        return margins_of(loop)
