"""Settings: their declaration, and their checked reading from files, from Python and from the command line.

Settings are frozen dataclasses. The annotation of a field has its bounds, its unit and its help.

    @dataclass(frozen=True)
    class DriveSettings(Settings, table="drive"):
        lag: Annotated[float, Setting(least=0, most=1, unit="s", help="Drive lag.")] = 0.0

A value of another type or out of bounds raises an InputError with table, key, value and allowed range. Everything else
about settings is made from these declarations: paths, options, the guide's page, and the files' schema.
"""

import difflib
import inspect
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from functools import cache
from numbers import Real
from types import UnionType
from typing import Annotated, Any, ClassVar, Self, get_args, get_origin

from dpcontrol.foundation.errors import InputError, Mistakes, shortened
from dpcontrol.foundation.units import unusual


def suggest(value: str, choices: Iterable[str]) -> str:
    """Return the allowed values as the end of an error's sentence, the nearest spelling first.

    Args:
        value: value given by the user.
        choices: allowed values.
    """
    choices = [str(choice) for choice in choices] or ["none"]
    nearest_choice = nearest(str(value), choices)
    if nearest_choice:
        return f"did you mean {nearest_choice!r}? Allowed: {', '.join(choices)}"
    return f"allowed: {', '.join(choices)}"


def check_choice(key: str, choices: Iterable[str], *values: Any) -> None:
    """Raise an error for the first value that is none of the choices.

    Args:
        key: key or kind of the values, such as "controller", for the message.
        choices: allowed values.
        *values: values given by the user.

    Raises:
        InputError: a value is no choice; the message has the nearest spelling.
    """
    allowed = list(choices)
    for value in values:
        if value not in allowed:
            raise InputError(f"{key} = {shortened(value)}: {suggest(str(value), allowed)}", key=key)


def nearest(value: str, choices: Iterable[str]) -> str:
    """Return the choice with the nearest spelling, ignoring case, or "" if all differ much.

    Args:
        value: value given by the user.
        choices: allowed values.
    """
    by_folded_case = {choice.casefold(): choice for choice in choices}
    matches = difflib.get_close_matches(value.casefold(), by_folded_case, n=1)
    return by_folded_case[matches[0]] if matches else ""


