"""Controllers that follow a reference: its input alone, or with time-varying linear-quadratic feedback.

    minimise Σ_k e_kᵀ Q e_k + r v_k² + e_Nᵀ P e_N,      e_{k+1} = A_k e_k + B_k v_k
    K_k = (r + B_kᵀ P_{k+1} B_k)⁻¹ B_kᵀ P_{k+1} A_k,     u_k = u*(t_k) + K_k (x*(t_k) - x̂_k)

e: the state's distance from the reference x*, v: the input's from u*, A and B along the reference.
Source: Anderson & Moore, Optimal Control: Linear Quadratic Methods, sections 2.4 and 4.1.

Following a reference by phase: the clock goes on with time and is corrected to the phase nearest to the state.

    c := c + 1 + lateness,    lateness = (x̂ - x*(c))·n(c),    n = D⁻² ẋ* / (|D⁻¹ ẋ*|² + ε²)      in ticks

D: the pendulum's scale; the cart is left out, as its position does not depend on the phase. ε: where the reference
stands still the clock goes on with time alone.
Source: Hauser & Hindman, Manoeuvre regulation from trajectory tracking, NOLCOS (1995), section 3.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.interface import Action, Mode, SampledModel, Session
from dpcontrol.control.lqr import ClosingWeights
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.settings import setting
from dpcontrol.references.problem import ANGLE_SCALE, RATE_SCALE
from dpcontrol.references.reference import Reference

Array = NDArray[np.float64]

STANDSTILL = 0.1
"""Scaled rate per second (π rad and 10 rad/s) below which the phase of a motion counts less and less."""
MOST = 0.5
"""Ticks by which the clock is moved at most, forth or back: it glides, whatever the estimate does."""


@dataclass(frozen=True, eq=False)
class ReferenceController:
    """What follows a reference: its states (K+1, N) and inputs (K,) in m/s² at the ticks, gains (K, N) on the state."""

    kind: str
    reference_states: Array
    feedforward: Array
    gains: Array
    status: str

    @property
    def first_state(self) -> Array:
        """Return the state (N,) from which it starts."""
        return self.reference_states[0]

    @property
    def ticks(self) -> int:
        """Return for how many periods it has something to do, if its clock goes with time."""
        return len(self.feedforward)


@dataclass(frozen=True, eq=False)
class TimedController(ReferenceController, ABC):
    """One whose clock is the loop's, so that many runs in lockstep share the reference."""

    def begin(self) -> Session:
        """Return a session for one run."""
        return self.join(0, self.first_state)

    def begin_many(self, count: int) -> Self:
        """Return what answers `commands` for `count` runs in lockstep."""
        return self

    @abstractmethod
    def join(self, tick: int, state: Array) -> Session:
        """Return a session whose start is at `tick`."""


class TimedSession:
    """A run whose clock is the loop's, from tick `start` on."""

    def __init__(self, start: int) -> None:
        self._start = start

    def resynchronise(self, tick: int, state: Array) -> str:
        """Leave the clock as it is: gains by time have no other."""
        return ""


@dataclass(frozen=True, eq=False)
class PhaseController(ReferenceController):
    """One whose clock is corrected to the nearest phase at every tick; normals n (K+1, N)."""

    normals: Array

    def begin(self) -> "PhaseSession":
        """Return a session for one run."""
        return PhaseSession(self)

    def begin_runs(self, count: int) -> "PhaseRuns":
        """Return what answers `commands` for `count` runs, each with a clock and so with a reference of its own."""
        return PhaseRuns(self, count)

    def join(self, tick: int, state: Array) -> "PhaseSession":
        """Return a session that starts at `tick` where the reference is nearest to `state` (N,), on the same turns."""
        return PhaseSession(self, tick=tick, place=self.nearest(state))

    def at(self, places: Array) -> Array:
        """Return reference states (…, N) at places (…) in ticks."""
        states = self.reference_states
        k = np.clip(places.astype(int), 0, len(states) - 2)
        share = np.clip(places - k, 0.0, 1.0)[..., None]
        return states[k] + share * (states[k + 1] - states[k])

    def nearest(self, state: Array) -> int:
        """Return the tick at which the pendulum's reference is nearest to `state` (N,)."""
        scale = _scale(len(state))
        away = (self.reference_states[:, : len(scale)] - state[: len(scale)]) / scale
        return int(np.argmin(np.square(away).sum(1)))


def phase_controller(kind: str, *, states: Array, feedforward: Array, gains: Array, period: float) -> PhaseController:
    """Return the controller for feedforward (K,), gains (K, N) and reference states (K+1, N), `period` s apart."""
    scale = _scale(states.shape[1])
    rates = np.gradient(states[:, : len(scale)], axis=0) / scale
    normals = np.zeros_like(states)
    normals[:, : len(scale)] = rates / scale / (np.square(rates).sum(1) + (STANDSTILL * period) ** 2)[:, None]
    text = f"gains for {len(gains)} ticks, by phase"
    return PhaseController(kind, states, feedforward, gains, text, normals)


