"""A run shown while it happens: what is shown, and that nothing that becomes of it touches the run."""

import contextlib
import fcntl
import os
import signal
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from dpcontrol.foundation.errors import Remark
from dpcontrol.foundation.rendering import live_view
from dpcontrol.logs import read_log
from dpcontrol.pages import live
from dpcontrol.pages.live import LiveView, ShownState, messages
from dpcontrol.pages.picture import viewer_program
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs import run as runs

NOWHERE = "rerun+http://127.0.0.1:9/proxy"


@pytest.fixture(scope="module")
def plan():
    return make_plan(load_itinerary("outer-turn"))


@pytest.fixture
def watched(monkeypatch):
    """Have runs watched by a viewer that is not there; return the views."""
    views: list[LiveView] = []

    class Elsewhere(LiveView):
        def __init__(self, start) -> None:
            super().__init__(start, viewer=NOWHERE)
            views.append(self)

    monkeypatch.setattr(live, "LiveView", Elsewhere)
    yield views
    for view in views:
        with contextlib.suppress(ProcessLookupError):
            os.kill(view.process, signal.SIGKILL)


class Kept:
    """A sink that keeps what a live view would send."""

    def __init__(self, start) -> None:
        reading, writing = os.pipe()
        self.reading, self.view = reading, LiveView(start, viewer=NOWHERE)
        os.set_blocking(writing, False)
        self.view._pipe = writing


@pytest.mark.slow
def test_sent_data_arrive_as_rows_at_fifty_hertz_and_are_drawn(plan, tmp_path: Path) -> None:
    log = runs.run_plan(plan).log
    start = replace(log, time=log.time[:0])
    sink = Kept(start)
    rows = runs.Ticks(
        log.time, log.measured, log.estimate, log.reference, log.truth, np.column_stack(list(log.controls.values()))
    )
    for first in range(0, 2000, 7):
        sink.view.ticks(rows.between(first, first + 7))
        sink.view.event(log.time[first], "info", "test", "an event")
    os.close(sink.view._pipe)
    recording = rr.RecordingStream("test")
    kept = recording.memory_recording()
    shown, count = ShownState.of(recording, start), 0
    for got, events in messages(sink.reading, None):
        shown.add(got, events)
        np.testing.assert_allclose(np.diff(got[:, 0]), 0.02, atol=1e-9)
        count += len(got)
    assert count == len(range(0, first + 7, 20))
    file = tmp_path / "live.rrd"
    file.write_bytes(kept.drain_as_bytes())
    stats = subprocess.run([viewer_program(), "rrd", "stats", file], capture_output=True, text=True).stdout
    for entity in ("/scene/arms/arm_1", "/scene/reference/arm_2", "/plots/angles/arm_1/3_plant", "/rosout", "/asked"):
        assert f"{entity}:" in stats


@pytest.mark.slow
def test_a_run_is_the_same_with_a_live_view_and_without(plan, watched, tmp_path: Path) -> None:
    for name, shown in (("plain", False), ("live", True)):
        runs.run_plan(plan, tmp_path / f"{name}.mcap", live=live_view if shown else None)
    plain, other = (read_log(tmp_path / f"{name}.mcap") for name in ("plain", "live"))
    np.testing.assert_array_equal(plain.truth, other.truth)
    np.testing.assert_array_equal(plain.time, other.time)
    assert len(watched) == 1


@pytest.mark.slow
def test_a_run_continues_after_its_view_is_killed(plan, watched, monkeypatch) -> None:
    begun = LiveView.__enter__

    def killed(self):
        entered = begun(self)
        os.kill(self.process, signal.SIGKILL)
        os.waitpid(self.process, 0)
        return entered

    monkeypatch.setattr(LiveView, "__enter__", killed)
    with pytest.warns(Remark, match="the live view ended before the run"):
        run = runs.run_plan(plan, live=live_view)
    assert run.converged


@pytest.mark.slow
def test_a_view_that_does_not_read_drops_rows_and_holds_nothing_up(plan, watched, monkeypatch) -> None:
    begun = LiveView.__enter__

    def stopped(self):
        entered = begun(self)
        os.kill(self.process, signal.SIGSTOP)
        # No more room than a page: what does not fit is dropped.
        fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, 4096)
        return entered

    monkeypatch.setattr(LiveView, "__enter__", stopped)
    with pytest.warns(Remark, match=r"the live view was behind: [1-9]"):
        run = runs.run_plan(plan, live=live_view)
    assert run.converged
