"""Mappings: TOML files for the columns of a recording, with their units, sign, zero and sampling.

    angle = sign · (unit · value - zero),       rate = sign · unit · value

The `zero` is what a hanging arm reads, in rad, whatever the sign: 0 if the recording counts from hanging, π if it
counts from upright. Relative encoders are summed from the inner arm outwards. Columns have the names of the file: a
table header, or in MATLAB notation a variable, a field, a cell or a row (`data{2}.Values.Data`, `Y(1,:)`). The columns
of a table without a header have their numbers, from 1.
"""

from collections import Counter
from collections.abc import Collection
from dataclasses import MISSING, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import Leaf, Setting, Settings, check_choice
from dpcontrol.foundation.shipped import MAPPINGS, mappings
from dpcontrol.foundation.toml import Place, Table, read_toml, table_of

ANGLE_UNITS = {"rad": 1.0, "deg": np.pi / 180, "turns": 2 * np.pi, "counts": 0.0}
RATE_UNITS = {"rad/s": 1.0, "deg/s": np.pi / 180, "turns/s": 2 * np.pi, "rpm": np.pi / 30, "counts/s": 0.0}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
ZEROS = {"hanging": 0.0, "upright": np.pi}
NAMED = BeforeValidator(lambda value: str(value) if type(value) is int else value)
"""Conversion of a column's number, in a table without a header, to its name."""


def _listed(value: Any) -> tuple[Any, ...]:
    """Return one value for all arms, or one for each, as a tuple of numbers; names of `ZEROS` become their numbers.

    `value` is an entry of a TOML file: a number, a name, or a list of them.
    """
    values = value if isinstance(value, list | tuple) else [value]
    return tuple(ZEROS.get(entry, entry) if isinstance(entry, str) else entry for entry in values)


LISTED = BeforeValidator(_listed)


@dataclass(frozen=True)
class _Time(Settings, table="time"):
    """The times of the samples, and their segments."""

    column: Annotated[str, NAMED, Setting(help="Column of the times.")] = ""
    segment: Annotated[str, NAMED, Setting(help="Column that numbers the segments; a change begins a segment.")] = ""
    unit: Annotated[str, Setting(choices=tuple(TIME_UNITS), help="Unit of the times.")] = "s"


@dataclass(frozen=True)
class _Sampling(Settings, table="sampling"):
    """The time between samples."""

    period: Annotated[float | None, Setting(least=1e-6, most=1, unit="s", help="Time between samples.")] = None
    rate: Annotated[float | None, Setting(least=1, most=1e6, unit="Hz", help="Samples per second.")] = None
    variable: Annotated[str, Setting(help="Variable of a MATLAB file that holds the period.")] = ""


@dataclass(frozen=True)
class _Cells(Settings, table="cells"):
    """Cell arrays of a MATLAB file, which replace all columns."""

    states: Annotated[tuple[str, ...], Setting(help="Cell arrays with rows of all angles, then of all rates.")] = ()
    time: Annotated[tuple[str, ...], Setting(help="Cell arrays with the times of `states`.")] = ()


@dataclass(frozen=True)
class _Angles(Settings, table="angles"):
    """The angles, inner arm first, as lists with one value for all arms or one for each."""

    columns: Annotated[tuple[Annotated[str, NAMED], ...], Setting(help="Columns of the angles.")] = ()
    unit: Annotated[str, Setting(choices=tuple(ANGLE_UNITS), help="Unit of the angles.")] = "rad"
    counts_per_turn: Annotated[tuple[int, ...], LISTED, Setting(least=1, help="Counts of an encoder in a turn.")] = ()
    sign: Annotated[tuple[float, ...], LISTED, Setting(help="1 for counter-clockwise, -1 for clockwise.")] = (1.0,)
    zero: Annotated[
        tuple[float, ...],
        LISTED,
        Setting(least=-100, most=100, unit="rad", help='Readings of hanging arms; "hanging" for 0, "upright" for π.'),
    ] = (0.0,)
    relative: Annotated[bool, Setting(help="Whether each angle counts from the next inner arm.")] = False

    @property
    def by_arm(self) -> dict[str, tuple[float, ...]]:
        """Values for all arms, or one for each, by their key in the file."""
        return {"counts_per_turn": self.counts_per_turn or (1,), "sign": self.sign, "zero": self.zero}


@dataclass(frozen=True)
class _Rates(Settings, table="rates"):
    """The rates, inner arm first."""

    columns: Annotated[tuple[Annotated[str, NAMED], ...], Setting(help="Columns of the rates.")] = ()
    unit: Annotated[str, Setting(choices=tuple(RATE_UNITS), help="Unit of the rates.")] = "rad/s"


@dataclass(frozen=True)
class _Cart(Settings, table="cart"):
    """The cart and its command."""

    position: Annotated[str, NAMED, Setting(help="Column of the cart's position.")] = ""
    unit: Annotated[str, Setting(choices=tuple(LENGTH_UNITS), help="Unit of the position.")] = "m"
    command: Annotated[str, NAMED, Setting(help="Column of the commanded acceleration, m/s².")] = ""


_TABLES = {"time": _Time, "sampling": _Sampling, "cells": _Cells, "angles": _Angles, "rates": _Rates, "cart": _Cart}


