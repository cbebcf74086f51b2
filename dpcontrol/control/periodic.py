"""Orbits for controllers: the nearest phase, and periodic linear-quadratic feedback.

The nearest phase ignores whole turns of the arms. It also ignores the cart, whose position does not depend on the
phase:

    τ = argmin |D⁻¹ (x - x*(τ))|,      D: the scale of the pendulum's state

The best entry of a table of one period is corrected by lateness = (x - x*) · D⁻² ẋ* / |D⁻¹ ẋ*|².

Gains of a periodic system hold an orbit tick by tick:

    minimise Σ_k ξ_kᵀ Q ξ_k + r p_k²,    ξ_{k+1} = A_k ξ_k + B_k p_k,    A_{k+m} = A_k, B_{k+m} = B_k

The backward Riccati recursion runs over successive periods until its gains repeat. On an orbit, the time of the motion
either follows the clock since the start, or is corrected to the nearest phase at every tick.
Sources: Bittanti, Laub & Willems (eds.), The Riccati Equation, chapter 6. Hauser & Hindman, Manoeuvre regulation from
trajectory tracking, NOLCOS (1995), section 3, for the phase.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.control.interface import (
    MANY,
    ONE,
    ClockedSession,
    Lanes,
    SampledModel,
    interpolated,
    pendulum_scale,
    whole_turns,
)
from dpcontrol.control.tracking import TvlqrSettings, riccati_gains
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.shown import Brief

if TYPE_CHECKING:
    from dpcontrol.references.sustained import SustainedOrbit


ENTRIES = 2048
"""Entries per period; linear interpolation then errs by 1e-5 rad at the lab's largest accelerations."""
COARSE = 8
"""Every k-th entry is searched before the best one is refined."""


