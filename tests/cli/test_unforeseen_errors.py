"""An internal error gives one sentence, exit code 70 and a traceback in a file. User text is escaped."""

import os
import re
import sys
import tempfile
import zipfile
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import progress_bar
from dpcontrol.logs import LogWriter, read_log
from dpcontrol.recordings.recording import recording_of

BROKEN = r"[/nope] \u001b[31mred \u009b1m $\\frac{$ :smile:"
"""A title as TOML writes it: rich's markup, ANSI sequences, half a formula, an emoji's name."""
SHOWN = r"[/nope] \x1b[31mred \x9b1m $\frac{$ :smile:"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


@pytest.fixture
def defect(monkeypatch: pytest.MonkeyPatch) -> None:
    """A verb with an error that nobody foresaw."""

    def broken(name: str) -> None:
        raise ZeroDivisionError(f"the \x1b[31mmodel {name} is odd")

    monkeypatch.setattr("dpcontrol.plans.model.load_model", broken)


@pytest.mark.usefixtures("defect")
def test_an_error_that_no_verb_foresaw_is_one_sentence_and_a_traceback_in_a_file(folder: Path) -> None:
    ended = dpcontrol("model", "lab")
    assert ended.code == 70
    assert ended.stdout == ""
    (line,) = ended.stderr.splitlines()
    assert r"ZeroDivisionError: the \x1b[31mmodel lab is odd; please report it with the file " in line
    (file,) = folder.iterdir()
    assert str(file) in line
    kept = file.read_text()
    assert kept.startswith("dpcontrol ")
    assert "\nmodel lab\n" in kept
    assert "Traceback" in kept
    assert "in broken" in kept


@pytest.mark.usefixtures("defect")
@pytest.mark.parametrize("line", ["--debug model lab", "model lab --debug"])
def test_debug_shows_the_traceback(line: str) -> None:
    ended = dpcontrol(*line.split())
    assert ended.code == 70
    assert "Traceback" in ended.stderr
    assert "in broken" in ended.stderr
    assert "please report it" in ended.message


@pytest.mark.usefixtures("defect")
def test_json_reports_internal_errors_too() -> None:
    ended = dpcontrol("model", "lab", "--json")
    assert ended.code == 70
    assert ended.document["error"] is True
    assert "please report it" in ended.document["status"]


