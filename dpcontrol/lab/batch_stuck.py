"""Stuck sensors of many runs in lockstep: `StuckWatch` on arrays (n+1, S)."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dpcontrol.lab.stuck import SAME, StuckWatch

Array = NDArray[np.float64]


class BatchStuck:
    """Watches the sensors of S runs; one `StuckWatch` holds the bounds and finds the words."""

    def __init__(self, arms: int, *, period: float, reaction: float, runs: int) -> None:
        self._one = one = StuckWatch(arms, period=period, reaction=reaction)
        shape = (arms + 1, runs)
        self._arms, self._period = arms, period
        self._still = np.array(one.still)[:, None]
        self._least, self._doubt = np.array(one.least)[:, None], np.array(one.doubt)[:, None]
        self._last, self._steps = np.full(shape, np.nan), np.full(shape, np.inf)
        self._same, self._begin, self._moved = np.zeros(shape, dtype=int), np.zeros(shape), np.zeros(shape)
        self._sent = np.zeros(runs)

    def seen(self, positions: Array, wanted: Array, sent: Array, nis: Array) -> Mapping[int, str]:
        """Return what is stuck by the number of the run.

        positions (n+1, S): absolute angles and the carts' positions; wanted (n, 1) or (n, S): the references' angles;
        sent (S,) m/s: the velocities that the carts were sent to; nis (S,): their means of late, for each position.
        """
        n, one = self._arms, self._one
        self._sent = self._sent + sent * self._period
        value, should = positions.copy(), np.empty_like(positions)
        value[1:n] -= positions[: n - 1]
        should[:n] = wanted
        should[1:n] -= wanted[: n - 1]
        should[n] = self._sent
        step = np.abs(value - self._last)
        same = step < SAME
        new = ~same
        self._last = np.where(new, value, self._last)
        self._begin = np.where(new, should, self._begin)
        self._moved = np.maximum(self._moved, np.abs(should - self._begin)) * same
        self._steps = np.where(new & (step < self._steps), step, self._steps)
        self._same = (self._same + 1) * same
        still = (self._same >= self._still) & (self._moved >= self._least) & ~(nis <= self._doubt)
        if not still.any():
            return {}
        out: dict[int, str] = {}
        for i, lane in zip(*np.nonzero(still), strict=True):
            if int(lane) not in out:
                words = one.told(
                    int(i), same=int(self._same[i, lane]), moved=float(self._moved[i, lane]),
                    step=float(self._steps[i, lane]),
                )  # fmt: skip
                if words:
                    out[int(lane)] = words
        return out
