"""Check of public functions' arguments against their annotations.

It happens before anything is computed.

Annotations of public functions may be text, because results' classes are imported when they are needed. A value fits
the name of a class if its class or one of its bases has this name. Numbers must be finite, and lie within `Between` if
these are annotated. A wrong number of arguments and an unknown keyword remain Python's TypeError.
"""

import builtins
import inspect
import math
import types
from collections.abc import Callable, Collection, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cache, wraps
from numbers import Integral, Real
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from dpcontrol.foundation.arguments import allowed_range, shortened
from dpcontrol.foundation.errors import InputError, printable
from dpcontrol.foundation.settings import suggest

Function = TypeVar("Function", bound=Callable[..., Any])


@dataclass(frozen=True)
class Between:
    """Bounds of an annotated number.

    At least `least`, at most `most`, greater than `above`.
    """

    least: float = -math.inf
    most: float = math.inf
    above: float = -math.inf


Seed = Annotated[int, Between(0, 2**62)]
Workers = Annotated[int, Between(0, 4096)]
Count = Annotated[int, Between(1, 1_000_000)]
Hit = Annotated[int, Between(1, 1000)]
Index = Annotated[int, Between(0, 1_000_000)]
Positive = Annotated[float, Between(above=0)]


def checked(function: Function) -> Function:
    """Return a function that checks its arguments against their annotations.

    The returned function raises InputError if an argument does not fit.

    Args:
        function: annotated function or method.
    """

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        signature, hints = inspect.signature(function), annotations_of(function)
        for name, value in signature.bind(*args, **kwargs).arguments.items():
            if name in hints and signature.parameters[name].kind is not inspect.Parameter.VAR_KEYWORD:
                check(name, value, hints[name])
        return function(*args, **kwargs)

    return call  # type: ignore[return-value]


@cache
def annotations_of(function: Callable[..., Any]) -> dict[str, Any]:
    """Return the annotations of a function by parameter, with stand-ins for classes that are not imported.

    Args:
        function: function as it was written, without the check.
    """
    return get_type_hints(function, {}, _Names({**vars(builtins), **function.__globals__}), include_extras=True)


class _ByName(type):
    """The type of stand-ins for classes that are not imported."""

    def __instancecheck__(cls, value: object) -> bool:
        return any(one.__name__ == cls.__name__ for one in type(value).__mro__)


class _Names(dict[str, Any]):
    """The names of a module, with stand-ins for missing classes.

    Only type checkers import these classes.
    """

    def __missing__(self, name: str) -> type:
        return _ByName(name, (), {})


def check(name: str, value: Any, hint: Any) -> None:
    """Raise an error if a value does not fit a type.

    Args:
        name: of the argument, for the message.
        value: the argument.
        hint: the type, as annotations write it.

    Raises:
        InputError: names the argument, its value and the allowed values.
    """
    options = _alternatives(hint)
    if _fits_any(value, hint):
        return
    if isinstance(value, str | Path) and not _is_line(str(value)):
        raise InputError(f"{name} = {shortened(value)}: must be one short line without control characters")
    texts = [one for option in options if get_origin(option) is Literal for one in get_args(option)]
    if isinstance(value, str) and texts and all(isinstance(one, str) for one in texts):
        raise InputError(f"{name} = {shortened(value)}: {suggest(value, texts)}")
    words = [word for option in options if (word := _words(option))]
    raise InputError(f"{name} = {shortened(value)}: must be {' or '.join(dict.fromkeys(words))}")


def number(name: str, value: Any) -> float:
    """Return a finite number as a float.

    Args:
        name: argument, for the message.
        value: number given by the user.

    Raises:
        InputError: the value is not a number, or not finite.
    """
    check(name, value, float)
    return float(value)


def numbers(name: str, values: Any, count: int) -> tuple[float, ...]:
    """Return `count` finite numbers.

    Args:
        name: argument, for the message.
        values: sequence (count,) given by the user.
        count: required number of entries.

    Raises:
        InputError: the count is wrong, or an entry is not a finite number.
    """
    check(name, values, types.GenericAlias(tuple, (float,) * count))
    return tuple(map(float, values))


def _alternatives(hint: Any) -> tuple[Any, ...]:
    if get_origin(hint) in (Union, types.UnionType):
        return tuple(one for part in get_args(hint) for one in _alternatives(part))
    return (hint,)


