"""Charts of an energy's sections, and rigorous maps between them.

A chart about a node x̄ has a basis u, s, f, w. These are the growing and shrinking directions along an orbit, the flow,
and a direction in which the energy changes. The section is the plane through x̄ spanned by u, s and w. Two numbers y
determine a point of the section with energy h:

    x(y) = x̄ + u y_1 + s y_2 + w z(y),      H(x(y)) = h.

For an interval of energies about h̄, boxes move with the energy: they are about the y of a chart's tilt times h - h̄.
The interval Newton method proves existence and uniqueness of z in an interval. The flow maps one chart to the next,
with crossing time s(y) near zero after the segment's duration. The derivative of this map of the plane is

    Dg = L (1 - f n/(n·f)) V M ∂x/∂y,

where L and n are rows of the inverse basis, and V and M are derivatives of the flow over s and over the duration.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from dpcontrol.proofs.balls import Fraction, NotClosed, ball, columns, flint, identity, symmetric
from dpcontrol.proofs.covering import ChartSegment
from dpcontrol.proofs.flow import Field, FlowSettings, Vector, fly
from dpcontrol.proofs.symbols import dot


@dataclass(frozen=True)
class SectionChart:
    """An exact node (N,) with the basis (N, N) of its section.

    The columns of the basis are u, s, the flow and w, and y (2,) are the coordinates along u and s. `tilt` (2,) is the
    change of y with the energy by which boxes move, zero for a single energy.
    """

    node: tuple[Fraction, ...]
    basis: tuple[tuple[float | Fraction, ...], ...]
    tilt: tuple[Fraction, ...] = (Fraction(0), Fraction(0))

    @cached_property
    def columns(self) -> list[Vector]:
        """The basis by columns, as balls."""
        return [[ball(v) for v in column] for column in zip(*self.basis, strict=True)]

    @cached_property
    def rows(self) -> list[Vector]:
        """The rows of the inverse basis: y_1, y_2, the normal, z."""
        return columns(self.basis).inv().tolist()

    def coordinates(self, state: Vector, shift: Vector) -> Vector:
        """Return the coordinates (y_1, y_2, height above the section, z) of a state in this chart.

        Args:
            state: balls (N,).
            shift: whole turns of the chart, subtracted from the state (N,).
        """
        difference = [x - ball(c) - t for x, c, t in zip(state, self.node, shift, strict=True)]
        return [dot(row, difference) for row in self.rows]

    def place(self, y: Vector, z: Any) -> Vector:
        """Return the state x̄ + u y_1 + s y_2 + w z (N,) at coordinates of this chart.

        Args:
            y: y_1 and y_2 (2,).
            z: coordinate along w.
        """
        u, s, _, w = self.columns
        return [ball(c) + u[i] * y[0] + s[i] * y[1] + w[i] * z for i, c in enumerate(self.node)]

    def lift(self, field: Field, energy: Any, y: Vector) -> tuple[Vector, Any]:
        """Return the states of given energy over a box of coordinates y, in which the energy determines z.

        A state is x̄ + u y_1 + s y_2 + w z, with the chart's node x̄, the growing and shrinking directions u and s, and a
        direction w in which the energy changes.

        Args:
            field: programs of the system.
            energy: ball, in the system's unit.
            y: box (2,).

        Returns:
            Box of states (N,), and an interval that contains z.

        Raises:
            NotClosed: the interval Newton method does not prove a unique z.
        """
        guess = interval = flint.arb(0)
        for _ in range(8):
            slope = dot(field.gradient(self.place(y, interval)), self.columns[3])
            # One step of the interval Newton method; `refined` holds each z over the box if it lies in `interval`.
            refined = guess - (field.energy(self.place(y, guess))[0][0] - energy) / slope
            if refined in interval and refined.is_finite():
                return self.place(y, refined), interval
            guess = refined.mid()
            interval = guess + symmetric((refined - guess) * 2)
        raise NotClosed("the energy does not fix a node's section")

    def tangents(self, field: Field, state: Vector) -> Any:
        """Return the derivatives (N, 3) of the chart's states by y_1, y_2 and the energy, over a box of states.

        Args:
            field: programs of the system.
            state: box of states (N,).
        """
        u, s, _, w = self.columns
        # At fixed energy, z changes with y by -H_u/H_w and -H_s/H_w.
        gradient = field.gradient(state)
        slope_w = dot(gradient, w)
        slope_ratios = [dot(gradient, t) / slope_w for t in (u, s)]
        plane_rows = [[u[i] - w[i] * slope_ratios[0], s[i] - w[i] * slope_ratios[1]] for i in range(len(w))]
        tilt = [ball(v) for v in self.tilt]
        return columns([[*row, dot(row, tilt) + w[i] / slope_w] for i, row in enumerate(plane_rows)])


@dataclass(frozen=True)
class Leg:
    """A segment between two charts, with duration (s) and whole turns (N,)."""

    first: SectionChart
    second: SectionChart
    duration: Fraction
    shift: tuple[int, ...]


@dataclass(frozen=True)
class Surface:
    """The energy surfaces of a ball of energies; `turns` (N,) is True for the states with period 2π."""

    field: Field
    energy: Any
    turns: tuple[bool, ...]


@dataclass(frozen=True)
class Passage:
    """The unique crossing of a section near a box of states.

    Attributes:
        time: until the crossing, s.
        around (N,): all states up to the crossing.
        rates (N,): f over `around`.
        moved (N, N): derivative of the flow up to the crossing.
    """

    time: Any
    around: Vector
    rates: Vector
    moved: Any


def passage(field: Field, normal: Vector, height: Any, state: Vector) -> Passage:
    """Enclose the crossing of a section by all states of a box at small height above it.

    Args:
        field: programs of the system.
        normal: row n (N,) of the section n·x = const.
        height: height of the states above the section.
        state: box of states (N,).

    Raises:
        NotClosed: no invariant box closes, or the crossing is not proved to be unique.
    """
    failure = NotClosed("the enclosure of a section's crossing does not close")
    rates = field.rate(state)[0]
    longest = (3 * height / dot(normal, rates)).abs_upper() + flint.arb(1) / 10**30
    times = symmetric(longest)
    # By Picard's theorem, a box that contains its image holds all solutions during these times.
    for _ in range(5):
        crossing_box = [x + 2 * times * symmetric(f) for x, f in zip(state, rates, strict=True)]
        rates, slopes = field.slopes(crossing_box)
        if all((x + times * f) in b for x, f, b in zip(state, rates, crossing_box, strict=True)):
            break
    else:
        raise failure
    speed = dot(normal, rates)
    if not longest * abs(speed) > abs(height):
        raise failure
    time = -height / speed
    growth = columns([[v.abs_upper() for v in row] for row in field.matrix(slopes)]) * time.abs_upper()
    deviation = [symmetric(v) for v in (growth.exp() - identity()).entries()]
    return Passage(time, crossing_box, rates, identity() + flint.arb_mat(4, 4, deviation))


def segment(surface: Surface, leg: Leg, radii: Vector, arriving: Vector, settings: FlowSettings) -> ChartSegment:
    """Enclose the map from the box |y_i| ≤ radii_i of a chart to the box |y_i| ≤ arriving_i of the next chart.

    Here y (2,) are the coordinates of the charts along the growing and the shrinking direction. A thin point, the node
    of the first chart at the middle energy, is followed without the box's width, and the derivative encloses the rest.

    Args:
        surface: energy surface.
        leg: two charts with the flight between them.
        radii: half-widths (2,) of the first box.
        arriving: half-widths (2,) of the second box.
        settings: settings of the integrator.

    Raises:
        NotClosed: an enclosure does not close.
    """
    field, chart, shift = surface.field, leg.second, [2 * flint.arb.pi() * k for k in leg.shift]
    normal = chart.rows[2]
    energy_deviation = surface.energy - surface.energy.mid()
    start, _ = leg.first.lift(field, surface.energy.mid(), [flint.arb(0)] * 2)
    y, arriving_box = (
        [symmetric(r) + ball(t) * energy_deviation for r, t in zip(sizes, end_chart.tilt, strict=True)]
        for sizes, end_chart in ((radii, leg.first), (arriving, chart))
    )
    states, _ = leg.first.lift(field, surface.energy, y)
    tangents = leg.first.tangents(field, states)
    spread = tangents * columns([[v] for v in (*map(symmetric, radii), energy_deviation)])
    thin, derivative, end, steps = fly(field, start, spread, leg.duration, settings)
    thin_crossing, box_crossing = (passage(field, normal, chart.coordinates(x, shift)[2], x) for x in (thin, end))
    thin_arrival = [x + thin_crossing.time * f for x, f in zip(thin, thin_crossing.rates, strict=True)]
    moved_tangents = (box_crossing.moved * derivative * tangents).transpose().tolist()
    # Displacements along each tangent delay the crossing, and are projected onto the plane along the flow.
    *delays, energy_delay = [-dot(normal, column) / dot(normal, box_crossing.rates) for column in moved_tangents]
    projected = [
        [m + f * d for m, f in zip(column, box_crossing.rates, strict=True)]
        for column, d in zip(moved_tangents, [*delays, energy_delay], strict=True)
    ]
    *columns_y, energy_column = [[dot(row, column) for row in chart.rows[:2]] for column in projected]
    slope = columns(columns_y).transpose()
    box_arrival = [x + box_crossing.time * f for x, f in zip(end, box_crossing.rates, strict=True)]
    # Over the second box, z is unique for given energy, so the chart's z and the arriving z are equal.
    coordinate = chart.lift(field, surface.energy, arriving_box)[1]
    possible_states = chart.place(arriving_box, coordinate.union(chart.coordinates(box_arrival, shift)[3]))
    if dot(field.gradient(possible_states), chart.columns[3]).contains(0):
        raise NotClosed("the energy does not fix a node's section")
    thin_coordinates = zip(chart.coordinates(thin_arrival, shift)[:2], energy_column, chart.tilt, strict=True)
    value = [v + (a - ball(t)) * energy_deviation for v, a, t in thin_coordinates]
    total_time, at_node = (
        ball(leg.duration) + time for time in (box_crossing.time, thin_crossing.time + energy_delay * energy_deviation)
    )
    return ChartSegment(value, slope, total_time, at_node, delays, [*steps, box_crossing.around], states)
