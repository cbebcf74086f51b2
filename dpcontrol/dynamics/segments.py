"""Many short trajectories at once, each with its state-transition matrix: the segments of multiple shooting.

Eight segments share each vector instruction, which makes one four times cheaper than flown alone; a solve with 128
symbols flies five thousand of them at every step.
"""

from functools import cached_property
from typing import Any

import heyoka as hy
import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Propagator

Array = NDArray[np.float64]

LANES = 8


class SegmentPropagator:
    """Flies batches of segments of one set of equations; compiled when first used, not shared between threads."""

    def __init__(self, propagator: Propagator) -> None:
        self.propagator = propagator

    @cached_property
    def _variational(self) -> Any:
        system = hy.var_ode_sys(self.propagator.taylor_system, args=hy.var_args.vars, order=1)
        return self._compile(system)

    @cached_property
    def _plain(self) -> Any:
        return self._compile(self.propagator.taylor_system)

    def _compile(self, system: Any) -> Any:
        n = self.propagator.equations.dimension
        tolerance = self.propagator.tolerance
        integrator = hy.taylor_adaptive_batch(system, np.zeros((n, LANES)), tol=tolerance, compact_mode=True)
        # Parameters that the equations never use are not part of the compiled code.
        integrator.pars[:] = self.propagator.parameters[: len(integrator.pars), None]
        return integrator

    def flows(self, states: Array, durations: Array) -> Array:
        """Return the states (K, N) to which `states` (K, N) flow in `durations` (K,) s.

        Raises:
            ArithmeticError: a state became infinite or undefined.
        """
        return self._flown(self._plain, states, durations)

    def flows_with_stm(self, states: Array, durations: Array) -> tuple[Array, Array]:
        """Return the states (K, N) after `durations` (K,) s and the state-transition matrices (K, N, N) to them.

        Raises:
            ArithmeticError: a state became infinite or undefined.
        """
        n = self.propagator.equations.dimension
        out = self._flown(self._variational, states, durations)
        return out[:, :n].copy(), out[:, n:].reshape(-1, n, n).copy()

    def _flown(self, integrator: Any, states: Array, durations: Array) -> Array:
        n = self.propagator.equations.dimension
        out = np.empty((len(states), integrator.state.shape[0]))
        if not (np.isfinite(states).all() and np.isfinite(durations).all()):
            raise ArithmeticError("a segment starts from a state, or lasts a time, that is not finite")
        identity = np.eye(n).reshape(-1, 1)
        for first in range(0, len(states), LANES):
            # A last batch that is not full flies its last segment again.
            which = np.minimum(np.arange(first, first + LANES), len(states) - 1)
            integrator.set_time(0.0)
            integrator.state[:n] = states[which].T
            if integrator.is_variational:
                integrator.state[n:] = identity
            integrator.propagate_until(durations[which])
            if any(result[0] != hy.taylor_outcome.time_limit for result in integrator.propagate_res):
                raise ArithmeticError(f"a segment of {np.max(np.abs(durations[which])):g} s could not be flown")
            out[which] = integrator.state.T
        return out
