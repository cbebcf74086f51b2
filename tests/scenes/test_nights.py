"""Long runs: what they will take, where they begin and go on, and a short one from end to end."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from dpcontrol.foundation.errors import InputError, Remark
from dpcontrol.logs import read_log
from dpcontrol.loop.bench import SensorSettings
from dpcontrol.scenes.itinerary import load_itinerary
from dpcontrol.scenes.night import (
    NightSettings,
    _since,
    announce_night,
    night_folder,
    night_itinerary,
    run_night,
)
from dpcontrol.scenes.plan import make_plan
from dpcontrol.scenes.run_options import RunOptions

TURN = load_itinerary("outer-turn")
# As tests of recovery have it, with whose plan it is shared.
BENCH = RunOptions(mismatch=0.02, initial_error=0.01, travel=0.8)


def test_a_night_goes_on_after_falls_unless_it_is_told_not_to() -> None:
    as_asked = night_itinerary(TURN, asked={}).loop.supervisor
    assert (as_asked.on_fall, as_asked.attempts) == ("resume", 0)
    stops = night_itinerary(TURN, asked={"on_fall": "stop", "attempts": 10}).loop.supervisor
    assert (stops.on_fall, stops.attempts) == ("stop", 10)


def test_what_keeps_stops_by_its_own_clock_is_left_out_of_a_night_and_that_is_said() -> None:
    linger = load_itinerary("linger")
    with pytest.warns(Remark, match=r'linger.toml: \[controller\] keep = "tvlqr" has a clock of its own'):
        loop = night_itinerary(linger, asked={}).loop
    assert (loop.keep, loop.supervisor.on_fall) == ("none", "resume")
    with pytest.raises(InputError, match="run with --keep none"):
        night_itinerary(linger, asked={"keep": "tvlqr"})
    assert night_itinerary(linger, asked={"on_fall": "stop"}).loop.keep == "tvlqr"


def test_the_memory_of_a_night_is_that_of_its_itinerary(tmp_path: Path) -> None:
    # Measured after ten minutes: 375 MB, 490 MB and 690 MB.
    for name, megabytes in (("outer-turn", "370"), ("linger", "460"), ("round-trip", "680")):
        with pytest.warns(Remark, match=f"about {megabytes} MB of memory|and {megabytes} MB of memory"):
            announce_night(load_itinerary(name), NightSettings(hours=0.5), tmp_path / "night")


def test_what_a_night_takes_is_said_and_too_much_is_refused(tmp_path: Path) -> None:
    folder = night_folder(tmp_path / "logs" / "turn-0.mcap")
    assert folder == tmp_path / "logs" / "turn-0"
    night = NightSettings(hours=1.0)
    with pytest.warns(Remark, match=r"--hours 1: 1 h of outer-turn will take about .* disk in .*: 6 files of 10 min"):
        announce_night(TURN, night, folder)
    with pytest.raises(InputError, match=r"20 GB are begun unasked: thin the logs with --keep-every"):
        announce_night(TURN, NightSettings(hours=18.0), folder)
    thinned = NightSettings(hours=11.0, keep_every=20)
    assert thinned.disk(1000.0) < NightSettings(hours=18.0).disk(1000.0) / 10
    with pytest.warns(Remark, match="of which one in 20 is kept"):
        announce_night(TURN, thinned, folder)
    with pytest.raises(InputError, match="are free there"):
        announce_night(TURN, NightSettings(hours=9_999.0), folder, yes=True)
    with pytest.raises(InputError, match=r"hours = 0"):
        NightSettings(hours=0.0)


def test_what_sticks_comes_back_also_in_a_night_that_is_resumed() -> None:
    loop = replace(TURN.loop, sensors=SensorSettings(stuck_at=100.0, stuck_for=10.0))
    assert _since(loop, 0.0) == loop
    assert _since(loop, 40.0).sensors == SensorSettings(stuck_at=60.0, stuck_for=10.0)
    assert _since(loop, 104.0).sensors == SensorSettings(stuck_at=0.0, stuck_for=6.0)
    assert _since(loop, 200.0).sensors == SensorSettings(stuck_for=10.0)


@pytest.mark.slow
def test_a_short_night_is_repeated_interrupted_resumed_and_told(tmp_path: Path) -> None:
    scene = night_itinerary(TURN.with_run(BENCH, seed=5), asked={})
    plan, out = make_plan(scene), tmp_path / "turn.mcap"
    night = NightSettings(hours=6 / 3600, file_minutes=0.05)
    done = run_night(plan, out, night)
    folder = tmp_path / "turn"
    assert [file.name for file in sorted(folder.glob("*.mcap"))] == ["turn-0001.mcap", "turn-0002.mcap"]
    # The turn's end meets its start, half a wobble before the last.
    assert (done.uptime, done.repetitions, len(done.falls)) == (pytest.approx(1.0, abs=1e-3), 1, 0)
    with pytest.raises(InputError, match="holds a long run already; go on with it by --resume"):
        run_night(plan, out, night)
    with pytest.raises(InputError, match=r"is complete: .* ask for more --hours"):
        run_night(plan, out, night, resume=True)
    with pytest.raises(InputError, match="holds no long run to be resumed"):
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
