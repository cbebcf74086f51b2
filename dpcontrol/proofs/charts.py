"""Charts of an energy's sections, and rigorous maps between them.

A chart about a node x̄ has a basis u, s, f, w: the directions that grow and shrink along an orbit, the flow, and a
direction in which the energy changes. Its section is the plane through x̄ spanned by u, s and w. A point of the section
on the energy h is given by two numbers y:

    x(y) = x̄ + u y_1 + s y_2 + w z(y),      H(x(y)) = h,

z by the interval Newton method: existence and uniqueness in an interval. The flow maps one chart to the next, a map of
the plane, with crossing time s(y) near zero after the segment's duration. Its derivative follows from that of the flow,

    Dg = L (1 - f n/(n·f)) V M ∂x/∂y,      L, n: rows of the inverse basis; V: the flow over s; M: over the duration.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.proofs.balls import Fraction, NotClosed, ball, columns, flint, identity, symmetric
from dpcontrol.proofs.flow import Field, FlowSettings, Vector, fly


@dataclass(frozen=True)
class SectionChart:
    """A node (N,), exact, and the basis (N, N) of its section: columns u, s, f, w, exact doubles."""

    node: tuple[Fraction, ...]
    basis: tuple[tuple[float, ...], ...]

    @cached_property
    def columns(self) -> list[Vector]:
        """The basis by columns, as balls."""
        return [[ball(v) for v in column] for column in zip(*self.basis, strict=True)]

    @cached_property
    def rows(self) -> list[Vector]:
        """The rows of the inverse basis, as balls: y_1, y_2, the section's normal, z."""
        return columns(self.basis).inv().tolist()

    def coordinates(self, state: Vector, shift: Vector) -> Vector:
        """Return (y_1, y_2, height above the section, z) of a state that a shift has been added to."""
        away = [x - ball(c) - t for x, c, t in zip(state, self.node, shift, strict=True)]
        return [dot(row, away) for row in self.rows]

    def place(self, y: Vector, z: Any) -> Vector:
        """Return x̄ + u y_1 + s y_2 + w z."""
        u, s, _, w = self.columns
        return [ball(c) + u[i] * y[0] + s[i] * y[1] + w[i] * z for i, c in enumerate(self.node)]

    def lift(self, field: Field, energy: Any, y: Vector) -> tuple[Vector, Any]:
        """Return the state on the energy over a box y, and z there.

        Raises:
            NotClosed: the interval Newton method does not show that there is exactly one.
        """
        w, middle = self.columns[3], [v.mid() for v in y]
        guess = flint.arb(0)
        for _ in range(4):
            state = self.place(middle, guess)
            guess = (guess - (field.height(state) - energy) / dot(field.gradient(state), w)).mid()
        interval = guess
        for _ in range(6):
            slope = dot(field.gradient(self.place(y, interval)), w)
            found = guess - (field.height(self.place(y, guess)) - energy) / slope
            if found in interval and found.is_finite():
                return self.place(y, found), interval
            interval = guess + symmetric((found - guess) * 2)
        raise NotClosed("the energy does not fix a node's section")

    def tangents(self, field: Field, state: Vector) -> Any:
        """Return ∂x/∂y (N, 2) over a box of states on the energy."""
        u, s, _, w = self.columns
        gradient = field.gradient(state)
        across = dot(gradient, w)
        along = [dot(gradient, t) / across for t in (u, s)]
        return columns([[u[i] - w[i] * along[0], s[i] - w[i] * along[1]] for i in range(len(w))])


def dot(first: Vector, second: Vector) -> Any:
    """Return the scalar product of two vectors of balls."""
    return sum((a * b for a, b in zip(first, second, strict=True)), flint.arb(0))


@dataclass(frozen=True)
class ChartSegment:
    """The map g between two charts over a box about zero.

    value (2,): g(0). slope (2, 2): Dg over the box. time: duration over the box in s, `at_node` from the node itself,
    `delays` (2,) its derivative by y over the box. spans: of the flight over the box, as `FlownBall` has them.
    landed (N,): the state at the end, from the node itself.
    """

    value: Vector
    slope: Any
    time: Any
    at_node: Any
    delays: Vector
    spans: list[tuple[Any, Any, Vector]]
    landed: Vector


@dataclass(frozen=True)
class Leg:
    """A segment to prove: between two charts, its duration in s, the whole turns (N,) added to the second's node."""

    first: SectionChart
    second: SectionChart
    duration: Fraction
    shift: tuple[int, ...]


@dataclass(frozen=True)
class Surface:
    """An energy of a system with exact parameters: its field, the exact energy, and which states (N,) turn by 2π."""

    field: Field
    energy: Fraction
    turns: tuple[bool, ...]
    parameters: Sequence[Fraction] = ()

    @cached_property
    def height(self) -> Any:
        """The energy as a ball."""
        return ball(self.energy)

    def lift(self, shift: Sequence[int]) -> Vector:
        """Return whole turns (N,) as lengths."""
        return [
            2 * flint.arb.pi() * int(k) if turning else flint.arb(0)
            for k, turning in zip(shift, self.turns, strict=True)
        ]


def staying(field: Field, state: Vector, longest: Any) -> tuple[Vector, Vector, Vector]:
    """Return a box that states do not leave for a time forward and backward, and f and Df over it.

    Raises:
        NotClosed: no box closes.
    """
    around, rates = symmetric(longest), field.rate(state)[0]
    for _ in range(5):
        box = [x + 2 * around * symmetric(f) for x, f in zip(state, rates, strict=True)]
        rates, slopes = field.slopes(box)
        if all((x + around * f) in b for x, f, b in zip(state, rates, box, strict=True)):
            return box, rates, slopes
    raise NotClosed("the enclosure of a section's crossing does not close")


