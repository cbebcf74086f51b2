"""The bench as a program: a rig whose plant, sensors and drive are simulated, tick by tick.

Period k runs from tick k to the next. In it the command given at tick k - i acts, i the whole periods of the delay; for
a fraction f of a period more, the one before it acts until k + f. Blows strike at the tick, after its reading. A cart
that reaches the end of its track stops dead there; the arms keep their momenta, and `fault` says so.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.plant import PlantParameters, after_blow, longest_step, plant_step
from dpcontrol.foundation.errors import InputError
from dpcontrol.loop.bench import BenchDraw, BenchSettings, Encoders
from dpcontrol.loop.result import Reading
from dpcontrol.references.problem import Limits

Array = NDArray[np.float64]


class SimulatedPlant:
    """Arms, cart and drive between ticks, with hard stops at ±track m; state (N,) of `plant_equations`.

    Not to be shared between threads.
    """

    def __init__(self, parameters: PlantParameters, state: Array, *, track: float) -> None:
        self.parameters, self.track = parameters, track
        self.fault = ""
        self._step = step = plant_step(parameters.arms.count, parameters.level, friction=parameters.arms.friction)
        self._machine = step.machine
        self._inputs, self._following = np.zeros(step.size_in), np.zeros(step.size_out)
        self.state: Array = self._inputs[step.slices["state"]]
        """The state now; overwritten as the plant moves."""
        self._inputs[step.slices["parameters"]] = parameters.numbers()
        self._input, self._duration = step.slices["inputs"].start, step.slices["duration"].start
        self._cart = 2 * parameters.arms.count
        self._lag = parameters.lag
        self._longest = longest_step(parameters)
        self.values: list[float] = []
        """The state as plain floats, which cost less one by one."""
        self._be(np.asarray(state))

    def _be(self, state: Array) -> None:
        self.state[:] = state
        self.values = state.tolist()

    @property
    def velocity(self) -> float:
        """The cart's velocity, m/s."""
        return self.values[self._cart + 1]

    @property
    def loop_velocity(self) -> float:
        """The velocity reference w of the drive's loop, m/s; the cart's velocity where nothing lags."""
        v = self.values[self._cart + 1]
        return v + self._lag * self.values[self._cart + 2] if self._lag else v

    def move(self, acceleration: float, duration: float, *, time: float) -> None:
        """Let `duration` s pass from `time` s with a held demand of `acceleration` m/s²."""
        splits = 1 if duration <= self._longest else math.ceil(duration / self._longest)
        inputs, following, track, cart = self._inputs, self._following, self.track, self._cart
        inputs[self._input], inputs[self._duration] = acceleration, duration / splits
        step = self._machine
        for k in range(splits):
            step(inputs, following)
            values = following.tolist()
            if values[cart] > track or values[cart] < -track:
                self._meet_stop(acceleration, duration / splits, time + k * duration / splits)
                inputs[self._input], inputs[self._duration] = acceleration, duration / splits
            else:
                self.state[:] = following
                self.values = values

    def strike(self, *, impulses: Array, jumps: Array, knock: float) -> None:
        """Apply a blow: couples' impulses (n,) N m s, jumps (n,) rad/s of rates, the cart's knock m/s."""
        self._be(after_blow(self.parameters, self.state, impulses=impulses, jumps=jumps, knock=knock))

    def _flow(self, acceleration: float, duration: float) -> Array:
        self._inputs[self._input], self._inputs[self._duration] = acceleration, duration
        return self._step(self._inputs, self._following)

    def _meet_stop(self, acceleration: float, duration: float, time: float) -> None:
        """Move for `duration` s in which the cart reaches a stop: to the contact, dead stop, rest of the time held."""
        cart, track = self._cart, self.track
        free, met = 0.0, duration
        for _ in range(60):
            middle = (free + met) / 2
            if abs(self._flow(acceleration, middle).item(cart)) > track:
                met = middle
            else:
                free = middle
        self._be(self._flow(acceleration, free))
        side, speed = math.copysign(1.0, self.values[cart]), self.velocity
        if not self.fault:
            self.fault = (
                f"cart hit its hard stop at t = {time + free:.3f} s: x = {side * track:.3f} m at {speed:.3g} m/s; "
                "allow more travel, or stop it sooner"
            )
        self._hold(side)
        # The drive does not push on against the stop.
        self._be(self._flow(0.0, duration - free))
        if side * self.values[cart] > track:
            self._hold(side)

    def _hold(self, side: float) -> None:
        n = self.parameters.arms.count
        none = np.zeros(n)
        self.strike(impulses=none, jumps=none, knock=-self.velocity)
        held = self.state.copy()
        held[self._cart], held[self._cart + 1 :] = side * self.track, 0.0
        self._be(held)


