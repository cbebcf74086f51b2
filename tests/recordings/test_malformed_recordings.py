"""Three hundred malformed recordings are each rejected with one clear sentence and without any file."""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from bench_recordings import PERIOD, cells, rig_variables, table_columns, write_csv, write_mat
from command_line import dpcontrol

from dpcontrol.foundation.errors import InputError
from dpcontrol.recordings.importing import import_recording

MANY = 300
LONGEST = 600  # characters of a sentence, the file's path left out: what fits a terminal's few lines
Random = np.random.Generator
Maker = Callable[[Path, Random], tuple[Path, str | None]]


def _mat(change: Callable[[dict[str, Any], Random], Any]) -> Maker:
    def make(folder: Path, random: Random) -> tuple[Path, str | None]:
        # Cells are copied: each case spoils its own.
        variables = rig_variables()
        change(variables, random)
        return write_mat(folder / "swing.mat", variables, compressed=bool(random.integers(2))), None

    return make


def _csv(change: Callable[[dict[str, list[Any]], Random], Any]) -> Maker:
    def make(folder: Path, random: Random) -> tuple[Path, str | None]:
        columns = table_columns()
        change(columns, random)
        return write_csv(folder / "swing.csv", columns), None

    return make


def _set_cell(name: str, value: Callable[[np.ndarray, Random], Any]) -> Maker:
    def change(variables: dict[str, Any], random: Random) -> None:
        k = int(random.integers(len(variables[name])))
        variables[name][k, 0] = value(variables[name][k, 0], random)

    return _mat(change)


def _set_value(name: str, value: Callable[[Random], Any]) -> Maker:
    def change(variables: dict[str, Any], random: Random) -> None:
        variables[name] = value(random)

    return _mat(change)


def _put(value: Callable[[Random], Any]) -> Callable[[np.ndarray, Random], np.ndarray]:
    def change(cell: np.ndarray, random: Random) -> np.ndarray:
        cell = cell.copy()
        cell[tuple(int(random.integers(size)) for size in cell.shape)] = value(random)
        return cell

    return change


def _late(cell: np.ndarray, random: Random) -> np.ndarray:
    cell = cell.copy()
    cell[int(random.integers(20, len(cell) - 20)) :] += random.uniform(0.002, 0.5)
    return cell


def _early(cell: np.ndarray, random: Random) -> np.ndarray:
    cell = cell.copy()
    cell[int(random.integers(20, len(cell) - 20)) :] -= random.uniform(0.001, 0.01)
    return cell


def _truncated_mat(folder: Path, random: Random) -> tuple[Path, str | None]:
    file = write_mat(folder / "swing.mat", rig_variables(), compressed=bool(random.integers(2)))
    data = file.read_bytes()
    file.write_bytes(data[: int(random.integers(0, len(data) - 60))])
    return file, None


def _garbage(suffix: str, head: bytes = b"") -> Maker:
    def make(folder: Path, random: Random) -> tuple[Path, str | None]:
        file = folder / f"swing{suffix}"
        file.write_bytes(head + random.integers(0, 256, int(random.integers(0, 3000)), dtype=np.uint8).tobytes())
        return file, None

    return make


def _huge_version_4(folder: Path, random: Random) -> tuple[Path, str | None]:
    file = folder / "swing.mat"
    rows, columns = int(random.integers(10**6, 2**31 - 1)), int(random.integers(10**6, 2**31 - 1))
    file.write_bytes(struct.pack("<5i", 0, rows, columns, 0, 5) + b"Y_id\0" + bytes(64))
    return file, None


def _huge_version_5(folder: Path, random: Random) -> tuple[Path, str | None]:
    file = write_mat(folder / "swing.mat", rig_variables())
    data = bytearray(file.read_bytes())
    # The dimensions of the first variable, a cell array: 128 bytes of header, the tags of matrix and flags before them.
    place = 128 + 8 + 16 + 8
    assert data[place : place + 8] == struct.pack("<2i", 2, 1)
    data[place : place + 8] = struct.pack("<2i", int(random.integers(10**6, 2**31 - 1)), int(random.integers(1, 2**20)))
    file.write_bytes(bytes(data))
    return file, None


def _truncated_table(folder: Path, random: Random) -> tuple[Path, str | None]:
    file = write_csv(folder / "swing.csv", table_columns())
    lines = file.read_text().splitlines(keepends=True)
    kept = int(random.integers(1, len(lines)))
    last = lines[kept]
    file.write_text("".join(lines[:kept]) + last[: last.index(",") + int(random.integers(2))].rstrip("\n"))
    return file, None


