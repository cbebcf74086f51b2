"""Tables for the terminal, and texts of numbers in them."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple


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
