"""Read a bench's file as a recording: columns by the mapping, checks, repairs where asked, segments.

A MATLAB file of cells has one segment per cell; a table or a whole MATLAB recording is one segment, unless a repair
cuts it. Where the segments' times do not follow one another they are laid end to end, and a note says so.

What the columns of a recording mean: units, sign, zero, sampling, from a small TOML file.

    angle = sign · unit · value - zero,       rate = sign · unit · value

so that `zero` is what a hanging arm reads, in rad after the sign: 0 where the recording counts from hanging, π where it
counts from upright. Relative encoders are summed from the inner arm outwards. A column is named as the file names it: a
header of a table, or in MATLAB's own notation a variable, a field, a cell or a row (`data{2}.Values.Data`, `Y(1,:)`).
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import checked_source
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.foundation.settings import Table, read_toml, suggest
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
from dpcontrol.recordings.formats import column, find, numbers, read_matlab, read_table, table_columns
from dpcontrol.recordings.recording import Recording

Array = NDArray[np.float64]

SHIPPED = Path(__file__).parent / "mappings"

ANGLE_UNITS = {"rad": 1.0, "deg": np.pi / 180, "turns": 2 * np.pi, "counts": 0.0}
RATE_UNITS = {"rad/s": 1.0, "deg/s": np.pi / 180, "turns/s": 2 * np.pi, "rpm": np.pi / 30, "counts/s": 0.0}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
ZEROS = {"hanging": 0.0, "upright": np.pi}
_DIRECTION = ("sign", "zero", "relative")


@dataclass(frozen=True)
class Mapping:
    """How a recording is read; all lists inner arm first, one value for all arms or one for each.

    angle_columns: empty where `state_cells` name cell arrays whose rows are all angles, then all rates. time_column ""
    and period 0 s: not given; period_variable: the variable that holds the period. angle_scale rad and rate_scale
    rad/s: one unit of the file; sign ±1; zero rad; relative: outer angles count from the arm before. cart_column in
    units of cart_scale m; command_column in m/s². arm_lengths m.
    """

    name: str
    title: str
    arm_lengths: tuple[float, ...]
    angle_columns: tuple[str, ...] = ()
    rate_columns: tuple[str, ...] = ()
    time_column: str = ""
    time_scale: float = 1.0
    period: float = 0.0
    period_variable: str = ""
    state_cells: tuple[str, ...] = ()
    time_cells: tuple[str, ...] = ()
    angle_scale: float = 1.0
    rate_scale: float = 1.0
    sign: tuple[float, ...] = (1.0,)
    zero: tuple[float, ...] = (0.0,)
    relative: bool = False
    cart_column: str = ""
    cart_scale: float = 1.0
    command_column: str = ""

    @property
    def named(self) -> tuple[str, ...]:
        """Names of all columns that are read."""
        single = (self.time_column, self.cart_column, self.command_column)
        return (*self.angle_columns, *self.rate_columns, *filter(None, single))

    def angles(self, values: Array) -> Array:
        """Return absolute angles (K, n) from hanging, counter-clockwise, of what the file holds (K, n)."""
        n = values.shape[1]
        angles = values * self.angle_scale * _each(self.sign, n) - _each(self.zero, n)
        return np.cumsum(angles, axis=1) if self.relative else angles

    def rates(self, values: Array) -> Array:
        """Return absolute rates (K, n) rad/s of what the file holds (K, n)."""
        rates = values * self.rate_scale * _each(self.sign, values.shape[1])
        return np.cumsum(rates, axis=1) if self.relative else rates

    def lengths(self, arms: int) -> tuple[float, ...]:
        """Return a length for each of `arms` arms; where the mapping gives fewer, the last again."""
        given = self.arm_lengths[:arms]
        return given + (self.arm_lengths[-1],) * (arms - len(given))


def _each(values: tuple[float, ...], arms: int) -> Array:
    return np.full(arms, values[0]) if len(values) == 1 else np.array(values[:arms])


def load_mapping(name: str) -> Mapping:
    """Return the mapping in a TOML file, given by path, or shipped under this name.

    Raises:
        InputError: no such mapping, or a mistake in its file: names file, table, key, value and what is allowed.
    """
    path = Path(name)
    if path.suffix != ".toml":
        path = SHIPPED / f"{name}.toml"
        known = sorted(file.stem for file in SHIPPED.glob("*.toml"))
        if name not in known:
            raise InputError(
                f"there is no mapping named {name!r}; {suggest(name, known)}; the path of a TOML file works"
            )
    table, _ = read_toml(path)
    return _mapping(table, path.stem)


def _mapping(table: Table, name: str) -> Mapping:
    cells, sampling, time = table.table("cells"), table.table("sampling"), table.table("time")
    angles, rates, cart = table.table("angles", required=True), table.table("rates"), table.table("cart")
    state_cells = cells.texts("states", ())
    columns = angles.texts("columns", ()) if state_cells else angles.texts("columns")
    count = 2 * np.pi / angles.integer("counts_per_turn", least=1) if "counts_per_turn" in angles else 0.0
    angle_unit = angles.text("unit", "rad", allowed=ANGLE_UNITS)
    rate_unit = rates.text("unit", "rad/s", allowed=RATE_UNITS)
    sign, zero, relative = _direction(angles)
    found = Mapping(
        name=name,
        title=table.text("title", name),
        arm_lengths=table.numbers("arm_lengths"),
        angle_columns=columns,
        rate_columns=rates.texts("columns", ()),
        time_column=time.text("column", ""),
        time_scale=TIME_UNITS[time.text("unit", "s", allowed=TIME_UNITS)],
        period=_period(sampling),
        period_variable=sampling.text("variable", ""),
        state_cells=state_cells,
        time_cells=cells.texts("time", ()),
        angle_scale=ANGLE_UNITS[angle_unit] or count,
        rate_scale=RATE_UNITS[rate_unit] or count,
        sign=sign,
        zero=zero,
        relative=relative,
        cart_column=cart.text("position", ""),
        cart_scale=LENGTH_UNITS[cart.text("unit", "m", allowed=LENGTH_UNITS)],
        command_column=cart.text("command", ""),
    )
    for part in (table, cells, sampling, time, angles, rates, cart):
        part.finish()
    lengths, time_cells = found.arm_lengths, found.time_cells
    if not lengths or any(not 0 < length <= 100 for length in lengths):
        raise InputError(f"{table.where('arm_lengths')} = {list(lengths)}: must be lengths in metres, 0 to 100")
    if not state_cells and not columns:
        raise InputError(f"{angles.where('columns')} = []: name one column for each arm, inner arm first")
    if state_cells and (columns or found.rate_columns or found.cart_column or found.command_column):
        raise InputError(f"{cells.where('states')}: rows of cells are all a recording's columns; name no others")
    if len(time_cells) not in (0, len(state_cells)):
        raise InputError(f"{cells.where('time')} = {list(time_cells)}: give one name for each of `states`, or none")
    if found.rate_columns and len(found.rate_columns) != len(columns):
        raise InputError(
            f"{rates.where('columns')}: {len(found.rate_columns)} rates for {len(columns)} angles; give as many"
        )
    for name, times in Counter(found.named).items():
        if times > 1:
            raise InputError(f"{angles.where('columns')}: {name!r} is named twice; a column has one meaning")
    if not (found.time_column or time_cells or found.period or found.period_variable):
        raise InputError(f"{table.file}: neither [time] column nor [sampling] period is given; give one of them")
    if "counts" in (angle_unit, rate_unit.partition("/")[0]) and not count:
        raise InputError(
            f"{angles.where()} the unit is counts but counts_per_turn is missing; say how many make a turn"
        )
    for key, values in (("sign", sign), ("zero", zero)):
        if columns and len(values) not in (1, len(columns)):
            raise InputError(
                f"{angles.where(key)}: {len(values)} values for {len(columns)} angles; give one or as many"
            )
    return found


def _period(sampling: Table) -> float:
    """Return the sampling period in s, 0 where it is not given as a number."""
    period, rate = sampling.number("period", 0.0), sampling.number("rate", 0.0)
    if "period" in sampling and not 1e-6 <= period <= 1:
        raise InputError(f"{sampling.where('period')} = {period!r}: must be 1e-6 to 1 seconds")
    if "rate" in sampling and not 1 <= rate <= 1e6:
        raise InputError(f"{sampling.where('rate')} = {rate!r}: must be 1 to 1e6 samples per second")
    return period or (1 / rate if rate else 0.0)


def _direction(angles: Table) -> tuple[tuple[float, ...], tuple[float, ...], bool]:
    """Return sign, zero in rad and whether outer angles are relative: what [angles] says in one value or a list."""
    rest = angles.remaining()
    for key in rest:
        if key not in _DIRECTION:
            known = [*_DIRECTION, "columns", "unit", "counts_per_turn"]
            raise InputError(f"{angles.where()} the key {key!r} is unknown: {suggest(key, known)}")
    sign, zero = (
        value if isinstance(value := rest.get(key, default), list) else [value]
        for key, default in (("sign", 1), ("zero", "hanging"))
    )
    for value in sign:
        if isinstance(value, bool) or value not in (1, -1):
            raise InputError(f"{angles.where('sign')} = {value!r}: must be 1, counter-clockwise, or -1, clockwise")
    shown: list[Any] = [ZEROS.get(value) if isinstance(value, str) else value for value in zero]
    for value, number in zip(zero, shown, strict=True):
        if isinstance(number, bool) or not isinstance(number, int | float) or not abs(number) <= 100:
            raise InputError(f"{angles.where('zero')} = {value!r}: must be 'hanging', 'upright' or an angle in rad")
    if not sign or not zero:
        raise InputError(f"{angles.where()} sign and zero: give one value, or a list of one for each arm")
    relative = rest.get("relative", False)
    if not isinstance(relative, bool):
        raise InputError(f"{angles.where('relative')} = {relative!r}: must be true or false")
    return tuple(map(float, sign)), tuple(map(float, shown)), relative


MATLAB, TABLES = (".mat",), (".csv", ".tsv", ".txt", ".parquet")
MOST_ARMS = 6
_KNOWN = (
    "multi-arm", "multi-arm-triple-cart", "multi-arm-triple", "multi-arm-double-cart", "multi-arm-double",
    "multi-arm-single-cart", "multi-arm-single",
    "multi-arm-raw-triple", "multi-arm-raw", "multi-arm-raw-single",
)  # fmt: skip
"""Mappings of MATLAB files, recognised by their variables: those that need more come before those that need less."""


def import_recording(
    path: Path | str,
    mapping: str | None = None,
    *,
    repairs: Sequence[str] = (),
    progress: Progress = no_progress,
) -> Recording:
    """Return what a file of the bench recorded.

    Args:
        path: a MATLAB (.mat), CSV (.csv, .tsv, .txt) or Parquet (.parquet) file.
        mapping: name or path of a mapping; by default the one of the MultiArm-Pendulum data set's kinds whose columns
            a MATLAB file holds, and `table` for others.
        repairs: names of repairs that may be made.
        progress: called with how far it is.

    Raises:
        InputError: the file or the mapping cannot be used; one sentence with file, row, value and remedy.
    """
    path = Path(path)
    allowed = checked_repairs(tuple(repairs))
    kind = path.suffix.lower()
    if kind not in MATLAB + TABLES:
        known = ", ".join(MATLAB + TABLES)
        raise InputError(f"{path}: a recording is a file of kind {known}; this ends in {kind or 'nothing'}")
    checked_source(path)
    given = load_mapping(mapping) if mapping else None
    progress("reading", 0.0)
    if kind in MATLAB:
        variables = read_matlab(path)
        chosen = given or _fitting(variables, path)
        stretches, period = _matlab(path, chosen, variables)
    else:
        chosen = given or _with_rates_that_are_there(load_mapping("table"), path)
        stretches, period = _table(path, chosen), chosen.period
    progress("checking", 0.5)
    return _recording(path, chosen, stretches, period=period, repairs=allowed)


def _fitting(variables: dict[str, Any], path: Path) -> Mapping:
    """Return the first known mapping whose columns are all there; where none is, the first."""
    for name in _KNOWN:
        mapping = load_mapping(name)
        wanted = (*mapping.state_cells[:1], *mapping.angle_columns, *mapping.rate_columns, mapping.cart_column)
        try:
            for column_name in filter(None, wanted):
                find(variables, column_name, file=path)
        except InputError:
            continue
        return mapping
    return load_mapping(_KNOWN[0])


def _with_rates_that_are_there(mapping: Mapping, path: Path) -> Mapping:
    """Return the mapping as it is, or without its rates where a table has none of their columns."""
    there = table_columns(path)
    return mapping if any(name in there for name in mapping.rate_columns) else replace(mapping, rate_columns=())


def _table(path: Path, mapping: Mapping) -> list[Samples]:
    if mapping.state_cells:
        raise InputError(f"{path}: the mapping {mapping.name!r} is for MATLAB cells; give one with columns: --mapping")
    if mapping.period_variable:
        raise InputError(f"{path}: a table holds no variable {mapping.period_variable!r}; give [sampling] period")
    return [_of_columns(path, mapping, read_table(path, mapping.named), mapping.period)]


def _of_columns(path: Path, mapping: Mapping, columns: dict[str, Array], period: float) -> Samples:
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        said = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise InputError(f"{path}: the columns differ in length ({said}); a row needs a value of each")

    groups = {
        ANGLE: mapping.angle_columns, RATE: mapping.rate_columns, CART: (mapping.cart_column,),
        COMMAND: (mapping.command_column,),
    }  # fmt: skip
    found = {kind: np.column_stack([columns[name] for name in names]) for kind, names in groups.items() if any(names)}
    return _samples(path, str(path), mapping, found, columns.get(mapping.time_column), period)


def _samples(
    path: Path, where: str, mapping: Mapping, found: dict[str, Array], time: Array | None, period: float
) -> Samples:
    """Return what stands together in a file, in SI units and our directions.

    found: columns (K, …) by kind, the angles first; time (K,) in the file's unit, or None where there is a period.
    """
    count, arms = found[ANGLE].shape
    if arms > MOST_ARMS:
        raise InputError(f"{path}: {arms} angles; a recording has 1 to {MOST_ARMS} arms")
    for key, given in (("sign", mapping.sign), ("zero", mapping.zero)):
        if len(given) not in (1, arms):
            raise InputError(
                f"{path}: the mapping's {key} has {len(given)} values for {arms} arms; give one or as many"
            )
    names: list[str] = []
    for kind in found:
        names += [f"{kind} {i + 1}" for i in range(arms)] if kind in (ANGLE, RATE) else [kind]
    read = {ANGLE: mapping.angles, RATE: mapping.rates, CART: lambda cart: cart * mapping.cart_scale}
    return Samples(
        where=where,
        rows=np.arange(1, count + 1),
        time=np.arange(count) * period if time is None else time * mapping.time_scale,
        values=np.column_stack([read[kind](values) if kind in read else values for kind, values in found.items()]),
        names=tuple(names),
    )


def _matlab(path: Path, mapping: Mapping, variables: dict[str, Any]) -> tuple[list[Samples], float]:
    period = mapping.period
    if mapping.period_variable:
        given = numbers(find(variables, mapping.period_variable, file=path), mapping.period_variable, file=path)
        period = float(given[0]) * mapping.time_scale
        if given.size != 1 or not 1e-6 <= period <= 1:
            shown = f"{given[0]:.6g}" if given.size == 1 else f"{given.size} numbers"
            raise InputError(f"{path}: {mapping.period_variable} is {shown}; a sampling period is 1e-6 to 1 s")
    if not mapping.state_cells:
        found = {name: column(variables, name, file=path) for name in mapping.named}
        return [_of_columns(path, mapping, found, period)], period
    stretches: list[Samples] = []
    for k, name in enumerate(mapping.state_cells):
        # Only the first is in every file: a data set may keep nothing back for validation.
        if k and name not in variables:
            continue
        times = mapping.time_cells[k] if mapping.time_cells else ""
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
        if values.dtype.kind not in "fiu" or values.ndim != 2 or values.size == 0:
            what = "empty" if values.size == 0 else f"of kind {values.dtype}, {' x '.join(map(str, values.shape))}"
            raise InputError(f"{path}: {label} is {what}; a cell holds rows of angles, then of rates, as numbers")
        rows, length = values.shape
        if rows % 2 or not 2 <= rows <= 2 * MOST_ARMS:
            hint = "; transpose it" if length % 2 == 0 and length <= 2 * MOST_ARMS else ""
            raise InputError(
                f"{path}: {label} is {rows} x {length}; it must have an even number of rows, angles then rates, of at "
                f"most {MOST_ARMS} arms, and a column for each sample{hint}"
            )
        when = None if time is None else numbers(time, f"{times}{{{number}}}", file=path)
        if when is not None and len(when) != length:
            raise InputError(f"{path}: {label} has {length} samples and {times}{{{number}}} {len(when)}; give as many")
        angles, rates = np.hsplit(values.T.astype(float), 2)
        stretches.append(_samples(path, f"{path}: {label}", mapping, {ANGLE: angles, RATE: rates}, when, period))
    return stretches


def _cell_list(path: Path, variables: dict[str, Any], name: str) -> list[Any]:
    value = find(variables, name, file=path)
    if not isinstance(value, np.ndarray) or value.dtype != object or value.size == 0:
        shape = " x ".join(map(str, np.shape(value)))
        kind = getattr(value, "dtype", type(value).__name__)
        raise InputError(
            f"{path}: {name} is not a cell array with cells in it (it is {shape}, {kind}); "
            "give a mapping that names this file's columns: --mapping"
        )
    return list(value.reshape(-1, order="F"))


def _recording(
    path: Path, mapping: Mapping, stretches: list[Samples], *, period: float, repairs: frozenset[str]
) -> Recording:
    parts: list[Samples] = []
    notes: list[str] = []
    for stretch in stretches:
        found, said = sound_segments(stretch, period=period, repairs=repairs)
        parts += found
        notes += said
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
    """Return the segments with times that follow one another, moved where they do not, and what was moved."""
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
