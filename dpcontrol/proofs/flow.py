"""A rigorous integrator for thin points and derivatives over boxes.

One step from time zero encloses x(t) for all initial states in a box B. Let p be the Taylor polynomial of degree m,
whose coefficients are balls over B. On the complex disc |t| ≤ ρ, consider continuous functions e, analytic inside, with
|e_i(t)| ≤ ε_i (|t|/ρ)^(m+1). If

    ρ/(m + 1) · sup |f_i(p(t) + e) - p_i'(t)| ≤ ε_i        over the disc and |e_i| ≤ ε_i,

then e ↦ ∫ f(p + e) - p' maps this set into itself. The integrand vanishes to order m at zero, so by Schwarz's lemma it
is at most the supremum times (|t|/ρ)^m. By Schauder's theorem there is a fixed point, and p + e is the solution. The
solution is therefore analytic on the disc, within ε of p. Cauchy's estimate bounds the Taylor coefficients of e by
ε_i/ρ^k, and those of the derivative V of the flow, V' = Df V, by exp(ρ sup|Df|)_ij/ρ^k. These bounds hold for
polynomials of any degree. One disc suffices for the thin point's polynomial of high degree, for the box and for V.

The disc is covered by a disc of half its radius and sectors of the outer ring. The upper half plane suffices, because x
has conjugate values at conjugate times. A supremum is finite only if f is analytic.

After any number of steps, the box has the form c + M (X - x). Here c encloses the thin point's orbit, and M the
derivative of the flow over all of X, so only the radii of M are subject to wrapping.

Sources: Tucker, Validated Numerics (2011), chapter 6; Zgliczyński, C¹-Lohner algorithm (2002), for c + M (X - x).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, reduce
from typing import Any

import casadi as ca

from dpcontrol.dynamics.system import System
from dpcontrol.proofs.balls import Fraction, Instructions, NotClosed, ball, columns, flint, identity, program, symmetric

Vector = list[Any]
"""A list of balls."""


@dataclass(frozen=True)
class FlowSettings:
    """Settings of the integrator.

    Attributes:
        order: of the thin point's polynomial.
        box_order: of the box's polynomial.
        left: remainder of a step relative to ε.
    """

    order: int = 32
    box_order: int = 18
    left: float = 1e-19


_ROUGH, _SECTORS, _SHARE, _GROWTH, _MOST_STEPS = 12, 5, 0.75, 1.04, 20_000
"""Degree of the disc's polynomial, sectors of its cover, and initial radius relative to the estimated convergence
radius. Then the largest growth of a disc between steps, and the largest number of steps."""


@dataclass(frozen=True)
class Field:
    """Programs of f, (f, Df) and (H, ∇H) with exact parameters."""

    rate: Instructions
    slopes: Instructions
    energy: Instructions

    @classmethod
    def of(cls, system: System, parameters: Sequence[Fraction]) -> "Field":
        """Return a system's programs at the working precision."""
        e = system.equations
        rate = ca.substitute(e.rate, e.inputs, ca.SX.zeros(e.input_count))
        jacobian, gradient = ca.jacobian(rate, e.state), ca.gradient(e.hamiltonian, e.state)
        make = lambda *outputs: program(e.state, e.parameters, outputs, parameters)  # noqa: E731
        return cls(make(rate), make(rate, jacobian), make(e.hamiltonian, gradient))

    def matrix(self, entries: Vector) -> list[Vector]:
        """Return the rows of Df from its entries in column-major order."""
        return [[entries[i + 4 * j] for j in range(4)] for i in range(4)]

    def height(self, state: Vector) -> Any:
        """Return H(x)."""
        return self.energy(state)[0][0]

    def gradient(self, state: Vector) -> Vector:
        """Return ∇H(x)."""
        return self.energy(state)[1]


