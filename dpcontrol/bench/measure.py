"""Times of repeated work, with the first call separate.

They are processor time of this process on one core.

Processor time excludes other programs on a busy machine. However, a processor can run at half speed, for a tenth of a
second or for many. The candidates are therefore measured in turns, and the median of the repeats counts. Work shorter
than the clock's resolution is repeated within one measurement.
"""

import os
import statistics
import time
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from math import inf
from typing import Any, Generic, TypeVar

from dpcontrol.bench.chart import Diagram, Missing, Point
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.progress import Progress, no_progress

T = TypeVar("T")
Key = TypeVar("Key", bound=Hashable)

GRAIN = 2e-3
"""Least duration of a measurement, s."""
_FIRST_GUESS = 20
"""Number of calls that estimates the time of one short call."""


@dataclass(frozen=True)
class TimedWork(Generic[T]):
    """Median seconds of a call, its start-up, and its first result."""

    seconds: float
    start_up: float
    result: T


def timed_in_turns(
    functions: Mapping[Key, Callable[[], T]],
    rounds: int = 31,
    *,
    grain: float = GRAIN,
    most: float = inf,
    least: int = 3,
    worth: Callable[[Key, T], bool] = lambda key, result: True,
    starts_up: bool = True,
    clock: Callable[[], float] = time.process_time,
    progress: Progress = no_progress,
) -> dict[Key, TimedWork[T]]:
    """Call each function once, then measure all in turns.

    Each of `rounds` measures every function for at least `grain` s.

    Args:
        functions: works by key.
        rounds: measurements of each function.
        grain: shortest measurement, s.
        most: measuring time of a function, s, after which it is skipped once measured `least` times.
        least: measurements before a function can be skipped.
        worth: decides by key and first result; without worth the first call is the only one.
        starts_up: False for work without compilation, whose first call counts like the others.
        clock: function that returns a time, s.
        progress: called at each first call and each round.
    """
    measured = {key: _Measured(function, grain, clock) for key, function in functions.items()}
    for k, (key, own) in enumerate(measured.items()):
        progress(f"first call {k + 1} of {len(measured)}", k / len(measured) / (rounds + 1))
        own.start(worth=partial(worth, key), starts_up=starts_up)
    for number in range(1, rounds + 1):
        progress(f"round {number} of {rounds}", number / (rounds + 1))
        for own in measured.values():
            count, spent = len(own.found), sum(end - begin for begin, end in own.found)
            if own.going and count < number and (spent < most or count < least):
                own.found.append(own.stretch())
    return {key: own.timed() for key, own in measured.items()}


class _Measured(Generic[T]):
    """The measurements of one function: (begin, end) of each, of `calls` calls."""

    def __init__(self, function: Callable[[], T], grain: float, clock: Callable[[], float]) -> None:
        self._function, self._grain, self._clock = function, grain, clock
        self._calls = 1
        self.found: list[tuple[float, float]] = []
        self.going = True

    def start(self, *, worth: Callable[[T], bool], starts_up: bool) -> None:
        """Make the first call, and determine the calls per measurement."""
        self._first = once = self.stretch()
        self._result = self._last
        self.going = worth(self._result)
        if not self.going:
            return
        if starts_up or once[1] - once[0] < self._grain:
            once = self.stretch()
        if once[1] - once[0] >= self._grain:
            self.found.append(once)
            return
        self._calls = _FIRST_GUESS
        begin, end = self.stretch()
        self._calls = max(1, round(self._grain * _FIRST_GUESS / (end - begin))) if end > begin else 1000

    def stretch(self) -> tuple[float, float]:
        """Make the calls of one measurement; return its begin and end."""
        begin = self._clock()
        for _ in range(self._calls):
            self._last = self._function()
        return begin, self._clock()

    def timed(self) -> TimedWork[T]:
        """Return the result of all measurements."""
        first = self._first[1] - self._first[0]
        found = [(end - begin) / self._calls for begin, end in self.found]
        seconds = statistics.median(found) if found else first
        return TimedWork(seconds, max(first - seconds, 0.0), self._result)


@contextmanager
def one_core() -> Iterator[None]:
    """Restrict this process to one core while the block runs.

    This has no effect if the system does not allow it.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


@dataclass(frozen=True)
class Alternative(Generic[T]):
    """A method at one setting.

    Its `work` is timed and does `units` units of a point's time.
    """

    method: str
    setting: str
    work: Callable[[], T]
    default: bool = False
    outside: bool = False
    units: float = 1.0


@dataclass(frozen=True)
class Judged:
    """Judgement of a result: its error, further measures, a note."""

    error: float
    others: Mapping[str, float] = field(default_factory=dict)
    note: str = ""


def compare(
    alternatives: Sequence[Alternative[T]], judge: Callable[[Alternative[T], T], Judged | str], rounds: int = 31,
    *, starts_up: bool = True, **turns: Any,
) -> Diagram:  # fmt: skip
    """Time alternatives in turns and judge their first results.

    If the judgement is a text, the point is missing for this reason. Work that raises an ArithmeticError, RuntimeError
    or GoalMissed has no point.

    Args:
        alternatives: works to time.
        judge: function of an alternative and its first result.
        rounds: see `timed_in_turns`.
        starts_up: see `timed_in_turns`.
        **turns: further arguments of `timed_in_turns`.

    Returns:
        The points as a diagram without a title.
    """
    judged: dict[int, Judged | str] = {}

    def tried(work: Callable[[], T]) -> T | Exception:
        try:
            return work()
        except (ArithmeticError, RuntimeError, GoalMissed) as failure:
            return failure

    def worth(k: int, result: T | Exception) -> bool:
        failed = isinstance(result, Exception)
        judged[k] = str(result).splitlines()[0][:200] if failed else judge(alternatives[k], result)
        return not isinstance(judged[k], str)

    works = {k: partial(tried, one.work) for k, one in enumerate(alternatives)}
    spent = timed_in_turns(works, rounds, worth=worth, starts_up=starts_up, **turns)
    points, missing = [], []
    start_up: dict[str, float] = {}
    for k, one in enumerate(alternatives):
        found, run = judged[k], spent[k]
        if isinstance(found, str):
            missing.append(Missing(one.method, one.setting, found))
            continue
        if starts_up:
            start_up[one.method] = max(start_up.get(one.method, 0.0), run.start_up)
        points.append(
            Point(one.method, one.setting, run.seconds / one.units, found.error, default=one.default,
                  outside=one.outside, note=found.note, others=found.others)
        )  # fmt: skip
    return Diagram("", "", "", tuple(points), start_up, tuple(missing))
