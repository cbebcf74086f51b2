"""Campaigns: what is counted and kept, and that the table is the same whoever ran it and whatever died meanwhile."""

import json
import math
import multiprocessing
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.stats import norm

from dpcontrol.control.tracking import TvlqrSettings
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import no_progress
from dpcontrol.foundation.statistics import paired, wilson
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan
from dpcontrol.runs import campaign as workers
from dpcontrol.runs.campaign import (
    LEVELS,
    STANDARD,
    Campaign,
    CampaignSettings,
    cases_of,
    run_campaign,
    standard_cases,
    standard_scores,
)

DIGITS = 1e-12
"""Of an interval: two ways to add up the same terms."""
HARD = {"mismatch": 0.15, "initial_error": 0.1}
"""Bench on which some runs fail and some do not."""


def read_rows(file: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """A campaign's rows in order, and its metadata, as others read them."""
    table = pq.read_table(file)
    return table.to_pylist(), json.loads(table.schema.metadata[b"dpcontrol.campaign"])


def campaign(
    plan: Plan, file: Path, *, over: dict[str, Any] | None = None, progress: Any = no_progress, **settings: Any
) -> Campaign:
    cases = cases_of(plan.itinerary, fixed=HARD, over=over or {})
    chosen = CampaignSettings(**{"runs": 16, "workers": 1, "batch": 4, "replayed": 1, **settings})
    return run_campaign(plan, cases, file, settings=chosen, progress=progress)


@pytest.fixture(scope="module")
def undisturbed(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """The rows of 16 runs in four jobs, by one process that nothing happened to."""
    file = tmp_path_factory.mktemp("campaign") / "whole.parquet"
    campaign(plan, file)
    return read_rows(file)[0]


@pytest.mark.parametrize(("successes", "runs"), [(0, 10), (7, 10), (990, 1000)])
def test_shares_have_wilsons_interval_by_its_formula(successes: int, runs: int) -> None:
    z, share = norm.ppf(0.975), successes / runs
    middle = (share + z**2 / (2 * runs)) / (1 + z**2 / runs)
    half = z / (1 + z**2 / runs) * math.sqrt(share * (1 - share) / runs + z**2 / (4 * runs**2))
    found = wilson(successes, runs)
    assert (found.low, found.high) == pytest.approx((max(middle - half, 0), min(middle + half, 1)), abs=DIGITS)
    assert found.rate == share


def test_pairs_are_counted_by_seed_and_judged_by_mcnemars_sum() -> None:
    first, second = [1, 1, 1, 1, 0, 0, 1], [0, 0, 0, 1, 1, 0, 0]
    found = paired(first, second)
    assert (found.only_first, found.only_second, found.pairs) == (4, 1, 7)
    # Five differing pairs, one of them the other way: 2 (C(5,0) + C(5,1)) / 2⁵.
    assert found.p_value == pytest.approx(2 * (1 + 5) / 32)
    assert paired([1, 0], [1, 0]).p_value == 1.0


@pytest.mark.slow
def test_cases_run_the_same_seeds_and_are_compared_in_pairs(plan: Plan, tmp_path: Path) -> None:
    file = tmp_path / "pairs.parquet"
    over = {"controller": ["tvlqr", "feedforward"]}
    found = campaign(plan, file, over=over, runs=8, batch=8, first_seed=5, replayed=4)
    rows, metadata = read_rows(file)
    seeds = [[row["seed"] for row in rows if row["controller"] == name] for name in ("tvlqr", "feedforward")]
    assert seeds == [list(range(5, 13))] * 2
    tracked, replayed = (r.completed for r in found.results)
    assert tracked.successes > 0 == replayed.successes
    ((_, _, pair),) = found.pairs
    assert (pair.only_first, pair.only_second) == (tracked.successes, 0)
    assert found.completed.runs == 16
    assert metadata["settings"]["first_seed"] == 5
    for row in found.results[1].failures:
        # Some turn by the reference's input alone, but none stays on the last orbit.
        assert (row["symbol"], row["symbols_completed"]) in {("down-up +", 0), ("", 1)}
        assert row["reason"]
    asked = [row["replays"] for row in found.results[1].failures]
    assert asked == [True] * 4 + [None] * 4


@pytest.mark.slow
def test_an_interrupted_campaign_continues(
    plan: Plan, undisturbed: list[dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "stopped.parquet"

    def stop(what: str, done: float) -> None:
        if what.startswith("2 of"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        campaign(plan, file, progress=stop)
    # The files of finished jobs are a table.
    assert read_rows(file)[0] == undisturbed[:8]
    begun = []
    run_job = workers.run_job
    monkeypatch.setattr(workers, "run_job", lambda job: begun.append(job.key) or run_job(job))
    campaign(plan, file)
    assert len(begun) == 2
    assert read_rows(file)[0] == undisturbed
    # A longer campaign uses the rows of the shorter one, whose last job it replaces if this has fewer seeds.
    assert campaign(plan, file, runs=20).rows[:16] == tuple(undisturbed)
    assert len(begun) == 3


@pytest.mark.slow
def test_a_killed_process_changes_nothing_in_the_table(
    plan: Plan, undisturbed: list[dict[str, Any]], tmp_path: Path
) -> None:
    file, killed = tmp_path / "killed.parquet", []

    def kill(what: str, done: float) -> None:
        if not killed and " of " in what:
            process = multiprocessing.active_children()[0]
            killed.append(process.pid)
            os.kill(process.pid, signal.SIGKILL)

    with pytest.raises(GoalMissed, match="run the same command again"):
        campaign(plan, file, workers=2, progress=kill)
    assert killed
    campaign(plan, file, workers=2)
    assert read_rows(file)[0] == undisturbed


def test_each_case_has_its_values_as_its_name() -> None:
    varied = {"lag": np.array([0.001, 0.0010000001]), "play": [(0.1, 0.2), 0.1]}
    cases = cases_of(load_itinerary("hold-down-down"), fixed={}, over=varied)
    lags, plays = ("lag=0.001", "lag=0.0010000001"), ("play=[0.1,0.2]", "play=0.1")
    assert [case.label for case in cases] == [f"{lag}, {play}" for lag in lags for play in plays]
    # Two cases of one name would be counted as one.
    with pytest.raises(InputError, match="lag=0 is listed twice"):
        cases_of(load_itinerary("hold-down-down"), fixed={}, over={"lag": [0, 0.1, 0.0]})


def test_the_standard_has_nine_kinds_of_twenty_one_levels_each(plan: Plan) -> None:
    cases = standard_cases(plan.itinerary, fixed={}, controllers=["tvlqr", "feedforward"])
    assert len(cases) == 2 * 9 * LEVELS == len({case.label for case in cases})
    by_kind = {
        kind.score: [c.loop for c in cases[: 9 * LEVELS] if dict(c.values)["kind"] == kind.score] for kind in STANDARD
    }
    assert [loop.mismatch for loop in by_kind["model error"]] == pytest.approx(np.linspace(0, 0.25, 21))
    assert [loop.drive.delay for loop in by_kind["delay"]] == pytest.approx(np.linspace(0, 300, 21))
    assert [loop.drive.response for loop in by_kind["response"]] == pytest.approx(np.linspace(0.1, 2, 21))
    assert by_kind["quantisation"][-1].sensors.counts == 16
    assert {loop.disturbances.pushes for loop in by_kind["pushes"]} == {3}
    assert isinstance(cases[0].loop.controller, TvlqrSettings)


@pytest.mark.slow
def test_a_score_is_the_mean_share_over_the_kinds(plan: Plan, tmp_path: Path) -> None:
    every = standard_cases(plan.itinerary, fixed={}, controllers=["tvlqr"])
    chosen = [case for case in every if dict(case.values)["level"] in (0.0, 20.0)]
    settings = CampaignSettings(runs=2, workers=1, replayed=0)
    found = run_campaign(plan, chosen[-2:] + chosen[:2], tmp_path / "score.parquet", settings=settings)
    (score,) = standard_scores(found.results)
    assert set(score.kinds) == {"encoder zeros", "model error"}
    assert all(share.runs == 4 for share in score.kinds.values())
    assert score.total == pytest.approx(sum(s.successes / 4 for s in score.kinds.values()) / 2)


def test_jobs_that_differ_in_a_setting_differ_in_their_keys() -> None:
    itinerary = load_itinerary("outer-turn")
    changes = ({}, {"mismatch": 0.5}, {"controller": "tvlqr"}, {"supervisor.lost_tracking": 1.0}, {"drive.lag": 0.001})
    keys = {
        workers.Job("turn", b"", itinerary.model.arms, case, (0,), "ticks").key
        for change in changes
        for case in [workers.Case("", (), itinerary.with_run(change, seed=0).loop)]
    }
    assert len(keys) == len(changes)
