"""Why a reference was not found, in words, and what would help: limits, friction, authority, or the guess itself."""

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.references.errors import largest_values, where_largest
from dpcontrol.references.homotopy import Raised
from dpcontrol.references.method import Method
from dpcontrol.references.problem import (
    ANGLE_SCALE,
    LIMIT_UNITS,
    RATE_SCALE,
    Limits,
    ReferenceProblem,
    ReferenceSettings,
    state_scale,
)
from dpcontrol.references.trajectory import Solved, Trajectory
from dpcontrol.references.transcription import solve

Array = NDArray[np.float64]

FARTHEST = 0.45
"""How far (scaled) a reference may pass from the guess within a third of a second before it is another motion.

Outer turn at -0.07 J and crossing at 0.2 J: 0.37 at the most that friction did to the itinerary itself (15 times the
arms' own); from 0.55 where the search ended at another motion, and 1.8 from straight lines."""
UNLIMITED = Limits(1e3, 1e3, 1e5)
_NO_AUTHORITY = 1e-9


def without_limits(
    problem: ReferenceProblem, method: Method, *, settings: ReferenceSettings, first: Trajectory
) -> Solved:
    """Solve the same program with limits that nothing reaches."""
    return solve(problem, method, settings=settings, first=first, limits=UNLIMITED)


def has_authority(problem: ReferenceProblem, times: Array) -> bool:
    """Tell whether the cart's acceleration moves any arm, along the guess at `times` (K,)."""
    e, n = problem.equations, problem.pendulum_dimension // 2
    effect = ca.Function("effect", [e.state, e.inputs, e.parameters], [ca.jacobian(e.rate[n : 2 * n], e.inputs)])
    states = np.hstack([problem.guess_at(times), np.zeros((len(times), 2))])
    found = np.array(effect.map(len(times))(states.T, 0.0, problem.parameters))
    return bool(np.abs(found).max() > _NO_AUTHORITY)


def limits_passed(problem: ReferenceProblem, method: Method, trajectory: Trajectory) -> str:
    """Say which of the problem's limits a motion without limits passes, by how much and when; empty if none."""
    largest = largest_values(trajectory, method=method, limits=problem.limits)
    passed = [
        f"cart {name} of {largest[name]:.4g} {LIMIT_UNITS[name]} where {bound:.4g} is allowed (at t = "
        f"{where_largest(trajectory, name, method=method):.2f} s)"
        for name, bound in problem.limits.named().items()
        if largest[name] > bound
    ]
    if not passed:
        return ""
    return (
        f"without limits it takes a {' and a '.join(passed)}; limits that wide are enough: widen them, or choose a "
        "gentler itinerary"
    )


def wanting(problem: ReferenceProblem, method: Method, *, settings: ReferenceSettings, first: Trajectory) -> str:
    """Say what stands in the way where nothing was found: the cart's authority, limits, or the guess."""
    if not has_authority(problem, first.mesh):
        return "the cart's acceleration moves no arm, so nothing makes up for friction; check the arms' parameters"
    free = without_limits(problem, method, settings=settings, first=first)
    if not free.succeeded:
        return (
            "without limits it finds nothing either: check that the guess is an orbit of the same arms, or "
            "lower the friction"
        )
    return limits_passed(problem, method, free.trajectory) or (
        "the limits are not the reason, for without them the same motion is found; use shorter intervals"
    )


def friction_text(raised: Raised) -> str:
    """Say how much of the friction could be made up for."""
    if np.isnan(raised.share):
        return (
            "even without friction and limits the guess leads to no motion near it: check that it is an orbit of the "
            "same arms"
        )
    return (
        f"friction is out of reach: {raised.share:.0%} of it can be made up for within the limits; lower the friction, "
        "widen the limits or choose a gentler itinerary"
    )


def guess_misses_its_ends(problem: ReferenceProblem) -> str:
    """Say where the guess is far from the states that the reference is to start and end in; empty if it is not."""
    nz, ends = problem.pendulum_dimension, problem.ends
    scale = state_scale(problem.equations.dimension, problem.limits)[:nz]
    first, last = problem.guess_at(np.array([0.0, problem.duration]))
    gaps = []
    for where, given, guessed in (("starts", ends.start, first), ("ends", ends.end, last)):
        if given is not None:
            gaps.append((where, given[:nz] - guessed))
    if ends.closing is not None:
        gaps.append(("closes", ends.closing[:nz] - (last - first)))
    for where, gap in gaps:
        away = float(np.nanmax(np.abs(gap) / scale, initial=0.0))
        if away > FARTHEST:
            return (
                f"the guess {where} {away:.2f} (scaled) from where the reference is to: an orbit integrated for "
                "several periods leaves itself, so tile one period instead"
            )
    return ""


def another_motion(away: float, when: float) -> str:
    """Say that what was found is not what was asked for."""
    return (
        f"no reference near the guess: what was found passes {away:.2f} from it at t = {when:.2f} s (scaled by "
        f"{ANGLE_SCALE:.3g} rad and {RATE_SCALE:g} rad/s; up to {FARTHEST:g} is the same motion), so it is another "
        "motion than the itinerary's; check that the guess is an orbit of the same arms, or lower the friction"
    )
