"""Many seeds of one run in lockstep: what campaigns are made of.

Plant, filter and prediction are the loop's machine code, called for one tick of all runs at once; what lies between is
the same arithmetic in the same order, on arrays (…, S). A run comes out as the loop gives it, to 1e-9: code for one and
for many differs in the last bit. No events are kept; what only the loop can do is left to it (`can_batch`).

Supervisors and stuck sensors of many runs in lockstep: `Supervisor` and `StuckWatch` on arrays (S,), (n+1, S).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.ekf import EkfProgram
from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.interface import MANY, Controller, ManySession
from dpcontrol.dynamics.chain import ArmChainParameters, Uncertainty
from dpcontrol.dynamics.compiled import VECTOR
from dpcontrol.foundation.errors import InputError
from dpcontrol.loop.loop import BRAKING, SETTLING, CommandPath, LoopSettings, loop_supervisor, sampled_model
from dpcontrol.loop.result import Ending, LoopResult, inside_95, rms
from dpcontrol.loop.simulated import SimulatedBench
from dpcontrol.loop.supervisor import SAME, Outcome, StuckWatch, Supervisor
from dpcontrol.references.problem import Limits

Array = NDArray[np.float64]


class BatchStuck:
    """Watches the sensors of S runs; one `StuckWatch` holds the bounds and finds the words."""

    def __init__(self, arms: int, *, period: float, reaction: float, runs: int) -> None:
        self._one = one = StuckWatch(arms, period=period, reaction=reaction)
        shape = (arms + 1, runs)
        self._arms, self._period, self._soonest = arms, period, min(one.still)
        self._still, self._least, self._doubt = np.array([one.still, one.least, one.doubt])[..., None]
        self._last, self._steps = np.full(shape, np.nan), np.full(shape, np.inf)
        self._same, self._begin, self._moved, self._value, self._should, self._step = np.zeros((6, *shape))
        self._is_same, self._is_new = np.empty(shape, dtype=bool), np.empty(shape, dtype=bool)
        self._sent = np.zeros(runs)

    def seen(
        self, positions: Array, wanted: Array, sent: Array, nis: Array, *, judged: NDArray[np.bool_]
    ) -> Mapping[int, str]:
        """Return what is stuck by the number of the run.

        positions (n+1, S): absolute angles and the carts' positions; wanted (n, 1) or (n, S): the references' angles;
        sent (S,) m/s: the velocities that the carts were sent to; nis (S,): their means of late, for each position.
        judged (S,): which runs are asked about.
        """
        n, one = self._arms, self._one
        # In place, and one operation for each thing: this is a tenth of a tick's time.
        value, should, step, same, new = self._value, self._should, self._step, self._is_same, self._is_new
        self._sent += sent * self._period
        value[:] = positions
        value[1:n] -= positions[: n - 1]
        should[:n] = wanted
        should[1:n] -= wanted[: n - 1]
        should[n] = self._sent
        np.subtract(value, self._last, out=step)
        np.abs(step, out=step)
        np.less(step, SAME, out=same)
        np.logical_not(same, out=new)
        np.copyto(self._last, value, where=new)
        np.copyto(self._begin, should, where=new)
        np.fmin(self._steps, step, out=self._steps, where=new)
        should -= self._begin
        np.abs(should, out=should)
        np.maximum(self._moved, should, out=self._moved)
        self._moved *= same
        self._same += 1
        self._same *= same
        if np.maximum.reduce(self._same, axis=None) < self._soonest:
            return {}
        still = (self._same >= self._still) & (self._moved >= self._least) & ~(nis <= self._doubt) & judged
        out: dict[int, str] = {}
        for i, lane in np.argwhere(still).tolist():
            same, moved, step = int(self._same[i, lane]), self._moved[i, lane], self._steps[i, lane]
            if lane not in out and (words := one.sentence(i, same=same, moved=float(moved), step=float(step))):
                out[lane] = words
        return out


class BatchWatch:
    """The supervisors of S runs. A single one is asked, for its words, only where it has to step in."""

    def __init__(self, supervisor: Supervisor, arms: int, runs: int) -> None:
        self._one, self._period = supervisor, supervisor.period
        self._stuck = BatchStuck(arms, period=supervisor.period, reaction=supervisor.reaction, runs=runs)
        self._error, self._nis, self._since = np.zeros(runs), np.zeros(runs), np.full(runs, np.inf)
        self._restarts = np.zeros(runs, dtype=int)
        self._alive, self._going = np.ones(runs, dtype=bool), np.ones(runs, dtype=bool)
        self.braking = np.zeros(runs, dtype=bool)
        """Which runs (S,) are being brought to rest."""
        self.any_braking, self.all_ended = False, False
        self.counts, self.stopped_at = [2**62] * runs, [2**62] * runs
        """Ticks of each run that has ended; tick at which each was stopped."""
        self.endings, self.reasons = [Ending.FINISHED] * runs, ["came to the reference's end"] * runs

    def judge(
        self,
        k: int,
        *,
        error: Array,
        nis: Array,
        used: Array,
        position: Array,
        velocity: Array,
        sent: Array,
        readings: tuple[Array, Array],
        switch: NDArray[np.bool_],
        fault: NDArray[np.bool_] | None,
    ) -> tuple[list[int], list[int]]:
        """Judge tick k; return which runs are to be stopped now and whose estimators are to be restarted.

        readings: positions (n+1, S) and the references' angles (n, 1) or (n, S).
        """
        one, settings, now = self._one, self._one.settings, k * self._period
        for lane in () if fault is None else np.flatnonzero(fault & self._alive).tolist():
            why = f"plant failed at t = {now:.3f} s: its state is no longer finite"
            self._end(lane, k, Ending.PLANT_FAILED, why)
        before = self._error, self._nis
        self._nis = self._nis + (nis / used - self._nis) * one.estimate_share
        self._error = self._error + (error - self._error) * one.tracking_share
        # NaN fails both comparisons.
        sure = self._nis <= settings.lost_estimate
        # Those that are restarted in this tick have no NIS to doubt by.
        stuck = self._stuck.seen(*readings, sent, np.where(sure, self._nis, 0.0), judged=self._going)
        near = ~one.far_from_ends(np.abs(position), np.maximum(np.abs(velocity), np.abs(sent)))
        bad = ~(sure & (self._error <= settings.lost_tracking)) | near | switch
        bad &= self._going
        bad[list(stuck)] = True
        stopped: list[int] = []
        restarted: list[int] = []
        for lane in np.flatnonzero(bad).tolist() if bad.any() else ():
            supervisor = replace(
                one, error=float(before[0][lane]), nis=float(before[1][lane]), restarts=int(self._restarts[lane])
            )
            verdict = supervisor.judge(
                now, error=float(error[lane]), nis=float(nis[lane]), used=int(used[lane]),
                position=float(position[lane]), velocity=float(velocity[lane]), sent=float(sent[lane]),
            )  # fmt: skip
            self._nis[lane], self._restarts[lane] = supervisor.nis, supervisor.restarts
            outcome, ending, why = supervisor.overruled(
                verdict, now, stuck=stuck.get(lane, ""), switch=bool(switch[lane])
            )
            if outcome is Outcome.RESTART:
                restarted.append(lane)
            elif outcome is Outcome.STOP:
                stopped.append(lane)
                self.endings[lane], self.reasons[lane], self.stopped_at[lane] = ending, why, k
        if stopped:
            self.braking[stopped], self._since[stopped] = True, now
            self._note()
        return stopped, restarted

    def _note(self) -> None:
        """Note which runs are judged, and whether any is being brought to rest: some runs have just changed."""
        self._going = self._alive & ~self.braking
        self.any_braking, self.all_ended = bool((self._alive & self.braking).any()), not self._alive.any()

    def _end(self, lane: int, count: int, ending: Ending, reason: str) -> None:
        self.endings[lane], self.reasons[lane], self.counts[lane], self._alive[lane] = ending, reason, count, False
        self._note()

    def brake(self, k: int, velocity: Array) -> None:
        """Note which carts still move by the commands sent, `velocity` (S,) m/s, before tick k's."""
        self._since[self.braking & (velocity != 0)] = k * self._period

    def ended(self, k: int, faults: Mapping[int, str]) -> None:
        """End the runs whose carts have stood long enough at tick k, and those that hit a stop."""
        if self.any_braking:
            over = self._alive & self.braking & (k * self._period > self._since + SETTLING)
            for lane in np.flatnonzero(over).tolist():
                self._end(lane, k + 1, self.endings[lane], self.reasons[lane])
        for lane, fault in faults.items():
            if self._alive[lane] and self.endings[lane] is not Ending.CART_STOP:
                self._end(lane, k + 1, Ending.CART_STOP, fault)


