"""Two commands that write one file at the same time, and files that are written through links."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol

from dpcontrol.foundation.files import write_folder, write_whole
from dpcontrol.logs import LogWriter, read_log

SWINGS = ("import", "--simulated", "lab", "--swings", "1", "--seconds", "1", "--out", "swing.mcap")
PAUSED = """
import sys
from dpcontrol.cli.main import main
from dpcontrol.recordings import recording
write = recording.write_recording
def paused(*given, **options):
    print("begun", flush=True)
    sys.stdin.readline()
    return write(*given, **options)
recording.write_recording = paused
main(sys.argv[1:])
"""


@pytest.fixture
def writing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[subprocess.Popen[str]]:
    """A command that is about to write swing.mcap in the working folder, and goes on after a line on its input."""
    monkeypatch.chdir(tmp_path)
    program = [sys.executable, "-c", PAUSED, *SWINGS]
    with subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=os.environ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "begun\n"
        yield other


@pytest.mark.slow
@pytest.mark.parametrize("file", ["swing.mcap", "link.mcap"])
def test_the_first_of_two_commands_that_write_one_file_wins(writing: subprocess.Popen[str], file: str) -> None:
    Path("link.mcap").symlink_to("swing.mcap")
    ended = dpcontrol(*SWINGS[:-1], file, "--seed", "1", "--force")
    writing.communicate("\n")
    assert (writing.returncode, ended.code) == (0, 2)
    assert f"cannot write {file}: another dpcontrol command is writing it" in ended.message
    # The claim has ended with the command.
    again = dpcontrol(*SWINGS[:-1], file, "--seed", "1", "--force")
    assert again.code == 0, again.stderr


def test_files_are_written_to_the_target_of_a_link(tmp_path: Path) -> None:
    there = tmp_path / "shared"
    there.mkdir()
    for name in ("table", "run.mcap"):
        (tmp_path / name).symlink_to(there / name)
    write_whole(tmp_path / "table", b"first")
    write_whole(tmp_path / "table", b"second")
    assert (there / "table").read_bytes() == b"second"
    with LogWriter(tmp_path / "run.mcap", arm_lengths=(0.3,), rate_hz=100.0, has_cart=False) as log:
        log.ticks([0.0], measured=np.array([[0.5]]))
    assert read_log(there / "run.mcap").measured.tolist() == [[0.5]]
    assert all((tmp_path / name).is_symlink() for name in ("table", "run.mcap"))
    assert sorted(file.name for file in there.iterdir()) == ["run.mcap", "table"]


def test_a_folder_is_written_to_the_target_of_a_link(tmp_path: Path) -> None:
    (tmp_path / "shared").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "shared")
    write_folder(tmp_path / "link", {"code.c": "int x;"})
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "shared" / "code.c").read_text() == "int x;"
