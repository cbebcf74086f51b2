"""Runs out of the ordinary: held, failed at once, lost, recovered, replayed."""

from pathlib import Path

import pytest
from synthetic_run import ARM_LENGTHS, synthetic_run, write_log

from dpcontrol.judge.of_log import run_view
from dpcontrol.judge.run_view import series_of
from dpcontrol.logs import LogWriter, read_log, recover
from dpcontrol.pages.page import draw
from dpcontrol.recordings.recording import REPLAYED


def left_titles(figure) -> list[str]:
    return [title for axes in figure.axes if (title := axes.get_title(loc="left"))]


def test_every_view_of_a_recovered_log_shows_its_losses(tmp_path: Path) -> None:
    whole = write_log(tmp_path / "run.mcap", synthetic_run())
    assert "recovered" not in run_view(read_log(whole)).verdict
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    log = read_log(recover(cut).log)
    assert log.recovered
    assert f"recovered and lacks {log.recovered}" in run_view(log).verdict


@pytest.mark.slow
def test_a_replay_is_judged_as_a_prediction_not_as_tracking(tmp_path: Path) -> None:
    run = synthetic_run(seconds=1.0)
    for kind, name in ((REPLAYED, "Prediction error"), ("run", "Tracking error")):
        path = tmp_path / f"{kind}.mcap"
        with LogWriter(path, arm_lengths=ARM_LENGTHS, rate_hz=1000.0, metadata={"kind": kind}) as log:
            log.ticks(run.time, measured=run.measured, estimate=run.estimate, reference=run.reference)
        read = read_log(path)
        errors = [t for t in left_titles(draw(run_view(read))) if "error" in t]
        assert [title.startswith(name) for title in errors] == [True]
        assert series_of(read).error_name == name
        figure = draw(run_view(read))
        figure.canvas.draw()
        for axes in figure.axes:
            legend = axes.get_legend()
            if legend and (title := axes.get_title(loc="left")):
                assert not legend.get_window_extent().overlaps(axes._left_title.get_window_extent()), title
