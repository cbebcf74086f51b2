"""Chart of the value of tubes.

It compares flights found along tubes with direct optimisation without them.

Every flight is one program, regardless of the method:

    minimise ∫ u² dt      subject to  ẋ = f(x, u), the cart's limits, x(0) on one sustained orbit, x(T) on the other

It is solved at the cart level with friction, by one transcription, solver, tolerance and limit of iterations. The
methods differ in the start of the search: the orbit that shadows the tubes' connection, a smooth curve from end to end,
that curve with random waves, or the motion under random inputs. Two more start from the result of the cross-entropy
method (CEM), which shoots forward with held inputs, or of a homotopy from waves (`dpcontrol.bench.homotopy`). The end
state includes
the winding, so every solution turns each arm the required number of times.

The charted figures are computed again from textbook equations of motion, by scipy alone: every interval from its first
state, and the effort as one more state. A flight counts if no interval ends farther than `GAP` (scaled) from the start
of the next. The shipped law then follows each on plants that are off by 5 %.

The settings of the other methods were tuned on flights outside the chart. Waves (0.15 to 2 rad, 3, 6 and 12 harmonics)
and inputs (0.3, 1 m/s²) used an outer turn at 0 J, eight tries each or more. CEM, waves and the homotopy's prices used
this and a crossing at 0.25 J, four tries of each setting or more.

Sources: Betts, Practical Methods for Optimal Control Using Nonlinear Programming, 3rd ed., ch. 4; Rubinstein & Kroese,
The Cross-Entropy Method (2004), ch. 5.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from statistics import median
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import BarycentricInterpolator

from dpcontrol.bench.chart import (
    AT_ONCE,
    Border,
    Diagram,
    Missing,
    Point,
    PrecisionChart,
    Search,
    Searches,
    find_border,
    half_of,
)
from dpcontrol.bench.chart import Attempt as Answer
from dpcontrol.bench.control import held
from dpcontrol.bench.homotopy import by_homotopy
from dpcontrol.control.interface import whole_turns
from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.dynamics.compiled import Compiled, compiled_step
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.processes import in_processes, processors
from dpcontrol.foundation.progress import Progress
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.bench import DisturbanceSettings
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.result import BatchRun
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.model import load_model
from dpcontrol.plans.pieces import walk_goal
from dpcontrol.plans.planning import on_turns, period_at
from dpcontrol.plans.transfers import sensitivity
from dpcontrol.references.find import find_reference, on_mesh, smooth_guess
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import EndConditions, Guess, Limits, ReferenceProblem, ReferenceSettings, state_scale
from dpcontrol.references.reference import Reference, joined
from dpcontrol.references.sustained import SustainedOrbit, sustained_orbit
from dpcontrol.references.trajectory import Trajectory, even_mesh, first_trajectory, times_on
from dpcontrol.references.transcription import solve
from dpcontrol.walks.edges import find_edges
from dpcontrol.walks.shadowing import WalkSolver
from dpcontrol.walks.symbols import parse_walk
from dpcontrol.walks.walks import resolve

LIMITS = Limits()
SETTINGS = ReferenceSettings(pendulum_weight=0.0, cart_weight=0.0)
"""Settings of every search: the package's, except for the cost, which is the effort alone."""
GAP = 1e-4
"""Largest scaled distance between an interval's end and the next one's start."""
TUBES, STRAIGHT, WAVES, INPUTS, CEM, HOMOTOPY = (
    "along tubes", "smooth curve", "curve with waves", "random inputs", "CEM, then collocation", "homotopy from waves",
)  # fmt: skip
MISMATCH, SEEDS, BLOWN = 0.05, 24, 16
"""Mismatch and number of the plants for following flights, and their number under blows."""


@dataclass(frozen=True, eq=False)
class ChartedFlight:
    """A flight between states of two sustained orbits.

    It is a problem with a guess from the tubes.

    `seconds` of one processor cover orbits, tubes, connections and the shadowing orbit.
    """

    name: str
    problem: ReferenceProblem
    orbits: tuple[SustainedOrbit, SustainedOrbit]
    seconds: float = 0.0

    @property
    def ends(self) -> tuple[Array, Array]:
        """States (6,) at start and end, with angles that include the winding."""
        return self.problem.end_states()


@cache
def flight(name: str, walk: tuple[str, ...], energy: float, wraps: int = 1) -> ChartedFlight:
    """Return the flight of a walk's symbols between sustained orbits.

    The orbits are those of the lab's arms, at their phase 0.

    Args:
        name: name of the flight.
        walk: symbols of the walk.
        energy: energy of the orbits, J.
        wraps: periods at each stop.

    Raises:
        GoalMissed: an orbit was not found.
    """
    model = load_model("lab")
    began = time.process_time()
    symbols = parse_walk(walk, model.system.saddles)
    pairs = list(dict.fromkeys((s.source, s.target) for symbol in symbols for s in symbol.simple))
    edges = find_edges(model.system, energy, pairs=pairs, symbols=symbols)
    orbit = WalkSolver(edges.known).solve(resolve(walk, edges), [wraps] * (len(walk) - 1), lead_in=0, lead_out=0)
    if not orbit.converged:
        raise GoalMissed(f"{name}: {orbit.status}")
    goal = walk_goal(orbit, walk, round_off=(True, True))
    spent = time.process_time() - began
    settings = replace(ReferenceSettings(), pendulum_weight=0.0, cart_weight=1.0)
    orbits = [sustained_orbit(one, model.arms, limits=LIMITS, settings=settings) for one in goal.orbits]
    if missed := [one.status for one in orbits if not one.converged]:
        raise GoalMissed(f"{name}: {missed[0]}")
    ends = [on_turns(one, state[:2]) for one, state in zip(orbits, (goal.start, goal.end), strict=True)]
    sample = orbit.states
    problem = ReferenceProblem(
        equations_of(model.arms, Level.CART), model.arms.base(), lambda times: sample(times + goal.begin), goal.seconds,
        limits=LIMITS, ends=EndConditions(start=ends[0], end=ends[1]),
    )  # fmt: skip
    return ChartedFlight(name, problem, (orbits[0], orbits[1]), spent)


