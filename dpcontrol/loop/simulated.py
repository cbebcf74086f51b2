"""Simulated bench: plant, sensors and drive, computed tick by tick.

Period k runs from tick k to the next. The command given at tick k - i acts in it, for i whole periods of delay. For a
further fraction f of a period, the previous command acts until k + f. Blows strike at the tick, after its reading. A
cart that reaches the end of its track stops there, and `fault` reports it. The arms keep their momenta.

The same lines compute one run or S runs in lockstep (`Lanes`). A number of one run is an array (S,) for S runs.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from heapq import merge
from itertools import repeat
from operator import itemgetter
from types import MappingProxyType
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.bench_period import DriveNumbers, PeriodKind
from dpcontrol.control.interface import MANY, ONE, Lanes
from dpcontrol.dynamics.compiled import SINGLE, Compiled
from dpcontrol.dynamics.plant import PlantParameters, after_blow, longest_step, plant_modes, plant_step
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import Cause
from dpcontrol.logs import Event
from dpcontrol.loop.bench import BenchDraw, BenchSettings, Blow, SensorSettings
from dpcontrol.loop.own import OwnArms
from dpcontrol.loop.protocols import Reading
from dpcontrol.loop.result import ended
from dpcontrol.references.problem import Limits


class Encoders:
    """Relative encoders of the joints and the cart's scale.

    They have faults during a run.

    Lost counts and stuck sensors require a single run.

    Args:
        zeros: zero errors (n,) or (n, S) of the encoders, rad.
        drift: drift (n,) or (n, S) of the zero errors, rad/s.
        lanes: `ONE` run or `MANY`.
        places: indices in the state that replace the measured joints and cart.
    """

    def __init__(
        self, arms: int, settings: SensorSettings, *, zeros: Array | None = None, drift: Array | None = None,
        lanes: Lanes = ONE, places: Mapping[int, int] = MappingProxyType({}),
    ) -> None:  # fmt: skip
        self.settings = settings
        self._arms, self._lanes = arms, lanes
        self._places, self._cart_place = [places.get(k) for k in range(arms)], places.get(arms, 2 * arms)
        self._steps, self._cart = settings.steps(arms), settings.cart_resolution
        self.zeros: list[Any] = [0.0] * arms if zeros is None else lanes.rows(np.asarray(zeros, dtype=float))
        self.drift: list[Any] | None = None if drift is None or not drift.any() else lanes.rows(drift)
        self._missed = [0] * arms
        self._stuck: float | None = None
        self._stuck_at, self._stuck_until = settings.stuck_at, settings.stuck_at + settings.stuck_for

    def measure(
        self,
        state: Sequence[Any],
        time: float = 0.0,
        *,
        missed: NDArray[np.int64] | None = None,
        noise: Array | None = None,
    ) -> Array:
        """Return measured absolute angles and cart position (n+1,).

        Encoders measure the angles between successive arms, whose readings are added up.

        Args:
            state: True state (2n+2,); a list of floats is fastest.
            time: time of the reading, s, default 0.
            missed: counts (n,) that the encoders of moving joints lose in this tick.
            noise: noise (n+1,) added to the relative angles, rad, and to the cart, m.
        """
        # For arrays this short, plain floats take a third of the time of numpy calls.
        steps, arms, nearest = self._steps, self._arms, self._lanes.rounded
        lost, added = self._missed, None if noise is None else self._lanes.rows(noise)
        if missed is not None:
            self._miss(state, missed.tolist())
        readings: list[Any] = []
        inner: Any = 0.0
        zeros, drift = self.zeros, self.drift
        if drift is not None:
            zeros = [zero + rate * time for zero, rate in zip(zeros, drift, strict=True)]
        for k, (zero, step) in enumerate(zip(zeros, steps, strict=True)):
            outer, own = state[k], self._places[k]
            value = (outer - inner if own is None else state[own]) + zero
            inner = outer
            if added is not None:
                value += added[k]
            readings.append(step * (nearest(value / step) - lost[k]) if step else value)
        cart = state[self._cart_place] if added is None else state[self._cart_place] + added[arms]
        readings.append(self._cart * nearest(cart / self._cart) if self._cart else cart)
        if self._stuck_at <= time < self._stuck_until:
            which = self.settings.stuck_sensor
            if self._stuck is None:
                self._stuck = readings[which]
            readings[which] = self._stuck
        for k in range(1, arms):
            readings[k] += readings[k - 1]
        return np.array(readings)

    def zeros_at(self, times: Array) -> Array:
        """Return the zero errors (K, n) at times (K,), s."""
        zeros = np.broadcast_to(self.zeros, (len(times), self._arms))
        return zeros if self.drift is None else zeros + times[:, None] * np.array(self.drift)

    def _miss(self, state: Sequence[float], missed: Sequence[int]) -> None:
        """Lose counts against the motion of each joint.

        A joint at rest loses none.
        """
        inner = 0.0
        for k, lost in enumerate(missed):
            outer = state[self._arms + k]
            if lost and outer != inner:
                self._missed[k] += lost if outer > inner else -lost
            inner = outer


_SWITCHES, _HALVINGS = 8, 24
"""Maximum number of mode changes within a step, and of bisections for the time of a change, to 1e-10 s."""


class ModalStep:
    """A plant's step, split at mode changes of its components.

    It serves one or many lanes.
    """

    def __init__(self, step: Compiled, modes: Compiled, *, single: bool) -> None:
        self._step, self._choose = (one.single if single else one.machine for one in (step, modes))
        self._state, self._duration = step.slices["state"], step.slices["duration"].start
        inputs = step.slices["inputs"]
        self._modes, self._size = slice(inputs.stop - modes.size_out, inputs.stop), step.size_out

    def __call__(self, inputs: Array, out: Array) -> None:
        """Write the states (N, S) that follow `inputs` (M, S)."""
        n, work, found = len(out), inputs.copy(), np.empty((self._size, inputs.shape[1]))
        chosen, left = np.empty((self._modes.stop - self._modes.start, inputs.shape[1])), work[self._duration].copy()

        def flown(duration: Array) -> NDArray[np.bool_]:
            work[self._duration] = duration
            self._step(work, found)
            return found[n:].min(axis=0) < 0

        for k in range(_SWITCHES):
            self._choose(work, chosen)
            work[self._modes] = chosen
            beyond, taken = flown(left), left
            if k < _SWITCHES - 1 and np.logical_or.reduce(beyond):
                within, taken = np.zeros(len(left)), left.copy()
                for _ in range(_HALVINGS):
                    middle = (within + taken) / 2
                    passed = flown(np.where(beyond, middle, left))
                    taken[beyond & passed] = middle[beyond & passed]
                    within[beyond & ~passed] = middle[beyond & ~passed]
                flown(taken)
            work[self._state] = found[:n]
            left = left - taken
            if not left.any():
                break
        out[:] = work[self._state]


class SimulatedPlant:
    """Arms, cart and drive between ticks, with hard stops at ±track m.

    An instance must not be shared between threads.

    Args:
        plants: parameters of each run.
        state: initial state (N,) or (N, S) of `plant_equations`.
        track: half length of the track, m.
    """

    def __init__(self, plants: list[PlantParameters], state: Array, *, track: float) -> None:
        first = plants[0]
        self.plants, self.track = plants, track
        self.faults: dict[int, Event] = {}
        """Faults at the end of the track, by run number."""
        self._many = many = state.ndim > 1
        kind = {"friction": first.arms.friction, "components": first.kinds}
        step = plant_step(first.arms.count, first.level, **kind)
        modes = plant_modes(first.arms.count, first.level, **kind)
        self._machine = (
            (step.machine if many else step.single) if modes is None else ModalStep(step, modes, single=not many)
        )
        # A single run fills a whole vector, so its result equals that in a batch to the last bit.
        lanes = state.shape[1] if many else SINGLE
        size = step.slices["state"].stop
        self._inputs, following = np.zeros((step.size_in, lanes)), np.zeros((size, lanes))
        self._flown, self._following = following, following if many else following[:, 0]
        self._inputs[step.slices["parameters"]] = np.array([p.numbers() for p in plants]).T
        self._input, self._duration = step.slices["inputs"].start, step.slices["duration"].start
        self.cart, self.motor, self.lag = 2 * first.arms.count, first.motor, first.lag
        self.longest, self._lasts = min(longest_step(p) for p in plants), 0.0
        self.whole_step = step if modes is None else None
        """The step, if it needs no split at changes of modes."""
        self._states: Array = self._inputs[step.slices["state"]]
        self.state: Array = self._states if many else self._states[:, 0]
        """The present state; `move` overwrites it."""
        self.values: list[Any] = list(self.state)
        """Its entries: plain floats for one run, which are faster to access, or views of the arrays for many."""
        self.set_state(state)

    def set_state(self, state: Array) -> None:
        """Replace the states (N,) or (N, S)."""
        self._states[:] = state if self._many else state[:, None]
        if not self._many:
            self.values = state.tolist()

    @property
    def loop_velocity(self) -> Any:
        """The velocity reference w of the drive's loop, m/s.

        Without lag, the velocity of cart or motor.
        """
        v = self.values[self.motor + 1]
        return v + self.lag * self.values[self.cart + 2] if self.lag else v

    def move(self, acceleration: Any, duration: Any, *, time: Any, span: float = 0.0) -> None:
        """Advance the plant with a constant demand.

        Args:
            acceleration: demand of each run, m/s².
            duration: duration for each run, s.
            time: start time, s.
            span: longest duration of all runs, s, if they differ.
        """
        span = span or duration
        splits = 1 if span <= self.longest else math.ceil(span / self.longest)
        inputs, following, track, cart = self._inputs, self._following, self.track, self.cart
        step, many = self._machine, self._many
        duration = duration / splits
        if isinstance(duration, np.ndarray):
            inputs[self._duration], self._lasts = duration, math.nan
        elif duration != self._lasts:
            inputs[self._duration] = self._lasts = duration
        for k in range(splits):
            inputs[self._input] = acceleration
            step(inputs, self._flown)
            if many:
                beyond = np.abs(following[cart]) > track
                if np.logical_or.reduce(beyond):
                    # Too rare to vectorise.
                    for run in np.flatnonzero(beyond).tolist():
                        alone = SimulatedPlant([self.plants[run]], self.state[:, run], track=track)
                        lasts = np.broadcast_to(duration, beyond.shape)[run].item()
                        begin = np.broadcast_to(time, beyond.shape)[run].item()
                        alone.meet_stop(float(acceleration[run]), lasts, begin + k * lasts)
                        self.faults.setdefault(run, alone.faults[0])
                        following[:, run] = alone.state
                self.state[:] = following
                continue
            values: list[Any] = following.tolist()
            if values[cart] > track or values[cart] < -track:
                self.meet_stop(acceleration, float(duration), time + k * duration)
            else:
                self._states[:] = self._flown
                self.values = values

    def replace_runs(self, runs: list[int], other: "SimulatedPlant") -> None:
        """Replace some of many runs by those of a plant with the same settings.

        Args:
            runs: numbers of the runs.
            other: plant with as many runs, which takes their places.
        """
        self._inputs[:, runs] = other._inputs
        self._lasts = math.nan
        for run, plant in zip(runs, other.plants, strict=True):
            self.plants[run] = plant
            self.faults.pop(run, None)

    def strike(self, blow: Blow, run: int = 0) -> None:
        """Apply a blow to one run.

        Args:
            blow: impulses and jumps.
            run: number of the run, default 0.
        """
        state = self.state[:, run] if self._many else self.state
        after = after_blow(self.plants[run], state, impulses=blow.impulses, jumps=blow.jumps, knock=blow.knock)
        if self._many:
            state[:] = after
        else:
            self.set_state(after)

    def _flow(self, acceleration: float, duration: float) -> Array:
        """Return the state of one run after `duration` s, which the next step overwrites."""
        self._inputs[self._input], self._inputs[self._duration] = acceleration, duration
        self._lasts = duration
        self._machine(self._inputs, self._flown)
        return self._following

    def meet_stop(self, acceleration: float, duration: float, time: float) -> None:
        """Move one run to a hard stop within `duration` s.

        The cart stops and is held there.
        """
        cart, track = self.cart, self.track
        free, met = 0.0, duration
        for _ in range(60):
            middle = (free + met) / 2
            if abs(self._flow(acceleration, middle).item(cart)) > track:
                met = middle
            else:
                free = middle
        self.set_state(self._flow(acceleration, free))
        side, speed = math.copysign(1.0, self.values[cart]), self.values[cart + 1]
        place = {"time": time + free, "position": side * track, "velocity": speed}
        self.faults.setdefault(0, ended(Cause.HARD_STOP, place))
        self._hold(side)
        # The drive does not push on against the stop.
        self.set_state(self._flow(0.0, duration - free))
        if side * self.values[cart] > track:
            self._hold(side)

    def _hold(self, side: float) -> None:
        """Hold cart and motor at the hard stop of one side, 1 or -1; the arms keep their momenta."""
        none = np.zeros(self.plants[0].arms.count)
        self.strike(Blow(none, none, -self.values[self.cart + 1]))
        held = self.state.copy()
        for place in (self.cart, self.motor):
            held[place], held[place + 1] = side * self.track, 0.0
        if self.lag:
            held[self.cart + 2] = 0.0
        self.set_state(held)


class DrawnTicks(NamedTuple):
    """Random numbers of K ticks: command_noise (K,), noise (K, n+1), zeros (K, n) of the encoders, dropped (K,)."""

    command_noise: Array
    noise: Array
    zeros: Array
    dropped: NDArray[np.bool_]


_NEVER = (0, (math.inf, None))
"""In place of a run, tick and blow if no blow follows."""


def _of_runs(values: list[Array], lanes: Lanes) -> Array:
    """Return values of runs, along the last axis if there are several."""
    return np.stack(values, axis=-1) if lanes is MANY else values[0]


def _first_states(draws: Sequence[BenchDraw], start: Array, demand: Any, lanes: Lanes) -> Array:
    """Return the states (N,) or (N, S) of plants at the first reading, whose drives follow a demand, m/s²."""
    plant, n = draws[0].plant, draws[0].plant.arms.count
    first = np.array(start if lanes is ONE else np.broadcast_to(start, (len(draws), 2 * n + 2)), dtype=float).T
    first[:n] += _of_runs([draw.initial_error for draw in draws], lanes)
    first[n : 2 * n] += _of_runs([draw.initial_rate for draw in draws], lanes)
    first[2 * n :] += _of_runs([draw.initial_cart for draw in draws], lanes)
    columns = zip(draws, first.reshape(2 * n + 2, -1).T, strict=True)
    further = _of_runs([draw.plant.own_states(state) for draw, state in columns], lanes)
    return np.concatenate([first, [demand], further] if plant.lag else [first, further])


class SimulatedBench:
    """Plants, sensors and drives with the same settings, one for each draw.

    Args:
        start: nominal initial state (2n+2,), to which each draw adds its error, or (S, 2n+2) with one state per run.
        queued: commands that are pending at the start, oldest first, m/s²; earlier ones are zero.
        lanes: `ONE` run or `MANY`.
    """

    def __init__(
        self, draws: Sequence[BenchDraw], settings: BenchSettings, *, limits: Limits, start: Array,
        queued: Sequence[Any] = (), lanes: Lanes = ONE,
    ) -> None:  # fmt: skip
        draw, n = draws[0], draws[0].plant.arms.count

        def by_tick(name: str, rows: Any = np.ndarray.tolist) -> Any:
            """Return values drawn for each tick, which a single run reads tick by tick."""
            if lanes is ONE:
                return draw.reader(name, rows)
            return _of_runs([d.drawn(name) for d in draws], lanes) if name in draw.streams else None

        self.period = draw.period
        """Period of the ticks, s."""
        own = settings.drive.limits(limits)
        self._drive = settings.drive.within(limits, draw.period, clip=lanes.clip)
        self._fails = {settings.drive.failure: settings.drive.failed_at}
        self._switch_at = own.position - settings.drive.switch_margin
        whole = math.floor(settings.drive.delay)
        self._fraction = settings.drive.delay - whole
        demands: list[Any] = [0.0 if lanes is ONE else np.zeros(len(draws))] * (whole + 1)
        for command in queued:
            demands.append(self._drive.demanded(command, 0.0, demands[-1]))
        # Ordered by the time they act: the second one begins to act in the coming period, which deletes the first.
        self._demands = demands[-(whole + 1) :]
        self._sent_before = whole + 1
        self._command_noise, self._noise = by_tick("command_noise"), by_tick("noise", np.asarray)
        self._missed, self._ages = draw.reader("missed", np.asarray), by_tick("ages")
        self._reports = settings.sensors.ages == "reported" and self._ages is not None
        self._dropped, self._many = by_tick("dropped"), lanes is MANY
        self._last: Any = np.zeros((n + 1, len(draws)) if self._many else n + 1)
        self._encoders = Encoders(
            n,
            settings.sensors,
            zeros=_of_runs([d.zeros for d in draws], lanes),
            drift=_of_runs([d.drift for d in draws], lanes),
            lanes=lanes,
            places=draw.plant.reads,
        )
        first = _first_states(draws, start, self._demands[0], lanes)
        self._plant = (
            SimulatedPlant([d.plant for d in draws], first, track=own.position) if draw.own is None
            else OwnArms(draw.own, draw.plant, first, track=own.position)
        )  # fmt: skip
        self.truth: Array = self._plant.state[: 2 * n + 2]
        """The true state (2n+2,) or states (2n+2, S) at the last reading; the next reading overwrites it."""
        self.hardest: Any = 0.0
        """The largest acceleration that the drive has applied in each run, m/s²."""
        self._larger: Any = max if lanes is ONE else np.maximum
        self._seen: Any = None
        self._cart, self._tick = 2 * n, -1
        self._braking: Any = None
        self._off = False
        known = (zip(repeat(run), sorted(d.blows.items(), key=itemgetter(0))) for run, d in enumerate(draws))
        random = (zip(repeat(run), d.random_blows()) for run, d in enumerate(draws))
        # In order of the ticks, first the known ones.
        self._blows: Iterator[Any] = merge(*known, *random, key=lambda one: one[1][0])
        self._coming: Any = next(self._blows, _NEVER)

    def _measured(self, k: int) -> Array:
        """Return what the encoders measure at a tick."""
        return self._encoders.measure(
            self._plant.values if self._seen is None else self._seen,
            k * self.period,
            missed=None if self._missed is None else self._missed[k],
            noise=None if self._noise is None else self._noise[k],
        )

    def _age(self, k: int) -> Any:
        """Return the age of a reading, s, or None.

        The result is None if the bench does not report ages.
        """
        # The first reading shows the initial state.
        return self._ages[k] if self._reports and k else None

    def _demand(self, k: int, acceleration: Any) -> None:
        """Store the command of tick k, m/s².

        A second one in the same period replaces the first.
        """
        demands = self._demands
        del demands[self._sent_before :]
        noise = 0.0 if self._command_noise is None else self._command_noise[k]
        if k * self.period >= self._fails.get("reversed", math.inf):
            acceleration = -acceleration
        demands.append(self._drive.demanded(acceleration, noise, demands[-1]))

    def _pass(self, k: int) -> None:
        """Advance the bench by period k."""
        plant, demands, period = self._plant, self._demands, self.period
        self._off = k * period >= self._fails.get("off", math.inf)
        if len(demands) <= self._sent_before:
            demands.append(demands[-1])
        while self._coming[1][0] <= k:
            run, (_, blow) = self._coming
            plant.strike(blow, run)
            self._coming = next(self._blows, _NEVER)
        fraction = self._fraction
        if not fraction and self._ages is None:
            plant.move(self._acting(demands[1], period), period, time=k * period)
        else:
            # The next reading shows the state `seen` seconds into this period.
            seen = period if self._ages is None else period - self._ages[k + 1]
            self._seen = None
            change = fraction * period
            if change:
                self._part(k, demands[0], 0.0, change, seen)
            self._part(k, demands[1], change, period, seen)
        del demands[0]

    def _part(self, k: int, demand: Any, begin: float, end: float, seen: float) -> None:
        """Advance a part of period k under `demand`.

        The part lasts from `begin` to `end` s within the period.
        """
        plant, start, span = self._plant, k * self.period, end - begin
        acting = self._acting(demand, span)
        if self._many:
            # Runs that are read before or after this part have zero duration in one of the two moves.
            middle = np.clip(seen, begin, end)
            plant.move(acting, middle - begin, time=start + begin, span=span)
            # The end of the period belongs to its last part.
            now = (begin <= seen) & ((seen < end) | (end >= self.period))
            self._seen = np.where(now, plant.state, plant.state if self._seen is None else self._seen)
            plant.move(acting, end - middle, time=start + middle, span=span)
        elif begin < seen < end:
            plant.move(acting, seen - begin, time=start + begin, span=span)
            self._seen = plant.values
            plant.move(acting, end - seen, time=start + seen, span=span)
        else:
            if seen == begin:
                self._seen = plant.values
            plant.move(acting, span, time=start + begin)

    def _acting(self, demand: Any, duration: float) -> Any:
        """Return the drive's acceleration, m/s², which keeps its velocity reference in bounds or brakes."""
        drive, velocity, braking = self._drive, self._plant.loop_velocity, self._braking
        if self._off or braking is True:
            acting = drive.braking(velocity, duration)
        elif braking is None:
            acting = drive.acting(demand, velocity, duration)
        else:
            acting = np.where(braking, drive.braking(velocity, duration), drive.acting(demand, velocity, duration))
        self.hardest = self._larger(self.hardest, abs(acting))
        return acting


