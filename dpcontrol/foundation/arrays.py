"""Array types by element; docstrings give shapes and meaning."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Array of floats."""
Flags = NDArray[np.bool_]
"""Array of booleans."""