def lasting(problem: ReferenceProblem, duration: float) -> ReferenceProblem:
    """Return the problem with another duration and equal ends.

    Args:
        problem: problem with fixed ends.
        duration: duration, s.
    """
    start, end = problem.end_states()
    guess = smooth_guess(start[:4], end[:4], duration)
    return ReferenceProblem(problem.equations, problem.parameters, guess, duration, problem.limits, problem.ends)


# --- Independent of the engine: equations written out, scipy's integrator, effort as a state.


@dataclass(frozen=True)
class Recomputed:
    """A flight recomputed by scipy alone.

    Attributes:
        effort: ∫u², m²/s³.
        peak: m/s².
        gap: largest scaled distance between intervals.
        miss: largest scaled distance from the ends.
        position: largest of the cart, m.
        velocity: largest of the cart, m/s.
        turns: of each arm, end to end.
    """

    effort: float
    peak: float
    gap: float
    miss: float
    position: float
    velocity: float
    turns: tuple[int, int]

    def flies(self, limits: Limits) -> bool:
        """True for a motion between the ends within limits.

        Rounding is tolerated.

        Args:
            limits: limits of the cart.
        """
        near = 1 + 1e-6
        inside = self.position <= near * limits.position and self.velocity <= near * limits.velocity
        return max(self.gap, self.miss) <= GAP and inside and self.peak <= near * limits.acceleration


def motion_rate(arms: ArmChainParameters, x: Array, u: Array) -> Array:
    """Return ẋ (6, K) of two arms on a cart.

        A ω₁' + C cos(θ₁-θ₂) ω₂' = -C sin(θ₁-θ₂) ω₂² - G₁ sin θ₁ - (G₁/g) cos θ₁ u - k₁ ω₁ - k₂ (ω₁ - ω₂)
        B ω₂' + C cos(θ₁-θ₂) ω₁' =  C sin(θ₁-θ₂) ω₁² - G₂ sin θ₂ - (G₂/g) cos θ₂ u - k₂ (ω₂ - ω₁)

    A = m₁a₁² + m₂ℓ₁² + J₁, B = m₂a₂² + J₂, C = m₂ℓ₁a₂, G₁ = (m₁a₁ + m₂ℓ₁)g, G₂ = m₂a₂g.

    Args:
        arms: parameters of the arms.
        x: states (6, K).
        u: accelerations of the cart (K,), m/s².
    """
    (m1, m2), (a1, a2), (j1, j2), l1 = arms.mass, arms.centre_of_mass, arms.inertia, arms.length[0]
    g, (k1, k2) = arms.gravity, arms.viscous
    a, b, c = m1 * a1**2 + m2 * l1**2 + j1, m2 * a2**2 + j2, m2 * l1 * a2
    s1, s2 = m1 * a1 + m2 * l1, m2 * a2
    angle_1, angle_2, rate_1, rate_2, _, velocity = x
    cosine, sine = c * np.cos(angle_1 - angle_2), c * np.sin(angle_1 - angle_2)
    drag = k2 * (rate_1 - rate_2)
    force_1 = -sine * rate_2**2 - s1 * (g * np.sin(angle_1) + np.cos(angle_1) * u) - k1 * rate_1 - drag
    force_2 = sine * rate_1**2 - s2 * (g * np.sin(angle_2) + np.cos(angle_2) * u) + drag
    determinant = a * b - cosine**2
    turn_1, turn_2 = (b * force_1 - cosine * force_2) / determinant, (a * force_2 - cosine * force_1) / determinant
    return np.array([rate_1, rate_2, turn_1, turn_2, velocity, u])


def recomputed(arms: ArmChainParameters, motion: Trajectory, ends: tuple[Array, Array]) -> Recomputed:
    """Return the scipy evaluation of a motion.

    All intervals run in parallel, each from its first state.

    Args:
        arms: parameters of the arms.
        motion: motion to evaluate.
        ends: required first and last state (6,).
    """
    lengths, scale = np.diff(motion.mesh), state_scale(6, LIMITS)
    inputs = BarycentricInterpolator(motion.method.points, motion.inputs[..., 0].T)
    count = len(lengths)

    def rate(tau: float, flat: Array) -> Array:
        u = np.asarray(inputs(tau)).ravel()
        rows = flat.reshape(7, count)
        return (lengths * np.vstack([motion_rate(arms, rows[:6], u), u**2])).ravel()

    first = np.vstack([motion.states[:, 0].T, np.zeros(count)])
    dense = np.linspace(0.0, 1.0, 11)
    done = solve_ivp(rate, (0.0, 1.0), first.ravel(), method="DOP853", t_eval=dense, rtol=1e-10, atol=1e-12)
    rows = done.y.reshape(7, count, -1)
    arrived = rows[:6, :, -1].T
    following = np.vstack([motion.states[1:, 0], ends[1]])
    missed = np.abs(motion.states[0, 0] - ends[0]), np.abs(arrived[-1] - ends[1])
    turned = np.rint((arrived[-1, :2] - motion.states[0, 0, :2]) / np.pi / 2).astype(int)
    return Recomputed(
        effort=float(rows[6, :, -1].sum()),
        peak=float(np.abs(inputs(dense)).max()),
        gap=float((np.abs(arrived - following) / scale).max()),
        miss=float((np.maximum(*missed) / scale).max()),
        position=float(np.abs(rows[4]).max()),
        velocity=float(np.abs(rows[5]).max()),
        turns=(int(turned[0]), int(turned[1])),
    )


# --- Searches.


@dataclass(frozen=True, eq=False)
class Try:
    """One search: method, seconds of one processor, and result, None without convergence."""

    method: str
    seconds: float
    motion: Trajectory | None = None

    @property
    def effort(self) -> float:
        """∫u² in m²/s³; infinite without convergence."""
        return float("inf") if self.motion is None else self.motion.effort


