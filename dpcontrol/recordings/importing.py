"""Read a bench's file as a recording.

Columns are mapped and checked, repaired on request, and cut into segments.

A MATLAB file of cells has one segment per cell. A table or a whole MATLAB recording is one segment, unless a column
numbers its segments or a repair cuts it. Segments whose times overlap are laid end to end, and a note reports this.

The mapping (`dpcontrol.recordings.mapping`) defines the columns: units, sign, zero, sampling.

Files are CSV, Parquet, or MATLAB of any version. Text tables are separated by commas, semicolons, tabs or blanks, and
the columns of a table without a header are named by their numbers from 1. Table cells that are not numbers are
reported by row. MATLAB's versions 4 to 7 are read by scipy; version 7.3 (HDF5) and objects (time series, Simulink data
sets) by mat-io.
Source: MathWorks, MAT-File Format (the version 5 format that scipy reads).
"""

import csv
import re
import struct
import zlib
from collections.abc import Collection, Iterator, Mapping as Columns, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise, zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import checked_size, checked_source
from dpcontrol.foundation.parts import part as package
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.foundation.settings import check_choice, suggest
from dpcontrol.recordings.bags import is_bag, read_bag, reading
from dpcontrol.recordings.checks import (
    ANGLE,
    CART,
    COMMAND,
    RATE,
    REPAIRS,
    Samples,
    check_plausible,
    sound_segments,
)
from dpcontrol.recordings.mapping import ANGLE_UNITS, LENGTH_UNITS, RATE_UNITS, TIME_UNITS, Mapping, load_mapping
from dpcontrol.recordings.recording import Recording

MATLAB, TABLES = (".mat",), (".csv", ".tsv", ".txt", ".parquet")
MOST_ARMS = 6
_KNOWN = (
    "multi-arm", "multi-arm-triple-cart", "multi-arm-triple", "multi-arm-double-cart", "multi-arm-double",
    "multi-arm-single-cart", "multi-arm-single",
    "multi-arm-raw-triple", "multi-arm-raw", "multi-arm-raw-single",
)  # fmt: skip
"""Mappings of MATLAB files, recognised by their variables; the more demanding ones come first."""
_JOINT_STATES = "joint-states"


def import_recording(
    path: Path | str,
    mapping: str | None = None,
    *,
    repairs: Sequence[str] = (),
    progress: Progress = no_progress,
) -> Recording:
    """Return the recording in a file of the bench.

    Args:
        path: a MATLAB (.mat), CSV (.csv, .tsv, .txt), Parquet (.parquet) or MCAP (.mcap) file, or a ROS bag.
        mapping: name or path of a mapping; by default one that matches the kind of file.
        repairs: names of permitted repairs.
        progress: called with a label and the completed share.

    Raises:
        InputError: the file or the mapping cannot be used; one sentence with file, row, value and remedy.
    """
    path = Path(path)
    check_choice("repair", REPAIRS, *repairs)
    bag, kind = is_bag(path), path.suffix.lower()
    if not bag and kind not in MATLAB + TABLES:
        suffixes = ", ".join((*MATLAB, *TABLES, ".mcap", ".bag"))
        raise InputError(
            f"{path}: a recording is a file of kind {suffixes} or a folder of ROS 2; this ends in {kind or 'nothing'}; "
            "save it as CSV, for example"
        )
    if not (bag and path.is_dir()):
        checked_source(path)
    default_mapping = _JOINT_STATES if bag else "table" if kind in TABLES else ""
    user_mapping = load_mapping(mapping) if mapping and mapping != default_mapping else None
    progress("reading", 0.0)
    if default_mapping:
        used_mapping, stretches = _of_columns(path, user_mapping, default_mapping)
    else:
        used_mapping, stretches = _of_matlab(path, user_mapping)
    progress("checking", 0.5)
    return _recording(path, used_mapping, stretches, repairs=frozenset(repairs))


