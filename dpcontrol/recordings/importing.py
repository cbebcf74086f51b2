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
from collections.abc import Collection, Iterator, Sequence
from collections.abc import Mapping as Columns
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import UNREADABLE, checked_size, checked_source
from dpcontrol.foundation.parts import part as package
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.foundation.settings import suggest
from dpcontrol.recordings.bags import is_bag, read_bag
from dpcontrol.recordings.checks import (
    ANGLE,
    CART,
    COMMAND,
    RATE,
    Samples,
    check_plausible,
    checked_repairs,
    sound_segments,
)
from dpcontrol.recordings.mapping import LENGTH_UNITS, TIME_UNITS, Mapping, load_mapping
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
    allowed = checked_repairs(repairs)
    bag, kind = is_bag(path), path.suffix.lower()
    if not bag and kind not in MATLAB + TABLES:
        known = ", ".join((*MATLAB, *TABLES, ".mcap", ".bag"))
        raise InputError(
            f"{path}: a recording is a file of kind {known} or a folder of ROS 2; this ends in {kind or 'nothing'}; "
            "save it as CSV, for example"
        )
    if not (bag and path.is_dir()):
        checked_source(path)
    default = _JOINT_STATES if bag else "table" if kind in TABLES else ""
    given = load_mapping(mapping) if mapping and mapping != default else None
    progress("reading", 0.0)
    if default:
        chosen, stretches = _of_columns(path, given, default)
    else:
        chosen, stretches = _of_matlab(path, given)
    progress("checking", 0.5)
    return _recording(path, chosen, stretches, repairs=allowed)


def _of_columns(path: Path, given: Mapping | None, default: str) -> tuple[Mapping, list[Samples]]:
    """Return the mapping and the stretches of a table or a bag.

    The default mapping names more columns than a file needs: the second and later arms of joint states, the rates, the
    cart and the segments may be missing.
    """
    mapping, optional = given or load_mapping(default), list[str]()
    if mapping.cells.states:
        raise InputError(f"{path}: the mapping {mapping.name!r} is for MATLAB cells; give one with columns: --mapping")
    if given is None:
        needed = (mapping.time.column, *mapping.angles.columns[: 1 if default == _JOINT_STATES else None])
        optional = [name for name in mapping.named if name not in needed]
    columns = (read_bag if is_bag(path) else read_table)(path, mapping.named, optional=optional)
    mapping = mapping.restricted(columns)
    if len(mapping.rates.columns) not in (0, len(mapping.angles.columns)):
        shown = ", ".join(mapping.rates.columns)
        raise InputError(f"{path}: only {shown} for {len(mapping.angles.columns)} angles; give as many rates, or none")
    return mapping, _segments(path, mapping, columns)


def _segments(path: Path, mapping: Mapping, columns: Columns[str, Array]) -> list[Samples]:
    """Return the samples of each segment."""
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        shown_lengths = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise InputError(f"{path}: the columns differ in length ({shown_lengths}); a row needs a value of each")
    groups = {
        ANGLE: mapping.angles.columns, RATE: mapping.rates.columns, CART: (mapping.cart.position,),
        COMMAND: (mapping.cart.command,),
    }  # fmt: skip
    values = {kind: np.column_stack([columns[name] for name in names]) for kind, names in groups.items() if any(names)}
    samples = _samples(str(path), mapping, values, columns.get(mapping.time.column))
    number = columns.get(mapping.time.segment, np.zeros(len(samples.time)))
    pieces = np.split(np.arange(len(number)), np.flatnonzero(np.diff(number)) + 1)
    return [samples.taken(piece) for piece in pieces]


