"""Remedies of failed runs: each printed option completes the run when typed and beats harmless changes."""

from dataclasses import replace

import pytest

from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.overrides import typed
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.runs.preflight import changes
from dpcontrol.runs.remedies import Why
from dpcontrol.runs.run import Run, run_plan

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
        gained = trial.counts.total - found.unchanged.total
        assert 2.0 ** (1 - gained) < 0.02
    assert found.sentence.startswith("completed with `--")
