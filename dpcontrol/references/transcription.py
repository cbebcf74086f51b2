"""One transcription for every collocation method, from optimal control to a sparse nonlinear program.

    Σ_j D_kj x_j = h f(x_k, u_k)   at the points k of each interval of length h,   x(τ = 1) = next interval's start

The interval is one casadi function, mapped over the mesh. Variables are scaled by `state_scale` and ordered by stage:
an interval's start, its inner values, its inputs. Structure-exploiting solvers need this order, and sparse ones accept
it. For the Jacobian of the whole program, casadi would use colouring, with some forty sweeps over all intervals.
Instead, one interval's small symbolic Jacobian and Hessian are mapped over the mesh and scattered into the program's
sparse matrices. This is several times faster to build and to evaluate.

Sources: Betts, Practical Methods for Optimal Control Using Nonlinear Programming, 3rd ed., ch. 4. Wächter & Biegler,
Mathematical Programming 106 (2006), for IPOPT. Vanroye, Sathya, De Schutter & Decré, FATROP: a fast constrained optimal
control problem solver (2023).
"""

import time
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.interrupts import catching_interrupts
from dpcontrol.references.method import Method, differentiation_matrix, interpolation_matrix
from dpcontrol.references.problem import (
    ANGLE_SCALE,
    RATE_SCALE,
    Limits,
    ReferenceProblem,
    ReferenceSettings,
    state_scale,
)
from dpcontrol.references.trajectory import Solved, Trajectory

Indices = NDArray[np.intp]


def interval_derivatives(interval: ca.Function, *, columns: Indices, size: int) -> dict[str, Any]:
    """Return the nonlinear program of a mesh and its derivatives for `casadi.nlpsol`, from those of one interval.

    The program has the variables x (size,), the cost f, the constraints g, ordered by interval, and the parameters p:
    the lengths of the N intervals, s, then their guesses, interval by interval. Its derivatives are the options grad_f
    (of the cost), jac_g (of the constraints) and hess_lag (second derivatives of the cost times sigma plus the
    constraints times lam, the upper triangle).

    Args:
        interval: (v, length, guess) -> (constraints, cost) of one interval, SX. Its variables v (nv,) are scaled, and
            its length is in s.
        columns: indices (nv, N) of each interval's v among the variables. Neighbours can share the last block of v.
        size: number of variables.

    Returns:
        "program" and "options", as `casadi.nlpsol` takes them.
    """
    nv, intervals = columns.shape
    v, length = ca.SX.sym("v", nv), ca.SX.sym("length")
    guess = ca.SX.sym("aim", interval.size1_in(2))
    constraints, cost = interval(v, length, guess)
    rows = constraints.shape[0]
    weight, multipliers = ca.SX.sym("weight"), ca.SX.sym("multipliers", rows)
    jacobian = ca.jacobian(constraints, v)
    hessian = ca.triu(ca.hessian(weight * cost + ca.dot(multipliers, constraints), v)[0])
    inputs = [v, length, guess]
    one_jacobian = ca.Function("j", inputs, [constraints, jacobian.nz[:]], {"cse": True})
    one_gradient = ca.Function("d", inputs, [cost, ca.densify(ca.gradient(cost, v))], {"cse": True})
    one_hessian = ca.Function("h", [*inputs, weight, multipliers], [hessian.nz[:]], {"cse": True})

    x, p = ca.MX.sym("x", size), ca.MX.sym("p", intervals * (1 + guess.shape[0]))
    interval_variables = ca.reshape(x[columns.T.ravel().tolist()], nv, intervals)
    arguments_of_intervals = [interval_variables, p[:intervals].T, ca.reshape(p[intervals:], guess.shape[0], intervals)]
    g, entries = one_jacobian.map(intervals)(*arguments_of_intervals)
    f, slopes = one_gradient.map(intervals)(*arguments_of_intervals)
    # Triplets of all intervals, interval by interval, in the order of the entries.
    local_row, local_col = (np.array(part) for part in jacobian.sparsity().get_triplet())
    stage = np.arange(intervals)
    jacobian_rows = (local_row[:, None] + rows * stage).T.ravel()
    jacobian_columns = columns[local_col].T.ravel()
    full_jacobian = _scattered(ca.vec(entries), jacobian_rows, jacobian_columns, (rows * intervals, size))
    gradient = _scattered(ca.vec(slopes), columns.T.ravel(), np.zeros(nv * intervals, dtype=np.intp), (size, 1))

    sigma, lam = ca.MX.sym("sigma"), ca.MX.sym("lam", rows * intervals)
    weights = ca.repmat(sigma, 1, intervals)
    curvatures = one_hessian.map(intervals)(*arguments_of_intervals, weights, ca.reshape(lam, rows, intervals))
    local_row, local_col = (np.array(part) for part in hessian.sparsity().get_triplet())
    row, column = columns[local_row].T.ravel(), columns[local_col].T.ravel()
    # Columns need not rise within v, but the result must be the upper triangle.
    full_hessian = _scattered(ca.vec(curvatures), np.minimum(row, column), np.maximum(row, column), (size, size))
    total_cost, all_constraints = ca.sum2(f), ca.vec(g)
    return {
        "program": {"x": x, "f": total_cost, "g": all_constraints, "p": p},
        "options": {
            "grad_f": ca.Function(
                "nlp_grad_f", [x, p], [total_cost, ca.densify(gradient)], ["x", "p"], ["f", "grad:f:x"]
            ),
            "jac_g": ca.Function("nlp_jac_g", [x, p], [all_constraints, full_jacobian], ["x", "p"], ["g", "jac:g:x"]),
            "hess_lag": ca.Function(
                "nlp_hess_l", [x, p, sigma, lam], [full_hessian], ["x", "p", "lam:f", "lam:g"], ["triu:hess:gamma:x:x"]
            ),
        },
    }


