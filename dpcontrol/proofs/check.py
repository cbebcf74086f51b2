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
_LONGEST, _SHORTEST, _MOST_STEPS, _MOST_NODES = Fraction(1, 128), Fraction(1, 2**20), 30_000, 500
"""Steps in s, and limits on the work that a file can cause."""


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
    """Return the digest of a certificate's content, excluding the digest itself.

    Args:
        certificate: JSON values by key.
    """
    rest = {key: value for key, value in certificate.items() if key != "digest"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, ensure_ascii=True).encode()).hexdigest()


class _Dual:
    """A number with four partial derivatives, as balls or power series."""

    def __init__(self, value: Any, partials: Sequence[Any]) -> None:
        self.value, self.partials = value, partials

    def _by(self, value: Any, slope: Any) -> "_Dual":
        return _Dual(value, [slope * p for p in self.partials])

    def __add__(self, other: Any) -> "_Dual":
        if not isinstance(other, _Dual):
            return _Dual(self.value + other, self.partials)
        return _Dual(self.value + other.value, [a + b for a, b in zip(self.partials, other.partials, strict=True)])

    def __mul__(self, other: Any) -> "_Dual":
        if not isinstance(other, _Dual):
            return self._by(self.value * other, other)
        pairs = zip(self.partials, other.partials, strict=True)
        return _Dual(self.value * other.value, [a * other.value + self.value * b for a, b in pairs])

    def square(self) -> "_Dual":
        # Powers of balls about zero are undefined in flint.
        return self._by(self.value * self.value, 2 * self.value)

    def power(self, exponent: int) -> "_Dual":
        return self._by(self.value**exponent, exponent * self.value ** (exponent - 1))

    def inverse_root(self) -> "_Dual":
        root = self.value.rsqrt()
        return self._by(root, root**3 / -2)

    def sine_cosine(self) -> "tuple[_Dual, _Dual]":
        sine, cosine = self.value.sin_cos()
        return self._by(sine, cosine), self._by(cosine, -sine)

    __radd__, __rmul__ = __add__, __mul__


