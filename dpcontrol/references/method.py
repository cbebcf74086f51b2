"""Collocation methods as data: points, differentiation matrix, quadrature weights, end weights.

On one interval, scaled to 0 ≤ τ ≤ 1, the state is the polynomial through its value at τ = 0 and its values at the
K collocation points; there its derivative equals the equations' rate. The input is the polynomial through its
values at the collocation points. A method supplies numbers only; the transcription is one for all.

Source: Garg, Patterson, Hager, Rao, Benson & Huntington, A unified framework for the numerical solution of
optimal control problems using pseudospectral methods, Automatica 46 (2010).
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.foundation.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Method:
    """A collocation method on 0 ≤ τ ≤ 1 with K points.

    points (K,): where the rate is matched, rising. differentiation (K, K+1): values at 0 and the points ->
    derivatives at the points. weights (K,): of the quadrature. end (K+1,): values at 0 and the points -> value
    at τ = 1.
    """

    name: str
    points: Array
    differentiation: Array
    weights: Array
    end: Array

    @property
    def support(self) -> Array:
        """Return where the state's polynomial has its values: 0 and the points, (K+1,)."""
        return np.concatenate([[0.0], self.points])

    @property
    def closes(self) -> bool:
        """Tell whether the last point ends the interval, so that it is the next interval's start."""
        return bool(self.points[-1] == 1.0)


def barycentric_weights(points: Array) -> Array:
    """Return the weights (K,) of barycentric interpolation through `points` (K,).

    Source: Berrut & Trefethen, Barycentric Lagrange interpolation, SIAM Review 46 (2004), eq. 3.2.
    """
    gaps = points[:, None] - points[None, :]
    np.fill_diagonal(gaps, 1.0)
    return 1 / gaps.prod(1)


def interpolation_matrix(points: Array, at: ArrayLike) -> Array:
    """Return the matrix (M, K) from values at `points` (K,) to values at `at` (M,); op. cit. eq. 4.2."""
    gaps = np.asarray(at, dtype=float)[:, None] - points[None, :]
    exact = gaps == 0
    parts = barycentric_weights(points) / np.where(exact, 1.0, gaps)
    parts[exact.any(1)] = 0.0
    parts[exact] = 1.0
    return parts / parts.sum(1, keepdims=True)


def differentiation_matrix(points: Array) -> Array:
    """Return the matrix (K, K) from values at `points` to derivatives there; op. cit. eqs. 9.4 and 9.5."""
    weights = barycentric_weights(points)
    gaps = points[:, None] - points[None, :]
    np.fill_diagonal(gaps, 1.0)
    matrix = weights[None, :] / weights[:, None] / gaps
    np.fill_diagonal(matrix, 0.0)
    np.fill_diagonal(matrix, -matrix.sum(1))
    return matrix


@cache
def radau(count: int) -> Method:
    """Return the flipped Legendre–Gauss–Radau method with `count` points, the last at the interval's end.

    State of degree `count`, input of degree `count` - 1; exact quadrature to degree 2 `count` - 2.

    Raises:
        InputError: `count` is not between 2 and 12.
    """
    if not 2 <= count <= 12:
        raise InputError(f"radau-{count}: the method has 2 to 12 points here; radau-5 serves the pendulum")
    # The points are 1 and the zeros of (P_{K-1} - P_K)/(1 - x), on -1 to 1.
    legendre = np.polynomial.legendre.Legendre
    difference = legendre.basis(count - 1) - legendre.basis(count)
    slope = difference.deriv()
    inner = np.sort(difference.roots().real)[:-1]
    for _ in range(3):
        inner = inner - difference(inner) / slope(inner)
    points = np.concatenate([(inner + 1) / 2, [1.0]])
    return collocation_method(f"radau-{count}", points)


def collocation_method(name: str, points: Array) -> Method:
    """Return the method that collocates at `points` (K,) in (0, 1]."""
    support = np.concatenate([[0.0], points])
    # Interpolatory weights: exact for the powers 0 … K-1.
    powers = np.arange(len(points))
    weights = np.linalg.solve(points[None, :] ** powers[:, None], 1 / (powers + 1.0))
    return Method(
        name=name,
        points=points,
        differentiation=differentiation_matrix(support)[1:],
        weights=np.asarray(weights, dtype=np.float64),
        end=interpolation_matrix(support, [1.0])[0],
    )


def method_named(name: str) -> Method:
    """Return the method of a name such as "radau-5".

    Raises:
        InputError: there is no such method.
    """
    family, _, count = name.partition("-")
    if family != "radau" or not (count.isascii() and count.isdecimal()):
        raise InputError(f"method = {name!r}: allowed are radau-2 to radau-12")
    return radau(int(count))
