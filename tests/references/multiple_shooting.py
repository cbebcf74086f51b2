"""Multiple shooting as an independent check of collocation (`dpcontrol.references.problem`).

    x_{i+1} = Φ(x_i, u_i; h_i)        Φ: the flow over interval i under the interval's own input polynomial

Φ and the integral of the cost use Dormand & Prince's explicit method of order eight. The method in the settings
supplies only the points of the input's values. IPOPT with casadi's derivatives solves the program. It is slower than
collocation and uses different equations, so agreement is significant.

Sources: Bock & Plitt, A multiple shooting algorithm for direct solution of optimal control problems, IFAC (1984).
Hairer, Nørsett & Wanner, Solving Ordinary Differential Equations I, section II.5, for the coefficients (as in SciPy).
"""

import time

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853

from dpcontrol.dynamics.propagator import PolynomialInputPropagator
from dpcontrol.references.method import Method, interpolation_matrix
from dpcontrol.references.problem import (
    ANGLE_SCALE,
    RATE_SCALE,
    ReferenceProblem,
    ReferenceSettings,
    state_scale,
)
from dpcontrol.references.trajectory import (
    Solved,
    Trajectory,
    first_trajectory,
    interval_propagator,
    power_coefficients,
)
from dpcontrol.references.transcription import solver_options

Array = NDArray[np.float64]

_STAGES = int(DOP853.n_stages)
_A = np.asarray(DOP853.A, dtype=float)[:_STAGES, :_STAGES]
_B = np.asarray(DOP853.B, dtype=float)
_C = np.asarray(DOP853.C, dtype=float)[:_STAGES]


def solve_by_shooting(
    problem: ReferenceProblem, method: Method, *, settings: ReferenceSettings, mesh: Array, steps: int = 1
) -> Solved:
    """Solve the program on `mesh` (N+1,) s with `steps` of the integrator per interval.

    Limits apply to the states at the ends of intervals and to the inputs at the method's points.
    Times and end states must be fixed, without a jerk limit.
    """
    began = time.perf_counter()
    nx, count, n = problem.equations.dimension, len(method.points), len(mesh) - 1
    scale = state_scale(nx, problem.limits)
    nodes, inputs = ca.MX.sym("nodes", nx, n + 1), ca.MX.sym("inputs", count, n)
    places = np.concatenate([(k + _C) / steps for k in range(steps)])
    aims = problem.guess_at((mesh[:-1, None] + np.diff(mesh)[:, None] * places).ravel()).reshape(n, -1).T
    lengths = ca.DM(np.diff(mesh)).T
    flow = _flow(problem, method, settings, steps)
    landed, costs = flow.map(n)(nodes[:, :-1], inputs, lengths, ca.DM(aims))
    program = {
        "x": ca.vertcat(ca.vec(nodes), ca.vec(inputs)),
        "f": ca.sum2(costs),
        "g": ca.vec(landed - nodes[:, 1:]),
    }
    solver = ca.nlpsol("shooting", "ipopt", program, solver_options(settings))
    low, high = _bounds(problem, settings, count=count, intervals=n)
    first = first_trajectory(problem, method, mesh)
    starts = np.vstack([first.states[:, 0], (method.end @ first.states[-1])[None]]) / scale
    x0 = np.clip(np.concatenate([starts.ravel(), first.inputs.ravel()]), low, high)
    out = solver(x0=x0, lbx=low, ubx=high, lbg=0.0, ubg=0.0)
    found, stats = np.array(out["x"]).ravel(), solver.stats()
    states = found[: nx * (n + 1)].reshape(n + 1, nx) * scale
    values = found[nx * (n + 1) :].reshape(n, count, 1)
    flown = _flown(interval_propagator(problem, method), method, mesh, states, values)
    return Solved(
        trajectory=Trajectory(method, mesh, flown, values),
        violation=float(np.abs(np.array(out["g"])).max()),
        cost=float(out["f"]),
        iterations=int(stats["iter_count"]),
        seconds=time.perf_counter() - began,
        succeeded=bool(stats["success"]),
        outcome=str(stats["return_status"]).replace("_", " ").lower(),
    )


def _flow(problem: ReferenceProblem, method: Method, settings: ReferenceSettings, steps: int) -> ca.Function:
    """Return the function (scaled state, inputs (K,), length, stage guess) -> (final scaled state, cost)."""
    e = problem.equations
    count, nx, nz = len(method.points), e.dimension, problem.pendulum_dimension
    scale = ca.DM(state_scale(nx, problem.limits))
    pendulum_scale = ca.DM([ANGLE_SCALE] * (nz // 2) + [RATE_SCALE] * (nz // 2))
    start, inputs, length = ca.SX.sym("start", nx), ca.SX.sym("inputs", count), ca.SX.sym("length")
    aims = ca.SX.sym("aims", nz * _STAGES * steps)
    rate, h = e.function(), length / steps
    x, cost = scale * start, ca.SX(0)
    for step in range(steps):
        slopes: list[ca.SX] = []
        for i in range(_STAGES):
            at = x + h * sum((float(_A[i, j]) * slopes[j] for j in range(i) if _A[i, j]), ca.SX.zeros(nx))
            row = interpolation_matrix(method.points, [(step + _C[i]) / steps])
            u = ca.mtimes(ca.DM(row), inputs)
            slopes.append(rate(at, u, ca.DM(problem.parameters)))
            offset = nz * (step * _STAGES + i)
            away = (at[:nz] - aims[offset : offset + nz]) / pendulum_scale
            running = u**2 + settings.pendulum_weight * ca.sumsqr(away) + settings.cart_weight * at[nz] ** 2
            cost += h * float(_B[i]) * running
        x = x + h * sum((float(b) * slope for b, slope in zip(_B, slopes, strict=True)), ca.SX.zeros(nx))
    return ca.Function("flow", [start, inputs, length, aims], [x / scale, cost], {"cse": True})


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


def _flown(propagator: PolynomialInputPropagator, method: Method, mesh: Array, states: Array, inputs: Array) -> Array:
    """Return the states (N, K+1, nx) at the method's support, integrated from each interval's start."""
    lengths = np.diff(mesh)
    coefficients = power_coefficients(method.points, inputs[..., 0])
    coefficients = coefficients / lengths[:, None] ** np.arange(len(method.points))
    return np.array(
        [
            propagator.sample(start, powers, method.support * length)
            for start, powers, length in zip(states[:-1], coefficients, lengths, strict=True)
        ]
    )