def _text_cell(columns: dict[str, list[Any]], random: Random) -> None:
    name = str(random.choice(list(columns)))
    columns[name][int(random.integers(300))] = str(random.choice(["abc", "1.2.3", "0x", "#VALUE!", "1e", "--5"]))


def _empty_cell(columns: dict[str, list[Any]], random: Random) -> None:
    columns[str(random.choice(list(columns)))][int(random.integers(300))] = ""


def _swapped(columns: dict[str, list[Any]], random: Random) -> None:
    first, second = random.choice(["time", "angle_1", "angle_2", "rate_1", "rate_2"], 2, replace=False)
    if {str(first), str(second)} == {"angle_1", "angle_2"}:
        second = "rate_2"
    columns[first], columns[second] = columns[second], columns[first]


def _renamed(columns: dict[str, list[Any]], random: Random) -> None:
    name = str(random.choice(list(columns)))
    columns[name + str(random.choice(["x", " (rad)", "_", "1"]))] = columns.pop(name)


def _scaled(columns: dict[str, list[Any]], random: Random) -> None:
    names, factor = [
        (("angle_1", "angle_2"), 180 / np.pi),
        (("rate_1", "rate_2"), 180 / np.pi),
        (("angle_1", "angle_2"), 40_000 / (2 * np.pi)),
        (("time",), 1e3),
        (("time",), 1e-3),
        (("rate_1", "rate_2"), -1.0),
        (("angle_1",), -1.0),
    ][int(random.integers(7))]
    for name in names:
        columns[name] = [factor * value for value in columns[name]]


def _constant(columns: dict[str, list[Any]], random: Random) -> None:
    columns["time"] = [float(random.integers(5))] * 300


def _short(columns: dict[str, list[Any]], random: Random) -> None:
    kept = int(random.integers(0, 15))
    for name in columns:
        columns[name] = columns[name][:kept]


def _table_of(values: Callable[[Random], Any]) -> Maker:
    def make(folder: Path, random: Random) -> tuple[Path, str | None]:
        columns: dict[str, Any] = table_columns()
        columns[str(random.choice(list(columns)))] = values(random)
        pq.write_table(pa.table(columns), folder / "swing.parquet")
        return folder / "swing.parquet", None

    return make


def _truncated_parquet(folder: Path, random: Random) -> tuple[Path, str | None]:
    file = folder / "swing.parquet"
    pq.write_table(pa.table(table_columns()), file)
    data = file.read_bytes()
    file.write_bytes(data[: int(random.integers(0, len(data) - 1))])
    return file, None


GOOD_MAPPING = """title = "a rig"
arm_lengths = [0.2, 0.3]
[time]
column = "time"
[angles]
columns = ["angle_1", "angle_2"]
unit = "rad"
zero = "hanging"
"""


def _mapping(folder: Path, random: Random) -> tuple[Path, str | None]:
    old, new = [
        ('"time"', '"angle_1"'), ("[time]", "[tme]"), ('"rad"', '"radians"'), ('"hanging"', '"sideways"'),
        ("[0.2, 0.3]", "[-0.2, 0.3]"), ("[0.2, 0.3]", "[]"), ("[0.2, 0.3]", '"long"'), ('"angle_2"', '"angle_1"'),
        ('["angle_1", "angle_2"]', "[]"), ('["angle_1", "angle_2"]', "3"), ('"rad"', '"counts"'), ("title", "title ="),
        ('zero = "hanging"', "sign = 2"), ('zero = "hanging"', "zero = [0, 0, 0]"), ('column = "time"', ""),
        ('zero = "hanging"', 'zer = "hanging"'), ('zero = "hanging"', "relative = 1"), ('"hanging"', "nan"),
        ('"hanging"', "true"), ('column = "time"', 'column = "time"\nunit = "h"'),
        ("[angles]", "[sampling]\nrate = 0\n[angles]"),
        ("[angles]", "[sampling]\nperiod = 5.0\n[angles]"), ("[angles]", '[cells]\nstates = ["Y_id"]\n[angles]'),
        ("[angles]", '[rates]\ncolumns = ["rate_1"]\n[angles]'), ("[angles]", '[cart]\nposition = "cart"\n[angles]'),
    ][int(random.integers(25))]  # fmt: skip
    assert old in GOOD_MAPPING
    (folder / "rig.toml").write_text(GOOD_MAPPING.replace(old, new))
    return write_csv(folder / "swing.csv", table_columns()), str(folder / "rig.toml")


