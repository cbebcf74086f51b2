"""A motion on one page, drawn by matplotlib: what happened, how well it was tracked and estimated, where it went."""

from collections.abc import Callable
from pathlib import Path
from textwrap import shorten, wrap

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dpcontrol.foundation.files import whole_file
from dpcontrol.logs import RunLog
from dpcontrol.review import check_panels, film, panels, series, story_panels, style
from dpcontrol.review.context import ReviewContext
from dpcontrol.review.motion import Motion, motion_of
from dpcontrol.review.panel_frame import NOTE, mark_symbols

Panel = Callable[[Axes, Motion, ReviewContext], None]

_SIZE = (16.0, 11.6)
_DPI = 110
_FRAMES = 8
_NOTES = 0.185
_NOTE_LINES = 13
_GOOD, _BAD = "#1e7a3c", style.LIMIT
_COLUMNS, _WIDTH = (0.045, 0.372, 0.70), 0.285
_ROW = 0.019
"""Height of a row of the story."""
_ABOVE = 0.04
"""Between two panels, for the title of the lower."""


def draw(log: RunLog, context: ReviewContext) -> Figure:
    """Return the page of a log as a figure."""
    return draw_motion(motion_of(log), context)


def draw_motion(motion: Motion, context: ReviewContext) -> Figure:
    """Return the page of a motion as a figure."""
    figure = Figure(figsize=_SIZE, dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    heading(figure, motion, context)
    top = 0.925
    rows = story_panels.story_rows(motion, context)
    if rows:
        tall = _ROW * len(rows)
        top -= 0.022
        story_panels.story(figure.add_axes((0.062, top - tall, 0.925, tall)), motion, context)
        top -= tall + 0.032
    horizontal, vertical = film.film_extent(motion, context, frames=_FRAMES)
    # As tall as its width makes it with equal scales; the panels below take what is left.
    tall = 0.98 * _SIZE[0] / _SIZE[1] * (vertical[1] - vertical[0]) / (horizontal[1] - horizontal[0])
    film.draw_film(figure.add_axes((0.01, top - tall, 0.98, tall)), motion, context, frames=_FRAMES)
    top -= tall + 0.03
    bottom = 0.005
    for column, chosen in zip(_COLUMNS, _columns(motion, context), strict=False):
        _stack(figure, chosen, motion, context, left=column, top=top, bottom=bottom + 0.035)
    arms = min(motion.arms, 2)
    share = (top - bottom - _NOTES) / 2
    for arm in range(arms):
        axes = figure.add_axes((_COLUMNS[2], top - arm * share - (share - 0.05), 0.28, share - 0.05))
        panels.phase_plane(axes, motion, context, arm=arm)
    place = figure.add_axes((_COLUMNS[2], bottom, 0.28, _NOTES))
    story_panels.notes(place, motion, context, lines=_NOTE_LINES)
    return figure


def _columns(motion: Motion, context: ReviewContext) -> tuple[list[Panel], list[Panel]]:
    """Return the panels of the left and the middle column: only those for which there is something to show."""
    left: list[Panel] = [panels.angles, panels.rates]
    left += [panels.cart] if motion.has_cart else []
    left += [panels.command] if motion.control is not None else []
    middle: list[Panel] = [check_panels.tracking_error] if motion.reference is not None else []
    middle += [check_panels.estimation_error] if motion.error is not None or motion.sigma is not None else []
    middle += [check_panels.energy] if series.energy_of(motion, context) is not None else []
    middle += [check_panels.innovations] if motion.nis is not None else []
    while len(left) > len(middle) + 1:
        middle.insert(0, left.pop())
    return left, middle


def _stack(
    figure: Figure,
    chosen: list[Panel],
    motion: Motion,
    context: ReviewContext,
    *,
    left: float,
    top: float,
    bottom: float,
) -> None:
    """Draw panels one below the other, on one axis of time."""
    tall = (top - bottom + _ABOVE) / max(len(chosen), 1)
    for row, panel in enumerate(chosen):
        axes = figure.add_axes((left, top - row * tall - (tall - _ABOVE), _WIDTH, tall - _ABOVE))
        panel(axes, motion, context)
        axes.set_xlim(*motion.time_range)
        last = row == len(chosen) - 1
        axes.tick_params(labelbottom=last)
        if last:
            axes.set_xlabel("time (s)", fontsize=8.5, color=NOTE, labelpad=1)
        mark_symbols(axes, motion, context)


def heading(figure: Figure, motion: Motion, context: ReviewContext) -> None:
    """Write title, origin and verdict at the top of a page."""
    title = shorten(context.title, 112, placeholder=" …")
    figure.text(
        0.022, 0.975, title, fontsize=17 if len(title) < 72 else 14, weight="bold", color=style.INK, va="center"
    )
    about = [motion.path.name, motion.metadata.get("program", "")]
    figure.text(0.985, 0.975, "   ".join(about), fontsize=8.5, color="#7a828b", va="center", ha="right")
    lines = wrap(context.verdict, 120) or [""]
    if len(lines) > 1:
        lines = wrap(context.verdict, 150, max_lines=2, placeholder=" …")
    size = 12 if len(lines) == 1 else 9.5
    colour = {True: _GOOD, False: _BAD, None: NOTE}[context.good]
    figure.text(0.022, 0.947, "\n".join(lines), fontsize=size, color=colour, va="center")


def write_drawing(log: RunLog, context: ReviewContext, path: Path) -> None:
    """Write the page as PNG or PDF, by the name's suffix.

    Raises:
        InputError: the file cannot be written.
    """
    save_figure(draw(log, context), path)


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG or PDF, by the name's suffix.

    Raises:
        InputError: the file cannot be written.
    """
    kind = "pdf" if Path(path).suffix.lower() == ".pdf" else "png"
    with whole_file(path, suffix=f".{kind}") as temporary:
        figure.savefig(temporary, format=kind)
