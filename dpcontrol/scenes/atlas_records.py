"""Orbits, cuts and connections of a search as the plain records of an atlas."""

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System
from dpcontrol.itineraries.atlas import (
    AtlasConnection,
    AtlasCut,
    AtlasKind,
    AtlasOrbit,
    AtlasPiece,
    AtlasRotatingOrbit,
    rotating_document,
)
from dpcontrol.tubes.connection import Connection
from dpcontrol.tubes.connections import ConnectionSearch
from dpcontrol.tubes.cut import Cut, Piece, section_points
from dpcontrol.tubes.lyapunov import LyapunovOrbit
from dpcontrol.tubes.manifold import UnstableManifold
from dpcontrol.tubes.rotating import RotatingOrbit

Array = NDArray[np.float64]

_ORBIT_SAMPLES = 256
_FLIGHT_SAMPLES = 400
_DENSE = 4
"""Times as many instants are flown as are kept."""


def orbit_record(orbit: LyapunovOrbit) -> AtlasOrbit:
    """Return the record of an orbit, sampled at 256 equally spaced phases."""
    return AtlasOrbit(
        saddle=orbit.saddle,
        family=orbit.family,
        energy=orbit.energy,
        period=orbit.period,
        state=orbit.state,
        floquet_multipliers=orbit.floquet_multipliers,
        residual=orbit.residual,
        status=orbit.status,
        samples=UnstableManifold(orbit).frame(np.arange(_ORBIT_SAMPLES) / _ORBIT_SAMPLES).states,
    )


def rotating_record(orbit: RotatingOrbit) -> AtlasRotatingOrbit:
    """Return the record of a rotating orbit, sampled at 256 equally spaced phases."""
    phases = np.arange(_ORBIT_SAMPLES) / _ORBIT_SAMPLES
    return AtlasRotatingOrbit(
        **rotating_document(orbit), samples=orbit.system.propagator.sample(orbit.state, phases * orbit.period)
    )


def cut_record(manifold: UnstableManifold, cut: Cut, strands: int, instants: int) -> AtlasCut:
    """Return the record of a cut with `strands` trajectories of each branch, each at `instants` instants."""
    flown = [strand for branch in (1, -1) for strand in _strands(manifold, cut, branch, strands, instants)]
    size = manifold.orbit.system.dimension
    return AtlasCut(
        saddle=manifold.orbit.saddle,
        section=cut.section,
        hit=cut.hit,
        pieces=tuple(_piece(manifold, cut, piece) for piece in cut.pieces),
        open_ends=tuple((end.branch, end.phase_interval, end.reason) for end in cut.open_ends),
        trajectories=cut.trajectories,
        resolved=cut.resolved,
        status=cut.status,
        strands=np.array([states for _, _, states in flown]).reshape(-1, instants, size),
        strand_branches=np.array([branch for branch, _, _ in flown], dtype=np.int64),
        strand_phases=np.array([phase for _, phase, _ in flown], dtype=float),
    )


def _strands(
    manifold: UnstableManifold, cut: Cut, branch: int, count: int, instants: int
) -> list[tuple[int, float, Array]]:
    """Return (branch, phase, states) of trajectories that reach the section, spread evenly over the phases."""
    pieces = [piece for piece in cut.pieces if piece.branch == branch]
    if not pieces:
        return []
    phases = np.concatenate([piece.phases for piece in pieces])
    times = np.concatenate([piece.times for piece in pieces])
    nearest = [int(np.argmin(np.abs((phases - k / count + 0.5) % 1 - 0.5))) for k in range(count)]
    chosen = list(dict.fromkeys(nearest))
    seeds, _ = manifold.seeds(phases[chosen], branch)
    system, flown = manifold.orbit.system, []
    for seed, k in zip(seeds, chosen, strict=True):
        dense = np.linspace(0.0, times[k], _DENSE * instants)
        states = system.propagator.sample(seed, dense)
        flown.append((branch, float(phases[k] % 1), states[_evenly(system, dense, states, instants)]))
    return flown


def _evenly(system: System, times: Array, states: Array, count: int) -> NDArray[np.int64]:
    """Return `count` of the indices of samples, spread evenly over half the time and half the scaled path."""
    path = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(states / system.scale, axis=0), axis=1))]
    along = (times - times[0]) / (times[-1] - times[0]) + path / path[-1]
    return np.rint(np.interp(np.linspace(0.0, along[-1], count), along, np.arange(len(times)))).astype(np.int64)


