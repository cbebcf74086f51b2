"""Independent check of certificates of periodic orbits, walks, and networks of connections.

This code shares flint's arithmetic with the search, and what follows from enclosures: modules symbols and covering.

The equations of two arms and of three bodies are written by hand, with derivatives from dual numbers. The integrator is
classical: Picard's iteration for a box that holds a step's solutions, Taylor polynomials, and Lagrange's remainder from
the next coefficient over that box. Steps are halved until both are good. For closed orbits, charts are not used. The
unknowns are all nodes x_k, durations τ_k and one number ε,

    Φ(x_k, τ_k) - x_{k+1} - [k last] (turn + ε v) = 0,      n_k·(x_k - x̄_k) = 0,      H(x_0) = h,

and Newton–Kantorovich is applied to them about the certificate's numbers, in a ball of the radius `unique`. Since
H(x_0 + ε v) = H(x_0) along a solution and ∇H·v has a sign, ε vanishes.

A symbol's claims are then checked in the boxes of all steps: its section crossings, the lifted saddle at its stop, the
nearest connection at its node, and its wraps.

Networks have charts x = x̄ + u y_1 + s y_2 + w z with columns u, s, f, w of a basis. H = h determines z over a box of y,
since H changes along w and its variation over the box is small. The derivative of the flow's map from chart to chart
follows by the chain rule, with the time at which the normal coordinate, along f, vanishes.

The statement is composed from the certificate's numbers. A certificate with another statement is rejected.

A certificate includes a digest of its content to detect accidental changes, on which the proof does not depend.

Source: Moore, Kearfott, Cloud, Introduction to Interval Analysis (2009), chapter 10.
"""

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import checked_source
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.proofs.balls import (
    NotClosed,
    flint,
    fraction,
    identity,
    largest,
    located,
    number,
    symmetric,
    working,
)
from dpcontrol.proofs.covering import ChartSegment, Enclosure, Network, orbit_boxes, proved_link
from dpcontrol.proofs.statements import interval, statement
from dpcontrol.proofs.symbols import Enclosed, check_symbols, dot

FORMAT = "dpcontrol proof 3"
_BITS, _ORDER, _BOX_ORDER, _REMAINDER, _WIDE_REMAINDER, _DERIVATIVE_REMAINDER = 140, 18, 7, "1e-18", "1e-13", "1e-5"
_LONGEST, _SHORTEST, _MOST_STEPS, _MOST_NODES, _PARTS = Fraction(1, 128), Fraction(1, 2**20), 30_000, 500, 4
"""Steps in s, limits on the work that a file can cause, and parts of a step with boxes of their own."""


@dataclass(frozen=True)
class CertificateCheck(Documented):
    """The verdict on a certificate, with the proved statement or the step that fails.

    Attributes:
        proved: True if every step holds.
        status: the step that fails, or a summary.
        statement: proved statement, or None.
    """

    proved: bool
    status: str
    statement: str | None

    @property
    def missed(self) -> str:
        """The step that fails."""
        return "" if self.proved else self.status


def digest(certificate: Mapping[str, Any]) -> str:
    """Return the digest of a certificate's content without its own entry, by which accidental changes are detected.

    Args:
        certificate: JSON values by key.
    """
    content = {key: value for key, value in certificate.items() if key != "digest"}
    return hashlib.sha256(json.dumps(content, sort_keys=True, ensure_ascii=True).encode()).hexdigest()


class _Dual:
    """A number with its four partial derivatives by the state, each a ball or a power series of balls.

    Sums, products and functions of such numbers follow the rules of differentiation, so that the equations' derivatives
    need not be written down.
    """

    def __init__(self, value: Any, partials: Sequence[Any]) -> None:
        """Hold a value and its derivatives (4,) by the state's coordinates."""
        self.value, self.partials = value, partials

    def _by(self, value: Any, slope: Any) -> "_Dual":
        """Return a function's value at this number by the chain rule; `slope` is the function's derivative there."""
        return _Dual(value, [slope * p for p in self.partials])

    def __add__(self, other: Any) -> "_Dual":
        """Return the sum with another number, with a ball or with a constant."""
        if not isinstance(other, _Dual):
            return _Dual(self.value + other, self.partials)
        return _Dual(self.value + other.value, [a + b for a, b in zip(self.partials, other.partials, strict=True)])

    def __mul__(self, other: Any) -> "_Dual":
        """Return the product with another number, with a ball or with a constant."""
        if not isinstance(other, _Dual):
            return self._by(self.value * other, other)
        pairs = zip(self.partials, other.partials, strict=True)
        return _Dual(
            self.value * other.value, [slope * other.value + self.value * other_slope for slope, other_slope in pairs]
        )

    def square(self) -> "_Dual":
        """Return the square of the number, which may be a ball about zero."""
        # Powers of balls about zero are undefined in flint.
        return self._by(self.value * self.value, 2 * self.value)

    def power(self, exponent: int) -> "_Dual":
        """Return the number raised to an integer power, negative ones included."""
        return self._by(self.value**exponent, exponent * self.value ** (exponent - 1))

    def inverse_root(self) -> "_Dual":
        """Return one divided by the square root, as in a distance's inverse."""
        root = self.value.rsqrt()
        return self._by(root, root**3 / -2)

    def sine_cosine(self) -> "tuple[_Dual, _Dual]":
        """Return sine and cosine of the number, an angle in rad."""
        sine, cosine = self.value.sin_cos()
        return self._by(sine, cosine), self._by(cosine, -sine)

    __radd__, __rmul__ = __add__, __mul__


