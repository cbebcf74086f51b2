"""Documents: what results are in JSON's terms."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np


def picked(result: Any, *names: str) -> dict[str, Any]:
    """Return attributes of a result by name."""
    return {name: getattr(result, name) for name in names}


def plain(value: Any) -> Any:
    """Return `value` in JSON's terms: arrays as lists, complex numbers as [re, im], what is not finite as null."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, complex | np.complexfloating):
        return [plain(float(value.real)), plain(float(value.imag))]
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
