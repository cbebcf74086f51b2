"""Independent check of a periodic orbit's certificate.

This code shares only flint's arithmetic with the search.

The right-hand side of two arms is written by hand, with derivatives from dual numbers. The integrator is classical:
Picard's iteration for a box that holds a step's solutions, Taylor polynomials at fixed steps, and Lagrange's remainder
from the next coefficient over that box. Charts are not used. The unknowns are all nodes x_k, durations τ_k and
one number ε,

    Φ(x_k, τ_k) - x_{k+1} - [k last] (turn + ε v) = 0,      n_k·(x_k - x̄_k) = 0,      H(x_0) = h,

and Newton–Kantorovich is applied to them about the certificate's numbers, in a ball of the radius that it calls
`unique`. Since H(x_0 + ε v) = H(x_0) along a solution and ∇H·v has a sign, ε vanishes.

A certificate includes a digest of its content to detect accidental changes, on which the proof does not depend.

Source: Moore, Kearfott, Cloud, Introduction to Interval Analysis (2009), chapter 10.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dpcontrol.foundation.files import checked_source
from dpcontrol.foundation.progress import Progress, no_progress

FORMAT = "dpcontrol proof 1"
_BITS, _STEP, _ORDER, _BOX_ORDER = 140, Fraction(1, 500), 18, 8


class Rejected(Exception):
    """A certificate is invalid; the message is one clause."""


def digest(certificate: Mapping[str, Any]) -> str:
    """Return the digest of a certificate's content, excluding the digest itself."""
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

    def power(self, exponent: int) -> "_Dual":
        return self._by(self.value**exponent, exponent * self.value ** (exponent - 1))

    def sine_cosine(self) -> "tuple[_Dual, _Dual]":
        sine, cosine = self.value.sin_cos()
        return self._by(sine, cosine), self._by(cosine, -sine)

    __radd__, __rmul__ = __add__, __mul__


