"""Settings with declared bounds, and their checked reading from TOML files.

Settings are frozen dataclasses whose fields have bounds and units.

    @dataclass(frozen=True)
    class DriveSettings(Settings, table="drive"):
        delay: float = setting(1.0, least=0, most=1000, unit="periods")

A value out of bounds raises an InputError with table, key, value and allowed range.

TOML files are checked when they are read: each mistake is one sentence with file, table, key, value and allowed range.
"""

import difflib
import json
import math
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cache
from numbers import Real
from pathlib import Path
from typing import Any, ClassVar, TypeVar, get_origin, get_type_hints

from dpcontrol.foundation.arguments import shortened
from dpcontrol.foundation.errors import InputError, Mistakes

T = TypeVar("T")


def suggest(value: str, choices: Iterable[str]) -> str:
    """Return the allowed values as a text, the nearest spelling first.

    Args:
        value: value given by the user.
        choices: allowed values.
    """
    choices = [str(choice) for choice in choices] or ["none"]
    close = nearest(str(value), choices)
    if close:
        return f"did you mean {close!r}? Allowed: {', '.join(choices)}"
    return f"allowed: {', '.join(choices)}"


def check_names(what: str, names: Iterable[str], known: Iterable[str]) -> None:
    """Raise an error for the first name that is not known.

    Args:
        what: kind of name, such as "controller", for the message.
        names: names given by the user.
        known: allowed names.

    Raises:
        InputError: unknown name; the message has the nearest spelling.
    """
    known = tuple(known)
    for name in names:
        if name not in known:
            raise InputError(f"unknown {what} {shortened(name)}: {suggest(name, known)}")


def nearest(value: str, choices: Iterable[str]) -> str:
    """Return the choice with the nearest spelling, ignoring case.

    The result is "" if all differ much.

    Args:
        value: value given by the user.
        choices: allowed values.
    """
    spelt = {choice.casefold(): choice for choice in choices}
    close = difflib.get_close_matches(value.casefold(), spelt, n=1)
    return spelt[close[0]] if close else ""


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
        found = tomllib.loads(text)
        # Dotted keys nest without recursion of the parser.
        level: list[Any] = [found]
        for _ in range(_DEEPEST):
            level = [one for part in level for one in (part.values() if isinstance(part, dict) else part)]
            level = [one for one in level if isinstance(one, dict | list)]
        if level:
            raise RecursionError
        return found
    except tomllib.TOMLDecodeError as error:
        # Before Python 3.14, the error has its line in the text only, or is at the end of the document.
        found = re.search(r"\(at line (\d+),", str(error))
        line = int(found[1]) if found else text.count("\n") + 1
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
class Bounds:
    """Allowed values of a setting, in `unit`.

    Attributes:
        least: smallest number.
        above: number that values must exceed.
        most: largest number.
        choices: allowed texts.
        zero, infinite: meaning of 0 or infinity, which are then also allowed.
        key: name in files, if it differs from the field's.
    """

    least: float = -math.inf
    above: float = -math.inf
    most: float = math.inf
    choices: Sequence[str] = ()
    zero: str = ""
    infinite: str = ""
    unit: str = ""
    key: str = ""

    @property
    def range(self) -> str:
        """Allowed range, such as "0 to 1000 periods" or "positive".

        "" for any number.
        """
        unit = f" {self.unit}" if self.unit else ""
        low = max(self.least, self.above)
        if math.isfinite(self.most):
            start = f"{_digits(low)} to " if self.above < low else "positive, at most " if low == 0 else ""
            text = f"{start or f'more than {_digits(low)}, at most '}{_digits(self.most)}{unit}"
        elif low == 0:
            text = ("positive" if self.above == 0 else "zero or positive") + (f", in{unit}" if unit else "")
        elif math.isfinite(low):
            text = f"{'more than' if self.above == low else 'at least'} {_digits(low)}{unit}"
        else:
            text = f"a finite number{f' of{unit}' if unit else ''}"
        extremes = (("0", self.zero), ("inf", self.infinite))
        return text + "".join(f", or {value} for {meaning}" for value, meaning in extremes if meaning)

    def complaint(self, value: Any) -> str:
        """Return the error of a value, or "" if it is valid.

        Args:
            value: value in `unit`.
        """
        if self.choices:
            return "" if value in self.choices else suggest(str(value), self.choices)
        if isinstance(value, str) and replace(self, unit="", key="") == Bounds():
            return ""
        if not isinstance(value, Real):
            return "must be a number"
        try:
            number = float(value)
        except OverflowError:
            return f"must be {self.range}; this one has too many digits"
        allowed = (
            (bool(self.zero) and number == 0)
            or (bool(self.infinite) and number == math.inf)
            or (math.isfinite(number) and self.above < number and self.least <= number <= self.most)
        )
        return "" if allowed else f"must be {self.range}"


