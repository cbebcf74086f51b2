"""Several runs on one page.

It shows charts over the common clock, phase planes, and the arms at the same instants.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.comparison import RunComparison
from dpcontrol.pages import style
from dpcontrol.pages.chart import Chart
from dpcontrol.pages.charts import draw_chart, draw_plane
from dpcontrol.pages.compared_charts import compared_charts
from dpcontrol.pages.filmstrip import draw_film, film_height, film_times
from dpcontrol.pages.layout import Page, Stack
from dpcontrol.pages.planes import plane
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
    frames = _frames(comparison)
    for run, colour in zip(runs, style.RUNS, strict=False):
        page.text(run.name, colour=colour, size=style.HEAD)
        page.text(run.view.verdict, colour=style.verdict_colour(run.view.good), size=style.TEXT)
        height = story_height(run.view, span=comparison.span)
        if height:
            page.strip(partial(story, view=run.view, span=comparison.span), height=height)
        if len(runs) <= _FILMED:
            height = film_height(run.view, frames, width=style.WIDTH)
            page.strip(partial(draw_film, view=run.view, times=frames), height=height)
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


def _frames(comparison: RunComparison) -> Array:
    """Return the times of all films, about the symbols.

    If the first run ends early, half of them lie before its end.

    The longest run supplies the symbol times.
    """
    longest = max((run.view for run in comparison.runs), key=lambda view: view.time_range[1])
    begin, end = min((run.view.time_range for run in comparison.runs), key=lambda span: span[1])
    chosen = film_times(longest, frames=_FRAMES)
    if (chosen <= end).mean() >= 0.5:
        return chosen
    half = _FRAMES // 2
    later = film_times(longest, frames=_FRAMES - half)
    return np.sort(np.concatenate([np.linspace(begin, end, half + 1)[1:], later]))
