"""Connections proved by covering relations with cone conditions, and the horseshoe that they make together.

Around each node of a periodic orbit, and of a computed connection from one orbit to another, stands a box |y_1| ≤ r_u,
|y_2| ≤ r_s in the node's chart. A box covers the next one if its image under the flow stretches across it,

    |Dg_uu| r_u - |Dg_us| r_s - |g_u(0)| > r_u',        |Dg_su| r_u + |Dg_ss| r_s + |g_s(0)| < r_s',

for every Dg over the box. Slopes of directions that grow are carried forward, those of directions that shrink backward;
around an orbit they return into the cone where they began, and lengths in it have grown. So the points that stay in an
orbit's boxes for all past times form a disc of its unstable manifold that crosses the boxes; for all future times, of
the stable one. If boxes cover one another from the first orbit's along a connection's to the last orbit's, an orbit
leads through all of them: a connection. There the manifolds' tangents lie in the cones, which have no direction in
common: it is transversal, and the cones enclose its angle.

All connections of one orbit leave and join the same boxes. So for every sequence of connections, with any numbers of
rounds beyond the fewest between them, boxes cover one another along the sequence, and an orbit follows it: a horseshoe.
Covering relations were chosen because one set of enclosures, a few for each connection, serves all sequences, and the
numbers of rounds are explicit; a Newton–Kantorovich bound uniform over sequences would need the same enclosures.

Sources: Zgliczyński, Gidea, Covering relations for multidimensional dynamical systems (2004); Zgliczyński, Covering
relations, cone conditions and the stable manifold theorem (2009).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from dpcontrol.dynamics.system import momentum_scale
from dpcontrol.foundation.arrays import Array
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.proofs.balls import Fraction, NotClosed, ball, columns, flint, identity, program, symmetric
from dpcontrol.proofs.charts import (
    ChartSegment,
    Leg,
    SectionChart,
    Surface,
    chart_of,
    directions,
    dot,
    segment,
    staying,
)
from dpcontrol.proofs.decode import crossings
from dpcontrol.proofs.flow import FlowSettings
from dpcontrol.tubes.connections import Connection

_KEPT = 0.95
"""Share of a box's stretched width that the next one takes."""


@dataclass(frozen=True)
class Boxes:
    """Boxes along a chain: charts, half-widths (K, 2) in u and s, and the segment from each to the next.

    grows, shrinks: slopes of the directions that grow (s over u) and shrink (u over s) at each box. times: durations.
    """

    charts: Sequence[SectionChart]
    widths: Array
    segments: Sequence[ChartSegment]
    grows: Sequence[Any]
    shrinks: Sequence[Any]


def _covered(
    surface: Surface, leg: Leg, widths: Array, arriving: Array, settings: FlowSettings, where: str
) -> ChartSegment:
    """Return the enclosure of a leg whose first box covers its second.

    Raises:
        NotClosed: it is not shown to.
    """
    u, s, wide, high = (ball(float(v)) for v in (*widths, *arriving))
    try:
        one = segment(surface, leg, [u, s], [wide, high], settings)
    except NotClosed as error:
        raise NotClosed(f"{where}: {error}") from error
    (a, b), (c, d) = one.slope.tolist()
    across = abs(a) * u - abs(b) * s - abs(one.value[0]) > wide
    if not (across and abs(c) * u + abs(d) * s + abs(one.value[1]) < high):
        raise NotClosed(f"{where}: the image of a box does not stretch across the next one")
    return one


def _forward(one: ChartSegment, slope: Any) -> tuple[Any, Any]:
    """Return the slope of a direction in the cone that grows after a segment, and by what it has grown, at least."""
    (a, b), (c, d) = one.slope.tolist()
    return (c + d * slope) / (a + b * slope), abs(a + b * slope)


def _backward(one: ChartSegment, slope: Any) -> tuple[Any, Any]:
    """Return the slope of a direction in the cone that shrinks before a segment, and its growth backward."""
    (a, b), (c, d) = one.slope.tolist()
    return (d * slope - b) / (a - c * slope), abs((a - c * slope) / (a * d - b * c))


