"""Several runs on one page, drawn by matplotlib: their stories and films one below the other, their curves together."""

from textwrap import shorten

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dpcontrol.review import film, panels, series, story_panels, style
from dpcontrol.review.comparison import RunComparison, compared_charts
from dpcontrol.review.panel_frame import mark_times, new_figure

Array = NDArray[np.float64]

_WIDE = 16.0
_FRAMES = 8
_STORY, _FILM, _PANEL, _HEAD = 0.95, 1.75, 1.75, 0.95
"""Heights in inches: of a run's story and film, of a row of panels, and of the title."""
_FILMED = 3
"""Up to so many runs have a film each."""


def draw_comparison(comparison: RunComparison) -> Figure:
    """Return the page as a figure."""
    runs = comparison.runs
    filmed = _FILM if len(runs) <= _FILMED else 0.0
    tall = _HEAD + len(runs) * (_STORY + filmed + 0.35) + 4 * (_PANEL + 0.5) + 0.35
    figure = new_figure(_WIDE, tall)
    title = shorten(comparison.title, 100, placeholder=" …")
    figure.text(0.022, 1 - 0.35 / tall, title, fontsize=16, weight="bold", color=style.INK, va="center")
    status = shorten(comparison.status, 190, placeholder=" …")
    figure.text(0.022, 1 - 0.68 / tall, status, fontsize=9, color=style.NOTE, va="center")
    top = tall - _HEAD
    frames = _frames(comparison)
    for run in runs:
        figure.text(0.022, (top - 0.12) / tall, run.name, fontsize=11, weight="bold", color=run.colour, va="center")
        verdict, colour = shorten(run.view.verdict, 150, placeholder=" …"), style.verdict_colour(run.view.good)
        figure.text(0.165, (top - 0.12) / tall, verdict, fontsize=9.5, color=colour, va="center")
        if story_panels.story_rows(run.view, span=comparison.span):
            height = _STORY - 0.5
            axes = figure.add_axes((0.062, (top - 0.42 - height) / tall, 0.925, height / tall))
            story_panels.story(axes, run.view, span=comparison.span, legend=False)
        top -= _STORY + 0.2
        if filmed:
            axes = figure.add_axes((0.01, (top - filmed) / tall, 0.98, (filmed - 0.05) / tall))
            film.draw_film(axes, run.view, frames=_FRAMES, times=frames)
            axes.set_aspect("equal")
            top -= filmed
        top -= 0.15
    _panels(figure, comparison, top=top - 0.1, tall=tall)
    return figure


def _frames(comparison: RunComparison) -> Array:
    """Return the instants of all films: about the symbols, and half before the first run's end if that is early.

    The run that lasts longest says where the symbols are.
    """
    longest = max((run.view for run in comparison.runs), key=lambda view: view.time_range[1])
    begin, end = min((run.view.time_range for run in comparison.runs), key=lambda span: span[1])
    chosen = film.film_times(longest, frames=_FRAMES)
    if (chosen <= end).mean() >= 0.5:
        return chosen
    half = _FRAMES // 2
    later = film.film_times(longest, frames=_FRAMES - half)
    return np.sort(np.concatenate([np.linspace(begin, end, half + 1)[1:], later]))


def _panels(figure: Figure, comparison: RunComparison, *, top: float, tall: float) -> None:
    arms = min(comparison.runs[0].view.arms, 2)
    shown = [chart for chart in compared_charts(comparison) if chart.key not in ("angle_3", "angle_4", "angle_5")]
    rows = (len(shown) + 1) // 2
    room = (top - 0.35) / rows
    for k, chart in enumerate(shown):
        row, column = k % rows, k // rows
        height = room - 0.5
        axes = figure.add_axes(((0.045, 0.372)[column], (top - row * room - room + 0.5) / tall, 0.285, height / tall))
        panels.draw_chart(axes, chart, comparison.runs[0].view)
        mark_times(axes, [comparison.moment])
        axes.set_xlim(*comparison.span)
        if row == rows - 1 or k == len(shown) - 1:
            axes.set_xlabel("time on the common clock (s)", fontsize=8.5, color=style.NOTE, labelpad=1)
    half = (top - 0.35) / arms
    for arm in range(arms):
        bottom = top - (arm + 1) * half + 0.5
        axes = figure.add_axes((0.70, bottom / tall, 0.28, (half - 0.5) / tall))
        planes = [(series.plane(run.view, arm), run.colour) for run in comparison.runs]
        panels.draw_plane(axes, planes, tubes=False)
