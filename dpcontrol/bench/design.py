"""Charts of the design: orbits and connections; the transcription of references.

*Orbits and connections*: seed distance, phases and tolerance against time and error. Truth is the same orbit and the
same connections in 113-bit arithmetic. A search's error is that of its worst connection: the largest scaled component
between its state on the section and the true one. A search that misses one has no point.

*Transcription*: method, order, interval and solver against error between nodes, cost and time. Each transcribes and
solves one crossing between two orbits, from the same first guess. The error is the one between nodes; the cost is shown
as its distance from the finest transcription's. Time includes building the program.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from dpcontrol.bench.chart import ChartPage, Diagram, Point
from dpcontrol.bench.measure import Alternative, Judged, compare
from dpcontrol.dynamics.chain import Level, equations_of
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.progress import Progress, part_of
from dpcontrol.orbits.cut import CutSettings, tube_cut
from dpcontrol.orbits.lyapunov import ContinuationSettings, LyapunovOrbit, lyapunov_orbit
from dpcontrol.orbits.manifold import local_manifold
from dpcontrol.plans.model import load_model
from dpcontrol.references.find import find_reference
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import ReferenceProblem, ReferenceSettings
from dpcontrol.references.reference import Reference
from dpcontrol.references.trajectory import Solved, error_between_nodes, even_mesh, first_trajectory
from dpcontrol.references.transcription import solve
from dpcontrol.shooting.extended import refine, refine_orbit
from dpcontrol.tubes.connections import ConnectionSearch, find_connections, orbits_between
from dpcontrol.tubes.intersections import ConnectionSettings, intersect_cuts
from dpcontrol.walks.shadowing import WalkSolver

ENERGY = -0.07
ROUNDING, GAP_ROUNDING = 1e-14, 1e-13
SLOWER, WIDER = 51.0, 1e6
"""hiten 0.5.4 on L1 to L2, end to end: stored multiple of this package's seconds, and least ratio of the gaps."""


def connections_chart(quick: bool, progress: Progress) -> ChartPage:
    """Return the chart of orbits and connections.

    Args:
        quick: fewer settings and connections.
        progress: called with a label and the completed share.
    """
    orbits = orbit_panel(part_of(progress, 0.0, 0.2), quick=quick)
    progress("connections: truth in 113 bits", 0.2)
    orbit = lyapunov_orbit(load_model("lab").system, "down-up", energy=ENERGY)
    truths = true_states(orbit, count=1 if quick else 3)
    searches = search_panel(orbit, truths, part_of(progress, 0.4, 0.9), quick=quick)
    progress("connections: three bodies", 0.9)
    return ChartPage(
        name="connections",
        title="Orbits and connections",
        parts=(orbits, searches, three_body_panel(quick=quick)),
        reading=(
            "A mark is one setting of a search: left is faster, low is nearer to the same in 113-bit arithmetic.",
            "'two flights' stops where the tubes meet; all others refine by multiple shooting from farther out.",
            "A search that loses a connection has no mark; the JSON lists it. Hollow marks are another package's.",
        ),
        chosen=(
            "Seeds 1e-4 from the orbit, 100 phases and chords of 0.05, then multiple shooting from 3e-7. That "
            "takes the error to rounding for any seed distance, so the choice aims at finding all connections."
        ),
    )


def orbit_panel(progress: Progress, *, quick: bool) -> Diagram:
    """Return the diagram of Lyapunov orbits: error by continuation step and tolerance.

    Args:
        progress: called with a label and the completed share.
        quick: fewer settings.
    """
    system = load_model("lab").system
    truth = refine_orbit(lyapunov_orbit(system, "down-up", energy=ENERGY)).state.astype(float)
    base = ContinuationSettings()
    settings = [("step of the continuation", f"{s:g}", replace(base, step=s)) for s in (0.025, 0.05, 0.1, 0.2, 0.4)]
    settings += [("tolerance", f"{t:.0e}", replace(base, tolerance=t)) for t in (1e-4, 1e-7, 1e-10)]
    tried = [
        Alternative(method, label, partial(lyapunov_orbit, system, "down-up", energy=ENERGY, settings=chosen),
                  default=chosen == base)
        for method, label, chosen in settings
    ]  # fmt: skip

    def judge(_: Alternative[LyapunovOrbit], orbit: LyapunovOrbit) -> Judged | str:
        return Judged(float(np.abs((orbit.state - truth) / system.scale).max())) if orbit.converged else orbit.status

    return replace(
        compare(tried, judge, rounds=15 if quick else 45, progress=progress),
        title="Lyapunov orbit about down-up", x_label="time, s", y_label="error of the orbit, scaled", floor=ROUNDING,
        why="longer steps find other orbits near the ends of families; one orbit takes milliseconds either way",
    )  # fmt: skip


