"""Ticks of a log that are not yet written: rows of numbers, checked as they come."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dpcontrol.logs import layout
from dpcontrol.logs.blocks import TickRows

Row = NDArray[np.float64]
Parts = Sequence[Row | None]
"""Rates, estimate, reference, truth and control, in the order of `layout.PARTS`; None for what a tick has not."""


class TickBuffer:
    """Room for `size` ticks of a layout with all its parts; which of them a log has, its first tick decides."""

    def __init__(self, tick: layout.TickLayout, *, rows: int) -> None:
        self.size, self.filled, self.last = rows, 0, 0.0
        self._time = np.zeros(rows)
        self._measured = np.zeros((rows, len(tick.names)))
        self._parts = tuple(np.zeros((rows, width)) for width in tick.widths.values())
        self._widths = tuple(tick.widths.values())
        self._given: tuple[bool, ...] | None = None

    @property
    def full(self) -> bool:
        """Whether no further tick has room."""
        return self.filled == self.size

    @property
    def first(self) -> float:
        """The time of the first tick in s; 0 where there is none."""
        return float(self._time[0]) if self.filled else 0.0

    @property
    def parts(self) -> frozenset[str]:
        """Which of `layout.PARTS` the log has."""
        given = self._given or (False,) * len(layout.PARTS)
        return frozenset(part for part, has in zip(layout.PARTS, given, strict=True) if has)

    @property
    def _wanted(self) -> str:
        joints, size, _, _, width = self._widths
        return (
            f"a tick needs measured and rates ({joints},), estimate, reference and truth ({size},), control ({width},)"
        )

    def put(self, time_s: float, measured: Row, parts: Parts) -> None:
        """Take one tick.

        Raises:
            ValueError: an array of another length, a time before the last, or a part in some ticks only.
        """
        self._decide(parts)
        if not time_s >= self.last:
            raise ValueError(f"tick at {time_s} s after one at {self.last} s")
        row = self.filled
        if len(measured) != self._measured.shape[1]:
            raise ValueError(self._wanted)
        self._measured[row] = measured
        for room, part, width in zip(self._parts, parts, self._widths, strict=True):
            if part is not None:
                if len(part) != width:
                    raise ValueError(self._wanted)
                room[row] = part
        self._time[row] = self.last = time_s
        self.filled = row + 1

    def checked(self, times: Row, measured: Row, parts: Parts) -> list[tuple[Row, Row]]:
        """Return rooms with the rows (K, …) that go into each.

        Raises:
            ValueError: rows of another shape, times that decrease, or a part in some ticks only.
        """
        pairs = [(self._measured, measured)]
        pairs += [(room, part) for room, part in zip(self._parts, parts, strict=True) if part is not None]
        for room, rows in pairs:
            if np.shape(rows) != (len(times), room.shape[1]):
                raise ValueError(f"expected rows of shape {(len(times), room.shape[1])}, got {np.shape(rows)}")
        if len(times) and not (times[0] >= self.last and (np.diff(times) >= 0).all()):
            raise ValueError("the times of ticks must not decrease")
        self._decide(parts)
        return pairs

    def put_rows(self, times: Row, pairs: list[tuple[Row, Row]], *, since: int) -> int:
        """Take rows from `since` on, as many as have room; return how many."""
        count = min(self.size - self.filled, len(times) - since)
        into, rows = slice(self.filled, self.filled + count), slice(since, since + count)
        self._time[into] = times[rows]
        for room, given in pairs:
            room[into] = given[rows]
        self.filled += count
        self.last = float(times[since + count - 1])
        return count

    def taken(self, parts: frozenset[str]) -> TickRows:
        """Return the ticks with these parts; views, good until the next tick comes."""
        count = self.filled
        return TickRows(
            time_ns=np.rint(self._time[:count] * 1e9).astype(np.int64),
            measured=self._measured[:count],
            parts={part: room[:count] for part, room in zip(layout.PARTS, self._parts, strict=True) if part in parts},
        )

    def clear(self) -> None:
        """Make room; the ticks have been written."""
        self.filled = 0

    def _decide(self, parts: Parts) -> None:
        given = tuple(part is not None for part in parts)
        if given == self._given:
            return
        if self._given is not None:
            names = (part for part, a, b in zip(layout.PARTS, given, self._given, strict=True) if a != b)
            raise ValueError(f"{', '.join(names)} must be given in every tick of a run or in none")
        self._given = given