class _Flow(ABC):
    """A system's integrator in flint's arithmetic at the working precision.

    `angles` is the number of coordinates that turn, which come first. `pace` is the length of the next step, s: it is
    halved after a step that fails, and doubled, up to `longest`, at the start of a flight. `left` decreases by one with
    each step. `remainder` limits the remainder of a step.
    """

    angles: int

    def __init__(self) -> None:
        """Start with steps of the length `pace`, s, that are at most `longest`.

        `remainder` limits the remainder of a step, and `left` is the number of steps that a file may still use.
        """
        self.longest, self.remainder = _LONGEST, _REMAINDER
        self.pace, self.left = self.longest, _MOST_STEPS

    @abstractmethod
    def rate(self, x: Sequence[_Dual]) -> list[_Dual]:
        """Return the rates f(x) (4,) of a state x (4,), with their derivatives."""

    @abstractmethod
    def height(self, x: Sequence[_Dual]) -> _Dual:
        """Return the energy H(x) of a state x (4,), with its gradient."""

    def energy(self, x: Sequence[Any]) -> _Dual:
        """Return the energy of a box of states x (4,), with its gradient as `partials`."""
        return self.height(self.duals(x))

    def duals(self, x: Sequence[Any]) -> list[_Dual]:
        """Return the coordinates of a state x (4,) as numbers with their derivatives by the state."""
        return [_Dual(value, row) for value, row in zip(x, identity().tolist(), strict=True)]

    def slopes(self, x: Sequence[Any]) -> tuple[list[Any], Any]:
        """Return the rates f (4,) and their derivative Df (4, 4) over a box of states x (4,)."""
        rates = self.rate(self.duals(x))
        return [f.value for f in rates], flint.arb_mat([f.partials for f in rates])

    def late(self, slopes: Any, time: Any) -> Any:
        """Return an enclosure (4, 4) of the flow's derivative after any time up to `time`, s.

        `slopes` encloses Df over a box that the solutions do not leave in this time. By Gronwall's inequality, the
        derivative differs from one by at most exp(|Df| time) - 1, entry by entry.
        """
        grown = (flint.arb_mat(4, 4, [v.abs_upper() for v in slopes.entries()]) * time).exp() - identity()
        return identity() + flint.arb_mat(4, 4, [symmetric(v) for v in grown.entries()])

    def series(self, x: Sequence[Any], order: int, width: int) -> list[list[Any]]:
        """Return Taylor coefficients in time of the states from a box x (4,), and of columns of the flow's derivative.

        The 4 + 4 `width` lists hold order + 1 coefficients each: first the states, then the derivative row by row.
        """
        coefficients = [[v] for v in x] + [[v] for row in identity().tolist() for v in row[:width]]
        for degree in range(1, order + 1):
            # Flint keeps as many coefficients of a series as are known.
            flint.ctx.cap = degree
            series = [flint.arb_series(c) for c in coefficients]
            rates = self.rate([_Dual(series[i], series[4 + width * i :][:width]) for i in range(4)])
            for c, r in zip(
                coefficients, [f.value for f in rates] + [p for f in rates for p in f.partials], strict=True
            ):
                c.append(r[degree - 1] / degree)
        return coefficients

    def rough(self, x: Sequence[Any], time: Any) -> list[Any]:
        """Return a box (4,) that contains all solutions from the box x (4,) during `time`, a ball of times in s.

        By Picard's theorem, a box that contains its image under x + time f holds them.

        Raises:
            NotClosed: no such box is found; a shorter step may help.
        """
        box = list(x)
        for _ in range(12):
            image = [v + time * r for v, r in zip(x, self.slopes(box)[0], strict=True)]
            if all(r in b for r, b in zip(image, box, strict=True)):
                return box
            # The next trial holds the start and the image, with an eighth more on all sides.
            box = [r.union(v) + symmetric((r - v) / 8 + number("1e-25")) for r, v in zip(image, x, strict=True)]
        raise NotClosed("a step's box does not close")

    def step(self, thin: Sequence[Any], carried: Any, spread: Any, h: Any) -> tuple[list[Any], Any, list[list[Any]]]:
        """Advance a thin point and the derivative over its box by one step of h (s).

        Args:
            thin: narrow box (4,) of the point itself.
            carried: derivative (4, 4) of the flow up to the step, over the whole box.
            spread: column (4, 1) from the first thin point to all states of the first box.
            h: length of the step, a ball, s.

        Returns:
            The thin point and the derivative after the step, and boxes (4,) of all solutions during its parts.

        Raises:
            NotClosed: the step is too long for its box or its remainders.
        """
        box = [c + d for c, d in zip(thin, (carried * spread).entries(), strict=True)]
        # The ball 0.5 ± 0.5 times h holds all times of the step.
        step_box = self.rough(box, h * flint.arb(0.5, 0.5))

        def ahead(near: Sequence[Any], last: Sequence[Any], time: Any = h) -> list[Any]:
            """Return the sums of Taylor coefficients `near` at a time, with remainders of the coefficients `last`."""
            return [
                sum((v * time**k for k, v in enumerate(c)), r * time ** len(c)) for c, r in zip(near, last, strict=True)
            ]

        # Lagrange's remainder is the next coefficient, enclosed over all states of the step.
        state_rest = [c[-1] for c in self.series(step_box, _ORDER + 1, 0)]
        # Coefficient k along a solution equals the coefficient at its state times the derivative.
        box_rest = [c[-1] for c in self.series(step_box, _BOX_ORDER + 1, 4)]
        slope_rest = flint.arb_mat(4, 4, box_rest[4:]) * self.late(self.slopes(step_box)[1], h)
        remainders = (state_rest, _ORDER, self.remainder), (slope_rest.entries(), _BOX_ORDER, _DERIVATIVE_REMAINDER)
        if not all(abs(r) * h ** (order + 1) < number(limit) for row, order, limit in remainders for r in row):
            raise NotClosed("the remainder of a step is too large")
        around = self.series(box, _BOX_ORDER, 4)
        return (
            ahead(self.series(thin, _ORDER, 0), state_rest),
            flint.arb_mat(4, 4, ahead(around[4:], slope_rest.entries())) * carried,
            [ahead(around[:4], box_rest[:4], h * flint.arb(k + 0.5, 0.5) / _PARTS) for k in range(_PARTS)],
        )

    def flight(self, x: Sequence[Any], spread: Any, duration: Fraction) -> tuple[list[Any], Any, list[list[Any]]]:
        """Integrate a thin point and the derivative over its box for a duration, with steps that are short enough.

        A thin point is a box (4,) that is no wider than the rounding errors about one state. The flow's derivative over
        the wide box about it, times the difference of two states at the start, encloses their difference at the end.
        Steps that fail are halved; each flight begins with twice the last length.

        Args:
            x: thin point (4,).
            spread: column (4, 1) from the point to all states of the box.
            duration: time, s.

        Returns:
            The thin end (4,), the flow's derivative (4, 4) over the box, and the boxes (4,) of all steps.

        Raises:
            NotClosed: the flight takes too many or too short steps.
        """
        carried, thin, boxes, elapsed = identity(), list(x), [], Fraction(0)
        self.pace = min(2 * self.pace, self.longest)
        while elapsed < duration:
            h, self.left = min(self.pace, duration - elapsed), self.left - 1
            if self.pace < _SHORTEST or self.left < 0:
                raise NotClosed("its flight takes too many or too short steps")
            try:
                thin, carried, parts = self.step(thin, carried, spread, number(h))
            except NotClosed:
                self.pace /= 2
                continue
            boxes += parts
            elapsed += h
        return thin, carried, boxes


