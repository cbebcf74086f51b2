"""Controllers that follow a reference: feedforward, TVLQR and adaptive.

    minimise Σ_k e_kᵀ Q e_k + r v_k² + e_Nᵀ P e_N,      e_{k+1} = A_k e_k + B_k v_k
    K_k = (r + B_kᵀ P_{k+1} B_k)⁻¹ B_kᵀ P_{k+1} A_k,     u_k = u*(t_k) + K_k (x*(t_k) - x̂_k)

e is the difference between state and reference x*, v that between input and u*. A and B are Jacobians along the
reference.
Source: Anderson & Moore, Optimal Control: Linear Quadratic Methods, sections 2.4 and 4.1.

The adaptive law uses the estimated errors of the model, with one more gain for each extra quantity w.

    e_{k+1} = A_k e_k + B_k v_k + E_k w_k,   w_{k+1} = D w_k,      v_k = -K_k e_k - F_k w_k
    F_k = (r + B_kᵀ P_{k+1} B_k)⁻¹ B_kᵀ (P_{k+1} E_k + N_{k+1} D)
    N_k = (A_k - B_k K_k)ᵀ (P_{k+1} E_k + N_{k+1} D),     N_K = 0

Constant errors of parameters and friction also shift the reference, so that its end keeps the shape of the desired
orbit. X is the shift for a unit of w under K̂ and F̂. These are the gains with a large weight on angles across their
path near the end. The feedback keeps the smaller gains, whose margins do not decrease there.

    X_{k+1} = (A_k - B_k K̂_k) X_k + E_k - B_k F̂_k,   X_0 = 0,      F_k := F̂_k + (K̂_k - K_k) X_k

The second-order remainder along this shift, for each pair of parameter errors, is treated as another constant error and
compensated in the same way:

    E'_k(i, j) = the coefficient of w_i w_j in f(x*_k + X_k w, u*_k - (F̂_k + K̂_k X_k) w, w) - x*_{k+1} - X_{k+1} w

w contains mainly the relative errors of the model's parameters. N propagates their future effect back from the
reference's end. The feedback therefore counteracts a wrong mass before it has an effect. Without w, the law is TVLQR.
The error of a parameter is log(p/p₀), and the equations do not depend on an overall scale.
Sources: Anderson & Moore, section 10.3. Åström & Wittenmark, Adaptive Control, section 1.4 (certainty equivalence).

If the drive's velocity loop has a known lag τ, the cart's acceleration a is an additional state with its own gain. The
feedforward leads so that a equals the reference's acceleration at the ticks:

    a_{k+1} = φ a_k + (1 - φ) u_k,   φ = e^{-T/τ},      mean over the period: u_k + (τ/T)(1 - φ)(a_k - u_k)

To follow a reference by phase, the clock advances with time and is corrected to the phase nearest to the state.

    c := c + 1 + lateness,    lateness = (x̂ - x*(c))·n(c),    n = D⁻² ẋ* / (|D⁻¹ ẋ*|² + ε²)      in ticks

D is the pendulum's scale. The cart is omitted, as its position does not depend on the phase. Because of ε, the clock
advances with time alone if the reference is at rest.
Source: Hauser & Hindman, Manoeuvre regulation from trajectory tracking, NOLCOS (1995), section 3.
"""

from dataclasses import dataclass, field
from functools import partial
from itertools import combinations_with_replacement
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.ekf import FilterEquations
from dpcontrol.control.estimator_settings import Augment, FilterSettings, extra_names
from dpcontrol.control.interface import (
    MANY,
    ONE,
    Action,
    ClockedSession,
    GainSchedule,
    Lanes,
    Mode,
    SampledModel,
    Session,
    interpolated,
    pendulum_scale,
)
from dpcontrol.control.lqr import ClosingWeights, QuadraticWeights
from dpcontrol.dynamics.compiled import QUICK, Compiled
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.settings import Setting, Settings
from dpcontrol.foundation.shown import Brief
from dpcontrol.references.reference import Reference

STANDSTILL = 0.1
"""Scaled rate below which the phase of a motion is weighted less, 1/s (π rad and 10 rad/s)."""
TURNING = 1.0
"""Rate below which a path of angles has no direction, as at a turning point, rad/s."""
MOST = 0.5
"""Largest correction of the clock per tick, in ticks; the clock moves smoothly for any estimate."""


