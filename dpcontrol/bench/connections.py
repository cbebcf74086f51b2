"""Chart of orbits and connections: seed distance, phases and tolerance against time and error.

Truth is the same orbit and the same connections in 113-bit arithmetic. A search's error is its worst connection's: the
largest scaled component between its state on the section and the true one; a search that loses one has no point.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bench.chart import Panel, Point, PrecisionChart
from dpcontrol.bench.measure import Alternative, Judged, compare, timed_in_turns
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.progress import Progress, part_of
from dpcontrol.orbits.lyapunov import ContinuationSettings, LyapunovOrbit, lyapunov_orbit
from dpcontrol.orbits.manifold import local_manifold
from dpcontrol.scenes.model import load_model
from dpcontrol.shooting.extended import refine, refine_orbit
from dpcontrol.tubes.connections import ConnectionSearch, find_connections
from dpcontrol.tubes.cut import CutSettings, tube_cut
from dpcontrol.tubes.intersections import ConnectionSettings, intersect_cuts

Array = NDArray[np.float64]

ENERGY = -0.07
THREE_BODY_ENERGY = -1.5175
ROUNDING, GAP_ROUNDING = 1e-14, 1e-13
ROUGH = "two flights"
SLOWER, WIDER = 51.0, 1e6
"""hiten 0.5.4 on L1 to L2, end to end: times this project's seconds as stored, gap wider by this at least."""


def chart(quick: bool, progress: Progress) -> PrecisionChart:
    """Return the chart of orbits and connections."""
    system = load_model("lab").system
    progress("connections: orbits", 0.0)
    orbits = orbit_panel(part_of(progress, 0.0, 0.2), quick=quick)
    progress("connections: truth in 113 bits", 0.2)
    orbit = lyapunov_orbit(system, "down-up", energy=ENERGY)
    truths = true_states(orbit, count=1 if quick else 3)
    progress("connections: searches", 0.4)
    searches = search_panel(orbit, truths, part_of(progress, 0.4, 0.9), quick=quick)
    progress("connections: three bodies", 0.9)
    return PrecisionChart(
        name="connections",
        title="Orbits and connections: time against error",
        parts=(orbits, searches, outside_panel(quick=quick)),
        reading=(
            "A mark is one setting of a search: left is faster, low is nearer to the same in 113-bit arithmetic.",
            "'two flights' stops where the tubes meet; all others refine by multiple shooting from farther out.",
            "A search that loses a connection has no mark; the JSON lists it. Hollow marks are another package's.",
        ),
        chosen=(
            "Seeds 1e-4 from the orbit, 100 phases and chords of 0.05, then multiple shooting from 3e-7: that "
            "takes the error to rounding for any seed distance, so that is chosen for finding all connections."
        ),
    )


def orbit_panel(progress: Progress, *, quick: bool) -> Panel:
    """Return the diagram of Lyapunov orbits: continuation step and tolerance against error."""
    system = load_model("lab").system
    found = lyapunov_orbit(system, "down-up", energy=ENERGY)
    truth = refine_orbit(found).state.astype(float)
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

    return compare(tried, judge, rounds=15 if quick else 45, progress=progress).titled(
        "Lyapunov orbit about down-up", "time, s", "error of the orbit, scaled", floor=ROUNDING,
        why="longer steps find other orbits near the ends of families; one orbit takes milliseconds either way",
    )  # fmt: skip


Truth = tuple[Array, Array]
"""A connection's state (N,) on the section in double, and as 113-bit arithmetic gives it."""


def true_states(orbit: LyapunovOrbit, *, count: int) -> tuple[Truth, ...]:
    """Return `count` connections of the orbit to itself, no two of them mirror images.

    Raises:
        GoalMissed: one could not be refined.
    """
    truths = []
    for connection in find_connections(orbit, orbit).connections[:count]:
        refined = refine(connection.solution)
        if not refined.converged:
            raise GoalMissed(f"{connection.name}: {refined.status}")
        truths.append((connection.state, refined.state.astype(float)))
    return tuple(truths)


