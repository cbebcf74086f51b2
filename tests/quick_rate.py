"""A fast function of the equations' rate for other integrators, and flights by scipy."""

from collections.abc import Callable

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp

from dpcontrol.dynamics.equations import Equations
from dpcontrol.dynamics.system import System

Rate = Callable[[ArrayLike, ArrayLike, ArrayLike], NDArray[np.float64]]


def quick_rate(equations: Equations) -> Rate:
    """Return the function (state, inputs, parameters) -> rate (N,) with preallocated memory.

    The conversion of casadi's arguments takes forty times as long as the function.
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
        # The buffer does not own the arrays, so they must have the same lifetime.
        for array, value in zip(arguments, (state, inputs, parameters), strict=True):
            array[:] = value
        run()
        return out.copy()

    return rate


def flown_by_scipy(system: System, state: ArrayLike, seconds: float) -> NDArray[np.float64]:
    """Return the state (N,) after a flight of `seconds` s, which may be negative, by DOP853."""
    rate, numbers = quick_rate(system.equations), system.parameters
    solution = solve_ivp(
        lambda _, x: rate(x, [], numbers), (0, seconds), state, method="DOP853", rtol=1e-12, atol=1e-12
    )
    return solution.y[:, -1]