class _Flow(ABC):
    """A system's integrator in flint's arithmetic at the working precision; `angles` of its states turn."""

    angles: int

    def __init__(self) -> None:
        self.longest, self.remainder = _LONGEST, _REMAINDER
        self.pace, self.left = self.longest, _MOST_STEPS

    @abstractmethod
    def rate(self, x: Sequence[_Dual]) -> list[_Dual]:
        """Return f(x)."""

    @abstractmethod
    def height(self, x: Sequence[_Dual]) -> _Dual:
        """Return H(x)."""

    def energy(self, x: Sequence[Any]) -> _Dual:
        return self.height(self.duals(x))

    def duals(self, x: Sequence[Any]) -> list[_Dual]:
        return [_Dual(value, row) for value, row in zip(x, identity().tolist(), strict=True)]

    def slopes(self, x: Sequence[Any]) -> tuple[list[Any], Any]:
        rates = self.rate(self.duals(x))
        return [f.value for f in rates], flint.arb_mat([f.partials for f in rates])

    def late(self, slopes: Any, time: Any) -> Any:
        """Return the flow's derivative over a time from an invariant box."""
        grown = (flint.arb_mat(4, 4, [v.abs_upper() for v in slopes.entries()]) * time).exp() - identity()
        return identity() + flint.arb_mat(4, 4, [symmetric(v) for v in grown.entries()])

    def series(self, x: Sequence[Any], order: int, width: int) -> list[list[Any]]:
        """Return Taylor coefficients of the states and the flow's derivative."""
        start = [[v] for v in x] + [[v] for row in identity().tolist() for v in row[:width]]
        for degree in range(1, order + 1):
            flint.ctx.cap = degree
            series = [flint.arb_series(c) for c in start]
            rates = self.rate([_Dual(series[i], series[4 + width * i :][:width]) for i in range(4)])
            for c, r in zip(start, [f.value for f in rates] + [p for f in rates for p in f.partials], strict=True):
                c.append(r[degree - 1] / degree)
        return start

    def rough(self, x: Sequence[Any], time: Any) -> list[Any]:
        """Return a box that contains all solutions from another box."""
        box = list(x)
        for _ in range(12):
            reached = [v + time * r for v, r in zip(x, self.slopes(box)[0], strict=True)]
            if all(r in b for r, b in zip(reached, box, strict=True)):
                return box
            box = [r.union(v) + symmetric((r - v) / 8 + number("1e-25")) for r, v in zip(reached, x, strict=True)]
        raise NotClosed("a step's box does not close")

    def step(self, thin: Sequence[Any], carried: Any, spread: Any, h: Any) -> tuple[list[Any], Any, list[Any]]:
        """Advance a thin point and the derivative by one step, and enclose all solutions during it in a box."""
        box = [c + d for c, d in zip(thin, (carried * spread).entries(), strict=True)]
        around = self.rough(box, h * flint.arb(0.5, 0.5))

        def ahead(near: Sequence[Any], order: int, last: Sequence[Any]) -> list[Any]:
            return [
                sum((c[k] * h**k for k in range(order + 1)), r * h ** (order + 1))
                for c, r in zip(near, last, strict=True)
            ]

        far = [c[-1] for c in self.series(around, _ORDER + 1, 0)]
        # Coefficient k along a solution equals the coefficient at its state times the derivative.
        rest = flint.arb_mat(4, 4, [c[-1] for c in self.series(around, _BOX_ORDER + 1, 4)[4:]])
        rest = rest * self.late(self.slopes(around)[1], h)
        remainders = (far, _ORDER, self.remainder), (rest.entries(), _BOX_ORDER, _DERIVATIVE_REMAINDER)
        if not all(abs(r) * h ** (order + 1) < number(most) for row, order, most in remainders for r in row):
            raise NotClosed("the remainder of a step is too large")
        over = ahead(self.series(box, _BOX_ORDER, 4)[4:], _BOX_ORDER, rest.entries())
        return ahead(self.series(thin, _ORDER, 0), _ORDER, far), flint.arb_mat(4, 4, over) * carried, around

    def flight(self, x: Sequence[Any], spread: Any, duration: Fraction) -> tuple[list[Any], Any, list[list[Any]]]:
        """Return the thin end, the derivative and the boxes of all steps."""
        carried, thin, boxes, flown = identity(), list(x), [], Fraction(0)
        self.pace = min(2 * self.pace, self.longest)
        while flown < duration:
            h, self.left = min(self.pace, duration - flown), self.left - 1
            if self.pace < _SHORTEST or self.left < 0:
                raise NotClosed("its flight takes too many or too short steps")
            try:
                thin, carried, around = self.step(thin, carried, spread, number(h))
            except NotClosed:
                self.pace /= 2
                continue
            boxes.append(around)
            flown += h
        return thin, carried, boxes


class _Pendulum(_Flow):
    """Two arms as a system, with the constants A, B, C, G₁ and G₂ of the guide."""

    def __init__(self, data: Mapping[str, Any]) -> None:
        super().__init__()
        keys = ("mass", "centre_of_mass", "length", "inertia")
        (m1, m2), (a1, a2), (l1, _), (j1, j2) = ([fraction(v) for v in data[key]] for key in keys)
        (gravity,), self.angles = map(fraction, data["gravity"]), 2
        g1 = m1 * a1 + m2 * l1
        inertias = j1 + m1 * a1**2 + m2 * l1**2, j2 + m2 * a2**2, m2 * l1 * a2
        self.numbers = [number(v) for v in (*inertias, gravity * g1, gravity * m2 * a2)]

    def rate(self, x: Sequence[_Dual]) -> list[_Dual]:
        a, b, c, g1, g2 = self.numbers
        sine, cosine = (x[0] + x[1] * -1).sine_cosine()
        first = sine * x[3].square() * -c + x[0].sine_cosine()[0] * -g1
        second = sine * x[2].square() * c + x[1].sine_cosine()[0] * -g2
        inverse = ((cosine * c).square() * -1 + a * b).power(-1)
        turned = (first * b + cosine * second * -c) * inverse, (second * a + cosine * first * -c) * inverse
        return [x[2], x[3], *turned]

    def height(self, x: Sequence[_Dual]) -> _Dual:
        a, b, c, g1, g2 = self.numbers
        kinetic = x[2].square() * (a / 2) + x[3].square() * (b / 2)
        coupled = (x[0] + x[1] * -1).sine_cosine()[1] * x[2] * x[3] * c
        return kinetic + coupled + x[0].sine_cosine()[1] * -g1 + x[1].sine_cosine()[1] * -g2