class _Pendulum(_Flow):
    """Two arms as a system, with the constants A, B, C, G₁ and G₂ of the guide."""

    def __init__(self, data: Mapping[str, Any]) -> None:
        """Compute the constants from a certificate's masses (kg), lengths (m), inertias (kg m²) and gravity (m/s²)."""
        super().__init__()
        keys = ("mass", "centre_of_mass", "length", "inertia")
        (m1, m2), (a1, a2), (l1, _), (j1, j2) = ([fraction(v) for v in data[key]] for key in keys)
        (gravity,), self.angles = map(fraction, data["gravity"]), 2
        g1 = m1 * a1 + m2 * l1
        inertias = j1 + m1 * a1**2 + m2 * l1**2, j2 + m2 * a2**2, m2 * l1 * a2
        self.numbers = [number(v) for v in (*inertias, gravity * g1, gravity * m2 * a2)]

    def rate(self, x: Sequence[_Dual]) -> list[_Dual]:
        """Return the angular velocities and accelerations (4,) at angles and angular velocities x (4,)."""
        a, b, c, g1, g2 = self.numbers
        sine, cosine = (x[0] + x[1] * -1).sine_cosine()
        first_torque = sine * x[3].square() * -c + x[0].sine_cosine()[0] * -g1
        second_torque = sine * x[2].square() * c + x[1].sine_cosine()[0] * -g2
        inverse_determinant = ((cosine * c).square() * -1 + a * b).power(-1)
        accelerations = (
            (first_torque * b + cosine * second_torque * -c) * inverse_determinant,
            (second_torque * a + cosine * first_torque * -c) * inverse_determinant,
        )
        return [x[2], x[3], *accelerations]

    def height(self, x: Sequence[_Dual]) -> _Dual:
        """Return the energy, J, at angles and angular velocities x (4,)."""
        a, b, c, g1, g2 = self.numbers
        kinetic = x[2].square() * (a / 2) + x[3].square() * (b / 2)
        coupling = (x[0] + x[1] * -1).sine_cosine()[1] * x[2] * x[3] * c
        return kinetic + coupling + x[0].sine_cosine()[1] * -g1 + x[1].sine_cosine()[1] * -g2


