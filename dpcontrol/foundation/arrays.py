"""Array types by element; docstrings give shapes and meaning."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError, shortened

Array = NDArray[np.float64]
"""Array of floats."""
Flags = NDArray[np.bool_]
"""Array of booleans."""


def true_runs(which: Flags) -> NDArray[np.intp]:
    """Return the uninterrupted runs of true flags (N,) as rows (first, end); `end` is the first index after the run."""
    return np.flatnonzero(np.diff(np.concatenate([[False], which, [False]]).astype(np.int8))).reshape(-1, 2)


def checked_array(name: str, values: Any, width: int | None = None) -> Array:
    """Return real numbers as an array of floats.

    Args:
        name: argument, for the message.
        values: numbers (…) or, given a width, (…, width).
        width: length of the last axis; None for any shape.

    Raises:
        InputError: the values are no real numbers, or their last axis has another length.
    """
    expected = "numbers" if width is None else f"states of {width} numbers"
    try:
        array = np.asarray(values)
    except (TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"{name} = {shortened(values)}: must be {expected}") from error
    if array.dtype.kind not in "iuf" or (width is not None and array.shape[-1:] != (width,)):
        raise InputError(f"{name} = {shortened(values)}: must be {expected}")
    return array.astype(float, copy=False)
