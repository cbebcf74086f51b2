"""Times of repeated work with the first call separate, as processor time of this process on one core.

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
from timeit import Timer
from typing import Any, Generic, TypeVar

from dpcontrol.bench.chart import Diagram, Missing, Point
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.progress import Progress, no_progress

T = TypeVar("T")
Key = TypeVar("Key", bound=Hashable)

GRAIN = 2e-3
"""Least duration of a measurement, s."""


@dataclass
class TimedWork(Generic[T]):
    """Times of a function's calls.

    Attributes:
        first: seconds of the first call.
        result: result of the first call.
        calls: calls per measurement.
        times: seconds of each measurement.
    """

    first: float
    result: T
    calls: int = 1
    times: list[float] = field(default_factory=list)

    @property
    def seconds(self) -> float:
        """Median seconds of a call."""
        return statistics.median(self.times) / self.calls if self.times else self.first


def timed_in_turns(
    functions: Mapping[Key, Callable[[], T]],
    rounds: int = 31,
    *,
    most: float = inf,
    least: int = 3,
    worth: Callable[[Key, T], bool] = lambda key, result: True,
    starts_up: bool = True,
    clock: Callable[[], float] = time.process_time,
    progress: Progress = no_progress,
) -> dict[Key, TimedWork[T]]:
    """Call each function once, then measure all in turns, so that a slow phase of the processor affects each of them.

    A measurement calls the function as often as it takes to last `GRAIN` s. The first one counts as the first round.

    Args:
        functions: works by key.
        rounds: measurements of each function.
        most: measuring time of a function, s, after which it is skipped once measured `least` times.
        least: measurements before a function can be skipped.
        worth: decides by key and first result; without worth the first call is the only one.
        starts_up: False for work without compilation, whose first call counts like the others.
        clock: function that returns a time, s.
        progress: called at each first call and each round.
    """
    works: dict[Key, TimedWork[T]] = {}
    timers: dict[Key, Timer] = {}
    for k, (key, function) in enumerate(functions.items()):
        progress(f"first call {k + 1} of {len(functions)}", k / len(functions) / (rounds + 1))
        start = clock()
        result = function()
        work = works[key] = TimedWork(clock() - start, result)
        if worth(key, result):
            timers[key] = Timer(function, timer=clock)
            seconds = timers[key].timeit(1) if starts_up or work.first < GRAIN else work.first
            while seconds < GRAIN:
                work.calls *= 2
                seconds = timers[key].timeit(work.calls)
            work.times.append(seconds)
    for number in range(1, rounds + 1):
        progress(f"round {number} of {rounds}", number / (rounds + 1))
        for key, timer in timers.items():
            work = works[key]
            if len(work.times) < number and (sum(work.times) < most or len(work.times) < least):
                work.times.append(timer.timeit(work.calls))
    return works


@contextmanager
def one_core() -> Iterator[None]:
    """Restrict this process to one core while the block runs, if the system allows it."""
    former_cores = os.sched_getaffinity(0) if hasattr(os, "sched_setaffinity") else set()
    if former_cores:
        os.sched_setaffinity(0, {max(former_cores)})
    try:
        yield
    finally:
        if former_cores:
            os.sched_setaffinity(0, former_cores)


@dataclass(frozen=True)
class Alternative(Generic[T]):
    """A method at one setting, whose work is timed.

    Attributes:
        method: name of the method.
        setting: its setting.
        work: function that does the work.
        default: True for the package's choice.
        units: units of work in one call; a point's time is that of one unit.
    """

    method: str
    setting: str
    work: Callable[[], T]
    default: bool = False
    units: float = 1.0


@dataclass(frozen=True)
class Judged:
    """Judgement of a result.

    Attributes:
        error: error of the result.
        others: further measures by name.
        note: a few words for display.
    """

    error: float
    others: Mapping[str, float] = field(default_factory=dict)
    note: str = ""


def compare(
    alternatives: Sequence[Alternative[T]], judge: Callable[[Alternative[T], T], Judged | str], **turns: Any
) -> Diagram:
    """Time alternatives in turns and judge their first results.

    If the judgement is a text, the point is missing for this reason. Work that raises an ArithmeticError, RuntimeError
    or GoalMissed has no point.

    Args:
        alternatives: works to time.
        judge: function of an alternative and its first result.
        **turns: further arguments of `timed_in_turns`.

    Returns:
        The points as a diagram without a title.
    """
    judgements: dict[int, Judged | str] = {}

    def tried(work: Callable[[], T]) -> T | Exception:
        """Return the result of a work, or the exception of an expected kind by which it failed."""
        try:
            return work()
        except (ArithmeticError, RuntimeError, GoalMissed) as failure:
            return failure

    def worth(k: int, result: T | Exception) -> bool:
        """Judge the first result of alternative k, and return True if it is worth timing.

        The judgement, or the text of a failure, is stored in `judgements`; a text makes the point missing.
        """
        failed = isinstance(result, Exception)
        judgements[k] = str(result).splitlines()[0][:200] if failed else judge(alternatives[k], result)
        return not isinstance(judgements[k], str)

    works = {k: partial(tried, alternative.work) for k, alternative in enumerate(alternatives)}
    timed_works = timed_in_turns(works, worth=worth, **turns)
    points, missing = [], []
    for k, alternative in enumerate(alternatives):
        judgement, timed_work = judgements[k], timed_works[k]
        if isinstance(judgement, str):
            missing.append(Missing(alternative.method, alternative.setting, judgement))
            continue
        display = {"note": judgement.note, "others": judgement.others}
        points.append(
            Point(
                alternative.method,
                alternative.setting,
                timed_work.seconds / alternative.units,
                judgement.error,
                alternative.default,
                **display,
            )
        )
    return Diagram("", "", "", tuple(points), tuple(missing))
