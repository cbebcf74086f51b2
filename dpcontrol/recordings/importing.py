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
import math
import re
import struct
import zlib
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import chain, pairwise
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
    allowed = checked_repairs(tuple(repairs))
    kind = path.suffix.lower()
    bag = is_bag(path)
    if not bag and kind not in MATLAB + TABLES:
        known = ", ".join((*MATLAB, *TABLES, ".mcap", ".bag"))
        raise InputError(
            f"{path}: a recording is a file of kind {known} or a folder of ROS 2; this ends in {kind or 'nothing'}; "
            "save it as CSV, for example"
        )
    if not (bag and path.is_dir()):
        checked_source(path)
    given = load_mapping(mapping) if mapping else None
    progress("reading", 0.0)
    if kind in MATLAB:
        variables = read_matlab(path)
        chosen = given or _fitting(variables, path)
        stretches, period = _matlab(path, chosen, variables)
    elif bag:
        if given is None or mapping == _JOINT_STATES:
            chosen, columns, covered = _joint_states(path)
        else:
            _check_columns(path, given)
            chosen, (columns, covered) = given, read_bag(path, given.named)
        stretches, period = _of_columns(path, chosen, columns, chosen.period, covered), chosen.period
    else:
        chosen, columns = _table(path, given)
        stretches, period = _of_columns(path, chosen, columns, chosen.period), chosen.period
    progress("checking", 0.5)
    return _recording(path, chosen, stretches, period=period, repairs=allowed)


def _fitting(variables: dict[str, Any], path: Path) -> Mapping:
    """Return the first known mapping whose columns all exist.

    Raises:
        InputError: there is none; lists the variables.
    """
    for name in _KNOWN:
        mapping = load_mapping(name)
        wanted = (*mapping.cells.states[:1], *mapping.named, mapping.sampling.variable)
        try:
            for column_name in filter(None, wanted):
                find(variables, column_name, file=path)
        except InputError:
            continue
        return mapping
    raise InputError(
        f"{path}: no shipped mapping fits its variables {', '.join(list(variables)[:12])}; give a mapping that names "
        "columns (for time series NAME.Time and NAME.Data): --mapping"
    )


_JOINT_STATES = "joint-states"


def _joint_states(path: Path) -> tuple[Mapping, dict[str, Array], NDArray[np.bool_]]:
    """Return the mapping of joint states, with the bag's own joints.

    A log of a run has one arm or more, and velocities only if the rig measures them. The results of `read_bag` are
    returned too.
    """
    mapping = load_mapping(_JOINT_STATES)
    first = mapping.angles.columns[0]
    angles, rates = (
        [name.replace("arm_1", f"arm_{arm + 1}") for arm in range(MOST_ARMS)]
        for name in (first, mapping.rates.columns[0])
    )
    cart, segment = mapping.cart.position, mapping.time.segment
    optional = (*angles[1:], *rates, cart, segment)
    columns, covered = read_bag(path, (first, *optional, mapping.time.column), optional=optional)
    angles, rates = (tuple(name for name in names if name in columns) for names in (angles, rates))
    chosen = replace(
        mapping,
        angles=replace(mapping.angles, columns=angles),
        rates=replace(mapping.rates, columns=rates),
        cart=replace(mapping.cart, position=cart if cart in columns else ""),
    )
    return chosen, columns, covered


def _check_columns(path: Path, mapping: Mapping) -> None:
    """Reject a mapping of MATLAB cells for a file that has only columns."""
    if mapping.cells.states:
        raise InputError(f"{path}: the mapping {mapping.name!r} is for MATLAB cells; give one with columns: --mapping")


def _table(path: Path, given: Mapping | None) -> tuple[Mapping, dict[str, Array]]:
    """Return the mapping and the columns of a table.

    The shipped mapping loses its rates if the table has none of them. The segments may be missing, too.
    """
    if given is not None:
        _check_columns(path, given)
        return given, read_table(path, given.named)
    mapping = load_mapping("table")
    rates = mapping.rates.columns
    columns = read_table(path, mapping.named, optional=(*rates, mapping.time.segment))
    rates = _present(path, list(columns), rates) if any(name in columns for name in rates) else ()
    return replace(mapping, rates=replace(mapping.rates, columns=rates)), columns


