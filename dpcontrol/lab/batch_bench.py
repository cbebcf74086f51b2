"""The simulated bench for many runs in lockstep: the arithmetic of `SimulatedRig`, in its order, on arrays (…, S)."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.dynamics.drive_level import after_blow, longest_step, plant_step
from dpcontrol.lab.bench import BenchSettings
from dpcontrol.lab.draw import BenchDraw
from dpcontrol.lab.simulated import SimulatedPlant
from dpcontrol.references.problem import Limits

Array = NDArray[np.float64]


class BatchBench:
    """Plants, sensors and drives of S runs with the same settings.

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
        self._drive = settings.drive.within(limits, first.period)
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
            demands.append(self._demanded(np.broadcast_to(command, (self._runs,)), 0.0, demands[-1]))
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
        """What runs have come to grief by, by their number."""

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
        self._demands.append(self._demanded(accelerations, noise, self._demands[-1]))

    def stop(self, lanes: NDArray[np.intp]) -> None:
        """Brake the carts of these runs to a standstill from now on, without the commands' delay."""
        if self._braking is None:
            self._braking = np.zeros(self._runs, dtype=bool)
        self._braking[lanes] = True

    def _demanded(self, command: Array, noise: Array | float, last: Array) -> Array:
        drive = self._drive
        wanted = drive.response * command + noise
        wanted = np.minimum(np.maximum(wanted, -drive.acceleration), drive.acceleration)
        return np.minimum(np.maximum(wanted, last - drive.jerk_step), last + drive.jerk_step)

    def _acting(self, demand: Array, duration: float) -> Array:
        drive, n = self._drive, self._arms
        velocity = self._state[2 * n + 1]
        if self._lag:
            velocity = velocity + self._lag * self._state[2 * n + 2]
        low, high = (-drive.velocity - velocity) / duration, (drive.velocity - velocity) / duration
        wanted = np.minimum(np.maximum(demand, low), high)
        most = drive.acceleration
        acting = np.minimum(np.maximum(wanted, -most), most)
        if self._braking is None:
            return acting
        return np.where(self._braking, np.minimum(np.maximum(-velocity / duration, -most), most), acting)

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
