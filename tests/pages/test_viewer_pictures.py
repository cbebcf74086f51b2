"""The viewer draws every kind of review without an error report in any view.

`viewer.picture_of` rejects a picture while any view of the viewer reports an error.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from synthetic_run import ARM_LENGTHS, synthetic_run, view_of

from dpcontrol.judge.comparison import compare
from dpcontrol.judge.of_log import reference_view, run_view
from dpcontrol.judge.run_view import RunView, Stay
from dpcontrol.logs import LogWriter, read_log
from dpcontrol.pages.atlas_recording import write_atlas_recording
from dpcontrol.pages.comparison_recording import write_comparison_recording
from dpcontrol.pages.picture import missing_renderer, picture_of
from dpcontrol.pages.rerun_recording import write_recording
from dpcontrol.plans.atlas import AtlasSettings, make_atlas
from dpcontrol.plans.model import load_model
from dpcontrol.references.reference import Reference, summarised
from dpcontrol.walks.atlas import Atlas

SEEN = 0.02
"""Least share of pixels that differ from the corner's: the viewer without data shows less."""

pytestmark = pytest.mark.skipif(missing_renderer() is not None, reason=str(missing_renderer()))


def logged(folder: Path, name: str, *, good: bool) -> RunView:
    """Return a run of three seconds that was done, or one that went astray and was cut at a limit."""
    view = view_of(folder / f"{name}.mcap", synthetic_run(seconds=3.0))
    asked = (Stay(0.0, 1.5, "down-up", "down-up"), Stay(1.5, 3.0, "down-up", "down-up"))
    strayed = (asked[0], Stay(2.0, 3.0, "up-down", "up-down (−1π, 0π)", wanted=False))
    plan = replace(view.plan, planned=asked, duration=3.0)
    return replace(view, plan=plan, done=asked if good else strayed, good=good)


def shown(write: Callable[[Path], None], folder: Path) -> None:
    """Take a picture and see that there is something in it, and that the viewer had nothing to say against it."""
    assert picture_of(write, folder / "picture.png", moment=1.0) is None
    pixels = imread(folder / "picture.png")[..., :3]
    assert float((np.abs(pixels - pixels[0, 0]).max(axis=-1) > 0.1).mean()) > SEEN


# That of a pair shows a good one too.
@pytest.mark.parametrize("good", [pytest.param(True, marks=pytest.mark.slow), False])
def test_a_run_is_shown_without_complaint(good: bool, tmp_path: Path) -> None:
    view = logged(tmp_path, "run", good=good)
    shown(lambda file: write_recording(view, file), tmp_path)


@pytest.mark.slow
def test_a_pair_is_shown_without_complaint(tmp_path: Path) -> None:
    pair = [logged(tmp_path, name, good=name == "good") for name in ("good", "bad")]
    shown(lambda file: write_comparison_recording(compare(pair), file), tmp_path)


@pytest.mark.slow
def test_a_recording_from_the_bench_is_shown_without_complaint(tmp_path: Path) -> None:
    time = np.arange(1000) / 1000
    with LogWriter(tmp_path / "bench.mcap", arm_lengths=ARM_LENGTHS, rate_hz=1000.0, has_cart=False) as log:
        log.ticks(time, measured=0.25 * np.sin(10 * time[:, None] + [0.0, 1.0]))
    run = read_log(tmp_path / "bench.mcap")
    shown(lambda file: write_recording(run_view(run), file), tmp_path)


@pytest.mark.slow
def test_a_reference_is_shown_without_complaint(turn: tuple[object, Reference], tmp_path: Path) -> None:
    view = reference_view(summarised(turn[1]), tmp_path / "turn.npz")
    shown(lambda file: write_recording(view, file), tmp_path)


@pytest.mark.slow
def test_an_atlas_is_shown_without_complaint(tmp_path: Path) -> None:
    atlas: Atlas = make_atlas(load_model("lab"), -0.07, settings=AtlasSettings(hits=(1, 1))).atlas
    shown(lambda file: write_atlas_recording(atlas, file), tmp_path)
