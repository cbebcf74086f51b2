"""Check of public functions' arguments against their annotations, before anything is computed.

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
from dpcontrol.foundation.parts import StageModule
from dpcontrol.foundation.progress import reporting
from dpcontrol.foundation.settings import Setting as Between, is_finite, suggest

Function = TypeVar("Function", bound=Callable[..., Any])

Seed = Annotated[int, Between(0, 2**62)]
Workers = Annotated[int, Between(0, 4096)]
Count = Annotated[int, Between(1, 1_000_000)]
Hit = Annotated[int, Between(1, 1000)]
Index = Annotated[int, Between(0, 1_000_000)]
Positive = Annotated[float, Between(above=0)]


def checked(function: Function) -> Function:
    """Return a function that checks its arguments against their annotations and raises InputError if one does not fit.

    If the function has the argument `progress`, it receives a function of a text and a share, whatever the caller gave.

    Args:
        function: annotated function or method.
    """

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        """Check the arguments of `function`, then call it with a receiver of progress reports if it takes one."""
        signature, hints = _signature(function), annotations_of(function)
        bound = signature.bind(*args, **kwargs)
        for name, value in bound.arguments.items():
            if name in hints and signature.parameters[name].kind is not inspect.Parameter.VAR_KEYWORD:
                check(name, value, hints[name])
        if "progress" not in signature.parameters:
            return function(*args, **kwargs)
        with reporting(bound.arguments.get("progress"), function.__name__.replace("_", " ")) as report:
            bound.arguments["progress"] = report
            return function(*bound.args, **bound.kwargs)

    return call  # type: ignore[return-value]


_signature = cache(inspect.signature)


@cache
def annotations_of(function: Callable[..., Any]) -> dict[str, Any]:
    """Return the annotations of a function by parameter, with stand-ins for classes that are not imported.

    The annotations may be texts that name classes of heavy modules; reading them must not import these.

    Args:
        function: function as it was written, without the check.
    """
    imported = {name: value for name, value in function.__globals__.items() if not isinstance(value, StageModule)}
    return get_type_hints(function, {}, _Names({**vars(builtins), **imported}), include_extras=True)


class _ByName(type):
    """The type of stand-ins for classes and modules that are not imported.

    A stand-in accepts the instances of every class that has its name, or has a base of this name. The attribute of a
    stand-in for a module is the stand-in for a class.
    """

    def __getattr__(cls, name: str) -> type:
        if name.startswith("_"):
            raise AttributeError(name)
        return _ByName(name, (), {})

    def __instancecheck__(cls, value: object) -> bool:
        return any(base.__name__ == cls.__name__ for base in type(value).__mro__)


class _Names(dict[str, Any]):
    """The names of a module, with stand-ins for the classes that only type checkers import."""

    def __missing__(self, name: str) -> type:
        return _ByName(name, (), {})


def check(name: str, value: Any, hint: Any) -> None:
    """Raise an error if a value does not fit a type.

    Args:
        name: name of the argument, for the message.
        value: the argument.
        hint: the type, as annotations write it, such as `int | None`, or `Annotated` with bounds.

    Raises:
        InputError: the value does not fit; the message names the argument, its value and the allowed values.
    """
    noun, fits = _kind(hint)
    if fits(value):
        return
    # Entries of Literal, also of one that is an alternative in a union.
    choices = [text for part in (hint, *get_args(hint)) if get_origin(part) is Literal for text in get_args(part)]
    if isinstance(value, str) and choices and all(isinstance(text, str) for text in choices):
        raise InputError(f"{name} = {shortened(value)}: {suggest(value, choices)}")
    raise InputError(f"{name} = {shortened(value)}: must be {noun}")


def number(name: str, value: Any) -> float:
    """Check that an argument is a finite number, and return it as a float.

    Args:
        name: argument, for the message.
        value: number given by the user.

    Raises:
        InputError: the value is not a number, or not finite.
    """
    check(name, value, float)
    return float(value)


def numbers(name: str, values: Any, count: int) -> tuple[float, ...]:
    """Check that an argument is a sequence of `count` finite numbers, and return them as floats.

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
    """Values that a type allows: their noun for messages, and their test."""

    noun: str
    fits: Callable[[Any], bool]


