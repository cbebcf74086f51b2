"""Collocation methods as data: points, support, differentiation matrix, quadrature weights, end weights.

On one interval, scaled to 0 ≤ τ ≤ 1, the state is a polynomial of degree K through its values at K + 1 support places,
the first of them τ = 0. At the K collocation points, its derivative equals the equations' rate. The input is the
polynomial through its values at the collocation points. A method supplies numbers only, and all methods share one
transcription: Legendre–Gauss (radau, gauss, lobatto) with any number of points, and Hermite–Simpson as three Lobatto
points.

Sources: Garg, Patterson, Hager, Rao, Benson & Huntington, A unified framework for the numerical solution of optimal
control problems using pseudospectral methods, Automatica 46 (2010). Hairer & Wanner, Solving Ordinary Differential
Equations II, section IV.5 (orders, Lobatto IIIA).
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import nearest
from dpcontrol.foundation.shown import Brief


@dataclass(frozen=True, eq=False)
class Method(Brief):
    """A collocation method on 0 ≤ τ ≤ 1 with K points.

    Attributes:
        points: collocation points (K,), rising.
        support: places of the state's values (K+1,), from 0.
        places: index in `support` of each point (K,).
        differentiation: values at the support -> derivatives at the points (K, K+1).
        weights: quadrature weights (K,).
        end: values at the support -> value at τ = 1 (K+1,).
        order: order of the error at interval ends.
    """

    name: str
    points: Array
    support: Array
    places: NDArray[np.intp]
    differentiation: Array
    weights: Array
    end: Array
    order: int

    @property
    def closes(self) -> bool:
        """True if the last support place is the interval's end, so that its value is the next interval's start."""
        return bool(self.support[-1] == 1.0)

    @property
    def shares_inputs(self) -> bool:
        """True if points lie on both ends, so that neighbouring intervals have one input there."""
        return bool(self.points[0] == 0.0 and self.points[-1] == 1.0)


def barycentric_weights(points: Array) -> Array:
    """Return the weights (K,) with which barycentric interpolation evaluates the polynomial through K points.

    Source: Berrut & Trefethen, Barycentric Lagrange interpolation, SIAM Review 46 (2004), eq. 3.2.

    Args:
        points: distinct points (K,).
    """
    gaps = points[:, None] - points[None, :]
    np.fill_diagonal(gaps, 1.0)
    return 1 / gaps.prod(1)


def interpolation_matrix(points: Array, at: ArrayLike) -> Array:
    """Return the matrix (M, K) that maps a polynomial's values at the points to its values at other places.

    Source: Berrut & Trefethen, Barycentric Lagrange interpolation, SIAM Review 46 (2004), eq. 4.2.

    Args:
        points: distinct points (K,).
        at: the other places (M,).
    """
    distances = np.asarray(at, dtype=float)[:, None] - points[None, :]
    coincides = distances == 0
    terms = barycentric_weights(points) / np.where(coincides, 1.0, distances)
    # The formula divides by zero at a point, of which the value counts alone.
    terms[coincides.any(1)] = 0.0
    terms[coincides] = 1.0
    return terms / terms.sum(1, keepdims=True)


def differentiation_matrix(points: Array) -> Array:
    """Return the matrix (K, K) that maps a polynomial's values at the points to its derivatives there.

    Source: Berrut & Trefethen, Barycentric Lagrange interpolation, SIAM Review 46 (2004), eqs. 9.4 and 9.5.

    Args:
        points: distinct points (K,).
    """
    weights = barycentric_weights(points)
    gaps = points[:, None] - points[None, :]
    np.fill_diagonal(gaps, 1.0)
    matrix = weights[None, :] / weights[:, None] / gaps
    np.fill_diagonal(matrix, 0.0)
    np.fill_diagonal(matrix, -matrix.sum(1))
    return matrix


_LEGENDRE = np.polynomial.Legendre.basis


def _roots(polynomial: np.polynomial.Legendre) -> Array:
    """Return the real roots of a Legendre series on -1 … 1, polished by Newton steps, as rising places in 0 … 1."""
    slope = polynomial.deriv()
    roots = np.sort(polynomial.roots().real)
    for _ in range(3):
        roots = roots - polynomial(roots) / slope(roots)
    return (roots + 1) / 2


@cache
def radau(count: int) -> Method:
    """Return the flipped Legendre–Gauss–Radau method, whose last point is at the interval's end.

    The state has degree `count`, the input `count` - 1. Quadrature is exact to degree 2 `count` - 2. The order is
    2 `count` - 1.

    Args:
        count: number of points.
    """
    # The points are 1 and the zeros of (P_{K-1} - P_K)/(1 - x), on -1 to 1.
    inner = _roots(_LEGENDRE(count - 1) - _LEGENDRE(count))[:-1]
    return collocation_method(f"radau-{count}", np.concatenate([inner, [1.0]]), order=2 * count - 1)


@cache
def gauss(count: int) -> Method:
    """Return the Legendre–Gauss method, with all points inside the interval and order 2 `count`.

    Args:
        count: number of points.
    """
    return collocation_method(f"gauss-{count}", _roots(_LEGENDRE(count)), order=2 * count)


@cache
def lobatto(count: int, *, name: str = "") -> Method:
    """Return the Legendre–Gauss–Lobatto method.

    It has points on both ends of the interval, and the order 2 `count` - 2. The state has degree `count`, one more than
    its points determine. Its free value halfway to the second point compensates for the collocation at τ = 0.

    Args:
        count: number of points.
        name: name of the method; "" for the usual one.
    """
    inner = _roots(_LEGENDRE(count - 1).deriv()) if count > 2 else np.empty(0)
    points = np.concatenate([[0.0], inner, [1.0]])
    return collocation_method(name or f"lobatto-{count}", points, order=2 * count - 2)


def collocation_method(name: str, points: Array, *, order: int) -> Method:
    """Return the collocation method with given points, from which its matrices and weights follow.

    Args:
        name: name of the method.
        points: rising points (K,) in [0, 1].
        order: order of convergence.
    """
    if points[0] == 0.0:
        support = np.concatenate([[0.0, points[1] / 2], points[1:]])
        places = np.concatenate([[0], np.arange(2, len(support))]).astype(np.intp)
    else:
        support = np.concatenate([[0.0], points])
        places = np.arange(1, len(support), dtype=np.intp)
    # Interpolatory weights: exact for the powers 0 … K-1.
    powers = np.arange(len(points))
    weights = np.linalg.solve(points[None, :] ** powers[:, None], 1 / (powers + 1.0))
    return Method(
        name=name,
        points=points,
        support=support,
        places=places,
        differentiation=differentiation_matrix(support)[places],
        weights=np.asarray(weights, dtype=np.float64),
        end=interpolation_matrix(support, [1.0])[0],
        order=order,
    )


_FAMILIES = {"radau": (radau, 2), "gauss": (gauss, 1), "lobatto": (lobatto, 2)}
"""Methods named by a number of points, and the least number."""


@cache
def method_named(name: str) -> Method:
    """Return the collocation method that a setting names.

    Args:
        name: such as "radau-5", "gauss-4", "lobatto-4" or "hermite-simpson".

    Raises:
        InputError: unknown method or number of points.
    """
    if name == "hermite-simpson":
        return lobatto(3, name=name)
    family, _, count = name.partition("-")
    if family not in _FAMILIES or not (count.isascii() and count.isdecimal()):
        names = [f"{family}-{number}" for family, (_, least) in _FAMILIES.items() for number in range(least, 13)]
        hint = nearest(name, [*names, "hermite-simpson"])
        raise InputError(
            f"method = {name!r}: {f'did you mean {hint!r}? Allowed' if hint else 'allowed'}: radau-2 to radau-12, "
            "gauss-1 to gauss-12, lobatto-2 to lobatto-12 and hermite-simpson"
        )
    make, least = _FAMILIES[family]
    number = int(count)
    if not least <= number <= 12:
        raise InputError(f"method = {name!r}: {family} has {least} to 12 points; radau-7 suits the pendulum")
    return make(number)
