"""References: work against precision by method, interval and solver, cost by length, and two hundred random ones.

Times are processor time of this process; only ratios and shares are asserted.
"""

import resource
import sys
import time
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / "references"))
from walk_references import complaints, problem_of, random_references

from dpcontrol.plans.model import load_model
from dpcontrol.references.find import find_reference
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import ReferenceSettings
from dpcontrol.references.trajectory import error_between_nodes, first_trajectory
from dpcontrol.references.transcription import solve
from dpcontrol.walks.edges import find_edges
from dpcontrol.walks.shadowing import WalkSolver
from dpcontrol.walks.walks import random_walk

pytestmark = pytest.mark.benchmark

CHOSEN = ReferenceSettings(method="radau-7", interval=0.05)
METHODS = [
    ("hermite-simpson", 0.005), ("radau-3", 0.01), ("radau-4", 0.015), ("radau-5", 0.02), ("radau-5", 0.03),
    ("gauss-5", 0.02), ("lobatto-5", 0.02), ("radau-6", 0.03), ("radau-7", 0.03), ("radau-7", 0.05), ("gauss-7", 0.05),
    ("lobatto-7", 0.05), ("radau-8", 0.07), ("radau-9", 0.05), ("radau-9", 0.09), ("radau-10", 0.12),
]  # fmt: skip
LENGTHS = (8, 16, 32, 64)
TIGHT = 1e-9
"""Tolerance of another reference of the shortest length."""
ITINERARIES, LONGEST = 200, 8
PER_DOUBLING = 2.3
SECONDS_PER_SECOND = 0.15
GIGABYTES = 4.0


@pytest.fixture(scope="module")
def model():
    return load_model("lab")


@pytest.fixture(scope="module")
def edges(model):
    return find_edges(model.system, 0.2)


def orbit_of(edges, length, seed=12):
    chain = random_walk(edges, length, np.random.default_rng(seed))
    solver = WalkSolver(edges.connections)
    orbit = solver.solve(chain, [n + 1 for n in solver.least(chain)])
    assert orbit.converged, orbit.status
    return orbit


@pytest.mark.parametrize("symbols", [1, 12])
def test_work_and_precision_of_methods_intervals_and_solvers(model, edges, symbols, one_core):
    crossing = WalkSolver(edges.connections).solve(edges.between("down-up", "up-down")[:1], [])
    problem = problem_of(model, crossing if symbols == 1 else orbit_of(edges, symbols))
    sys.stdout.write(f"\n{symbols} symbols, {problem.duration:.1f} s\n")
    sys.stdout.write("method           interval  solver  error    CPU s/s  iterations  cost\n")
    costs = []
    for name, interval in METHODS:
        method = method_named(name)
        for solver in ("ipopt",) if method.shares_inputs else ("ipopt", "fatrop"):
            mesh = np.linspace(0.0, problem.duration, int(np.ceil(problem.duration / interval)) + 1)
            began = time.process_time()
            first = first_trajectory(problem, method, mesh)
            settings = ReferenceSettings(solver=solver)
            solved = solve(problem, first, settings=settings, limits=problem.limits)
            spent = (time.process_time() - began) / problem.duration
            error = error_between_nodes(problem, solved.trajectory).max()
            sys.stdout.write(
                f"{name:16s} {interval:8.3f}  {solver:6s}  {error:.1e}  {spent:7.3f}  {solved.iterations:10d}  "
                f"{solved.cost:.6f}{'' if solved.succeeded else '  ' + solved.outcome}\n"
            )
            if solved.succeeded and error < 1e-4:
                costs.append(solved.cost)
    assert max(costs) / min(costs) < 1.001


def test_cost_grows_with_length_and_no_faster(model, edges, one_core):
    sys.stdout.write("\nsymbols  s       tolerance  error    CPU s/s  CPU s   GB\n")
    spent = {}
    for symbols in LENGTHS:
        problem = problem_of(model, orbit_of(edges, symbols))
        for tolerance in (1e-6, TIGHT) if symbols == LENGTHS[0] else (1e-6,):
            settings = ReferenceSettings(method=CHOSEN.method, interval=CHOSEN.interval, tolerance=tolerance)
            began = time.process_time()
            found = find_reference(problem, settings)
            seconds = time.process_time() - began
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
            sys.stdout.write(
                f"{symbols:7d}  {problem.duration:6.1f}  {tolerance:.0e}      {found.max_error_between_nodes:.1e}  "
                f"{seconds / problem.duration:7.3f}  {seconds:6.1f}  {memory:.2f}\n"
            )
            assert found.converged, found.status
            assert found.max_error_between_nodes <= tolerance
            assert memory < GIGABYTES
            if tolerance == 1e-6:
                spent[symbols] = (seconds, seconds / problem.duration)
    assert max(rate for symbols, (_, rate) in spent.items() if symbols < LENGTHS[-1]) <= SECONDS_PER_SECOND
    assert spent[LENGTHS[-1]][0] / spent[LENGTHS[-2]][0] <= PER_DOUBLING


def test_two_hundred_random_itineraries_all_converge(model, edges):
    failed, iterations, error = [], [], 0.0
    for followed in random_references(model, edges, ITINERARIES, seed=5, lengths=(1, LONGEST), settings=CHOSEN):
        failed += complaints(model, followed)
        iterations.append(followed.reference.iterations)
        error = max(error, followed.reference.max_error_between_nodes)
    sys.stdout.write(
        f"\n{len(iterations)} itineraries: {len(failed)} complaints, iterations {np.median(iterations):.0f} in the "
        f"median and {max(iterations)} at most, largest error between nodes {error:.1e}\n"
    )
    assert failed == []
