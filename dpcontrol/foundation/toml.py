"""TOML files: reading, tables checked against declared settings, and edits.

Each mistake in a file is one sentence with file, table, key, value and allowed range.
"""

import json
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any, TypeVar

from dpcontrol.foundation.errors import InputError, Mistakes, shortened
from dpcontrol.foundation.settings import Leaf, leaves_of, nearest, suggest

T = TypeVar("T")


def read_toml(path: Path) -> tuple[dict[str, Any], str]:
    """Return the contents of a TOML file, and its text.

    Args:
        path: UTF-8 file, with or without a byte-order mark.

    Raises:
        InputError: the file cannot be read, is not text, or is not TOML, with the line.
    """
    try:
        # Editors on Windows begin a file with a mark that is not part of its text.
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}; check the name") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not a text file; give a TOML file") from error
    return parse_toml(text, str(path)), text


_DEEPEST = 20
"""Levels of tables and lists in a file; our own have four."""


def parse_toml(text: str, file: str) -> dict[str, Any]:
    """Return the contents of TOML text.

    Args:
        text: the text.
        file: its name in messages.

    Raises:
        InputError: the text is not TOML, with the line.
    """
    try:
        document = tomllib.loads(text)
        # Dotted keys nest without recursion of the parser.
        level: list[Any] = [document]
        for _ in range(_DEEPEST):
            level = [one for part in level for one in (part.values() if isinstance(part, dict) else part)]
            level = [one for one in level if isinstance(one, dict | list)]
        if level:
            raise RecursionError
        return document
    except tomllib.TOMLDecodeError as error:
        # Before Python 3.14, the error has its line in the text only, or is at the end of the document.
        place = re.search(r"\(at line (\d+),", str(error))
        line = int(place[1]) if place else text.count("\n") + 1
        raise InputError(f" is not valid TOML: {error}", where=file, line=line) from error
    except (RecursionError, ValueError) as error:
        raise InputError(f"{file} is not usable TOML: nested too deeply, or a number of too many digits") from error


def with_values(text: str, table: str, values: Mapping[str, Any], *, file: str) -> str:
    """Return TOML text with keys of one table set.

    Comments, order, spacing and line ends are kept. New keys follow the table's last key, and a new table follows the
    text.

    Args:
        text: valid TOML.
        table: name of the table; "" for the top level.
        values: texts, numbers or lists of these, by key.
        file: its name in messages.

    Raises:
        InputError: the text cannot be changed; the message has the lines to write by hand.
    """
    import tomlkit

    before = tomllib.loads(text)
    wanted = {**before, table: {**before.get(table, {}), **values}} if table else {**before, **values}
    document = tomlkit.parse(text)
    if table and table not in document:
        document[table] = tomlkit.table()
    edited: Any = document[table] if table else document
    for key, value in values.items():
        edited[key] = _listed(value) if isinstance(value, list | tuple) else tomlkit.item(value)
    out = tomlkit.dumps(document)
    out = out.replace("\r\n", "\n").replace("\n", "\r\n") if "\r\n" in text else out
    if _as_text(tomllib.loads(out)) != _as_text(wanted):
        shown = ", ".join(f"{key} = {value!r}" for key, value in values.items())
        where = f"its [{table}]" if table else "it"
        raise InputError(f"{file}: {where} could not be changed; write there {shown}")
    return out


def _listed(values: Sequence[Any]) -> Any:
    """Return the item of a list, in which each text has a line."""
    import tomlkit

    # tomlkit parses a list in linear time, but appends to one in quadratic time.
    texts = [tomlkit.item(one).as_string() for one in values]
    lines = len(values) > 1 and all(isinstance(one, str) for one in values)
    inside = "".join(f"\n    {text}," for text in texts) + "\n" if lines else ", ".join(texts)
    return tomlkit.value(f"[{inside}]")


def _as_text(values: Mapping[str, Any]) -> str:
    """Return values as text, because NaN is not equal to itself."""
    return json.dumps(values, default=str, sort_keys=True)


@dataclass(frozen=True)
class Place:
    """The place of a table in a file, for messages.

    Tables of a list are numbered from 1.
    """

    file: str
    table: str = ""
    number: int = 0

    def __str__(self) -> str:
        table = f"[[{self.table}]] {self.number}," if self.number else f"[{self.table}]"
        return f"{self.file}:{f' {table}' if self.table else ''}"

    def error(self, key: str, value: Any, complaint: str) -> InputError:
        """Return the error of a key's value.

        Args:
            key: key of the table.
            value: its value.
            complaint: what is wrong, such as "must be positive".
        """
        return self.refusal(f"{key} = {shortened(value)}: {complaint}", key)

    def refusal(self, sentence: str, key: str = "") -> InputError:
        """Return an error at this place.

        Args:
            sentence: what is wrong.
            key: key of the table.
        """
        return InputError(sentence, where=f"{self} ", table=self.table, key=key)


def table_values(
    leaves: Mapping[str, Leaf], values: Mapping[str, Any], place: Place, *, also: Iterable[str] = ()
) -> dict[str, Any]:
    """Return the values of a table as its settings take them.

    Args:
        leaves: settings of the table by key.
        values: values by key.
        place: for messages.
        also: further keys of the file, for suggestions.

    Raises:
        InputError: every unknown or missing key, and every value of another type or out of bounds.
    """
    read, mistakes, unknown = dict[str, Any](), Mistakes(), [key for key in values if key not in leaves]
    misspelt = {nearest(key, leaves) for key in unknown}
    for key, value in values.items():
        with mistakes:
            if key in unknown:
                top = "" if place.table else "at the top level, "
                known = sorted({*leaves, *also})
                raise InputError(f"{top}the key {shortened(key)} is unknown: {suggest(key, known)}", key=key)
            read[key] = leaves[key].read(value)
    for key, leaf in leaves.items():
        with mistakes:
            if leaf.default is MISSING and key not in values and key not in misspelt:
                raise InputError(f"the key {key!r} is missing", key=key)
    try:
        mistakes.report()
    except InputError as error:
        raise error.under(f"{place} ", table=place.table) from error
    return read


def decode(kind: type[T], values: Mapping[str, Any], place: Place, *, also: Iterable[str] = ()) -> T:
    """Return settings of a dataclass from a table.

    Args:
        kind: dataclass derived from `Settings`.
        values: values by key, where lists become tuples.
        place: for messages.
        also: further keys of the file, for suggestions.

    Raises:
        InputError: every unknown or missing key, and every value of another type or out of bounds.
    """
    read = table_values(leaves_of(kind), values, place, also=also)
    try:
        return kind(**read)
    except InputError as error:
        raise error.under(f"{place} ", table=place.table) from error