def _samples(where: str, mapping: Mapping, values: Columns[str, Array], time: Array | None) -> Samples:
    """Return the samples of one stretch of a file, in SI units and the package's directions.

    Args:
        where: file and part, for messages.
        mapping: the mapping.
        values: columns (K, …) by kind, the angles first.
        time: (K,) in the file's unit, or None if the mapping gives a period.
    """
    count, arms = values[ANGLE].shape
    if arms > MOST_ARMS:
        raise InputError(f"{where}: {arms} angles; a recording has 1 to {MOST_ARMS} arms")
    for key, given in mapping.angles.by_arm.items():
        if len(given) not in (1, arms):
            raise InputError(
                f"{where}: the mapping's {key} has {len(given)} values for {arms} arms; give one or as many"
            )
    read = {
        ANGLE: mapping.absolute_angles,
        RATE: mapping.absolute_rates,
        CART: lambda cart: cart * LENGTH_UNITS[mapping.cart.unit],
        COMMAND: lambda command: command,
    }
    several = {kind: [f"{kind} {arm + 1}" for arm in range(arms)] for kind in (ANGLE, RATE)}
    return Samples(
        where=where,
        rows=np.arange(1, count + 1),
        time=np.arange(count) * mapping.period if time is None else time * TIME_UNITS[mapping.time.unit],
        values=np.column_stack([read[kind](columns) for kind, columns in values.items()]),
        names=tuple(name for kind in values for name in several.get(kind, [kind])),
    )


def _recording(path: Path, mapping: Mapping, stretches: list[Samples], *, repairs: frozenset[str]) -> Recording:
    """Return the recording of stretches, after all checks."""
    counts = {stretch.arms for stretch in stretches}
    if len(counts) > 1:
        raise InputError(f"{path}: some cells have {min(counts)} arms, others {max(counts)}; all must have the same")
    parts: list[Samples] = []
    notes: list[str] = []
    for stretch in stretches:
        sound, repaired = sound_segments(stretch, period=mapping.period, repairs=repairs)
        parts += sound
        notes += repaired
    spacing = mapping.period or float(np.median(np.concatenate([np.diff(part.time) for part in parts])))
    if not 1e-6 <= spacing <= 0.1:
        raise InputError(
            f"{path}: samples are {spacing:.6g} s apart, and swings are seen at 1e-6 to 0.1 s; check the unit of time"
        )
    check_plausible(parts, spacing, file=str(path))
    times: list[Array] = []
    for index, part in enumerate(parts):
        last = times[-1][-1] if times else -spacing
        behind = part.time[0] <= last if times else part.time[0] < 0
        shift = last + spacing - part.time[0] if behind else 0.0
        notes += [f"segment {index}: its time was moved by {shift:.9g} s to follow the one before"] if behind else []
        times.append(part.time + shift)
    edges = np.cumsum([0, *map(len, times)]).tolist()
    whole = replace(parts[0], values=np.concatenate([part.values for part in parts]))
    cart, command = whole.of(CART), whole.of(COMMAND)
    return Recording(
        name=path.stem,
        source=path.name,
        dt=spacing,
        time=np.concatenate(times),
        angles=np.ascontiguousarray(whole.of(ANGLE)),
        rates=whole.of(RATE),
        cart=None if cart is None else cart[:, 0],
        command=None if command is None else command[:, 0],
        segments=tuple(pairwise(edges)),
        arm_lengths=mapping.lengths(whole.arms),
        notes=tuple(notes),
    )


_MISSING = ("", "nan", "na", "null", "none", "-")
_NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+|nan|inf)(e[-+]?\d+)?", re.IGNORECASE)


def read_table(path: Path, columns: Sequence[str], *, optional: Collection[str] = ()) -> dict[str, Array]:
    """Return the named columns (K,) of a text table or a .parquet file.

    An empty cell is nan.

    Args:
        path: file.
        columns: names of columns.
        optional: columns that are left out if the table lacks them.

    Raises:
        InputError: the file cannot be read, is not a table, lacks a column, or holds text in place of numbers.
    """
    try:
        names, cells = _parquet(path, columns) if path.suffix.lower() == ".parquet" else _text(path)
    except (*UNREADABLE, csv.Error) as error:
        raise InputError(
            f"cannot read {path} as a table ({_reason(error)}); check the name, or save the recording again"
        ) from error
    for name in columns:
        if names.count(name) > 1:
            raise InputError(f"{path}: {names.count(name)} columns are called {name!r}; rename all but one")
        if name not in (*names, *optional):
            known = "the table has no header, so a mapping names columns by number; " if names[0] == "1" else ""
            raise InputError(
                f"{path}: the column {name!r} is missing; {known}{suggest(name, names[:20])}; check file and mapping"
            )
    return {name: _numbers(cells[name], name, path) for name in columns if name in names}


def _reason(error: BaseException) -> str:
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


