"""Arrays by what they hold; their shapes stand in docstrings, beside what they are."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Of real numbers."""
Flags = NDArray[np.bool_]
"""Of truths."""
