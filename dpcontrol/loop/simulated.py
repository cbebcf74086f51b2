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
    """Simulated sensors: relative encoders of the joints and the cart's scale, with their faults during a run.

    Lost counts and stuck sensors require a single run.

    Args:
        arms: number n of arms.
        settings: resolution and faults.
        zeros: zero errors (n,) or (n, S) of the encoders, rad.
        drift: drift (n,) or (n, S) of the zero errors, rad/s.
        lanes: `ONE` run or `MANY`.
        places: indices in the state that replace the measured joints and cart, such as those of an encoder with play.
    """

    def __init__(
        self, arms: int, settings: SensorSettings, *, zeros: Array | None = None, drift: Array | None = None,
        lanes: Lanes = ONE, places: Mapping[int, int] = MappingProxyType({}),
    ) -> None:  # fmt: skip
        """Begin with no lost counts (`_missed`) and no stuck value (`_stuck`).

        `_steps` (n,) and `_cart` are the resolutions of the encoders, rad, and of the cart's scale, m, 0 for none. A
        sensor is stuck from `_stuck_at` to `_stuck_until`, s.
        """
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
        steps, arms, rounded = self._steps, self._arms, self._lanes.rounded
        lost_counts, added_noise = self._missed, None if noise is None else self._lanes.rows(noise)
        if missed is not None:
            self._miss(state, missed.tolist())
        readings: list[Any] = []
        inner_angle: Any = 0.0
        zeros, drift = self.zeros, self.drift
        if drift is not None:
            zeros = [zero + rate * time for zero, rate in zip(zeros, drift, strict=True)]
        for k, (zero, step) in enumerate(zip(zeros, steps, strict=True)):
            # An encoder with play reads an entry of the state of its own, at index `place`.
            angle, place = state[k], self._places[k]
            joint = (angle - inner_angle if place is None else state[place]) + zero
            inner_angle = angle
            if added_noise is not None:
                joint += added_noise[k]
            readings.append(step * (rounded(joint / step) - lost_counts[k]) if step else joint)
        cart = state[self._cart_place] if added_noise is None else state[self._cart_place] + added_noise[arms]
        readings.append(self._cart * rounded(cart / self._cart) if self._cart else cart)
        if self._stuck_at <= time < self._stuck_until:
            sensor = self.settings.stuck_sensor
            if self._stuck is None:
                self._stuck = readings[sensor]
            readings[sensor] = self._stuck
        for k in range(1, arms):
            readings[k] += readings[k - 1]
        return np.array(readings)

    def zeros_at(self, times: Array) -> Array:
        """Return the zero errors (K, n) of the encoders at times (K,), s, which grow by their drift, rad."""
        zeros = np.broadcast_to(self.zeros, (len(times), self._arms))
        return zeros if self.drift is None else zeros + times[:, None] * np.array(self.drift)

    def _miss(self, state: Sequence[float], missed: Sequence[int]) -> None:
        """Add the counts that each encoder loses in a tick to `_missed`, which `measure` subtracts from its reading.

        An encoder that misses edges of its pulses counts too little in the direction of its joint's motion. A joint at
        rest loses none.

        Args:
            state: true state (2n+2,).
            missed: counts (n,) that moving joints lose in this tick.
        """
        inner_rate = 0.0
        for k, count in enumerate(missed):
            rate = state[self._arms + k]
            if count and rate != inner_rate:
                self._missed[k] += count if rate > inner_rate else -count
            inner_rate = rate


_SWITCHES, _HALVINGS = 8, 24
"""Maximum number of mode changes within a step, and of bisections for the time of a change, to 1e-10 s."""