class BatchBench(SimulatedBench):
    """The benches of S runs."""

    @property
    def failed(self) -> NDArray[np.bool_] | None:
        """Which states (S,) are no longer finite; None while all are."""
        # One sum tells that all are; only where one is not is it asked which.
        if math.isfinite(np.add.reduce(self._plant.state, axis=None)):
            return None
        failed = ~np.isfinite(self._plant.state.sum(axis=0))
        return failed if failed.any() else None

    @property
    def faults(self) -> Mapping[int, str]:
        """Why runs have failed, by their number."""
        return self._plant.faults

    def read(self, k: int) -> tuple[Array, NDArray[np.bool_]]:
        """Return the positions (n+1, S) at tick k, and which runs (S,) touch a limit switch."""
        if k:
            self._pass(k - 1)
        return self._measured(k), np.abs(self._plant.values[self._cart]) >= self._switch_at

    def command(self, k: int, accelerations: Array) -> None:
        """Send the carts' wanted accelerations (S,), m/s², at tick k."""
        self._demand(k, accelerations)

    def stop(self, runs: list[int]) -> None:
        """Brake the carts of these runs to a standstill from now on, without the commands' delay."""
        if self._braking is None:
            self._braking = np.zeros(self.truth.shape[1], dtype=bool)
        self._braking[runs] = True


