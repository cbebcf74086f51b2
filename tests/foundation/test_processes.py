"""Workers exit with their parent process, regardless of how it ends."""

import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

PATIENCE = 60.0
"""Time after which workers count as orphaned, s."""

POOL = """
import time
from dpcontrol.foundation.processes import in_processes
list(in_processes(time.sleep, [600.0, 601.0], 2))
"""
BENCH = """
import time
from functools import partial
from types import SimpleNamespace
from dpcontrol.rig.bench import BenchProcess
BenchProcess(SimpleNamespace(rehearse=partial(time.sleep, 600.0)))
"""


@pytest.mark.skipif(os.name != "posix", reason="these signals are POSIX's")
@pytest.mark.parametrize(
    ("does", "children", "killed_by"),
    [
        # Two workers and the resource tracker.
        (POOL, 3, (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP)),
        # Two processes import the rig's modules in sequence.
        pytest.param(BENCH, 2, (signal.SIGKILL,), marks=pytest.mark.slow),
    ],
)
def test_workers_end_with_a_killed_parent(does: str, children: int, killed_by: tuple[signal.Signals, ...]) -> None:
    # Processes under nohup ignore a hangup.
    killed_by = tuple(number for number in killed_by if signal.getsignal(number) is not signal.SIG_IGN)
    quiet = {"start_new_session": True, "stderr": subprocess.DEVNULL}
    parents = [subprocess.Popen([sys.executable, "-c", does], **quiet) for _ in killed_by]
    families: list[psutil.Process] = []
    try:
        for parent in parents:
            while len(family := psutil.Process(parent.pid).children(recursive=True)) < children:
                assert parent.poll() is None
                time.sleep(0.02)
            families += family
        for parent, number in zip(parents, killed_by, strict=True):
            # The signal goes to the parent only, as from `kill` and the out-of-memory killer.
            os.kill(parent.pid, number)
            assert parent.wait() == -number
        _, left = psutil.wait_procs(families, timeout=PATIENCE)
        assert not left
    finally:
        for process in [*parents, *(p for p in families if p.is_running())]:
            process.kill()
