"""Homoclinic and heteroclinic connections: where an unstable and a stable tube's cuts meet.

Intersections of the cuts are refined by multiple shooting from farther out on both local manifolds, which leaves
states good to about 1e-12; then each is described (winding, sense, symmetry, angle, flight times) and named.

A connection a → b, turned around in time, is one b → a: nothing is searched again.

The tubes of an orbit that crosses the section itself, as every rotating orbit crosses its arm's, have no first
crossing: they cross with every lap, on a curve through the orbit's own crossing that each lap stretches by λ. A search
takes the laps on which the curve has grown large; a connection that is met on several is listed once, by its state
where the other tube first (or last) crosses. It is described by the phase at which the turning orbit would run, had it
never been left (or always been joined), in [0, 1) where the connection crosses the section; its winding counts from
there, as γ(φ + 1) = γ(φ) + whole turns.

Sources: Kaheman et al. (2023), section 3; Koon, Lo, Marsden, Ross, Heteroclinic connections between periodic orbits and
resonance transitions in celestial mechanics (2000), section 4.
"""

import difflib
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import picked
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.orbits.lyapunov import LyapunovOrbit, lyapunov_orbit
from dpcontrol.orbits.manifold import HyperbolicOrbit, OrbitCurve, local_manifold
from dpcontrol.shooting.equations import Guess, ManifoldEnd, ShootingOrbit
from dpcontrol.shooting.newton import solve_shooting
from dpcontrol.tubes.connection import (
    Connection,
    can_be_reversed,
    described_connection,
    mirrored,
    named,
    reversed_in_time,
    uncertainty,
)
from dpcontrol.tubes.cut import Cut, OpenEnd, section_points, tube_cut
from dpcontrol.tubes.intersections import ConnectionSettings, Intersection, balanced, intersect_cuts

Array = NDArray[np.float64]

_TANGENT = 1e-5  # scaled: rounding that moves an intersection farther may hide the others of a bifurcation


