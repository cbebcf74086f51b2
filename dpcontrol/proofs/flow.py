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
from dpcontrol.proofs.balls import (
    Fraction,
    Instructions,
    NotClosed,
    ball,
    columns,
    flint,
    identity,
    largest,
    program,
    symmetric,
)

Vector = list[Any]
"""A list of balls."""


@dataclass(frozen=True)
class FlowSettings:
    """Orders and remainder of the rigorous integrator's Taylor polynomials.

    Attributes:
        order: of the thin point's polynomial.
        box_order: of the box's polynomial.
        left: remainder of a step relative to ε, the distance of solutions from their polynomials on a disc of times.
    """

    order: int = 32
    box_order: int = 18
    left: float = 1e-19


_ROUGH, _SECTORS, _SHARE, _GROWTH, _MOST_TRIES, _MOST_STEPS = 12, 5, 0.75, 1.04, 40, 20_000
"""Degree of the disc's polynomial, sectors of its cover, and initial radius relative to the estimated convergence
radius. Then the largest growth of a disc between steps, and the largest numbers of radii per step and of steps."""


@dataclass(frozen=True)
class Field:
    """Programs of f, (f, Df), (H, ∇H) and ∂p/∂x with exact parameters."""

    rate: Instructions
    slopes: Instructions
    energy: Instructions
    momenta: Instructions

    @classmethod
    def of(cls, system: System, parameters: Sequence[Fraction]) -> "Field":
        """Return the programs that evaluate a system's equations in ball arithmetic at the working precision.

        Args:
            system: system of two degrees of freedom.
            parameters: exact parameters (p,).
        """
        equations = system.equations
        rate = ca.substitute(equations.rate, equations.inputs, ca.SX.zeros(equations.input_count))
        jacobian, gradient = ca.jacobian(rate, equations.state), ca.gradient(equations.hamiltonian, equations.state)
        make = lambda *outputs: program(equations.state, equations.parameters, outputs, parameters)  # noqa: E731
        momenta = ca.jacobian(equations.momentum, equations.state)
        return cls(make(rate), make(rate, jacobian), make(equations.hamiltonian, gradient), make(momenta))

    def matrix(self, entries: Vector) -> list[Vector]:
        """Return the rows (N, N) of Df from its entries in column-major order, in which `slopes` returns them.

        Args:
            entries: entries of Df (16,).
        """
        return [[entries[i + 4 * j] for j in range(4)] for i in range(4)]

    def rates(self, state: Vector) -> Vector:
        """Return the rates f(x) (N,) at a state.

        Args:
            state: balls or series (N,).
        """
        return self.rate(state)[0]

    def gradient(self, state: Vector) -> Vector:
        """Return the gradient ∇H(x) (N,) of the energy at a state.

        Args:
            state: balls or series (N,).
        """
        return self.energy(state)[1]


@cache
def _cover() -> list[Any]:
    """Return the complex boxes that together cover the upper half of the unit disc, see the module's text."""
    half = flint.arb(0.75, 0.25)
    angles = [((2 * k + 1 + flint.arb(0, 1)) / (2 * _SECTORS)).sin_cos_pi() for k in range(_SECTORS)]
    return [flint.acb(flint.arb(0, 0.5), flint.arb(0, 0.5)), *(flint.acb(half * c, half * s) for s, c in angles)]


def _horner(coefficients: Vector, time: Any) -> Any:
    """Return the value of a polynomial with these coefficients (degree + 1,), lowest order first, at a time."""
    return reduce(lambda value, c: value * time + c, reversed(coefficients))


def _coefficients(series: Any, length: int) -> Vector:
    """Return the first `length` coefficients of a power series, or of a constant as a series."""
    if not isinstance(series, flint.arb_series):
        return [series] + [flint.arb(0)] * (length - 1)
    return [series[k] for k in range(length)]


def taylor(field: Field, start: Vector, order: int) -> list[Vector]:
    """Return Taylor coefficients in time of the states that start in a box.

    Args:
        field: programs of the system.
        start: box of states (N,).
        order: degree of the polynomials.

    Returns:
        Coefficients (N, order + 1), lowest order first.
    """
    coefficients = [[value] for value in start]
    for k in range(order):
        flint.ctx.cap = k + 1
        for series, rate in zip(
            coefficients, field.rates([flint.arb_series(series) for series in coefficients]), strict=True
        ):
            series.append(_coefficients(rate, k + 1)[k] / (k + 1))
    return coefficients


def tangent(field: Field, x: list[Vector], order: int) -> list[Any]:
    """Return Taylor coefficients in time of the flow's derivative V, from V' = Df V.

    Args:
        field: programs of the system.
        x: Taylor coefficients (N, at least `order`) of the states.
        order: degree of the polynomials.

    Returns:
        Matrices (N, N) of the coefficients 0 … order.
    """
    flint.ctx.cap = order
    jacobian = field.matrix(field.slopes([flint.arb_series(c[:order]) for c in x])[1])
    jacobian_series = [_coefficients(s, order) for row in jacobian for s in row]
    matrices, flows = (
        [flint.arb_mat(4, 4, list(entries)) for entries in zip(*jacobian_series, strict=True)],
        [identity()],
    )
    for k in range(order):
        total = reduce(lambda a, b: a + b, (matrices[j] * flows[k - j] for j in range(k + 1)))
        flows.append(total * (1 / flint.arb(k + 1)))
    return flows


