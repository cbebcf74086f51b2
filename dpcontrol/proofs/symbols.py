"""Claims on the symbols of a walk, and their proof in boxes that enclose a flight.

Claims are exact numbers as text, which certificates hold. They are proved in boxes of any integrator: in those of the
search for `prove walk`, and in those of the independent check for `prove check`.

Between the middles of its two stops, each symbol has as many section crossings as its connection, which are
hits_u + hits_s - 1, and the marked node is at number hits_u. Heights above the section are enclosed during every step.
If a height may vanish, the speed across the section must have a definite sign, and the sheets before and after
determine the number of crossings. In the middle of each stop, every angle is within half a turn of the walk's lifted
saddle, which proves the winding of each symbol. At the marked node, the orbit is nearer to its connection than to any
other one of the same kind. The time between two marked nodes determines the wraps.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from dpcontrol.proofs.balls import NotClosed, flint, folded, largest, located, number

Vector = list[Any]
"""A list of balls."""
_BEYOND = "1e9"
"""Period of a section without one; no state is at such a height."""


def dot(first: Sequence[Any], second: Sequence[Any]) -> Any:
    """Return the scalar product of two vectors of balls.

    Args:
        first: balls (N,).
        second: balls (N,).
    """
    return sum((a * b for a, b in zip(first, second, strict=True)), flint.arb(0))


def described(section: Any) -> dict[str, Any]:
    """Return a Poincaré section as decimals, which certificates hold and `crossings` reads.

    Args:
        section: a `Section` of module propagator.
    """
    side = (0.0,) * len(section.normal) if section.side is None else section.side
    return {
        "normal": [repr(v) for v in section.normal],
        "offset": repr(section.offset),
        "period": "2 pi" if section.period == 2 * math.pi else repr(section.period) if section.period else _BEYOND,
        "side": [repr(v) for v in side],
        "middle": repr(-1.0 if section.side is None else section.middle),
        "reach": None if section.reach is None else repr(section.reach),
    }


def period_of(section: Mapping[str, Any]) -> Any:
    """Return the period of a section's height as a ball: the distance of neighbouring sheets of the section.

    Args:
        section: numbers of `described`.
    """
    return 2 * flint.arb.pi() if section["period"] == "2 pi" else number(section["period"])


def crossings(section: Mapping[str, Any], boxes: Sequence[Vector], rates: Callable[[Vector], Vector]) -> list[range]:
    """Return the valid section crossings along a flight, each as the boxes in which it may occur.

    The section consists of parallel planes, its sheets. Boxes between two that lie on different sheets without meeting
    a plane hold as many crossings as there are planes between them. Crossings on the wrong side of the section's
    condition are left out.

    Args:
        section: numbers of `described`.
        boxes: boxes (N,) along the flight, in order.
        rates: function that encloses f over a box.

    Raises:
        NotClosed: the boxes are too wide to count.
    """
    lengths = [section["offset"], section["middle"], section["reach"] or 0]
    rows = ([number(v) for v in row] for row in (section["normal"], section["side"], lengths))
    (normal, side, (offset, middle, reach)), period = rows, period_of(section)
    sheets = [((dot(normal, box) - offset) / period).floor().unique_fmpz() for box in boxes]
    clear_boxes = [k for k, sheet in enumerate(sheets) if sheet is not None]
    if not clear_boxes or clear_boxes[0] > 0 or clear_boxes[-1] + 1 < len(boxes):
        raise NotClosed("the trajectory begins or ends on its section")
    found_crossings: list[range] = []
    for first, last in pairwise(clear_boxes):
        sheet_changes, boxes_between = abs(int(sheets[last]) - int(sheets[first])), boxes[first + 1 : last]
        side_heights = [dot(side, box) - middle for box in boxes_between]
        if section["reach"] is not None:
            side_heights = [abs(v) - reach for v in side_heights]
        if not boxes_between and sheet_changes:
            raise NotClosed("a step's enclosure jumps over a section")
        if boxes_between and not all(v <= 0 for v in side_heights):
            speeds = [dot(normal, rates(box)) for box in boxes_between]
            if not all(v > 0 for v in side_heights) or not (all(v > 0 for v in speeds) or all(v < 0 for v in speeds)):
                raise NotClosed("the enclosures do not determine the number of section crossings")
            found_crossings += [range(first + 1, last)] * sheet_changes
    return found_crossings


@dataclass(frozen=True)
class Enclosed:
    """A flight in boxes.

    Attributes:
        flights (K,): boxes of all steps in each segment.
        nodes (K, N): boxes of first states.
        times (K,): durations, s.
        turns (N,): whole turns from its start to its end.
        angles (N,): True for the period 2π.
        scale (N,): units of states.
        rates: encloses f over a box.
        closed: True for a closed orbit, False for a chain between two orbits.
    """

    flights: Sequence[Sequence[Vector]]
    nodes: Sequence[Vector]
    times: Sequence[Any]
    turns: Sequence[int]
    angles: Sequence[bool]
    scale: Vector
    rates: Callable[[Vector], Vector]
    closed: bool = True

    def away(self, box: Vector, state: Sequence[str], turns: Sequence[int]) -> Vector:
        """Return the difference (N,) of a box of states and a computed state with whole turns added.

        Args:
            box: box of states (N,).
            state: decimals (N,).
            turns: whole turns (N,) of the lift.
        """
        return [x - c - 2 * flint.arb.pi() * int(k) for x, c, k in zip(box, map(number, state), turns, strict=True)]


def check_symbols(claims: Sequence[Mapping[str, Any]], flown: Enclosed) -> None:
    """Prove that an orbit follows the symbols of a walk: their sections, connections, windings and wraps.

    An open orbit has no next mark after its last symbol, and therefore no wraps there. A claim has these entries:

        section              numbers of `described`
        node, hits           the marked node on the section, and the numbers of its crossing from either end
        segments             first and last segment of the symbol, from stop to stop
        turns, states        whole turns (N,) up to the symbol; states (N,) of its connection and then of its rivals
        stop, stop_turns     the saddle (N,) of the stop after the symbol, and whole turns (N,) up to it
        wraps, period, rest  wraps at this stop, its orbit's period, and the time between marks without wraps, s

    Args:
        claims: claims in the order of the symbols.
        flown: the orbit's flight.

    Raises:
        NotClosed: the boxes do not prove a claim.
    """
    count, nodes = len(flown.flights), [claim["node"] for claim in claims]
    # First segment, marked node and last segment of each symbol rise along the orbit.
    edges = [edge for claim in claims for edge in (claim["segments"][0], claim["node"], claim["segments"][1])]
    turn_counts = [turn_count for claim in claims for turn_count in (claim["turns"], claim["stop_turns"])]
    symbols_adjoin = [edge + 1 for edge in edges[2:-1:3]] == edges[3::3] and (edges[0], edges[-1]) == (0, count - 1)
    # Each symbol starts with the whole turns of the stop before it, the first one without any.
    if (
        not symbols_adjoin
        or edges != sorted(edges)
        or [[0] * 4, *turn_counts[1::2]] != [*turn_counts[::2], list(flown.turns)]
    ):
        raise NotClosed("the symbols do not follow one another along the orbit")
    for k, (claim, next_node) in enumerate(zip(claims, [*nodes[1:], nodes[0] + count], strict=True), start=1):
        first, node, last = (int(edge) for edge in (claim["segments"][0], claim["node"], claim["segments"][1]))
        stop_difference = flown.away(
            flown.flights[last][len(flown.flights[last]) // 2], claim["stop"], claim["stop_turns"]
        )
        state_differences = [flown.away(flown.nodes[node], state, claim["turns"]) for state in claim["states"]]
        distances = [
            largest([v / s for v, s in zip(difference, flown.scale, strict=True)]) for difference in state_differences
        ]
        stay = sum((flown.times[i % count] for i in range(node, next_node)), flint.arb(0))
        section, node_box = claim["section"], flown.flights[node][0]
        level = dot([number(v) for v in section["normal"]], node_box) - number(section["offset"])
        with located(f"symbol {k} of {len(claims)}:"):
            if not folded(level, period_of(section)).contains(0):
                raise NotClosed("its marked node is not on its section")
            crossed = crossings(
                section,
                [box for boxes_of_flight in flown.flights[first : last + 1] for box in boxes_of_flight],
                flown.rates,
            )
            # The marked node is in the last box before it and in the first one after it.
            node_index = sum(len(boxes_of_flight) for boxes_of_flight in flown.flights[first:node])
            hits = [
                (k + 1, len(crossed) - k)
                for k, boxes in enumerate(crossed)
                if node_index in boxes and node_index - 1 in boxes
            ]
            if hits != [tuple(int(v) for v in claim["hits"])]:
                raise NotClosed(
                    f"its marked node has the hits {hits} among {len(crossed)} crossings, not {claim['hits']}"
                )
            if not all(
                abs(v) < flint.arb.pi() for v, turning in zip(stop_difference, flown.angles, strict=True) if turning
            ):
                raise NotClosed("the whole turns up to the next stop differ from those of the walk")
            if not all(distances[0] < other for other in distances[1:]):
                raise NotClosed("the orbit is not proved to be nearer to its connection than to all others")
            if k == len(claims) and not flown.closed:
                return
            wraps = whole_number((stay - number(claim["rest"])) / number(claim["period"]))
            if wraps != claim["wraps"]:
                raise NotClosed(f"the duration of its stop is that of {wraps} wraps instead of {claim['wraps']}")


def whole_number(rounds: Any) -> int:
    """Return the whole number that is nearest to all numbers of a ball, such as the wraps of a stop.

    Args:
        rounds: ball.

    Raises:
        NotClosed: the enclosure does not determine it.
    """
    nearest = (rounds + 0.5).floor().unique_fmpz()
    if nearest is None:
        raise NotClosed("the duration of a stop does not determine its wraps")
    return int(nearest)
