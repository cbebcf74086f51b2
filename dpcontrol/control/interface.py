"""Interfaces of controllers and estimators, and the model that they share.

The model between two ticks is one step of the equations with constant input, and its Jacobians.

    x_{k+1} = F(x_k, u_k),   A = ∂F/∂x,   B = ∂F/∂u        (classical Runge-Kutta, order 4)

The casadi function is called through its buffers without a copy, which takes 2 µs a step instead of 16 µs.
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

from dpcontrol.dynamics.chain import ArmChainParameters, Level, arm_chain_equations
from dpcontrol.dynamics.compiled import Compiled
from dpcontrol.dynamics.equations import Equations, PointCalls
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.shown import Brief
from dpcontrol.references.problem import ANGLE_SCALE, RATE_SCALE

Present = NDArray[np.bool_] | None
"""Valid positions (n+1,); None for all."""


class Mode(IntEnum):
    """Mode of the controller in a tick.

    The field `mode` of a log's /control.
    """

    IDLE = 0
    """Not started: the command is zero."""
    TRACKING = 1
    """Following a time-varying reference."""
    HOLDING = 2
    """Stabilising an orbit or an equilibrium."""
    PULSING = 3
    """Within a pulse of OGY control."""
    SATURATED = 4
    """Tracking or holding with the command cut at a limit."""
    STOPPED = 5
    """Ended as planned: the command is zero."""
    ABORTED = 6
    """Stopped by the supervisor: a limit was passed or the estimate was lost."""


def clip_number(value: float, low: float, high: float) -> float:
    """Return a number limited to two bounds; faster than min and max.

    Args:
        value: the number.
        low: lower bound.
        high: upper bound.
    """
    return high if value > high else low if value < low else value


def clip_lanes(value: Array, low: Array | float, high: Array | float) -> Array:
    """Return numbers (S,) of S lockstep runs limited to two bounds, as `clip_number` does for one run.

    Args:
        value: numbers (S,).
        low: lower bounds, one number or (S,).
        high: upper bounds, one number or (S,).
    """
    return np.minimum(np.maximum(value, low), high)


class Lanes(NamedTuple):
    """Arithmetic for one run or for S lockstep runs.

    `ONE` uses plain floats for one run, `MANY` arrays (S,).

    numpy needs ten times as long for short arrays as Python for floats, so shared code uses these functions. `nearest`
    and `below` return whole numbers for counting, `rounded` whole numbers for arithmetic. `dot` takes (N,) or rows (S,
    N). `column` converts (S,) to (S, 1). `rows` iterates over an array (K,) or (K, S).
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
    """Return the multiples of 2π nearest to angles, rad, by which angles are compared modulo whole turns.

    Args:
        angles: angles of any shape, rad.
    """
    return np.rint(angles / (2 * np.pi)) * (2 * np.pi)


def pendulum_scale(arms: int) -> Array:
    """Return the scales (2n,) of the arms' angles and rates, rad and rad/s, by which distances of states are measured.

    Distances ignore the cart, which has no effect on the phase.

    Args:
        arms: number n of arms.
    """
    return np.array([ANGLE_SCALE] * arms + [RATE_SCALE] * arms)


def interpolated(states: Array, place: Any, lanes: Lanes) -> Array:
    """Return states at fractional rows of a table, by linear interpolation.

    Places beyond the table's ends count as its ends.

    Args:
        states: table (K, N).
        place: fractional row, or rows (S,).
        lanes: arithmetic for one run, `ONE`, or for S runs, `MANY`.

    Returns:
        States (N,) or (S, N).
    """
    k = lanes.clip(lanes.below(place), 0, len(states) - 2)
    lower = states[k]
    return lower + lanes.column(lanes.clip(place - k, 0.0, 1.0)) * (states[k + 1] - lower)


