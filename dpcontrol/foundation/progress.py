"""Progress of long work: a function that is called as the work goes on."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from dpcontrol.foundation.errors import printable

Progress = Callable[[str, float], None]
"""Called with what is being done and how much of it is done (0 to 1)."""


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

    Where stderr is no terminal, only the end is reported.
    """
    if not sys.stderr.isatty():
        yield no_progress
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
