"""Several transcriptions and two solvers have the same optimum."""

import numpy as np
import pytest
from multiple_shooting import solve_by_shooting
from numpy.typing import NDArray
from shadowing_stand_in import LAB, orbit_stretch

from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.references.find import find_reference
from dpcontrol.references.method import Method, interpolation_matrix, method_named
from dpcontrol.references.problem import Limits, ReferenceProblem, ReferenceSettings, state_scale
from dpcontrol.references.trajectory import Solved, first_trajectory
from dpcontrol.references.transcription import solve

Array = NDArray[np.float64]

SAME_COST = 1e-3  # Required relative and scaled differences.
SAME_STATES = 1e-4
SECONDS = 0.5
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


def swing(limits: Limits | None = None) -> ReferenceProblem:
    orbit = orbit_stretch(SECONDS)
    equations = arm_chain_equations(2, Level.CART)
    return ReferenceProblem(equations, LAB.base(), orbit.guess, SECONDS, limits or Limits())


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
