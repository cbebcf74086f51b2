"""What tubes buy: flights found along tubes, and by direct optimisation without them.

    python tests/benchmarks/payoff.py            # minutes on two cores

Every flight is one program, regardless of the method:

    minimise ∫ u² dt      subject to  ẋ = f(x, u), the cart's limits, x(0) on one sustained orbit, x(T) on the other

It is solved at the cart level with friction, by one transcription, solver, tolerance and limit of iterations. The
methods differ in the start of the search: the orbit that shadows the tubes' connection, a smooth curve from end to end,
that curve with random waves, or the motion under random inputs. Two more start from the result of the cross-entropy
method (CEM), which shoots forward with held inputs, or of a homotopy from waves, in which the arms have virtual
accelerations v at rising prices ρ:

    minimise ∫ u² + ρ |v|² dt      subject to  ẋ = f(x, u) + (0, v, 0), the cart's limits, the ends

While v is cheap any curve between the ends is a motion, so the first program always has a solution. Each solution
starts the next. Trapezoidal collocation on an even mesh gives a first guess for the true program.

The cheapest flight of each method is computed again from textbook equations of motion, by scipy alone: every interval
from its first state, and the effort as one more state. A flight counts if no interval ends farther than `GAP` (scaled)
from the start of the next. The result is stored in `charts/payoff.json`, from which the table of the guide and the
picture `.assets/payoff.png` are made.

The settings of the other methods were tuned on flights outside the chart. Waves (0.15 to 2 rad, 3, 6 and 12 harmonics)
and inputs (0.3, 1 m/s²) used an outer turn at 0 J, eight tries each or more. CEM, waves and the homotopy's prices used
this and a crossing at 0.25 J, four tries of each setting or more.

Sources: Betts, Practical Methods for Optimal Control Using Nonlinear Programming, 3rd ed., ch. 4; Nocedal & Wright,
Numerical Optimization, 2nd ed., section 11.3; Rubinstein & Kroese, The Cross-Entropy Method (2004), ch. 5.
"""

import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from statistics import median
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import BarycentricInterpolator
from textbook import TwoArms

from dpcontrol.dynamics.chain import Level, equations_of
from dpcontrol.dynamics.compiled import Compiled, compiled_step
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.processes import in_processes, processors
from dpcontrol.plans.model import load_model
from dpcontrol.plans.pieces import walk_goal
from dpcontrol.plans.planning import on_turns
from dpcontrol.references.find import find_reference, smooth_guess
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import EndConditions, Guess, Limits, ReferenceProblem, ReferenceSettings, state_scale
from dpcontrol.references.sustained import sustained_orbit
from dpcontrol.references.trajectory import Trajectory, even_mesh, first_trajectory, times_on
from dpcontrol.references.transcription import solve
from dpcontrol.walks.edges import find_edges
from dpcontrol.walks.shadowing import WalkSolver
from dpcontrol.walks.symbols import parse_walk
from dpcontrol.walks.walks import resolve

STORE = Path(__file__).parent / "charts" / "payoff.json"
PICTURE = Path(__file__).parents[2] / ".assets" / "payoff.png"

ARMS = load_model("lab").arms
LIMITS = Limits()
SETTINGS = ReferenceSettings(pendulum_weight=0.0, cart_weight=0.0)
"""Settings of every search: the package's, except for the cost, which is the effort alone."""
GAP = 1e-4
"""Largest scaled distance between an interval's end and the next one's start."""
TUBES, STRAIGHT, WAVES, INPUTS, CEM, HOMOTOPY = (
    "along tubes", "smooth curve", "curve with waves", "random inputs", "CEM, then collocation", "homotopy from waves",
)  # fmt: skip


@cache
def flight(name: str, walk: tuple[str, ...], energy: float) -> tuple[ReferenceProblem, float]:
    """Return a walk's flight between sustained orbits, with a guess from tubes, and their processor time, s."""
    model = load_model("lab")
    began = time.process_time()
    symbols = parse_walk(walk, model.system.saddles)
    pairs = list(dict.fromkeys((s.source, s.target) for symbol in symbols for s in symbol.simple))
    edges = find_edges(model.system, energy, pairs=pairs, symbols=symbols)
    orbit = WalkSolver(edges.known).solve(resolve(walk, edges), [], lead_in=0, lead_out=0)
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
    return problem, spent


