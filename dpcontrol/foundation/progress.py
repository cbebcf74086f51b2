"""Progress reports of long work, and its predicted cost before it starts.

Costs are predicted from measured rates, within a factor of three. Work beyond a limit is rejected unless the user
confirms it.
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Literal

from dpcontrol.foundation.errors import InputError, printable, remark
from dpcontrol.foundation.parts import Later

rich = Later("rich.progress")

Progress = Callable[[str, float], None]
"""Function that receives the current task and its completed fraction (0 to 1)."""


Reporting = Progress | Literal[True] | None
"""Progress output: a function, True for a bar on stderr, None for a line on stderr every twenty seconds."""


def no_progress(what: str, done: float) -> None:
    """Ignore progress.

    Args:
        what: the current task.
        done: its completed fraction, 0 to 1.
    """


def part_of(progress: Progress, low: float, high: float) -> Progress:
    """Return a progress function for a part of the work.

    It maps 0 to 1 to the range from `low` to `high`.

    Args:
        progress: progress function of the whole work.
        low: completed share of the whole work at the start of the part, 0 to 1.
        high: completed share of the whole work at the end of the part, 0 to 1.
    """

    def report(what: str, done: float) -> None:
        progress(what, low + (high - low) * done)

    return report


@contextmanager
def progress_bar(label: str) -> Iterator[Progress]:
    """Show a progress bar on stderr, and yield its function.

    The bar lasts for the block.

    If stderr is not a terminal, a line is written every twenty seconds, and one at the end.

    Args:
        label: text before the bar.
    """
    if not sys.stderr.isatty():
        yield lines(label)
        _write_line(f"{printable(label)}: done")
        return
    columns = (
        rich.TextColumn("{task.description:<34}", markup=False),
        rich.BarColumn(),
        rich.TextColumn("{task.percentage:>3.0f}%"),
        rich.TimeElapsedColumn(),
    )
    with rich.Progress(*columns, console=rich.Console(stderr=True)) as bar:
        task = bar.add_task(printable(label), total=1.0)

        def report(what: str, done: float) -> None:
            bar.update(task, completed=done, description=printable(what))

        yield report
        bar.update(task, completed=1.0, description=printable(label))


_LINE = 20.0
"""Interval between lines of progress, s."""


def lines(label: str) -> Progress:
    """Return a progress function that writes lines to stderr.

    It writes one every twenty seconds.

    Args:
        label: begin of each line.
    """
    began = last = time.monotonic()

    def report(what: str, done: float) -> None:
        nonlocal last
        if (now := time.monotonic()) - last >= _LINE:
            last = now
            _write_line(f"{printable(label)}: {printable(what)}, {done:.0%} after {now - began:.0f} s")

    return report


def _write_line(text: str) -> None:
    """Write a line to stderr.

    A full disk or a closed reader does not stop the work.
    """
    with suppress(OSError):
        sys.stderr.write(f"{text}\n")
        sys.stderr.flush()


MOST_SECONDS, MOST_BYTES = 3600.0, 4e9
"""Maximum cost of work that starts without confirmation."""
ANNOUNCED_FROM = 60.0
"""Duration beyond which work is announced, s."""


@contextmanager
def reporting(progress: Reporting, label: str) -> Iterator[Progress]:
    """Yield the progress function, with a labelled bar if requested.

    Args:
        progress: a function, True for a bar, None for lines on stderr.
        label: text before the bar or in each line.
    """
    if progress is True:
        with progress_bar(label) as report:
            yield report
    else:
        yield progress or lines(label)


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
        return f"{self.key}: {self.work} will take about {_time(self.seconds)} and {_size(self.memory)} of memory"


def announce(cost: Cost, *, yes: bool) -> None:
    """Announce long work, and reject work beyond the limits.

    Work is long if it takes more than a minute.

    Args:
        cost: predicted cost.
        yes: confirmation of the user, which lifts the limits.

    Raises:
        InputError: the work is beyond the limits.
    """
    if not yes and (cost.seconds > MOST_SECONDS or cost.memory > MOST_BYTES):
        allowed = f"{_time(MOST_SECONDS)} and {_size(MOST_BYTES)}"
        remedy = "reduce the work, or add --yes (yes=True in Python)"
        raise InputError(f"{cost.sentence}; the limit is {allowed}: {remedy}")
    if cost.seconds > ANNOUNCED_FROM:
        remark(cost.sentence)


def _time(seconds: float) -> str:
    for size, unit, above in ((86400.0, "days", 48 * 3600.0), (3600.0, "hours", 5400.0), (60.0, "minutes", 90.0)):
        if seconds >= above:
            return f"{_rounded(seconds / size)} {unit}"
    return f"{_rounded(seconds)} seconds"


def _size(memory: float) -> str:
    return f"{_rounded(memory / 1e9)} GB" if memory >= 1e9 else f"{_rounded(memory / 1e6)} MB"


def _rounded(value: float) -> str:
    return f"{float(f'{value:.2g}'):,.10g}"
