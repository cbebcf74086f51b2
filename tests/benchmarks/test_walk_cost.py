"""Walks by the hundred, each read by the classifier; and what a walk costs as it grows from 4 to 128 symbols.

Times are processor time of this process; only their ratios are asserted.
"""

import sys
import time

import numpy as np
import pytest
from walk_classifier import WalkClassifier

from dpcontrol.plans.model import load_model
from dpcontrol.walks.edges import find_edges
from dpcontrol.walks.shadowing import WalkSolver
from dpcontrol.walks.walks import drawn_requests, random_walk, solved

pytestmark = pytest.mark.benchmark

LENGTHS = (4, 8, 16, 32, 64, 128)
LONGEST = 128  # of a walk that is solved before times count
WALKS = 5  # of each length; their median counts
PER_DOUBLING = 2.3
RESIDUAL = 1e-11


@pytest.fixture(scope="module")
def edges():
    return find_edges(load_model("lab").system, 0.2)


def test_cost_grows_with_the_number_of_symbols_and_no_faster(edges, one_core):
    solver, generator = WalkSolver(edges.connections), np.random.default_rng(11)
    solver.solve(random_walk(edges, LONGEST, generator), [2] * (LONGEST - 1))
    seconds = []
    for length in LENGTHS:
        taken = []
        for _ in range(WALKS):
            chain = random_walk(edges, length, generator)
            began = time.process_time()
            orbit = solver.solve(chain, generator.integers(0, 5, length - 1).tolist())
            taken.append(time.process_time() - began)
            assert orbit.converged, orbit.status
        seconds.append(float(np.median(taken)))
    ratios = [np.nan, *np.divide(seconds[1:], seconds[:-1])]
    sys.stdout.write("\nsymbols  s        ms/symbol  × per doubling\n")
    for length, spent, ratio in zip(LENGTHS, seconds, ratios, strict=True):
        sys.stdout.write(f"{length:7d}  {spent:7.3f}  {1e3 * spent / length:9.1f}  {ratio:.2f}\n")
    assert max(ratios[1:]) <= PER_DOUBLING


@pytest.mark.parametrize(("count", "lengths", "periodic"), [(200, (1, 16), False), (50, (1, 8), True)])
def test_all_random_walks_become_the_requested_orbits(edges, count, lengths, periodic):
    solver, classifier = WalkSolver(edges.connections), WalkClassifier(edges.system, edges.connections)
    requests = drawn_requests(edges, count, lengths=lengths, extra=(0, 4), seed=7, periodic=periodic)
    failed, residuals, reciprocity = [], [], []
    for answer in solved(requests, solver):
        orbit = answer.orbit
        if orbit is None or not orbit.converged:
            failed.append(answer.status)
            continue
        residuals.append(orbit.residual)
        failed += classifier.complaints(orbit)
        if periodic:
            reciprocity.append(abs(orbit.estimate.multipliers.reciprocity))
    sys.stdout.write(
        f"\n{count} {'closed ' if periodic else ''}walks: {len(failed)} complaints, largest gap {max(residuals):.1e}, "
        f"|λᵤλₛ| - 1 within {max(reciprocity, default=0.0):.1e}\n"
    )
    assert failed == []
    assert max(residuals) < RESIDUAL
