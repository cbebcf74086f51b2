"""What the loop believes about its own commands, against superposition: each command acts for one period, shifted by
the delay, and a period's mean is the sum of what overlaps it.
"""

from itertools import pairwise

import numpy as np
import pytest

from dpcontrol.foundation.errors import InputError
from dpcontrol.loop.loop import CommandPath
from dpcontrol.references.problem import Limits

EXACT = 1e-12  # Sums of a few numbers of order ten.
PERIOD = 1e-3
WIDE = Limits(position=10.0, velocity=1e6, acceleration=1e6)
DELAYS = [0.0, 0.2, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 2.6, 7.0, 7.99]


def superposed(commands: np.ndarray, delay: float, first: int, last: int) -> np.ndarray:
    """Return the mean of what acts in each period from `first` up to `last`, command k acting in [k + d, k + d + 1)."""
    means = []
    for period in range(first, last):
        mean = 0.0
        for k, command in enumerate(commands):
            begin, end = max(k + delay, period), min(k + delay + 1, period + 1)
            mean += max(end - begin, 0.0) * command
        means.append(mean)
    return np.array(means)


@pytest.mark.parametrize("delay", DELAYS)
def test_what_acted_is_the_superposition_of_the_commands(delay: float) -> None:
    commands = np.random.default_rng(1).normal(0, 10, 40)
    path = CommandPath(WIDE, delay=delay, period=PERIOD)
    acted = []
    for command in commands:
        path.send(float(command))
        acted.append(path.acted(0.0))
    # After command k has been sent, tick k's period ends.
    assert acted == pytest.approx(superposed(commands, delay, 0, 40), abs=EXACT)


@pytest.mark.parametrize("delay", DELAYS)
def test_what_is_on_its_way_is_what_will_act_until_the_next_command_can(delay: float) -> None:
    commands = np.random.default_rng(2).normal(0, 10, 40)
    path = CommandPath(WIDE, delay=delay, period=PERIOD)
    for k, command in enumerate(commands):
        coming = path.on_their_way()
        assert len(coming) == path.lead == round(delay)
        known = commands[:k]
        # Command k, not yet sent, may still act in a part of the last of these periods where the delay was rounded up;
        # until it is known the newest stands for it.
        held = np.append(known, known[-1] if k else 0.0)
        expected = superposed(held, delay, k, k + path.lead)
        assert coming == pytest.approx(expected, abs=EXACT)
        path.send(float(command))


@pytest.mark.parametrize("delay", [0.0, 1.0, 2.5])
def test_the_velocity_is_the_sum_of_all_that_was_sent_within_the_limits(delay: float) -> None:
    limits = Limits(position=1.0, velocity=0.05, acceleration=20.0)
    path = CommandPath(limits, delay=delay, period=PERIOD)
    path.start([5.0], velocity=-0.01)
    velocity = -0.01 + 5.0 * PERIOD
    for command in (50.0, 10.0, 20.0, 20.0, -100.0, 3.0):
        path.send(command)
        velocity = float(np.clip(velocity + np.clip(command, -20, 20) * PERIOD, -0.05, 0.05))
        assert path.velocity == pytest.approx(velocity, abs=EXACT)


def test_braking_brings_what_was_sent_to_rest_and_not_beyond() -> None:
    path = CommandPath(Limits(position=1.0, velocity=3.0, acceleration=20.0), delay=3.0, period=PERIOD)
    path.start([], velocity=0.123)
    speeds = []
    for _ in range(20):
        path.send(path.braking(0.5))
        speeds.append(path.velocity)
    assert all(later <= earlier for earlier, later in pairwise(speeds))
    assert speeds[11] > 0
    assert speeds[12:] == pytest.approx([0.0] * 8, abs=EXACT)


def test_a_cart_at_its_fastest_takes_only_what_slows_it() -> None:
    path = CommandPath(Limits(position=1.0, velocity=3.0, acceleration=20.0), delay=0.0, period=PERIOD)
    path.send(10.0)
    assert path.acted(3.0) == 0.0
    assert path.acted(2.995) == pytest.approx(5.0)
    path.send(-10.0)
    assert path.acted(3.0) == -10.0


@pytest.mark.parametrize("delay", [-0.5, 1000.5, float("nan"), float("inf")])
def test_an_absurd_delay_is_refused_by_name(delay: float) -> None:
    with pytest.raises(InputError, match=r"delay = .*0 to 1000 periods"):
        CommandPath(WIDE, delay=delay, period=PERIOD)
