"""Propagation to machine precision: Taylor's method (heyoka), with variational equations and sections.

An integrator is compiled when it is first needed; parameters and inputs are run-time values, so a changed mass
costs nothing. heyoka keeps compiled code on disk between processes.

Source: Biscani & Izzo, Revisiting high-order Taylor methods for astrodynamics and celestial mechanics (2021).
"""

from functools import cached_property
from typing import Any

import heyoka as hy
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.dynamics.crossings import CrossingFinder
from dpcontrol.dynamics.equations import Equations
from dpcontrol.dynamics.section import Crossing, Section
from dpcontrol.dynamics.taylor import to_heyoka

Array = NDArray[np.float64]


class Propagator:
    """Propagates one set of equations at machine precision.

    tolerance: of a Taylor step, relative; zero for rounding itself, which `crossings` always take. Not to be shared
    between threads: the compiled integrators are reused from call to call.
    """

    def __init__(self, equations: Equations, parameters: ArrayLike, *, tolerance: float = 0.0) -> None:
        self.equations = equations
        self.parameters = np.asarray(parameters, dtype=float)
        self.tolerance = tolerance

    @cached_property
    def taylor_system(self) -> list[tuple[Any, Any]]:
        """The equations in heyoka's form, (variable, rate) pairs: what every integrator is compiled from."""
        e = self.equations
        states = hy.make_vars(*[f"x{i}" for i in range(e.dimension)])
        count = e.parameters.shape[0]
        parameters = [hy.par[i] for i in range(count)]
        inputs = [hy.par[count + i] for i in range(e.input_count)]
        rates = to_heyoka(e.function(), [states, inputs, parameters])
        return list(zip(states, rates, strict=True))

    def _compile(self, system: Any, **options: Any) -> Any:
        # compact_mode compiles ten times faster and runs at most two times slower.
        start = [0.0] * self.equations.dimension
        return hy.taylor_adaptive(system, start, tol=self.tolerance, compact_mode=True, time=0.0, **options)

    @cached_property
    def _plain(self) -> Any:
        return self._compile(self.taylor_system)

    @cached_property
    def _variational(self) -> Any:
        return self._compile(hy.var_ode_sys(self.taylor_system, args=hy.var_args.vars, order=1))

    @cached_property
    def _finder(self) -> CrossingFinder:
        return CrossingFinder(self.taylor_system, self._values(None))

    def _values(self, inputs: ArrayLike | None) -> Array:
        """Return parameters and inputs, zero if not given, as the compiled code takes them."""
        if not self.equations.input_count:
            return self.parameters
        given = np.zeros(self.equations.input_count) if inputs is None else np.atleast_1d(inputs)
        return np.concatenate([self.parameters, given])

    def _start(self, integrator: Any, state: ArrayLike, inputs: ArrayLike | None) -> None:
        integrator.time = 0.0
        n = self.equations.dimension
        integrator.state[:n] = state
        values = self._values(inputs)
        # Parameters that the equations never use are not part of the compiled code.
        integrator.pars[:] = values[: len(integrator.pars)]
        if integrator.is_variational:
            integrator.state[n:] = np.eye(n).ravel()

    def flow(self, state: ArrayLike, duration: float, *, inputs: ArrayLike | None = None) -> Array:
        """Return the state (N,) after `duration` seconds (negative: before), inputs (m,) held.

        Raises:
            ArithmeticError: the state became infinite or undefined.
        """
        integrator = self._plain
        self._start(integrator, state, inputs)
        outcome = integrator.propagate_until(float(duration))[0]
        if outcome != hy.taylor_outcome.time_limit:
            raise ArithmeticError(f"propagation stopped at t = {integrator.time:g} s: {outcome}")
        return integrator.state.copy()

    def flow_with_stm(self, state: ArrayLike, duration: float) -> tuple[Array, Array]:
        """Return the state (N,) after `duration` seconds and the state-transition matrix (N, N) to it.

        Raises:
            ArithmeticError: the state became infinite or undefined.
        """
        integrator = self._variational
        n = self.equations.dimension
        self._start(integrator, state, None)
        outcome = integrator.propagate_until(float(duration))[0]
        if outcome != hy.taylor_outcome.time_limit:
            raise ArithmeticError(f"propagation stopped at t = {integrator.time:g} s: {outcome}")
        return integrator.state[:n].copy(), integrator.state[n:].reshape(n, n).copy()

    def sample(self, state: ArrayLike, times: ArrayLike) -> Array:
        """Return the states (K, N) at monotonic `times` (K,) s from `state` at time zero.

        Raises:
            ArithmeticError: the state became infinite or undefined.
        """
        grid = np.asarray(times, dtype=float)
        if grid.size == 0:
            return np.empty((0, self.equations.dimension))
        if grid[0] != 0.0:
            grid = np.concatenate([[0.0], grid])
        integrator = self._plain
        self._start(integrator, state, None)
        result = integrator.propagate_grid(grid)
        if result[0] != hy.taylor_outcome.time_limit:
            raise ArithmeticError(f"propagation stopped at t = {integrator.time:g} s: {result[0]}")
        states = np.array(result[-1])
        return states if np.size(times) == len(states) else states[1:]

    def crossings(self, states: ArrayLike, section: Section, *, longest: float, hit: int = 1) -> list[Crossing | None]:
        """Return each state's (K, N) `hit`-th crossing of the section within `longest` s (negative: backward), or None.

        Flown many at once, which is four times cheaper than one by one; a result does not depend on its companions.
        """
        many = np.asarray(states, dtype=float).reshape(-1, self.equations.dimension)
        return self._finder.find(many, section, longest=float(longest), hit=hit)

    def crossing(self, state: ArrayLike, section: Section, *, longest: float, hit: int = 1) -> Crossing | None:
        """Return the `hit`-th crossing of the section within `longest` seconds (negative: backward), or None."""
        # An integrator for one state alone takes 0.6 times as long per flight, but has to be compiled as well.
        return self.crossings(state, section, longest=longest, hit=hit)[0]

    def sample_with_stm(self, state: ArrayLike, times: ArrayLike) -> tuple[Array, Array]:
        """Return states (K, N) and state-transition matrices (K, N, N) at monotonic `times` (K,) from zero.

        Raises:
            ArithmeticError: the state became infinite or undefined.
        """
        integrator = self._variational
        n = self.equations.dimension
        states, matrices = [], []
        self._start(integrator, state, None)
        for time in np.asarray(times, dtype=float):
            outcome = integrator.propagate_until(float(time))[0]
            if outcome != hy.taylor_outcome.time_limit:
                raise ArithmeticError(f"propagation stopped at t = {integrator.time:g} s: {outcome}")
            states.append(integrator.state[:n].copy())
            matrices.append(integrator.state[n:].reshape(n, n).copy())
        return np.array(states).reshape(-1, n), np.array(matrices).reshape(-1, n, n)
