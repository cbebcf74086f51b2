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
from functools import reduce
from itertools import combinations
from typing import Any

import numpy as np

from dpcontrol.dynamics.system import momentum_scale
from dpcontrol.foundation.arrays import Array
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.proofs.balls import Fraction, NotClosed, ball, flint, folded, located, symmetric
from dpcontrol.proofs.charts import (
    ChartSegment,
    Leg,
    SectionChart,
    Surface,
    legs_of,
    passage,
)
from dpcontrol.proofs.flow import FlowSettings
from dpcontrol.proofs.periodic import closed_chain, enclose
from dpcontrol.proofs.symbols import crossings, described, dot, period_of, whole
from dpcontrol.tubes.connections import Connection
from dpcontrol.tubes.frames import directions, growth, node_count, orbit_nodes, phased_times
from dpcontrol.walks.shadowing import phase_gap

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


def _covered(surface: Surface, legs: Sequence[Leg], widths: Array, settings: FlowSettings) -> list[ChartSegment]:
    """Return the enclosures of legs with covering boxes.

    Each one's box covers the next box.

    Args:
        widths (K + 1, 2): half-widths of the boxes.

    Raises:
        NotClosed: a covering is not proved.
    """
    segments = enclose(surface, legs, widths.tolist(), settings)
    for k, (one, here, there) in enumerate(zip(segments, widths, widths[1:], strict=False), start=1):
        (a, b), (c, d) = one.slope.tolist()
        u, s, wide, high = (ball(v) for v in (*here, *there))
        across = abs(a) * u - abs(b) * s - abs(one.value[0]) > wide
        if not (across and abs(c) * u + abs(d) * s + abs(one.value[1]) < high):
            raise NotClosed(f"in segment {k} of {len(legs)} the image of a box does not stretch across the next one")
    return segments


def _forward(one: ChartSegment, slope: Any) -> tuple[Any, Any]:
    """Return slope and least growth of the growing cone after a segment."""
    (a, b), (c, d) = one.slope.tolist()
    return (c + d * slope) / (a + b * slope), abs(a + b * slope)


def _backward(one: ChartSegment, slope: Any) -> tuple[Any, Any]:
    """Return slope and backward growth of the shrinking cone before a segment."""
    (a, b), (c, d) = one.slope.tolist()
    return (d * slope - b) / (a - c * slope), abs((a - c * slope) / (a * d - b * c))


def orbit_boxes(surface: Surface, orbit: LyapunovOrbit, radius: float, settings: FlowSettings) -> Boxes:
    """Return covering boxes around a periodic orbit, with invariant cones.

    Args:
        surface: energy surface.
        orbit: periodic orbit on the surface.
        radius: largest half-width of the boxes, in the charts' coordinates.
        settings: settings of the integrator.

    Raises:
        NotClosed: the covering or the cones are not proved.
    """
    legs, rates = closed_chain(orbit.system, *orbit_nodes(orbit, node_count(orbit)), (0,) * 4)
    # The widths follow the stretching, up to a constant factor per leg.
    even = rates / np.exp(np.log(rates).mean(axis=0))
    widths = np.concatenate([np.ones((1, 2)), np.cumprod(even, axis=0)[:-1]])
    widths = radius * widths / widths.max(axis=0)
    with located(f"the orbit about {orbit.saddle}:"):
        segments = _covered(surface, legs, np.concatenate([widths, widths[:1]]), settings)
    cone, longer, shorter = symmetric(1), flint.arb(1), flint.arb(1)
    grows, shrinks = [cone], [cone]
    for one, back in zip(segments, reversed(segments), strict=True):
        (slope, by), (back_slope, back_by) = _forward(one, grows[-1]), _backward(back, shrinks[-1])
        grows, shrinks, longer, shorter = [*grows, slope], [*shrinks, back_slope], longer * by, shorter * back_by
    narrow = all(slope in cone for slope in [*grows, *shrinks])
    if not (narrow and longer > 2 and shorter > 2):
        raise NotClosed(f"the cones of the orbit about {orbit.saddle} are not invariant")
    # After a round, the cones at the first node are narrower.
    return Boxes(
        [leg.first for leg in legs],
        widths,
        segments,
        [grows[-1], *grows[1:-1]],
        [shrinks[-1], *reversed(shrinks[1:-1])],
    )


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


