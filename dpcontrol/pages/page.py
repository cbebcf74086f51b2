"""A run, a recording, a reference or an orbit on one page, drawn by matplotlib from its story (`series`).

From the top: title and verdict, the planned and the flown itinerary, a film of the arms seen from the cart, then charts
over time, phase planes, symbols and events. The helpers for figures, frames, axes in units of π and legends are shared
with every other page and figure.
"""

import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from textwrap import shorten, wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, MultipleLocator
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError, printable
from dpcontrol.foundation.files import whole_file
from dpcontrol.judge.of_log import run_view
from dpcontrol.judge.run_view import RunView
from dpcontrol.logs import RunLog
from dpcontrol.pages import series, style
from dpcontrol.pages.series import (
    Chart,
    LevelLine,
    Line,
    Plane,
    Range,
    Span,
    Strip,
    arm_points,
    extreme_rows,
    gap_times,
    strips,
)
from dpcontrol.runs.run import Run

SMALL = 8.5
_DPI = 110
_BINS = 1500
DOTTED, DASHED = (0, (2, 2)), (0, (5, 3))


class ShownFigure(Figure):
    """A figure displayed by notebook cells, and elsewhere by `show`.

    pyplot does not manage it: a figure that pyplot manages appears a second time at the end of a notebook's cell.
    """

    def _repr_png_(self) -> bytes:
        _literal_texts(self)
        picture = BytesIO()
        self.savefig(picture, format="png")
        return picture.getvalue()

    def show(self, warn: bool = True) -> None:
        """Display the figure once, in a notebook or a window.

        Outside notebooks the window blocks until it is closed.

        `warn` has no effect; pyplot warns if its backend has no windows.
        """
        shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
        if hasattr(shell, "kernel"):
            sys.modules["IPython"].display.display(self)
            return
        from matplotlib import pyplot

        _literal_texts(self)
        # The window is created for a figure of pyplot and then shows this one.
        canvas = pyplot.figure(figsize=self.get_size_inches()).canvas
        canvas.figure = self
        self.set_canvas(canvas)
        pyplot.show()


def new_figure(width: float, height: float, title: str = "") -> Figure:
    """Return an empty white figure with a title.

    Width and height are in inches.
    """
    figure = ShownFigure(figsize=(width, height), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, x=0.015, y=0.985, ha="left", va="top", fontsize=13, weight="bold", color=style.INK)
    return figure


def _literal_texts(figure: Figure) -> None:
    """Draw texts literally: a dollar sign begins no formula, and control characters are written out."""
    for text in figure.findobj(Text):
        # The tick labels of a logarithmic axis are formulas of matplotlib.
        if isinstance(text, Text) and "$" in text.get_text() and "\\mathdefault" not in text.get_text():
            text.set_parse_math(False)
        if isinstance(text, Text):
            text.set_text(printable(text.get_text()))


def save_figure(figure: Figure, path: Path | str) -> None:
    """Write a figure as PNG or PDF, by the name's suffix.

    Raises:
        InputError: the file cannot be written.
    """
    path = Path(path)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("png", "pdf"):
        raise InputError(f"{path}: a picture is a .png or .pdf file; choose a name that ends so")
    _literal_texts(figure)
    with whole_file(path, suffix=f".{kind}") as temporary:
        try:
            figure.savefig(temporary, format=kind)
        except OverflowError as error:
            raise InputError(
                f"cannot draw {path}: its curves reach too far ({error}); look for time that runs backward or jumps"
            ) from error


def quiet(axes: Axes, title: str = "", *, x: str = "", y: str = "", size: float = 9.5) -> None:
    """Set a panel's title, axis labels, and plain frame and grid."""
    if title:
        axes.set_title(title, loc="left", fontsize=size, color=style.INK, pad=4)
    axes.set_xlabel(x, fontsize=SMALL, color=style.NOTE, labelpad=1)
    axes.set_ylabel(y, fontsize=SMALL, color=style.NOTE, labelpad=1)
    axes.tick_params(labelsize=SMALL, colors=style.NOTE, length=2.5)
    axes.grid(color=style.GRID, linewidth=0.7)
    axes.set_axisbelow(True)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(style.FAINT)


