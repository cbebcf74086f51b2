"""An internal error gives one sentence, exit code 70 and a traceback in a file. User text is escaped."""

import re
import tempfile
from pathlib import Path

import pytest
from command_line import dpcontrol

from dpcontrol.foundation.shipped import find

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
    document = dpcontrol("model", "lab", "--json").document
    assert document["error"] is True
    assert "please report it" in document["status"]


def test_user_text_is_printed_unchanged_and_cannot_control_the_terminal() -> None:
    text = re.sub("(?m)^title = .*$", lambda _: f'title = "{BROKEN}"', find("models", "lab").read_text())
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
