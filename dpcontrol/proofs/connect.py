"""Links between periodic orbits as chains of boxes, and the angles of connections.

Boxes are chosen in doubles, and module covering states what covering relations between them prove. Around an orbit,
widths follow the stretching between its nodes. Along a connection or an open walk, they grow from a quarter of the
first orbit's box towards the last orbit's box. The manifolds' tangents lie in the propagated cones. If the cones are
disjoint, the connection is transversal and they enclose its angle.

All connections of one orbit leave and join the same boxes, so every walk on a graph is a path along covering relations.
A few enclosures per connection suffice for all sequences, with explicit numbers of rounds. A Newton–Kantorovich bound
uniform over sequences would need the same enclosures.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from dpcontrol.dynamics.system import System, momentum_scale
from dpcontrol.foundation.arrays import Array
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.proofs.balls import Fraction, ball, flint, folded
from dpcontrol.proofs.charts import Leg, SectionChart, Surface, passage, segment
from dpcontrol.proofs.covering import CoveringLink, Enclosure, OrbitBoxes, backward, forward
from dpcontrol.proofs.flow import FlowSettings
from dpcontrol.proofs.symbols import described, dot, period_of
from dpcontrol.shooting.newton import ShootingOrbit
from dpcontrol.tubes.connections import Connection
from dpcontrol.tubes.frames import closed_frames, directions, growth, node_count, orbit_nodes, phased_times
from dpcontrol.walks.shadowing import ShadowingOrbit, phase_gap

_KEPT = 0.95
"""Width of the next box relative to the stretched width of a box."""


@dataclass(frozen=True)
class Route:
    """A computed orbit from one periodic orbit to another one, along one connection or several.

    Attributes:
        times (S,): section crossings of its symbols, s.
        offsets (S + 1, N): whole turns of each symbol and of the final orbit.
        wraps (S - 1,): wraps at its stops, or (S,) for a closed walk.
    """

    name: str
    orbit: ShootingOrbit
    connections: tuple[Connection, ...]
    times: Array
    offsets: Array
    wraps: tuple[int, ...]

    @classmethod
    def of(cls, flight: Connection | ShadowingOrbit) -> "Route":
        """Return the route of a connection or of a walk.

        Args:
            flight: computed connection or walk.
        """
        if isinstance(flight, ShadowingOrbit):
            name = ", ".join(flight.walk)
            return cls(name, flight.orbit, flight.connections, flight.symbol_times, flight.offsets, flight.wraps)
        turns = np.array([np.zeros(len(flight.state)), flight.orbit.end.turns])
        return cls(flight.name, flight.orbit, (flight,), np.zeros(1), turns, ())

    @property
    def stops(self) -> list[LyapunovOrbit]:
        """The periodic orbits that it leaves, passes and approaches."""
        return [self.connections[0].source, *(connection.target for connection in self.connections)]

    def claims(
        self, segments: Sequence[Sequence[int]], nodes: Sequence[int], rivals: Sequence[Connection] | None
    ) -> list[dict[str, Any]]:
        """Return the claims on each symbol that a certificate states and `check_symbols` proves.

        Each has its section, the segments from the middle of one stop to the middle of the next, and the marked node.
        Saddles are lifted by whole turns. If a stop had no wraps, it would last for `rest` s between marked nodes.

        Args:
            segments: first and last segment of each symbol (S, 2).
            nodes: marked nodes (S,).
            rivals: connections that the orbit must not follow, None if its nearest connection is not claimed.
        """
        claims = []
        for k, connection in enumerate(self.connections):
            rivals_of_kind = [
                rival for rival in rivals or () if _kind(rival) == _kind(connection) and rival.name != connection.name
            ]
            claimed_connections = () if rivals is None else (connection, *rivals_of_kind)
            claim = {
                "section": described(connection.section),
                "hits": [int(v) for v in connection.hits],
                "segments": [int(v) for v in segments[k]],
                "node": int(nodes[k]),
                "turns": [int(v) for v in self.offsets[k]],
                "states": [[repr(float(v)) for v in rival.state] for rival in claimed_connections],
                "stop": [repr(float(v)) for v in connection.target.centre],
                "stop_turns": [int(v) for v in self.offsets[k + 1]],
            }
            if k < len(self.wraps):
                next_connection, period = self.connections[(k + 1) % len(self.connections)], connection.target.period
                time_without_wraps = (
                    connection.time_in + next_connection.time_out + phase_gap(connection, next_connection) * period
                )
                claim |= {
                    "wraps": int(self.wraps[k]),
                    "period": repr(float(period)),
                    "rest": repr(float(time_without_wraps)),
                }
            claims.append(claim)
        return claims


def _kind(connection: Connection) -> tuple[Any, ...]:
    """Return the properties that a connection shares with its rivals: source, target, winding and section."""
    return connection.source.saddle, connection.target.saddle, connection.winding, connection.section


def _charts(states: Array, bases: Array, tilts: Array | None) -> list[dict[str, Any]]:
    """Return charts as decimals, from nodes (K, N), bases (K, N, N) and tilts (K, 2); one energy needs none."""
    charts = [{"node": _decimals(state), "basis": _decimals(basis)} for state, basis in zip(states, bases, strict=True)]
    if tilts is None:
        return charts
    return [chart | {"tilt": _decimals(tilt)} for chart, tilt in zip(charts, tilts, strict=True)]


def _tilts(system: System, states: Array, bases: Array, stms: Array, ends: tuple[float, float] | None = None) -> Array:
    """Return the change (K, 2) with the energy of an orbit's coordinates y at its nodes, in doubles.

    Boxes of an interval of energies move by it. The coordinates y_1 along u (growing) and y_2 along s (shrinking) are
    those of the nodes' charts, and z is that along w, in which the energy changes. A closed orbit has as many
    state-transition matrices as nodes. Another orbit starts with the s and ends with the u of `ends`.

    Args:
        system: system of the orbit.
        states: nodes (K, N).
        bases: bases u, s, f, w of the charts (K, N, N).
        stms: state-transition matrices from node to node, (K, N, N) or (K - 1, N, N).
        ends: for an open orbit, change of s at its first and of u at its last node.
    """
    count = len(states)
    chart_maps = np.linalg.inv(np.roll(bases, -1, axis=0)[: len(stms)]) @ stms @ bases[: len(stms)]
    slopes = np.einsum("kn,knm->km", system.numeric.gradient(states), bases)[: len(stms)]
    # Coordinate z follows from the energy: z = (1 - H_u y_1 - H_s y_2) / H_w.
    # H_u, H_s and H_w are the derivatives of the energy along u, s and w.
    energy_shifts = chart_maps[:, :2, 3] / slopes[:, 3:]
    plane_maps = chart_maps[:, :2, :2] - energy_shifts[:, :, None] * slopes[:, None, :2]
    # Each tilt follows from the one before: tilt_{k+1} - plane_map_k tilt_k = energy_shift_k.
    matrix, right_side = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
    for k, (plane_map, energy_shift) in enumerate(zip(plane_maps, energy_shifts, strict=True)):
        rows, next_columns = slice(2 * k, 2 * k + 2), 2 * ((k + 1) % count)
        matrix[rows, rows] -= plane_map
        matrix[rows, next_columns : next_columns + 2] += np.eye(2)
        right_side[rows] = energy_shift
    if ends is not None:
        matrix[-2, 1] = matrix[-1, -2] = 1.0
        right_side[-2:] = ends
    return np.asarray(np.linalg.solve(matrix, right_side), dtype=float).reshape(count, 2)


def chart_of(data: Any) -> SectionChart:
    """Return the chart that a certificate holds as decimals.

    Args:
        data: node (N,) and basis (N, N).
    """
    return SectionChart(
        tuple(Fraction(v) for v in data["node"]),
        tuple(tuple(Fraction(v) for v in row) for row in data["basis"]),
        tuple(Fraction(v) for v in data.get("tilt", "00")),
    )


def enclosure_of(surface: Surface, scale: Array, settings: FlowSettings) -> Enclosure:
    """Return the enclosures that a search for proofs uses, by the integrator of module flow.

    Args:
        surface: energy surface.
        scale: units of states (N,).
        settings: settings of the integrator.
    """

    def enclosed(charts: Sequence[Any], widths: Any, duration: Fraction, turns: Sequence[int]) -> Any:
        """Enclose the map between two charts, given as decimals, over boxes about their nodes; see `segment`.

        `widths` (2, 2) holds the boxes' half-widths, `duration` the flight time, s, and `turns` (N,) the whole turns by
        which the second chart is shifted.
        """
        first, second = map(chart_of, charts)
        return segment(surface, Leg(first, second, duration, tuple(turns)), widths[0], widths[1], settings)

    return Enclosure(enclosed, surface.field.rates, surface.turns, [ball(v) for v in scale])


def orbit_data(orbit: LyapunovOrbit, radius: float, *, tilted: bool) -> dict[str, Any]:
    """Return charts, half-widths and durations of boxes around a periodic orbit, each of which must cover the next one.

    A chart is a node of the orbit with the basis of the section through it. A box covers the next one if its image
    under the flow is longer than it in the growing direction and narrower in the shrinking one.

    Args:
        orbit: periodic orbit.
        radius: largest half-width of the boxes, in the charts' coordinates.
        tilted: True if boxes move with the energy.
    """
    system = orbit.system
    states, durations = orbit_nodes(orbit, node_count(orbit))
    bases, rates = closed_frames(system, states, durations)
    stms = system.propagator.flows_with_stm(states, durations)[1]
    tilts = _tilts(system, states, bases[:-1], stms) if tilted else None
    # The widths follow the stretching, up to a constant factor per leg.
    relative_rates = rates / np.exp(np.log(rates).mean(axis=0))
    widths = np.concatenate([np.ones((1, 2)), np.cumprod(relative_rates, axis=0)[:-1]])
    return {
        "charts": _charts(states, bases[:-1], tilts),
        "widths": _decimals(radius * widths / widths.max(axis=0)),
        "durations": _decimals(durations),
    }


def _decimals(values: Array) -> Any:
    """Return doubles as decimals, in lists of the same shape."""
    return [_decimals(value) for value in values] if np.ndim(values) else repr(float(values))


def link_data(
    route: Route, ends: Sequence[int], orbits: Sequence[Any], radius: float, rivals: Sequence[Connection] | None = None
) -> dict[str, Any]:
    """Return charts, half-widths, durations and claims of boxes along a route, each of which must cover the next one.

    Args:
        route: computed orbit.
        ends: index of the first and of the last orbit.
        orbits: numbers of all orbits, see `orbit_data`.
        radius: largest half-width of the boxes.
        rivals: connections that the orbit must not follow, None without such a claim.

    Returns:
        The numbers from which `proved_link` proves the link. The boxes lie between box `leaves` of the source orbit and
            box `joins` of the target orbit.
    """
    system, stops, (source, target) = route.orbit.system, route.stops, (orbits[k] for k in ends)
    # The route's first and last nodes have the phases of boxes `first` and `last` of its two orbits.
    times, first, last = phased_times(route.orbit, route.times, stops, radius)
    states, durations = route.orbit.sample(times), np.diff(times)
    marks = [int(k) for k in np.searchsorted(times, route.times)]
    _, stms = system.propagator.flows_with_stm(states[:-1], durations)
    first_growing, last_shrinking = (
        np.array(data["charts"][k]["basis"], dtype=float)[:, column]
        for data, k, column in ((source, first, 0), (target, last, 1))
    )
    bases = directions(system, states, stms, closed=False, first=first_growing, last=last_shrinking)
    tilts = None
    if "tilt" in source["charts"][0]:
        end_tilts = _carried(source["charts"][first], bases[0])[1], _carried(target["charts"][last], bases[-1])[0]
        tilts = _tilts(system, states, bases, stms, end_tilts)
    rates = growth(bases, stms)
    # A box is narrower than the stretched one before it in u, and wider than the shrunk one in s, so it is covered.
    unstable_widths, stable_widths = [float(source["widths"][first][0]) / 4], [float(target["widths"][last][1])]
    for growth_forward, growth_backward in zip(rates, rates[::-1], strict=True):
        unstable_widths.append(min(_KEPT * growth_forward[0] * unstable_widths[-1], radius))
        stable_widths.append(min(_KEPT * stable_widths[-1] / growth_backward[1], radius))
    middle_times = [
        (crossed + before.time_in + crosses - after.time_out) / 2
        for crossed, crosses, before, after in zip(
            route.times, route.times[1:], route.connections, route.connections[1:], strict=False
        )
    ]
    # Joints are the nodes after the middles of the stops, which divide the segments among the symbols.
    joints = [int(k) for k in np.searchsorted(times, middle_times)]
    segments = zip([0, *(k + 1 for k in joints)], [*joints, len(times)], strict=True)
    departs, arrives = route.connections[0], route.connections[-1]
    return {
        "source": ends[0],
        "target": ends[1],
        "leaves": (first - 1) % len(source["charts"]),
        "joins": (last + 1) % len(target["charts"]),
        "charts": _charts(states, bases, tilts),
        "widths": _decimals(np.stack([unstable_widths, stable_widths[::-1]], axis=1)),
        "durations": [source["durations"][0], *_decimals(durations), target["durations"][0]],
        "turns": [int(k) for k in route.offsets[-1]],
        "time_out": repr(float(departs.time_out)),
        "phase_out": repr(float(departs.phase_out)),
        "time_in": repr(float(arrives.time_in)),
        "phase_in": repr(float(arrives.phase_in)),
        "symbols": route.claims(list(segments), [k + 1 for k in marks], rivals),
    }


def _carried(chart: Mapping[str, Any], base: Array) -> Array:
    """Return the tilt (2,) of an orbit's chart in the basis `base` (N, N) of a state near its node."""
    tilt, basis = (np.array(chart[key], dtype=float) for key in ("tilt", "basis"))
    return np.asarray(np.linalg.solve(base, basis[:, :2] @ tilt), dtype=float)


