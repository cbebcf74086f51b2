"""Kill runs at random moments and recover what they leave."""

import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from log_samples import ATTACHMENTS, sample

from dpcontrol.logs import read_log, recover

TICKS = 4000
PERIOD = 1e-3
FIRST = 0.06
"""In s: the earliest kill, when the first chunks are written."""


@dataclass(frozen=True)
class Killed:
    """A killed run: ticks that it had handed over, and those that were recovered."""

    told: int
    recovered: int


def kill_one(folder: Path, after_s: float) -> Killed:
    """Start a run, kill it `after_s` after its first tick, recover its log, and compare it with what was written."""
    path = folder / "run.mcap"
    script = Path(__file__).with_name("killed_run.py")
    with subprocess.Popen([sys.executable, script, path, str(TICKS), str(PERIOD)], stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        pipe = child.stdout.fileno()
        told = os.read(pipe, 4)
        end = time.perf_counter() + after_s
        while time.perf_counter() < end:
            told = (told + os.read(pipe, 1 << 16))[-4096:]
        child.kill()
        while rest := os.read(pipe, 1 << 16):
            told = (told + rest)[-4096:]
    # The pipe carries whole numbers of four bytes; the last may be torn by the kill.
    kept = len(told) - len(told) % 4
    last = int.from_bytes(told[kept - 4 : kept], "little")
    partial = path.with_name("run.mcap.partial")
    done = recover(partial)
    assert done.log == path
    log, run = read_log(path), sample(TICKS)
    count = len(log.time)
    np.testing.assert_array_equal(log.measured, run.measured[:count])
    np.testing.assert_array_equal(log.truth, run.truth[:count])
    assert log.attachments == ATTACHMENTS
    assert not done.attachments_lost
    partial.unlink()
    path.unlink()
    return Killed(last + 1, count)
