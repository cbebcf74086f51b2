"""Long runs: their cost, start and resumption, and a short one from start to end."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from dpcontrol.foundation.errors import InputError, Remark
from dpcontrol.logs import read_log
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.night import NightSettings, night_itinerary, run_night

TURN = load_itinerary("outer-turn")
# As tests of recovery have it, with whose plan it is shared.
BENCH = {"mismatch": 0.02, "initial_error": 0.01, "travel": 0.8}


def test_a_night_continues_after_falls_by_default() -> None:
    as_given = night_itinerary(TURN, overrides={}).loop.supervisor
    assert (as_given.on_fall, as_given.attempts) == ("resume", 0)
    linger = load_itinerary("linger")
    by_time = night_itinerary(linger, overrides={}).loop
    assert (by_time.keep, by_time.supervisor.on_fall) == ("tvlqr", "resume")
    by_pulses = linger.with_run({"controller.keep": "ogy"})
    with pytest.warns(Remark, match=r'linger.toml: \[controller\] keep = "ogy" has internal timing'):
        loop = night_itinerary(by_pulses, overrides={}).loop
    assert (loop.keep, loop.supervisor.on_fall) == ("none", "resume")
    stops = night_itinerary(linger, overrides={"on_fall": "stop", "attempts": 10}).loop
    assert (stops.keep, stops.supervisor.on_fall, stops.supervisor.attempts) == ("tvlqr", "stop", 10)


@pytest.mark.slow
def test_a_short_night_is_repeated_interrupted_resumed_and_reported(tmp_path: Path) -> None:
    scene = night_itinerary(TURN.with_run(BENCH, seed=5), overrides={})
    plan, out = make_plan(scene), tmp_path / "turn.mcap"
    night = NightSettings(hours=6 / 3600, file_minutes=0.05)
    done = run_night(plan, out, night)
    folder = tmp_path / "turn"
    assert [file.name for file in sorted(folder.glob("*.mcap"))] == ["turn-0001.mcap", "turn-0002.mcap"]
    # The turn's end meets its start, half a wobble before the last.
    assert (done.uptime, done.repetitions, len(done.falls)) == (pytest.approx(1.0, abs=1e-3), 1, 0)
    with pytest.raises(InputError, match="already holds a long run"):
        run_night(plan, out, night)
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
