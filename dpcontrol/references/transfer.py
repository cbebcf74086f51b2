"""Getting from one state to another: swing up from rest, come down to rest, change from orbit to orbit.

A transfer follows nothing; its cost is the cart's effort alone. The guess is a smooth curve from start to end, from
which direct collocation finds a swing-up as well as a landing; several durations, and several lattice points to end on,
are tried in turn. Where a transfer joins two periodic orbits of one saddle the guess blends one into the other, wobble
by wobble. Source: Kelly, An introduction to trajectory optimization, SIAM Review 59 (2017), for the method.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.files import Progress, no_progress
from dpcontrol.references.find import find_reference
from dpcontrol.references.problem import Ends, Guess, Limits, ReferenceProblem, ReferenceSettings
from dpcontrol.references.reference import Reference

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TransferSettings:
    """How transfers are sought. durations: tried in turn, s; cart_weight: of the cart's position in the cost.

    gentle: a transfer whose acceleration, velocity and travel all stay below this share of their limits is taken at
    once; otherwise the gentlest of those found is.
    """

    durations: tuple[float, ...] = (2.5, 3.0, 2.0, 4.0)
    cart_weight: float = 1.0
    iterations: int = 400
    gentle: float = 0.5


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
    wanted = replace(settings, pendulum_weight=0.0, cart_weight=transfer.cart_weight, iterations=transfer.iterations,
                     end_tolerance=0.0)  # fmt: skip
    tries = list(product(transfer.durations, ends))
    best: tuple[float, Reference] | None = None
    status = ""
    for k, (duration, end) in enumerate(tries):
        progress("transfer", k / len(tries))
        nz = equations.dimension - 2
        problem = ReferenceProblem(
            equations=equations,
            parameters=parameters,
            guess=smooth_guess(start[:nz], end[:nz], duration),
            duration=duration,
            limits=limits,
            ends=Ends(start=start, end=end),
        )
        found = find_reference(problem, wanted)
        status = found.status
        if not found.converged:
            continue
        effort = share_of_limits(found)
        if best is None or effort < best[0]:
            best = (effort, found)
        if effort <= transfer.gentle:
            break
    if best is None:
        seconds = ", ".join(f"{duration:g}" for duration in transfer.durations)
        raise GoalMissed(f"no transfer within the limits in {seconds} s: {status}")
    progress("transfer", 1.0)
    return best[1]


def share_of_limits(reference: Reference) -> float:
    """Return the largest share of a limit that a reference uses: of travel, velocity and acceleration."""
    limits = reference.limits
    return max(
        reference.max_cart_position / limits.position,
        reference.max_cart_velocity / limits.velocity,
        reference.max_cart_acceleration / limits.acceleration,
    )
