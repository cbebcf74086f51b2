"""What loop, estimators and controllers share: their interfaces, and the model between two ticks.

What the loop asks of an estimator and of a controller; the same objects serve a simulated and a real bench.

The model between two ticks: one step of the equations with the input held, and its Jacobians.

    x_{k+1} = F(x_k, u_k),   A = ∂F/∂x,   B = ∂F/∂u        (classical Runge-Kutta, order 4)

The casadi function is called through its buffers, without a copy: 2 µs a step in place of 16 µs.
"""

from collections.abc import Iterable, Sequence
from enum import IntEnum
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.errors import InputError

Array = NDArray[np.float64]
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

    def update(self, estimate: Estimate, measured: Array, present: Present = None, *, coming: float = 0.0) -> Estimate:
        """Return the estimate after the positions `measured` (n+1,), of which those `present` count.

        coming m/s²: the command of the next period, if `ahead` is to be asked for it.
        """
        ...

    def step(
        self, estimate: Estimate, command: float, measured: Array, present: Present = None, *, coming: float = 0.0
    ) -> Estimate:
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


class ManySession(Protocol):
    """A controller during many runs in lockstep; what it gives for one run is what its `Session` gives, to the bit."""

    def commands(self, tick: int, states: Array, extras: Array) -> tuple[float | Array, Array, Array]:
        """Return feedforward (a number or (S,)) and feedback (S,) in m/s², and the reference (N,) of this tick.

        states (N, S): those expected at the tick; extras (E, S).
        """
        ...


class Controller(Protocol):
    """A control law, ready made for one reference and model."""

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

    def begin(self) -> Session:
        """Return a fresh session for one run."""
        ...


class SampledModel:
    """The equations of the cart level over `period` s, with base parameters (p,).

    Not to be shared between threads: the buffers are reused from call to call.

    Raises:
        InputError: the period is not positive, the parameters are too few or many, or there is no single input.
    """

    def __init__(self, equations: Equations, parameters: Array, *, period: float) -> None:
        if not np.isfinite(period) or period <= 0:
            raise InputError(f"period = {period!r}: must be a positive, finite number of seconds")
        if equations.input_count != 1:
            raise InputError(f"the equations have {equations.input_count} inputs: the loop needs the cart level")
        if np.shape(parameters) != (equations.parameters.shape[0],):
            raise InputError(
                f"parameters have shape {np.shape(parameters)}: the equations take ({equations.parameters.shape[0]},)"
            )
        self.equations = equations
        self.parameters = np.array(parameters, dtype=float)
        self.period = period

    @cached_property
    def dimension(self) -> int:
        """Length of the state."""
        return self.equations.dimension

    @cached_property
    def arms(self) -> int:
        """Number of arms."""
        return (self.dimension - 2) // 2

    @cached_property
    def position_indices(self) -> NDArray[np.intp]:
        """Return where the measured positions stand in a state: the angles, then the cart."""
        return np.array([*range(self.arms), 2 * self.arms])

    @cached_property
    def _function(self) -> Any:
        return self.equations.discrete_step(self.period)

    @cached_property
    def _buffered(self) -> tuple[Any, Any, Array, Array, Array]:
        """Return (trigger, its keeper, state, input, following) that share memory with the plain step's arguments."""
        function = self._function.factory("plain", self._function.name_in(), [self._function.name_out(0)])
        buffer, trigger = function.buffer()
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

    def ahead(self, state: Array, commands: Iterable[float]) -> Array:
        """Return the state (N,) after the commands that are already on their way, one per period.

        This compensates the delay: a new command is computed for the state at which it will act.
        """
        for command in commands:
            state = self.step(state, command)
        return state

    def linearised(self, states: Array, commands: Array) -> tuple[Array, Array]:
        """Return A (K, N, N) and B (K, N) at `states` (K, N) and `commands` (K,)."""
        count, n = np.shape(states)
        parameters = np.repeat(self.parameters[:, None], count, axis=1)
        _, a, b = self._function.map(count)(states.T, np.asarray(commands)[None, :], parameters)
        return np.array(a).T.reshape(count, n, n).transpose(0, 2, 1), np.array(b).T.reshape(count, n)