class _ThreeBodies(_Flow):
    """The planar circular restricted three-body problem in the rotating frame."""

    def __init__(self, data: Mapping[str, Any]) -> None:
        """Read the mass ratio of a certificate's system; no coordinate turns."""
        super().__init__()
        (self.mu,), self.angles = map(number, data["mass_ratio"]), 0

    def _pull(self, x: Sequence[_Dual]) -> list[tuple[Any, _Dual, _Dual]]:
        """Return the mass, the distance along x and the inverse distance of both primaries from a state x (4,)."""
        bodies = (1 - self.mu, x[0] + self.mu), (self.mu, x[0] + (self.mu - 1))
        return [(mass, offset, (offset.square() + x[1].square()).inverse_root()) for mass, offset in bodies]

    def rate(self, x: Sequence[_Dual]) -> list[_Dual]:
        """Return velocities and accelerations (4,) at positions and velocities x (4,) in the rotating frame."""
        x_acceleration, y_acceleration = x[0] + x[3] * 2, x[1] + x[2] * -2
        for mass, offset, inverse in self._pull(x):
            cube = inverse.power(3) * -mass
            x_acceleration, y_acceleration = x_acceleration + offset * cube, y_acceleration + x[1] * cube
        return [x[2], x[3], x_acceleration, y_acceleration]

    def height(self, x: Sequence[_Dual]) -> _Dual:
        """Return the Jacobi energy at positions and velocities x (4,) in the rotating frame."""
        energy = (x[2].square() + x[3].square()) * number("0.5")
        for mass, offset, inverse in self._pull(x):
            energy = energy + (offset.square() + x[1].square()) * (-mass / 2) + inverse * -mass
        return energy


_SYSTEMS = {"double pendulum": _Pendulum, "three bodies": _ThreeBodies}


class _Chart:
    """The plane through a node along u, s and w, on which the energy determines w's coordinate z over a box.

    The basis consists of the growing direction u, the shrinking direction s, the flow f and a direction w in which the
    energy changes. The coordinates y along u and s are those of boxes. `rows` is the inverse of the basis, and `level`
    the energy of the node minus the middle one. For an interval of energies, boxes move along the tilt, the change (2,)
    of y with the energy, by at most their distance `within` from the middle.
    """

    def __init__(self, flow: _Flow, data: Mapping[str, Any], energy: Any, within: Any) -> None:
        """Read a chart from a certificate; `energy` and `within` are the middle and the half-width of its energies."""
        self.flow, self.node, self.within = flow, [number(v) for v in data["node"]], within
        self.tilt = [number(v) for v in data.get("tilt", "00")]
        self.basis = flint.arb_mat([[number(v) for v in row] for row in data["basis"]])
        self.rows, self.level = self.basis.inv().tolist(), flow.energy(self.node).value - energy

    def box(self, widths: Sequence[Any], z: Any) -> tuple[list[Any], list[Any]]:
        """Return the states of a box of this chart, and the derivative of H over them along the basis.

        Args:
            widths: half-widths (2,) of the box in y.
            z: coordinate along w, a ball.

        Returns:
            Box of states (4,), and derivatives (4,) along u, s, f and w.
        """
        column = [[symmetric(widths[0])], [symmetric(widths[1])], [flint.arb(0)], [z]]
        states = [c + d for c, d in zip(self.node, (self.basis * flint.arb_mat(column)).entries(), strict=True)]
        return states, (flint.arb_mat([self.flow.energy(states).partials]) * self.basis).entries()

    def wide(self, widths: Sequence[Any]) -> list[Any]:
        """Return the half-widths (2,) of a box that contains the boxes of half-widths `widths` (2,) at all energies."""
        return [width + abs(change) * self.within for width, change in zip(widths, self.tilt, strict=True)]

    def height(self, widths: Sequence[Any]) -> Any:
        """Return an interval that contains exactly one z of each energy for each y in a box of half-widths (2,).

        Raises:
            NotClosed: the energy is not proved to determine z.
        """
        reach = flint.arb(0)
        for _ in range(8):
            _, (along_u, along_s, _, along_w) = self.box(widths, symmetric(reach))
            needed = (abs(self.level) + self.within + abs(along_u) * widths[0] + abs(along_s) * widths[1]) / abs(
                along_w
            )
            if needed < reach:
                return symmetric(reach)
            reach = 2 * needed.upper() + number("1e-30")
        raise NotClosed("the energy does not determine the states of a box")

    def away(self, row: int, state: Sequence[Any], shift: Sequence[Any]) -> Any:
        """Return a coordinate of a state (4,) minus a shift (4,) of whole turns.

        `row` selects it: 0 and 1 for y, 2 for the height over the plane, 3 for z.
        """
        return dot(self.rows[row], [x - c - t for x, c, t in zip(state, self.node, shift, strict=True)])


