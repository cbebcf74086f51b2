"""Searches with a short flight time report longer flights; escaping branches hide no connections."""

import casadi as ca
import pytest
from command_line import dpcontrol

import dpcontrol as dp
from dpcontrol.examples.henon_heiles import henon_heiles
from dpcontrol.foundation.causes import OpenEndCause


@pytest.mark.slow
def test_a_search_that_excludes_longer_flights_misses_its_goal() -> None:
    """Four periods are the default for three bodies."""
    line = ("connect", "three-body", "--from", "L1", "--to", "L1", "--energy", "-1.5185", "--json")
    short, longer = dpcontrol(*line), dpcontrol(*line, "--longest", "4.3")
    assert short.code == 1
    assert short.document["complete"] is False
    assert "raise it above 4 periods" in short.message
    assert longer.document["count"] > short.document["count"]


@pytest.mark.slow
def test_an_escaping_branch_is_reported_and_keeps_the_search_complete() -> None:
    """Above the saddle, the outer branch escapes to infinity along the cubic potential."""
    search = dp.connections(dp.orbit(henon_heiles(), "top", energy=0.17))
    assert search.complete, search.status
    escaping = [end for _, end in search.open_ends if end.cause is OpenEndCause.ESCAPES]
    assert {end.branch for end in escaping} == {1}


def barrier(potential, above=0.1):
    def hamiltonian(q, p, _):
        return (p[0] ** 2 + p[1] ** 2) / 2 + potential(*q)

    system = dp.System.from_hamiltonian("barrier", hamiltonian, coordinates=("x", "y"), equilibria={"bar": (0.01, 0)})
    energy = float(system.numeric.hamiltonian(system.equilibria["bar"])) + above
    return dp.orbit(system, "bar", energy=energy)


def gaussian(x, y):
    return ca.exp(-(x**2)) + y**2 / 2 * (1 + 0.3 * ca.exp(-(x**2)))


def test_branches_that_leave_at_a_constant_speed_escape() -> None:
    orbit = barrier(gaussian)
    search = dp.connections(orbit)
    assert search.complete, search.status
    assert search.connections == ()
    causes = {(end.branch, end.cause) for _, end in search.open_ends}
    assert causes == {(1, OpenEndCause.ESCAPES), (-1, OpenEndCause.ESCAPES)}


@pytest.mark.slow
def test_the_advice_for_branches_that_return_late_is_longer_flights() -> None:
    """Both branches move freely for more than 12 periods, until they return from distant walls."""
    orbit = barrier(lambda x, y: gaussian(x, y) + (x / 130) ** 40)
    search = dp.connections(orbit)
    assert not search.complete
    assert all(end.cause is OpenEndCause.NEVER_ARRIVES and end.later for _, end in search.open_ends)
    assert search.cuts[0].longest == 12
    longer = dp.connections(orbit, longest=20)
    assert not any(end.later for _, end in longer.open_ends)
    assert len(longer.cuts[0].pieces) == 2
    assert len(orbit.manifold().cut(longest=20).pieces) == 2
