"""A homotopy from any curve to a flight, without tubes.

The arms have virtual accelerations at rising prices.

    minimise ∫ u² + ρ |v|² dt      subject to  ẋ = f(x, u) + (0, v, 0), the cart's limits, the ends;   ρ: rising

While v is cheap any curve between the ends is a motion, so the first program always has a solution. Each solution
starts the next. Trapezoidal collocation on an even mesh gives a first guess for the true program.

Source: Betts, Practical Methods for Optimal Control Using Nonlinear Programming, 3rd ed., ch. 4; Nocedal & Wright,
Numerical Optimization, 2nd ed., section 11.3.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.interrupts import catching_interrupts
from dpcontrol.references.problem import ReferenceProblem, state_scale


@dataclass(frozen=True)
class HomotopySettings:
    """Mesh, prices and effort of the homotopy.

    Attributes:
        step: step of the mesh, s.
        prices: prices of the virtual accelerations, rising.
        iterations: solver iterations per price.
    """

    step: float = 0.025
    prices: tuple[float, ...] = (1e-2, 1.0, 1e2)
    iterations: int = 100


def by_homotopy(problem: ReferenceProblem, settings: HomotopySettings | None = None) -> tuple[Array, Array, float]:
    """Return states (K, N), inputs (K,) and their step, s.

    The homotopy starts at the problem's guess.

    Args:
        problem: problem with a guess.
        settings: step and prices.
    """
    settings = settings or HomotopySettings()
    e, nx = problem.equations, problem.equations.dimension
    n, count = nx // 2 - 1, int(np.ceil(problem.duration / settings.step)) + 1
    scale, h = ca.DM(state_scale(nx, problem.limits)), problem.duration / (count - 1)
    states, inputs, virtual = (ca.MX.sym(name, rows, count) for name, rows in (("x", nx), ("u", 1), ("v", n)))
    price = ca.MX.sym("price")
    z, u, v = ca.SX.sym("z", nx), ca.SX.sym("u"), ca.SX.sym("v", n)
    pushed = e.function()(scale * z, u, ca.DM(problem.parameters)) + ca.vertcat(ca.SX(n, 1), v, ca.SX(2, 1))
    rates = ca.Function("rates", [z, u, v], [pushed / scale], {"cse": True}).map(count)(states, inputs, virtual)
    defects = states[:, 1:] - states[:, :-1] - h / 2 * (rates[:, 1:] + rates[:, :-1])
    weights = ca.DM([0.5] + [1.0] * (count - 2) + [0.5]).T * h
    cost = ca.sum2(weights * (inputs**2 + price * ca.sum1(virtual**2)))
    variables = ca.vertcat(ca.vec(states), ca.vec(inputs), ca.vec(virtual))
    options = {
        "print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.max_iter": settings.iterations,
        "ipopt.tol": 1e-6, "error_on_fail": False,
    }  # fmt: skip
    solver = ca.nlpsol("homotopy", "ipopt", {"x": variables, "p": price, "f": cost, "g": ca.vec(defects)}, options)
    times = np.linspace(0.0, problem.duration, count)
    high = np.full((count, nx), np.inf)
    high[:, -2:] = np.array([problem.limits.position, problem.limits.velocity]) / np.array(scale).ravel()[-2:]
    low = -high
    low[[0, -1]] = high[[0, -1]] = np.array(problem.end_states()) / np.array(scale).ravel()
    free = np.full(n * count, np.inf)
    bounds = [np.concatenate([box.ravel(), np.full(count, side), side * free])
              for box, side in ((low, -problem.limits.acceleration), (high, problem.limits.acceleration))]  # fmt: skip
    guess = np.hstack([problem.guess_at(times), np.zeros((count, 2))]) / np.array(scale).ravel()
    found = np.concatenate([guess.ravel(), np.zeros((1 + n) * count)])
    for value in settings.prices:
        with catching_interrupts():
            found = np.array(solver(x0=found, p=value, lbx=bounds[0], ubx=bounds[1], lbg=0, ubg=0)["x"]).ravel()
    rows = found[: nx * count].reshape(count, nx) * np.array(scale).ravel()
    return rows, found[nx * count : (nx + 1) * count], h