@dataclass(frozen=True)
class ConnectionSearch:
    """All connections found between two orbits on one section, and what may hide others.

    failed: crossings of the cuts that did not converge. complete: none failed, the cuts are resolved and open only
    where nothing is hidden, closed ones cross as often one way as the other, and no two are tangent to rounding.
    """

    source: LyapunovOrbit
    target: LyapunovOrbit
    connections: tuple[Connection, ...]
    cuts: tuple[Cut, Cut]
    failed: int
    complete: bool
    status: str

    def __repr__(self) -> str:
        return f"<connections {self.source.saddle} → {self.target.saddle}: {self.status}>"

    def document(self) -> dict[str, Any]:
        """Return what `dpcontrol connect --json` prints."""
        return {
            "count": len(self.connections),
            "connections": [c.document() for c in self.connections],
            "open_cuts": [
                {"branch": f"{tube} {end.branch:+d}", **picked(end, "phase_interval", "reason")}
                for tube, end in self.open_ends
            ],
            **picked(self, "complete", "status"),
            "energy": self.source.energy,
            "from": self.source.saddle,
            "to": self.target.saddle,
            "hits": [cut.hit for cut in self.cuts],
            "section": self.cuts[0].section.name,
        }

    def named(self, name: str) -> Connection:
        """Return the connection of this name.

        Raises:
            InputError: none of those found has it; names the one most like it.
        """
        names = [c.name for c in self.connections]
        if name in names:
            return self.connections[names.index(name)]
        if not names:
            raise InputError(f"there is no connection {name!r}: the search found none ({self.status})")
        close = difflib.get_close_matches(name, names, n=1, cutoff=0.3)
        hint = f"did you mean {close[0]!r}?" if close else f"names look like {names[0]!r}"
        raise InputError(f"there is no connection {name!r} among the {len(names)} found; {hint} (quote it in a shell)")

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
    section: Section | None = None,
    settings: ConnectionSettings | None = None,
    cuts: tuple[Cut, Cut] | None = None,
    progress: Progress = no_progress,
) -> ConnectionSearch:
    """Find every connection from `source` to `target` that meets a section at `hits`: their own, or another.

    An orbit that meets the section more than once is found at each pair of hits that add up to one more than it has
    crossings: one that passes by another saddle's side and comes back has at least two.

    cuts: of the unstable tubes of source and target, where they are known already, made with the same settings (the
    stable tube's cut is its unstable one's, turned around).

    Raises:
        InputError: the orbits differ in energy, no section is known between their saddles, it is not kept by the
            target's reverser, or one of the orbits crosses it itself.
    """
    settings, began = settings or ConnectionSettings(), time.process_time()
    system = source.system

    def spent() -> float:
        """The share of the search's time that has passed."""
        return (time.process_time() - began) / settings.seconds

    section = section or system.section_between(source.saddle, target.saddle)
    if source.energy != target.energy:
        raise InputError(
            f"orbits at {source.energy:g} J and {target.energy:g} J cannot be connected: the flow keeps its energy"
        )
    if not section.kept_by(target.reverser, target.centre):
        raise InputError(
            f"the section {section.name} is not kept by the reverser about {target.saddle}, which turns the unstable "
            "tube into the stable one; choose a section that this symmetry maps onto itself"
        )
    curves = (OrbitCurve(source), OrbitCurve(target))
    for curve in curves:
        if not curve.orbit.laps and _crosses(curve, section):
            raise InputError(
                f"the orbit about {curve.orbit.saddle} itself crosses {section.name}: its tubes have no first crossing "
                "there; choose another section"
            )
    manifolds = (
        local_manifold(source, settings.distance),
        local_manifold(target, settings.distance),
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
    after_cuts = spent()

    def spent_since() -> float:
        return (spent() - after_cuts) / max(1 - after_cuts, 1e-9)

    met = intersect_cuts(system, section, manifolds, (unstable, backward), settings, spent=spent_since)
    crossings, failed, left = met.found, met.failed, met.left
    even = balanced(crossings, (unstable, backward))
    remaining = settings.seconds * (1 - spent())
    finer = replace(settings, cut=replace(settings.cut, chord=settings.cut.chord / 2), seconds=remaining)
    # A finer search takes about twice as long.
    if not even and finer.cut.chord >= settings.finest and spent() < 1 / 4:
        # Folds thinner than the chord: what one polyline cuts off, a finer one follows.
        return find_connections(source, target, hits=hits, section=section, settings=finer, progress=progress)
    found = []
    for k, crossing in enumerate(crossings):
        if spent() > 1:
            left += len(crossings) - k
            break
        progress("refining connections", 0.7 + 0.3 * k / len(crossings))
        orbit = _refined(crossing, settings)
        if not orbit.converged:
            failed += 1
            continue
        connection = described_connection(crossing, orbit, curves, settings)
        if not _known(system, connection, found, settings.same):
            found.append(connection)
            if manifolds[0].branches_are_mirrored and manifolds[1].branches_are_mirrored:
                found.append(mirrored(connection))
    if (
        hits[0] == hits[1]
        and source is target
        and can_be_reversed(system, source.saddle, source.saddle, section=section)
    ):
        for image in [reversed_in_time(connection) for connection in found if not connection.symmetric]:
            if not _known(system, image, found, settings.same):
                found.append(image)
    _sort(found)
    resolved = all(cut.resolved for cut in (unstable, backward))
    hidden = [end for cut in (unstable, backward) for end in cut.open_ends if end.hides]
    tangent = sum(uncertainty(c.transversality_angle, settings.same) > _TANGENT for c in found)
    complete = even and resolved and not (failed or left or hidden or tangent)
    count = f"{'' if complete else 'at least '}{len(found)} connections"
    status = f"{count}; unstable tube {unstable.status}; stable tube {backward.status}"
    if not even:
        status += "; closed cuts cross one way more often than the other, so crossings were missed"
        status += ": try another energy" if settings.thorough else ": search thoroughly"
    if failed:
        remedy = "try another energy" if settings.thorough else "search thoroughly, or at another energy"
        status += f"; {failed} crossings of the cuts did not converge: {remedy}"
    if left:
        status += (
            f"; {left} places were left when {settings.seconds:.0f} s of processor time were over: at an energy nearer "
            "to the saddles' tubes cross less often"
        )
    if tangent:
        status += f"; the tubes are tangent to rounding at {tangent}, so near a bifurcation that each may be several"
    if hidden:
        remedy = "try another energy" if settings.thorough else "search thoroughly"
        status += f"; the cuts are open (see open_cuts) where connections may lie: allow more time, or {remedy}"
    elif unstable.open_ends or backward.open_ends:
        status += "; the cuts are open (see open_cuts), so crossings beyond their ends belong to other hits"
    progress("connections", 1.0)
    return ConnectionSearch(source, target, tuple(found), (unstable, backward), failed, complete, status)


def _sort(found: list[Connection]) -> list[Connection]:
    """Order connections in place by sense and position on their section."""
    # Ties in the position are noise: sorting on rounded values keeps the order from run to run.
    found.sort(key=lambda c: (-c.sense, *np.round(section_points(c.source.system, c.section, c.state), 6)))
    return found


def _crosses(curve: OrbitCurve, section: Section) -> bool:
    """Whether a periodic orbit meets a section, by its samples."""
    states = np.vstack([curve.samples, curve.samples[:1]])
    return any(section.admits(states[k]) for k in np.flatnonzero(np.diff(section.sheets(states))))


def _known(system: System, connection: Connection, found: list[Connection], tolerance: float) -> bool:
    """Whether a connection was found before: pieces of scattered cuts overlap where they join."""

    def same(other: Connection) -> bool:
        flattest = min(other.transversality_angle, connection.transversality_angle)
        apart = float(system.scaled_distance(other.state, connection.state))
        return other.winding == connection.winding and apart < uncertainty(flattest, tolerance)

    return any(same(other) for other in found)


def _refined(crossing: Intersection, settings: ConnectionSettings) -> ShootingOrbit:
    """Refine by multiple shooting, over shorter segments where rounding grows too far along an unstable orbit's."""
    orbit = _shot(crossing, settings)
    for shorter in (2, 4):
        if orbit.converged:
            break
        orbit = _shot(crossing, replace(settings, segments=shorter * settings.segments))
    return orbit


def _shot(crossing: Intersection, settings: ConnectionSettings) -> ShootingOrbit:
    """Refine by multiple shooting from farther out on both manifolds; time zero is the node on the section."""
    ends, times, states = [], [], []
    for side, phase, flight in zip(crossing.sides, crossing.phases, crossing.times, strict=True):
        manifold = side.manifold
        system, period = manifold.orbit.system, manifold.orbit.period
        amplitude = manifold.amplitude(float(phase), side.branch)
        turns = crossing.turns if side.stable else np.zeros(system.dimension)
        seed_end = ManifoldEnd(manifold, side.stable, float(phase), amplitude, tuple(float(k) for k in turns))
        # Time runs from the seed to the section here, whichever way the tube flows.
        sign = -1.0 if side.stable else 1.0
        count = max(2, int(np.ceil(flight / period * settings.segments)))
        out = max(settings.lead, float(np.log(manifold.distance / settings.farthest)) / manifold.exponent)
        out = min(out, float(np.log(manifold.distance / settings.nearest)) / manifold.exponent)
        lead = np.linspace(-out * period, 0.0, max(1, int(np.ceil(out * settings.segments))) + 1)[:-1]
        along = np.linspace(0.0, flight, count + 1)
        seeds, _ = manifold.seeds(np.array([phase]), side.branch)
        flown = side.turned(system.propagator.sample(seeds[0], along)) + turns * system.turn_lengths
        times.append(sign * (np.concatenate([lead, along]) - flight))
        states.append(np.vstack([seed_end.states(sign * lead), flown]))
        ends.append(seed_end.moved(-sign * out * period))
    orbit, section = crossing.sides[0].manifold.orbit, crossing.sides[0].section
    guessed = np.concatenate([times[0], times[1][::-1][1:]])
    guess = Guess(
        system=orbit.system,
        states=np.vstack([states[0], states[1][::-1][1:]]),
        durations=np.diff(guessed),
        owners=np.zeros(len(guessed), dtype=np.intp),
        # The section itself, not where the flown crossing lies to rounding: states must not depend on how it was flown.
        markers={len(times[0]) - 1: (np.asarray(section.normal), section.level(states[0][-1]))},
        energy=orbit.energy,
        ends=(ends[0], ends[1]),
    )
    return solve_shooting(guess).orbit


def reversed_search(search: ConnectionSearch) -> ConnectionSearch:
    """Return the search from target to source that time reversal makes of one from source to target.

    Raises:
        ValueError: the section or a saddle is not kept by the reverser (`can_be_reversed` tells).
    """
    system = search.source.system
    if not can_be_reversed(system, search.source.saddle, search.target.saddle, section=search.cuts[0].section):
        raise ValueError(f"time reversal does not keep the section from {search.source.saddle}")
    found = _sort([reversed_in_time(connection) for connection in search.connections])
    unstable, stable = search.cuts[1], search.cuts[0]
    status = (
        f"{len(found)} connections, those from {search.source.saddle} to {search.target.saddle} turned around in time; "
        f"unstable tube {unstable.status}; stable tube {stable.status}"
    )
    return replace(
        search,
        source=search.target,
        target=search.source,
        connections=tuple(found),
        cuts=(unstable, stable),
        status=status,
    )


_LARGE = 0.4  # scaled distance from the orbit to which a tube has grown where its connections are sought
_PROBED = 96  # phases at which the seeds' distances are compared
_EDGE = 1e-6  # of a phase: what rounding may put on either side of a whole number


def find_lap_connections(
    source: LyapunovOrbit,
    target: LyapunovOrbit,
    *,
    section: Section,
    crossings: Sequence[int] = (),
    settings: ConnectionSettings | None = None,
    progress: Progress = no_progress,
) -> ConnectionSearch:
    """Find connections between an orbit that crosses `section` itself and one that does not, either way.

    crossings: which of the lapping tube's crossings, counted from its seeds, are searched; by default the last on which
    it has grown to a scaled distance of about 0.4. The other tube's first crossing is taken.

    Raises:
        InputError: not exactly one of the orbits crosses the section, no crossing numbers above zero, or the orbits
            differ in energy.
    """
    settings = settings or ConnectionSettings()
    lapping = [orbit for orbit in (source, target) if isinstance(orbit, HyperbolicOrbit)]
    if len(lapping) != 1:
        raise InputError(
            f"{source.saddle} and {target.saddle}: exactly one must be an orbit whose tubes cross with every lap"
        )
    each = own_crossings(lapping[0], section)
    if not each:
        raise InputError(f"{lapping[0].saddle} does not cross {section.name}: search it with find_connections")
    manifold = local_manifold(lapping[0], settings.distance)
    crossings = tuple(crossings) or (grown_crossing(lapping[0], section, settings),)
    if min(crossings) < 1:
        raise InputError(f"crossings = {list(crossings)}: must be 1 or more")
    longest = lapping[0].system.flight_periods + max(crossings) / each
    settings = replace(settings, cut=replace(settings.cut, longest=longest))
    other = tube_cut(
        local_manifold(target if lapping[0] is source else source, settings.distance), section, settings=settings.cut
    )
    found: list[Connection] = []
    search, failed, resolved = None, 0, True
    for k, crossing in enumerate(crossings):
        progress(f"tube of {lapping[0].saddle}, crossing {crossing}", k / len(crossings))
        cut = tube_cut(manifold, section, hit=crossing, settings=settings.cut)
        hits, cuts = ((crossing, 1), (cut, other)) if lapping[0] is source else ((1, crossing), (other, cut))
        search = find_connections(source, target, hits=hits, section=section, settings=settings, cuts=cuts)
        failed, resolved = failed + search.failed, resolved and cut.resolved
        for connection in search.connections:
            canonical = _canonical(connection, settings.near)
            same = (float(source.system.scaled_distance(canonical.state, c.state)) < settings.same for c in found)
            if not any(same):
                found.append(canonical)
    assert search is not None
    _sort(found)
    progress("connections", 1.0)
    listed = ", ".join(str(c) for c in crossings)
    status = f"{len(found)} connections where {lapping[0].saddle}'s tube crosses {section.name} for the {listed}. time"
    status += "; other crossings have others"
    if failed:
        status += f"; {failed} crossings of the cuts did not converge; try another energy"
    if not resolved:
        status += "; not every cut is resolved: allow less time"
    return replace(search, connections=tuple(found), failed=failed, complete=False, status=status)


def grown_crossing(orbit: HyperbolicOrbit, section: Section, settings: ConnectionSettings | None = None) -> int:
    """Return the last crossing, counted from its seeds, on which a tube has grown to a scaled distance of about 0.4."""
    settings = settings or ConnectionSettings()
    manifold, phases = local_manifold(orbit, settings.distance), np.arange(_PROBED) / _PROBED
    away = (manifold.seeds(phases, 1)[0] - manifold.frame(phases).states) / orbit.system.scale
    # Where they would otherwise meet one trajectory more than once, seeds are nearer than `distance`.
    laps = float(np.log(_LARGE / np.linalg.norm(away, axis=1).min())) / manifold.exponent
    return max(1, int(laps * own_crossings(orbit, section)))


def own_crossings(orbit: LyapunovOrbit, section: Section) -> int:
    """Return how often an orbit itself crosses a section in one period."""
    curve = OrbitCurve(orbit)
    states = np.vstack([curve.samples, curve.samples[:1] + orbit.turn])
    return sum(section.admits(states[k]) for k in np.flatnonzero(np.diff(section.sheets(states))))


def _canonical(connection: Connection, near: float) -> Connection:
    """Return a connection with the turning orbit's phase at the section in [0, 1), and all else to match."""
    source, target, orbit = connection.source, connection.target, connection.orbit
    system = source.system
    start, end, states = orbit.start, orbit.end, orbit.states
    state = connection.state
    rounds = int(np.floor(start.orbit_phase - float(orbit.times[0]) / source.period + _EDGE))
    if source.laps and rounds:
        # γ(φ) a whole number of rounds on is γ(φ - rounds), lifted: the connection starts where phases say.
        back = source.whole_turns * rounds
        start = replace(start, phase=start.phase - rounds, amplitude=start.amplitude * _sign(source) ** rounds)
        states, state = states - back * system.turn_lengths, state - back * system.turn_lengths
        end = replace(end, turns=tuple(float(k) for k in np.asarray(end.turns) - back))
    rounds = int(np.floor(end.orbit_phase - float(orbit.times[-1]) / target.period + _EDGE))
    if target.laps and rounds:
        on = target.whole_turns * rounds
        end = replace(
            end,
            phase=end.phase + rounds,
            amplitude=end.amplitude * _sign(target) ** rounds,
            turns=tuple(float(k) for k in np.asarray(end.turns) + on),
        )
    orbit = replace(orbit, ends=(start, end), states=states)
    return named(
        replace(
            connection,
            state=state,
            winding=tuple(int(k) for k in np.rint(end.turns)[: len(connection.winding)]),
            hits=_hits_since(orbit, connection, near),
            orbit=orbit,
        )
    )


def _sign(orbit: LyapunovOrbit) -> int:
    return int(np.sign(orbit.unstable_multiplier))


def _hits_since(orbit: ShootingOrbit, connection: Connection, near: float) -> tuple[int, int]:
    """Return which crossings these are, counted since the first orbit was left and until the last is joined.

    Left and joined mean a scaled distance of `near`; the seeds still lap with the periodic orbit.
    """
    section, counts = connection.section, []
    for sign, reach, orbit_end in (
        (-1.0, connection.time_out, connection.source),
        (1.0, connection.time_in, connection.target),
    ):
        if not orbit_end.laps:
            counts.append(connection.hits[0 if sign < 0 else 1])
            continue
        # The crossing at time zero lies on a node, to rounding on either side of the section.
        count = 2 + int(np.ceil(reach / orbit_end.period * 200))
        times = (np.arange(count) + 0.5) * reach / count
        counts.append(1 + int(np.count_nonzero(np.diff(section.sheets(orbit.sample(sign * times))))))
    return counts[0], counts[1]
