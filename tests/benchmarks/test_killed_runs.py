"""Fifty runs of the program, killed at random moments, and what each lost.

As a script, this runs `dpcontrol` with a rig that reports each tick on stdout.
"""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from dpcontrol.cli.main import main
from dpcontrol.logs import read_log, recover
from dpcontrol.loop import assembly
from dpcontrol.loop.protocols import Reading

KILLS = 50
LOST_TICKS = 25
"""At 1 kHz: milliseconds."""

pytestmark = [pytest.mark.benchmark, pytest.mark.skipif(os.name != "posix", reason="SIGKILL is POSIX's")]


class TellingRig(assembly.SimulatedRig):
    """A rig that writes the number of each tick as four bytes."""

    told = 0

    def read(self) -> Reading:
        os.write(1, self.told.to_bytes(4, "little"))
        self.told += 1
        return super().read()


def killed(path: Path, *, after: float) -> tuple[int, int]:
    """Kill `dpcontrol run` after its first tick; return the started and recovered ticks."""
    command = [sys.executable, __file__, "run", "hold-down-down", "--out", path]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as child:
        assert child.stdout is not None
        pipe = child.stdout.fileno()
        told = os.read(pipe, 4)
        end = time.perf_counter() + after
        # A log needs its first chunk, which may take longer on a slow machine.
        while time.perf_counter() < end or len(told) < 400:
            more = os.read(pipe, 1 << 16)
            assert more, "the run ended before it could be killed"
            told += more
        child.kill()
        while rest := os.read(pipe, 1 << 16):
            told += rest
    done = recover(path.with_name(path.name + ".partial"))
    assert {"scene.toml", "model.toml", "reference.npz"} <= read_log(done.log).attachments.keys()
    return len(told) // 4, done.ticks


def test_killed_runs_lose_no_more_than_twenty_five_milliseconds(tmp_path: Path) -> None:
    lost = []
    for k, after in enumerate(np.random.default_rng(4).uniform(0.05, 1.5, KILLS)):
        told, recovered = killed(tmp_path / f"run-{k}.mcap", after=float(after))
        lost.append(told - recovered)
    sys.stdout.write(f"\nlost at most {max(lost)} ms, in the mean {np.mean(lost):.1f} ms\n")
    assert min(lost) >= 0
    assert max(lost) <= LOST_TICKS


if __name__ == "__main__":
    assembly.SimulatedRig = TellingRig
    main(sys.argv[1:])