@cache
def _cover() -> list[Any]:
    """Return boxes that cover the upper half of the unit disc."""
    boxes, half = [flint.acb(flint.arb(0, 0.5), flint.arb(0, 0.5))], flint.arb(0.75, 0.25)
    for k in range(_SECTORS):
        angle = (2 * k + 1 + flint.arb(0, 1)) / (2 * _SECTORS)
        sine, cosine = angle.sin_cos_pi()
        boxes.append(flint.acb(half * cosine, half * sine))
    return boxes


def _horner(coefficients: Vector, time: Any) -> Any:
    return reduce(lambda value, c: value * time + c, reversed(coefficients))


def _coefficients(series: Any, length: int) -> Vector:
    """Return the first coefficients of a series or a constant."""
    if not isinstance(series, flint.arb_series):
        return [series] + [flint.arb(0)] * (length - 1)
    return [series[k] for k in range(length)]


def taylor(field: Field, start: Vector, order: int) -> list[Vector]:
    """Return Taylor coefficients 0 … order of the states over a box.

    From the first m coefficients, f(x) - x' follows to order 2m. The others solve the linearised equations, so each
    round doubles the number of coefficients.
    """
    known = 1
    x = [[s] for s in start]
    while known <= order:
        following = min(2 * known, order + 1)
        flint.ctx.cap = following - 1
        rates = [_coefficients(r, following - 1) for r in field.rate([flint.arb_series(c) for c in x])[0]]
        flint.ctx.cap = max(following - 1 - known, 1)
        slope = field.matrix(field.slopes([flint.arb_series(c) for c in x])[1])
        linear = [[_coefficients(s, flint.ctx.cap) for s in row] for row in slope]
        change: list[Vector] = [[], [], [], []]
        for k in range(known, following):
            # Coefficient k of x comes from coefficient k - 1 of f(x).
            value = [r[k - 1] for r in rates]
            for i, row in enumerate(linear):
                products = (a[k - 1 - known - m] * c for a, b in zip(row, change, strict=True) for m, c in enumerate(b))
                value[i] = sum(products, value[i])
            for one, v in zip(change, value, strict=True):
                one.append(v / k)
        x, known = [a + b for a, b in zip(x, change, strict=True)], following
    return x


def tangent(field: Field, x: list[Vector], order: int) -> list[Any]:
    """Return Taylor coefficients (N, N) of the flow's derivative."""
    flint.ctx.cap = order
    slope = field.matrix(field.slopes([flint.arb_series(c[:order]) for c in x])[1])
    linear = [_coefficients(s, order) for row in slope for s in row]
    matrices, out = [flint.arb_mat(4, 4, list(entries)) for entries in zip(*linear, strict=True)], [identity()]
    for k in range(order):
        total = reduce(lambda a, b: a + b, (matrices[j] * out[k - j] for j in range(k + 1)))
        out.append(total * (1 / flint.arb(k + 1)))
    return out


@dataclass(frozen=True)
class Disc:
    """The disc of radius ρ in which a step's solutions are analytic.

    It has bounds ε (N,) on the distance from the polynomial of the given degree, and on the flow's derivative (N, N).
    """

    radius: Any
    bounds: Vector
    derivative: Any
    degree: int


def _sup(values: list[Vector]) -> Vector:
    """Return an upper bound of the largest modulus in each column."""
    return [reduce(lambda a, b: a.max(b.abs_upper()), column, flint.arb(0)) for column in zip(*values, strict=True)]


def disc(field: Field, x: list[Vector], radius: Any, guess: Vector | None) -> Disc | None:
    """Return the disc of a radius if its enclosure closes, or None."""
    degree, times = _ROUGH, [box * radius for box in _cover()]
    p = [c[: degree + 1] for c in x]
    slopes = [[c[k] * k for k in range(1, degree + 1)] for c in p]
    values = [[_horner(c, t) for c in p] for t in times]
    rates = [[_horner(c, t) for c in slopes] for t in times]
    bounds = guess or [flint.arb(0)] * 4
    for _ in range(4):
        spread = [flint.acb(symmetric(b), symmetric(b)) for b in bounds]
        found = [field.slopes([v + e for v, e in zip(value, spread, strict=True)]) for value in values]
        gaps = _sup(
            [[f - r for f, r in zip(one[0], rate, strict=True)] for one, rate in zip(found, rates, strict=True)]
        )
        needed = [radius * g / (degree + 1) for g in gaps]
        if not all(g.is_finite() for g in needed):
            return None
        if all(g <= b for g, b in zip(needed, bounds, strict=True)):
            largest = _sup([one[1] for one in found])
            grown = (columns(field.matrix(largest)) * radius).exp()
            return Disc(radius, bounds, grown, degree) if all(g.is_finite() for g in grown.entries()) else None
        bounds = [flint.arb((g * 5 / 4).upper()) for g in needed]
    return None


