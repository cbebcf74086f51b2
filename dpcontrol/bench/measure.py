"""Times of repeated work: processor time of this process on one core, the first call apart.

Processor time leaves out what other programs take of a busy machine. Work shorter than the clock's grain is repeated
within one measurement. The median of the repeats counts.
"""

import os
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")

GRAIN = 2e-3
"""s: what one measurement takes at least."""


@dataclass(frozen=True)
class Timed(Generic[T]):
    """Median seconds of a call, the extra seconds of the first one, and the first one's result."""

    seconds: float
    start_up: float
    result: T


def timed(
    function: Callable[[], T],
    repeats: int = 5,
    *,
    grain: float = GRAIN,
    most: float = 2.0,
    starts_up: bool = True,
    clock: Callable[[], float] = time.process_time,
) -> Timed[T]:
    """Call `function` once, then in `repeats` measurements of at least `grain` s each.

    most: s after which no further measurement is begun; slow work has little noise. starts_up: False for work that
    compiles nothing, whose first call counts like the others.
    clock: seconds; `time.perf_counter` for work that waits (files, other processes).
    """
    began = clock()
    result = function()
    first = clock() - began
    if not starts_up and first >= most:
        return Timed(first, 0.0, result)
    began = clock()
    function()
    spent = clock() - began
    calls = max(1, round(grain / spent)) if spent > 0 else 1000
    # A call as long as all the repeats need not be made once more.
    measured = [spent] if calls == 1 else []
    ends = began + most
    while len(measured) < repeats and not (measured and clock() > ends):
        began = clock()
        for _ in range(calls):
            function()
        measured.append((clock() - began) / calls)
    seconds = statistics.median(measured)
    return Timed(seconds, max(first - seconds, 0.0), result)


@contextmanager
def one_core() -> Iterator[None]:
    """Keep this process on one core while the block runs, where the system allows it."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)