def _of_columns(
    path: Path,
    mapping: Mapping,
    columns: dict[str, Array],
    period: float,
    covered: NDArray[np.bool_] | None = None,
) -> list[Samples]:
    """Return the samples of each segment, of the covered rows only."""
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        shown_lengths = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise InputError(f"{path}: the columns differ in length ({shown_lengths}); a row needs a value of each")

    groups = {
        ANGLE: mapping.angles.columns, RATE: mapping.rates.columns, CART: (mapping.cart.position,),
        COMMAND: (mapping.cart.command,),
    }  # fmt: skip
    found = {kind: np.column_stack([columns[name] for name in names]) for kind, names in groups.items() if any(names)}
    samples = _samples(path, str(path), mapping, found, columns.get(mapping.time.column), period)
    number = columns.get(mapping.time.segment, np.zeros(len(samples.time)))
    pieces = np.split(np.arange(len(number)), np.flatnonzero(np.diff(number)) + 1)
    return [samples.taken(piece if covered is None else piece[covered[piece]]) for piece in pieces]


def _samples(
    path: Path, where: str, mapping: Mapping, found: dict[str, Array], time: Array | None, period: float
) -> Samples:
    """Return the samples of one stretch of a file.

    The samples are in SI units and the package's directions.

    Args:
        found: columns (K, …) by kind, the angles first.
        time: (K,) in the file's unit, or None if the mapping gives a period.
    """
    count, arms = found[ANGLE].shape
    if arms > MOST_ARMS:
        raise InputError(f"{path}: {arms} angles; a recording has 1 to {MOST_ARMS} arms")
    for key, given in mapping.angles.by_arm.items():
        if len(given) not in (1, arms):
            raise InputError(
                f"{path}: the mapping's {key} has {len(given)} values for {arms} arms; give one or as many"
            )
    names: list[str] = []
    for kind in found:
        names += [f"{kind} {i + 1}" for i in range(arms)] if kind in (ANGLE, RATE) else [kind]
    read = {
        ANGLE: mapping.absolute_angles,
        RATE: mapping.absolute_rates,
        CART: lambda cart: cart * LENGTH_UNITS[mapping.cart.unit],
    }
    return Samples(
        where=where,
        rows=np.arange(1, count + 1),
        time=np.arange(count) * period if time is None else time * TIME_UNITS[mapping.time.unit],
        values=np.column_stack([read[kind](values) if kind in read else values for kind, values in found.items()]),
        names=tuple(names),
    )


def _matlab(path: Path, mapping: Mapping, variables: dict[str, Any]) -> tuple[list[Samples], float]:
    period = mapping.period
    if mapping.sampling.variable:
        name = mapping.sampling.variable
        period = float(numbers(find(variables, name, file=path), name, file=path)[0]) * TIME_UNITS[mapping.time.unit]
        if not 1e-6 <= period <= 1:
            raise InputError(f"{path}: {name} is {period:.6g} s; a sampling period is 1e-6 to 1 s")
    if not mapping.cells.states:
        found = {name: column(variables, name, file=path) for name in mapping.named}
        return _of_columns(path, mapping, found, period), period
    stretches: list[Samples] = []
    for k, name in enumerate(mapping.cells.states):
        # Only the first exists in every file: a data set may have no validation part.
        if k and name not in variables:
            continue
        times = mapping.cells.time[k] if mapping.cells.time else ""
        stretches += _cells(path, mapping, variables, name, times, period)
    arms = {stretch.arms for stretch in stretches}
    if len(arms) > 1:
        raise InputError(f"{path}: some cells have {min(arms)} arms, others {max(arms)}; all must have the same")
    return stretches, period


def _cells(
    path: Path, mapping: Mapping, variables: dict[str, Any], name: str, times: str, period: float
) -> list[Samples]:
    cells = _cell_list(path, variables, name)
    time_cells = _cell_list(path, variables, times) if times else [None] * len(cells)
    if len(cells) != len(time_cells):
        raise InputError(f"{path}: {name} has {len(cells)} cells and {times} {len(time_cells)}; each needs its times")
    stretches = []
    for number, (cell, time) in enumerate(zip(cells, time_cells, strict=True), start=1):
        label, values = f"{name}{{{number}}}", np.asarray(cell)
        if values.dtype.kind not in "fiu" or values.ndim != 2 or values.size == 0 or len(values) % 2:
            raise InputError(
                f"{path}: {label} is {_described(values)}; a cell holds an even number of rows, angles then rates, and "
                "a column for each sample"
            )
        when = None if time is None else numbers(time, f"{times}{{{number}}}", file=path)
        if when is not None and len(when) != values.shape[1]:
            raise InputError(f"{path}: {label} is {_described(values)}, but has {len(when)} times; give as many")
        angles, rates = np.hsplit(values.T.astype(float), 2)
        stretches.append(_samples(path, f"{path}: {label}", mapping, {ANGLE: angles, RATE: rates}, when, period))
    return stretches


