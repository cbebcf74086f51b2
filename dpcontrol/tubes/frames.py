"""Nodes and bases along orbits and connections, in doubles.

Proofs enclose the flow between sections through these nodes, in coordinates along these bases. They are choices only:
no statement rests on them.
"""

from collections.abc import Sequence

import numpy as np

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.shooting.newton import ShootingOrbit


def directions(system: System, states: Array, stms: Array, *, closed: bool, first: Array, last: Array) -> Array:
    """Return bases (K, N, N) of the nodes' sections, in doubles, in which proofs enclose the flow.

    The columns are u, s, f, w: the growing direction, the shrinking one, the flow, and one across the energy surface.
    In scaled coordinates, u, s and w are orthogonal to the flow, and u and s lie in the tangent plane of the energy
    surface.

    Args:
        system: system of the states.
        states: nodes (K, N).
        stms: state-transition matrices (K - 1, N, N), or (K, N, N) for a closed chain.
        closed: True for a closed chain.
        first: growing direction (N,) at the first node, or a guess of it for a closed chain.
        last: shrinking direction (N,) at the last node, or a guess of it for a closed chain.
    """
    scale, numeric, count = system.scale, system.numeric, len(states)
    flow = numeric.rate(states) / scale
    flow = flow / np.linalg.norm(flow, axis=1, keepdims=True)
    energy_gradient = numeric.gradient(states) * scale
    energy_gradient = energy_gradient / np.linalg.norm(energy_gradient, axis=1, keepdims=True)
    scaled = stms * scale / scale[:, None]

    def along(k: int, vector: Array) -> Array:
        """Return a scaled direction (N,) at node k without its parts along flow and energy gradient, of length one."""
        flat = vector - flow[k] * (flow[k] @ vector)
        flat = flat - energy_gradient[k] * (energy_gradient[k] @ flat)
        return np.asarray(flat / np.linalg.norm(flat))

    grows, shrinks = np.empty((count, states.shape[1])), np.empty((count, states.shape[1]))
    passes = 4 if closed else 1
    # The growing direction follows the flow forward, the shrinking one backward; several rounds let both converge.
    vector = along(0, first / scale)
    for k in range(passes * count - (not closed)):
        grows[k % count] = vector
        vector = along((k + 1) % count, scaled[k % count] @ vector)
    grows[-1 if not closed else 0] = vector
    vector = along(count - 1, last / scale)
    for k in reversed(range(passes * count - (not closed))):
        shrinks[(k + 1) % count] = vector
        vector = along(k % count, np.linalg.solve(scaled[k % count], vector))
    shrinks[0] = vector
    return np.stack([grows, shrinks, flow, energy_gradient], axis=2) * scale[:, None]


def closed_frames(system: System, states: Array, durations: Array) -> tuple[Array, Array]:
    """Return bases (K + 1, N, N) and growth factors (K, 2) along a closed orbit, for the proofs' enclosures.

    Args:
        system: system of the orbit.
        states: nodes (K, N), of which the first follows the last.
        durations: flight times (K,) from each node to the next, s.
    """
    _, stms = system.propagator.flows_with_stm(states, durations)
    start_vector = np.cos(np.arange(system.dimension) + 1.0) * system.scale
    bases = directions(system, states, stms, closed=True, first=start_vector, last=start_vector)
    bases = np.concatenate([bases, bases[:1]])
    return bases, growth(bases, stms)


def growth(bases: Array, stms: Array) -> Array:
    """Return the growth factors (K, 2) of u and s from each node to the next.

    Args:
        bases: bases (K + 1, N, N) at the nodes.
        stms: state-transition matrices (K, N, N) between the nodes.
    """
    maps = np.linalg.inv(bases[1:]) @ stms @ bases[:-1]
    return np.abs(np.stack([maps[:, 0, 0], maps[:, 1, 1]], axis=1))


def node_count(orbit: LyapunovOrbit) -> int:
    """Return the number of nodes for an orbit, between which it stretches by about two.

    Args:
        orbit: hyperbolic orbit.
    """
    return max(8, int(np.log(abs(orbit.unstable_multiplier)) / 0.75))


def orbit_nodes(orbit: LyapunovOrbit, count: int) -> tuple[Array, Array]:
    """Return nodes (K, N) of an orbit at equal times, and the durations (K,) between them, s.

    Each node is reached from the orbit's state by the shorter way, so that errors grow by the root of the multiplier
    only.

    Args:
        orbit: periodic orbit.
        count: number K of nodes.
    """
    flow, step = orbit.system.propagator.flow, orbit.period / count
    offsets = (k if 2 * k <= count else k - count for k in range(count))
    return np.array([flow(orbit.state, step * k) for k in offsets]), np.full(count, step)


def phased_times(
    orbit: ShootingOrbit, marks: Array, stops: Sequence[LyapunovOrbit], radius: float
) -> tuple[Array, int, int]:
    """Return node times (K,) along an orbit between two periodic orbits, and the periodic orbits' nodes at its ends.

    A proof encloses the flow from one periodic orbit's node to the other's, with the marks among the times. The ends
    are in phase with a node of the first and the last periodic orbit, at half the radius from it.

    Args:
        orbit: orbit with both ends on local manifolds.
        marks: times (S,) at which nodes are needed.
        stops: periodic orbits before, between and after the marks (S + 1,).
        radius: scaled distance from the orbits.
    """
    ends, steps = [], [stop.period / node_count(stop) for stop in stops]
    for end, end_time, sign in ((orbit.start, orbit.times[0], 1), (orbit.end, orbit.times[-1], -1)):
        periodic_orbit = end.manifold.orbit
        system, count = periodic_orbit.system, node_count(periodic_orbit)
        phase = end.orbit_phase
        lifted = system.propagator.flow(periodic_orbit.state, (phase % 1.0) * periodic_orbit.period)
        lifted = lifted + np.asarray(end.turns) * system.turn_lengths
        gap = np.linalg.norm((orbit.sample(np.array([end_time]))[0] - lifted) / system.scale)
        rounds = np.log(gap / (radius / 2)) / np.log(abs(periodic_orbit.unstable_multiplier))
        node = np.floor(sign * (phase - sign * rounds) * count) * sign
        ends.append((float(end_time + (node / count - phase) * periodic_orbit.period), int(node) % count))
    (start, first), (stop, last) = ends
    edges = np.array([start, *marks, stop])
    parts = [
        np.linspace(begin, finish, int(np.ceil((finish - begin) / step)) + 1)[1:]
        for begin, finish, step in zip(edges[:-1], edges[1:], steps, strict=True)
    ]
    return np.concatenate([[start], *parts]), first, last
