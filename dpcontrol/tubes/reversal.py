"""Connections the other way, by time reversal: a connection a → b, turned around, is a connection b → a.

With A the reverser that turns unstable tubes into stable ones, x(t) a connection on its lift and k the whole turns at
its end, y(t) = A x(-t) - A k is one on the lift that starts at b's named position. Nothing is searched again.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.tubes.connection import Connection, connection_name
from dpcontrol.tubes.connections import ConnectionSearch
from dpcontrol.tubes.cut import section_points
from dpcontrol.tubes.lyapunov import LyapunovOrbit

Array = NDArray[np.float64]


def can_be_reversed(system: System, source: str, target: str, *, section: Section | None = None) -> bool:
    """Tell whether the reverser keeps both saddles and a section, and so every search on it.

    section: the one that was searched on, None for the one between the saddles either way.
    """
    reverser = system.reversers[0]
    forward = section or system.sections.get((source, target))
    backward = section or system.sections.get((target, source))
    if forward is None or forward != backward:
        return False
    kept = all(np.allclose(reverser @ system.equilibrium(name), system.equilibrium(name)) for name in (source, target))
    normal = np.asarray(forward.normal)
    image = normal @ reverser
    # Only a section through the origin may be turned over.
    same = np.allclose(image, normal) or (np.allclose(image, -normal) and forward.offset == 0)
    sided = forward.side is None or np.allclose(np.asarray(forward.side) @ reverser, forward.side)
    return kept and bool(same) and bool(sided)


def reversed_search(search: ConnectionSearch) -> ConnectionSearch:
    """Return the search from target to source that time reversal makes of one from source to target.

    Raises:
        ValueError: the section or a saddle is not kept by the reverser (`can_be_reversed` tells).
    """
    system = search.source.system
    if not can_be_reversed(system, search.source.saddle, search.target.saddle, section=search.cuts[0].section):
        raise ValueError(f"time reversal does not keep the section from {search.source.saddle}")
    found = [_reversed(connection) for connection in search.connections]
    if found:
        section = found[0].section
        found.sort(key=lambda c: (-c.sense, *np.round(section_points(system, section, c.state), 6)))
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


def _reversed_phase(orbit: LyapunovOrbit, phase: float) -> float:
    """Return the phase of A γ(φ): orbits start on the last reverser's fixed set, half a period from the first's."""
    return ((0.5 if len(orbit.system.reversers) > 1 else 0.0) - phase) % 1.0


def _reversed(connection: Connection) -> Connection:
    orbit, source, target = connection.orbit, connection.target, connection.source
    system, section = source.system, connection.section
    reverser = system.reversers[0]
    turns = -reverser @ np.asarray(orbit.end.turns) + 0.0
    lift = turns * system.turn_lengths
    state = reverser @ connection.state + lift
    winding = tuple(int(k) for k in turns[: len(connection.winding)])
    hits = (connection.hits[1], connection.hits[0])
    # The turned-around stable end is a point of the unstable manifold, with the same phase and amplitude.
    start = replace(orbit.end, stable=False, turns=(0.0,) * system.dimension)
    end = replace(orbit.start, stable=True, turns=tuple(float(k) for k in turns))
    direction = int(np.sign(system.numeric.rate(state) @ np.asarray(section.normal)))
    entries = [k for k in winding if k]
    homoclinic = source.saddle == target.saddle
    return replace(
        connection,
        name=connection_name(system, (source.saddle, target.saddle), winding, hits, state, section),
        source=source,
        target=target,
        state=state,
        winding=winding,
        sense=int(np.sign(entries[0])) if homoclinic and entries else direction,
        hits=hits,
        time_out=connection.time_in,
        time_in=connection.time_out,
        phase_out=_reversed_phase(source, connection.phase_in),
        phase_in=_reversed_phase(target, connection.phase_out),
        orbit=replace(
            orbit,
            start=start,
            end=end,
            times=-orbit.times[::-1],
            states=orbit.states[::-1] @ reverser.T + lift,
        ),
    )
