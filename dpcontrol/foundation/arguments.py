"""Arguments of Python functions, checked at the edge: a wrong one is refused in a sentence."""

import math
import os
from collections.abc import Sequence
from numbers import Real
from pathlib import Path
from typing import Any

from dpcontrol.foundation.errors import InputError


def number(name: str, value: Any, *, least: float = -math.inf, most: float = math.inf) -> float:
    """Return a finite number within bounds as a float.

    Raises:
        InputError: it is no number, not finite, or out of bounds.
    """
    try:
        given = float(value) if isinstance(value, Real) and not isinstance(value, bool) else math.nan
    except OverflowError:
        given = math.inf
    if not math.isfinite(given) or not least <= given <= most:
        raise InputError(f"{name} = {shortened(value)}: must be {allowed_range('a finite number', least, most)}")
    return given


def whole(name: str, value: Any, *, least: int, most: int) -> int:
    """Return a whole number within bounds.

    Raises:
        InputError: it is none, or out of bounds.
    """
    real = isinstance(value, Real) and not isinstance(value, bool)
    given: Any = value
    if not real or not least <= given <= most or int(given) != given:
        raise InputError(f"{name} = {shortened(value)}: must be {allowed_range('a whole number', least, most)}")
    return int(given)


def numbers(name: str, values: Any, count: int) -> tuple[float, ...]:
    """Return so many finite numbers.

    Raises:
        InputError: they are not so many, or one is none.
    """
    if isinstance(values, str) or not isinstance(values, Sequence) or len(values) != count:
        raise InputError(f"{name} = {shortened(values)}: give {count} numbers")
    return tuple(number(name, value) for value in values)


def path(name: str, value: Any) -> str:
    """Return a path of a file as text.

    Raises:
        InputError: it is no path.
    """
    if not isinstance(value, str | os.PathLike) or isinstance(os.fspath(value), bytes):
        raise InputError(f"{name} = {shortened(value)}: must be the path of a file, as text or a pathlib.Path")
    return str(os.fspath(value))


def place(name: str, value: Any) -> Path | None:
    """Return a path of a file or folder, or None for none.

    Raises:
        InputError: it is neither.
    """
    return None if value is None else Path(path(name, value))


def instance(name: str, value: Any, kinds: type | tuple[type, ...], what: str) -> Any:
    """Return a value that is of one of these kinds; what: their description.

    Raises:
        InputError: it is of another kind.
    """
    if not isinstance(value, kinds):
        raise InputError(f"{name} = {shortened(value)}: must be {what}")
    return value


def allowed_range(kind: str, least: float, most: float) -> str:
    if math.isinf(least) and math.isinf(most):
        return kind
    return f"{kind} of at least {least:g}" if math.isinf(most) else f"{kind} from {least:g} to {most:g}"


def shortened(value: Any) -> str:
    """Return how a value is written, cut where it is long."""
    try:
        text = repr(value)
    except ValueError:
        # Python writes no whole number of more than 4,300 digits.
        return "a number of thousands of digits"
    return text if len(text) <= 40 else f"{text[:40]}…"
