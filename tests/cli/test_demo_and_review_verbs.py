"""`dpcontrol demo` and `dpcontrol review`: the files they make, and where they say these are."""

import time
from pathlib import Path

import pytest
from command_line import Ended, dpcontrol

PNG, RECORDING = b"\x89PNG\r\n\x1a\n", b"RRF2"
"""First bytes of a picture (PNG specification) and of a Rerun recording."""
VIEWER_STARTS = 20.0
"""Seconds to wait for the stand-in viewer; it takes milliseconds unless the machine is very busy."""


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Ended]:
    """A folder in which the demo was shown, and how that ended."""
    folder = tmp_path_factory.mktemp("demo")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("VK_DRIVER_FILES", "/nonexistent")
        return folder, dpcontrol("demo")


def test_the_demo_completes_and_says_where_log_recording_and_picture_are(demo: tuple[Path, Ended]) -> None:
    folder, ended = demo
    assert ended.code == 0
    assert "completed: 1 of 1 symbols" in ended.stdout
    for suffix in ("mcap", "rrd", "png"):
        assert f"logs/outer-turn-0.{suffix}" in ended.stdout
        assert (folder / f"logs/outer-turn-0.{suffix}").is_file()
    assert (folder / "logs/outer-turn-0.png").read_bytes().startswith(PNG)
    assert (folder / "logs/outer-turn-0.rrd").read_bytes().startswith(RECORDING)
    assert len(list(folder.rglob("*.*"))) == 3


def test_the_demo_shows_its_progress_on_stderr(demo: tuple[Path, Ended]) -> None:
    assert "100%" in demo[1].stderr


def test_the_demos_log_scores_as_completed(demo: tuple[Path, Ended]) -> None:
    scored = dpcontrol("score", demo[0] / "logs/outer-turn-0.mcap", "--json")
    assert scored.code == 0
    assert scored.document["completed"] is True


def test_review_saves_recording_and_picture_and_names_the_renderer(demo: tuple[Path, Ended], tmp_path: Path) -> None:
    log, recording, picture = demo[0] / "logs/outer-turn-0.mcap", tmp_path / "turn.rrd", tmp_path / "turn.png"
    ended = dpcontrol("review", log, "--save", recording, "--picture", picture, "--json")
    assert ended.code == 0
    assert recording.read_bytes().startswith(RECORDING)
    assert picture.read_bytes().startswith(PNG)
    shown = ended.document
    assert (shown["recording"], shown["picture"]) == (str(recording), str(picture))
    assert shown["renderer"] == "matplotlib"
    assert "matplotlib" in shown["status"]
    assert sorted(f.name for f in tmp_path.iterdir()) == ["turn.png", "turn.rrd"]


def test_review_without_files_opens_the_viewer_on_a_recording(
    demo: tuple[Path, Ended], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = tmp_path / "opened"
    viewer = tmp_path / "viewer"
    viewer.write_text(f'#!/bin/sh\ncp "$1" "{opened}.part" && mv "{opened}.part" "{opened}"\n')
    viewer.chmod(0o755)
    monkeypatch.setattr("dpcontrol.review.viewer.viewer_program", lambda: viewer)
    ended = dpcontrol("review", demo[0] / "logs/outer-turn-0.mcap")
    assert ended.code == 0
    waited = time.monotonic() + VIEWER_STARTS
    while not opened.is_file() and time.monotonic() < waited:
        time.sleep(0.05)
    assert opened.read_bytes().startswith(RECORDING)
