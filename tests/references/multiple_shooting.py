"""Multiple shooting as an independent check of collocation (`dpcontrol.references.problem`).

    x_{i+1} = Φ(x_i, u_i; h_i)        Φ: the flow over interval i under the interval's own input polynomial

Φ and the integral of the cost are casadi's classical Runge-Kutta method in small steps; the method in the settings
supplies only the points of the input's values. The equations differ from collocation's, so agreement is significant.

Source: Bock & Plitt, A multiple shooting algorithm for direct solution of optimal control problems, IFAC (1984).
"""

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.references.method import Method
from dpcontrol.references.problem import ANGLE_SCALE, RATE_SCALE, ReferenceProblem, ReferenceSettings, state_scale
from dpcontrol.references.trajectory import first_trajectory, interval_propagator, power_coefficients
from dpcontrol.references.transcription import solver_options

Array = NDArray[np.float64]

STEPS = 10
"""Steps of the integrator in an interval; its errors are below 1e-8."""
CLOSES = 1e-10
"""Scaled gap between intervals that the solver may leave."""


def solve_by_shooting(
    problem: ReferenceProblem, method: Method, *, settings: ReferenceSettings, mesh: Array, times: Array
) -> tuple[float, Array]:
    """Return the least cost on `mesh` (N+1,) s, and the scaled states (M, nx) at `times` (M,) s.

    Limits apply to the states at the ends of intervals and to the inputs at the method's points.
    Times and end states must be fixed, without a jerk limit.
    """
    nx, count, n = problem.equations.dimension, len(method.points), len(mesh) - 1
    scale = state_scale(nx, problem.limits)
    nodes, inputs = ca.MX.sym("nodes", nx, n + 1), ca.MX.sym("inputs", count, n)
    where = ca.DM(np.array([mesh[:-1], np.diff(mesh)]))
    ends = _flow(problem, method, settings).map(n)(x0=nodes[:, :-1], p=ca.vertcat(inputs, where))
    program = {
        "x": ca.vertcat(ca.vec(nodes), ca.vec(inputs)),
        "f": ca.sum2(ends["qf"]),
        "g": ca.vec(ends["xf"] - nodes[:, 1:]),
    }
    solver = ca.nlpsol("shooting", "ipopt", program, solver_options(settings))
    low, high = _bounds(problem, settings, count=count, intervals=n)
    first = first_trajectory(problem, method, mesh)
    starts = np.vstack([first.states[:, 0], method.end @ first.states[-1]]) / scale
    x0 = np.clip(np.concatenate([starts.ravel(), first.inputs.ravel()]), low, high)
    out = solver(x0=x0, lbx=low, ubx=high, lbg=0.0, ubg=0.0)
    assert solver.stats()["success"]
    assert np.abs(np.array(out["g"])).max() < CLOSES
    values = np.array(out["x"]).ravel()
    found, pushes = values[: nx * (n + 1)].reshape(n + 1, nx) * scale, values[nx * (n + 1) :].reshape(n, count)
    powers = power_coefficients(method.points, pushes) / np.diff(mesh)[:, None] ** np.arange(count)
    index = np.clip(np.searchsorted(mesh, times, side="right") - 1, 0, n - 1)
    propagator = interval_propagator(problem, method)
    # A propagator begins at zero, and its times rise.
    places = [np.append(0.0, times[index == i] - mesh[i] + 1e-12) for i in range(n)]
    states = [propagator.sample(found[i], powers[i], places[i])[1:] for i in range(n)]
    return float(out["f"]), np.vstack(states) / scale


def _flow(problem: ReferenceProblem, method: Method, settings: ReferenceSettings) -> ca.Function:
    """Return casadi's integrator of scaled state and cost over an interval, with inputs, start and length as `p`."""
    nx, nz, count = problem.equations.dimension, problem.pendulum_dimension, len(method.points)
    scale = ca.DM(state_scale(nx, problem.limits))
    pendulum_scale = np.repeat([ANGLE_SCALE, RATE_SCALE], nz // 2)
    grid = np.linspace(0.0, problem.duration, 1001)
    guess = ca.interpolant("guess", "bspline", [grid], (problem.guess_at(grid) / pendulum_scale).ravel())
    x, p, share = ca.MX.sym("x", nx), ca.MX.sym("p", count + 2), ca.MX.sym("share")
    begin, length, state = p[count], p[count + 1], scale * x
    monomials = ca.vertcat(*(share**k for k in range(count)))
    push = ca.dot(ca.DM(np.linalg.inv(np.vander(method.points, increasing=True)).T) @ monomials, p[:count])
    away = state[:nz] / ca.DM(pendulum_scale) - guess(begin + share * length)
    running = push**2 + settings.pendulum_weight * ca.sumsqr(away) + settings.cart_weight * state[nz] ** 2
    rate = problem.equations.function()(state, push, ca.DM(problem.parameters))
    equations = {"x": x, "p": p, "t": share, "ode": length * rate / scale, "quad": length * running}
    return ca.integrator("flow", "rk", equations, 0.0, 1.0, {"number_of_finite_elements": STEPS})


def _bounds(
    problem: ReferenceProblem, settings: ReferenceSettings, *, count: int, intervals: int
) -> tuple[Array, Array]:
    """Return the lower and upper bounds of nodes and inputs."""
    nx, nz, limits = problem.equations.dimension, problem.pendulum_dimension, problem.limits
    scale = state_scale(nx, limits)
    high = np.full((intervals + 1, nx), np.inf)
    high[:, nz:] = np.array([limits.position, limits.velocity]) / scale[nz:]
    low = -high
    slack = np.where(np.arange(nx) < nz, settings.end_tolerance, 0.0)
    for row, state, spare in zip((0, -1), problem.end_states(), (np.zeros(nx), slack), strict=True):
        given = np.isfinite(state)
        low[row, given], high[row, given] = (state / scale - spare)[given], (state / scale + spare)[given]
    pushes = np.full(intervals * count, limits.acceleration)
    return np.concatenate([low.ravel(), -pushes]), np.concatenate([high.ravel(), pushes])