class _ThreeBodies(_Flow):
    """The planar circular restricted three-body problem in the rotating frame."""

    def __init__(self, data: Mapping[str, Any]) -> None:
        super().__init__()
        (self.mu,), self.angles = map(number, data["mass_ratio"]), 0

    def _pull(self, x: Sequence[_Dual]) -> list[tuple[Any, _Dual, _Dual]]:
        """Return mass, distance along x and inverse distance of both primaries."""
        bodies = (1 - self.mu, x[0] + self.mu), (self.mu, x[0] + (self.mu - 1))
        return [(mass, along, (along.square() + x[1].square()).inverse_root()) for mass, along in bodies]

    def rate(self, x: Sequence[_Dual]) -> list[_Dual]:
        first, second = x[0] + x[3] * 2, x[1] + x[2] * -2
        for mass, along, inverse in self._pull(x):
            cube = inverse.power(3) * -mass
            first, second = first + along * cube, second + x[1] * cube
        return [x[2], x[3], first, second]

    def height(self, x: Sequence[_Dual]) -> _Dual:
        total = (x[2].square() + x[3].square()) * number("0.5")
        for mass, along, inverse in self._pull(x):
            total = total + (along.square() + x[1].square()) * (-mass / 2) + inverse * -mass
        return total


_SYSTEMS = {"double pendulum": _Pendulum, "three bodies": _ThreeBodies}


class _Chart:
    """The plane through a node along u, s and w, on which the energy determines w's coordinate z over a box.

    For an interval of energies, boxes move along the tilt, by at most their distance `within` from the middle.
    """

    def __init__(self, flow: _Flow, data: Mapping[str, Any], energy: Any, within: Any) -> None:
        self.flow, self.node, self.within = flow, [number(v) for v in data["node"]], within
        self.tilt = [number(v) for v in data.get("tilt", "00")]
        self.basis = flint.arb_mat([[number(v) for v in row] for row in data["basis"]])
        self.rows, self.level = self.basis.inv().tolist(), flow.energy(self.node).value - energy

    def box(self, widths: Sequence[Any], z: Any) -> tuple[list[Any], list[Any]]:
        """Return the states of a box with z, and the derivative of H along the basis."""
        column = [[symmetric(widths[0])], [symmetric(widths[1])], [flint.arb(0)], [z]]
        around = [c + d for c, d in zip(self.node, (self.basis * flint.arb_mat(column)).entries(), strict=True)]
        return around, (flint.arb_mat([self.flow.energy(around).partials]) * self.basis).entries()

    def wide(self, widths: Sequence[Any]) -> list[Any]:
        """Return the half-widths of the box that contains those of all energies."""
        return [w + abs(t) * self.within for w, t in zip(widths, self.tilt, strict=True)]

    def height(self, widths: Sequence[Any]) -> Any:
        """Return an interval that contains exactly one z of each energy for each y of a box."""
        reach = flint.arb(0)
        for _ in range(8):
            _, (along, beside, _, across) = self.box(widths, symmetric(reach))
            needed = (abs(self.level) + self.within + abs(along) * widths[0] + abs(beside) * widths[1]) / abs(across)
            if needed < reach:
                return symmetric(reach)
            reach = 2 * needed.upper() + number("1e-30")
        raise NotClosed("the energy does not determine the states of a box")

    def away(self, row: int, state: Sequence[Any], shift: Sequence[Any]) -> Any:
        """Return a coordinate of a state that is shifted by whole turns."""
        return dot(self.rows[row], [x - c - t for x, c, t in zip(state, self.node, shift, strict=True)])