@dataclass(frozen=True)
class FlownBall:
    """The enclosure of a flow after a duration.

    For each step, `spans` has the start and length in s, and balls (N,) that enclose all solutions.
    """

    thin: Vector
    derivative: Any
    box: Vector
    spans: list[tuple[Any, Any, Vector]]


def fly(field: Field, start: Vector, spread: Any, duration: Fraction, settings: FlowSettings) -> FlownBall:
    """Enclose the flow from a thin point, with derivatives over a box.

    Raises:
        NotClosed: a step's enclosure does not close.
    """
    flown, spans, thin, carried = Fraction(0), [], start, identity()
    guess: Vector | None = None
    radius: Any = None
    while flown < duration:
        if len(spans) == _MOST_STEPS:
            raise NotClosed(f"more than {_MOST_STEPS} steps")
        where = f"the enclosure at {float(flown):.4g} s of a segment's flight does not close"
        box = [c + d for c, d in zip(thin, (carried * spread).entries(), strict=True)]
        try:
            point = taylor(field, thin, settings.order)
            around = taylor(field, box, settings.box_order)
        except (ZeroDivisionError, ValueError) as error:
            raise NotClosed(where) from error
        tried = min(_convergence(point), 10.0 if radius is None else radius * _GROWTH)
        found = None
        for _ in range(12):
            found = disc(field, around, ball(tried), guess)
            if found is not None:
                break
            tried, guess = tried * 0.85, None
        if found is None:
            raise NotClosed(where)
        radius, guess = tried, [flint.arb((b * 9 / 8).upper()) for b in found.bounds]
        step = min(Fraction(tried * settings.left ** (1 / (settings.order + 1))), duration - flown)
        h = ball(step)
        ratio = h / found.radius
        if not ratio < 1:
            raise NotClosed(where)
        tail, box_tail = (ratio ** (order + 1) / (1 - ratio) for order in (settings.order, settings.box_order))
        during = flint.arb(0.5, 0.5) * h
        rough = [c[: found.degree + 1] for c in around]
        at_most = (during / found.radius).abs_upper() ** (found.degree + 1)
        spans.append(
            (
                ball(flown),
                h,
                [_horner(c, during) + symmetric(b * at_most) for c, b in zip(rough, found.bounds, strict=True)],
            )
        )
        thin = [_horner(c, h) + symmetric(b * tail) for c, b in zip(point, found.bounds, strict=True)]
        grown = flint.arb_mat(4, 4, [symmetric(g * box_tail) for g in found.derivative.entries()])
        carried = (_horner(tangent(field, around, settings.box_order), h) + grown) * carried
        flown += step
    box = [c + d for c, d in zip(thin, (carried * spread).entries(), strict=True)]
    return FlownBall(thin, carried, box, spans)


def _convergence(x: list[Vector]) -> float:
    """Return a guess of the disc's radius from the radius of convergence."""
    order = len(x[0]) - 1
    sizes = [max(abs(float(c[k].mid())) for c in x) for k in (order - 1, order)]
    first = max(max(abs(float(c[1].mid())) for c in x), 1e-3)
    rates = [(first / s) ** (1 / k) for s, k in zip(sizes, (order - 2, order - 1), strict=True) if s > 0]
    return _SHARE * min([*rates, 10.0])
