"""Several runs on one page.

It shows charts over the common clock, phase planes, and the arms at the same instants.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.judge.comparison import ComparedRun, RunComparison
from dpcontrol.pages import style
from dpcontrol.pages.chart import Chart, Line
from dpcontrol.pages.charts import draw_chart, draw_plane
from dpcontrol.pages.filmstrip import add_film, film_times
from dpcontrol.pages.layout import Page, Stack
from dpcontrol.pages.planes import plane
from dpcontrol.pages.run_charts import charts as charts_of
from dpcontrol.pages.story import story, story_height

_FRAMES = 8
_PANEL = 1.75
"""Height of a row of panels, inches."""
_FILMED = 3
"""Greatest number of runs with films."""


def draw_comparison(comparison: RunComparison) -> Figure:
    """Return the page of a comparison as a figure."""
    runs = comparison.runs
    page = Page(comparison.title, comparison.status)
    # All films have the times of the run that ends first.
    frames = film_times(min((run.view for run in runs), key=lambda view: view.time_range[1]), frames=_FRAMES)
    for run, colour in zip(runs, style.RUNS, strict=False):
        page.text(run.name, colour=colour, size=style.HEAD)
        page.text(run.view.verdict, colour=style.verdict_colour(run.view.good), size=style.TEXT)
        height = story_height(run.view, span=comparison.span)
        if height:
            page.row(partial(story, view=run.view, span=comparison.span), height=height)
        if len(runs) <= _FILMED:
            add_film(page, run.view, frames)
    charts = compared_charts(comparison)
    half = (len(charts) + 1) // 2
    columns = [
        Stack([partial(_draw, chart=chart, comparison=comparison) for chart in some])
        for some in (charts[:half], charts[half:])
    ]
    planes = [
        partial(draw_plane, runs=[(plane(run.view, arm), style.RUNS[k]) for k, run in enumerate(runs)], tubes=False)
        for arm in range(min(runs[0].view.arms, 2))
    ]
    return page.row(*columns, Stack(planes), height=_PANEL * max(half, 3)).figure()


def _draw(axes: Axes, chart: Chart, comparison: RunComparison) -> None:
    draw_chart(axes, chart, comparison.runs[0].view, span=comparison.span)
    axes.axvline(comparison.moment, color=style.INK, linewidth=1.0, linestyle=style.DOTTED)


def compared_charts(comparison: RunComparison) -> tuple[Chart, ...]:
    """Return the common charts with a line for each run.

    The first run's reference and levels are included.
    """
    first = comparison.runs[0].view
    every = [charts_of(run.view) for run in comparison.runs]
    wanted = [
        ("angles", f"angle_{arm + 1}", f"Arm {arm + 1}'s angle θ{style.number(arm)}", f"arm_{arm + 1}/")
        for arm in range(min(first.arms, 2))
    ]
    wanted += [
        ("cart", "cart", "Cart position", ""),
        ("tracking_error", "tracking_error", "Tracking error, largest of the angles", ""),
        ("acceleration", "acceleration", "Acceleration applied", "applied"),
        ("energy", "energy", "Energy of the pendulum", ""),
        ("nis", "nis", "NIS, means of 50 updates", ""),
    ]
    found = [_chart(comparison, [own.get(source) for own in every], *rest) for source, *rest in wanted]
    return tuple(chart for chart in found if chart is not None and chart.lines)


def _chart(comparison: RunComparison, every: list[Chart | None], key: str, title: str, prefix: str) -> Chart | None:
    """Return one chart of all runs.

    The chart has those of their lines whose keys start with `prefix`. Several such lines of a run, such as errors
    of several arms, are replaced by their largest size at each time.
    """
    lines: list[Line] = []
    for k, (run, own) in enumerate(zip(comparison.runs, every, strict=True)):
        shown = [line for line in own.lines if line.key.startswith(prefix)] if own else []
        lines += [
            replace(
                line,
                key="0_reference",
                name=f"reference of {run.name}",
                label="the first's reference",
                colour=style.REFERENCE,
            )
            for line in shown
            if line.role == "reference" and k == 0
        ]
        parts = [line for line in shown if line.role == "run"]
        if parts:
            values = parts[0].values if len(parts) == 1 else np.max([np.abs(line.values) for line in parts], axis=0)
            lines.append(Line(run_path(k, run), run.name, "", parts[0].time, values, style.RUNS[k], dashed=k > 0))
    known = next((own for own in every if own), None)
    if known is None:
        return None
    return replace(
        known,
        key=key,
        title=title,
        note="",
        lines=tuple(lines),
        levels=tuple(level for level in known.levels if level.kind == "limit" or key == "energy"),
        cut=(),
        shown=None,
        log=False,
    )


def run_path(k: int, run: ComparedRun) -> str:
    """Return the path of a run in a recording.

    Args:
        k: index of the run, from 0.
        run: run of the comparison.
    """
    return f"{k + 1}_{'_'.join(''.join(c if c.isascii() and c.isalnum() else ' ' for c in run.name).split())}"
