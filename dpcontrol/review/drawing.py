"""A run, a recording or a reference on one page, drawn by matplotlib: what happened, how well, and where it went."""

from textwrap import shorten, wrap

from matplotlib.figure import Figure

from dpcontrol.review import film, panels, series, story_panels, style
from dpcontrol.review.motion import RunView
from dpcontrol.review.panel_frame import mark_times, new_figure

_SIZE = (16.0, 11.6)
_FRAMES = 8
_NOTES = 0.185
_NOTE_LINES = 13
_COLUMNS, _WIDTH = (0.045, 0.372, 0.70), 0.285
_ROW = 0.019
"""Height of a row of the story."""
_ABOVE = 0.04
"""Between two panels, for the title of the lower."""


def draw(view: RunView) -> Figure:
    """Return the page as a figure."""
    figure = new_figure(*_SIZE)
    _heading(figure, view)
    top = 0.925
    rows = story_panels.story_rows(view)
    if rows:
        tall = _ROW * len(rows)
        top -= 0.022
        story_panels.story(figure.add_axes((0.062, top - tall, 0.925, tall)), view)
        top -= tall + 0.032
    horizontal, vertical = film.film_extent(view, frames=_FRAMES)
    # As tall as its width makes it with equal scales; the panels below take what is left.
    tall = 0.98 * _SIZE[0] / _SIZE[1] * (vertical[1] - vertical[0]) / (horizontal[1] - horizontal[0])
    film.draw_film(figure.add_axes((0.01, top - tall, 0.98, tall)), view, frames=_FRAMES)
    top -= tall + 0.03
    bottom = 0.005
    left, middle = list(series.motion_charts(view)), list(series.check_charts(view))
    while len(left) > len(middle) + 1:
        middle.insert(0, left.pop())
    for column, chosen in zip(_COLUMNS, (left, middle), strict=False):
        _stack(figure, chosen, view, left=column, top=top, bottom=bottom + 0.035)
    share = (top - bottom - _NOTES) / 2
    for arm in range(min(view.arms, 2)):
        axes = figure.add_axes((_COLUMNS[2], top - arm * share - (share - 0.05), 0.28, share - 0.05))
        panels.draw_plane(axes, [(series.plane(view, arm), style.INK)])
    story_panels.notes(figure.add_axes((_COLUMNS[2], bottom, 0.28, _NOTES)), view, lines=_NOTE_LINES)
    return figure


def _stack(
    figure: Figure, chosen: list[series.Chart], view: RunView, *, left: float, top: float, bottom: float
) -> None:
    """Draw charts one below the other, on one axis of time."""
    tall = (top - bottom + _ABOVE) / max(len(chosen), 1)
    begin, end = view.time_range
    for row, chart in enumerate(chosen):
        axes = figure.add_axes((left, top - row * tall - (tall - _ABOVE), _WIDTH, tall - _ABOVE))
        panels.draw_chart(axes, chart, view)
        axes.set_xlim(begin, end)
        last = row == len(chosen) - 1
        axes.tick_params(labelbottom=last)
        if last:
            axes.set_xlabel("time (s)", fontsize=8.5, color=style.NOTE, labelpad=1)
        mark_times(axes, [at for at, _ in view.plan.symbols if begin <= at <= end])


def _heading(figure: Figure, view: RunView) -> None:
    """Write title, origin and verdict at the top of a page."""
    title = shorten(view.title, 112, placeholder=" …")
    size = 17 if len(title) < 72 else 14
    figure.text(0.022, 0.975, title, fontsize=size, weight="bold", color=style.INK, va="center")
    about = "   ".join([view.path.name, view.metadata.get("program", "")])
    figure.text(0.985, 0.975, about, fontsize=8.5, color=style.MARK, va="center", ha="right")
    lines = wrap(view.verdict, 120) or [""]
    if len(lines) > 1:
        lines = wrap(view.verdict, 150, max_lines=2, placeholder=" …")
    size = 12 if len(lines) == 1 else 9.5
    figure.text(
        0.022, 0.947, "\n".join(lines), fontsize=size, color=style.verdict_colour(view.good), va="center"
    )  # fmt: skip
