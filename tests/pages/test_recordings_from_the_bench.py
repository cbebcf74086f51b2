"""Logs that hold measured angles only: shown for what they are, with nothing made up and no line across a gap."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from synthetic_run import ARM_LENGTHS, synthetic_run, write_log

from dpcontrol.judge.of_log import run_view
from dpcontrol.judge.run_view import series_of
from dpcontrol.logs import LogWriter, RunLog, control_fields, read_log
from dpcontrol.pages.charts import curve
from dpcontrol.pages.page import draw
from dpcontrol.pages.rerun_recording import write_recording
from dpcontrol.pages.strips import mode_spans

RATE_ERROR = 0.02
"""rad/s: central differences of 1.6 Hz over 1 ms are off by ω³h²/6 · 0.25 rad, 4e-5; at the ends by ω²h/2, 0.013."""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> RunLog:
    """Two segments of one second with a gap of a second between them, angles only."""
    time = np.concatenate([np.arange(1000), np.arange(2000, 3000)]) / 1000
    angles = 0.25 * np.sin(2 * np.pi * 1.6 * time[:, None] + [0.0, 1.0])
    path = tmp_path_factory.mktemp("bench") / "bench.mcap"
    with LogWriter(path, arm_lengths=ARM_LENGTHS, rate_hz=1000.0, has_cart=False) as log:
        log.ticks(time, measured=angles)
    return read_log(path)


def test_rates_are_differences_within_each_segment(bench: RunLog) -> None:
    view = series_of(bench)
    assert (view.what, view.differenced) == ("measured", True)
    expected = 0.25 * 2 * np.pi * 1.6 * np.cos(2 * np.pi * 1.6 * bench.time[:, None] + [0.0, 1.0])
    assert view.state[:, 2:] == pytest.approx(expected, abs=RATE_ERROR)


def test_missing_data_are_not_drawn(bench: RunLog) -> None:
    view = series_of(bench)
    for part in (view.reference, view.estimate, view.error, view.sigma, view.control, view.nis):
        assert part is None
    titles = [axes.get_title(loc="left") for axes in draw(run_view(bench)).axes]
    assert [title for title in titles if title] == [
        "Angles from hanging (rad)",
        "Rates (rad/s), by differences",
        "Arm 1: ω₁ (rad/s) over θ₁",
        "Arm 2: ω₂ (rad/s) over θ₂",
    ]


def test_no_line_is_drawn_across_a_gap(bench: RunLog) -> None:
    view = series_of(bench)
    time, values = curve(view, view.time, view.state[:, 0])
    assert view.breaks.tolist() == [1000]
    between = (time > 0.9995) & (time < 1.9995)
    assert np.isnan(values[between]).all()
    assert between.sum() == 1


def test_the_viewer_draws_no_line_across_a_gap(bench: RunLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A row without a value ends the viewer's line (its series_query: an empty batch is a Clear)."""
    empty: dict[str, list[int]] = {}
    send = rr.RecordingStream.send_columns

    def noted(self: rr.RecordingStream, path: str, indexes: Any, columns: Any, **others: Any) -> None:
        if path.startswith("plots/"):
            (index,) = indexes
            times = index.as_arrow_array().cast("int64").to_pylist()
            (rows,) = (column.as_arrow_array().to_pylist() for column in columns)
            empty[path] = [time for time, row in zip(times, rows, strict=True) if not row]
        send(self, path, indexes, columns, **others)

    monkeypatch.setattr(rr.RecordingStream, "send_columns", noted)
    write_recording(run_view(bench), tmp_path / "bench.rrd")
    assert len(empty) == 4
    assert all(times == [1_499_500_000] for times in empty.values())


def test_a_replay_with_a_cart_shows_its_nis_for_the_arms_and_no_controller(tmp_path: Path) -> None:
    fields = control_fields(2, has_cart=True)
    control = np.zeros((500, len(fields)))
    control[:, fields.index("applied")] = np.sin(np.arange(500) / 50)
    control[:, fields.index("nis")] = 2.0
    metadata = {"kind": "replay", "summary": "0.5 s predicted by lab"}
    with LogWriter(tmp_path / "replay.mcap", arm_lengths=ARM_LENGTHS, rate_hz=1000.0, metadata=metadata) as log:
        shape = (500, 6)
        estimate, reference = np.full(shape, 0.1), np.full(shape, 0.2)
        log.ticks(
            np.arange(500) / 1000, measured=np.zeros((500, 3)), estimate=estimate, reference=reference, control=control
        )
    run = read_log(tmp_path / "replay.mcap")
    view = series_of(run)
    assert (view.sensors, view.against) == (2, "prediction")
    assert view.control is not None
    assert "applied" in view.control
    assert "feedforward" not in view.control
    assert mode_spans(view) == []
    assert run_view(run).verdict == "0.5 s predicted by lab"
    write_recording(run_view(run), tmp_path / "replay.rrd")


def test_an_estimate_that_repeats_the_reference_is_no_reference(tmp_path: Path) -> None:
    made = synthetic_run(seconds=1.0)
    same = replace(made, reference=made.estimate)
    assert series_of(read_log(write_log(tmp_path / "same.mcap", same))).reference is None
    assert series_of(read_log(write_log(tmp_path / "run.mcap", made))).reference is not None