@dataclass(frozen=True)
class Setting:
    """The declaration of a setting or an argument, in its annotation: allowed values in `unit`, and help.

    Attributes:
        least: smallest number.
        most: largest number.
        above: number that values must exceed.
        choices: allowed texts, beside numbers where these have bounds.
        zero, infinite: meaning of 0 or infinity, which are then also allowed.
        unit: unit of the numbers.
        key: name in files, if it differs from the field's.
        help: a noun phrase without the unit, for tables, `--help` and the schema.
        usual: least and largest size on ordinary benches, beyond which a number causes a remark.
    """

    least: float = -math.inf
    most: float = math.inf
    above: float = -math.inf
    choices: Sequence[str] = ()
    zero: str = ""
    infinite: str = ""
    unit: str = ""
    key: str = ""
    help: str = ""
    usual: tuple[float, float] | None = None

    @property
    def bounded(self) -> bool:
        """True if only some numbers are allowed."""
        return max(self.least, self.above) > -math.inf or self.most < math.inf

    @property
    def range(self) -> str:
        """Allowed range, such as "0 to 1000 periods"."""
        lower = "" if self.least == -math.inf else f"at least {_digits(self.least)}"
        lower = f"more than {_digits(self.above)}" if self.above > -math.inf else lower
        range_text = ", ".join(filter(None, (lower, f"at most {_digits(self.most)}" if self.most < math.inf else "")))
        if self.least > -math.inf and self.most < math.inf:
            range_text = f"{_digits(self.least)} to {_digits(self.most)}"
        unit = f" {self.unit}" if self.unit else ""
        range_text = f"{range_text}{unit}" if range_text else "a finite number" + (f", in{unit}" if unit else "")
        special_values = (("0", self.zero), ("inf", self.infinite))
        return range_text + "".join(f", or {value} for {meaning}" for value, meaning in special_values if meaning)

    def complaint(self, value: Any) -> str:
        """Return the error of a number or a text, or "" if it is allowed.

        Args:
            value: value in `unit`.
        """
        if self.choices and not (self.bounded and isinstance(value, Real)):
            number_range = f", or a number: {self.range}" if self.bounded else ""
            return "" if value in self.choices else suggest(str(value), self.choices) + number_range
        if not isinstance(value, Real):
            return "must be a number" if self.bounded else ""
        number: Any = value
        allowed = (
            (bool(self.zero) and number == 0)
            or (bool(self.infinite) and number == math.inf)
            or (is_finite(number) and self.above < number and self.least <= number <= self.most)
        )
        return "" if allowed else f"must be {' or '.join([self.range, *map(repr, self.choices)])}"

    def oddities(self, key: str, value: Any) -> Iterator[str]:
        """Yield a sentence on each number outside of the range `usual`.

        Args:
            key: key of the value, for messages, unless the setting has a `key` of its own.
            value: a number or several, in `unit`.

        Raises:
            InputError: an impossible number.
        """
        if self.usual is not None:
            values = value if isinstance(value, tuple | list) else (value,)
            yield from unusual(self.key or key, [item for item in values if is_finite(item)], self.usual, self.unit)

    def check(self, key: str, value: Any, *, table: str = "") -> None:
        """Raise an error if a value, or a value of a list, is not allowed.

        Args:
            key: key of the value, for the message.
            value: value in `unit`; None is allowed.
            table: table of the key, for the message.
        """
        for item in value if isinstance(value, tuple | list) else (value,):
            if item is not None and (complaint := self.complaint(item)):
                key = self.key or key
                place = f"{table}: " if table else ""
                raise InputError(f"{key} = {shortened(item)}: {complaint}", where=place, table=table, key=key)


def is_finite(value: Any) -> bool:
    """Return True if a number is finite and fits in a double, which whole numbers of any size need not.

    Args:
        value: real number of any type.
    """
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _digits(value: float) -> str:
    """Return a number without needless digits, whole numbers in full."""
    return f"{value}" if isinstance(value, int) else f"{value:g}"