def _segment(
    flow: _Flow, charts: tuple[_Chart, _Chart], widths: Sequence[Any], duration: Fraction, turns: Sequence[int]
) -> ChartSegment:
    """Enclose the map from a box of one chart to the next chart, at all energies of the charts.

    Charts are planes through nodes with coordinates y along u and s, see `_Chart`. The result holds the map of the node
    of the first box, its derivative over the box and the durations.

    Args:
        flow: integrator of the system.
        charts: the chart at the start and the one at the end.
        widths: half-widths (2, 2) of the boxes in both charts.
        duration: time of flight between the charts, s.
        turns: whole turns (4,) by which the second chart is shifted.

    Raises:
        NotClosed: an enclosure does not close.
    """
    (first, second), shift = charts, [2 * flint.arb.pi() * int(k) for k in turns]
    first_widths, second_widths = (chart.wide(sizes) for chart, sizes in zip(charts, widths, strict=True))
    z = first.height(first_widths)
    # Derivatives of H along u, s and w determine the change of z over the box.
    states, (along, beside, _, across) = first.box(first_widths, z)
    rise = (1 - dot([along, beside], first.tilt)) / across
    tangents = first.basis * flint.arb_mat(
        [[1, 0, first.tilt[0]], [0, 1, first.tilt[1]], [0, 0, 0], [-along / across, -beside / across, rise]]
    )
    # At y = 0, the middle energy determines z up to the derivative of H along w.
    thin_start, _ = first.box([flint.arb(0)] * 2, -first.level / first.box([flint.arb(0)] * 2, z)[1][3])
    spread = flint.arb_mat([[x - c] for x, c in zip(states, thin_start, strict=True)])
    end, derivative, boxes = flow.flight(thin_start, spread, duration)
    ends = [c + d for c, d in zip(end, (derivative * spread).entries(), strict=True)]
    normal = second.rows[2]
    # Twice the estimated time to the second chart's plane, before or after the end of the flight.
    reach = symmetric(2 * second.away(2, ends, shift) / dot(normal, flow.slopes(ends)[0])) + symmetric(number("1e-30"))
    crossing_box = flow.rough(ends, reach)
    rates, slopes = flow.slopes(crossing_box)
    speed = dot(normal, rates)
    time, thin_time = (-second.away(2, x, shift) / speed for x in (ends, end))
    if not abs(time) < reach.abs_upper():
        raise NotClosed("a box is not proved to meet the next chart once")
    moved_tangents = (flow.late(slopes, reach) * derivative * tangents).transpose().tolist()
    # Displacements along each tangent delay the crossing, and are projected onto the plane along the flow.
    *delays, energy_delay = [-dot(normal, column) / speed for column in moved_tangents]
    projected = flint.arb_mat(
        [
            [m + f * d for m, f in zip(column, rates, strict=True)]
            for column, d in zip(moved_tangents, [*delays, energy_delay], strict=True)
        ]
    )
    # The first two rows are derivatives by y, and the last one is that by the energy.
    *along, across = (projected * flint.arb_mat(second.rows[:2]).transpose()).tolist()
    thin_arrival, arrival = (
        [x + t * f for x, f in zip(v, rates, strict=True)] for v, t in ((end, thin_time), (ends, time))
    )
    if second.box(second_widths, second.height(second_widths).union(second.away(3, arrival, shift)))[1][3].contains(0):
        raise NotClosed("the energy does not determine the states of a box")
    energy_range, flight_time = symmetric(first.within), number(duration)
    value = [second.away(k, thin_arrival, shift) + (across[k] - second.tilt[k]) * energy_range for k in range(2)]
    slope, at_node = flint.arb_mat(along).transpose(), flight_time + thin_time + energy_delay * energy_range
    return ChartSegment(value, slope, flight_time + time, at_node, delays, [*boxes, crossing_box], states)