_LENGTHS = Setting(above=0, most=100, unit="m", help="Lengths of the arms, for pictures.")
_FILE = Table(
    {
        "arm_lengths": Leaf("arm_lengths", Annotated[tuple[float, ...], _LENGTHS], MISSING),
        "title": Leaf("title", Annotated[str, Setting(help="What the mapping reads.")], ""),
        **{name: table_of(table) for name, table in _TABLES.items()},
    }
)


@dataclass(frozen=True)
class Mapping:
    """Rules for reading a recording: the tables of the mapping's file.

    Attributes:
        name: name of the file without its ending.
        arm_lengths: lengths of the arms, m, with which logs and pictures show them; the last one counts for further
            arms.
        time: column and unit of the times.
        sampling: time between samples.
        cells: cell arrays of a MATLAB file.
        angles: columns, unit, sign and zero of the angles.
        rates: columns and unit of the rates.
        cart: columns of the cart and its command.
    """

    name: str
    arm_lengths: tuple[float, ...]
    time: _Time
    sampling: _Sampling
    cells: _Cells
    angles: _Angles
    rates: _Rates
    cart: _Cart

    @property
    def named(self) -> tuple[str, ...]:
        """Names of all columns to read from a file."""
        single = (self.time.column, self.time.segment, self.cart.position, self.cart.command)
        return (*self.angles.columns, *self.rates.columns, *filter(None, single))

    @property
    def period(self) -> float:
        """Time between samples, s; 0 if not given."""
        return self.sampling.period or (1 / self.sampling.rate if self.sampling.rate else 0.0)

    def restricted(self, columns: Collection[str]) -> "Mapping":
        """Return the mapping without the angles, the rates and the cart's position that a file lacks.

        Args:
            columns: names of the file's columns.
        """
        angles, rates = (
            replace(table, columns=tuple(name for name in table.columns if name in columns))
            for table in (self.angles, self.rates)
        )
        cart = self.cart if self.cart.position in columns else replace(self.cart, position="")
        return replace(self, angles=angles, rates=rates, cart=cart)

    def absolute(self, values: Array, unit: float, zeros: tuple[float, ...] = (0.0,)) -> Array:
        """Return absolute angles or rates (K, n), rad or rad/s, counted from hanging, counter-clockwise.

        Args:
            values: values (K, n) in the file's unit and directions.
            unit: size of the file's unit, 0 for counts.
            zeros: readings of hanging arms, rad.
        """
        scale = unit or 2 * np.pi / np.array(self.angles.counts_per_turn)
        directed = (values * scale - np.array(zeros)) * np.array(self.angles.sign)
        return np.cumsum(directed, axis=1) if self.angles.relative else directed


def load_mapping(name: str) -> Mapping:
    """Return the mapping in a TOML file.

    Args:
        name: path of the file, or name of a shipped mapping.

    Raises:
        InputError: the mapping is missing, or its file has a mistake; reports file, table, key, value and range.
    """
    path = Path(name)
    if path.suffix != ".toml":
        check_choice("mapping", mappings(), name)
        path = MAPPINGS / f"{name}.toml"
    top = Place(str(path))
    tables = _FILE.read(read_toml(path)[0], top)
    tables.pop("title", None)
    mapping = Mapping(path.stem, **{name: kind() for name, kind in _TABLES.items()} | tables)
    for complaint, wrong in _rules(mapping).items():
        if wrong:
            raise InputError(f"{top} {complaint}")
    return mapping


def _rules(mapping: Mapping) -> dict[str, bool]:
    """Return the rules by which a mapping's tables fit together: each complaint, with True if its rule is broken."""
    columns, rates, cells = mapping.angles.columns, mapping.rates.columns, mapping.cells
    repeated = [name for name, uses in Counter(mapping.named).items() if uses > 1]
    time_sources = (mapping.time.column, cells.time, mapping.period, mapping.sampling.variable)
    unequal = [
        key for key, values in mapping.angles.by_arm.items() if len(values) not in (1, len(columns) or len(values))
    ]
    in_counts = "counts" in (mapping.angles.unit, *mapping.rates.unit.split("/"))
    return {
        "[angles] columns = []: name one column for each arm, inner arm first": not cells.states and not columns,
        "[cells] states: rows of cells replace all columns of a recording; name no others": bool(cells.states)
        and bool(columns or rates or mapping.cart.position or mapping.cart.command),
        "arm_lengths = []: give the length of each arm, m": not mapping.arm_lengths,
        "[angles] sign: must be 1, counter-clockwise, or -1, clockwise": any(
            abs(sign) != 1 for sign in mapping.angles.sign
        ),
        f"[angles] {', '.join(unequal)}: give one value, or one for each of {len(columns)} angles": bool(unequal),
        f"[cells] time = {list(cells.time)}: give one name for each of `states`, or none": len(cells.time)
        not in (0, len(cells.states)),
        f"[rates] columns: {len(rates)} rates for {len(columns)} angles; give as many": len(rates)
        not in (0, len(columns)),
        f"[angles] columns: {repeated} is named twice; a column has one meaning": bool(repeated),
        "neither [time] column nor [sampling] period is given; give one of them": not any(time_sources),
        "[angles] a unit is counts but counts_per_turn is missing; add it": in_counts
        and not mapping.angles.counts_per_turn,
    }
