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


def test_a_shipped_scene_is_copied_into_the_working_folder(scene: Path) -> None:
    shipped = ROOT / "itineraries" / "outer-turn.toml"
    before = shipped.read_bytes()
    ended = dpcontrol("commission", "outer-turn", "--delay", "1.5", "--write")
    assert ended.code == 0
    assert "itineraries/outer-turn.toml: [run] now has delay = 1.5" in ended.stdout
    assert shipped.read_bytes() == before
    assert load_itinerary("outer-turn").loop.drive.delay == pytest.approx(1.5, abs=0.01)


def test_an_inline_table_is_updated_as_well(scene: Path) -> None:
    inline = scene.with_name("inline.toml")
    head, tail = scene.read_text().split("[run]")
    values = [line.split("#")[0].strip() for line in tail.splitlines() if "=" in line]
    inline.write_text(f"run = {{ {', '.join(values)} }}\n{head}")
    ended = dpcontrol("commission", inline, "--delay", "1.5", "--write")
    assert ended.code == 0, ended.message
    assert load_itinerary(str(inline)).loop.drive.delay == pytest.approx(1.5, abs=0.01)


def test_a_file_that_cannot_be_written_is_reported_without_losing_measurements(scene: Path, monkeypatch) -> None:
    def full(*_: object) -> None:
        raise commissioning_error()

    monkeypatch.setattr("dpcontrol.cli.run.write_whole", full)
    ended = dpcontrol("commission", scene, "--write")
    assert ended.code == 1
    assert "no space" in ended.message
    assert "delay: the delay is" in ended.stdout


def commissioning_error() -> Exception:
    from dpcontrol.foundation.errors import InputError

    return InputError("cannot write mine.toml: no space left; choose another file or folder")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--real-time",), "add --rig"),
        (("--rig", "udp://127.0.0.1:1", "--fault", "zeros-off"), "omit them with --rig"),
        (("--rig", "udp://127.0.0.1:1", "--lag", "0.1"), "omit them with --rig"),
        (("--rig", "tcp://x:1"), "must be udp://HOST:PORT"),
        (("--fault", "encoder-2-reversd"), "did you mean 'encoder-2-reversed'?"),
        (("--switches", "nan"), "switches = nan: must be 0.02 to 100 m"),
        (("--rate", "10"), "takes at least 20 Hz; raise its rate"),
        (("--switches", "0.001"), "switches = 0.001: must be 0.02 to 100 m"),
    ],
)
def test_impossible_options_give_one_sentence(scene: Path, arguments: tuple[str, ...], sentence: str) -> None:
    ended = dpcontrol("commission", scene, *arguments)
    assert ended.code == 2
    assert sentence in ended.stderr


def test_zeros_for_other_arms_are_rejected_by_name(scene: Path) -> None:
    scene.write_text(scene.read_text() + "zeros = [0.1]\n")
    ended = dpcontrol("commission", scene)
    assert ended.code == 2
    assert "[run] zeros has 1 values; give one for each of 2 arms" in ended.message


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


@pytest.mark.slow  # A whole run is exported.
def test_an_exported_program_is_remarked_to_take_no_zeros_off(scene: Path) -> None:
    hold = scene.with_name("hold.toml")
    text = (ROOT / "itineraries" / "hold-down-down.toml").read_text()
    hold.write_text(f"{text}zeros = [0.03, -0.02]\n")
    ended = dpcontrol("export", hold, "--out", scene.with_name("controller"))
    assert ended.code == 0
    assert "[run] zeros = [0.03, -0.02] is not in the exported program" in ended.stderr
