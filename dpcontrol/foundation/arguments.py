"""Checks of arguments in the Python interface."""

import math
import os
from numbers import Real
from pathlib import Path
from typing import Any

from dpcontrol.foundation.errors import InputError


def whole(name: str, value: Any, *, least: int, most: int) -> int:
    """Return a whole number within bounds.

    Args:
        name: argument, for the message.
        value: number given by the user.
        least: lower bound, inclusive.
        most: upper bound, inclusive.

    Raises:
        InputError: the value is not a whole number, or out of bounds.
    """
    real = isinstance(value, Real) and not isinstance(value, bool)
    given: Any = value
    if not real or not least <= given <= most or int(given) != given:
        raise InputError(f"{name} = {shortened(value)}: must be {allowed_range('a whole number', least, most)}")
    return int(given)


def path(name: str, value: Any) -> str:
    """Return the path of a file as text.

    Args:
        name: argument, for the message.
        value: text or `os.PathLike`, not bytes.

    Raises:
        InputError: the value is not a path.
    """
    if not isinstance(value, str | os.PathLike) or isinstance(os.fspath(value), bytes):
        raise InputError(f"{name} = {shortened(value)}: must be the path of a file, as text or a pathlib.Path")
    return str(os.fspath(value))


def place(name: str, value: Any) -> Path | None:
    """Return the path of a file or folder, or None.

    Args:
        name: argument, for the message.
        value: text, `os.PathLike` or None.

    Raises:
        InputError: the value is neither a path nor None.
    """
    return None if value is None else Path(path(name, value))


def allowed_range(kind: str, least: float, most: float) -> str:
    """Return the text of a range of numbers, for messages.

    Args:
        kind: noun, such as "a whole number".
        least: lower bound, inclusive, or -inf for none.
        most: upper bound, inclusive, or inf for none.
    """
    if math.isinf(least) and math.isinf(most):
        return kind
    return f"{kind} of at least {least:g}" if math.isinf(most) else f"{kind} from {least:g} to {most:g}"


def shortened(value: Any) -> str:
    """Return the repr of a value, shortened if it is long.

    Args:
        value: any object.
    """
    try:
        text = " ".join(repr(value).split())
    except ValueError:
        # Python cannot print whole numbers of more than 4,300 digits.
        return "a number of thousands of digits"
    except Exception:  # noqa: BLE001 - the object is the user's, and so is its __repr__
        return f"<{type(value).__name__}>"
    return text if len(text) <= 40 else f"{text[:40]}…"