_KEYS = {
    "format statement versions system energy scale orbits links digest",
    "format statement versions system energy scale orbits links wraps entropy digest",
}


def _checked_network(flow: _Flow, data: Mapping[str, Any], progress: Progress) -> str:
    """Return the statement of a certificate of orbits and links, after proving it.

    A link is a chain of boxes from orbit to orbit, each of which the flow stretches across the next one. If the
    certificate states wraps and entropy, the marks of links (their boxes on their sections) are also proved to be
    apart, and both numbers are proved.

    Args:
        flow: integrator of the certificate's system.
        data: content of the certificate by key.
        progress: called with a label and the completed share.

    Raises:
        NotClosed: the numbers do not prove the statement, or the certificate has another one.
    """
    stated, energy, within = statement(data), number(data["energy"]), number(data.get("within", 0))
    charts = dict[str, _Chart]()
    if within < 0 or {*data} - {"within"} not in [{*keys.split()} for keys in _KEYS] or data["statement"] != stated:
        raise NotClosed("its statement is not that of its numbers, or it has other numbers")

    # The boxes of links are wider than the balls of closed orbits.
    flow.longest, flow.remainder, flow.left = 2 * _LONGEST, _WIDE_REMAINDER, 10 * _MOST_STEPS

    def enclosed(ends: Sequence[Any], widths: Any, duration: Fraction, turns: Sequence[int]) -> ChartSegment:
        """Enclose the map between the charts at both ends of a flight of this duration, s; see `_segment`.

        `ends` holds the charts' data, `widths` (2, 2) the half-widths of their boxes.

        Raises:
            NotClosed: the flight is too long, so that a certificate cannot cause unlimited work, or is not enclosed.
        """
        if duration > _LONGEST * _MOST_STEPS:
            raise NotClosed("a flight is too long")
        first, second = (charts.setdefault(repr(end), _Chart(flow, end, energy, within)) for end in ends)
        return _segment(flow, (first, second), widths, duration, turns)

    enclosure = Enclosure(
        enclosed,
        lambda box: flow.slopes(box)[0],
        [k < flow.angles for k in range(4)],
        [number(v) for v in data["scale"]],
    )
    orbits, links = [orbit_boxes(orbit, enclosure) for orbit in data["orbits"]], []
    for k, numbers in enumerate(data["links"]):
        progress("checking the flow", k / len(data["links"]))
        with located(f"link {k + 1}:"):
            links.append(proved_link(numbers, data["orbits"], enclosure))
    network = Network(orbits, links, enclosure)
    if "wraps" in data:
        network.check_marks()
        least = [n for row in network.fewest_wraps() for n in row if n is not None]
        if max(least) != int(data["wraps"]):
            raise NotClosed(f"its links need {max(least)} wraps, not {data['wraps']}")
        if not network.has_entropy(number(data["entropy"])):
            raise NotClosed("its entropy is not proved")
    return stated


def check(certificate: Mapping[str, Any], progress: Progress = no_progress) -> CertificateCheck:
    """Return the verdict on a certificate, by the equations and the integrator of this module.

    Args:
        certificate: JSON values by key.
        progress: called with a label and the completed share.

    Raises:
        PartMissing: python-flint is not installed.
    """
    try:
        if certificate["digest"] != digest(certificate) or certificate["format"] != FORMAT:
            raise NotClosed("its digest does not match its content, or its format is unknown")
        if "pieces" in certificate:
            return _checked_pieces(certificate, progress)
        with working(_BITS):
            flow = _SYSTEMS[certificate["system"]["equations"]](certificate["system"])
            prove = _checked_network if "links" in certificate else _checked
            return CertificateCheck(True, "the certificate proves its statement", prove(flow, certificate, progress))
    except (NotClosed, LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError) as error:
        invalid = "" if isinstance(error, NotClosed) else f"a value is missing or invalid, {type(error).__name__}: "
        return CertificateCheck(
            False, f"rejected: the certificate does not prove its statement: {invalid}{error}", None
        )


