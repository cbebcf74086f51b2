"""Proofs of connections and horseshoes by covering relations with cone conditions.

Each node of a periodic orbit, or of a computed connection between two orbits, has a box |y_1| ≤ r_u, |y_2| ≤ r_s in its
chart. A box covers the next one if its image under the flow stretches across it,

    |Dg_uu| r_u - |Dg_us| r_s - |g_u(0)| > r_u',        |Dg_su| r_u + |Dg_ss| r_s + |g_s(0)| < r_s',

for every Dg over the box. Slopes of growing directions are propagated forward and those of shrinking directions
backward. Around an orbit, they return to the initial cone, in which lengths have grown. The points that stay in an
orbit's boxes for all past times therefore form a disc of its unstable manifold that crosses the boxes. For all future
times, they form a disc of the stable manifold. If boxes cover one another from the first orbit along a connection to
the last orbit, an orbit passes through all of them. It is a connection. The manifolds' tangents lie in the cones, which
are disjoint, so the connection is transversal and the cones enclose its angle.

All connections of one orbit leave and join the same boxes. For every sequence of connections, with any number of rounds
above the minimum, boxes cover one another along the sequence and an orbit follows it. This is a horseshoe. Covering
relations have the advantage that a few enclosures per connection suffice for all sequences, with explicit numbers of
rounds. A Newton–Kantorovich bound uniform over sequences would need the same enclosures.

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
"""Width of the next box relative to the stretched width of a box."""


@dataclass(frozen=True)
class Boxes:
    """Boxes along a chain of charts, with half-widths (K, 2).

    Slopes of the growing directions (`grows`) are s over u, and those of the shrinking directions u over s.
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
        NotClosed: the covering is not proved.
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
    """Return slope and least growth of the growing cone after a segment."""
    (a, b), (c, d) = one.slope.tolist()
    return (c + d * slope) / (a + b * slope), abs(a + b * slope)


def _backward(one: ChartSegment, slope: Any) -> tuple[Any, Any]:
    """Return slope and backward growth of the shrinking cone before a segment."""
    (a, b), (c, d) = one.slope.tolist()
    return (d * slope - b) / (a - c * slope), abs((a - c * slope) / (a * d - b * c))


def _rates(bases: Array, stms: Array) -> Array:
    """Return the growth factors (K, 2) of u and s per leg."""
    maps = np.linalg.inv(bases[1:]) @ stms @ bases[:-1]
    return np.abs(np.stack([maps[:, 0, 0], maps[:, 1, 1]], axis=1))


def nodes_of(orbit: LyapunovOrbit) -> int:
    """Return the number of nodes, for stretching by about two per leg."""
    return max(3, min(8, int(np.log(abs(orbit.unstable_multiplier)) / 0.75)))


def orbit_boxes(surface: Surface, orbit: LyapunovOrbit, radius: float, settings: FlowSettings) -> Boxes:
    """Return covering boxes around a periodic orbit, with invariant cones.

    Raises:
        NotClosed: the covering or the cones are not proved.
    """
    system, count = orbit.system, nodes_of(orbit)
    durations = np.full(count, orbit.period / count)
    states = np.array([system.propagator.flow(orbit.state, t) for t in orbit.period * np.arange(count) / count])
    _, stms = system.propagator.flows_with_stm(states, durations)
    ones = np.cos(np.arange(4) + 1.0) * system.scale
    bases = directions(system, states, stms, closed=True, first=ones, last=ones)
    rates = _rates(np.concatenate([bases, bases[:1]]), stms)
    # The widths follow the stretching, up to a constant factor per leg.
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
        raise NotClosed(f"the cones of the orbit about {orbit.saddle} are not invariant")
    return Boxes(charts, widths, segments, grows[:-1], [shrinks[-1], *reversed(shrinks[1:-1])])


@dataclass(frozen=True)
class CoveringRelation:
    """The boxes along a connection and their neighbours on the orbits.

    The connection leaves the source's box before `first` and joins the target's box `last`. The enclosed times `before`
    and `after` (s) run from the source's box to the section, and from there to the target's box.

    Attributes:
        angle: deg.
        state: enclosure on the section.
    """

    connection: Connection
    first: int
    last: int
    before: Any
    after: Any
    angle: Any
    state: Sequence[Any]


def _times(connection: Connection, radius: float) -> tuple[Array, int, int, int]:
    """Return a connection's node times (K,), section index and end phases.

    The ends are in phase with a node of the orbit, at half the radius from it.
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
        NotClosed: the covering or the connection's identity is not proved.
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
        raise NotClosed("the number of its section crossings does not match its hits")
    y = [symmetric(float(v)) for v in widths[middle]]
    state, _ = charts[middle].lift(surface.field, surface.height, y)
    before = sum((one.time for one in found[: middle + 1]), flint.arb(0))
    after = sum((one.time for one in found[middle + 1 :]), flint.arb(0))
    angle = _angle(surface, connection, charts[middle], state, (slope, back))
    return CoveringRelation(connection, first, last, before, after, angle, state)


def _angle(surface: Surface, connection: Connection, chart: SectionChart, state: Any, slopes: tuple[Any, Any]) -> Any:
    """Return the angle (deg) between both tubes' cuts in (q, p/p₀).

    Raises:
        NotClosed: the cones are not proved to be disjoint.
    """
    system, section = connection.source.system, connection.section
    e = system.equations
    normal, position = ([ball(v) for v in row] for row in (section.normal, section.position))
    height = dot(normal, state) - ball(section.offset)
    if section.period is not None:
        sheets = 2 * flint.arb.pi() if section.period == 2 * np.pi else ball(section.period)
        height = height - (height / sheets + flint.arb(1) / 2).mid().floor() * sheets
    # The orbit meets the section slightly before or after the chart, so the enclosures cover this time.
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
        raise NotClosed("the cones of both manifolds are not proved to be disjoint")
    return flint.arb.atan2(across, abs(a * c + b * d)) * 180 / flint.arb.pi()


def horseshoe(surface: Surface, boxes: Boxes, links: Sequence[CoveringRelation]) -> tuple[list[list[int]], Any]:
    """Return the horseshoe of links between one orbit's boxes.

    The result is the fewest wraps between each two links (L, L), and a lower bound of the topological entropy in nats
    per second.

    The wraps of a passage follow from its duration. In the boxes, an orbit's distance from the periodic orbit is more
    than halved in each round from either end. Five times the uncertainty of one round therefore bounds that of any
    number of rounds. For loops of first return to one box with times τ_i, Abramov's formula gives the entropy h by
    Σ exp(-h τ_i) = 1.

    Raises:
        NotClosed: a duration does not determine its wraps, or two links are not proved to be distinct.
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
                raise NotClosed(f"{one.connection.name} and {other.connection.name} are not proved to be distinct")

    def way(here: int, there: int) -> Any:
        """Return the time (s) between two boxes of the orbit."""
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
                raise NotClosed(f"the duration of the passage from {a.name} to {b.name} does not determine its wraps")
            row.append(int(wraps))
        least.append(row)
    loops = [way(0, one.first - 1) + one.before + one.after + way(one.last + 1, 0) for one in links] + [round_time]
    low, high = 0.0, 100.0
    for _ in range(60):
        total = sum(((-flint.arb((low + high) / 2) * time).exp() for time in loops), flint.arb(0))
        low, high = ((low + high) / 2, high) if total > 1 else (low, (low + high) / 2)
    return least, flint.arb(low)