def _rates(bases: Array, stms: Array) -> Array:
    """Return by what u and s grow in each leg (K, 2), in doubles."""
    maps = np.linalg.inv(bases[1:]) @ stms @ bases[:-1]
    return np.abs(np.stack([maps[:, 0, 0], maps[:, 1, 1]], axis=1))


def nodes_of(orbit: LyapunovOrbit) -> int:
    """Return how many nodes an orbit gets: each leg stretches about twice."""
    return max(3, min(8, int(np.log(abs(orbit.unstable_multiplier)) / 0.75)))


def orbit_boxes(surface: Surface, orbit: LyapunovOrbit, radius: float, settings: FlowSettings) -> Boxes:
    """Return boxes around a periodic orbit, each of which covers the next, with cones that return into themselves.

    Raises:
        NotClosed: they are not shown to.
    """
    system, count = orbit.system, nodes_of(orbit)
    durations = np.full(count, orbit.period / count)
    states = np.array([system.propagator.flow(orbit.state, t) for t in orbit.period * np.arange(count) / count])
    _, stms = system.propagator.flows_with_stm(states, durations)
    ones = np.cos(np.arange(4) + 1.0) * system.scale
    bases = directions(system, states, stms, closed=True, first=ones, last=ones)
    rates = _rates(np.concatenate([bases, bases[:1]]), stms)
    # Around the orbit widths follow the stretching, but for the same factor in each leg.
    even = rates / np.exp(np.log(rates).mean(axis=0))
    widths = np.concatenate([np.ones((1, 2)), np.cumprod(even, axis=0)[:-1]])
    widths = radius * widths / widths.max(axis=0)
    charts = [chart_of(x, b) for x, b in zip(states, bases, strict=True)]
    segments = []
    for k in range(count):
        following = (k + 1) % count
        leg = Leg(charts[k], charts[following], Fraction(float(durations[k])), (0,) * 4)
        where = f"leg {k + 1} of {count} of the orbit about {orbit.saddle}"
        segments.append(_covered(surface, leg, widths[k], widths[following], settings, where))
    cone, longer, shorter = symmetric(0.25), flint.arb(1), flint.arb(1)
    grows, shrinks = [cone], [cone]
    for one, back in zip(segments, reversed(segments), strict=True):
        (slope, by), (back_slope, back_by) = _forward(one, grows[-1]), _backward(back, shrinks[-1])
        grows, shrinks, longer, shorter = [*grows, slope], [*shrinks, back_slope], longer * by, shorter * back_by
    if not (grows[-1] in cone and shrinks[-1] in cone and longer > 2 and shorter > 2):
        raise NotClosed(f"the cones of the orbit about {orbit.saddle} do not return into themselves")
    return Boxes(charts, widths, segments, grows[:-1], [shrinks[-1], *reversed(shrinks[1:-1])])


@dataclass(frozen=True)
class CoveringRelation:
    """A connection's boxes: those along it, and between which of the orbits' boxes they stand.

    first: leaves from the source's box before this one; last: the target's box that is joined. before, after: enclosed
    seconds from leaving the one to the section, and from there to joining the other. angle: degrees. state: its box on
    the section.
    """

    connection: Connection
    first: int
    last: int
    before: Any
    after: Any
    angle: Any
    state: Sequence[Any]


def _times(connection: Connection, radius: float) -> tuple[Array, int, int, int]:
    """Return the times (K,) of a connection's nodes, the index of that on the section, and the phases at both ends.

    At its ends it runs in step with a node of the orbit there, at half the radius from it.
    """
    orbit, ends = connection.orbit, []
    for end, at, sign in ((orbit.start, orbit.times[0], 1), (orbit.end, orbit.times[-1], -1)):
        around = end.manifold.orbit
        system, count = around.system, nodes_of(around)
        phase = end.orbit_phase
        lifted = system.propagator.flow(around.state, (phase % 1.0) * around.period)
        lifted = lifted + np.asarray(end.turns) * system.turn_lengths
        gap = np.linalg.norm((orbit.sample(np.array([at]))[0] - lifted) / system.scale)
        rounds = np.log(gap / (radius / 2)) / np.log(abs(around.unstable_multiplier))
        node = np.floor(sign * (phase - sign * rounds) * count) * sign
        ends.append((float(at + (node / count - phase) * around.period), int(node) % count, around.period / count))
    (start, first, step), (stop, last, late) = ends
    before, after = int(np.ceil(-start / step)), int(np.ceil(stop / late))
    return (
        np.concatenate([np.linspace(start, 0.0, before + 1), np.linspace(0.0, stop, after + 1)[1:]]),
        before,
        first,
        last,
    )