def transversality(surface: Surface, connection: Connection, proved: CoveringLink, orbits: Sequence[OrbitBoxes]) -> Any:
    """Enclose the angle between both tubes' cuts in (q, p/p₀) at the first mark of a link, deg.

    The tangents of the unstable manifold lie in a cone that is propagated forward from the source orbit's boxes, and
    those of the stable one in a cone propagated backward from the target's. The result is None if the cones are not
    proved to be disjoint. Covering relations do not need it.

    Args:
        surface: energy surface.
        connection: connection of the first mark.
        proved: proved link.
        orbits: boxes of all orbits.

    Raises:
        NotClosed: the crossing of the section is not enclosed.
    """
    mark, legs = proved.marks[0], proved.legs
    source, leaves, target, joins = proved.numbers("source", "leaves", "target", "joins")
    unstable_cone = reduce(lambda cone, leg: forward(leg, cone)[0], legs[:mark], orbits[source].grows[leaves])
    stable_cone = reduce(lambda cone, leg: backward(leg, cone)[0], legs[: mark - 1 : -1], orbits[target].shrinks[joins])
    return _angle(
        surface, connection, chart_of(proved.data["charts"][mark - 1]), legs[mark].start, (unstable_cone, stable_cone)
    )


def _angle(surface: Surface, connection: Connection, chart: SectionChart, state: Any, slopes: tuple[Any, Any]) -> Any:
    """Enclose the angle (deg) at a section between a direction in the unstable cone and one in the stable cone.

    Args:
        surface: energy surface.
        connection: connection that crosses the section.
        chart: chart of the link's mark, near the section.
        state: box of states (N,) in this chart.
        slopes: unstable cone (s over u) and stable cone (u over s) as balls.

    Returns:
        The angle, or None if the cones may meet.
    """
    section = connection.section
    normal, position = ([ball(v) for v in row] for row in (section.normal, section.position))
    height = folded(dot(normal, state) - ball(section.offset), period_of(described(section)))
    # The orbit meets the section slightly before or after the chart.
    crossing = passage(surface.field, normal, height, state)
    tangents = (crossing.moved * chart.tangents(surface.field, state)).transpose().tolist()
    momenta, scale = surface.field.momenta(crossing.around)[0], ball(momentum_scale(connection.source.system, section))
    plane_directions = []
    for first, second in ((flint.arb(1), slopes[0]), (slopes[1], flint.arb(1))):
        # Tangent vector of the cone at the crossing, then projected onto the section along the flow.
        v = [first * a + second * b for a, b in zip(*tangents[:2], strict=True)]
        v = [a - f * dot(normal, v) / dot(normal, crossing.rates) for a, f in zip(v, crossing.rates, strict=True)]
        momentum = [dot([momenta[i + 2 * j] for j in range(4)], v) for i in range(2)]
        plane_directions.append((dot(position, v), dot([ball(m) for m in section.momentum], momentum) / scale))
    (a, b), (c, d) = plane_directions
    cross_product = abs(a * d - b * c)
    return flint.arb.atan2(cross_product, abs(a * c + b * d)) * 180 / flint.arb.pi() if cross_product > 0 else None
