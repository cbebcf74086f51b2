"""Propagation to machine precision: Taylor's method (heyoka), with variational equations and sections.

An integrator is compiled when it is first needed; parameters and inputs are run-time values, so a changed mass
costs nothing. heyoka keeps compiled code on disk between processes.

Source: Biscani & Izzo, Revisiting high-order Taylor methods for astrodynamics and celestial mechanics (2021).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import heyoka as hy
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.dynamics.equations import Equations
from dpcontrol.dynamics.taylor import to_heyoka

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Section:
    """A Poincaré section n·x = offset (+ period · k where the coordinate is an angle), and coordinates on it.

    normal, position (N,): n and the row that gives the section's coordinate q = position · x. momentum (n,): the
    combination of canonical momenta conjugate to q. period: of n·x, or None on a line. side: (N,) and the
    crossing counts only where side · x > 0, or None.
    """

    name: str
    normal: tuple[float, ...]
    position: tuple[float, ...]
    momentum: tuple[float, ...]
    offset: float = 0.0
    period: float | None = None
    side: tuple[float, ...] | None = None

    def height(self, states: Array) -> Array:
        """Return n·x - offset for states (…, N): zero, or a multiple of the period, on the section."""
        return np.asarray(states) @ np.asarray(self.normal) - self.offset

    def admits(self, state: Array) -> bool:
        """Tell whether a crossing at `state` (N,) counts."""
        return self.side is None or float(np.dot(self.side, state)) > 0


@dataclass(frozen=True)
class Crossing:
    """Where a trajectory met a section: state (N,), time in s. None in its place means it never did."""

    state: Array
    time: float


class Propagator:
    """Propagates one set of equations at machine precision.

    Not to be shared between threads: the compiled integrators are reused from call to call.
    """

    def __init__(self, equations: Equations, parameters: ArrayLike) -> None:
        self.equations = equations
        self.parameters = np.asarray(parameters, dtype=float)
        self._sections: dict[Section, Any] = {}

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
        return hy.taylor_adaptive(system, [0.0] * self.equations.dimension, compact_mode=True, time=0.0, **options)

    @cached_property
    def _plain(self) -> Any:
        return self._compile(self.taylor_system)

    @cached_property
    def _variational(self) -> Any:
        return self._compile(hy.var_ode_sys(self.taylor_system, args=hy.var_args.vars, order=1))

    def _with_section(self, section: Section) -> Any:
        if section not in self._sections:
            states = [state for state, _ in self.taylor_system]
            height: Any = sum((n * x for n, x in zip(section.normal, states, strict=True) if n), hy.expression(0.0))
            if section.offset:
                height = height - section.offset
            event = height if section.period is None else hy.sin(height * (np.pi / section.period))
            self._sections[section] = self._compile(self.taylor_system, t_events=[hy.t_event(event)])
        return self._sections[section]

    def _start(self, integrator: Any, state: ArrayLike, inputs: ArrayLike | None) -> None:
        integrator.time = 0.0
        n = self.equations.dimension
        integrator.state[:n] = state
        values = self.parameters
        if self.equations.input_count:
            given = np.zeros(self.equations.input_count) if inputs is None else np.atleast_1d(inputs)
            values = np.concatenate([values, given])
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

    def crossing(self, state: ArrayLike, section: Section, *, longest: float, hit: int = 1) -> Crossing | None:
        """Return the `hit`-th crossing of the section within `longest` seconds (negative: backward), or None."""
        integrator = self._with_section(section)
        self._start(integrator, state, None)
        integrator.reset_cooldowns()
        seen = 0
        while True:
            outcome = integrator.propagate_until(float(longest))[0]
            # A stopping terminal event reports -1 - its index; everything else ends the search.
            if int(outcome) != -1:
                return None
            if section.admits(integrator.state):
                seen += 1
                if seen == hit:
                    return Crossing(integrator.state.copy(), float(integrator.time))

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