# --- Independent of the engine: the textbook's equations, scipy's integrator, effort as a state.


def motion_rate(x: Array, u: Array) -> Array:
    """Return ẋ (6, K) of two arms on a cart, for states (6, K) and accelerations (K,), by the textbook."""
    return np.array([*TwoArms(ARMS, viscous=ARMS.viscous).slope(x, u), x[5], u])


def recomputed(motion: Trajectory, ends: tuple[Array, Array], limits: Limits) -> float:
    """Return the effort of a motion by scipy, m²/s³; infinite if it has gaps, misses its ends or leaves the limits.

    All intervals run in parallel, each from its first state.
    """
    lengths, scale = np.diff(motion.mesh), state_scale(6, LIMITS)
    inputs = BarycentricInterpolator(motion.method.points, motion.inputs[..., 0].T)
    count = len(lengths)

    def rate(tau: float, flat: Array) -> Array:
        u = np.asarray(inputs(tau)).ravel()
        rows = flat.reshape(7, count)
        return (lengths * np.vstack([motion_rate(rows[:6], u), u**2])).ravel()

    first = np.vstack([motion.states[:, 0].T, np.zeros(count)])
    dense = np.linspace(0.0, 1.0, 11)
    done = solve_ivp(rate, (0.0, 1.0), first.ravel(), method="DOP853", t_eval=dense, rtol=1e-10, atol=1e-12)
    rows = done.y.reshape(7, count, -1)
    arrived = rows[:6, :, -1].T
    following = np.vstack([motion.states[1:, 0], ends[1]])
    missed = np.abs(motion.states[0, 0] - ends[0]), np.abs(arrived[-1] - ends[1])
    gap, miss = np.abs(arrived - following) / scale, np.maximum(*missed) / scale
    near = 1 + 1e-6
    inside = np.abs(rows[4]).max() <= near * limits.position and np.abs(rows[5]).max() <= near * limits.velocity
    inside &= np.abs(inputs(dense)).max() <= near * limits.acceleration
    return float(rows[6, :, -1].sum()) if inside and max(gap.max(), miss.max()) <= GAP else float("inf")


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


MESH, PRICES, ITERATIONS = 0.025, (1e-2, 1.0, 1e2), 100
"""Step of the homotopy's mesh, s, rising prices of the virtual accelerations, and solver iterations per price."""


def by_homotopy(problem: ReferenceProblem, generator: np.random.Generator) -> Trajectory:
    guess_at = with_waves(problem, generator)
    e, nx = problem.equations, problem.equations.dimension
    n, count = nx // 2 - 1, int(np.ceil(problem.duration / MESH)) + 1
    scale, h = ca.DM(state_scale(nx, problem.limits)), problem.duration / (count - 1)
    states, inputs, virtual = (ca.MX.sym(name, rows, count) for name, rows in (("x", nx), ("u", 1), ("v", n)))
    price = ca.MX.sym("price")
    z, u, v = ca.SX.sym("z", nx), ca.SX.sym("u"), ca.SX.sym("v", n)
    pushed = e.function()(scale * z, u, ca.DM(problem.parameters)) + ca.vertcat(ca.SX(n, 1), v, ca.SX(2, 1))
    rates = ca.Function("rates", [z, u, v], [pushed / scale], {"cse": True}).map(count)(states, inputs, virtual)
    defects = states[:, 1:] - states[:, :-1] - h / 2 * (rates[:, 1:] + rates[:, :-1])
    weights = ca.DM([0.5] + [1.0] * (count - 2) + [0.5]).T * h
    cost = ca.sum2(weights * (inputs**2 + price * ca.sum1(virtual**2)))
    variables = ca.vertcat(ca.vec(states), ca.vec(inputs), ca.vec(virtual))
    options = {
        "print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.max_iter": ITERATIONS,
        "ipopt.tol": 1e-6, "error_on_fail": False,
    }  # fmt: skip
    solver = ca.nlpsol("homotopy", "ipopt", {"x": variables, "p": price, "f": cost, "g": ca.vec(defects)}, options)
    times = np.linspace(0.0, problem.duration, count)
    high = np.full((count, nx), np.inf)
    high[:, -2:] = np.array([problem.limits.position, problem.limits.velocity]) / np.array(scale).ravel()[-2:]
    low = -high
    low[[0, -1]] = high[[0, -1]] = np.array(problem.end_states()) / np.array(scale).ravel()
    free = np.full(n * count, np.inf)
    bounds = [np.concatenate([box.ravel(), np.full(count, side), side * free])
              for box, side in ((low, -problem.limits.acceleration), (high, problem.limits.acceleration))]  # fmt: skip
    guess = np.hstack([guess_at(times), np.zeros((count, 2))]) / np.array(scale).ravel()
    found = np.concatenate([guess.ravel(), np.zeros((1 + n) * count)])
    for value in PRICES:
        found = np.array(solver(x0=found, p=value, lbx=bounds[0], ubx=bounds[1], lbg=0, ubg=0)["x"]).ravel()
    rows = found[: nx * count].reshape(count, nx) * np.array(scale).ravel()
    return flown(problem, rows, found[nx * count : (nx + 1) * count], h)


