"""`dpcontrol commission` and `rig`: measurements go into the scene's [run], and runs use a bench of another process."""

import json
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from command_line import PROGRAM, dpcontrol

from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.rig import commissioning
from dpcontrol.rig.commissioning import CommissioningSettings

ROOT = Path(__file__).parents[2]
QUICK = CommissioningSettings(look=0.2, hold=0.5, sweep=4.0, ring=2.0, wait=3.0)


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An itinerary at 500 Hz in the working folder, which halves the time of commissioning."""
    monkeypatch.setattr(commissioning, "CommissioningSettings", lambda: QUICK)
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "mine.toml"
    text = (ROOT / "itineraries" / "outer-turn.toml").read_text()
    file.write_text(text.replace("= 1000.0 ", "= 500.0  "))
    return file


@pytest.mark.slow
def test_measured_values_are_written_once_and_then_equal_those_of_the_file(scene: Path) -> None:
    before = scene.read_text().splitlines()
    bench = ("--fault", "zeros-off", "--delay", "2.5", "--lag", "0.008", "--counts", "2000")
    first = dpcontrol("commission", scene, *bench)
    assert first.code == 1
    assert "as --write does" in first.stdout
    assert scene.read_text().splitlines() == before
    written = dpcontrol("commission", scene, *bench, "--write", "--json")
    assert written.code == 0
    document = written.document
    assert document["written"] == str(scene)
    assert document["measured"]["delay"] == pytest.approx(2.5, abs=0.01)
    after = scene.read_text().splitlines()
    kept = [line for line in before if not line.startswith(("delay", "counts"))]
    assert [line for line in after if line in kept] == kept
    assert len(after) == len(before) + 3
    loaded = load_itinerary(str(scene))
    assert loaded.loop.drive.lag == pytest.approx(0.008, abs=1e-4)
    assert loaded.zeros == pytest.approx((0.03, -0.02), abs=1e-3)
    assert loaded.loop.sensors.counts == 2000
    again = dpcontrol("commission", scene, *bench)
    assert again.code == 0
    assert "wrong" not in again.stdout


@contextmanager
def bench(folder: Path, *options: str) -> Iterator[str]:
    """Start an example bench in another process, and give its address."""
    command = [PROGRAM, "rig", "outer-turn", "--runs", "1", "--json", *options]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline()]
        while lines[-1].strip() != "}":
            lines.append(process.stdout.readline())
        yield json.loads("".join(lines))["address"]
        assert process.wait(60) == 0


@pytest.mark.slow
def test_a_run_on_a_bench_in_another_process_is_logged_without_truth(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    with bench(tmp_path) as address:
        wrong = dpcontrol("run", "outer-turn", "--rig", address, "--rate", "500", "--out", tmp_path / "no.mcap")
    assert wrong.code == 2
    assert "run with --rate 1000" in wrong.message
    ended = dpcontrol("run", "outer-turn", "--rig", "udp", "--real-time", "--out", log, "--json")
    shown = ended.document
    assert shown["completed"] is None
    assert "the true state is not known" in shown["reason"]
    # A computer that stalls for a tenth of a second loses the arms, and the run must report this.
    assert shown["deadlines"]["ticks"] > 0
    assert 0 < shown["thinking"]["median"] <= shown["thinking"]["within_99"]
    assert ended.code == (0 if shown["ending"] == "finished" and shown["symbols_completed"] == 1 else 1)
    found = dpcontrol("info", log, "--json").document
    assert found["metadata"]["deadlines_missed"] == str(shown["deadlines"]["missed"])
    assert "/estimate/joint_states" in json.dumps(found)
    assert "/truth/joint_states" not in json.dumps(found)
    again = dpcontrol("run", "--from", log)
    assert again.code == 2
    assert f"it was made on the rig at {found['metadata']['rig']}" in again.message
    assert not (tmp_path / "logs").exists()
