"""The equations' rate for other integrators, which call it tens of thousands of times."""

from collections.abc import Callable

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.dynamics.equations import Equations

Rate = Callable[[ArrayLike, ArrayLike, ArrayLike], NDArray[np.float64]]


def quick_rate(equations: Equations) -> Rate:
    """Return (state, inputs, parameters) -> rate (N,), called on memory of its own.

    casadi's conversions of arguments take forty times as long as the function itself.
    """
    function = ca.Function(
        "rate", [equations.state, equations.inputs, equations.parameters], [ca.densify(equations.rate)]
    )
    arguments = [np.zeros(function.size1_in(i)) for i in range(3)]
    out = np.zeros(function.numel_out(0))
    buffer, run = function.buffer()
    for k, array in enumerate(arguments):
        if array.size:
            buffer.set_arg(k, memoryview(array.data))
    buffer.set_res(0, memoryview(out.data))

    def rate(
        state: ArrayLike, inputs: ArrayLike, parameters: ArrayLike, kept: object = (function, buffer)
    ) -> NDArray[np.float64]:
        # The run points into the buffer, which owns nothing: what it reads must live as long as this.
        for array, value in zip(arguments, (state, inputs, parameters), strict=True):
            array[:] = value
        run()
        return out.copy()

    return rate