def searched(method: str, problem: ReferenceProblem, first: Trajectory | None = None, *, spent: float = 0.0) -> Try:
    """Return the collocation result from a first trajectory.

    Args:
        method: name of the method in the chart.
        problem: problem with a guess.
        first: first trajectory, by default the guess.
        spent: time that went into finding it, s.
    """
    began = time.process_time()
    if first is None:
        first = first_trajectory(problem, method_named(SETTINGS.method), even_mesh(problem.duration, SETTINGS.interval))
    solved = solve(problem, first, settings=SETTINGS, limits=problem.limits)
    spent += time.process_time() - began
    return Try(method, spent, solved.trajectory if solved.succeeded else None)


def led(method: str, problem: ReferenceProblem, generator: np.random.Generator) -> Try:
    """Return the collocation result from a homotopy.

    It starts at the guess with random waves.

    Args:
        method: name of the method in the chart.
        problem: problem with a guess.
        generator: random generator, which is advanced.
    """
    began = time.process_time()
    states, inputs, step = by_homotopy(replace(problem, guess=with_waves(problem, generator)))
    return searched(method, problem, flown(problem, states, inputs, step), spent=time.process_time() - began)


def along_tubes(one: ChartedFlight) -> Try:
    """Return the collocation result from the shadowing orbit.

    Its seconds include tubes and connections.

    Args:
        one: flight along tubes.
    """
    return searched(TUBES, one.problem, spent=one.seconds)


WAVE, HARMONICS = 0.5, 6
"""Standard deviation of a wave of one half period, rad; the k-th has a k-th of it."""
PUSH, KNOTS = 0.3, 12
"""Standard deviation of random inputs, m/s², linear between this number of knots."""


def with_waves(problem: ReferenceProblem, generator: np.random.Generator) -> Guess:
    """Return the problem's guess with random waves on its angles.

    The rates match them.

    Args:
        problem: problem with a guess.
        generator: random generator, which is advanced.
    """
    base, order = problem.guess, np.arange(1, HARMONICS + 1)
    heights = generator.normal(size=(HARMONICS, 2)) * (WAVE / order)[:, None]

    def guess(times: Array) -> Array:
        phases = np.pi * order * np.asarray(times)[:, None] / problem.duration
        states = base(times).copy()
        states[:, :2] += np.sin(phases) @ heights
        states[:, 2:] += np.cos(phases) @ (heights * (np.pi * order / problem.duration)[:, None])
        return states

    return guess


_STEP = 0.01
"""Step of shooting, s; at this step the plant's method of order 8 errs by less than 1e-7."""


@cache
def _shot(arms: ArmChainParameters) -> Compiled:
    return compiled_step(equations_of(arms, Level.CART))


def shot(arms: ArmChainParameters, start: Array, inputs: Array, step: float) -> Array:
    """Return the states (K + 1, 6, S) from one start.

    Args:
        arms: parameters of the arms.
        start: first state (6,).
        inputs: held inputs (K, S), m/s².
        step: time for which an input is held, s.
    """
    machine, (count, lanes) = _shot(arms), inputs.shape
    rows = np.empty((machine.size_in, lanes))
    rows[machine.slices["parameters"]] = arms.base()[:, None]
    rows[machine.slices["duration"]] = step
    states = np.empty((count + 1, 6, lanes))
    states[0] = start[:, None]
    for k in range(count):
        rows[machine.slices["state"]], rows[machine.slices["inputs"]] = states[k], inputs[k]
        machine(rows, states[k + 1])
    return states


def flown(problem: ReferenceProblem, states: Array, inputs: Array, step: float) -> Trajectory:
    """Return a shot motion as a first trajectory.

    The shot motion is on the even mesh.

    Args:
        problem: problem with its duration.
        states: states (K + 1, 6).
        inputs: held inputs (K,), m/s².
        step: time for which an input is held, s.
    """
    method, mesh = method_named(SETTINGS.method), even_mesh(problem.duration, SETTINGS.interval)
    times, clock = times_on(mesh, method.support), step * np.arange(len(states))
    rows = np.stack([np.interp(times, clock, column) for column in states.T], axis=-1)
    places = np.minimum((times_on(mesh, method.points) / step).astype(int), len(inputs) - 1)
    return Trajectory(method, mesh, rows, inputs[places][..., None])


def with_inputs(problem: ReferenceProblem, arms: ArmChainParameters, generator: np.random.Generator) -> Trajectory:
    """Return the motion from the start under random inputs.

    Args:
        problem: problem with a fixed start.
        arms: parameters of the arms.
        generator: random generator, which is advanced.
    """
    count = int(np.ceil(problem.duration / _STEP))
    step = problem.duration / count
    knots = generator.normal(size=KNOTS) * PUSH
    inputs = np.interp(np.arange(count) / count, np.linspace(0.0, 1.0, KNOTS), knots)
    states = shot(arms, problem.end_states()[0], np.repeat(inputs[:, None], 8, axis=1), step)[..., 0]
    # A cart beyond the track is no start for a search.
    states[:, 4:] = 0.0
    return flown(problem, states, inputs, step)


@dataclass(frozen=True)
class CemSettings:
    """Samples, generations and weights of the cross-entropy method.

    They are samples and elite of a generation, generations, length of held inputs s, initial standard deviation m/s²,
    and weight of the squared scaled miss relative to ∫u².
    """

    samples: int = 256
    kept: int = 24
    generations: int = 80
    hold: float = 0.1
    spread: float = 1.0
    weight: float = 1e3


