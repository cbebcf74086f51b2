"""Tables for the terminal, and texts of numbers in them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple


class TextTable(NamedTuple):
    """A table whose first column is aligned left and whose other columns are aligned right."""

    title: str
    columns: Sequence[str]
    rows: Iterable[Sequence[str]]


class Markdown(NamedTuple):
    """A page in Markdown."""

    text: str


Line = str | TextTable | Markdown
"""A part of a result's text."""


def table(title: str, items: Iterable[Any], columns: Mapping[str, str | Callable[[Any], str]]) -> TextTable:
    """Return a table with a row for each item.

    Args:
        title: title above the table.
        items: objects, one for each row.
        columns: heading -> format or function of the item.
    """
    rows = [[show.format(row) if isinstance(show, str) else show(row) for show in columns.values()] for row in items]
    return TextTable(title, tuple(columns), rows)


def spaced(values: Iterable[float], form: str) -> str:
    """Return numbers side by side.

    Args:
        values: numbers.
        form: format of each number.
    """
    return "  ".join(format(value, form) for value in values)


def multiplier_text(value: complex, digits: int = 11) -> str:
    """Return a Floquet multiplier as text, real if possible; the pair at one has some twelve digits.

    Args:
        value: the multiplier.
        digits: number of significant digits.
    """
    value = complex(value)
    if abs(value.imag) < 1e-12:
        return f"{value.real:.{digits}g}"
    return f"{value.real:.{min(digits, 10)}g}{value.imag:+.{min(digits, 10)}g}i"


def multiplier_texts(values: Iterable[complex], digits: int = 11) -> str:
    """Return Floquet multipliers side by side.

    Args:
        values: multipliers.
        digits: significant digits of each.
    """
    return "  ".join(multiplier_text(value, digits) for value in values)


def extended_text(state: Sequence[str], indent: str) -> list[str]:
    """Return the lines of a state in decimal digits, positions before rates.

    Args:
        state: decimals (N,).
        indent: blanks before each line.
    """
    half = len(state) // 2
    return [f"{indent}{'position' if k < half else 'rate'} {k % half + 1}  {value}" for k, value in enumerate(state)]


def drawn_to(file: Path | str | None) -> list[str]:
    """Return the line that names a picture or a film, if there is one.

    Args:
        file: file of the picture or film, or None.
    """
    return [] if file is None else [f"drawn to {file}"]
