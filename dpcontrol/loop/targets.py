"""Goals of flights: places where a law takes over, with its cost-to-go."""

import math
from dataclasses import dataclass, replace

import numpy as np

from dpcontrol.control.flight import Target
from dpcontrol.control.interface import GainSchedule, SampledModel, whole_turns
from dpcontrol.control.lqr import HoldController, QuadraticWeights
from dpcontrol.control.tracking import motion_at_ticks, regulator_along, riccati_gains, terminal_cost
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.shown import Brief
from dpcontrol.references.problem import Limits
from dpcontrol.references.reference import Reference
from dpcontrol.references.sustained import SustainedOrbit

SETTLES, _LEFT = 0.5, 1 / 3
"""Part of a stay that follows a flight, s, and the least share of the acceleration that the feedback has there."""
_NEAR = 0.8
"""Maximum angle of an arm from a candidate place, rad."""
PHASES, _PERIODS = 120, 12
"""Phases of an orbit that are places, and periods after which its cost-to-go repeats."""


@dataclass(frozen=True, eq=False)
class Reach(Brief):
    """Places of a reference, `every` ticks apart, with the cost-to-go to each.

    The recovery compares a state with them, to find an earlier place from which the law can resume the itinerary.

    Attributes:
        every: ticks between two places.
        states: reference states (M, N).
        costs: cost-to-go matrices P (M, N, N) of the law that follows the reference.
    """

    every: int
    states: Array
    costs: Array

    def costs_at(self, states: Array, place: int) -> Array:
        """Return the costs-to-go (S,) from states to a place, modulo whole turns of the arms.

        Large costs mark states from which the law can hardly return.

        Args:
            states: estimated states (S, N) of S runs.
            place: index of the place in `states` and `costs` of this object.
        """
        differences = states - self.states[place]
        n = states.shape[1] // 2 - 1
        differences[:, :n] -= whole_turns(differences[:, :n])
        return np.einsum("si,ij,sj->s", differences, self.costs[place], differences)

    def nearest(self, state: Array, last: int, *, worth: float) -> tuple[int, float]:
        """Return the index of the place with the least cost-to-go, and that cost.

        The cost is infinite if no place is near. It doubles for a place that is `worth` places earlier, since flying a
        section again costs time.

        Args:
            state: estimated state (N,) of the run.
            last: index of the last place that is considered.
            worth: number of places after which the cost doubles.
        """
        n = len(state) // 2 - 1
        differences = state - self.states[: last + 1]
        differences[:, :n] -= whole_turns(differences[:, :n])
        # Quadratic forms for all places would take longer than a tick.
        near = np.flatnonzero(np.abs(differences[:, :n]).max(axis=1) < _NEAR)
        if not near.size:
            return last, math.inf
        costs = np.einsum("ki,kij,kj->k", differences[near], self.costs[near], differences[near]) * (
            1 + (last - near) / worth
        )
        least = int(np.argmin(costs))
        return int(near[least]), float(costs[least])


@dataclass(frozen=True, eq=False)
class FlightGoal(Brief):
    """A stop, or rest, that flights lead to, with the times at which the itinerary continues from there.

    Attributes:
        target: places and their costs-to-go, scaled to 1 where the law saturates.
        terminal: costs P (M, N, N) of the places in the units of the law that takes over there.
        at: time (M,) at each place, s, on the clock of this law's gains.
    """

    target: Target
    terminal: Array
    at: Array

    def until(self, latest: float) -> "FlightGoal":
        """Return the goal with the places up to a time, at least the first.

        After a fall, a place behind the fall would leave a gap in the scored motion.

        Args:
            latest: time of the plan's reference, s.
        """
        count = max(1, int(np.searchsorted(self.at, latest, side="right")))
        return replace(self, target=Target(self.target.states[:count], self.target.costs[:count]))


def reached(
    reference: Reference, model: SampledModel, settings: QuadraticWeights, *, every: int, limits: Limits
) -> tuple[Reach, Target]:
    """Return the places of a reference by their costs-to-go, and as targets of flights.

    Recoveries compare costs along the reference (`Reach`). Flights need costs that are 1 where the law saturates
    (`Target`).

    Args:
        reference: reference to follow.
        model: model of arms and cart, with a period of `every` ticks.
        settings: weights of the law.
        every: ticks between two places.
        limits: limits of the cart.
    """
    states, commands, _ = motion_at_ticks(reference, model)
    gains, _, costs = regulator_along(model, states[:-1], commands, settings)
    levels = _levels(gains, costs[:-1], commands, limits)
    return Reach(every, states, costs), Target(states, costs / np.append(levels, levels[-1])[:, None, None])


