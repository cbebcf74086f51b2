"""Runs out of the ordinary: held, failed at once, lost, recovered, replayed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_run import ARM_LENGTHS, synthetic_run, view_of, write_log

from dpcontrol.judge.of_log import run_view
from dpcontrol.judge.run_view import PlanView, series_of
from dpcontrol.judge.score import Score
from dpcontrol.logs import LogWriter, read_log, recover
from dpcontrol.pages.filmstrip import film_times
from dpcontrol.pages.page import draw
from dpcontrol.recordings.recording import REPLAYED


def left_titles(figure) -> list[str]:
    return [title for axes in figure.axes if (title := axes.get_title(loc="left"))]


@pytest.mark.parametrize(("symbols", "said"), [(0, "completed: stayed"), (2, "completed: 2 of 2 symbols; stayed")])
def test_a_run_that_had_no_symbols_to_do_counts_none(symbols: int, said: str) -> None:
    figures = dict.fromkeys(("rms_tracking_error", "max_cart_position", "rms_cart_acceleration", "nis_inside_95"), 0.0)
    score = Score(
        "a.mcap", 0, True, symbols, symbols, wraps=(), real_time_factor=None, reason="stayed at up-up to the end",
        **figures,
    )  # fmt: skip
    assert score.sentence == f"{said} at up-up to the end"


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


@pytest.mark.parametrize("seconds", [0.3, 0.6, 5.0])
def test_the_film_of_a_failed_run_leaves_no_long_stretch_out(tmp_path: Path, seconds: float) -> None:
    run = view_of(tmp_path / "run.mcap", synthetic_run(seconds=seconds))
    time = run.time
    shown = film_times(replace(run, plan=PlanView(symbols=((2.4, "down-up +"),)), good=False), frames=8)
    assert len(shown) == 8
    assert (np.diff(shown) > 0).all()
    assert shown[-1] == pytest.approx(time[-1])
    if seconds < 1.6:
        # A run that fails before its first symbol: all instants evenly.
        assert np.diff(shown).max() < 1.5 * seconds / 7


@pytest.mark.slow
def test_data_before_a_lost_estimate_stay_visible(tmp_path: Path) -> None:
    view = view_of(tmp_path / "run.mcap", synthetic_run())
    assert view.nis is not None
    nis = view.nis.copy()
    nis[-400:] = 1e5
    lost = replace(view, nis=nis)
    for case, least in ((view, 0.3), (lost, 0.05)):
        figure = draw(case)
        figure.canvas.draw()
        (axes,) = [axes for axes in figure.axes if axes.get_title(loc="left").startswith("NIS")]
        box = axes.get_window_extent()
        # The NIS of three positions is 3 in the mean.
        height = axes.transData.transform((1.0, 3.0))[1]
        assert least < (height - box.y0) / box.height < 0.9
        top = axes.transData.transform((1.0, 1e5))[1]
        assert (top < box.y1) == (case is lost)


@pytest.mark.slow
@pytest.mark.parametrize("span", [1e-4, 1e-2, 0.5, 20.0])
def test_labels_of_an_angle_distinguish_its_ticks(tmp_path: Path, span: float) -> None:
    run = synthetic_run()
    held = np.pi + span * (run.truth[:, :2] - run.truth[:, :2].min()) / np.ptp(run.truth[:, :2])
    still = replace(run, truth=np.column_stack([held, run.truth[:, 2:]]))
    view = view_of(tmp_path / "run.mcap", still)
    figure = draw(replace(view, plan=replace(view.plan, orbits=())))
    figure.canvas.draw()
    for axes in figure.axes:
        title = axes.get_title(loc="left")
        if title.startswith("Arm "):
            labels = [label.get_text() for label in axes.get_xticklabels()]
            assert len(labels) > 1
            assert len(set(labels)) == len(labels)
