"""Programs with jerk limits, free durations or closed orbits; transcriptions and solvers have the same optimum."""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from shadowing_stand_in import DOWN_UP_LOW, LAB, orbit_stretch

from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.dynamics.equations import NumericEquations
from dpcontrol.foundation.errors import InputError
from dpcontrol.references.find import find_reference
from dpcontrol.references.method import Method, interpolation_matrix, method_named
from dpcontrol.references.problem import (
    ANGLE_SCALE,
    RATE_SCALE,
    EndConditions,
    Limits,
    ReferenceProblem,
    ReferenceSettings,
    state_scale,
)
from dpcontrol.references.reference import Reference
from dpcontrol.references.trajectory import Solved, first_trajectory, interval_propagator, power_coefficients
from dpcontrol.references.transcription import solve, solver_options

Array = NDArray[np.float64]

LIMIT = 1e-9  # Allowed relative violation of a limit.
EXACT = 1e-9  # Residual of the solver's equations, in units of the state.
SECONDS = 0.5
QUICK = ReferenceSettings(method="radau-7", interval=0.05)


def swing(limits: Limits | None = None, seconds: float = SECONDS, **ends: Any) -> ReferenceProblem:
    equations, guess = arm_chain_equations(2, Level.CART), orbit_stretch(seconds).guess
    return ReferenceProblem(equations, LAB.base(), guess, seconds, limits or Limits(), EndConditions(**ends))


def slopes_of(reference: Reference, times: Array) -> Array:
    return np.abs(np.diff(reference.input(times)[:, 0]) / np.diff(times))


def effort(reference: Reference) -> float:
    return reference.rms_cart_acceleration**2 * reference.duration


def test_a_jerk_limit_holds_between_the_nodes_and_makes_the_input_continuous() -> None:
    free = find_reference(swing(Limits(jerk=1e5)), QUICK)
    times = np.linspace(0.0, SECONDS, 200_001)
    bound = 0.8 * slopes_of(free, times).max()
    held = find_reference(swing(Limits(jerk=float(bound))), QUICK)
    assert held.converged, held.status
    # A jump between intervals would appear as a slope far above the bound.
    slopes = slopes_of(held, times)
    assert slopes.max() <= bound * (1 + 1e-6)
    assert slopes.max() > 0.9 * bound
    assert effort(held) >= effort(free) * (1 - 1e-6)


def test_a_free_duration_saves_effort_within_its_limit() -> None:
    fixed = find_reference(swing(), QUICK)
    freed = find_reference(swing(stretch=0.2), QUICK)
    assert freed.converged, freed.status
    assert abs(freed.duration / SECONDS - 1) <= 0.2 + LIMIT
    assert freed.duration != pytest.approx(SECONDS, rel=1e-4)
    assert effort(freed) < effort(fixed)
    given = orbit_stretch(SECONDS).guess(np.array([0.0, SECONDS]))
    assert freed.state(freed.duration)[:4] == pytest.approx(given[1], abs=EXACT)
    # A fixed duration of the same value gives the same optimum.
    again = replace(
        swing(start=np.array([*given[0], 0, 0]), end=np.array([*given[1], 0, 0])),
        duration=freed.duration,
        guess=lambda t: orbit_stretch(SECONDS).guess(np.asarray(t) * SECONDS / freed.duration),
    )
    assert effort(find_reference(again, QUICK)) == pytest.approx(effort(freed), rel=1e-3)


def test_a_closed_orbit_has_the_requested_energy() -> None:
    problem = swing(seconds=DOWN_UP_LOW.period, closing=np.zeros(6), energy=-0.07, stretch=0.1)
    found = find_reference(problem, replace(QUICK, pendulum_weight=0.01))
    assert found.converged, found.status
    first, last = found.state(0.0), found.state(found.duration)
    assert last == pytest.approx(first, abs=EXACT)
    energy = NumericEquations(arm_chain_equations(2, Level.CONSERVATIVE), LAB.base()).hamiltonian(first[:4])
    assert float(energy) == pytest.approx(-0.07, abs=EXACT)
    # On a closed orbit, friction dissipates all supplied energy.
    assert found.rms_cart_acceleration > 0.01


@pytest.mark.parametrize(("name", "stretch"), [("radau-5", 0.1), ("lobatto-4", 0.0)])
def test_fatrop_refuses_constraints_that_couple_stages(name: str, stretch: float) -> None:
    with pytest.raises(InputError, match=r'fatrop.*use "ipopt"'):
        find_reference(swing(stretch=stretch), replace(QUICK, method=name, solver="fatrop"))


