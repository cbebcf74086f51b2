"""An estimator whose rates are noisy, as where rates are measured and not estimated: one kind of trouble of a bench.

    what the controller is given at tick k:   x̂ + (0, ν_k, 0),   ν_k ~ N(0, σ²) on the arms' rates

The estimator itself goes on without the noise; only the state that the controller steers by carries it.
Source: Wiebe et al., Open-source dual-purpose acrobot and pendubot platform (IEEE RAM, 2024), section on benchmarking.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.interface import Estimate, Estimator

Array = NDArray[np.float64]


class NoisyRates:
    """An `Estimator` for one run: `inner`, and `noise` (K, n) rad/s on the rates that it predicts at each tick.

    Each update and step is a tick, beginning with tick 0.
    """

    def __init__(self, inner: Estimator, noise: Array) -> None:
        self._inner, self._noise = inner, noise
        self._tick = -1

    @property
    def kind(self) -> str:
        """Return the name of its kind."""
        return self._inner.kind

    @property
    def extra_names(self) -> tuple[str, ...]:
        """Return the names of what it is augmented by."""
        return self._inner.extra_names

    def first(self, state: Array) -> Estimate:
        """Return the estimate before any measurement, at `state` (N,)."""
        return self._inner.first(state)

    def update(
        self, estimate: Estimate, measured: Array, present: NDArray[np.bool_] | None = None, *, coming: float = 0.0
    ) -> Estimate:
        """Return the estimate after the positions `measured` (n+1,); present (n+1,): which of them count."""
        self._tick += 1
        return self._inner.update(estimate, measured, present, coming=coming)

    def step(
        self,
        estimate: Estimate,
        command: float,
        measured: Array,
        present: NDArray[np.bool_] | None = None,
        *,
        coming: float = 0.0,
    ) -> Estimate:
        """Return the estimate a period later: the cart accelerated by `command` m/s², then `measured` came."""
        self._tick += 1
        return self._inner.step(estimate, command, measured, present, coming=coming)

    def ahead(self, estimate: Estimate, commands: Sequence[float]) -> Array:
        """Return the state (N,) after the commands on their way, this tick's noise on its rates.

        Before the first measurement, where only the start is known, there is none.
        """
        state = self._inner.ahead(estimate, commands).copy()
        if self._tick < 0:
            return state
        arms = self._noise.shape[1]
        state[arms : 2 * arms] += self._noise[self._tick]
        return state

    def covariance(self, estimate: Estimate) -> Array:
        """Return the covariance (N+E, N+E) of state and extra."""
        return self._inner.covariance(estimate)

    def restarted(self, estimate: Estimate, measured: Array) -> Estimate:
        """Return an estimate that trusts the positions `measured` (n+1,) and little else: for recovery when lost."""
        return self._inner.restarted(estimate, measured)
