"""Several runs on one clock: each is delayed so that all cross the section of one symbol at the same moment.

The moment is the run's own crossing, decoded from its true angles, or from the estimated ones where the truth is not
known; for a symbol without a section, or one that was not done, it is the plan's; a log without a plan is taken from
its start. Which it was is said for each run.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dpcontrol.foundation.errors import InputError
from dpcontrol.review import style
from dpcontrol.review.motion import RunView
from dpcontrol.review.series import Chart, Line, Range, charts

MOST = len(style.RUNS)


@dataclass(frozen=True)
class ComparedRun:
    """One of several runs.

    Attributes:
        name: of its file, with a number where another has the same.
        colour: its own.
        view: on the common clock.
        delay: s, by which its own clock was moved.
        aligned_by: a phrase.
    """

    name: str
    colour: str
    view: RunView
    delay: float
    aligned_by: str


@dataclass(frozen=True)
class RunComparison:
    """Runs on one clock, the symbol at which they are aligned (from 1), and when that is, s."""

    runs: tuple[ComparedRun, ...]
    symbol: int
    moment: float

    @property
    def status(self) -> str:
        """How the runs were aligned, in one sentence."""
        said = [f"{run.name} {run.aligned_by}" for run in self.runs]
        return f"aligned at symbol {self.symbol}, at {self.moment:.3f} s: {'; '.join(said)}"

    @property
    def title(self) -> str:
        """A title for a page."""
        titles = list(dict.fromkeys(run.view.title.split(" — ")[0] for run in self.runs))
        return f"{len(self.runs)} runs: {titles[0]}" if len(titles) == 1 else f"{len(self.runs)} runs compared"

    @property
    def span(self) -> Range:
        """From the first begin to the last end of the runs and their plans, s."""
        ends = [run.view.span for run in self.runs]
        return min(begin for begin, _ in ends), max(end for _, end in ends)


def compare(runs: Sequence[RunView], *, symbol: int = 1) -> RunComparison:
    """Return runs on one clock, aligned at a symbol, counted from 1.

    Raises:
        InputError: too many runs, of other pendulums, or none has such a symbol.
    """
    if len(runs) > MOST:
        raise InputError(f"{len(runs)} logs are too many for one picture: compare up to {MOST}")
    if len({view.arms for view in runs}) > 1:
        raise InputError("the logs are of pendulums with different numbers of arms: compare those that have the same")
    most = max(len(view.symbols) for view in runs)
    if not 1 <= symbol <= max(most, 1):
        raise InputError(f"--align {symbol}: these runs have symbols 1 to {most}" if most else "no log has symbols")
    moments = [_moment(view, symbol - 1) for view in runs]
    latest = max(moment for moment, _ in moments)
    names = [view.path.stem for view in runs]
    compared = []
    for k, (view, (moment, said)) in enumerate(zip(runs, moments, strict=True)):
        delay = latest - moment
        name = names[k] if names.count(names[k]) == 1 else f"{names[k]} ({k + 1})"
        compared.append(ComparedRun(name, style.RUNS[k], view.delayed(delay), delay, said))
    return RunComparison(tuple(compared), symbol, latest)


def _moment(view: RunView, k: int) -> tuple[float, str]:
    done = view.crossings[k] if k < len(view.crossings) else None
    if done is not None:
        known = "estimated" if view.what == "estimate" else "true"
        return done, f"by its own crossing ({known} angles)"
    if k < len(view.symbols):
        reached = k < len(view.crossings)
        return view.plan.symbols[k][0], f"by its plan's time ({'a swing' if reached else 'not done'})"
    return float(view.time[0]), "by its start (no such symbol)"


def compared_charts(comparison: RunComparison) -> tuple[Chart, ...]:
    """Return the charts in which all runs are drawn: a line for each, and the first's reference and levels."""
    first = comparison.runs[0].view
    every = [charts(run.view) for run in comparison.runs]
    found = []
    for arm in range(first.arms):
        title = f"Arm {arm + 1}'s angle θ{style.number(arm)} (rad)"
        prefix = f"arm_{arm + 1}/"
        found.append(_chart(comparison, every, "angles", f"angle_{arm + 1}", title, prefix=prefix, legend=arm == 0))
    limits = first.limits
    track = f", track ±{1000 * limits[0]:g}" if limits else ""
    found += [
        _chart(comparison, every, "cart", "cart", f"Cart position (mm){track}"),
        _chart(comparison, every, "tracking_error", "tracking_error", "Tracking error: largest of the angles (rad)"),
        _chart(comparison, every, "acceleration", "acceleration", "Acceleration applied (m/s²)", prefix="applied"),
        _chart(comparison, every, "energy", "energy", "Energy of the pendulum (J)"),
        _chart(comparison, every, "nis", "nis", "NIS, means of 50 updates"),
    ]
    return tuple(chart for chart in found if chart.lines)


def _chart(
    comparison: RunComparison, every: list[dict[str, Chart]], source: str, key: str, title: str, *, prefix: str = "",
    legend: bool = False,
) -> Chart:  # fmt: skip
    """Return one chart of all runs, made of the lines that each shows itself by under a prefix in a chart of its own.

    Of several such lines, as errors of several arms, it has the largest size.
    """
    lines: list[Line] = []
    known = [one[source] for one in every if source in one]
    for k, (run, own) in enumerate(zip(comparison.runs, every, strict=True)):
        shown = [line for line in own[source].lines if line.key.startswith(prefix)] if source in own else []
        wanted = [line for line in shown if line.role == "reference"] if k == 0 else []
        lines += [replace(line, key="0_reference", name=f"reference of {run.name}", label="the first's reference",
                          colour=style.REFERENCE) for line in wanted]  # fmt: skip
        parts = [line for line in shown if line.role == "run"]
        if parts:
            values = parts[0].values if len(parts) == 1 else np.max([np.abs(line.values) for line in parts], axis=0)
            place = f"{k + 1}_{re.sub(r'[^A-Za-z0-9]+', '_', run.name)}"
            line = Line(place, run.name, "", parts[0].time, values, run.colour, dashed=k > 0)
            lines.append(line)
    if not known:
        return Chart(key, title, title, ())
    levels = tuple(level for level in known[0].levels if level.kind == "limit" or source == "energy")
    named = title.replace("(mm)", "(m)").split(", track")[0] + (", reference grey" if legend else "")
    half_turns, scale = known[0].half_turns, known[0].scale
    return Chart(key, title, named, tuple(lines), levels=levels, scale=scale, half_turns=half_turns, legend=legend)
