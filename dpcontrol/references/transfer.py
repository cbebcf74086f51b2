"""Getting from one state to another: swing up from rest, come down to rest, change from orbit to orbit.

A transfer follows nothing; its cost is the cart's effort alone. The guess is a smooth curve from start to end, from
which direct collocation finds a swing-up as well as a landing; several durations, and several lattice points to end on,
are tried in turn, with half of the cart's limits first: what is left is the feedback's.
Source: Kelly, An introduction to trajectory optimization, SIAM Review 59 (2017), for the method.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.files import Progress, no_progress
from dpcontrol.references.find import find_reference, wanting
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import (
    LIMIT_UNITS,
    Ends,
    Guess,
    Limits,
    ReferenceProblem,
    ReferenceSettings,
)
from dpcontrol.references.reference import Reference
from dpcontrol.references.transcription import first_trajectory, solve

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TransferSettings:
    """How transfers are sought. durations: tried in turn, s; cart_weight: of the cart's position in the cost.

    shares: of the limits that a transfer may use; the first that allows one is taken, for what is left is the
    feedback's. iterations: of the solver in one try; interval: s, of the mesh on which tries are made.
    """

    durations: tuple[float, ...] = (2.5, 2.0, 3.5)
    cart_weight: float = 1.0
    shares: tuple[float, ...] = (0.5, 1.0)
    iterations: int = 120
    interval: float = 0.05


def smooth_guess(start: Array, end: Array, duration: float) -> Guess:
    """Return the guess whose angles run from start to end (2n,) by a cubic with the ends' own rates."""
    n = len(start) // 2

    def guess(times: Array) -> Array:
        t = np.asarray(times, dtype=float)[:, None] / duration
        # Cubic Hermite polynomials, and their derivatives.
        bases = (2 * t**3 - 3 * t**2 + 1, t**3 - 2 * t**2 + t, -2 * t**3 + 3 * t**2, t**3 - t**2)
        slopes = (6 * t**2 - 6 * t, 3 * t**2 - 4 * t + 1, -6 * t**2 + 6 * t, 3 * t**2 - 2 * t)
        values = (start[:n], start[n:] * duration, end[:n], end[n:] * duration)
        angles = sum(base * value for base, value in zip(bases, values, strict=True))
        rates = sum(slope * value for slope, value in zip(slopes, values, strict=True)) / duration
        return np.hstack([angles, rates])

    return guess


def find_transfer(
    equations: Equations,
    parameters: Array,
    *,
    start: Array,
    ends: Sequence[Array],
    limits: Limits,
    settings: ReferenceSettings,
    transfer: TransferSettings | None = None,
    progress: Progress = no_progress,
) -> Reference:
    """Return a reference from `start` (N,) to one of `ends` (N,), with friction, cart and limits.

    Raises:
        GoalMissed: none of the durations and ends gave one; says what stood in the way of the last.
    """
    transfer = transfer or TransferSettings()
    wanted = replace(settings, pendulum_weight=0.0, cart_weight=transfer.cart_weight, end_tolerance=0.0)
    tried = replace(wanted, iterations=transfer.iterations)
    method, nz = method_named(settings.method), equations.dimension - 2
    tries = list(product(transfer.shares, transfer.durations, ends))
    outcome = ""
    assert tries
    for k, (share, duration, end) in enumerate(tries):
        progress("transfer", k / len(tries))
        problem = ReferenceProblem(
            equations=equations,
            parameters=parameters,
            guess=smooth_guess(start[:nz], end[:nz], duration),
            duration=duration,
            limits=limits,
            ends=Ends(start=start, end=end),
        )
        mesh = np.linspace(0.0, duration, int(np.ceil(duration / transfer.interval)) + 1)
        held = limits.shared(share)
        first = first_trajectory(problem, method, mesh)
        attempt = solve(problem, method, settings=tried, first=first, limits=held)
        if not attempt.succeeded:
            outcome = attempt.outcome
            continue
        found = find_reference(problem, wanted, near=attempt.trajectory, held=held)
        outcome = found.status
        if found.converged:
            progress("transfer", 1.0)
            return found
    seconds = ", ".join(f"{duration:g}" for duration in transfer.durations)
    why = wanting(problem, method, settings=tried, first=first)
    raise GoalMissed(f"no transfer in {seconds} s within the cart's limits ({_named(limits)}): {outcome}; {why}")


def _named(limits: Limits) -> str:
    return ", ".join(f"{name} {bound:g} {LIMIT_UNITS[name]}" for name, bound in limits.named().items())