class Estimate(NamedTuple):
    """State and extra quantities after a tick, with their uncertainty."""

    state: Array
    """State (N,) of the model."""
    extra: Array
    """Extra quantities (E,), in the order of the estimator's `extra_names`."""
    sigmas: Array
    """Standard deviations (N+E,) of both."""
    innovation: Array
    """Innovation (m,), zero without a measurement."""
    nis: float
    """Normalised innovation squared, NaN before the first measurement."""
    used: int
    """Number of measured positions, its degrees of freedom."""
    memory: Any
    """Data for the estimator's next step."""


class Estimator(ABC):
    """Converts measured positions to states; its methods do not modify their arguments."""

    kind: str
    """Name of its kind."""
    extra_names: tuple[str, ...]
    """Names of the extra quantities."""

    @abstractmethod
    def first(self, state: Array) -> Estimate:
        """Return the estimate before any measurement.

        Args:
            state: initial state (N,).
        """

    @abstractmethod
    def update(self, estimate: Estimate, measured: Array, present: Present = None) -> Estimate:
        """Return the estimate after a measurement.

        Args:
            estimate: estimate before it.
            measured: positions (n+1,), rad and m.
            present: True for each valid position (n+1,), None if all are valid.
        """

    @abstractmethod
    def step(self, estimate: Estimate, command: float, measured: Array, present: Present = None) -> Estimate:
        """Return the estimate after a period and a new measurement.

        Args:
            estimate: estimate one tick earlier.
            command: acceleration of the cart during the period, m/s².
            measured: positions (n+1,), rad and m.
            present: True for each valid position (n+1,), None if all are valid.
        """

    @abstractmethod
    def ahead(self, estimate: Estimate, commands: Sequence[float]) -> Array:
        """Return the state (N,) after the pending commands, for which the law computes the next command.

        Args:
            estimate: present estimate.
            commands: pending commands, one per period, oldest first, m/s².
        """

    @abstractmethod
    def covariance(self, estimate: Estimate) -> Array:
        """Return the covariance (N+E, N+E) of state and extra.

        Args:
            estimate: estimate of this estimator.
        """

    @abstractmethod
    def restarted(self, estimate: Estimate, measured: Array) -> Estimate:
        """Return an estimate reset to measured positions, with which a filter continues that has lost the state.

        Args:
            estimate: last estimate.
            measured: positions (n+1,), rad and m.
        """


class Action(NamedTuple):
    """A controller's output for one tick.

    Accelerations, m/s², and the reference state (N,).

    `event` is a sentence for the log on a decision in this tick, or "".
    """

    feedforward: float
    feedback: float
    reference: Array
    mode: Mode
    event: str = ""


class Session(ABC):
    """A controller during one run; it may have a state."""

    @abstractmethod
    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return the action (feedforward, feedback and reference) for the period from a tick.

        Args:
            tick: the tick in which the command acts.
            state: predicted state (N,) at the tick.
            extra: estimated extras (E,).
        """

    def resynchronise(self, tick: int, state: Array) -> str:
        """Move the reference's clock to the nearest phase.

        Sessions without a clock of the reference do nothing.

        Args:
            tick: present tick.
            state: state (N,) at that tick.

        Returns:
            A sentence for the log, or "".
        """
        return ""


class ClockedSession(Session):
    """A session with its own clock, for one or many runs.

    S runs in lockstep have clocks (S,).
    """

    mode = Mode.HOLDING
    lanes: Lanes

    @abstractmethod
    def steer(self, tick: int, states: Array) -> tuple[Any, Any, Array]:
        """Return the feedforward and the feedback at a tick, m/s², and the reference's state.

        They are numbers and (N,) for one run, (S,) and (S, N) for many. The session's clock advances to this tick.

        Args:
            tick: the tick in which the command acts.
            states: state (N,) of one run, or states (S, N).
        """

    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return the action of one run for the period from a tick, from `steer`.

        Args:
            tick: the tick in which the command acts.
            state: predicted state (N,) at the tick.
            extra: ignored.
        """
        forward, feedback, reference = self.steer(tick, state)
        return Action(float(forward), float(feedback), reference, self.mode)

    def commands(self, tick: int, states: Array, extras: Array | None = None) -> tuple[Array, Array, Array]:
        """Return the commands of S lockstep runs for the period from a tick, from `steer`.

        Args:
            tick: the tick in which the commands act.
            states: predicted states (N, S) at the tick.
            extras: ignored.

        Returns:
            Feedforwards (S,) and feedbacks (S,), m/s², and references (N, S).
        """
        forward, feedback, references = self.steer(tick, states.T)
        return forward, feedback, references.T


