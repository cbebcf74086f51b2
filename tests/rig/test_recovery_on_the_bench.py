"""Runs over UDP, in real time, that fall and go on by themselves; and a loop that dies in mid-fall."""

import multiprocessing
import os
from dataclasses import replace
from functools import partialmethod

import numpy as np
import pytest

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import read_log
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.bench import Push
from dpcontrol.loop.result import Ending, LoopSink
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.rig.bench import BenchProcess, BenchServerSettings
from dpcontrol.rig.client import LinkSettings, UdpRig
from dpcontrol.runs.night import NightSettings, run_night
from dpcontrol.runs.run import RigLink, bench_recipe, run_on_rig

pytestmark = pytest.mark.slow  # most of a minute of real time


def falling() -> Plan:
    scene = load_itinerary("turn-from-rest").with_run({"on_fall": "resume", "lag": 0.005, "travel": 0.8}, seed=3)
    blows = (Push(3.2, 1, 0.02), Push(3.4, 0, 0.02))
    loop = replace(scene.loop, disturbances=replace(scene.loop.disturbances, explicit=blows))
    return make_plan(replace(scene, loop=loop))


@pytest.mark.benchmark  # a minute of real time; the night below falls and goes on as well
def test_a_run_on_the_example_bench_falls_and_resumes_by_itself(tmp_path) -> None:
    run = run_on_rig(falling(), tmp_path / "rig.mcap", RigLink("udp"))
    assert run.result.ending is Ending.FINISHED
    assert run.score.falls >= 1
    assert run.score.symbols_completed == 3
    names = [event.name for event in read_log(tmp_path / "rig.mcap").events]
    assert names.index("return") < names.index("at rest")
    assert names[-1] == "finished"


def test_a_night_on_the_example_bench_rolls_its_logs_and_continues_after_a_fall(tmp_path) -> None:
    plan = falling()
    night = NightSettings(hours=22 / 3600, file_minutes=0.1)
    done = run_night(plan, tmp_path / "rig.mcap", night, link=RigLink("udp", real_time=True))
    files = sorted((tmp_path / "rig").glob("*.mcap"))
    logs = [read_log(file) for file in files]
    assert [log.time[0] for log in logs] == pytest.approx([0.0, 6.0, 12.0, 18.0])
    assert all(log.metadata["rig"] == "udp" and log.truth is None for log in logs)
    assert len(done.falls) >= 1
    assert len(done.returns) >= 1
    assert done.repetitions >= 1
    assert not done.endings
    assert done.deadlines is not None
    assert done.deadlines["ticks"] >= 22_000
    with pytest.raises(InputError, match="is complete"):
        run_night(plan, tmp_path / "rig.mcap", night, link=RigLink("udp", real_time=True), resume=True)
    with pytest.raises(InputError, match=r"of another run .*rig"):
        run_night(plan, tmp_path / "rig.mcap", night, resume=True)


def test_a_night_whose_bench_does_not_answer_leaves_nothing(tmp_path, monkeypatch) -> None:
    plan, night = falling(), NightSettings(hours=1.0)
    monkeypatch.setattr(LinkSettings, "__init__", partialmethod(LinkSettings.__init__, answer=0.3))
    with pytest.raises(InputError, match="no bench responded"):
        run_night(plan, tmp_path / "rig.mcap", night, link=RigLink("udp://127.0.0.1:9"))
    assert not (tmp_path / "rig").exists()


class Dies(LoopSink):
    """Ends its process without a word at the first fall."""

    def event(self, time_s, level, name, text) -> None:
        if name == "return":
            os._exit(9)


def fly(address: tuple[str, int], key: bytes) -> None:
    plan = falling()
    arms, settings = plan.itinerary.model.arms, plan.itinerary.loop
    controller = Assembly(plan.reference, arms, settings).controller
    shared = Assembly(plan.reference, arms, settings, law=controller).recovery
    assert shared is not None
    loop = Assembly(plan.reference, arms, settings, law=controller).loop(sink=Dies(), recovery=shared)
    loop.ticker.rehearse()
    with UdpRig(address, queued=loop.queued, key=key) as rig:
        loop.run(rig)


def test_after_a_controller_dies_during_a_fall_the_cart_stops() -> None:
    with BenchProcess(bench_recipe(falling()), BenchServerSettings()) as bench:
        loop = multiprocessing.get_context("spawn").Process(target=fly, args=(bench.address, bench.key))
        loop.start()
        loop.join(60)
        assert loop.exitcode == 9
    record = bench.record
    assert record is not None
    # The bench heard nothing any more, and its watchdog braked the cart, which was on its track all the while.
    assert not record.fault
    assert abs(record.truth[record.ticks - 1, 5]) < 1e-6
    assert np.abs(record.truth[: record.ticks, 4]).max() < 0.8
