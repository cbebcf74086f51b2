"""Malformed recordings are each refused with one clear sentence, and nothing is written."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from bench_recordings import rig_variables, table_columns, write_csv, write_mat
from hypothesis import HealthCheck, given, settings, strategies as st

from dpcontrol.foundation.errors import InputError
from dpcontrol.recordings.importing import import_recording

EXAMPLES = 60
LONGEST = 600  # characters of a sentence, the file's path left out: what fits a terminal's few lines
Random = np.random.Generator
Maker = Callable[[Path, Random], Path]


def mat(change: Callable[[dict[str, Any], Random], Any]) -> Maker:
    def make(folder: Path, random: Random) -> Path:
        variables = rig_variables()
        change(variables, random)
        return write_mat(folder / "swing.mat", variables, compressed=bool(random.integers(2)))

    return make


def cell(name: str, value: Callable[[np.ndarray, Random], Any]) -> Maker:
    def change(variables: dict[str, Any], random: Random) -> None:
        k = int(random.integers(len(variables[name])))
        variables[name][k, 0] = value(variables[name][k, 0], random)

    return mat(change)


def table(change: Callable[[dict[str, Any], Random], Any]) -> Maker:
    def make(folder: Path, random: Random) -> Path:
        columns: dict[str, Any] = table_columns()
        change(columns, random)
        return write_csv(folder / "swing.csv", columns)

    return make


def garbage(suffix: str, head: bytes = b"") -> Maker:
    def make(folder: Path, random: Random) -> Path:
        file = folder / f"swing{suffix}"
        file.write_bytes(head + random.bytes(int(random.integers(3000))))
        return file

    return make


def cut(file: Path, random: Random) -> Path:
    data = file.read_bytes()
    file.write_bytes(data[: int(random.integers(0, len(data) - 60))])
    return file


def cut_parquet(folder: Path, random: Random) -> Path:
    pq.write_table(pa.table(table_columns()), folder / "swing.parquet")
    return cut(folder / "swing.parquet", random)


MAKERS: dict[str, Maker] = {
    "cut": lambda folder, random: cut(write_mat(folder / "swing.mat", rig_variables()), random),
    "garbage for MATLAB 5": garbage(".mat", b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"),
    "garbage for HDF5": garbage(".mat", b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n"),
    "garbage for a table": garbage(".csv"),
    "garbage for a bag": garbage(".bag", b"#ROSBAG V2.0\n"),
    "garbage for MCAP": garbage(".mcap", b"\x89MCAP0\r\n"),
    "transposed": cell("Y_id", lambda values, _: values.T),
    "rates first": cell("Y_id", lambda values, _: values[[2, 3, 0, 1]]),
    "not finite": cell("Y_id", lambda values, _: np.where(values > values.mean(), values, np.nan)),
    "beyond all benches": cell("Y_id", lambda values, _: 1e9 * values),
    "a time less": cell("Time_id", lambda values, _: values[:-1]),
    "times reversed": cell("Time_id", lambda values, _: values[::-1]),
    "a period of none": mat(lambda variables, random: variables.update(dt=float(random.choice([0.0, np.nan, 2e-3])))),
    "a variable missing": mat(lambda variables, random: variables.pop(str(random.choice(["Y_id", "Time_id", "dt"])))),
    "an empty cell": table(lambda columns, random: columns["angle_1"].__setitem__(int(random.integers(300)), "")),
    "columns swapped": table(lambda columns, _: columns.update(time=columns["angle_1"], angle_1=columns["time"])),
    "a column renamed": table(lambda columns, _: columns.update({"angle_x": columns.pop("angle_1")})),
    "no rows": table(lambda columns, _: columns.update({name: [] for name in columns})),
    "too short": table(lambda columns, _: columns.update({name: part[:9] for name, part in columns.items()})),
    "parquet cut": cut_parquet,
}


def is_one_clear_sentence(message: str, file: Path) -> bool:
    """True if a message names the file, and a reason or a remedy."""
    rest = message.replace(str(file), "")
    return str(file) in message and "\n" not in message and len(rest) <= LONGEST and len(rest.split()) >= 5


@settings(derandomize=True, deadline=None, max_examples=EXAMPLES, suppress_health_check=list(HealthCheck))
@given(name=st.sampled_from(sorted(MAKERS)), seed=st.integers(0, 2**32 - 1))
def test_a_malformed_recording_gets_one_sentence_and_writes_nothing(
    tmp_path_factory: pytest.TempPathFactory, name: str, seed: int
) -> None:
    folder = tmp_path_factory.mktemp("malformed")
    file = MAKERS[name](folder, np.random.default_rng(seed))
    with pytest.raises(InputError) as refused:
        import_recording(file)
    assert is_one_clear_sentence(str(refused.value), file), refused.value
    assert [*folder.iterdir()] == [file]
