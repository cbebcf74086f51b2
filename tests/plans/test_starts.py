"""Plans with ways from rest to their stops: what is planned, kept and judged for runs that go on after a fall."""

from dataclasses import replace

import numpy as np
import pytest

from dpcontrol.foundation.errors import InputError
from dpcontrol.loop.bench import Push
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.run import check_exportable, repeat_run, run_plan

RESUME = {"on_fall": "resume", "lag": 0.005, "mismatch": 0.05, "travel": 0.8}


@pytest.fixture(scope="module")
def plan():
    scene = load_itinerary("outer-turn").with_run(RESUME, seed=3)
    blows = (Push(1.7, 0, 0.02), Push(3.0, 1, 0.02))
    loop = replace(scene.loop, disturbances=replace(scene.loop.disturbances, explicit=blows))
    return make_plan(replace(scene, loop=loop))


@pytest.mark.slow
def test_each_stop_has_a_way_from_rest_that_ends_on_the_reference(plan) -> None:
    starts = plan.content.starts
    assert [start.stop for start in starts] == [0, 1]
    for start in starts:
        lead_in = plan.reference.lead_in(start)
        assert lead_in is not None
        np.testing.assert_allclose(lead_in.state(0.0), 0.0, atol=1e-9)
        meets = plan.reference.state(start.at) - lead_in.state(lead_in.duration)
        meets[:2] -= 2 * np.pi * np.array(start.turns)
        np.testing.assert_allclose(meets, 0.0, atol=1e-6)


@pytest.mark.slow
def test_a_plan_is_the_same_with_starts_and_without(plan) -> None:
    alone = make_plan(load_itinerary("outer-turn"))
    np.testing.assert_array_equal(alone.reference.states, plan.reference.states)
    assert not alone.content.starts
    assert make_plan(plan.itinerary).cached


@pytest.mark.slow
def test_a_run_that_fell_and_was_done_again_is_completed_and_repeats_itself(plan, tmp_path) -> None:
    log = tmp_path / "fell.mcap"
    verdict = run_plan(plan, log).score()
    assert verdict.completed
    assert verdict.falls == 1
    assert verdict.attempts == (2,)
    assert "after 1 fall" in verdict.sentence
    assert verdict.rms_tracking_error < 0.5
    assert repeat_run(log, tmp_path / "again.mcap").comparison.difference is None


@pytest.mark.slow
def test_recovery_from_falls_cannot_be_exported_to_c(plan) -> None:
    with pytest.raises(InputError, match='export with on_fall = "stop"'):
        check_exportable(plan.itinerary)
