"""Flights: motions of the cart that carry the arms from any state to a target in a short time.

A target is one place or several, each with the cost-to-go of the law that takes over there. The planner minimises

    J = T + r/2 ∫ u² dt + soft limits of the cart + w/2 V(x(T)),      V(x) = min (x - x*)ᵀ P (x - x*)   over the places

by iLQR, a Gauss-Newton form of differential dynamic programming, with the input as a box. P is scaled so that V = 1
where the law that takes over saturates. The length of a step is a further state that stays constant, so the final time
T is free. Angles are compared modulo whole turns.

The search starts from motions of a braking cart of several durations. These guesses and the lengths of a line search
are computed side by side in the lanes of a compiled step.

Sources: Tassa, Erez & Todorov, Synthesis and stabilization of complex behaviors through online trajectory optimization
(2012). Tassa, Mansard & Todorov, Control-limited differential dynamic programming (2014).
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.interface import whole_turns
from dpcontrol.dynamics.chain import ArmChainParameters, Level, arm_chain_equations
from dpcontrol.dynamics.compiled import Compiled, fixed_step
from dpcontrol.dynamics.equations import Equations, runge_kutta_4
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import FlightCause
from dpcontrol.foundation.shown import Brief, Timed, checked_times
from dpcontrol.references.problem import CART_VELOCITY_SCALE, RATE_SCALE, Limits, Scale
from dpcontrol.words.searches import Concluded

STEPS = 80
"""Steps of a flight."""
DURATIONS = np.linspace(0.5, 1.6, 8)
"""Durations of the guesses, s."""
_BRAKING = np.array([40.0, 14.0])
"""Gains of the braking law on position and velocity of the cart, 1/s² and 1/s."""
REACHED = 0.3
"""Cost-to-go V at the end of a flight that converged."""
JOINED = 4.0
"""Cost-to-go at the end of a flight above which another one is planned."""
_EFFORT = 3e-3
"""Weight r of the squared acceleration, s⁴/m²; less leaves the feedback nothing."""
_RESERVE_ACCELERATION, _RESERVE_SPEED, _RESERVE_TRACK = 2 / 3, 0.8, 0.07
"""Shares of the greatest acceleration and speed in a flight, and the part of the track left free at its ends, m."""
_TRACK_SHARE = 0.175
"""Greatest share of half the track that is left free."""
_NEAR_STOP = 0.03
"""Part of the track at its ends into which a flight must not lead, m."""
_SOFT_POSITION, _SOFT_VELOCITY = 0.01, 0.05
"""Scales of the excess over a soft limit: m and m/s."""
_RETURNING = 1.0, 2.0
"""Gains on position and velocity of the cart in the first motions of `timed`, 1/s² and 1/s."""
_LENGTHS = np.array([1.0, 0.2])
"""Lengths of the line search."""
_LONGER = 0.25
"""Largest relative change of the duration in an iteration."""
_FAILED = 1e6
"""Addition to J of a flight that fails."""
_SHORTEST, _LONGEST = 0.1, 5.0
"""Bounds of the duration, s."""


def braking_gains(arms: ArmChainParameters) -> Array:
    """Return the gains of the braking law on position and velocity of the cart, 1/s² and 1/s, by which a cart rests.

    Args:
        arms: the arms, by whose natural time the cart brakes.
    """
    time = Scale.of(arms).time
    return _BRAKING * (time**2, time)


class Stage(NamedTuple):
    """Iterations of the search with one weight `end` of the end's cost V and one weight `soft` of the soft limits.

    With `diagonal`, the end's cost is that of the scaled differences of angles, rates and cart.
    """

    iterations: int
    end: float
    soft: float
    diagonal: bool = False


STAGES = (Stage(25, 20.0, 1.0, diagonal=True), Stage(30, 4.0, 3.0), Stage(15, 4.0, 30.0))
"""The search for a flight."""
GENTLE_STAGES = (Stage(20, 1.0, 0.1, diagonal=True), Stage(20, 0.3, 0.3), Stage(10, 4.0, 10.0))
"""The search for a flight of given duration. Larger weights of the end leave the effort far from its minimum."""


@dataclass(frozen=True, eq=False)
class Target(Brief):
    """Places (M, N) at which a law takes over, and its cost-to-go.

    Attributes:
        states: states (M, N).
        costs: matrices P (M, N, N), scaled so that V = 1 where the law saturates.
    """

    states: Array
    costs: Array

    def nearest(self, states: Array, costs: Array | None = None) -> tuple[Array, NDArray[np.intp], Array]:
        """Return the cost-to-go from states to their nearest places, the places' indices, and the differences.

        Args:
            states: states (S, N).
            costs: other matrices (M, N, N), default those of the target.

        Returns:
            Costs (S,), indices (S,) and differences (S, N).
        """
        n = states.shape[1] // 2 - 1
        differences = states[:, None, :] - self.states
        differences[:, :, :n] -= whole_turns(differences[:, :, :n])
        costs = self.costs if costs is None else costs
        all_costs = np.einsum("smi,mij,smj->sm", differences, costs, differences, optimize=len(self.states) > 1)
        place = np.argmin(all_costs, axis=1)
        rows = np.arange(len(states))
        return all_costs[rows, place], place, differences[rows, place]


@dataclass(frozen=True, eq=False)
class Flights(Brief):
    """Flights from S states, each in `STEPS` steps.

    Attributes:
        durations: durations (S,), s.
        nodes: states (S, STEPS + 1, N) at the ends of the steps.
        inputs: constant accelerations of the cart in each step (S, STEPS), m/s².
        costs: cost-to-go V (S,) at the end.
        places: indices (S,) of the target's places.
        objectives: J (S,).
        inside: True (S,) for flights that keep the cart's limits.
    """

    durations: Array
    nodes: Array
    inputs: Array
    costs: Array
    places: NDArray[np.intp]
    objectives: Array
    inside: NDArray[np.bool_]

    def picked(self, rows: NDArray[Any]) -> "Flights":
        """Return some of the flights.

        Args:
            rows: their indices, or a mask (S,).
        """
        return replace(self, **{attribute.name: getattr(self, attribute.name)[rows] for attribute in fields(self)})

    @property
    def reached(self) -> NDArray[np.bool_]:
        """True (S,) for flights that end where the law of the target takes over, within the limits."""
        return self.inside & (self.costs < REACHED)


@lru_cache(maxsize=4)
def _programs(equations: Equations) -> tuple[Compiled, Compiled]:
    """Return the compiled steps forward and backward (`_FlightStep`), which all planners of these equations share."""
    step = _step(equations)
    return Compiled(step.forward()), Compiled(step.backward())


class FlightPlanner:
    """Plans flights of one model within limits of the cart.

    Its numbers are those of the laboratory's arms; arms of any size are scaled to these (`Scale`), and get the same
    flights.

    `_limits`, `_terms` and `_parameters` are in the units of the laboratory's arms, and change only in the copies that
    `with_room` and `with_parameters` return. `_limits` are the cart's. `_terms` (4,) are the largest input, the soft
    limits of position and velocity, and the weight of the cart's distance from the middle. `_parameters` (p,) are the
    base parameters. `_factors` (N,) and `_sizes` (p,) convert states and base parameters to these units.

    Args:
        arms: parameters of the arms.
        limits: limits of the cart, of which the flights leave a reserve.
    """

    def __init__(self, arms: ArmChainParameters, limits: Limits) -> None:
        """Prepare a planner: its limits and parameters in the units of the laboratory's arms, and its compiled steps.

        Args:
            arms: parameters of the arms.
            limits: limits of the cart, of which the flights leave a reserve.
        """
        scale = Scale.of(arms)
        equations = arm_chain_equations(arms.count, Level.CART, friction=arms.friction)
        self._n, self._scale, self._factors = equations.dimension, scale, scale.state(arms.count)
        self._limits = limits = scale.limits(limits)
        acceleration, speed = _RESERVE_ACCELERATION * limits.acceleration, _RESERVE_SPEED * limits.velocity
        track = limits.position
        self._terms = np.array([acceleration, track - min(_RESERVE_TRACK, _TRACK_SHARE * track), speed, 0.0])
        self._forward, self._backward = _programs(equations)
        # Ones in place of friction: parameters that are zero have a scale as well.
        with_friction = replace(arms, **dict.fromkeys(("viscous", *arms.friction), (1.0,) * arms.count))
        sizes = with_friction.scaled(scale.length, scale.time).base(), with_friction.base()
        self._sizes = np.divide(*sizes, out=np.ones_like(sizes[0]), where=sizes[1] != 0)
        self._parameters = self._sizes * arms.base()

    def plan(self, states: Array, target: Target) -> Flights:
        """Return the best flight from each state to a target, of several first durations.

        Args:
            states: states (S, N).
            target: places where a law takes over.
        """
        n, count, guesses = self._n, len(states), len(DURATIONS)
        arms = n // 2 - 1
        first = self._factors * states
        turns = whole_turns(first[:, :arms])
        first[:, :arms] -= turns
        start = np.repeat(first, guesses, axis=0).T
        lanes = start.shape[1]
        # The guesses brake the cart, and differ in their durations.
        begin = np.vstack([start, np.tile(DURATIONS / STEPS, count)])
        gains = np.zeros((STEPS, n + 1, lanes))
        gains[:, n - 2], gains[:, n - 1] = -_BRAKING[0], -_BRAKING[1]
        nodes, inputs, _ = self._flown(begin, np.zeros((STEPS, lanes)), np.zeros_like(gains), gains, STAGES[0].soft)
        flights = self._searched(nodes, inputs, self._scaled(target), STAGES)
        # Those that fail are compared by their cost as well.
        penalised = (flights.objectives + _FAILED * ~flights.reached).reshape(count, guesses)
        chosen = np.argmin(penalised, axis=1) + guesses * np.arange(count)
        flights = flights.picked(chosen)
        flights.nodes[:, :, :arms] += turns[:, None]
        return self._unscaled(flights)

    def with_parameters(self, parameters: Array) -> "FlightPlanner":
        """Return a planner with the same limits for similar arms, whose parameters a filter has estimated.

        Args:
            parameters: base parameters (p,) of the same equations.
        """
        similar = copy(self)
        similar._parameters = self._sizes * parameters
        return similar

    def with_room(self, room: Limits, *, centring: float) -> "FlightPlanner":
        """Return a planner whose flights keep other limits, and may prefer the middle of the track.

        Args:
            room: limits of the flights.
            centring: weight of the cart's squared distance from the middle, 1/s⁴ for the laboratory's arms.
        """
        changed, limits = copy(self), self._scale.limits(room)
        changed._terms = np.array([limits.acceleration, limits.position, limits.velocity, centring])
        return changed

    def _scaled(self, target: Target) -> Target:
        """Return a target in the units of the laboratory's arms, in which the search runs."""
        return Target(self._factors * target.states, target.costs / np.outer(self._factors, self._factors))

    def _unscaled(self, flights: Flights) -> Flights:
        """Return flights in the arms' own units, from the units of the laboratory's arms."""
        return replace(
            flights,
            durations=flights.durations / self._scale.time,
            nodes=flights.nodes / self._factors,
            inputs=flights.inputs / self._scale.acceleration,
        )

    def timed(self, start: Array, target: Target, durations: Array, inputs: Array, *, fixed: bool) -> Flights:
        """Return the flights from a state to which several durations and first inputs lead, as guesses of transfers.

        Args:
            start: state (N,).
            target: places where a law takes over.
            durations: first durations (L,), s.
            inputs: first inputs (STEPS, L), m/s², beside a feedback that returns the cart to the middle.
            fixed: True to keep the durations.
        """
        n, lanes = self._n, len(durations)
        begin = np.vstack([np.tile((self._factors * start)[:, None], lanes), self._scale.time * durations / STEPS])
        gains = np.zeros((STEPS, n + 1, lanes))
        gains[:, n - 2], gains[:, n - 1] = -_RETURNING[0], -_RETURNING[1]
        stages = GENTLE_STAGES if fixed else STAGES
        pushes = self._scale.acceleration * inputs
        nodes, pushes, _ = self._flown(begin, pushes, np.zeros_like(gains), gains, stages[0].soft)
        return self._unscaled(self._searched(nodes, pushes, self._scaled(target), stages, fixed=fixed))

    def lands(self, state: Array, nodes: Array, inputs: Array, gains: Array, step: float, target: Target) -> bool:
        """Return True if feedback leads from a state near a flight to its target, with the cart on its track.

        A planned flight is then kept, and no other one is searched. Inputs are limited to the drive's acceleration.

        Args:
            state: state (N,).
            nodes: states (K, N) of the flight at the begin of its last K steps.
            inputs: its inputs (K,) there, m/s².
            gains: gains (K, N) of the feedback that follows it.
            step: length of its steps, s.
            target: places where a law takes over.
        """
        n, factors, push = self._n, self._factors, self._scale.acceleration
        step = self._scale.time * step
        nominal, feedback = np.full((len(inputs), n + 1, 1), step), np.zeros((len(inputs), n + 1, 1))
        nominal[:, :n, 0], feedback[:, :n, 0] = factors * nodes, -push * gains / factors
        begin = np.append(factors * state, step)[:, None]
        nodes_flown, _, _ = self._flown(
            begin, push * inputs[:, None], nominal, feedback, 0.0, most=self._limits.acceleration
        )
        ends = self._scaled(target).nearest(nodes_flown[-1, :n].T)[0]
        return bool(ends[0] < JOINED and np.abs(nodes_flown[:, n - 2]).max() < self._limits.position - _NEAR_STOP)

    def states(self, nodes: Array, inputs: Array, duration: float, times: Array) -> tuple[Array, Array]:
        """Return states (T, N) and inputs (T,), m/s², of a flight at any times, by integration from its nodes.

        Args:
            nodes: its states (K+1, N) at the ends of equal steps.
            inputs: its inputs (K,) in the steps, m/s².
            duration: its duration, s.
            times: times (T,), from 0 to the duration, s.
        """
        count, scale = len(inputs), self._scale
        step = np.minimum((times / duration * count).astype(int), count - 1)
        # Each time is one lane, with a step that ends at this time.
        lengths = scale.time * (times - step * (duration / count))
        begin = np.vstack([(self._factors * nodes[step]).T, lengths])
        no_feedback, pushes = np.zeros((1, self._n + 1, len(times))), scale.acceleration * inputs[step]
        nodes_after, _, _ = self._flown(begin, pushes[None], no_feedback, no_feedback, 0.0, most=np.inf)
        return nodes_after[1, : self._n].T / self._factors, inputs[step]

    def _flown(
        self, begin: Array, away: Array, nominal: Array, gains: Array, soft: float, *, most: float | None = None
    ) -> tuple[Array, Array, Array]:
        """Return nodes (K+1, N+1, L), inputs (K, L) and costs (L,) of L motions from `begin` (N+1, L).

        The search compares them. All numbers are in the units of the laboratory's arms, and the last entry of a node is
        the length of a step, s. The costs lack that of the end.

        `away` (K, L): inputs to which the feedback is added, m/s². `nominal`, `gains` (K, N+1, L): the states about
        which the feedback acts, and its gains. `soft`: weight of the soft limits. `most`: largest input, m/s², by
        default that of a flight.
        """
        n, lanes, step, count = self._n, begin.shape[1], self._forward, len(away)
        rows = np.empty((count, step.size_in, lanes))
        rows[:, step.slices["away"].start] = away
        rows[:, step.slices["nominal"]], rows[:, step.slices["gains"]] = nominal, gains
        rows[:, step.slices["soft"]], rows[:, step.slices["terms"]] = soft, self._terms[:, None]
        rows[:, step.slices["terms"].start] = most or self._terms[0]
        rows[:, step.slices["parameters"]] = self._parameters[:, None]
        results, machine = np.empty((count, step.size_out, lanes)), step.machine
        node = begin
        for k in range(count):
            rows[k, : n + 1] = node
            machine(rows[k], results[k])
            node = results[k, : n + 1]
        nodes = np.concatenate([begin[None], results[:, : n + 1]])
        return nodes, results[:, n + 1], results[:, n + 2].sum(axis=0)

    def _searched(
        self, nodes: Array, inputs: Array, target: Target, stages: Sequence[Stage], *, fixed: bool = False
    ) -> Flights:
        """Return the flights to which the stages of the search lead from L nominal motions.

        `nodes` (STEPS+1, N+1, L), `inputs` (STEPS, L) m/s²: the nominal motions, see `_flown`. `target`: in the same
        units. `fixed`: True to keep the durations. In an iteration, each lane tries the lengths of a line search, and
        keeps its motion unless a trial is better.
        """
        lanes, n, count = nodes.shape[2], self._n, len(inputs)
        regularity = np.full(lanes, 1e-6)
        total = np.full(lanes, np.inf)
        for stage in stages:
            weights = self._end_weights(stage, target)
            flown = self._flown(nodes[0], inputs, nodes[:-1], np.zeros_like(nodes[:-1]), stage.soft)
            total = self._total(flown, target, weights)
            for _ in range(stage.iterations):
                forward, gains, slope, curvature = self._improved(nodes, inputs, target, weights, stage, regularity)
                limit = (0.0 if fixed else _LONGER) * nodes[0, n]
                step_change = np.clip(-slope / np.maximum(curvature, 1e-9), -limit, limit)
                trials = len(_LENGTHS)
                trial_begin = np.tile(nodes[0], trials)
                trial_begin[n] += np.outer(_LENGTHS, step_change).ravel()
                trial_begin[n] = np.clip(trial_begin[n], _SHORTEST / STEPS, _LONGEST / STEPS)
                trial_inputs = (inputs[:, None] + _LENGTHS[:, None] * forward[:, None]).reshape(count, -1)
                candidates = self._flown(
                    trial_begin, trial_inputs, np.tile(nodes[:-1], trials), np.tile(gains, trials), stage.soft
                )
                trial_totals = self._total(candidates, target, weights).reshape(trials, lanes)
                best_trial = np.argmin(trial_totals, axis=0)
                better = trial_totals[best_trial, np.arange(lanes)] < total
                best_lanes = best_trial * lanes + np.arange(lanes)
                nodes = np.where(better, candidates[0][:, :, best_lanes], nodes)
                inputs = np.where(better, candidates[1][:, best_lanes], inputs)
                total = np.where(better, trial_totals[best_trial, np.arange(lanes)], total)
                regularity = np.clip(np.where(better, regularity / 4, regularity * 10), 1e-9, 1e3)
        costs, places, _ = target.nearest(nodes[-1, :n].T)
        position, velocity = np.abs(nodes[1:, n - 2 : n]).max(axis=0)
        inside = np.isfinite(total) & (position <= self._limits.position) & (velocity <= self._limits.velocity)
        states = nodes[:, :n].transpose(2, 0, 1)
        return Flights(count * nodes[0, n], states, inputs.T.copy(), costs, places, total, inside)

    def _total(self, flown: tuple[Array, Array, Array], target: Target, weights: Array) -> Array:
        """Return J (L,) of motions, the results of `_flown`; infinite for those that diverge, which are not chosen.

        `weights` (M, N, N): matrices of the end's cost at the M places of the target.
        """
        nodes, _, costs = flown
        totals = costs + target.nearest(nodes[-1, : self._n].T, weights)[0] / 2
        # J is positive; other values are due to overflow.
        return np.where(np.isfinite(totals) & (totals > 0), totals, np.inf)

    def _end_weights(self, stage: Stage, target: Target) -> Array:
        """Return the matrices (M, N, N) of the end's cost in a stage, one for each place of the target."""
        if not stage.diagonal:
            return stage.end * target.costs
        arms = self._n // 2 - 1
        scale = np.array([1 / np.pi] * arms + [1 / RATE_SCALE] * arms + [1.0, 1 / CART_VELOCITY_SCALE])
        return np.tile(stage.end * np.diag(scale**2), (len(target.states), 1, 1))

    def _improved(
        self, nodes: Array, inputs: Array, target: Target, weights: Array, stage: Stage, regularity: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Return iLQR's improvement of L motions: changes of inputs, gains, and J's slope and curvature by the step.

        They are (STEPS, L) in m/s², (STEPS, N+1, L), (L,) and (L,). The backward recursion runs along `nodes` (STEPS+1,
        N+1, L) and `inputs` (STEPS, L).

        `weights` (M, N, N): of the end's cost. `regularity` (L,): added to the curvature by the input, larger after a
        failed iteration.
        """
        n, lanes, program = self._n, nodes.shape[2], self._backward
        size = n + 1
        rows = np.empty((program.size_in, lanes))
        rows[program.slices["soft"]], rows[program.slices["terms"]] = stage.soft, self._terms[:, None]
        rows[program.slices["regularity"]] = regularity
        rows[program.slices["parameters"]] = self._parameters[:, None]
        _, place, differences = target.nearest(nodes[-1, :n].T, weights)
        hessian = np.zeros((size, size, lanes))
        hessian[:n, :n] = weights[place].transpose(1, 2, 0)
        gradient = np.zeros((size, lanes))
        gradient[:n] = np.einsum("sij,sj->is", weights[place], differences)
        value = np.concatenate([gradient, hessian.reshape(size * size, lanes)])
        value_rows, node_rows, input_row = (
            program.slices["value"],
            program.slices["moving"],
            program.slices["input"].start,
        )
        results, machine = np.empty((len(inputs), program.size_out, lanes)), program.machine
        for k in range(len(inputs) - 1, -1, -1):
            rows[node_rows], rows[input_row], rows[value_rows] = nodes[k], inputs[k], value
            machine(rows, results[k])
            value = results[k, size + 1 :]
        # The step's length is the last state, so its slope and curvature are in the value at the first node.
        return results[:, 0], results[:, 1 : size + 1], value[n], value[size + n * size + n]


@dataclass(frozen=True, eq=False)
class Flight(Concluded, Timed):
    """A motion from a state to a target.

    Attributes:
        target: name of the target.
        duration: duration, s.
        cost: cost-to-go V at the end, 1 where the law that takes over saturates; a flight with less than 0.3 converged.
        inputs: constant accelerations of the cart in equal steps (K,), m/s².
        nodes: states (K+1, N) at the ends of the steps.
        cause: how the search ended.
        limits: limits of the cart, of which the flight leaves a reserve.
        planner: planner that found the flight.
        remedy: if the search failed, name and value of a changed limit of the cart with which a flight was found, or
            None.
    """

    target: str
    duration: float
    cost: float
    inputs: Array
    nodes: Array
    cause: FlightCause
    limits: Limits
    planner: FlightPlanner = field(repr=False)
    remedy: tuple[str, float] | None = None

    @property
    def converged(self) -> bool:
        """True if it ends where the law of the target takes over."""
        return self.cause is FlightCause.REACHED

    @property
    def time_range(self) -> tuple[float, float]:
        """First and last time, s."""
        return 0.0, self.duration

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the N entries of a state."""
        arms = range(1, self.nodes.shape[1] // 2)
        names = [f"{name}_{k}" for name in ("angle", "rate") for k in arms]
        return (*names, "cart_position", "cart_velocity")

    def states(self, times: Any = None) -> Array:
        """Return the states at given times.

        Args:
            times: times (…) from 0 to the duration, s; by default 200 over the whole flight.

        Returns:
            States (…, N): angles, rates, and the cart's position and velocity.

        Raises:
            InputError: the times are not finite numbers.
        """
        return self.sample() if times is None else self._at(checked_times(times))[0]

    def input(self, times: Any) -> Array:
        """Return the accelerations (…) of the cart at given times, m/s².

        Args:
            times: times (…) from 0 to the duration, s.

        Raises:
            InputError: the times are not finite numbers.
        """
        return self._at(checked_times(times))[1]

    def _at(self, times: Array) -> tuple[Array, Array]:
        """Return states (…, N) and inputs (…), m/s², at times (…), s; times outside the flight count as its ends."""
        clipped = np.clip(times.ravel(), 0.0, self.duration)
        states, inputs = self.planner.states(self.nodes, self.inputs, self.duration, clipped)
        return states.reshape(*times.shape, self.nodes.shape[1]), inputs.reshape(times.shape)

    def document(self) -> dict[str, Any]:
        """Return the flight as JSON values."""
        values = {name: getattr(self, name) for name in ("target", "duration", "cost", "inputs", "nodes", "converged")}
        return {**values, "cause": self.cause, "limits": self.limits.named()}


def _beyond(value: ca.SX, limit: ca.SX) -> ca.SX:
    """Return the signed excess of a value over a symmetric limit, zero within it, for the soft limits."""
    return ca.if_else(value > limit, value - limit, ca.if_else(value < -limit, value + limit, 0))


@dataclass(frozen=True)
class _FlightStep:
    """One step of a motion, symbolically.

    The state `moving` (N+1,) is that of the equations and the length of the step. `accurate` (N,) is the next state of
    the equations for motions, `following` a cheaper one for derivatives. `cost` is the step's part of J, and `excess`
    (2,) the scaled excess over the soft limits, which J weighs by `soft`. `terms` (4,) are the largest input, the soft
    limits of position and velocity, and the weight of the cart's distance from the middle. `parameters` (p,) are the
    base parameters.
    """

    moving: ca.SX
    input: ca.SX
    soft: ca.SX
    terms: ca.SX
    parameters: ca.SX
    accurate: ca.SX
    following: ca.SX
    cost: ca.SX
    excess: ca.SX

    def forward(self) -> ca.Function:
        """Return the step under feedback: (moving, input, cost) from an input, a nominal state and gains about it.

        The input is limited to the largest one. `moving` (N+1,) is the next state with the step's length, and `cost` is
        the step's part of J.
        """
        size, z = self.moving.shape[0], self.moving
        input_before_feedback, nominal, gains = ca.SX.sym("away"), ca.SX.sym("nominal", size), ca.SX.sym("gains", size)
        largest = self.terms[0]
        command = ca.fmax(-largest, ca.fmin(largest, input_before_feedback + ca.dot(gains, z - nominal)))
        following, cost = ca.substitute([self.accurate, self.cost], [self.input], [command])
        result = ca.cse(ca.densify(ca.vertcat(following, z[size - 1], command, cost)))
        names = ["moving", "away", "nominal", "gains", "soft", "terms", "parameters"]
        inputs = [z, input_before_feedback, nominal, gains, self.soft, self.terms, self.parameters]
        return ca.Function("flight_forward", inputs, [result], names, ["out"])

    def backward(self) -> ca.Function:
        """Return one step of iLQR's backward recursion, from the value at the step's end to that at its begin.

        Its outputs are the change of the input, the gains (N+1,), and gradient (N+1,) and Hessian ((N+1)²,) of the
        value, the cost J from the step's begin on.

        In the formulas, q_… are derivatives of the step's cost plus the value at its end, by the state z and by the
        input u. An input at its limit has zero gains.
        """
        z, u, largest = self.moving, self.input, self.terms[0]
        size = z.shape[0]
        h, n = z[size - 1], size - 1
        gradient, hessian = ca.SX.sym("gradient", size), ca.SX.sym("hessian", size, size)
        regularity = ca.SX.sym("regularity")
        by_state = ca.vertcat(ca.jacobian(self.following, z), ca.horzcat(ca.SX.zeros(1, n), ca.SX.ones(1, 1)))
        by_input = ca.vertcat(ca.jacobian(self.following, u), ca.SX.zeros(1, 1))
        slopes = ca.jacobian(self.excess, z)
        q_z = ca.gradient(self.cost, z) + by_state.T @ gradient
        q_u = ca.gradient(self.cost, u) + by_input.T @ gradient
        pushed = by_input.T @ hessian
        q_zz = h * self.soft * slopes.T @ slopes + by_state.T @ hessian @ by_state
        q_zz[n - 2, n - 2] += h * _EFFORT * self.terms[3]
        q_uz = pushed @ by_state + ca.horzcat(ca.SX.zeros(1, n), _EFFORT * u)
        # A negative curvature by the input would lead to a maximum.
        q_uu = h * _EFFORT + ca.fmax(pushed @ by_input, 0) + regularity
        free = -q_u / q_uu
        change = ca.fmax(-largest - u, ca.fmin(largest - u, free))
        gains = ca.if_else(change == free, -q_uz / q_uu, ca.SX.zeros(1, size)).T
        new_gradient = q_z + gains @ (q_uu @ change + q_u) + q_uz.T @ change
        new_hessian = q_zz + q_uu * gains @ gains.T + gains @ q_uz + q_uz.T @ gains.T
        result = ca.vertcat(change, gains, new_gradient, ca.vec((new_hessian + new_hessian.T) / 2))
        value = ca.SX.sym("value", size + size * size)
        result = ca.cse(ca.densify(ca.substitute(result, ca.vertcat(gradient, ca.vec(hessian)), value)))
        names = ["moving", "input", "value", "soft", "terms", "regularity", "parameters"]
        inputs = [z, u, value, self.soft, self.terms, regularity, self.parameters]
        return ca.Function("flight_backward", inputs, [result], names, ["out"])


def _step(equations: Equations) -> _FlightStep:
    """Return one Runge-Kutta step of a motion as expressions, with its part of J, from which iLQR's functions are made.

    `equations`: cart-level equations of the arms.
    """
    n, x, u, p = equations.dimension, equations.state, equations.inputs, equations.parameters
    h, soft, terms, slope = ca.SX.sym("step"), ca.SX.sym("soft"), ca.SX.sym("terms", 4), equations.function()
    excess = ca.vertcat(
        _beyond(x[n - 2], terms[1]) / _SOFT_POSITION,
        _beyond(x[n - 1], terms[2]) / _SOFT_VELOCITY,
    )
    following = runge_kutta_4(lambda state, _: slope(state, u, p), x, h)
    cost = h * (1 + _EFFORT / 2 * (u**2 + terms[3] * x[n - 2] ** 2) + soft / 2 * ca.sumsqr(excess))
    accurate = fixed_step(equations)(x, u, h, p)
    return _FlightStep(ca.vertcat(x, h), u, soft, terms, p, accurate, following, cost, excess)