def _crossing(surface: Surface, chart: SectionChart, state: Vector, shift: Vector) -> tuple[Any, Vector, Vector]:
    """Return when states meet a chart's section, exactly once in a short time about now, and f and Df meanwhile."""
    height = chart.coordinates(state, shift)[2]
    longest = (3 * height / dot(chart.rows[2], surface.field.rate(state)[0])).abs_upper() + flint.arb(1) / 10**30
    _, rates, slopes = staying(surface.field, state, longest)
    speed = dot(chart.rows[2], rates)
    if not (speed > 0 and longest * speed.abs_lower() > height.abs_upper()):
        raise NotClosed("the enclosure of a section's crossing does not close")
    return -height / speed, rates, slopes


def segment(surface: Surface, leg: Leg, radii: Vector, arriving: Vector, settings: FlowSettings) -> ChartSegment:
    """Enclose the map from one chart over a box |y_i| ≤ radii_i to the next, whose box is |y_i| ≤ arriving_i.

    Raises:
        NotClosed: an enclosure does not close.
    """
    field, zero = surface.field, [flint.arb(0), flint.arb(0)]
    shift = surface.lift(leg.shift)
    start, _ = leg.first.lift(field, surface.height, zero)
    y = [symmetric(r) for r in radii]
    states, _ = leg.first.lift(field, surface.height, y)
    tangents = leg.first.tangents(field, states)
    flown = fly(field, start, tangents * columns([[v] for v in y]), leg.duration, settings)
    # The point: where it meets the section, and its coordinates there.
    time, rates, _ = _crossing(surface, leg.second, flown.thin, shift)
    landed = [x + time * f for x, f in zip(flown.thin, rates, strict=True)]
    value = leg.second.coordinates(landed, shift)[:2]
    # The box: its times, and the derivative there.
    times, rates, slopes = _crossing(surface, leg.second, flown.box, shift)
    grown = columns([[v.abs_upper() for v in row] for row in field.matrix(slopes)]) * times.abs_upper()
    late = flint.arb_mat(4, 4, [symmetric(v) for v in (grown.exp() - identity()).entries()])
    moved = ((identity() + late) * flown.derivative * tangents).transpose().tolist()
    normal = leg.second.rows[2]
    speed = dot(normal, rates)
    delays = [-dot(normal, one) / speed for one in moved]
    projected = [[m + f * d for m, f in zip(one, rates, strict=True)] for one, d in zip(moved, delays, strict=True)]
    slope = [[dot(row, one) for one in projected] for row in leg.second.rows[:2]]
    ends = [x + times * f for x, f in zip(flown.box, rates, strict=True)]
    arrived = [symmetric(r) for r in arriving]
    # Over the second box no two z, the chart's own and the one that arrives, have one energy: they are the same.
    own = leg.second.lift(field, surface.height, arrived)[1]
    reached = leg.second.place(arrived, own.union(leg.second.coordinates(ends, shift)[3]))
    if dot(field.gradient(reached), leg.second.columns[3]).contains(0):
        raise NotClosed("the energy does not fix a node's section")
    duration = ball(leg.duration)
    return ChartSegment(value, columns(slope), duration + times, duration + time, delays, flown.spans, landed)


def directions(system: System, states: Array, stms: Array, *, closed: bool, first: Array, last: Array) -> Array:
    """Return bases (K, N, N) of sections at nodes (K, N), columns u, s, f, w, in doubles.

    stms (K - 1, N, N), or (K, N, N) of a closed chain: from each node to the next. first, last (N,): directions that
    grow from the first node, and shrink towards the last; carried along they become those of all nodes. u, s, w are
    orthogonal to the flow in scaled coordinates, u and s in the energy's tangent plane.
    """
    scale, numeric, count = system.scale, system.numeric, len(states)
    flow = numeric.rate(states) / scale
    flow = flow / np.linalg.norm(flow, axis=1, keepdims=True)
    steep = numeric.gradient(states) * scale
    steep = steep / np.linalg.norm(steep, axis=1, keepdims=True)
    scaled = stms * scale / scale[:, None]

    def along(k: int, vector: Array) -> Array:
        flat = vector - flow[k] * (flow[k] @ vector)
        flat = flat - steep[k] * (steep[k] @ flat)
        return np.asarray(flat / np.linalg.norm(flat))

    grows, shrinks = np.empty((count, states.shape[1])), np.empty((count, states.shape[1]))
    rounds = 4 if closed else 1
    vector = along(0, first / scale)
    for k in range(rounds * count - (not closed)):
        grows[k % count] = vector
        vector = along((k + 1) % count, scaled[k % count] @ vector)
    grows[-1 if not closed else 0] = vector
    vector = along(count - 1, last / scale)
    for k in reversed(range(rounds * count - (not closed))):
        shrinks[(k + 1) % count] = vector
        vector = along(k % count, np.linalg.solve(scaled[k % count], vector))
    shrinks[0] = vector
    return np.stack([grows, shrinks, flow, steep], axis=2) * scale[:, None]


def chart_of(state: Array, basis: Array) -> SectionChart:
    """Return the chart about a state (N,) with a basis (N, N), both doubles."""
    return SectionChart(tuple(Fraction(float(v)) for v in state), tuple(tuple(float(v) for v in row) for row in basis))
