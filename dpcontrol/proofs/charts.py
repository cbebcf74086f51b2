"""Charts of an energy's sections, and rigorous maps between them.

A chart about a node x̄ has a basis u, s, f, w. These are the growing and shrinking directions along an orbit, the flow,
and a direction in which the energy changes. The section is the plane through x̄ spanned by u, s and w. Two numbers y
determine a point of the section with energy h:

    x(y) = x̄ + u y_1 + s y_2 + w z(y),      H(x(y)) = h.

The interval Newton method proves existence and uniqueness of z in an interval. The flow maps one chart to the next,
with crossing time s(y) near zero after the segment's duration. The derivative of this map of the plane is

    Dg = L (1 - f n/(n·f)) V M ∂x/∂y,

where L and n are rows of the inverse basis, and V and M are derivatives of the flow over s and over the duration.
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
    """An exact node (N,) with the basis (N, N) of its section."""

    node: tuple[Fraction, ...]
    basis: tuple[tuple[float, ...], ...]

    @cached_property
    def columns(self) -> list[Vector]:
        """The basis by columns, as balls."""
        return [[ball(v) for v in column] for column in zip(*self.basis, strict=True)]

    @cached_property
    def rows(self) -> list[Vector]:
        """The rows of the inverse basis: y_1, y_2, the normal, z."""
        return columns(self.basis).inv().tolist()

    def coordinates(self, state: Vector, shift: Vector) -> Vector:
        """Return (y_1, y_2, height above the section, z) of a shifted state."""
        away = [x - ball(c) - t for x, c, t in zip(state, self.node, shift, strict=True)]
        return [dot(row, away) for row in self.rows]

    def place(self, y: Vector, z: Any) -> Vector:
        """Return x̄ + u y_1 + s y_2 + w z."""
        u, s, _, w = self.columns
        return [ball(c) + u[i] * y[0] + s[i] * y[1] + w[i] * z for i, c in enumerate(self.node)]

    def lift(self, field: Field, energy: Any, y: Vector) -> tuple[Vector, Any]:
        """Return the states of given energy over a box y, and z.

        Raises:
            NotClosed: the interval Newton method does not prove a unique z.
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
        """Return ∂x/∂y (N, 2) over a box of states with constant energy."""
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

    The duration (s) is `time` over the box and `at_node` from the node. Its derivative by y is `delays` (2,). The state
    `landed` (N,) is the end of the node's trajectory, and `spans` are those of `FlownBall`.

    Attributes:
        value (2,): g(0).
        slope (2, 2): Dg over the box.
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
    """A segment between two charts, with duration (s) and whole turns (N,)."""

    first: SectionChart
    second: SectionChart
    duration: Fraction
    shift: tuple[int, ...]


@dataclass(frozen=True)
class Surface:
    """An energy surface with exact parameters; some states (N,) have period 2π."""

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
    """Return an invariant box over a time, with f and Df.

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
    """Return the unique crossing time near zero, with f and Df."""
    height = chart.coordinates(state, shift)[2]
    longest = (3 * height / dot(chart.rows[2], surface.field.rate(state)[0])).abs_upper() + flint.arb(1) / 10**30
    _, rates, slopes = staying(surface.field, state, longest)
    speed = dot(chart.rows[2], rates)
    if not (speed > 0 and longest * speed.abs_lower() > height.abs_upper()):
        raise NotClosed("the enclosure of a section's crossing does not close")
    return -height / speed, rates, slopes


def segment(surface: Surface, leg: Leg, radii: Vector, arriving: Vector, settings: FlowSettings) -> ChartSegment:
    """Enclose the map from a chart's box to the next chart.

    The boxes are |y_i| ≤ radii_i and |y_i| ≤ arriving_i.

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
    # The point's section crossing and coordinates.
    time, rates, _ = _crossing(surface, leg.second, flown.thin, shift)
    landed = [x + time * f for x, f in zip(flown.thin, rates, strict=True)]
    value = leg.second.coordinates(landed, shift)[:2]
    # The box's crossing times and derivative.
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
    # Over the second box, z is unique for given energy, so the chart's z and the arriving z are equal.
    own = leg.second.lift(field, surface.height, arrived)[1]
    reached = leg.second.place(arrived, own.union(leg.second.coordinates(ends, shift)[3]))
    if dot(field.gradient(reached), leg.second.columns[3]).contains(0):
        raise NotClosed("the energy does not fix a node's section")
    duration = ball(leg.duration)
    return ChartSegment(value, columns(slope), duration + times, duration + time, delays, flown.spans, landed)


def directions(system: System, states: Array, stms: Array, *, closed: bool, first: Array, last: Array) -> Array:
    """Return bases (K, N, N) of the nodes' sections, in doubles.

    The columns are u, s, f, w. In scaled coordinates, u, s and w are orthogonal to the flow, and u and s lie in the
    tangent plane of the energy surface.

    Args:
        stms (K - 1, N, N): state-transition matrices, (K, N, N) for a closed chain.
        first (N,): growing direction at the first node.
        last (N,): shrinking direction at the last node.
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
    """Return the chart about a state (N,) with a basis (N, N)."""
    return SectionChart(tuple(Fraction(float(v)) for v in state), tuple(tuple(float(v) for v in row) for row in basis))