def disc(field: Field, x: list[Vector], radius: Any, guess: Vector | None) -> tuple[Any, Vector, Any] | None:
    """Return a disc of complex times on which a step's solutions are proved to be analytic, None if it does not close.

    A trial of the distance ε between the solutions and their polynomials, of which `guess` is the first, is proved if
    the defect of the polynomials over the disc and within ε needs no larger one. Otherwise the next trial is a quarter
    larger than needed. The disc does not close after four trials, or if a bound is infinite.

    Args:
        field: programs of the system.
        x: Taylor coefficients of the states, N rows.
        radius: radius of the disc in time, s.
        guess: first guess of ε (N,), or None.

    Returns:
        Radius ρ, distance ε (N,) of the solutions from their polynomials, and a bound (N, N) on the flow's derivative.
    """
    times, polynomials = [box * radius for box in _cover()], [c[: _ROUGH + 1] for c in x]
    slopes = [[c[k] * k for k in range(1, _ROUGH + 1)] for c in polynomials]
    values, rates = ([[_horner(c, t) for c in rows] for t in times] for rows in (polynomials, slopes))
    bounds = guess or [flint.arb(0)] * 4
    for _ in range(4):
        spread = [flint.acb(symmetric(b), symmetric(b)) for b in bounds]
        values_and_slopes = [field.slopes([v + e for v, e in zip(value, spread, strict=True)]) for value in values]
        defects = [
            [f - r for f, r in zip(pair[0], rate, strict=True)]
            for pair, rate in zip(values_and_slopes, rates, strict=True)
        ]
        needed_bounds = [radius * largest(column) / (_ROUGH + 1) for column in zip(*defects, strict=True)]
        if not all(g.is_finite() for g in needed_bounds):
            return None
        if all(g <= b for g, b in zip(needed_bounds, bounds, strict=True)):
            steepest = [largest(column) for column in zip(*[pair[1] for pair in values_and_slopes], strict=True)]
            growth = (columns(field.matrix(steepest)) * radius).exp()
            return (radius, bounds, growth) if all(g.is_finite() for g in growth.entries()) else None
        bounds = [flint.arb((g * 5 / 4).upper()) for g in needed_bounds]
    return None


def fly(
    field: Field, start: Vector, spread: Any, duration: Fraction, settings: FlowSettings
) -> tuple[Vector, Any, Vector, list[Vector]]:
    """Enclose the flow from a thin point, with derivatives over a box.

    A thin point is a box that is no wider than the rounding errors about one state. The derivative over the wide box
    about it, times `spread`, encloses the differences between both at the end. The length of each step follows from a
    disc of complex times on which its solutions are analytic.

    Args:
        field: programs of the system.
        start: thin point (N,).
        spread: column of the box about the point (N, 1).
        duration: time, s.
        settings: settings of the integrator.

    Returns:
        The thin end (N,), the derivative (N, N), the box's end (N,), and balls (N,) that enclose all solutions during
        each step.

    Raises:
        NotClosed: a step's enclosure does not close.
    """
    elapsed, spans, thin, carried, disc_radius, guess = Fraction(0), [], start, identity(), 10.0, None
    while elapsed < duration:
        failure = NotClosed(f"the enclosure at {float(elapsed):.4g} s of a segment's flight does not close")
        box = [c + d for c, d in zip(thin, (carried * spread).entries(), strict=True)]
        thin_series, box_series = taylor(field, thin, settings.order), taylor(field, box, settings.box_order)
        # Smaller discs are tried in turn, the first one with the last step's ε.
        disc_radius = min(_convergence(thin_series), disc_radius * _GROWTH)
        attempts = (
            disc(field, box_series, ball(disc_radius * 0.85**k), None if k else guess) for k in range(_MOST_TRIES)
        )
        attempted = next((attempt for attempt in attempts if attempt is not None), None)
        if attempted is None or len(spans) == _MOST_STEPS:
            raise failure
        radius, bounds, derivative = attempted
        disc_radius, guess = float(radius), [flint.arb((b * 9 / 8).upper()) for b in bounds]
        step = min(Fraction(disc_radius * settings.left ** (1 / (settings.order + 1))), duration - elapsed)
        h = ball(step)
        # The ball 0.5 ± 0.5 times h holds all times of the step.
        ratio, times = h / radius, flint.arb(0.5, 0.5) * h
        if not ratio < 1:
            raise failure
        # Cauchy's estimate bounds the rest of a Taylor series by a geometric series.
        tail, box_tail = (ratio ** (order + 1) / (1 - ratio) for order in (settings.order, settings.box_order))
        polynomials, remainder_share = (
            [c[: _ROUGH + 1] for c in box_series],
            (times / radius).abs_upper() ** (_ROUGH + 1),
        )
        spans.append(
            [_horner(c, times) + symmetric(b * remainder_share) for c, b in zip(polynomials, bounds, strict=True)]
        )
        thin = [_horner(c, h) + symmetric(b * tail) for c, b in zip(thin_series, bounds, strict=True)]
        derivative_rest = flint.arb_mat(4, 4, [symmetric(g * box_tail) for g in derivative.entries()])
        carried = (_horner(tangent(field, box_series, settings.box_order), h) + derivative_rest) * carried
        elapsed += step
    return (
        thin,
        carried,
        [c + d for c, d in zip(thin, (carried * spread).entries(), strict=True)],
        spans,
    )


def _convergence(x: list[Vector]) -> float:
    """Return a first guess of a disc's radius (s) from the growth of the Taylor coefficients x (N, order + 1).

    A wrong guess costs time only, since the disc is proved afterwards.
    """
    first, last = (max(abs(float(c[k].mid())) for c in x for k in orders) for orders in ((1,), (-2, -1)))
    return _SHARE * min(10.0, (max(first, 1e-3) / max(last, 1e-300)) ** (1 / (len(x[0]) - 2)))
