"""Swing-ups, landings and joined pieces."""

import numpy as np
import pytest
from flown_again import gaps
from shadowing_stand_in import LAB

from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.plans.layout import GENTLE, SHORTEST, Pace
from dpcontrol.plans.model import load_model
from dpcontrol.plans.transfers import ROOM, Transfer, find_transfer
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits, ReferenceSettings
from dpcontrol.references.reference import joined, still

SETTINGS = ReferenceSettings(method="radau-7", interval=0.05)
COARSE = ReferenceSettings(method="radau-5", interval=0.1, tolerance=1e-3)
HANGING = (0.0,) * 6
UP = np.array([np.pi, np.pi, 0, 0, 0, 0.0])
SINGLE = load_model("single").arms
SAME_MOTION = 1e-6  # rad, and relative to lengths and rates: solvers stop at 1e-9


def swing(pace: Pace, *, limits: Limits | None = None) -> Transfer:
    return Transfer("", "lab", LAB, limits or Limits(), SETTINGS, HANGING, (tuple(UP.tolist()),), pace)


@pytest.fixture(scope="module")
def swing_up():
    return find_transfer(swing(GENTLE))


@pytest.mark.slow
def test_a_swing_up_satisfies_the_equations_of_motion(swing_up):
    assert swing_up.converged
    assert np.abs(swing_up.state(0.0) - HANGING).max() < 1e-12
    assert np.abs(swing_up.state(swing_up.duration) - UP).max() < 1e-9
    for name, bound in Limits().named().items():
        # A gentle transfer leaves room for feedback.
        assert swing_up.largest[name] <= ROOM * bound + 1e-9
    assert gaps(swing_up, LAB).max() < 1e-6


def test_an_impossible_transfer_is_reported_with_the_cause():
    tight = Limits(position=0.01, velocity=0.05, acceleration=0.2)
    with pytest.raises(
        GoalMissed, match=r"no transfer in 0.5 s within .*without limits it takes a cart (position|velocity|accel)"
    ):
        find_transfer(swing(0.5, limits=tight))


@pytest.mark.slow
def test_a_transfer_takes_the_time_that_was_asked_for_or_the_shortest_one(swing_up):
    given = find_transfer(swing(2.2))
    assert given.duration == pytest.approx(2.2)
    shortest = find_transfer(swing(SHORTEST))
    assert shortest.duration < 1.5 < given.duration < swing_up.duration
    for found in (given, shortest):
        assert gaps(found, LAB).max() < 1e-6
        halves = found.state(found.duration)[:2] / np.pi
        assert halves == pytest.approx(np.rint(halves))


@pytest.mark.parametrize("pace", [GENTLE, 2.0])
def test_arms_of_any_size_get_the_same_motion(pace):
    """In ten times the length and at the pace of its square root, with limits in proportion."""
    size, time = 10.0, 10**0.5
    limits = Limits(position=0.4 * size, velocity=3.0 * time, acceleration=30.0)
    ends = (0.0,) * 4, ((np.pi, 0.0, 0.0, 0.0),)
    small = find_transfer(Transfer("", "single", SINGLE, Limits(), COARSE, *ends, pace))
    longer = pace * time if isinstance(pace, float) else pace
    large = find_transfer(Transfer("", "large", SINGLE.scaled(size, time), limits, COARSE, *ends, longer))
    assert large.duration == pytest.approx(small.duration * time, rel=SAME_MOTION)
    times = np.linspace(0.0, small.duration, 200)
    scaled = large.state(times * time) / [1.0, 1 / time, size, time]
    assert np.abs(scaled - small.state(times)).max() < SAME_MOTION * max(1.0, np.abs(scaled).max())
    assert np.abs(large.input(times * time) - small.input(times)).max() < SAME_MOTION * np.abs(small.inputs).max()


@pytest.mark.slow
def test_pieces_are_joined_in_time_and_jumps_are_detected(swing_up):
    method = method_named("radau-7")
    hold = still(UP, 0.5, method=method, limits=Limits(), interval=0.1)
    whole, begins = joined([swing_up, hold])
    assert begins == pytest.approx([0.0, swing_up.duration, swing_up.duration + 0.5])
    assert whole.duration == pytest.approx(begins[-1])
    assert whole.constraint_violation < 1e-9
    for t in (0.3, 1.1, swing_up.duration - 0.01):
        assert whole.state(t) == pytest.approx(swing_up.state(t), abs=1e-12)
    assert whole.state(swing_up.duration + 0.2) == pytest.approx(UP, abs=1e-12)
    _, jump = joined([swing_up, hold])[0], joined([hold, swing_up])[0]
    assert jump.constraint_violation == pytest.approx(1.0)
    effort = swing_up.rms_cart_acceleration**2 * swing_up.duration
    assert whole.rms_cart_acceleration**2 * whole.duration == pytest.approx(effort)
