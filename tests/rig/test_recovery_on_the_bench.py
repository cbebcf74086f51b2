"""A night over UDP, in real time, that falls and goes on by itself."""

from dataclasses import replace

import pytest

from dpcontrol.logs import read_log
from dpcontrol.loop.bench import Push
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.night import NightSettings, run_night
from dpcontrol.runs.run import RigLink

pytestmark = pytest.mark.slow  # most of a minute of real time


def test_a_night_on_the_example_bench_rolls_its_logs_and_continues_after_a_fall(tmp_path) -> None:
    scene = load_itinerary("turn-from-rest").with_run({"on_fall": "resume", "lag": 0.005, "travel": 0.8}, seed=3)
    blows = (Push(3.2, 1, 0.02), Push(3.4, 0, 0.02))
    loop = replace(scene.loop, disturbances=replace(scene.loop.disturbances, explicit=blows))
    plan = make_plan(replace(scene, loop=loop))
    night = NightSettings(hours=17 / 3600, file_minutes=0.1)
    done = run_night(plan, tmp_path / "rig.mcap", night, link=RigLink("udp", real_time=True))
    files = sorted((tmp_path / "rig").glob("*.mcap"))
    logs = [read_log(file) for file in files]
    assert [log.time[0] for log in logs] == pytest.approx([0.0, 6.0, 12.0], abs=0.1)
    assert all(log.metadata["rig"] == "udp" and log.truth is None for log in logs)
    assert len(done.falls) >= 1
    assert len(done.returns) >= 1
    assert done.repetitions >= 1
    assert not done.endings
    assert done.deadlines is not None
    assert done.deadlines["ticks"] >= 17_000