def _of_columns(path: Path, user_mapping: Mapping | None, default: str) -> tuple[Mapping, list[Samples]]:
    """Return the mapping, restricted to the file's columns, and the stretches of samples of a table or a bag.

    The default mapping names more columns than a file needs: the second and later arms of joint states, the rates, the
    cart and the segments may be missing. `default` is the name of that mapping, and `user_mapping` replaces it; all
    columns of a user's mapping must exist.

    Raises:
        InputError: the mapping is for MATLAB cells, a column is missing, or only some arms have rates.
    """
    mapping, optional = user_mapping or load_mapping(default), list[str]()
    if mapping.cells.states:
        raise InputError(f"{path}: the mapping {mapping.name!r} is for MATLAB cells; give one with columns: --mapping")
    if user_mapping is None:
        needed = (mapping.time.column, *mapping.angles.columns[: 1 if default == _JOINT_STATES else None])
        optional = [name for name in mapping.named if name not in needed]
    columns = (read_bag if is_bag(path) else read_table)(path, mapping.named, optional=optional)
    mapping = mapping.restricted(columns)
    if len(mapping.rates.columns) not in (0, len(mapping.angles.columns)):
        rate_names = ", ".join(mapping.rates.columns)
        raise InputError(
            f"{path}: only {rate_names} for {len(mapping.angles.columns)} angles; give as many rates, or none"
        )
    return mapping, _segments(path, mapping, columns)


def _segments(path: Path, mapping: Mapping, columns: Columns[str, Array]) -> list[Samples]:
    """Return the samples of each segment in a file's columns (K,), which are cut where the segment's number changes.

    `mapping` defines the columns, their units and directions. Without a column of segments, all samples are one.

    Raises:
        InputError: the columns differ in length.
    """
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        shown_lengths = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise InputError(f"{path}: the columns differ in length ({shown_lengths}); a row needs a value of each")
    columns_by_kind = {
        ANGLE: mapping.angles.columns, RATE: mapping.rates.columns, CART: (mapping.cart.position,),
        COMMAND: (mapping.cart.command,),
    }  # fmt: skip
    values = {
        kind: np.column_stack([columns[name] for name in names])
        for kind, names in columns_by_kind.items()
        if any(names)
    }
    samples = _samples(str(path), mapping, values, columns.get(mapping.time.column))
    segment_numbers = columns.get(mapping.time.segment, np.zeros(len(samples.time)))
    return samples.cut(np.flatnonzero(np.diff(segment_numbers)))


def _samples(where: str, mapping: Mapping, values: Columns[str, Array], time: Array | None) -> Samples:
    """Return the samples of one stretch of a file, in SI units and the package's directions.

    Args:
        where: file and part, for messages.
        mapping: the mapping.
        values: columns (K, …) by kind, the angles first; kinds are `ANGLE`, `RATE`, `CART` and `COMMAND`.
        time: (K,) in the file's unit, or None if the mapping gives a period.

    Raises:
        InputError: there are too many arms, or the mapping has values for another number of arms.
    """
    count, arms = values[ANGLE].shape
    if arms > MOST_ARMS:
        raise InputError(f"{where}: {arms} angles; a recording has 1 to {MOST_ARMS} arms")
    for key, of_arms in mapping.angles.by_arm.items():
        if len(of_arms) not in (1, arms):
            raise InputError(
                f"{where}: the mapping's {key} has {len(of_arms)} values for {arms} arms; give one or as many"
            )
    conversions = {
        ANGLE: lambda angles: mapping.absolute(angles, ANGLE_UNITS[mapping.angles.unit], mapping.angles.zero),
        RATE: lambda rates: mapping.absolute(rates, RATE_UNITS[mapping.rates.unit]),
        CART: lambda cart: cart * LENGTH_UNITS[mapping.cart.unit],
        COMMAND: lambda command: command,
    }
    numbered_names = {kind: [f"{kind} {arm + 1}" for arm in range(arms)] for kind in (ANGLE, RATE)}
    return Samples(
        where=where,
        rows=np.arange(1, count + 1),
        time=np.arange(count) * mapping.period if time is None else time * TIME_UNITS[mapping.time.unit],
        values=np.column_stack([conversions[kind](columns) for kind, columns in values.items()]),
        names=tuple(name for kind in values for name in numbered_names.get(kind, [kind])),
    )


