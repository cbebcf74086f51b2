"""A run shown while it happens: what is shown, and that nothing that becomes of it touches the run."""

import fcntl
import os
import signal
import subprocess
from dataclasses import replace
from multiprocessing import Pipe
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from dpcontrol.foundation.errors import Remark
from dpcontrol.foundation.rendering import live_view
from dpcontrol.logs import Event
from dpcontrol.pages import viewer
from dpcontrol.pages.viewer import LiveView, parts_of, show, viewer_program
from dpcontrol.runs import run as runs

NOWHERE = "rerun+http://127.0.0.1:9/proxy"


@pytest.fixture
def watched(monkeypatch):
    """Have runs watched by a viewer that is not there; return the views."""
    views: list[LiveView] = []

    class Elsewhere(LiveView):
        def __init__(self, start) -> None:
            super().__init__(start, viewer=NOWHERE)
            views.append(self)

    monkeypatch.setattr(viewer, "LiveView", Elsewhere)
    yield views
    for view in views:
        view.process.kill()


@pytest.mark.slow
def test_sent_data_arrive_as_rows_at_fifty_hertz_and_are_drawn(plan, tmp_path: Path) -> None:
    log = runs.run_plan(plan).log
    start = replace(log, time=log.time[:0])
    reading, writing = Pipe(duplex=False)
    fcntl.fcntl(writing.fileno(), fcntl.F_SETPIPE_SZ, 1 << 20)
    view = LiveView(start, viewer=NOWHERE)
    view.pipe = writing
    rows = runs.Ticks(
        log.time, log.measured, log.estimate, log.reference, log.truth, np.column_stack(list(log.controls.values()))
    )
    for first in range(0, 2000, 7):
        view.ticks(rows.between(first, first + 7))
        view.event(Event(log.time[first], "info", "test", words="an event"))
    writing.close()
    recording = rr.RecordingStream("test")
    kept, parts = recording.memory_recording(), list(parts_of(reading))
    show(recording, start, parts)
    times = np.concatenate([got[:, 0] for got, _ in parts if len(got)])
    np.testing.assert_allclose(np.diff(times), 0.02, atol=1e-9)
    assert len(times) == len(range(0, first + 7, 20))
    file = tmp_path / "live.rrd"
    file.write_bytes(kept.drain_as_bytes())
    stats = subprocess.run([viewer_program(), "rrd", "stats", file], capture_output=True, text=True).stdout
    for entity in ("/scene/arms/arm_1", "/scene/reference/arm_2", "/plots/angles/arm_1/3_plant", "/rosout", "/asked"):
        assert f"{entity}:" in stats


def killed(view: LiveView) -> None:
    view.process.kill()
    view.process.join()


def stopped(view: LiveView) -> None:
    os.kill(view.process.pid, signal.SIGSTOP)
    # No more room than a page: what does not fit is dropped.
    fcntl.fcntl(view.pipe.fileno(), fcntl.F_SETPIPE_SZ, 4096)


@pytest.mark.slow
@pytest.mark.parametrize(("happens", "remark"), [(killed, "ended before the run"), (stopped, "was behind: [1-9]")])
def test_a_run_is_the_same_whatever_becomes_of_its_view(plan, watched, monkeypatch, happens, remark) -> None:
    begun = LiveView.__enter__

    def entered(self):
        view = begun(self)
        happens(self)
        return view

    monkeypatch.setattr(LiveView, "__enter__", entered)
    with pytest.warns(Remark, match=f"the live view {remark}"):
        shown = runs.run_plan(plan, live=live_view)
    assert len(watched) == 1
    np.testing.assert_array_equal(shown.log.truth, runs.run_plan(plan).log.truth)
