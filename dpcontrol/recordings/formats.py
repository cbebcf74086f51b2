"""Recordings' files as columns of numbers: CSV and Parquet, and MATLAB files of any version.

Cells of a table that are not numbers are reported by row; columns of a MATLAB file are found by MATLAB's own notation.
Versions 4 to 7 are read by scipy; version 7.3 (HDF5) and objects (time series, data sets logged by Simulink) by mat-io.
Source: MathWorks, MAT-File Format (the version 5 format that scipy reads).
"""

import csv
import math
import re
import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import UNREADABLE, checked_size
from dpcontrol.foundation.settings import suggest

Array = NDArray[np.float64]

_MISSING = ("", "nan", "na", "null", "none", "-")


def read_table(path: Path, columns: Sequence[str]) -> dict[str, Array]:
    """Return the named columns (K,) of a .csv or .parquet file; an empty cell is nan.

    Raises:
        InputError: the file cannot be read, is not a table, lacks a column, or holds text where numbers belong.
    """
    import pyarrow as pa

    try:
        table = _parquet(path, columns) if path.suffix.lower() == ".parquet" else _csv(path, columns)
    except OSError as error:
        # pyarrow's damage reports are OSError as well, and longer than a line.
        raise InputError(
            f"cannot read {path}: {error.strerror or _reason(error)}; check the name, or save the recording again"
        ) from error
    except (pa.ArrowException, ValueError, csv.Error, MemoryError) as error:
        raise InputError(f"{path} is not a readable table ({_reason(error)}); save the recording again") from error
    if table.num_rows == 0:
        raise InputError(f"{path} holds no rows; save the recording again")
    return {name: _numbers(table.column(name), name, path) for name in columns}


def _reason(error: BaseException) -> str:
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


def _check(path: Path, header: Sequence[str], columns: Sequence[str]) -> None:
    for name in columns:
        if header.count(name) > 1:
            raise InputError(f"{path}: {header.count(name)} columns are called {name!r}; give each a name of its own")
        if name not in header:
            shown = [one if len(one) <= 40 else f"{one[:40]}…" for one in header[:20]]
            raise InputError(f"{path}: the column {name!r} is missing; {suggest(name, shown)}; check file and mapping")