def _parquet(path: Path, columns: Sequence[str]) -> tuple[list[str], dict[str, Any]]:
    arrow = package("pyarrow")
    # pyarrow takes a name such as s3:table.parquet for an address.
    with path.open("rb") as stream:
        try:
            file = package("pyarrow.parquet").ParquetFile(stream)
            checked_size(8.0 * file.metadata.num_rows * len(columns))
            names = list(file.schema_arrow.names)
            table = file.read(columns=[name for name in columns if names.count(name) == 1])
        except arrow.ArrowException as error:
            raise ValueError(_reason(error)) from error
    return names, {name: table.column(name).to_numpy() for name in table.column_names}


def _text(path: Path) -> tuple[list[str], dict[str, Sequence[str]]]:
    """Return the columns' names of a text table, and its cells by column.

    A first line of numbers is no header: the names are then 1, 2, ….
    """
    with path.open(encoding="utf-8-sig", newline="") as stream:
        # NumPy writes a header as a comment.
        lines = [line.removeprefix("#") for line in stream if line.strip()]
    if not lines:
        raise ValueError("it is empty")
    # Commas beside another separator are decimal points.
    mark = next((mark for mark in ";\t," if mark in lines[0]), "")
    table = list(csv.reader(lines, delimiter=mark)) if mark else [line.split() for line in lines]
    if mark != ",":
        table = [[cell.replace(",", ".") for cell in row] for row in table]
    names = [cell.strip() for cell in table[0]]
    if all(map(_NUMBER.fullmatch, names)):
        names = [str(number) for number in range(1, len(names) + 1)]
    else:
        del table[0]
    for row, cells in enumerate(table, start=1):
        if len(cells) != len(names):
            raise ValueError(f"row {row} has {len(cells)} cells, the first line {len(names)}")
    return names, dict(zip(names, zip(*table, strict=True), strict=False))


def _numbers(cells: Sequence[Any], name: str, path: Path) -> Array:
    """Return a column's numbers; markers of missing values become nan."""
    try:
        return np.array(cells, dtype=float)
    except (TypeError, ValueError):
        texts = [str(cell).strip() for cell in cells]
    values = np.full(len(texts), np.nan)
    for row, text in enumerate(texts):
        try:
            values[row] = float("nan" if text.casefold() in _MISSING else text)
        except ValueError:
            raise InputError(f"{path}: row {row + 1} of column {name!r} holds {text!r}; it must be a number") from None
    return values


def _of_matlab(path: Path, given: Mapping | None) -> tuple[Mapping, list[Samples]]:
    """Return the mapping, with the file's period if it holds one, and the stretches."""
    variables = read_matlab(path)
    mapping = given or _fitting(variables, path)
    if name := mapping.sampling.variable:
        period = float(numbers(find(variables, name, file=path), name, file=path)[0]) * TIME_UNITS[mapping.time.unit]
        if not 1e-6 <= period <= 1:
            raise InputError(f"{path}: {name} is {period:.6g} s; a sampling period is 1e-6 to 1 s")
        mapping = replace(mapping, sampling=replace(mapping.sampling, period=period))
    if mapping.cells.states:
        return mapping, list(_cells(path, mapping, variables))
    columns = {name: column(variables, name, file=path) for name in mapping.named}
    return mapping, _segments(path, mapping, columns)


def _fitting(variables: Columns[str, Any], path: Path) -> Mapping:
    """Return the first known mapping whose columns all exist.

    Raises:
        InputError: there is none; lists the variables.
    """
    for mapping in map(load_mapping, _KNOWN):
        wanted = (*mapping.cells.states[:1], *mapping.named, *filter(None, [mapping.sampling.variable]))
        if all(_found(variables, name)[0] is not None for name in wanted):
            return mapping
    raise InputError(
        f"{path}: no shipped mapping fits its variables {', '.join(list(variables)[:12])}; give a mapping that names "
        "columns (for time series NAME.Time and NAME.Data): --mapping"
    )