def _fits(value: Any, hint: Any) -> bool:
    import numpy as np

    kind, inner = get_origin(hint), get_args(hint)
    if kind is Annotated:
        bounds = inner[1]
        if not isinstance(inner[1], Between):
            return _fits_any(value, inner[0])
        return _fits(value, inner[0]) and bounds.least <= value <= bounds.most and value > bounds.above
    if kind is Literal:
        return any(type(value) is type(one) and value == one for one in inner)
    if kind is Mapping:
        return isinstance(value, Mapping) and all(
            _fits_any(one, part) for pair in value.items() for one, part in zip(pair, inner, strict=True)
        )
    if kind in (Sequence, Collection, tuple):
        return is_list(value) and len(value) == _length(hint, value) and all(
            _fits_any(one, inner[0 if Ellipsis in inner else min(k, len(inner) - 1)]) for k, one in enumerate(value)
        )  # fmt: skip
    if kind is np.ndarray:
        return isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and bool(np.isfinite(value).all())
    if hint in (float, int):
        kinds: Any = (Real if hint is float else Integral, bool | np.bool_)
        # The bound overflows in NumPy's short floats.
        size = abs(float(value) if isinstance(value, np.floating) else value) if isinstance(value, kinds[0]) else np.nan
        return not isinstance(value, kinds[1]) and bool(size <= _LARGEST)
    if hint is bool:
        return isinstance(value, bool | np.bool_)
    if hint is None or hint is Any or hint is object or isinstance(hint, TypeVar):
        return value is None or hint is not None
    if isinstance(value, str | Path) and hint in (str, Path):
        return isinstance(value, hint) and _is_line(str(value))
    if getattr(hint, "_is_protocol", False):
        return value is not None  # The object's methods are checked where they are called.
    kind = kind or hint
    return callable(value) if kind is Callable else not isinstance(kind, type) or isinstance(value, kind)


def _is_line(text: str) -> bool:
    """Return True if a text is one printable line that fits in a path; symbols of composite edges are long."""
    return printable(text) == text and "\n" not in text and len(text) < 4000


_LARGEST = 1.7976931348623157e308
"""The largest double; NaN does not compare as less."""


def _fits_any(value: Any, hint: Any) -> bool:
    return any(_fits(value, option) for option in _alternatives(hint))


def is_list(value: Any) -> bool:
    """Return True if a value has entries in an order.

    Texts, mappings and sets are no lists. An array is one if it has at least one axis.

    Args:
        value: any object.
    """
    if hasattr(value, "ndim"):
        return value.ndim > 0
    return isinstance(value, Collection) and not isinstance(value, str | bytes | Mapping | Set)


def _length(hint: Any, value: Any) -> int:
    inner = get_args(hint)
    return len(value) if get_origin(hint) is not tuple or Ellipsis in inner else len(inner)


def _words(hint: Any) -> str:
    kind, inner = get_origin(hint), get_args(hint)
    if kind is Annotated and not isinstance(inner[1], Between):
        return " or ".join(filter(None, map(_words, _alternatives(inner[0]))))
    if kind is Annotated:
        above = "" if math.isinf(inner[1].above) else f" above {inner[1].above:g}"
        return allowed_range(_words(inner[0]), inner[1].least, inner[1].most) + above
    if kind is Literal:
        return ", ".join(map(repr, inner))
    if kind is Mapping:
        return "values by name"
    if kind in (Sequence, Collection, tuple):
        count = "" if kind is not tuple or Ellipsis in inner else f"{len(inner)} values, each "
        each = " or ".join(filter(None, map(_words, _alternatives(inner[0]))))
        if count:
            return f"{count}{each}"
        return f"a list, each entry {each}" if each else "a list"
    plain = {
        float: "a finite number",
        int: "a whole number",
        bool: "True or False",
        str: "text",
        None: "",
        type(None): "",
        Any: "",
    }
    if hint in plain:
        return plain[hint]
    if getattr(kind, "__name__", "") == "ndarray":
        return "an array of finite numbers"
    if kind is Callable:
        return "a function"
    if hint is Path:
        return "the path of a file"
    name = getattr(hint, "__name__", str(hint))
    return f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"
