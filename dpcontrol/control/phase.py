"""Where on a periodic motion a state is: the nearest phase, modulo whole turns of the arms.

    τ = argmin |D⁻¹ (x - x*(τ))|,      D: the scale of the pendulum's state, the cart left out

The cart is left out because its position does not depend on the phase. A table of one period is searched, and the best
entry moved along the orbit by lateness = (x - x*) · D⁻² ẋ* / |D⁻¹ ẋ*|².
Source: Hauser & Hindman, Manoeuvre regulation from trajectory tracking, NOLCOS (1995), section 3, for the projection.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.references.problem import ANGLE_SCALE, RATE_SCALE

if TYPE_CHECKING:
    from dpcontrol.references.sustained import SustainedOrbit

Array = NDArray[np.float64]

ENTRIES = 2048
"""Entries of a period: between two of them a straight line errs by 1e-5 rad at the lab's largest accelerations."""
COARSE = 8
"""Every k-th entry is searched before the best one is moved along the orbit."""


def whole_turns(angles: Array) -> Array:
    """Return the angles' nearest multiples of 2π, in rad, same shape."""
    return np.rint(angles / (2 * np.pi)) * (2 * np.pi)


@dataclass(frozen=True, eq=False)
class PhaseTable:
    """One period in s of a motion: states (M+1, N) and inputs (M+1,) m/s² at even times, the last as at time zero."""

    period: float
    states: Array
    inputs: Array

    @property
    def step(self) -> float:
        """Return the time between two entries in s."""
        return self.period / (len(self.states) - 1)

    @property
    def arms(self) -> int:
        """Return the number of arms."""
        return (self.states.shape[1] - 2) // 2

    def state(self, time: float) -> Array:
        """Return the state (N,) at a time in s, counted modulo the period."""
        where = time % self.period / self.step
        k = min(int(where), len(self.states) - 2)
        before = self.states[k]
        return before + (where - k) * (self.states[k + 1] - before)

    def states_at(self, times: Array) -> Array:
        """Return the states (S, N) at times (S,) in s, counted modulo the period."""
        where = np.mod(times, self.period) / self.step
        k = np.minimum(where.astype(int), len(self.states) - 2)
        return self.states[k] + (where - k)[:, None] * (self.states[k + 1] - self.states[k])

    def input(self, time: float) -> float:
        """Return the input in m/s² of the entry next to a time in s, counted modulo the period."""
        return float(self.inputs[round(time % self.period / self.step)])

    def nearest(self, states: ArrayLike) -> tuple[Array, Array, Array]:
        """Return times (…) in s, scaled distances (…) and whole turns (…, n) in rad of the phases nearest to (…, N).

        The distance is the pendulum's only: its largest component, angles by π and rates by 10 rad/s.
        """
        x = np.asarray(states, dtype=float)
        n = self.arms
        flat = x.reshape(-1, x.shape[-1])[:, : 2 * n]
        scale = np.array([ANGLE_SCALE] * n + [RATE_SCALE] * n)
        table = self.states[:-1:COARSE, : 2 * n]
        away = flat[:, None, :] - table[None, :, :]
        away[..., :n] -= whole_turns(away[..., :n])
        best = np.argmin(np.square(away / scale).sum(-1), axis=1)
        rows = np.arange(len(flat))
        rate = self._rates(best * COARSE)
        late = (away[rows, best] * rate / scale**2).sum(1) / np.square(rate / scale).sum(1)
        late = np.clip(late, -COARSE * self.step, COARSE * self.step)
        times = np.mod(best * COARSE * self.step + late, self.period)
        here = np.array([self.state(t)[: 2 * n] for t in times])
        turns = whole_turns(flat[:, :n] - here[:, :n])
        distance = np.abs((flat - here - np.hstack([turns, np.zeros_like(turns)])) / scale).max(1)
        shape = x.shape[:-1]
        return times.reshape(shape), distance.reshape(shape), turns.reshape(*shape, n)

    def _rates(self, index: NDArray[np.intp]) -> Array:
        """Return the pendulum's rates of change (K, 2n) at entries, by central differences."""
        count, n = len(self.states) - 1, 2 * self.arms
        return (self.states[(index + 1) % count, :n] - self.states[(index - 1) % count, :n]) / (2 * self.step)


def phase_table(orbit: "SustainedOrbit", *, entries: int = ENTRIES) -> PhaseTable:
    """Return one period of a sustained orbit."""
    times = np.arange(entries + 1) / entries * orbit.period
    states = orbit.state(times)
    states[-1] = states[0]
    return PhaseTable(orbit.period, states, orbit.input(times))