def _cells(path: Path, mapping: Mapping, variables: Columns[str, Any]) -> Iterator[Samples]:
    """Yield the samples of each cell."""
    for k, name in enumerate(mapping.cells.states):
        # Only the first exists in every file: a data set may have no validation part.
        if k and name not in variables:
            continue
        times_name = mapping.cells.time[k] if mapping.cells.time else ""
        cells, times = (find(variables, one, file=path) if one else None for one in (name, times_name))
        if not isinstance(cells, list) or (times_name and (not isinstance(times, list) or len(times) != len(cells))):
            raise InputError(
                f"{path}: {name} and {times_name or 'its times'} are no cell arrays with as many cells; give a mapping "
                "that names this file's columns: --mapping"
            )
        for index, cell in enumerate(cells):
            where, values = f"{path}: {name}{{{index + 1}}}", _array(cell)
            if values.dtype.kind not in "fiu" or values.ndim != 2 or values.size == 0 or len(values) % 2:
                raise InputError(
                    f"{where} is {_described(values)}; a cell holds an even number of rows, angles then rates, and a "
                    "column for each sample"
                )
            time = numbers(times[index], f"{times_name}{{{index + 1}}}", file=path) if times else None
            if time is not None and len(time) != values.shape[1]:
                raise InputError(f"{where} is {_described(values)}, but has {len(time)} times; give as many")
            angles, rates = np.hsplit(values.T.astype(float), 2)
            yield _samples(where, mapping, {ANGLE: angles, RATE: rates}, time)


def _array(value: Any) -> NDArray[Any]:
    """Return numbers as an array, and other values as an array of objects."""
    return np.empty(len(value), object) if isinstance(value, dict | list) else np.asarray(value)


def _described(array: NDArray[Any]) -> str:
    """Return shape and kind of an array, for messages."""
    return f"{' x '.join(map(str, array.shape))} of kind {array.dtype}"


_STEP = re.compile(r"\.?([A-Za-z]\w*)|\{(\d+)\}|\((\d+),:\)|\(:,(\d+)\)")
_MOST_SAMPLES = 10**8
_OCTAVE = (b"# Created by Octave", b"Octave-1-", b"\x89HDF\r\n\x1a\n")
"""Beginnings of Octave's text, binary and HDF5 files; MATLAB's HDF5 begins with a header of its own."""
_PACKED = 15
"""Type of compressed elements in a version 5 file."""


def read_matlab(path: Path) -> dict[str, Any]:
    """Return the variables of a MATLAB file by name: structs and objects as dictionaries, cell arrays as lists.

    Args:
        path: file of any version.

    Raises:
        InputError: the file cannot be read, or is not a MATLAB file.
    """
    from scipy.io import loadmat

    try:
        data = path.read_bytes()
        hdf5 = b"MATLAB 7.3" in data[:128] or b"\x89HDF\r\n\x1a\n" in data[:600]
        checked_size(_hdf5_size(path) if hdf5 else _unpacked_size(data))
        if data.startswith(_OCTAVE):
            raise InputError(f"{path} is not a MATLAB file but one of Octave; save it in Octave with `save -v7`")
        variables = {} if hdf5 else loadmat(path)
        if hdf5 or "__function_workspace__" in variables:
            variables = _with_objects(path)
        return {name: _plain(value) for name, value in variables.items() if not name.startswith("__")}
    except UNREADABLE as error:
        raise InputError(
            f"cannot read {path} as a MATLAB file ({_reason(error)}); check the name, or save or copy it again"
        ) from error


def _unpacked_size(data: bytes) -> int:
    """Return the unpacked size of a version 5 file, bytes.

    The unpacked size is that of the compressed variables, from their headers.
    """
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
    """Return the unpacked size of a version 7.3 file, bytes.

    The size is that of the data sets.
    """
    sizes: list[int] = []
    with package("h5py").File(path) as file:
        file.visititems(lambda _, item: sizes.append(getattr(item, "nbytes", 0)))
    return sum(sizes)


def _with_objects(path: Path) -> dict[str, Any]:
    # Takes half a second to import, and most files do not need it.
    matio = package("matio")
    try:
        return matio.load_from_mat(str(path), raw_data=True) or {}
    except package("matio.utils.matclass").MatReadError as error:
        raise ValueError(str(error)) from error


