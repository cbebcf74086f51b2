"""Remedies of failed runs: each printed option completes the run when typed and beats harmless changes."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import dpcontrol

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import LogWriter
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.overrides import typed
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.runs.preflight import changes
from dpcontrol.runs.remedies import Completed, TriedChange, Why, _beats
from dpcontrol.runs.run import Run, _plan, _with_options, run_metadata, run_plan

SHORT = {"controller": "tvlqr", "travel": 0.015, "mismatch": 0.0}
"""A track that the plan itself nearly fills."""


@pytest.fixture(scope="module")
def plan() -> Plan:
    return make_plan(load_itinerary("outer-turn").with_run(SHORT))


@pytest.fixture(scope="module")
def failed(plan: Plan) -> Run:
    return run_plan(plan)


@pytest.fixture(scope="module")
def found(failed: Run) -> Why:
    return failed.why(workers=1)


@pytest.mark.slow
def test_each_remedy_completes_the_run_and_beats_harmless_changes(plan: Plan, found: Why, failed: Run) -> None:
    assert failed.score().completed is False
    assert found.reason == failed.score().reason
    named = {change.text: change.options for group in changes(plan.itinerary) for change in group}
    assert {trial.change: trial.option for trial in found.trials} == {
        text: typed(named[text]) for text in (trial.change for trial in found.trials)
    }
    assert "--travel 0.03" in found.saves or "--travel 0.0225" in found.saves
    assert 0 < len(found.saves) < len(found.trials)
    assert found.unchanged is not None
    for trial in found.remedies:
        scene = plan.itinerary.with_run(named[trial.change])
        again = run_plan(replace(plan, itinerary=scene)).score()
        assert again.completed
        assert again.reason == trial.verdict
        # A sign test: of the pairs that differ, nearly all are gained.
        gained = trial.total - found.unchanged.total
        assert 2.0 ** (1 - gained) < 0.02
    assert found.sentence.startswith("completed with `--")


def test_a_change_alters_one_setting_and_keeps_the_seed(plan: Plan) -> None:
    troubles = {"lag": 0.01, "cart_mass": 0.3, "zero_error": 0.01, "tilt": 0.02, "stuck_at": 1.0}
    scene = plan.itinerary.with_run(troubles, seed=7)
    tried = [change for group in changes(scene) for change in group]
    assert len({change.text for change in tried}) == len(tried)
    options = [typed(change.options) for change in tried]
    for expected in ("--lag 0.005", "--set drive_lag=0.01", "--set sensors.zero_error=0.005",
                     "--set sensors.zero_error=0.0", "--set disturbances.tilt=0.0",
                     "--set sensors.stuck_at=inf", "--set drive.cart_mass=0.0", "--controller adaptive"):  # fmt: skip
        assert expected in options
    assert all(len(change.options) == 1 for change in tried)


def test_options_read_from_a_log_give_the_settings_of_the_command_line(failed: Run, tmp_path: Path) -> None:
    """An adaptive run that gets another law loses the adaptive filter, as on the command line."""
    scene = load_itinerary("outer-turn")
    asked_for = {"mismatch": 0.2, "lag": 0.005, "counts": 4000}
    asked = scene.with_run(asked_for, seed=3)
    log = replace(failed.log, metadata={**failed.log.metadata, **run_metadata(asked)})
    logged = _plan(log, tmp_path)
    assert logged.itinerary.loop == asked.loop
    for change in ({"controller": "tvlqr"}, {"estimator": "ukf"}, {"travel": 0.3, "counts": 0}):
        expected = scene.with_run({**asked_for, **change}, seed=3)
        assert _with_options(logged, scene, change).itinerary.loop == expected.loop


@pytest.mark.parametrize(
    ("before", "done", "beats"),
    [
        # Eight pairs gained and none lost: p = 2 / 256.
        ([False] * 8 + [True] * 8, [True] * 16, True),
        ([False] * 6 + [True] * 10, [True] * 16, False),
        # The failed run gains what its neighbours lose.
        ([False] * 8 + [True] * 8, [True] * 8 + [True] * 7 + [False], False),
        ([True, False] * 8, [False, True] * 8, False),
        ([False] * 16, [], False),
    ],
)
def test_a_change_beats_harmless_ones_by_an_exact_test_of_pairs(
    before: list[bool], done: list[bool], beats: bool
) -> None:
    assert _beats(done, before) is beats


def test_a_run_that_chance_completes_has_no_remedy_and_the_sentence_gives_the_reason() -> None:
    tried = TriedChange("half the lag", "--lag 0.01", completed=True, verdict="", counts=Completed(10, 16, 16))
    found = Why("log", 1, "lost", (tried,), Completed(9, 16, 16))
    assert found.saves == ()
    assert found.sentence == (
        "none of 1 change completes this run more often than harmless changes do; these complete it 9 times in 16, so "
        "chance decides"
    )


@pytest.mark.slow
def test_nothing_is_tried_for_a_run_that_was_completed(plan: Plan) -> None:
    done = run_plan(replace(plan, itinerary=load_itinerary("outer-turn"))).why()
    assert done.trials == ()
    assert done.sentence == "the run was completed, so no change was tried"


def test_only_simulated_runs_can_be_tried_again(failed: Run) -> None:
    log = failed.log
    with pytest.raises(InputError, match="only simulated runs are repeatable"):
        Run(replace(log, metadata={**log.metadata, "rig": "udp://bench:5005"})).why()


@pytest.mark.slow
def test_score_prints_the_remedies(tmp_path: Path, plan: Plan) -> None:
    run_plan(plan, tmp_path / "failed.mcap")
    told = dpcontrol("score", str(tmp_path / "failed.mcap"), "--why", "--json")
    assert told.code == 1
    document = json.loads(told.stdout)
    assert document["why"]["saves"]
    assert document["why"]["sentence"].startswith("completed with `--")
    assert {"change", "option", "completed", "verdict", "helps", "counts"} == set(document["why"]["trials"][0])
    with LogWriter(tmp_path / "bench.mcap", arm_lengths=(0.1, 0.2), rate_hz=1000.0, limits=(0.4, 3.0, 30.0)):
        pass
    refused = dpcontrol("score", str(tmp_path / "bench.mcap"), "--why")
    assert refused.code == 2
