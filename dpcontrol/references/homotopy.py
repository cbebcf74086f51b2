"""Friction raised step by step: each solution starts the next, from no friction, where the guess is a solution itself.

Steps are halved where one fails. How far it comes is an answer too: what share of the friction can be made up for.
Source: Nocedal & Wright, Numerical Optimization, 2nd ed., section 11.3, for continuation.
"""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.references.errors import away_from_guess
from dpcontrol.references.method import Method
from dpcontrol.references.problem import Limits, ReferenceProblem, ReferenceSettings
from dpcontrol.references.trajectory import Solved, Trajectory
from dpcontrol.references.transcription import solve

Array = NDArray[np.float64]

STEP = 0.25
LEAST_STEP = 1 / 32
_ROUNDING = 1e-12
ITERATIONS = 40
"""Of the solver in a step: next to a solution it takes ten or so."""


@dataclass(frozen=True)
class Raised:
    """The last solution and the share of the friction it makes up for; not-a-number: none even without friction.

    iterations and seconds are those of all steps.
    """

    solved: Solved | None
    share: float
    iterations: int
    seconds: float


def friction_parameters(problem: ReferenceProblem) -> NDArray[np.bool_]:
    """Tell which parameters (p,) act on arms whose cart does not push, though the energy does not know them."""
    e = problem.equations
    slopes = ca.Function("slopes", [e.state, e.inputs, e.parameters], [ca.jacobian(e.rate, e.parameters)])
    # The cart stands still: terms in its velocity cancel but for rounding.
    anywhere = np.append(np.sqrt(np.arange(2.0, e.dimension)), [0.0, 0.0])
    effect = np.abs(np.array(ca.densify(slopes(anywhere, 0.0, problem.parameters)))).max(0)
    acts = effect > _ROUNDING * effect.max()
    return acts & ~np.array(ca.which_depends(e.hamiltonian, e.parameters, 1, False), dtype=bool)


def raise_friction(
    problem: ReferenceProblem,
    method: Method,
    *,
    settings: ReferenceSettings,
    first: Trajectory,
    limits: Limits,
    farthest: float,
) -> Raised:
    """Solve with shares of the friction from none to all, never further than `farthest` (scaled) from the guess."""
    friction = friction_parameters(problem)
    reached, step, kept = np.nan, STEP, None
    iterations, seconds = 0, 0.0
    quick = replace(settings, iterations=min(settings.iterations, ITERATIONS))
    while not reached >= 1.0 and step >= LEAST_STEP:
        share = 0.0 if kept is None else min(1.0, reached + step)
        parameters = np.where(friction, share * problem.parameters, problem.parameters)
        solved = solve(
            replace(problem, parameters=parameters), method, settings=quick,
            first=first if kept is None else kept.trajectory, limits=limits, warm=kept is not None,
        )  # fmt: skip
        iterations, seconds = iterations + solved.iterations, seconds + solved.seconds
        if solved.succeeded and away_from_guess(problem, solved.trajectory, method=method)[0] <= farthest:
            reached, kept = share, solved
        elif kept is None:
            break
        else:
            step /= 2
    return Raised(kept, reached, iterations, seconds)