@pytest.mark.parametrize("name", ["lobatto-4", "lobatto-5", "hermite-simpson"])
def test_neighbouring_lobatto_intervals_share_their_common_input(name: str) -> None:
    problem, method = swing(), method_named(name)
    assert method.shares_inputs
    first = first_trajectory(problem, method, np.linspace(0.0, SECONDS, 26))
    solved = solve(problem, first, settings=ReferenceSettings(), limits=problem.limits)
    inputs = solved.trajectory.inputs[..., 0]
    assert np.abs(inputs).max() > 0.1
    assert inputs[1:, 0] == pytest.approx(inputs[:-1, -1], abs=EXACT)


SAME_COST = 1e-3  # Required relative and scaled differences.
SAME_STATES = 1e-4
TIMES = np.linspace(0.0, SECONDS, 2001)
# Intervals with an error between nodes below 1e-6.
COLLOCATED = [
    ("radau-3", 0.01, "ipopt"),
    ("radau-5", 0.02, "ipopt"),
    ("radau-7", 0.05, "fatrop"),
    ("gauss-4", 0.02, "ipopt"),
    ("gauss-4", 0.02, "fatrop"),
    ("lobatto-5", 0.02, "ipopt"),
    ("hermite-simpson", 0.005, "ipopt"),
]


STEPS = 10
"""Steps of the integrator in an interval; its errors are below 1e-8."""
CLOSES = 1e-10
"""Scaled gap between intervals that the solver may leave."""


def solve_by_shooting(
    problem: ReferenceProblem, method: Method, *, settings: ReferenceSettings, mesh: Array, times: Array
) -> tuple[float, Array]:
    """Return the least cost on `mesh` (N+1,) s by multiple shooting, and the scaled states (M, nx) at `times` (M,) s.

        x_{i+1} = Φ(x_i, u_i; h_i)        Φ: the flow over interval i under the interval's own input polynomial

    Φ and the integral of the cost are casadi's classical Runge-Kutta method in small steps; the method in the settings
    supplies only the points of the input's values. The equations differ from collocation's: agreement is significant.
    Limits apply to the states at the ends of intervals and to the inputs at the method's points.
    Times and end states must be fixed, without a jerk limit.
    Source: Bock & Plitt, A multiple shooting algorithm for direct solution of optimal control problems, IFAC (1984).
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


def mesh_of(interval: float) -> Array:
    return np.linspace(0.0, SECONDS, round(SECONDS / interval) + 1)


def states(solved: Solved, method: Method) -> Array:
    """Return scaled states (2001, 6) at TIMES."""
    mesh = solved.trajectory.mesh
    index = np.clip(np.searchsorted(mesh, TIMES, side="right") - 1, 0, len(mesh) - 2)
    rows = interpolation_matrix(method.support, (TIMES - mesh[index]) / np.diff(mesh)[index])
    return np.einsum("mk,mkn->mn", rows, solved.trajectory.states[index]) / state_scale(6, Limits())


def collocated(problem: ReferenceProblem, name: str, interval: float, solver: str) -> Solved:
    method = method_named(name)
    first = first_trajectory(problem, method, mesh_of(interval))
    return solve(problem, first, settings=ReferenceSettings(solver=solver), limits=problem.limits)


@pytest.fixture(scope="module")
def shot() -> tuple[float, Array]:
    """Cost and states of the optimum by multiple shooting, computed once."""
    method, mesh = method_named("radau-7"), mesh_of(0.05)
    return solve_by_shooting(swing(), method, settings=ReferenceSettings(), mesh=mesh, times=TIMES)


@pytest.mark.parametrize(("name", "interval", "solver"), COLLOCATED)
def test_every_method_and_solver_finds_the_optimum_of_multiple_shooting(
    name: str, interval: float, solver: str, shot: tuple[float, Array]
) -> None:
    solved = collocated(swing(), name, interval, solver)
    assert solved.succeeded, solved.outcome
    assert solved.cost == pytest.approx(shot[0], rel=SAME_COST)
    assert np.abs(states(solved, method_named(name)) - shot[1]).max() < SAME_STATES


def test_shooting_agrees_where_a_limit_binds() -> None:
    free = find_reference(swing(), ReferenceSettings())
    problem = swing(Limits(acceleration=0.85 * free.max_cart_acceleration))
    method = method_named("radau-5")
    # Both apply the limit at the same points, so the programs differ only in the equations of motion.
    settings = ReferenceSettings()
    cost, flown = solve_by_shooting(problem, method, settings=settings, mesh=mesh_of(0.02), times=TIMES)
    held = collocated(problem, "radau-5", 0.02, "ipopt")
    assert held.succeeded
    assert np.abs(held.trajectory.inputs).max() == pytest.approx(problem.limits.acceleration, rel=1e-5)
    assert held.cost == pytest.approx(cost, rel=SAME_COST)
    assert held.cost > (1 + 5 * SAME_COST) * collocated(swing(), "radau-5", 0.02, "ipopt").cost
    assert np.abs(states(held, method) - flown).max() < SAME_STATES