def _scattered(values: ca.MX, rows: Indices, columns: Indices, shape: tuple[int, int]) -> ca.MX:
    """Return the sparse matrix of this shape with values (K,) at (rows, columns) (K,), of which equal ones are added.

    The matrices of single intervals overlap where neighbours share variables.
    """
    places = columns * shape[0] + rows
    order = np.argsort(places, kind="stable")
    is_first = np.concatenate([[True], np.diff(places[order]) != 0])
    unique_places = places[order][is_first]
    sparsity = ca.Sparsity.triplet(*shape, (unique_places % shape[0]).tolist(), (unique_places // shape[0]).tolist())
    slots = np.cumsum(is_first) - 1
    if is_first.all():
        return ca.MX(sparsity, values[order.tolist()])
    # One column for each value: a product with zeros and ones adds values at equal places.
    gather = ca.Sparsity.triplet(len(unique_places), len(places), slots.tolist(), order.tolist())
    return ca.MX(sparsity, ca.mtimes(ca.DM(gather, 1.0), values))


Search = Literal["fresh", "warm", "far", "rough"]
"""A search that starts from a solution on another mesh, which a large barrier would lose, is warm. From a start that is
far from the solution, IPOPT adapts its barrier at each step. Solutions of rough searches are only compared."""


def solver_options(settings: ReferenceSettings, *, search: Search = "fresh") -> dict[str, Any]:
    """Return casadi's options for IPOPT or fatrop.

    Args:
        settings: solver and iterations.
        search: kind of the search.
    """
    common_options: dict[str, Any] = {"print_time": False, "error_on_fail": False}
    if settings.solver == "fatrop":
        solver_settings = {"print_level": 0, "max_iter": settings.iterations, "tolerance": 1e-8}
    else:
        solver_settings = {
            "print_level": 0,
            "sb": "yes",
            "max_iter": settings.iterations,
            "tol": 1e-4 if search == "rough" else 1e-8,
            "constr_viol_tol": 1e-6 if search == "rough" else 1e-10,
            # IPOPT would otherwise widen every bound by 1e-8 before it starts.
            "bound_relax_factor": 0.0,
            "mu_init": 1e-6 if search == "warm" else 0.1,
            "mu_strategy": "adaptive" if search == "far" else "monotone",
        }
    return common_options | {f"{settings.solver}.{name}": value for name, value in solver_settings.items()}


def interval_function(
    equations: Equations, parameters: Sequence[float], limits: Limits, method: Method, settings: ReferenceSettings
) -> ca.Function:
    """Return the function that gives the constraints and the cost of one interval, in scaled states.

    It maps (start, values, inputs, length, guess) to (defects, end, cost, jerk). In an interval, the state is a
    polynomial through its values at K + 1 places, the support, of which the first is the start and `values` (nx, K) are
    the others. At K collocation points, its derivative must equal the equations' rate; `defects` are the differences in
    scaled states, times the length. `inputs` (1, K) and `guess` (nz, K) are given at the points, `end` (nx,) is the
    state at the interval's end, and `jerk` (K, 1) the derivative of the input.

    Args:
        equations: equations with nx states, nz of them of the pendulum.
        parameters: base parameters (p,).
        limits: limits of the cart, by which its state is scaled.
        method: collocation method with K points.
        settings: weights of the cost.
    """
    count, nx, nz = len(method.points), equations.dimension, equations.dimension - 2
    scale = ca.DM(state_scale(nx, limits))
    start, values = ca.SX.sym("start", nx), ca.SX.sym("values", nx, count)
    inputs, length = ca.SX.sym("inputs", 1, count), ca.SX.sym("length")
    guess = ca.SX.sym("guess", nz, count)
    rate, parameter_values = equations.function(), ca.DM(parameters)
    support_states = ca.horzcat(start, values)
    derivative = ca.mtimes(support_states, ca.DM(method.differentiation).T)
    pendulum_scale = ca.DM([ANGLE_SCALE] * (nz // 2) + [RATE_SCALE] * (nz // 2))
    defects, cost = [], ca.SX(0)
    for k, place in enumerate(method.places):
        x = scale * support_states[:, int(place)]
        defects.append(derivative[:, k] - length * rate(x, inputs[:, k], parameter_values) / scale)
        distance = (x[:nz] - guess[:, k]) / pendulum_scale
        running_cost = (
            inputs[0, k] ** 2 + settings.pendulum_weight * ca.sumsqr(distance) + settings.cart_weight * x[nz] ** 2
        )
        cost += length * float(method.weights[k]) * running_cost
    end = ca.mtimes(support_states, ca.DM(method.end))
    slopes = differentiation_matrix(method.points) if count > 1 else np.zeros((1, 1))
    jerk = ca.mtimes(inputs, ca.DM(slopes).T) / length
    outputs = [ca.vertcat(*defects), end, cost, jerk.T]
    return ca.Function("interval", [start, values, inputs, length, guess], outputs, {"cse": True})


@lru_cache(maxsize=8)
def _by_interval(
    equations: Equations,
    parameters: tuple[float, ...],
    limits: Limits,
    method: Method,
    settings: ReferenceSettings,
    intervals: int,
) -> dict[str, Any]:
    """Return the program of a mesh whose constraints couple neighbouring intervals only; see `interval_derivatives`.

    Meshes with equal numbers of intervals have the same program, so that repeated transfers share one. The variables v
    of an interval are its start, its inner values and its inputs, followed by the start of the next interval. If the
    method's last value is at the interval's end (`closes`), it is this next start.

    Args:
        equations: equations with a cart.
        parameters: base parameters (p,).
        limits: limits of the cart, by which its state is scaled.
        method: collocation method.
        settings: weights of the cost.
        intervals: number of intervals.
    """
    nx, count, shares_ends = equations.dimension, len(method.points), method.closes
    nz, free_values = nx - 2, count - method.closes
    stage_width = nx * (1 + free_values) + count
    v, length, guess = ca.SX.sym("v", stage_width + nx), ca.SX.sym("length"), ca.SX.sym("aim", nz * count)
    inner_values, next_start = v[nx : nx * (1 + free_values)], v[stage_width:]
    values = ca.vertcat(inner_values, next_start) if shares_ends else inner_values
    defects, end, cost, _ = interval_function(equations, parameters, limits, method, settings)(
        v[:nx],
        ca.reshape(values, nx, count),
        v[nx * (1 + free_values) : stage_width].T,
        length,
        ca.reshape(guess, nz, count),
    )
    constraints = defects if shares_ends else ca.vertcat(next_start - end, defects)
    return interval_derivatives(
        ca.Function("interval", [v, length, guess], [constraints, cost]),
        columns=(np.arange(stage_width + nx)[:, None] + stage_width * np.arange(intervals)).astype(np.intp),
        size=stage_width * intervals + nx,
    )


class _Program:
    """The nonlinear program of one mesh: its expressions, bounds and the indices of its variables.

    Variables, by column: an interval's start, its support values and its inputs. A support value that is the next
    interval's start is left out, unless the solver requires separate stages. Then follow the last state and, if it is
    free, the factor of the duration.

    `nx` and `nz` are the lengths of a state and of its pendulum part, `count` the number K of points, and `intervals`
    that of intervals. `program` is casadi's program; `values` are its parameters p, empty if it has none. `low_g` and
    `high_g` are parts of the bounds of its constraints, in order, and `options` those of the solver that depend on it.
    `fixed_counts`, for separate stages only, are the numbers of fixed entries of the first and the last state.
    """

    def __init__(
        self, problem: ReferenceProblem, settings: ReferenceSettings, first: Trajectory, limits: Limits
    ) -> None:
        """Build the program of the mesh of `first`, the trajectory from which the solver starts.

        `limits` bound the cart at the nodes; they may be tighter than those of the problem.

        Raises:
            InputError: a formulation that the solver does not support.
        """
        self.problem, self.settings, self.limits, self.first = problem, settings, limits, first
        self.method, self.mesh = first.method, first.mesh
        self.nx, self.nz = problem.equations.dimension, problem.pendulum_dimension
        self.count, self.intervals = len(self.method.points), len(self.mesh) - 1
        self.scale = state_scale(self.nx, problem.limits)
        # Fatrop needs separate stages. In others, an interval's last support value can be shared with the next one, so
        # that `free` values remain for each interval.
        self.staged = settings.solver == "fatrop"
        self.shared = self.method.closes and not self.staged
        self.free = self.count - 1 if self.shared else self.count
        self.stretches = problem.ends.stretch > 0
        # The input is continuous if intervals share their points or the jerk is limited.
        self.coupled = self.method.shares_inputs or limits.jerk > 0
        has_couplings = self.stretches or self.coupled or problem.ends.closing is not None
        if self.staged and has_couplings:
            raise InputError(
                'solver = "fatrop" supports only fixed times, open ends and inputs that jump; use "ipopt" for a free '
                "duration, a periodic orbit, a jerk limit, lobatto or hermite-simpson"
            )
        self.options: dict[str, Any] = {}
        self.values = np.zeros(0)
        # Couplings of more than neighbouring intervals use casadi's derivatives.
        if self.staged or has_couplings or problem.ends.energy is not None:
            self._assemble()
        else:
            self._assemble_by_interval()

    def _assemble_by_interval(self) -> None:
        """Build the program and its derivatives from those of one interval, faster than by casadi's own derivatives."""
        equations, limits, n = self.problem.equations, self.problem.limits, self.intervals
        interval_program = _by_interval(
            equations, tuple(self.problem.parameters.tolist()), limits, self.method, self.settings, n
        )
        self.program, self.options = interval_program["program"], interval_program["options"]
        self.values = np.concatenate([np.diff(self.mesh), self._aims().ravel()])
        zeros = np.zeros(self.program["g"].shape[0])
        self.low_g, self.high_g = [zeros], [zeros]

    def _aims(self) -> Array:
        """Return the guess at all collocation points (N * K, nz), the distance from which is part of the cost."""
        return self.problem.guess_at(self.first.input_times.ravel())

    def _assemble(self) -> None:
        """Build the program with casadi's own derivatives, for couplings of more than neighbouring intervals.

        Such couplings are a closed motion, a free duration, a given energy, continuous inputs, or a solver that needs
        separate stages. A stage holds the scaled variables of one interval, `last` the state at the end, and `factor`
        is that of the duration.
        """
        nx, count, n, free = self.nx, self.count, self.intervals, self.free
        stages = ca.MX.sym("stages", nx * (1 + free) + count, n)
        last = ca.MX.sym("last", nx)
        factor = ca.MX.sym("factor") if self.stretches else ca.MX(1)
        starts, inner = stages[:nx, :], stages[nx : nx * (1 + free), :]
        inputs = stages[nx * (1 + free) :, :]
        next_starts = ca.horzcat(starts[:, 1:], last)
        values = ca.vertcat(inner, next_starts) if self.shared else inner
        problem = self.problem
        interval = interval_function(
            problem.equations, problem.parameters.tolist(), problem.limits, self.method, self.settings
        )
        defects, ends, costs, jerks = interval.map(n)(
            starts,
            ca.reshape(values, nx, count * n),
            ca.reshape(inputs, 1, count * n),
            ca.DM(np.diff(self.mesh)).T * factor,
            ca.DM(self._aims().T),
        )
        blocks = [defects] if self.shared else [next_starts - ends, defects]
        lower = [np.zeros((nx * count + (0 if self.shared else nx), n))]
        upper = [lower[0]]
        if self.limits.jerk > 0:
            blocks.append(jerks)
            lower.append(np.full((count, n), -self.limits.jerk))
            upper.append(-lower[-1])
        matrix = ca.vertcat(*blocks)
        constraints, self.low_g, self.high_g = (
            [ca.vec(matrix)],
            [np.vstack(lower).T.ravel()],
            [np.vstack(upper).T.ravel()],
        )
        self._join_ends(constraints, starts[:, 0], last, matrix)
        if self.coupled and n > 1:
            end_row, start_row = (interpolation_matrix(self.method.points, [tau])[0] for tau in (1.0, 0.0))
            jumps = ca.mtimes(ca.DM(end_row).T, inputs[:, :-1]) - ca.mtimes(ca.DM(start_row).T, inputs[:, 1:])
            self._equal(constraints, ca.vec(jumps), np.zeros(n - 1))
        variables = [ca.vec(stages), last]
        if self.stretches:
            variables.append(factor)
        self.program = {"x": ca.vertcat(*variables), "f": ca.sum2(costs), "g": ca.vertcat(*constraints)}
        if self.staged:
            self._name_stages(matrix.shape[0] - nx)

    def _equal(self, rows: list[ca.MX], expression: ca.MX, values: Array) -> None:
        """Add the constraints that an expression equals `values` to those so far, `rows`, and to the bounds."""
        rows.append(expression)
        self.low_g.append(values)
        self.high_g.append(values)

    def _join_ends(self, rows: list[ca.MX], first: ca.MX, last: ca.MX, matrix: ca.MX) -> None:
        """Add the conditions at the ends that are not bounds of variables: closed motions and given energies.

        A program of separate stages, for fatrop, has no bounds of variables. Its rows become those of the first stage,
        the start, the later stages and the end, in this order.

        Args:
            rows: constraints so far, which are extended, or replaced for separate stages.
            first: scaled state at the start.
            last: scaled state at the end.
            matrix: constraints of the intervals, one column each.
        """
        ends, equations = self.problem.ends, self.problem.equations
        if ends.closing is not None:
            self._equal(rows, last - first, np.asarray(ends.closing) / self.scale)
        if ends.energy is not None:
            energy = ca.Function("energy", [equations.state, equations.parameters], [equations.hamiltonian])
            value = energy(ca.DM(self.scale) * first, ca.DM(self.problem.parameters))
            self._equal(rows, value, np.array([ends.energy]))
        if self.staged:
            start, end = (x / self.scale for x in self.problem.end_states())
            later_stages = ca.vec(matrix[:, 1:])
            fixed_start, fixed_end = np.flatnonzero(np.isfinite(start)), np.flatnonzero(np.isfinite(end))
            stage_rows = matrix.shape[0]
            rows[:] = [matrix[:, 0], first[fixed_start.tolist()], later_stages, last[fixed_end.tolist()]]
            lower, upper = self.low_g[0], self.high_g[0]
            slack = np.where(fixed_end < self.nz, self.settings.end_tolerance, 0.0)
            self.low_g[:] = [lower[:stage_rows], start[fixed_start], lower[stage_rows:], end[fixed_end] - slack]
            self.high_g[:] = [upper[:stage_rows], start[fixed_start], upper[stage_rows:], end[fixed_end] + slack]
            self.fixed_counts = (len(fixed_start), len(fixed_end))

    def _name_stages(self, gaps: int) -> None:
        """Set the options by which fatrop knows the program's stages.

        They are the stages' numbers of states, inputs and constraints (`gaps` of them in each interval), and the
        equalities.
        """
        n, stage_width = self.intervals, self.nx * self.free + self.count
        is_equality = np.concatenate(self.low_g) == np.concatenate(self.high_g)
        self.options = {
            "structure_detection": "manual",
            "N": n,
            "nx": [self.nx] * (n + 1),
            "nu": [stage_width] * n + [0],
            "ng": [gaps + self.fixed_counts[0], *([gaps] * (n - 1)), self.fixed_counts[1]],
            "equality": is_equality.tolist(),
        }

    def bounds(self) -> tuple[Array, Array]:
        """Return the lower and upper bounds (V,) of the scaled variables."""
        state_bounds = np.full(self.nx, np.inf)
        state_bounds[self.nz :] = np.array([self.limits.position, self.limits.velocity]) / self.scale[self.nz :]
        stage_bounds = np.concatenate(
            [np.tile(state_bounds, 1 + self.free), np.full(self.count, self.limits.acceleration)]
        )
        high = np.concatenate([np.tile(stage_bounds, self.intervals), state_bounds])
        low = -high
        if self.staged:
            # These are constraints, because equal bounds would not be strictly feasible.
            high[: self.nx], low[: self.nx] = np.inf, -np.inf
            high[-self.nx :], low[-self.nx :] = np.inf, -np.inf
        else:
            start, end = (x / self.scale for x in self.problem.end_states())
            slack = np.where(np.arange(self.nx) < self.nz, self.settings.end_tolerance, 0.0)
            fixed_start, fixed_end = np.isfinite(start), np.isfinite(end)
            low[: self.nx][fixed_start] = high[: self.nx][fixed_start] = start[fixed_start]
            low[-self.nx :][fixed_end], high[-self.nx :][fixed_end] = (end - slack)[fixed_end], (end + slack)[fixed_end]
        if self.stretches:
            stretch = self.problem.ends.stretch
            low, high = np.append(low, 1 - stretch), np.append(high, 1 + stretch)
        return low, high

    def start(self) -> Array:
        """Return the scaled variables (V,) of the first trajectory, from which the solver starts."""
        scaled_states = self.first.states / self.scale
        stage_blocks = (
            scaled_states[:, : 1 + self.free].reshape(self.intervals, -1),
            self.first.inputs.reshape(self.intervals, -1),
        )
        stages = np.hstack(stage_blocks)
        variables = np.concatenate([stages.ravel(), self.method.end @ scaled_states[-1]])
        return np.append(variables, 1.0) if self.stretches else variables

    def unpacked(self, values: Array) -> Trajectory:
        """Return the trajectory, in SI units, of the scaled variables (V,)."""
        factor = float(values[-1]) if self.stretches else 1.0
        stage_values = values[:-1] if self.stretches else values
        last = stage_values[-self.nx :]
        stages = stage_values[: -self.nx].reshape(self.intervals, -1)
        state_count = self.nx * (1 + self.free)
        states = stages[:, :state_count].reshape(self.intervals, 1 + self.free, self.nx)
        if self.shared:
            next_starts = np.vstack([states[1:, 0], last[None]])
            states = np.concatenate([states, next_starts[:, None]], axis=1)
        inputs = stages[:, state_count:].reshape(self.intervals, self.count, 1)
        mesh = self.mesh[0] + (self.mesh - self.mesh[0]) * factor
        return Trajectory(self.method, mesh, states * self.scale, inputs.copy())


def solve(
    problem: ReferenceProblem,
    first: Trajectory,
    *,
    settings: ReferenceSettings,
    limits: Limits,
    search: Search = "fresh",
) -> Solved:
    """Solve the program on the mesh of a trajectory.

    Args:
        problem: equations, guess and ends.
        first: trajectory to start from.
        settings: solver and weights.
        limits: limits of the cart at all nodes.
        search: "fresh", "warm" if `first` is a solution on another mesh, "far" if it is far from the solution, or
            "rough" for a solution that is only compared with others.

    Returns:
        The solution, or the solver's last iterate with the reason for its end.

    Raises:
        InputError: a formulation that the solver does not support.
    """
    begin = time.perf_counter()
    program = _Program(problem, settings, first, limits)
    options = solver_options(settings, search=search) | program.options
    solver = ca.nlpsol("reference", settings.solver, program.program, options)
    low, high = program.bounds()
    x0 = np.clip(program.start(), low, high)
    low_g, high_g = np.concatenate(program.low_g), np.concatenate(program.high_g)
    with catching_interrupts():
        solution = solver(x0=x0, p=program.values, lbx=low, ubx=high, lbg=low_g, ubg=high_g)
    values = np.array(solution["x"]).ravel()
    residuals = np.array(solution["g"]).ravel()
    stats = solver.stats()
    finite = bool(np.isfinite(values).all())
    violation = float(np.maximum(np.maximum(residuals - high_g, low_g - residuals), 0.0).max())
    return Solved(
        trajectory=program.unpacked(values),
        violation=violation if np.isfinite(violation) else float("inf"),
        cost=float(solution["f"]),
        iterations=int(stats["iter_count"]),
        seconds=time.perf_counter() - begin,
        succeeded=bool(stats["success"]) and finite,
        outcome=str(stats.get("return_status") or stats.get("unified_return_status")).replace("_", " ").lower(),
    )
