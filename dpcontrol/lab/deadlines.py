"""How well a loop kept time on a rig: what it missed, what was lost on the way, and how long answers took."""

import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass

import numpy as np


@contextmanager
def without_collecting() -> Iterator[None]:
    """Keep Python from looking for cycles of garbage meanwhile, which takes many milliseconds at a time."""
    was = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


@contextmanager
def real_time_priority() -> Iterator[bool]:
    """Run before all ordinary work meanwhile (SCHED_FIFO); yield whether the system allowed it.

    For processes that sleep most of the time: one that does not would keep its core to itself.
    """
    try:
        policy, priority = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except (AttributeError, OSError):
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, policy, priority)


@dataclass(frozen=True)
class Deadlines:
    """A run in real time; times in s.

    ticks: of the run; missed: those that began a whole period late or later, so that their commands came too late;
    worst, lateness_99, lateness_median: of how late ticks began. lost: readings that never came; stale: readings that
    came when their tick had passed; held: periods in which the bench had to do with an old command; trip_median,
    trip_99, trip_worst: from a reading leaving the bench to its command arriving there; not-a-number: none arrived.
    """

    ticks: int
    missed: int
    worst: float
    lateness_median: float
    lateness_99: float
    lost: int
    stale: int
    held: int
    trip_median: float
    trip_99: float
    trip_worst: float

    @classmethod
    def of(
        cls, lateness: list[float], trips: list[float], *, missed: int, lost: int, stale: int, held: int
    ) -> "Deadlines":
        """Return the statistics of ticks that began so late (s), of answers that took so long (s), and the counts."""
        late, trip = np.array(lateness or [np.nan]), np.array(trips or [np.nan])
        return cls(
            ticks=len(lateness), missed=missed, worst=float(late.max()), lateness_median=float(np.median(late)),
            lateness_99=float(np.percentile(late, 99)), lost=lost, stale=stale, held=held,
            trip_median=float(np.median(trip)), trip_99=float(np.percentile(trip, 99)), trip_worst=float(trip.max()),
        )  # fmt: skip

    @property
    def sentence(self) -> str:
        """What a user wants to know of it."""
        return (
            f"{self.missed} of {self.ticks} deadlines missed; ticks began up to {1e3 * self.worst:.3g} ms late (99 %: "
            f"{1e3 * self.lateness_99:.3g} ms); {self.lost} readings lost, {self.stale} too late; the bench repeated a "
            f"command {self.held} times; from reading to command {1e3 * self.trip_median:.3g} ms (99 %: "
            f"{1e3 * self.trip_99:.3g} ms)"
        )

    def record(self) -> dict[str, str]:
        """Return the statistics as text by name, for a log's result record."""
        return {f"deadlines_{name}": repr(value) for name, value in asdict(self).items()}
