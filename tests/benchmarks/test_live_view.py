"""Runs of twenty seconds at 1 kHz on the example bench in real time, with a live view and without, in turn.

The viewer has no window and writes its data to a file.
"""

import os
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from dpcontrol.foundation.rendering import live_view
from dpcontrol.pages.viewer import LiveView, viewer_program
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.run import rig_link, run_plan

ITINERARY, TURNS = "turn-cross-turn-return", 3
SHOWN = 100_000
"""Bytes that the viewer writes, at least."""
SLOWER = 1.5
"""Bound on the median tick with a live view over that without."""


@pytest.mark.benchmark
def test_a_live_view_makes_no_tick_late(tmp_path, monkeypatch, capsys) -> None:
    plan = make_plan(load_itinerary(ITINERARY))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    viewer = subprocess.Popen(
        [viewer_program(), "--save", tmp_path / "live.rrd", "--port", str(port), "--bind", "127.0.0.1"],
        stderr=subprocess.DEVNULL, env={**os.environ, "CI": "1"},
    )  # fmt: skip
    address = f"rerun+http://127.0.0.1:{port}/proxy"
    monkeypatch.setattr("dpcontrol.pages.viewer.LiveView", lambda start: LiveView(start, viewer=address))
    link = rig_link("udp", key_file=None, insecure=False, real_time=True)
    assert link is not None
    medians: dict[bool, list[float]] = {False: [], True: []}
    try:
        for turn in range(2 * TURNS):
            shown = bool(turn % 2)
            run = run_plan(plan, tmp_path / f"{turn}.mcap", bench=link, live=live_view if shown else None)
            thinking, deadlines = run.result.thinking, run.deadlines
            assert run.result.finished, run.result.reason
            assert deadlines is not None
            times = 1e6 * np.quantile(thinking, [0.5, 0.99])
            medians[shown].append(times[0])
            text = f"{'with' if shown else 'without'} a live view: {deadlines.missed} of {len(thinking):,} deadlines"
            text += f" missed, tick {times[0]:.1f} µs (median), {times[1]:.1f} (99 %), load {os.getloadavg()[0]:.1f}"
            with capsys.disabled():
                sys.stdout.write(f"\n{text}")
            time.sleep(1.0)
    finally:
        viewer.terminate()
        viewer.wait()
    assert (tmp_path / "live.rrd").stat().st_size > SHOWN
    assert np.median(medians[True]) < SLOWER * np.median(medians[False])
