"""Getting from one state to another: swing up from rest, come down to rest, change from orbit to orbit.

A transfer follows nothing; its cost is the cart's effort and travel. The guess turns each arm by a smooth curve without
its ends' rates, from which direct collocation finds a swing-up as well as a landing (35 of 36 tried; with the ends'
rates in the guess 30, and half as gentle). Several durations, and several lattice points to end on, are tried on a
coarse mesh; the first that leaves the feedback room is refined, or else the gentlest.
Source: Kelly, An introduction to trajectory optimization, SIAM Review 59 (2017), for the method.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.references.find import find_reference, wanting
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import (
    LIMIT_UNITS,
    EndConditions,
    Guess,
    Limits,
    ReferenceProblem,
    ReferenceSettings,
)
from dpcontrol.references.reference import Reference
from dpcontrol.references.trajectory import Trajectory, first_trajectory, largest_values
from dpcontrol.references.transcription import solve

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TransferSettings:
    """How transfers are sought. durations: tried in turn, s; cart_weight: of the cart's position in the cost.

    gentle: a transfer that uses at most this share of every limit is taken at once. iterations: of the solver in one
    try; interval: s, of the mesh on which tries are made.
    """

    durations: tuple[float, ...] = (2.0, 2.5, 1.5, 3.0)
    cart_weight: float = 100.0
    gentle: float = 0.6
    iterations: int = 100
    interval: float = 0.05


def smooth_guess(start: Array, end: Array, duration: float) -> Guess:
    """Return the guess whose angles turn from those of start to those of end (2n,), at rest at both."""
    n = len(start) // 2
    change = end[:n] - start[:n]

    def guess(times: Array) -> Array:
        t = np.asarray(times, dtype=float)[:, None] / duration
        return np.hstack([start[:n] + change * (3 * t**2 - 2 * t**3), change * (6 * t - 6 * t**2) / duration])

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
    method = method_named(settings.method)
    tries = list(product(transfer.durations, ends))
    solved: list[tuple[float, ReferenceProblem, Trajectory]] = []

    def sought(duration: float, end: Array) -> tuple[ReferenceProblem, Trajectory]:
        """Return one problem, and the guess on its coarse mesh."""
        guess, both = smooth_guess(start[:-2], end[:-2], duration), EndConditions(start=start, end=end)
        problem = ReferenceProblem(equations, parameters, guess, duration, limits=limits, ends=both)
        mesh = np.linspace(0.0, duration, int(np.ceil(duration / transfer.interval)) + 1)
        return problem, first_trajectory(problem, method, mesh)

    (problem, first), outcome = sought(*tries[0]), ""
    for k, one in enumerate(tries):
        progress("transfer", k / len(tries))
        problem, first = sought(*one)
        attempt = solve(problem, first, settings=tried, limits=limits)
        outcome = attempt.outcome
        if attempt.succeeded:
            share = _share(attempt.trajectory, limits)
            solved.append((share, problem, attempt.trajectory))
            if share <= transfer.gentle:
                break
    for _, chosen, trajectory in sorted(solved, key=lambda entry: entry[0]):
        found = find_reference(chosen, wanted, near=trajectory)
        outcome = found.status
        if found.converged:
            progress("transfer", 1.0)
            return found
    seconds = ", ".join(f"{duration:g}" for duration in transfer.durations)
    why = wanting(problem, first, tried)
    raise GoalMissed(f"no transfer in {seconds} s within the cart's limits ({_named(limits)}): {outcome}; {why}")


def _share(trajectory: Trajectory, limits: Limits) -> float:
    """Return the largest share of a limit that a trajectory uses."""
    largest = largest_values(trajectory, limits)
    return max(largest[name] / bound for name, bound in limits.named().items())


def _named(limits: Limits) -> str:
    return ", ".join(f"{name} {bound:g} {LIMIT_UNITS[name]}" for name, bound in limits.named().items())
