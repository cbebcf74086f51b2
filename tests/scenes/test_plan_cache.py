"""Plans kept by content: found again, and never taken for another's."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import read_log
from dpcontrol.references.archive import load_reference, save_reference
from dpcontrol.review.score import score
from dpcontrol.scenes.itinerary import load_itinerary
from dpcontrol.scenes.plan import make_plan, plan_key
from dpcontrol.scenes.run import run_plan


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of this test's own."""
    monkeypatch.setenv("DPCONTROL_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_a_plan_under_anothers_name_is_made_anew(cache: Path) -> None:
    turn, cross = load_itinerary("outer-turn"), load_itinerary("cross")
    made = make_plan(cross)
    assert not made.cached
    assert make_plan(cross).cached
    stolen = cache / "plans" / f"outer-turn-{plan_key(turn)}.npz"
    shutil.copyfile(made.file, stolen)
    plan = make_plan(turn)
    assert not plan.cached
    assert plan.notes["itinerary"] == "outer-turn"


def test_a_changed_title_or_limit_asks_for_another_plan() -> None:
    scene = load_itinerary("outer-turn")
    assert plan_key(replace(scene, title="Another")) != plan_key(scene)
    assert plan_key(replace(scene, limits=replace(scene.limits, position=0.3))) != plan_key(scene)
    assert plan_key(scene.with_run(seed=5, mismatch=0.1)) == plan_key(scene)


@pytest.mark.parametrize("lost", ["stops", "symbols", "orbits", "saddles", "wraps", "title"])
def test_a_log_whose_plan_lacks_a_part_is_refused_whole(lost: str, tmp_path: Path) -> None:
    plan = make_plan(load_itinerary("outer-turn"))
    reference = load_reference(plan.file)
    notes = {key: value for key, value in reference.notes.items() if key != lost}
    damaged = tmp_path / "damaged.npz"
    save_reference(damaged, replace(reference, notes=notes))
    log = tmp_path / "run.mcap"
    run_plan(plan, log)
    run = read_log(log)
    assert score(run).completed
    with pytest.raises(InputError, match="holds no plan"):
        score(replace(run, attachments={**run.attachments, "reference.npz": damaged.read_bytes()}))
    other = replace(reference, states=np.ascontiguousarray(reference.states[..., :3]))
    save_reference(damaged, other)
    with pytest.raises(InputError, match="holds no plan"):
        score(replace(run, attachments={**run.attachments, "reference.npz": damaged.read_bytes()}))
