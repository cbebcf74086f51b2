"""Verdicts, nights and campaigns compare causes and numbers: other sentences change none of them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dpcontrol.judge.night import Night, followed
from dpcontrol.logs.rolling import Digest
from dpcontrol.loop.bench import Push
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.runs.campaign import CampaignSettings, cases_of, run_campaign
from dpcontrol.runs.run import run_plan
from dpcontrol.words import runs as words

BENCH = {"on_fall": "resume", "lag": 0.005, "counts": 4000, "initial_error": 0.05, "mismatch": 0.05, "travel": 0.8}
FALLS = (Push(1.7, 0, 0.02), Push(3.0, 1, 0.02))
"""Blows after which the run of seed 3 falls."""


@pytest.fixture(scope="module")
def plan() -> Plan:
    return make_plan(load_itinerary("outer-turn").with_run(BENCH, seed=3))


def judged(plan: Plan, folder: Path) -> dict[str, Any]:
    """Return all that is judged of a run with falls, of it as a night, and of a campaign with failures."""
    scene = plan.itinerary
    loop = replace(scene.loop, disturbances=replace(scene.loop.disturbances, explicit=FALLS))
    run = run_plan(replace(plan, itinerary=replace(scene, loop=loop)), folder / "run.mcap")
    score = run.score()
    digest = Digest(1, first=0.0, end=run.log.time[-1], ticks=len(run.log.time))
    for event in run.log.events:
        digest.add_event(event)
    digests = (Digest.of(digest.text()),)
    night = Night(folder, digests, (), *followed(digests))
    case = cases_of(scene, fixed={"on_fall": "stop", "mismatch": 0.5}, over={})
    campaign = run_campaign(plan, case, settings=CampaignSettings(runs=6, workers=1, replayed=0))
    texts = ("reason", "verdict", "real_time_factor", "thinking", "log")
    return {
        "score": {key: value for key, value in score.document().items() if key not in texts},
        "fault": (score.verdict.fault, score.verdict.figures, score.attempts),
        "night": (night.causes, night.spans, [fall.back for fall in night.falls], night.stop_hits),
        "campaign": (campaign.summary.reasons, [row["cause"] for row in campaign.rows]),
    }


@pytest.mark.slow
def test_other_sentences_change_no_verdict(plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "before").mkdir()
    (tmp_path / "after").mkdir()
    before = judged(plan, tmp_path / "before")
    assert before["score"]["falls"] >= 1
    assert before["night"][0]
    assert before["campaign"][0]
    for table in (words.SENTENCES, words.ADDITIONS):
        for key in table:
            monkeypatch.setitem(table, key, "nothing to read, 7 of 9 symbols")
    assert judged(plan, tmp_path / "after") == before
