"""A run in closed loop that is killed keeps all but its last ticks: buffers of loop and log together."""

import os
from pathlib import Path

import numpy as np
import pytest
from shadowing_stand_in import LAB
from told_run import killed

from dpcontrol.control.interface import Action, Mode
from dpcontrol.logs import LogWriter, read_log, recover
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.bench import draw_bench
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.result import LogSink, Reading
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits
from dpcontrol.references.reference import still

LOST_SECONDS = 0.025
MOMENTS = 25
KILLS = 2
SECONDS = 1.2
LIMITS = Limits(position=0.4, velocity=3.0, acceleration=30.0)
ATTACHMENTS = {"scene.toml": b"title = 'killed'\n"}

posix = pytest.mark.skipif(os.name != "posix", reason="SIGKILL is POSIX's")


class Hanging:
    """A controller that does nothing but report events now and then, never in step with a chunk."""

    kind = "hanging"
    first_state = np.zeros(6)

    def __init__(self, ticks: int, rng: np.random.Generator) -> None:
        self.ticks = ticks
        self.eventful = set(rng.integers(0, ticks, ticks // 9).tolist())

    def begin(self) -> "Hanging":
        return self

    def command(self, tick: int, state: np.ndarray, extra: np.ndarray) -> Action:
        return Action(0.0, 0.0, self.first_state, Mode.HOLDING, "look" if tick in self.eventful else "")

    def resynchronise(self, tick: int, state: np.ndarray) -> str:
        return ""


class CopyingRig:
    """A rig that copies the log as it is in the file, as a kill would leave it, before it reads at some ticks."""

    truth = property(lambda self: self.rig.truth)
    fault = property(lambda self: self.rig.fault)

    def __init__(self, rig: SimulatedRig, log: LogWriter, folder: Path, at: set[int]) -> None:
        self.rig, self.log, self.folder, self.at, self.reads = rig, log, folder, at, 0

    def __getattr__(self, name: str):
        return getattr(self.rig, name)

    def read(self) -> Reading:
        if self.reads in self.at:
            (self.folder / f"at-{self.reads}.mcap.partial").write_bytes(self.log.partial.read_bytes())
        self.reads += 1
        if self.reads == max(self.at) + 1:
            raise KeyboardInterrupt
        return self.rig.read()


@pytest.mark.slow
@pytest.mark.parametrize("rate", [100.0, 900.0, 1000.0, 10_000.0])
def test_at_any_moment_all_but_the_last_twenty_five_milliseconds_are_in_the_file(tmp_path: Path, rate: float) -> None:
    rng = np.random.default_rng(7)
    first = max(2, round(LOST_SECONDS * rate))
    count = round(SECONDS * rate) if rate < 5000 else 4000
    moments = set(rng.integers(first, count, MOMENTS).tolist())
    with pytest.raises(KeyboardInterrupt):
        interrupted_run(tmp_path, Hanging(count, rng), rate=rate, moments=moments)
    for moment in moments:
        done = recover(tmp_path / f"at-{moment}.mcap.partial")
        assert 0 <= moment - done.ticks <= max(LOST_SECONDS * rate, 1)
        assert read_log(done.log).attachments == ATTACHMENTS
    # An interrupt, unlike a kill, loses no rows.
    assert recover(tmp_path / "run.mcap.partial").ticks == max(moments)


def interrupted_run(folder: Path, controller: Hanging, *, rate: float, moments: set[int]) -> None:
    """Run the loop with a log until the last of the moments, then be interrupted."""
    settings = LoopSettings(rate=rate, seed=0)
    draw = draw_bench(LAB, settings.bench, seed=0, ticks=controller.ticks + 1, period=1 / rate)
    with LogWriter(folder / "run.mcap", arm_lengths=LAB.length, rate_hz=rate, attachments=ATTACHMENTS) as log:
        rest = still(np.zeros(6), 1.0, method=method_named("radau-7"), limits=LIMITS, interval=1.0)
        loop = Assembly(rest, LAB, settings, law=controller).loop(sink=LogSink(log))
        rig = SimulatedRig(draw, settings.bench, limits=LIMITS, start=controller.first_state, queued=loop.queued)
        loop.run(CopyingRig(rig, log, folder, moments))


@posix
@pytest.mark.slow
def test_a_killed_run_of_the_program_loses_no_more_than_twenty_five_milliseconds(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    for k, after in enumerate(rng.uniform(0.05, 0.8, KILLS)):
        path = tmp_path / f"run-{k}.mcap"
        told, recovered = killed(path, after=float(after))
        assert 0 <= told - recovered <= LOST_SECONDS * 1000
