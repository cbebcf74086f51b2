"""Progress reports of long work, and its predicted cost before it starts.

Costs are predicted from measured rates, within a factor of three. Work beyond a limit is rejected unless the user
confirms it.
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from dpcontrol.foundation.errors import InputError, printable, remark
from dpcontrol.foundation.parts import Later

rich = Later("rich.progress")

Progress = Callable[[str, float], None]
"""Function that receives the current task and its completed fraction (0 to 1)."""


if TYPE_CHECKING:
    Reporting: TypeAlias = Any
else:
    Reporting = Progress | Literal[True] | None
"""Progress output: a function, True for a bar on stderr, None for a line on stderr every twenty seconds.

`checked` turns each of them into a function for the body of a public function.
"""


def no_progress(what: str, done: float) -> None:
    """Ignore progress.

    Args:
        what: the current task.
        done: its completed fraction, 0 to 1.
    """


def part_of(progress: Progress, low: float, high: float) -> Progress:
    """Return a progress function for a part of the work, whose 0 to 1 are `low` to `high` of the whole work.

    Args:
        progress: progress function of the whole work.
        low: completed share of the whole work at the start of the part, 0 to 1.
        high: completed share of the whole work at the end of the part, 0 to 1.
    """

    def report(what: str, done: float) -> None:
        """Report the completed share `done` of the part, 0 to 1, to `progress` as a share of the whole work."""
        progress(what, low + (high - low) * done)

    return report


_LINE = 20.0
"""Interval between lines of progress, s."""


def lines(label: str) -> Progress:
    """Return a progress function that writes a line to stderr every twenty seconds.

    Args:
        label: begin of each line.
    """
    start = last = time.monotonic()

    def report(what: str, done: float) -> None:
        """Write a line to stderr if twenty seconds have passed since the `last` one; else the report is dropped."""
        nonlocal last
        # A full disk or a closed reader does not stop the work.
        with suppress(OSError):
            if (now := time.monotonic()) - last >= _LINE:
                last = now
                text = f"{printable(label)}: {printable(what)}, {done:.0%} after {now - start:.0f} s"
                sys.stderr.write(f"{text}\n")
                sys.stderr.flush()

    return report


@contextmanager
def reporting(progress: Progress | Literal[True] | None, label: str) -> Iterator[Progress]:
    """Yield a progress function for the block: the given one, or one that shows a bar or writes lines.

    The bar is on stderr, from the first report to the end of the block. If stderr is not a terminal, a line is written
    every twenty seconds instead.

    Args:
        progress: a function, True for a bar, None for lines on stderr.
        label: text of the bar at its end, or before each line.
    """
    if callable(progress):
        yield progress
        return
    if progress is None or not sys.stderr.isatty():
        yield lines(label)
        return
    columns = (
        rich.TextColumn("{task.description:<34}", markup=False),
        rich.BarColumn(),
        rich.TextColumn("{task.percentage:>3.0f}%"),
        rich.TimeElapsedColumn(),
    )
    bar = rich.Progress(*columns, console=rich.Console(stderr=True))
    task = bar.add_task(printable(label), total=1.0)

    def report(what: str, done: float) -> None:
        """Show the task `what` and its completed share `done`, 0 to 1, in the bar, which the first report starts."""
        bar.start()
        bar.update(task, completed=done, description=printable(what))

    try:
        yield report
        bar.update(task, completed=1.0, description=printable(label))
    finally:
        bar.stop()


MOST_SECONDS, MOST_BYTES = 3600.0, 4e9
"""Maximum cost of work that starts without confirmation."""
ANNOUNCED_FROM = 60.0
"""Duration beyond which work is announced, s."""


@dataclass(frozen=True)
class Cost:
    """Predicted cost of work.

    Attributes:
        key: setting that makes the work long, as the user wrote it.
        work: amount of work, in words.
        seconds: time, s.
        memory: memory, bytes.
    """

    work: str
    seconds: float
    memory: float
    key: str

    @property
    def sentence(self) -> str:
        """The predicted cost in one sentence."""
        return f"{self.key}: {self.work} will take about {_time(self.seconds)} and {size_text(self.memory)} of memory"


def announce(cost: Cost, *, yes: bool, above: float = ANNOUNCED_FROM) -> None:
    """Announce long work, and reject work beyond the limits.

    Args:
        cost: predicted cost.
        yes: confirmation of the user, which lifts the limits.
        above: duration beyond which work is long, s.

    Raises:
        InputError: the work is beyond the limits.
    """
    if not yes and (cost.seconds > MOST_SECONDS or cost.memory > MOST_BYTES):
        allowed = f"{_time(MOST_SECONDS)} and {size_text(MOST_BYTES)}"
        remedy = "reduce the work, or add --yes (yes=True in Python)"
        raise InputError(f"{cost.sentence}; the limit is {allowed}: {remedy}")
    if cost.seconds > above:
        remark(cost.sentence)


def _time(seconds: float) -> str:
    """Return a duration in days, hours, minutes or seconds, in the largest unit that gives a number well above one."""
    for size, unit, above in ((86400.0, "days", 48 * 3600.0), (3600.0, "hours", 5400.0), (60.0, "minutes", 90.0)):
        if seconds >= above:
            return f"{_rounded(seconds / size)} {unit}"
    return f"{_rounded(seconds)} seconds"


def size_text(memory: float) -> str:
    """Return a size of memory as text with its unit, MB or GB.

    Args:
        memory: bytes.
    """
    return f"{_rounded(memory / 1e9)} GB" if memory >= 1e9 else f"{_rounded(memory / 1e6)} MB"


def _rounded(value: float) -> str:
    """Return a number with two significant digits, without an exponent, since predictions are no more accurate."""
    return f"{float(f'{value:.2g}'):,.10g}"