def setting(default: Any = MISSING, /, *, help: str = "", **bounds: Any) -> Any:
    """Declare a setting.

    A dataclass field with its default, its `Bounds` and its help.

    Args:
        default: required if there is none. None passes the bounds.
        help: a noun phrase without the unit, for tables, `--help` and the schema.
        **bounds: fields of `Bounds`; they hold for every value of a tuple.
    """
    return field(default=default, metadata={"bounds": Bounds(**bounds), "help": help})


class Settings:
    """Base of settings: checks the fields' bounds on construction.

    `table` names the settings in messages.
    """

    TABLE: ClassVar[str] = ""
    __pydantic_config__: ClassVar[Mapping[str, Any]] = {
        "extra": "forbid", "strict": True, "arbitrary_types_allowed": True
    }  # fmt: skip

    def __init_subclass__(cls, table: str | None = None, **others: Any) -> None:
        super().__init_subclass__(**others)
        if table is not None:
            cls.TABLE = table

    def __post_init__(self) -> None:
        """Check every bounded field, then their combination.

        Raises:
            InputError: every mistake with table, key, value and allowed range.
        """
        mistakes = Mistakes()
        for name in bounds_of(type(self)):
            with mistakes:
                self.check(name, getattr(self, name))
        mistakes.report()
        self._check_together()

    @classmethod
    def check(cls, name: str, value: Any) -> None:
        bounds = bounds_of(cls)[name]
        for one in value if isinstance(value, tuple | list) else (value,):
            if one is not None and (complaint := bounds.complaint(one)):
                raise cls._refused(bounds.key or name, one, complaint)

    def _check_together(self) -> None:
        """Reject combinations of valid values; the default accepts all."""

    @classmethod
    def _refused(cls, key: str, value: Any, complaint: str) -> InputError:
        where = f"{cls.TABLE}: " if cls.TABLE else ""
        return InputError(f"{key} = {shortened(value)}: {complaint}", where=where, table=cls.TABLE, key=key)

    def of_each(self, name: str, arms: int) -> tuple[Any, ...]:
        """Return the values of a setting for each arm.

        Args:
            name: setting whose value is one number, or one for each arm.
            arms: number of arms.

        Raises:
            InputError: their number differs from that of the arms.
        """
        value = getattr(self, name)
        values = tuple(value) if isinstance(value, tuple | list) else (value,) * arms
        if len(values) != arms:
            raise self.refusal(name, f"must be one number, or {arms}, one for each arm")
        return values

    def refusal(self, key: str, complaint: str) -> InputError:
        """Return the error of a setting's present value.

        Args:
            key: field of the settings.
            complaint: what is wrong, such as "must be positive".
        """
        return self._refused(key, getattr(self, key), complaint)


@cache
def bounds_of(kind: type) -> dict[str, Bounds]:
    """Return {field: bounds}.

    A field with another default in a subclass keeps its bounds.

    Args:
        kind: settings dataclass.
    """
    return {name: found["bounds"] for name, found in _declared(kind).items()}


@cache
def help_of(kind: type) -> dict[str, str]:
    """Return {field: help}, inherited like the bounds.

    Args:
        kind: settings dataclass.
    """
    return {name: found["help"] for name, found in _declared(kind).items()}


def _declared(kind: type) -> dict[str, Mapping[str, Any]]:
    """Return the metadata of each declared setting, with inherited help."""
    found: dict[str, Mapping[str, Any]] = {}
    for one in fields(kind):  # type: ignore[arg-type]
        own = [
            metadata
            for ancestor in kind.__mro__
            if one.name in vars(ancestor).get("__dataclass_fields__", {})
            and "bounds" in (metadata := vars(ancestor)["__dataclass_fields__"][one.name].metadata)
        ]
        if own:
            found[one.name] = {"bounds": own[0]["bounds"], "help": next((m["help"] for m in own if m["help"]), "")}
    return found


def _digits(value: float) -> str:
    return f"{value}" if isinstance(value, int) else f"{value:g}"


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


