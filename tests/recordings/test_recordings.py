"""Recordings come in as they were measured: units, signs and zeros by their mapping, faults named, mended if asked."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench_recordings import PERIOD, cells, free_swing, rig_file, rig_variables, table_columns, write_csv, write_mat
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.io import loadmat, savemat

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import read_log
from dpcontrol.plans.model import load_model
from dpcontrol.recordings.importing import import_recording
from dpcontrol.recordings.recording import Recording, load_recording, simulated_recording, write_recording

EXACT = 1e-12  # rad: conversions of units round a few times
TIME_STEP = 1e-9  # s: logs count nanoseconds
EVEN = 1e-4  # the period found from jittering times, relative
FILLED = 1e-6  # rad: a cubic over 6 ms, far below an encoder's count of 1.6e-4


def test_the_rigs_file_is_imported_with_hanging_as_zero() -> None:
    file = rig_file()
    recording = import_recording(file)
    given = loadmat(file)
    angles = np.concatenate([cell[:2].T for cell in given["Y_id"][:, 0]])
    rates = np.concatenate([cell[2:].T for cell in given["Y_id"][:, 0]])
    times = np.concatenate([cell[:, 0] for cell in given["Time_id"][:, 0]])
    assert np.array_equal(recording.angles, angles - np.pi)
    assert np.array_equal(recording.rates, rates)
    assert np.array_equal(recording.time, times)
    assert recording.dt == 1e-3
    assert recording.segments == tuple((2667 * k, 2667 * (k + 1)) for k in range(15))
    assert recording.notes == ()
    assert recording.cart is None


def test_a_log_gives_back_the_recording_segment_by_segment(tmp_path: Path) -> None:
    recording = import_recording(write_mat(tmp_path / "swing.mat", rig_variables(segments=3)))
    back = load_recording(write_recording(recording, tmp_path / "swing.mcap"))
    assert np.array_equal(back.angles, recording.angles)
    assert np.array_equal(back.rates, recording.rates)  # type: ignore[arg-type]
    assert np.abs(back.time - recording.time).max() <= TIME_STEP
    assert (back.dt, back.segments, back.arm_lengths) == (recording.dt, recording.segments, recording.arm_lengths)
    for part, (first, end) in zip(back.split(), recording.segments, strict=True):
        assert np.array_equal(part.angles, recording.angles[first:end])
        assert part.segments == ((0, end - first),)


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_whole_recordings_by_simulink_open_as_structs_and_as_objects(tmp_path: Path, version: str) -> None:
    matio = pytest.importorskip("matio", reason="mat-io writes MATLAB's objects for this test")
    from matio.utils.matclass import MatlabOpaque

    times, states = free_swing(400)
    upright = states + np.array([np.pi, np.pi, 0, 0])
    structs = [{"Values": {"Data": column[:, None].copy(), "Time": times[:, None].copy()}} for column in upright.T]
    series = [
        {"Values": MatlabOpaque({"Data": column[:, None].copy(), "Time": times[:, None].copy()}, "timeseries")}
        for column in upright.T
    ]
    for name, signals in (("structs", structs), ("objects", series)):
        file = tmp_path / f"{name}.mat"
        matio.save_to_mat(str(file), {"data": cells(signals)}, version=version)
        recording = import_recording(file, "multi-arm-raw")
        assert np.abs(recording.angles - states[:, :2]).max() <= EXACT
        assert np.array_equal(recording.rates, states[:, 2:])  # type: ignore[arg-type]


MAPPING = """
title = "another rig"
arm_lengths = [0.2, 0.3]
[sampling]
rate = 1000
[angles]
columns = ["inner", "outer"]
{angles}
"""


def _written(values: NDArray[np.float64], folder: Path, angles: str) -> Recording:
    file = write_csv(folder / "rig.csv", {"inner": values[:, 0].tolist(), "outer": values[:, 1].tolist()})
    mapping = folder / "rig.toml"
    mapping.write_text(MAPPING.format(angles=angles))
    return import_recording(file, str(mapping))


@pytest.mark.parametrize("signs", [(1, 1), (1, -1)])
@pytest.mark.parametrize("relative", [False, True])
def test_the_zero_is_what_a_hanging_arm_reads_whatever_the_sign(
    tmp_path: Path, signs: tuple[int, int], relative: bool
) -> None:
    _, states = free_swing(300)
    joints = np.diff(states[:, :2], axis=1, prepend=0.0) if relative else states[:, :2]
    hanging = (1.5, 4.6)
    told = np.degrees(hanging + joints * signs)
    keys = f"sign = {list(signs)}\nzero = {list(hanging)}\nrelative = {str(relative).lower()}"
    recording = _written(told, tmp_path, f'unit = "deg"\n{keys}')
    assert np.abs(recording.angles - states[:, :2]).max() <= EXACT
    assert recording.rates is None
    assert recording.dt == PERIOD


NUMBERED = """
arm_lengths = [0.2, 0.3]
[time]
column = 1
[angles]
columns = [2, "3"]
[rates]
columns = [4, 5]
"""


@pytest.mark.parametrize("writer", ["columns", "decimal commas", "a comment as header"])
def test_a_table_without_a_header_is_imported_by_the_numbers_of_its_columns(tmp_path: Path, writer: str) -> None:
    columns = table_columns()
    values, file, mapping = np.column_stack([*columns.values()]), tmp_path / "swing.txt", tmp_path / "numbered.toml"
    mapping.write_text(NUMBERED)
    if writer == "a comment as header":
        np.savetxt(file, values, header=" ".join(columns))
    else:
        # In columns, as MATLAB's save -ascii writes.
        np.savetxt(file, values, **({"fmt": "%25.17g"} if writer == "columns" else {"delimiter": ";"}))
        if writer == "decimal commas":
            file.write_text(file.read_text().replace(".", ","))
        with pytest.raises(InputError, match=r"has no header, so a mapping names columns by number; allowed: 1, 2, 3"):
            import_recording(file)
    recording = import_recording(file, None if writer == "a comment as header" else str(mapping))
    assert np.array_equal(recording.angles, values[:, 1:3])
    assert np.array_equal(recording.rates, values[:, 3:])  # type: ignore[arg-type]


def test_segments_survive_tables_and_a_second_import(tmp_path: Path) -> None:
    recording = import_recording(write_mat(tmp_path / "swing.mat", rig_variables(segments=3)))
    log = write_recording(recording, tmp_path / "swing.mcap")
    recording.frame().to_csv(tmp_path / "swing.csv")
    read_log(log).frame().to_csv(tmp_path / "log.csv")
    mapping = tmp_path / "log.toml"
    mapping.write_text(
        'arm_lengths = [0.2, 0.3]\n[time]\ncolumn = "time"\nsegment = "segment"\n'
        '[angles]\ncolumns = ["measured.arm_1", "measured.arm_2"]'
    )
    for file, given in (("swing.mcap", None), ("swing.csv", None), ("log.csv", str(mapping))):
        again = import_recording(tmp_path / file, given)
        assert again.segments == recording.segments
        assert np.abs(again.angles - recording.angles).max() <= EXACT


@pytest.mark.parametrize(("given", "turns"), [("40000", (40_000, 40_000)), ("[40000, 8192]", (40_000, 8192))])
def test_counts_of_relative_encoders_are_summed_to_absolute_angles(
    tmp_path: Path, given: str, turns: tuple[int, int]
) -> None:
    _, states = free_swing(300)
    relative = np.column_stack([states[:, 0], states[:, 1] - states[:, 0]])
    counts = np.rint(relative * turns / (2 * np.pi))
    recording = _written(counts, tmp_path, f'unit = "counts"\ncounts_per_turn = {given}\nrelative = true')
    half_counts = np.cumsum(np.pi / np.array(turns))
    assert np.all(np.abs(recording.angles - states[:, :2]).max(axis=0) <= half_counts + EXACT)


def test_parquet_reads_as_csv(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = table_columns()
    pq.write_table(pa.table(columns), tmp_path / "swing.parquet")
    by_csv = import_recording(write_csv(tmp_path / "swing.csv", columns))
    by_parquet = import_recording(tmp_path / "swing.parquet")
    assert np.array_equal(by_csv.angles, by_parquet.angles)
    assert np.array_equal(by_csv.time, by_parquet.time)


def _missing(columns: dict[str, Any]) -> None:
    columns["angle_2"][100:105] = [""] * 5


def _repeated(columns: dict[str, Any]) -> None:
    columns["time"][100] = columns["time"][99]


def _backward(columns: dict[str, Any]) -> None:
    columns["time"][100] = columns["time"][97]


def _gap(columns: dict[str, Any]) -> None:
    for values in columns.values():
        del values[100:130]


def _wrapped(columns: dict[str, Any]) -> None:
    least = columns["angle_1"][99]
    columns["angle_1"] = [(v - least) % (2 * np.pi) + least for v in columns["angle_1"]]


def _spiked(columns: dict[str, Any]) -> None:
    columns["rate_2"][100] += 300.0


def _uneven(columns: dict[str, Any]) -> None:
    times = np.array(columns["time"]) + 0.3 * PERIOD * np.sin(np.arange(len(columns["time"])))
    clock, states = free_swing(300)
    for name, column in zip(("angle_1", "angle_2", "rate_1", "rate_2"), states.T, strict=True):
        columns[name] = CubicSpline(clock, column)(times).tolist()
    columns["time"] = times.tolist()


@pytest.mark.parametrize(
    ("fault", "repair", "said"),
    [
        (_missing, "nan", "row 101 (t = 0.1 s): angle 2 is not finite, or above 1e+09 (5 such rows)"),
        (_repeated, "time", "row 101 (t = 0.099 s): the time is missing or not later than before"),
        (_backward, "time", "row 101 (t = 0.097 s): the time is missing or not later than before"),
        (_gap, "gaps", "row 100 (t = 0.099 s): samples are missing after it"),
        (_wrapped, "wrap", "angle 1 jumps by a turn"),
        (_spiked, "spikes", "row 101 (t = 0.1 s): rate 2 is far from its neighbours"),
        (_uneven, "sampling", "the sampling is uneven"),
    ],
)
def test_a_fault_is_named_and_corrected_only_on_request(
    tmp_path: Path, fault: Callable[[dict[str, Any]], None], repair: str, said: str
) -> None:
    columns = table_columns()
    fault(columns)
    file = write_csv(tmp_path / "faulty.csv", columns)
    with pytest.raises(InputError, match="repair " + repair) as refused:
        import_recording(file)
    assert said in str(refused.value)
    other = {"nan", "time", "gaps", "wrap", "spikes", "sampling"} - {repair, "gaps", "sampling"}
    with pytest.raises(InputError):
        import_recording(file, repairs=sorted(other))
    # A row left out for its time leaves a gap.
    repairs = [repair, "gaps"] if repair == "time" else [repair]
    recording = import_recording(file, repairs=repairs)
    assert recording.notes
    times, states = free_swing(300)
    turns = 2 * np.pi
    for part in recording.split():
        expected = CubicSpline(times, states[:, :2])(part.time)
        off = part.angles - expected
        assert np.abs(off - turns * np.round(off / turns)).max() <= FILLED
        assert np.allclose(np.diff(part.time), PERIOD, rtol=EVEN)


Array = NDArray[np.float64]

STORED = 1e-9  # m, s: logs count nanoseconds, and hold doubles
FINE = 1e-4  # s, of the data set's recordings of one and three arms
AMPLITUDE, FREQUENCY = 0.05, 0.47  # m, Hz: the data set's cart went to and fro every 2.1 s


def _variables(angles: Array, rates: Array, times: Array) -> dict[str, Any]:
    """Return the data set's variables for several arms: one for each angle and rate, from upright."""
    named: dict[str, Any] = {"Time": times[:, None], "dt": times[1] - times[0]}
    for i in range(angles.shape[1]):
        named |= {f"Theta{i + 1}": angles[:, i : i + 1] + np.pi, f"dTheta{i + 1}": rates[:, i : i + 1]}
    return named


