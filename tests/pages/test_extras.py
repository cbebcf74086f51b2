"""Augmented estimates are logged and drawn, with the truth of a simulated log beside them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dpcontrol.judge.of_log import run_view
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.run import Run, run_plan

SIGMAS = 5.0
FOUND = 2e-3
"""Of an inertia's or a weight's ratio: what the filter's own noise leaves after a turn."""
KNOWN = ("M11", "M22", "S1", "S2")


def run_of(log: Path | None = None, **options: float | str) -> Run:
    plan = make_plan(load_itinerary("outer-turn"))
    return run_plan(replace(plan, itinerary=plan.itinerary.with_run({**options}, seed=3)), log)


@pytest.fixture(scope="module")
def adaptive(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A turn on a plant that is off by up to 5 %, logged."""
    return run_of(tmp_path_factory.mktemp("run") / "run.mcap", controller="adaptive", mismatch=0.05, travel=0.8)


@pytest.mark.slow
def test_the_estimates_of_a_log_end_at_its_plants_ratios(adaptive: Run) -> None:
    plant, model = adaptive.plant, load_itinerary("outer-turn").model.arms
    assert plant is not None
    view = run_view(adaptive.log)
    extras = view.extras
    assert extras is not None
    assert extras.names[-4:] == KNOWN
    # By hand, from the physical parameters: M12 = (m2 a2) l1, S1 = m1 a1 + m2 l1, M22 = J2 + m2 a2².
    ratios = []
    for arms in (plant, model):
        (m1, m2), (a1, a2), (l1, _), (_, j2) = arms.mass, arms.centre_of_mass, arms.length, arms.inertia
        ratios.append(np.array([m1 * a1 + m2 * l1, j2 + m2 * a2**2]) / (m2 * a2 * l1))
    by_hand = ratios[0] / ratios[1] - 1
    assert [view.extra_truth["S1"], view.extra_truth["M22"]] == pytest.approx(by_hand.tolist(), abs=1e-12)
    for name in KNOWN:
        column = extras.names.index(name)
        away = abs(extras.values[-1, column] - view.extra_truth[name])
        assert away <= max(SIGMAS * extras.sigmas[-1, column], FOUND), name
