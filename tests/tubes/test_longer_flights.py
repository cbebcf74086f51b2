"""Searches with a short flight time report longer flights; escaping branches hide no connections."""

import pytest
from command_line import dpcontrol

from dpcontrol.dynamics.system import System
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.tubes.connections import find_connections

THREE_BODY = ("connect", "three-body", "--from", "L1", "--to", "L1", "--energy", "-1.5185")


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
