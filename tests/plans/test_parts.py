"""Itineraries in parts: from rest to rest, holds, changes of energy, the level without friction and cart."""

from pathlib import Path

import numpy as np
import pytest

from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.dynamics.propagator import PolynomialInputPropagator
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.references.problem import state_scale
from dpcontrol.references.trajectory import power_coefficients
from dpcontrol.runs.run import run_plan

ROUNDING = 1e-9
WALK = {"energy": "-0.07", "walk": '["down-up +"]', "wraps": "[]", "lead_in": "1", "lead_out": "1"}


def scene(folder: Path, keys: dict[str, str], *tables: str) -> Path:
    file = folder / "scene.toml"
    file.write_text("".join(f"{key} = {value}\n" for key, value in keys.items()) + "\n".join(tables))
    return file


@pytest.fixture(scope="module")
def two_energies():
    return make_plan(load_itinerary("two-energies"))


@pytest.mark.slow
def test_a_change_of_energy_is_one_motion_from_rest_to_rest(two_energies):
    """Each interval, flown again on its own input, ends where the next begins."""
    reference, model = two_energies.reference, two_energies.itinerary.model
    assert reference.converged
    equations = arm_chain_equations(2, Level.CART)
    propagator = PolynomialInputPropagator(equations, model.arms.base(), degree=len(reference.method.points) - 1)
    scale = state_scale(6, reference.limits)
    coefficients, lengths = (
        power_coefficients(reference.method.points, reference.inputs[..., 0]),
        np.diff(reference.mesh),
    )
    for k in range(len(lengths) - 1):
        powers = coefficients[k] / lengths[k] ** np.arange(len(reference.method.points))
        landed = propagator.flow(reference.states[k, 0], powers, lengths[k])
        assert (np.abs(landed - reference.states[k + 1, 0]) / scale).max() < 1e-6
    first, last = reference.state(0.0), reference.state(reference.duration)
    assert np.abs(first).max() < ROUNDING
    turns = last[:2] / (2 * np.pi)
    assert np.abs(turns - np.rint(turns)).max() < ROUNDING
    assert np.abs(last[2:]).max() < ROUNDING


@pytest.mark.slow
def test_both_energies_are_there_while_their_walks_last(two_energies):
    """With friction and cart the pendulum's own energy stays near that of the walk that it follows."""
    reference, notes = two_energies.reference, two_energies.notes
    numeric = two_energies.itinerary.model.system.numeric
    times = {s["text"]: s["time"] for s in notes["symbols"]}
    for text, energy in (("down-up +", -0.07), ("down-up > up-down", 0.2)):
        near = reference.state(times[text] + np.linspace(-0.5, 0.5, 50))[:, :4]
        assert np.abs(numeric.hamiltonian(near) - energy).max() < 0.02


@pytest.mark.slow
def test_stops_and_symbols_describe_the_whole_motion(two_energies):
    notes = two_energies.notes
    saddles = [stop["saddle"] for stop in notes["stops"]]
    assert saddles == ["down-down", "down-up", "down-up", "up-down", "up-up", "down-down"]
    assert [s["name"] is None for s in notes["symbols"]] == [True, False, False, True, True]
    assert notes["wraps"] == [None, None, None, None]
    assert len(notes["transfers"]) == 4
    for symbol, before, after in zip(notes["symbols"], notes["stops"][:-1], notes["stops"][1:], strict=True):
        assert (symbol["source"], symbol["target"]) == (before["saddle"], after["saddle"])


@pytest.mark.slow
def test_a_run_through_two_energies_and_a_hold_is_completed(two_energies, tmp_path):
    done = run_plan(two_energies, tmp_path / "run.mcap").score()
    assert (done.completed, done.symbols_completed) == (True, 5)
    assert done.reason.endswith("at rest to the end")
    assert (done.symbols_total, done.transfers) == (5, 3)
    assert done.sentence.startswith(
        "completed: 5 of 5 symbols and transfers; all 5 symbols and transfers done in order"
    )


@pytest.mark.slow
def test_a_hold_that_is_lost_is_named(tmp_path):
    itinerary = load_itinerary("up-up").with_run({"controller": "feedforward"})
    done = run_plan(make_plan(itinerary), tmp_path / "run.mcap").score()
    assert done.completed is False
    assert "rest to up-up" in done.reason or "up-up to rest" in done.reason


def test_a_walk_without_friction_and_cart_is_its_shadowing_orbit(tmp_path):
    plan = make_plan(load_itinerary(str(scene(tmp_path, WALK, '[reference]\nlevel = "conservative"'))))
    reference = plan.reference
    assert reference.converged
    assert (reference.iterations, reference.max_cart_position) == (0, 0.0)
    states = reference.state(np.linspace(0, reference.duration, 500))[:, :4]
    assert np.abs(plan.itinerary.model.system.numeric.hamiltonian(states) + 0.07).max() < 1e-6


@pytest.mark.slow
def test_a_transfer_that_the_limits_forbid_is_named_with_its_place(tmp_path):
    limits = "[limits]\nposition = 0.02\nvelocity = 0.1\nacceleration = 1.0"
    with pytest.raises(
        GoalMissed, match=r"rest to down-up: no transfer in .*within the cart's limits \(position 0.02 m"
    ):
        make_plan(load_itinerary(str(scene(tmp_path, {**WALK, "start": '"rest"'}, limits))))


@pytest.mark.parametrize(
    ("keys", "tables", "naming"),
    [
        ({**WALK, "start": '"lying"'}, [], ["start = 'lying'", "rest"]),
        ({"hold": '"up-up"'}, [], ["start = 'orbit'", "hold"]),
        ({"hold": '"up-upp"', "start": '"rest"', "finish": '"rest"'}, [], ["hold = 'up-upp'", "up-up"]),
        ({"hold": '"up-up"', "seconds": "0.1", "start": '"rest"', "finish": '"rest"'}, [], ["seconds = 0.1", "0.5"]),
        ({**WALK, "hold": '"up-up"'}, [], ["hold", "walk as well"]),
        (WALK, ['[[parts]]\nhold = "up-up"'], ["[[parts]]"]),
        ({"start": '"rest"', "finish": '"rest"'}, ['[[parts]]\nhold = "up-up"\nsecond = 2.0'], ["'second'", "seconds"]),
        ({"parts": "3"}, [], ["parts = 3", "[[parts]]"]),
        (WALK, ['[reference]\nlevel = "dissipative"'], ["dissipative", "cart"]),
        ({**WALK, "finish": '"rest"'}, ['[reference]\nlevel = "conservative"'], ["conservative", "cart"]),
    ],
)
def test_parts_that_make_no_sense_are_refused_in_one_sentence(keys, tables, naming, tmp_path):
    with pytest.raises(InputError) as refused:
        load_itinerary(str(scene(tmp_path, keys, *tables)))
    message = str(refused.value)
    assert "scene.toml" in message
    assert all(line.startswith(str(tmp_path)) for line in message.split("\n"))
    for part in naming:
        assert part in message