def _piece(manifold: UnstableManifold, cut: Cut, piece: Piece) -> AtlasPiece:
    system, centre = manifold.orbit.system, manifold.orbit.centre
    turned = (piece.states - centre) @ system.reversers[0].T + centre
    return AtlasPiece(
        branch=piece.branch,
        direction=piece.direction,
        closed=piece.closed,
        phases=piece.phases,
        points=piece.points,
        stable_points=section_points(system, cut.section, turned),
        states=piece.states,
        times=piece.times,
    )


def connection_record(connection: Connection) -> AtlasConnection:
    """Return the record of a connection with its flight."""
    orbit = connection.orbit
    system: System = orbit.system
    begin, end = float(orbit.times[0]), float(orbit.times[-1])
    # A flight that never comes within the distance that counts as joined is shown whole.
    if np.isfinite(connection.time_out):
        begin = max(begin, -connection.time_out - connection.source.period)
    if np.isfinite(connection.time_in):
        end = min(end, connection.time_in + connection.target.period)
    dense = np.linspace(begin, end, _DENSE * _FLIGHT_SAMPLES)
    flown = orbit.sample(dense)
    kept = np.unique(_evenly(system, dense, flown, _FLIGHT_SAMPLES))
    return AtlasConnection(
        name=connection.name,
        source=connection.source.saddle,
        target=connection.target.saddle,
        section=connection.section,
        state=connection.state,
        point=section_points(system, connection.section, connection.state),
        winding=connection.winding,
        sense=connection.sense,
        symmetric=connection.symmetric,
        residual=connection.residual,
        transversality_angle=connection.transversality_angle,
        hits=connection.hits,
        time_out=connection.time_out,
        time_in=connection.time_in,
        phase_out=connection.phase_out,
        phase_in=connection.phase_in,
        times=dense[kept],
        states=flown[kept],
        node_times=orbit.times,
        nodes=orbit.states,
    )


def with_kind(search: ConnectionSearch, *, by_reversal: bool) -> tuple[ConnectionSearch, AtlasKind]:
    """Return a search and how it ended."""
    source, target = search.source.saddle, search.target.saddle
    return search, AtlasKind(
        source=source,
        target=target,
        section=search.cuts[0].section.name,
        hits=(search.cuts[0].hit, search.cuts[1].hit),
        count=len(search.connections),
        failed=search.failed,
        complete=search.complete,
        open_ends=tuple((tube, end.branch, end.phase_interval, end.reason) for tube, end in search.open_ends),
        by_reversal=by_reversal,
        status=search.status,
    )


def atlas_status(
    orbits: list[LyapunovOrbit], absent: list[tuple[str, str]], kinds: tuple[AtlasKind, ...], system: System
) -> str:
    """Return one sentence on what there is, what is not, and what may be hidden."""
    count = sum(kind.count for kind in kinds)
    parts = [f"{len(orbits)} orbits, {count} connections of {len({(k.source, k.target) for k in kinds})} kinds"]
    if not system.sections:
        parts.append(f"{system.name} has no sections on which connections are sought")
    later = {(k.source, k.target): k.hits for k in kinds if k.count and k.hits != (1, 1)}
    empty = {(k.source, k.target) for k in kinds if not k.count and k.hits == (1, 1)}
    for (source, target), hits in later.items():
        if (source, target) in empty:
            parts.append(f"{source} → {target} is empty at first hits and has its first connections at {list(hits)}")
    parts += [f"{k.source} → {k.target} has none at {list(k.hits)}" for k in kinds
              if not k.count and (k.source, k.target) not in later]  # fmt: skip
    incomplete = [k for k in kinds if not k.complete]
    if incomplete:
        names = ", ".join(f"{k.source} → {k.target} at {list(k.hits)}" for k in incomplete)
        parts.append(f"cuts are open or crossings failed in {names}, so connections at these hits may be missing")
    elif kinds:
        parts.append("all cuts are closed and resolved, so none of these hits is missing down to the cuts' chord")
    parts += [reason for _, reason in absent]
    return "; ".join(parts)
