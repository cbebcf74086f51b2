"""Controller and estimator of a run, or of many side by side: from a reading to a report.

Where the gains stand in a table and the estimator is the compiled filter, a tick is one call of `TickProgram`. A law
with a clock of its own is asked between its two parts; another estimator takes the place of the first.
"""

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from dpcontrol.control.handover import NearestKeeper
from dpcontrol.control.interface import Controller, Estimate, Estimator, GainSchedule, schedule_of
from dpcontrol.control.tick import UNROLLED, Outcome, TickProgram
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.loop.own import OwnController, OwnEstimates, OwnFailure, OwnSession, wrong_command
from dpcontrol.loop.result import Reading

_SCALE_SECONDS = 0.01
"""Over how long the cart's velocity is read off its scale."""
_VELOCITY, _VELOCITY_SHARE = 0.1, 0.1
"""m/s and share: how far scale and estimate may be apart for the estimated velocity to be told."""


class Ticker:
    """The ticks of one run, or of as many in lockstep as the program has runs.

    estimator: in place of the compiled filter, for one run.

    Raises:
        InputError: the first state does not fit the model, or the law cannot answer for many runs.
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
        self._asks = self._own is not None or isinstance(controller, OwnController)
        self.watched = self._asks or "own" in program.at
        """Whether a user's law or estimator takes part; it may fail."""
        self.kind, self.estimator_kind = controller.kind, estimator_kind
        self.lead, self.at = program.lead, program.at
        self._arms, self._n = program.model.arms, program.model.dimension
        if len(controller.first_state) != self._n:
            raise InputError(
                f"the controller is for states of {len(controller.first_state)} entries, these arms have {self._n}"
            )
        self.count, self._many = controller.ticks + 1, program.runs > 1
        self._schedule = schedule
        sizes = program.equations.report.slices
        self._extra, self._ahead = sizes["extra"], sizes["ahead"]
        self._wanted, self._reading = program.equations.row.slices["wanted"], program.equations.reading.slices
        self._forward = program.equations.row.slices["feedforward"].start
        first = program.equations.row.slices["state"].start
        self._state = slice(first, first + self._arms)
        self._stopped = program.equations.memory.slices["stopped"].start
        self._whole = schedule is not None and estimator is None and self.lead <= UNROLLED
        self.event = ""
        """What the law decided in the last tick, a sentence for the log, or empty."""
        self._heeds_switch = True
        self.began = 0
        """The tick at which what is followed now began; `references` are from there on."""
        self.begin()

    @property
    def failure(self) -> OwnFailure | None:
        """What was wrong with a user's law or estimator in the last tick."""
        if "own" in self.at and (wrong := wrong_command(self.kind, self.program.report.item(self.at["own"], 0))):
            return wrong
        session = self._session.failure if isinstance(self._session, OwnSession) else None
        return session or (None if self._own is None else self._own.failure)

    @property
    def extra_names(self) -> tuple[str, ...]:
        """Names of what is estimated besides the state."""
        return self.program.equations.filter.extra_names

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
            """(K, N): of each tick; (K, n, runs): of the angles alone, where each of many runs has a clock of its own.
            """
            self._rows = self._schedule.rows[:, :, None]
            self._lift = np.zeros(self._rows.shape[1:])
            self.queued = self._schedule.queued[:, None]
            program.set_number("mode", float(self._schedule.mode))
        else:
            self._session = self._begun()
            self.references = np.empty((self.count, self._arms, program.runs) if self._many else (self.count, self._n))
            # The commands that act before the first tick's own can, computed for where those before them lead.
            rest = np.zeros(program.equations.filter.dimension - self._n)
            z = program.spread(np.concatenate([first, rest])[:, None])
            queued, drive = [], np.zeros(program.lanes)
            for k in range(self.lead):
                forward, back = self._ask(k, z[: self._n], z[self._n :])
                queued.append(np.broadcast_to(forward + back, program.lanes))
                z, drive = program.moved(z, drive, queued[-1])
            self.queued = np.array(queued).reshape(self.lead, program.lanes)[:, : program.runs]
        program.begin(first, self.queued, velocity=float(first[-1]))
        # Compiled now: the first tick of a run has no time for it.
        program.prepare(["tick"] if self._whole else self._parts)

    @property
    def _parts(self) -> list[str]:
        """The functions that a tick by parts needs."""
        return ["judge", "moved"] if self.estimator is not None else ["sense", "moved", "finish"]

    def prepare_to_hold(self) -> None:
        """Have all compiled that is needed once the reference is given up."""
        self.program.prepare(self._parts)

    def _begun(self) -> Any:
        law: Any = self.controller
        if not self._many:
            return law.begin_after(self.lead) if hasattr(law, "begin_after") else law.begin()
        if not hasattr(law, "begin_many"):
            raise InputError(f'controller: kind = "{self.kind}" answers one run at a time; run these one by one')
        return law.begin_many(self.program.runs)

    def _ask(self, tick: int, ahead: Array, extra: Array) -> tuple[Any, Any]:
        """Return the session's feedforward and feedback for `tick`, of one run or all; remember its reference."""
        if self._many:
            forward, back, wanted = self._session.commands(tick, ahead, extra)
            self._coming.append(wanted[: self._arms].reshape(self._arms, -1))
            return forward, back
        action = self._session.command(tick, ahead[:, 0].copy(), extra[:, 0].copy())
        self._coming.append(action.reference)
        self.event = action.event
        self.program.set_number("mode", float(action.mode))
        return action.feedforward, action.feedback

    def __call__(self, k: int, reading: Reading, rate_error: Array | None = None) -> Array:
        """Do tick k; return its report, (size, lanes), which the next overwrites.

        rate_error (n, 1) or (n, lanes) rad/s: added to the rates that the law sees.
        """
        program = self.program
        positions = reading.positions if self._many else reading.positions[:, None]
        switch = reading.switch if self._heeds_switch else 0
        program.take(positions, reading.present, switch, rate_error, reading.age)
        cart = positions[-1] if reading.present is None else np.where(reading.present[-1], positions[-1], np.nan)
        self._carts[k % len(self._carts)] = cart
        if self._whole:
            np.add(self._rows[k - self.began], self._lift, out=program.row)
            program.tick()
            return program.report
        return self._by_parts(k - self.began, reading)

    def _by_parts(self, k: int, reading: Reading) -> Array:
        """Do the tick that is k after what is followed began."""
        program = self.program
        if self.estimator is None:
            sensed = program.sense()
            z = sensed[: program.equations.filter.dimension]
            ahead, drive = program.look_ahead(z)
        else:
            sensed, ahead, drive = self._estimated(k + self.began, reading)
            z = sensed[: program.equations.filter.dimension]
        back: Any = 0.0
        if self._session is None:
            np.add(self._rows[k], self._lift, out=program.row)
        elif not self._many and program.memory[self._stopped, 0]:
            # Being brought to rest: the law is asked no more.
            self.references[k] = self.references[k - 1]
        else:
            self.event = ""
            forward, back = self._ask(k + self.lead, ahead, z[self._n :])
            wanted = self._coming.popleft()
            program.row[self._forward] = forward
            self.references[k] = wanted
            program.row[self._wanted] = wanted if self._many else wanted[: self._arms, None]
        program.finish(sensed, ahead, drive, back, predicts=self.estimator is None)
        if self.estimator is not None and program.report[self.at["outcome"], 0] == Outcome.RESTART:
            self._estimate = self.estimator.restarted(self._estimate, reading.positions)
        if self._own is not None and not self._own.judged:
            program.report[self.at["nis"]] = math.nan
            self.event = f"{self._own.kind} has no sigmas: NIS and the check of the estimate are off" * (k == 0)
        return program.report

    def _estimated(self, k: int, reading: Reading) -> tuple[Array, Array, Array]:
        """Return what `TickProgram.sense` would, the state ahead and `drive` then, by another estimator; one run."""
        program, estimator, before = self.program, self.estimator, self._estimate
        assert estimator is not None
        means, drive = program.acting_on_their_way()
        way = [float(mean[0]) for mean in means]
        sound = 1.0
        try:
            if k:
                if self._own is not None:
                    self._own.sent = program.report[self.at["command"], 0].item()
                acted = program.report[self.at["acting"], 0].item()
                now = estimator.step(before, acted, reading.positions, reading.present)
            else:
                now = estimator.update(before, reading.positions, reading.present)
            self._estimate = now
        except ArithmeticError:
            now, sound = before, 0.0
        ahead = estimator.ahead(now, way)
        parts = {
            "z": np.concatenate([now.state, now.extra]), "sigmas": now.sigmas, "nis": now.nis if sound else np.nan,
            "used": now.used, "sound": sound,
        }  # fmt: skip
        sensed = program.equations.sensed.filled(parts, program.lanes)
        return sensed, program.with_rate_error(program.spread(ahead[:, None])), drive

    def hold(self, k: int, fallback: NearestKeeper) -> str:
        """Give the reference up at tick k and hold what `fallback` finds; return what that is. For one run."""
        program, report = self.program, self.program.report
        self._session, held = fallback.session(k + self.lead, report[self._ahead, 0].copy())
        k -= self.began
        now = self.references[k].copy()
        self.references = np.concatenate([self.references[: k + 1], np.empty((self.count - k - 1, self._n))])
        self._coming.clear()
        self._coming.extend([now] * self.lead)
        # The row's own law is silent from now on.
        program.row[:] = 0.0
        self._whole = False
        return held

    def follow(
        self,
        k: int,
        controller: Controller,
        *,
        lift: Array,
        bounds: Mapping[str, float],
        heeds_switch: bool = True,
    ) -> None:
        """Follow another controller from tick k on, the next, with `lift` (n,) rad added to its angles; for one run.

        The filter goes on, and so do the commands that are on their way; what was judged begins anew, by these bounds
        (`tick.BOUNDS`) in place of those before.
        """
        program = self.program
        self._heeds_switch = heeds_switch
        places = program.equations.memory.slices
        for name in ("error", "restarts", "held", "moved", "stopped", "still", "silent"):
            program.memory[places[name]] = 0.0
        for name, value in bounds.items():
            program.set_number(name, value)
        self.controller, self.kind, self.began = controller, controller.kind, k
        self.count = controller.ticks + 1
        self._schedule = schedule = schedule_of(controller, self.lead)
        self._whole = schedule is not None and self.estimator is None and self.lead <= UNROLLED
        program.row[:] = 0.0
        self._coming.clear()
        if schedule is None:
            self._session = self._begun()
            now = program.report[: self._n, 0].copy()
            self.references = np.tile(now, (self.count, 1))
            self._coming.extend([now] * self.lead)
            return
        self._session, self._rows, self.references = None, schedule.rows[:, :, None], schedule.references.copy()
        self.references[:, : self._arms] += lift
        # A table is long: each row is turned when its tick comes.
        self._lift = np.zeros(self._rows.shape[1:])
        self._lift[self._state] = self._lift[self._wanted] = lift[:, None]
        program.set_number("mode", float(schedule.mode))

    def lose(self) -> None:
        """Have the filter begin anew with the next reading, knowing little else."""
        memory, places = self.program.memory, self.program.equations.memory.slices
        memory[places["restart"]], memory[places["nis"]] = 1.0, 0.0
        if self.estimator is not None:
            measured = self.program.reading[self._reading["measured"], 0].copy()
            self._estimate = self.estimator.restarted(self._estimate, measured)

    def number(self, name: str) -> float:
        """Return one of the `BOUNDS`."""
        return float(self.program.numbers[self.program.equations.numbers.slices[name]][0])

    def repeats(self, sensor: int) -> float:
        """Return for how many ticks a sensor, counted from 1, has given one reading."""
        return float(self.program.memory[self.program.equations.memory.slices["same"]][sensor - 1, 0])

    def resynchronise(self, k: int) -> str:
        """Move the law's clock to the phase nearest to the state ahead; say by how much, or "" if it has none."""
        if self._session is None:
            return ""
        return self._session.resynchronise(k + self.lead, self.program.report[self._ahead, 0].copy())

    def stand(self, k: int) -> None:
        """Let the reference stand from tick k on: the cart is brought to rest."""
        if self._session is None:
            stands = self.references.copy()
            stands[k - self.began :] = stands[k - self.began]
            self.references = stands

    def brake(self, k: int) -> None:
        """Bring the cart to rest from the tick after k on, whatever is followed."""
        self.program.memory[self.program.equations.memory.slices["stopped"]] = float(Outcome.TRACKING_LOST)
        self.stand(k)

    @property
    def cart_reading(self) -> float:
        """The cart's position as last read, m."""
        return float(self.program.reading[self._reading["measured"]][self._arms, 0])

    def brake_from(self, velocity: float) -> None:
        """Have a cart that is being brought to rest brake from this velocity, m/s, whatever it was sent to."""
        self.program.memory[self.program.equations.memory.slices["velocity"]] = velocity

    def rehearse(self) -> None:
        """Do ticks that nobody sees, so that all is in memory before the first deadline; not with users' objects."""
        if self._asks:
            return
        state = self.controller.first_state
        reading = Reading(0.0, state[self.program.model.position_indices])
        for k in range(min(50, self.count)):
            self(k, reading)
        self.begin()
        if self._whole:
            # What beginning has put in their place is fetched again.
            begun = self.program.memory.copy()
            self(0, reading)
            self.program.memory[:] = begun

    def doubt(self) -> str:
        """Return a sentence on the parameter that the last tick found to be wrong beyond the law's trust."""
        schedule, report = self._schedule, self.program.report
        assert schedule is not None
        which = int(report[self.at["doubted"], 0]) - 1
        share = report[self._extra, 0][which]
        return (
            f"model doubted: {schedule.names[which]} is found to be off by {share:+.0%}, more than first order carries "
            f"(trust {schedule.trust:g}); identify the arms, or expect the reference to be lost"
        )

    def figures(self, k: int, lane: int = 0) -> Mapping[str, float]:
        """Return the numbers of tick k, the last, by which an outcome is explained.

        distance rad: of the angle that is farthest from the reference, as read, or as estimated where nothing was read;
        apart rad: of the estimated angle that is farthest from its reading; position m and velocity m/s: of the cart,
        the velocity not a number where the cart's scale does not bear it out, as just after a knock.
        """
        column, references, arms = self.program.report[:, lane], self.references[k - self.began], self._arms
        names = ("mean_nis", "error", "silent", "sensor", "repeats", "wish", "command", "doubted", "newly_cut")
        angles = column[:arms]
        wanted = references[:arms] if references.ndim == 1 else references[:, lane]
        measured, present = (self.program.reading[self._reading[name]] for name in ("measured", "present"))
        apart = measured[:arms, lane] - angles
        read = measured[:arms, lane] - 2 * np.pi * np.rint(apart / (2 * np.pi))
        seen = present[:arms, lane] > 0
        velocity, span = column.item(self._n - 1), len(self._carts)
        moved = self._carts[k % span, lane] - self._carts[(k + 1) % span, lane]
        by_scale = moved / ((span - 1) * self.program.period)
        agree = abs(velocity - by_scale) <= _VELOCITY + _VELOCITY_SHARE * abs(by_scale)
        return {
            **{name: column.item(self.at[name]) for name in names},
            "distance": float(np.abs(np.where(seen, read, angles) - wanted).max()),
            "apart": float(np.abs(apart[seen]).max(initial=0.0)),
            "position": column.item(self._n - 2), "velocity": velocity if agree else math.nan,
        }  # fmt: skip
