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
    """The ticks of one run, or of many in lockstep.

    The program decides the number of runs.

    Args:
        schedule: gains of the controller, or None if it has an internal clock.
        estimator: replacement for the compiled filter, for a single run.
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
        """The error of a user's law or estimator in the last tick."""
        if self.report.own.size and (wrong := wrong_command(self.kind, self.report.own.item(0))):
            return wrong
        session = self._session.failure if isinstance(self._session, OwnSession) else None
        return session or (None if self._own is None else self._own.failure)

    @property
    def extra_names(self) -> tuple[str, ...]:
        """Names of the parameters that are estimated in addition to the state."""
        return self.program.equations.filter.extra_names

    @property
    def constants(self) -> tuple[list[Any], ...] | None:
        """Names (C,), values (C,) and covariances (C, C), now and at the start, of the model's constant errors.

        The result is None unless the compiled filter estimates parameters.

        Their order is that of `estimator_settings.constants`; errors of parameters are logarithms.
        """
        settings, memory = self.program.settings, self.program.memory
        if self.estimator is not None or Augment.PARAMETERS not in settings.augments:
            return None
        names = list(constants(self._arms, settings.augments))
        part = np.s_[-len(names) :, -len(names) :]
        before, now = settings.first_covariance(self._arms)[part], unpacked(memory.covariance[:, 0])[part]
        return names, memory.z[-len(names) :, 0].tolist(), now.tolist(), before.tolist()

    def begin(self) -> None:
        """Begin a run."""
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
            # previous ones lead to.
            rest = np.zeros(program.equations.filter.dimension - self._n)
            z = program.spread(np.concatenate([first, rest])[:, None])
            queued, drive = [], np.zeros(program.lanes)
            for k in range(self.lead):
                forward, back = self._call_law(k, z[: self._n], z[self._n :])
                queued.append(np.broadcast_to(forward + back, program.lanes))
                z, drive = program.moved(z, drive, queued[-1])
            self.queued = np.array(queued).reshape(self.lead, program.lanes)[:, : program.runs]
        program.begin(first, self.queued, velocity=float(first[-1]))
        # Compiled now, since there is no time for it in the first tick.
        program.prepare(["tick"] if self.whole else self._parts)

    @property
    def _parts(self) -> list[str]:
        """The functions that a tick in parts needs."""
        return ["judge", "moved"] if self.estimator is not None else ["sense", "moved", "finish"]

    def prepare_to_hold(self) -> None:
        """Compile everything that is needed after the reference is abandoned."""
        self.program.prepare(self._parts)

    def _begun(self) -> Any:
        """Return a new session of the law, for one run or all."""
        law: Any = self.controller
        if not self._many:
            return law.begin_after(self.lead) if hasattr(law, "begin_after") else law.begin()
        return law.begin_many(self.program.runs)

    def _call_law(self, tick: int, ahead: Array, extra: Array) -> tuple[Any, Any]:
        """Return the session's feedforward and feedback for `tick`, and store its reference."""
        if self._many:
            forward, back, wanted = self._session.commands(tick, ahead, extra)
            self._coming.append(wanted[: self._arms].reshape(self._arms, -1))
            return forward, back
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
        cart = positions[-1] if reading.present is None else np.where(reading.present[-1], positions[-1], np.nan)
        self._carts[k % len(self._carts)] = cart
        if self.whole:
            np.add(self._rows[k - self.began], self._lift, out=program.row)
            program.tick()
            return self.report
        return self._by_parts(k - self.began, reading)

    def seen(self, reading: Reading) -> Reading:
        """Return a reading without the angles of arms that have no encoder.

        Args:
            reading: reading of one run.
        """
        if self._measured.all():
            return reading
        present = self._measured if reading.present is None else self._measured & reading.present
        return reading._replace(positions=np.where(self._measured, reading.positions, np.nan), present=present)

    def rows_of(self, k: int, count: int, out: Array) -> None:
        """Write the rows of ticks from k on into `out` (count, size, lanes)."""
        rows = self._rows[k - self.began :][:count, :, 0] + self._lift[:, 0]
        # Lane by lane, since numpy's innermost loop would be over the two lanes.
        for lane in range(out.shape[2]):
            out[:count, :, lane] = rows

    def take_carts(self, k: int, carts: Array) -> None:
        """Store the cart's last positions, m, of which those from tick k on are (K,), NaN where missing."""
        span = len(self._carts)
        for i, cart in enumerate(carts[-span:].tolist(), k + max(len(carts) - span, 0)):
            self._carts[i % span] = cart

    def _by_parts(self, k: int, reading: Reading) -> Report:
        """Compute the tick that is k ticks after the present controller started.

        `_lift` adds whole turns to the rows of the schedule. A law with an internal clock acts `lead` ticks later, and
        `_coming` stores its references until then.
        """
        program = self.program
        if self.estimator is None:
            sensed = program.sense()
            z = sensed[: program.equations.filter.dimension]
            ahead, drive = program.look_ahead(z)
        else:
            sensed, ahead, drive = self._estimated(self.estimator, k + self.began, reading)
            z = sensed[: program.equations.filter.dimension]
        back: Any = 0.0
        if self._session is None:
            np.add(self._rows[k], self._lift, out=program.row)
        elif not self._many and program.memory.stopped[0, 0]:
            # The cart is braking, and a single run no longer calls the law. In lockstep, other runs still do.
            self.references[k] = self.references[k - 1]
        else:
            self.event = ""
            forward, back = self._call_law(k + self.lead, ahead, z[self._n :])
            wanted = self._coming.popleft()
            self._row.feedforward[:] = forward
            self.references[k] = wanted
            self._row.wanted[:] = wanted if self._many else wanted[: self._arms, None]
        program.finish(sensed, ahead, drive, back, predicts=self.estimator is None)
        if self.estimator is not None and self.report.outcome[0, 0] == Outcome.RESTART:
            self._estimate = self.estimator.restarted(self._estimate, reading.positions)
        if self._own is not None and not self._own.judged:
            self.report.nis[:] = math.nan
            if self._judged:
                self.event = f"{self._own.kind} has no sigmas: NIS and the check of the estimate are off"
            self._judged = False
        return self.report

    def _estimated(self, estimator: Estimator, k: int, reading: Reading) -> tuple[Array, Array, Array]:
        """Return sensed values, predicted state and `drive`, by another estimator.

        The values are those of `TickProgram.sense`.
        """
        program, before = self.program, self._estimate
        means, drive = program.pending_accelerations()
        way = [float(mean[0]) for mean in means]
        sound = 1.0
        try:
            if k:
                if self._own is not None:
                    self._own.sends(self.report.command.item(0))
                now = estimator.step(before, self.report.acting.item(0), reading.positions, reading.present)
            else:
                now = estimator.update(before, reading.positions, reading.present)
            self._estimate = now
        except ArithmeticError:
            now, sound = before, 0.0
        ahead = estimator.ahead(now, way)
        sensed = program.equations.sensed.filled(
            program.lanes, z=np.concatenate([now.state, now.extra]), sigmas=now.sigmas,
            nis=now.nis if sound else np.nan, used=now.used, sound=sound,
        )  # fmt: skip
        return sensed, program.with_rate_error(program.spread(ahead[:, None])), drive

    def hold(self, k: int, fallback: NearestKeeper) -> str:
        """Abandon the reference and return the name of the held orbit.

        The ticker must have a single run.

        Args:
            k: tick.
            fallback: laws that hold orbits and equilibria.
        """
        self._session, held = fallback.session(k + self.lead, self.report.ahead[:, 0].copy())
        k -= self.began
        now = self.references[k].copy()
        self.references = np.concatenate([self.references[: k + 1], np.empty((self.count - k - 1, self._n))])
        self._coming.clear()
        self._coming.extend([now] * self.lead)
        # The gains of the row no longer apply.
        self.program.row[:] = 0.0
        self.whole = False
        return held

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

        The filter and the pending commands continue. The supervisor's memory is reset.

        Args:
            k: the next tick.
            controller: controller to follow.
            lift: whole turns (n,) added to its angles, rad.
            bounds: new values of `tick_parts.Numbers`.
            uses_switch: if False, the end switches do not stop the run.
        """
        program = self.program
        self._uses_switch = uses_switch
        memory = program.memory
        for part in (
            memory.error,
            memory.restarts,
            memory.held,
            memory.moved,
            memory.stopped,
            memory.still,
            memory.silent,
        ):
            part[:] = 0.0
        program.bound(**bounds)
        self.controller, self.kind, self.began = controller, controller.kind, k
        self.count = controller.ticks + 1
        self._schedule = schedule = schedule_of(controller, self.lead)
        self.whole = schedule is not None and self.estimator is None and self.lead <= UNROLLED
        program.row[:] = 0.0
        self._coming.clear()
        if schedule is None:
            self._session = self._begun()
            now = self.report.state[:, 0].copy()
            self.references = np.tile(now, (self.count, 1))
            self._coming.extend([now] * self.lead)
            return
        self._session, self._rows, self.references = None, schedule.rows[:, :, None], schedule.references.copy()
        self.references[:, : self._arms] += lift
        # The table is long, so each row is turned in its own tick.
        self._lift = np.zeros(self._rows.shape[1:])
        turned = program.equations.row.of(self._lift)
        turned.state[: self._arms] = turned.wanted[:] = lift[:, None]
        program.bound(mode=float(schedule.mode))

    def lose(self) -> None:
        """Restart the filter at the next reading with a wide covariance."""
        self.program.memory.restart[:], self.program.memory.nis[:] = 1.0, 0.0
        if self.estimator is not None:
            measured = self.program.reading.measured[:, 0].copy()
            self._estimate = self.estimator.restarted(self._estimate, measured)

    def resynchronise(self, k: int) -> str:
        """Move the law's clock to the nearest phase.

        Args:
            k: tick.

        Returns:
            A sentence, or "" if the law has no internal clock.
        """
        if self._session is None:
            return ""
        return self._session.resynchronise(k + self.lead, self.report.ahead[:, 0].copy())

    def freeze_reference(self, k: int) -> None:
        """Keep the reference constant from tick k while the cart brakes.

        Args:
            k: tick.
        """
        if self._session is None:
            frozen = self.references.copy()
            frozen[k - self.began :] = frozen[k - self.began]
            self.references = frozen

    def brake(self, k: int) -> None:
        """Brake the cart to a standstill from the tick after k.

        Args:
            k: tick.
        """
        self.program.memory.stopped[:] = float(Outcome.TRACKING_LOST)
        self.freeze_reference(k)

    def correct_velocity(self, velocity: float) -> None:
        """Replace the cart's commanded velocity, from which limits and braking are computed.

        Args:
            velocity: velocity of the cart, m/s.
        """
        self.program.memory.velocity[:] = velocity

    def rehearse(self) -> None:
        """Run ticks and discard them, to load everything before the first deadline.

        Not with users' objects.
        """
        if self._has_own:
            return
        reading = Reading(0.0, self.controller.first_state[self.program.model.position_indices])
        for k in range(min(50, self.count)):
            self(k, reading)
        self.begin()
        if self.whole:
            # `begin` has replaced some arrays, which the tick loads again.
            begun = self.program.stored.copy()
            self(0, reading)
            self.program.stored[:] = begun

    def untrusted(self) -> Mapping[str, Any]:
        """Return name and share of the parameter that left the range in which the law trusts its estimate."""
        schedule, which = self._schedule, int(self.report.untrusted.item(0)) - 1
        assert schedule is not None
        share = self.report.extra.item(which, 0)
        return {"parameter": schedule.names[which], "share": share, "trust": float(schedule.trust)}

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
        wanted = references[:arms] if references.ndim == 1 else references[:, lane]
        measured = self.program.reading.measured[:arms, lane]
        apart = measured - angles
        read = measured - 2 * np.pi * np.rint(apart / (2 * np.pi))
        seen = self.program.reading.present[:arms, lane] > 0
        sensor, period = int(report.sensor.item(lane)), self.program.period
        velocity, span = state.item(self._n - 1), len(self._carts)
        moved = self._carts[k % span, lane] - self._carts[(k + 1) % span, lane]
        by_scale = moved / ((span - 1) * period)
        agree = abs(velocity - by_scale) <= _VELOCITY + _VELOCITY_SHARE * abs(by_scale)
        names = ("mean_nis", "error", "silent", "wish", "command", "untrusted", "newly_cut")
        return {
            **{name: getattr(report, name).item(lane) for name in names},
            "distance": float(np.abs(np.where(seen, read, angles) - wanted).max()),
            "apart": float(np.abs(apart[seen]).max(initial=0.0)),
            "position": state.item(self._n - 2), "velocity": velocity if agree else math.nan,
            "sensor": sensor if sensor <= arms else 0, "repeated": report.repeats.item(lane) * period,
            "time": k * period,
        }  # fmt: skip