def by_cem(
    problem: ReferenceProblem, arms: ArmChainParameters, generator: np.random.Generator, settings: CemSettings
) -> tuple[Trajectory, float]:
    """Return the best motion of the cross-entropy method.

    Its scaled miss at the end is the second value.

    Args:
        problem: problem with fixed ends.
        arms: parameters of the arms.
        generator: random generator, which is advanced.
        settings: settings of the method.
    """
    start, end = problem.end_states()
    holds = int(np.ceil(problem.duration / settings.hold))
    each = int(np.ceil(problem.duration / holds / (2 * _STEP)))
    step, scale = problem.duration / holds / each, state_scale(6, problem.limits)
    mean, spread = np.zeros(holds), np.full(holds, settings.spread)
    best: tuple[float, float, Array, Array] | None = None
    for _ in range(settings.generations):
        inputs = mean[:, None] + spread[:, None] * generator.normal(size=(holds, settings.samples))
        inputs = np.clip(inputs, -problem.limits.acceleration, problem.limits.acceleration)
        held_on = np.repeat(inputs, each, axis=0)
        states = shot(arms, start, held_on, step)
        away = np.abs((states[-1] - end[:, None]) / scale[:, None])
        costs = (inputs**2).sum(0) * problem.duration / holds + settings.weight * (away**2).sum(0)
        costs = np.where(np.isfinite(costs), costs, np.inf)
        order = np.argsort(costs)
        mean, spread = inputs[:, order[: settings.kept]].mean(1), inputs[:, order[: settings.kept]].std(1) + 1e-3
        first = int(order[0])
        if best is None or costs[first] < best[0]:
            best = (float(costs[first]), float(away[:, first].max()), states[..., first].copy(), held_on[:, first])
    assert best is not None
    return flown(problem, best[2], best[3], step), best[1]


def refined(problem: ReferenceProblem, motion: Trajectory) -> Reference | None:
    """Return a motion on a refined mesh, or None on failure.

    The mesh reaches the package's error between nodes.

    Args:
        problem: problem of the motion.
        motion: solution on a coarse mesh.
    """
    found = find_reference(problem, SETTINGS, near=motion)
    return found if found.converged else None


def resampled(motion: Trajectory, duration: float) -> Trajectory:
    """Return a motion stretched to another duration.

    The motion is on the even mesh.

    Args:
        motion: motion of six states.
        duration: duration, s.
    """
    slower = duration / motion.duration
    states = motion.states.copy()
    states[..., 2:4] /= slower
    states[..., 5] /= slower
    stretched = Trajectory(motion.method, slower * (motion.mesh - motion.mesh[0]), states, motion.inputs / slower**2)
    stretched.mesh[-1] = duration
    return on_mesh(stretched, even_mesh(duration, SETTINGS.interval))


# --- Feedback.


@dataclass(frozen=True)
class FollowedFlight:
    """Loop results for a flight between two orbits.

    The motion includes a period of each orbit on either side.

    Attributes:
        completed: share of plants.
        effort: mean ∫u² of completed runs, m²/s³, or not-a-number.
        sensitivity: rad per unit of relative error of a parameter.
        blow: N m s on an arm, at any time, survived by half of the plants, or 0.
    """

    completed: float
    effort: float
    sensitivity: float
    blow: float = 0.0


def between_orbits(one: ChartedFlight, motion: Reference) -> Reference:
    """Return a period of each orbit and the flight as one reference.

    Args:
        one: flight with its orbits.
        motion: reference of the flight.
    """
    start, end = one.ends
    pieces = [motion]
    for orbit, state, place in ((one.orbits[0], start, 0), (one.orbits[1], end, 2)):
        pieces.insert(place, period_at(orbit, state))
    return joined(pieces)[0]


def _did(one: ChartedFlight, run: BatchRun) -> bool:
    orbit = one.orbits[1]
    angles = orbit.state(np.linspace(0.0, orbit.period, 400))[:, :2]
    end = whole_turns(run.truth[-1, :2] - run.references[-1])
    return held(angles, period=orbit.period)(run) and not end.any()


def followed(one: ChartedFlight, motion: Reference, *, seeds: int, blows: bool = False) -> FollowedFlight:
    """Return the results of the shipped law on a flight.

    The plants are off by 5 %.

    Args:
        one: flight with its orbits.
        motion: reference of the flight.
        seeds: number of runs.
        blows: find the largest blow survived.
    """
    arms = load_model("lab").arms
    scene = load_itinerary("outer-turn").loop
    whole = between_orbits(one, motion)
    settings = replace(scene, seed=0, mismatch=MISMATCH, initial_error=0.0)
    assembly = Assembly(whole, arms, settings)
    _ = assembly.controller

    def runs(loop: LoopSettings, count: int) -> list[BatchRun]:
        return assembly.under(loop).batch(range(count))

    every = runs(settings, seeds)
    done = [run for run in every if _did(one, run)]
    effort = float(np.mean([run.applied @ run.applied for run in done])) / settings.rate if done else float("nan")

    def struck(impulse: float) -> Answer:
        hit = replace(settings, disturbances=DisturbanceSettings(pushes=1, push_impulse=impulse))
        return half_of([Answer(_did(one, run), run.reason) for run in runs(hit, BLOWN)], "are lost")

    border: Border | None = None
    if blows:
        border = find_border(struck, x=0.0, line=one.name, near=3e-4, far=3e-2, ratio=1.3)
    blow = (border.measured or border.near or 0.0) if border else 0.0
    return FollowedFlight(len(done) / len(every), effort, sensitivity(arms, motion), blow)


# --- Charted flights.

FLIGHTS = (
    ("outer turn, -0.07 J", ("down-up +",), -0.07), ("outer turn, 0.1 J", ("down-up +",), 0.1),
    ("outer turn, 0.2 J", ("down-up +",), 0.2), ("inner turn, 0.2 J", ("up-down +",), 0.2),
    ("crossing, 0.2 J", ("down-up > up-down",), 0.2),
)  # fmt: skip
FACTORS = (0.3, 0.5, 0.75, 1.0, 1.4, 2.0, 3.0)
WALKS = (1, 2, 4, 8)
OFF, WRAPS = "off tubes", "along tubes, wobbles more"
EQUILIBRIA = "between equilibria"
_LOOKED_AT = 3
"""Number of cheapest tries, until one is valid on a refined mesh."""


@dataclass(frozen=True)
class Effort:
    """Numbers of tries and runs that a comparison spends.

    It counts tries from curves with waves, from random inputs, by CEM and by homotopy, tries at each time of a front
    and for each walk, and runs of the loop. Other fields select blows and the times of a front as multiples of that
    along tubes.
    """

    waves: int
    inputs: int
    cem: int
    homotopies: int
    front: int
    walk: int
    seeds: int
    blows: bool
    factors: tuple[float, ...]
    flights: tuple[tuple[str, tuple[str, ...], float], ...]
    walks: tuple[int, ...]


