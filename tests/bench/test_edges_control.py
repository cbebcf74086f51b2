"""Borders of control along moving references, with the loop's messages."""

from dataclasses import replace

import numpy as np
import pytest

from dpcontrol.bench.edges import (
    TRIED,
    WEAK,
    delay_border,
    followed,
    moving,
)
from dpcontrol.loop.bench import DriveSettings

RATE = 50.0
BESIDE = 0.05  # rad: what encoders and the held input leave; in the longest delay the arms turn through a radian


def test_commands_on_their_way_at_the_start_belong_to_where_the_motion_leads():
    """However late commands act, a motion that begins on its reference stays there."""
    assert replace(moving(RATE), near=BESIDE).run(acceleration=WEAK, error=0.0, delay=0.2).works


def test_lockstep_and_loop_queue_the_same_commands():
    stand = moving(RATE)
    late = replace(stand.assembly.settings, seed=3, initial_error=0.01, drive=DriveSettings(delay=10))
    assembly = replace(stand.assembly, settings=late)
    together, alone = assembly.batch([3])[0], assembly.simulate()
    assert alone.ticks.truth is not None
    assert np.abs(together.truth[:40] - alone.ticks.truth[:40]).max() < 1e-9


@pytest.mark.slow
def test_a_moving_reference_tolerates_a_known_delay_up_to_a_reported_border():
    found = delay_border(moving(RATE), error=0.02, ratio=1.2)
    assert found.measured == pytest.approx(0.27, rel=0.15)  # as measured when this was written
    assert "tracking lost" in found.says


@pytest.mark.benchmark
def test_campaigns_end_near_the_margins_of_the_loop():
    held = followed("hold-up-up", "lqr", 8)
    for name, value in held.margins.items():
        key, inside = name.partition("_")[0], 1.25 if name == "gain_low" else 1 / 1.25
        assert held.driven(**{key: min(value * inside, TRIED)}).works, name
    # A hold from its very start; what it bears of gain is decided there, and a campaign may bear more.
    for name in ("gain_low", "delay", "lag"):
        outside = 1 / 1.25 if name == "gain_low" else 1.25
        found = held.driven(**{name.partition("_")[0]: held.margins[name] * outside})
        assert not found.works, name
        assert found.says
