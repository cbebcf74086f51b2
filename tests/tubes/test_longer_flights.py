"""Searches with a short flight time report longer flights; escaping branches hide no connections."""

import casadi as ca
import pytest
from command_line import dpcontrol

import dpcontrol as dp
from dpcontrol.dynamics.system import System
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.tubes.connections import find_connections

THREE_BODY = ("connect", "three-body", "--from", "L1", "--to", "L1", "--energy", "-1.5185")

LATE_CROSSING = ("connect", "lab", "--from", "down-up", "--to", "down-up", "--energy", "0.2", "--hits", "4")


def hamiltonian(q, p, _):
    """Hénon and Heiles (1964)."""
    (x, y), (px, py) = q, p
    return (px**2 + py**2 + x**2 + y**2) / 2 + x**2 * y - y**3 / 3


@pytest.mark.slow
def test_a_search_that_excludes_longer_flights_misses_its_goal() -> None:
    short = dpcontrol(*THREE_BODY, "--longest", "4", "--json")
    longer = dpcontrol(*THREE_BODY, "--longest", "4.3", "--json")
    assert short.code == 1
    assert short.document["complete"] is False
    assert short.document["status"].startswith("at least 4 connections")
    assert "longer flights exist beyond --longest" in short.message
    assert longer.document["count"] > short.document["count"]


def test_an_incomplete_search_without_connections_gives_no_lower_bound() -> None:
    ended = dpcontrol("connect", "lab", "--from", "down-up", "--to", "down-up", "--energy", "0.2", "--longest", "1")
    assert ended.code == 1
    assert "is not complete: no connections found: " in ended.message


@pytest.mark.slow
def test_the_advice_for_tubes_that_scatter_does_not_contradict_itself() -> None:
    found = dpcontrol(*LATE_CROSSING, "--longest", "3", "--seconds", "6")
    assert found.code == 1
    assert "scatters before crossing 4" in found.message
    assert "shorten --longest" in found.message
    assert "longer flights exist beyond" in found.message
    assert "raise it" not in found.message
    assert found.message.count("allow more seconds") <= 1


@pytest.mark.slow
def test_three_bodies_have_normalised_units() -> None:
    ended = dpcontrol("orbit", "three-body", "--saddle", "L1", "--energy", "-1.5185")
    assert ended.code == 0
    assert "at -1.5185: converged" in ended.stdout
    assert " J" not in ended.stdout
    assert "rad" not in ended.stdout
    shown = dpcontrol(*THREE_BODY, "--longest", "3").stdout
    assert "time out " in shown
    assert "(s)" not in shown
    assert " J" not in shown


@pytest.mark.slow
def test_an_escaping_branch_is_reported_and_keeps_the_search_complete() -> None:
    """Above the saddle, the outer branch escapes to infinity along the cubic potential."""
    system = System.from_hamiltonian(
        "henon-heiles", hamiltonian, coordinates=("x", "y"), equilibria={"top": (0.0, 1.0), "left": (-0.9, -0.5)}
    )
    orbit = lyapunov_orbit(system, "top", energy=0.17)
    search = find_connections(orbit, orbit)
    assert search.complete, search.status
    escaping = [end for _, end in search.open_ends if end.escapes]
    assert {end.branch for end in escaping} == {1}
    assert all("escapes: " in end.reason for end in escaping)
    assert "allow more time" not in search.status


def barrier(potential, above=0.1):
    """The orbit on top of a barrier, at an energy above it."""

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
    assert {(end.branch, end.escapes) for _, end in search.open_ends} == {(1, True), (-1, True)}
    assert all("move away at a constant rate" in end.reason for _, end in search.open_ends)
    assert "allow" not in search.status
    assert "escapes" in orbit.manifold(branch=1).cut().status


def test_the_advice_for_branches_that_return_late_is_longer_flights() -> None:
    """Both branches move freely for more than 12 periods, until they return from distant walls."""
    orbit = barrier(lambda x, y: gaussian(x, y) + (x / 130) ** 40)
    search = dp.connections(orbit)
    assert not search.complete
    assert not any(end.escapes for _, end in search.open_ends)
    assert "raise it above 12 periods" in search.status
    assert "--longest (longest in Python)" in search.status
    assert "seconds" not in search.status
    assert "thorough" not in search.status
    longer = dp.connections(orbit, longest=20)
    assert "beyond --longest" not in longer.status
    assert len(longer.cuts[0].pieces) == 2
    assert len(orbit.manifold().cut(longest=20).pieces) == 2


def test_branches_that_become_infinite_are_searched() -> None:
    """On one side, y grows faster than exponentially, and on the other, trajectories slow down."""
    orbit = barrier(lambda x, y: 1 / ca.cosh(x) ** 2 + y**2 * (1 + 0.2 * x) / 2)
    search = dp.connections(orbit)
    assert {(end.branch, end.escapes) for _, end in search.open_ends} == {(1, False), (-1, True)}
    assert "raise it above 12 periods" in search.status
    for branch in (1, -1):
        assert orbit.manifold(branch=branch).cut().pieces == ()


@pytest.mark.slow
def test_the_default_flights_of_three_bodies_are_extended_by_the_advised_option() -> None:
    default = dpcontrol(*THREE_BODY, "--json")
    assert default.code == 1
    assert "raise it above 4 periods" in default.message
    assert "thorough" not in default.message
    assert "allow more" not in default.message
    longer = dpcontrol(*THREE_BODY, "--longest", "4.3", "--json")
    assert longer.document["count"] > default.document["count"]
    assert "raise it above 4.3 periods" in longer.message