def _scale(dimension: int) -> Array:
    arms = (dimension - 2) // 2
    return np.array([ANGLE_SCALE] * arms + [RATE_SCALE] * arms)


class PhaseRuns:
    """The clocks of `count` runs of one law, from the reference's tick `place` at the loop's `tick`."""

    def __init__(self, law: PhaseController, count: int, *, tick: int = 0, place: float = 0.0) -> None:
        self._law = law
        self._tick = tick
        self._places = np.full(count, float(place))

    def commands(self, tick: int, states: Array, extras: Array | None = None) -> tuple[Array, Array, Array]:
        """Return feedforwards (S,), feedbacks (S,) in m/s² and references (N, S) for `states` (N, S) at `tick`."""
        law, x, last = self._law, states.T, len(self._law.feedforward)
        self._places += max(tick - self._tick, 0)
        self._tick = tick
        k = np.clip(np.rint(self._places).astype(int), 0, last)
        late = ((x - law.at(self._places)) * law.normals[k]).sum(1)
        self._places += np.clip(late, -MOST, MOST)
        wanted = law.at(self._places)
        j = np.clip(np.rint(self._places).astype(int), 0, last - 1)
        return law.feedforward[j], (law.gains[j] * (wanted - x)).sum(1), wanted.T


class PhaseSession:
    """One run of a law: from the reference's tick `place` at the loop's `tick`."""

    def __init__(self, law: PhaseController, *, tick: int = 0, place: float = 0.0) -> None:
        self._law = law
        self._tick, self._place = tick, place

    @property
    def place(self) -> float:
        """Return the tick of the reference at which the clock stands."""
        return self._place

    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return what to do in the period from `tick` at `state` (N,)."""
        law, last = self._law, len(self._law.feedforward)
        self._place += max(tick - self._tick, 0)
        self._tick = tick
        k = min(max(round(self._place), 0), last)
        late = float(law.normals[k].dot(state - self._at(self._place)))
        self._place += min(max(late, -MOST), MOST)
        wanted = self._at(self._place)
        j = min(max(round(self._place), 0), last - 1)
        feedback = float(law.gains[j].dot(wanted - state))
        return Action(float(law.feedforward[j]), feedback, wanted, Mode.TRACKING)

    def _at(self, place: float) -> Array:
        states = self._law.reference_states
        k = min(max(int(place), 0), len(states) - 2)
        share = min(max(place - k, 0.0), 1.0)
        return states[k] + share * (states[k + 1] - states[k])

    def resynchronise(self, tick: int, state: Array) -> str:
        """Move the clock to the phase nearest to `state` (N,); say by how much."""
        expected = self._place + tick - self._tick
        self._tick, self._place = tick, float(self._law.nearest(state))
        return f"clock of the reference moved by {self._place - expected:+.0f} ticks"


@dataclass(frozen=True)
class FeedforwardSettings:
    """The reference's input alone: shows that a correct reference is not enough."""

    kind: str = "feedforward"


SCHEDULES = ("time", "phase")


@dataclass(frozen=True)
class TvlqrSettings(ClosingWeights):
    """Linear-quadratic feedback. schedule: whether reference and gains are taken by time or at the nearest phase."""

    angle: float = 10_000.0
    rate: float = 1000.0
    position: float = 150.0
    kind: str = "tvlqr"
    schedule: str = setting("time", choices=SCHEDULES)


ControllerSettings = FeedforwardSettings | TvlqrSettings


@dataclass(frozen=True, eq=False)
class TrackingController(TimedController):
    """Gains by time; of zero: no feedback. After the last tick the last gain holds the reference's end."""

    @cached_property
    def rows(self) -> list[tuple[float, tuple[float, ...], tuple[float, ...]]]:
        """Feedforward, gains and reference state tick by tick as plain floats: quicker than arrays so short."""
        gains, states = self.gains.tolist(), self.reference_states.tolist()
        return [
            (forward, tuple(gain), tuple(state))
            for forward, gain, state in zip(self.feedforward.tolist(), gains, states[:-1], strict=True)
        ]

    def commands(self, tick: int, states: Array, extras: Array) -> tuple[float, Array, Array]:
        """Return feedforward m/s², feedbacks (S,) m/s² and the reference (N,) for `states` (N, S) of many runs.

        The products are added up in the order of the state, as for one run, so that both agree to the last bit.
        """
        k = min(tick, self.ticks - 1)
        products = self.gains[k][:, None] * (self.reference_states[k][:, None] - states)
        return float(self.feedforward[k]), np.add.reduce(products, axis=0), self.reference_states[min(tick, self.ticks)]

    def join(self, tick: int, state: Array) -> "TrackingSession":
        """Return a session whose start is at `tick`."""
        return TrackingSession(self, tick)


