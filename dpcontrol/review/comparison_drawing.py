"""Several runs on one page, drawn by matplotlib: their stories and films one below the other, their curves together."""

from collections.abc import Callable
from textwrap import shorten

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from dpcontrol.review import film, series, story_panels, style
from dpcontrol.review.comparison import ComparedRun, Comparison
from dpcontrol.review.panel_frame import NOTE, ghost, label_in_pi, limit_lines, number, plot, prepare

Array = NDArray[np.float64]
Values = Callable[[ComparedRun], Array | None]

_WIDE, _DPI = 16.0, 110
_FRAMES = 8
_STORY, _FILM, _PANEL, _HEAD = 0.95, 1.75, 1.75, 0.95
"""Heights in inches: of a run's story and film, of a row of panels, and of the title."""
_FILMED = 3
"""Up to so many runs have a film each."""
_POINTS = 20_000


def draw_comparison(comparison: Comparison) -> Figure:
    """Return the page as a figure."""
    runs = comparison.runs
    filmed = _FILM if len(runs) <= _FILMED else 0.0
    tall = _HEAD + len(runs) * (_STORY + filmed + 0.35) + 4 * (_PANEL + 0.5) + 0.35
    figure = Figure(figsize=(_WIDE, tall), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    title = shorten(comparison.title, 100, placeholder=" …")
    figure.text(0.022, 1 - 0.35 / tall, title, fontsize=16, weight="bold", color=style.INK, va="center")
    status = shorten(comparison.status, 190, placeholder=" …")
    figure.text(0.022, 1 - 0.68 / tall, status, fontsize=9, color=NOTE, va="center")
    top = tall - _HEAD
    span = _span(comparison)
    frames = _frames(comparison)
    for run in runs:
        figure.text(0.022, (top - 0.12) / tall, run.name, fontsize=11, weight="bold", color=run.colour, va="center")
        verdict = shorten(run.context.verdict, 150, placeholder=" …")
        colour = {True: "#1e7a3c", False: style.LIMIT, None: NOTE}[run.context.good]
        figure.text(0.165, (top - 0.12) / tall, verdict, fontsize=9.5, color=colour, va="center")
        rows = story_panels.story_rows(run.motion, run.context)
        if rows:
            height = _STORY - 0.5
            axes = figure.add_axes((0.062, (top - 0.42 - height) / tall, 0.925, height / tall))
            story_panels.story(axes, run.motion, run.context, span=span, legend=False)
        top -= _STORY + 0.2
        if filmed:
            axes = figure.add_axes((0.01, (top - filmed) / tall, 0.98, (filmed - 0.05) / tall))
            film.draw_film(axes, run.motion, run.context, frames=_FRAMES, times=frames)
            axes.set_aspect("equal")
            top -= filmed
        top -= 0.15
    _panels(figure, comparison, top=top - 0.1, tall=tall, span=span)
    return figure


def _span(comparison: Comparison) -> tuple[float, float]:
    begins = [run.motion.time_range[0] for run in comparison.runs]
    ends = [max(run.motion.time_range[1], run.context.duration or 0.0) for run in comparison.runs]
    return min(begins), max(ends)


def _frames(comparison: Comparison) -> Array:
    """Return the instants of all films: about the symbols, and half before the first run's end if that is early.

    The run that lasts longest says where the symbols are.
    """
    longest = max(comparison.runs, key=lambda run: run.motion.time_range[1])
    shortest = min(comparison.runs, key=lambda run: run.motion.time_range[1])
    begin, end = shortest.motion.time_range
    chosen = series.film_times(longest.context, longest.motion.time, frames=_FRAMES)
    if (chosen <= end).mean() >= 0.5:
        return chosen
    half = _FRAMES // 2
    later = series.film_times(longest.context, longest.motion.time, frames=_FRAMES - half)
    return np.sort(np.concatenate([np.linspace(begin, end, half + 1)[1:], later]))


def _panels(figure: Figure, comparison: Comparison, *, top: float, tall: float, span: tuple[float, float]) -> None:
    arms = comparison.runs[0].motion.arms
    curves: list[tuple[str, Values, Values | None, float | None]] = []
    for arm in range(min(arms, 2)):
        name = f"Arm {arm + 1}'s angle θ{number(arm)} (rad), broad: the first's reference"
        curves.append((name, _column(arm, 1 / np.pi), _reference(arm, 1 / np.pi), None))
    limits = comparison.runs[0].context.limits
    if all(run.motion.has_cart for run in comparison.runs):
        bound = 1000 * limits[0] if limits else None
        track = f", track ±{bound:g}" if bound else ""
        curves.append((f"Cart position (mm){track}", _column(2 * arms, 1000), _reference(2 * arms, 1000), bound))
    curves += [
        ("Tracking error: largest of the angles (rad)", _tracking, None, None),
        ("Acceleration applied (m/s²)", _applied, None, limits[2] if limits else None),
        ("Energy of the pendulum (J)", lambda run: series.energy_of(run.motion, run.context), None, None),
        ("NIS, means of 50 updates", _nis, None, None),
    ]
    shown = [c for c in curves if any(c[1](run) is not None for run in comparison.runs)]
    rows = (len(shown) + 1) // 2
    room = (top - 0.35) / rows
    for k, (title, values, reference, bound) in enumerate(shown):
        row, column = k % rows, k // rows
        height = room - 0.5
        axes = figure.add_axes(((0.045, 0.372)[column], (top - row * room - room + 0.5) / tall, 0.285, height / tall))
        _curves(axes, comparison, title, values=values, reference=reference)
        if bound is not None:
            limit_lines(axes, bound)
        if "angle θ" in title:
            axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
            label_in_pi(axes.yaxis)
        axes.set_xlim(*span)
        if row == rows - 1 or k == len(shown) - 1:
            axes.set_xlabel("time on the common clock (s)", fontsize=8.5, color=NOTE, labelpad=1)
    half = (top - 0.35) / min(arms, 2)
    for arm in range(min(arms, 2)):
        bottom = top - (arm + 1) * half + 0.5
        axes = figure.add_axes((0.70, bottom / tall, 0.28, (half - 0.5) / tall))
        _plane(axes, comparison, arm)


def _column(column: int, scale: float) -> Values:
    return lambda run: run.motion.state[:, column] * scale


def _reference(column: int, scale: float) -> Values:
    return lambda run: None if run.motion.reference is None else run.motion.reference[:, column] * scale


def _tracking(run: ComparedRun) -> Array | None:
    if run.motion.reference is None:
        return None
    n = run.motion.arms
    return np.abs(run.motion.state[:, :n] - run.motion.reference[:, :n]).max(axis=1)


def _applied(run: ComparedRun) -> Array | None:
    return None if run.motion.control is None else run.motion.control.get("applied")


def _nis(run: ComparedRun) -> Array | None:
    return run.motion.nis


def _curves(axes: Axes, comparison: Comparison, title: str, *, values: Values, reference: Values | None) -> None:
    prepare(axes, title)
    first = comparison.runs[0]
    wanted = None if reference is None else reference(first)
    if wanted is not None:
        plot(axes, first.motion, wanted, **ghost())
    for k, run in enumerate(comparison.runs):
        found = values(run)
        if found is None:
            continue
        look = {"color": run.colour, "linewidth": 1.3, "linestyle": "-" if k == 0 else (0, (5, 1.2))}
        if values is _nis:
            time, means, _ = series.smoothed_nis(run.motion)
            axes.plot(*series.thinned(time, means), **look)
        else:
            plot(axes, run.motion, found, **look)
    axes.axvline(comparison.moment, color="#7a828b", linewidth=0.9, linestyle=(0, (2, 2)), zorder=1.5)
    if title.startswith("Tracking"):
        axes.set_ylim(bottom=0)


def _plane(axes: Axes, comparison: Comparison, arm: int) -> None:
    prepare(axes, f"Arm {arm + 1}: ω{number(arm)} (rad/s) over θ{number(arm)}, orbits broad")
    for orbit in comparison.runs[0].context.orbits:
        n = orbit.states.shape[1] // 2
        closed = np.vstack([orbit.states, orbit.states[:1]])
        colour = style.saddle_colour(orbit.saddle)
        axes.plot(closed[:, arm] / np.pi, closed[:, n + arm], color=colour, linewidth=3.0, alpha=0.4)
    for run in comparison.runs:
        n, step = run.motion.arms, max(1, len(run.motion.time) // _POINTS)
        state = run.motion.state[::step]
        axes.plot(state[:, arm] / np.pi, state[:, n + arm], color=run.colour, linewidth=1.0)
        axes.plot(state[-1, arm] / np.pi, state[-1, n + arm], "s", color=run.colour, markersize=5)
    axes.margins(x=0.04)
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))
    label_in_pi(axes.xaxis)
