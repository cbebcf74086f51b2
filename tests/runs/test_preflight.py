"""Preflights: rate, endings, borders and changes are those of a campaign's own runs, found once and kept."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dpcontrol.dynamics.chain import Uncertainty, ratio_names
from dpcontrol.foundation.causes import CautionCause
from dpcontrol.foundation.statistics import wilson
from dpcontrol.judge.preflight import HazardBorder, Improvement, Preflight
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.pages.layout import save_figure
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.overrides import typed
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.runs import preflight as module
from dpcontrol.runs.campaign import CampaignSettings, Job, cases_of, run_campaign
from dpcontrol.runs.preflight import (
    ASSUMED_MISMATCH,
    PreflightSettings,
    SettingChange,
    changes,
    preflight,
    with_known_errors,
)
from dpcontrol.runs.remedies import Why
from dpcontrol.runs.run import Run, run_plan

HARD = {"mismatch": 0.2, "initial_error": 0.05, "lag": 0.005, "command_noise": 0.3, "controller": "tvlqr"}
"""Bench on which some runs fail and some do not."""
SMALL = PreflightSettings(runs=16, workers=1, first_seed=40_000)
ROUNDING = 1e-9


def made_up(monkeypatch: pytest.MonkeyPatch, threshold: Any) -> list[Job]:
    """Complete each seed whose settings are below its threshold, and return the requested jobs."""
    asked: list[Job] = []

    def run_job(job: Job) -> list[dict[str, Any]]:
        asked.append(job)
        rows = []
        for seed in job.seeds:
            done = threshold(job.case.loop, np.random.default_rng(seed))
            cause, reason = ("completed", "") if done else ("tracking lost", f"tracking lost at t = {seed} s; try")
            rows.append({"seed": seed, "completed": done, "cause": cause, "reason": reason})
        return rows

    monkeypatch.setattr(module, "run_job", run_job)
    monkeypatch.setattr(module, "kept", lambda file: None)
    monkeypatch.setattr(module, "keep", lambda file, content: None)
    return asked


def border(found: Preflight, setting: str) -> HazardBorder:
    (one,) = (b for b in found.borders if b.setting == setting)
    return one


@pytest.mark.parametrize("median", [0.011, 0.05, 0.2])
def test_a_border_is_the_median_of_the_seeds_own_thresholds(
    median: float, plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Seeds with log-normal thresholds of lag, a third of a factor e wide: the median to two standard errors."""
    made_up(monkeypatch, lambda loop, random: loop.drive.lag < median * math.exp(random.normal() / 3))
    found = preflight(plan, {"lag": 0.003}, settings=PreflightSettings(runs=256, workers=1))
    lag = border(found, "lag")
    assert None not in (lag.border, lag.low, lag.high)
    # The median of 128 has a standard error of √(π/2)/√128 of the thresholds' own.
    assert abs(math.log(lag.border / (1e3 * median))) < 2.5 * 1.2533 / math.sqrt(128) / 3
    assert lag.low < lag.border < lag.high
    assert lag.margin == pytest.approx(lag.border / 3)