Truth = tuple[Array, Array]
"""A connection's state (N,) on the section in double precision and in 113-bit arithmetic."""


def true_states(orbit: LyapunovOrbit, *, count: int) -> tuple[Truth, ...]:
    """Return connections of an orbit to itself, without mirror images.

    Args:
        orbit: Lyapunov orbit.
        count: number of connections.
    """
    connections = find_connections(orbit, orbit).connections[:count]
    return tuple((connection.state, refine(connection.solution).state.astype(float)) for connection in connections)


def worst(orbit: LyapunovOrbit, states: Sequence[Array], truths: Sequence[Truth]) -> float:
    """Return the largest scaled error of matching states, infinite if one is missing.

    Args:
        orbit: orbit of the connections.
        states: states found (N,).
        truths: states to match.
    """
    error = max(float(np.min(orbit.system.scaled_distance(np.array(states), exact))) for _, exact in truths)
    return error if error < 0.01 else float("inf")


def search_panel(orbit: LyapunovOrbit, truths: Sequence[Truth], progress: Progress, *, quick: bool) -> Diagram:
    """Return time and error of connection searches by distance of the seeds, first phases, chord and tolerance.

    Args:
        orbit: orbit of the connections.
        truths: states to match.
        progress: called with a label and the completed share.
        quick: fewer settings.
    """
    base = ConnectionSettings()
    expected = len(find_connections(orbit, orbit).connections)
    cases = [("seed distance", f"{d:.0e}", replace(base, distance=d)) for d in (3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-6)]
    cases += [("first phases", f"{n}", replace(base, cut=CutSettings(first_phases=n))) for n in (12, 25, 50, 200)]
    cases += [("chord", f"{c:g}", replace(base, cut=CutSettings(chord=c))) for c in (0.2, 0.1, 0.025)]
    cases += [("shooting from", f"{f:.0e}", replace(base, farthest=f)) for f in (1e-4, 1e-5, 1e-6)]
    if quick:
        cases = [cases[k] for k in (0, 6, 10)]

    def searched(settings: ConnectionSettings) -> list[Array]:
        return [c.state for c in find_connections(orbit, orbit, settings=settings).connections]

    tried = [Alternative(method, label, partial(searched, s)) for method, label, s in cases]
    tried.append(Alternative("chosen", "1e-4, 100, 0.05, 3e-7", partial(searched, base), default=True))
    tried += [Alternative("two flights", f"{d:.0e}", partial(_two_flights, orbit, d)) for d in (1e-3, 1e-4, 1e-6)]

    def judge(alternative: Alternative[list[Array]], states: list[Array]) -> Judged | str:
        # Two flights omit intersections that are images of others.
        least, error = len(truths) if alternative.method == "two flights" else expected, worst(orbit, states, truths)
        return Judged(error) if len(states) >= least and np.isfinite(error) else f"{len(states)} of {least} found"

    return replace(
        compare(tried, judge, rounds=9 if quick else 15, most=0.4 if quick else 6.0, progress=progress),
        title=f"{expected} connections of down-up with itself", x_label="time, s",
        y_label="error of the worst, scaled", floor=ROUNDING,
        why="fewer phases or longer chords save part of the time here and lose connections at other energies",
    )  # fmt: skip


