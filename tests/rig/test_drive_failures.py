"""A drive that is off or reversed stops the run, on the simulated bench, over UDP and on a rig in Python."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from bench_at_hand import LONG, served

import dpcontrol as dp
from dpcontrol.control.interface import Mode
from dpcontrol.loop.protocols import Reading
from dpcontrol.loop.result import Ending, LoopResult
from dpcontrol.rig.client import UdpRig
from dpcontrol.runs.closed_loop import ClosedLoop

pytestmark = pytest.mark.slow

SOON = 0.05
"""Longest time from visible commanded motion to the end of the run, s."""
MOVED = 5e-3
"""Commanded motion of a resting cart that must show, m: less can be noise if the commands stay below 1 m/s²."""
ITINERARY = "turn-from-rest"
ERROR = 0.05
"""Initial error of simulated arms, rad, so that the commands begin at once."""
HELD = np.array([0.05, 0.05, 0.0])
"""Deflection of arms that hang still on a rig whose readings never change, rad, rad and m."""


@pytest.fixture(scope="module")
def loop() -> ClosedLoop:
    return dp.closed_loop(ITINERARY, initial_error=ERROR)


@dataclass
class Still:
    """A rig whose readings never change, and which records its commands."""

    positions: np.ndarray
    period: float = 1e-3
    tick: int = -1
    queued: tuple[float, ...] = ()
    fault: None = None
    truth: None = None

    def read(self) -> Reading:
        self.tick += 1
        return Reading(self.tick * self.period, self.positions)

    def command(self, acceleration: float) -> None:
        pass

    def stop(self) -> None:
        pass


class Backwards(Still):
    """The model of a rig whose cart moves against the commands."""

    def __init__(self, loop: ClosedLoop) -> None:
        self.model, self.state, self.acting = loop.assembly.model, loop.plan.reference.state(0.0), 0.0
        super().__init__(self.state[self.model.position_indices])

    def read(self) -> Reading:
        self.state = self.model.step(self.state, -self.acting)
        self.positions = self.state[self.model.position_indices]
        return super().read()

    def command(self, acceleration: float) -> None:
        self.acting = acceleration


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


def test_readings_that_never_change_end_a_run_over_udp_soon(loop: ClosedLoop) -> None:
    ready = loop.assembly.loop()
    ready.ticker.rehearse()
    still = Still(loop.plan.reference.state(0.0)[loop.assembly.model.position_indices] + HELD)
    with served(still) as bench, UdpRig(bench.address, queued=ready.queued, settings=LONG) as rig:
        assert ended_soon(ready.run(rig))


def test_a_rig_in_python_that_stands_or_runs_backwards_ends_soon(loop: ClosedLoop) -> None:
    at_start = loop.plan.reference.state(0.0)[loop.assembly.model.position_indices]
    for rig in (Still(at_start + HELD), Backwards(loop)):
        assert ended_soon(loop.assembly.loop().run(rig))
        assert loop.run(rig=rig).log.metadata["ending"] == Ending.DRIVE_FAILED.value
