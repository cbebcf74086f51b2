"""What long work will take, said before it is begun, and how far it is: a function that is called as it goes on.

Costs are predicted from measured rates and are good to a factor of three; more than a stated limit is refused unless it
is asked for by name.
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

from dpcontrol.foundation.errors import InputError, printable, remark

Progress = Callable[[str, float], None]
"""Called with what is being done and how much of it is done (0 to 1)."""


Reporting = Progress | Literal[True] | None
"""Where progress goes: a function, True for a bar on stderr, None for a line on stderr every twenty seconds."""


def no_progress(what: str, done: float) -> None:
    """Ignore progress."""


def part_of(progress: Progress, low: float, high: float) -> Progress:
    """Return a progress that reports into the part of another from `low` to `high`."""

    def report(what: str, done: float) -> None:
        progress(what, low + (high - low) * done)

    return report


@contextmanager
def progress_bar(label: str) -> Iterator[Progress]:
    """Show a progress bar on stderr while the block runs; yields the function to report to.

    Where stderr is no terminal, a line is written every twenty seconds, and one at the end.
    """
    if not sys.stderr.isatty():
        yield lines(label)
        sys.stderr.write(f"{printable(label)}: done\n")
        return
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description:<34}", markup=False), BarColumn(), TextColumn("{task.percentage:>3.0f}%"))
    with Bar(*columns, TimeElapsedColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task(printable(label), total=1.0)

        def report(what: str, done: float) -> None:
            bar.update(task, completed=done, description=printable(what))

        yield report
        bar.update(task, completed=1.0, description=printable(label))


_LINE = 20.0
"""s between lines of progress."""


def lines(label: str) -> Progress:
    """Return a progress that writes a line to stderr every twenty seconds, and nothing about work that takes less."""
    began = last = time.monotonic()

    def report(what: str, done: float) -> None:
        nonlocal last
        if (now := time.monotonic()) - last >= _LINE:
            last = now
            sys.stderr.write(f"{printable(label)}: {printable(what)}, {done:.0%} after {now - began:.0f} s\n")
            sys.stderr.flush()

    return report


MOST_SECONDS, MOST_BYTES = 3600.0, 4e9
"""What is begun without being asked for by name."""
NEVER_SECONDS, NEVER_BYTES = 1e8, 1e13
"""What no one means to begin: to be asked for by name is not advised there."""
SAID_FROM = 60.0
"""s; work that takes longer is announced."""


@contextmanager
def reporting(progress: Reporting, label: str) -> Iterator[Progress]:
    """Yield the function that takes progress, with a bar of this label if one is asked for."""
    if progress is True:
        with progress_bar(label) as report:
            yield report
    else:
        yield progress or lines(label)


@dataclass(frozen=True)
class Cost:
    """What work will take: how much of it there is, in words, its time in s and its memory in bytes.

    key: the setting that makes it long, as the user gave it.
    """

    work: str
    seconds: float
    memory: float
    key: str

    @property
    def sentence(self) -> str:
        """What it will take."""
        return f"{self.key}: {self.work} will take about {_time(self.seconds)} and {_size(self.memory)} of memory"


def announce(cost: Cost, *, yes: bool) -> None:
    """Say what work will take, where that is more than a minute, and refuse what is beyond the limits unless `yes`.

    Raises:
        InputError: it is beyond the limits; says what it will take, and what is allowed.
    """
    if not yes and (cost.seconds > MOST_SECONDS or cost.memory > MOST_BYTES):
        allowed = f"{_time(MOST_SECONDS)} and {_size(MOST_BYTES)} are begun unasked"
        beyond_all = cost.seconds > NEVER_SECONDS or cost.memory > NEVER_BYTES
        remedy = "ask for less" if beyond_all else "ask for less, or give --yes (yes=True in Python)"
        raise InputError(f"{cost.sentence}, and {allowed}; {remedy}")
    if cost.seconds > SAID_FROM:
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