def _recording(path: Path, mapping: Mapping, stretches: list[Samples], *, repairs: frozenset[str]) -> Recording:
    """Return the recording of a file's stretches, after all checks and the permitted repairs.

    Segments whose times overlap are moved to follow one another, as the recording's notes report. `repairs` are the
    names of permitted repairs.

    Raises:
        InputError: the stretches have different numbers of arms, or a check fails.
    """
    counts = {stretch.arms for stretch in stretches}
    if len(counts) != 1:
        counts_text = " and ".join(map(str, sorted(counts))) or "no"
        raise InputError(f"{path}: its cells have {counts_text} arms; all must have the same number")
    repaired = [sound_segments(stretch, period=mapping.period, repairs=repairs) for stretch in stretches]
    parts, notes = (
        [part for segments, _ in repaired for part in segments],
        [note for _, segment_notes in repaired for note in segment_notes],
    )
    spacing = mapping.period or float(np.median(np.concatenate([np.diff(part.time) for part in parts])))
    if not 1e-6 <= spacing <= 0.1:
        raise InputError(
            f"{path}: samples are {spacing:.6g} s apart, and swings are seen at 1e-6 to 0.1 s; check the unit of time"
        )
    check_plausible(parts, spacing, file=str(path))
    times: list[Array] = []
    for index, part in enumerate(parts):
        last = times[-1][-1] if times else -spacing
        # The first segment is moved only if its time begins below zero.
        overlaps = part.time[0] <= last if times else part.time[0] < 0
        shift = last + spacing - part.time[0] if overlaps else 0.0
        notes += [f"segment {index}: its time was moved by {shift:.9g} s to follow the one before"] if overlaps else []
        times.append(part.time + shift)
    edges = np.cumsum([0, *map(len, times)]).tolist()
    joined = replace(parts[0], values=np.concatenate([part.values for part in parts]))
    cart, command = joined.of(CART), joined.of(COMMAND)
    return Recording(
        name=path.stem,
        source=path.name,
        dt=spacing,
        time=np.concatenate(times),
        angles=np.ascontiguousarray(joined.of(ANGLE)),
        rates=joined.of(RATE),
        cart=None if cart is None else cart[:, 0],
        command=None if command is None else command[:, 0],
        segments=tuple(pairwise(edges)),
        # Arms without a length have that of the last one.
        arm_lengths=(*mapping.arm_lengths, *joined.arms * mapping.arm_lengths[-1:])[: joined.arms],
        notes=tuple(notes),
    )


_MISSING = ("", "nan", "na", "null", "none", "-")
_NUMBER = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+|nan|inf)(e[-+]?\d+)?", re.IGNORECASE)


def read_table(path: Path, columns: Sequence[str], *, optional: Collection[str] = ()) -> dict[str, Array]:
    """Return the named columns (K,) of a text table or a .parquet file, with nan for empty cells.

    Args:
        path: file.
        columns: names of columns.
        optional: columns that are left out if the table lacks them.

    Raises:
        InputError: the file cannot be read, is not a table, lacks a column, or holds text in place of numbers.
    """
    with reading(path, "a table"):
        names, cells = _parquet(path, columns) if path.suffix.lower() == ".parquet" else _text(path)
    for name in columns:
        if names.count(name) > 1:
            raise InputError(f"{path}: {names.count(name)} columns are called {name!r}; rename all but one")
        if name not in (*names, *optional):
            header = "the table has no header, so a mapping names columns by number; " if names[0] == "1" else ""
            raise InputError(
                f"{path}: the column {name!r} is missing; {header}{suggest(name, names[:20])}; check file and mapping"
            )
    return {name: _numbers(cells[name], name, path) for name in columns if name in names}


