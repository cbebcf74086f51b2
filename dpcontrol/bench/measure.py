"""Times of repeated work: processor time of this process on one core, the first call apart.

Processor time leaves out what other programs take of a busy machine. Work shorter than the clock's grain is repeated
within one measurement. The median of the repeats counts. What is to be compared is measured in turns, so that a machine
that slows down for a while slows all of it.
"""

import os
import statistics
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

T = TypeVar("T")
Key = TypeVar("Key", bound=Hashable)

GRAIN = 2e-3
"""s: what one measurement takes at least."""
_FIRST_GUESS = 20
"""Calls from which the time of one short call is guessed."""


@dataclass(frozen=True)
class Timed(Generic[T]):
    """Median seconds of a call, the extra seconds of the first one, and the first one's result.

    yardstick: median seconds of work of scipy alone, in the same rounds; what is measured over it tells less of how
    quick the machine was meanwhile.
    """

    seconds: float
    start_up: float
    result: T
    yardstick: float = 0.0


def timed(
    function: Callable[[], T],
    repeats: int = 5,
    *,
    grain: float = GRAIN,
    most: float = 2.0,
    clock: Callable[[], float] = time.process_time,
) -> Timed[T]:
    """Call `function` once, then in `repeats` measurements of at least `grain` s each.

    most: s after which no further measurement is begun; slow work has little noise.
    clock: seconds; `time.perf_counter` for work that waits (files, other processes).
    """
    return timed_in_turns({None: function}, repeats, grain=grain, most=most, least=1, clock=clock)[None]


def timed_in_turns(
    functions: Mapping[Key, Callable[[], T]],
    rounds: int = 15,
    *,
    grain: float = GRAIN,
    most: float = inf,
    least: int = 3,
    worth: Callable[[T], bool] = lambda _: True,
    starts_up: bool = True,
    clock: Callable[[], float] = time.process_time,
) -> dict[Key, Timed[T]]:
    """Call each function once, then measure all of them once in each of `rounds`, for at least `grain` s each.

    most: s of a function's own after which it is measured no more, if it was `least` times. worth: says of a first
    result whether its time is of interest; else the first call's is all there is. starts_up: False for work that
    compiles nothing, whose first call counts like the others.
    """
    clocks = {key: _Clock(function, grain, clock) for key, function in functions.items()}
    beside: list[float] = []
    for own in clocks.values():
        own.start(worth=worth, starts_up=starts_up)
    for number in range(1, rounds + 1):
        going = [own for own in clocks.values() if own.going and (own.spent < most or len(own.found) < least)]
        for own in going:
            if len(own.found) < number:
                own.measure()
        if going or not beside:
            beside.append(yardstick())
    return {key: own.timed(statistics.median(beside)) for key, own in clocks.items()}


def yardstick() -> float:
    """Return processor seconds of a flight by scipy's DOP853, without anything of this project's."""

    def rate(_: float, x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array([10 * (x[1] - x[0]), x[0] * (28 - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]])

    began = time.process_time()
    solve_ivp(rate, (0.0, 2.0), (1.0, 1.0, 1.0), method="DOP853", rtol=1e-8)
    return time.process_time() - began


class _Clock(Generic[T]):
    """The measurements of one function."""

    def __init__(self, function: Callable[[], T], grain: float, clock: Callable[[], float]) -> None:
        self._function, self._grain, self._clock = function, grain, clock
        self._calls = 1
        self.found: list[float] = []
        self.spent = 0.0
        self.going = True

    def start(self, *, worth: Callable[[T], bool], starts_up: bool) -> None:
        """Make the first call, and find how many calls make a measurement."""
        began = self._clock()
        self._result = self._function()
        self._first = self._clock() - began
        self.going = worth(self._result)
        if not self.going:
            return
        if not starts_up and self._first >= self._grain:
            self._keep(self._first)
            return
        once = self._each(1)
        if once >= self._grain:
            self._keep(once)
            return
        once = self._each(_FIRST_GUESS)
        self._calls = max(1, round(self._grain / once)) if once > 0 else 1000

    def measure(self) -> None:
        """Take one measurement."""
        self._keep(self._each(self._calls))

    def timed(self, beside: float) -> Timed[T]:
        """Return what was found; beside: seconds of the yardstick in the same rounds."""
        seconds = statistics.median(self.found) if self.found else self._first
        return Timed(seconds, max(self._first - seconds, 0.0), self._result, beside)

    def _keep(self, seconds: float) -> None:
        self.found.append(seconds)
        self.spent += seconds * self._calls

    def _each(self, calls: int) -> float:
        began = self._clock()
        for _ in range(calls):
            self._function()
        return (self._clock() - began) / calls


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
