"""Long runs: their cost, start and resumption, and a short one from start to end."""

import json
import multiprocessing
import re
import shutil
import threading
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from dpcontrol.foundation.errors import GoalMissed, InputError, Remark
from dpcontrol.logs import read_log
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.bench import DisturbanceSettings, Push, SensorSettings
from dpcontrol.loop.recovery import FRESH_SECONDS, REST_ANGLE, REST_RATE, REST_SECONDS, StartController
from dpcontrol.loop.result import Ending
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.night import (
    _START_TICKS,
    NightSettings,
    _plan_starts,
    _since,
    _waits,
    night_cost,
    night_folder,
    night_itinerary,
    night_plan,
    run_night,
)

TURN = load_itinerary("outer-turn")
# As tests of recovery have it, with whose plan it is shared.
BENCH = {"mismatch": 0.02, "initial_error": 0.01, "travel": 0.8}


def test_a_night_continues_after_falls_by_default() -> None:
    as_given = night_itinerary(TURN, given={}).loop.supervisor
    assert (as_given.on_fall, as_given.attempts) == ("resume", 0)
    stops = night_itinerary(TURN, given={"on_fall": "stop", "attempts": 10}).loop.supervisor
    assert (stops.on_fall, stops.attempts) == ("stop", 10)


def test_a_keeper_of_stops_with_internal_timing_is_replaced_in_a_night_with_a_remark() -> None:
    linger = load_itinerary("linger")
    with pytest.warns(Remark, match=r'linger.toml: \[controller\] keep = "tvlqr" has internal timing'):
        loop = night_itinerary(linger, given={}).loop
    assert (loop.keep, loop.supervisor.on_fall) == ("none", "resume")
    with pytest.raises(InputError, match="run with --set keep=none"):
        night_itinerary(linger, given={"keep": "tvlqr"})
    assert night_itinerary(linger, given={"on_fall": "stop"}).loop.keep == "tvlqr"


def test_the_memory_of_a_night_is_that_of_its_itinerary(tmp_path: Path) -> None:
    # Measured after ten minutes: 375 MB, 490 MB and 690 MB.
    for name, megabytes in (("outer-turn", "370"), ("linger", "460"), ("round-trip", "680")):
        cost = night_cost(load_itinerary(name), NightSettings(hours=0.5), tmp_path / "night")
        assert f" and {megabytes} MB of memory" in cost


def test_the_cost_of_a_night_is_stated_and_too_much_is_refused(tmp_path: Path) -> None:
    folder = night_folder(tmp_path / "logs" / "turn-0.mcap")
    assert folder == tmp_path / "logs" / "turn-0"
    cost = night_cost(TURN, NightSettings(hours=1.0), folder)
    assert re.search(r"--hours 1: 1 h of outer-turn will take about .* disk in .*: 6 files of 10 min", cost)
    with pytest.raises(InputError, match=r"20 GB are begun unasked: thin the logs with --keep-every"):
        night_cost(TURN, NightSettings(hours=18.0), folder)
    thinned = NightSettings(hours=11.0, keep_every=20)
    assert thinned.disk(1000.0) < NightSettings(hours=18.0).disk(1000.0) / 10
    assert "of which one in 20 is kept" in night_cost(TURN, thinned, folder)
    with pytest.raises(InputError, match="are free there"):
        night_cost(TURN, NightSettings(hours=9_999.0), folder, yes=True)
    with pytest.raises(InputError, match=r"hours = 0"):
        NightSettings(hours=0.0)


def test_the_time_of_a_night_follows_from_its_pace_and_from_waiting(tmp_path: Path) -> None:
    def minutes(pace: float, waits: float = 0.0) -> str:
        cost = night_cost(TURN, NightSettings(hours=1.0), tmp_path, pace=pace, overhead=waits)
        return str(re.findall(r"about ([\d.]+) minutes", cost)[0])

    # 3,600,000 ticks.
    assert minutes(10_000.0) == "6"
    assert minutes(10_000.0, 60.0) == "7"
    assert minutes(20_000.0) == "3"


def test_a_night_is_expected_to_wait_only_if_it_needs_a_way_from_rest() -> None:
    references, hour = np.zeros((5000, 6)), 3_600_000
    calm, blown = TURN.loop, TURN.with_run({"knocks_per_minute": 6}).loop
    # It ends where it begins, so laps need no way from rest.
    assert _waits(calm, references, hour) == 0
    assert _waits(blown, references, 9_999) == 0
    # The first blow comes after 10,000 ticks on average.
    expected = _waits(blown, references, 180_000)
    assert (180_000 + expected) ** 2 == pytest.approx(180_000 * (180_000 + _START_TICKS - 10_000))
    references[-1600:] = 1.0
    assert _waits(calm, references, hour) == _START_TICKS - 5000


def test_stuck_sensors_recover_in_a_resumed_night() -> None:
    loop = replace(TURN.loop, sensors=SensorSettings(stuck_at=100.0, stuck_for=10.0))
    assert _since(loop, 0.0) == loop
    assert _since(loop, 40.0).sensors == SensorSettings(stuck_at=60.0, stuck_for=10.0)
    assert _since(loop, 104.0).sensors == SensorSettings(stuck_at=0.0, stuck_for=6.0)
    assert _since(loop, 200.0).sensors == SensorSettings(stuck_for=10.0)