def _plain(value: Any) -> Any:
    """Return structs and objects as dictionaries, cell arrays and arrays of structs as lists, and numbers as they are.

    The times of a time series, which MATLAB does not store where they are even, are added.
    """
    value = getattr(value, "properties", value)
    if isinstance(value, np.ndarray) and value.dtype.names:
        value = [{name: one[name] for name in value.dtype.names} for one in value.reshape(-1, order="F")]
        value = value[0] if len(value) == 1 else value
    if isinstance(value, np.ndarray) and value.dtype == object:
        value = list(value.reshape(-1, order="F"))
    if isinstance(value, list):
        return [_plain(one) for one in value]
    if not isinstance(value, dict):
        return value
    fields = {str(name).rstrip("_"): _plain(one) for name, one in value.items()}
    if "TimeInfo" in fields and not np.size(fields.get("Time", ())):
        parts = [_member(fields["TimeInfo"], name) for name in ("Time", "Start", "Increment", "Length")]
        times, start, increment, length = (np.ravel(() if part is None else part) for part in parts)
        # Start and increment are empty for uneven times.
        if not times.size and start.size == increment.size == length.size == 1 and 0 < length[0] < _MOST_SAMPLES:
            times = start + increment * np.arange(int(length[0]))
        fields["Time"] = times
    return fields


def column(variables: Columns[str, Any], name: str, *, file: Path) -> Array:
    """Return the numbers (K,) at `name`.

    For a signal logged by Simulink (structure with time, time series) the values are returned.

    Args:
        variables: variables of the file by name.
        name: a variable with optional fields, cells `{i}` and rows `(i,:)`.
        file: the file, for messages.

    Raises:
        InputError: `name` does not exist, or is not one row or column of real numbers.
    """
    value = find(variables, name, file=file)
    for inner in (_member(_member(value, "signals"), "values"), _member(value, "Data")):
        value = value if inner is None else inner
    return numbers(value, name, file=file)


def find(variables: Columns[str, Any], name: str, *, file: Path) -> Any:
    """Return the object of any kind at `name`.

    Args:
        variables: variables of the file by name.
        name: a variable with optional fields, cells `{i}` and rows `(i,:)`.
        file: the file, for messages.

    Raises:
        InputError: `name` does not exist; reports the first missing part.
    """
    if not re.fullmatch(f"[A-Za-z]({_STEP.pattern}|\\w)*", name):
        raise InputError(f"{name!r} names no column of {file}: write a variable, its fields, cells {{i}} or rows (i,:)")
    value, done, holder = _found(variables, name)
    if value is None:
        there = f"; {done or 'the file'} holds {', '.join(list(holder)[:12]) or 'no fields'}"
        raise InputError(f"{file}: there is no {name}{there}; check the mapping")
    return value


def _found(variables: Columns[str, Any], name: str) -> tuple[Any, str, Columns[str, Any]]:
    """Return the object at `name` or None, the name of the last object on the way, and its fields."""
    value: Any = variables
    done = ""
    for step in _STEP.finditer(name):
        member, cell, row, line = step.groups()
        if member:
            following = _member(value, member)
        elif cell:
            following = dict(enumerate(_cell_list(value), start=1)).get(int(cell))
        elif isinstance(value, np.ndarray) and value.ndim == 2:
            following = dict(enumerate(value if row else value.T, start=1)).get(int(row or line))
        else:
            following = None
        if following is None:
            return None, done, value if isinstance(value, dict) else {}
        value, done = following, done + step.group()
    return value, done, {}


def _member(value: Any, name: str) -> Any:
    """Return a field of a struct or an object, ignoring case, or None."""
    fields = value[0] if isinstance(value, list) and len(value) == 1 else value
    if not isinstance(fields, dict):
        return None
    return fields.get(name, {key.casefold(): held for key, held in fields.items()}.get(name.casefold()))


def _cell_list(value: Any) -> list[Any]:
    """Return the cells of a cell array, or of the first cell array of objects in an object."""
    if isinstance(value, dict):
        inner = (_cell_list(held) for held in value.values() if isinstance(held, dict | list))
        return next((cells for cells in inner if cells and all(isinstance(one, dict) for one in cells)), [])
    return value if isinstance(value, list) else []


def numbers(value: Any, name: str, *, file: Path) -> Array:
    """Return one row or column of real numbers as (K,).

    Args:
        value: object of any kind.
        name: its name, for messages.
        file: the file, for messages.

    Raises:
        InputError: the value has another kind or shape, or is empty.
    """
    array = _array(value)
    if array.dtype.kind not in "fiu" or array.size == 0 or max(array.shape, default=1) != array.size:
        raise InputError(
            f"{file}: {name} is {_described(array)}; a column is one row or column of real numbers, as in {name}(1,:) "
            f"(save those of an object as x = {name})"
        )
    return array.reshape(-1).astype(float)