def searched(method: str, problem: ReferenceProblem, first: Trajectory | None = None, *, spent: float = 0.0) -> Try:
    began = time.process_time()
    if first is None:
        first = first_trajectory(problem, method_named(SETTINGS.method), even_mesh(problem.duration, SETTINGS.interval))
    solved = solve(problem, first, settings=SETTINGS, limits=problem.limits)
    spent += time.process_time() - began
    return Try(method, spent, solved.trajectory if solved.succeeded else None)


WAVE, HARMONICS = 0.5, 6
"""Standard deviation of a wave of one half period, rad; the k-th has a k-th of it."""
PUSH, KNOTS = 0.3, 12
"""Standard deviation of random inputs, m/s², linear between this number of knots."""


def with_waves(problem: ReferenceProblem, generator: np.random.Generator) -> Guess:
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
def _shot() -> Compiled:
    return compiled_step(equations_of(ARMS, Level.CART))


def shot(start: Array, inputs: Array, step: float) -> Array:
    """Return the states (K + 1, 6, S) from one start."""
    machine, (count, lanes) = _shot(), inputs.shape
    rows = np.empty((machine.size_in, lanes))
    rows[machine.slices["parameters"]] = ARMS.base()[:, None]
    rows[machine.slices["duration"]] = step
    states = np.empty((count + 1, 6, lanes))
    states[0] = start[:, None]
    for k in range(count):
        rows[machine.slices["state"]], rows[machine.slices["inputs"]] = states[k], inputs[k]
        machine(rows, states[k + 1])
    return states


def flown(problem: ReferenceProblem, states: Array, inputs: Array, step: float) -> Trajectory:
    method, mesh = method_named(SETTINGS.method), even_mesh(problem.duration, SETTINGS.interval)
    times, clock = times_on(mesh, method.support), step * np.arange(len(states))
    rows = np.stack([np.interp(times, clock, column) for column in states.T], axis=-1)
    places = np.minimum((times_on(mesh, method.points) / step).astype(int), len(inputs) - 1)
    return Trajectory(method, mesh, rows, inputs[places][..., None])


def with_inputs(problem: ReferenceProblem, generator: np.random.Generator) -> Trajectory:
    """Return the motion from the start under random inputs."""
    count = int(np.ceil(problem.duration / _STEP))
    step = problem.duration / count
    knots = generator.normal(size=KNOTS) * PUSH
    inputs = np.interp(np.arange(count) / count, np.linspace(0.0, 1.0, KNOTS), knots)
    states = shot(problem.end_states()[0], np.repeat(inputs[:, None], 8, axis=1), step)[..., 0]
    # A cart beyond the track is no start for a search.
    states[:, 4:] = 0.0
    return flown(problem, states, inputs, step)