@pytest.mark.slow
def test_ways_from_rest_that_are_planned_beside_a_night_are_those_of_its_plan() -> None:
    plan = make_plan(night_itinerary(TURN.with_run(BENCH, seed=5), given={}))
    arms, loop = plan.itinerary.model.arms, plan.itinerary.loop
    controller = Assembly(plan.reference, arms, loop).controller
    known = Assembly(plan.reference, arms, loop, law=controller).recovery
    assert known is not None
    here, there = multiprocessing.Pipe(duplex=False)
    sent = []
    # What is sent is larger than a pipe holds.
    reader = threading.Thread(target=lambda: sent.extend(here.recv() for _ in known.starts))
    reader.start()
    bare = {name: note for name, note in plan.reference.notes.items() if name != "starts"}
    archive = replace(plan, reference=replace(plan.reference, notes=bare)).archive
    _plan_starts(there, plan.itinerary.path, loop, archive, known.gains, 0)
    reader.join()
    assert [start.stop for start in sent] == [start.stop for start in known.starts] == [0, 1]
    for mine, theirs in zip(sent, known.starts, strict=True):
        np.testing.assert_array_equal(mine.gains.rows, theirs.gains.rows)
        assert (mine.at, mine.lead_in) == (theirs.at, theirs.lead_in)
    assert "starts" not in make_plan(TURN).notes
    assert "starts" in night_plan(plan.itinerary).notes


@pytest.mark.slow
@pytest.mark.parametrize("patient", [True, False])
def test_arms_rest_until_there_is_a_way_to_start_again(patient: bool) -> None:
    """In real time the run goes on with resting arms; without any way it ends with the reason."""
    blow = (Push(1.0, 1, 0.1),)
    scene = night_itinerary(TURN.with_run(BENCH, seed=5), given={})
    scene = replace(scene, loop=replace(scene.loop, disturbances=DisturbanceSettings(explicit=blow)))
    plan = make_plan(scene)
    arms, loop = scene.model.arms, scene.loop
    controller = Assembly(plan.reference, arms, loop).controller
    known = Assembly(plan.reference, arms, loop, law=controller).recovery
    assert known is not None
    starts, asked = list[StartController](), []

    def ready() -> bool:
        asked.append(len(starts))
        if len(asked) < 2000:
            return False
        if not patient:
            raise GoalMissed("from rest to stop 1: no transfer")
        starts.extend(known.starts)
        return True

    later = replace(known, starts=starts, ready=ready)
    fly = partial(Assembly(plan.reference, arms, loop, law=controller).simulate, recovery=later, until=16_000)
    if not patient:
        with pytest.raises(GoalMissed, match="from rest to stop 1"):
            fly()
        return
    ended = fly()
    assert ended.ending is Ending.FINISHED
    assert ended.falls == 1
    # They rest two seconds longer than a start needs, with a request in each tick.
    assert asked == [0] * 2000
    assert ended.ticks.truth is not None
    angles, rates = ended.ticks.truth[:, :2], ended.ticks.truth[:, 2:4]
    rests = (np.abs(np.sin(angles)).max(axis=1) < REST_ANGLE) & (np.abs(rates).max(axis=1) < REST_RATE)
    changes = np.flatnonzero(np.diff(rests, prepend=False, append=False))
    assert np.diff(changes)[::2].max() > 1e3 * (2.0 + REST_SECONDS + FRESH_SECONDS)


@pytest.mark.slow
def test_a_short_night_is_repeated_interrupted_resumed_and_reported(tmp_path: Path) -> None:
    scene = night_itinerary(TURN.with_run(BENCH, seed=5), given={})
    plan, out = make_plan(scene), tmp_path / "turn.mcap"
    night = NightSettings(hours=6 / 3600, file_minutes=0.05)
    done = run_night(plan, out, night)
    folder = tmp_path / "turn"
    assert [file.name for file in sorted(folder.glob("*.mcap"))] == ["turn-0001.mcap", "turn-0002.mcap"]
    # The turn's end meets its start, half a wobble before the last.
    assert (done.uptime, done.repetitions, len(done.falls)) == (pytest.approx(1.0, abs=1e-3), 1, 0)
    with pytest.raises(InputError, match="already holds a long run; continue it with --resume"):
        run_night(plan, out, night)
    with pytest.raises(InputError, match=r"is complete: .* raise --hours"):
        run_night(plan, out, night, resume=True)
    with pytest.raises(InputError, match="holds no long run to resume"):
        run_night(plan, tmp_path / "other.mcap", night, resume=True)
    other = replace(scene, loop=replace(scene.loop, mismatch=0.03))
    longer = NightSettings(hours=8 / 3600, file_minutes=0.05)
    with pytest.raises(InputError, match=r"of another run \(not the same: .*run_settings"):
        run_night(replace(plan, itinerary=other), out, longer, resume=True)
    # As a killed run leaves it: the second file is cut, and has no digest.
    second = folder / "turn-0002.mcap"
    (folder / "turn-0002.mcap.partial").write_bytes(second.read_bytes()[: second.stat().st_size * 2 // 3])
    second.unlink()
    (folder / "turn-0002.json").unlink()
    more = run_night(plan, out, longer, resume=True)
    logs = [read_log(file) for file in sorted(folder.glob("*.mcap"))]
    assert [json.loads(log.metadata["night"])["session"] for log in logs] == [1, 1, 2, 2]
    assert logs[1].recovered
    assert logs[1].time[-1] < 5.5
    assert logs[2].time[0] == pytest.approx(logs[1].time[-1] + 1e-3)
    assert logs[3].time[-1] == pytest.approx(8.0, abs=0.2)
    assert more.known == pytest.approx(8.0, abs=0.2)
    assert more.uptime > 0.95
    shutil.rmtree(folder)
