"""A plant with other arms and laws of friction than the controller's model."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dpcontrol.foundation.shipped import find
from dpcontrol.plans.itinerary import Itinerary, load_itinerary
from dpcontrol.plans.model import load_model
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.run import repeat_run, run_plan

FRICTION = "viscous = [8e-4, 1e-4]\ncoulomb = [3e-4, 2e-4]\nquadratic = [1e-3, 1e-3]"


@pytest.fixture
def rusty(tmp_path: Path) -> Path:
    """The lab's arms with dry joints, in air."""
    text = find("models", "lab").read_text()
    file = tmp_path / "rusty.toml"
    file.write_text(text[: text.index("viscous =")] + FRICTION + "\n")
    return file


@pytest.fixture(scope="module")
def turn() -> Itinerary:
    return load_itinerary("outer-turn")


def test_the_plant_is_the_files_and_the_model_stays(turn: Itinerary, rusty: Path) -> None:
    scene = turn.with_run({"plant": str(rusty), "mismatch": 0.0})
    assert scene.loop.draw(scene.model.arms, ticks=2).plant.arms == load_model(str(rusty)).arms
    assert scene.model.arms == load_model("lab").arms


def test_mismatch_and_the_factor_on_friction_go_with_the_plants_own(turn: Itinerary, rusty: Path) -> None:
    own = load_model(str(rusty)).arms
    scene = turn.with_run({"plant": str(rusty), "mismatch": 0.05, "friction": 3.0}, seed=4)
    drawn = scene.loop.draw(scene.model.arms, ticks=2).plant.arms
    assert np.all(np.abs(np.divide(drawn.mass, own.mass) - 1) <= 0.05)
    for law in ("viscous", "coulomb", "quadratic"):
        factor = np.divide(getattr(drawn, law), getattr(own, law))
        assert np.all((factor >= 3 * 0.75) & (factor <= 3 * 1.25))
    plain = turn.with_run({"mismatch": 0.05}, seed=4)
    tripled = replace(plain.loop, friction=3.0).draw(plain.model.arms, ticks=2).plant.arms
    as_before = plain.loop.draw(plain.model.arms, ticks=2).plant.arms
    assert tripled == replace(as_before, viscous=tuple(3.0 * k for k in as_before.viscous))


@pytest.mark.slow
def test_a_plans_and_a_logs_plant_travel_with_them(rusty: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the file has it at the time of the plan, although the plan itself was cached with another plant."""
    text, scene = find("itineraries", "hold-down-down").read_text(), rusty.with_name("with-rust.toml")
    scene.write_text(text.replace("60.0", "0.5").replace("[run]", '[run]\nplant = "rusty.toml"'))
    make_plan(load_itinerary(str(scene)))
    rusty.write_text(rusty.read_text().replace("8e-4", "7e-4"))
    plan, other = make_plan(load_itinerary(str(scene))), rusty.parent / "other"
    own = load_model(str(rusty)).arms
    other.mkdir()
    (other / "plan.npz").write_bytes(plan.archive)
    run_plan(plan, other / "run.mcap")
    for file in (scene, rusty):
        file.unlink()
    monkeypatch.chdir(other)
    assert load_itinerary("plan.npz").loop.plant == own
    assert repeat_run(Path("run.mcap"), out=Path("again.mcap")).comparison.difference is None