SAMPLES, BEST, GENERATIONS = 256, 24, 80
"""Of the cross-entropy method: samples and elite of a generation, and generations."""
HOLD, SPREAD, WEIGHT = 0.1, 1.0, 1e3
"""s of an input, its standard deviation at first, m/s², and the weight of the squared scaled miss."""


def by_cem(problem: ReferenceProblem, generator: np.random.Generator) -> Trajectory:
    """Return the best motion of the cross-entropy method."""
    start, end = problem.end_states()
    holds = int(np.ceil(problem.duration / HOLD))
    each = int(np.ceil(problem.duration / holds / (2 * _STEP)))
    step, scale = problem.duration / holds / each, state_scale(6, problem.limits)
    mean, spread = np.zeros(holds), np.full(holds, SPREAD)
    best: tuple[float, Array, Array] | None = None
    for _ in range(GENERATIONS):
        inputs = mean[:, None] + spread[:, None] * generator.normal(size=(holds, SAMPLES))
        inputs = np.clip(inputs, -problem.limits.acceleration, problem.limits.acceleration)
        held_on = np.repeat(inputs, each, axis=0)
        states = shot(start, held_on, step)
        away = np.abs((states[-1] - end[:, None]) / scale[:, None])
        costs = (inputs**2).sum(0) * problem.duration / holds + WEIGHT * (away**2).sum(0)
        costs = np.where(np.isfinite(costs), costs, np.inf)
        order = np.argsort(costs)
        mean, spread = inputs[:, order[:BEST]].mean(1), inputs[:, order[:BEST]].std(1) + 1e-3
        first = int(order[0])
        if best is None or costs[first] < best[0]:
            best = float(costs[first]), states[..., first].copy(), held_on[:, first]
    assert best is not None
    return flown(problem, best[1], best[2], step)


# --- Charted flights.

FLIGHTS = (
    ("outer turn, -0.07 J", ("down-up +",), -0.07), ("outer turn, 0.1 J", ("down-up +",), 0.1),
    ("outer turn, 0.2 J", ("down-up +",), 0.2), ("inner turn, 0.2 J", ("up-down +",), 0.2),
    ("crossing, 0.2 J", ("down-up > up-down",), 0.2),
)  # fmt: skip
AS_CHEAP = 1.1
"""Multiple of the tubes' effort up to which a flight counts as equally cheap."""


@dataclass(frozen=True)
class Tries:
    """Numbers of tries for each flight: curves with waves, random inputs, CEM and homotopy."""

    waves: int = 8
    inputs: int = 3
    cem: int = 1
    homotopies: int = 3


def tries_of(problem: ReferenceProblem, seconds: float, tries: Tries, generator: np.random.Generator) -> Iterator[Try]:
    """Yield the tries of every method, that along tubes first."""
    start, end = problem.end_states()
    smooth = replace(problem, guess=smooth_guess(start[:4], end[:4], problem.duration))
    yield searched(TUBES, problem, spent=seconds)
    yield searched(STRAIGHT, smooth)
    for _ in range(tries.waves):
        yield searched(WAVES, replace(smooth, guess=with_waves(smooth, generator)))
    makers = ((INPUTS, tries.inputs, with_inputs), (CEM, tries.cem, by_cem), (HOMOTOPY, tries.homotopies, by_homotopy))
    for method, count, make in makers:
        for _ in range(count):
            began = time.process_time()
            first = make(smooth, generator)
            yield searched(method, smooth, first, spent=time.process_time() - began)


def valid_effort(problem: ReferenceProblem, tries: Sequence[Try]) -> float:
    """Return the effort of the cheapest try, refined and computed again by scipy; infinite if it is no flight."""
    motion = min(tries, key=lambda t: t.effort).motion
    fine = None if motion is None else find_reference(problem, SETTINGS, near=motion)
    if fine is None or not fine.converged:
        return float("inf")
    return recomputed(fine, problem.end_states(), problem.limits)