class ModalStep:
    """A plant's step, split at mode changes of its components, such as a joint that sticks or slides.

    Each lane changes its mode at its own time, so a step serves one or many lanes.

    Args:
        step: the plant's step in constant modes.
        modes: choice of the modes for a state.
        single: True for one lane.
    """

    def __init__(self, step: Compiled, modes: Compiled, *, single: bool) -> None:
        """Find the rows of state, duration and modes in the step's inputs; the modes are the last rows of `inputs`."""
        self._step, self._choose = (function.single if single else function.machine for function in (step, modes))
        self._state, self._duration = step.slices["state"], step.slices["duration"].start
        inputs = step.slices["inputs"]
        self._modes, self._size = slice(inputs.stop - modes.size_out, inputs.stop), step.size_out

    def __call__(self, inputs: Array, out: Array) -> None:
        """Write the states (N, S) at the end of a step into `out`.

        Each pass advances all lanes to their next mode change, whose time is found by bisection, or to the end of the
        step. The last of `_SWITCHES` passes ignores further changes, so a joint that chatters cannot continue for ever.

        Args:
            inputs: state, duration, inputs and parameters (M, S) of the step.
            out: array (N, S) for the states.
        """
        n, step_inputs, step_outputs = len(out), inputs.copy(), np.empty((self._size, inputs.shape[1]))
        modes, remaining = (
            np.empty((self._modes.stop - self._modes.start, inputs.shape[1])),
            step_inputs[self._duration].copy(),
        )

        def advance(duration: Array) -> NDArray[np.bool_]:
            """Advance all lanes by `duration` (S,), s, and return True (S,) where a mode changes in that time.

            Each call starts from the state in `step_inputs` and writes to `step_outputs`. There, the rows after the n
            states are negative once a mode no longer holds.
            """
            step_inputs[self._duration] = duration
            self._step(step_inputs, step_outputs)
            return step_outputs[n:].min(axis=0) < 0

        for k in range(_SWITCHES):
            self._choose(step_inputs, modes)
            step_inputs[self._modes] = modes
            changes, elapsed = advance(remaining), remaining
            if k < _SWITCHES - 1 and np.logical_or.reduce(changes):
                before_change, elapsed = np.zeros(len(remaining)), remaining.copy()
                for _ in range(_HALVINGS):
                    middle = (before_change + elapsed) / 2
                    changed = advance(np.where(changes, middle, remaining))
                    elapsed[changes & changed] = middle[changes & changed]
                    before_change[changes & ~changed] = middle[changes & ~changed]
                advance(elapsed)
            step_inputs[self._state] = step_outputs[:n]
            remaining = remaining - elapsed
            if not remaining.any():
                break
        out[:] = step_inputs[self._state]