def link(
    surface: Surface, connection: Connection, source: Boxes, target: Boxes, settings: FlowSettings
) -> CoveringRelation:
    """Prove a connection between the boxes of two orbits.

    Args:
        surface: energy surface.
        connection: connection on the surface.
        source: boxes of the orbit that it leaves.
        target: boxes of the orbit that it approaches.
        settings: settings of the integrator.

    Raises:
        NotClosed: the covering or the connection's identity is not proved.
    """
    system, radius = connection.source.system, float(source.widths.max())
    times, middle, first, last = phased_times(connection, radius)
    states, durations, count = connection.orbit.sample(times), np.diff(times), len(target.charts)
    _, stms = system.propagator.flows_with_stm(states[:-1], durations)
    grows, shrinks = np.array(source.charts[first].basis)[:, 0], np.array(target.charts[last].basis)[:, 1]
    bases = directions(system, states, stms, closed=False, first=grows, last=shrinks)
    rates = growth(bases, stms)
    wide, high = [source.widths[first, 0] / 4], [float(target.widths[last, 1])]
    for up, down in zip(rates, rates[::-1], strict=True):
        wide.append(min(_KEPT * up[0] * wide[-1], radius))
        high.append(min(_KEPT * high[-1] / down[1], radius))
    widths, none, following = np.stack([wide, high[::-1]], axis=1), (0,) * 4, (last + 1) % count
    steps = Fraction(connection.source.period / len(source.charts)), Fraction(connection.target.period / count)
    turns = tuple(int(k) for k in connection.orbit.end.turns)
    inner = legs_of(states, bases, durations, none)
    legs = [Leg(source.charts[first - 1], inner[0].first, steps[0], none), *inner]
    legs.append(Leg(inner[-1].second, target.charts[following], steps[1], turns))
    sizes = np.array([source.widths[first - 1], *widths, target.widths[following]])
    found = _covered(surface, legs, sizes, settings)
    slope = reduce(lambda cone, one: _forward(one, cone)[0], found[: middle + 1], source.grows[first - 1])
    back = reduce(lambda cone, one: _backward(one, cone)[0], found[:middle:-1], target.shrinks[following])
    section, flight = described(connection.section), [box for one in found for box in one.spans]
    if len(crossings(section, flight, surface.field.rates)) != sum(connection.hits) - 1:
        raise NotClosed("the number of its section crossings does not match its hits")
    # The leg after the one that ends at the section begins with the states there.
    state = found[middle + 1].start
    late, angle = _angle(surface, connection, legs[middle + 1].first, state, (slope, back))
    before = sum((one.time for one in found[: middle + 1]), late)
    after = sum((one.time for one in found[middle + 1 :]), -late)
    return CoveringRelation(connection, first, last, before, after, angle, state)


def _angle(
    surface: Surface, connection: Connection, chart: SectionChart, state: Any, slopes: tuple[Any, Any]
) -> tuple[Any, Any]:
    """Return the time and the angle at the section.

    The time to the section is in s. The angle between both tubes' cuts in (q, p/p₀) is in deg.

    Raises:
        NotClosed: the cones are not proved to be disjoint.
    """
    section = connection.section
    normal, position = ([ball(v) for v in row] for row in (section.normal, section.position))
    height = folded(dot(normal, state) - ball(section.offset), period_of(described(section)))
    # The orbit meets the section slightly before or after the chart.
    met = passage(surface.field, normal, height, state)
    tangents = (met.moved * chart.tangents(surface.field, state)).transpose().tolist()
    momenta, scale = surface.field.momenta(met.around)[0], ball(momentum_scale(connection.source.system, section))
    flat = []
    for first, second in ((flint.arb(1), slopes[0]), (slopes[1], flint.arb(1))):
        v = [first * a + second * b for a, b in zip(*tangents, strict=True)]
        v = [a - f * dot(normal, v) / dot(normal, met.rates) for a, f in zip(v, met.rates, strict=True)]
        p = [dot([momenta[i + 2 * j] for j in range(4)], v) for i in range(2)]
        flat.append((dot(position, v), dot([ball(m) for m in section.momentum], p) / scale))
    (a, b), (c, d) = flat
    across = abs(a * d - b * c)
    if not across > 0:
        raise NotClosed("the cones of both manifolds are not proved to be disjoint")
    return met.time, flint.arb.atan2(across, abs(a * c + b * d)) * 180 / flint.arb.pi()