def table_columns(path: Path) -> list[str]:
    """Return the names of a table's columns; none where it cannot be read, which reading it reports."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        if path.suffix.lower() == ".parquet":
            return list(pq.ParquetFile(path).schema_arrow.names)
        return _header(path)[0]
    except (OSError, ValueError, pa.ArrowException, csv.Error, InputError):
        return []


def _parquet(path: Path, columns: Sequence[str]) -> Any:
    import pyarrow.parquet as pq

    file = pq.ParquetFile(path)
    checked_size(8.0 * file.metadata.num_rows * len(columns))
    _check(path, list(file.schema_arrow.names), columns)
    return file.read(columns=list(columns))


def _header(path: Path) -> tuple[list[str], str]:
    """Return the names in the first line of a table of text, and what stands between them."""
    with path.open(encoding="utf-8-sig", newline="") as stream:
        first = stream.readline(1_000_000)
    if not first.strip():
        raise InputError(f"{path} is empty or begins with an empty line; its first line must name the columns")
    delimiter = max(",;\t", key=first.count)
    return [name.strip() for name in next(csv.reader([first], delimiter=delimiter))], delimiter


def _csv(path: Path, columns: Sequence[str]) -> Any:
    import pyarrow as pa
    from pyarrow import csv as arrow

    header, delimiter = _header(path)
    _check(path, header, columns)
    # Read as text, so that a cell that is not a number can be reported by its row.
    table = arrow.read_csv(
        path,
        read_options=arrow.ReadOptions(column_names=header, skip_rows=1),
        parse_options=arrow.ParseOptions(delimiter=delimiter),
        convert_options=arrow.ConvertOptions(
            include_columns=list(columns), column_types=dict.fromkeys(columns, pa.string()), strings_can_be_null=False
        ),
    )
    if delimiter == ",":
        return table
    import pyarrow.compute as pc

    parts = {name: pc.replace_substring(table.column(name), ",", ".") for name in columns}  # type: ignore[attr-defined]
    return pa.table(parts)


def _numbers(values: Any, name: str, path: Path) -> Array:
    import pyarrow as pa

    kind = values.type
    if pa.types.is_integer(kind) or pa.types.is_floating(kind):
        return np.asarray(values.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=float)
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        raise InputError(f"{path}: the column {name!r} holds values of type {kind}; a column holds numbers")
    cells = np.array(values.to_pylist(), dtype=object)
    try:
        return np.array([float(cell) for cell in cells])
    except (TypeError, ValueError):
        return np.array([_number(cell, row, name, path) for row, cell in enumerate(cells, start=1)])


def _number(cell: str | None, row: int, name: str, path: Path) -> float:
    text = (cell or "").strip()
    if text.casefold() in _MISSING:
        return float("nan")
    try:
        return float(text)
    except ValueError:
        shown = text if len(text) <= 40 else f"{text[:40]}…"
        raise InputError(f"{path}: row {row} of column {name!r} holds {shown!r}; it must be a number") from None


_STEP = re.compile(r"\.?([A-Za-z]\w*)|\{(\d+)\}|\((\d+),:\)|\(:,(\d+)\)")
_LARGEST_RATIO = 2000
"""Elements for each byte of the file; zlib makes at most 1,032 of one."""
_MOST_SAMPLES = 10**8


def read_matlab(path: Path) -> dict[str, Any]:
    """Return the variables of a MATLAB file by name.

    Raises:
        InputError: the file cannot be read, or is not a MATLAB file.
    """
    try:
        with path.open("rb") as stream:
            head = stream.read(600)
        size = path.stat().st_size
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}; check the name") from error
    if not head:
        raise InputError(f"{path} is empty; save or copy the recording again")
    try:
        if b"MATLAB 7.3" in head[:128] or b"\x89HDF\r\n\x1a\n" in head:
            checked_size(_hdf5_size(path))
            variables = _with_objects(path)
        else:
            checked_size(_unpacked_size(path))
            variables = _plain(path, size)
    except UNREADABLE as error:
        raise InputError(
            f"{path} is not a MATLAB file, or is cut off or damaged ({_reason(error)}); save or copy it again"
        ) from error
    named = {name: value for name, value in variables.items() if isinstance(name, str) and not name.startswith("__")}
    if not named:
        raise InputError(f"{path} holds no variables; save the recording again")
    return named


def _plain(path: Path, size: int) -> dict[str, Any]:
    from scipy.io import loadmat, whosmat

    try:
        declared = whosmat(path)
    except TypeError:
        # scipy cannot tell the shape of objects.
        return _with_objects(path)
    checked_size(sum(8 * math.prod(map(float, shape)) for _, shape, _ in declared))
    for name, shape, _ in declared:
        if np.prod([float(length) for length in shape]) > _LARGEST_RATIO * size:
            raise ValueError(f"it declares {' x '.join(map(str, shape))} values in {name}, in {size} bytes")
    variables = loadmat(path)
    return _with_objects(path) if "__function_workspace__" in variables else variables


_PACKED = 15
"""Type of the elements of a version 5 file that zlib has packed."""


def _unpacked_size(path: Path) -> int:
    """Return to how many bytes the packed variables of a version 5 file unpack, as each says at its beginning."""
    data = path.read_bytes()
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128], "")
    size, place = 0, 128
    while order and place + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, place)
        if kind == _PACKED:
            beginning = zlib.decompressobj().decompress(data[place + 8 : place + 8 + length], 8)
            size += struct.unpack_from(f"{order}I", beginning, 4)[0] if len(beginning) == 8 else 0
        place += 8 + length
    return size


def _hdf5_size(path: Path) -> int:
    """Return to how many bytes the data sets of a version 7.3 file unpack."""
    import h5py

    sizes: list[int] = []

    def visit(name: str, one: Any) -> None:
        if isinstance(one, h5py.Dataset):
            sizes.append(one.size * one.dtype.itemsize)

    with h5py.File(path) as file:
        file.visititems(visit)
    return sum(sizes)


def _with_objects(path: Path) -> dict[str, Any]:
    # Takes half a second to import, and most files do not need it.
    from matio import load_from_mat
    from matio.utils.matclass import MatReadError

    try:
        return load_from_mat(str(path), raw_data=True) or {}
    except MatReadError as error:
        raise ValueError(str(error)) from error


def column(variables: Mapping[str, Any], name: str, *, file: Path) -> Array:
    """Return the numbers (K,) that `name` means: a variable, fields, cells `{i}` and rows `(i,:)` of it.

    Of a signal that Simulink logged, as a structure with time or as a time series, its values.

    Raises:
        InputError: there is no such thing, or it is not one row or column of real numbers.
    """
    value = find(variables, name, file=file)
    for inner in (_member(_member(value, "signals"), "values"), _member(value, "Data")):
        value = value if inner is None else inner
    return numbers(value, name, file=file)


def find(variables: Mapping[str, Any], name: str, *, file: Path) -> Any:
    """Return what `name` means, of whatever kind.

    Raises:
        InputError: there is no such thing; says how far the name could be followed.
    """
    steps = list(_STEP.finditer(name))
    if "".join(step.group() for step in steps) != name or not steps or not steps[0].group(1):
        raise InputError(f"{name!r} names no column of {file}: write a variable, its fields, cells {{i}} or rows (i,:)")
    value: Any = dict(variables)
    done = ""
    for step in steps:
        member, cell, row, line = step.groups()
        if member:
            following = _member(value, member)
        elif cell:
            following = _cell(value, int(cell))
        else:
            following = _line(value, int(row or line), axis=0 if row else 1)
        if following is None:
            there = f"; {done or 'the file'} holds {', '.join(_members(value)) or 'no fields'}"
            raise InputError(f"{file}: there is no {name} ({done + step.group()} is missing{there}); check the mapping")
        value, done = following, done + step.group()
    return value


def numbers(value: Any, name: str, *, file: Path) -> Array:
    """Return one row or column of real numbers as (K,).

    Raises:
        InputError: the value is of another kind or shape, or empty.
    """
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        kind = {"c": "complex numbers", "U": "text", "S": "text", "b": "true and false", "O": "cells or an object"}
        raise InputError(f"{file}: {name} holds {kind.get(array.dtype.kind, 'a struct')}; a column holds real numbers")
    if array.size == 0:
        raise InputError(f"{file}: {name} is empty; a recording has samples")
    if max(array.shape, default=1) != array.size:
        shape = " x ".join(map(str, array.shape))
        raise InputError(f"{file}: {name} is {shape}; a column is one row or one column, as in {name}(1,:)")
    return array.reshape(-1).astype(float)


def _properties(value: Any) -> dict[str, Any] | None:
    """Return the fields of a struct or an object, None where there are none."""
    if isinstance(value, np.ndarray) and value.dtype.names and value.size == 1:
        only = value.reshape(-1)[0]
        return {name: only[name] for name in value.dtype.names}
    if isinstance(value, np.ndarray) and value.dtype == object and value.size == 1:
        return _properties(value.reshape(-1)[0])
    inner = getattr(value, "properties", value)
    return inner if isinstance(inner, dict) else None


def _members(value: Any) -> list[str]:
    return [str(name) for name in _properties(value) or {} if not str(name).startswith("__")][:12]


def _member(value: Any, name: str) -> Any:
    """Return a field, in any case; of an object also a field that it keeps under `name_` or in one of its parts."""
    fields = _properties(value)
    if fields is None:
        return None
    if name in fields:
        return fields[name]
    wanted = name.casefold()
    for field, held in fields.items():
        if str(field).casefold().rstrip("_") == wanted:
            return held
    if wanted == "time" and "TimeInfo" in fields:
        return _times(fields["TimeInfo"])
    return None


def _times(info: Any) -> Any:
    """Return the times of a time series' metadata: given one by one, or by start, increment and length."""
    given = _member(info, "Time")
    if given is not None and np.size(given):
        return given
    # MATLAB stores them as Start_, Increment_ and Length, the first two empty or nan where times are uneven.
    parts = [np.asarray(_member(info, name)).reshape(-1) for name in ("Start", "Increment", "Length")]
    if not all(part.size == 1 and part.dtype.kind in "fiu" and np.isfinite(part[0]) for part in parts):
        return None
    start, increment, length = (float(part[0]) for part in parts)
    return start + increment * np.arange(int(length)) if 0 < length < _MOST_SAMPLES else None


def _cell(value: Any, index: int) -> Any:
    """Return a cell by its number from 1; of an object, of the first cell array of objects that it keeps."""
    cells = value if _is_cells(value) else _inner_cells(value)
    return cells.reshape(-1, order="F")[index - 1] if cells is not None and 1 <= index <= cells.size else None


def _is_cells(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.dtype == object


def _inner_cells(value: Any) -> Any:
    for held in (_properties(value) or {}).values():
        if _is_cells(held) and held.size and all(_properties(one) is not None for one in held.reshape(-1)):
            return held
        inner = None if isinstance(held, np.ndarray) else _inner_cells(held)
        if inner is not None:
            return inner
    return None


def _line(value: Any, index: int, *, axis: int) -> Any:
    array = np.asarray(value)
    if array.ndim != 2 or array.dtype.kind not in "fiu" or not 1 <= index <= array.shape[axis]:
        return None
    return array[index - 1] if axis == 0 else array[:, index - 1]
