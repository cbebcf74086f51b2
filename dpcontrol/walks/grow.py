"""The theorem is iterative: an orbit that shadows a walk is itself a connection, and may be an edge of longer walks.

It leaves the walk's first orbit, joins its last, and winds by the sum of its symbols' windings. Its section is the one
of its first symbol; where it crosses that, its time is zero. Whatever lies between the first and the last symbol is
part of the flight in: the edge arrives when it comes near its last orbit after its last symbol.

Source: Kaheman et al. (2023), theorem 4.1.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System, momentum_scale
from dpcontrol.foundation.errors import InputError
from dpcontrol.orbits.curve import OrbitCurve
from dpcontrol.shooting.orbit import ShootingOrbit
from dpcontrol.tubes.connection import Connection, approach, connection_sense
from dpcontrol.tubes.intersections import ConnectionSettings
from dpcontrol.walks.shadowing import ShadowingOrbit
from dpcontrol.walks.symbols import composed

Array = NDArray[np.float64]

_FAR = 0.05  # scaled; between two stops an orbit is farther off than this, and once it has joined an orbit never again
_MIRRORED = 1e-7  # scaled; states are good to 1e-11, and orbits that nearly mirror each other are farther apart


def as_connection(orbit: ShadowingOrbit, *, settings: ConnectionSettings | None = None) -> Connection:
    """Return a converged open shadowing orbit as a connection, to be an edge of other walks.

    settings: `near`, the scaled distance at which it is said to have joined its orbits.

    Raises:
        InputError: the orbit is periodic, or has not converged.
    """
    settings = settings or ConnectionSettings()
    if orbit.periodic:
        raise InputError("a periodic orbit connects nothing: only an open walk becomes an edge of the graph")
    if not orbit.converged:
        raise InputError(f"only an orbit that has converged becomes an edge of the graph: {orbit.status}")
    first, last = orbit.connections[0], orbit.connections[-1]
    source, target, section = first.source, last.target, first.section
    system = source.system
    nodes = sorted(orbit.shot.guess.markers)
    whole = replace(orbit.orbit, times=orbit.orbit.times - orbit.symbol_times[0])
    state = whole.states[nodes[0]]
    winding = tuple(int(k) for k in orbit.offsets[-1][: len(first.winding)])
    saddles = (source.saddle, target.saddle)
    # The mirror image of an orbit starts where its original ends: at the last symbol. In between it may still differ.
    stay = float(orbit.symbol_times[-1] - orbit.symbol_times[0])
    along = whole.sample(np.linspace(0.0, stay, 1 + 16 * (len(orbit.walk) - 1)))
    symmetric = source.saddle == target.saddle and any(
        float(system.scaled_distance((along[::-1] - source.centre) @ reverser.T + source.centre, along).max())
        < _MIRRORED
        for reverser in system.reversers
    )
    time_out, phase_out = approach(whole, OrbitCurve(source), -1, settings.near)
    curve = OrbitCurve(target)
    since = _last_far(whole, curve)
    time_in, phase_in = approach(replace(whole, times=whole.times - since), curve, +1, settings.near)
    # Beyond there an orbit that crosses the section itself would count its laps.
    since_left = -time_out if source.laps else float(whole.times[0])
    till_joined = since + time_in if target.laps else float(whole.times[-1])
    hits = section_hits(whole, section, (since_left, till_joined))
    turns = ",".join(str(k) for k in winding)
    return Connection(
        name=f"{source.saddle}>{target.saddle}[{turns}]h{hits[0]}.{hits[1]}@{composed(orbit.walk, orbit.wraps)}",
        source=source,
        target=target,
        section=section,
        state=state,
        winding=winding,
        sense=connection_sense(system, saddles, winding, state, section),
        symmetric=symmetric,
        residual=orbit.residual,
        transversality_angle=transversality_angle(orbit, nodes[0]),
        hits=hits,
        time_out=time_out,
        time_in=since + time_in,
        phase_out=phase_out,
        phase_in=phase_in,
        orbit=whole,
    )


def _last_far(orbit: ShootingOrbit, curve: OrbitCurve) -> float:
    """Return the last time in s, zero or later, at which a connecting orbit is far from its last periodic orbit.

    The last symbol's own section is no such time: the symbol may be a grown edge, with stops that come after it.
    """
    last = float(orbit.times[-1])
    grid = np.linspace(0.0, last, max(2, int(np.ceil(last / curve.orbit.period * 50))))
    far = np.flatnonzero(curve.distances(orbit.sample(grid))[1] > _FAR)
    return float(grid[far[-1]]) if far.size else 0.0


def section_hits(
    orbit: ShootingOrbit, section: Section, span: tuple[float, float], *, per_segment: int = 40
) -> tuple[int, int]:
    """Return (n_u, n_s): the how-manieth crossing of the lifted section lies at time zero, forward and backward.

    span: times in s between which crossings count.
    """
    shares = np.linspace(0.0, 1.0, per_segment, endpoint=False)
    within = orbit.times[:-1, None] + np.diff(orbit.times)[:, None] * shares
    grid = np.append(within.ravel(), orbit.times[-1])
    grid = grid[(grid >= span[0]) & (grid <= span[1])]
    states = orbit.sample(grid)
    # The crossing at time zero lies on a node, to rounding on either side of the section.
    where = [k for k in np.flatnonzero(np.diff(section.sheets(states))) if section.admits(states[k])]
    spacing = float(np.diff(grid).max())
    before = sum(1 for k in where if grid[k + 1] < -spacing / 2)
    after = sum(1 for k in where if grid[k] > spacing / 2)
    return before + 1, after + 1


def transversality_angle(orbit: ShadowingOrbit, node: int) -> float:
    """Return the angle in degrees, in (q, p/p₀), at which the end orbits' manifolds cross along an open orbit.

    node: one on the first symbol's section. The unstable manifold's tangent is carried there from the first node, the
    stable one's from the last, through the segments' state-transition matrices; each draws its own neighbours in.
    """
    shot = orbit.shot
    section, system = orbit.connections[0].section, shot.guess.system
    scale = system.scale
    unstable = shot.orbit.start.point()[2] / scale
    for stm in shot.stms[:node]:
        unstable = (stm @ (unstable * scale)) / scale
        unstable = unstable / np.linalg.norm(unstable)
    stable = shot.orbit.end.point()[2] / scale
    for stm in shot.stms[node:][::-1]:
        stable = np.linalg.solve(stm, stable * scale) / scale
        stable = stable / np.linalg.norm(stable)
    tangents = [_on_section(system, section, shot.orbit.states[node], t * scale) for t in (unstable, stable)]
    first, second = (t / np.linalg.norm(t) for t in tangents)
    return float(np.degrees(np.arcsin(min(1.0, abs(first[0] * second[1] - first[1] * second[0])))))


def _on_section(system: System, section: Section, state: Array, tangent: Array) -> Array:
    """Return a tangent (N,) along the flow to the section, in its coordinates (q, p/p₀)."""
    rate, normal = system.numeric.rate(state), np.asarray(section.normal)
    across = tangent - rate * (normal @ tangent) / (normal @ rate)
    momentum = np.asarray(section.momentum) @ (system.numeric.momentum_jacobian(state) @ across)
    return np.array([np.asarray(section.position) @ across, momentum / momentum_scale(system, section)])