MAKERS: tuple[Maker, ...] = (
    _truncated_mat,
    _truncated_mat,
    _garbage(".mat"),
    _garbage(".mat", b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"),
    _garbage(".mat", b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n"),
    _garbage(".csv"),
    _garbage(".parquet", b"PAR1"),
    _garbage(".xlsx"),
    _huge_version_4,
    _huge_version_5,
    _set_cell("Y_id", lambda cell, _: cell.T),
    _set_cell("Y_id", lambda cell, _: cell[:3]),
    _set_cell("Y_id", lambda cell, _: cell[:, :-7]),
    _set_cell("Y_id", lambda cell, _: cell[:2]),
    _set_cell("Y_id", lambda cell, _: cell[:, :0]),
    _set_cell("Y_id", lambda cell, _: np.stack([cell, cell])),
    _set_cell("Y_id", lambda cell, _: cell * 1j),
    _set_cell("Y_id", lambda cell, _: "angles"),
    _set_cell("Y_id", lambda cell, _: {"angles": cell}),
    _set_cell("Y_id", lambda cell, _: cell[[2, 3, 0, 1]]),
    _set_cell("Y_id", lambda cell, _: cell[[0, 1, 3, 2]]),
    _set_cell("Y_id", lambda cell, _: cell * np.array([[180 / np.pi], [180 / np.pi], [1], [1]])),
    _set_cell("Y_id", _put(lambda _: np.nan)),
    _set_cell("Y_id", _put(lambda _: np.inf)),
    _set_cell("Y_id", _put(lambda random: random.uniform(1e3, 1e9))),
    _set_cell("Time_id", lambda cell, _: cell[:-1]),
    _set_cell("Time_id", lambda cell, _: "now"),
    _set_cell("Time_id", lambda cell, _: cell[:0]),
    _set_cell("Time_id", lambda cell, _: cell[::-1]),
    _set_cell("Time_id", lambda cell, _: cell * 1e3),
    _set_cell("Time_id", _put(lambda _: np.nan)),
    _set_cell("Time_id", _late),
    _set_cell("Time_id", _early),
    _set_value("dt", lambda random: float(random.choice([0.0, -1e-3, 1.0, np.nan, np.inf, 1e-2, 2e-3]))),
    _set_value("dt", lambda _: "a millisecond"),
    _set_value("dt", lambda _: np.array([[PERIOD, PERIOD]])),
    _set_value("Y_id", lambda random: random.normal(size=(4, 300))),
    _set_value("Y_id", lambda _: np.empty((0, 0), dtype=object)),
    _set_value("Time_id", lambda _: cells([np.zeros((300, 1))])),
    _mat(lambda variables, random: variables.pop(str(random.choice(["Y_id", "Time_id", "dt"])))),
    _csv(_text_cell),
    _csv(_text_cell),
    _csv(_empty_cell),
    _csv(_swapped),
    _csv(_swapped),
    _csv(_renamed),
    _csv(_scaled),
    _csv(_scaled),
    _csv(_constant),
    _csv(_short),
    _truncated_table,
    _truncated_parquet,
    _table_of(lambda _: ["text"] * 300),
    _table_of(lambda _: [[1.0]] * 300),
    _table_of(lambda _: [True] * 300),
    _table_of(lambda _: [None] * 300),
    _mapping,
    _mapping,
    _mapping,
    _mapping,
)


def _one_clear_sentence(message: str, file: Path, mapping: str | None) -> None:
    assert message
    assert "\n" not in message
    assert "Traceback" not in message
    # It names the place: the file, or the mapping.
    assert str(file) in message or (mapping is not None and mapping in message)
    assert len(message.replace(str(file), "")) <= LONGEST
    # And a reason or a remedy beyond the place.
    assert len(message.replace(str(file), "").split()) >= 5


@pytest.mark.parametrize("seed", range(0, MANY, 10))
def test_malformed_recordings_get_one_sentence_each_and_write_nothing(seed: int, tmp_path: Path) -> None:
    for k in range(seed, seed + 10):
        folder = tmp_path / str(k)
        folder.mkdir()
        file, mapping = MAKERS[k % len(MAKERS)](folder, np.random.default_rng(k))
        before = sorted(folder.iterdir())
        with pytest.raises(InputError) as refused:
            import_recording(file, mapping)
        _one_clear_sentence(str(refused.value), file, mapping)
        assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize("maker", range(0, len(MAKERS), 4))
def test_the_command_line_rejects_them_with_exit_status_2(
    maker: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file, mapping = MAKERS[maker](tmp_path, np.random.default_rng(maker))
    before = sorted(tmp_path.rglob("*"))
    ended = dpcontrol("import", file, *(["--mapping", mapping] if mapping else []), "--json")
    assert ended.code == 2
    assert ended.document["error"] is True
    _one_clear_sentence(ended.document["status"], file, mapping)
    assert sorted(tmp_path.rglob("*")) == before