def _segment(
    flow: _Flow, charts: tuple[_Chart, _Chart], widths: Sequence[Any], duration: Fraction, turns: Sequence[int]
) -> ChartSegment:
    """Enclose the map from a chart's box to the next chart."""
    (first, second), shift = charts, [2 * flint.arb.pi() * int(k) for k in turns]
    leaving, arriving = (chart.wide(sizes) for chart, sizes in zip(charts, widths, strict=True))
    z = first.height(leaving)
    states, (along, beside, _, across) = first.box(leaving, z)
    rise = (1 - dot([along, beside], first.tilt)) / across
    tangents = first.basis * flint.arb_mat(
        [[1, 0, first.tilt[0]], [0, 1, first.tilt[1]], [0, 0, 0], [-along / across, -beside / across, rise]]
    )
    thin, _ = first.box([flint.arb(0)] * 2, -first.level / first.box([flint.arb(0)] * 2, z)[1][3])
    spread = flint.arb_mat([[x - c] for x, c in zip(states, thin, strict=True)])
    end, derivative, boxes = flow.flight(thin, spread, duration)
    ends = [c + d for c, d in zip(end, (derivative * spread).entries(), strict=True)]
    normal = second.rows[2]
    reach = symmetric(2 * second.away(2, ends, shift) / dot(normal, flow.slopes(ends)[0])) + symmetric(number("1e-30"))
    around = flow.rough(ends, reach)
    rates, slopes = flow.slopes(around)
    speed = dot(normal, rates)
    time, exact = (-second.away(2, x, shift) / speed for x in (ends, end))
    if not abs(time) < reach.abs_upper():
        raise NotClosed("a box is not proved to meet the next chart once")
    moved = (flow.late(slopes, reach) * derivative * tangents).transpose().tolist()
    *delays, late = [-dot(normal, column) / speed for column in moved]
    projected = flint.arb_mat(
        [
            [m + f * d for m, f in zip(column, rates, strict=True)]
            for column, d in zip(moved, [*delays, late], strict=True)
        ]
    )
    *along, across = (projected * flint.arb_mat(second.rows[:2]).transpose()).tolist()
    landed, arrived = ([x + t * f for x, f in zip(v, rates, strict=True)] for v, t in ((end, exact), (ends, time)))
    if second.box(arriving, second.height(arriving).union(second.away(3, arrived, shift)))[1][3].contains(0):
        raise NotClosed("the energy does not determine the states of a box")
    away, total = symmetric(first.within), number(duration)
    value = [second.away(k, landed, shift) + (across[k] - second.tilt[k]) * away for k in range(2)]
    slope, at_node = flint.arb_mat(along).transpose(), total + exact + late * away
    return ChartSegment(value, slope, total + time, at_node, delays, [*boxes, around], states)


_KEYS = {
    "format statement versions system energy scale orbits links digest",
    "format statement versions system energy scale orbits links wraps entropy digest",
}


def _checked_network(flow: _Flow, data: Mapping[str, Any], progress: Progress) -> str:
    """Return the statement of a certificate of links after proving it."""
    said, energy, within = statement(data), number(data["energy"]), number(data.get("within", 0))
    charts = dict[str, _Chart]()
    if within < 0 or {*data} - {"within"} not in [{*keys.split()} for keys in _KEYS] or data["statement"] != said:
        raise NotClosed("its statement is not that of its numbers, or it has other numbers")

    # The boxes of links are wider than the balls of closed orbits.
    flow.longest, flow.remainder, flow.left = 2 * _LONGEST, _WIDE_REMAINDER, 10 * _MOST_STEPS

    def enclosed(ends: Sequence[Any], widths: Any, duration: Fraction, turns: Sequence[int]) -> ChartSegment:
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
    return said


