"""Controller and estimator of runs: from a reading to a report.

With tabulated gains and the compiled filter, one call of `TickProgram` computes a tick. A law with an internal clock is
called between the two parts of a tick. Another estimator replaces the first part.
"""

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from dpcontrol.control.ekf import unpacked
from dpcontrol.control.estimator_settings import Augment, constants
from dpcontrol.control.handover import NearestKeeper
from dpcontrol.control.interface import Controller, Estimate, Estimator, GainSchedule, schedule_of
from dpcontrol.control.tick import UNROLLED, TickProgram
from dpcontrol.control.tick_parts import Outcome, Report
from dpcontrol.foundation.arrays import Array
from dpcontrol.loop.own import OwnController, OwnEstimates, OwnFailure, OwnSession, wrong_command
from dpcontrol.loop.protocols import Reading

_SCALE_SECONDS = 0.01
"""Interval over which the cart's velocity is computed from its scale, s."""
_VELOCITY, _VELOCITY_SHARE = 0.1, 0.1
"""Maximum difference between scale and estimate for the velocity to be reported: m/s, and a share."""


class Ticker:
    """The ticks of one run, or of many in lockstep: each converts a reading to a command.

    It joins the compiled tick (`TickProgram`), the law and the estimator, and stores the references that the ticks
    follow.

    Args:
        program: compiled tick for one run, or for S runs in lockstep.
        controller: the law that is followed first.
        schedule: gains of the controller, or None if it has an internal clock.
        estimator: replacement for the compiled filter, for a single run.
        estimator_kind: name of the estimator's kind, for the log.
    """

    def __init__(
        self,
        program: TickProgram,
        controller: Controller,
        *,
        schedule: GainSchedule | None,
        estimator: Estimator | None = None,
        estimator_kind: str,
    ) -> None:
        """Store the parts, and prepare the first tick.

        `_schedule` and `_rows` hold the gains by tick of a law without an internal clock; `_session` is a law with one.
        `_row` names the parts of the compiled tick's input for gains and references. `_own` is a user's estimator, and
        `_judged` False once its lack of standard deviations has been reported.

        `lead` is the number of ticks from a reading to the action of its command, and `count` the number of ticks of
        the present controller. `_uses_switch` is False while the limit switches must not stop the run, as in braking.
        """
        self.program, self.controller, self.estimator = program, controller, estimator
        self._own = estimator if isinstance(estimator, OwnEstimates) else None
        self._judged = True
        self._has_own = self._own is not None or isinstance(controller, OwnController)
        self.watched = self._has_own or program.equations.own is not None
        """True if a user's law or estimator takes part, which may fail."""
        self.kind, self.estimator_kind = controller.kind, estimator_kind
        self.lead, self.report = program.lead, program.report
        self._arms, self._n = program.model.arms, program.model.dimension
        self._measured = np.array(program.equations.measured)
        self.count, self._many = controller.ticks + 1, program.runs > 1
        self._schedule = schedule
        self._row = program.equations.row.of(program.row)
        self.whole = schedule is not None and estimator is None and self.lead <= UNROLLED
        """True if a tick is one call."""
        self.event = ""
        """The law's decision in the last tick, as a sentence for the log, or ""."""
        self._uses_switch = True
        self.began = 0
        """The tick at which the present controller started; `references` begin there."""
        self.begin()

    @property
    def failure(self) -> OwnFailure | None:
        """The error of a user's law or estimator in the last tick, or None."""
        if self.report.own.size and (command_error := wrong_command(self.kind, self.report.own.item(0))):
            return command_error
        law_error = self._session.failure if isinstance(self._session, OwnSession) else None
        return law_error or (None if self._own is None else self._own.failure)

    @property
    def extra_names(self) -> tuple[str, ...]:
        """Names (E,) of the parameters that are estimated in addition to the state."""
        return self.program.equations.filter.extra_names

    @property
    def constants(self) -> tuple[list[Any], ...] | None:
        """Names (C,), values (C,) and covariances (C, C), now and at the start, of the model's constant errors.

        The log of a run stores them, so that a next run can begin with a better model. The result is None unless the
        compiled filter estimates parameters.

        Their order is that of `estimator_settings.constants`; errors of parameters are logarithms.
        """
        settings, memory = self.program.settings, self.program.memory
        if self.estimator is not None or Augment.PARAMETERS not in settings.augments:
            return None
        names = list(constants(self._arms, settings.augments))
        last_entries = np.s_[-len(names) :, -len(names) :]
        first, last = (
            settings.first_covariance(self._arms)[last_entries],
            unpacked(memory.covariance[:, 0])[last_entries],
        )
        return names, memory.z[-len(names) :, 0].tolist(), last.tolist(), first.tolist()

    def begin(self) -> None:
        """Prepare the first tick: reset estimator and memory, and compute the commands that are pending at the start.

        Pending commands are those that act before the first tick's command, because the drive has a delay of `lead`
        periods. `_carts` stores the last positions of the cart by its scale, m, and `_coming` the references of a law
        with an internal clock until the ticks at which its commands act. `_lift` is added to the rows of gains, to turn
        their angles by whole turns. `_estimate` is the last estimate of an estimator that replaces the compiled filter.
        """
        program, first = self.program, self.controller.first_state
        self._session: Any = None
        self._carts = np.full((max(1, round(_SCALE_SECONDS / program.period)) + 1, program.lanes), np.nan)
        self._coming: deque[Array] = deque()
        if self.estimator is not None:
            self._estimate: Estimate = self.estimator.first(first)
        if self._schedule is not None:
            self.references: Array = self._schedule.references
            """References (K, N) of each tick; only angles (K, n, runs) if each run has its own clock."""
            self._rows = self._schedule.rows[:, :, None]
            self._lift = np.zeros(self._rows.shape[1:])
            self.queued = self._schedule.queued[:, None]
            program.bound(mode=float(self._schedule.mode))
        else:
            self._session = self._begun()
            self.references = np.empty((self.count, self._arms, program.runs) if self._many else (self.count, self._n))
            # Pending commands act before the first tick's own command; each is computed for the state that the
            # previous ones lead to. All lanes begin with the same state, without errors of estimated parameters.
            extras = np.zeros(program.equations.filter.dimension - self._n)
            prediction = program.spread(np.concatenate([first, extras])[:, None])
            queued, drive = [], np.zeros(program.lanes)
            for k in range(self.lead):
                feedforward, feedback = self._call_law(k, prediction[: self._n], prediction[self._n :])
                queued.append(np.broadcast_to(feedforward + feedback, program.lanes))
                prediction, drive = program.moved(prediction, drive, queued[-1])
            self.queued = np.array(queued).reshape(self.lead, program.lanes)[:, : program.runs]
        program.begin(first, self.queued, velocity=float(first[-1]))
        # Compiled now, since there is no time for it in the first tick.
        program.prepare(["tick"] if self.whole else self._parts)

    @property
    def _parts(self) -> list[str]:
        """Names of the compiled functions that `_by_parts` needs; a replaced estimator needs no filter."""
        return ["judge", "moved"] if self.estimator is not None else ["sense", "moved", "finish"]

    def prepare_to_hold(self) -> None:
        """Compile the functions of ticks after the reference is abandoned: a late compilation would miss deadlines."""
        self.program.prepare(self._parts)

    def _begun(self) -> Any:
        """Return a new session of a law with an internal clock: an object that computes its commands in one run.

        A law with `begin_after` is told how many first commands no reading precedes (`lead`). Runs in lockstep share
        one session, whose commands are arrays.
        """
        law: Any = self.controller
        if not self._many:
            return law.begin_after(self.lead) if hasattr(law, "begin_after") else law.begin()
        return law.begin_many(self.program.runs)

    def _call_law(self, tick: int, ahead: Array, extra: Array) -> tuple[Any, Any]:
        """Return feedforward and feedback, m/s², of a law with an internal clock, and queue its reference in `_coming`.

        Args:
            tick: the tick in which the command acts.
            ahead: predicted states (N, lanes) at that tick.
            extra: estimated further parameters (E, lanes).

        Returns:
            Numbers for one run, or arrays (lanes,) for runs in lockstep.
        """
        if self._many:
            feedforward, feedback, references = self._session.commands(tick, ahead, extra)
            self._coming.append(references[: self._arms].reshape(self._arms, -1))
            return feedforward, feedback
        action = self._session.command(tick, ahead[:, 0].copy(), extra[:, 0].copy())
        self._coming.append(action.reference)
        self.event = action.event
        self.program.bound(mode=float(action.mode))
        return action.feedforward, action.feedback

    def __call__(self, k: int, reading: Reading, rate_error: Array | None = None) -> Report:
        """Compute tick k and return its report, parts (length, lanes).

        The next tick overwrites the report.

        Args:
            k: tick.
            reading: reading of that tick.
            rate_error: error (n, 1) or (n, lanes) added to the rates that the law receives, rad/s.
        """
        program = self.program
        positions = reading.positions if self._many else reading.positions[:, None]
        switch = reading.switch if self._uses_switch else 0
        program.take(positions, reading.present, switch, rate_error, reading.age)
        cart_position = (
            positions[-1] if reading.present is None else np.where(reading.present[-1], positions[-1], np.nan)
        )
        # A ring of the last positions, from which `figures` computes a velocity.
        self._carts[k % len(self._carts)] = cart_position
        if self.whole:
            np.add(self._rows[k - self.began], self._lift, out=program.row)
            program.tick()
            return self.report
        return self._by_parts(k - self.began, reading)

    def seen(self, reading: Reading) -> Reading:
        """Return a reading in which the angles of arms without an encoder are missing: NaN and not present.

        Args:
            reading: reading of one run.
        """
        if self._measured.all():
            return reading
        present = self._measured if reading.present is None else self._measured & reading.present
        return reading._replace(positions=np.where(self._measured, reading.positions, np.nan), present=present)

    def rows_of(self, k: int, count: int, out: Array) -> None:
        """Write the gains and references of several ticks into the rows that `Blocks` computes at once.

        Args:
            k: the first tick.
            count: number of ticks.
            out: array (count, size, lanes) for the inputs `TickEquations.row`, which are gains and reference of a tick.
        """
        rows = self._rows[k - self.began :][:count, :, 0] + self._lift[:, 0]
        # Lane by lane, since numpy's innermost loop would be over the two lanes.
        for lane in range(out.shape[2]):
            out[:count, :, lane] = rows

    def take_carts(self, k: int, carts: Array) -> None:
        """Store the cart's positions after a block, from which `figures` computes the velocity of its scale.

        Args:
            k: the first tick of the block.
            carts: positions (K,) of the cart from that tick on, m, NaN where missing.
        """
        length = len(self._carts)
        for i, cart in enumerate(carts[-length:].tolist(), k + max(len(carts) - length, 0)):
            self._carts[i % length] = cart

    def _by_parts(self, k: int, reading: Reading) -> Report:
        """Compute a tick in two parts, with the law or another estimator called between them, and return its report.

        `k` is the number of ticks since the present controller started. A law without an internal clock has no
        `_session`, and its gains and references for the tick are row k of `_rows`; `_lift` adds whole turns to it. A
        law with an internal clock acts `lead` ticks later, and `_coming` stores its references until then.

        `sensed` is the output of the tick's first part, which begins with the estimate (N+E, lanes). `ahead` is the
        state (N, lanes) at which the command acts, and `drive` the acceleration of a lagging drive then, m/s².
        """
        program = self.program
        if self.estimator is None:
            sensed = program.sense()
            estimate = sensed[: program.equations.filter.dimension]
            ahead, drive = program.look_ahead(estimate)
        else:
            sensed, ahead, drive = self._estimated(self.estimator, k + self.began, reading)
            estimate = sensed[: program.equations.filter.dimension]
        feedback: Any = 0.0
        if self._session is None:
            np.add(self._rows[k], self._lift, out=program.row)
        elif not self._many and program.memory.stopped[0, 0]:
            # The cart is braking, and a single run no longer calls the law. In lockstep, other runs still do.
            self.references[k] = self.references[k - 1]
        else:
            self.event = ""
            feedforward, feedback = self._call_law(k + self.lead, ahead, estimate[self._n :])
            references = self._coming.popleft()
            self._row.feedforward[:] = feedforward
            self.references[k] = references
            self._row.wanted[:] = references if self._many else references[: self._arms, None]
        program.finish(sensed, ahead, drive, feedback, predicts=self.estimator is None)
        if self.estimator is not None and self.report.outcome[0, 0] == Outcome.RESTART:
            self._estimate = self.estimator.restarted(self._estimate, reading.positions)
        # A user's estimator without standard deviations has no NIS, which is reported once.
        if self._own is not None and not self._own.judged:
            self.report.nis[:] = math.nan
            if self._judged:
                self.event = f"{self._own.kind} has no sigmas: NIS and the check of the estimate are off"
            self._judged = False
        return self.report

    def _estimated(self, estimator: Estimator, k: int, reading: Reading) -> tuple[Array, Array, Array]:
        """Return the estimate by an estimator that replaces the compiled filter, as input of the second part of a tick.

        Args:
            estimator: the replacement.
            k: tick of the run.
            reading: reading of this tick.

        Returns:
            Sensed values as those of `TickProgram.sense`, the state (N, lanes) at which the command acts, and the
                acceleration of a lagging drive then, m/s². An estimator that fails leaves the estimate as it was, with
                `sound` 0.
        """
        program, last_estimate = self.program, self._estimate
        means, drive = program.pending_accelerations()
        pending = [float(mean[0]) for mean in means]
        sound = 1.0
        try:
            if k:
                if self._own is not None:
                    # A user's estimator receives the command, and the model the acceleration that acts.
                    self._own.sends(self.report.command.item(0))
                estimate = estimator.step(last_estimate, self.report.acting.item(0), reading.positions, reading.present)
            else:
                estimate = estimator.update(last_estimate, reading.positions, reading.present)
            self._estimate = estimate
        except ArithmeticError:
            estimate, sound = last_estimate, 0.0
        ahead = estimator.ahead(estimate, pending)
        sensed = program.equations.sensed.filled(
            program.lanes, z=np.concatenate([estimate.state, estimate.extra]), sigmas=estimate.sigmas,
            nis=estimate.nis if sound else np.nan, used=estimate.used, sound=sound,
        )  # fmt: skip
        return sensed, program.with_rate_error(program.spread(ahead[:, None])), drive

    def hold(self, k: int, fallback: NearestKeeper) -> str:
        """Abandon the reference from the tick after k on, and hold the nearest orbit or equilibrium.

        Return a description of what is held, for the log.

        The ticker must have a single run. From then on, a tick consists of several calls, because the fallback's law is
        not part of the compiled tick.

        Args:
            k: tick.
            fallback: laws that hold orbits and equilibria.
        """
        self._session, description = fallback.session(k + self.lead, self.report.ahead[:, 0].copy())
        # From here on, k counts from the start of the present controller, like the references.
        k -= self.began
        reference = self.references[k].copy()
        self.references = np.concatenate([self.references[: k + 1], np.empty((self.count - k - 1, self._n))])
        # The new law's references begin when its first command acts; until then, the present one stays.
        self._coming.clear()
        self._coming.extend([reference] * self.lead)
        # The gains of the row no longer apply.
        self.program.row[:] = 0.0
        self.whole = False
        return description

    def follow(
        self,
        k: int,
        controller: Controller,
        *,
        lift: Array,
        bounds: Mapping[str, float],
        uses_switch: bool = True,
    ) -> None:
        """Follow another controller from the next tick k.

        The ticker must have a single run.

        The filter and the pending commands continue. The supervisor's memory is reset: its means, its restarts of the
        filter, and a stop or hold. Until the first command of a law with an internal clock acts, the present estimate
        is its reference.

        Args:
            k: the next tick.
            controller: controller to follow.
            lift: whole turns (n,) added to its angles, rad.
            bounds: numbers of the supervisor that change, by their names in `tick_parts.Numbers`.
            uses_switch: if False, the limit switches do not stop the run.
        """
        program = self.program
        self._uses_switch = uses_switch
        memory = program.memory
        for values in (
            memory.error,
            memory.restarts,
            memory.held,
            memory.moved,
            memory.stopped,
            memory.still,
            memory.silent,
        ):
            values[:] = 0.0
        program.bound(**bounds)
        self.controller, self.kind, self.began = controller, controller.kind, k
        self.count = controller.ticks + 1
        self._schedule = schedule = schedule_of(controller, self.lead)
        self.whole = schedule is not None and self.estimator is None and self.lead <= UNROLLED
        program.row[:] = 0.0
        self._coming.clear()
        if schedule is None:
            self._session = self._begun()
            state = self.report.state[:, 0].copy()
            self.references = np.tile(state, (self.count, 1))
            self._coming.extend([state] * self.lead)
            return
        self._session, self._rows, self.references = None, schedule.rows[:, :, None], schedule.references.copy()
        self.references[:, : self._arms] += lift
        # The table of gains is long, so whole turns are added to each row in its own tick. They apply to the states
        # from which gains measure deviations, and to the angles of which the supervisor measures the distance.
        self._lift = np.zeros(self._rows.shape[1:])
        lifted = program.equations.row.of(self._lift)
        lifted.state[: self._arms] = lifted.wanted[:] = lift[:, None]
        program.bound(mode=float(schedule.mode))

    def lose(self) -> None:
        """Restart the filter at the next reading with a wide covariance, because its estimate has become wrong.

        An estimator that replaces the compiled filter restarts now, with the last measured positions.
        """
        self.program.memory.restart[:], self.program.memory.nis[:] = 1.0, 0.0
        if self.estimator is not None:
            measured = self.program.reading.measured[:, 0].copy()
            self._estimate = self.estimator.restarted(self._estimate, measured)

    def resynchronise(self, k: int) -> str:
        """Move the law's clock to the reference's phase nearest to the state, because the run is early or late.

        Args:
            k: tick.

        Returns:
            A sentence, or "" if the law has no internal clock.
        """
        if self._session is None:
            return ""
        return self._session.resynchronise(k + self.lead, self.report.ahead[:, 0].copy())

    def freeze_reference(self, k: int) -> None:
        """Keep the reference constant from tick k on, because a braking cart no longer follows it.

        Logs and scores then compare with the place where the motion was abandoned.

        Args:
            k: tick.
        """
        if self._session is None:
            references = self.references.copy()
            references[k - self.began :] = references[k - self.began]
            self.references = references

    def brake(self, k: int) -> None:
        """Brake the cart to a standstill from the tick after k on, by a decision of the recovery.

        Args:
            k: tick.
        """
        self.program.memory.stopped[:] = float(Outcome.TRACKING_LOST)
        self.freeze_reference(k)

    def correct_velocity(self, velocity: float) -> None:
        """Replace the cart's commanded velocity, from which the tick computes limits and braking.

        A drive does not follow its commands exactly, so the commanded velocity can differ from the actual one.

        Args:
            velocity: velocity of the cart, m/s.
        """
        self.program.memory.velocity[:] = velocity

    def rehearse(self) -> None:
        """Compute some ticks and discard them, so that all code is loaded before the first deadline of a real bench.

        Users' objects are not called, because they may have a state.
        """
        if self._has_own:
            return
        reading = Reading(0.0, self.controller.first_state[self.program.model.position_indices])
        for k in range(min(50, self.count)):
            self(k, reading)
        self.begin()
        if self.whole:
            # `begin` has replaced some arrays, which the tick loads again.
            first_memory = self.program.stored.copy()
            self(0, reading)
            self.program.stored[:] = first_memory

    def untrusted(self) -> Mapping[str, Any]:
        """Return name, share and trust of the parameter whose estimate left the range in which the law trusts it."""
        schedule, index = self._schedule, int(self.report.untrusted.item(0)) - 1
        assert schedule is not None
        share = self.report.extra.item(index, 0)
        return {"parameter": schedule.names[index], "share": share, "trust": float(schedule.trust)}

    def figures(self, k: int, lane: int = 0) -> Mapping[str, float]:
        """Return the numbers of the last tick that explain an outcome.

        time        s, of the tick
        distance    rad, of the angle farthest from the reference, as measured if possible
        apart       rad, of the estimated angle farthest from its reading
        position    m, of the cart
        velocity    m/s, of the cart; NaN if its scale contradicts it
        sensor      number of the sensor with a constant reading, 0 for the cart's scale
        repeated    s, for which that sensor has given this reading

        Args:
            k: the last tick.
            lane: number of the run, default 0.
        """
        report, references, arms = self.report, self.references[k - self.began], self._arms
        state = report.state[:, lane]
        angles = state[:arms]
        reference_angles = references[:arms] if references.ndim == 1 else references[:, lane]
        measured = self.program.reading.measured[:arms, lane]
        differences = measured - angles
        aligned_angles = measured - 2 * np.pi * np.rint(differences / (2 * np.pi))
        present = self.program.reading.present[:arms, lane] > 0
        sensor, period = int(report.sensor.item(lane)), self.program.period
        velocity, length = state.item(self._n - 1), len(self._carts)
        travel = self._carts[k % length, lane] - self._carts[(k + 1) % length, lane]
        scale_velocity = travel / ((length - 1) * period)
        velocities_agree = abs(velocity - scale_velocity) <= _VELOCITY + _VELOCITY_SHARE * abs(scale_velocity)
        names = ("mean_nis", "error", "silent", "wish", "command", "untrusted", "newly_cut")
        return {
            **{name: getattr(report, name).item(lane) for name in names},
            "distance": float(np.abs(np.where(present, aligned_angles, angles) - reference_angles).max()),
            "apart": float(np.abs(differences[present]).max(initial=0.0)),
            "position": state.item(self._n - 2), "velocity": velocity if velocities_agree else math.nan,
            "sensor": sensor if sensor <= arms else 0, "repeated": report.repeats.item(lane) * period,
            "time": k * period,
        }  # fmt: skip
