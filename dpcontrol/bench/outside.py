"""The program of a reference, given to another package: rockit, where it is installed.

Same equations, cost, ends and first guess; rockit holds its input over an interval, so its optimum is a little other.
Source: Gillis et al., Effortless modeling of optimal control problems with rockit (2020).
"""

from importlib.util import find_spec
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.references.problem import ReferenceProblem, ReferenceSettings

Array = NDArray[np.float64]

GUESS_DEGREE = 10


def has_rockit() -> bool:
    """Tell whether rockit can be imported."""
    return find_spec("rockit") is not None


def by_rockit(problem: ReferenceProblem, settings: ReferenceSettings, intervals: int) -> tuple[Array, Array]:
    """Return times (K,) s and states (K, N) of rockit's optimum, by Radau collocation with 4 points an interval.

    The cost leaves out the pendulum's distance from the guess: `settings` must not ask for it.
    """
    import rockit  # pyright: ignore[reportMissingImports]

    package: Any = rockit
    ocp = package.Ocp(T=problem.duration)
    dimension = problem.equations.dimension
    states = [ocp.state() for _ in range(dimension)]
    command = ocp.control()
    rate = problem.equations.function()(ca.vertcat(*states), command, ca.DM(problem.parameters))
    for k, state in enumerate(states):
        ocp.set_der(state, rate[k])
    ocp.add_objective(ocp.integral(command**2 + settings.cart_weight * states[problem.pendulum_dimension] ** 2))
    start, end = problem.end_states()
    sparse = np.linspace(0.0, problem.duration, 101)
    powers = np.polynomial.polynomial.polyfit(sparse, problem.guess_at(sparse), GUESS_DEGREE).T
    for k, state in enumerate(states):
        ocp.subject_to(ocp.at_t0(state) == start[k])
        ocp.subject_to(ocp.at_tf(state) == end[k])
        if k < problem.pendulum_dimension:
            # rockit takes expressions of its own time.
            ocp.set_initial(state, sum(float(c) * ocp.t**i for i, c in enumerate(powers[k])))
    quiet = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.tol": 1e-10}
    ocp.solver("ipopt", quiet)
    ocp.method(package.DirectCollocation(N=intervals, M=1, degree=4, scheme="radau"))
    solution = ocp.solve()
    sampled = [solution.sample(state, grid="control") for state in states]
    return np.array(sampled[0][0]), np.array([values for _, values in sampled]).T