def compared(job: tuple[tuple[str, tuple[str, ...], float], Tries]) -> list[dict[str, Any]]:
    """Return a row for each method's tries of one flight, at its duration along tubes."""
    which, tries = job
    problem, seconds = flight(*which)
    every = list(tries_of(problem, seconds, tries, np.random.default_rng([20, *which[0].encode()])))
    rows, ours = [], float("inf")
    for method in dict.fromkeys(t.method for t in every):
        mine = [t for t in every if t.method == method]
        efforts = [t.effort for t in mine if np.isfinite(t.effort)]
        valid = valid_effort(problem, mine)
        ours = valid if method == TUBES else ours
        if not np.isfinite(ours):
            raise GoalMissed(f"{which[0]}: the flight found along tubes is not valid")
        rows.append(
            {
                "flight": which[0],
                "method": method,
                "tries": len(mine),
                "flights": len(efforts),
                "as_cheap": sum(effort <= AS_CHEAP * ours for effort in efforts),
                "seconds": sum(t.seconds for t in mine),
                "median_effort": median(efforts) / ours if efforts else None,
                "best_effort": valid / ours if np.isfinite(valid) else None,
            }
        )
    return rows


def by_method(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the sums over all flights for each method, the quickest way to a cheap flight first."""
    keys = ("tries", "flights", "as_cheap", "seconds")
    sums = [
        {"method": method} | {key: sum(row[key] for row in rows if row["method"] == method) for key in keys}
        for method in dict.fromkeys(row["method"] for row in rows)
    ]
    return sorted(sums, key=lambda s: (s["seconds"] / s["as_cheap"] if s["as_cheap"] else np.inf, -s["flights"]))


def guide_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of the guide in Markdown."""
    lines = ["| | tries | find a flight | as cheap as along tubes | one of these takes |", "|---|---|---|---|---|"]
    for s in by_method(rows):
        cheap, each = "none", ""
        if s["as_cheap"]:
            cheap, each = f"{s['as_cheap'] / s['tries']:.0%}", f"{s['seconds'] / s['as_cheap']:.2g} s"
        lines.append(f"| {s['method']} | {s['tries']} | {s['flights'] / s['tries']:.0%} | {cheap} | {each} |")
    return "\n".join(lines).replace("%", " %")


def draw(rows: Sequence[Mapping[str, Any]], picture: Path) -> None:
    """Draw the share of successful tries and the time to a flight as cheap as along tubes."""
    from matplotlib.figure import Figure

    sums = by_method(rows)[::-1]
    figure = Figure(figsize=(8, 3.4), layout="constrained")
    shares, times = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(sums))
    for key, label, height, colour in (
        ("flights", "any flight", 0.8, "#c9d3dd"),
        ("as_cheap", "as cheap as along tubes", 0.4, "#1f6f9f"),
    ):
        shares.barh(places, [100 * s[key] / s["tries"] for s in sums], height=height, color=colour, label=label)
    shares.set(yticks=places, yticklabels=[s["method"] for s in sums], xlabel="share of tries that find one, %")
    shares.legend(loc="lower right", fontsize=8)
    seconds = [s["seconds"] / s["as_cheap"] if s["as_cheap"] else 0.0 for s in sums]
    times.barh(places, seconds, height=0.4, color="#1f6f9f")
    for place, value in zip(places, seconds, strict=True):
        times.text(value, place, f" {value:.2g} s" if value else " none found", va="center", fontsize=8)
    times.set(xlabel="time to one as cheap, s of one core", xlim=(0, 1.25 * max(seconds)))
    for axes in (shares, times):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(picture, dpi=150)


def main() -> None:
    """Search all flights by all methods, store the rows, draw them and print the table."""
    jobs = [(which, Tries()) for which in FLIGHTS]
    found = in_processes(compared, jobs, processors())
    rows = [row for _, flights in sorted(found, key=lambda pair: jobs.index(pair[0])) for row in flights]
    STORE.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    draw(rows, PICTURE)
    sys.stdout.write(f"{guide_table(rows)}\n")


if __name__ == "__main__":
    main()
