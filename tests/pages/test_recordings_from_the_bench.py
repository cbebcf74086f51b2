"""Logs that hold measured angles only: shown for what they are, with nothing made up and no line across a gap."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_run import ARM_LENGTHS, synthetic_run, write_log

from dpcontrol.judge.of_log import run_view
from dpcontrol.judge.run_view import series_of
from dpcontrol.logs import LogWriter, RunLog, control_fields, read_log, recover
from dpcontrol.pages.charts import curve
from dpcontrol.pages.rerun_recording import write_recording
from dpcontrol.pages.story import mode_spans

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


def test_no_line_is_drawn_across_a_gap(bench: RunLog) -> None:
    view = series_of(bench)
    time, values = curve(view, view.time, view.state[:, 0])
    assert view.breaks.tolist() == [1000]
    between = (time > 0.9995) & (time < 1.9995)
    assert np.isnan(values[between]).all()
    assert between.sum() == 1


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


def test_every_view_of_a_recovered_log_shows_its_losses(tmp_path: Path) -> None:
    whole = write_log(tmp_path / "run.mcap", synthetic_run())
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    log = read_log(recover(cut).log)
    assert log.recovered
    assert str(log.recovered) in run_view(log).verdict
