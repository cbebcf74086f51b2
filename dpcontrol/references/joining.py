"""References one after the other, as one: pieces that end where the next begins."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dpcontrol.references.method import Method
from dpcontrol.references.problem import Limits, state_scale
from dpcontrol.references.reference import Reference

Array = NDArray[np.float64]


def still(state: Array, seconds: float, *, method: Method, limits: Limits, interval: float) -> Reference:
    """Return the reference that stays at an equilibrium (N,), without input."""
    count = max(1, int(np.ceil(seconds / interval)))
    shape = (count, len(method.support), len(state))
    return Reference(
        mesh=np.linspace(0.0, seconds, count + 1),
        method=method,
        states=np.broadcast_to(np.asarray(state, dtype=float), shape).copy(),
        inputs=np.zeros((count, len(method.points), 1)),
        limits=limits,
        status=f"at rest for {seconds:g} s",
        converged=True,
        max_error_between_nodes=0.0,
        constraint_violation=0.0,
        max_cart_position=float(abs(state[-2])),
        max_cart_velocity=0.0,
        max_cart_acceleration=0.0,
        rms_cart_acceleration=0.0,
        iterations=0,
        solve_seconds=0.0,
    )


def joined(pieces: Sequence[Reference]) -> tuple[Reference, Array]:
    """Return pieces as one reference, and the times (P + 1,) at which they begin and the last ends.

    All have one method. A jump from one to the next counts as a constraint violation; their inputs may jump.

    Raises:
        ValueError: no pieces, or pieces of different methods.
    """
    if not pieces or len({piece.method.name for piece in pieces}) > 1:
        raise ValueError("pieces of one method are joined, one at least")
    first, limits = pieces[0], pieces[0].limits
    if len(pieces) == 1:
        return first, np.array([0.0, first.duration])
    scale = state_scale(first.states.shape[-1], limits)
    begins = np.concatenate([[0.0], np.cumsum([piece.duration for piece in pieces])])
    meshes = [piece.mesh - piece.mesh[0] + begin for piece, begin in zip(pieces, begins[:-1], strict=True)]
    mesh = np.concatenate([*(m[:-1] for m in meshes), meshes[-1][-1:]])
    jumps = [
        float(np.max(np.abs(before.state(before.mesh[-1]) - after.state(after.mesh[0])) / scale))
        for before, after in pairwise(pieces)
    ]
    lengths = np.diff(begins)
    square = sum(piece.rms_cart_acceleration**2 * length for piece, length in zip(pieces, lengths, strict=True))
    bad = [piece for piece in pieces if not piece.converged]
    error = max(piece.max_error_between_nodes for piece in pieces)
    count = len(mesh) - 1
    status = bad[0].status if bad else (
        f"converged in {sum(piece.iterations for piece in pieces)} iterations; error between nodes {error:.1e} on "
        f"{count} intervals of {len(pieces)} pieces"
    )  # fmt: skip
    together = replace(
        first,
        mesh=mesh,
        states=np.concatenate([piece.states for piece in pieces]),
        inputs=np.concatenate([piece.inputs for piece in pieces]),
        status=status,
        converged=not bad,
        max_error_between_nodes=error,
        constraint_violation=max([*jumps, *(piece.constraint_violation for piece in pieces)]),
        max_cart_position=max(piece.max_cart_position for piece in pieces),
        max_cart_velocity=max(piece.max_cart_velocity for piece in pieces),
        max_cart_acceleration=max(piece.max_cart_acceleration for piece in pieces),
        rms_cart_acceleration=float(np.sqrt(square / lengths.sum())),
        iterations=sum(piece.iterations for piece in pieces),
        solve_seconds=sum(piece.solve_seconds for piece in pieces),
    )
    return together, begins
