"""A run in closed loop that is killed keeps all but its last ticks: buffers of loop and log together."""

import os
from pathlib import Path

import numpy as np
import pytest
from told_run import killed

LOST_SECONDS = 0.025
KILLS = 3
posix = pytest.mark.skipif(os.name != "posix", reason="SIGKILL is POSIX's")


@posix
@pytest.mark.slow
def test_a_killed_run_of_the_program_loses_no_more_than_twenty_five_milliseconds(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    for k, after in enumerate(rng.uniform(0.05, 0.8, KILLS)):
        path = tmp_path / f"run-{k}.mcap"
        told, recovered = killed(path, after=float(after))
        assert 0 <= told - recovered <= LOST_SECONDS * 1000
