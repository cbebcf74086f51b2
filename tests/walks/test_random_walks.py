"""Random walks on the lab's graph at 0.2 J, each of which gives the requested orbit.

A classifier decodes the orbit from its trajectory and the published connections only. Defects are
checked by DOP853.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from walk_classifier import WalkClassifier

from dpcontrol.walks.atlas import connection_graph, walks
from dpcontrol.walks.edges import find_edges
from dpcontrol.walks.shadowing import WalkSolver
from dpcontrol.walks.walks import drawn_requests, random_walk

RESIDUAL = 1e-11
WALKS = 25
SEED = 7


@pytest.fixture(scope="module")
def edges(system):
    return find_edges(system, 0.2)


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


CLOSURE = 1e-11
RECIPROCAL = 1e-8  # λ ≈ 1e3 per symbol: rounding of small parts of the state-transition matrices


def exponents(system, orbit, rounds=3):
    """Return the logarithms of the multipliers' moduli by QR iteration around the orbit."""
    states, durations = orbit.orbit.states, np.diff(orbit.orbit.times)
    scale = system.scale
    stms = [system.propagator.flow_with_stm(x, h)[1] * scale / scale[:, None]
            for x, h in zip(states[:-1], durations, strict=True)]  # fmt: skip
    basis, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(len(scale), len(scale))))
    growth = np.zeros(len(scale))
    for _ in range(rounds):
        growth = np.zeros(len(scale))
        for stm in stms:
            basis, factor = np.linalg.qr(stm @ basis)
            growth += np.log(np.abs(np.diag(factor)))
    return growth


@pytest.mark.slow
def test_random_closed_walks_give_periodic_orbits(edges):
    solver, classifier = WalkSolver(edges.connections), WalkClassifier(edges.system, edges.connections)
    for asked in drawn_requests(edges, 10, lengths=(1, 8), extra=(0, 4), seed=7, periodic=True):
        wraps = [n + more for n, more in zip(solver.least(asked.chain, periodic=True), asked.extra, strict=True)]
        orbit = solver.solve(asked.chain, wraps, periodic=True)
        assert orbit.converged, orbit.status
        assert orbit.residual < CLOSURE
        assert classifier.complaints(orbit) == []
        logs = exponents(edges.system, orbit)
        assert orbit.estimate.multipliers.log_unstable == pytest.approx(logs[0], rel=1e-10)
        assert orbit.estimate.multipliers.log_stable == pytest.approx(logs[-1], rel=1e-8)
        assert abs(orbit.estimate.multipliers.reciprocity) < RECIPROCAL
        assert logs[0] + logs[-1] == pytest.approx(0.0, abs=RECIPROCAL)


@pytest.mark.slow
def test_four_equal_turns_give_the_orbit_of_one_turn(edges):
    solver, classifier = WalkSolver(edges.connections), WalkClassifier(edges.system, edges.connections)
    turn = edges.between("up-down", "up-down")[0]
    once, often = (solver.solve([turn] * k, [1] * k, periodic=True) for k in (1, 4))
    assert classifier.complaints(once) == []
    assert classifier.complaints(often) == []
    assert often.duration == pytest.approx(4 * once.duration, abs=1e-10)
    logs = [orbit.estimate.multipliers.log_unstable for orbit in (once, often)]
    assert logs[1] == pytest.approx(4 * logs[0], rel=1e-10)


@pytest.fixture
def graph():
    """Two loops at a, one at b, an edge in each direction, and an isolated node c."""
    edges = [("p", "a", "a"), ("q", "a", "a"), ("r", "b", "b"), ("ab", "a", "b"), ("ba", "b", "a")]
    orbits = [SimpleNamespace(name=name) for name in ("a", "b", "c", "c family 1")]
    return connection_graph(orbits, [(a, b, SimpleNamespace(name=name)) for name, a, b in edges])


def test_the_number_of_walks_is_a_power_of_the_adjacency_matrix(graph):
    names = list(graph.nodes)
    adjacency = np.array([[graph.number_of_edges(a, b) for b in names] for a in names])
    for length in (1, 2, 5):
        power = np.linalg.matrix_power(adjacency, length)
        for i, source in enumerate(names):
            assert len(list(walks(graph, source, length=length))) == power[i].sum()
            for j, target in enumerate(names):
                assert len(list(walks(graph, source, target=target, length=length))) == power[i, j]
