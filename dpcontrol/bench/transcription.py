"""Chart of transcription: method, order, interval and solver against error between nodes, cost and time.

One crossing between two orbits is transcribed and solved, from the same first guess, once by each. The error is the one
between nodes; the cost is shown as its distance from the finest transcription's. Time includes building the program.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bench.candidates import Candidate, Judged, compare
from dpcontrol.bench.chart import Chart, Panel, Point
from dpcontrol.bench.outside import by_rockit, has_rockit
from dpcontrol.dynamics.chain import Level, equations_of
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.progress import Progress, part_of
from dpcontrol.references.find import find_reference
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import ReferenceProblem, ReferenceSettings, state_scale
from dpcontrol.references.reference import Reference
from dpcontrol.references.trajectory import Solved, error_between_nodes, first_trajectory
from dpcontrol.references.transcription import solve
from dpcontrol.scenes.model import load_model
from dpcontrol.tubes.connections import find_connections, orbits_between
from dpcontrol.walks.shadowing import WalkSolver

Array = NDArray[np.float64]
T = TypeVar("T")

TIME = "time, s per second of motion"

ENERGY = 0.2
FINEST = ("radau-10", 0.03)
QUICK = (
    ("hermite-simpson", 0.01), ("radau-5", 0.02), ("radau-7", 0.03), ("radau-7", 0.05),
    ("radau-9", 0.09),
)  # fmt: skip
WHOLE = (
    ("hermite-simpson", 0.005), ("gauss-5", 0.02), ("radau-3", 0.01), ("radau-4", 0.015), ("radau-5", 0.03),
    ("lobatto-5", 0.02), ("gauss-6", 0.05), ("radau-6", 0.03), ("gauss-7", 0.05), ("lobatto-7", 0.05),
    ("radau-8", 0.07), ("radau-9", 0.05), ("radau-10", 0.12),
)  # fmt: skip
STRETCH = 0.5
"""s: of the crossing's start, given to the other package too."""
ROCKIT = {25: (16.4, 1.32e-3), 50: (31.9, 3.28e-4), 100: (63.5, 8.16e-5), 200: (131.0, 2.04e-5)}
"""rockit 0.6.7 by its intervals: times the default's seconds, and error, as this chart measured them."""


def chart(quick: bool, progress: Progress) -> Chart:
    """Return the chart of transcription."""
    progress("transcription: the orbit to follow", 0.0)
    problem = crossing_problem()
    return Chart(
        name="transcription",
        title="Transcription: time against error between nodes, and against cost",
        panels=(
            *method_panels(problem, part_of(progress, 0.05, 0.6), quick=quick),
            refined_panel(problem, part_of(progress, 0.6, 0.85), quick=quick),
            outside_panel(problem, part_of(progress, 0.85, 1.0), quick=quick),
        ),
        reading=(
            "A mark is a method with its points on intervals of one length, built and solved once from one guess.",
            "Error between nodes: a propagator restarts at each interval and tells how far the polynomial is from it.",
            "Last diagram: the first half second, given to rockit too, which holds its input over an interval.",
        ),
        chosen=(
            "Radau with 7 points, begun on 50 ms and split where the error asks for it, IPOPT: orders beyond gain "
            "little, Hermite-Simpson needs many times the intervals, fatrop many times the time."
        ),
    )


def crossing_problem() -> ReferenceProblem:
    """Return the problem of crossing from down-up to up-down with the lab's friction, 5.5 s.

    Raises:
        GoalMissed: the connection or its orbit was not found.
    """
    model = load_model("lab")
    found = find_connections(*orbits_between(model.system, "down-up", "up-down", ENERGY)).connections
    if not found:
        raise GoalMissed("no connection from down-up to up-down was found")
    orbit = WalkSolver(found).solve(found[:1], [])
    if not orbit.converged:
        raise GoalMissed(orbit.status)
    return ReferenceProblem(equations_of(model.arms, Level.CART), model.arms.base(), orbit.sample, orbit.duration)


def transcribed(problem: ReferenceProblem, name: str, interval: float, solver: str = "ipopt") -> Solved:
    """Return the program's solution on even intervals of about `interval` s, from the problem's guess."""
    method = method_named(name)
    mesh = np.linspace(0.0, problem.duration, int(np.ceil(problem.duration / interval)) + 1)
    settings = ReferenceSettings(method=name, solver=solver, interval=interval)
    first = first_trajectory(problem, method, mesh)
    return solve(problem, first, settings=settings, limits=problem.limits)


