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
"""Energy of the orbits and connections, J."""
ROUNDING, GAP_ROUNDING = 1e-14, 1e-13
"""Errors below which results differ by rounding only, scaled: of states, and of gaps between pieces."""
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
    defaults = ContinuationSettings()
    settings = [
        ("step of the continuation", f"{step:g}", replace(defaults, step=step)) for step in (0.025, 0.05, 0.1, 0.2, 0.4)
    ]
    settings += [
        ("tolerance", f"{tolerance:.0e}", replace(defaults, tolerance=tolerance)) for tolerance in (1e-4, 1e-7, 1e-10)
    ]
    alternatives = [
        Alternative(method, label, partial(lyapunov_orbit, system, "down-up", energy=ENERGY, settings=case_settings),
                  default=case_settings == defaults)
        for method, label, case_settings in settings
    ]  # fmt: skip

    def judge(_: Alternative[LyapunovOrbit], orbit: LyapunovOrbit) -> Judged | str:
        """Return the largest scaled error of an orbit's state, or, if its search did not converge, the reason."""
        return Judged(float(np.abs((orbit.state - truth) / system.scale).max())) if orbit.converged else orbit.status

    return replace(
        compare(alternatives, judge, rounds=15 if quick else 45, progress=progress),
        title="Lyapunov orbit about down-up", x_label="time, s", y_label="error of the orbit, scaled", floor=ROUNDING,
        why="longer steps find other orbits near the ends of families; one orbit takes milliseconds either way",
    )  # fmt: skip


Truth = tuple[Array, Array]
"""A connection's state (N,) on the section in double precision and in 113-bit arithmetic."""


def true_states(orbit: LyapunovOrbit, *, count: int) -> tuple[Truth, ...]:
    """Return connections of an orbit to itself in double precision and in 113-bit arithmetic.

    Searches are judged by them. Mirror images are left out.

    Args:
        orbit: Lyapunov orbit.
        count: number of connections.
    """
    connections = find_connections(orbit, orbit).connections[:count]
    return tuple((connection.state, refine(connection.solution).state.astype(float)) for connection in connections)


def worst(orbit: LyapunovOrbit, states: Sequence[Array], truths: Sequence[Truth]) -> float:
    """Return the largest scaled error of the found states that match the true ones, infinite if one is missing.

    A true state is missing if none found is within 0.01 of it, scaled.

    Args:
        orbit: orbit of the connections.
        states: states (N,) of the found connections on the section.
        truths: true connections, of which the state in 113-bit arithmetic counts.
    """
    error = max(float(np.min(orbit.system.scaled_distance(np.array(states), exact))) for _, exact in truths)
    return error if error < 0.01 else float("inf")


