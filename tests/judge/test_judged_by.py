"""Simulated runs are judged by the true plant and its applied acceleration, runs on a rig by the estimate."""

from dataclasses import replace

import numpy as np
import pytest

from dpcontrol.cli.review import shortfall
from dpcontrol.judge.score import HARDEST_METADATA, score
from dpcontrol.logs import RunLog
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.run import run_plan


@pytest.fixture(scope="module")
def log() -> RunLog:
    return run_plan(make_plan(load_itinerary("outer-turn"))).log


def with_applied(log: RunLog, row: int, value: float) -> RunLog:
    """Return the log with another acceleration in the loop's own figures."""
    applied = log.controls["applied"].copy()
    applied[row] = value
    return replace(log, controls={**log.controls, "applied": applied})


def without_note(log: RunLog) -> RunLog:
    return replace(log, metadata={k: v for k, v in log.metadata.items() if k != HARDEST_METADATA})


@pytest.mark.slow
def test_a_simulated_run_notes_the_largest_acceleration_that_its_drive_applied(log: RunLog) -> None:
    """Without a cart's mass, command noise or blows it is the largest change of the true velocity."""
    true = np.abs(np.diff(log.states["truth"][:, -1])).max() * log.rate_hz
    assert float(log.metadata[HARDEST_METADATA]) == pytest.approx(true, rel=1e-6)
    assert score(log).document()["judged_by"] == "truth"


def test_wrong_assumptions_on_the_drive_fail_no_simulated_run(log: RunLog) -> None:
    wrong = with_applied(log, 700, 98.3)
    assert score(wrong).completed
    assert score(without_note(wrong)).completed


def test_a_drive_that_really_went_beyond_its_limit_fails_the_run(log: RunLog) -> None:
    found = score(replace(log, metadata={**log.metadata, HARDEST_METADATA: "41.5"}))
    assert found.completed is False
    assert "41.5" in found.reason


def test_without_the_true_state_the_verdict_uses_the_estimate_and_reports_this(log: RunLog) -> None:
    measured = replace(without_note(log), states={k: v for k, v in log.states.items() if k != "truth"})
    found = score(measured)
    assert (found.completed, found.judged_by) == (None, "estimate")
    assert not shortfall(found)
    assert shortfall(replace(found, symbols_completed=0))
    assert "acceleration" in score(with_applied(measured, 700, 98.3)).reason