def test_borders_where_less_is_worse_are_sought_downward(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    def threshold(loop: LoopSettings, random: np.random.Generator) -> bool:
        return loop.sensors.counts > 300 and (not loop.travel or loop.travel > 0.2 * random.uniform(1, 1.1))

    made_up(monkeypatch, threshold)
    found = preflight(plan, settings=PreflightSettings(runs=128, workers=1))
    counts, travel = border(found, "counts"), border(found, "travel")
    assert counts.border == pytest.approx(300, rel=0.3)
    assert counts.margin == pytest.approx(40_000 / counts.border)
    assert travel.border == pytest.approx(210, rel=0.05)
    # A run without disturbances has no border in the searched range.
    assert border(found, "lag").border is None
    assert border(found, "lag").sentence.startswith("beyond")
    assert (border(found, "belt").own, border(found, "counts").own) == ("none", "40,000 a turn")


def test_a_preflight_names_the_figures_that_explain_its_failures(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    made_up(monkeypatch, lambda loop, random: loop.drive.lag < 0.01)
    found = preflight(plan, {"lag": 0.03}, settings=PreflightSettings(runs=16, workers=1))
    assert {caution.cause for caution in found.warnings} == {CautionCause.LAG}
    assert found.document()["warnings"][0]["remedy"]


def test_a_change_is_worth_what_it_rescues_less_what_it_loses(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half the mismatch saves all runs, other laws lose all, and the rest has no effect."""
    made_up(
        monkeypatch,
        lambda loop, random: (loop.mismatch <= 0.1 or random.uniform() < 0.75) and loop.controller.kind == "tvlqr",
    )
    found = preflight(plan, {**HARD, "mismatch": 0.2}, settings=PreflightSettings(runs=128, workers=1))
    best, worst = found.changes[0], found.changes[-1]
    assert "half the mismatch" in best.text
    assert best.gain == pytest.approx(1 - found.share.rate, abs=ROUNDING)
    assert "adaptive" in worst.text
    assert worst.gain == pytest.approx(-found.share.rate, abs=ROUNDING)
    assert [c.gain for c in found.changes[1:-1]] == [0.0] * (len(found.changes) - 2)
    assert best.text in found.advice
    assert {e.cause for e in found.endings} == {"tracking lost"}
    assert sum(e.runs for e in found.endings) == found.share.runs - found.share.successes


@pytest.mark.slow
def test_its_runs_are_those_of_a_campaign_and_are_kept(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DPCONTROL_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(module, "hazards", lambda plan, scene, **most: [])
    half = {"mismatch": 0.1}
    changed = SettingChange("", half, "half")
    monkeypatch.setattr(module, "changes", lambda scene: [[changed]])
    found = preflight(plan, HARD, settings=SMALL)
    assert found.changes[0].gain > 0
    cases = cases_of(plan.itinerary, fixed=HARD, over={})
    runs = CampaignSettings(runs=16, first_seed=40_000, workers=1, replayed=0)
    campaign = run_campaign(plan, cases, settings=runs)
    assert found.share.successes == campaign.completed.successes
    assert found.share.low == wilson(found.share.successes, 16, confidence=0.99).low
    assert {e.seed for e in found.endings} <= {row["seed"] for row in campaign.results[0].failures}
    # A second preflight runs no job, and its document differs only in time.
    monkeypatch.setattr(module, "run_job", lambda job: pytest.fail("run again"))
    first, second = ({**one.document(), "seconds": 0} for one in (found, preflight(plan, HARD, settings=SMALL)))
    assert first == second
    # Damaged parts are run again.
    for part in (tmp_path / "cache" / "preflights").iterdir():
        part.write_bytes(part.read_bytes()[:-1] + b"x")
    with pytest.raises(pytest.fail.Exception, match="run again"):
        preflight(plan, HARD, settings=SMALL)
    save_figure(found.plot(), tmp_path / "page.pdf")
    assert (tmp_path / "page.pdf").stat().st_size > 10_000
    json.dumps(first)


def test_arms_are_drawn_from_their_known_errors(plan: Plan) -> None:
    scene = plan.itinerary
    assert with_known_errors(scene, {})[0].loop.mismatch == scene.loop.mismatch
    unknown, listed = with_known_errors(replace(scene, loop=replace(scene.loop, mismatch=0.0)), {})
    assert unknown.loop.mismatch == ASSUMED_MISMATCH
    assert listed[0].source.startswith("assumed")
    # A mismatch of zero by name means none.
    assert with_known_errors(scene, {"mismatch": 0.0})[0].loop.mismatch == 0
    names = ratio_names(scene.model.arms)
    covariance = tuple((1e-4 * np.eye(len(names))).ravel().tolist())
    model = replace(scene.model, uncertainty=Uncertainty(names, covariance))
    known, listed = with_known_errors(replace(scene, model=model), {})
    assert (known.loop.model_uncertainty, known.loop.mismatch) == (1.0, 0.0)
    assert listed[0].source.startswith("identified")
    assert with_known_errors(replace(scene, model=model), {"mismatch": 0.1})[0].loop.model_uncertainty == 0


def test_a_gain_and_its_error_weigh_both_kinds_of_seeds() -> None:
    change = Improvement("x", {}, rescued=12, failing=24, lost=3, completing=48, rate=0.8)
    assert change.gain == pytest.approx(0.2 * 0.5 - 0.8 / 16)
    up, down = 14 / 28, 5 / 52
    assert change.error**2 == pytest.approx(0.04 * up * (1 - up) / 28 + 0.64 * down * (1 - down) / 52)


SHORT = {"controller": "tvlqr", "travel": 0.015, "mismatch": 0.0}
"""A track that the plan itself nearly fills."""


@pytest.fixture(scope="module")
def short_track() -> Plan:
    return make_plan(load_itinerary("outer-turn").with_run(SHORT))


@pytest.fixture(scope="module")
def failed(short_track: Plan) -> Run:
    return run_plan(short_track)


@pytest.fixture(scope="module")
def found(failed: Run) -> Why:
    return failed.why(workers=1)


@pytest.mark.slow
def test_each_remedy_completes_the_run_and_beats_harmless_changes(short_track: Plan, found: Why, failed: Run) -> None:
    assert failed.score().completed is False
    assert found.reason == failed.score().reason
    named = {change.text: change.options for group in changes(short_track.itinerary) for change in group}
    assert {trial.change: trial.option for trial in found.trials} == {
        text: typed(named[text]) for text in (trial.change for trial in found.trials)
    }
    assert "--travel 0.03" in found.saves or "--travel 0.0225" in found.saves
    assert 0 < len(found.saves) < len(found.trials)
    for trial in found.remedies:
        scene = short_track.itinerary.with_run(named[trial.change])
        again = run_plan(replace(short_track, itinerary=scene)).score()
        assert again.completed
        assert again.reason == trial.verdict
        # A sign test: of the pairs that differ, nearly all are gained.
        gained = trial.counts.total - found.unchanged.total
        assert 2.0 ** (1 - gained) < 0.02
    assert found.sentence.startswith("completed with `--")
