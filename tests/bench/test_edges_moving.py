"""Borders of control on a moving reference: foretold ones against runs, both sides of each; the linear loop."""

from dataclasses import replace

import numpy as np
import pytest

from dpcontrol.bench.edges_control import ROOM
from dpcontrol.bench.edges_moving import delay_border, foretold, mismatch_border, path_at
from dpcontrol.loop.batch import run_batch
from dpcontrol.loop.bench import DriveSettings
from dpcontrol.loop.draw import draw_bench
from dpcontrol.loop.loop import LoopSettings, run_loop
from dpcontrol.loop.result import Ending
from dpcontrol.references.problem import Limits
from dpcontrol.scenes.itinerary import load_itinerary
from dpcontrol.scenes.plan import make_plan

APART = 0.25  # the bar
RATE = 50.0
LIMITS = Limits(position=ROOM, velocity=ROOM, acceleration=5.0)
BESIDE = 0.05  # rad: what encoders and the held input leave; in the longest delay the arms turn through a radian


def settings(delay: float, error: float = 0.0) -> LoopSettings:
    return LoopSettings(seed=0, rate=RATE, initial_error=error, drive=DriveSettings(delay=round(delay * RATE)))


def test_commands_on_their_way_at_the_start_belong_to_where_the_motion_leads():
    """However late commands act, a motion that begins on its reference stays there."""
    path = path_at(RATE)
    for delay in (0.02, 0.2):
        run = run_batch(path.arms, settings=settings(delay), seeds=[0], controller=path.controller, limits=LIMITS)[0]
        assert run.ending is Ending.FINISHED
        assert np.abs(run.truth[:, :2] - run.references).max() < BESIDE


def test_lockstep_and_loop_queue_the_same_commands():
    path = path_at(RATE)
    late = replace(settings(0.2, 0.01), seed=3)
    reference = make_plan(load_itinerary("outer-turn")).reference
    limits = late.limits(reference)
    together = run_batch(path.arms, settings=late, seeds=[3], controller=path.controller, limits=limits)[0]
    alone = run_loop(reference, path.arms, settings=late, controller=path.controller)
    assert alone.ticks.truth is not None
    assert np.abs(together.truth[:40] - alone.ticks.truth[:40]).max() < 1e-9


def test_a_known_delay_is_borne_up_to_where_it_is_foretold_and_then_the_loop_says_so():
    found = delay_border(rate=RATE, ratio=1.2)
    assert found.off is not None
    assert found.off < APART
    assert "tracking lost" in found.says


def test_a_wrong_model_is_borne_up_to_where_it_is_foretold_and_then_the_loop_says_so():
    found = mismatch_border(delay=0.1, ratio=1.2)
    assert found.off is not None
    assert found.off < APART
    assert "tracking lost" in found.says


def test_the_linear_loop_strays_more_for_a_larger_error_and_less_authority():
    path = path_at(RATE)
    drawn = draw_bench(path.arms, settings(0.0).bench, seed=0, ticks=2, period=1 / RATE, initial_error=0.02)
    error = np.concatenate([drawn.initial_error, np.zeros(4)])

    def holds(size: float, acceleration: float) -> bool:
        return foretold(path, delay=6, acceleration=acceleration, truth=path.model, error=size * error)

    assert holds(1.0, 5.0)
    assert not holds(30.0, 5.0)
    assert not holds(1.0, 0.05)


@pytest.mark.parametrize("delay", [0.04])
def test_far_beyond_the_border_of_mismatch_the_run_ends_with_its_reason(delay):
    path = path_at(RATE)
    wrong = replace(settings(delay), mismatch=0.6)
    run = run_batch(path.arms, settings=wrong, seeds=[0], controller=path.controller, limits=LIMITS)[0]
    assert run.ending is not Ending.FINISHED
    assert run.reason
