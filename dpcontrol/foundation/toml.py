"""TOML files: reading, tables checked against declared settings, and edits.

Each mistake in a file is one sentence with file, table, key, value and allowed range.
"""

import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar

from dpcontrol.foundation.errors import InputError, Mistakes, shortened
from dpcontrol.foundation.parts import Later
from dpcontrol.foundation.settings import Leaf, Setting, check_choice, leaves_of, nearest, suggest

tomlkit = Later("tomlkit")


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


def parse_toml(text: str, file: str) -> dict[str, Any]:
    """Return the contents of TOML text.

    Args:
        text: the text.
        file: its name in messages.

    Raises:
        InputError: the text is not TOML, with the line.
    """
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        # Before Python 3.14, the error has its line in the text only, or is at the end of the document.
        place = re.search(r"\(at line (\d+),", str(error))
        line = int(place[1]) if place else text.count("\n") + 1
        raise InputError(f" is not valid TOML: {error}", where=file, line=line) from error
    except (RecursionError, ValueError) as error:
        raise InputError(f"{file} is not usable TOML: nested too deeply, or a number of too many digits") from error


def with_values(text: str, table: str, values: Mapping[str, Any], *, number: int = 0) -> str:
    """Return TOML text with keys of one table set.

    Comments, order, spacing and line ends are kept. New keys follow the table's last key, and a new table follows the
    text.

    Args:
        text: valid TOML.
        table: name of the table, or "" for the top level.
        values: texts, numbers or lists of these, by key.
        number: number of a table in a list, from 1, or 0 for a table outside a list.

    Returns:
        The new text; other parts of the text are unchanged.
    """
    document = tomlkit.parse(text)
    if table and table not in document:
        document[table] = tomlkit.table()
    edited: Any = document[table] if table else document
    edited = edited[number - 1] if number else edited
    for key, value in values.items():
        edited[key] = _listed(value) if isinstance(value, list | tuple) else tomlkit.item(value)
    new_text = tomlkit.dumps(document)
    # tomlkit ends its new lines as on Unix.
    return new_text.replace("\r\n", "\n").replace("\n", "\r\n") if "\r\n" in text else new_text


def _listed(values: Sequence[Any]) -> Any:
    """Return a list as tomlkit's value of a key. Several texts have a line each, so that the file stays readable.

    Args:
        values: texts or numbers.
    """
    # tomlkit parses a list in linear time, but appends to one in quadratic time.
    texts = [tomlkit.item(item).as_string() for item in values]
    line_for_each = len(values) > 1 and all(isinstance(item, str) for item in values)
    content = "".join(f"\n    {text}," for text in texts) + "\n" if line_for_each else ", ".join(texts)
    return tomlkit.value(f"[{content}]")


