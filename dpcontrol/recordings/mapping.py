"""What the columns of a recording mean: units, sign, zero, sampling, from a small TOML file.

    angle = sign · unit · value - zero,       rate = sign · unit · value

so that `zero` is what a hanging arm reads, in rad after the sign: 0 where the recording counts from hanging, π where it
counts from upright. Relative encoders are summed from the inner arm outwards. A column is named as the file names it: a
header of a table, or in MATLAB's own notation a variable, a field, a cell or a row (`data{2}.Values.Data`, `Y(1,:)`).
"""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.tables import Table, read_toml, suggest

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
    given: dict[str, list[Any]] = {}
    for key, default in (("sign", 1), ("zero", "hanging")):
        value = rest.get(key, default)
        given[key] = value if isinstance(value, list) else [value]
    for value in given["sign"]:
        if isinstance(value, bool) or value not in (1, -1):
            raise InputError(f"{angles.where('sign')} = {value!r}: must be 1, counter-clockwise, or -1, clockwise")
    zero = []
    for value in given["zero"]:
        number = ZEROS.get(value) if isinstance(value, str) else value
        if number is None or isinstance(number, bool) or not isinstance(number, int | float) or not abs(number) <= 100:
            raise InputError(f"{angles.where('zero')} = {value!r}: must be 'hanging', 'upright' or an angle in rad")
        zero.append(float(number))
    if not given["sign"] or not given["zero"]:
        raise InputError(f"{angles.where()} sign and zero: give one value, or a list of one for each arm")
    relative = rest.get("relative", False)
    if not isinstance(relative, bool):
        raise InputError(f"{angles.where('relative')} = {relative!r}: must be true or false")
    return tuple(float(value) for value in given["sign"]), tuple(zero), relative
