"""What loop, estimators and controllers share: interfaces, the model between two ticks, sums for one run or many.

The model between two ticks is one step of the equations with the input held, and its Jacobians.

    x_{k+1} = F(x_k, u_k),   A = ∂F/∂x,   B = ∂F/∂u        (classical Runge-Kutta, order 4)

The casadi function is called through its buffers, without a copy: 2 µs a step in place of 16 µs.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.compiled import Compiled
from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.shown import Brief
from dpcontrol.references.problem import ANGLE_SCALE, RATE_SCALE

Present = NDArray[np.bool_] | None
"""Which of the positions (n+1,) count; None: all."""


class Mode(IntEnum):
    """What the controller was doing in a tick: the field `mode` of a log's /control."""

    IDLE = 0
    """Not started: the command is zero."""
    TRACKING = 1
    """Following a time-varying reference."""
    HOLDING = 2
    """Stabilising an orbit or an equilibrium."""
    PULSING = 3
    """Within a pulse of OGY control."""
    SATURATED = 4
    """As tracking or holding, the command cut at a limit."""
    STOPPED = 5
    """Ended as planned: the command is zero."""
    ABORTED = 6
    """Stopped by the supervisor: a limit was passed or the estimate was lost."""


def clip_number(value: float, low: float, high: float) -> float:
    """Return a number within two bounds, quicker than min and max do."""
    return high if value > high else low if value < low else value


def clip_lanes(value: Array, low: Array | float, high: Array | float) -> Array:
    """Return the numbers (S,) of many runs within two bounds."""
    return np.minimum(np.maximum(value, low), high)


class Lanes(NamedTuple):
    """Arithmetic for one run on plain floats, or for S runs in lockstep on arrays (S,): `ONE` and `MANY`.

    Short arrays take numpy ten times as long as floats take Python, so what both do is written once over these.
    clip; nearest and below: whole numbers to count by; rounded: whole numbers to reckon with; dot: of (N,), or of rows
    (S, N); column: (S,) as (S, 1); rows: of an array (K,) or (K, S), one by one.
    """

    clip: Callable[[Any, Any, Any], Any]
    nearest: Callable[[Any], Any]
    rounded: Callable[[Any], Any]
    below: Callable[[Any], Any]
    dot: Callable[[Array, Array], Any]
    column: Callable[[Any], Any]
    rows: Callable[[Array], list[Any]]


ONE = Lanes(clip_number, round, round, int, lambda a, b: float(a.dot(b)), lambda value: value, lambda a: a.tolist())
MANY = Lanes(
    clip_lanes,
    lambda values: np.rint(values).astype(int),
    np.rint,
    lambda values: values.astype(int),
    lambda a, b: (a * b).sum(1),
    lambda values: values[:, None],
    list,
)


def whole_turns(angles: Array) -> Array:
    """Return the angles' nearest multiples of 2π, in rad, same shape."""
    return np.rint(angles / (2 * np.pi)) * (2 * np.pi)


def pendulum_scale(arms: int) -> Array:
    """Return the scale (2n,) of the pendulum's state: distances leave the cart out, no phase depends on it."""
    return np.array([ANGLE_SCALE] * arms + [RATE_SCALE] * arms)


def interpolated(states: Array, place: Any, lanes: Lanes) -> Array:
    """Return the states (N,) or (S, N) of a table (K, N) at a place or places (S,) between its rows; clipped."""
    k = lanes.clip(lanes.below(place), 0, len(states) - 2)
    before = states[k]
    return before + lanes.column(lanes.clip(place - k, 0.0, 1.0)) * (states[k + 1] - before)


class Estimate(NamedTuple):
    """What is believed after a tick.

    state (N,): of the model; extra (E,): what the estimator is augmented by, in the order of its `extra_names`;
    sigmas (N+E,): standard deviations of both; innovation (m,): zero where nothing was measured; nis: normalised
    innovation squared, nan before the first measurement; used: number of positions in it, its degrees of freedom;
    memory: what the estimator itself needs at its next step.
    """

    state: Array
    extra: Array
    sigmas: Array
    innovation: Array
    nis: float
    used: int
    memory: Any