def test_an_error_of_a_file_or_of_memory_needs_no_report(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    for error, code, naming in (
        (PermissionError(13, "Permission denied", "far/off"), 2, "far/off: Permission denied"),
        (MemoryError("Unable to allocate 7 TiB"), 1, "not enough memory"),
    ):
        monkeypatch.setattr("dpcontrol.plans.model.load_model", lambda name, error=error: (_ for _ in ()).throw(error))
        ended = dpcontrol("model", "lab")
        assert ended.code == code
        assert naming in ended.message
    assert list(folder.iterdir()) == []


def test_user_text_is_printed_unchanged_and_cannot_control_the_terminal(shipped_text: dict[str, str]) -> None:
    text = re.sub("(?m)^title = .*$", lambda _: f'title = "{BROKEN}"', shipped_text["lab"])
    Path("mine.toml").write_text(text)
    ended = dpcontrol("model", "mine.toml")
    assert ended.code == 0
    assert SHOWN in " ".join(ended.stdout.split())
    raw = dpcontrol("model", "mine.toml", "--json")
    assert raw.document["title"] == SHOWN.replace(r"\x1b", "\x1b").replace(r"\x9b", "\x9b")
    assert not re.search(r"[\x1b\x9b]", ended.stdout + raw.stdout)
    Path("mine.toml").write_text(text.replace("gravity", '"\\u001b[2Jgravity"', 1))
    for arguments in (("model", "mine.toml"), ("model", "\x1b[2Jlab"), ("model", "lab", "--\x1b[2J"), ("\x1b[2J",)):
        ended = dpcontrol(*arguments)
        assert ended.code == 2
        assert r"\x1b[2J" in ended.stderr
        assert "\x1b" not in ended.stderr


def test_a_users_text_steers_no_progress_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(stream, "isatty", lambda: True, raising=False)
    with progress_bar("[/nope]") as report:
        report("family [/nope] \x1b]0;title\x07", 0.5)
    assert "[/nope]" in stream.getvalue()
    assert "\x1b]0;" not in stream.getvalue()


def test_half_a_formula_in_a_title_is_drawn_as_text(folder: Path) -> None:
    from dpcontrol.pages.layout import new_figure, save_figure

    figure = new_figure(4, 3)
    figure.suptitle(r"costs $5 \frac{$ and more")
    figure.add_subplot().semilogy([1e-3, 1.0])
    save_figure(figure, folder / "page.png")
    assert (folder / "page.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("line", "naming"),
    [
        ("connect lab --from down-up --to down-up --energy sNaN", "--energy sNaN: must be a finite number"),
        ("connect lab --from down-up --to down-up --energy 1e999", "--energy 1e999: must be a finite number"),
        ("walk lab --energy sNaN", "--energy sNaN: must be a finite number"),
        (
            "connect lab --from down-up --to down-up --energy -0.07 --longest nan",
            "longest = nan: must be a number in the range",
        ),
        ("connect lab --from down-up --to down-up --energy -0.07 --longest inf", "longest = inf: must be a finite"),
        ("walk lab --energy -0.07 --random 2 --lengths 1 99999999999999999999", "--lengths: a number with"),
        ("walk lab --energy -0.07 --random 2 --extra-wraps 0 99999999999999999999", "--extra-wraps: a number with"),
        ("replay loop.mcap", "cannot read loop.mcap: it is a link that leads to itself"),
        ("import loop.csv --out loop.mcap", "cannot write loop.mcap: it is a link that leads to itself"),
        ("import loop.csv", "cannot read loop.csv: it is a link that leads to itself"),
        ("run outer-turn --rig udp://" + 240 * "n" + ":47000", "must be udp://HOST:PORT"),
        ("run outer-turn --rig udp://" + 90 * "n." + ":47000", "udp://n.n.n."),
    ],
)
def test_hostile_values_are_rejected_in_a_sentence(line: str, naming: str) -> None:
    for name in ("loop.mcap", "loop.csv"):
        Path(name).symlink_to(name)
    ended = dpcontrol(*line.split())
    assert ended.code == 2, ended.stderr
    assert naming in ended.stderr


def test_wraps_beyond_all_bounds_and_symbols_nested_two_hundred_deep_are_rejected() -> None:
    walk = ("walk", "lab", "--energy", "-0.07", "--solve")
    endless = dpcontrol(*walk, "-s", "down-up +", "-s", "down-up +", "--wraps", "99999999999999999999")
    nested = dpcontrol(*walk, "-s", 200 * "(" + "down-up +" + 200 * ")")
    assert (endless.code, nested.code) == (2, 2)
    assert "--wraps: a number with too many digits" in endless.message
    assert "may be nested at most 20 deep" in nested.message


@pytest.mark.slow
def test_names_as_long_as_the_system_allows_are_written_and_cached(shipped_text: dict[str, str]) -> None:
    name = 240 * "n"
    Path(f"{name}.toml").write_text(shipped_text["hold-down-down"])
    assert dpcontrol("plan", f"{name}.toml", "--out", f"{name}.npz").code == 0
    assert dpcontrol("reference", f"{name}.npz", "--picture", f"{name}.png").code == 0
    assert sorted(os.listdir(".")) == [f"{name}.npz", f"{name}.png", f"{name}.toml"]


def test_an_archive_with_false_shapes_or_deep_nesting_is_rejected() -> None:
    assert dpcontrol("plan", "hold-down-down", "--out", "plan.npz").code == 0
    sound = dict(np.load("plan.npz"))
    long, deep = 10**15, 4000
    heads = {
        "long": f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({long}, 6)}}",
        "negative": "{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 6)}",
        "nested": "{'descr': '<f8', 'fortran_order': False, 'shape': " + deep * "(" + deep * ")" + "}",
        "open": "{'descr': '<f8', 'fortran_order': False, 'shape': " + deep * "(",
    }
    for kind, head in heads.items():
        np.savez(f"{kind}.npz", **{k: v for k, v in sound.items() if k != "states"})
        data = head.encode() + b"\n"
        with zipfile.ZipFile(f"{kind}.npz", "a") as file:
            file.writestr("states.npy", b"\x93NUMPY\x01\x00" + len(data).to_bytes(2, "little") + data)
    np.savez("header.npz", **{**sound, "header": np.array(100_000 * "[")})
    for kind in (*heads, "header"):
        for arguments in (("reference", f"{kind}.npz"), ("review", f"{kind}.npz", "--save", "x.rrd")):
            ended = dpcontrol(*arguments)
            assert ended.code == 2, ended.stderr
            assert f"{kind}.npz is not a" in ended.message
            assert len(ended.message) < 500


def test_a_log_whose_time_runs_backward_is_no_recording(folder: Path) -> None:
    with LogWriter(folder / "still.mcap", arm_lengths=(0.2, 0.2), rate_hz=1000.0) as log:
        log.ticks(np.arange(50) / 1000, measured=np.zeros((50, 3)))
    log = read_log(folder / "still.mcap")
    backward = log.time.copy()
    backward[20:] -= 0.01
    with pytest.raises(InputError, match=r"time runs backward after 0\.019 s"):
        recording_of(replace(log, time=backward))


def test_a_picture_whose_curves_reach_too_far_is_rejected_in_a_sentence(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    from dpcontrol.pages.layout import new_figure, save_figure

    figure = new_figure(4, 3)

    def overflowing(*arguments: object, **others: object) -> None:
        raise OverflowError("In draw_path: Exceeded cell block limit")

    monkeypatch.setattr(figure, "savefig", overflowing)
    with pytest.raises(InputError, match=r"cannot draw .*page\.png: its curves reach too far"):
        save_figure(figure, folder / "page.png")
    assert list(folder.iterdir()) == []
