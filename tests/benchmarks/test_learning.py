"""Second runs after `learn`, on twenty random plants of each itinerary, with fresh noise.

Each plant differs from the model by up to ±10 or ±30 % in each mass, length, centre and inertia, and by five times as
much in friction. Its first run is learnt from, and its second run follows the new plan. The noise level is the rms
feedback beyond the feedforward, after the first second, of a run of the old plan with the same noise and initial error
on a plant that equals the model.
About twenty minutes of one core; `-k cross` runs one itinerary alone.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import dpcontrol as dp
from dpcontrol.dynamics.chain import base_ratios, with_laws
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.plans.plan import Plan
from dpcontrol.runs.learning import Learnt, effort
from dpcontrol.runs.run import Run

pytestmark = pytest.mark.benchmark

SCENES = ("outer-turn", "cross", "turn-from-rest")
PLANTS, FRESH = 20, 500
"""Plants of each itinerary, and the distance of a second run's seed from the first's."""
NOISE, SHARE = 1.3, 0.9
"""Noise levels that the effort of a second run may have, and the share of runs that must not have more: 1.27 at most in
57 runs."""
WORSE = 1.1
"""Times the effort of the first run that no second run may have."""
COMPLETED = 0.97
CONSISTENT = (0.5, 2.0)
"""Bounds of the rms of the ratios' errors over their standard errors."""


@pytest.mark.parametrize("name", SCENES)
def test_after_one_run_feedback_only_works_against_noise(name: str) -> None:
    level = np.array([effort_of(dp.run(name, mismatch=0.0, seed=FRESH + seed)) for seed in range(PLANTS)])
    found = [second_run(name, 0.1, seed) for seed in range(PLANTS)]
    after = np.array([one["after"] for one in found])
    beyond = float(np.sqrt(np.mean([np.square(one["errors"]) for one in found])))
    assert np.mean(after <= NOISE * level) >= SHARE
    assert not any(one["after"] > WORSE * one["before"] for one in found)
    assert CONSISTENT[0] < beyond < CONSISTENT[1]


@pytest.mark.parametrize("name", SCENES)
def test_second_runs_of_plants_that_differ_by_thirty_percent_complete(name: str) -> None:
    found = [second_run(name, 0.3, seed) for seed in range(PLANTS)]
    assert np.mean([one["second"] for one in found]) >= COMPLETED


def second_run(name: str, mismatch: float, seed: int) -> dict[str, Any]:
    """Return the figures of a plant's first and second run."""
    first = dp.run(name, mismatch=mismatch, seed=seed)
    before = effort_of(first)
    try:
        learnt = first.learn()
    except GoalMissed as error:
        return {"second": False, "before": before, "missed": str(error)}
    second = again(learnt.plan, first, seed=seed + FRESH)
    return {
        "second": second.converged,
        "before": before,
        "after": effort_of(second),
        "errors": errors_of(learnt, first),
    }


def again(plan: Plan, first: Run, *, seed: int) -> Run:
    loop = replace(plan.itinerary.loop, plant=first.plant, mismatch=0.0)
    return dp.run(replace(plan, itinerary=replace(plan.itinerary, loop=loop)), seed=seed)


def errors_of(learnt: Learnt, first: Run) -> np.ndarray[Any, Any]:
    """Return the errors of the learnt ratios over their standard errors."""
    assert first.plant is not None
    return (learnt.values - base_ratios(with_laws(first.plant, learnt.model.arms.friction))) / learnt.errors


def effort_of(run: Run) -> float:
    return effort(run.log.time, run.log.control["feedback"])
