"""A file that --out names is replaced by the command that made it, and by no other without --force. Default names are
free names.
"""

from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import LogWriter, check_replaced

STILL = "still.toml"
SCENE = """
title = "Hold both arms hanging"
start = "hold"
hold = "down-down"
seconds = 0.5
[controller]
kind = "lqr"
[supervisor]
lost_tracking = 1.5
"""
LOG = Path("logs/still-0.mcap")
SWINGS = "import --simulated lab --seconds 0.5"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("logs").mkdir()
    Path(STILL).write_text(SCENE)
    return tmp_path


def called(line: str) -> None:
    ended = dpcontrol(*line.split())
    assert ended.code == 0, ended.stderr


def kept(file: Path, line: str) -> None:
    """Check that a command keeps a file, reports this, and replaces it with --force."""
    content = file.read_bytes()
    ended = dpcontrol(*line.split())
    assert ended.code == 2, ended.stderr
    assert ended.stdout == ""
    assert f"{file} is there already and " in ended.message
    assert "choose another name, or replace it with --force" in ended.message
    assert file.read_bytes() == content
    assert [one.name for one in file.parent.iterdir()] == [file.name]
    called(f"{line} --force")
    assert file.read_bytes() != content


@pytest.mark.parametrize(
    ("line", "file", "other"),
    [
        (f"run {STILL} --out", LOG, "--mismatch 0.07"),
        (f"{SWINGS} --swings 2 --out", LOG, "--seed 1"),
        ("replay swings.mcap --out", LOG, "--counts 400"),
    ],
    ids=["run", "import", "replay"],
)
def test_a_command_replaces_its_own_output_but_neither_anothers_nor_a_file_of_another_kind(
    line: str, file: Path, other: str
) -> None:
    called(f"{SWINGS} --swings 1 --out swings.mcap")
    called(f"{line} {file}")
    called(f"{line} {file}")
    kept(file, f"{line} {file} {other}")
    file.write_text("my notes")
    kept(file, f"{line} {file}")


def written(path: Path, *, rig: str | None = None, ticks: int = 50) -> None:
    """Write a log of a bench at rest."""
    with LogWriter(path, arm_lengths=(0.2, 0.2), rate_hz=1000.0, metadata={"seed": "0"}) as log:
        log.ticks(np.arange(ticks) / 1000, measured=np.zeros((ticks, 3)))
        log.result(**({} if rig is None else {"rig": rig}))


def test_logs_of_a_rig_are_always_kept() -> None:
    written(LOG, rig="udp://127.0.0.1:47000")
    with pytest.raises(InputError, match="is a log from a rig"):
        check_replaced(LOG, {"seed": "0"})
    # Before any bench is looked for: nothing answers there.
    ended = dpcontrol("run", STILL, "--rig", "udp://127.0.0.1:9", "--out", str(LOG))
    assert ended.code == 2
    assert "is a log from a rig" in ended.message
    written(LOG)
    check_replaced(LOG, {"seed": "0", "commit": "another"})
    with pytest.raises(InputError, match="not the same: rig"):
        check_replaced(LOG, {"seed": "0", "rig": "udp"})


@pytest.mark.parametrize(
    ("line", "link"),
    [
        (f"review {LOG} --save", "o.rrd"),
        (f"report {LOG} --picture", "o.png"),
        (f"plan {STILL} --out", "a.npz"),
        (f"run {STILL} --force --out", "o.mcap"),
        (f"replay {LOG} --out", "o.mcap"),
        (f"import {LOG} --out", "o.mcap"),
        ("recover logs/cut.mcap --out", "o.mcap"),
    ],
)
@pytest.mark.parametrize("way", ["hard link", "link", "name"])
def test_no_verb_replaces_its_input(line: str, link: str, way: str) -> None:
    written(LOG)
    Path("logs/cut.mcap").write_bytes(LOG.read_bytes()[:-600])
    read = Path(line.split()[1])
    content = read.read_bytes()
    if way == "name":
        link = str(read)
    else:
        Path(link).hardlink_to(read) if way == "hard link" else Path(link).symlink_to(read)
    ended = dpcontrol(*line.split(), link)
    assert ended.code == 2, ended.stdout
    assert read.read_bytes() == content
