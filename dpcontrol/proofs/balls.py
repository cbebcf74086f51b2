"""Ball arithmetic with flint: precision, exact decimals and evaluation of equations.

A ball is a midpoint with a radius. Operations of flint return balls that contain all results for numbers in the
operands. A comparison of balls is true only if it holds for all their numbers. Working precision and series length are
global settings of flint, which only `working` sets and restores.

A casadi graph is converted once to a list of operations with single assignments. The list is evaluated on balls,
complex balls and power series of balls. Parameters are exact fractions.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from fractions import Fraction
from functools import partial, reduce
from operator import add, itemgetter, mul, neg, sub, truediv
from typing import Any

import casadi as ca

from dpcontrol.dynamics.compiled import interpreted
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.parts import Later

flint: Any = Later("flint")


class NotClosed(Exception):
    """An enclosure does not close; the message names the step."""


@contextmanager
def located(where: str) -> Iterator[None]:
    """Put a place before the message of an enclosure that does not close or has an operation without a result.

    Args:
        where: the place, in words.
    """
    try:
        yield
    except (NotClosed, ZeroDivisionError, ValueError) as error:
        raise NotClosed(f"{where} {error}") from error


@contextmanager
def working(bits: int) -> Iterator[None]:
    """Set flint's working precision in the block, and restore precision and series length after it.

    Args:
        bits: precision, bits.
    """
    context = flint.ctx
    settings_before = context.prec, context.cap
    context.prec = bits
    try:
        yield
    finally:
        context.prec, context.cap = settings_before


def ball(value: Any) -> Any:
    """Return a number as a ball of flint, exactly if it is a fraction or a double.

    Args:
        value: ball, fraction, or any number that converts to float.
    """
    if isinstance(value, Fraction):
        return flint.arb(flint.fmpq(value.numerator, value.denominator))
    return value if isinstance(value, flint.arb) else flint.arb(float(value))


def symmetric(radius: Any) -> Any:
    """Return the ball about zero with the given radius, as a bound of an error of unknown sign.

    Args:
        radius: number or ball, of which the upper bound counts.
    """
    return flint.arb(0, ball(radius).abs_upper())


def largest(values: Sequence[Any]) -> Any:
    """Return the largest modulus of several balls as a ball, 0 without values.

    Args:
        values: balls (K,).
    """
    return reduce(lambda a, b: a.max(abs(b)), values, flint.arb(0))


def folded(value: Any, period: Any) -> Any:
    """Return a ball minus the multiple of a period that is nearest to its midpoint, to compare angles.

    Args:
        value: ball.
        period: ball or number, positive.
    """
    return value - (value / period + 0.5).mid().floor() * period


def exact(value: Any, digits: int = 40) -> Fraction:
    """Return the midpoint of a ball, rounded to decimal digits, as an exact number that certificates can state.

    Args:
        value: ball or number.
        digits: number of significant digits.
    """
    return Fraction(ball(value).mid().str(digits, radius=False))


_DECIMAL = re.compile(r"[+-]?\d{1,1200}(\.\d{0,1200})?([eE][+-]?\d{1,3})?")


def fraction(value: Any) -> Fraction:
    """Return an integer or a decimal of limited size as an exact number.

    Args:
        value: fraction, integer or text of a decimal.

    Raises:
        ValueError: no such number.
    """
    if not isinstance(value, Fraction) and not _DECIMAL.fullmatch(str(value)):
        raise ValueError(f"{str(value)[:40]!r} is not a decimal")
    return Fraction(value)


def number(text: Any) -> Any:
    """Return an integer or a decimal as a ball.

    Args:
        text: see `fraction`.
    """
    return ball(fraction(text))


def decimal(value: Fraction) -> str:
    """Return all decimal digits of an exact number, as certificates hold it.

    Args:
        value: fraction with finitely many decimal digits.
    """
    return str(Context(prec=1200).divide(Decimal(value.numerator), Decimal(value.denominator)))


def bound(value: Any, *, lower: bool = False) -> str:
    """Format an upper or lower bound of a nonnegative ball, three digits.

    Args:
        value: nonnegative ball or number.
        lower: True for a lower bound, rounded down.
    """
    number = Fraction((ball(value).lower() if lower else ball(value).upper()).fmpq().str())
    rounded = Context(prec=3, rounding=ROUND_FLOOR if lower else ROUND_CEILING)
    return f"{rounded.divide(Decimal(number.numerator), Decimal(number.denominator)):g}"


def columns(rows: Sequence[Sequence[Any]]) -> Any:
    """Return a matrix of flint from rows of numbers or balls.

    Args:
        rows: numbers or balls (M, N).
    """
    return flint.arb_mat([[ball(x) for x in row] for row in rows])


def identity() -> Any:
    """Return the identity matrix for four states."""
    return flint.arb_mat(4, 4, [flint.arb(int(k % 5 == 0)) for k in range(16)])


def _power(base: Any, exponent: Any) -> Any:
    """Return a ball, complex ball or series raised to a power, a number of the same kinds.

    Whole and half powers, given as a ball, need no logarithm.
    """
    doubled_exponent = 2 * exponent
    if not (isinstance(doubled_exponent, flint.arb) and doubled_exponent.is_integer()):
        return (_branch(base, "log") * exponent).exp()
    half_powers = int(float(doubled_exponent))
    return base ** (half_powers // 2) if half_powers % 2 == 0 else _branch(base, "sqrt") ** half_powers


def _branch(x: Any, name: str) -> Any:
    """Return the function of flint with this name, "log" or "sqrt", of a ball, complex ball or series."""
    # Root and logarithm are not analytic across their branch cuts. In this case flint returns NaN.
    return getattr(x, name)(analytic=True) if isinstance(x, flint.acb) else getattr(x, name)()


_OPERATIONS: dict[int, Callable[..., Any]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_NEG: neg,
    ca.OP_EXP: lambda a: a.exp(),
    ca.OP_LOG: lambda a: _branch(a, "log"),
    ca.OP_SQRT: lambda a: _branch(a, "sqrt"),
    ca.OP_SQ: lambda a: a * a,
    ca.OP_TWICE: lambda a: a + a,
    ca.OP_INV: lambda a: 1 / a,
    ca.OP_TAN: lambda a: a.sin() / a.cos(),
    ca.OP_SINH: lambda a: (a.exp() - (-a).exp()) / 2,
    ca.OP_COSH: lambda a: (a.exp() + (-a).exp()) / 2,
    ca.OP_TANH: lambda a: 1 - 2 / ((a + a).exp() + 1),
    ca.OP_ADD: add,
    ca.OP_SUB: sub,
    ca.OP_MUL: mul,
    ca.OP_DIV: truediv,
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
}


@dataclass(frozen=True)
class Instructions:
    """A casadi function of (state, parameters) as operations on numbered values.

    Attributes:
        start: initial values, the state first, None if computed later.
        steps: (operation, index of its result, indices of its arguments).
        outputs: indices of entries, None for structural zeros.
    """

    start: tuple[Any, ...]
    steps: tuple[tuple[Callable[..., Any], int, tuple[int, ...]], ...]
    outputs: tuple[tuple[int | None, ...], ...]

    def __call__(self, state: Sequence[Any]) -> list[list[Any]]:
        """Run the operations on a state, and return the entries of each output in column-major order.

        Args:
            state: numbers, balls, complex balls or series (N,).
        """
        values = [*state, *self.start[len(state) :]]
        for operation, result, arguments in self.steps:
            values[result] = operation(*[values[i] for i in arguments])
        return [[flint.arb(0) if i is None else values[i] for i in output] for output in self.outputs]


def program(state: ca.SX, parameters: ca.SX, outputs: Sequence[ca.SX], values: Sequence[Fraction]) -> Instructions:
    """Return the program that evaluates casadi expressions in ball arithmetic, with exact parameter values.

    Args:
        state: symbols (N,).
        parameters: symbols (p,).
        outputs: expressions of these symbols, of any shape.
        values: exact parameters (p,).

    Raises:
        InputError: an operation of the expressions is not supported.
    """
    function = ca.Function("f", [state, parameters], ca.cse(list(outputs)))
    constants: list[Any] = [None] * state.shape[0] + [ball(v) for v in values]
    angles: dict[int, int] = {}
    steps: list[tuple[Callable[..., Any], int, tuple[int, ...]]] = []

    def applied(operation: Callable[..., Any], *arguments: int) -> int:
        """Record an operation on numbered values, or compute it now if all are constants; return its result's index."""
        constant = all(constants[i] is not None for i in arguments)
        constants.append(operation(*[constants[i] for i in arguments]) if constant else None)
        if not constant:
            steps.append((operation, len(constants) - 1, arguments))
        return len(constants) - 1

    def operated(code: int, *arguments: int) -> int:
        """Record an operation by casadi's code, and return its result's index."""
        if code in (ca.OP_SIN, ca.OP_COS):
            # Sine and cosine of an angle are computed together.
            if arguments[0] not in angles:
                angles[arguments[0]] = applied(lambda a: a.sin_cos(), arguments[0])
            return applied(itemgetter(int(code == ca.OP_COS)), angles[arguments[0]])
        if code not in _OPERATIONS:
            raise InputError(
                f"the equations use casadi's operation {code}, which the prover does not support; write the energy "
                "with + - * /, powers, sqrt, exp, log, sin, cos, tan and hyperbolic functions"
            )
        return applied(_OPERATIONS[code], *arguments)

    count = state.shape[0]
    places = interpreted(
        function,
        [range(count), range(count, len(constants))],
        constant=lambda number: applied(partial(ball, number)),
        applied=operated,
        zero=None,
    )
    return Instructions(tuple(constants), tuple(steps), tuple(tuple(p) for p in places))