def search_panel(orbit: LyapunovOrbit, truths: Sequence[Truth], progress: Progress, *, quick: bool) -> Diagram:
    """Return the diagram of connection searches: time and error by the settings of the search.

    These are the distance of the seeds, the number of first phases, the chord of the cuts, and the start of shooting.

    Args:
        orbit: orbit of the connections.
        truths: states to match.
        progress: called with a label and the completed share.
        quick: fewer settings.
    """
    defaults = ConnectionSettings()
    expected = len(find_connections(orbit, orbit).connections)
    cases = [
        ("seed distance", f"{distance:.0e}", replace(defaults, distance=distance))
        for distance in (3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-6)
    ]
    cases += [("first phases", f"{n}", replace(defaults, cut=CutSettings(first_phases=n))) for n in (12, 25, 50, 200)]
    cases += [("chord", f"{c:g}", replace(defaults, cut=CutSettings(chord=c))) for c in (0.2, 0.1, 0.025)]
    cases += [("shooting from", f"{start:.0e}", replace(defaults, farthest=start)) for start in (1e-4, 1e-5, 1e-6)]
    if quick:
        cases = [cases[k] for k in (0, 6, 10)]

    def found_states(settings: ConnectionSettings) -> list[Array]:
        """Return the states (N,) of all connections that a search with these settings finds."""
        return [c.state for c in find_connections(orbit, orbit, settings=settings).connections]

    alternatives = [
        Alternative(method, label, partial(found_states, case_settings)) for method, label, case_settings in cases
    ]
    alternatives.append(Alternative("chosen", "1e-4, 100, 0.05, 3e-7", partial(found_states, defaults), default=True))
    alternatives += [
        Alternative("two flights", f"{distance:.0e}", partial(_two_flights, orbit, distance))
        for distance in (1e-3, 1e-4, 1e-6)
    ]

    def judge(alternative: Alternative[list[Array]], states: list[Array]) -> Judged | str:
        """Return the error of the worst state, or the number of states if some are missing."""
        # Two flights omit intersections that are images of others.
        required, error = len(truths) if alternative.method == "two flights" else expected, worst(orbit, states, truths)
        return Judged(error) if len(states) >= required and np.isfinite(error) else f"{len(states)} of {required} found"

    return replace(
        compare(alternatives, judge, rounds=9 if quick else 15, most=0.4 if quick else 6.0, progress=progress),
        title=f"{expected} connections of down-up with itself", x_label="time, s",
        y_label="error of the worst, scaled", floor=ROUNDING,
        why="fewer phases or longer chords save part of the time here and lose connections at other energies",
    )  # fmt: skip


def _two_flights(orbit: LyapunovOrbit, distance: float) -> list[Array]:
    """Return the states (N,) at which the cuts of two tubes intersect, without refinement.

    Such states show the error that multiple shooting removes. `distance` is that of the seeds from the orbit.
    """
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

    def search_connections() -> ConnectionSearch:
        """Return the connections from L1 to L2, orbits included: the task for which hiten was timed."""
        first, second = (lyapunov_orbit(system, name, energy=-1.5175) for name in ("L1", "L2"))
        return find_connections(first, second, hits=(2, 2))

    def judge(_: Alternative[ConnectionSearch], search: ConnectionSearch) -> Judged:
        """Return the largest gap between the pieces of a connection, over all connections found."""
        return Judged(
            max(connection.residual for connection in search.connections), note=f"{len(search.connections)} connections"
        )

    measurement = {"rounds": 3 if quick else 7, "most": 0.5 if quick else 4.0, "least": 1}
    ours_measured = compare(
        [Alternative("dpcontrol", "", search_connections, default=True)], judge, **measurement
    ).points[0]
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
"""Label of the axis of costs."""

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
    """Return the optimisation problem that all transcriptions solve.

    It is a crossing from Down-Up to Up-Down in 5.5 s, with the lab's friction and the shadowing orbit as the guess.
    """
    model = load_model("lab")
    connections = find_connections(*orbits_between(model.system, "down-up", "up-down", 0.2)).connections
    orbit = WalkSolver(connections).solve(connections[:1], [])
    return ReferenceProblem(equations_of(model.arms, Level.CART), model.arms.base(), orbit.states, orbit.duration)


def transcribed(problem: ReferenceProblem, settings: ReferenceSettings) -> Solved:
    """Return the solution of a problem on one even mesh, from the problem's guess, without refinement of the mesh.

    Args:
        problem: problem of a reference, with its first guess.
        settings: method, interval and solver.
    """
    mesh = even_mesh(problem.duration, settings.interval)
    initial_trajectory = first_trajectory(problem, method_named(settings.method), mesh)
    return solve(problem, initial_trajectory, settings=settings, limits=problem.limits)