@dataclass(frozen=True, eq=False)
class ReferenceController(Brief):
    """States, feedforward and gains at the ticks of a reference.

    States (K+1, N), inputs (K,) m/s² and gains (K, N) at the ticks.
    """

    kind: str
    reference_states: Array
    feedforward: Array
    gains: Array

    @property
    def first_state(self) -> Array:
        """Return the initial state (N,), with which a run begins."""
        return self.reference_states[0]

    @property
    def ticks(self) -> int:
        """Return the number of periods if the clock follows time."""
        return len(self.feedforward)


@dataclass(frozen=True, eq=False)
class TimedController(ReferenceController):
    """A controller with the loop's clock and gains (K, N) by time.

    Without feedback if they are zero.

    After the last tick, the last gain holds the end of the reference.

    Attributes:
        drive: acceleration of the cart at the ticks, m/s², and the gain on it (K+1, 2), for a lagging drive.
    """

    drive: Array | None = field(default=None, kw_only=True)

    def schedule(self, lead: int) -> GainSchedule:
        """Return the gain schedule for commands that act `lead` ticks after their computation.

        Args:
            lead: number of ticks between the computation of a command and its action.
        """
        return GainSchedule(self._rows(lead), self.reference_states, self.feedforward[:lead], Mode.TRACKING)

    def _rows(self, lead: int, *more: Array) -> Array:
        """Return the rows (K+1, …) of a schedule whose commands act `lead` ticks later, with further gains (K, …).

        Their columns are those of `TickEquations.row`. `more`: tables of gains on the extras and on products of shares.
        """
        last, n = self.ticks, (len(self.first_state) - 2) // 2
        acting_tick = np.minimum(np.arange(last + 1) + lead, last)
        gain_index = np.minimum(acting_tick, last - 1)
        parts = [self.feedforward[gain_index, None], self.gains[gain_index], self.reference_states[acting_tick]]
        parts += [*([] if self.drive is None else [self.drive[acting_tick]]), *(table[gain_index] for table in more)]
        return np.concatenate([*parts, self.reference_states[:, :n]], axis=1)