class Estimator(Protocol):
    """Turns measured positions into states. Its methods do not change what they are given."""

    @property
    def kind(self) -> str:
        """Return the name of its kind."""
        ...

    @property
    def extra_names(self) -> tuple[str, ...]:
        """Return the names of what it is augmented by."""
        ...

    def first(self, state: Array) -> Estimate:
        """Return the estimate before any measurement, at `state` (N,)."""
        ...

    def update(self, estimate: Estimate, measured: Array, present: Present = None) -> Estimate:
        """Return the estimate after the positions `measured` (n+1,), of which those `present` count."""
        ...

    def step(self, estimate: Estimate, command: float, measured: Array, present: Present = None) -> Estimate:
        """Return the estimate a period later: the cart accelerated by `command` m/s², then `measured` came."""
        ...

    def ahead(self, estimate: Estimate, commands: Sequence[float]) -> Array:
        """Return the state (N,) after the commands on their way, one per period."""
        ...

    def covariance(self, estimate: Estimate) -> Array:
        """Return the covariance (N+E, N+E) of state and extra."""
        ...

    def restarted(self, estimate: Estimate, measured: Array) -> Estimate:
        """Return an estimate that trusts the positions `measured` (n+1,) and little else: for recovery when lost."""
        ...


class Action(NamedTuple):
    """What a controller wants for one tick: accelerations in m/s², and the state (N,) that it steers for.

    event: what was decided in this tick, a sentence for the log, or empty.
    """

    feedforward: float
    feedback: float
    reference: Array
    mode: Mode
    event: str = ""


class Session(Protocol):
    """A controller during one run; it may remember."""

    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return what to do in the period from `tick`, for which `state` (N,) is expected; extra: the estimate's."""
        ...

    def resynchronise(self, tick: int, state: Array) -> str:
        """Move the reference's clock to the phase nearest to `state`; say by how much, or "" if it cannot."""
        ...


class ClockedSession(ABC):
    """A session whose place on its path is its own, of one run or (S,) of as many in lockstep."""

    mode = Mode.HOLDING
    lanes: Lanes

    @abstractmethod
    def steer(self, tick: int, states: Array) -> tuple[Any, Any, Array]:
        """Return feedforward and feedback in m/s², and the reference, at `tick` for the state (N,) or states (S, N)."""

    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return what to do in the period from `tick` at `state` (N,)."""
        forward, feedback, wanted = self.steer(tick, state)
        return Action(float(forward), float(feedback), wanted, self.mode)

    def commands(self, tick: int, states: Array, extras: Array | None = None) -> tuple[Array, Array, Array]:
        """Return feedforwards (S,), feedbacks (S,) in m/s² and references (N, S) for `states` (N, S) at `tick`."""
        forward, feedback, wanted = self.steer(tick, states.T)
        return forward, feedback, wanted.T


@dataclass(frozen=True, eq=False)
class GainSchedule(Brief):
    """Inputs, gains and references by the loop's own clock, for K ticks, N states, E extras and n arms.

    rows (K, ·): see `TickEquations.row`; references (K, N); queued (lead,) m/s²: what acts before the first
    tick's command can; shares, names (E,): of the extras that it has gains
    on, which are relative errors that are trusted up to `trust`, and all names; None and () without such gains.
    law: a user's (`dpcontrol.control.symbolic`), which acts besides the gains.
    """

    rows: Array
    references: Array
    queued: Array
    mode: Mode
    shares: tuple[bool, ...] | None = None
    names: tuple[str, ...] = ()
    trust: float = 0.0
    law: Any = None

    def turned(self, turns: Array) -> "GainSchedule":
        """Return the same with `turns` (n,) rad added to all its angles."""
        n, size = len(turns), self.references.shape[1]
        rows, references = self.rows.copy(), self.references.copy()
        for angles in (rows[:, 1 + size : 1 + size + n], rows[:, -n:], references[:, :n]):
            angles += turns
        return replace(self, rows=rows, references=references)


class Controller(Protocol):
    """A control law, ready made for one reference and model.

    One whose gains go by the loop's clock has `schedule(lead)`, which returns a `GainSchedule` for commands computed so
    many ticks ahead; one with a clock of its own `begin()`, which returns a `Session`, and `begin_many(count)` where it
    can do that.
    """

    @property
    def kind(self) -> str:
        """Return the name of its kind."""
        ...

    @property
    def first_state(self) -> Array:
        """Return the state (N,) from which it starts."""
        ...

    @property
    def ticks(self) -> int:
        """Return for how many periods it has something to do."""
        ...


def schedule_of(controller: Controller, lead: int) -> GainSchedule | None:
    """Return the gains of a law by the loop's clock, for commands computed `lead` ticks ahead; None for any other."""
    made = getattr(controller, "schedule", None)
    return None if made is None else made(lead)