class _Pendulum:
    """Two arms in flint's arithmetic at the working precision."""

    def __init__(self, flint: Any, data: Mapping[str, Any]) -> None:
        self.flint, number = flint, self.number
        keys = ("mass", "centre_of_mass", "length", "inertia")
        (m1, m2), (a1, a2), (l1, _), (j1, j2) = ([Fraction(v) for v in data[key]] for key in keys)
        gravity, g1 = Fraction(data["gravity"]), m1 * a1 + m2 * l1
        exact = j1 + m1 * a1**2 + m2 * l1**2, j2 + m2 * a2**2, m2 * l1 * a2, gravity * g1, gravity * m2 * a2
        self.numbers = [number(v) for v in exact]

    def number(self, text: Any) -> Any:
        value = Fraction(text)
        return self.flint.arb(self.flint.fmpq(value.numerator, value.denominator))

    def about(self, radius: Any) -> Any:
        return self.flint.arb(0, radius.abs_upper())

    def matrix(self, entries: Sequence[Any]) -> Any:
        return self.flint.arb_mat(4, 4, entries)

    def identity(self) -> Any:
        return self.matrix([self.flint.arb(int(k % 5 == 0)) for k in range(16)])

    def rate(self, x: Sequence[_Dual]) -> list[_Dual]:
        a, b, c, g1, g2 = self.numbers
        sine, cosine = (x[0] + x[1] * -1).sine_cosine()
        first = sine * x[3].power(2) * -c + x[0].sine_cosine()[0] * -g1
        second = sine * x[2].power(2) * c + x[1].sine_cosine()[0] * -g2
        inverse = ((cosine * c).power(2) * -1 + a * b).power(-1)
        turned = (first * b + cosine * second * -c) * inverse, (second * a + cosine * first * -c) * inverse
        return [x[2], x[3], *turned]

    def energy(self, x: Sequence[Any]) -> _Dual:
        a, b, c, g1, g2 = self.numbers
        x = self.duals(x)
        kinetic = x[2].power(2) * (a / 2) + x[3].power(2) * (b / 2)
        coupled = (x[0] + x[1] * -1).sine_cosine()[1] * x[2] * x[3] * c
        return kinetic + coupled + x[0].sine_cosine()[1] * -g1 + x[1].sine_cosine()[1] * -g2

    def duals(self, x: Sequence[Any]) -> list[_Dual]:
        return [_Dual(value, row) for value, row in zip(x, self.identity().tolist(), strict=True)]

    def slopes(self, x: Sequence[Any]) -> tuple[list[Any], Any]:
        found = self.rate(self.duals(x))
        return [f.value for f in found], self.flint.arb_mat([f.partials for f in found])

    def late(self, slopes: Any, time: Any) -> Any:
        """Return the flow's derivative over a time from an invariant box."""
        grown = (self.matrix([v.abs_upper() for v in slopes.entries()]) * time).exp() - self.identity()
        return self.identity() + self.matrix([self.about(v) for v in grown.entries()])

    def series(self, x: Sequence[Any], order: int, width: int) -> list[list[Any]]:
        """Return Taylor coefficients of the states and the flow's derivative."""
        start = [[v] for v in x] + [[v] for row in self.identity().tolist() for v in row[:width]]
        for known in range(1, order + 1):
            self.flint.ctx.cap = known
            series = [self.flint.arb_series(c) for c in start]
            found = self.rate([_Dual(series[i], series[4 + width * i :][:width]) for i in range(4)])
            for c, r in zip(start, [f.value for f in found] + [p for f in found for p in f.partials], strict=True):
                c.append(r[known - 1] / known)
        return start

    def rough(self, x: Sequence[Any], time: Any) -> list[Any]:
        """Return a box that contains all solutions from another box."""
        box = list(x)
        for _ in range(12):
            reached = [v + time * r for v, r in zip(x, self.slopes(box)[0], strict=True)]
            if all(r in b for r, b in zip(reached, box, strict=True)):
                return box
            box = [r.union(v) + self.about((r - v) / 8 + self.number("1e-25")) for r, v in zip(reached, x, strict=True)]
        raise Rejected("a step's box does not close")

    def step(self, thin: Sequence[Any], carried: Any, spread: Any, h: Any) -> tuple[list[Any], Any]:
        """Advance a thin point and the derivative by one step."""
        box = [c + d for c, d in zip(thin, (carried * spread).entries(), strict=True)]
        around = self.rough(box, h * self.flint.arb(0.5, 0.5))

        def ahead(near: Sequence[Any], order: int, last: Sequence[Any]) -> list[Any]:
            return [
                sum((c[k] * h**k for k in range(order + 1)), r * h ** (order + 1))
                for c, r in zip(near, last, strict=True)
            ]

        far = [c[-1] for c in self.series(around, _ORDER + 1, 0)]
        # Coefficient k along a solution equals the coefficient at its state times the derivative.
        rest = self.matrix([c[-1] for c in self.series(around, _BOX_ORDER + 1, 4)[4:]])
        rest = rest * self.late(self.slopes(around)[1], h)
        over = ahead(self.series(box, _BOX_ORDER, 4)[4:], _BOX_ORDER, rest.entries())
        return ahead(self.series(thin, _ORDER, 0), _ORDER, far), self.matrix(over) * carried

    def flight(self, x: Sequence[Any], spread: Any, duration: Fraction) -> tuple[list[Any], Any]:
        carried, thin, count = self.identity(), list(x), -(-duration // _STEP)
        for _ in range(count):
            thin, carried = self.step(thin, carried, spread, self.number(duration / count))
        return thin, carried


def check(certificate: Mapping[str, Any], progress: Progress = no_progress) -> str:
    """Check a certificate and return the proved statement.

    Raises:
        Rejected: the certificate is invalid; the message gives the failed step.
        PartMissing: python-flint is not installed.
    """
    from dpcontrol.proofs.balls import flint, working

    try:
        if certificate["digest"] != digest(certificate) or certificate["format"] != FORMAT:
            raise Rejected("its digest does not match its content, or its format is unknown")
        if certificate["system"]["equations"] != "double pendulum":
            raise Rejected("the check supports only the equations of the double pendulum")
        with working(_BITS):
            return _checked(_Pendulum(flint, certificate["system"]), certificate, progress)
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, np.linalg.LinAlgError) as error:
        raise Rejected(f"a value is missing or is not a number ({type(error).__name__}: {error})") from error


class CertificateCheck(NamedTuple):
    """The verdict on a certificate's file: the proved statement, or the step that fails."""

    proved: bool
    status: str
    statement: str | None


def check_file(file: Path, progress: Progress = no_progress) -> CertificateCheck:
    """Check the certificate in a file.

    Raises:
        InputError: the file is missing or unreadable.
        PartMissing: python-flint is not installed.
    """
    try:
        content = json.loads(checked_source(file).read_text(encoding="utf-8"))
        return CertificateCheck(True, check(content, progress), str(content["statement"]))
    except (Rejected, ValueError, RecursionError) as error:
        return CertificateCheck(False, f"rejected: the certificate does not prove its statement: {error}", None)


