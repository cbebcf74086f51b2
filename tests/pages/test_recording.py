"""The Rerun recording of a run: whole, arranged, and holding what the log says."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

import dpcontrol as dp
from dpcontrol.judge.of_log import run_view
from dpcontrol.judge.run_view import ACTUAL, RunView, series_of
from dpcontrol.logs import LogWriter, RunLog, control_fields, read_log
from dpcontrol.pages.charts import curve
from dpcontrol.pages.rerun_recording import write_recording
from dpcontrol.pages.story import mode_spans
from dpcontrol.pages.viewer import viewer_program

ACCELERATION = 1e-9  # m/s²: velocities of 1 m/s differ by rounding, over 1 ms
ARM_LENGTHS = (0.1738, 0.2490)


def flown(**settings: float) -> RunView:
    """Return the view of an outer turn with settings of the drive or the disturbances."""
    run = dp.run("outer-turn", seed=1, settings={name.replace("__", "."): value for name, value in settings.items()})
    return run_view(run.log)


@pytest.fixture(scope="module")
def run() -> RunView:
    return flown()


def rerun(*arguments: str) -> str:
    program = viewer_program()
    assert program is not None
    done = subprocess.run([str(program), *arguments], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_recording_holds_scene_plots_events_and_blueprint(run: RunView, tmp_path: Path) -> None:
    write_recording(run, tmp_path / "run.rrd")
    found = rerun("rrd", "stats", str(tmp_path / "run.rrd"))
    for entity in (
        "/scene/cart",
        "/scene/arms/arm_2",
        "/scene/reference/arm_1",
        "/rosout",
        "/symbol",
        "/mode",
        "/plots/angles/arm_1/3_plant",
        "/plots/estimation_error/arm_2",
        "/plots/energy/down_up",
        "/phase_planes/arm_2/orbits",
        "/phase_planes/arm_1/grid",
        "/plots/tracking_error/arm_1",
        "/plots/nis/mean",
        "/scene/tip",
        "/viewport",
    ):
        assert entity in found, f"{entity} is not in the recording"


def test_the_true_motion_of_the_cart_is_drawn_beside_the_assumed_one() -> None:
    """A drive that gives half of what it was told is known from the truth alone."""
    control = flown(drive__response=0.5, drive__lag=0.0).control
    assert control is not None
    assert np.abs(control[ACTUAL] - 0.5 * control["applied"])[:-1].max() <= ACCELERATION


def test_a_blow_on_the_cart_is_no_acceleration_of_its_drive() -> None:
    view = flown(disturbances__knocks=1, disturbances__knock_velocity=1.0)
    assert view.control is not None
    (struck,) = np.flatnonzero(np.isnan(view.control[ACTUAL]))
    assert abs(view.state[struck + 1, 5] - view.state[struck, 5]) > 0.5


def test_thinned_curves_keep_every_peak(run: RunView) -> None:
    time_s = np.linspace(0, 1, 100_000)
    values = np.sin(40 * time_s)
    values[[777, 50_000]] = 5.0, -5.0
    thin_time, thin_values = curve(run, time_s, values)
    assert len(thin_time) < 3_100
    assert (thin_values.max(), thin_values.min()) == (5.0, -5.0)
    assert (np.diff(thin_time) > 0).all()


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