def link(
    surface: Surface, connection: Connection, source: Boxes, target: Boxes, settings: FlowSettings
) -> CoveringRelation:
    """Prove a connection between the boxes of two orbits.

    Raises:
        NotClosed: a box is not shown to cover the next, or the connection not to be what it is called.
    """
    system, radius = connection.source.system, float(source.widths.max())
    times, middle, first, last = _times(connection, radius)
    states, durations = connection.orbit.sample(times), np.diff(times)
    _, stms = system.propagator.flows_with_stm(states[:-1], durations)
    grows, shrinks = np.array(source.charts[first].basis)[:, 0], np.array(target.charts[last].basis)[:, 1]
    bases = directions(system, states, stms, closed=False, first=grows, last=shrinks)
    rates = _rates(bases, stms)
    wide, high = [source.widths[first, 0] / 4], [float(target.widths[last, 1])]
    for up, down in zip(rates, rates[::-1], strict=True):
        wide.append(min(_KEPT * up[0] * wide[-1], radius))
        high.append(min(_KEPT * high[-1] / down[1], radius))
    widths = np.stack([wide, high[::-1]], axis=1)
    charts = [chart_of(x, b) for x, b in zip(states, bases, strict=True)]
    count, none = len(source.charts), (0,) * 4
    following = (last + 1) % len(target.charts)
    turns = tuple(int(k) for k in connection.orbit.end.turns)
    steps = Fraction(connection.source.period / count), Fraction(connection.target.period / len(target.charts))
    legs = [Leg(source.charts[first - 1], charts[0], steps[0], none)]
    legs += [Leg(a, b, Fraction(float(t)), none) for (a, b), t in zip(pairwise(charts), durations, strict=True)]
    legs.append(Leg(charts[-1], target.charts[following], steps[1], turns))
    sizes = [source.widths[first - 1], *widths, target.widths[following]]
    found = []
    for k, (leg, (here, there)) in enumerate(zip(legs, pairwise(sizes), strict=True)):
        found.append(_covered(surface, leg, here, there, settings, f"leg {k + 1} of {len(legs)}"))
    slope, back = source.grows[first - 1], target.shrinks[following]
    for one in found[: middle + 1]:
        slope, _ = _forward(one, slope)
    for one in reversed(found[middle + 1 :]):
        back, _ = _backward(one, back)
    flight = [box for one in found for _, _, box in one.spans]
    if crossings(surface, connection.section, flight) != sum(connection.hits) - 1:
        raise NotClosed("its section is not crossed as often as its hits say")
    y = [symmetric(float(v)) for v in widths[middle]]
    state, _ = charts[middle].lift(surface.field, surface.height, y)
    before = sum((one.time for one in found[: middle + 1]), flint.arb(0))
    after = sum((one.time for one in found[middle + 1 :]), flint.arb(0))
    angle = _angle(surface, connection, charts[middle], state, (slope, back))
    return CoveringRelation(connection, first, last, before, after, angle, state)