def worst(orbit: LyapunovOrbit, states: Sequence[Array], truths: Sequence[Truth]) -> float:
    """Return the largest scaled error of the states that belong to `truths`; infinite if one is not among them."""
    if not len(states):
        return float("inf")
    error = max(float(np.min(orbit.system.scaled_distance(np.array(states), exact))) for _, exact in truths)
    return error if error < 0.01 else float("inf")


def search_panel(orbit: LyapunovOrbit, truths: Sequence[Truth], progress: Progress, *, quick: bool) -> Panel:
    """Return the diagram of searches: distance of the seeds, first phases, chord, tolerance."""
    base = ConnectionSettings()
    expected = len(find_connections(orbit, orbit).connections)
    distances, farthest = ((3e-3,), ()) if quick else ((3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-6), (1e-4, 1e-5, 1e-6))
    phases, chords = ((12,), (0.2,)) if quick else ((12, 25, 50, 200), (0.2, 0.1, 0.025))
    cases = [("seed distance", f"{d:.0e}", replace(base, distance=d)) for d in distances]
    cases += [("first phases", f"{n}", replace(base, cut=CutSettings(first_phases=n))) for n in phases]
    cases += [("chord", f"{c:g}", replace(base, cut=CutSettings(chord=c))) for c in chords]
    cases += [("shooting from", f"{f:.0e}", replace(base, farthest=f)) for f in farthest]

    def searched(settings: ConnectionSettings) -> list[Array]:
        return [c.state for c in find_connections(orbit, orbit, settings=settings).connections]

    tried = [Alternative(method, label, partial(searched, s)) for method, label, s in cases]
    tried.append(Alternative("chosen", "1e-4, 100, 0.05, 3e-7", partial(searched, base), default=True))
    tried += [Alternative(ROUGH, f"{d:.0e}", partial(_two_flights, orbit, d)) for d in (1e-3, 1e-4, 1e-6)]

    def judge(one: Alternative[list[Array]], states: list[Array]) -> Judged | str:
        # Two flights leave out meetings that are images of others.
        least, error = len(truths) if one.method == ROUGH else expected, worst(orbit, states, truths)
        return Judged(error) if len(states) >= least and np.isfinite(error) else f"{len(states)} of {least} found"

    return compare(tried, judge, rounds=9 if quick else 15, most=1.2 if quick else 6.0, progress=progress).titled(
        f"{expected} connections of down-up with itself", "time, s", "error of the worst, scaled", floor=ROUNDING,
        why="fewer phases or longer chords save part of the time here and lose connections at other energies",
    )  # fmt: skip


def _two_flights(orbit: LyapunovOrbit, distance: float) -> list[Array]:
    """Return the states in which cuts flown from seeds at `distance` meet, without refinement."""
    system, settings = orbit.system, ConnectionSettings(distance=distance)
    section = system.section_between(orbit.saddle, orbit.saddle)
    manifold = local_manifold(orbit, distance)
    cut = tube_cut(manifold, section, hit=1, settings=settings.cut)
    crossings = intersect_cuts(system, section, (manifold, manifold), (cut, cut), settings)
    return [crossing.states[0] for crossing in crossings.found]


def outside_panel(*, quick: bool) -> Panel:
    """Return the diagram of the three-body problem's L1-L2 connection, with hiten's point as it was stored."""
    system = load_model("three-body").system

    def ours() -> ConnectionSearch:
        first, second = (lyapunov_orbit(system, name, energy=THREE_BODY_ENERGY) for name in ("L1", "L2"))
        return find_connections(first, second, hits=(2, 2))

    run = timed_in_turns({None: ours}, 3 if quick else 7, most=0.5 if quick else 4.0, least=1)[None]
    found = run.result.connections
    gap = max(c.residual for c in found)
    note = "ratios stored by tests/benchmarks/test_against_hiten.py: of a fresh process; gap at least"
    points = (
        Point("dpcontrol", f"{len(found)} connections", run.seconds, gap, default=True, yardstick=run.yardstick),
        Point("hiten 0.5.4 (stored)", "", run.seconds * SLOWER, gap * WIDER, outside=True, stored=True, note=note),
    )
    return Panel(
        "L1 to L2 of three bodies, with the orbits", "time, s", "gap where the pieces meet", points,
        {"dpcontrol": run.start_up}, floor=GAP_ROUNDING,
    )  # fmt: skip
