"""Failures of shadowing, each reported with the cause and a remedy.

Energies are at the lab's saddle-nodes, at which pairs of connections appear, and just above.
"""

import numpy as np
import pytest
from walk_classifier import WalkClassifier

from dpcontrol.foundation.causes import ShootingCause, WalkCause, WrapsCause
from dpcontrol.shooting.newton import solve_shooting
from dpcontrol.walks.edges import find_edges
from dpcontrol.walks.shadowing import WalkSolver, described, first_guess

TURN_BORN = -0.141987140339  # Down-Up to itself
CROSSING_BORN = 0.188368752752  # Down-Up to Up-Down
HAIR = 2e-10  # J; twins are 1e-5 apart (scaled), and tubes meet at 0.02° to 0.05°


@pytest.fixture(scope="module")
def tangent(system):
    """The two pairs of turns of Down-Up just above their saddle-nodes."""
    return find_edges(system, TURN_BORN + HAIR, pairs=[("down-up", "down-up")])


@pytest.fixture(scope="module")
def crossing(system):
    """Transversal turns of Down-Up, and heteroclinics just above their saddle-node."""
    pairs = [("down-up", "down-up"), ("down-up", "up-down"), ("up-down", "down-up")]
    return find_edges(system, CROSSING_BORN + HAIR, pairs=pairs)


@pytest.mark.slow
def test_zero_wraps_are_too_few_just_above_the_saddle_node(system, tangent):
    solver, classifier = WalkSolver(tangent.connections), WalkClassifier(system, tangent.connections)
    plus = [c for c in tangent.connections if c.sense > 0]
    assert len(plus) == 2
    for walk in ([plus[0], plus[0]], [plus[0], plus[1]]):
        failed = solver.solve(walk, [0])
        assert not failed.converged
        assert failed.fault in (0, 1)
        assert failed.orbit.cause is ShootingCause.NO_STEP
        advice = solver.advice(failed)
        assert (advice.cause, advice.wraps) == (WrapsCause.TOO_FEW, (1,))
        missed = solver.missed(failed)
        assert (missed.symbol, missed.wraps) == (failed.fault, (1,))
        assert solver.least(walk) == (1,)
        assert classifier.complaints(solver.solve(walk, [1])) == []


def test_the_fewest_wraps_of_a_closed_walk_cannot_be_reduced(system, tangent):
    solver, classifier = WalkSolver(tangent.connections), WalkClassifier(system, tangent.connections)
    plus = [c for c in tangent.connections if c.sense > 0]
    walk = [plus[0], plus[1], plus[0]]
    least = solver.least(walk, periodic=True)
    assert max(least) > 0
    assert classifier.complaints(solver.solve(walk, least, periodic=True)) == []
    for k in np.flatnonzero(least):
        fewer = [n - (j == k) for j, n in enumerate(least)]
        assert not solver.solve(walk, fewer, periodic=True).converged


@pytest.mark.slow
def test_the_nearly_tangent_symbol_is_reported_as_the_cause(system, crossing):
    solver, classifier = WalkSolver(crossing.connections), WalkClassifier(system, crossing.connections)
    turns = [c for c in crossing.between("down-up", "down-up") if c.symmetric and c.transversality_angle > 20]
    blamed = 0
    for edge in crossing.between("down-up", "up-down"):
        for turn in turns:
            failed = solver.solve([turn, turn, edge], [0, 0])
            if failed.converged:
                continue
            blamed += 1
            assert failed.fault == 2
            least = solver.least([turn, turn, edge])
            assert least == (0, 1)
            assert classifier.complaints(solver.solve([turn, turn, edge], least)) == []
    assert blamed > 0


def test_an_orbit_that_follows_the_twin_is_reported(tangent):
    """Two twins are 1e-5 apart, and the solution for one is described as the other."""
    first, twin = (c for c in tangent.connections if c.sense > 0)
    shot = solve_shooting(first_guess([first, twin, first], [2, 2]))
    assert shot.orbit.converged
    asked = described(shot, (first, twin, first), [2, 2], rivals=tangent.connections)
    assert asked.converged
    wrong = described(shot, (first, first, first), [2, 2], rivals=tangent.connections)
    assert not wrong.converged
    assert wrong.fault == 1
    assert (wrong.cause, wrong.rival) == (WalkCause.RIVAL, twin.name)


def test_wraps_other_than_requested_are_reported(tangent):
    turn = tangent.connections[0]
    shot = solve_shooting(first_guess([turn, turn], [2]))
    wrong = described(shot, (turn, turn), [3], rivals=tangent.connections)
    assert not wrong.converged
    assert wrong.fault == 0
    assert (wrong.cause, wrong.wraps_realised, wrong.wraps) == (WalkCause.OTHER_WRAPS, (2,), (3,))