def quiet_space(axes: Axes, *, angular: bool, steps: tuple[float, float] = (1.0, 1.0)) -> None:
    """Label the axes of a panel in space.

    They are (first coordinate, second, first rate), with ticks every `steps` half turns.
    """
    for which, label, step in zip("xy", ("θ₁ (rad)", "θ₂ (rad)") if angular else ("x", "y"), steps, strict=True):
        getattr(axes, f"set_{which}label")(label, fontsize=9)
        if angular:
            angle_axis(axes, which, step=step)
    axes.set_zlabel("ω₁ (rad/s)" if angular else "x rate", fontsize=9)  # type: ignore[attr-defined]
    axes.view_init(elev=22, azim=-122)  # type: ignore[attr-defined]
    axes.tick_params(labelsize=8, colors=style.CART)


def key(on: Axes | Figure, entries: Iterable[tuple[str, str | dict[str, Any]]], **where: Any) -> None:
    """Add a legend without a frame to a panel or a page.

    Entries are labels with a colour or a line style.
    """
    handles = []
    for label, given in entries:
        look: dict[str, Any] = {"color": given} if isinstance(given, str) else given
        handles.append(Line2D([], [], label=label, **look))
    on.legend(handles=handles, **{"fontsize": SMALL, "frameon": False, **where})


ABOVE: dict[str, Any] = {
    "loc": "lower right", "bbox_to_anchor": (1.005, 1.0), "handlelength": 1.5, "columnspacing": 1.1,
    "handletextpad": 0.5, "borderpad": 0, "borderaxespad": 0.1,
}  # fmt: skip
"""Position of a key that covers no curve: above its panel, right."""
NARROW: dict[str, Any] = {"handlelength": 0.8, "columnspacing": 0.5, "handletextpad": 0.25, "fontsize": 7}
"""The same position beside a long title, or for many entries, as narrow as legible."""
_BESIDE_TITLE = 62
"""Letters of a title and a key together, with four more for each entry, that fit side by side."""


def angle_axis(axes: Axes, which: str, *, step: float | None = None) -> None:
    """Tick the "x" or "y" axis in multiples of π.

    The step is `step` of them or adapted to the data.
    """
    axis = axes.xaxis if which == "x" else axes.yaxis
    if step is None:
        low, high = axis.get_view_interval()
        span = (high - low) / np.pi
        step = next((s for s in (0.05, 0.1, 0.25, 0.5, 1.0, 2.0) if span / s <= 5), 4.0)
    axis.set_major_locator(MultipleLocator(step * np.pi))
    axis.set_major_formatter(FuncFormatter(lambda value, _: style.in_pi(value / np.pi)))


def label_in_pi(axis: Axis) -> None:
    """Label an axis of half turns with enough digits.

    The digits distinguish its ends.
    """

    def text(value: float, _: object) -> str:
        low, high = axis.get_view_interval()
        largest = max(abs(low), abs(high))
        finest = np.log10(largest / (high - low)) if high > low else 0.0
        return style.in_pi(value, digits=3 + max(0, int(np.ceil(finest))))

    axis.set_major_formatter(FuncFormatter(text))


def curve(view: RunView, time: Array, values: Array) -> tuple[Array, Array]:
    """Return a series (K,) of a view, thinned to its peaks.

    In its gaps nan interrupts lines.
    """
    rows = extreme_rows(values, bins=_BINS)
    time, values = time[rows], values[rows]
    if not len(view.breaks):
        return time, values
    gaps = gap_times(view)
    places = np.searchsorted(time, gaps)
    return np.insert(time, places, gaps), np.insert(values, places, np.nan)


def mark_times(axes: Axes, moments: list[float]) -> None:
    """Mark moments (s) with a dotted line."""
    for moment in moments:
        axes.axvline(moment, color=style.MARK, linewidth=0.9, linestyle=DOTTED, zorder=1.5)


def _limit(axes: Axes, value: float) -> None:
    """Draw a limit and shade the range beyond it if the curves come near."""
    low, high = axes.get_ylim()
    if low - 0.35 * (high - low) < value < high + 0.35 * (high - low):
        axes.axhline(value, color=style.LIMIT, linewidth=1.1, linestyle=DASHED)
        low, high = min(low, 1.06 * value), max(high, 1.06 * value)
        axes.axhspan(value, 1e3 * value, color=style.LIMIT, alpha=0.08, linewidth=0)
    axes.set_ylim(low, high)