def _checked_pieces(data: Mapping[str, Any], progress: Progress) -> CertificateCheck:
    """Return the verdict on a certificate of several intervals of energies, which must be proved and leave no gap.

    `data` is the certificate's content by key; each of its "pieces" is the certificate of one interval.

    Raises:
        NotClosed: the intervals leave a gap, or the statement is not that of the intervals.
    """
    pieces, stated = data["pieces"], statement(data)
    if {*data} != {"format", "statement", "pieces", "digest"} or data["statement"] != stated:
        raise NotClosed("its statement is not that of its intervals, or it has other numbers")
    if any(before[1] != after[0] for before, after in pairwise(map(interval, pieces))):
        raise NotClosed("its intervals of energies leave gaps")
    for k, piece in enumerate(pieces):
        verdict = check(piece, part_of(progress, k / len(pieces), (k + 1) / len(pieces)))
        if not verdict.proved:
            return replace(verdict, status=f"interval {k + 1}: {verdict.status}")
    return CertificateCheck(True, "the certificate proves its statement", stated)


def check_file(file: Path, progress: Progress = no_progress) -> CertificateCheck:
    """Return the verdict on the certificate in a file.

    Args:
        file: JSON file of `prove --out`.
        progress: called with a label and the completed share.

    Raises:
        InputError: the file is missing, unreadable or no certificate.
        PartMissing: python-flint is not installed.
    """
    try:
        content = json.loads(checked_source(file).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot read {file}: {error.strerror}; give a file of `prove --out`") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file} is not a certificate: it is not JSON; give a file of `prove --out`") from error
    if not isinstance(content, dict) or not {"format", "nodes", "links", "digest"} & set(content):
        raise InputError(f"{file} is not a certificate: none of its keys is one's; give a file of `prove --out`")
    return check(content, progress)


def _trace_of_product(maps: Sequence[Any]) -> Any:
    """Return an enclosure of the trace of the flow's derivative over a closed orbit's period, from which λ follows.

    `maps` holds the derivatives (4, 4) of the flow from node to node of a closed orbit, in order. λ is the orbit's
    unstable multiplier.

    A plain product of enclosures loses all digits over a hundred nodes. In frames that follow the orbit, each factor is
    nearly triangular, with the directions of growth in order, and the errors grow no faster than the product.
    """
    # The frames of a second period no longer depend on the first frame.
    frames_along = accumulate(
        [*maps, *maps], lambda frame, factor: np.linalg.qr(_middle(factor) @ frame)[0], initial=np.eye(4)
    )
    frames = [flint.arb_mat(frame.tolist()) for frame in frames_along][len(maps) :]
    product = identity()
    # There is one more frame than maps: the one after the last map.
    for factor, before, after in zip(maps, frames, frames[1:], strict=False):
        product = after.inv() * factor * before * product
    return (product * frames[0].inv() * frames[-1]).trace()


def _middle(matrix: Any) -> Any:
    """Return the midpoints of a matrix of balls as doubles."""
    return np.array([[float(v.mid()) for v in row] for row in matrix.tolist()])


