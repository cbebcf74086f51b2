"""Many seeds of one run in lockstep: what campaigns are made of.

Plant, filter and prediction are the loop's machine code, called for one tick of all runs at once; what lies between is
the same arithmetic in the same order, on arrays (…, S). A run comes out as the loop gives it, to 1e-9: code for one and
for many differs in the last bit. No events are kept; what only the loop can do is left to it (`can_batch`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.control.ekf import EkfProgram
from dpcontrol.control.estimator_settings import EkfSettings, chi_square_band
from dpcontrol.control.interface import Controller, ManySession
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.dynamics.compiled import VECTOR
from dpcontrol.dynamics.plant import after_blow, longest_step, plant_step
from dpcontrol.dynamics.ratios import Uncertainty
from dpcontrol.foundation.errors import InputError
from dpcontrol.loop.batch_watch import BatchWatch
from dpcontrol.loop.bench import BenchDraw, BenchSettings, clip_lanes
from dpcontrol.loop.control_loop import BRAKING, CommandPath
from dpcontrol.loop.loop import LoopSettings, sampled_model
from dpcontrol.loop.result import Ending, LoopResult
from dpcontrol.loop.simulated import SimulatedPlant
from dpcontrol.references.problem import Limits

Array = NDArray[np.float64]


class BatchBench:
    """Plants, sensors and drives of S runs with the same settings: what `SimulatedRig` computes, in its order.

    draws: one for each run; start (2n+2,): the nominal first state; queued: commands on their way, oldest first, each a
    number or (S,).
    """

    def __init__(
        self, draws: Sequence[BenchDraw], settings: BenchSettings, *, limits: Limits, start: Array,
        queued: Sequence[ArrayLike],
    ) -> None:  # fmt: skip
        first = draws[0]
        self._draws, self._runs, self._period = draws, len(draws), first.period
        self._arms = n = first.plant.arms.count
        own = settings.drive.limits(limits)
        self._drive = settings.drive.within(limits, first.period, clip=clip_lanes)
        self._track, self._switch_at = own.position, own.position - settings.drive.switch_margin
        whole = math.floor(settings.drive.delay)
        self._fraction = settings.drive.delay - whole
        self._sensors = settings.sensors
        self._zeros = np.stack([d.zeros for d in draws], axis=1)
        noise = [d.noise for d in draws if d.noise is not None]
        self._noise = np.stack(noise, axis=2) if noise else None
        command_noise = [d.command_noise for d in draws if d.command_noise is not None]
        self._command_noise = np.stack(command_noise, axis=1) if command_noise else None
        self._blows = sorted({tick for d in draws for tick in d.blows})
        demands: list[Array] = [np.zeros(self._runs)] * (whole + 1)
        for command in queued:
            demands.append(self._drive.demanded(np.broadcast_to(command, (self._runs,)), 0.0, demands[-1]))
        self._demands = demands[-(whole + 1) :]
        self._step = step = plant_step(n, first.plant.level, friction=first.plant.arms.friction)
        self._inputs = np.zeros((step.size_in, self._runs))
        self._following = np.empty((step.size_out, self._runs))
        self._inputs[step.slices["parameters"]] = np.stack([d.plant.numbers() for d in draws], axis=1)
        self._input, self._duration = step.slices["inputs"].start, step.slices["duration"].start
        self._state: Array = self._inputs[step.slices["state"]]
        self._state[: 2 * n + 2] = start[:, None]
        self._state[:n] += np.stack([d.initial_error for d in draws], axis=1)
        self._lag = first.plant.lag
        if self._lag:
            self._state[2 * n + 2] = self._demands[0]
        self._longest = min(longest_step(d.plant) for d in draws)
        self._braking: NDArray[np.bool_] | None = None
        self.faults: dict[int, str] = {}
        """Why runs have failed, by their number."""

    @property
    def truth(self) -> Array:
        """The true states (2n+2, S) at the last reading; overwritten at the next."""
        return self._state[: 2 * self._arms + 2]

    @property
    def failed(self) -> NDArray[np.bool_] | None:
        """Which states (S,) are no longer finite; None while all are."""
        # One sum tells that all are; only where one is not is it asked which.
        if math.isfinite(np.add.reduce(self._state, axis=None)):
            return None
        failed = ~np.isfinite(self._state.sum(axis=0))
        return failed if failed.any() else None

    def read(self, k: int) -> tuple[Array, NDArray[np.bool_]]:
        """Return the positions (n+1, S) at tick k, and which runs (S,) touch a limit switch."""
        if k:
            self._pass(k - 1)
        n, s = self._arms, self._sensors
        x = self._state
        readings = np.empty((n + 1, self._runs))
        readings[0] = x[0]
        readings[1:n] = x[1:n] - x[: n - 1]
        readings[:n] += self._zeros
        readings[n] = x[2 * n]
        if self._noise is not None:
            readings += self._noise[k]
        angle, cart = s.steps
        if angle:
            readings[:n] = angle * np.rint(readings[:n] / angle)
        if cart:
            readings[n] = cart * np.rint(readings[n] / cart)
        for i in range(1, n):
            readings[i] += readings[i - 1]
        return readings, np.abs(x[2 * n]) >= self._switch_at

    def command(self, k: int, accelerations: Array) -> None:
        """Send the carts' wanted accelerations (S,), m/s², at tick k."""
        noise = 0.0 if self._command_noise is None else self._command_noise[k]
        self._demands.append(self._drive.demanded(accelerations, noise, self._demands[-1]))

    def stop(self, lanes: NDArray[np.intp]) -> None:
        """Brake the carts of these runs to a standstill from now on, without the commands' delay."""
        if self._braking is None:
            self._braking = np.zeros(self._runs, dtype=bool)
        self._braking[lanes] = True

    def _acting(self, demand: Array, duration: float) -> Array:
        drive, n = self._drive, self._arms
        velocity = self._state[2 * n + 1]
        if self._lag:
            velocity = velocity + self._lag * self._state[2 * n + 2]
        acting = drive.acting(demand, velocity, duration)
        return acting if self._braking is None else np.where(self._braking, drive.braking(velocity, duration), acting)

    def _pass(self, k: int) -> None:
        """Let period k pass."""
        if self._blows and self._blows[0] == k:
            self._blows.pop(0)
            for lane, draw in enumerate(self._draws):
                if k in draw.blows:
                    blow = draw.blows[k]
                    self._state[:, lane] = after_blow(
                        draw.plant, self._state[:, lane], impulses=blow.impulses, jumps=blow.jumps, knock=blow.knock
                    )
        change = self._fraction * self._period
        if change:
            self._move(self._acting(self._demands[k], change), change, time=k * self._period)
        rest = self._period - change
        self._move(self._acting(self._demands[k + 1], rest), rest, time=k * self._period + change)
        # What has acted is not needed any more; its place keeps the count.
        self._demands[k] = self._demands[k + 1]

    def _move(self, accelerations: Array, duration: float, *, time: float) -> None:
        splits = 1 if duration <= self._longest else math.ceil(duration / self._longest)
        inputs, following, cart = self._inputs, self._following, 2 * self._arms
        inputs[self._input], inputs[self._duration] = accelerations, duration / splits
        for part in range(splits):
            self._step(inputs, following)
            beyond = np.abs(following[cart]) > self._track
            if np.logical_or.reduce(beyond):
                began = time + part * duration / splits
                for lane in np.flatnonzero(beyond):
                    following[:, lane] = self._at_stop(int(lane), float(accelerations[lane]), duration / splits, began)
            self._state[:] = following

    def _at_stop(self, lane: int, acceleration: float, duration: float, time: float) -> Array:
        """Move one run whose cart reaches a hard stop: too rare to be worth doing at once for many."""
        plant = SimulatedPlant(self._draws[lane].plant, self._state[:, lane], track=self._track)
        plant.move(acceleration, duration, time=time)
        self.faults.setdefault(lane, plant.fault)
        return plant.state


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
    return getattr(controller, "begin_many", None) or getattr(controller, "begin_runs", None)


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
        self.bench = BatchBench(draws, settings.bench, limits=limits, start=first, queued=queued)
        rate_noise = [d.rate_noise for d in draws if d.rate_noise is not None]
        self.rate_noise = np.stack(rate_noise, axis=2) if rate_noise else None
        self.watch = BatchWatch(settings, limits, runs=self.runs)
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
                if restarts is not None:
                    for lane in restarts:
                        memory, _ = self.program.restarted(states[:, lane].copy(), positions[:, lane])
                        self.memory[:, lane] = memory
                command = forward + back
                if watch.any_braking:
                    braking = watch.braking
                    command = np.where(braking, path.braking(BRAKING), command)
                    feedback = np.where(braking, command, back)
                    watch.brake(k, path.velocity)
                path.send(command)
                bench.command(k, command)
                if stopped is not None:
                    bench.stop(stopped)
                acted = path.acted(self.memory[n - 1])
                turn = k % _TURN
                latest[turn] = bench.truth
                if turn == _TURN - 1:
                    truth[:, k - turn : k + 1] = latest.transpose(2, 0, 1)
                applied[k], feedbacks[k] = acted, feedback
                if restarts is not None or watch.any_braking:
                    # As in the loop: a filter that failed shows its last NIS, one that restarts has none.
                    nis = np.where(np.isfinite(nis), nis, nis_rows[k - 1] if k else np.nan)
                    nis[restarts or []] = np.nan
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
        low, high = chi_square_band(self.arms + 1)
        out = []
        for lane in range(self.runs):
            count = min(self.watch.counts[lane], done)
            references = self.wanted[:count, :, lane % self.wanted.shape[2]].copy()
            since = self.watch.stopped_at[lane]
            if since < count:
                references[since:] = references[since]
            seen = nis[:count, lane]
            finite = np.isfinite(seen)
            out.append(
                BatchRun(
                    times[:count],
                    truth[lane, :count],
                    references,
                    applied[:count, lane].copy(),
                    self.watch.endings[lane],
                    self.watch.reasons[lane],
                    float(((seen >= low) & (seen <= high))[finite].mean()) if finite.any() else float("nan"),
                    float(np.sqrt((feedbacks[:count, lane] ** 2).mean())),
                )
            )
        return out