@dataclass(frozen=True, eq=False)
class PhaseTable(Brief):
    """One period of a motion in s.

    States (M+1, N) and inputs (M+1,) m/s² at even times, both ends included.
    """

    period: float
    states: Array
    inputs: Array

    @property
    def step(self) -> float:
        """Return the time between two entries of the table, s."""
        return self.period / (len(self.states) - 1)

    def state(self, time: Any, lanes: Lanes = ONE) -> Array:
        """Return the motion's states at times, interpolated, modulo the period.

        Args:
            time: time, s, or times (S,).
            lanes: arithmetic for one run, `ONE`, or for S runs, `MANY`.

        Returns:
            State (N,), or states (S, N).
        """
        return interpolated(self.states, time % self.period / self.step, lanes)

    def input(self, time: Any, lanes: Lanes = ONE) -> Any:
        """Return the inputs of the table's entries nearest in time, m/s².

        Args:
            time: time, s, or times (S,), modulo the period.
            lanes: arithmetic for one run, `ONE`, or for S runs, `MANY`.
        """
        return self.inputs[lanes.nearest(time % self.period / self.step)]

    def shift(self, time: Any, expected: Any) -> Any:
        """Return the time by which a clock is ahead of an expected time, s, at most half a period either way.

        Args:
            time: time, s, or times of any shape.
            expected: expected time, s, in the same shape.
        """
        half = self.period / 2
        return (time - expected + half) % (2 * half) - half

    def distance(self, state: Array) -> float:
        """Return the distance of a state from the motion's nearest point, its largest scaled component.

        Whole turns do not count. By this distance, a program checks that a flight meets an orbit, and a fallback is
        chosen.

        Args:
            state: state (N,), whose cart is ignored.
        """
        return float(self.nearest(state)[1])

    def nearest(self, states: ArrayLike) -> tuple[Array, Array, Array]:
        """Return the phases of the motion that are nearest to states, at which a clock can continue.

        The distance is the largest component of the pendulum's state, with angles scaled by π and rates by 10 rad/s.

        Args:
            states: states (…, N).

        Returns:
            Times (…), s, scaled distances (…) and turns (…, N), rad.
        """
        all_states = np.asarray(states, dtype=float)
        size = all_states.shape[-1] - 2
        n, pendulum, scale = (
            size // 2,
            all_states.reshape(-1, all_states.shape[-1])[:, :size],
            pendulum_scale(size // 2),
        )
        differences = pendulum[:, None, :] - self.states[None, :-1:COARSE, :size]
        differences[..., :n] -= whole_turns(differences[..., :n])
        entry = np.argmin(np.square(differences / scale).sum(-1), axis=1)
        rate = self.rates(entry * COARSE)
        # A table's entry is corrected by the time by which the state is late there.
        lateness = (differences[np.arange(len(pendulum)), entry] * rate / scale**2).sum(1) / np.square(
            rate / scale
        ).sum(1)
        lateness = np.clip(lateness, -COARSE * self.step, COARSE * self.step)
        times = np.mod(entry * COARSE * self.step + lateness, self.period)
        deviations = pendulum - self.state(times, MANY)[:, :size]
        turns = np.zeros((len(pendulum), size + 2))
        turns[:, :n] = whole_turns(deviations[:, :n])
        distance = np.abs((deviations - turns[:, :size]) / scale).max(1)
        return (
            times.reshape(all_states.shape[:-1]),
            distance.reshape(all_states.shape[:-1]),
            turns.reshape(all_states.shape),
        )

    def rates(self, index: NDArray[np.intp]) -> Array:
        """Return the time derivatives of the pendulum's states at entries of the table, by central differences.

        Args:
            index: entries (K,) of the table.

        Returns:
            Derivatives (K, 2n), rad/s and rad/s².
        """
        count, n = len(self.states) - 1, self.states.shape[1] - 2
        return (self.states[(index + 1) % count, :n] - self.states[(index - 1) % count, :n]) / (2 * self.step)


def phase_table(orbit: "SustainedOrbit", *, entries: int = ENTRIES) -> PhaseTable:
    """Return one period of a sustained orbit as a table, from which controllers read phases, states and inputs.

    Args:
        orbit: the sustained orbit.
        entries: number of entries of the table.
    """
    times = np.arange(entries + 1) / entries * orbit.period
    states = orbit.state(times)
    states[-1] = states[0]
    return PhaseTable(orbit.period, states, orbit.input(times))


_MOST_STEPS = 200_000
_SETTLED = 1e-9


def periodic_gains(matrices: Array, responses: Array, *, weights: Array, effort: float) -> Array:
    """Return the gains (m, N) that hold an orbit, from a Riccati equation with the period of m parts.

    Args:
        matrices: A (m, N, N) of each part of the period.
        responses: B (m, N).
        weights: diagonal (N,) of Q.
        effort: weight r of the squared input.

    Raises:
        GoalMissed: the recursion does not converge, since the input cannot influence a drifting or growing motion.
    """
    parts = len(matrices)
    cost = np.diag(weights)
    previous = np.full_like(responses, np.inf)
    for _ in range(max(_MOST_STEPS // parts, 3)):
        gains, _, costs = riccati_gains(matrices, responses, weights=weights, effort=effort, terminal=cost)
        cost = costs[0]
        if not np.isfinite(gains).all():
            break
        if np.abs(gains - previous).max() <= _SETTLED * np.abs(gains).max():
            largest = float(np.abs(closed_multipliers(matrices, responses, gains))[0])
            if largest < 1:
                return gains
            raise GoalMissed(
                f"no periodic gains: the input cannot influence a motion that grows by {largest:.4g} per period; "
                "give the cart's position a weight, or use more sections per period"
            )
        previous = gains
    raise GoalMissed("no periodic gains: the Riccati recursion did not converge; increase the weight of the effort")


def closed_multipliers(matrices: Array, responses: Array, gains: Array) -> NDArray[np.complex128]:
    """Return the multipliers (N,) of a period, largest first; the loop is stable if all moduli are below 1.

    In each part of the period, the state's deviation ξ from the orbit becomes A ξ + B p with the input p = -K ξ.

    Args:
        matrices: A (m, N, N) of each part of the period.
        responses: B (m, N).
        gains: K (m, N).
    """
    product = np.eye(matrices.shape[-1])
    for matrix, response, gain in zip(matrices, responses, gains, strict=True):
        product = (matrix - np.outer(response, gain)) @ product
    values = np.linalg.eigvals(product).astype(complex)
    return values[np.argsort(-np.abs(values), kind="stable")]


@dataclass(frozen=True, eq=False)
class OrbitController(Brief):
    """Stabilises a sustained orbit with gains at every tick.

    It is a TVLQR without end.
    """

    kind: str
    table: PhaseTable
    """One period, with an entry at each of its ticks."""
    gains: Array
    """Gains (M, N)."""
    normals: Array
    """Normals (M, N), by which a deviation from the orbit gives its lateness, s, see `PhaseSection`."""
    feedforward: Array
    """Accelerations of the cart (M,), m/s²."""
    period: float
    """Period of the loop, s."""
    ticks: int
    """Number of periods."""
    by_phase: bool
    """True to correct the clock to the nearest phase at every tick."""

    @property
    def first_state(self) -> Array:
        """Return the initial state (N,): the orbit at phase 0."""
        return self.table.states[0]

    def begin(self) -> "OrbitSession":
        """Return a new session, the state of this law during one run."""
        return OrbitSession(self, 0, 0.0, np.zeros(len(self.first_state)))

    def begin_many(self, count: int) -> "OrbitSession":
        """Return a session for many runs in lockstep, each with its own clock.

        Args:
            count: number of runs.
        """
        return OrbitSession(self, 0, np.zeros(count), np.zeros(len(self.first_state)), MANY)

    def join(self, tick: int, state: Array) -> "OrbitSession":
        """Return a session from a tick at the phase nearest to a state, for a handover from another law.

        It keeps the state's turns.

        Args:
            tick: first tick.
            state: state (N,) at that tick.
        """
        time, _, turns = self.table.nearest(state)
        return OrbitSession(self, tick, float(time), turns)

    def distance(self, state: Array) -> float:
        """Return the distance of a state from the nearest point of the orbit, see `PhaseTable.distance`.

        Args:
            state: state (N,), whose cart is ignored.
        """
        return self.table.distance(state)


class OrbitSession(ClockedSession):
    """An orbit's clock, or clocks (S,).

    `_time` is the time on the orbit's clock, s, or times (S,), at the loop's tick `_tick`, the last one in which the
    law was called; both change at each call. `_lift` (N,) are the whole turns between run and table, rad, which only
    `resynchronise` changes.
    """

    def __init__(self, law: OrbitController, tick: int, time: Any, lift: Array, lanes: Lanes = ONE) -> None:
        """Begin a session at a tick of the loop and a time on the orbit's clock.

        Args:
            law: the controller.
            tick: tick of the loop.
            time: time on the orbit's clock, s, or times (S,).
            lift: whole turns (N,) between run and table, rad.
            lanes: see `Lanes`.
        """
        self._law, self.lanes = law, lanes
        self._tick, self._time, self._lift = tick, time, lift
        self.orbit_period = law.table.period
        """s"""

    @property
    def time(self) -> float:
        """Return the time on the orbit's clock, s."""
        return self._time % self.orbit_period

    def steer(self, tick: int, states: Array) -> tuple[Any, Any, Array]:
        """Return feedforward and feedback, m/s², and the reference, the orbit at the session's clock.

        Args:
            tick: the tick in which the command acts.
            states: state (N,) of one run, or states (S, N).
        """
        law, lanes, without_turns = self._law, self.lanes, states - self._lift
        table, count = law.table, len(law.gains)
        time = self._time + (tick - self._tick) * law.period
        self._tick = tick
        if law.by_phase:
            lateness = lanes.dot(
                without_turns - table.state(time, lanes), law.normals[lanes.nearest(time / table.step) % count]
            )
            # The correction is at most half a tick, so the clock moves smoothly for any estimate.
            time = time + lanes.clip(lateness, -law.period / 2, law.period / 2)
        self._time = time
        k = lanes.nearest(time / table.step) % count
        reference = table.state(time, lanes)
        return law.feedforward[k], lanes.dot(law.gains[k], reference - without_turns), reference + self._lift

    def resynchronise(self, tick: int, state: Array) -> str:
        """Move the orbit's clock to the phase nearest to a state, and return a sentence for the log.

        The loop calls it if the arms have been far from the reference for some time.

        Args:
            tick: present tick.
            state: state (N,) at that tick.
        """
        law, expected = self._law, self._time + (tick - self._tick) * self._law.period
        time, _, self._lift = law.table.nearest(state)
        self._tick, self._time = tick, float(time)
        return f"clock of the orbit moved by {law.table.shift(self._time, expected):+.4f} s"


def orbit_controller(
    orbit: "SustainedOrbit", model: SampledModel, settings: TvlqrSettings, *, seconds: float
) -> OrbitController:
    """Return the controller that holds an orbit at every tick.

    The period is cut into equal ticks next to the model's own in length.

    Args:
        orbit: the sustained orbit.
        model: model of arms and drive from tick to tick.
        settings: weights, and the schedule "time" or "phase".
        seconds: duration of the hold, s.

    Raises:
        GoalMissed: it cannot be stabilised.
    """
    weights, effort = settings.weights(model.arms, model.period)
    count = max(round(orbit.period / model.period), 4)
    table = phase_table(orbit, entries=count)
    feedforward = np.asarray(orbit.input((np.arange(count) + 0.5) * table.step))
    tick_model = SampledModel(model.equations, model.parameters, period=table.step)
    state_jacobians, input_jacobians = tick_model.linearised(table.states[:-1], feedforward)
    gains = periodic_gains(state_jacobians, input_jacobians, weights=weights, effort=effort)
    rates = table.rates(np.arange(count))
    scaled_rates = rates / pendulum_scale(model.arms) ** 2
    normals = np.zeros_like(gains)
    normals[:, : 2 * model.arms] = scaled_rates / (scaled_rates * rates).sum(1)[:, None]
    return OrbitController(
        settings.kind, table, gains, normals, feedforward, model.period, max(round(seconds / model.period), 1),
        settings.schedule == "phase",
    )  # fmt: skip
