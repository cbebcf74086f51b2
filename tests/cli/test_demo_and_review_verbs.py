"""`dpcontrol demo` and `dpcontrol review`: the files they make, and where they say these are."""

import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from command_line import Ended, dpcontrol

from dpcontrol.judge.of_log import run_view
from dpcontrol.logs import read_log

PNG, RECORDING = b"\x89PNG\r\n\x1a\n", b"RRF2"
"""First bytes of a picture (PNG specification) and of a Rerun recording."""
CUT_SPACING = 0.06
"""Scaled: half of the widest step between neighbours of the 96 trajectories that sample a cut, 0.11 here."""
VIEWER_STARTS = 20.0
"""Seconds to wait for the stand-in viewer; it takes milliseconds unless the machine is very busy."""


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Ended]:
    """A folder in which the demo was shown, and how that ended."""
    folder = tmp_path_factory.mktemp("demo")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        return folder, dpcontrol("demo")


def test_the_demo_completes_and_prints_the_paths_of_log_recording_and_picture(demo: tuple[Path, Ended]) -> None:
    folder, ended = demo
    assert ended.code == 0
    assert "completed: 1 of 1 symbols" in ended.stdout
    for suffix in ("mcap", "rrd", "png"):
        assert f"logs/outer-turn-0.{suffix}" in ended.stdout
        assert (folder / f"logs/outer-turn-0.{suffix}").is_file()
    assert (folder / "logs/outer-turn-0.png").read_bytes().startswith(PNG)
    assert (folder / "logs/outer-turn-0.rrd").read_bytes().startswith(RECORDING)
    assert len(list(folder.rglob("*.*"))) == 3


def test_the_demo_reports_its_end_on_stderr(demo: tuple[Path, Ended]) -> None:
    assert "demo: done" in demo[1].stderr


def test_the_demos_log_scores_as_completed(demo: tuple[Path, Ended]) -> None:
    scored = dpcontrol("score", demo[0] / "logs/outer-turn-0.mcap", "--json")
    assert scored.code == 0
    assert scored.document["completed"] is True


@pytest.mark.slow
def test_review_saves_recording_and_picture(demo: tuple[Path, Ended], tmp_path: Path) -> None:
    log, recording, picture = demo[0] / "logs/outer-turn-0.mcap", tmp_path / "turn.rrd", tmp_path / "turn.png"
    ended = dpcontrol("review", log, "--save", recording, "--picture", picture, "--json")
    assert ended.code == 0
    assert recording.read_bytes().startswith(RECORDING)
    assert picture.read_bytes().startswith(PNG)
    shown = ended.document
    assert (shown["recording"], shown["picture"]) == (str(recording), str(picture))
    assert sorted(f.name for f in tmp_path.iterdir()) == ["turn.png", "turn.rrd"]


