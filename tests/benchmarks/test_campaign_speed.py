"""Campaigns in lockstep, draws and scores included, against the time simulated and the loop tick by tick; CPU time."""

import sys
import time
from dataclasses import replace

import pytest

from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.campaign import CampaignSettings, Job, cases_of, run_job

pytestmark = pytest.mark.benchmark

RUNS = CampaignSettings(runs=1).batch
TRIES = 3
PACE = 300
"""Times quicker than real time on one core."""
BENCH = {"mismatch": 0.05, "initial_error": 0.05, "lag": 0.005, "command_noise": 0.3}


def pace(job: Job) -> float:
    """Return the best of seconds simulated by seconds of this process."""
    best = 0.0
    for _ in range(TRIES):
        began = time.process_time()
        rows = run_job(job)
        best = max(best, sum(row["simulated_seconds"] for row in rows) / (time.process_time() - began))
    return best


def test_lockstep_is_three_hundred_times_quicker_than_time(one_core, hold):
    scene = load_itinerary("outer-turn")
    archive = make_plan(scene).file.read_bytes()
    (case,) = cases_of(scene, fixed=BENCH, over={})
    many = Job(
        scene.name,
        archive,
        scene.model.arms,
        case,
        tuple(range(RUNS)),
        "compiled",
        replayed=0,
    )
    few = replace(many, seeds=(0, 1), path="ticks")
    # The first calls compile. Both ways must come to the same outcomes.
    outcomes = [[(row["seed"], row["completed"]) for row in run_job(job)] for job in (few, many)]
    assert outcomes[0] == outcomes[1][:2]
    together, alone = pace(many), pace(few)
    sys.stdout.write(
        f"\nlockstep {together:.0f} × real time, tick by tick {alone:.1f} ×, ratio {together / alone:.1f}\n"
    )
    hold("campaign: lockstep over tick by tick", together / alone)
    assert together > PACE
