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


pytestmark = pytest.mark.slow  # A run of a quarter of a minute.


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
    scored = dpcontrol("score", folder / "logs/outer-turn-0.mcap", "--json")
    assert (scored.code, scored.document["completed"]) == (0, True)


def test_review_without_files_opens_the_viewer_on_a_recording(
    demo: tuple[Path, Ended], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = tmp_path / "opened"
    viewer = tmp_path / "viewer"
    called = 'echo "$CI $2 $3" > "$0.called"'
    viewer.write_text(f'#!/bin/sh\n{called}\ncat > "{opened}.part" && mv "{opened}.part" "{opened}"\n')
    viewer.chmod(0o755)
    monkeypatch.setattr("dpcontrol.pages.viewer.viewer_program", lambda: viewer)
    monkeypatch.setenv("DISPLAY", ":0")
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    ended = dpcontrol("review", demo[0] / "logs/outer-turn-0.mcap")
    assert ended.code == 0
    waited = time.monotonic() + VIEWER_STARTS
    while (not opened.is_file() or any((tmp_path / "tmp").iterdir())) and time.monotonic() < waited:
        time.sleep(0.05)
    assert opened.read_bytes().startswith(RECORDING)
    # It reports nothing to its makers and listens to this computer only; its temporary files go with it.
    assert (tmp_path / "viewer.called").read_text() == "1 --bind 127.0.0.1\n"
    assert list((tmp_path / "tmp").iterdir()) == []


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