def _logged(values: Array, times: Array) -> dict[str, Any]:
    """Return a signal as Simulink logs it: a structure with time."""
    return {"time": times[:, None], "signals": {"values": values[:, None], "dimensions": 1.0, "label": ""}}


def _way(times: Array) -> tuple[Array, Array]:
    """Return position and velocity (K,) of a cart that moves to and fro."""
    turning = 2 * np.pi * FREQUENCY
    return AMPLITUDE * np.sin(turning * times), AMPLITUDE * turning * np.cos(turning * times)


@pytest.mark.parametrize("driven", [False, True])
def test_one_arm_logged_as_structures_opens_with_a_moving_cart(tmp_path: Path, driven: bool) -> None:
    swing = simulated_recording(load_model("single").arms, [np.array([0.8])], seconds=2.0, period=FINE, counts=0)
    times, angle, (cart, velocity) = swing.time, swing.angles[:, 0], _way(swing.time)
    variables = {"Theta1": _logged(angle + np.pi, times)}
    if driven:
        variables |= {"Distance": _logged(cart, times), "Velocity": _logged(velocity, times)}
    savemat(tmp_path / "single.mat", variables)
    recording = import_recording(tmp_path / "single.mat")
    assert recording.arms == 1
    assert np.abs(recording.angles[:, 0] - angle).max() <= EXACT
    assert (recording.cart is not None) == driven
    if recording.cart is not None:
        assert np.array_equal(recording.cart, cart)