class SimulatedPlant:
    """Arms, cart and drive between ticks, with hard stops at ±track m, of one run or of S runs in lockstep.

    An instance must not be shared between threads.

    Args:
        plants: parameters of each run.
        state: initial state (N,) or (N, S) of `plant_equations`.
        track: half length of the track, m.
    """

    def __init__(self, plants: list[PlantParameters], state: Array, *, track: float) -> None:
        """Compile the plant's step, and allocate its inputs, whose rows hold state, duration, demand and parameters.

        `_inputs` are the inputs of the step, of which `_states` are the rows of the state; `_input` and `_duration` are
        the rows of demand and duration. `_machine` writes the state at the end of a step into `_flown`; `_following` is
        the same memory, without lanes for one run. `longest` is the longest step that is accurate, s, and `_lasts` the
        duration now in the inputs, s. `cart` and `motor` are the indices of their positions in the state.
        """
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
        self._inputs[step.slices["parameters"]] = np.array([plant.numbers() for plant in plants]).T
        self._input, self._duration = step.slices["inputs"].start, step.slices["duration"].start
        self.cart, self.motor, self.lag = 2 * first.arms.count, first.motor, first.lag
        self.longest, self._lasts = min(longest_step(plant) for plant in plants), 0.0
        self.whole_step = step if modes is None else None
        """The step, if it needs no split at changes of modes."""
        self._states: Array = self._inputs[step.slices["state"]]
        self.state: Array = self._states if many else self._states[:, 0]
        """The present state; `move` overwrites it."""
        self.values: list[Any] = list(self.state)
        """Its entries: plain floats for one run, which are faster to access, or views of the arrays for many."""
        self.set_state(state)

    def set_state(self, state: Array) -> None:
        """Replace the state (N,) of one run, or the states (N, S) of many, for example after a blow."""
        self._states[:] = state if self._many else state[:, None]
        if not self._many:
            self.values = state.tolist()

    @property
    def loop_velocity(self) -> Any:
        """The velocity reference w of the drive's loop, m/s, which the drive keeps within its limit.

        Without lag, it is the velocity of the cart, or of the motor of a cart on a belt.
        """
        # Velocities follow positions in the state; with lag, the cart's acceleration follows its velocity.
        velocity = self.values[self.motor + 1]
        return velocity + self.lag * self.values[self.cart + 2] if self.lag else velocity

    def move(self, acceleration: Any, duration: Any, *, time: Any, span: float = 0.0) -> None:
        """Advance the plant with a constant demand, and stop a cart that reaches the end of its track.

        A duration longer than the longest accurate step is split.

        Args:
            acceleration: demand of each run, m/s².
            duration: duration for each run, s.
            time: start time of each run, s, for the events of hard stops.
            span: longest duration of all runs, s, if they differ; 0 if `duration` is the same for all.
        """
        span = span or duration
        splits = 1 if span <= self.longest else math.ceil(span / self.longest)
        inputs, following, track, cart = self._inputs, self._following, self.track, self.cart
        step, many = self._machine, self._many
        duration = duration / splits
        # The duration is written only if it changes; NaN equals none, so the next one is written.
        if isinstance(duration, np.ndarray):
            inputs[self._duration], self._lasts = duration, math.nan
        elif duration != self._lasts:
            inputs[self._duration] = self._lasts = duration
        for k in range(splits):
            inputs[self._input] = acceleration
            step(inputs, self._flown)
            if many:
                at_stop = np.abs(following[cart]) > track
                if np.logical_or.reduce(at_stop):
                    # Too rare to vectorise.
                    for run in np.flatnonzero(at_stop).tolist():
                        single = SimulatedPlant([self.plants[run]], self.state[:, run], track=track)
                        step_duration = np.broadcast_to(duration, at_stop.shape)[run].item()
                        step_start = np.broadcast_to(time, at_stop.shape)[run].item()
                        single.meet_stop(float(acceleration[run]), step_duration, step_start + k * step_duration)
                        self.faults.setdefault(run, single.faults[0])
                        following[:, run] = single.state
                self.state[:] = following
                continue
            values: list[Any] = following.tolist()
            if values[cart] > track or values[cart] < -track:
                self.meet_stop(acceleration, float(duration), time + k * duration)
            else:
                self._states[:] = self._flown
                self.values = values

    def replace_runs(self, runs: list[int], other: "SimulatedPlant") -> None:
        """Replace some of many runs by those of a plant with the same settings, to begin new runs in their places.

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
        """Apply a blow to one run: impulses on the arms, jumps of their rates, a jump of the cart's velocity.

        Args:
            blow: impulses and jumps.
            run: number of the run, default 0.
        """
        state = self.state[:, run] if self._many else self.state
        struck = after_blow(self.plants[run], state, impulses=blow.impulses, jumps=blow.jumps, knock=blow.knock)
        if self._many:
            state[:] = struck
        else:
            self.set_state(struck)

    def _flow(self, acceleration: float, duration: float) -> Array:
        """Return the state (N,) of one run after `duration` s with a constant acceleration, without storing it.

        The next step overwrites the array.
        """
        self._inputs[self._input], self._inputs[self._duration] = acceleration, duration
        self._lasts = duration
        self._machine(self._inputs, self._flown)
        return self._following

    def meet_stop(self, acceleration: float, duration: float, time: float) -> None:
        """Advance a run whose cart hits a hard stop within `duration` s and stops there.

        In the remaining time the drive has no demand, so it does not push on against the stop. The time of contact is
        found by bisection. The first contact of a run is stored in `faults`.

        Args:
            acceleration: demanded acceleration of the cart, m/s².
            duration: duration of the step, s.
            time: time at the start of the step, s.
        """
        cart, track = self.cart, self.track
        before_contact, after_contact = 0.0, duration
        # Sixty bisections reach the precision of a double.
        for _ in range(60):
            middle = (before_contact + after_contact) / 2
            if abs(self._flow(acceleration, middle).item(cart)) > track:
                after_contact = middle
            else:
                before_contact = middle
        self.set_state(self._flow(acceleration, before_contact))
        side, speed = math.copysign(1.0, self.values[cart]), self.values[cart + 1]
        figures = {"time": time + before_contact, "position": side * track, "velocity": speed}
        self.faults.setdefault(0, ended(Cause.HARD_STOP, figures))
        self._hold(side)
        self.set_state(self._flow(0.0, duration - before_contact))
        if side * self.values[cart] > track:
            self._hold(side)

    def _hold(self, side: float) -> None:
        """Set cart and motor at rest at the hard stop of one side, 1 or -1; the arms keep their momenta.

        A knock that cancels the cart's velocity gives the rates of the arms after the impact. In the state, a velocity
        follows each position, and the acceleration of a lagging drive follows the cart's velocity.
        """
        zeros = np.zeros(self.plants[0].arms.count)
        self.strike(Blow(zeros, zeros, -self.values[self.cart + 1]))
        state = self.state.copy()
        for place in (self.cart, self.motor):
            state[place], state[place + 1] = side * self.track, 0.0
        if self.lag:
            state[self.cart + 2] = 0.0
        self.set_state(state)


class DrawnTicks(NamedTuple):
    """Random numbers of K ticks for `Blocks`.

    command_noise (K,), m/s². noise (K, n+1) of relative angles and cart, rad and m. zeros (K, n) of the encoders, rad.
    dropped (K,): True for ticks without a reading.
    """

    command_noise: Array
    noise: Array
    zeros: Array
    dropped: NDArray[np.bool_]


_NEVER = (0, (math.inf, None))
"""Run, tick and blow that stand for the end of the blows: the tick is never reached."""


def _of_runs(values: list[Array], lanes: Lanes) -> Array:
    """Return values of runs as one array, along the last axis for many runs, or the value of the only run."""
    return np.stack(values, axis=-1) if lanes is MANY else values[0]


def _first_states(draws: Sequence[BenchDraw], start: Array, demand: Any, lanes: Lanes) -> Array:
    """Return the states (N,) or (N, S) of plants at the first reading: the nominal start and the drawn errors.

    The 2n+2 entries of arms and cart are followed by the acceleration of a lagging drive, and by the states of
    components such as a belt.

    Args:
        draws: draw of each run.
        start: nominal initial state (2n+2,), or (S, 2n+2) with one state per run.
        demand: acceleration that the drive follows at the start, m/s², a number or (S,).
        lanes: `ONE` run or `MANY`.
    """
    plant, n = draws[0].plant, draws[0].plant.arms.count
    first = np.array(start if lanes is ONE else np.broadcast_to(start, (len(draws), 2 * n + 2)), dtype=float).T
    first[:n] += _of_runs([draw.initial_error for draw in draws], lanes)
    first[n : 2 * n] += _of_runs([draw.initial_rate for draw in draws], lanes)
    first[2 * n :] += _of_runs([draw.initial_cart for draw in draws], lanes)
    columns = zip(draws, first.reshape(2 * n + 2, -1).T, strict=True)
    component_states = _of_runs([draw.plant.own_states(state) for draw, state in columns], lanes)
    return np.concatenate([first, [demand], component_states] if plant.lag else [first, component_states])


class SimulatedBench:
    """Plants, sensors and drives with the same settings, one for each draw.

    `_fails` is the time of a failure by its kind ("off" or "reversed"), s, and `_switch_at` the distance of the limit
    switches from the centre, m. `_seen` is the state that the next reading shows if it is older than the tick, else
    None. `_braking` is None until a run is stopped, then True, or (S,) for many runs. `_off` is True once the drive has
    failed. `_coming` is the next blow as (run, (tick, blow)).

    Args:
        draws: draw of each run.
        settings: settings of all benches.
        limits: the itinerary's limits, which apply where the drive has none.
        start: nominal initial state (2n+2,), to which each draw adds its error, or (S, 2n+2) with one state per run.
        queued: commands that are pending at the start, oldest first, m/s²; earlier ones are zero.
        lanes: `ONE` run or `MANY`.
    """

    def __init__(
        self, draws: Sequence[BenchDraw], settings: BenchSettings, *, limits: Limits, start: Array,
        queued: Sequence[Any] = (), lanes: Lanes = ONE,
    ) -> None:  # fmt: skip
        """Begin before the first reading (tick -1), with the queued commands on their way to the drives.

        `_demands` holds the demands in the order in which they act. `_sent_before` is the number of those sent before
        the present period, and `_fraction` the part of the delay beyond whole periods. `_last` is the last reading that
        was not dropped, (n+1,) or (n+1, S), rad and m. `_reports` is True if readings come with their ages.

        `by_tick` gives the random numbers of the stream `name` in `draw.streams`, of which the reader of a single run
        converts blocks by `rows`.
        """
        draw, n = draws[0], draws[0].plant.arms.count

        def by_tick(name: str, rows: Any = np.ndarray.tolist) -> Any:
            """Return a stream's numbers by tick: a reader for one run, an array (K, …, S) for many, None if unused."""
            if lanes is ONE:
                return draw.reader(name, rows)
            return _of_runs([run_draw.drawn(name) for run_draw in draws], lanes) if name in draw.streams else None

        self.period = draw.period
        """Period of the ticks, s."""
        bounds = settings.drive.limits(limits)
        self._drive = settings.drive.within(limits, draw.period, clip=lanes.clip)
        self._fails = {settings.drive.failure: settings.drive.failed_at}
        self._switch_at = bounds.position - settings.drive.switch_margin
        whole_periods = math.floor(settings.drive.delay)
        self._fraction = settings.drive.delay - whole_periods
        demands: list[Any] = [0.0 if lanes is ONE else np.zeros(len(draws))] * (whole_periods + 1)
        for command in queued:
            demands.append(self._drive.demanded(command, 0.0, demands[-1]))
        # Ordered by the time they act: the second one begins to act in the coming period, which deletes the first.
        self._demands = demands[-(whole_periods + 1) :]
        self._sent_before = whole_periods + 1
        self._command_noise, self._noise = by_tick("command_noise"), by_tick("noise", np.asarray)
        self._missed, self._ages = draw.reader("missed", np.asarray), by_tick("ages")
        self._reports = settings.sensors.ages == "reported" and self._ages is not None
        self._dropped, self._many = by_tick("dropped"), lanes is MANY
        self._last: Any = np.zeros((n + 1, len(draws)) if self._many else n + 1)
        self._encoders = Encoders(
            n,
            settings.sensors,
            zeros=_of_runs([run_draw.zeros for run_draw in draws], lanes),
            drift=_of_runs([run_draw.drift for run_draw in draws], lanes),
            lanes=lanes,
            places=draw.plant.reads,
        )
        first = _first_states(draws, start, self._demands[0], lanes)
        self._plant = (
            SimulatedPlant([run_draw.plant for run_draw in draws], first, track=bounds.position) if draw.own is None
            else OwnArms(draw.own, draw.plant, first, track=bounds.position)
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
        fixed_blows = (
            zip(repeat(run), sorted(run_draw.blows.items(), key=itemgetter(0))) for run, run_draw in enumerate(draws)
        )
        random_blows = (zip(repeat(run), run_draw.random_blows()) for run, run_draw in enumerate(draws))
        # In order of the ticks, first the known ones.
        self._blows: Iterator[Any] = merge(*fixed_blows, *random_blows, key=lambda entry: entry[1][0])
        self._coming: Any = next(self._blows, _NEVER)

    def _measured(self, k: int) -> Array:
        """Return the readings (n+1,) or (n+1, S) of the encoders at tick k, rad and m, with lost counts and noise.

        `_seen` is the state that a reading with an age shows; None for a reading of the present state.
        """
        return self._encoders.measure(
            self._plant.values if self._seen is None else self._seen,
            k * self.period,
            missed=None if self._missed is None else self._missed[k],
            noise=None if self._noise is None else self._noise[k],
        )

    def _age(self, k: int) -> Any:
        """Return the age of the reading at tick k, s, or None if the bench does not report ages."""
        # The first reading shows the initial state.
        return self._ages[k] if self._reports and k else None

    def _demand(self, k: int, acceleration: Any) -> None:
        """Append the command of tick k, m/s², to the demands on their way to the drive, within the drive's limits.

        A second command in the same period replaces the first: the first `_sent_before` demands are of earlier periods.
        A drive with reversed wiring (`_fails`, time of a failure by its kind) inverts the command.
        """
        demands = self._demands
        del demands[self._sent_before :]
        noise = 0.0 if self._command_noise is None else self._command_noise[k]
        if k * self.period >= self._fails.get("reversed", math.inf):
            acceleration = -acceleration
        demands.append(self._drive.demanded(acceleration, noise, demands[-1]))

    def _pass(self, k: int) -> None:
        """Advance the bench by period k, from tick k to the next, with its blows and the demands that act in it.

        If no command was sent in this period, the last demand is repeated. `_coming` is the next blow as (run, (tick,
        blow)). With a delay of i + f periods, the oldest demand acts for the fraction f, then the second one.
        """
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
            reading_time = period if self._ages is None else period - self._ages[k + 1]
            self._seen = None
            demand_change = fraction * period
            if demand_change:
                self._part(k, demands[0], 0.0, demand_change, reading_time)
            self._part(k, demands[1], demand_change, period, reading_time)
        del demands[0]

    def _part(self, k: int, demand: Any, begin: float, end: float, seen: float) -> None:
        """Advance the bench over a part of period k in which one demand acts.

        A reading with an age shows a state within the period, which is stored in `_seen`.

        Args:
            k: number of the period.
            demand: demand that acts, m/s².
            begin: start of the part within the period, s.
            end: its end within the period, s.
            seen: time within the period of the state that the next reading shows, s, a number or (S,).
        """
        plant, start, span = self._plant, k * self.period, end - begin
        acting = self._acting(demand, span)
        if self._many:
            # Runs that are read before or after this part have zero duration in one of the two moves.
            middle = np.clip(seen, begin, end)
            plant.move(acting, middle - begin, time=start + begin, span=span)
            # The end of the period belongs to its last part.
            is_read = (begin <= seen) & ((seen < end) | (end >= self.period))
            self._seen = np.where(is_read, plant.state, plant.state if self._seen is None else self._seen)
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
        """Return the drive's acceleration for a demand, m/s² (a number or (S,)), and update the largest, `hardest`.

        The drive keeps its velocity reference in bounds for `duration` s. It brakes instead if it has failed (`_off`)
        or the run was stopped: `_braking` is None before any stop, True for a single run, and (S,) for many runs.
        """
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
    """A simulated bench of one run, with the `Rig` protocol.

    Args:
        draw: draw of the run.
        settings: settings of the bench.
        limits: see `SimulatedBench`.
        start: see `SimulatedBench`.
        queued: see `SimulatedBench`.
    """

    def __init__(
        self, draw: BenchDraw, settings: BenchSettings, *, limits: Limits, start: Array, queued: Sequence[float] = ()
    ) -> None:
        super().__init__([draw], settings, limits=limits, start=start, queued=queued)
        # Sensors of a tick without a reading.
        self._nothing = np.zeros(draw.plant.arms.count + 1, dtype=bool)

    @property
    def state(self) -> Array:
        """The plant's full state (N,): the true state, the demand of a lagging drive, and the components' states."""
        return self._plant.state

    @property
    def fault(self) -> Event | None:
        """The fault at the end of the track, or None."""
        return self._plant.faults.get(0)

    @cached_property
    def kind(self) -> PeriodKind | None:
        """Expression of a period, for blocks of ticks in machine code; None for a bench that needs Python.

        Python computes delays of fractional periods, readings with ages, faults during the run, modes of components,
        users' plants, and periods that are too long for one step.
        """
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
        """Resolutions (n+1,) of the encoders and of the cart's scale, rad and m; 0 for a sensor that does not round."""
        settings, arms = self._encoders.settings, len(self._nothing) - 1
        return np.array([*settings.steps(arms), settings.cart_resolution])

    @cached_property
    def parameters(self) -> Array:
        """Parameters of the plant's step in the order of `PlantParameters.numbers`, for blocks of ticks."""
        return cast("SimulatedPlant", self._plant).plants[0].numbers()

    @cached_property
    def drive_numbers(self) -> Array:
        """Limits and lag of the drive as an array in the order of `DriveNumbers`, for blocks of ticks."""
        drive, plant = self._drive, cast("SimulatedPlant", self._plant)
        numbers = DriveNumbers(
            drive.acceleration, drive.velocity, drive.jerk_step, drive.response, plant.lag, self.period
        )
        return np.array(numbers, dtype=float)

    def plain_ticks(self, k: int, most: int) -> int:
        """Return the number of ticks from k on, at most `most`, that need only the expression of `kind`.

        The count ends with the tick of the next blow, which is the first entry of `_coming[1]`. It is 0 for the first
        tick (k = 0) and once the cart was told to brake.
        """
        if not k or self._braking is not None:
            return 0
        return max(0, min(most, self._coming[1][0] + 1 - k))

    def plain_states(self, states: Array) -> NDArray[np.bool_]:
        """Return True (K,) for states (K, N) from which a block can continue.

        They are finite, with the cart on its track and nearer to the centre than the limit switches (`_switch_at`, m).
        """
        cart = np.abs(states[:, self._cart])
        return (
            (cart <= cast("SimulatedPlant", self._plant).track)
            & (cart < self._switch_at)
            & np.isfinite(states.sum(axis=1))
        )

    @property
    def stored(self) -> tuple[Array, list[float], Array, float]:
        """The state from which a block of ticks begins.

        These are the plant's state (N,), the demands, m/s², the last reading (n+1,), and the drive's coming
        acceleration, m/s².
        """
        return self._plant.state, self._demands, self._last, self._acting(self._demands[1], self.period)

    @property
    def draws(self) -> bool:
        """True if random numbers or drifts change from tick to tick, so that blocks must read them."""
        streams = self._command_noise, self._noise, self._dropped
        return self._encoders.drift is not None or any(stream is not None for stream in streams)

    def drawn(self, k: int, count: int) -> DrawnTicks:
        """Return the random numbers of `count` ticks from tick k on, for a block."""
        ticks, n = range(k, k + count), len(self._nothing) - 1

        def values_of(stream: Any, *shape: int) -> Array:
            """Return a stream's numbers (count, …) of these ticks, zeros for an unused stream (None)."""
            return np.zeros((count, *shape)) if stream is None else np.array([stream[tick] for tick in ticks])

        zeros = self._encoders.zeros_at(np.asarray(np.arange(k, k + count) * self.period, dtype=np.float64))
        return DrawnTicks(
            values_of(self._command_noise), values_of(self._noise, n + 1), zeros, values_of(self._dropped) > 0
        )

    def resume(self, tick: int, state: Array, demands: Array, read: Array, *, hardest: float) -> None:
        """Continue after a block that ended with a tick, from a state, demands and reading as in `stored`.

        Args:
            tick: the last tick of the block.
            state: state (N,) of the plant at that tick.
            demands: demands on their way to the drive, oldest first, m/s².
            read: reading (n+1,) of that tick, rad and m.
            hardest: largest acceleration of the drive since the last call, m/s².
        """
        self._tick, self._last, self._demands = tick, read.copy(), demands.tolist()
        cast("SimulatedPlant", self._plant).set_state(state)
        self.hardest = max(self.hardest, hardest)

    def read(self) -> Reading:
        """Advance by one period, except in the first call, and return the reading.

        If the reading of this tick is dropped, the positions are those of the last reading, and none is `present`.

        Raises:
            ArithmeticError: the state is no longer finite.
        """
        k = self._tick + 1
        if k:
            self._pass(k - 1)
        self._tick = k
        time_s, values = k * self.period, self._plant.values
        if not math.isfinite(sum(values)):
            raise ArithmeticError(f"plant failed at t = {time_s:.3f} s: its state is no longer finite")
        position = values[self._cart]
        switch = 0 if abs(position) < self._switch_at else 1 if position > 0 else -1
        # Encoders count, and lose counts, even if readings are dropped.
        measured = self._measured(k)
        if self._dropped is not None and self._dropped[k]:
            return Reading(time_s, self._last, self._nothing, switch)
        self._last = measured
        return Reading(time_s, measured, None, switch, age=self._age(k))

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
    """The simulated benches of S runs in lockstep, which advance together."""

    @property
    def failed(self) -> NDArray[np.bool_] | None:
        """True (S,) for runs whose state is not finite, or None if all are finite."""
        # One sum detects the rare failure; only then is each run checked.
        if math.isfinite(np.add.reduce(self._plant.state, axis=None)):
            return None
        failed = ~np.isfinite(self._plant.state.sum(axis=0))
        return failed if failed.any() else None

    @property
    def faults(self) -> Mapping[int, Event]:
        """Events of carts that reached the end of their track, by run number."""
        return self._plant.faults

    def read(self) -> Reading:
        """Advance all benches by one period, except in the first call.

        Return the reading of all runs, with positions (n+1, S) and switches (S,). A run whose reading is dropped
        repeats its last positions, which are then not `present`.
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
        """Send the demanded accelerations of all runs to their drives.

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
        """Replace runs by those of a bench with the same settings that has been read once, to begin new episodes.

        Noise and blows, which follow the ticks of the whole bench, remain those of the replaced runs.

        Args:
            runs: numbers of the runs.
            other: bench with as many runs, which takes their places.
        """
        plant: Any = self._plant
        plant.replace_runs(runs, other._plant)
        self._last[:, runs] = other._last
        demands = [*zip(self._demands, other._demands, strict=False)]
        for values, other_values in [*demands, *zip(self._encoders.zeros, other._encoders.zeros, strict=True)]:
            values[runs] = other_values