_TURN = 32
"""Ticks turned at once from lanes side by side into one after the other: singly, each row would be fetched again."""


@dataclass(frozen=True, eq=False)
class BatchRun:
    """One run of K ticks: what it is judged by, and a few of its figures.

    times (K,) s; truth (K, 2n+2); references (K, n): angles; applied (K,) m/s²; ending and why. SI units.
    """

    times: Array
    truth: Array
    references: Array
    applied: Array
    ending: Ending
    reason: str
    nis_inside_95: float
    rms_feedback: float

    @classmethod
    def of(cls, result: LoopResult) -> "BatchRun":
        """Return what the loop gave, in the same form.

        Raises:
            InputError: the true states of the run are not known.
        """
        ticks = result.ticks
        if ticks.truth is None:
            raise InputError("the true states are not known, so the run cannot be judged; run it in simulation")
        angles = ticks.references[:, : ticks.measured.shape[1] - 1]
        return cls(
            ticks.times, ticks.truth, angles, ticks.control[:, 3], result.ending, result.reason,
            result.nis_inside_95, result.rms_feedback,
        )  # fmt: skip


def can_batch(settings: LoopSettings, controller: Controller | None = None) -> bool:
    """Tell whether runs can go in lockstep, by the settings alone where no controller is given."""
    sensors = settings.sensors
    faults = sensors.missed_counts or sensors.dropout or sensors.jitter or np.isfinite(sensors.stuck_at)
    hands_over = settings.keep != "none" or settings.supervisor.hold != "none" or settings.supervisor.resynchronise
    compiled = isinstance(settings.estimator, EkfSettings)
    return compiled and not faults and not hands_over and (controller is None or _many(controller) is not None)


def _many(controller: Controller) -> Any:
    """Return what begins a session for many runs: of one clock, or each of its own; None where there is none."""
    return getattr(controller, "begin_many", None)


