"""CSV and Parquet files as columns of numbers; what is no number is told by its row."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.tables import suggest

Array = NDArray[np.float64]

_MISSING = ("", "nan", "na", "null", "none", "-")


def read_table(path: Path, columns: Sequence[str]) -> dict[str, Array]:
    """Return the named columns (K,) of a .csv or .parquet file; an empty cell is nan.

    Raises:
        InputError: the file cannot be read, is no table, lacks a column, or holds text where numbers belong.
    """
    import pyarrow as pa

    try:
        table = _parquet(path, columns) if path.suffix.lower() == ".parquet" else _csv(path, columns)
    except OSError as error:
        # pyarrow's damage reports are OSError as well, and longer than a line.
        reason = error.strerror or str(error).strip().splitlines()[0]
        raise InputError(f"cannot read {path}: {reason}; check the name, or save the recording again") from error
    except (pa.ArrowException, UnicodeError, csv.Error, MemoryError) as error:
        reason = str(error).strip().splitlines() or [type(error).__name__]
        raise InputError(f"{path} is no table that can be read ({reason[0]}); save the recording again") from error
    if table.num_rows == 0:
        raise InputError(f"{path} holds no rows; save the recording again")
    return {name: _numbers(table.column(name), name, path) for name in columns}


def _check(path: Path, header: Sequence[str], columns: Sequence[str]) -> None:
    for name in columns:
        if header.count(name) > 1:
            raise InputError(f"{path}: {header.count(name)} columns are called {name!r}; give each a name of its own")
        if name not in header:
            shown = [one if len(one) <= 40 else f"{one[:40]}…" for one in header[:20]]
            raise InputError(f"{path}: the column {name!r} is missing; {suggest(name, shown)}; check file and mapping")


def _parquet(path: Path, columns: Sequence[str]) -> Any:
    import pyarrow.parquet as pq

    file = pq.ParquetFile(path)
    _check(path, list(file.schema_arrow.names), columns)
    return file.read(columns=list(columns))


def _csv(path: Path, columns: Sequence[str]) -> Any:
    import pyarrow as pa
    from pyarrow import csv as arrow

    with path.open(encoding="utf-8-sig", newline="") as stream:
        first = stream.readline(1_000_000)
    if not first.strip():
        raise InputError(f"{path} is empty or begins with an empty line; its first line must name the columns")
    delimiter = max(",;\t", key=first.count)
    header = [name.strip() for name in next(csv.reader([first], delimiter=delimiter))]
    _check(path, header, columns)
    # Read as text, so that a cell that is no number can be told by its row.
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