class SimulatedRig(SimulatedBench):
    """A simulated bench with the `Rig` protocol.

    Args:
        start: see `SimulatedBench`.
        queued: see `SimulatedBench`.
    """

    def __init__(
        self, draw: BenchDraw, settings: BenchSettings, *, limits: Limits, start: Array, queued: Sequence[float] = ()
    ) -> None:
        super().__init__([draw], settings, limits=limits, start=start, queued=queued)
        self._nothing = np.zeros(draw.plant.arms.count + 1, dtype=bool)

    @property
    def state(self) -> Array:
        """The plant's full state (N,).

        The true state, then the demand of a lagging drive.
        """
        return self._plant.state

    @property
    def fault(self) -> Event | None:
        """The fault at the end of the track, or None."""
        return self._plant.faults.get(0)

    @cached_property
    def kind(self) -> PeriodKind | None:
        """A period as one expression, or None for a bench that computes it in parts or outside of machine code."""
        plant, settings = self._plant, self._encoders.settings
        if self._fraction or self._ages is not None or self._missed is not None:
            return None
        if math.isfinite(settings.stuck_at) or math.isfinite(min(self._fails.values())):
            return None
        if not isinstance(plant, SimulatedPlant) or plant.whole_step is None or self.period > plant.longest:
            return None
        return PeriodKind(
            plant.whole_step,
            len(plant.state),
            self._sent_before + 1,
            plant.lag > 0,
            tuple((self.steps > 0).tolist()),
            tuple(plant.plants[0].reads.items()),
            plant.cart,
            plant.motor,
        )

    @cached_property
    def steps(self) -> Array:
        """Counts (n+1,) of the encoders and of the cart's scale, rad and m, 0 for exact ones."""
        settings, arms = self._encoders.settings, len(self._nothing) - 1
        return np.array([*settings.steps(arms), settings.cart_resolution])

    @cached_property
    def parameters(self) -> Array:
        """Parameters of the plant's step."""
        return cast("SimulatedPlant", self._plant).plants[0].numbers()

    @cached_property
    def drive_numbers(self) -> Array:
        """Values of `DriveNumbers`."""
        d, plant = self._drive, cast("SimulatedPlant", self._plant)
        numbers = DriveNumbers(d.acceleration, d.velocity, d.jerk_step, d.response, plant.lag, self.period)
        return np.array(numbers, dtype=float)

    def plain_ticks(self, k: int, most: int) -> int:
        """Return how many ticks from k on, at most `most`, need only the expression of `kind`."""
        if not k or self._braking is not None:
            return 0
        return max(0, min(most, self._coming[1][0] + 1 - k))

    def plain_states(self, states: Array) -> NDArray[np.bool_]:
        """Return True for each state (K, N) that is finite, with the cart on its track and away from the switches."""
        cart = np.abs(states[:, self._cart])
        return (
            (cart <= cast("SimulatedPlant", self._plant).track)
            & (cart < self._switch_at)
            & np.isfinite(states.sum(axis=1))
        )

    @property
    def stored(self) -> tuple[Array, list[float], Array, float]:
        """State of the plant, demands, m/s², last reading (n+1,), and the drive's coming acceleration, m/s²."""
        return self._plant.state, self._demands, self._last, self._acting(self._demands[1], self.period)

    @property
    def draws(self) -> bool:
        """True if random numbers or drifts change from tick to tick."""
        streams = self._command_noise, self._noise, self._dropped
        return self._encoders.drift is not None or any(stream is not None for stream in streams)

    def drawn(self, k: int, count: int) -> DrawnTicks:
        """Return the random numbers of ticks from k on."""
        ticks, n = range(k, k + count), len(self._nothing) - 1

        def of(stream: Any, *shape: int) -> Array:
            return np.zeros((count, *shape)) if stream is None else np.array([stream[tick] for tick in ticks])

        zeros = self._encoders.zeros_at(np.asarray(np.arange(k, k + count) * self.period, dtype=np.float64))
        return DrawnTicks(of(self._command_noise), of(self._noise, n + 1), zeros, of(self._dropped) > 0)

    def resume(self, tick: int, state: Array, demands: Array, read: Array, *, hardest: float) -> None:
        """Continue after a tick with a state, demands and reading as in `stored`.

        Args:
            tick: the last tick.
            state: state (N,) of the plant.
            demands: demands, oldest first, m/s².
            read: its reading (n+1,), rad and m.
            hardest: largest acceleration of the drive since the last call, m/s².
        """
        self._tick, self._last, self._demands = tick, read.copy(), demands.tolist()
        cast("SimulatedPlant", self._plant).set_state(state)
        self.hardest = max(self.hardest, hardest)

    def read(self) -> Reading:
        """Advance one period, except in the first call, and return the readings.

        Raises:
            ArithmeticError: the state is no longer finite.
        """
        k = self._tick + 1
        if k:
            self._pass(k - 1)
        self._tick = k
        now, values = k * self.period, self._plant.values
        if not math.isfinite(sum(values)):
            raise ArithmeticError(f"plant failed at t = {now:.3f} s: its state is no longer finite")
        position = values[self._cart]
        switch = 0 if abs(position) < self._switch_at else 1 if position > 0 else -1
        # Encoders count, and lose counts, even if readings are dropped.
        measured = self._measured(k)
        if self._dropped is not None and self._dropped[k]:
            return Reading(now, self._last, self._nothing, switch)
        self._last = measured
        return Reading(now, measured, None, switch, age=self._age(k))

    def command(self, acceleration: float) -> None:
        """Send the demanded acceleration of the cart.

        A second command in one period replaces the first.

        Args:
            acceleration: demand, m/s².
        """
        self._demand(max(self._tick, 0), acceleration)

    def stop(self) -> None:
        """Brake the cart to a standstill at once, without the commands' delay."""
        self._braking = True