def decode(kind: type[T], values: Mapping[str, Any], place: Place, *, also: Iterable[str] = ()) -> T:
    """Return settings of a dataclass from TOML or JSON.

    The values are a table or an object.

    Args:
        kind: dataclass derived from `Settings`.
        values: values by key, where lists become tuples.
        place: for messages.
        also: further keys of the file, for suggestions.

    Raises:
        InputError: every unknown or missing key, and every value of another type or out of bounds.
    """
    from pydantic import ValidationError

    values = frozen(values)
    try:
        # Strict pydantic rejects Python dictionaries as dataclasses, but accepts those of JSON.
        return adapter(kind).validate_json(json.dumps(values, default=str))
    except InputError as error:
        raise error.under(f"{place} ", table=place.table) from error
    except ValidationError as error:
        if not all(one["loc"] for one in error.errors(include_url=False, include_context=False)):
            raise place.refusal("a text is not valid Unicode; write it again") from error
        wrong = {str(one["loc"][0]): one for one in error.errors(include_url=False, include_context=False)}
    known = [f.name for f in fields(kind)]  # type: ignore[arg-type]
    mistakes = Mistakes()
    unknown = [key for key in values if key not in known]
    misspelt = {nearest(key, unknown) for key in wrong if key not in values}
    for key in [*(key for key in values if key not in misspelt), *(key for key in wrong if key not in values)]:
        with mistakes:
            if key in wrong:
                raise _mistake(kind, key, wrong[key], place, (values, sorted({*known, *also})))
            if key in bounds_of(kind):
                _check_value(kind, key, values[key], place)
    mistakes.report()
    raise AssertionError("pydantic rejected valid values")


def _check_value(kind: Any, key: str, value: Any, place: Place) -> None:
    try:
        kind.check(key, value)
    except InputError as error:
        raise error.under(f"{place} ", table=place.table) from error


def frozen(value: Any) -> Any:
    """Return a value with tuples in place of lists.

    Args:
        value: value of TOML or JSON.
    """
    if isinstance(value, Mapping):
        return {key: frozen(one) for key, one in value.items()}
    return tuple(map(frozen, value)) if isinstance(value, list | tuple) else value


@cache
def adapter(kind: Any) -> Any:
    """Return pydantic's adapter of a dataclass.

    The import within the function takes a tenth of a second.

    Args:
        kind: dataclass, or another type.
    """
    from pydantic import TypeAdapter

    return TypeAdapter(kind)


_TYPES = {
    float: "must be a number",
    int: "must be a whole number",
    str: "must be text in quotes",
    bool: "must be true or false",
    float | None: "must be a number",
    int | None: "must be a whole number",
    tuple[str, ...]: "must be a list of texts in quotes",
    tuple[int, ...]: "must be a list of whole numbers",
    tuple[float, ...]: "must be a list of numbers",
    float | tuple[float, ...]: "must be a number or a list of numbers",
    int | tuple[int, ...]: "must be a whole number or a list of whole numbers",
    int | tuple[int, ...] | None: "must be a whole number or a list of whole numbers",
}
"""Complaint about a value of another type."""


def _mistake(
    kind: type, key: str, wrong: Mapping[str, Any], place: Place, keys: tuple[Any, Sequence[str]]
) -> InputError:
    """Return the error of one key.

    `keys` are the file's values, and the known keys.
    """
    values, known = keys
    if wrong["type"] in ("missing", "missing_argument"):
        close = nearest(key, [one for one in values if one not in known])
        return place.refusal(
            f"the key {key!r} is missing{f'; is {close!r} a misspelling of it?' if close else ''}", close
        )
    if wrong["type"] == "unexpected_keyword_argument":
        top = "" if place.table else "at the top level, "
        return place.refusal(f"{top}the key {key!r} is unknown: {suggest(key, known)}", key)
    hint, value = get_type_hints(kind)[key], values[key]
    if isinstance(value, tuple) and get_origin(hint) is not None:
        inside = next((value[k] for k in wrong["loc"] if isinstance(k, int)), value)
        return place.refusal(f"{key} holds {inside!r}: {_TYPES.get(hint, wrong['msg'])}", key)
    text = str(_TYPES.get(hint, wrong["msg"]))
    if hint is int and (bounds := bounds_of(kind).get(key)):
        text += f", {bounds.range}"
    return place.error(key, list(value) if isinstance(value, tuple) else value, text)