def badge(axes: Axes, number: int, x: float, y: float, *, size: float = 7.5) -> None:
    """Put a symbol's number, white on a dark disc."""
    axes.text(
        x, y, str(number), ha="center", va="center_baseline", fontsize=size, color="white", zorder=6, clip_on=False,
        bbox={"boxstyle": "circle,pad=0.25", "facecolor": style.INK, "edgecolor": "none"},
    )  # fmt: skip


def wrapped_runs(curve: Array, periods: tuple[float | None, ...]) -> list[Array]:
    """Return a curve (K, D) as runs within one period about zero.

    It is split at the bounds.

    `periods` is (D,), None or zero for coordinates without a period.
    """
    lengths = np.array([period or 0.0 for period in periods])
    turns = np.rint(curve / np.where(lengths, lengths, np.inf))
    breaks = np.flatnonzero((np.diff(turns, axis=0) != 0).any(axis=1)) + 1
    runs = []
    for start, end in zip(np.r_[0, breaks], np.r_[breaks, len(curve)], strict=True):
        # One point beyond each end extends runs to the frame.
        low, high = max(start - 1, 0), min(end + 1, len(curve))
        runs.append(curve[low:high] - turns[start] * lengths)
    return [run for run in runs if len(run) > 1]


_BROAD: dict[str, Any] = {"alpha": 0.3, "linewidth": 4.5}
"""Style of a reference behind the curve that follows it."""
_UNIT = np.array([1 / np.pi, 1.0])


def draw_chart(axes: Axes, chart: Chart, view: RunView) -> None:
    """Draw a chart's lines, bands, levels and limits.

    A line of a view other than `view` has no gaps.
    """
    quiet(axes, chart.title)
    axes.margins(x=0)
    scale = 1 / np.pi if chart.half_turns else chart.scale
    entries: dict[str, dict] = {}
    for line in chart.lines:
        if line.role != "detail":
            _line(axes, line, view, scale=scale)
        if line.label and line.role != "detail":
            broad = line.role == "reference"
            look = {"color": style.REFERENCE, **_BROAD, "alpha": 0.6} if broad else {"color": line.colour}
            look |= {"linestyle": DASHED} if line.dashed else {}
            entries[line.label] = {"linewidth": max(line.width, 1.5), **look}
    for first, last in chart.cut:
        axes.axvspan(first, last, color=style.LIMIT, alpha=0.3, linewidth=0.8, zorder=0.5)
        entries["cut"] = {"color": style.LIMIT, "linewidth": 6, "alpha": 0.3}
    _axis(axes, chart, scale=scale)
    ends = [scale * level.value for level in chart.levels if level.kind == "band"]
    if ends:
        axes.axhspan(min(ends), max(ends), color=style.MODES["holding"], alpha=0.35, linewidth=0)
    for level in chart.levels:
        if level.kind == "limit":
            _limit(axes, scale * level.value)
        elif level.kind == "named":
            _named_level(axes, level)
    letters = len(chart.title) + sum(len(label) + 4 for label in entries)
    where = ABOVE | (NARROW if letters > _BESIDE_TITLE else {})
    # The reference is listed after the following curve.
    key(axes, sorted(entries.items(), key=lambda entry: "alpha" in entry[1]), ncols=max(len(entries), 1), **where)


def _line(axes: Axes, line: Line, view: RunView, *, scale: float) -> None:
    if line.around and line.reach is not None:
        values, reach = scale * line.values, scale * line.reach
        axes.fill_between(line.time, values - reach, values + reach, color=line.colour, alpha=0.15, linewidth=0)
        axes.plot(line.time, values, color=line.colour, linewidth=line.width)
        return
    time, values = curve(view, line.time, scale * line.values)
    if line.role == "reference":
        axes.plot(time, values, color=line.colour, **_BROAD)
        return
    faint = line.reach is not None
    dashes = (0, (5, 1.2)) if line.dashed else "-"
    axes.plot(
        time, values, color=line.colour, linewidth=0.6 if faint else line.width, alpha=0.45 if faint else 1.0,
        linestyle=dashes,
    )  # fmt: skip
    if line.reach is not None:
        time, band = curve(view, line.time, scale * line.reach)
        axes.fill_between(time, -band, band, color=line.colour, alpha=0.10, linewidth=0)
        axes.plot(time, band, time, -band, color=line.colour, linewidth=1.1, zorder=3)