@pytest.mark.parametrize("cart", ["none", "structures", "columns"])
@pytest.mark.parametrize(("model", "start"), [("lab", [1.0, -0.4]), ("triple", [0.6, 0.9, -0.5])])
def test_two_and_three_arms_open_with_the_way_of_their_cart(
    tmp_path: Path, model: str, start: list[float], cart: str
) -> None:
    swing = simulated_recording(load_model(model).arms, [np.array(start)], seconds=1.0, period=FINE, counts=0)
    angles, times, (way, speed) = swing.angles, swing.time, _way(swing.time)
    rates = np.gradient(angles, FINE, axis=0, edge_order=2)
    signals = {} if cart == "none" else {"Distance": way, "Velocity": speed}
    logged = {name: _logged(v, times) if cart == "structures" else v[:, None] for name, v in signals.items()}
    savemat(tmp_path / "whole.mat", _variables(angles, rates, times) | logged)
    recording = import_recording(tmp_path / "whole.mat")
    assert recording.arms == len(recording.arm_lengths) == len(start)
    assert recording.dt == pytest.approx(FINE, rel=1e-12)
    assert np.abs(recording.angles - angles).max() <= EXACT
    assert np.array_equal(recording.rates, rates)
    assert (recording.cart is None) == (cart == "none")
    assert recording.cart is None or np.array_equal(recording.cart, way)


