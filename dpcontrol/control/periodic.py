"""Linear-quadratic feedback that repeats itself: gains of a periodic system, and an orbit held by them tick by tick.

    minimise Σ_k ξ_kᵀ Q ξ_k + r p_k²,    ξ_{k+1} = A_k ξ_k + B_k p_k,    A_{k+m} = A_k, B_{k+m} = B_k

The backward Riccati recursion is run over period after period until its gains repeat themselves. On an orbit, the
time of the motion is either the clock's since the start, or corrected at every tick to that of the nearest phase.
Source: Bittanti, Laub & Willems (eds.), The Riccati Equation, chapter 6; Hauser & Hindman (1995) for the phase.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.interface import Action, Mode, SampledModel
from dpcontrol.control.phase import PhaseTable, phase_table
from dpcontrol.control.tracking import TvlqrSettings, riccati_gains
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.references.problem import ANGLE_SCALE, RATE_SCALE

if TYPE_CHECKING:
    from dpcontrol.references.sustained import SustainedOrbit

Array = NDArray[np.float64]

_MOST_STEPS = 200_000
_SETTLED = 1e-9


def periodic_gains(matrices: Array, responses: Array, *, weights: Array, effort: float) -> Array:
    """Return the gains (m, N) of the periodic Riccati equation of A (m, N, N), B (m, N), Q's diagonal (N,), r.

    Raises:
        GoalMissed: the recursion does not settle: what drifts or grows is out of the input's reach.
    """
    m = len(matrices)
    cost = np.diag(weights)
    before = np.full_like(responses, np.inf)
    for _ in range(max(_MOST_STEPS // m, 3)):
        gains, cost = riccati_gains(matrices, responses, weights=weights, effort=effort, terminal=cost)
        if not np.isfinite(gains).all():
            break
        if np.abs(gains - before).max() <= _SETTLED * np.abs(gains).max():
            largest = float(np.abs(closed_multipliers(matrices, responses, gains))[0])
            if largest < 1:
                return gains
            raise GoalMissed(
                f"no periodic gains: what grows by {largest:.4g} in a period is out of the input's reach; give the "
                "cart's position a weight, or take more sections in a period"
            )
        before = gains
    raise GoalMissed("no periodic gains: the Riccati recursion did not settle; weigh the effort more")


def closed_multipliers(matrices: Array, responses: Array, gains: Array) -> NDArray[np.complex128]:
    """Return the multipliers (N,) of a period under p = -K ξ, largest first: the loop is stable below 1."""
    product = np.eye(matrices.shape[-1])
    for a, b, gain in zip(matrices, responses, gains, strict=True):
        product = (a - np.outer(b, gain)) @ product
    values = np.linalg.eigvals(product).astype(complex)
    return values[np.argsort(-np.abs(values), kind="stable")]


@dataclass(frozen=True, eq=False)
class OrbitController:
    """Holds a sustained orbit by gains at every tick: TVLQR that never ends.

    table: one period at its ticks, of which there are `gains` (M, N); normals (M, N): see `PhaseSection`; ticks: for
    how long; by_phase: whether the clock is corrected to the nearest phase at every tick.
    """

    kind: str
    table: PhaseTable
    gains: Array
    normals: Array
    feedforward: Array
    period: float
    ticks: int
    by_phase: bool
    status: str

    @property
    def first_state(self) -> Array:
        """Return the state (N,) from which it starts: the orbit at its phase 0."""
        return self.table.states[0]

    def begin(self) -> "OrbitSession":
        """Return a fresh session for one run."""
        return OrbitSession(self, 0, 0.0, np.zeros(len(self.first_state)))

    def begin_runs(self, count: int) -> "OrbitRuns":
        """Return what answers `commands` for `count` runs, each with a clock and so with a reference of its own."""
        return OrbitRuns(self, count)

    def join(self, tick: int, state: Array) -> "OrbitSession":
        """Return a session that starts at `tick` from `state` (N,), at the nearest phase and on its turns."""
        time, _, turns = self.table.nearest(state)
        lift = np.zeros(len(state))
        lift[: len(turns)] = turns
        return OrbitSession(self, tick, float(time), lift)

    def distance(self, state: Array) -> float:
        """Return the scaled distance of the pendulum's `state` (N,) from the orbit, modulo turns."""
        return float(self.table.nearest(state)[1])


