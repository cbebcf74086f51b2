"""Networks of covering relations, and what follows from them.

A chart has boxes |y_1| ≤ r_u, |y_2| ≤ r_s. A box covers the next one if its image under the flow stretches across it,

    |Dg_uu| r_u - |Dg_us| r_s - |g_u(0)| > r_u',        |Dg_su| r_u + |Dg_ss| r_s + |g_s(0)| < r_s',

for every Dg over the box. For each finite, infinite or closed path along covering relations there is an orbit in the
boxes of this path; if the path is closed, it is a closed orbit. The boxes about a periodic orbit cover one another in a
circle. A link is a chain of boxes from a box of one orbit to a box of another one or the same. Orbits and links are a
graph, and every walk on it is followed by an orbit.

Slopes of growing directions are propagated forward and those of shrinking directions backward. Around an orbit, they
return to the initial cone, in which lengths have grown. The points that stay in an orbit's boxes for all past times
therefore form a disc of its unstable manifold that crosses the boxes. For all future times, they form a disc of the
stable manifold. An orbit that stays in the boxes of a link and of both its orbits is a connection of them.

The wraps of a passage from link to link follow from its duration, for any number n of extra rounds. Consider the
difference between an orbit in the boxes and the periodic orbit. At the start of each round, it lies in the growing or
the shrinking cone, because both cones together are the plane. Once it grows, it keeps growing. It is therefore at most
2^-j of the boxes' widths j rounds after the first or before the last one. Let E bound the deviation of one round's
duration from the period in the boxes. The deviations sum up to at most 2E while the difference shrinks and to 2E while
it grows. The round in between adds at most E, and so do the legs before the first and after the last full round.

The entropy needs orbits of different walks to separate. Let the mark of a link be its box on its section. No step of
any orbit along the network's boxes meets a mark, except in the two legs beside it. If two orbits stay close, one is in
these legs of a link whenever the other one passes its mark. So both pass marks of the same links, at times that differ
by at most the longest of these legs, η. Passages last longer than 2η, and passages with different wraps differ by more
than 2η. So both follow the same links with the same wraps, and orbits of different walks are (ε, T)-separated for a
small ε. Their number grows as that of walks of duration T. With M(h)_ab = Σ exp(-h τ) over the links and rounds from
the first box of orbit a to that of orbit b, where τ is an upper bound of the duration, it grows at least as exp(h T)
if the spectral radius of M(h) is at least one. This holds if M(h) v ≥ v for a vector v ≥ 0 (Collatz and Wielandt).

`prove` and the independent check use these functions with different equations, charts and integrators.

Sources: Zgliczyński, Gidea, Covering relations for multidimensional dynamical systems (2004); Zgliczyński, Covering
relations, cone conditions and the stable manifold theorem (2009); Bowen, Walters, Expansive one-parameter flows (1972).
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import chain, pairwise
from typing import Any

import numpy as np

from dpcontrol.proofs.balls import NotClosed, flint, folded, fraction, located, number, symmetric
from dpcontrol.proofs.symbols import Enclosed, check_symbols, crossings, dot, period_of, whole_number

Vector = list[Any]
"""A list of balls."""


@dataclass(frozen=True)
class ChartSegment:
    """The map g between two charts over a box about zero.

    The duration (s) is `time` over the box and `at_node` from the node. Its derivative by y is `delays` (2,). `start`
    (N,) encloses the box's states. Balls in `spans` enclose all solutions during each step, and finally near the second
    section.

    Attributes:
        value (2,): g(0).
        slope (2, 2): Dg over the box.
    """

    value: Vector
    slope: Any
    time: Any
    at_node: Any
    delays: Vector
    spans: list[Vector]
    start: Vector


@dataclass(frozen=True)
class Enclosure:
    """The enclosures of a system on an energy surface.

    Attributes:
        segment: encloses the map between two charts over boxes of given half-widths, with its duration and turns.
        rates: encloses f over a box.
        angles (N,): True for the period 2π.
        scale (N,): units of states.
    """

    segment: Callable[[Sequence[Any], Sequence[Vector], Any, Sequence[int]], ChartSegment]
    rates: Callable[[Vector], Vector]
    angles: Sequence[bool]
    scale: Vector

    def covered(
        self, charts: Sequence[Any], widths: Sequence[Sequence[Any]], durations: Sequence[Any], turns: Sequence[int]
    ) -> list[ChartSegment]:
        """Return the maps of a chain in which each box covers the next one.

        A box covers the next one if its image under the flow is longer than it in u, the growing direction, and
        narrower in s, the shrinking direction.

        Args:
            charts (K + 1,): the chain's charts, as `segment` takes them.
            widths (K + 1, 2): half-widths of the boxes.
            durations (K,): flight times, s.
            turns (N,): whole turns at the end of the chain.

        Raises:
            NotClosed: a covering is not proved.
        """
        sizes, legs = [[number(v) for v in row] for row in widths], list[ChartSegment]()
        if not all(v > 0 for v in (*chain(*sizes), *map(number, durations))) or len(durations) < 2:
            raise NotClosed("a chain has fewer than two legs, or one without width or duration")
        rows = zip(pairwise(charts), pairwise(sizes), durations, strict=True)
        for k, (ends, ((u, s), (next_width, next_height)), duration) in enumerate(rows, start=1):
            with located(f"in segment {k} of {len(durations)}:"):
                shift = turns if k == len(durations) else [0] * len(turns)
                leg = self.segment(ends, [[u, s], [next_width, next_height]], fraction(duration), shift)
                # Derivatives of the coordinates (u, s) after the flight by those before it.
                (a, b), (c, d) = leg.slope.tolist()
                stretches = abs(a) * u - abs(b) * s - abs(leg.value[0]) > next_width
                if not (stretches and abs(c) * u + abs(d) * s + abs(leg.value[1]) < next_height):
                    raise NotClosed("the image of a box does not stretch across the next one")
            legs.append(leg)
        return legs


def forward(leg: ChartSegment, slope: Any) -> tuple[Any, Any]:
    """Return the cone of growing directions after a segment, as a ball of slopes, and the least growth in it.

    Args:
        leg: segment, whose derivative (a, b; c, d) maps the coordinates (u, s) before it to those after it.
        slope: ball of slopes s over u before it.
    """
    (a, b), (c, d) = leg.slope.tolist()
    return (c + d * slope) / (a + b * slope), abs(a + b * slope)


def backward(leg: ChartSegment, slope: Any) -> tuple[Any, Any]:
    """Return the cone of shrinking directions before a segment, as a ball of slopes, and its least backward growth.

    Args:
        leg: segment, whose derivative (a, b; c, d) maps the coordinates (u, s) before it to those after it.
        slope: ball of slopes u over s after it.
    """
    (a, b), (c, d) = leg.slope.tolist()
    return (d * slope - b) / (a - c * slope), abs((a - c * slope) / (a * d - b * c))


@dataclass(frozen=True)
class OrbitBoxes:
    """Covering boxes about a periodic orbit.

    Slopes of the growing directions (`grows`) are s over u, and those of the shrinking directions u over s.

    Attributes:
        legs (K,): maps between the boxes.
        slack: bound of a passage's deviation from whole rounds, s.
    """

    legs: Sequence[ChartSegment]
    grows: Sequence[Any]
    shrinks: Sequence[Any]
    slack: Any

    def way(self, start: int, end: int, rounds: int = 0) -> Any:
        """Return the enclosed time (s) of a flight along an orbit from the start of one box to that of another one.

        Args:
            start: first box.
            end: last box.
            rounds: full rounds in addition.
        """
        count = len(self.legs)
        passed_legs = range(start, start + (end - start) % count + rounds * count)
        return sum((self.legs[k % count].time for k in passed_legs), flint.arb(0))


def orbit_boxes(data: Mapping[str, Any], enclosure: Enclosure) -> OrbitBoxes:
    """Return the boxes about a periodic orbit, after proving that they cover one another and have invariant cones.

    The cone of growing directions has slopes (s over u) of at most one. It is invariant if its images stay in it over a
    round, in which lengths must more than double. The same must hold backward for shrinking directions (u over s).

    Args:
        data: charts, half-widths and durations.
        enclosure: enclosures of the system.

    Raises:
        NotClosed: the covering or the cones are not proved.
    """
    charts, widths = data["charts"], data["widths"]
    legs = enclosure.covered([*charts, charts[0]], [*widths, widths[0]], data["durations"], [0] * 4)
    cone, growth, backward_growth = symmetric(1), flint.arb(1), flint.arb(1)
    grows, shrinks = [cone], [cone]
    for leg, leg_backward in zip(legs, reversed(legs), strict=True):
        (slope, factor), (back_slope, back_factor) = forward(leg, grows[-1]), backward(leg_backward, shrinks[-1])
        grows, shrinks, growth, backward_growth = (
            [*grows, slope],
            [*shrinks, back_slope],
            growth * factor,
            backward_growth * back_factor,
        )
    if not (all(slope in cone for slope in [*grows, *shrinks]) and growth > 2 and backward_growth > 2):
        raise NotClosed("its cones are not invariant")
    sizes = zip(legs, (max(map(fraction, row)) for row in widths), strict=True)
    deviation = sum((2 * number(w) * (abs(leg.delays[0]) + abs(leg.delays[1])) for leg, w in sizes), flint.arb(0))
    # After a round, the cones at the first node are narrower.
    return OrbitBoxes(
        legs, [grows[-1], *grows[1:-1]], [shrinks[-1], *reversed(shrinks[1:-1])], symmetric(6 * deviation)
    )


@dataclass(frozen=True)
class CoveringLink:
    """A chain of covering relations from a box of one orbit to a box of another one or the same.

    Attributes:
        data: its numbers, as certificates hold them.
        legs (K,): maps between its boxes.
        marks: number of the leg that begins at each symbol's section.
        before: enclosed time from the source's box to the first mark's section, s.
        after: enclosed time from the last mark's section to the target's box, s.
    """

    data: Mapping[str, Any]
    legs: Sequence[ChartSegment]
    marks: Sequence[int]
    before: Any
    after: Any

    def numbers(self, *keys: str) -> Iterable[int]:
        """Return the whole numbers that the link's data have under some keys, such as the indices of its orbits.

        Args:
            keys: their keys.
        """
        return (int(self.data[key]) for key in keys)


def proved_link(data: Mapping[str, Any], orbits: Sequence[Mapping[str, Any]], enclosure: Enclosure) -> CoveringLink:
    """Return a chain of boxes from orbit to orbit, after proving that each covers the next one and its symbols hold.

    Args:
        data: source, target, leaves, joins, charts, widths, durations, turns and symbols.
        orbits: numbers of all orbits.
        enclosure: enclosures of the system.

    Raises:
        NotClosed: a covering or a symbol is not proved.
    """
    # The chain begins at box `leaves` of its source orbit and ends at box `joins` of its target orbit.
    ends = [(orbits[int(data[key])], int(data[index])) for key, index in (("source", "leaves"), ("target", "joins"))]
    charts, widths = (
        [ends[0][0][key][ends[0][1]], *data[key], ends[1][0][key][ends[1][1]]] for key in ("charts", "widths")
    )
    turns, symbols = [int(k) for k in data["turns"]], data["symbols"]
    legs = enclosure.covered(charts, widths, data["durations"], turns)
    flights, starts, times = zip(*((leg.spans, leg.start, leg.time) for leg in legs), strict=True)
    check_symbols(
        symbols,
        Enclosed(flights, starts, times, turns, enclosure.angles, enclosure.scale, enclosure.rates, closed=False),
    )
    marks = [int(symbol["node"]) for symbol in symbols]
    first_delay, last_delay = (
        _delay(symbol["section"], legs[k - 1 : k + 1], enclosure)
        for symbol, k in ((symbols[0], marks[0]), (symbols[-1], marks[-1]))
    )
    before, after = sum(times[: marks[0]], first_delay), sum(times[marks[-1] :], -last_delay)
    return CoveringLink(data, legs, marks, before, after)


def _delay(section: Mapping[str, Any], beside: Sequence[ChartSegment], enclosure: Enclosure) -> Any:
    """Return the enclosed time (s) from a mark's chart to the section of its symbol.

    Chart and crossing are in the same boxes, in which the speed across the section has a sign.

    Args:
        section: numbers of the section.
        beside: the leg before the mark and the one after it.
        enclosure: enclosures of the system.

    Raises:
        NotClosed: the boxes beside the mark do not hold exactly one crossing.
    """
    normal, boxes = [number(v) for v in section["normal"]], [box for leg in beside for box in leg.spans]
    height = folded(dot(normal, beside[1].start) - number(section["offset"]), period_of(section))
    marked_crossings = [hit for hit in crossings(section, boxes, enclosure.rates) if len(beside[0].spans) in hit]
    if len(marked_crossings) != 1:
        raise NotClosed("the time of a section crossing is not determined")
    crossing_box = reduce(
        lambda a, b: [x.union(y) for x, y in zip(a, b, strict=True)], [boxes[k] for k in marked_crossings[0]]
    )
    return -height / dot(normal, enclosure.rates(crossing_box))


@dataclass(frozen=True)
class Network:
    """Orbits and links with proved covering relations.

    Attributes:
        orbits: boxes about each orbit.
        links: the chains between them.
        enclosure: enclosures of the system.
    """

    orbits: list[OrbitBoxes]
    links: list[CoveringLink]
    enclosure: Enclosure

    def check_marks(self) -> None:
        """Prove that no step along other boxes meets the mark of a link, which includes that links are distinct.

        The mark of a link is its box on its section.

        Raises:
            NotClosed: a step is not proved to avoid a mark, or a link has more than one mark.
        """
        if any(len(link.marks) > 1 for link in self.links):
            raise NotClosed("a link has more than one mark")
        for k, j in self.passages():
            chain_name = f"link {j}" if j > 0 else f"orbit {j + len(self.orbits)}"
            raise NotClosed(f"{chain_name} is not proved to avoid the box of link {k} on its section")

    def passages(self) -> Iterator[tuple[int, int]]:
        """Yield each link and the number of a chain that is not proved to avoid its mark, its box on its section.

        Links count from 1, and the last orbit has number 0. The legs beside a link's own mark are not tested.
        """
        chains = [row.legs for row in (*self.orbits, *self.links)]
        for k, link in enumerate(self.links, start=1):
            for j, legs in enumerate(chains, start=1 - len(self.orbits)):
                legs_at_mark = (link.marks[0] - 1, link.marks[0]) if j == k else ()
                spans = (box for i, leg in enumerate(legs) if i not in legs_at_mark for box in leg.spans)
                if any(self._meet(link.legs[link.marks[0]].start, box) for box in spans):
                    yield k, j

    def apart(self) -> list[int]:
        """Return the indices of links whose marks all chains of these links and of the orbits avoid.

        Of two links that are not proved to be apart, the later one is left out.
        """
        excluded = set[int]()
        for k, j in self.passages():
            if not excluded & {k, j}:
                excluded.add(max(k, j))
        return [k for k in range(len(self.links)) if k + 1 not in excluded]

    def _meet(self, mark: Vector, box: Vector) -> bool:
        """Return True if a mark and another box of states (N,) may have a state in common, up to whole turns."""
        turn = 2 * flint.arb.pi()
        return all(
            (folded(a - b, turn) if turns else a - b).contains(0)
            for a, b, turns in zip(mark, box, self.enclosure.angles, strict=True)
        )

    def fewest_wraps(self) -> list[list[int | None]]:
        """Return the fewest wraps of a passage from each link to each other (L, L), None if they do not share an orbit.

        A passage leads from the mark of one link, its box on its section, along the boxes of the orbit between them to
        the mark of the next link. More wraps are possible by further rounds.

        Raises:
            NotClosed: a duration does not determine its wraps, or orbits of different walks are not proved to separate.
        """
        leg_times = [link.legs[k].time for link in self.links for k in (link.marks[0] - 1, link.marks[0])]
        # This is 2η of the module's text: passages that differ by more separate the orbits of different walks.
        least_difference = 2 * reduce(lambda a, b: a.max(b), leg_times)

        def fewest(link: CoveringLink, other: CoveringLink) -> int | None:
            """Return the wraps of the shortest passage from link to link, None if they do not share an orbit."""
            ((target, joins), (source, leaves)) = link.numbers("target", "joins"), other.numbers("source", "leaves")
            if target != source:
                return None
            orbit = self.orbits[target]
            stay, period = link.after + orbit.way(joins, leaves) + other.before + orbit.slack, orbit.way(0, 0, 1)
            if not (stay > least_difference and period - 2 * stay.rad() > least_difference):
                raise NotClosed("orbits of different walks are not proved to separate")
            flight_time = number(link.data["time_in"]) + number(other.data["time_out"])
            phase_difference = fraction(other.data["phase_out"]) - fraction(link.data["phase_in"])
            return whole_number((stay - flight_time) / period - number(phase_difference % 1))

        for orbit, section in (
            (self.orbits[index], link.data["symbols"][0]["section"])
            for link in self.links
            for index in link.numbers("source", "target")
        ):
            if crossings(section, [box for leg in orbit.legs for box in leg.spans], self.enclosure.rates):
                raise NotClosed("an orbit's boxes meet the section of its link")
        return [[fewest(link, other) for other in self.links] for link in self.links]

    def has_entropy(self, rate: Any) -> bool:
        """Return True if the topological entropy is proved to be at least a rate.

        Walks are counted by the matrix M(h) of the module's text, whose rows and columns are the orbits. Its entries
        are sums of exp(-h τ) over the rounds and links from the first box of one orbit to that of another, with their
        durations τ. The entropy is at least h if M(h) v ≥ v for a vector v ≥ 0, for which the largest eigenvalue's
        vector is tried.

        Args:
            rate: the rate h, a ball, per time unit.
        """
        count = len(self.orbits)
        matrix = [[flint.arb(0)] * count for _ in range(count)]
        loops = [((k, k), orbit.way(0, 0, 1)) for k, orbit in enumerate(self.orbits)]
        for link in self.links:
            a, leaves, b, joins = link.numbers("source", "leaves", "target", "joins")
            time_beside = self.orbits[a].way(0, leaves) + self.orbits[b].way(joins, 0)
            loops.append(((a, b), time_beside + link.before + link.after))
        for (a, b), time in loops:
            matrix[a][b] += (-rate * time).exp()
        values, vectors = np.linalg.eig([[float(v.mid()) for v in row] for row in matrix])
        # Entries of rounding errors would belong to orbits outside the part of the graph that has this entropy.
        vector = [flint.arb(float(v) if v > 1e-9 else 0.0) for v in np.abs(vectors[:, np.argmax(values.real)])]
        return all(dot(row, vector) >= v for row, v in zip(matrix, vector, strict=True))