def check(certificate: Mapping[str, Any], progress: Progress = no_progress) -> CertificateCheck:
    """Check a certificate with the equations and integrator of this module.

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
            proved = _checked_network if "links" in certificate else _checked
            return CertificateCheck(True, "the certificate proves its statement", proved(flow, certificate, progress))
    except (NotClosed, LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError) as error:
        invalid = "" if isinstance(error, NotClosed) else f"a value is missing or invalid, {type(error).__name__}: "
        return CertificateCheck(
            False, f"rejected: the certificate does not prove its statement: {invalid}{error}", None
        )


def _checked_pieces(data: Mapping[str, Any], progress: Progress) -> CertificateCheck:
    """Check the certificates of intervals of energies, and that they leave no gap."""
    pieces, said = data["pieces"], statement(data)
    if {*data} != {"format", "statement", "pieces", "digest"} or data["statement"] != said:
        raise NotClosed("its statement is not that of its intervals, or it has other numbers")
    if any(before[1] != after[0] for before, after in pairwise(map(interval, pieces))):
        raise NotClosed("its intervals of energies leave gaps")
    for k, piece in enumerate(pieces):
        verdict = check(piece, part_of(progress, k / len(pieces), (k + 1) / len(pieces)))
        if not verdict.proved:
            return replace(verdict, status=f"interval {k + 1}: {verdict.status}")
    return CertificateCheck(True, "the certificate proves its statement", said)


def check_file(file: Path, progress: Progress = no_progress) -> CertificateCheck:
    """Check the certificate in a file.

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
    """Return an enclosure of the trace of a product.

    The factors are a closed orbit's derivatives (4, 4), the first one first.

    A plain product of enclosures loses all digits over a hundred nodes. In frames that follow the orbit, each factor is
    nearly triangular, with the directions of growth in order, and the errors grow no faster than the product.
    """
    turned = accumulate(
        [*maps, *maps], lambda frame, factor: np.linalg.qr(_middle(factor) @ frame)[0], initial=np.eye(4)
    )
    frames = [flint.arb_mat(frame.tolist()) for frame in turned][len(maps) :]
    product = identity()
    for factor, before, after in zip(maps, frames, frames[1:], strict=False):
        product = after.inv() * factor * before * product
    return (product * frames[0].inv() * frames[-1]).trace()


def _middle(matrix: Any) -> Any:
    return np.array([[float(v.mid()) for v in row] for row in matrix.tolist()])