WHOLE = Effort(80, 15, 5, 16, 3, 2, SEEDS, True, FACTORS, FLIGHTS, WALKS)
QUICK = Effort(2, 1, 1, 2, 0, 0, 6, False, (0.5, 1.0, 2.0), FLIGHTS[:1] + FLIGHTS[4:], WALKS[:2])


@dataclass(frozen=True, eq=False)
class Charted:
    """A charted flight: its evaluation by scipy, and the loop's results.

    The latter may be missing.
    """

    method: str
    duration: float
    checked: Recomputed
    followed: FollowedFlight | None = None


@dataclass(frozen=True, eq=False)
class Compared:
    """One flight by every method.

    It has all tries, without their motions, and the cheapest valid one of each method.
    """

    name: str
    tries: tuple[tuple[str, float, float], ...]
    best: dict[str, Charted]

    def of(self, method: str) -> list[tuple[float, float]]:
        """Return seconds and effort of a method's tries.

        The effort of failures is infinite.

        Args:
            method: name of the method.
        """
        return [(seconds, effort) for name, seconds, effort in self.tries if name == method]

    @property
    def ours(self) -> Charted:
        """The flight found along tubes."""
        return self.best[TUBES]


def tries_of(one: ChartedFlight, effort: Effort, generator: np.random.Generator) -> Iterator[Try]:
    """Yield the tries of every method without tubes.

    Args:
        one: flight along tubes.
        effort: number of tries.
        generator: random generator, which is advanced.
    """
    arms, smooth = load_model("lab").arms, lasting(one.problem, one.problem.duration)
    yield searched(STRAIGHT, smooth)
    for _ in range(effort.waves):
        yield searched(WAVES, replace(smooth, guess=with_waves(smooth, generator)))
    for _ in range(effort.inputs):
        began = time.process_time()
        first = with_inputs(smooth, arms, generator)
        yield searched(INPUTS, smooth, first, spent=time.process_time() - began)
    for _ in range(effort.cem):
        began = time.process_time()
        first, _ = by_cem(smooth, arms, generator, CemSettings())
        yield searched(CEM, smooth, first, spent=time.process_time() - began)
    for _ in range(effort.homotopies):
        yield led(HOMOTOPY, smooth, generator)


def charted(
    one: ChartedFlight, problem: ReferenceProblem, tries: Sequence[Try], *, seeds: int = 0, blows: bool = False
) -> Charted | None:
    """Return the cheapest of some tries refined and checked.

    The result is None if all are invalid.

    Args:
        one: flight along tubes.
        problem: problem of the tries.
        tries: results to choose from.
        seeds: number of runs that follow it; 0 for none.
        blows: see `followed`.
    """
    for first in sorted(tries, key=lambda t: t.effort)[:_LOOKED_AT]:
        fine = None if first.motion is None else refined(problem, first.motion)
        if fine is None:
            continue
        checked = recomputed(load_model("lab").arms, fine, problem.end_states())
        if checked.flies(problem.limits):
            loop = followed(one, fine, seeds=seeds, blows=blows) if seeds else None
            return Charted(first.method, fine.duration, checked, loop)
    return None


def by_method(one: ChartedFlight, tries: Sequence[Try], effort: Effort, *, feedback: bool) -> Compared:
    """Return all tries, and the cheapest valid one of each method.

    The tubes' flight and the best other one have loop results.

    Args:
        one: flight along tubes.
        tries: results of all methods.
        effort: number of runs.
        feedback: run the loop.
    """
    cheapest = min((t for t in tries if t.method != TUBES), key=lambda t: t.effort).method
    best: dict[str, Charted] = {}
    for method in dict.fromkeys(t.method for t in tries):
        seeds = effort.seeds if feedback and method in (TUBES, cheapest) else 0
        own = [t for t in tries if t.method == method]
        if (found := charted(one, one.problem, own, seeds=seeds, blows=effort.blows)) is not None:
            best[method] = found
    if TUBES not in best:
        raise GoalMissed(f"{one.name}: the flight found along tubes is not valid")
    return Compared(one.name, tuple((t.method, t.seconds, t.effort) for t in tries), best)


def compared(which: tuple[str, tuple[str, ...], float], effort: Effort) -> Compared:
    """Return one flight by every method, at its duration along tubes.

    Args:
        which: name, walk and energy (J) of the flight.
        effort: number of tries.
    """
    one = flight(*which)
    generator = np.random.default_rng([20, *which[0].encode()])
    return by_method(one, [along_tubes(one), *tries_of(one, effort, generator)], effort, feedback=True)


def front(which: tuple[str, tuple[str, ...], float], effort: Effort, *, resting: bool = False) -> list[Charted]:
    """Return the cheapest flights at each time.

    They lie off tubes and along them, with and without additional wobbles.

    Args:
        which: name, walk and energy (J) of the flight.
        effort: number of tries.
        resting: join the equilibria of the saddles, without orbits and tubes.
    """
    one, arms = flight(*which), load_model("lab").arms
    problem = one.problem
    if resting:
        ends = [np.concatenate([np.pi * np.rint(end[:2] / np.pi), np.zeros(4)]) for end in one.ends]
        problem = replace(problem, ends=EndConditions(start=ends[0], end=ends[1]))
    generator = np.random.default_rng([21, resting, *which[0].encode()])
    method = EQUILIBRIA if resting else OFF
    found: list[Charted] = []
    middle = effort.factors.index(1.0)
    best: dict[float, Trajectory] = {}
    # From the tubes' time to longer ones, then to shorter ones: the best at each time is a start for the next.
    for factor, before in (
        (1.0, 0.0), *zip(effort.factors[middle + 1 :], effort.factors[middle:], strict=False),
        *zip(effort.factors[:middle][::-1], effort.factors[: middle + 1][::-1], strict=False),
    ):  # fmt: skip
        here = lasting(problem, factor * one.problem.duration)
        tries = [searched(method, here)]
        tries += [searched(method, replace(here, guess=with_waves(here, generator))) for _ in range(effort.front)]
        if before in best:
            tries.append(searched(method, here, resampled(best[before], here.duration)))
        cheapest = min(tries, key=lambda t: t.effort).motion
        if cheapest is not None:
            best[factor] = cheapest
        if (done := charted(one, here, tries)) is not None:
            found.append(done)
    return found if resting else found + with_wobbles(one, arms, effort)


