"""Connections of an orbit that crosses the section itself, as every rotating orbit crosses its arm's.

Its tubes have no first crossing: they cross with every lap, on a curve through the orbit's own crossing that each lap
stretches by λ. A search takes the laps on which the curve has grown large; the same connection may be met on several,
and is told once, by its state where the other tube first (or last) crosses.

Phases of a turning orbit come with its lift: γ(φ + 1) = γ(φ) + whole turns. A connection is told with the phase at
which the turning orbit would run, had it never been left (or always been joined), in [0, 1) where the connection
crosses the section; its winding counts from there.

Source: Koon, Lo, Marsden, Ross, Heteroclinic connections between periodic orbits and resonance transitions in celestial
mechanics (2000), section 4.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.orbits.curve import HyperbolicOrbit, OrbitCurve, local_manifold
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.shooting.orbit import ShootingOrbit
from dpcontrol.tubes.connection import Connection, connection_name
from dpcontrol.tubes.connections import ConnectionSearch, find_connections
from dpcontrol.tubes.cut import section_points, tube_cut
from dpcontrol.tubes.intersections import ConnectionSettings

Array = NDArray[np.float64]

_LARGE = 0.4  # scaled distance from the orbit to which a tube has grown where its connections are sought
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
    found.sort(key=lambda c: (-c.sense, *np.round(section_points(source.system, section, c.state), 6)))
    progress("connections", 1.0)
    listed = ", ".join(str(c) for c in crossings)
    status = f"{len(found)} connections where {lapping[0].saddle}'s tube crosses {section.name} for the {listed}. time"
    status += "; other crossings have others"
    if failed:
        status += f"; {failed} crossings of the cuts did not converge: refine the chord"
    if not resolved:
        status += "; not every cut is resolved: allow less time"
    return replace(search, connections=tuple(found), failed=failed, complete=False, status=status)


def grown_crossing(orbit: HyperbolicOrbit, section: Section, settings: ConnectionSettings | None = None) -> int:
    """Return the last crossing, counted from its seeds, on which a tube has grown to a scaled distance of about 0.4."""
    settings = settings or ConnectionSettings()
    laps = np.log(_LARGE / settings.distance) / local_manifold(orbit, settings.distance).exponent
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
    winding = tuple(int(k) for k in np.rint(end.turns)[: len(connection.winding)])
    hits = _hits_since(orbit, connection, near)
    return replace(
        connection,
        name=connection_name(system, (source.saddle, target.saddle), winding, hits, state, connection.section),
        state=state,
        winding=winding,
        hits=hits,
        orbit=orbit,
    )


def _sign(orbit: LyapunovOrbit) -> int:
    return int(np.sign(orbit.unstable_multiplier))


def _hits_since(orbit: ShootingOrbit, connection: Connection, near: float) -> tuple[int, int]:
    """Return the how-manieth crossings these are since the first orbit was left, and till the last is joined.

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