@dataclass(frozen=True)
class Place:
    """The place of a table in a file, for messages; `number` is its place in a list of tables, from 1, else 0."""

    file: str
    table: str = ""
    number: int = 0

    def __str__(self) -> str:
        table = f"[[{self.table}]] {self.number}," if self.number else f"[{self.table}]"
        return f"{self.file}:{f' {table}' if self.table else ''}"

    def within(self, key: str) -> "Place":
        """Return the place of a table in this one.

        Args:
            key: its key, "" for this table.
        """
        return Place(self.file, f"{self.table}.{key}" if self.table else key)

    def __enter__(self) -> None:
        """Begin a block whose mistakes are at this place."""

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        # A mistake that is raised in the block gets this place at its beginning.
        if isinstance(error, InputError):
            raise error.under(f"{self} ", table=self.table) from error

    def error(self, key: str, value: Any, complaint: str) -> InputError:
        """Return the error of a key's value at this place, as an exception to raise.

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


@dataclass(frozen=True)
class Table:
    """A table of a file: its keys, and the function that makes an object of their values.

    Attributes:
        keys: settings, tables, choices of tables and lists of tables by key.
        make: function of the values by key and of the reader's context; its InputError is a mistake in the table.
        required: True if the file must have it.
    """

    keys: Mapping[str, "Leaf | Table | Choice | Tables"]
    make: Callable[[dict[str, Any], Any], Any] = lambda values, _: values
    required: bool = False

    def read(self, values: Any, place: Place, context: Any = None) -> Any:
        """Return the object that the table makes of the values of a file.

        Args:
            values: values by key, as parsed.
            place: place of the table.
            context: object that the functions `make` of this table and of the tables in it need, or None.

        Raises:
            InputError: every unknown or missing key, and every value of another type or out of bounds.
        """
        if not isinstance(values, Mapping):
            raise Place(place.file).error(place.table, values, f"must be a table, [{place.table}]")
        values_read, mistakes = dict[str, Any](), Mistakes()
        # A required key whose misspelt form is present is reported once, as unknown.
        misspelt = {nearest(key, self.keys) for key in values if key not in self.keys}
        for key, value in values.items():
            with mistakes:
                declaration = self.keys.get(key)
                if declaration is None:
                    at_top = "" if place.table else "at the top level, "
                    suggestion = suggest(key, sorted(filter(None, self.keys)))
                    raise place.refusal(f"{at_top}the key {shortened(key)} is unknown: {suggestion}", key)
                if isinstance(declaration, Leaf):
                    with place:
                        values_read[key] = declaration.read(value)
                else:
                    values_read[key] = declaration.read(value, place.within(key), context)
        for key, declaration in self.keys.items():
            with mistakes:
                if declaration.required and key not in values and key not in misspelt:
                    raise place.refusal(f"the key {key!r} is missing", key)
        mistakes.report()
        with place:
            return self.make(values_read, context)


@cache
def table_of(kind: Any) -> Table:
    """Return the table of a file that makes a settings dataclass, with a key for each setting.

    Args:
        kind: dataclass derived from `Settings`; one with a `kind` allows this key with its value.
    """
    name = getattr(kind, "kind", "")
    kind_leaf = {"kind": Leaf("kind", Annotated[str, Setting(choices=(name,), help="Kind.")], name)} if name else {}
    return Table({**kind_leaf, **leaves_of(kind)}, lambda values, _: kind(**values))


@dataclass(frozen=True)
class Choice:
    """A table of a file whose values decide its keys.

    Attributes:
        tables: the possible tables by name.
        choose: function of the values, which returns one of the names.
        key: key that has the name.
    """

    tables: Mapping[str, Table]
    choose: Callable[[Mapping[str, Any]], Any]
    key: str = "kind"
    required: ClassVar[bool] = False

    def read(self, values: Any, place: Place, context: Any = None) -> Any:
        """Return the object that the chosen table makes of `values`, which are values by key as TOML gives them.

        `place` and `context` are passed on, see `Table.read`.

        Raises:
            InputError: no table has the chosen name, or a mistake in the chosen one.
        """
        with place:
            kind = self.choose(values) if isinstance(values, Mapping) else next(iter(self.tables))
            check_choice(self.key, self.tables, kind)
        return self.tables[kind].read(values, place, context)


@dataclass(frozen=True)
class Tables:
    """A list of tables of a file, at least one, of which `each` reads one; a file must have it if `required`."""

    each: Table | Choice
    required: bool = False

    def read(self, values: Any, place: Place, context: Any = None) -> tuple[Any, ...]:
        """Return the object that each table makes of its values; `values` is the list of tables as TOML gives it.

        `place` and `context` are passed on, see `Table.read`.

        Raises:
            InputError: there is no table, or one entry is no table; or every mistake in the tables.
        """
        if not (isinstance(values, list) and values and all(isinstance(table, dict) for table in values)):
            sentence = f"{place.table} = {shortened(values)}: must be tables, each under [[{place.table}]]"
            raise InputError(sentence, where=f"{place.file}: ", key=place.table)
        mistakes, objects = Mistakes(), list[Any]()
        for number, table in enumerate(values, start=1):
            with mistakes:
                objects.append(self.each.read(table, replace(place, number=number), context))
        mistakes.report()
        return tuple(objects)