def _parquet(path: Path, columns: Sequence[str]) -> tuple[list[str], dict[str, Any]]:
    """Return all column names of a Parquet file, and the cells (K,) of the named columns as numpy arrays.

    A column whose name occurs several times is left out, and reported by the caller.
    """
    # pyarrow takes a name such as s3:table.parquet for an address.
    with path.open("rb") as stream:
        file = package("pyarrow.parquet").ParquetFile(stream)
        checked_size(8.0 * file.metadata.num_rows * len(columns))
        names = list(file.schema_arrow.names)
        table = file.read(columns=[name for name in columns if names.count(name) == 1])
    return names, {name: table.column(name).to_numpy() for name in table.column_names}


def _text(path: Path) -> tuple[list[str], dict[str, Sequence[str]]]:
    """Return the columns' names of a text table, and its cells by column, as texts.

    A first line of numbers is no header: the names are then 1, 2, ….

    Raises:
        ValueError: the table has fewer than two lines, or a row has not as many cells as the first line.
    """
    with path.open(encoding="utf-8-sig", newline="") as stream:
        # NumPy writes a header as a comment.
        lines = [line.removeprefix("#") for line in stream if line.strip()]
    if len(lines) < 2:
        raise ValueError("it has no rows")
    # Commas beside another separator are decimal points.
    separator = next((separator for separator in ";\t," if separator in lines[0]), "")
    table = list(csv.reader(lines, delimiter=separator)) if separator else [line.split() for line in lines]
    if separator != ",":
        table = [[cell.replace(",", ".") for cell in row] for row in table]
    names = [cell.strip() for cell in table[0]]
    if all(map(_NUMBER.fullmatch, names)):
        names = [str(number) for number in range(1, len(names) + 1)]
    else:
        del table[0]
    uneven_rows = [row for row, cells in enumerate(table, start=1) if len(cells) != len(names)]
    if uneven_rows:
        raise ValueError(
            f"row {uneven_rows[0]} has {len(table[uneven_rows[0] - 1])} cells, the first line {len(names)}"
        )
    return names, dict(zip(names, zip(*table, strict=True), strict=False))


def _numbers(cells: Sequence[Any], name: str, path: Path) -> Array:
    """Return a column's cells, texts or numbers, as numbers (K,); markers of missing values become nan.

    Raises:
        InputError: a cell is no number; names its row.
    """
    try:
        return np.array(cells, dtype=float)
    except (TypeError, ValueError):
        texts = [str(cell).strip() for cell in cells]
    numbers = ["nan" if text.casefold() in _MISSING else text for text in texts]
    for row_number, text in enumerate(numbers, start=1):
        if not _NUMBER.fullmatch(text):
            raise InputError(f"{path}: row {row_number} of column {name!r} holds {text!r}; it must be a number")
    return np.array(numbers, dtype=float)


def _of_matlab(path: Path, user_mapping: Mapping | None) -> tuple[Mapping, list[Samples]]:
    """Return the mapping of a MATLAB file, with the file's period if it holds one, and the stretches of samples.

    Without a user's mapping, the first shipped one that fits is used.

    Raises:
        InputError: no mapping fits, a column is missing, or the file's period is impossible.
    """
    file = MatlabFile(path, read_matlab(path))
    mapping = user_mapping or _fitting(file)
    if name := mapping.sampling.variable:
        period = float(file.column(name)[0]) * TIME_UNITS[mapping.time.unit]
        if not 1e-6 <= period <= 1:
            raise InputError(f"{path}: {name} is {period:.6g} s; a sampling period is 1e-6 to 1 s")
        mapping = replace(mapping, sampling=replace(mapping.sampling, period=period))
    if mapping.cells.states:
        return mapping, list(_cells(file, mapping))
    return mapping, _segments(path, mapping, {name: file.column(name) for name in mapping.named})


def _fitting(file: "MatlabFile") -> Mapping:
    """Return the first known mapping whose columns all exist in a MATLAB file.

    Raises:
        InputError: there is none; lists the variables.
    """
    for mapping in map(load_mapping, _KNOWN):
        first_cell = [f"{name}{{1}}" for name in mapping.cells.states[:1]]
        variables = (*first_cell, *mapping.named, *filter(None, [mapping.sampling.variable]))
        if all(file.find(name) is not None for name in variables):
            return mapping
    raise InputError(
        f"{file.path}: no shipped mapping fits its variables {', '.join(list(file.values)[:12])}; give a mapping that "
        "names columns (for time series NAME.Time and NAME.Data): --mapping"
    )


