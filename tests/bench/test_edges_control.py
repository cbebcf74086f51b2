"""Borders of control: foretold ones against runs, and both sides of each; the far side is named by the loop itself."""

import numpy as np
import pytest

from dpcontrol.bench.edges_control import (
    INITIAL_ERROR,
    ROOM,
    SADDLE,
    believed_at,
    delay_border,
    longest_delay,
    loop_matrix,
    mismatch_border,
)
from dpcontrol.control.lqr import HoldSettings, hold_controller
from dpcontrol.loop.batch import run_batch
from dpcontrol.loop.bench import DriveSettings
from dpcontrol.loop.draw import draw_bench
from dpcontrol.loop.loop import LoopSettings, sampled_model
from dpcontrol.loop.result import Ending
from dpcontrol.references.problem import Limits
from dpcontrol.scenes.model import load_model

APART = 0.25  # the bar
RATE = 50.0
LAB = load_model("lab").arms
STATE = load_model("lab").system.equilibrium(SADDLE)


def held(delay: float = 0.0, *, mismatch: float = 0.0, acceleration: float = 30.0, seconds: float = 8.0):
    model = sampled_model(LAB, RATE)
    controller = hold_controller(STATE, model, HoldSettings(), seconds=seconds)
    settings = LoopSettings(
        seed=0,
        rate=RATE,
        initial_error=INITIAL_ERROR,
        mismatch=mismatch,
        drive=DriveSettings(delay=round(delay * RATE)),
    )
    limits = Limits(position=ROOM, velocity=ROOM, acceleration=acceleration)
    run = run_batch(LAB, settings=settings, seeds=[0], controller=controller, limits=limits)[0]
    drawn = draw_bench(LAB, settings.bench, seed=0, ticks=2, period=1 / RATE, initial_error=INITIAL_ERROR)
    error = np.concatenate([drawn.initial_error, np.zeros(4)])
    return run, longest_delay(model, controller.state, error, acceleration=acceleration)


def test_authority_over_a_known_delay_ends_where_it_is_foretold_and_the_loop_says_so():
    _, foretold = held(acceleration=5.0)
    near, _ = held(0.75 * foretold, acceleration=5.0)
    far, _ = held(1.25 * foretold, acceleration=5.0)
    assert near.ending is Ending.FINISHED
    assert np.abs(near.truth[-50:, :2] - STATE[:2]).max() < 0.05
    assert far.ending in (Ending.TRACKING_LOST, Ending.CART_STOP)
    assert "tracking lost" in far.reason or "cart at its stop" in far.reason


def test_more_acceleration_bears_a_longer_delay_by_the_logarithm():
    (_, weak), (_, strong) = held(acceleration=5.0), held(acceleration=30.0)
    # λ of the linearised arms at Down-Up, from their Jacobian in continuous time.
    model = sampled_model(LAB, 1000.0)
    a = model.linearised(np.concatenate([STATE, [0, 0]])[None, :], np.zeros(1))[0][0]
    growth = np.log(np.abs(np.linalg.eigvals(a)).max()) * 1000
    assert strong - weak == pytest.approx(np.log(6) / growth, rel=1e-3)


def test_the_linear_loop_without_mismatch_is_stable_at_any_delay_and_has_the_regulators_multipliers():
    model = sampled_model(LAB, RATE)
    controller = hold_controller(STATE, model, HoldSettings(), seconds=1.0)
    settings = LoopSettings(seed=0, rate=RATE)
    believed = believed_at(model, settings, controller.state)
    a, b = (v[0] for v in model.linearised(controller.state[None, :], np.zeros(1)))
    regulator = np.linalg.eigvals(a - np.outer(b, controller.gain))
    for delay in (0, 1, 5):
        matrix = loop_matrix((a, b), believed, gain=controller.gain, positions=model.position_indices, delay=delay)
        values = np.linalg.eigvals(matrix)
        # Separation: the regulator's multipliers are among the loop's, whatever the filter and the delay.
        assert max(np.abs(values - r).min() for r in regulator) < 1e-6
        assert np.abs(values).max() < 1


def test_mismatch_ends_where_the_eigenvalue_leaves_the_circle():
    found = mismatch_border(LAB, STATE, delay=0.14, rate=RATE, seed=1, ratio=1.15)
    assert found.predicted is not None
    assert found.off is not None
    assert found.off < APART
    assert found.says


def test_far_beyond_the_border_of_mismatch_the_loop_names_what_ended_it():
    foretold = mismatch_border(LAB, STATE, delay=0.14, rate=RATE, seed=0, ratio=10.0).predicted
    assert foretold is not None
    lost, _ = held(0.14, mismatch=min(3 * foretold, 0.8), seconds=20.0)
    assert lost.ending is not Ending.FINISHED
    assert lost.reason


def test_a_slow_loop_has_the_border_of_a_fast_one():
    slow = delay_border(LAB, STATE, rate=40.0, ratio=1.2)
    fast = delay_border(LAB, STATE, rate=80.0, ratio=1.2)
    for found in (slow, fast):
        assert found.off is not None
        assert found.off < APART
    assert slow.predicted == pytest.approx(fast.predicted, rel=1e-3)