def _checked(flow: _Flow, data: Mapping[str, Any], progress: Progress) -> str:
    """Return the statement of a certificate of a closed orbit, after proving it.

    The rows of `matrix`, the derivative of the equations over the ball, are those of the nodes' defects, of the
    sections n_k and of the energy. Its columns are the states, the durations and ε, an unknown that makes the matrix
    square and is zero for an orbit (see the module's text). All are scaled.

    Args:
        flow: integrator of the certificate's system.
        data: content of the certificate by key.
        progress: called with a label and the completed share.

    Raises:
        NotClosed: the numbers do not prove the statement, or the certificate has another one.
    """
    nodes, normals = ([[number(v) for v in row] for row in data[key]] for key in ("nodes", "normals"))
    durations, scale = [fraction(v) for v in data["durations"]], [number(v) for v in data["scale"]]
    turns, unique, exists = [int(v) for v in data["turns"]], number(data["unique"]), number(data["exists"])
    # The unknown ε and the equation of the energy are the last ones.
    count, last, flights, stated = len(nodes), 5 * len(nodes), list[Any](), statement(data)
    sizes = {len(nodes), len(normals), len(durations)}, {len(v) for v in [*nodes, *normals, scale, turns]}
    if count > _MOST_NODES or sum(durations) > _MOST_STEPS * _LONGEST:
        raise NotClosed(f"its orbit has more than {_MOST_NODES} nodes or {float(_MOST_STEPS * _LONGEST):.0f} s")
    if data["statement"] != stated:
        raise NotClosed("its statement is not that of its numbers")
    positive = count > 1 and 0 < exists <= unique and min(durations) > 0 and all(s > 0 for s in scale)
    if sizes != ({count}, {4}) or not positive or any(turns[flow.angles :]):
        raise NotClosed("its nodes, normals, durations, turns or radii are inconsistent")
    spread, maps = flint.arb_mat([[symmetric(s * unique)] for s in scale]), list[Any]()
    matrix, residual = [[flint.arb(0)] * (last + 1) for _ in range(last + 1)], [flint.arb(0)] * (last + 1)
    # The vector v of ε v, along which the energy grows.
    direction = [g.mid() * s * s for g, s in zip(flow.energy(nodes[0]).partials, scale, strict=True)]
    for k in range(count):
        progress("checking the flow", k / count)
        next_node = (k + 1) % count
        thin, derivative, boxes = flow.flight(nodes[k], spread, durations[k])
        end_box = flow.rough(
            [c + d for c, d in zip(thin, (derivative * spread).entries(), strict=True)], symmetric(unique)
        )
        flights.append([*boxes, end_box])
        rates, slopes = flow.slopes(end_box)
        # Durations are unknowns too, which may differ by `unique`.
        derivative = flow.late(slopes, unique) * derivative
        maps.append(derivative)
        for i in range(4):
            row, turn = matrix[4 * k + i], 2 * flint.arb.pi() * turns[i] * int(next_node == 0)
            residual[4 * k + i] = (thin[i] - nodes[next_node][i] - turn) / scale[i]
            row[4 * k : 4 * k + 4] = [derivative[i, j] * scale[j] / scale[i] for j in range(4)]
            row[4 * next_node + i] += number(-1)
            row[4 * count + k], row[last] = rates[i] / scale[i], -direction[i] / scale[i] * int(next_node == 0)
            matrix[4 * count + k][4 * k + i] = normals[k][i] * scale[i]
    start = [c + d for c, d in zip(nodes[0], spread.entries(), strict=True)]
    within = symmetric(number(data.get("within", 0)))
    residual[last] = flow.energy(nodes[0]).value - number(data["energy"]) + within
    matrix[last][:4] = [p * s for p, s in zip(flow.energy(start).partials, scale, strict=True)]
    _check_solution(matrix, residual, exists)
    # H(x_0 + ε v) = H(x_0) implies ε = 0 only if H changes along v everywhere in between.
    moved_box = [x + p * symmetric(unique) for x, p in zip(start, direction, strict=True)]
    if dot(flow.energy(moved_box).partials, direction).contains(0):
        raise NotClosed("the energy does not determine the orbit")
    _check_bounds(data, number(sum(durations)) + count * symmetric(exists), maps)
    node_boxes = [[c + symmetric(s * exists) for c, s in zip(node, scale, strict=True)] for node in nodes]
    times, angles = [number(v) + symmetric(exists) for v in durations], [k < flow.angles for k in range(4)]
    if data["symbols"]:
        check_symbols(
            data["symbols"],
            Enclosed(flights, node_boxes, times, turns, angles, scale, lambda box: flow.slopes(box)[0]),
        )
    return stated


def _check_solution(matrix: Sequence[Sequence[Any]], residual: Sequence[Any], exists: Any) -> None:
    """Prove by Newton–Kantorovich that the equations have a solution within `exists` of the certificate's numbers.

    With an approximate inverse A of the derivative, this holds if A times the derivative differs from one by less than
    one (`contraction`) and A times the residual (`first`) is at most (1 - contraction) · exists.

    Args:
        matrix: derivative (M, M) of the equations over the ball of uniqueness.
        residual: values (M,) of the equations at the certificate's numbers.
        exists: radius of the ball that must contain the solution.

    Raises:
        NotClosed: the theorem does not prove it.
    """
    square = flint.arb_mat(matrix)
    inverse = flint.arb_mat(np.linalg.inv(_middle(square)).tolist())
    product = (inverse * square).tolist()
    contraction = largest(
        [sum((abs(entry - int(i == j)) for j, entry in enumerate(row)), flint.arb(0)) for i, row in enumerate(product)]
    )
    first = largest((inverse * flint.arb_mat([[entry] for entry in residual])).entries())
    if not (contraction < 1 and first <= (1 - contraction) * exists):
        raise NotClosed("Newton–Kantorovich does not prove an orbit within `exists` of its nodes")


def _check_bounds(data: Mapping[str, Any], period: Any, maps: Sequence[Any]) -> None:
    """Prove the bounds of a closed orbit's period and multiplier that its certificate states.

    The multipliers are 1, 1, λ and 1/λ, so the trace of the flow's derivative over a period gives λ + 1/λ.

    Args:
        data: content of the certificate by key.
        period: enclosure of the period, s.
        maps: derivatives (4, 4) of the flow from node to node.

    Raises:
        NotClosed: a bound is not proved.
    """
    low, high = map(number, data["period"])
    least_multiplier, sum_of_pair = number(data["multiplier_exceeds"]), abs(_trace_of_product(maps) - 2)
    # λ + 1/λ grows with |λ| > 1.
    if not (
        low <= period
        and period <= high
        and least_multiplier >= 1
        and sum_of_pair > least_multiplier + 1 / least_multiplier
    ):
        raise NotClosed("its period or its multiplier is not proved to be within its bounds")