@dataclass(frozen=True, eq=False)
class GainSchedule(Brief):
    """Inputs, gains and references by the loop's clock.

    K is the number of ticks, N of states, E of extras and n of arms.
    """

    rows: Array
    """Rows (K, ·), see `TickEquations.row`."""
    references: Array
    """Reference states (K, N)."""
    queued: Array
    """Commands (lead,) that act before the first tick's command, m/s²."""
    mode: Mode
    shares: tuple[bool, ...] | None = None
    """True for extras (E,) that are relative errors, limited by `trust`; None without gains on them."""
    names: tuple[str, ...] = ()
    """Names (E,) of all extras with gains."""
    trust: float = 0.0
    law: Any = None
    """A user's law (`dpcontrol.control.symbolic`) that acts in addition to the gains."""


class Controller(Protocol):
    """A control law for one reference and model.

    If its gains follow the loop's clock, it has `schedule(lead)`, which returns a `GainSchedule` for commands computed
    `lead` ticks ahead. If it has its own clock, it has `begin()`, which returns a `Session`. It may then also have
    `begin_many(count)`.
    """

    @property
    def kind(self) -> str:
        """Return the name of its kind."""
        ...

    @property
    def first_state(self) -> Array:
        """Return the initial state (N,), with which a run begins."""
        ...

    @property
    def ticks(self) -> int:
        """Return the number of periods for which the law acts."""
        ...


def schedule_of(controller: Controller, lead: int) -> GainSchedule | None:
    """Return a law's gains by the loop's clock, which the compiled tick reads row by row.

    The result is None for a law with its own clock.

    Args:
        controller: the law.
        lead: number of ticks between the computation of a command and its action.
    """
    schedule = getattr(controller, "schedule", None)
    return None if schedule is None else schedule(lead)


