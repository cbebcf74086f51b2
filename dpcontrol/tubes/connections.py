"""Homoclinic and heteroclinic connections: where an unstable and a stable tube's cuts meet.

Intersections of the cuts are refined by multiple shooting from farther out on both local manifolds, which leaves
states good to about 1e-12; then each is described (winding, sense, symmetry, angle, flight times) and named.

Source: Kaheman et al. (2023), section 3.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root_scalar

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import Progress, no_progress
from dpcontrol.tubes.connecting_orbit import Anchor, ConnectingOrbit, ManifoldEnd, solve_connecting_orbit
from dpcontrol.tubes.cut import Cut, OpenEnd, section_points, tube_cut
from dpcontrol.tubes.intersections import ConnectionSettings, Intersection, intersect_cuts
from dpcontrol.tubes.lyapunov import LyapunovOrbit, lyapunov_orbit
from dpcontrol.tubes.manifold import UnstableManifold
from dpcontrol.tubes.orbit_curve import OrbitCurve

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Connection:
    """An orbit from one Lyapunov orbit to another (or the same).

    state (N,): its point on the section, on the lift that starts at the source saddle's named position. winding:
    whole turns of each coordinate between the source and target saddles' named positions. hits: which crossing of the
    section this is for the unstable tube forward and the stable tube backward. time_out: s from leaving the source
    orbit (scaled distance 1e-3) to the section; time_in: s from the section to the target orbit; phase_out, phase_in:
    the orbits' phases there. transversality_angle: degrees between the cuts in (q, p/p₀). residual: largest gap
    between the segments of `orbit`, whose time zero is the section.
    """

    name: str
    source: LyapunovOrbit
    target: LyapunovOrbit
    section: Section
    state: Array
    winding: tuple[int, ...]
    sense: int
    symmetric: bool
    residual: float
    transversality_angle: float
    hits: tuple[int, int]
    time_out: float
    time_in: float
    phase_out: float
    phase_in: float
    orbit: ConnectingOrbit


@dataclass(frozen=True)
class ConnectionSearch:
    """All connections found between two orbits on one section, and what may hide others.

    failed: crossings of the cuts that did not converge. complete: none failed and both cuts are closed.
    """

    source: LyapunovOrbit
    target: LyapunovOrbit
    connections: tuple[Connection, ...]
    cuts: tuple[Cut, Cut]
    failed: int
    complete: bool
    status: str

    @property
    def open_ends(self) -> tuple[tuple[str, OpenEnd], ...]:
        """Where cuts are open: (tube, end) with tube "unstable" or "stable"."""
        return tuple((name, end) for name, cut in zip(("unstable", "stable"), self.cuts, strict=True)
                     for end in cut.open_ends)  # fmt: skip


def orbits_between(system: System, source: str, target: str, energy: float) -> tuple[LyapunovOrbit, LyapunovOrbit]:
    """Return the Lyapunov orbits of both saddles at `energy`, the same one for a homoclinic search.

    Raises:
        InputError: an unknown saddle, or an energy at which one of them has no orbit.
    """
    first = lyapunov_orbit(system, source, energy=energy)
    return first, first if source == target else lyapunov_orbit(system, target, energy=energy)


def find_connections(
    source: LyapunovOrbit,
    target: LyapunovOrbit,
    *,
    hits: tuple[int, int] = (1, 1),
    settings: ConnectionSettings | None = None,
    cuts: tuple[Cut, Cut] | None = None,
    progress: Progress = no_progress,
) -> ConnectionSearch:
    """Find every connection from `source` to `target` that meets their section at `hits`.

    cuts: of the unstable tubes of source and target, where they are known already, made with the same settings (the
    stable tube's cut is its unstable one's, turned around).

    Raises:
        InputError: the orbits differ in energy, or no section is known between their saddles.
    """
    settings = settings or ConnectionSettings()
    system = source.system
    if (source.saddle, target.saddle) not in system.sections:
        raise InputError(f"{system.name} has no section between {source.saddle} and {target.saddle}")
    if source.energy != target.energy:
        raise InputError(
            f"orbits at {source.energy:g} J and {target.energy:g} J cannot be connected: the flow keeps its energy"
        )
    section = system.sections[source.saddle, target.saddle]
    manifolds = (
        UnstableManifold(source, settings.distance),
        UnstableManifold(target, settings.distance),
    )
    if cuts is None:
        progress(f"tube of {source.saddle}", 0.0)
        unstable = tube_cut(manifolds[0], section, hit=hits[0], settings=settings.cut)
        progress(f"tube of {target.saddle}", 0.4)
        same_tube = source is target and hits[0] == hits[1]
        backward = unstable if same_tube else tube_cut(manifolds[1], section, hit=hits[1], settings=settings.cut)
    else:
        unstable, backward = cuts
    progress("intersections", 0.6)
    crossings, failed = intersect_cuts(system, section, manifolds, (unstable, backward), settings)
    found = []
    curves = (OrbitCurve(source), OrbitCurve(target))
    for k, crossing in enumerate(crossings):
        progress("refining connections", 0.7 + 0.3 * k / len(crossings))
        refined = _refined(system, crossing, curves, settings)
        if not refined.orbit.converged:
            failed += 1
        elif not _known(system, refined, found, settings.same):
            found.append(refined)
            if manifolds[0].branches_are_mirrored and manifolds[1].branches_are_mirrored:
                found.append(_mirrored(refined))
    # Ties in the position are noise: sorting on rounded values keeps the order from run to run.
    found.sort(key=lambda c: (-c.sense, *np.round(section_points(system, section, c.state), 6)))
    complete = not failed and all(cut.resolved and not cut.open_ends for cut in (unstable, backward))
    unresolved = not all(cut.resolved for cut in (unstable, backward))
    count = f"{'at least ' if failed or unresolved else ''}{len(found)} connections"
    status = f"{count}; unstable tube {unstable.status}; stable tube {backward.status}"
    if failed:
        status += f"; {failed} crossings of the cuts did not converge: refine the chord"
    if unstable.open_ends or backward.open_ends:
        status += "; the cuts are open (see open_cuts), so crossings beyond their ends belong to other hits"
    progress("connections", 1.0)
    return ConnectionSearch(source, target, tuple(found), (unstable, backward), failed, complete, status)


def _known(system: System, connection: Connection, found: list[Connection], tolerance: float) -> bool:
    """Whether a connection was found before: pieces of scattered cuts overlap where they join."""
    return any(
        other.winding == connection.winding and bool(system.scaled_distance(other.state, connection.state) < tolerance)
        for other in found
    )


def _refined(
    system: System, crossing: Intersection, curves: tuple[OrbitCurve, OrbitCurve], settings: ConnectionSettings
) -> Connection:
    """Refine an intersection by multiple shooting from farther out on both manifolds, and describe it."""
    section = crossing.sides[0].section
    source, target = crossing.sides[0].manifold.orbit, crossing.sides[1].manifold.orbit
    orbit, middle = _shot(crossing, settings)
    state = orbit.states[middle]
    rate = float(system.numeric.rate(state) @ np.asarray(section.normal))
    n = system.dimension // 2
    winding = tuple(int(k) for k in crossing.turns[:n])
    entries = [k for k in winding if k]
    direction = int(np.sign(rate))
    sense = int(np.sign(entries[0])) if source.saddle == target.saddle and entries else direction
    symmetric = source.saddle == target.saddle and any(
        float(system.scaled_distance(reverser @ state, state)) < 1e-7 for reverser in system.reversers
    )
    first, second = (crossing.tangents[:, k] / np.linalg.norm(crossing.tangents[:, k]) for k in (0, 1))
    angle = np.degrees(np.arcsin(min(1.0, abs(first[0] * second[1] - first[1] * second[0]))))
    hits = (crossing.sides[0].hit, crossing.sides[1].hit)
    time_out, phase_out = _approach(orbit, curves[0], -1, settings.near)
    time_in, phase_in = _approach(orbit, curves[1], +1, settings.near)
    return Connection(
        name=connection_name(system, (source.saddle, target.saddle), winding, hits, state, section),
        source=source,
        target=target,
        section=section,
        state=state,
        winding=winding,
        sense=sense,
        symmetric=symmetric,
        residual=orbit.residual,
        transversality_angle=float(angle),
        hits=hits,
        time_out=time_out,
        time_in=time_in,
        phase_out=phase_out,
        phase_in=phase_in,
        orbit=orbit,
    )


def _shot(crossing: Intersection, settings: ConnectionSettings) -> tuple[ConnectingOrbit, int]:
    """Return the refined orbit, with time zero at the section, and the index of its node there."""
    ends, times, states = [], [], []
    for side, phase, flight in zip(crossing.sides, crossing.phases, crossing.times, strict=True):
        manifold = side.manifold
        system, period = manifold.orbit.system, manifold.orbit.period
        amplitude = side.branch * manifold.distance / float(manifold.frame(np.array([phase])).lengths[0])
        turns = crossing.turns if side.stable else np.zeros(system.dimension)
        seed_end = ManifoldEnd(manifold, side.stable, float(phase), amplitude, tuple(float(k) for k in turns))
        # Time runs from the seed to the section here, whichever way the tube flows.
        sign = -1.0 if side.stable else 1.0
        count = max(2, int(np.ceil(flight / period * settings.segments)))
        lead_count = max(1, int(np.ceil(settings.lead * settings.segments)))
        lead = np.linspace(-settings.lead * period, 0.0, lead_count + 1)[:-1]
        along = np.linspace(0.0, flight, count + 1)
        seeds, _ = manifold.seeds(np.array([phase]), side.branch)
        flown = side.turned(system.propagator.sample(seeds[0], along)) + turns * system.turn_lengths
        times.append(sign * (np.concatenate([lead, along]) - flight))
        states.append(np.vstack([seed_end.states(sign * lead), flown]))
        ends.append(seed_end.moved(-sign * settings.lead * period))
    middle = len(times[0]) - 1
    normal = crossing.sides[0].section.normal
    orbit = solve_connecting_orbit(
        crossing.sides[0].manifold.orbit.system,
        ends[0],
        ends[1],
        np.concatenate([times[0], times[1][::-1][1:]]),
        np.vstack([states[0], states[1][::-1][1:]]),
        anchor=Anchor(middle, normal, float(np.dot(normal, states[0][-1]))),
    )
    return orbit, middle


def _approach(orbit: ConnectingOrbit, curve: OrbitCurve, sign: int, near: float) -> tuple[float, float]:
    """Return (seconds, phase) from the section to the first approach within `near` of a periodic orbit.

    sign +1 looks forward in time, -1 backward; seconds are positive either way.
    """
    last = abs(orbit.times[-1] if sign > 0 else orbit.times[0])
    grid = np.linspace(0.0, last, max(2, int(np.ceil(last / curve.orbit.period * 300))))
    _, distances = curve.distances(orbit.sample(sign * grid))
    inside = np.flatnonzero(distances <= near)
    if inside.size == 0:
        return float("nan"), float("nan")
    if inside[0] == 0:
        return 0.0, float(curve.nearest(orbit.sample(np.array([0.0]))[0])[0])

    def excess(seconds: float) -> float:
        return curve.nearest(orbit.sample(np.array([sign * seconds]))[0])[1] - near

    # `nearest` minimises the largest component itself, so it never finds more than `distances` does: the first
    # approach may lie a few steps before the grid's, never after it.
    first = int(inside[0])
    while first > 1 and excess(grid[first - 1]) <= 0:
        first -= 1
    seconds = float(root_scalar(excess, bracket=(grid[first - 1], grid[first]), xtol=1e-12).root)
    return seconds, curve.nearest(orbit.sample(np.array([sign * seconds]))[0])[0]


def _mirrored(connection: Connection) -> Connection:
    """Return the image under the symmetry S that exchanges both tubes' branches: the other sense."""
    orbit, source, target = connection.orbit, connection.source, connection.target
    system = source.system
    half_turn = orbit.start.manifold.half_turn
    assert half_turn is not None
    symmetry = half_turn[0]
    lengths = np.where(np.isfinite(system.periods), system.periods, 1.0)
    # S acts about the source saddle; about the target saddle it differs by whole turns.
    shift = (source.centre - target.centre) - symmetry @ (source.centre - target.centre)
    end_turns = np.rint(symmetry @ np.asarray(orbit.end.turns) + shift / lengths) + 0.0

    def image(states: Array) -> Array:
        return (states - source.centre) @ symmetry.T + source.centre

    start = replace(orbit.start, phase=orbit.start.phase + 0.5, amplitude=-orbit.start.amplitude)
    end = replace(
        orbit.end,
        phase=orbit.end.phase + 0.5,
        amplitude=-orbit.end.amplitude,
        turns=tuple(float(k) for k in end_turns),
    )
    state = image(connection.state)
    winding = tuple(int(k) for k in end_turns[: len(connection.winding)])
    saddles = (source.saddle, target.saddle)
    return replace(
        connection,
        name=connection_name(system, saddles, winding, connection.hits, state, connection.section),
        state=state,
        winding=winding,
        sense=-connection.sense,
        phase_out=(connection.phase_out + 0.5) % 1.0,
        phase_in=(connection.phase_in + 0.5) % 1.0,
        orbit=replace(orbit, start=start, end=end, states=image(orbit.states)),
    )


def connection_name(
    system: System,
    saddles: tuple[str, str],
    winding: tuple[int, ...],
    hits: tuple[int, int],
    state: Array,
    section: Section,
) -> str:
    """Return a name made of what the connection is, not of the order in which it was found.

    Source, target, winding, hits, and its position and rate on the section to four digits.
    """
    coordinate = int(np.argmax(np.abs(section.position)))
    period = system.periods[coordinate]
    position = state[coordinate]
    if np.isfinite(period):
        position = position - np.rint(position / period) * period
    # Adding zero turns -0.0 into 0.0.
    place = ",".join(f"{round(float(v), 4) + 0.0:.4f}" for v in (position, state[coordinate + len(state) // 2]))
    turns = ",".join(str(k) for k in winding)
    return f"{saddles[0]}>{saddles[1]}[{turns}]h{hits[0]}.{hits[1]}@{place}"