def _described(value: Any) -> str:
    """Return shape and kind of a value, for messages."""
    array = np.asarray(value)
    return f"{' x '.join(map(str, array.shape))} of kind {array.dtype}"


def _cell_list(path: Path, variables: dict[str, Any], name: str) -> list[Any]:
    value = find(variables, name, file=path)
    if not _is_cells(value) or not value.size:
        raise InputError(
            f"{path}: {name} is not a cell array with cells in it (it is {_described(value)}); "
            "give a mapping that names this file's columns: --mapping"
        )
    return list(value.reshape(-1, order="F"))


def _recording(
    path: Path, mapping: Mapping, stretches: list[Samples], *, period: float, repairs: frozenset[str]
) -> Recording:
    parts: list[Samples] = []
    notes: list[str] = []
    for stretch in stretches:
        found, shown_lengths = sound_segments(stretch, period=period, repairs=repairs)
        parts += found
        notes += shown_lengths
    spacing = period or float(np.median(np.concatenate([np.diff(part.time) for part in parts])))
    if not 1e-6 <= spacing <= 0.1:
        raise InputError(
            f"{path}: samples are {spacing:.6g} s apart, and swings are seen at 1e-6 to 0.1 s; check the unit of time"
        )
    check_plausible(parts, file=str(path))
    parts, laid = _in_order(parts, spacing)
    edges = np.cumsum([0, *(len(part.time) for part in parts)]).tolist()
    whole = replace(parts[0], values=np.concatenate([part.values for part in parts]))
    cart, command = whole.of(CART), whole.of(COMMAND)
    return Recording(
        name=path.stem,
        source=path.name,
        dt=spacing,
        time=np.concatenate([part.time for part in parts]),
        angles=np.ascontiguousarray(whole.of(ANGLE)),
        rates=whole.of(RATE),
        cart=None if cart is None else cart[:, 0],
        command=None if command is None else command[:, 0],
        segments=tuple(pairwise(edges)),
        arm_lengths=mapping.lengths(whole.arms),
        notes=(*notes, *laid),
    )


def _in_order(parts: list[Samples], spacing: float) -> tuple[list[Samples], list[str]]:
    """Return the segments with increasing times, and notes.

    A note reports each segment that was moved in time.
    """
    placed: list[Samples] = []
    moved: list[str] = []
    last = -np.inf
    for index, part in enumerate(parts):
        shift = 0.0
        if (part.time[0] < 0 and not placed) or part.time[0] <= last:
            shift = (last + spacing if placed else 0.0) - part.time[0]
            moved.append(f"segment {index}: its time was moved by {shift:.9g} s to follow the one before")
        placed.append(replace(part, time=part.time + shift))
        last = float(placed[-1].time[-1])
    return placed, moved


_MISSING = ("", "nan", "na", "null", "none", "-")


def read_table(path: Path, columns: Sequence[str], *, optional: Collection[str] = ()) -> dict[str, Array]:
    """Return the named columns (K,) of a .csv or .parquet file.

    An empty cell is nan.

    Args:
        path: file.
        columns: names of columns.
        optional: columns that are left out if the table lacks them.

    Raises:
        InputError: the file cannot be read, is not a table, lacks a column, or holds text in place of numbers.
    """
    try:
        table = (_parquet if path.suffix.lower() == ".parquet" else _csv)(path, columns, optional)
    except (OSError, ValueError, csv.Error, MemoryError) as error:
        raise InputError(
            f"cannot read {path} as a table ({_reason(error)}); check the name, or save the recording again"
        ) from error
    return {name: _numbers(cells, name, path) for name, cells in table.items()}


def _reason(error: BaseException) -> str:
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


def _present(
    path: Path, header: Sequence[str], columns: Sequence[str], optional: Collection[str] = ()
) -> tuple[str, ...]:
    """Return the columns that a table has; reject missing ones."""
    for name in columns:
        if header.count(name) > 1:
            raise InputError(f"{path}: {header.count(name)} columns are called {name!r}; rename all but one")
        if name not in (*header, *optional):
            known = "the table has no header, so a mapping names columns by number; " if header[0] == "1" else ""
            raise InputError(
                f"{path}: the column {name!r} is missing; {known}{suggest(name, header[:20])}; check file and mapping"
            )
    return tuple(name for name in columns if name in header)


