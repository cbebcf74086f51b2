"""`dpcontrol commission`: what is wrong is said with a remedy, and what was measured goes into the scene's [run]."""

import json
import subprocess
from pathlib import Path

import pytest
from command_line import PROGRAM, dpcontrol, dpcontrol_program

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


def test_nothing_is_written_while_the_rig_is_wrong(scene: Path) -> None:
    before = scene.read_bytes()
    ended = dpcontrol("commission", scene, "--fault", "encoders-swapped", "--delay", "2", "--write")
    assert ended.code == 1
    assert "→ swap their plugs" in ended.stdout
    assert "is unchanged until the rig has no fault" in ended.stdout
    assert scene.read_bytes() == before


@pytest.mark.slow
def test_a_shipped_scene_is_copied_into_the_working_folder(scene: Path) -> None:
    shipped = ROOT / "itineraries" / "outer-turn.toml"
    before = shipped.read_bytes()
    ended = dpcontrol("commission", "outer-turn", "--delay", "1.5", "--write")
    assert ended.code == 0
    assert "itineraries/outer-turn.toml: [run] now has delay = 1.5" in ended.stdout
    assert shipped.read_bytes() == before
    assert load_itinerary("outer-turn").loop.drive.delay == pytest.approx(1.5, abs=0.01)


@pytest.mark.slow  # Some 15 s in real time, twice.
def test_a_bench_in_another_process_is_commissioned_over_udp(tmp_path: Path) -> None:
    command = [PROGRAM, "rig", "outer-turn", "--hanging", "--runs", "1", "--json", "--fault", "drive-reversed"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as bench:
        assert bench.stdout is not None
        lines = [bench.stdout.readline()]
        while lines[-1].strip() != "}":
            lines.append(bench.stdout.readline())
        address = json.loads("".join(lines))["address"]
        ended = dpcontrol_program(
            "commission", "outer-turn", "--rig", address, "--real-time", "--write", "--json", folder=tmp_path
        )
        assert bench.wait(60) == 0
    assert ended.code == 1
    document = ended.document
    assert not (tmp_path / "itineraries").exists()
    late = next(f for f in document["findings"] if f["step"] == "deadlines")
    if late["verdict"] != "wrong":
        (wrong,) = [f for f in document["findings"] if f["verdict"] == "wrong"]
        assert "the drive is reversed" in wrong["sentence"]
