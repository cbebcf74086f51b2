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
        self._soonest = min(one.still)
        self._least, self._doubt = np.array(one.least)[:, None], np.array(one.doubt)[:, None]
        self._last, self._steps = np.full(shape, np.nan), np.full(shape, np.inf)
        self._same, self._begin, self._moved = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self._value, self._should, self._step = np.empty(shape), np.empty(shape), np.empty(shape)
        self._is_same, self._is_new = np.empty(shape, dtype=bool), np.empty(shape, dtype=bool)
        self._sent = np.zeros(runs)

    def seen(
        self, positions: Array, wanted: Array, sent: Array, nis: Array, *, judged: NDArray[np.bool_] | None = None
    ) -> Mapping[int, str]:
        """Return what is stuck by the number of the run.

        positions (n+1, S): absolute angles and the carts' positions; wanted (n, 1) or (n, S): the references' angles;
        sent (S,) m/s: the velocities that the carts were sent to; nis (S,): their means of late, for each position.
        judged (S,): which runs are asked about; all by default.
        """
        n, one = self._arms, self._one
        # In place, and one operation for each thing: this is a tenth of a tick's time.
        value, should, step, same, new = self._value, self._should, self._step, self._is_same, self._is_new
        self._sent += sent * self._period
        value[:] = positions
        value[1:n] -= positions[: n - 1]
        should[:n] = wanted
        should[1:n] -= wanted[: n - 1]
        should[n] = self._sent
        np.subtract(value, self._last, out=step)
        np.abs(step, out=step)
        np.less(step, SAME, out=same)
        np.logical_not(same, out=new)
        np.copyto(self._last, value, where=new)
        np.copyto(self._begin, should, where=new)
        np.fmin(self._steps, step, out=self._steps, where=new)
        should -= self._begin
        np.abs(should, out=should)
        np.maximum(self._moved, should, out=self._moved)
        self._moved *= same
        self._same += 1
        self._same *= same
        if np.maximum.reduce(self._same, axis=None) < self._soonest:
            return {}
        still = (self._same >= self._still) & (self._moved >= self._least) & ~(nis <= self._doubt)
        if judged is not None:
            still &= judged
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
