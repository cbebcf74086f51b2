"""A run shown while it happens: what is shown, and that nothing that becomes of it touches the run."""

import fcntl
import os
import signal

import numpy as np
import pytest

from dpcontrol.foundation.errors import Remark
from dpcontrol.foundation.rendering import live_view
from dpcontrol.pages import viewer
from dpcontrol.pages.viewer import LiveView
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