def with_wobbles(one: ChartedFlight, arms: ArmChainParameters, effort: Effort) -> list[Charted]:
    """Return the flight along tubes, with and without additional wobbles.

    Their number grows up to the front's longest time.

    Args:
        one: flight along tubes.
        arms: parameters of the arms.
        effort: times of the front, and runs that follow it.
    """
    ours = along_tubes(one)
    fine = None if ours.motion is None else refined(one.problem, ours.motion)
    if fine is None:
        raise GoalMissed(f"{one.name}: nothing was found along the tubes")
    orbit, start = one.orbits[0], one.ends[0]
    wobble, found = period_at(orbit, start), []
    most = int((max(effort.factors) - 1) * fine.duration / orbit.period)
    for more in range(most + 1):
        whole = joined([*[wobble] * more, fine])[0]
        checked = recomputed(arms, whole, one.ends)
        if checked.flies(LIMITS):
            found.append(Charted(WRAPS if more else TUBES, whole.duration, checked))
    return found


def stop_by_stop(problem: ReferenceProblem, count: int) -> ReferenceProblem:
    """Return the problem with a guess from the walk's turns.

    Smooth curves join stops at even times.

    Args:
        problem: problem of a walk.
        count: number of turns.
    """
    start, end = problem.end_states()
    change, each = np.append((end - start)[:2] / count, [0.0, 0.0]), problem.duration / count
    turn = smooth_guess(np.zeros(4), change, each)

    def guess(times: Array) -> Array:
        which = np.clip(np.floor(np.asarray(times) / each), 0, count - 1)
        states = start[:4] * [1, 1, 0, 0] + which[:, None] * change + turn(times - which * each)
        return states

    return replace(problem, guess=guess)


def walked(count: int, effort: Effort) -> Compared:
    """Return a walk of some turns of the outer arm.

    The walk is found by tubes and by methods without them.

    Args:
        count: number of turns.
        effort: number of tries.
    """
    one = flight(f"{count} turns", ("down-up +",) * count, FLIGHTS[0][2])
    stops = stop_by_stop(one.problem, count)
    generator = np.random.default_rng([22, count])
    tries = [along_tubes(one), searched(STRAIGHT, stops)]
    tries += [searched(WAVES, replace(stops, guess=with_waves(stops, generator))) for _ in range(effort.walk)]
    return by_method(one, tries, effort, feedback=False)


Work = tuple[str, Any, Effort]


def job_done(job: Work) -> Any:
    """Run one of the chart's jobs, in any process.

    Args:
        job: kind, flight or count, and effort.
    """
    kind, what, effort = job
    if kind == "flight":
        return compared(what, effort)
    if kind == "walk":
        return walked(what, effort)
    return front(what, effort, resting=kind == "rest")


def jobs_of(effort: Effort) -> list[Work]:
    """Return the chart's jobs, those that take longest first."""
    return [
        *(("flight", which, effort) for which in effort.flights),
        *(("front", which, effort) for which in (effort.flights[0], effort.flights[-1])),
        ("rest", effort.flights[0], effort),
        *(("walk", count, effort) for count in reversed(effort.walks)),
    ]  # fmt: skip


def chart(quick: bool, progress: Progress) -> PrecisionChart:
    """Return the chart of the value of tubes.

    Args:
        quick: two flights and fewer tries.
        progress: called with a label and the completed share.
    """
    effort, found = QUICK if quick else WHOLE, {}
    jobs = jobs_of(effort)
    keys = [(kind, str(what)) for kind, what, _ in jobs]
    progress("payoff", 0.0)
    for job, done in in_processes(job_done, jobs, min(processors(), AT_ONCE), remedy="Draw it again"):
        found[job[0], str(job[1])] = done
        progress(f"payoff: {len(found)} of {len(jobs)}", len(found) / len(jobs))
    results = {kind: [found[key] for key in keys if key[0] == kind] for kind in ("flight", "walk", "front", "rest")}
    return page(results)


def page(results: dict[str, list[Any]]) -> PrecisionChart:
    """Return the page of all results, by kind of job.

    Args:
        results: results of the jobs, by kind.
    """
    flights: list[Compared] = results["flight"]
    walks: list[Compared] = results["walk"][::-1]
    pairs = zip((flights[0], flights[-1]), results["front"], strict=False)
    fronts = {one.name: with_best_known(found, one) for one, found in pairs}
    return PrecisionChart(
        name="payoff",
        title="Value of tubes: flights along tubes, and by direct optimisation without them",
        parts=(
            *(front_panel(f"Time set free: {name}", front) for name, front in fronts.items()),
            *(front_panel("Time set free: outer turn, held before and after", found) for found in results["rest"]),
            success_panel(flights), effort_panel(flights), feedback_panel(flights),
            robustness_panel(flights), *walk_panels(walks),
        ),
        reading=(
            "All start and end in the same states, under the same limits, by the same program; low and left is better. "
            "All flights are computed again by scipy alone.",
            "Time set free: the cheapest flight of a few searches at each time. Held before and after: at rest at the "
            "ends.",
            "Robustness: largest blow survived by half the runs.",
        ),
        chosen=verdict(flights, walks, fronts),
        lead=searches_of(flights),
    )  # fmt: skip


def with_best_known(front: Sequence[Charted], one: Compared) -> list[Charted]:
    """Return a front with the cheapest flight off the tubes.

    That flight, at the tubes' time, is chosen from all tries, not only the front's.

    Args:
        front: flights at several times.
        one: the same flight by every method.
    """
    others = [c for method, c in one.best.items() if method != TUBES]
    if not others:
        return list(front)
    best = replace(min(others, key=lambda c: c.checked.effort), method=OFF)
    same = [c for c in front if c.method == OFF and abs(c.duration - best.duration) < _SAME_TIME]
    return [best, *(c for c in front if c not in same or c.checked.effort < best.checked.effort)]


