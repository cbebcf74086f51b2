"""Plans kept by content: found again, and never taken for another's."""

import io
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol as call

from dpcontrol.foundation.errors import InputError
from dpcontrol.judge.score import score
from dpcontrol.logs import RunLog
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan, plan_key
from dpcontrol.references.reference import load_reference, save_reference
from dpcontrol.runs.run import run_plan


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of this test's own."""
    monkeypatch.setenv("DPCONTROL_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.mark.slow
def test_a_plan_under_another_plans_name_is_computed_again(cache: Path) -> None:
    turn, cross = load_itinerary("outer-turn"), load_itinerary("cross")
    made = make_plan(cross)
    assert not made.cached
    assert make_plan(cross).cached
    stolen = cache / "plans" / f"outer-turn-{plan_key(turn)}.npz"
    shutil.copyfile(made.file, stolen)
    plan = make_plan(turn)
    assert not plan.cached
    assert plan.content.itinerary == "outer-turn"


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


@pytest.mark.slow
def test_a_plan_is_made_and_run_where_the_cache_cannot_be_written(
    tmp_path: Path, turn_plan: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a file").touch()
    monkeypatch.setenv("DPCONTROL_CACHE", str(tmp_path / "a file"))
    sound = load_reference(io.BytesIO(turn_plan))
    monkeypatch.setattr("dpcontrol.plans.planning.planned", lambda *_, **__: sound)
    ended = call("run", "outer-turn", "--out", tmp_path / "turn.mcap")
    assert ended.code == 0, ended.stderr
    assert call("plan", "outer-turn", "--json").document["file"] is None


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


def test_a_log_whose_plan_lacks_a_part_is_refused_whole(flown: RunLog, tmp_path: Path) -> None:
    reference = load_reference(io.BytesIO(flown.attachments["reference.npz"]))
    save_reference(tmp_path / "other.npz", replace(reference, plan=replace(reference.content, stops=())))
    attachments = {**flown.attachments, "reference.npz": (tmp_path / "other.npz").read_bytes()}
    with pytest.raises(InputError, match="is damaged"):
        score(replace(flown, attachments=attachments))


def test_a_plan_with_damaged_notes_is_refused_when_it_is_read(flown: RunLog, tmp_path: Path) -> None:
    reference = load_reference(io.BytesIO(flown.attachments["reference.npz"]))
    save_reference(file := tmp_path / "plan.npz", replace(reference, plan=replace(reference.content, stops=())))
    with pytest.raises(InputError, match="contradict each other"):
        load_itinerary(str(file))
    save_reference(file, reference)
    assert load_itinerary(str(file)).name == "outer-turn"