def method_panels(problem: ReferenceProblem, progress: Progress, *, quick: bool) -> tuple[Panel, Panel]:
    """Return the diagrams of error between nodes and of cost, from the same solutions."""
    finest = transcribed(problem, *FINEST).cost
    cases = [
        ReferenceSettings(method=name, interval=interval) for name, interval in (QUICK if quick else QUICK + WHOLE)
    ]
    cases += [
        ReferenceSettings(method=name, interval=interval, solver="fatrop")
        for name, interval in (("radau-7", 0.05), ("radau-5", 0.02))[: 1 if quick else 2]
    ]

    def judge(_: Candidate[Solved], solved: Solved) -> Judged | str:
        if not solved.succeeded:
            return solved.outcome
        others = {"cost": solved.cost, "iterations": float(solved.iterations)}
        return Judged(float(error_between_nodes(problem, solved.trajectory).max()), others)

    tried = [_candidate(s, partial(transcribed, problem, s.method, s.interval, s.solver), problem) for s in cases]
    found = compare(tried, judge, **_turns(quick=quick), progress=progress)
    costs = tuple(replace(p, error=abs(p.others["cost"] / finest - 1)) for p in found.points)
    label = f"cost, off {FINEST[0]} at {1e3 * FINEST[1]:g} ms, share"
    return (
        found.panel("one even mesh: error", TIME, "error between nodes, scaled"),
        found.panel("one even mesh: cost", TIME, label, points=costs),
    )


def _candidate(s: ReferenceSettings, work: Callable[[], T], problem: ReferenceProblem) -> Candidate[T]:
    """Return a candidate named by its method, interval, solver and tolerance."""
    label = f"{1e3 * s.interval:g} ms{'' if s.solver == 'ipopt' else ', ' + s.solver}"
    label += "" if s.tolerance == ReferenceSettings().tolerance else f", to {s.tolerance:.0e}"
    return Candidate(s.method, label, work, units=problem.duration)


def _turns(*, quick: bool, quick_most: float = 1.2, most: float = 6.0) -> dict[str, Any]:
    """Return how long programs are measured, which compile nothing at first."""
    return {"rounds": 9, "most": quick_most if quick else most, "least": 2 if quick else 3, "starts_up": False}


def refined_panel(problem: ReferenceProblem, progress: Progress, *, quick: bool) -> Panel:
    """Return the diagram of whole searches, the mesh refined until the error between nodes is small enough."""
    chosen = ReferenceSettings()
    starts = (("radau-5", 0.02), ("radau-7", 0.05), ("radau-9", 0.09))
    if not quick:
        starts += (
            ("hermite-simpson", 0.01), ("radau-5", 0.05), ("radau-7", 0.03), ("gauss-6", 0.05), ("radau-8", 0.07),
        )  # fmt: skip
    cases = [ReferenceSettings(method=name, interval=interval) for name, interval in starts]
    cases += [replace(chosen, tolerance=t) for t in ((1e-4,) if quick else (1e-3, 1e-4))]
    if not quick:
        cases.append(replace(chosen, solver="fatrop"))

    def judge(_: Candidate[Reference], found: Reference) -> Judged | str:
        return Judged(found.max_error_between_nodes) if found.converged else found.status

    tried = [replace(_candidate(s, partial(find_reference, problem, s), problem), default=s == chosen) for s in cases]
    return compare(tried, judge, **_turns(quick=quick), progress=progress).panel(
        f"mesh refined to {chosen.tolerance:.0e}", TIME, "error between nodes, scaled", floor=chosen.tolerance,
        why="what the error falls to below the tolerance is chance; the tolerance is what is asked for",
    )  # fmt: skip


def outside_panel(problem: ReferenceProblem, progress: Progress, *, quick: bool) -> Panel:
    """Return the diagram of the crossing's start without weight on the guess, solved by rockit too if installed."""
    short = replace(problem, duration=STRETCH)
    settings = ReferenceSettings(pendulum_weight=0.0)
    finest = find_reference(short, replace(settings, method="radau-9", tolerance=1e-10))
    if not finest.converged:
        raise GoalMissed(finest.status)
    scale = state_scale(problem.equations.dimension, problem.limits)

    def judge(_: Candidate[tuple[Array, Array]], found: tuple[Array, Array]) -> Judged:
        times, states = found
        return Judged(float(np.abs((states - finest.state(times)) / scale).max()))

    dense = np.linspace(0.0, STRETCH, 101)

    def by_us(tolerance: float) -> tuple[Array, Array]:
        return dense, find_reference(short, replace(settings, tolerance=tolerance)).state(dense)

    tried = [
        Candidate(settings.method, f"to {t:.0e}", partial(by_us, t), default=t == ReferenceSettings().tolerance)
        for t in ((1e-4, 1e-6) if quick else (1e-3, 1e-4, 1e-6, 1e-8))
    ]
    if has_rockit():
        tried += [
            Candidate("rockit", f"{n} intervals", partial(by_rockit, short, settings, n), outside=True)
            for n in ((25,) if quick else (25, 50, 100, 200))
        ]
    points = compare(tried, judge, **_turns(quick=quick, quick_most=0.6, most=3.0), progress=progress).points
    if not has_rockit():
        ours = next(p.seconds for p in points if p.default)
        points += tuple(
            Point("rockit 0.6.7 (stored)", f"{n} intervals", ours * slower, error, outside=True, stored=True,
                  note="as measured where it was installed: pip install 'dpcontrol[bench]'")
            for n, (slower, error) in ROCKIT.items()
        )  # fmt: skip
    return Panel(
        f"the first {STRETCH:g} s, free of the guess", "time, s", "error of the states, scaled", points,
        why="interval and tolerance are chosen for whole itineraries, where the error matters",
    )  # fmt: skip