_SAME_TIME = 1e-6


def numbers(one: Charted) -> dict[str, float]:
    """Return a flight's figures by name, for the JSON."""
    c, loop = one.checked, one.followed
    found = {
        "duration": one.duration, "effort": c.effort, "peak": c.peak, "gap": c.gap, "miss": c.miss,
        "cart_position": c.position, "cart_velocity": c.velocity, "turns_1": c.turns[0], "turns_2": c.turns[1],
    }  # fmt: skip
    if loop is not None:
        found |= {"completed": loop.completed, "sensitivity": loop.sensitivity, "blow": loop.blow}
        if np.isfinite(loop.effort):
            found["loop_effort"] = loop.effort
    return {name: float(value) for name, value in found.items()}


AS_CHEAP = 1.1
"""Multiple of the tubes' effort up to which a flight counts as equally cheap."""


def as_cheap(one: Compared, method: str) -> int:
    """Return the number of a method's tries with little effort.

    These tries find motions as cheap as the flight along tubes.

    Args:
        one: flight by every method.
        method: name of the method.
    """
    return sum(effort <= AS_CHEAP * one.ours.checked.effort for _, effort in one.of(method))


def _tallied(one: Compared, method: str) -> dict[str, float]:
    tries = one.of(method)
    efforts = [effort for _, effort in tries if np.isfinite(effort)]
    found = {
        "tries": len(tries), "converged": len(efforts), "as_cheap": as_cheap(one, method),
        "seconds_in_all": sum(seconds for seconds, _ in tries),
    }  # fmt: skip
    return found | ({"median_effort": median(efforts)} if efforts else {})


def _methods(found: Sequence[Compared]) -> list[str]:
    return list(dict.fromkeys(name for one in found for name, *_ in one.tries))


def searches_of(flights: Sequence[Compared]) -> Searches:
    """Return the success of every method over all flights, the best first."""
    found = []
    for method in _methods(flights):
        tallies = [_tallied(one, method) for one in flights]
        tries, solved, good, seconds = (
            sum(t[key] for t in tallies) for key in ("tries", "converged", "as_cheap", "seconds_in_all")
        )
        found.append(Search(method, int(tries), int(solved), int(good), seconds, default=method == TUBES))
    found.sort(key=lambda s: (s.seconds_to_good, -s.found / s.tries))
    return Searches("Flights between the same states in the same time", tuple(found), "as cheap as along tubes")


def success_panel(flights: Sequence[Compared]) -> Diagram:
    """Return the diagram of failing tries against time.

    The share of failures is drawn against the time of one try.
    """
    points = []
    for method in _methods(flights):
        for one in flights:
            tally = _tallied(one, method)
            share = tally["converged"] / tally["tries"]
            points.append(
                Point(method, short(one.name), tally["seconds_in_all"] / tally["tries"], 1 - share, others=tally,
                      default=method == TUBES, note=f"{tally['converged']:g} of {tally['tries']:g} tries")
            )  # fmt: skip
    return Diagram(
        "Same ends, same time: success",
        "time of a try on one core, s",
        "share of tries that find no flight",
        tuple(points),
        log_y=False,
        judged=False,
        timed=False,
    )


def effort_panel(flights: Sequence[Compared]) -> Diagram:
    """Return the diagram of the best flight's effort against time.

    The time is that of all tries.
    """
    points, missing = [], []
    for method in _methods(flights):
        for one in flights:
            if method not in one.best:
                missing.append(Missing(method, short(one.name), "no try found a flight"))
                continue
            best, tally = one.best[method], _tallied(one, method)
            note = f"{tally['as_cheap']:g} of {tally['tries']:g} tries within {AS_CHEAP - 1:.0%} of the tubes' effort"
            points.append(
                Point(method, short(one.name), tally["seconds_in_all"], best.checked.effort / one.ours.checked.effort,
                      default=method == TUBES, note=note, others=tally | numbers(best))
            )  # fmt: skip
    return Diagram(
        "Same ends, same time: best flight", "time of all tries on one core, s", "∫u², times that along tubes",
        tuple(points), missing=tuple(missing), judged=False, timed=False,
    )  # fmt: skip


def feedback_panel(flights: Sequence[Compared]) -> Diagram:
    """Return the diagram of the loop's effort at ±5 %.

    The diagram is drawn against that of the reference.
    """
    points, missing = [], []
    for one in flights:
        for method, best in one.best.items():
            loop, name = best.followed, TUBES if method == TUBES else OFF
            if loop is None:
                continue
            if not loop.completed:
                missing.append(Missing(name, short(one.name), "no run completes"))
                continue
            points.append(
                Point(name, short(one.name), best.checked.effort, loop.effort, default=method == TUBES,
                      note=f"{loop.completed:.0%} come through", others=numbers(best))
            )  # fmt: skip
    return Diagram(
        "Feedback too, plants off by 5 %", "∫u² of the reference, m²/s³", "∫u² of the loop, m²/s³", tuple(points),
        missing=tuple(missing), judged=False, timed=False,
    )  # fmt: skip


def front_panel(title: str, found: Sequence[Charted]) -> Diagram:
    """Return the diagram of a reference's effort against its time.

    Args:
        title: title of the diagram.
        found: flights of the front.
    """
    points = [Point(c.method, "", c.duration, c.checked.effort, default=c.method == TUBES, others=numbers(c))
              for c in found]  # fmt: skip
    return Diagram(title, "time, s", "∫u², m²/s³", tuple(points), judged=False, timed=False)