def _checked(flow: _Flow, data: Mapping[str, Any], progress: Progress) -> str:
    """Return the statement of a certificate after proving it."""
    nodes, normals = ([[number(v) for v in row] for row in data[key]] for key in ("nodes", "normals"))
    durations, scale = [fraction(v) for v in data["durations"]], [number(v) for v in data["scale"]]
    turns, unique, exists = [int(v) for v in data["turns"]], number(data["unique"]), number(data["exists"])
    count, last, flights, said = len(nodes), 5 * len(nodes), list[Any](), statement(data)
    sizes = {len(nodes), len(normals), len(durations)}, {len(v) for v in [*nodes, *normals, scale, turns]}
    if count > _MOST_NODES or sum(durations) > _MOST_STEPS * _LONGEST:
        raise NotClosed(f"its orbit has more than {_MOST_NODES} nodes or {float(_MOST_STEPS * _LONGEST):.0f} s")
    if data["statement"] != said:
        raise NotClosed("its statement is not that of its numbers")
    positive = count > 1 and 0 < exists <= unique and min(durations) > 0 and all(s > 0 for s in scale)
    if sizes != ({count}, {4}) or not positive or any(turns[flow.angles :]):
        raise NotClosed("its nodes, normals, durations, turns or radii are inconsistent")
    spread, maps = flint.arb_mat([[symmetric(s * unique)] for s in scale]), list[Any]()
    matrix, residual = [[flint.arb(0)] * (last + 1) for _ in range(last + 1)], [flint.arb(0)] * (last + 1)
    push = [g.mid() * s * s for g, s in zip(flow.energy(nodes[0]).partials, scale, strict=True)]
    for k in range(count):
        progress("checking the flow", k / count)
        following = (k + 1) % count
        thin, derivative, boxes = flow.flight(nodes[k], spread, durations[k])
        around = flow.rough(
            [c + d for c, d in zip(thin, (derivative * spread).entries(), strict=True)], symmetric(unique)
        )
        flights.append([*boxes, around])
        rates, slopes = flow.slopes(around)
        derivative = flow.late(slopes, unique) * derivative
        maps.append(derivative)
        for i in range(4):
            row, turned = matrix[4 * k + i], 2 * flint.arb.pi() * turns[i] * int(following == 0)
            residual[4 * k + i] = (thin[i] - nodes[following][i] - turned) / scale[i]
            row[4 * k : 4 * k + 4] = [derivative[i, j] * scale[j] / scale[i] for j in range(4)]
            row[4 * following + i] += number(-1)
            row[4 * count + k], row[last] = rates[i] / scale[i], -push[i] / scale[i] * int(following == 0)
            matrix[4 * count + k][4 * k + i] = normals[k][i] * scale[i]
    start = [c + d for c, d in zip(nodes[0], spread.entries(), strict=True)]
    within = symmetric(number(data.get("within", 0)))
    residual[last] = flow.energy(nodes[0]).value - number(data["energy"]) + within
    matrix[last][:4] = [p * s for p, s in zip(flow.energy(start).partials, scale, strict=True)]
    _check_solution(matrix, residual, exists)
    moved = [x + p * symmetric(unique) for x, p in zip(start, push, strict=True)]
    if dot(flow.energy(moved).partials, push).contains(0):
        raise NotClosed("the energy does not determine the orbit")
    _check_bounds(data, number(sum(durations)) + count * symmetric(exists), maps)
    near = [[c + symmetric(s * exists) for c, s in zip(node, scale, strict=True)] for node in nodes]
    times, angles = [number(v) + symmetric(exists) for v in durations], [k < flow.angles for k in range(4)]
    if data["symbols"]:
        check_symbols(
            data["symbols"],
            Enclosed(flights, near, times, turns, angles, scale, lambda box: flow.slopes(box)[0]),
        )
    return said


def _check_solution(matrix: Sequence[Sequence[Any]], residual: Sequence[Any], exists: Any) -> None:
    """Apply Newton–Kantorovich to the derivative over the ball and the residual at the nodes."""
    square = flint.arb_mat(matrix)
    inverse = flint.arb_mat(np.linalg.inv(_middle(square)).tolist())
    off = (inverse * square).tolist()
    contraction = largest(
        [sum((abs(v - int(i == j)) for j, v in enumerate(row)), flint.arb(0)) for i, row in enumerate(off)]
    )
    first = largest((inverse * flint.arb_mat([[v] for v in residual])).entries())
    if not (contraction < 1 and first <= (1 - contraction) * exists):
        raise NotClosed("Newton–Kantorovich does not prove an orbit within `exists` of its nodes")


def _check_bounds(data: Mapping[str, Any], period: Any, maps: Sequence[Any]) -> None:
    """Prove the bounds of a closed orbit's duration and multiplier from its derivatives."""
    low, high = map(number, data["period"])
    least, pair = number(data["multiplier_exceeds"]), abs(_trace_of_product(maps) - 2)
    # λ + 1/λ grows with |λ| > 1.
    if not (low <= period and period <= high and least >= 1 and pair > least + 1 / least):
        raise NotClosed("its period or its multiplier is not proved to be within its bounds")
