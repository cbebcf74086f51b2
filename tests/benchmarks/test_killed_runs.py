"""Fifty runs of the program, killed at random moments, and what each lost."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from told_run import killed

KILLS = 50
LOST_TICKS = 25
"""At 1 kHz: milliseconds."""

pytestmark = [pytest.mark.benchmark, pytest.mark.skipif(os.name != "posix", reason="SIGKILL is POSIX's")]


def test_killed_runs_lose_no_more_than_twenty_five_milliseconds(tmp_path: Path) -> None:
    lost = []
    for k, after in enumerate(np.random.default_rng(4).uniform(0.05, 1.5, KILLS)):
        told, recovered = killed(tmp_path / f"run-{k}.mcap", after=float(after))
        lost.append(told - recovered)
    sys.stdout.write(f"\nlost at most {max(lost)} ms, in the mean {np.mean(lost):.1f} ms\n")
    assert min(lost) >= 0
    assert max(lost) <= LOST_TICKS