@cache
def _plain_kinds() -> dict[Any, _Kind]:
    """Return the noun and the test of the values that each plain type allows, by type.

    NumPy is imported within the function, which keeps the import of the public functions quick.
    """
    import numpy as np

    def is_number(value: Any, kind: Any) -> bool:
        """Return True for a finite number of a kind; True and False, which Python counts as whole numbers, are none."""
        return isinstance(value, kind) and not isinstance(value, bool) and is_finite(value)

    def is_array(value: Any) -> bool:
        """Return True for a NumPy array of finite real numbers of any shape."""
        return isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and bool(np.isfinite(value).all())

    return {
        float: _Kind("a finite number", lambda value: is_number(value, Real)),
        int: _Kind("a whole number", lambda value: is_number(value, Integral)),
        bool: _Kind("True or False", lambda value: isinstance(value, bool | np.bool_)),
        str: _Kind("one short line of text", lambda value: isinstance(value, str) and _is_line(value)),
        Path: _Kind("the path of a file", lambda value: isinstance(value, Path) and _is_line(str(value))),
        np.ndarray: _Kind("an array of finite numbers", is_array),
        Callable: _Kind("a function", callable),
        **dict.fromkeys((types.NoneType, None), _Kind("", lambda value: value is None)),
        **dict.fromkeys((Any, object), _Kind("", lambda _: True)),
    }


@cache
def _kind(hint: Any) -> _Kind:
    """Return the noun and the test of the values that a type allows, composed from those of its parts.

    The noun names allowed values in messages, such as "a whole number", and the test is True for allowed values.

    Args:
        hint: type as annotations write it, such as a union, a literal, or a list of another type.
    """
    kind, inner = get_origin(hint) or hint, get_args(hint)
    if kind in (Union, types.UnionType):
        parts = [_kind(part) for part in inner]
        nouns = dict.fromkeys(part.noun for part in parts if part.noun)
        return _Kind(" or ".join(nouns), lambda value: any(part.fits(value) for part in parts))
    if kind is Annotated:
        noun, fits = _kind(inner[0])
        # `Between` declares the bounds of a number, or the allowed texts.
        bounds = next((constraint for constraint in inner if isinstance(constraint, Between)), None)
        if bounds is None:
            return _Kind(noun, fits)
        return _Kind(f"{noun}, {bounds.range}", lambda value: fits(value) and not bounds.complaint(value))
    if kind is Literal:
        # The types are compared too, because True == 1 in Python.
        typed_values = [(type(constraint), constraint) for constraint in inner]
        return _Kind(", ".join(map(repr, inner)), lambda value: (type(value), value) in typed_values)
    if kind is Mapping:
        key, entry = map(_kind, inner)
        return _Kind(
            "values by name",
            lambda value: isinstance(value, Mapping) and all(key.fits(k) and entry.fits(v) for k, v in value.items()),
        )
    if kind in (Sequence, Collection, tuple):
        kinds_by_position = [_kind(part) for part in inner] if kind is tuple and Ellipsis not in inner else []
        entry_kind, count = _kind(inner[0]), f"{len(kinds_by_position)} values" if kinds_by_position else "a list"

        def fit(value: Any) -> bool:
            """Return True for a list that fits `kinds_by_position`, or whose every entry fits `entry_kind`."""
            entries = kinds_by_position or [entry_kind] * (len(value) if is_list(value) else 0)
            return is_list(value) and len(value) == len(entries) and all(map(lambda k, v: k.fits(v), entries, value))

        return _Kind(f"{count}, each {entry_kind.noun}" if entry_kind.noun else count, fit)
    if kind in _plain_kinds():
        return _plain_kinds()[kind]
    name = getattr(kind, "__name__", str(kind))
    # The methods of a protocol's object are checked where they are called.
    can_check = isinstance(kind, type) and not getattr(kind, "_is_protocol", False)
    return _Kind(
        f"{'an' if name[0] in 'AEIOU' else 'a'} {name}",
        lambda value: isinstance(value, kind) if can_check else value is not None or not isinstance(kind, type),
    )


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
