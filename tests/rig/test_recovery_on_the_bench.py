"""Runs over UDP, in real time, that fall and go on by themselves; and a loop that dies in mid-fall."""

from dataclasses import replace

import pytest

from dpcontrol.logs import read_log
from dpcontrol.loop.bench import Push
from dpcontrol.loop.result import Ending
from dpcontrol.scenes.itinerary import load_itinerary
from dpcontrol.scenes.plan import make_plan
from dpcontrol.scenes.run import run_on_rig
from dpcontrol.scenes.run_options import RunOptions

pytestmark = pytest.mark.slow  # a quarter of a minute of real time


def test_a_run_on_the_example_bench_falls_and_resumes_by_itself(tmp_path) -> None:
    scene = load_itinerary("turn-from-rest").with_run(RunOptions(on_fall="resume", lag=0.005, travel=0.8), seed=3)
    blows = (Push(3.2, 1, 0.02), Push(3.4, 0, 0.02))
    loop = replace(scene.loop, disturbances=replace(scene.loop.disturbances, explicit=blows))
    run = run_on_rig(make_plan(replace(scene, loop=loop)), tmp_path / "rig.mcap", "udp")
    assert run.result.ending is Ending.FINISHED
    assert run.score.falls >= 1
    assert run.score.symbols_completed == 3
    names = [event.name for event in read_log(tmp_path / "rig.mcap").events]
    assert names.index("return") < names.index("at rest")
    assert names[-1] == "finished"