@dataclass(frozen=True)
class Leaf:
    """A setting of a dataclass.

    Attributes:
        name: name of its field.
        annotation: annotation of its field, which has the bounds.
        default: default, MISSING if the setting is required.
    """

    name: str
    annotation: Any
    default: Any

    @property
    def required(self) -> bool:
        """True if the setting has no default."""
        return self.default is MISSING

    @property
    def hint(self) -> Any:
        """Type of the values."""
        return self.annotation.__origin__

    @property
    def bounds(self) -> Setting:
        """Declaration of the setting."""
        return self.annotation.__metadata__[-1]  # type: ignore[no-any-return]

    def read(self, value: Any, *, key: str = "", strict: bool = True) -> Any:
        """Return a value as the setting's type has it, such as a tuple for a list, or a float for a whole number.

        Args:
            value: value from a file or from Python.
            key: its name in messages (default: that of the field).
            strict: False to read numbers from text.

        Raises:
            InputError: it is of another type, or out of bounds.
        """
        # MISSING stands for a value that only pydantic can read, or reject with a reason.
        key, result = key or self.name, _exactly(_plain(value), self.hint)
        if result is MISSING:
            from pydantic import ValidationError

            try:
                result = adapter(self.annotation).validate_python(_plain(value), strict=strict)
            except ValidationError as error:
                raise InputError(self._complaint(key, value, error.errors(include_url=False)), key=key) from error
        self.bounds.check(key, result)
        return result

    def _complaint(self, key: str, value: Any, errors: Sequence[Mapping[str, Any]]) -> str:
        """Return the sentence for the user about a value that pydantic rejects.

        Args:
            key: name of the value in the message.
            value: the rejected value.
            errors: pydantic's errors, of which a union has one for each of its types; `loc` is the place within the
                value, `type` the kind of the error, and `input` the rejected part.
        """
        # An error in an entry of a list has its index in its location; then the entry is shown, not the whole list.
        entry_errors = [
            error for error in errors if any(isinstance(key_or_index, int) for key_or_index in error["loc"])
        ]
        allowed_kinds = dict.fromkeys(str(_KINDS.get(error["type"], error["msg"])) for error in entry_errors or errors)
        assignment = (
            f"{key} holds {shortened(entry_errors[0]['input'])}" if entry_errors else f"{key} = {shortened(value)}"
        )
        if self.bounds.choices:
            return f"{assignment}: {suggest(str(value), self.bounds.choices)}"
        return f"{assignment}: must be {' or '.join(allowed_kinds)}" + (
            f", {self.bounds.range}" if self.bounds.bounded else ""
        )

    def schema(self) -> dict[str, Any]:
        """Return the JSON Schema of the setting's values, by which editors check files."""
        bounds, schema = self.bounds, adapter(self.annotation).json_schema()
        limits = {"minimum": bounds.least, "exclusiveMinimum": bounds.above, "maximum": bounds.most}
        limits = {name: float(value) for name, value in limits.items() if math.isfinite(value)}
        # JSON has no infinity, so a schema cannot allow it beyond a maximum.
        if bounds.infinite:
            limits.pop("maximum", None)
        for subschema in _nested(schema):
            if subschema.get("type") in ("number", "integer"):
                subschema.update({"anyOf": [{"const": 0}, limits]} if bounds.zero and limits else limits)
            elif subschema.get("type") == "string" and bounds.choices:
                subschema["enum"] = list(bounds.choices)
        if self.default not in (MISSING, math.inf, None):
            schema["default"] = self.default
        return {**schema, "description": bounds.help + (f" Unit: {bounds.unit}." if bounds.unit else "")}


_KINDS = {
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "a whole number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    "string_type": "text in quotes",
    "tuple_type": "a list",
}
"""Values that a type allows, by the kind of pydantic's error."""