def _two_flights(orbit: LyapunovOrbit, distance: float) -> list[Array]:
    """Return the states at the unrefined intersections of cuts whose seeds are at `distance`."""
    system, settings = orbit.system, ConnectionSettings(distance=distance)
    section = system.section_between(orbit.saddle, orbit.saddle)
    manifold = local_manifold(orbit, distance)
    cut = tube_cut(manifold, section, hit=1, settings=settings.cut)
    crossings = intersect_cuts(system, section, (manifold, manifold), (cut, cut), settings)
    return [crossing.states[0] for crossing in crossings.found]


def three_body_panel(*, quick: bool) -> Diagram:
    """Return the diagram of the three-body problem's L1-L2 connection, with hiten's stored point.

    Args:
        quick: fewer repetitions.
    """
    system = load_model("three-body").system

    def ours() -> ConnectionSearch:
        first, second = (lyapunov_orbit(system, name, energy=-1.5175) for name in ("L1", "L2"))
        return find_connections(first, second, hits=(2, 2))

    def judge(_: Alternative[ConnectionSearch], search: ConnectionSearch) -> Judged:
        return Judged(max(c.residual for c in search.connections), note=f"{len(search.connections)} connections")

    turns = {"rounds": 3 if quick else 7, "most": 0.5 if quick else 4.0, "least": 1}
    ours_measured = compare([Alternative("dpcontrol", "", ours, default=True)], judge, **turns).points[0]
    note = "ratios stored by tests/benchmarks/test_against_hiten.py: of a fresh process; gap at least"
    stored = Point(
        "hiten 0.5.4 (stored)",
        "",
        ours_measured.seconds * SLOWER,
        ours_measured.error * WIDER,
        outside=True,
        stored=True,
        note=note,
    )
    return Diagram(
        "L1 to L2 of three bodies, with the orbits",
        "time, s",
        "gap where the pieces meet",
        (ours_measured, stored),
        floor=GAP_ROUNDING,
    )


TIME = "time for a second of motion, s"

FINEST = ReferenceSettings(method="radau-10", interval=0.03)
QUICK = (
    ("hermite-simpson", 0.01), ("radau-5", 0.02), ("radau-7", 0.03), ("radau-7", 0.05),
    ("radau-9", 0.09),
)  # fmt: skip
WHOLE = (
    ("hermite-simpson", 0.005), ("gauss-5", 0.02), ("radau-3", 0.01), ("radau-4", 0.015), ("radau-5", 0.03),
    ("lobatto-5", 0.02), ("gauss-6", 0.05), ("radau-6", 0.03), ("gauss-7", 0.05), ("lobatto-7", 0.05),
    ("radau-8", 0.07), ("radau-9", 0.05), ("radau-10", 0.12),
)  # fmt: skip


def transcription_chart(quick: bool, progress: Progress) -> ChartPage:
    """Return diagrams of collocation: time against error and cost.

    Args:
        quick: fewer settings.
        progress: called with a label and the completed share.
    """
    progress("transcription: the orbit to follow", 0.0)
    problem = crossing_problem()
    return ChartPage(
        name="transcription",
        title="Transcription",
        parts=(
            *method_panels(problem, part_of(progress, 0.05, 0.7), quick=quick),
            refined_panel(problem, part_of(progress, 0.7, 1.0), quick=quick),
        ),
        reading=(
            "A mark is a method with its points on intervals of one length, built and solved once from one guess.",
            "Error between nodes: a propagator restarts at each interval and measures the polynomial's error.",
            "Last diagram: the mesh is refined until the error between nodes is below the tolerance.",
        ),
        chosen=(
            "Radau with 7 points, begun on 50 ms and split according to the error, IPOPT: higher orders gain "
            "little, Hermite-Simpson needs many times the intervals, fatrop many times the time."
        ),
    )


def crossing_problem() -> ReferenceProblem:
    """Return the problem of crossing from down-up to up-down in 5.5 s with the lab's friction."""
    model = load_model("lab")
    connections = find_connections(*orbits_between(model.system, "down-up", "up-down", 0.2)).connections
    orbit = WalkSolver(connections).solve(connections[:1], [])
    return ReferenceProblem(equations_of(model.arms, Level.CART), model.arms.base(), orbit.states, orbit.duration)