def _levels(gains: Array, costs: Array, commands: Array, limits: Limits) -> Array:
    """Return the costs-to-go (K,) up to which a law's feedback stays within the cart's acceleration.

    Flights end within this level, because beyond it the law saturates and may lose the arms. For a gain k and a cost P,
    the largest feedback on xᵀPx = V is √(V kᵀP⁻¹k).

    Args:
        gains: gains (K, N) on the state.
        costs: cost-to-go matrices P (K, N, N).
        commands: feedforward (K,), m/s², which leaves the rest of the acceleration to the feedback.
        limits: limits of the cart.
    """
    available = np.maximum(limits.acceleration - np.abs(commands), _LEFT * limits.acceleration)
    return available**2 / np.einsum("ki,kij,kj->k", gains, np.linalg.inv(costs), gains)


def hold_target(hold: HoldController, limits: Limits) -> Target:
    """Return an equilibrium as a target of flights with one place, whose cost is 1 where its law saturates.

    Args:
        hold: law that holds it.
        limits: limits of the cart.
    """
    assert hold.cost is not None
    level = _levels(hold.gain[None], hold.cost[None], np.zeros(1), limits)
    return Target(hold.state[None], hold.cost[None] / level[:, None, None])


def orbit_target(orbit: SustainedOrbit, model: SampledModel, settings: QuadraticWeights, limits: Limits) -> Target:
    """Return all phases of an orbit as a target, so that a flight can join it at any of them.

    The Riccati recursion is repeated over `_PERIODS` periods, until its cost-to-go is periodic.

    Args:
        orbit: periodic orbit of pendulum and cart.
        model: model of arms and cart, with a period that divides the orbit's.
        settings: weights of the law that keeps it.
        limits: limits of the cart.
    """
    times = model.period * np.arange(round(orbit.period / model.period))
    states, commands = orbit.state(times), orbit.reference.input(times + model.period / 2)[:, 0]
    state_jacobians, input_jacobians = model.linearised(states, commands)
    diagonal, effort = settings.weights(model.arms, model.period)
    terminal = terminal_cost(state_jacobians[0], input_jacobians[0], weights=np.diag(diagonal), effort=effort)
    for _ in range(_PERIODS):
        *_, costs = riccati_gains(state_jacobians, input_jacobians, weights=diagonal, effort=effort, terminal=terminal)
        terminal = costs[0]
    gains, _, costs = riccati_gains(
        state_jacobians, input_jacobians, weights=diagonal, effort=effort, terminal=terminal
    )
    return Target(states, costs[:-1] / _levels(gains, costs[:-1], commands, limits)[:, None, None])


def goal_of(reach: Reach, targets: Target, *, stay: tuple[float, float], period: float, rate: float) -> FlightGoal:
    """Return a stop of the plan as a goal of flights.

    Its places are early in the stay, so that the feedback settles before the stay ends, and within one period of its
    orbit.

    Args:
        reach: places of the reference.
        targets: the same places as targets of flights.
        stay: begin and end of the stay, s.
        period: period of the stop's orbit, s.
        rate: rate of the loop, Hz.
    """
    begin, end = stay
    first, last = math.ceil(begin * rate / reach.every), math.floor(max(begin, end - SETTLES) * rate / reach.every)
    last = min(max(first, last), first + math.ceil(period * rate / reach.every), len(reach.states) - 1)
    places = np.arange(min(first, last), last + 1)
    target = Target(targets.states[places], targets.costs[places])
    return FlightGoal(target, reach.costs[places], places * reach.every / rate)


def rest_goal(hold: HoldController, limits: Limits) -> FlightGoal:
    """Return the goal of flights to arms that hang at rest.

    From there, a flight to a stop is tried again after two that failed.

    Args:
        hold: law that holds them there.
        limits: limits of the cart.
    """
    assert hold.cost is not None
    return FlightGoal(hold_target(hold, limits), hold.cost[None], np.zeros(1))


def padded(gains: GainSchedule, like: GainSchedule) -> GainSchedule:
    """Return a gain schedule with the columns of another one, because all laws of a run share one compiled tick.

    Gains on extras that the schedule lacks are zero.

    Args:
        gains: gains on the state alone, which may lack columns for extras.
        like: gains of the itinerary, whose number of columns the result gets.
    """
    n = gains.references.shape[1] // 2 - 1
    extra_columns = np.zeros((len(gains.rows), like.rows.shape[1] - gains.rows.shape[1]))
    rows = np.hstack([gains.rows[:, :-n], extra_columns, gains.rows[:, -n:]])
    return replace(like, rows=rows, references=gains.references, queued=gains.queued, mode=gains.mode)
