"""Plans kept by content: found again, and never taken for another's."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dpcontrol.logs import RunLog
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan, plan_key
from dpcontrol.references.reference import load_reference
from dpcontrol.runs.run import run_plan


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of this test's own."""
    monkeypatch.setenv("DPCONTROL_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="module")
def turn_plan(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The outer turn's plan as its file's bytes, found without a cache."""
    return make_plan(load_itinerary("outer-turn")).archive


def test_a_kept_plan_whose_states_were_changed_is_never_served(
    cache: Path, turn_plan: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    turn = load_itinerary("outer-turn")
    sound = load_reference(io.BytesIO(turn_plan))
    monkeypatch.setattr("dpcontrol.plans.planning.planned", lambda *_, **__: sound)
    file = make_plan(turn).file
    assert make_plan(turn).cached
    with np.load(file) as archive:
        arrays = dict(archive)
    np.savez(file, **(arrays | {"states": 1.5 * arrays["states"]}))
    assert load_reference(file).converged
    again = make_plan(turn)
    assert not again.cached
    assert np.array_equal(again.reference.states, sound.states)
    assert make_plan(turn).cached


def test_a_changed_title_or_limit_requires_another_plan() -> None:
    scene = load_itinerary("outer-turn")
    assert plan_key(replace(scene, title="Another")) != plan_key(scene)
    assert plan_key(replace(scene, limits=replace(scene.limits, position=0.3))) != plan_key(scene)
    assert plan_key(scene.with_run({"mismatch": 0.1}, seed=5)) == plan_key(scene)


@pytest.fixture(scope="module")
def flown() -> RunLog:
    """Content of a run's log."""
    run = run_plan(make_plan(load_itinerary("outer-turn")))
    assert run.score().completed
    return run.log