class SampledModel:
    """The cart-level equations over one period.

    The period and the drive's `lag` are in s, the base parameters are (p,).

    An instance must not be shared between threads, since its buffers are reused.
    """

    def __init__(self, equations: Equations, parameters: Array, *, period: float, lag: float = 0.0) -> None:
        """Set the equations over one period.

        Args:
            equations: cart-level equations.
            parameters: base parameters (p,).
            period: time between ticks, s.
            lag: time constant of the drive, s.
        """
        self.equations, self.period, self.lag = equations, period, lag
        self.lag_keeps = math.exp(-period / lag) if lag else 0.0
        """Factor by which the cart's acceleration decays over a period with a lagging drive."""
        self.parameters = np.array(parameters, dtype=float)
        self.dimension = equations.dimension
        """Length of the state."""
        self.arms = (self.dimension - 2) // 2
        self.position_indices = np.array([*range(self.arms), 2 * self.arms])
        """Indices of the measured positions in a state: the angles, then the cart."""

    @cached_property
    def _function(self) -> Any:
        """The step of the equations with its Jacobians: (state, command, parameters) -> next state, A, B."""
        return self.equations.discrete_step(self.period)

    @cached_property
    def machine(self) -> Any:
        """The compiled step of S states together.

        It maps state, command and parameters, (N+1+p, S), to the next states (N, S).
        """
        return Compiled(self._plain).machine

    @cached_property
    def _plain(self) -> Any:
        """The step without its Jacobians: (state, command, parameters) -> next state."""
        return self._function.factory("plain", self._function.name_in(), [self._function.name_out(0)])

    @cached_property
    def _calls(self) -> PointCalls:
        """The step without conversions of its arguments."""
        return PointCalls(self._plain)

    def step(self, state: Array, command: float) -> Array:
        """Return the state (N,) one period later.

        Args:
            state: state (N,).
            command: constant acceleration of the cart, m/s².
        """
        call, inputs, following = self._calls.of(1)
        inputs[0][:], inputs[1][:], inputs[2][:] = state, command, self.parameters
        call()
        return following[0].copy()

    def steps(self, states: Array, commands: Array, parameters: Array) -> Array:
        """Return the states (K, N) one period later.

        Args:
            states: states (K, N).
            commands: constant accelerations of the cart (K,), m/s².
            parameters: base parameters (p,).
        """
        base = np.repeat(parameters[:, None], len(states), axis=1)
        return np.array(self._plain.map(len(states))(states.T, commands[None], base)).T

    def lagging(self, a: Array, b: Array) -> tuple[Array, Array]:
        """Return A and B of `linearised` for a drive whose cart's acceleration lags behind the command.

        The cart's acceleration becomes the last state. Without lag, A and B are returned unchanged.

        Args:
            a: A (K, N, N).
            b: B (K, N).

        Returns:
            A (K, N+1, N+1) and B (K, N+1).
        """
        if not self.lag:
            return a, b
        count, n = b.shape
        lag_share = self.lag / self.period * (1 - self.lag_keeps)
        wide_a, wide_b = np.zeros((count, n + 1, n + 1)), np.empty((count, n + 1))
        wide_a[:, :n, :n], wide_a[:, :n, n], wide_a[:, n, n] = a, lag_share * b, self.lag_keeps
        wide_b[:, :n], wide_b[:, n] = (1 - lag_share) * b, 1 - self.lag_keeps
        return wide_a, wide_b

    def linearised(self, states: Array, commands: Array, *, parameters: Array | None = None) -> tuple[Array, Array]:
        """Return the Jacobians A (K, N, N) and B (K, N) of one period at K states, by the state and by the command.

        Args:
            states: states (K, N).
            commands: accelerations of the cart (K,), m/s².
            parameters: base parameters (p,), default the model's.
        """
        count, n = np.shape(states)
        base = np.repeat((self.parameters if parameters is None else parameters)[:, None], count, axis=1)
        _, state_jacobians, input_jacobians = self._function.map(count)(states.T, np.asarray(commands)[None, :], base)
        return np.array(state_jacobians).T.reshape(count, n, n).transpose(0, 2, 1), np.array(input_jacobians).T.reshape(
            count, n
        )


def with_dry_friction(parameters: ArmChainParameters, rate: float) -> ArmChainParameters:
    """Return arms with dry friction, possibly zero, which fades below a rate that one period resolves.

    Args:
        parameters: parameters of the arms.
        rate: rate of the ticks, Hz.
    """
    parameters = replace(parameters, coulomb=parameters.coulomb or (0.0,) * parameters.count)
    return replace(parameters, smoothing=max(parameters.smoothing, parameters.coulomb_acceleration / rate))


def sampled_model(parameters: ArmChainParameters, rate: float, lag: float = 0.0) -> SampledModel:
    """Return the cart-level model of these arms between ticks.

    It always has dry friction, possibly zero, for a filter that estimates it.

    Args:
        parameters: parameters of the arms.
        rate: rate of the ticks, Hz.
        lag: time constant of the drive, s, default 0.
    """
    parameters = with_dry_friction(parameters, rate)
    equations = arm_chain_equations(parameters.count, Level.CART, friction=parameters.friction)
    return SampledModel(equations, parameters.base(), period=1 / rate, lag=lag)
