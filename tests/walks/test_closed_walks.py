"""Closed walks give periodic orbits with reciprocal multipliers.

The multipliers are compared with QR factors of separately integrated state-transition matrices.
"""

import numpy as np
import pytest
from walk_classifier import WalkClassifier

from dpcontrol.plans.model import load_model
from dpcontrol.walks.edges import find_edges
from dpcontrol.walks.shadowing import WalkSolver
from dpcontrol.walks.walks import drawn_requests

CLOSURE = 1e-11
RECIPROCAL = 1e-8  # λ ≈ 1e3 per symbol: rounding of small parts of the state-transition matrices


@pytest.fixture(scope="module")
def edges():
    return find_edges(load_model("lab").system, 0.2)


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