class TrackingSession(TimedSession):
    """A tracking controller during one run."""

    def __init__(self, controller: TrackingController, start: int = 0) -> None:
        super().__init__(start)
        self._rows, self._wanted = controller.rows, controller.reference_states
        self._still = not controller.gains.any()
        self._last = len(self._rows) - 1

    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return what to do in the period from `tick`; after the last, its gain holds the reference's end."""
        tick = max(tick - self._start, 0)
        k = tick if tick < self._last else self._last
        wanted = self._wanted[tick if tick <= self._last else self._last + 1]
        forward, gains, due = self._rows[k]
        feedback = 0.0
        if not self._still:
            for gain, wish, seen in zip(gains, due, state.tolist(), strict=True):
                feedback += gain * (wish - seen)
        return Action(forward, feedback, wanted, Mode.TRACKING)


def terminal_cost(state_jacobian: Array, input_jacobian: Array, *, weights: Array, effort: float) -> Array:
    """Return P (N, N) of the discrete algebraic Riccati equation with A (N, N), B (N,), Q's diagonal (N,), r.

    Raises:
        GoalMissed: the pair cannot be stabilised.
    """
    # python-control would ask the same function, and takes a second to import.
    from scipy.linalg import solve_discrete_are

    try:
        cost = solve_discrete_are(state_jacobian, input_jacobian[:, None], np.diag(weights), np.array([[effort]]))
    except (np.linalg.LinAlgError, ValueError) as error:
        raise GoalMissed(
            f"no terminal cost for the controller: the reference's end cannot be stabilised ({error}); give the "
            "cart's position a weight and end away from a motion the cart cannot influence"
        ) from error
    return np.asarray(cost)


def riccati_gains(
    state_jacobians: Array, input_jacobians: Array, *, weights: Array, effort: float, terminal: Array
) -> tuple[Array, Array]:
    """Return gains (K, N) of the backward recursion over A (K, N, N), B (K, N) from P (N, N) = `terminal`, and P_0.

    weights: Q's diagonal, (N,) or one for each tick (K, N).
    """
    gains = np.empty_like(input_jacobians)
    cost = terminal
    changing = weights.ndim > 1
    state_cost = np.diag(weights[-1] if changing else weights)
    diagonal = np.einsum("ii->i", state_cost)
    # numpy's outer and diag would take as long as all the rest.
    for k in range(len(gains) - 1, -1, -1):
        a, b = state_jacobians[k], input_jacobians[k]
        weighted = b @ cost
        gain = (weighted @ a) / (effort + weighted @ b)
        gains[k] = gain
        closed = a - b[:, None] * gain
        if changing:
            diagonal[:] = weights[k]
        # The symmetric form keeps P positive (Joseph): thousands of steps would lose it otherwise.
        cost = state_cost + effort * (gain[:, None] * gain) + closed.T @ cost @ closed
        cost = (cost + cost.T) / 2
    return gains, cost


def tracking_controller(
    reference: Reference, model: SampledModel, settings: ControllerSettings
) -> TrackingController | PhaseController:
    """Return the controller for `reference` at the model's period.

    The terminal cost is that of the model frozen at the reference's end. The recursion forgets it within a few
    tenths of a second, so the simplest positive definite matrix serves; the periodic orbit's own Riccati solution
    would need the orbit, which friction bends.

    Raises:
        InputError: the reference did not converge or has another number of states than the model.
        GoalMissed: the reference's end cannot be stabilised.
    """
    if not reference.converged:
        raise InputError(f"the reference cannot be tracked: {reference.status}")
    if reference.states.shape[-1] != model.dimension:
        raise InputError(
            f"the reference has {reference.states.shape[-1]} states, the model {model.dimension}: use one model"
        )
    count = tick_count(reference, model.period)
    times = reference.mesh[0] + model.period * np.arange(count + 1)
    states = reference.state(times)
    # The input in the middle of a period: holding it errs by the square of the period only.
    feedforward = reference.input(times[:-1] + model.period / 2)[:, 0]
    if isinstance(settings, FeedforwardSettings):
        gains = np.zeros((count, model.dimension))
        return TrackingController(settings.kind, states, feedforward, gains, f"feedforward over {count} ticks")
    diagonal, effort = settings.weights(model.arms, model.period)
    a, b = model.linearised(states[:-1], feedforward)
    terminal = terminal_cost(a[-1], b[-1], weights=diagonal, effort=effort)
    weights = settings.along(model.arms, model.period, count=count)
    gains, _ = riccati_gains(a, b, weights=weights, effort=effort, terminal=terminal)
    if not np.isfinite(gains).all():
        raise GoalMissed("the controller's gains became infinite; weigh effort more or shorten the period")
    if settings.schedule == "phase":
        return phase_controller(settings.kind, states=states, feedforward=feedforward, gains=gains, period=model.period)
    return TrackingController(settings.kind, states, feedforward, gains, f"gains for {count} ticks")


def tick_count(reference: Reference, period: float) -> int:
    """Return the number of periods that cover the reference."""
    return max(int(np.ceil(reference.duration / period - 1e-6)), 1)
