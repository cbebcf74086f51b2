"""Borders of control from both sides, with predictions for holds and the loop's messages."""

from dataclasses import replace

import numpy as np
import pytest

from dpcontrol.bench.edges import (
    STRONG,
    TRIED,
    WEAK,
    WITHOUT_FILTER,
    delay_border,
    followed,
    held_at_rest,
    held_delay_border,
    held_mismatch_border,
    longest_delay,
    loop_matrix,
    mismatch_border,
    moving,
)
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.bench import DriveSettings

APART = 0.25  # the bar
RATE = 50.0
BESIDE = 0.05  # rad: what encoders and the held input leave; in the longest delay the arms turn through a radian
ENDS = ("tracking lost", "cart at its stop")


def predicted_delay(acceleration: float) -> float:
    stand = held_at_rest(RATE)
    error = stand.drawn_error(0.05)
    return longest_delay(stand, error, acceleration=acceleration)


def test_authority_over_a_known_delay_ends_at_the_predicted_and_reported_border():
    stand, predicted = held_at_rest(RATE), predicted_delay(WEAK)
    assert stand.run(acceleration=WEAK, error=0.05, delay=0.75 * predicted).works
    far = stand.run(acceleration=WEAK, error=0.05, delay=1.25 * predicted)
    assert not far.works
    assert any(end in far.says for end in ENDS)


def test_more_acceleration_tolerates_a_longer_delay_by_the_logarithm():
    # λ of the linearised arms at Down-Up, from their Jacobian in continuous time.
    stand = held_at_rest(1000.0)
    a = stand.linear()[0]
    growth = np.log(np.abs(np.linalg.eigvals(a)).max()) * 1000
    assert predicted_delay(30.0) - predicted_delay(5.0) == pytest.approx(np.log(6) / growth, rel=1e-3)


def test_the_linear_loop_without_mismatch_has_the_regulators_multipliers_at_any_delay():
    stand = held_at_rest(RATE)
    a, b = stand.linear()
    regulator = np.linalg.eigvals(a - np.outer(b, stand.controller.gain))
    for delay in (0, 1, 5):
        values = np.linalg.eigvals(loop_matrix((a, b), (a, b), gain=stand.controller.gain, delay=delay))
        # A prediction that is right takes the delay out of the loop: its multipliers are zero.
        assert max(np.abs(values - r).min() for r in regulator) < 1e-6
        assert np.sort(np.abs(values))[:delay] == pytest.approx(np.zeros(delay), abs=0.02)


@pytest.mark.benchmark
def test_mismatch_ends_where_the_eigenvalue_leaves_the_circle():
    found = held_mismatch_border(0.14, ratio=1.15)
    assert found.off is not None
    assert found.off < WITHOUT_FILTER
    assert found.says


@pytest.mark.slow
def test_a_slow_loop_has_the_border_of_a_fast_one():
    slow, fast = (held_delay_border(rate, ratio=1.2) for rate in (40.0, 80.0))
    for found in (slow, fast):
        assert found.off is not None
        assert found.off < APART
    assert slow.predicted == pytest.approx(fast.predicted, rel=1e-3)


def test_commands_on_their_way_at_the_start_belong_to_where_the_motion_leads():
    """However late commands act, a motion that begins on its reference stays there."""
    stand = replace(moving(RATE), near=BESIDE)
    for delay in (0.02, 0.2):
        assert stand.run(acceleration=WEAK, error=0.0, delay=delay).works


def test_lockstep_and_loop_queue_the_same_commands():
    stand = moving(RATE)
    late = replace(stand.settings, seed=3, initial_error=0.01, drive=DriveSettings(delay=10))
    assembly = Assembly(stand.reference, stand.arms, late, law=stand.controller)
    together, alone = assembly.batch([3])[0], assembly.simulate()
    assert alone.ticks.truth is not None
    assert np.abs(together.truth[:40] - alone.ticks.truth[:40]).max() < 1e-9


@pytest.mark.slow
def test_a_moving_reference_tolerates_a_known_delay_up_to_a_reported_border():
    found = delay_border(moving(RATE), error=0.02, ratio=1.2)
    assert found.measured == pytest.approx(0.27, rel=0.15)  # as measured when this was written
    assert "tracking lost" in found.says


@pytest.mark.slow
def test_a_moving_reference_tolerates_a_wrong_model_up_to_a_border_that_the_loop_reports():
    found = mismatch_border(moving(100.0), 0.1, ratio=1.2)
    assert found.measured == pytest.approx(0.107, rel=0.15)  # as measured when this was written
    assert "rad away over its last tenth" in found.says


@pytest.mark.slow
def test_far_beyond_the_border_of_mismatch_the_run_ends_with_its_reason():
    for stand, most in ((moving(RATE), WEAK), (held_at_rest(RATE, seconds=20.0), STRONG)):
        lost = stand.run(acceleration=most, mismatch=0.6, delay=0.14)
        assert not lost.works
        assert any(end in lost.says for end in ENDS)


@pytest.mark.slow
def test_campaigns_end_near_the_margins_of_the_loop():
    held = followed("hold-up-up", "lqr", 8)
    for name, value in held.margins.items():
        key, inside = name.partition("_")[0], 1.25 if name == "gain_low" else 1 / 1.25
        assert held.run(**{key: min(value * inside, TRIED)}).works, name
    # A hold from its very start; what it bears of gain is decided there, and a campaign may bear more.
    for name in ("gain_low", "delay", "lag"):
        outside = 1 / 1.25 if name == "gain_low" else 1.25
        found = held.run(**{name.partition("_")[0]: held.margins[name] * outside})
        assert not found.works, name
        assert found.says