def _angle(surface: Surface, connection: Connection, chart: SectionChart, state: Any, slopes: tuple[Any, Any]) -> Any:
    """Return the angle in degrees between both tubes' cuts in (q, p/p₀) on the connection's section.

    Raises:
        NotClosed: the cones are not shown to have no direction in common.
    """
    system, section = connection.source.system, connection.section
    e = system.equations
    normal, position = ([ball(v) for v in row] for row in (section.normal, section.position))
    height = dot(normal, state) - ball(section.offset)
    if section.period is not None:
        sheets = 2 * flint.arb.pi() if section.period == 2 * np.pi else ball(section.period)
        height = height - (height / sheets + flint.arb(1) / 2).mid().floor() * sheets
    # The orbit meets the section a little before or after the chart: all is enclosed over that time.
    late = (2 * height / dot(normal, surface.field.rate(state)[0])).abs_upper()
    around, rate, entries = staying(surface.field, state, late)
    drift = columns([[v.abs_upper() * late for v in row] for row in surface.field.matrix(entries)]).exp() - identity()
    moved = identity() + flint.arb_mat(4, 4, [symmetric(v) for v in drift.entries()])
    tangents = (moved * chart.tangents(surface.field, state)).transpose().tolist()
    momenta = program(e.state, e.parameters, [ca.jacobian(e.momentum, e.state)], surface.parameters)(around)[0]
    scale = ball(momentum_scale(system, section))
    flat = []
    for first, second in ((flint.arb(1), slopes[0]), (slopes[1], flint.arb(1))):
        v = [first * a + second * b for a, b in zip(*tangents, strict=True)]
        v = [a - f * dot(normal, v) / dot(normal, rate) for a, f in zip(v, rate, strict=True)]
        p = [dot([momenta[i + 2 * j] for j in range(4)], v) for i in range(2)]
        flat.append((dot(position, v), dot([ball(m) for m in section.momentum], p) / scale))
    (a, b), (c, d) = flat
    across = abs(a * d - b * c)
    if not across > 0:
        raise NotClosed("the cones of both manifolds are not shown to be apart")
    return flint.arb.atan2(across, abs(a * c + b * d)) * 180 / flint.arb.pi()


def horseshoe(surface: Surface, boxes: Boxes, links: Sequence[CoveringRelation]) -> tuple[list[list[int]], Any]:
    """Return the horseshoe of links from one orbit's boxes: the least wraps between each two (L, L), and a lower bound
    of the topological entropy in nats per second.

    The wraps of a passage follow from its duration. In the boxes an orbit's distance from the periodic one shrinks to
    less than a half each round from either end, so that five times what one round may take more or less bounds what any
    number of rounds may. Entropy: of the loops of first return to one box, with times τ_i,
    Abramov's formula gives the h with Σ exp(-h τ_i) = 1.

    Raises:
        NotClosed: a duration does not fix its wraps, or two links are not shown to be apart.
    """
    legs, count = [one.time for one in boxes.segments], len(boxes.segments)
    spans = [box for one in boxes.segments for _, _, box in one.spans]
    if any(crossings(surface, one.connection.section, spans) for one in links):
        raise NotClosed("the orbit's boxes meet a section")
    for k, one in enumerate(links):
        for other in links[:k]:
            gaps = []
            for a, b, turns in zip(one.state, other.state, surface.turns, strict=True):
                sheets = (((a - b) / (2 * flint.arb.pi())).mid() + flint.arb(1) / 2).floor() if turns else 0
                gaps.append(a - b - 2 * flint.arb.pi() * sheets)
            if all(gap.contains(0) for gap in gaps):
                raise NotClosed(f"{one.connection.name} and {other.connection.name} are not shown to be apart")

    def way(here: int, there: int) -> Any:
        """Return the seconds from one box of the orbit to the next passage of another."""
        return sum((legs[k % count] for k in range(here, here + (there - here) % count)), flint.arb(0))

    round_time, least = way(0, count - 1) + legs[-1], []
    slack = symmetric(5 * round_time.rad())
    for one in links:
        row = []
        for other in links:
            a, b = one.connection, other.connection
            passage = one.after + way(one.last + 1, other.first - 1) + other.before + slack
            spare = (passage - ball(a.time_in) - ball(b.time_out)) / round_time - ball((b.phase_out - a.phase_in) % 1.0)
            wraps = (spare + flint.arb(1) / 2).floor().unique_fmpz()
            if wraps is None:
                raise NotClosed(f"the duration of the passage from {a.name} to {b.name} does not fix its wraps")
            row.append(int(wraps))
        least.append(row)
    loops = [way(0, one.first - 1) + one.before + one.after + way(one.last + 1, 0) for one in links] + [round_time]
    low, high = 0.0, 100.0
    for _ in range(60):
        total = sum(((-flint.arb((low + high) / 2) * time).exp() for time in loops), flint.arb(0))
        low, high = ((low + high) / 2, high) if total > 1 else (low, (low + high) / 2)
    return least, flint.arb(low)
