"""Propagation with an input that is a polynomial of time: one interval of a reference, or a held command.

    ẋ = f(x, u(t); p),      u(t) = Σ_k c_k t^k        (t from the start of the propagation)

The coefficients are run-time values of the compiled integrator, so one compilation serves every interval.
Source of the integrator: Biscani & Izzo, Revisiting high-order Taylor methods for astrodynamics and celestial
mechanics (2021).
"""

from functools import cached_property
from typing import Any

import heyoka as hy
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.dynamics.compiled import to_heyoka
from dpcontrol.dynamics.equations import Equations

Array = NDArray[np.float64]


class PolynomialInputPropagator:
    """Propagates one set of equations at machine precision under inputs of one polynomial degree.

    `degree` 0 holds the input. Not to be shared between threads: the compiled integrator is reused.
    """

    def __init__(self, equations: Equations, parameters: ArrayLike, *, degree: int) -> None:
        self.equations = equations
        self.parameters = np.asarray(parameters, dtype=float)
        self.degree = degree

    @cached_property
    def _integrator(self) -> Any:
        e = self.equations
        states = hy.make_vars(*[f"x{i}" for i in range(e.dimension)])
        inputs = []
        for i in range(e.input_count):
            first = (self.degree + 1) * i
            value: Any = hy.par[first + self.degree]
            for k in reversed(range(self.degree)):
                value = hy.par[first + k] + hy.time * value
            inputs.append(value)
        held = (self.degree + 1) * e.input_count
        parameters = [hy.par[held + i] for i in range(e.parameters.shape[0])]
        rates = to_heyoka(e.function(), [states, inputs, parameters])
        system = list(zip(states, rates, strict=True))
        integrator = hy.taylor_adaptive(system, [0.0] * e.dimension, compact_mode=True, time=0.0)
        # Parameters that the equations never use are not part of the compiled code.
        used = max(len(integrator.pars) - held, 0)
        integrator.pars[held:] = self.parameters[:used]
        return integrator

    @cached_property
    def _views(self) -> tuple[Any, Array, Array]:
        integrator = self._integrator
        return integrator, integrator.state, integrator.pars[: (self.degree + 1) * self.equations.input_count]

    def flow(self, state: ArrayLike, coefficients: ArrayLike, duration: float) -> Array:
        """Return the state (N,) after `duration` seconds.

        coefficients ((degree+1) m,): input by input, from the constant term up.

        Raises:
            ArithmeticError: the state became infinite or undefined.
        """
        integrator, x, c = self._views
        integrator.time = 0.0
        x[:] = state
        c[:] = coefficients
        outcome = integrator.propagate_until(duration)[0]
        if outcome != hy.taylor_outcome.time_limit:
            raise ArithmeticError(f"propagation stopped at t = {integrator.time:g} s: {outcome}")
        return x.copy()

    def sample(self, state: ArrayLike, coefficients: ArrayLike, times: ArrayLike) -> Array:
        """Return the states (K, N) at rising `times` (K,) s, the first of them 0, where `state` holds.

        coefficients as in `flow`.

        Raises:
            ArithmeticError: the state became infinite or undefined.
        """
        integrator, x, c = self._views
        integrator.time = 0.0
        x[:] = state
        c[:] = coefficients
        result = integrator.propagate_grid(np.asarray(times, dtype=float))
        if result[0] != hy.taylor_outcome.time_limit:
            raise ArithmeticError(f"propagation stopped at t = {integrator.time:g} s: {result[0]}")
        return np.array(result[-1])
