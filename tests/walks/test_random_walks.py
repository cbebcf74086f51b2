"""Random walks on the lab's graph at 0.2 J, each of which gives the requested orbit.

A classifier decodes the orbit from its trajectory and the published connections only. Defects are
checked by DOP853.
"""

import numpy as np
import pytest
from walk_classifier import WalkClassifier

from dpcontrol.plans.model import load_model
from dpcontrol.walks.edges import find_edges
from dpcontrol.walks.shadowing import WalkSolver
from dpcontrol.walks.walks import drawn_requests, random_walk

RESIDUAL = 1e-11
WALKS = 25
SEED = 7


@pytest.fixture(scope="module")
def edges():
    return find_edges(load_model("lab").system, 0.2)


@pytest.fixture(scope="module")
def classifier(edges):
    return WalkClassifier(edges.system, edges.connections)


@pytest.fixture(scope="module")
def solver(edges):
    return WalkSolver(edges.connections)


@pytest.mark.benchmark
def test_random_walks_give_the_requested_orbits(edges, classifier, solver):
    for asked in drawn_requests(edges, WALKS, lengths=(1, 16), extra=(0, 4), seed=SEED, periodic=False):
        least = solver.least(asked.chain)
        wraps = [n + more for n, more in zip(least, asked.extra, strict=True)]
        orbit = solver.solve(asked.chain, wraps)
        assert orbit.converged, orbit.status
        assert orbit.residual < RESIDUAL
        assert classifier.complaints(orbit) == []


@pytest.mark.slow
@pytest.mark.parametrize("leads", [(0, 0), (30, 30)])
def test_leads_of_any_length_are_part_of_the_orbit(edges, classifier, solver, leads):
    chain = random_walk(edges, 3, np.random.default_rng(SEED))
    orbit = solver.solve(chain, [1, 0], lead_in=leads[0], lead_out=leads[1])
    assert classifier.complaints(orbit) == []
    first, last = chain[0], chain[-1]
    spare = leads[0] * first.source.period + leads[1] * last.target.period
    between = orbit.symbol_times[-1] - orbit.symbol_times[0]
    assert orbit.duration == pytest.approx(first.time_out + between + last.time_in + spare, abs=1e-9)


@pytest.mark.slow
def test_forty_wraps_stay_near_the_periodic_orbit(edges, classifier, solver):
    chain = next(
        asked.chain for asked in drawn_requests(edges, 9, lengths=(3, 3), extra=(0, 0), seed=SEED, periodic=False)
    )
    for wraps in ([40, 0], [0, 40]):
        orbit = solver.solve(chain, wraps)
        assert orbit.converged, orbit.status
        assert classifier.complaints(orbit) == []


@pytest.mark.slow
def test_a_walk_of_128_symbols_is_as_accurate_as_a_short_one(edges, classifier, solver):
    orbit = solver.solve(random_walk(edges, 128, np.random.default_rng(SEED)), [1] * 127)
    assert orbit.converged, orbit.status
    assert orbit.residual < RESIDUAL
    assert classifier.complaints(orbit) == []
