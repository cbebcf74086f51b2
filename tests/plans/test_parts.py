"""Itineraries in parts: from rest to rest, holds, changes of energy, the level without friction and cart."""

import numpy as np
import pytest

from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.run import run_plan
from tests.references.flown_again import gaps

ROUNDING = 1e-9
WALK = """
energy = -0.07
walk = ["down-up +"]
lead_in = 1
lead_out = 1
[reference]
level = "conservative"
"""


@pytest.fixture(scope="module")
def two_energies():
    return make_plan(load_itinerary("two-energies"))


@pytest.mark.slow
def test_a_change_of_energy_is_one_motion_from_rest_to_rest(two_energies):
    reference = two_energies.reference
    assert reference.converged
    assert gaps(reference, two_energies.itinerary.model.arms).max() < 1e-6
    first, last = reference.state(0.0), reference.state(reference.duration)
    assert np.abs(first).max() < ROUNDING
    turns = last[:2] / (2 * np.pi)
    assert np.abs(turns - np.rint(turns)).max() < ROUNDING
    assert np.abs(last[2:]).max() < ROUNDING


@pytest.mark.slow
def test_both_energies_are_there_while_their_walks_last(two_energies):
    """With friction and cart the pendulum's own energy stays near that of the walk that it follows."""
    reference, content = two_energies.reference, two_energies.content
    numeric = two_energies.itinerary.model.system.numeric
    times = {s.text: s.time for s in content.symbols}
    for text, energy in (("down-up +", -0.07), ("down-up > up-down", 0.2)):
        near = reference.state(times[text] + np.linspace(-0.5, 0.5, 50))[:, :4]
        assert np.abs(numeric.hamiltonian(near) - energy).max() < 0.02


@pytest.mark.slow
def test_stops_and_symbols_describe_the_whole_motion(two_energies):
    content = two_energies.content
    saddles = [stop.saddle for stop in content.stops]
    assert saddles == ["down-down", "down-up", "down-up", "up-down", "up-up", "down-down"]
    assert [s.name is None for s in content.symbols] == [True, False, False, True, True]
    assert content.wraps == (None, None, None, None)
    assert len(content.transfers) == 4
    for symbol, before, after in zip(content.symbols, content.stops[:-1], content.stops[1:], strict=True):
        assert (symbol.source, symbol.target) == (before.saddle, after.saddle)


@pytest.mark.slow
def test_a_run_through_two_energies_and_a_hold_is_completed(two_energies, tmp_path):
    done = run_plan(two_energies, tmp_path / "run.mcap").score()
    assert (done.completed, done.symbols_completed) == (True, 5)
    assert (done.symbols_total, done.transfers) == (5, 4)  # the change of energy is no symbol


def test_a_walk_without_friction_and_cart_is_its_shadowing_orbit(tmp_path):
    (tmp_path / "scene.toml").write_text(WALK)
    plan = make_plan(load_itinerary(str(tmp_path / "scene.toml")))
    reference = plan.reference
    assert reference.converged
    assert (reference.iterations, reference.max_cart_position) == (0, 0.0)
    states = reference.state(np.linspace(0, reference.duration, 500))[:, :4]
    assert np.abs(plan.itinerary.model.system.numeric.hamiltonian(states) + 0.07).max() < 1e-6
