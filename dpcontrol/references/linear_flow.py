"""The equations linearised along a reference: what becomes of small differences, and of a pulse of the input.

    δẋ = A(t) δx + B(t) v(t),    A = ∂f/∂x,  B = ∂f/∂u  at (x*(t), u*(t));    δx(b) = Φ(b, a) δx(a) + Γ(b, a)

solved by Gauss collocation on the reference's own intervals, whose polynomials are smooth there.
Source: Betts, Practical Methods for Optimal Control Using Nonlinear Programming, 3rd ed., section 4.7, for what the
intervals resolve; Hairer, Lubich & Wanner, Geometric Numerical Integration, section II.1, for the method.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.equations import Equations
from dpcontrol.references.method import gauss
from dpcontrol.references.reference import Reference

Array = NDArray[np.float64]
Signal = Callable[[Array], Array]
"""From times (K,) in s to inputs (K,) in m/s²."""

_METHOD = gauss(8)
"""Of order 16: on intervals that resolve the reference its own error is at rounding."""


@dataclass(frozen=True, eq=False)
class LinearFlow:
    """A reference with the equations and base parameters (p,) that it solves, linearised along it."""

    equations: Equations
    parameters: Array
    reference: Reference

    @cached_property
    def _jacobians(self) -> ca.Function:
        e = self.equations
        parts = [ca.densify(ca.jacobian(e.rate, e.state)), ca.densify(ca.jacobian(e.rate, e.inputs))]
        return ca.Function("linear", [e.state, e.inputs, e.parameters], parts, {"cse": True})

    def pieces(self, begin: float, end: float, *, pulse: Signal | None = None) -> tuple[Array, Array]:
        """Return transition matrices (P, N, N) and pulse responses (P, N) of the pieces between two times in s.

        A piece ends where an interval of the reference does. pulse: v(t), zero if there is none.
        """
        mesh = self.reference.mesh
        ends = np.concatenate([[begin], mesh[(mesh > begin + 1e-12) & (mesh < end - 1e-12)], [end]])
        lengths, n, count = np.diff(ends), self.equations.dimension, len(_METHOD.points)
        times = ends[:-1, None] + lengths[:, None] * _METHOD.points
        flat = times.ravel()
        values = self._jacobians.map(len(flat))(
            self.reference.state(flat).T, self.reference.input(flat).T, ca.repmat(ca.DM(self.parameters), 1, len(flat))
        )
        a, b = (np.array(v).reshape(n, len(flat), -1).transpose(1, 0, 2) for v in values)
        forced = b[..., 0] * (np.zeros(len(flat)) if pulse is None else np.asarray(pulse(flat)))[:, None]
        a, forced = a.reshape(-1, count, n, n), forced.reshape(-1, count, n)
        # Unknowns: δx at the points, for each unit vector at the start and for the pulse.
        system = np.tile(np.kron(_METHOD.differentiation[:, 1:], np.eye(n)), (len(lengths), 1, 1))
        right = np.empty((len(lengths), count * n, n + 1))
        right[..., :n] = -np.kron(_METHOD.differentiation[:, :1], np.eye(n))
        right[..., n] = (lengths[:, None, None] * forced).reshape(len(lengths), -1)
        for k in range(count):
            rows = slice(k * n, (k + 1) * n)
            system[:, rows, rows] -= lengths[:, None, None] * a[:, k]
        inner = np.linalg.solve(system, right).reshape(len(lengths), count, n, n + 1)
        found = np.einsum("k,pkij->pij", _METHOD.end[1:], inner)
        found[..., :n] += _METHOD.end[0] * np.eye(n)
        return found[..., :n], found[..., n]

    def over(self, begin: float, end: float, *, pulse: Signal | None = None) -> tuple[Array, Array]:
        """Return Φ (N, N) and Γ (N,) from `begin` to `end` s; pulse as in `pieces`."""
        n = self.equations.dimension
        matrix, response = np.eye(n), np.zeros(n)
        for part, forced in zip(*self.pieces(begin, end, pulse=pulse), strict=True):
            matrix, response = part @ matrix, part @ response + forced
        return matrix, response


def products(parts: Array) -> tuple[Array, Array]:
    """Return parts[-1] … parts[0] (P, n, n) and its inverse, each (n, n), with errors relative to their own size."""
    forward, backward = np.eye(parts.shape[-1]), np.eye(parts.shape[-1])
    for part in parts:
        forward = part @ forward
        backward = backward @ np.linalg.inv(part)
    return forward, backward


def eigenvalues_of_both(forward: Array, backward: Array) -> NDArray[np.complex128]:
    """Return the eigenvalues (n,) of a matrix given with its inverse, largest modulus first.

    Those well inside the unit circle are taken from the inverse: the matrix knows them only to rounding times its
    largest.
    """
    values, small = np.linalg.eigvals(forward).astype(complex), 1 / np.linalg.eigvals(backward).astype(complex)
    values, small = (v[np.argsort(-np.abs(v), kind="stable")] for v in (values, small))
    return np.where(np.abs(small) < _SMALL, small, values)


_SMALL = 0.5
