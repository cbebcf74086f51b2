"""The shipped itineraries do what their titles say, and a walk may be repeated."""

import numpy as np
import pytest

from dpcontrol.plans.itinerary import Itinerary, itinerary_from, load_itinerary
from dpcontrol.plans.model import load_model
from dpcontrol.plans.plan import make_plan
from dpcontrol.plans.planning import shadowing_orbit
from dpcontrol.runs.run import run_plan

RESIDUAL = 1e-11
JOURNEYS = {
    # Saddles at the stops, and whole turns of both arms from the first named position to the last.
    "triple-turn": (["down-up"] * 4, [0, 3]),
    "round-trip": (["down-up"] * 3 + ["up-down"] * 3 + ["down-up"] * 2 + ["up-down"] * 3 + ["down-up"] * 2, None),
    "dance": (["down-up", "up-down", "up-down", "down-up"] * 3 + ["down-up"], None),
}


def scene(*lines: str) -> Itinerary:
    """Return an itinerary of two turns there and back, with further keys."""
    text = "\n".join(["energy = -0.07", 'walk = ["down-up +", "down-up -"]', *lines])
    return itinerary_from(text, "scene", load_model("lab"))


@pytest.mark.slow
@pytest.mark.parametrize("name", JOURNEYS)
def test_a_shipped_itinerary_is_followed_by_an_orbit_with_its_stops_turns_and_wraps(name: str) -> None:
    itinerary = load_itinerary(name)
    orbit = shadowing_orbit(itinerary, itinerary.walks[0])
    stops, turns = JOURNEYS[name]
    chain = orbit.connections
    assert orbit.residual <= RESIDUAL
    assert orbit.wraps_realised == itinerary.wraps
    assert [chain[0].source.saddle, *(c.target.saddle for c in chain)] == stops
    assert len(itinerary.walk) == len(stops) - 1
    first, last = orbit.states(np.array([0.0, orbit.duration]))
    # Both ends have the same phase of the orbit, so they differ by whole turns.
    if turns is not None:
        change = (last - first)[:2] / (2 * np.pi)
        assert np.rint(change).tolist() == turns


def test_a_repeated_walk_is_done_so_often_with_the_last_wrap_between_rounds() -> None:
    itinerary = scene("wraps = [0, 1]", "repeat = 3")
    assert itinerary.walk == ("down-up +", "down-up -") * 3
    assert itinerary.wraps == (0, 1, 0, 1, 0)
    dance = load_itinerary("dance")
    assert (len(dance.walk), len(dance.wraps), dance.walks[0].repeat) == (12, 11, 3)


@pytest.mark.slow
def test_a_repeated_walk_is_planned_run_and_scored_as_all_its_rounds() -> None:
    plan = make_plan(scene("wraps = [0, 0]", "repeat = 2", "lead_in = 1", "lead_out = 1"))
    assert plan.reference.converged
    assert plan.content.wraps == (0, 0, 0)
    assert [s.text for s in plan.content.symbols] == ["down-up +", "down-up -"] * 2
    done = run_plan(plan).score()
    assert (done.completed, done.symbols_completed, done.wraps) == (True, 4, (0, 0, 0))


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
def test_a_run_through_two_energies_and_a_hold_is_completed(two_energies):
    done = run_plan(two_energies).score()
    assert (done.completed, done.symbols_completed) == (True, 5)
    assert (done.symbols_total, done.transfers) == (5, 4)  # the change of energy is no symbol


def test_a_walk_without_friction_and_cart_is_its_shadowing_orbit():
    plan = make_plan(itinerary_from(WALK, "scene", load_model("lab")))
    reference = plan.reference
    assert reference.converged
    assert (reference.iterations, reference.max_cart_position) == (0, 0.0)
    states = reference.state(np.linspace(0, reference.duration, 500))[:, :4]
    assert np.abs(plan.itinerary.model.system.numeric.hamiltonian(states) + 0.07).max() < 1e-6
