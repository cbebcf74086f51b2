"""A run on one page, drawn by matplotlib: what happened, how well it was tracked and estimated, where it went."""

from pathlib import Path
from textwrap import shorten, wrap

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dpcontrol.foundation.files import whole_file
from dpcontrol.logs import RunLog
from dpcontrol.review import film, panels, series, style
from dpcontrol.review.context import ReviewContext

_SIZE = (16.0, 11.0)
_DPI = 110
_FRAMES = 8
_NOTES = 0.195
_NOTE_LINES = 13
_GOOD, _BAD = "#1e7a3c", style.LIMIT


def draw(log: RunLog, context: ReviewContext) -> Figure:
    """Return the page as a figure."""
    log, context = series.drawable(log, context)
    figure = Figure(figsize=_SIZE, dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    _heading(figure, log, context)
    horizontal, vertical = film.film_extent(log, context, frames=_FRAMES)
    # As tall as its width makes it with equal scales; the panels below take what is left.
    tall = 0.98 * _SIZE[0] / _SIZE[1] * (vertical[1] - vertical[0]) / (horizontal[1] - horizontal[0])
    film.draw_film(figure.add_axes((0.01, 0.93 - tall, 0.98, tall)), log, context, frames=_FRAMES)
    rows, columns = 4, (0.045, 0.372, 0.70)
    width, right = 0.285, 0.28
    top, bottom = 0.93 - tall - 0.035, 0.005

    strip = 0.014
    step = (top - strip - 0.045 - bottom) / rows
    height = step - 0.04
    mode_axes = figure.add_axes((columns[0], top - strip, width, strip))
    panels.modes(mode_axes, log, context)
    drawn = []
    lefts = [panels.angles, panels.rates, panels.cart if log.has_cart else None, panels.command]
    for row, panel in enumerate(lefts):
        if panel is not None:
            axes = figure.add_axes((columns[0], top - strip - 0.045 - row * step - height, width, height))
            panel(axes, log, context)
            drawn.append(axes)
    tall = (top - bottom) / rows
    rights = [panels.tracking_error, panels.estimation_error, panels.energy, lambda a, b, _: panels.innovations(a, b)]
    for row, panel in enumerate(rights):
        axes = figure.add_axes((columns[1], top - row * tall - (tall - 0.04), width, tall - 0.04))
        panel(axes, log, context)
        drawn.append(axes)
    for axes in drawn:
        axes.set_xlim(*series.time_range(log))
        last = axes is drawn[len([panel for panel in lefts if panel]) - 1] or axes is drawn[-1]
        axes.tick_params(labelbottom=last)
        if last:
            axes.set_xlabel("time (s)", fontsize=8.5, color="#555c64", labelpad=1)
        panels.mark_symbols(axes, context, log)

    arms = min(len(context.arm_lengths), 2)
    share = (top - bottom - _NOTES) / 2
    for arm in range(arms):
        axes = figure.add_axes((columns[2], top - arm * share - (share - 0.05), right, share - 0.05))
        panels.phase_plane(axes, log, context, arm=arm)
    panels.notes(figure.add_axes((columns[2], bottom, right, _NOTES)), log, context, lines=_NOTE_LINES)
    return figure


def _heading(figure: Figure, log: RunLog, context: ReviewContext) -> None:
    title = shorten(context.title, 70, placeholder=" …")
    figure.text(0.022, 0.975, title, fontsize=17, weight="bold", color=style.INK, va="center")
    about = [f"seed {log.metadata['seed']}"] if "seed" in log.metadata else []
    about += [log.metadata.get("program", ""), "in the film: grey the reference, thin the tip's path"]
    figure.text(0.985, 0.975, "   ".join(about), fontsize=8.5, color="#7a828b", va="center", ha="right")
    done = context.verdict.lower().startswith("completed")
    lines = wrap(context.verdict, 120) or [""]
    if len(lines) > 1:
        lines = wrap(context.verdict, 150, max_lines=2, placeholder=" …")
    size = 12 if len(lines) == 1 else 9.5
    figure.text(0.022, 0.947, "\n".join(lines), fontsize=size, color=_GOOD if done else _BAD, va="center")


def write_drawing(log: RunLog, context: ReviewContext, path: Path) -> None:
    """Write the page as PNG, 1760 by 1210.

    Raises:
        InputError: the file cannot be written.
    """
    figure = draw(log, context)
    with whole_file(path, suffix=".png") as temporary:
        figure.savefig(temporary, format="png")