def method_panels(problem: ReferenceProblem, progress: Progress, *, quick: bool) -> tuple[Diagram, Diagram]:
    """Return the diagrams of error between nodes and of cost, from the same solutions.

    Args:
        problem: problem of a reference, with its first guess.
        progress: called with a label and the completed share.
        quick: fewer settings.
    """
    finest_cost = transcribed(problem, FINEST).cost
    settings = [
        ReferenceSettings(method=name, interval=interval) for name, interval in (QUICK if quick else QUICK + WHOLE)
    ]
    fatrop_cases = (("radau-7", 0.05), ("radau-5", 0.02))[: 1 if quick else 2]
    settings += [ReferenceSettings(method=name, interval=interval, solver="fatrop") for name, interval in fatrop_cases]

    def judge(_: Alternative[Solved], solved: Solved) -> Judged | str:
        """Return the largest error between nodes, with cost and iterations, or the reason of the solver's failure."""
        if not solved.succeeded:
            return solved.outcome
        measures = {"cost": solved.cost, "iterations": float(solved.iterations)}
        return Judged(float(error_between_nodes(problem, solved.trajectory).max()), measures)

    alternatives = [_alternative(problem, case_settings, transcribed) for case_settings in settings]
    diagram = compare(alternatives, judge, **_turns(quick=quick), progress=progress)
    costs = tuple(replace(point, error=abs(point.others["cost"] / finest_cost - 1)) for point in diagram.points)
    label = f"cost, off {FINEST.method} at {1e3 * FINEST.interval:g} ms, share"
    error = replace(diagram, title="one even mesh, error", x_label=TIME, y_label="error between nodes, scaled")
    return error, replace(error, title="one even mesh, cost", y_label=label, points=costs)


def _alternative(problem: ReferenceProblem, s: ReferenceSettings, find: Callable[..., Any]) -> Alternative[Any]:
    """Return a transcription as an alternative to be timed, with interval, solver and tolerance as its label.

    Args:
        problem: problem of a reference, with its first guess.
        s: settings of the transcription.
        find: function of problem and settings that solves the problem.
    """
    defaults = ReferenceSettings()
    label = f"{1e3 * s.interval:g} ms{'' if s.solver == defaults.solver else ', ' + s.solver}"
    label += "" if s.tolerance == defaults.tolerance else f", to {s.tolerance:.0e}"
    return Alternative(s.method, label, partial(find, problem, s), units=problem.duration)


def _turns(*, quick: bool) -> dict[str, Any]:
    """Return the numbers of measurements for `compare`; these programs compile nothing in their first call."""
    return {"rounds": 9, "most": 0.6 if quick else 6.0, "least": 1 if quick else 3, "starts_up": False}


def refined_panel(problem: ReferenceProblem, progress: Progress, *, quick: bool) -> Diagram:
    """Return the diagram of whole searches, which refine the mesh to the tolerance between nodes.

    Args:
        problem: problem of a reference, with its first guess.
        progress: called with a label and the completed share.
        quick: fewer settings.
    """
    defaults = ReferenceSettings()
    starts = [("radau-5", 0.02), ("radau-7", 0.05), ("radau-9", 0.09)]
    further_starts = [
        ("hermite-simpson", 0.01),
        ("radau-5", 0.05),
        ("radau-7", 0.03),
        ("gauss-6", 0.05),
        ("radau-8", 0.07),
    ]
    cases = [ReferenceSettings(method=name, interval=t) for name, t in (starts if quick else starts + further_starts)]
    cases += [replace(defaults, tolerance=t) for t in ((1e-4,) if quick else (1e-3, 1e-4))]
    cases += [] if quick else [replace(defaults, solver="fatrop")]

    def judge(_: Alternative[Reference], reference: Reference) -> Judged | str:
        """Return the largest error between nodes, or, if the search did not converge, the reason."""
        return Judged(reference.max_error_between_nodes) if reference.converged else reference.status

    alternatives = [
        replace(_alternative(problem, case_settings, find_reference), default=case_settings == defaults)
        for case_settings in cases
    ]
    return replace(
        compare(alternatives, judge, **_turns(quick=quick), progress=progress),
        title=f"mesh refined to {defaults.tolerance:.0e}",
        x_label=TIME, y_label="error between nodes, scaled", floor=defaults.tolerance,
        why="errors below the tolerance are a matter of chance; the tolerance is the requirement",
    )  # fmt: skip