def _nested(schema: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a JSON Schema, its alternatives and the schemas of entries, all of which get the bounds of a setting."""
    yield schema
    for subschema in (*schema.get("anyOf", ()), *((schema["items"],) if "items" in schema else ())):
        yield from _nested(subschema)


def frozen(value: Any) -> Any:
    """Return a value with tuples in place of lists, as the fields of frozen dataclasses have them.

    Args:
        value: value of TOML or JSON.
    """
    if isinstance(value, Mapping):
        return {key: frozen(item) for key, item in value.items()}
    return tuple(map(frozen, value)) if isinstance(value, list | tuple) else value


def _plain(value: Any) -> Any:
    """Return a value from a file or from Python as the strict checks of pydantic accept it.

    Lists become tuples, arrays and numbers of NumPy those of Python, and floats without a fraction whole numbers.
    """
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, list | tuple):
        return tuple(map(_plain, value))
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _exactly(value: Any, hint: Any) -> Any:
    """Return a value as pydantic would read it, if its type fits exactly, or else MISSING.

    Most values need no pydantic, whose import takes 0.1 s.

    Args:
        value: value as `_plain` returns it.
        hint: type of the setting, without its declaration.
    """
    if hint is float and type(value) in (int, float) and is_finite(value):
        return float(value)
    if type(value) is hint and hint is not float:
        return value
    if isinstance(hint, UnionType):
        return next((result for item in get_args(hint) if (result := _exactly(value, item)) is not MISSING), MISSING)
    if type(value) is tuple and get_origin(hint) is tuple and get_args(hint)[1:] == (...,):
        entries = tuple(_exactly(item, get_args(hint)[0]) for item in value)
        return MISSING if any(item is MISSING for item in entries) else entries
    return MISSING


@cache
def adapter(kind: Any) -> Any:
    """Return pydantic's adapter of a type, which checks values, reads JSON and makes the type's JSON Schema.

    The import within the function takes a tenth of a second.

    Args:
        kind: dataclass, or another type.
    """
    from pydantic import TypeAdapter

    return TypeAdapter(kind)


@cache
def leaves_of(kind: type) -> dict[str, Leaf]:
    """Return the declared settings of a dataclass by name: the fields whose annotation has a `Setting`.

    A field with another default in a subclass keeps its declaration.

    Args:
        kind: settings dataclass.
    """
    annotations = [inspect.get_annotations(ancestor, eval_str=True) for ancestor in kind.__mro__]
    leaves = {}
    for field in fields(kind):
        declarations = [
            hints_of_class[field.name]
            for hints_of_class in annotations
            if get_origin(hints_of_class.get(field.name)) is Annotated
        ]
        # The first declaration is that of the most derived class, which comes first in the order of resolution.
        if declarations and isinstance(declarations[0].__metadata__[-1], Setting):
            leaves[field.name] = Leaf(field.name, declarations[0], field.default)
    return leaves


class Settings:
    """Base of settings that checks the fields' bounds on construction; `table` names the settings in messages."""

    TABLE: ClassVar[str] = ""

    def __init_subclass__(cls, table: str | None = None, **options: Any) -> None:
        """Set the table that messages name, which subclasses inherit."""
        super().__init_subclass__(**options)
        if table is not None:
            cls.TABLE = table

    def __post_init__(self) -> None:
        """Check every declared field, then their combination.

        Raises:
            InputError: every mistake with table, key, value and allowed range.
        """
        mistakes = Mistakes()
        # Only values that differ from their defaults need a check.
        for name, leaf in leaves_of(type(self)).items():
            value = getattr(self, name)
            if value is not leaf.default:
                with mistakes:
                    leaf.bounds.check(name, value, table=self.TABLE)
        mistakes.report()
        self._check_together()

    def _check_together(self) -> None:
        """Reject combinations of valid values; the default accepts all."""

    def with_(self, values: Mapping[str, Any]) -> Self:
        """Return the settings with some replaced.

        Args:
            values: new values by path below these settings, such as "rate" or "drive.lag".

        Raises:
            InputError: an unknown name, or values out of bounds.
        """
        # Values of fields of these settings, and values of settings that are fields, by the name of the field.
        new_values, of_parts = dict[str, Any](), dict[str, dict[str, Any]]()
        for path, value in values.items():
            name_of_part, _, path_within = path.partition(".")
            if path_within:
                of_parts.setdefault(name_of_part, {})[path_within] = value
            else:
                new_values[name_of_part] = value
        names = [setting.name for setting in fields(self) if setting.name != "kind"]  # type: ignore[arg-type]
        for name in (*new_values, *of_parts):
            if name not in names:
                owner = getattr(self, "kind", self.TABLE)
                raise InputError(f"{self.TABLE}.{name}: {owner} has no such setting; it has {', '.join(names)}")
        new_values |= {
            name_of_part: getattr(self, name_of_part).with_(values_within)
            for name_of_part, values_within in of_parts.items()
        }
        return replace(self, **new_values)  # type: ignore[type-var]

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
            raise self.refusal(name, f"must be one value, or a list of {arms}, one for each arm")
        return values

    def refusal(self, key: str, complaint: str) -> InputError:
        """Return the error of a setting's present value.

        Args:
            key: field of the settings.
            complaint: what is wrong, such as "must be positive".
        """
        place = f"{self.TABLE}: " if self.TABLE else ""
        return InputError(
            f"{key} = {shortened(getattr(self, key))}: {complaint}", where=place, table=self.TABLE, key=key
        )