class SimulatedRig:
    """A simulated bench behind the `Rig` protocol.

    draw: of this run; settings: as it was drawn from; limits: the scene's. start (2n+2,): the nominal first state, to
    which the draw's initial error is added. queued m/s²: commands already on their way, oldest first; zero before them.

    Raises:
        InputError: the state has the wrong shape, or the settings do not fit the arms.
    """

    def __init__(
        self, draw: BenchDraw, settings: BenchSettings, *, limits: Limits, start: Array, queued: Sequence[float] = ()
    ) -> None:
        n = draw.plant.arms.count
        if np.shape(start) != (2 * n + 2,):
            raise InputError(f"the first state has shape {np.shape(start)}: {n} arms on a cart need ({2 * n + 2},)")
        self._draw, self._period = draw, draw.period
        self._limits = settings.drive.limits(limits)
        self._drive = settings.drive.within(limits, draw.period)
        self._switch_at = self._limits.position - settings.drive.switch_margin
        whole = math.floor(settings.drive.delay)
        self._fraction = settings.drive.delay - whole
        demands = [0.0] * (whole + 1)
        for command in queued:
            demands.append(self._drive.demanded(command, 0.0, demands[-1] if demands else 0.0))
        # From the one that acts first; the one at place k + 1 begins to act in period k.
        self._demands = demands[-(whole + 1) :]
        self._sent_before = whole + 1
        self._noise = None if draw.command_noise is None else draw.command_noise.tolist()
        self._ages = None if draw.ages is None else draw.ages.tolist()
        self._dropped = None if draw.dropped is None else draw.dropped.tolist()
        self._encoders = Encoders(n, settings.sensors, zeros=draw.zeros)
        self._nothing, self._positions = np.zeros(n + 1, dtype=bool), np.zeros(n + 1)
        first = np.array(start, dtype=float)
        first[:n] += draw.initial_error
        if draw.plant.lag:
            first = np.append(first, self._demands[0])
        self._plant = SimulatedPlant(draw.plant, first, track=self._limits.position)
        self._bench = self._plant.state[: 2 * n + 2]
        self._seen: list[float] | None = None
        self._cart = 2 * n
        self._tick, self._acted, self._braking = -1, 0.0, False
        self._ticks, self._blows = draw.ticks, draw.blows

    @property
    def period(self) -> float:
        """Return the time between ticks, s."""
        return self._period

    @property
    def truth(self) -> Array:
        """Return the true state (2n+2,) at the last reading's tick; overwritten at the next."""
        return self._bench

    @property
    def state(self) -> Array:
        """Return all of the plant's state (N,): the truth, then the demand of a drive that lags."""
        return self._plant.state

    @property
    def acted(self) -> float:
        """Return the mean acceleration of the cart over the last period, m/s², blows apart."""
        return self._acted

    @property
    def fault(self) -> str:
        """Return what has happened at the end of the track, or ""."""
        return self._plant.fault

    def read(self) -> Reading:
        """Let a period pass, unless it is the first call, and return what the sensors say.

        Raises:
            ArithmeticError: the state is no longer finite, or the run outlasts its draw.
        """
        k = self._tick + 1
        draw = self._draw
        if k >= self._ticks:
            raise ArithmeticError(f"the run was drawn for {self._ticks} ticks and is asked for more; draw more of them")
        if k:
            self._pass(k - 1)
        self._tick = k
        now = k * self._period
        values = self._plant.values
        if not math.isfinite(sum(values)):
            raise ArithmeticError(f"plant failed at t = {now:.3f} s: its state is no longer finite")
        position = values[self._cart]
        switch = 0 if abs(position) < self._switch_at else 1 if position > 0 else -1
        measured = self._encoders.measure(
            values if self._seen is None else self._seen,
            now,
            missed=None if draw.missed is None else draw.missed[k],
            noise=None if draw.noise is None else draw.noise[k],
        )
        if self._dropped is not None and self._dropped[k]:
            return Reading(now, self._positions, self._nothing, switch)
        self._positions = measured
        return Reading(now, measured, None, switch)

    def command(self, acceleration: float) -> None:
        """Send the cart's wanted acceleration, m/s²; a second command in one period replaces the first.

        Raises:
            ArithmeticError: it is not a finite number.
        """
        if not math.isfinite(acceleration):
            raise ArithmeticError(f"command = {acceleration!r}: the drive takes finite accelerations only")
        k, demands = max(self._tick, 0), self._demands
        if len(demands) > self._sent_before + k:
            del demands[self._sent_before + k :]
        noise = 0.0 if self._noise is None else self._noise[k]
        demands.append(self._drive.demanded(acceleration, noise, demands[-1]))

    def stop(self) -> None:
        """Brake the cart to a standstill from now on, without the commands' delay."""
        self._braking = True

    def _pass(self, k: int) -> None:
        """Let period k pass."""
        plant, demands, period = self._plant, self._demands, self._period
        if len(demands) < self._sent_before + k + 1:
            demands.append(demands[-1])
        if k in self._blows:
            blow = self._blows[k]
            plant.strike(impulses=blow.impulses, jumps=blow.jumps, knock=blow.knock)
        began, fraction = plant.values[self._cart + 1], self._fraction
        if not fraction and self._ages is None:
            plant.move(self._acting(demands[k + 1], period), period, time=k * period)
        else:
            # The next reading is of the state `seen` seconds into this period.
            seen = period if self._ages is None else period - self._ages[k + 1]
            self._seen = None
            change = fraction * period
            if change:
                self._part(k, demands[k], 0.0, change, seen)
            self._part(k, demands[k + 1], change, period, seen)
        self._acted = (plant.values[self._cart + 1] - began) / period

    def _part(self, k: int, demand: float, begin: float, end: float, seen: float) -> None:
        """Let a part of period k pass, from `begin` to `end` seconds in it, `demand` acting."""
        plant, start = self._plant, k * self._period
        acting = self._acting(demand, end - begin)
        if begin < seen < end:
            plant.move(acting, seen - begin, time=start + begin)
            self._seen = plant.values
            plant.move(acting, end - seen, time=start + seen)
        else:
            if seen == begin:
                self._seen = plant.values
            plant.move(acting, end - begin, time=start + begin)

    def _acting(self, demand: float, duration: float) -> float:
        velocity = self._plant.loop_velocity
        if self._braking:
            return self._drive.braking(velocity, duration)
        return self._drive.acting(demand, velocity, duration)