class SampledModel:
    """The equations of the cart level over `period` s, with base parameters (p,), and the drive's `lag` in s.

    Not to be shared between threads: the buffers are reused from call to call.

    Raises:
        InputError: the period is not positive, the parameters are too few or many, or there is no single input.
    """

    def __init__(self, equations: Equations, parameters: Array, *, period: float, lag: float = 0.0) -> None:
        if not np.isfinite(period) or period <= 0:
            raise InputError(f"period = {period!r}: must be a positive, finite number of seconds")
        if equations.input_count != 1:
            raise InputError(f"the equations have {equations.input_count} inputs: the loop needs the cart level")
        if np.shape(parameters) != (equations.parameters.shape[0],):
            raise InputError(
                f"parameters have shape {np.shape(parameters)}: the equations take ({equations.parameters.shape[0]},)"
            )
        self.equations, self.period, self.lag = equations, period, lag
        self.lag_keeps = math.exp(-period / lag) if lag else 0.0
        """Share of the cart's acceleration that a drive that lags keeps over a period."""
        self.parameters = np.array(parameters, dtype=float)
        self.dimension = equations.dimension
        """Length of the state."""
        self.arms = (self.dimension - 2) // 2
        self.position_indices = np.array([*range(self.arms), 2 * self.arms])
        """Where the measured positions stand in a state: the angles, then the cart."""

    @cached_property
    def _function(self) -> Any:
        return self.equations.discrete_step(self.period)

    @cached_property
    def machine(self) -> Any:
        """The step as machine code: from state, command and parameters, (N+1+p, S), to the following states (N, S)."""
        return Compiled(self._plain).machine

    @cached_property
    def _plain(self) -> Any:
        return self._function.factory("plain", self._function.name_in(), [self._function.name_out(0)])

    @cached_property
    def _buffered(self) -> tuple[Any, Any, Array, Array, Array]:
        """Return (trigger, its keeper, state, input, following) that share memory with the plain step's arguments."""
        buffer, trigger = self._plain.buffer()
        x, u, following = np.zeros(self.dimension), np.zeros(1), np.zeros(self.dimension)
        for k, array in enumerate((x, u, self.parameters)):
            buffer.set_arg(k, memoryview(array.data))
        buffer.set_res(0, memoryview(following.data))
        # The trigger points into the buffer and all arrays but owns neither: they must live as long as it does.
        return trigger, (buffer, x, u, following), x, u, following

    def step(self, state: Array, command: float) -> Array:
        """Return the state (N,) one period later, with the cart's acceleration `command` held, m/s²."""
        trigger, _, x, u, following = self._buffered
        x[:] = state
        u[0] = command
        trigger()
        return following.copy()

    def lagging(self, a: Array, b: Array) -> tuple[Array, Array]:
        """Return A (K, N+1, N+1) and B (K, N+1) of `linearised` with the cart's acceleration as last state.

        Where the drive follows at once, A and B as they are.
        """
        if not self.lag:
            return a, b
        count, n = b.shape
        mean = self.lag / self.period * (1 - self.lag_keeps)
        whole, push = np.zeros((count, n + 1, n + 1)), np.empty((count, n + 1))
        whole[:, :n, :n], whole[:, :n, n], whole[:, n, n] = a, mean * b, self.lag_keeps
        push[:, :n], push[:, n] = (1 - mean) * b, 1 - self.lag_keeps
        return whole, push

    def linearised(self, states: Array, commands: Array) -> tuple[Array, Array]:
        """Return A (K, N, N) and B (K, N) at `states` (K, N) and `commands` (K,)."""
        count, n = np.shape(states)
        parameters = np.repeat(self.parameters[:, None], count, axis=1)
        _, a, b = self._function.map(count)(states.T, np.asarray(commands)[None, :], parameters)
        return np.array(a).T.reshape(count, n, n).transpose(0, 2, 1), np.array(b).T.reshape(count, n)
