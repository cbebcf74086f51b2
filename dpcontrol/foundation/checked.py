"""Check of public functions' arguments against their annotations.

It happens before anything is computed.

Annotations of public functions may be text, because results' classes are imported when they are needed. A value fits
the name of a class if its class or one of its bases has this name. Numbers must be finite, and lie within `Between` if
these are annotated. A wrong number of arguments and an unknown keyword remain Python's TypeError.
"""

import builtins
import inspect
import types
from collections.abc import Callable, Collection, Mapping, Sequence, Set
from functools import cache, wraps
from numbers import Integral, Real
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

from dpcontrol.foundation.errors import InputError, printable, shortened
from dpcontrol.foundation.settings import Setting as Between
from dpcontrol.foundation.settings import is_finite, suggest

Function = TypeVar("Function", bound=Callable[..., Any])

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
        signature, hints = _signature(function), annotations_of(function)
        for name, value in signature.bind(*args, **kwargs).arguments.items():
            if name in hints and signature.parameters[name].kind is not inspect.Parameter.VAR_KEYWORD:
                check(name, value, hints[name])
        return function(*args, **kwargs)

    return call  # type: ignore[return-value]


_signature = cache(inspect.signature)


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
    """The names of a module, with stand-ins for the classes that only type checkers import."""

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
    if _fits(value, hint):
        return
    texts = [text for part in (hint, *get_args(hint)) if get_origin(part) is Literal for text in get_args(part)]
    if isinstance(value, str) and texts and all(isinstance(text, str) for text in texts):
        raise InputError(f"{name} = {shortened(value)}: {suggest(value, texts)}")
    raise InputError(f"{name} = {shortened(value)}: must be {_noun(hint)}")


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


class _Kind(NamedTuple):
    """Values that a plain type allows: their noun for messages, and their test."""

    noun: str
    fits: Callable[[Any], bool]


@cache
def _kinds() -> dict[Any, _Kind]:
    """Return the values that each plain type allows.

    The import within the function keeps the signatures of public functions quick to import.
    """
    import numpy as np

    def is_number(value: Any, kind: Any) -> bool:
        return isinstance(value, kind) and not isinstance(value, bool) and is_finite(value)

    def is_array(value: Any) -> bool:
        return isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and bool(np.isfinite(value).all())

    anything = _Kind("", lambda _: True)
    return {
        float: _Kind("a finite number", lambda value: is_number(value, Real)),
        int: _Kind("a whole number", lambda value: is_number(value, Integral)),
        bool: _Kind("True or False", lambda value: isinstance(value, bool | np.bool_)),
        str: _Kind("one short line of text", lambda value: isinstance(value, str) and _is_line(value)),
        Path: _Kind("the path of a file", lambda value: isinstance(value, Path) and _is_line(str(value))),
        np.ndarray: _Kind("an array of finite numbers", is_array),
        Callable: _Kind("a function", callable),
        types.NoneType: _Kind("", lambda value: value is None),
        None: _Kind("", lambda value: value is None),
        Any: anything,
        object: anything,
    }


def _fits(value: Any, hint: Any) -> bool:
    kind, inner = get_origin(hint) or hint, get_args(hint)
    if kind in (Union, types.UnionType):
        return any(_fits(value, part) for part in inner)
    if kind is Annotated:
        return _fits(value, inner[0]) and not (isinstance(inner[1], Between) and inner[1].complaint(value))
    if kind is Literal:
        return any(type(value) is type(allowed) and value == allowed for allowed in inner)
    if kind is Mapping:
        return isinstance(value, Mapping) and all(
            _fits(key, inner[0]) and _fits(entry, inner[1]) for key, entry in value.items()
        )
    if kind in (Sequence, Collection, tuple):
        entries = inner if kind is tuple and Ellipsis not in inner else inner[:1] * len(value) if is_list(value) else ()
        return is_list(value) and len(value) == len(entries) and all(map(_fits, value, entries))
    if kind in _kinds():
        return _kinds()[kind].fits(value)
    if getattr(kind, "_is_protocol", False):
        return value is not None  # The object's methods are checked where they are called.
    return not isinstance(kind, type) or isinstance(value, kind)


def _is_line(text: str) -> bool:
    """Return True if a text is one printable line that fits in a path; symbols of composite edges are long."""
    return printable(text) == text and "\n" not in text and len(text) < 4000


def is_list(value: Any) -> bool:
    """Return True if a value has entries in an order.

    Texts, mappings and sets are no lists. An array is one if it has at least one axis.

    Args:
        value: any object.
    """
    ordered = isinstance(value, Collection) and not isinstance(value, str | bytes | Mapping | Set)
    return ordered and getattr(value, "ndim", 1) > 0


def _noun(hint: Any) -> str:
    """Return the values that a type allows, as a noun for messages."""
    kind, inner = get_origin(hint) or hint, get_args(hint)
    if kind in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(filter(None, map(_noun, inner))))
    if kind is Annotated:
        return f"{_noun(inner[0])}, {inner[1].range}" if isinstance(inner[1], Between) else _noun(inner[0])
    if kind is Literal:
        return ", ".join(map(repr, inner))
    if kind is Mapping:
        return "values by name"
    if kind in (Sequence, Collection, tuple):
        count = f"{len(inner)} values" if kind is tuple and Ellipsis not in inner else "a list"
        each = _noun(inner[0])
        return f"{count}, each {each}" if each else count
    name = getattr(kind, "__name__", str(kind))
    return _kinds()[kind].noun if kind in _kinds() else f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"
