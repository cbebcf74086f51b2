"""What would have saved a run: each change that is named completes the seed, and what cannot be tried is refused."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import dpcontrol

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import LogWriter
from dpcontrol.scenes.itinerary import load_itinerary
from dpcontrol.scenes.plan import Plan, make_plan
from dpcontrol.scenes.preflight import Why, changes
from dpcontrol.scenes.run import Run, run_plan
from dpcontrol.scenes.run_options import RunOptions

SHORT = RunOptions(controller="tvlqr", travel=0.015, mismatch=0.0)
"""A track that the plan itself nearly fills."""


@pytest.fixture(scope="module")
def plan() -> Plan:
    return make_plan(load_itinerary("outer-turn").with_run(SHORT))


@pytest.fixture(scope="module")
def failed(plan: Plan) -> Run:
    return run_plan(plan)


@pytest.fixture(scope="module")
def found(failed: Run) -> Why:
    return failed.why()


@pytest.mark.slow
def test_the_changes_that_are_named_complete_the_seed_and_no_other_does(plan: Plan, found: Why, failed: Run) -> None:
    assert failed.score().completed is False
    assert found.reason == failed.score().reason
    named = {change.text: change.loop for group in changes(plan.itinerary) for change in group}
    assert {trial.change for trial in found.trials} <= set(named)
    assert "with a travel of ±0.03 m" in found.saves
    assert 0 < len(found.saves) < len(found.trials)
    for trial in found.trials[:3]:
        again = run_plan(replace(plan, itinerary=replace(plan.itinerary, loop=named[trial.change]))).score()
        assert (again.completed, again.reason) == (trial.completed, trial.verdict)
    assert found.sentence.startswith(f"this seed is completed {found.saves[0]}")


def test_a_change_alters_one_setting_and_keeps_the_seed(plan: Plan) -> None:
    troubles = RunOptions(lag=0.01, cart_mass=0.3, zero_error=0.01, tilt=0.02, stuck_at=1.0)
    scene = plan.itinerary.with_run(troubles, seed=7)
    texts = [change.text for group in changes(scene) for change in group]
    assert len(set(texts)) == len(texts)
    expected_of = ("half the drive's lag", "knows of the lag", "zeros set", "level track", "does not stick")
    for expected in (*expected_of, "do not push", "adaptive"):
        assert any(expected in text for text in texts), expected
    assert all(change.loop.seed == 7 for group in changes(scene) for change in group)


def test_nothing_is_tried_for_a_run_that_was_completed(plan: Plan) -> None:
    done = run_plan(replace(plan, itinerary=load_itinerary("outer-turn"))).why()
    assert done.trials == ()
    assert done.sentence == "completed as it is: nothing was tried"


def test_what_was_not_simulated_cannot_be_tried_again(failed: Run) -> None:
    log = failed.log
    with pytest.raises(InputError, match="only what is simulated does the same twice"):
        Run(replace(log, metadata={**log.metadata, "rig": "udp://bench:5005"})).why()


def test_score_says_why(tmp_path: Path, plan: Plan) -> None:
    run_plan(plan, tmp_path / "failed.mcap")
    told = dpcontrol("score", str(tmp_path / "failed.mcap"), "--why", "--json")
    assert told.code == 1
    document = json.loads(told.stdout)
    assert document["why"]["saves"]
    assert document["why"]["sentence"].startswith("this seed is completed")
    assert {"change", "completed", "verdict"} == set(document["why"]["trials"][0])
    with LogWriter(tmp_path / "bench.mcap", arm_lengths=(0.1, 0.2), rate_hz=1000.0, limits=(0.4, 3.0, 30.0)):
        pass
    refused = dpcontrol("score", str(tmp_path / "bench.mcap"), "--why")
    assert refused.code == 2