DRIVEN = """
arm_lengths = [0.17, 0.23]
[time]
column = "t"
unit = "ms"
[angles]
columns = ["inner", "outer"]
[cart]
position = "way"
unit = "mm"
command = "wanted"
"""


def test_a_cart_and_its_command_come_in_and_survive_the_log(tmp_path: Path) -> None:
    times = 1e-3 * np.arange(800)
    way = AMPLITUDE * np.sin(2 * np.pi * times)
    columns = {"t": 1e3 * times, "inner": 0.3 * np.cos(8 * times), "outer": 0.2 * np.cos(8 * times + 0.3)}
    columns |= {"way": 1e3 * way, "wanted": -((2 * np.pi) ** 2) * way}
    file, mapping = write_csv(tmp_path / "driven.csv", {k: v.tolist() for k, v in columns.items()}), tmp_path / "r.toml"
    mapping.write_text(DRIVEN)
    recording = import_recording(file, str(mapping))
    again = load_recording(write_recording(recording, tmp_path / "driven.mcap"))
    for one in (recording, again):
        assert np.abs(one.cart - way).max() <= STORED
        assert np.abs(one.command + (2 * np.pi) ** 2 * way).max() <= STORED
    assert np.abs(again.time - recording.time).max() <= STORED
    with pytest.raises(InputError, match=r"is not a log .*; import a recording with `dpcontrol import` first"):
        load_recording(file)
