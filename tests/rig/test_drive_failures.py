"""A drive that is off or reversed stops the run, on the simulated bench, over UDP and on a rig in Python."""

from dataclasses import replace

import numpy as np
import pytest

import dpcontrol as dp
from dpcontrol.control.interface import Mode
from dpcontrol.loop.result import Ending, LoopResult
from dpcontrol.runs.closed_loop import ClosedLoop

pytestmark = pytest.mark.slow

SOON = 0.05
"""Longest time from visible commanded motion to the end of the run, s."""
MOVED = 5e-3
"""Commanded motion of a resting cart that must show, m: less can be noise if the commands stay below 1 m/s²."""
ITINERARY = "turn-from-rest"
ERROR = 0.05
"""Initial error of simulated arms, rad, so that the commands begin at once."""


@pytest.fixture(scope="module")
def loop() -> ClosedLoop:
    return dp.closed_loop(ITINERARY, initial_error=ERROR)


def ended_soon(result: LoopResult, *, fails: float = 0.0) -> bool:
    """Return true if the run ended soon after its commands demanded a visible motion of a resting cart."""
    assert result.ending is Ending.DRIVE_FAILED, result.reason
    times, applied, mode = result.ticks.times, result.ticks.control[:, 3], result.ticks.control[:, 6]
    moved = np.abs(np.cumsum(np.cumsum(np.where(times >= fails, applied, 0.0))) * (times[1] - times[0]) ** 2)
    due = times[moved >= MOVED]
    return not due.size or times[np.argmax(mode == Mode.ABORTED)] <= due[0] + SOON


@pytest.mark.parametrize("failure", ["off", "reversed"])
@pytest.mark.parametrize("fails", [0.0, 1.0, 1.3])
def test_a_simulated_drive_that_fails_ends_the_run_soon(loop: ClosedLoop, failure: str, fails: float) -> None:
    settings = loop.assembly.settings
    drive = replace(settings.drive, failed_at=fails, failure=failure)
    faulty = loop.assembly.under(replace(settings, drive=drive))
    for seed in range(2):
        assert ended_soon(faulty.simulate(draw=faulty.draw(seed=seed)), fails=fails)
