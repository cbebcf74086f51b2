"""Progress of long work: a function that is called as the work goes on."""

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Called with what is being done and how much of it is done (0 to 1)."""


def no_progress(what: str, done: float) -> None:
    """Ignore progress."""


def part_of(progress: Progress, low: float, high: float) -> Progress:
    """Return a progress that reports into the part of another from `low` to `high`."""

    def report(what: str, done: float) -> None:
        progress(what, low + (high - low) * done)

    return report