def test_review_without_files_opens_the_viewer_on_a_recording(
    demo: tuple[Path, Ended], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = tmp_path / "opened"
    viewer = tmp_path / "viewer"
    called = 'echo "$CI $2 $3" > "$0.called"'
    viewer.write_text(f'#!/bin/sh\n{called}\ncp "$1" "{opened}.part" && mv "{opened}.part" "{opened}"\n')
    viewer.chmod(0o755)
    monkeypatch.setattr("dpcontrol.pages.picture.viewer_program", lambda: viewer)
    monkeypatch.setenv("DISPLAY", ":0")
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    ended = dpcontrol("review", demo[0] / "logs/outer-turn-0.mcap")
    assert ended.code == 0
    waited = time.monotonic() + VIEWER_STARTS
    while (not opened.is_file() or any((tmp_path / "tmp").iterdir())) and time.monotonic() < waited:
        time.sleep(0.05)
    assert opened.read_bytes().startswith(RECORDING)
    # It reports nothing to its makers and listens to this computer only; what was made for it goes when it is closed.
    assert (tmp_path / "viewer.called").read_text() == "1 --bind 127.0.0.1\n"
    assert list((tmp_path / "tmp").iterdir()) == []


@pytest.mark.parametrize("display", ["", ":0"])
def test_review_without_a_display_is_rejected_and_leaves_nothing(
    display: str, demo: tuple[Path, Ended], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # If the named display does not exist, the viewer itself reports this at once.
    monkeypatch.setattr("dpcontrol.pages.picture.viewer_program", lambda: Path("/bin/false"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    ended = dpcontrol("review", demo[0] / "logs/outer-turn-0.mcap")
    assert ended.code == 2
    assert ("the viewer ended at once" if display else "there is no display to open the viewer on") in ended.message
    assert "write a file with --picture FILE.png or --save FILE.rrd" in ended.message
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_two_logs_are_reviewed_together_with_their_alignment(demo: tuple[Path, Ended], tmp_path: Path) -> None:
    log = demo[0] / "logs/outer-turn-0.mcap"
    ended = dpcontrol("review", log, log, "--save", tmp_path / "two.rrd", "--picture", tmp_path / "two.png", "--json")
    assert ended.code == 0
    assert ended.document["logs"] == [str(log), str(log)]
    assert ended.document["aligned"].startswith("aligned at symbol 1")
    assert (tmp_path / "two.rrd").read_bytes().startswith(RECORDING)
    assert (tmp_path / "two.png").read_bytes().startswith(PNG)
    assert dpcontrol("review", log, log, "--align", "2", "--save", tmp_path / "none.rrd").code == 2
    assert not (tmp_path / "none.rrd").exists()


@pytest.mark.slow
def test_a_reference_is_reviewed_too_but_not_beside_a_log(demo: tuple[Path, Ended], tmp_path: Path) -> None:
    log, reference = demo[0] / "logs/outer-turn-0.mcap", tmp_path / "turn.npz"
    reference.write_bytes(read_log(log).attachments["reference.npz"])
    ended = dpcontrol("review", reference, "--save", tmp_path / "turn.rrd", "--picture", tmp_path / "turn.png")
    assert ended.code == 0
    assert (tmp_path / "turn.rrd").read_bytes().startswith(RECORDING)
    assert (tmp_path / "turn.png").read_bytes().startswith(PNG)
    beside = dpcontrol("review", log, reference, "--save", tmp_path / "none.rrd")
    assert beside.code == 2
    assert "turn.npz is not a log" in beside.stderr


@pytest.mark.parametrize(("suffix", "first"), [("png", PNG), ("pdf", b"%PDF")])
def test_report_writes_one_page_of_a_log_and_gives_its_score(
    demo: tuple[Path, Ended], tmp_path: Path, suffix: str, first: bytes
) -> None:
    page = tmp_path / f"page.{suffix}"
    ended = dpcontrol("report", demo[0] / "logs/outer-turn-0.mcap", "--picture", page, "--json")
    assert ended.code == 0
    assert ended.document["completed"] is True
    assert ended.document["picture"] == str(page)
    assert page.read_bytes().startswith(first)


def test_report_rejects_a_page_of_another_format(demo: tuple[Path, Ended], tmp_path: Path) -> None:
    ended = dpcontrol("report", demo[0] / "logs/outer-turn-0.mcap", "--picture", tmp_path / "page.svg")
    assert ended.code == 2
    assert ".png or .pdf" in ended.stderr
    assert not list(tmp_path.iterdir())


def test_the_drawn_tubes_meet_at_the_plans_section_crossing(demo: tuple[Path, Ended]) -> None:
    log = read_log(demo[0] / "logs/outer-turn-0.mcap")
    view = run_view(log)
    assert sorted(tube.stable for tube in view.plan.tubes) == [False, True]
    # The outer arm's section is θ₂ = 2πk; the plan turns it from π to 3π.
    crossing = log.reference[np.argmin(np.abs(log.reference[:, 1] - 2 * np.pi)), :4]
    for tube in view.plan.tubes:
        known = tube.cut[np.isfinite(tube.cut).all(axis=1)]
        assert known[:, 1] == pytest.approx(2 * np.pi)
        assert tube.strands[:, 0, 1] == pytest.approx(3 * np.pi if tube.stable else np.pi, abs=0.5)
        away = np.abs(known - crossing) / [1.0, 1.0, 10.0, 10.0]
        assert away.max(axis=1).min() < CUT_SPACING


def test_the_actual_itinerary_is_reported_beside_the_planned_one(demo: tuple[Path, Ended]) -> None:
    log = read_log(demo[0] / "logs/outer-turn-0.mcap")
    view = run_view(log)
    assert [stay.text for stay in view.plan.planned] == [stay.text for stay in view.done] == ["down-up", "down-up"]
    assert all(stay.wanted for stay in view.done)
    truth = log.truth
    assert truth is not None
    passed = float(log.time[np.flatnonzero(truth[:, 1] > 2 * np.pi)[0]])
    assert view.crossings[0] == pytest.approx(passed, abs=2 / log.rate_hz)


@pytest.mark.slow
def test_report_shows_the_margins_of_a_log_on_request(demo: tuple[Path, Ended], tmp_path: Path) -> None:
    page, log = tmp_path / "page.png", demo[0] / "logs/outer-turn-0.mcap"
    shown = dpcontrol("report", log, "--margins", "--picture", page, "--json").document
    assert page.read_bytes().startswith(PNG)
    assert shown["margins"] == dpcontrol("plan", "outer-turn", "--margins", "--json").document["margins"]
    assert shown["margins"]["lag"]["value"] < 0.2


@pytest.mark.slow
def test_a_stretch_of_a_log_is_filmed_and_no_viewer_opens(demo, tmp_path) -> None:
    log, film = demo[0] / "logs/outer-turn-0.mcap", tmp_path / "turn.gif"
    ended = dpcontrol("review", log, "--film", film, "--stretch", "1", "1.4", "--json")
    assert ended.code == 0, ended.stderr
    assert ended.document["film"] == str(film)
    assert film.read_bytes().startswith(b"GIF89a")
    bad = (["--stretch", "1", "2"], ["--film", tmp_path / "turn.avi"], ["--film", film, "--stretch", "9", "8"])
    for arguments in bad:
        assert dpcontrol("review", log, *arguments).code == 2
    beside = dpcontrol("review", log, log, "--film", tmp_path / "two.gif")
    assert (beside.code, "one motion" in beside.message) == (2, True)
    assert [file.name for file in tmp_path.iterdir()] == ["turn.gif"]