def run_batch(
    parameters: ArmChainParameters,
    *,
    settings: LoopSettings,
    seeds: Sequence[int],
    controller: Controller,
    limits: Limits,
    uncertainty: Uncertainty | None = None,
    mismatches: Sequence[float] | None = None,
) -> list[BatchRun]:
    """Run the seeds and return them in their order; `parameters` are the model's, `limits` the cart's in these runs.

    uncertainty: of the model, for settings that draw the plants from it. mismatches: of each run's plant, in place of
    the settings' own.

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
    return _Lockstep(parameters, settings, lanes, controller, limits, uncertainty).run()[: len(seeds)]


class _Lockstep:
    """The runs of one batch."""

    def __init__(
        self,
        parameters: ArmChainParameters,
        settings: LoopSettings,
        lanes: list[tuple[int, float]],
        controller: Controller,
        limits: Limits,
        uncertainty: Uncertainty | None,
    ) -> None:
        self.period, self.runs, self.count = 1 / settings.rate, len(lanes), controller.ticks + 1
        self.arms = arms = parameters.count
        session: ManySession = _many(controller)(self.runs)
        self.session = session
        draws = [
            settings.draw(parameters, ticks=self.count, uncertainty=uncertainty, seed=seed, mismatch=mismatch)
            for seed, mismatch in lanes
        ]
        program = EkfProgram(sampled_model(parameters, settings.rate), settings.estimator)
        self.program = program
        self.inputs = program.inputs(settings.sensors.covariance(arms), runs=self.runs)
        self.outputs = np.empty((program.step.size_out, self.runs))
        first = controller.first_state
        self.memory: Array = self.inputs[program.slices["memory"]]
        self.memory[:] = program.first(np.repeat(first[:, None], self.runs, axis=1))
        self.ahead_inputs = np.zeros((program.ahead.size_in, self.runs))
        for name, value in (("parameters", program.model.parameters), ("process", program.process)):
            self.ahead_inputs[program.ahead.slices[name]] = value[:, None]
        self.predicted = np.empty((program.ahead.size_out, self.runs))
        self.path = CommandPath(limits, delay=settings.drive.delay, period=self.period, runs=self.runs)
        z = self.memory[: program.out["z"].stop]
        # Angles alone, for that is what a run is judged by; of all runs at once where they have one clock.
        self.wanted = np.empty((self.count + self.path.lead, arms, 1))
        queued = []
        for k in range(self.path.lead):
            forward, back, reference = session.commands(k, *self._of(z))
            self._want(k, reference)
            queued.append(forward + back)
            z = self._moved(z, queued[-1])
        self.path.start(queued, velocity=float(first[-1]))
        self.bench = BatchBench(draws, settings.bench, limits=limits, start=first, queued=queued, lanes=MANY)
        rate_noise = [d.rate_noise for d in draws if d.rate_noise is not None]
        self.rate_noise = np.stack(rate_noise, axis=2) if rate_noise else None
        self.watch = BatchWatch(loop_supervisor(settings, limits), arms, self.runs)
        self.way: list[Array] = []
        self.sound: NDArray[np.bool_] | None = None

    def _want(self, k: int, reference: Array) -> None:
        """Keep the reference (N,) or (N, S) of tick k."""
        if reference.ndim == 2 and self.wanted.shape[2] != self.runs:
            self.wanted = np.repeat(self.wanted, self.runs, axis=2)
        self.wanted[k] = reference[: self.arms].reshape(self.arms, -1)

    def _of(self, memory: Array) -> tuple[Array, Array]:
        """Return states (N, S) and extras (E, S) of estimates."""
        n = self.program.model.dimension
        return memory[:n], memory[n : self.program.out["z"].stop]

    def _estimated(self, k: int, acted: Array, positions: Array) -> tuple[Array, Array]:
        """Return each run's NIS, infinite where the filter failed, and how many positions it holds."""
        where, out, inputs = self.program.slices, self.program.out, self.inputs
        inputs[where["command"]] = acted
        inputs[where["measured"]] = positions
        inputs[where["coming"]] = self.way[0] if self.way else 0.0
        (self.program.step if k else self.program.update)(inputs, self.outputs)
        nis = self.outputs[out["nis"]][0]
        self.sound = None
        # NaN fails both.
        if np.minimum.reduce(nis) >= 0 and np.maximum.reduce(nis) < np.inf:
            self.memory[:] = self.outputs[out["memory"]]
            return nis, self.outputs[out["used"]][0]
        self.sound = sound = (nis >= 0) & (nis < np.inf)
        # The loop keeps the estimate before it failed.
        self.memory[:, sound] = self.outputs[out["memory"]][:, sound]
        return np.where(sound, nis, np.inf), np.where(sound, self.outputs[out["used"]][0], 1.0)

    def _moved(self, z: Array, command: Array | float) -> Array:
        """Return z (Z, S) a period on; it stays valid until the next call."""
        self.ahead_inputs[: len(z)], self.ahead_inputs[len(z)] = z, command
        return self.program.ahead(self.ahead_inputs, self.predicted)

    def _ahead(self, k: int) -> Array:
        """Return the states (N, S) for which the commands of tick k are computed."""
        z = self.memory[: self.program.out["z"].stop]
        known = self.outputs[self.program.out["later"]]
        for place, command in enumerate(self.way):
            if place == 0 and self.sound is None:
                z = known
                continue
            z = self._moved(z, command)
            if place == 0 and self.sound is not None:
                z = np.where(self.sound, known, z)
        states = z[: self.program.model.dimension]
        if self.rate_noise is None:
            return states
        noisy = states.copy()
        noisy[self.arms : 2 * self.arms] += self.rate_noise[k]
        return noisy

    def run(self) -> list[BatchRun]:
        """Run to the last tick, or until every run has ended."""
        n, arms, lead = self.program.model.dimension, self.arms, self.path.lead
        watch, path, bench = self.watch, self.path, self.bench
        # A run's states stand together, for they are looked at run by run.
        truth = np.empty((self.runs, self.count, n))
        latest = np.empty((_TURN, n, self.runs))
        applied, feedbacks, nis_rows = (np.empty((self.count, self.runs)) for _ in range(3))
        acted = np.zeros(self.runs)
        done = self.count
        with np.errstate(all="ignore"):
            for k in range(self.count):
                positions, switch = bench.read(k)
                self.way = path.on_their_way()
                nis, used = self._estimated(k, acted, positions)
                states, extras = self._of(self.memory)
                ahead = self._ahead(k)
                forward, back, reference = self.session.commands(k + lead, ahead, extras)
                self._want(k + lead, reference)
                error = np.maximum.reduce(np.abs(states[:arms] - self.wanted[k]), axis=0)
                stopped, restarts = watch.judge(
                    k, error=error, nis=nis, used=used, position=ahead[n - 2], velocity=ahead[n - 1],
                    sent=path.velocity, readings=(positions, self.wanted[k]), switch=switch, fault=bench.failed,
                )  # fmt: skip
                feedback = back
                for lane in restarts:
                    self.memory[:, lane], _ = self.program.restarted(states[:, lane].copy(), positions[:, lane])
                command = forward + back
                if watch.any_braking:
                    braking = watch.braking
                    command = np.where(braking, path.braking(BRAKING), command)
                    feedback = np.where(braking, command, back)
                    watch.brake(k, path.velocity)
                path.send(command)
                bench.command(k, command)
                if stopped:
                    bench.stop(stopped)
                acted = path.acted(self.memory[n - 1])
                turn = k % _TURN
                latest[turn] = bench.truth
                if turn == _TURN - 1:
                    truth[:, k - turn : k + 1] = latest.transpose(2, 0, 1)
                applied[k], feedbacks[k] = acted, feedback
                if restarts or watch.any_braking:
                    # As in the loop: a filter that failed shows its last NIS, one that restarts has none.
                    nis = np.where(np.isfinite(nis), nis, nis_rows[k - 1] if k else np.nan)
                    nis[restarts] = np.nan
                nis_rows[k] = nis
                watch.ended(k, bench.faults)
                if watch.all_ended:
                    done = k + 1
                    break
        rest = done % _TURN
        truth[:, done - rest : done] = latest[:rest].transpose(2, 0, 1)
        return self._results(done, truth, applied, feedbacks, nis_rows)

    def _results(self, done: int, truth: Array, applied: Array, feedbacks: Array, nis: Array) -> list[BatchRun]:
        times = np.asarray(np.arange(self.count) * self.period, dtype=np.float64)
        out = []
        for lane in range(self.runs):
            count = min(self.watch.counts[lane], done)
            references = self.wanted[:count, :, lane % self.wanted.shape[2]].copy()
            since = self.watch.stopped_at[lane]
            if since < count:
                references[since:] = references[since]
            out.append(
                BatchRun(
                    times[:count], truth[lane, :count], references, applied[:count, lane].copy(),
                    self.watch.endings[lane], self.watch.reasons[lane], inside_95(nis[:count, lane], self.arms + 1),
                    rms(feedbacks[:count, lane]),
                )
            )  # fmt: skip
        return out