def _checked(own: _Pendulum, data: Mapping[str, Any], progress: Progress) -> str:
    arb_mat, zero, number = own.flint.arb_mat, own.flint.arb(0), own.number
    nodes, normals = ([[number(v) for v in row] for row in data[key]] for key in ("nodes", "normals"))
    durations, scale = [Fraction(v) for v in data["durations"]], [number(v) for v in data["scale"]]
    turns, unique, exists = [int(v) for v in data["turns"]], number(data["unique"]), number(data["exists"])
    count, last = len(nodes), 5 * len(nodes)
    sizes = {len(nodes), len(normals), len(durations)}, {len(v) for v in [*nodes, *normals, scale, turns]}
    positive = count > 1 and 0 < exists <= unique and min(durations) > 0 and all(s > 0 for s in scale)
    if sizes != ({count}, {4}) or not positive or any(turns[2:]):
        raise Rejected("its nodes, normals, durations, turns or radii are inconsistent")
    spread, product = arb_mat([[own.about(s * unique)] for s in scale]), own.identity()
    matrix, residual = [[zero] * (last + 1) for _ in range(last + 1)], [zero] * (last + 1)
    push = [g.mid() * s * s for g, s in zip(own.energy(nodes[0]).partials, scale, strict=True)]
    for k in range(count):
        progress("checking the flow", k / count)
        following = (k + 1) % count
        thin, derivative = own.flight(nodes[k], spread, durations[k])
        around = own.rough(
            [c + d for c, d in zip(thin, (derivative * spread).entries(), strict=True)], own.about(unique)
        )
        rates, slopes = own.slopes(around)
        derivative = own.late(slopes, unique) * derivative
        product = derivative * product
        for i in range(4):
            row, turned = matrix[4 * k + i], 2 * own.flint.arb.pi() * turns[i] * int(following == 0)
            residual[4 * k + i] = (thin[i] - nodes[following][i] - turned) / scale[i]
            row[4 * k : 4 * k + 4] = [derivative[i, j] * scale[j] / scale[i] for j in range(4)]
            row[4 * following + i] += own.number(-1)
            row[4 * count + k], row[last] = rates[i] / scale[i], -push[i] / scale[i] * int(following == 0)
            matrix[4 * count + k][4 * k + i] = normals[k][i] * scale[i]
    start = [c + d for c, d in zip(nodes[0], spread.entries(), strict=True)]
    residual[last] = own.energy(nodes[0]).value - number(data["energy"])
    matrix[last][:4] = [p * s for p, s in zip(own.energy(start).partials, scale, strict=True)]
    inverse = arb_mat(np.linalg.inv(np.array([[float(v.mid()) for v in row] for row in matrix])).tolist())
    off = (inverse * arb_mat(matrix)).tolist()
    sums = [sum((abs(v - int(i == j)) for j, v in enumerate(row)), zero) for i, row in enumerate(off)]
    steps = (inverse * arb_mat([[v] for v in residual])).entries()
    contraction, first = (reduce(lambda a, b: a.max(b.abs_upper()), values, zero) for values in (sums, steps))
    if not (contraction < 1 and first <= (1 - contraction) * exists):
        raise Rejected("Newton–Kantorovich does not prove an orbit within `exists` of its nodes")
    moved = [x + p * own.about(unique) for x, p in zip(start, push, strict=True)]
    if sum((a * b for a, b in zip(own.energy(moved).partials, push, strict=True)), zero).contains(0):
        raise Rejected("the energy does not determine the orbit")
    period, (low, high) = number(sum(durations)) + count * own.about(exists), (number(v) for v in data["period"])
    least, pair = number(data["multiplier_exceeds"]), abs(product.trace() - 2)
    # λ + 1/λ grows with |λ| > 1.
    if not (low <= period and period <= high and least >= 1 and pair > least + 1 / least):
        raise Rejected("its period or its multiplier is not proved to be within its bounds")
    return (
        f"exactly one periodic orbit crosses the {count} planes within {data['unique']} of the nodes (scaled); it is "
        f"within {data['exists']}, its period lies in its bounds, its multiplier exceeds {data['multiplier_exceeds']}"
    )