class BatchBench(SimulatedBench):
    """The simulated benches of S runs, which advance together."""

    @property
    def failed(self) -> NDArray[np.bool_] | None:
        """True for each state (S,) that is not finite.

        The result is None if all are finite.
        """
        # One sum detects the rare failure; only then is each run checked.
        if math.isfinite(np.add.reduce(self._plant.state, axis=None)):
            return None
        failed = ~np.isfinite(self._plant.state.sum(axis=0))
        return failed if failed.any() else None

    @property
    def faults(self) -> Mapping[int, Event]:
        """Causes of failed runs, by run number."""
        return self._plant.faults

    def read(self) -> Reading:
        """Advance one period, except in the first call.

        Return positions (n+1, S) and switches.
        """
        self._tick = k = self._tick + 1
        if k:
            self._pass(k - 1)
        switch = np.abs(self._plant.values[self._cart]) >= self._switch_at
        measured, present = self._measured(k), None
        if self._dropped is not None:
            measured = np.where(self._dropped[k], self._last, measured)
            present = np.broadcast_to(~self._dropped[k], measured.shape)
        self._last = measured
        return Reading(k * self.period, measured, present, switch, age=self._age(k))

    def command(self, accelerations: Array) -> None:
        """Accelerate the carts.

        Args:
            accelerations: demanded accelerations (S,) of the carts, m/s².
        """
        # The array is a part of the report, which the next tick overwrites.
        self._demand(self._tick, accelerations.copy())

    def stop(self, runs: list[int]) -> None:
        """Brake the carts of these runs to a standstill at once.

        The commands' delay does not apply.

        Args:
            runs: numbers of the runs.
        """
        if self._braking is None:
            self._braking = np.zeros(self.truth.shape[1], dtype=bool)
        self._braking[runs] = True

    def replace_runs(self, runs: list[int], other: "BatchBench") -> None:
        """Replace runs by those of a bench with the same settings that has been read once.

        Noise and blows, which follow the ticks of the whole bench, remain those of the replaced runs.

        Args:
            runs: numbers of the runs.
            other: bench with as many runs, which takes their places.
        """
        plant: Any = self._plant
        plant.replace_runs(runs, other._plant)
        self._last[:, runs] = other._last
        pairs = [*zip(self._demands, other._demands, strict=False)]
        for mine, theirs in [*pairs, *zip(self._encoders.zeros, other._encoders.zeros, strict=True)]:
            mine[runs] = theirs