def _axis(axes: Axes, chart: Chart, *, scale: float) -> None:
    if chart.half_turns:
        axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
        label_in_pi(axes.yaxis)
    if chart.log:
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(base=10, numticks=6))
    elif chart.shown is not None:
        axes.set_ylim(scale * chart.shown[0], scale * chart.shown[1])


def _named_level(axes: Axes, level: LevelLine) -> None:
    low, high = axes.get_ylim()
    if not low <= level.value <= high:
        return
    axes.axhline(level.value, color=level.colour, linewidth=1.0, linestyle=DASHED)
    # Above the lower levels and below the upper, so that a name does not leave the panel.
    upper = axes.transData.transform((0, level.value))[1] > axes.transAxes.transform((0, 0.5))[1]
    axes.annotate(
        level.name, (1.0, level.value), xycoords=("axes fraction", "data"), xytext=(-2, -2 if upper else 2),
        textcoords="offset points", ha="right", va="top" if upper else "bottom", fontsize=7.5, color=level.colour,
        bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 0.8},
    )  # fmt: skip


def draw_plane(axes: Axes, runs: list[tuple[Plane, str]], *, tubes: bool = True) -> None:
    """Draw runs in one arm's phase plane.

    Each has a colour. Orbits and tubes are those of the first run.
    """
    first, _ = runs[0]
    quiet(axes, f"Arm {first.arm + 1}: ω{style.number(first.arm)} (rad/s) over θ{style.number(first.arm)}")
    entries: list[tuple[str, dict]] = []
    if first.orbits:
        entries.append(("orbits", {"color": first.orbits[0][0], "linewidth": 3.2}))
    for stable, colour, text in ((False, style.UNSTABLE, "tubes from"), (True, style.STABLE, "to them")):
        if tubes and first.strands[stable]:
            axes.plot(*_joined(first.strands[stable]), color=colour, linewidth=0.45, alpha=0.35, zorder=1.2)
            axes.plot(*_joined(first.cuts[stable]), color=colour, linewidth=1.8, zorder=2.5)
            entries.append((text, {"color": colour, "linewidth": 1.5}))
    for colour, points in first.orbits:
        look = {"color": colour, "zorder": 1.5, "alpha": 0.75 if tubes else 0.4}
        if len(points) > 3:
            axes.plot(*(points * _UNIT).T, linewidth=3.2, **look)
        else:
            axes.plot(*(points[0] * _UNIT), "D", markersize=8, **look)
    for plane, colour in runs:
        start, end = plane.ends * _UNIT
        if plane.run:
            axes.plot(*_joined(plane.run), color=colour, linewidth=1.1, zorder=3)
        axes.plot(*end, "s", color=colour, markersize=5, zorder=4)
        if len(runs) == 1:
            axes.plot(*start, "o", color=colour, markersize=5, zorder=4)
            _name_ends(axes, start, end)
    axes.margins(x=0.04)
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))
    label_in_pi(axes.xaxis)
    if entries:
        key(axes, entries, ncols=len(entries), **ABOVE)


def _joined(curves: list[Array]) -> Array:
    """Return curves (K, 2) as one (2, M) in page units, separated by nan."""
    apart = np.full((1, 2), np.nan)
    parts = [part for points in curves for part in (points * _UNIT, apart)]
    return np.concatenate(parts).T if parts else np.zeros((2, 0))