def _parquet(path: Path, columns: Sequence[str], optional: Collection[str]) -> dict[str, NDArray[Any]]:
    arrow = package("pyarrow")
    try:
        # pyarrow takes a name such as s3:table.parquet for an address.
        with path.open("rb") as stream:
            file = package("pyarrow.parquet").ParquetFile(stream)
            checked_size(8.0 * file.metadata.num_rows * len(columns))
            wanted = _present(path, list(file.schema_arrow.names), columns, optional)
            table = file.read(columns=list(wanted))
    except arrow.ArrowException as error:
        raise ValueError(_reason(error)) from error
    return {name: table.column(name).to_numpy() for name in wanted}


_NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+|nan|inf)(e[-+]?\d+)?", re.IGNORECASE)


def _rows(path: Path) -> Iterator[list[str]]:
    """Yield the columns' names of a text table, then its rows.

    A first line of numbers is no header: the names are then 1, 2, ….
    """
    with path.open(encoding="utf-8-sig", newline="") as stream:
        head = [stream.readline(1_000_000), stream.readline(1_000_000)]
        if not head[0].strip():
            raise InputError(f"{path} is empty or begins with an empty line; it must begin with names or numbers")
        # Commas beside another separator are decimal points, and NumPy writes a header as a comment.
        mark = next((mark for mark in ";\t" if mark in head[0]), ",")
        lines = chain([head[0].removeprefix("#"), head[1]], stream)
        if mark not in head[0] and len(head[1].split()) > 1:
            lines = (mark.join(line.split()) for line in lines)
        rows = csv.reader(lines, delimiter=mark)
        names = [cell.strip() for cell in next(rows)]
        if all(map(_NUMBER.fullmatch, names)):
            rows = chain([names], rows)
            names = [str(number) for number in range(1, len(names) + 1)]
        yield names
        for row in filter(None, rows):
            yield row if mark == "," else [cell.replace(",", ".") for cell in row]


def _csv(path: Path, columns: Sequence[str], optional: Collection[str]) -> dict[str, list[str | None]]:
    header, *lines = _rows(path)
    places = {name: header.index(name) for name in _present(path, header, columns, optional)}
    for row, line in enumerate(lines, start=1):
        if len(line) != len(header):
            raise ValueError(f"row {row} has {len(line)} cells, the first line {len(header)}")
    return {name: [line[place] for line in lines] for name, place in places.items()}


def _numbers(cells: Sequence[Any] | NDArray[Any], name: str, path: Path) -> Array:
    """Return a column's numbers.

    Markers of missing values become nan, other text is reported by row.
    """
    try:
        return np.array(cells, dtype=float)
    except (TypeError, ValueError):
        return np.array([_number(cell, row, name, path) for row, cell in enumerate(cells, start=1)])


def _number(cell: Any, row: int, name: str, path: Path) -> float:
    text = str(cell).strip()
    try:
        return float("nan") if text.casefold() in _MISSING else float(text)
    except ValueError:
        raise InputError(f"{path}: row {row} of column {name!r} holds {text!r}; it must be a number") from None


_STEP = re.compile(r"\.?([A-Za-z]\w*)|\{(\d+)\}|\((\d+),:\)|\(:,(\d+)\)")
_MOST_SAMPLES = 10**8


def read_matlab(path: Path) -> dict[str, Any]:
    """Return the variables of a MATLAB file by name.

    Args:
        path: file of any version.

    Raises:
        InputError: the file cannot be read, or is not a MATLAB file.
    """
    try:
        with path.open("rb") as stream:
            head = stream.read(600)
        hdf5 = b"MATLAB 7.3" in head[:128] or b"\x89HDF\r\n\x1a\n" in head
        checked_size((_hdf5_size if hdf5 else _unpacked_size)(path))
        if head.startswith(_OCTAVE):
            raise InputError(f"{path} is not a MATLAB file but one of Octave; save it in Octave with `save -v7`")
        variables = _with_objects(path) if hdf5 else _plain(path)
    except UNREADABLE as error:
        raise InputError(
            f"cannot read {path} as a MATLAB file ({_reason(error)}); check the name, or save or copy it again"
        ) from error
    return {name: value for name, value in variables.items() if isinstance(name, str) and not name.startswith("__")}


