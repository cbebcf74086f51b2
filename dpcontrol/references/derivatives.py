"""Derivatives of a transcribed program, assembled from those of one interval.

casadi would find the Jacobian of the whole program by colouring: some forty sweeps over all intervals for each. One
interval's Jacobian and Hessian are small symbolic matrices; mapped over the mesh and scattered into the program's
sparse ones they are built, and evaluated, several times faster.
"""

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


def interval_derivatives(
    interval: ca.Function, *, columns: Indices, lengths: Array, guess: Array, size: int
) -> dict[str, Any]:
    """Return the options grad_f, jac_g and hess_lag of `casadi.nlpsol`, and the program's own x, f and g.

    interval: (v, length, guess) -> (constraints, cost) of one interval, SX. columns (nv, N): where each interval's v
    lies among the program's `size` variables; the last block of v may be shared with the next interval's first.
    guess (ng, N); lengths (N,). Constraints are ordered by interval.
    """
    nv, intervals = columns.shape
    v, length = ca.SX.sym("v", nv), ca.SX.sym("length")
    aim = ca.SX.sym("aim", guess.shape[0])
    constraints, cost = interval(v, length, aim)
    rows = constraints.shape[0]
    weight, multipliers = ca.SX.sym("weight"), ca.SX.sym("multipliers", rows)
    jacobian = ca.jacobian(constraints, v)
    hessian = ca.triu(ca.hessian(weight * cost + ca.dot(multipliers, constraints), v)[0])
    inputs = [v, length, aim]
    one_jacobian = ca.Function("j", inputs, [constraints, jacobian.nz[:]], {"cse": True})
    one_gradient = ca.Function("d", inputs, [cost, ca.densify(ca.gradient(cost, v))], {"cse": True})
    one_hessian = ca.Function("h", [*inputs, weight, multipliers], [hessian.nz[:]], {"cse": True})

    x, p = ca.MX.sym("x", size), ca.MX.sym("p", 0)
    gathered = ca.reshape(x[columns.T.ravel().tolist()], nv, intervals)
    fixed = [gathered, ca.DM(lengths).T, ca.DM(guess)]
    g, entries = one_jacobian.map(intervals)(*fixed)
    f, slopes = one_gradient.map(intervals)(*fixed)
    # Triplets of all intervals, interval by interval, in the order of the entries.
    local_row, local_col = (np.array(part) for part in jacobian.sparsity().get_triplet())
    stage = np.arange(intervals)
    jacobian_rows = (local_row[:, None] + rows * stage).T.ravel()
    jacobian_columns = columns[local_col].T.ravel()
    full_jacobian = _scattered(ca.vec(entries), jacobian_rows, jacobian_columns, (rows * intervals, size))
    gradient = _scattered(ca.vec(slopes), columns.T.ravel(), np.zeros(nv * intervals, dtype=np.intp), (size, 1))

    sigma, lam = ca.MX.sym("sigma"), ca.MX.sym("lam", rows * intervals)
    weights = ca.repmat(sigma, 1, intervals)
    curvatures = one_hessian.map(intervals)(*fixed, weights, ca.reshape(lam, rows, intervals))
    local_row, local_col = (np.array(part) for part in hessian.sparsity().get_triplet())
    one, other = columns[local_row].T.ravel(), columns[local_col].T.ravel()
    # Columns need not rise within v; the upper triangle is wanted.
    full_hessian = _scattered(ca.vec(curvatures), np.minimum(one, other), np.maximum(one, other), (size, size))
    total, flat = ca.sum2(f), ca.vec(g)
    return {
        "program": {"x": x, "f": total, "g": flat, "p": p},
        "options": {
            "grad_f": ca.Function("nlp_grad_f", [x, p], [total, ca.densify(gradient)], ["x", "p"], ["f", "grad:f:x"]),
            "jac_g": ca.Function("nlp_jac_g", [x, p], [flat, full_jacobian], ["x", "p"], ["g", "jac:g:x"]),
            "hess_lag": ca.Function(
                "nlp_hess_l", [x, p, sigma, lam], [full_hessian], ["x", "p", "lam:f", "lam:g"], ["triu:hess:gamma:x:x"]
            ),
        },
    }


def _scattered(values: ca.MX, rows: Indices, columns: Indices, shape: tuple[int, int]) -> ca.MX:
    """Return the sparse matrix with `values` (K,) at (rows, columns) (K,), those at the same place added."""
    place = columns * shape[0] + rows
    order = np.argsort(place, kind="stable")
    first = np.concatenate([[True], np.diff(place[order]) != 0])
    unique = place[order][first]
    sparsity = ca.Sparsity.triplet(*shape, (unique % shape[0]).tolist(), (unique // shape[0]).tolist())
    slot = np.cumsum(first) - 1
    if first.all():
        return ca.MX(sparsity, values[order.tolist()])
    # One column for each value: a product with zeros and ones adds what falls together.
    gather = ca.Sparsity.triplet(len(unique), len(place), slot.tolist(), order.tolist())
    return ca.MX(sparsity, ca.mtimes(ca.DM(gather, 1.0), values))