def _name_ends(axes: Axes, first: Array, last: Array) -> None:
    """Label start and end at their marks, with one label if they are near each other."""
    spans = np.abs([np.diff(axes.get_xlim())[0], np.diff(axes.get_ylim())[0]]).clip(1e-9)
    near = bool((np.abs(last - first) < np.array([0.16, 0.12]) * spans).all())
    for text, place in [("start, end", first)] if near else [("start", first), ("end", last)]:
        if np.isfinite(place).all():
            axes.annotate(
                text, tuple(place), xytext=(4, -4), textcoords="offset points", va="top", fontsize=7.5,
                color=style.INK, bbox={"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 0.6}, zorder=5,
            )  # fmt: skip


_LETTER = 0.077
"""Width of a letter, inches."""
_TALL = 0.84
_WRONG = {"facecolor": "#f7d9d6", "edgecolor": style.LIMIT, "hatch": "xxxx"}
_BETWEEN = {"facecolor": "#eceef0", "edgecolor": style.FAINT, "hatch": "////"}


def story_rows(view: RunView, *, span: Range | None = None) -> list[Strip]:
    """Return the rows of the story, from the top."""
    return [strip for strip in strips(view, until=None if span is None else span[1]) if strip.name]


def story(axes: Axes, view: RunView, *, span: Range | None = None, legend: bool = True) -> None:
    """Draw planned stays, decoded stays and modes over time.

    `span` is the time range to show, s; by default that of the motion and its plan.
    """
    rows = story_rows(view, span=span)
    begin, end = span or view.span
    figure = axes.get_figure(root=True)
    letter = _LETTER * (end - begin) / (axes.get_position().width * figure.get_figwidth())  # type: ignore[union-attr]
    for place, strip in enumerate(reversed(rows)):
        for part in strip.spans:
            _part(axes, part, place, view, letter=letter, named=strip.name != "controller")
    _numbers(axes, view, [strip.name for strip in rows], letter=letter, begin=begin, end=end)
    axes.set_xlim(begin, end)
    axes.set_ylim(-0.08, len(rows) + 0.02)
    axes.set_yticks([place + _TALL / 2 for place in range(len(rows))], [strip.name for strip in reversed(rows)])
    axes.tick_params(labelsize=SMALL, colors=style.NOTE, length=2.5)
    axes.tick_params(axis="y", length=0)
    unit = " (s)" if view.arm_lengths else ""
    axes.set_xlabel(f"time{unit}", fontsize=SMALL, color=style.NOTE, loc="left", labelpad=0)
    for side, spine in axes.spines.items():
        spine.set_visible(side == "bottom")
        spine.set_color(style.FAINT)
    if legend:
        _legend(axes, rows)


def _part(axes: Axes, part: Span, place: int, view: RunView, *, letter: float, named: bool) -> None:
    """Draw a span of a strip, with its text if there is room."""
    # A mode of one tick, as at an end, is widened to remain visible.
    width = max(part.last - part.first, letter * (0.8 if part.kind == "mode" else 0.5))
    first = part.last - width if part.kind == "mode" else part.first
    look = {"astray": _WRONG, "transfer": _BETWEEN, "ended": _BETWEEN}.get(part.kind, {"facecolor": part.colour})
    axes.broken_barh([(first, width)], (place, _TALL), linewidth=0, **look)  # type: ignore[arg-type]
    text = {"mode": "", "ended": f"the run ended at {part.first:.2f} s" if named else ""}.get(part.kind, part.text)
    crossed = part.kind == "transfer" and any(part.first <= at <= part.last for at, _ in view.plan.symbols)
    if text and not crossed and width > letter * (len(text) + 1):
        colour = {"stay": "white", "astray": style.LIMIT}.get(part.kind, style.NOTE)
        box = None if part.kind == "stay" else {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
        axes.text(
            first + width / 2, place + _TALL / 2, text, ha="center", va="center_baseline", fontsize=SMALL,
            color=colour, bbox=box, clip_on=True, zorder=4,
        )  # fmt: skip


def _numbers(axes: Axes, view: RunView, rows: list[str], *, letter: float, begin: float, end: float) -> None:
    """Number the symbols at their planned and actual times.

    If there is room, their names are above.
    """
    free = begin
    for i, (name, planned, done) in enumerate(view.symbols):
        for row, moment in ((rows[0], planned), ("done", done)):
            if row in rows and moment is not None and begin <= moment <= end:
                place = len(rows) - 1 - rows.index(row)
                axes.plot([moment, moment], [place, place + _TALL], color=style.INK, linewidth=1.4, zorder=4.5)
                if row == rows[0]:
                    badge(axes, i + 1, moment, place + _TALL / 2)
        half = letter * len(name) / 2
        left = min(max(planned - half, begin), end - 2 * half)
        if left > free and begin <= planned <= end:
            axes.text(left + half, len(rows) - 0.02, name, ha="center", va="bottom", fontsize=SMALL, color=style.INK)
            free = left + 2 * half + letter


def _legend(axes: Axes, rows: list[Strip]) -> None:
    every = [part for strip in rows for part in strip.spans]
    shown = {part.text: part.colour for part in every if part.kind == "mode"}
    handles = [Patch(color=colour, label=name) for name, colour in shown.items()]
    if any(part.kind == "astray" for part in every):
        handles.append(Patch(**_WRONG, linewidth=0, label="not planned"))  # type: ignore[arg-type]
    if handles:
        axes.legend(
            handles=handles, loc="upper right", bbox_to_anchor=(1.0, -0.28 / max(len(rows), 1)), ncols=len(handles),
            fontsize=SMALL, frameon=False, handlelength=1.2, handleheight=0.9, columnspacing=1.2, borderpad=0,
            borderaxespad=0.9,
        )  # fmt: skip


def notes(axes: Axes, view: RunView, *, lines: int) -> None:
    """Write the symbols with their times, then as many events as fit."""
    axes.axis("off")
    if not view.symbols and not view.events:
        return
    text = [("Itinerary: planned → done (s)", True)] if view.symbols else []
    for i, (name, at, done) in enumerate(view.symbols):
        seen = "" if done is None else f" → {done:.2f}"
        text.append((f"{i + 1}  {shorten(name, 40, placeholder=' …')}   {at:.2f}{seen}", False))
    most = lines // 2 - 1
    if len(text) > most + 1:
        text = [*text[:most], (f"… and {len(text) - most} more", False)]
    text += [("", False), ("Events", True)] if text else [("Events", True)]
    events = [(f"{event.time:7.2f} s  {event.text}", False) for event in view.events]
    room = max(1, lines - len(text))
    if len(events) > room:
        # The end describes the result, the start the kind of run.
        events = [events[0], (f"… {len(events) - room + 1} more …", False), *events[len(events) - room + 2 :]]
    text += events or [("none", False)]
    for row, (line, heading) in enumerate(text):
        axes.text(
            0.0, 1.0 - row / lines, line if len(line) < 68 else line[:66] + "…", transform=axes.transAxes, va="top",
            fontsize=9.5 if heading else SMALL, color=style.INK if heading else style.NOTE,
        )  # fmt: skip


_FRAME_STEP = 2.12
"""Distance between the film's frames, in lengths of all arms: enough for two stretched towards one another."""


def draw_film(axes: Axes, view: RunView, times: Array) -> None:
    """Draw the arms at several times (K,) s.

    The reference is grey behind them. The tip's path begins at the last frame.

    Times outside the motion are skipped.
    """
    state, arms, reach = view.state, view.arms, sum(view.arm_lengths)
    horizontal, vertical = film_extent(view, times)
    axes.set(xlim=horizontal, ylim=vertical)
    pivot, width, tip = view.pivot, 0.05 * reach, style.arm_colour(arms - 1)
    rows = film_rows(view, times)
    for i, (time, row) in enumerate(zip(times, rows, strict=True)):
        at = frame_position(view, i)
        if not view.time[0] <= time <= view.time[-1]:
            axes.text(at, 0, f"no data at\n{time:.2f} s", ha="center", va="center", fontsize=8.5, color=style.MARK)
            continue
        if view.has_cart:
            axes.plot([at - 0.98 * reach, at + 0.98 * reach], [0, 0], color=style.FAINT, linewidth=2.5, zorder=1)
            axes.add_patch(Rectangle((at - 0.13 * reach, -width), 0.26 * reach, 2 * width, color=style.CART, zorder=2))
        before = max(1, round((0.25 if i else 0.1) * view.rate_hz))
        since = max(rows[i - 1] if i else 0, row - before)
        points = arm_points(state[since : row + 1, :arms], view.arm_lengths)
        points[..., 0] += at + (pivot[since : row + 1] - pivot[row])[:, None]
        last = points[-1]
        axes.plot(*points[:, -1].T, color=tip, alpha=0.3, linewidth=1.3)
        for arm in range(arms):
            look: dict[str, Any] = {"color": style.arm_colour(arm), "linewidth": 2.6, "solid_capstyle": "round"}
            axes.plot(*last[arm : arm + 2].T, **look, zorder=3)
        axes.plot(*last[:-1].T, "o", color=style.INK, markersize=3.2, zorder=4)
        axes.plot(*last[-1], "o", color=tip, markersize=5.5, zorder=4)
        if view.reference is not None:
            ghost = arm_points(view.reference[row : row + 1, :arms], view.arm_lengths)[0]
            shift = at + (view.reference[row, 2 * arms] - pivot[row] if view.has_cart else 0.0)
            look = {"color": "#b4bbc3", "linewidth": 6.5, "solid_capstyle": "round", "zorder": 2.5}
            axes.plot(shift + ghost[:, 0], ghost[:, 1], **look)
        cart = f"\ncart {round(1000 * float(pivot[row])):+d} mm" if np.isfinite(pivot[row]) else "\nlost"
        text = f"{view.time[row]:.2f} s{cart if view.has_cart else ''}"
        look = {"ha": "center", "va": "top", "fontsize": 8.5, "color": style.NOTE, "linespacing": 1.25}
        axes.text(at, vertical[0] + 0.46 * reach, text, **look)
    axes.axis("off")


def frame_position(view: RunView, frame: int) -> float:
    """Return the drawn position of the pivot of a frame, m."""
    return frame * _FRAME_STEP * sum(view.arm_lengths)


def film_extent(view: RunView, times: Array) -> tuple[Range, Range]:
    """Return the x and y limits in m for `draw_film`.

    Vertically they cover the arms in its frames.
    """
    rows, reach = film_rows(view, times), sum(view.arm_lengths)
    shown = [view.state] if view.reference is None else [view.state, view.reference]
    both = np.concatenate([states[rows, : view.arms] for states in shown])
    heights = arm_points(both[np.isfinite(both).all(axis=1)], view.arm_lengths)[..., 1].ravel()
    heights = np.append(heights, 0.0)
    low, high = min(float(heights.min()), -0.2 * reach), max(float(heights.max()), 0.1 * reach)
    step = _FRAME_STEP * reach
    return (-0.53 * step, (len(times) - 0.47) * step), (low - 0.62 * reach, high + 0.1 * reach)


def film_height(view: RunView, times: Array, *, width: float) -> float:
    """Return the height of a film of this width at equal scales."""
    (left, right), (low, high) = film_extent(view, times)
    return width * (high - low) / (right - left)


def film_rows(view: RunView, times: Array) -> NDArray[np.int64]:
    """Return the ticks shown in the film."""
    return np.searchsorted(view.time, times).clip(0, len(view.time) - 1)


def film_times(view: RunView, *, frames: int, until: float = np.inf) -> Array:
    """Return (frames,) times for a filmstrip.

    They are distributed among the symbols' crossings, otherwise evenly.

    On either side of a crossing they span a third of the period of a simple pendulum as long as all arms. For a run
    that failed, the last quarter of the frames covers its end. `until` is the latest time, s.
    """
    time = view.time[view.time <= until]
    if view.good is False and frames > 3 and time[-1] > time[0]:
        last = frames // 4
        # A run that ended at once gets no more than its share.
        length = min(0.2 * last, (time[-1] - time[0]) * last / frames)
        ending = np.linspace(time[-1] - length, time[-1], last + 1)
        before = film_times(replace(view, good=None), frames=frames - last, until=ending[0])
        return np.concatenate([before, ending[1:]])
    moments = np.array([done or planned for _, planned, done in view.symbols])
    moments = moments[(moments >= time[0]) & (moments <= time[-1])] if len(moments) else moments
    if not len(moments):
        return np.linspace(time[0], time[-1], frames)
    moments = moments[np.linspace(0, len(moments) - 1, min(len(moments), frames)).astype(int)]
    half = 0.33 * 2 * np.pi * np.sqrt(sum(view.arm_lengths) / 9.81)
    parts = []
    for i, moment in enumerate(moments):
        share = frames // len(moments) + (i < frames % len(moments))
        parts.append(
            moment + half * np.linspace(-1, 1, share)
            if share > 2
            else np.linspace(moment - half / 2, moment, share + 1)[1:]
        )
    return np.sort(np.clip(np.concatenate(parts), time[0], time[-1]))


_SIZE = (16.0, 11.6)
_ROWS, _TALLER = 4, 1.5
"""Charts in a column of a page of that size, and the height of each further one, inches."""
_FRAMES = 8
_NOTES = 0.185
_NOTE_LINES = 13
_COLUMNS, _WIDTH = (0.045, 0.372, 0.70), 0.285
_ROW = 0.019
"""Height of a row of the story, inches."""
_ABOVE = 0.04
"""Gap between two panels for the title of the lower one, inches."""


def draw(view: RunView, more: Sequence[Chart] = ()) -> Figure:
    """Return the page of a view as a figure.

    The charts in `more` are added to the view's.
    """
    left, middle = list(series.motion_charts(view)), [*series.check_charts(view), *series.extra_charts(view), *more]
    while len(left) > len(middle) + 1:
        middle.insert(0, left.pop())
    while len(middle) > len(left) + 1:
        left.append(middle.pop(0))
    width, height = _SIZE[0], _SIZE[1] + _TALLER * max(0, max(len(left), len(middle)) - _ROWS)
    figure = new_figure(width, height)
    _heading(figure, view)
    top = 0.925
    rows = story_rows(view)
    if rows:
        tall = _ROW * len(rows)
        top -= 0.022
        story(figure.add_axes((0.062, top - tall, 0.925, tall)), view)
        top -= tall + 0.032
    times = film_times(view, frames=_FRAMES)
    # The panels below use the remaining height.
    tall = film_height(view, times, width=0.98 * width) / height
    draw_film(figure.add_axes((0.01, top - tall, 0.98, tall)), view, times)
    top -= tall + 0.03
    bottom = 0.005
    for column, chosen in zip(_COLUMNS, (left, middle), strict=False):
        _stack(figure, chosen, view, left=column, top=top, bottom=bottom + 0.035)
    share = (top - bottom - _NOTES) / 2
    for arm in range(min(view.arms, 2)):
        axes = figure.add_axes((_COLUMNS[2], top - arm * share - (share - 0.05), 0.28, share - 0.05))
        draw_plane(axes, [(series.plane(view, arm), style.INK)])
    notes(figure.add_axes((_COLUMNS[2], bottom, 0.28, _NOTES)), view, lines=_NOTE_LINES)
    return figure


def _stack(
    figure: Figure, chosen: list[series.Chart], view: RunView, *, left: float, top: float, bottom: float
) -> None:
    """Draw charts one below the other, on one axis of time."""
    tall = (top - bottom + _ABOVE) / max(len(chosen), 1)
    begin, end = view.time_range
    for row, chart in enumerate(chosen):
        axes = figure.add_axes((left, top - row * tall - (tall - _ABOVE), _WIDTH, tall - _ABOVE))
        draw_chart(axes, chart, view)
        axes.set_xlim(begin, end)
        last = row == len(chosen) - 1
        axes.tick_params(labelbottom=last)
        axes.set_xlabel("time (s)" if last else "")
        mark_times(axes, [at for at, _ in view.plan.symbols if begin <= at <= end])


def _heading(figure: Figure, view: RunView) -> None:
    """Write title, origin and verdict at the top of a page."""
    title = shorten(view.title, 112, placeholder=" …")
    look: dict[str, Any] = {"va": "center", "color": style.INK}
    figure.text(0.022, 0.975, title, fontsize=17 if len(title) < 72 else 14, weight="bold", **look)
    about = "   ".join([view.path.name, view.metadata.get("program", "")])
    figure.text(0.985, 0.975, about, fontsize=SMALL, color=style.MARK, va="center", ha="right")
    lines = wrap(view.verdict, 120) or [""]
    if len(lines) > 1:
        lines = wrap(view.verdict, 150, max_lines=2, placeholder=" …")
    look |= {"color": style.verdict_colour(view.good), "fontsize": 12 if len(lines) == 1 else 9.5}
    figure.text(0.022, 0.947, "\n".join(lines), **look)


def draw_log(log: RunLog) -> Figure:
    """Return the page of a log as a figure."""
    return draw(run_view(log))


def draw_run(run: Run) -> Figure:
    """Return the page of a run as a figure."""
    return draw_log(run.log)
