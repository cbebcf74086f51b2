"""One transcription for every collocation method: optimal control as a sparse nonlinear program.

    Σ_j D_kj x_j = h f(x_k, u_k)   at the points k of each interval of length h,   x(τ = 1) = next interval's start

The interval is one casadi function, mapped over the mesh; IPOPT solves with exact Hessians. Variables are scaled
by `state_scale`. Source: Betts, Practical Methods for Optimal Control Using Nonlinear Programming, 3rd ed., ch. 4;
Wächter & Biegler, Mathematical Programming 106 (2006), for IPOPT.
"""

import time
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.references.method import Method
from dpcontrol.references.problem import (
    ANGLE_SCALE,
    RATE_SCALE,
    Limits,
    ReferenceProblem,
    ReferenceSettings,
    state_scale,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trajectory:
    """Values on a mesh: mesh (N+1,) s, states (N, K+1, nx) at interval starts and points, inputs (N, K, nu)."""

    mesh: Array
    states: Array
    inputs: Array

    def node_times(self, method: Method) -> Array:
        """Return the times (N, K+1) of `states`."""
        return self.mesh[:-1, None] + np.diff(self.mesh)[:, None] * method.support


@dataclass(frozen=True)
class Solved:
    """What the solver left: a trajectory, its constraint violation (scaled), and how it ended."""

    trajectory: Trajectory
    violation: float
    cost: float
    iterations: int
    seconds: float
    succeeded: bool
    outcome: str


def first_trajectory(problem: ReferenceProblem, method: Method, mesh: Array) -> Trajectory:
    """Return the guess on the mesh, with the cart at rest in the middle and no input."""
    shape = (len(mesh) - 1, len(method.support))
    times = mesh[:-1, None] + np.diff(mesh)[:, None] * method.support
    states = np.zeros((*shape, problem.equations.dimension))
    states[..., : problem.pendulum_dimension] = problem.guess_at(times.ravel()).reshape(*shape, -1)
    return Trajectory(mesh, states, np.zeros((shape[0], len(method.points), 1)))


def _interval(problem: ReferenceProblem, method: Method, settings: ReferenceSettings) -> ca.Function:
    """Return (start, points, inputs, length, guess) -> (defects, end, cost) of one interval, states scaled."""
    e = problem.equations
    count, nx, nz = len(method.points), e.dimension, problem.pendulum_dimension
    scale = ca.DM(state_scale(nx, problem.limits))
    start, points = ca.SX.sym("start", nx), ca.SX.sym("points", nx, count)
    inputs, length = ca.SX.sym("inputs", 1, count), ca.SX.sym("length")
    guess = ca.SX.sym("guess", nz, count)
    rate = e.function()
    values = ca.horzcat(start, points)
    derivative = ca.mtimes(values, ca.DM(method.differentiation).T)
    pendulum_scale = ca.DM([ANGLE_SCALE] * (nz // 2) + [RATE_SCALE] * (nz // 2))
    defects, cost = [], ca.SX(0)
    for k in range(count):
        x = scale * points[:, k]
        defects.append(derivative[:, k] - length * rate(x, inputs[:, k], ca.DM(problem.parameters)) / scale)
        away = (x[:nz] - guess[:, k]) / pendulum_scale
        running = inputs[0, k] ** 2 + settings.pendulum_weight * ca.sumsqr(away) + settings.cart_weight * x[nz] ** 2
        cost += length * float(method.weights[k]) * running
    end = ca.mtimes(values, ca.DM(method.end))
    return ca.Function(
        "interval", [start, points, inputs, length, guess], [ca.vertcat(*defects), end, cost], {"cse": True}
    )


def _options(settings: ReferenceSettings) -> dict[str, Any]:
    return {
        "print_time": False,
        "error_on_fail": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": settings.iterations,
        "ipopt.tol": 1e-8,
        "ipopt.constr_viol_tol": 1e-10,
        # IPOPT would otherwise widen every bound by 1e-8 before it starts.
        "ipopt.bound_relax_factor": 0.0,
    }


def solve(
    problem: ReferenceProblem,
    method: Method,
    *,
    settings: ReferenceSettings,
    first: Trajectory,
    limits: Limits,
) -> Solved:
    """Solve the program on the mesh of `first`, starting from it, with `limits` at all nodes."""
    began = time.perf_counter()
    mesh = first.mesh
    count, intervals = len(method.points), len(mesh) - 1
    nx, nz = problem.equations.dimension, problem.pendulum_dimension
    scale = state_scale(nx, problem.limits)
    free = count - 1 if method.closes else count
    starts = ca.MX.sym("starts", nx, intervals + 1)
    inner = ca.MX.sym("inner", nx * free, intervals)
    inputs = ca.MX.sym("inputs", count, intervals)
    points = ca.vertcat(inner, starts[:, 1:]) if method.closes else inner
    times = first.node_times(method)[:, 1:]
    guess = problem.guess_at(times.ravel()).reshape(intervals, count * nz)
    # casadi keeps a matrix (nz, K) of each interval side by side, which is numpy's order of (N, K, nz).
    wide = guess.reshape(intervals * count, nz).T
    defects, ends, costs = _interval(problem, method, settings).map(intervals)(
        starts[:, :-1],
        ca.reshape(points, nx, count * intervals),
        ca.reshape(inputs, 1, count * intervals),
        ca.DM(np.diff(mesh)).T,
        ca.DM(wide),
    )
    constraints = [ca.vec(defects)]
    if not method.closes:
        constraints.append(ca.vec(ends - starts[:, 1:]))
    program = {
        "x": ca.veccat(starts, inner, inputs),
        "f": ca.sum2(costs),
        "g": ca.vertcat(*constraints),
    }
    solver = ca.nlpsol("reference", "ipopt", program, _options(settings))

    box = np.full(nx, np.inf)
    box[nz:] = np.array([limits.position, limits.velocity]) / scale[nz:]
    high_starts = np.tile(box, (intervals + 1, 1))
    low_starts = -high_starts
    ends_at = problem.guess_at(np.array([mesh[0], mesh[-1]])) / scale[:nz]
    low_starts[0], high_starts[0] = (np.concatenate([ends_at[0], [0.0, 0.0]]),) * 2
    low_starts[-1], high_starts[-1] = (np.concatenate([ends_at[1], [0.0, 0.0]]),) * 2
    low_starts[-1, :nz] -= settings.end_tolerance
    high_starts[-1, :nz] += settings.end_tolerance
    high = np.concatenate(
        [high_starts.ravel(), np.tile(box, intervals * free), np.full(count * intervals, limits.acceleration)]
    )
    low = np.concatenate([low_starts.ravel(), -high[high_starts.size :]])
    scaled = first.states / scale
    last = scaled[-1] if method.closes else np.vstack([scaled[-1], method.end @ scaled[-1]])
    guess_starts = np.vstack([scaled[:, 0], last[-1:]])
    x0 = np.concatenate([guess_starts.ravel(), scaled[:, 1 : 1 + free].ravel(), first.inputs.ravel()])
    out = solver(x0=np.clip(x0, low, high), lbx=low, ubx=high, lbg=0.0, ubg=0.0)

    w = np.array(out["x"]).ravel()
    split = nx * (intervals + 1)
    found_starts = w[:split].reshape(intervals + 1, nx)
    found_inner = w[split : split + nx * free * intervals].reshape(intervals, free, nx)
    states = [found_starts[:-1, None], found_inner]
    if method.closes:
        states.append(found_starts[1:, None])
    trajectory = Trajectory(
        mesh,
        np.concatenate(states, 1) * scale,
        w[split + nx * free * intervals :].reshape(intervals, count, 1),
    )
    stats = solver.stats()
    finite = bool(np.isfinite(w).all())
    violation = float(np.abs(np.array(out["g"])).max())
    return Solved(
        trajectory=trajectory,
        violation=violation if np.isfinite(violation) else float("inf"),
        cost=float(out["f"]),
        iterations=int(stats["iter_count"]),
        seconds=time.perf_counter() - began,
        succeeded=bool(stats["success"]) and finite,
        outcome=str(stats["return_status"]).replace("_", " ").lower(),
    )