def _cells(file: "MatlabFile", mapping: Mapping) -> Iterator[Samples]:
    """Yield the samples of each cell of the mapped cell arrays; a cell is a matrix whose rows are angles, then rates.

    Raises:
        InputError: a cell has another shape, or not as many times.
    """
    for states, times in zip_longest(mapping.cells.states, mapping.cells.time, fillvalue=""):
        cells = [name for name in file.values if re.fullmatch(rf"{re.escape(states)}\{{\d+\}}", name)]
        for number, cell in enumerate(cells, start=1):
            name, values = f"{states}{{{number}}}", file.values[cell]
            time = file.column(f"{times}{{{number}}}") if times else None
            angles, rates = np.array_split(np.atleast_2d(values).T.astype(float), 2, axis=1)
            # The names differ if a cell before this one is missing because it holds no numbers.
            if name != cell or angles.shape != rates.shape or (time is not None and len(time) != len(angles)):
                raise InputError(
                    f"{file.path}: {name} is not a matrix with an even number of rows, angles then rates, and a column "
                    "for each sample, or has not as many times"
                )
            yield _samples(f"{file.path}: {name}", mapping, {ANGLE: angles, RATE: rates}, time)


_LINE = re.compile(r"(.*)\((?:(\d+),:|:,(\d+))\)")
"""Row or column of a matrix."""
_MOST_SAMPLES = 10**8
_OCTAVE = (b"# Created by Octave", b"Octave-1-", b"\x89HDF\r\n\x1a\n")
"""Beginnings of Octave's text, binary and HDF5 files; MATLAB's HDF5 begins with a header of its own."""
_PACKED = 15
"""Type of compressed elements in a version 5 file."""


@dataclass(frozen=True)
class MatlabFile:
    """The numbers of a MATLAB file, in which a mapping finds its columns.

    Attributes:
        path: the file.
        values: arrays of numbers by name in MATLAB's notation, such as `data{2}.Values.Data`.
    """

    path: Path
    values: Columns[str, NDArray[Any]]

    def find(self, name: str) -> NDArray[Any] | None:
        """Return the array of a name, or None if the file has no such array, row or column.

        Case is ignored. Of a signal logged by Simulink (structure with time, time series), it is the array of values.

        Args:
            name: a variable with optional fields, cells `{i}` and a row `(i,:)` or column `(:,i)`.
        """
        if (
            (matched_line := _LINE.fullmatch(name))
            and (matrix := self.find(matched_line[1])) is not None
            and matrix.ndim == 2
        ):
            return dict(enumerate(matrix if matched_line[2] else matrix.T, start=1)).get(
                int(matched_line[2] or matched_line[3])
            )
        stored_names = {stored_name.casefold(): stored_name for stored_name in self.values}
        suffixes = ("", ".signals.values", ".data")
        stored_name = next(
            (stored_names[name.casefold() + suffix] for suffix in suffixes if name.casefold() + suffix in stored_names),
            None,
        )
        return None if stored_name is None else self.values[stored_name]

    def column(self, name: str) -> Array:
        """Return one row or column of real numbers as (K,), a column of a mapping.

        Args:
            name: see `find`.

        Raises:
            InputError: there is no such array, or it has another shape.
        """
        array = self.find(name)
        if array is None:
            raise InputError(
                f"{self.path}: there are no numbers {name}; {suggest(name, self.values)}; check the mapping"
            )
        if max(array.shape, default=1) != array.size:
            raise InputError(
                f"{self.path}: {name} is of shape {array.shape}; a column is one row or column, as in {name}(1,:)"
            )
        return array.reshape(-1).astype(float)