def walk_panels(walks: Sequence[Compared]) -> tuple[Diagram, ...]:
    """Return the diagrams of longer walks, if any.

    Seconds to a flight, and failures, are drawn against the number of symbols.
    """
    if not walks:
        return ()
    times, shares, missing = [], [], []
    for method in _methods(walks):
        for one in walks:
            count, tally = int(one.name.split()[0]), _tallied(one, method)
            share, default = tally["converged"] / tally["tries"], method == TUBES
            others = tally | (numbers(one.best[method]) if method in one.best else {})
            shares.append(Point(method, "", count, 1 - share, default=default, others=others))
            if share:
                ratio = f"∫u² {others['effort'] / one.ours.checked.effort:.3g} times ours" if method in one.best else ""
                times.append(
                    Point(method, "", count, tally["seconds_in_all"] / tally["converged"], default=default, note=ratio,
                          others=others)
                )  # fmt: skip
            else:
                missing.append(Missing(method, one.name, f"none of {tally['tries']:g} tries found a flight"))
    more: dict[str, Any] = {"judged": False, "timed": False}
    return (
        Diagram("Longer walks: time", "turns of the outer arm", "time to a flight on one core, s", tuple(times),
              missing=tuple(missing), **more),
        Diagram("Longer walks: success", "turns of the outer arm", "share of tries that find no flight", tuple(shares),
              log_y=False, **more),
    )  # fmt: skip


def robustness_panel(flights: Sequence[Compared]) -> Diagram:
    """Return the diagram of the largest blow survived.

    Without blows it shows the sensitivity to the arms' parameters.
    """
    points = []
    struck = all(c.followed is None or c.followed.blow for one in flights for c in one.best.values())
    for one in flights:
        for method, best in one.best.items():
            if (loop := best.followed) is None or not np.isfinite(loop.sensitivity):
                continue
            points.append(
                Point(TUBES if method == TUBES else OFF, short(one.name), best.checked.effort,
                      1 / loop.blow if struck else loop.sensitivity, default=method == TUBES, others=numbers(best))
            )  # fmt: skip
    label = "1 / largest blow survived, 1/(N m s)" if struck else "rad astray for a unit of a parameter's error"
    return Diagram(
        "Robustness", "∫u² of the reference, m²/s³", label, tuple(points), judged=False, timed=False
    )  # fmt: skip


def short(name: str) -> str:
    """Return a flight's name for a label.

    Args:
        name: name such as "outer turn, 0.1 J".
    """
    return name.replace("outer turn, ", "outer ").replace("inner turn, ", "inner ").replace("crossing, ", "cross ")


def verdict(flights: Sequence[Compared], walks: Sequence[Compared], fronts: Mapping[str, Sequence[Charted]]) -> str:
    """Return the chart's finding in a few sentences, for either outcome.

    Args:
        flights: flights by every method.
        walks: longer walks by every method.
        fronts: fronts by name of the flight.
    """
    plain = [name for name in _methods(flights) if name != TUBES]
    tries = {name: [t for one in flights for t in one.of(name)] for name in plain}
    cheap = {name: sum(as_cheap(one, name) for one in flights) for name in plain}
    every = [t for name in plain for t in tries[name]]
    seconds = {name: sum(s for s, _ in tries[name]) / cheap[name] for name in plain if cheap[name]}
    dearest = [effort / one.ours.checked.effort for one in flights for name in plain for _, effort in one.of(name)]
    best = [min((c.checked.effort for m, c in one.best.items() if m != TUBES), default=float("inf"))
            / one.ours.checked.effort for one in flights]  # fmt: skip
    ours = [one.of(TUBES)[0][0] for one in flights]
    found = sum(np.isfinite(effort) for _, effort in every)
    quickest = min(seconds, key=lambda name: seconds[name], default="")
    sentences = [
        f"along tubes each of {len(flights)} flights is found at once, in {min(ours):.1f} to {max(ours):.1f} s; "
        f"of {len(every)} searches without tubes {found / len(every):.0%} find one, the median "
        f"{median(r for r in dearest if np.isfinite(r)):,.0f} times as costly",
        f"within {AS_CHEAP - 1:.0%} of the tubes' effort are {sum(cheap.values())} of them"
        + (f", at best one in {seconds[quickest]:.0f} s of one core ({quickest})" if seconds else ""),
        f"the best of each flight costs {min(best):.2f} to {max(best):.3g} times that along tubes",
        loop_text(flights),
        *(cheaper_text(name, front) for name, front in fronts.items()),
        *map(walk_text, walks[-1:]),
    ]
    return "; ".join(filter(None, sentences)) + "."


def loop_text(flights: Sequence[Compared]) -> str:
    """Return a sentence on the cost of feedback.

    It compares the tubes' flights with the best others.
    """
    ratios, added = [], []
    for one in flights:
        loops = {m == TUBES: c.followed for m, c in one.best.items() if c.followed and c.followed.completed}
        if True in loops:
            added.append(loops[True].effort / one.ours.checked.effort)
        if len(loops) == 2:
            ratios.append(loops[False].effort / loops[True].effort)
    if not ratios:
        return ""
    return (
        f"with feedback at ±{MISMATCH:.0%} the loop takes {min(added):.0f} to {max(added):.0f} times the reference's "
        f"effort, off the tubes {min(ratios):.2f} to {max(ratios):.2f} times the effort along them"
    )


def cheaper_text(name: str, found: Sequence[Charted]) -> str:
    """Return a sentence on the cheapest flight off the tubes.

    It reports the time and saving on a front.

    Args:
        name: name of the flight.
        found: flights of its front.
    """
    (ours,) = [c for c in found if c.method == TUBES]
    off = [c for c in found if c.method == OFF]
    cheap = [c for c in off if c.checked.effort < ours.checked.effort / 1.02]
    if not cheap:
        times = [c.duration for c in off]
        return f"{name}: no other time from {min(times, default=0):.2g} to {max(times, default=0):.2g} s is cheaper"
    least = min(cheap, key=lambda c: c.checked.effort)
    ratio = least.checked.effort / ours.checked.effort
    times = f"{least.duration:.2g} s in place of {ours.duration:.2g}"
    return f"{name}: {ratio:.2f} times the effort off the tubes in {times}"


def walk_text(one: Compared) -> str:
    """Return a sentence on the longest walk."""
    tries = [t for name in _methods([one]) if name != TUBES for t in one.of(name)]
    found = [effort for _, effort in tries if np.isfinite(effort)]
    text = f"{one.name}: {one.of(TUBES)[0][0]:.1f} s along tubes, {len(found)} of {len(tries)} searches without"
    return text + (f", the best at {min(found) / one.ours.checked.effort:.3g} times the effort" if found else "")