def _plain(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat, whosmat

    try:
        declared = whosmat(path)
    except TypeError:
        # scipy does not report the shape of objects.
        return _with_objects(path)
    checked_size(sum(8 * math.prod(map(float, shape)) for _, shape, _ in declared))
    variables = loadmat(path)
    return _with_objects(path) if "__function_workspace__" in variables else variables


_OCTAVE = (b"# Created by Octave", b"Octave-1-", b"\x89HDF\r\n\x1a\n")
"""Beginnings of Octave's text, binary and HDF5 files; MATLAB's HDF5 begins with a header of its own."""
_PACKED = 15
"""Type of compressed elements in a version 5 file."""


def _unpacked_size(path: Path) -> int:
    """Return the unpacked size of a version 5 file, bytes.

    The unpacked size is that of the compressed variables, from their headers.
    """
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
    """Return the unpacked size of a version 7.3 file, bytes.

    The size is that of the data sets.
    """
    h5py = package("h5py")
    sizes: list[int] = []
    with h5py.File(path) as file:
        file.visititems(lambda _, item: sizes.append(getattr(item, "nbytes", 0)))
    return sum(sizes)


def _with_objects(path: Path) -> dict[str, Any]:
    # Takes half a second to import, and most files do not need it.
    matio = package("matio")
    try:
        return matio.load_from_mat(str(path), raw_data=True) or {}
    except package("matio.utils.matclass").MatReadError as error:
        raise ValueError(str(error)) from error


def column(variables: dict[str, Any], name: str, *, file: Path) -> Array:
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


def find(variables: dict[str, Any], name: str, *, file: Path) -> Any:
    """Return the object of any kind at `name`.

    Args:
        variables: variables of the file by name.
        name: a variable with optional fields, cells `{i}` and rows `(i,:)`.
        file: the file, for messages.

    Raises:
        InputError: `name` does not exist; reports the first missing part.
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
            members = [str(name) for name in _properties(value) or {} if not str(name).startswith("__")][:12]
            there = f"; {done or 'the file'} holds {', '.join(members) or 'no fields'}"
            raise InputError(f"{file}: there is no {name} ({done + step.group()} is missing{there}); check the mapping")
        value, done = following, done + step.group()
    return value


def numbers(value: Any, name: str, *, file: Path) -> Array:
    """Return one row or column of real numbers as (K,).

    Args:
        value: object of any kind.
        name: its name, for messages.
        file: the file, for messages.

    Raises:
        InputError: the value has another kind or shape, or is empty.
    """
    array = np.asarray(value)
    if array.dtype.kind not in "fiu" or array.size == 0 or max(array.shape, default=1) != array.size:
        raise InputError(
            f"{file}: {name} is {_described(array)}; a column is one row or column of real numbers, as in {name}(1,:) "
            f"(save those of an object as x = {name})"
        )
    return array.reshape(-1).astype(float)


def _properties(value: Any) -> dict[str, Any] | None:
    """Return the fields of a struct or an object, or None."""
    if isinstance(value, np.ndarray) and value.dtype.names and value.size == 1:
        only = value.reshape(-1)[0]
        return {name: only[name] for name in value.dtype.names}
    if isinstance(value, np.ndarray) and value.dtype == object and value.size == 1:
        return _properties(value.reshape(-1)[0])
    inner = getattr(value, "properties", value)
    return inner if isinstance(inner, dict) else None


def _member(value: Any, name: str) -> Any:
    """Return a field, ignoring case.

    In an object it may be stored as `name_` or in one of its parts.
    """
    fields = _properties(value)
    if fields is None:
        return None
    wanted = name.casefold()
    stored = [name, *(field for field in fields if str(field).casefold().rstrip("_") == wanted)]
    held = next((fields[field] for field in stored if field in fields), None)
    if wanted != "time" or (held is not None and np.size(held)):
        return held
    # A time series leaves its times empty where they are even.
    times = _times(_member(value, "TimeInfo"))
    return held if times is None else times


def _times(info: Any) -> Any:
    """Return the times in a time series' metadata.

    They come from a list or from start, increment and length.
    """
    given = _member(info, "Time")
    if given is not None and np.size(given):
        return given
    # MATLAB stores them as Start_, Increment_ and Length, the first two empty or nan for uneven times.
    parts = [np.asarray(_member(info, name)).reshape(-1) for name in ("Start", "Increment", "Length")]
    if any(part.size != 1 or part.dtype.kind not in "fiu" for part in parts):
        return None
    start, increment, length = np.concatenate(parts).astype(float)
    return start + increment * np.arange(int(length)) if 0 < length < _MOST_SAMPLES else None


def _cell(value: Any, index: int) -> Any:
    """Return a cell by its number from 1.

    In an object it is taken from its first cell array of objects.
    """
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