class OrbitSession:
    """An orbit's clock during one run; lift (N,): whole turns of the arms by which the run is away from the table."""

    def __init__(self, controller: OrbitController, tick: int, time: float, lift: Array) -> None:
        self._law = controller
        self._tick = tick
        self._time = time
        self._lift = lift

    @property
    def orbit_period(self) -> float:
        """Return the orbit's period in s."""
        return self._law.table.period

    @property
    def time(self) -> float:
        """Return the time on the orbit's clock in s."""
        return self._time % self.orbit_period

    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return what to do in the period from `tick` at `state` (N,)."""
        law = self._law
        table = law.table
        self._time += (tick - self._tick) * law.period
        self._tick = tick
        x = state - self._lift
        count = len(law.gains)
        if law.by_phase:
            k = round(self._time / table.step) % count
            # Half a tick forth and back at most: the clock glides, whatever the estimate does.
            late = float((x - table.state(self._time)).dot(law.normals[k]))
            self._time += min(max(late, -law.period / 2), law.period / 2)
        k = round(self._time / table.step) % count
        wanted = table.state(self._time)
        feedback = float(law.gains[k].dot(wanted - x))
        return Action(float(law.feedforward[k]), feedback, wanted + self._lift, Mode.HOLDING)

    def resynchronise(self, tick: int, state: Array) -> str:
        """Move the clock to the phase nearest to `state` (N,); say by how much."""
        time, _, turns = self._law.table.nearest(state)
        expected = self._time + (tick - self._tick) * self._law.period
        half = self._law.table.period / 2
        moved = (float(time) - expected + half) % (2 * half) - half
        self._tick, self._time = tick, float(time)
        self._lift = np.concatenate([turns, np.zeros(len(state) - len(turns))])
        return f"clock of the orbit moved by {moved:+.4f} s"


class OrbitRuns:
    """`count` sessions of one controller in lockstep, all from its first state."""

    def __init__(self, controller: OrbitController, count: int) -> None:
        self._law = controller
        self._tick = 0
        self._times = np.zeros(count)

    def commands(self, tick: int, states: Array, extras: Array | None = None) -> tuple[Array, Array, Array]:
        """Return feedforwards (S,), feedbacks (S,) in m/s² and references (N, S) for `states` (N, S) at `tick`."""
        law, table, x = self._law, self._law.table, states.T
        self._times += (tick - self._tick) * law.period
        self._tick = tick
        count = len(law.gains)
        if law.by_phase:
            k = np.rint(self._times / table.step).astype(int) % count
            late = ((x - table.states_at(self._times)) * law.normals[k]).sum(1)
            self._times += np.clip(late, -law.period / 2, law.period / 2)
        k = np.rint(self._times / table.step).astype(int) % count
        wanted = table.states_at(self._times)
        return law.feedforward[k], (law.gains[k] * (wanted - x)).sum(1), wanted.T


def orbit_controller(
    orbit: "SustainedOrbit", model: SampledModel, settings: TvlqrSettings, *, seconds: float
) -> OrbitController:
    """Return the controller that holds `orbit` for `seconds` by feedback at every tick of the model.

    settings.schedule: "time" or "phase". The period is cut into equal ticks next to the model's own in length.

    Raises:
        InputError: the orbit did not converge, or is of another number of arms.
        GoalMissed: it cannot be stabilised.
    """
    check_orbit(orbit, model)
    weights, effort = settings.weights(model.arms, model.period)
    count = max(round(orbit.period / model.period), 4)
    table = phase_table(orbit, entries=count)
    feedforward = np.asarray(orbit.input((np.arange(count) + 0.5) * table.step))
    ticks = SampledModel(model.equations, model.parameters, period=table.step)
    a, b = ticks.linearised(table.states[:-1], feedforward)
    gains = periodic_gains(a, b, weights=weights, effort=effort)
    n = 2 * model.arms
    rates = np.zeros_like(table.states[:-1])
    rates[:, :n] = (np.roll(table.states[:-1, :n], -1, 0) - np.roll(table.states[:-1, :n], 1, 0)) / (2 * table.step)
    normals = rates / np.array([ANGLE_SCALE**2] * model.arms + [RATE_SCALE**2] * model.arms + [1.0, 1.0])
    normals /= (normals * rates).sum(1)[:, None]
    return OrbitController(
        kind=settings.kind,
        table=table,
        gains=gains,
        normals=normals,
        feedforward=feedforward,
        period=model.period,
        ticks=max(round(seconds / model.period), 1),
        by_phase=settings.schedule == "phase",
        status=f"periodic gains at {count} ticks of a period of {orbit.period:.4g} s",
    )


def check_orbit(orbit: "SustainedOrbit", model: SampledModel) -> None:
    """Reject an orbit that cannot be held with this model.

    Raises:
        InputError: the orbit did not converge, or is of another number of arms.
    """
    if not orbit.converged:
        raise InputError(f"the orbit cannot be held: {orbit.status}")
    if orbit.equations.dimension != model.dimension:
        raise InputError(
            f"the orbit has {orbit.equations.dimension} states, the model {model.dimension}: use one model"
        )