def transcribed(problem: ReferenceProblem, settings: ReferenceSettings) -> Solved:
    """Return the program's solution from the problem's guess, on one even mesh.

    Args:
        problem: problem with a guess.
        settings: method, interval and solver.
    """
    mesh = even_mesh(problem.duration, settings.interval)
    first = first_trajectory(problem, method_named(settings.method), mesh)
    return solve(problem, first, settings=settings, limits=problem.limits)


def method_panels(problem: ReferenceProblem, progress: Progress, *, quick: bool) -> tuple[Diagram, Diagram]:
    """Return the diagrams of error between nodes and of cost, from the same solutions.

    Args:
        problem: problem with a guess.
        progress: called with a label and the completed share.
        quick: fewer settings.
    """
    finest = transcribed(problem, FINEST).cost
    settings = [ReferenceSettings(method=name, interval=t) for name, t in (QUICK if quick else QUICK + WHOLE)]
    further = (("radau-7", 0.05), ("radau-5", 0.02))[: 1 if quick else 2]
    settings += [ReferenceSettings(method=name, interval=t, solver="fatrop") for name, t in further]

    def judge(_: Alternative[Solved], solved: Solved) -> Judged | str:
        if not solved.succeeded:
            return solved.outcome
        measures = {"cost": solved.cost, "iterations": float(solved.iterations)}
        return Judged(float(error_between_nodes(problem, solved.trajectory).max()), measures)

    tried = [_alternative(problem, s, transcribed) for s in settings]
    diagram = compare(tried, judge, **_turns(quick=quick), progress=progress)
    costs = tuple(replace(p, error=abs(p.others["cost"] / finest - 1)) for p in diagram.points)
    label = f"cost, off {FINEST.method} at {1e3 * FINEST.interval:g} ms, share"
    error = replace(diagram, title="one even mesh, error", x_label=TIME, y_label="error between nodes, scaled")
    return error, replace(error, title="one even mesh, cost", y_label=label, points=costs)


def _alternative(problem: ReferenceProblem, s: ReferenceSettings, find: Callable[..., Any]) -> Alternative[Any]:
    """Return settings with the work that solves the problem by them."""
    chosen = ReferenceSettings()
    label = f"{1e3 * s.interval:g} ms{'' if s.solver == chosen.solver else ', ' + s.solver}"
    label += "" if s.tolerance == chosen.tolerance else f", to {s.tolerance:.0e}"
    return Alternative(s.method, label, partial(find, problem, s), units=problem.duration)


def _turns(*, quick: bool) -> dict[str, Any]:
    """Return measurement settings for programs, which compile nothing at first."""
    return {"rounds": 9, "most": 0.6 if quick else 6.0, "least": 1 if quick else 3, "starts_up": False}


def refined_panel(problem: ReferenceProblem, progress: Progress, *, quick: bool) -> Diagram:
    """Return the diagram of whole searches, which refine the mesh to the tolerance between nodes.

    Args:
        problem: problem with a guess.
        progress: called with a label and the completed share.
        quick: fewer settings.
    """
    chosen = ReferenceSettings()
    starts = [("radau-5", 0.02), ("radau-7", 0.05), ("radau-9", 0.09)]
    more = [("hermite-simpson", 0.01), ("radau-5", 0.05), ("radau-7", 0.03), ("gauss-6", 0.05), ("radau-8", 0.07)]
    cases = [ReferenceSettings(method=name, interval=t) for name, t in (starts if quick else starts + more)]
    cases += [replace(chosen, tolerance=t) for t in ((1e-4,) if quick else (1e-3, 1e-4))]
    cases += [] if quick else [replace(chosen, solver="fatrop")]

    def judge(_: Alternative[Reference], reference: Reference) -> Judged | str:
        return Judged(reference.max_error_between_nodes) if reference.converged else reference.status

    tried = [replace(_alternative(problem, s, find_reference), default=s == chosen) for s in cases]
    return replace(
        compare(tried, judge, **_turns(quick=quick), progress=progress),
        title=f"mesh refined to {chosen.tolerance:.0e}",
        x_label=TIME, y_label="error between nodes, scaled", floor=chosen.tolerance,
        why="errors below the tolerance are a matter of chance; the tolerance is the requirement",
    )  # fmt: skip
