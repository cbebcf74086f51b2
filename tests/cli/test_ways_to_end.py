"""Ways in which a command may end or fail that have nothing to do with its work, each with a true sentence."""

import errno
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import pytest
from command_line import PROGRAM, dpcontrol

from dpcontrol.cli import main as program
from dpcontrol.foundation.errors import InputError
from dpcontrol.rig.packets import shared_key
from dpcontrol.walks.symbols import parse_symbol

SCENE = """
title = "Hold both arms hanging"
start = "hold"
hold = "down-down"
[run]
"""

ENDED = """
import os, signal, sys, time
from dpcontrol.__main__ import main
from dpcontrol.cli import main as program
def works(*_, **__):
    os.kill(os.getpid(), {number})
    time.sleep({seconds})
program.cli.main = works
main()
"""


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="SIGHUP is POSIX's")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_signal_ends_a_command_with_a_sentence(name: str) -> None:
    number = signal.Signals[name]
    # The tests may run under nohup.
    default = f"import signal; signal.signal({int(number)}, signal.SIG_DFL)\n"
    code = default + ENDED.format(number=int(number), seconds=60)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=50)
    assert done.returncode == 128 + number
    assert done.stderr == f"dpcontrol: ended by {name}; finished results are kept\n"


@pytest.mark.skipif(shutil.which("nohup") is None, reason="nohup is POSIX's")
def test_a_command_under_nohup_survives_the_end_of_its_terminal() -> None:
    command = ["nohup", sys.executable, "-c", ENDED.format(number=1, seconds=0)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=50)
    assert (done.returncode, "ended" in done.stderr) == (0, False)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="/dev/full is Linux's")
def test_full_streams_are_named_and_keep_the_exit_code() -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run([PROGRAM, "cache"], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
        assert (done.returncode, done.stderr) == (
            1, "dpcontrol: no space left on standard output; free space, or redirect it elsewhere\n",
        )  # fmt: skip
        assert subprocess.run([PROGRAM, "model", "nosuch"], stderr=full, check=False).returncode == 2


@pytest.mark.parametrize("command", ["--help", "model lab"])
def test_a_command_whose_reader_has_ended_misses_no_goal(command: str) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    done = subprocess.run(
        [PROGRAM, *command.split()], stdout=writer, stderr=subprocess.PIPE, env=environment, check=False
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, b"")


@pytest.mark.slow
@pytest.mark.parametrize("streams", ["2>&-", "<&- 2>&-"])
def test_a_command_without_stderr_does_its_work(tmp_path: Path, streams: str) -> None:
    command = f'exec "$@" {streams}'
    arguments = ["import", "--simulated", "lab", "--swings", "1", "--seconds", "1", "--out", "swing.mcap", "--json"]
    done = subprocess.run(
        ["sh", "-c", command, "sh", PROGRAM, *arguments], cwd=tmp_path, stdout=subprocess.PIPE, check=False
    )
    assert done.returncode == 0
    assert b'"swing.mcap"' in done.stdout
    assert [file.name for file in tmp_path.iterdir()] == ["swing.mcap"]


@pytest.mark.parametrize(
    ("blow", "said"),
    [
        ("arm = 1\nimpulse = 0.01", "[[run.blows]] 1, the key 'time' is missing"),
        ("tiem = 1.0", "is 'tiem' a misspelling of it?"),
    ],
)
def test_a_blow_without_a_time_gives_one_sentence(tmp_path: Path, blow: str, said: str) -> None:
    file = tmp_path / "struck.toml"
    file.write_text(f"{SCENE}[[run.blows]]\n{blow}\n")
    ended = dpcontrol("plan", file)
    assert ended.code == 2
    assert said in ended.message


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("Down-Up +", "down-up +"), ("DOWN-UP > up-down", "down-up > up-down"), ("l1 -", "L1 -"),
        ("DOWN-UP > Up-down -", "down-up > up-down -"), ("Down-Up > DOWN-UP +", "down-up > down-up +"),
    ],
)  # fmt: skip
def test_symbols_in_other_letters_are_named_as_they_should_be_written(text: str, meant: str) -> None:
    with pytest.raises(InputError, match=f"the case of letters matters; write '{meant}'".replace("+", r"\+")):
        parse_symbol(text, ["down-up", "up-down", "L1"])
    assert parse_symbol(meant, ["down-up", "up-down", "L1"]).text == meant
    with pytest.raises(InputError, match="'Up-dwn' has no tubes"):
        parse_symbol("DOWN-UP > Up-dwn", ["down-up", "up-down"])


def test_names_in_capitals_are_recognised() -> None:
    assert "did you mean 'lab'?" in dpcontrol("model", "LAB").message
    assert "did you mean 'turn-from-rest'?" in dpcontrol("plan", "TURN-FROM-REST").message


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes with names are POSIX's")
def test_a_key_file_that_is_a_pipe_is_rejected_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "key")
    reader = "import pathlib; from dpcontrol.rig.packets import shared_key; shared_key(pathlib.Path('key'))"
    program = [sys.executable, "-c", reader]
    done = subprocess.run(program, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=30)
    assert "it is a pipe; give a regular file" in done.stderr
    (tmp_path / "file").write_text("k" * 64)
    assert shared_key(tmp_path / "file") == b"k" * 64


@pytest.mark.parametrize(
    ("filename", "free", "said"),
    [
        (
            "{tmp}/dpcontrol-x/run.rrd",
            1,
            "no space left in the folder of temporary files, {tmp}; free space, or set TMPDIR",
        ),
        (None, 0, "no space left in the folder of temporary files, {tmp}"),
        ("logs/run.mcap", 1, "no space left in the output folder"),
    ],
)
def test_a_full_folder_of_temporary_files_is_named(
    monkeypatch: pytest.MonkeyPatch, filename: str | None, free: int, said: str
) -> None:
    folder = tempfile.gettempdir()

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), filename and filename.format(tmp=folder))

    monkeypatch.setattr(program.cli, "main", full)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
    ended = dpcontrol("model", "lab")
    assert ended.code == 1
    assert said.format(tmp=folder) in ended.message


def test_a_live_view_without_a_display_recommends_options_that_exist(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rerun")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    ended = dpcontrol("run", "outer-turn", "--live")
    assert ended.code == 2
    advised = ended.message.partition("is set); ")[2]
    assert advised == "leave out --live, and draw the log with `dpcontrol review LOG --picture FILE.png`"