def read_matlab(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of numbers in a MATLAB file by name, such as `data{2}.Values.Data`.

    Args:
        path: file of any version.

    Raises:
        InputError: the file cannot be read, or is not a MATLAB file.
    """
    from scipy.io import loadmat

    with reading(path, "a MATLAB file"):
        data = path.read_bytes()
        is_hdf5 = b"MATLAB 7.3" in data[:128] or b"\x89HDF\r\n\x1a\n" in data[:600]
        checked_size(_hdf5_size(path) if is_hdf5 else _unpacked_size(data))
        if data.startswith(_OCTAVE):
            raise InputError(f"{path} is not a MATLAB file but one of Octave; save it in Octave with `save -v7`")
        variables = {} if is_hdf5 else loadmat(path)
        if is_hdf5 or "__function_workspace__" in variables:
            variables = package("matio").load_from_mat(str(path), raw_data=True) or {}
        named_arrays = (_arrays(value, name) for name, value in variables.items() if not name.startswith("__"))
        return dict(chain.from_iterable(named_arrays))


def _unpacked_size(data: bytes) -> int:
    """Return the unpacked size of a version 5 file, bytes, from the headers of its compressed variables.

    The caller rejects a file that would unpack to more than the memory. The size is 0 for files of other versions and
    without compressed variables. A version 5 file has a header of 128 bytes that ends with the order of bytes. Each
    variable begins with its type and length, four bytes each.
    """
    byte_order = {b"IM": "<", b"MI": ">"}.get(data[126:128], "")
    size, position = 0, 128
    while byte_order and position + 8 <= len(data):
        kind, length = struct.unpack_from(f"{byte_order}II", data, position)
        if kind == _PACKED:
            beginning = zlib.decompressobj().decompress(data[position + 8 : position + 8 + length], 8)
            size += struct.unpack_from(f"{byte_order}I", beginning, 4)[0] if len(beginning) == 8 else 0
        position += 8 + length
    return size


def _hdf5_size(path: Path) -> int:
    """Return the unpacked size of the data sets of a version 7.3 file, bytes, for the same check."""
    sizes: list[int] = []
    with package("h5py").File(path) as file:
        file.visititems(lambda _, item: sizes.append(getattr(item, "nbytes", 0)))
    return sum(sizes)


def _arrays(value: Any, name: str, owner: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the arrays of numbers in a variable, with their names in MATLAB's notation.

    If an object holds a cell array of objects, each cell is yielded under the array's name and under the name of the
    object. A time series with even times stores only their start, increment and number, so its times are added.

    Args:
        value: variable, or a part of it, as scipy or mat-io read it: an array, a list of cells, a dictionary of fields,
            or an object whose `properties` are these. Texts and other contents yield nothing.
        name: its name.
        owner: the name of the variable or cell that holds it.
    """
    value = getattr(value, "properties", value)
    if isinstance(value, np.ndarray) and value.dtype.names:
        value = [{field: item[field] for field in value.dtype.names} for item in value.reshape(-1, order="F")]
        value = value[0] if len(value) == 1 else value
    if isinstance(value, np.ndarray) and value.dtype == object:
        value = list(value.reshape(-1, order="F"))
    if isinstance(value, list):
        for number, item in enumerate(value, start=1):
            # An object's cells are found by the name of the array and by that of the object.
            for holder in {name, owner or name} if hasattr(item, "properties") else (name,):
                yield from _arrays(item, f"{holder}{{{number}}}")
    elif isinstance(value, dict):
        member_arrays = {}
        for field, item in value.items():
            member_arrays |= _arrays(item, f"{name}.{str(field).rstrip('_')}", owner or name)
        yield from member_arrays.items()
        time_info = [
            member_arrays.get(f"{name}.TimeInfo.{field}", np.empty(0)) for field in ("Start", "Increment", "Length")
        ]
        if f"{name}.Time" not in member_arrays and all(part.size == 1 for part in time_info):
            start, increment, length = np.concatenate(time_info, axis=None)
            yield f"{name}.Time", start + increment * np.arange(min(length, _MOST_SAMPLES))
    elif np.size(value) and np.asarray(value).dtype.kind in "fiu":
        yield name, np.asarray(value)
