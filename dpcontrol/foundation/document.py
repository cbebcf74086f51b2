"""Documents: results as JSON values."""

import math
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np


def picked(result: Any, *names: str) -> dict[str, Any]:
    """Return attributes of a result by name.

    Args:
        result: any object.
        *names: names of its attributes.
    """
    return {name: getattr(result, name) for name in names}


def fields_of(kind: type, record: Any) -> dict[str, Any]:
    """Return the fields of a dataclass from a record, by name.

    Args:
        kind: dataclass that declares the fields.
        record: object with at least these attributes.
    """
    return picked(record, *(field.name for field in fields(kind)))


def plain(value: Any) -> Any:
    """Return `value` as JSON values.

    Arrays become lists, complex numbers [re, im], paths text, and numbers that are not finite null.

    Args:
        value: nested mappings, lists, arrays (…) and scalars.
    """
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, complex | np.complexfloating):
        return [plain(float(value.real)), plain(float(value.imag))]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
