"""Pictures of a run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from synthetic_run import synthetic_run, view_of

from dpcontrol.judge.run_view import RunView
from dpcontrol.pages.charts import curve
from dpcontrol.pages.layout import save_figure
from dpcontrol.pages.page import draw
from dpcontrol.pages.rerun_recording import write_recording

PIXELS_SET = 0.02
"""Least share of pixels that differ from the background in a picture that shows something."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunView:
    return view_of(tmp_path_factory.mktemp("runs") / "run.mcap", synthetic_run())


def _share_set(path: Path) -> float:
    pixels = imread(path)[..., :3]
    return float((np.abs(pixels - pixels[0, 0]).max(axis=-1) > 0.1).mean())


def test_thinned_curves_keep_every_peak(run: RunView) -> None:
    time_s = np.linspace(0, 1, 100_000)
    values = np.sin(40 * time_s)
    values[[777, 50_000]] = 5.0, -5.0
    thin_time, thin_values = curve(run, time_s, values)
    assert len(thin_time) < 3_100
    assert (thin_values.max(), thin_values.min()) == (5.0, -5.0)
    assert (np.diff(thin_time) > 0).all()


@pytest.mark.slow
def test_a_run_that_went_wrong_beyond_numbers_is_still_shown(tmp_path: Path) -> None:
    made = synthetic_run(seconds=2.0)
    for spoilt, since in ((1e300, 1200), (np.nan, 0)):
        estimate, truth, control = made.estimate.copy(), made.truth.copy(), made.control.copy()
        for array in (estimate, truth, control):
            array[since:] = spoilt
        bad = replace(made, estimate=estimate, truth=truth, control=control)
        view = replace(view_of(tmp_path / "run.mcap", bad), energy=truth[:, 0])
        write_recording(view, tmp_path / "run.rrd")
        save_figure(draw(view), tmp_path / "run.png")
        assert _share_set(tmp_path / "run.png") > PIXELS_SET