def check_distinct(surface: Surface, links: Sequence[CoveringRelation]) -> None:
    """Prove that links on one section are distinct.

    Args:
        surface: energy surface.
        links: proved connections (L,).

    Raises:
        NotClosed: two links are not proved to be distinct.
    """
    for one, other in combinations(links, 2):
        states = zip(one.state, other.state, surface.turns, strict=True)
        gaps = [folded(a - b, 2 * flint.arb.pi()) if turns else a - b for a, b, turns in states]
        if all(gap.contains(0) for gap in gaps):
            raise NotClosed(f"{one.connection.name} and {other.connection.name} are not proved to be distinct")


def horseshoe(surface: Surface, boxes: Boxes, links: Sequence[CoveringRelation]) -> tuple[list[list[int]], Any]:
    """Return the horseshoe of links between one orbit's boxes.

    The result is the fewest wraps between each two links (L, L), and a lower bound of the topological entropy in nats
    per second.

    The wraps of a passage follow from its duration, for any number n of extra rounds. Consider the difference between
    an orbit in the boxes and the periodic orbit. At the start of each round, it lies in the growing or the shrinking
    cone, because both cones together are the plane. Once it grows, it keeps growing. It is therefore at most 2^-j of
    the boxes' widths j rounds after the first or before the last one. Let E bound the deviation of one round's duration
    from the period in the boxes. The deviations sum up to at most 2E while the difference shrinks and to 2E while it
    grows. The round in between adds at most E, and so do the legs before the first and after the last full round.

    For loops of first return to one box with times τ_i, Abramov's formula gives the entropy h by Σ exp(-h τ_i) = 1.

    Args:
        surface: energy surface.
        boxes: boxes of the orbit.
        links: proved homoclinic connections (L,), which are distinct.

    Raises:
        NotClosed: a duration does not determine its wraps.
    """
    legs, count = [one.time for one in boxes.segments], len(boxes.segments)
    spans = [box for one in boxes.segments for box in one.spans]
    if any(crossings(described(one.connection.section), spans, surface.field.rates) for one in links):
        raise NotClosed("the orbit's boxes meet a section")

    def way(here: int, there: int) -> Any:
        """Return the time (s) between two boxes of the orbit."""
        return sum((legs[k % count] for k in range(here, here + (there - here) % count)), flint.arb(0))

    round_time = way(0, count - 1) + legs[-1]
    spread = zip(boxes.segments, boxes.widths, strict=True)
    deviation = sum((2 * float(w.max()) * (abs(one.delays[0]) + abs(one.delays[1])) for one, w in spread), flint.arb(0))
    slack = symmetric(6 * deviation)

    def fewest(one: CoveringRelation, other: CoveringRelation) -> int:
        """Return the wraps of the shortest passage between two links."""
        a, b = one.connection, other.connection
        stay = one.after + way(one.last + 1, other.first - 1) + other.before + slack
        return whole((stay - ball(a.time_in) - ball(b.time_out)) / round_time - ball(phase_gap(a, b)))

    least = [[fewest(one, other) for other in links] for one in links]
    loops = [way(0, one.first - 1) + one.before + one.after + way(one.last + 1, 0) for one in links] + [round_time]
    low, high = 0.0, 100.0
    for _ in range(60):
        total = sum(((-flint.arb((low + high) / 2) * time).exp() for time in loops), flint.arb(0))
        low, high = ((low + high) / 2, high) if total > 1 else (low, (low + high) / 2)
    return least, flint.arb(low)
