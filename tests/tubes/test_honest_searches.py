"""Searches list each connection once, detect symmetry and report incompleteness."""

import numpy as np
import pytest
from uniform_rods import uniform_rods

from dpcontrol.bifurcations.bifurcations import SweepSettings, find_bifurcations
from dpcontrol.bifurcations.links import Quantity
from dpcontrol.plans.model import load_model
from dpcontrol.tubes.connections import ConnectionSearch, find_connections, orbits_between
from dpcontrol.walks.edges import find_edges
from dpcontrol.walks.symbols import choose, parse_symbol

ON_MIRROR = 1e-8  # rad
STATE = 1e-7  # scaled
PITCHFORK = -0.10032106461843  # J, of the lab's Down-Up homoclinics, 4 below and 8 above; error 1e-11


def homoclinics(model: str, saddle: str, energy: float) -> ConnectionSearch:
    return find_connections(*orbits_between(load_model(model).system, saddle, saddle, energy))


def test_a_trajectory_that_returns_near_its_orbit_is_not_a_saddle_node():
    system, settings = load_model("printed").system, SweepSettings(samples=2)
    found = find_bifurcations(
        Quantity.of_energy(system), "down-up", "down-up", values=(0.0975, 0.0979), settings=settings
    )
    assert found.complete
    assert not found.events
    assert {c.count for c in found.counts} == {12}


@pytest.mark.slow
def test_near_a_pitchfork_each_connection_is_counted_once():
    assert len(homoclinics("lab", "down-up", PITCHFORK + 1e-9).connections) == 8
    # Nearer to it, the tubes are tangent to rounding, which the status reports.
    assert not homoclinics("lab", "down-up", PITCHFORK + 1e-10).complete


@pytest.mark.parametrize("energy", [0.06, 0.195])
def test_symmetric_connections_lie_on_the_symmetry_line_for_any_multiplier(energy):
    search = homoclinics("printed", "down-up", energy)
    for c in search.connections:
        assert c.symmetric == (abs(np.sin(c.state[0])) < ON_MIRROR), c.name
    assert any(c.symmetric for c in search.connections)


@pytest.mark.slow
def test_a_short_symbol_selects_the_same_motion_at_nearby_energies():
    system = load_model("printed").system
    named = []
    for energy in (0.17, 0.18, 0.19):
        edges = find_edges(system, energy, pairs=[("down-up", "down-up")])
        named.append(choose(parse_symbol("down-up +", edges.saddles), edges.connections))
    assert all(c.symmetric for c in named)
    rates = np.array([c.state[2:] for c in named])
    # A small change in energy moves the same motion only slightly.
    assert np.abs(np.diff(rates, axis=0)).max() < 0.1 * np.abs(rates).max()


@pytest.mark.slow
def test_connections_with_large_rounding_errors_are_found():
    system = uniform_rods((0.2, 0.1), (0.1, 0.1))
    search = find_connections(*orbits_between(system, "up-down", "up-down", 0.250155))
    assert len(search.connections) == 32
    assert not search.failed


@pytest.mark.slow
def test_the_mirror_image_of_every_homoclinic_is_listed():
    system = uniform_rods((0.2, 0.1), (0.1, 0.5))
    search = find_connections(*orbits_between(system, "down-up", "down-up", 1.0791))
    states = np.array([c.state for c in search.connections])
    for image in (states * [1, 1, -1, -1], states * [-1, -1, 1, 1]):
        for state in image:
            assert system.scaled_distance(states, state).min() < STATE