@dataclass(frozen=True, eq=False)
class PhaseController(ReferenceController):
    """A controller whose clock follows the nearest phase.

    The clock is corrected at every tick. The normals n (K+1, N) give the lateness, in ticks, of a state from its
    difference to the reference: lateness = n · (x̂ - x*).
    """

    normals: Array

    def begin(self) -> "PhaseSession":
        """Return a new session, the state of this law during one run."""
        return PhaseSession(self)

    def begin_many(self, count: int) -> "PhaseSession":
        """Return a session for many runs in lockstep, each with its own clock.

        Args:
            count: number of runs.
        """
        return PhaseSession(self, place=np.zeros(count), lanes=MANY)

    def join(self, tick: int, state: Array) -> "PhaseSession":
        """Return a session from a tick at the reference's place nearest to a state, for a handover from another law.

        Args:
            tick: first tick.
            state: state (N,) at that tick.
        """
        return PhaseSession(self, tick=tick, place=self.nearest(state))

    def nearest(self, state: Array) -> int:
        """Return the tick of the reference nearest to a state.

        Args:
            state: state (N,), whose cart is ignored.
        """
        scale = pendulum_scale(len(state) // 2 - 1)
        differences = (self.reference_states[:, : len(scale)] - state[: len(scale)]) / scale
        return int(np.argmin(np.square(differences).sum(1)))


def phase_controller(kind: str, *, states: Array, feedforward: Array, gains: Array, period: float) -> PhaseController:
    """Return the controller whose clock follows the nearest phase, with tabulated states, feedforward and gains.

    Args:
        kind: name of the law.
        states: reference states (K+1, N).
        feedforward: accelerations (K,), m/s².
        gains: gains (K, N).
        period: time between ticks, s.
    """
    scale = pendulum_scale(states.shape[1] // 2 - 1)
    rates = np.gradient(states[:, : len(scale)], axis=0) / scale
    normals = np.zeros_like(states)
    normals[:, : len(scale)] = rates / scale / (np.square(rates).sum(1) + (STANDSTILL * period) ** 2)[:, None]
    return PhaseController(kind, states, feedforward, gains, normals)


class PhaseSession(ClockedSession):
    """One or many runs of a law.

    `place` is the reference's fractional tick, or ticks (S,), at the loop's tick `_tick`, the last one in which the law
    was called. Both change at each call.
    """

    mode = Mode.TRACKING

    def __init__(self, law: PhaseController, *, tick: int = 0, place: Any = 0.0, lanes: Lanes = ONE) -> None:
        """Begin a session at a tick of the loop and a place of the reference.

        Args:
            law: the controller.
            tick: tick of the loop.
            place: fractional tick of the reference, or ticks (S,).
            lanes: `ONE` for a single run, `MANY` for S runs.
        """
        self._law, self.lanes = law, lanes
        self._tick, self.place = tick, place

    def steer(self, tick: int, states: Array) -> tuple[Any, Any, Array]:
        """Return feedforward and feedback, m/s², and the reference's state.

        They are numbers and (N,) for one run, (S,) and (S, N) for many.

        Args:
            tick: the tick in which the command acts.
            states: state (N,) of one run, or states (S, N).
        """
        law, lanes, last = self._law, self.lanes, len(self._law.feedforward)
        # The clock advances with time, and is then corrected by the lateness.
        place = self.place + max(tick - self._tick, 0)
        self._tick = tick
        k = lanes.clip(lanes.nearest(place), 0, last)
        lateness = lanes.dot(law.normals[k], states - interpolated(law.reference_states, place, lanes))
        self.place = place = place + lanes.clip(lateness, -MOST, MOST)
        reference = interpolated(law.reference_states, place, lanes)
        j = lanes.clip(lanes.nearest(place), 0, last - 1)
        return law.feedforward[j], lanes.dot(law.gains[j], reference - states), reference

    def resynchronise(self, tick: int, state: Array) -> str:
        """Move the reference's clock to the phase nearest to a state, and return a sentence for the log.

        The loop calls it if the arms have been far from the reference for some time.

        Args:
            tick: present tick.
            state: state (N,) at that tick.
        """
        expected = self.place + tick - self._tick
        self._tick, self.place = tick, float(self._law.nearest(state))
        return f"clock of the reference moved by {self.place - expected:+.0f} ticks"


@dataclass(frozen=True)
class FeedforwardSettings(Settings, table="controller"):
    """The reference's input alone.

    It shows that even a correct reference needs feedback.
    """

    kind: str = "feedforward"


SCHEDULES = ("time", "phase")


@dataclass(frozen=True)
class TvlqrSettings(ClosingWeights):
    """Linear-quadratic feedback, with gains by time or at the nearest phase (`schedule`)."""

    angle: float = 10_000.0
    rate: float = 1000.0
    position: float = 150.0
    kind: str = "tvlqr"
    schedule: Annotated[str, Setting(choices=SCHEDULES, help="Whether gains follow time or phase.")] = "time"


@dataclass(frozen=True, eq=False)
class TrackingController(TimedController):
    """Gains by time, also for flights of a program."""

    def join(self, tick: int, state: Array) -> "TrackingSession":
        """Return a session in which the reference begins at a tick, for flights of a program.

        Args:
            tick: first tick.
            state: ignored.
        """
        return TrackingSession(self, tick)


class TrackingSession(Session):
    """A tracking controller during a flight, from tick `start`.

    Its clock is that of the loop.
    """

    def __init__(self, controller: TrackingController, start: int = 0) -> None:
        """Begin a session at a tick of the loop.

        Args:
            controller: the controller.
            start: tick of the loop at which the reference begins.
        """
        self._law, self._start = controller, start

    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return the action for the period from `tick`; after the last tick, its gain holds the reference's end.

        Args:
            tick: the tick in which the command acts.
            state: predicted state (N,) at the tick.
            extra: ignored.
        """
        law, tick = self._law, max(tick - self._start, 0)
        k = min(tick, law.ticks - 1)
        reference = law.reference_states[min(tick, law.ticks)]
        return Action(float(law.feedforward[k]), float(law.gains[k].dot(reference - state)), reference, Mode.TRACKING)


@dataclass(frozen=True)
class AdaptiveSettings(ClosingWeights):
    """Weights like those of "tvlqr", but smaller.

    They are smaller except at the end, since known errors need no feedback.

    Attributes:
        trust: largest error log(p/p₀) of a parameter that the law uses; errors of 0.3 in masses and lengths cause at
            most 0.7.
    """

    kind: str = "adaptive"
    angle: float = 6000.0
    rate: float = 600.0
    closing: float = 120.0
    trust: Annotated[
        float, Setting(least=0, most=1.9, help="Largest logarithmic error of a parameter that the law acts on.")
    ] = 0.8


@dataclass(frozen=True, eq=False)
class AdaptiveController(TimedController):
    """Gains by time on the state and on the extras.

    There are gains on the extras (K, E), and on products of all pairs of shares (K, P).

    Attributes:
        shares: True for extras (E,) that are relative errors of parameters.
        names: names of all extras.
        trust: limit of the shares, see the settings.
    """

    extra_gains: Array
    pair_gains: Array
    names: tuple[str, ...]
    shares: NDArray[np.bool_]
    trust: float

    def schedule(self, lead: int) -> GainSchedule:
        """Return the gain schedule, with gains on the extras and on products of the shares.

        Args:
            lead: number of ticks between the computation of a command and its action.
        """
        return GainSchedule(
            self._rows(lead, self.extra_gains, self.pair_gains), self.reference_states, self.feedforward[:lead],
            Mode.TRACKING, tuple(self.shares.tolist()), self.names, self.trust,
        )  # fmt: skip


def terminal_cost(state_jacobian: Array, input_jacobian: Array, *, weights: Array, effort: float) -> Array:
    """Return P (N, N), the cost-to-go at a reference's end, from the discrete algebraic Riccati equation.

    Args:
        state_jacobian: A (N, N).
        input_jacobian: B (N,).
        weights: Q (N, N).
        effort: weight r of the input.

    Raises:
        GoalMissed: the pair cannot be stabilised.
    """
    # python-control calls the same function, and takes a second to import.
    from scipy.linalg import solve_discrete_are

    try:
        cost = solve_discrete_are(state_jacobian, input_jacobian[:, None], weights, np.array([[effort]]))
    except (np.linalg.LinAlgError, ValueError) as error:
        raise GoalMissed(
            f"no terminal cost for the controller: the reference's end cannot be stabilised ({error}); give the "
            "cart's position a weight and choose an end that the cart can influence"
        ) from error
    return np.asarray(cost)


def riccati_gains(
    state_jacobians: Array,
    input_jacobians: Array,
    *,
    weights: Array,
    effort: float,
    terminal: Array,
    extras: tuple[Array, Array] | None = None,
) -> tuple[Array, Array, Array]:
    """Return the linear-quadratic gains along a motion, by the backward recursion, and the cost-to-go P (K+1, N, N).

    There are gains on the state (K, N) and on the extras (K, E).

    Args:
        state_jacobians: A (K, N, N).
        input_jacobians: B (K, N).
        weights: Q (N, N), its diagonal (N,), or Q at each tick (K, N, N).
        effort: weight r of the input.
        terminal: P (N, N) at the end.
        extras: effects E (K, N, E) on the state after a period, and decay factors D (E,) per period, of the
            disturbances w that the estimator adds, w+ = D w; None for no gains on them (E = 0).
    """
    gains = np.empty_like(input_jacobians)
    effects, decay = extras or (np.empty((len(gains), gains.shape[1], 0)), np.empty(0))
    extra_gains = np.empty((len(gains), len(decay)))
    costs, extra_cost = np.empty((len(gains) + 1, *terminal.shape)), np.zeros(effects.shape[1:])
    costs[-1] = cost = terminal
    state_cost = np.diag(weights) if weights.ndim == 1 else weights
    state_costs = np.broadcast_to(state_cost, (len(gains), *terminal.shape))
    # numpy's outer would take as long as all the rest.
    for k in range(len(gains) - 1, -1, -1):
        matrix, response = state_jacobians[k], input_jacobians[k]
        weighted = response @ cost
        curvature = effort + weighted @ response
        gains[k] = gain = (weighted @ matrix) / curvature
        closed_loop = matrix - response[:, None] * gain
        extra_push = cost @ effects[k] + extra_cost * decay
        extra_gains[k] = (response @ extra_push) / curvature
        extra_cost = closed_loop.T @ extra_push
        # The symmetric (Joseph) form keeps P positive over thousands of steps.
        cost = state_costs[k] + effort * (gain[:, None] * gain) + closed_loop.T @ cost @ closed_loop
        costs[k] = cost = (cost + cost.T) / 2
    return gains, extra_gains, costs


def tracking_controller(
    reference: Reference, model: SampledModel, settings: FeedforwardSettings | TvlqrSettings
) -> TrackingController | PhaseController:
    """Return the controller for a reference at the model's period.

    The terminal cost is that of the model frozen at the reference's end. Its influence decays within a few tenths of a
    second, so the simplest positive definite matrix is sufficient. The Riccati solution of the periodic orbit would
    require the orbit, which friction changes.

    Args:
        reference: reference to follow.
        model: model of arms and drive from tick to tick.
        settings: weights of the law.

    Raises:
        GoalMissed: the reference's end cannot be stabilised.
    """
    path = motion_at_ticks(reference, model)
    limit = reference.limits.acceleration
    if isinstance(settings, FeedforwardSettings):
        gains = np.zeros((len(path.commands), model.dimension + (model.lag > 0)))
        return TrackingController(settings.kind, path.states, **_by_time(model, path, gains, limit))
    law = tracking_law(path, model, settings, most=limit)
    if settings.schedule == "phase":
        return phase_controller(
            settings.kind, states=path.states, feedforward=law.feedforward, gains=law.gains, period=model.period
        )
    return law


class TickedMotion(NamedTuple):
    """A motion at the loop's ticks.

    States (K+1, N), mean accelerations (K,) of the cart in the periods and its accelerations (K+1,) at the ticks, m/s².
    """

    states: Array
    commands: Array
    drive: Array


def tracking_law(
    path: TickedMotion,
    model: SampledModel,
    settings: TvlqrSettings,
    *,
    most: float,
    terminal: Array | None = None,
    coarse: SampledModel | None = None,
) -> TrackingController:
    """Return the TVLQR controller for a motion at the model's ticks, such as a planned flight.

    Args:
        path: states and inputs at the ticks.
        model: model of arms and drive from tick to tick.
        settings: weights of the law.
        most: greatest acceleration of the cart, m/s².
        terminal: cost-to-go P (N, N) at the end, default that of the model frozen there.
        coarse: model over several ticks, for which the gains are computed, default `model`. They change slowly.

    Raises:
        GoalMissed: the end cannot be stabilised, or the gains are infinite.
    """
    coarse = coarse or model
    stride, last = round(coarse.period / model.period), len(path.commands)
    begins = np.arange(0, last, stride)
    commands = np.add.reduceat(path.commands, begins) / np.minimum(stride, last - begins)
    states = np.concatenate([path.states[:-1:stride], path.states[-1:]])
    diagonal, effort = settings.weights(model.arms, coarse.period)
    state_jacobians, input_jacobians = coarse.lagging(*coarse.linearised(states[:-1], commands))
    if terminal is None:
        terminal = terminal_cost(
            state_jacobians[-1], input_jacobians[-1], weights=_widened(np.diag(diagonal), coarse), effort=effort
        )
    else:
        terminal = _widened(terminal, coarse)
    weights = _widened(closing_weights(settings, states, coarse), coarse)
    gains, *_ = riccati_gains(state_jacobians, input_jacobians, weights=weights, effort=effort, terminal=terminal)
    if not np.isfinite(gains).all():
        raise GoalMissed(
            "the controller's gains became infinite; increase the weight of the effort or shorten the period"
        )
    by_time = _by_time(model, path, np.repeat(gains, stride, axis=0)[:last], most)
    return TrackingController(settings.kind, path.states, **by_time)


def motion_at_ticks(reference: Reference, model: SampledModel) -> TickedMotion:
    """Return a reference's states and inputs at a model's ticks, for which gains are computed.

    Args:
        reference: reference to sample.
        model: model of arms and drive from tick to tick.
    """
    count = max(int(np.ceil(reference.duration / model.period - 1e-6)), 1)
    times = reference.mesh[0] + model.period * np.arange(count + 1)
    # The input in the middle of a period; a constant input then errs only by the square of the period.
    commands = reference.input(times[:-1] + model.period / 2)[:, 0]
    return TickedMotion(reference.state(times), commands, reference.input(times)[:, 0])


def _widened(weights: Array, model: SampledModel) -> Array:
    """Return weights (…, N, N) for the state of a model whose drive lags, (…, N+1, N+1); unchanged without lag.

    The added state, the cart's acceleration, has zero weight.
    """
    return np.pad(weights, [(0, 0)] * (weights.ndim - 2) + [(0, 1), (0, 1)]) if model.lag else weights


def _by_time(model: SampledModel, path: TickedMotion, gains: Array, most: float) -> dict[str, Any]:
    """Return the fields of a `TimedController`: feedforward (K,) m/s², gains (K, N), and data of a lagging drive.

    The drive's command leads so that its acceleration equals the reference's at the ticks.

    `path`: states and inputs of the reference at the ticks. `gains`: (K, N), or (K, N+1) with a lagging drive, the last
    on the cart's acceleration. `most`: largest acceleration, m/s².
    """
    if not model.lag:
        return {"feedforward": path.commands, "gains": gains}
    keeps, drive = model.lag_keeps, path.drive
    leading = np.clip((drive[1:] - keeps * drive[:-1]) / (1 - keeps), -most, most)
    drive_gains = np.append(gains[:, -1], gains[-1, -1])
    return {"feedforward": leading, "gains": gains[:, :-1], "drive": np.stack([drive, drive_gains], axis=1)}


def regulator_along(
    model: SampledModel, states: Array, commands: Array, settings: QuadraticWeights, *, parameters: Array | None = None
) -> tuple[Array, Array, Array]:
    """Return gains (K, N), closed-loop matrices (K, N, N) and P (K+1, N, N) of feedback along a motion.

    P is that of the cost-to-go eᵀPe, at the end that of the model frozen there. A flight's target is a
    place of the motion with this cost, and plans are compared by their gains.

    Args:
        model: model of arms and drive from tick to tick.
        states: states (K, N) at the ticks.
        commands: accelerations (K,) of the cart, m/s².
        settings: weights of the cost.
        parameters: parameters of the equations, default those of the model.

    Raises:
        GoalMissed: the motion's end cannot be stabilised.
    """
    state_jacobians, input_jacobians = model.linearised(states, commands, parameters=parameters)
    diagonal, effort = settings.weights(model.arms, model.period)
    terminal = terminal_cost(state_jacobians[-1], input_jacobians[-1], weights=np.diag(diagonal), effort=effort)
    gains, _, costs = riccati_gains(
        state_jacobians, input_jacobians, weights=diagonal, effort=effort, terminal=terminal
    )
    return gains, state_jacobians - input_jacobians[:, :, None] * gains[:, None], costs


def extra_jacobians(
    model: SampledModel, augment: tuple[Augment, ...], states: Array, commands: Array, process: Array
) -> tuple[Array, Array]:
    """Return effects E (K, N, E) of the extras on the state after a period, and their decay factors D (E,) per period.

    Extras are the quantities that the estimator estimates beside the state, such as errors of parameters. Effects and
    factors come from the estimator's prediction.

    Args:
        model: model of arms and drive from tick to tick.
        augment: kinds of extras.
        states: states (K, N).
        commands: accelerations of the cart (K,), m/s².
        process: noise parameters (P,), see `FilterSettings.process`.
    """
    equations = FilterEquations(model.equations, model.period, augment)
    size, n, count = equations.dimension, model.dimension, len(states)
    program = Compiled(equations.prediction(with_jacobian=True), QUICK)
    inputs = np.zeros((program.size_in, count))
    inputs[:n] = states.T
    for name, value in (("command", commands), ("parameters", model.parameters), ("process", process)):
        inputs[program.slices[name]] = value if name == "command" else value[:, None]
    results = program(inputs, np.empty((program.size_out, count)))
    jacobian = results[size : size + size * size].reshape(size, size, count)
    # casadi writes column by column: the first index is the column.
    return jacobian[n:, :n].transpose(2, 1, 0).copy(), jacobian[range(n, size), range(n, size), 0].copy()


def closing_weights(settings: ClosingWeights, states: Array, model: SampledModel) -> Array:
    """Return Q (K, N, N) at the ticks of a reference.

    Towards the end, angles have a larger weight across their path than along it.

    Args:
        settings: weights along the reference.
        states: reference states (K+1, N).
        model: model of arms and drive from tick to tick.
    """
    n, count = model.arms, len(states) - 1
    diagonal, _ = settings.weights(n, model.period)
    weights = np.tile(np.diag(diagonal), (count, 1, 1))
    last = max(count - round(settings.closing_time / model.period), 0)
    rates = states[last:-1, n : 2 * n]
    path_projection = rates[:, :, None] * rates[:, None, :] / (np.square(rates).sum(1) + TURNING**2)[:, None, None]
    weights[last:, :n, :n] += (settings.closing - 1) * diagonal[0] * (np.eye(n) - path_projection)
    return weights


def _shifted(
    a: Array, b: Array, e: Array, gains: Array, *, weights: Array, effort: float, terminal: Array
) -> tuple[Array, Array, Array]:
    """Return gains F (K, E) on constant quantities for fixed feedback gains, with the shifts of states and inputs.

    The shifts X (K+1, N, E) and (K, E) are those of the reference by a unit of each quantity. The feedback `gains` (K,
    N) follow the reference that is optimal by `weights` for known constants, to first order. X_{k+1} = (A - B K̂) X_k +
    E - B F̂, X_0 = 0, with K̂ and F̂ the gains by `weights`. Then F = F̂ + (K̂ - K) X.

    `a` (K, N, N), `b` (K, N), `e` (K, N, E): A, B and E along the reference. `weights` (K, N, N), `effort`, `terminal`
    (N, N): Q, r and P of the cost.
    """
    optimal_gains, direct_gains, _ = riccati_gains(
        a, b, weights=weights, effort=effort, terminal=terminal, extras=(e, np.ones(e.shape[2]))
    )
    total_gains, inputs, states = (
        np.empty_like(direct_gains),
        np.empty_like(direct_gains),
        np.zeros((len(b) + 1, *e.shape[1:])),
    )
    for k in range(len(b)):
        shift = states[k]
        inputs[k] = -(optimal_gains[k] @ shift + direct_gains[k])
        total_gains[k] = direct_gains[k] + (optimal_gains[k] - gains[k]) @ shift
        states[k + 1] = a[k] @ shift + e[k] + b[k][:, None] * inputs[k]
    return total_gains, states, inputs


_SHARE = 0.05
"""Relative step of a parameter for second-order terms; the fourth-order term is a 400th of it."""


def _of_second_order(
    model: SampledModel, estimator: FilterSettings, states: Array, commands: Array, *, moved: Array, pushed: Array,
    which: NDArray[np.intp],
) -> Array:  # fmt: skip
    """Return E' (K, N, P), the second-order effects of all P pairs of m parameter errors along the shifted path.

    `adaptive_controller` compensates them like further constant errors. They are central differences of `defects`.

    `states` (K+1, N), `commands` (K,) m/s²: the reference. `moved` (K+1, N, m), `pushed` (K, m) m/s²: shifts of states
    and commands by a unit of each error. `which` (m,): indices of the extras with the errors. `estimator`: settings
    that define the extras.
    """
    equations = FilterEquations(model.equations, model.period, estimator.augments)
    n, m, count = model.dimension, len(which), len(commands)
    program = Compiled(equations.prediction(with_jacobian=False))
    inputs, out = np.zeros((program.size_in, count)), np.empty((program.size_out, count))
    inputs[program.slices["parameters"]] = model.parameters[:, None]
    inputs[program.slices["process"]] = estimator.process(model.arms, model.period)[:, None]

    lag = model.lag / model.period * (1 - model.lag_keeps)

    def defects(shares: Array) -> Array:
        """Return the defects (K, N) of the path that is shifted in proportion to the errors `shares` (m,).

        A defect is the model's state after a period minus the path's next state.
        """
        state_shift, command_shift = moved @ shares, pushed @ shares
        path = states + state_shift[:, :n]
        inputs[:n], inputs[program.slices["command"]] = path[:-1].T, commands + command_shift
        if model.lag:
            inputs[program.slices["command"]] += lag * (state_shift[:-1, n] - command_shift)
        inputs[n + which] = shares[:, None]
        return program(inputs, out)[:n].T - path[1:]

    effects, unit, nominal_defects = [], _SHARE * np.eye(m), defects(np.zeros(m))
    for i, j in combinations_with_replacement(range(m), 2):
        # Half of the second derivative by one error, or the mixed one by two.
        difference = (
            2 * (defects(unit[i]) + defects(-unit[i]) - 2 * nominal_defects)
            if i == j
            else defects(unit[i] + unit[j])
            + defects(-unit[i] - unit[j])
            - defects(unit[i] - unit[j])
            - defects(unit[j] - unit[i])
        )
        effects.append(difference / (4 * _SHARE**2))
    return np.pad(np.stack(effects, axis=2), ((0, 0), (0, int(model.lag > 0)), (0, 0)))


def adaptive_controller(
    reference: Reference, model: SampledModel, settings: AdaptiveSettings, *, estimator: FilterSettings
) -> AdaptiveController:
    """Return the adaptive controller, which uses the estimator's extras, for a reference.

    Its gains on constant errors are those of the shifted reference, and products of the parameters' errors have gains
    as well; see the module's text.

    Args:
        reference: reference to follow.
        model: model of arms and drive from tick to tick.
        settings: weights of the law.
        estimator: settings of the estimator, which must estimate the parameters.

    Raises:
        InputError: the estimator does not estimate the parameters.
        GoalMissed: the reference's end cannot be stabilised, or the gains are infinite.
    """
    if Augment.PARAMETERS not in estimator.augments:
        raise InputError(
            f"controller: kind = {settings.kind!r} needs estimated errors of the model, but the estimator has "
            f'augment = {list(estimator.augment)!r}: add "parameters", and "friction" as well'
        )
    states, commands, _ = path = motion_at_ticks(reference, model)
    state_jacobians, input_jacobians = model.linearised(states[:-1], commands)
    process = estimator.process(model.arms, model.period)
    effects, decay = extra_jacobians(model, estimator.augments, states[:-1], commands, process)
    (state_jacobians, input_jacobians), effects = (
        model.lagging(state_jacobians, input_jacobians),
        np.pad(effects, ((0, 0), (0, int(model.lag > 0)), (0, 0))),
    )
    diagonal, effort = settings.weights(model.arms, model.period)
    weights = _widened(np.diag(diagonal), model)
    terminal = terminal_cost(state_jacobians[-1], input_jacobians[-1], weights=weights, effort=effort)
    gains, extra_gains, _ = riccati_gains(
        state_jacobians,
        input_jacobians,
        weights=weights,
        effort=effort,
        terminal=terminal,
        extras=(effects, decay),
    )
    names = extra_names(model.arms, estimator.augments)
    shares = np.array([name.startswith(("M", "S")) for name in names])
    shifted = partial(
        _shifted, state_jacobians, input_jacobians, gains=gains,
        weights=_widened(closing_weights(settings, states, model), model), effort=effort, terminal=terminal,
    )  # fmt: skip
    constant = decay == 1
    extra_gains[:, constant], moved, pushed = shifted(effects[:, :, constant])
    constant_shares = shares[constant]
    pair_effects = _of_second_order(
        model, estimator, states, commands, moved=moved[:, :, constant_shares], pushed=pushed[:, constant_shares],
        which=np.flatnonzero(shares),
    )  # fmt: skip
    pair_gains = shifted(pair_effects)[0]
    if not all(np.isfinite(gain_table).all() for gain_table in (gains, extra_gains, pair_gains)):
        raise GoalMissed(
            "the controller's gains became infinite; increase the weight of the effort or shorten the period"
        )
    return AdaptiveController(
        settings.kind, states, **_by_time(model, path, gains, reference.limits.acceleration),
        extra_gains=extra_gains, pair_gains=pair_gains, names=names, shares=shares, trust=settings.trust,
    )  # fmt: skip
