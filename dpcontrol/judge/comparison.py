"""Several runs on one clock, aligned at a symbol.

The clocks agree at the crossing of the symbol's section.

The crossing time is decoded from the run's true angles, or from the estimated ones if the truth is unknown. For a
symbol without a section, or one that the run did not complete, the plan's time is used. A log without a plan is aligned
at its start. The comparison's status reports the method used for each run.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.shown import Shown
from dpcontrol.judge.run_view import RunView

MOST = 6
"""Largest number of runs in a comparison: as many have distinct colours."""


@dataclass(frozen=True)
class ComparedRun:
    """A run on the common clock of a comparison.

    Attributes:
        name: file name, numbered if another run has the same.
        view: the run on the common clock.
        delay: shift of its clock, s.
        aligned_by: phrase on the alignment.
    """

    name: str
    view: RunView
    delay: float
    aligned_by: str


@dataclass(frozen=True)
class RunComparison(Shown, Documented):
    """Runs on one clock, aligned at a symbol, which counts from 1 and whose time is in s.

    Attributes:
        runs: runs with their names and views, in order.
        symbol: number of the symbol at which they are aligned, from 1.
        moment: time of this symbol on the common clock, s.
    """

    KEYS: ClassVar[str] = "symbol moment status runs=runs.name"

    runs: tuple[ComparedRun, ...]
    symbol: int
    moment: float

    @property
    def status(self) -> str:
        """Sentence on the alignment of the runs."""
        alignment = [f"{run.name} {run.aligned_by}" for run in self.runs]
        return f"aligned at symbol {self.symbol}, at {self.moment:.3f} s: {'; '.join(alignment)}"

    @property
    def title(self) -> str:
        """Title of the page."""
        titles = list(dict.fromkeys(run.view.title.split(" — ")[0] for run in self.runs))
        return f"{len(self.runs)} runs: {titles[0]}" if len(titles) == 1 else f"{len(self.runs)} runs compared"

    @property
    def span(self) -> tuple[float, float]:
        """Range of the runs and their plans on the clock, s."""
        ends = [run.view.span for run in self.runs]
        return min(begin for begin, _ in ends), max(end for _, end in ends)


def compare(runs: Sequence[RunView], *, symbol: int = 1) -> RunComparison:
    """Return runs on one clock, aligned at a symbol.

    Args:
        runs: views of the runs.
        symbol: number of the symbol in the plans, counted from 1.

    Raises:
        InputError: there are too many runs, their pendulums differ, or the symbol is missing in all.
    """
    if not 1 <= len(runs) <= MOST:
        raise InputError(f"{len(runs)} logs: one picture compares 1 to {MOST}")
    if len({view.arms for view in runs}) > 1:
        raise InputError("the logs are of pendulums with different numbers of arms: compare those that have the same")
    symbol_count = max(len(view.symbols) for view in runs)
    if not 1 <= symbol <= max(symbol_count, 1):
        raise InputError(
            f"--align {symbol}: these runs have symbols 1 to {symbol_count}" if symbol_count else "no log has symbols"
        )
    alignments = [_moment(view, symbol - 1) for view in runs]
    latest, names = max(alignments)[0], [view.path.stem for view in runs]
    names = [name if names.count(name) == 1 else f"{name} ({k})" for k, name in enumerate(names, 1)]
    compared = tuple(
        ComparedRun(name, view.delayed(latest - moment), latest - moment, alignment)
        for name, view, (moment, alignment) in zip(names, runs, alignments, strict=True)
    )
    return RunComparison(compared, symbol, latest)


def _moment(view: RunView, k: int) -> tuple[float, str]:
    """Return the time at which a run is aligned with others, s, and a phrase on how the time was found.

    It is the crossing of the symbol's section if the run has one, otherwise the plan's time of the symbol, otherwise,
    without such a symbol, the run's start.

    Args:
        view: the run.
        k: index of the symbol, from 0.
    """
    crossing_time = view.crossings[k] if k < len(view.crossings) else None
    if crossing_time is not None:
        source = "estimated" if view.what == "estimate" else "true"
        return crossing_time, f"by its decoded crossing ({source} angles)"
    if k < len(view.symbols):
        is_reached = k < len(view.crossings)
        return view.plan.symbols[k][0], f"by its plan's time ({'a swing' if is_reached else 'not done'})"
    return float(view.time[0]), "by its start (no such symbol)"
