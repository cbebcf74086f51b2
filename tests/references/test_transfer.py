"""Swing-ups, landings and joined pieces."""

import numpy as np
import pytest
from flown_again import gaps
from shadowing_stand_in import LAB

from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.references.find import TransferSettings, find_transfer, smooth_guess
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits, ReferenceSettings
from dpcontrol.references.reference import joined, still

EQUATIONS = arm_chain_equations(2, Level.CART)
SETTINGS = ReferenceSettings(method="radau-7", interval=0.05)
HANGING = np.zeros(6)
UP = np.array([np.pi, np.pi, 0, 0, 0, 0.0])


@pytest.fixture(scope="module")
def swing_up():
    return find_transfer(EQUATIONS, LAB.base(), start=HANGING, ends=[UP], limits=Limits(), settings=SETTINGS)


@pytest.mark.slow
def test_a_swing_up_satisfies_the_equations_of_motion(swing_up):
    assert swing_up.converged
    assert np.abs(swing_up.state(0.0) - HANGING).max() < 1e-12
    assert np.abs(swing_up.state(swing_up.duration) - UP).max() < 1e-9
    for name, bound in Limits().named().items():
        assert swing_up.largest[name] <= bound + 1e-9
    assert gaps(swing_up, LAB).max() < 1e-6


def test_an_impossible_transfer_is_reported_with_the_cause():
    tight = Limits(position=0.01, velocity=0.05, acceleration=0.2)
    with pytest.raises(
        GoalMissed, match=r"no transfer in 0.5 s within .*without limits it takes a cart (position|velocity|accel)"
    ):
        find_transfer(
            EQUATIONS, LAB.base(), start=HANGING, ends=[UP], limits=tight, settings=SETTINGS,
            transfer=TransferSettings(durations=(0.5,), longer=(), iterations=200),
        )  # fmt: skip


@pytest.mark.slow
def test_the_least_sensitive_motion_within_margins_is_selected():
    """Of two durations, the one with the smaller error growth is selected, although the other has less effort."""
    asked = {}

    def sensitivity(motion):
        asked[motion.duration] = 100.0 if motion.duration == 2.5 else 1.0
        return asked[motion.duration]

    coarse = ReferenceSettings(method="radau-5", interval=0.1, tolerance=1e-3)
    found = find_transfer(
        EQUATIONS, LAB.base(), start=HANGING, ends=[UP], limits=Limits(), settings=coarse,
        transfer=TransferSettings(durations=(2.5, 2.0), gentle=1.0, interval=0.1), sensitivity=sensitivity,
    )  # fmt: skip
    assert set(asked) == {2.5, 2.0}
    assert found.duration == 2.0


def test_longer_durations_are_tried_after_failures():
    coarse = ReferenceSettings(method="radau-5", interval=0.1, tolerance=1e-3)
    found = find_transfer(
        EQUATIONS, LAB.base(), start=HANGING, ends=[UP], limits=Limits(), settings=coarse,
        transfer=TransferSettings(durations=(0.1,), longer=(2.0,), gentle=1.0, interval=0.1),
    )  # fmt: skip
    assert found.duration == 2.0


def test_the_guess_turns_the_arms_smoothly():
    start, end = np.array([0.1, -0.2, 3.0, 4.0]), np.array([2.0, 1.0, -5.0, 6.0])
    guess = smooth_guess(start, end, 1.7)
    times = np.linspace(0, 1.7, 4001)
    states = guess(times)
    assert states[0] == pytest.approx([0.1, -0.2, 0, 0], abs=1e-14)
    assert states[-1] == pytest.approx([2.0, 1.0, 0, 0], abs=1e-12)
    slope = np.gradient(states[:, :2], times, axis=0)
    assert np.abs(slope - states[:, 2:])[1:-1].max() < 1e-4


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
