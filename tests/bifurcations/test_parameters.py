"""Connections followed over a parameter of the model, compared with searches at single values and with energies."""

from dataclasses import replace

import numpy as np
import pytest

import dpcontrol as dp
from dpcontrol.bifurcations.bifurcations import BifurcationSearch
from dpcontrol.orbits.lyapunov import equilibrium
from dpcontrol.plans.model import load_model
from dpcontrol.tubes.connections import find_connections, orbits_between

LAB = load_model("lab")
ENERGY = -0.07  # J
BESIDE = 2e-5  # kg: the pair of a pitchfork is then far enough from the symmetric connection
SAME = 1e-9  # J, kg: an event solved over the mass and over the energy


def with_mass(mass: float) -> dp.System:
    """Return the lab pendulum with another outer mass, kg."""
    return replace(LAB, parameters=replace(LAB.arms, mass=(LAB.arms.mass[0], mass))).system


def count(mass: float, energy: float = ENERGY) -> int:
    """Return the number of first-hit homoclinics, by intersections of cuts and multiple shooting."""
    return len(find_connections(*orbits_between(with_mass(mass), "down-up", "down-up", energy)).connections)


@pytest.fixture(scope="module")
def near_pitchfork() -> BifurcationSearch:
    return dp.find_bifurcations(LAB, "down-up", "down-up", parameter=("m2", 0.0985, 0.1005), energy=ENERGY, samples=2)


def test_a_pitchfork_over_the_mass_is_a_pitchfork_over_the_energy(near_pitchfork: BifurcationSearch) -> None:
    (event,) = near_pitchfork.events
    assert (event.kind, event.count_below, event.count_above, event.energy) == ("pitchfork", 4, 8, ENERGY)
    over_energy = dp.find_bifurcations(
        with_mass(event.value), "down-up", "down-up", energies=(ENERGY - 1e-3, ENERGY + 1e-3), samples=2
    )
    (other,) = over_energy.events
    assert other.kind == "pitchfork"
    assert other.energy == pytest.approx(ENERGY, abs=SAME)
    assert np.abs(other.state - event.state).max() < 1e-6


@pytest.mark.slow
def test_the_lab_pendulums_homoclinics_over_the_outer_mass_agree_with_searches_beside_each_event() -> None:
    found = dp.find_bifurcations(LAB, "down-up", "down-up", parameter=("m2", 0.05, 0.3), energy=ENERGY)
    assert found.complete
    assert [(event.kind, event.count_below, event.count_above) for event in found.events] == [("pitchfork", 4, 8)]
    for event in found.events:
        assert count(event.value - BESIDE) == event.count_below
        assert count(event.value + BESIDE) == event.count_above
    ends = found.counts[0], found.counts[-1]
    assert [count(end.value) for end in ends] == [end.count for end in ends]


@pytest.mark.slow
def test_at_a_fixed_height_the_energy_follows_the_saddle() -> None:
    height = 0.1  # J: above the first saddle-node
    found = dp.find_bifurcations(LAB, "down-up", "down-up", parameter=("l1", 0.17, 0.18), height=height, samples=2)
    for step in found.counts:
        longer = replace(LAB, parameters=replace(LAB.arms, length=(step.value, LAB.arms.length[1]))).system
        assert step.energy == pytest.approx(equilibrium(longer, "down-up").energy + height, abs=1e-15)
        searched = find_connections(*orbits_between(longer, "down-up", "down-up", step.energy)).connections
        assert step.count == len(searched)
        assert step.orbits[0].period == pytest.approx(searched[0].source.period, abs=1e-10)


@pytest.mark.slow
def test_three_bodies_are_followed_over_their_mass_ratio() -> None:
    sun = load_model("three-body")
    mu = sun.parameters.named()["mu"][0]
    found = dp.find_bifurcations(sun, "L1", "L1", parameter=("mu", mu, 1.01 * mu), height=5e-4, samples=2)
    heavier = replace(sun, parameters=replace(sun.parameters, mass_ratio=1.01 * mu)).system
    searched = find_connections(*orbits_between(heavier, "L1", "L1", found.counts[-1].energy)).connections
    assert found.counts[-1].count == len(searched)
    assert not found.unexplained
