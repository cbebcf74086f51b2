"""What every page is made of: an empty figure, quiet panels with a legend above, limits, angles in units of π."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MultipleLocator
from numpy.typing import NDArray

from dpcontrol.foundation.files import whole_file
from dpcontrol.review import style
from dpcontrol.review.motion import RunView
from dpcontrol.review.series import telling_rows

Array = NDArray[np.float64]

SMALL = 8.5
_DPI = 110
_BINS = 1500
DOTTED, DASHED = (0, (2, 2)), (0, (5, 3))


def new_figure(width: float, height: float, title: str = "") -> Figure:
    """Return an empty white figure of a size in inches with a title."""
    figure = Figure(figsize=(width, height), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, x=0.015, y=0.985, ha="left", va="top", fontsize=13, weight="bold", color=style.INK)
    return figure


def save_figure(figure: Figure, path: Path | str) -> None:
    """Write a figure as PNG or PDF, by the name's suffix.

    Raises:
        InputError: the file cannot be written.
    """
    path = Path(path)
    kind = "pdf" if path.suffix.lower() == ".pdf" else "png"
    with whole_file(path, suffix=f".{kind}") as temporary:
        figure.savefig(temporary, format=kind)


def quiet(axes: Axes, label: str = "", *, size: float = 9.5) -> None:
    """Set a panel's title and its quiet frame and grid."""
    if label:
        axes.set_title(label, loc="left", fontsize=size, color=style.INK, pad=4)
    axes.tick_params(labelsize=SMALL, colors=style.NOTE, length=2.5)
    axes.grid(color=style.GRID, linewidth=0.7)
    axes.set_axisbelow(True)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(style.FAINT)


def legend(axes: Axes, entries: list[tuple[str, dict]]) -> None:
    """Put a legend on one line above the panel, right, where it cannot cover a curve."""
    handles = [Line2D([], [], label=label, **look) for label, look in entries]
    axes.legend(
        handles=handles, loc="lower right", bbox_to_anchor=(1.005, 1.0), ncols=len(handles), fontsize=SMALL,
        frameon=False, handlelength=1.5, columnspacing=1.1, handletextpad=0.5, borderpad=0, borderaxespad=0.1,
    )  # fmt: skip


def angle_axis(axes: Axes, which: str, *, step: float | None = None) -> None:
    """Tick the "x" or "y" axis in multiples of π, by `step` of them or as fits what has been drawn."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    if step is None:
        low, high = axis.get_view_interval()
        span = (high - low) / np.pi
        step = next((s for s in (0.05, 0.1, 0.25, 0.5, 1.0, 2.0) if span / s <= 5), 4.0)
    axis.set_major_locator(MultipleLocator(step * np.pi))
    axis.set_major_formatter(FuncFormatter(lambda value, _: style.in_pi(value / np.pi)))


def label_in_pi(axis: Axis) -> None:
    """Label an axis of half turns, with as many digits as tell its ends apart."""

    def text(value: float, _: object) -> str:
        low, high = axis.get_view_interval()
        largest = max(abs(low), abs(high))
        finest = np.log10(largest / (high - low)) if high > low else 0.0
        return style.in_pi(value, digits=3 + max(0, int(np.ceil(finest))))

    axis.set_major_formatter(FuncFormatter(text))


def curve(view: RunView, time: Array, values: Array) -> tuple[Array, Array]:
    """Return a series (K,) of a view, thinned to its peaks, with nan in its gaps so that no line crosses them."""
    rows = telling_rows(values, bins=_BINS)
    time, values = time[rows], values[rows]
    if not len(view.breaks):
        return time, values
    gaps = (view.time[view.breaks] + view.time[view.breaks - 1]) / 2
    places = np.searchsorted(time, gaps)
    return np.insert(time, places, gaps), np.insert(values, places, np.nan)


def mark_times(axes: Axes, moments: list[float]) -> None:
    """Mark moments (s) with a dotted line."""
    for moment in moments:
        axes.axvline(moment, color=style.MARK, linewidth=0.9, linestyle=DOTTED, zorder=1.5)


def limit_line(axes: Axes, value: float) -> None:
    """Draw a limit, and shade what lies beyond, where the curves come near it."""
    low, high = axes.get_ylim()
    if low - 0.35 * (high - low) < value < high + 0.35 * (high - low):
        axes.axhline(value, color=style.LIMIT, linewidth=1.1, linestyle=DASHED)
        low, high = min(low, 1.06 * value), max(high, 1.06 * value)
        axes.axhspan(value, 1e3 * value, color=style.LIMIT, alpha=0.08, linewidth=0)
    axes.set_ylim(low, high)


def say(axes: Axes, text: str) -> None:
    """Say in a panel why it is empty."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", fontsize=9, color=style.NOTE)


def badge(axes: Axes, number: int, x: float, y: float, *, size: float = 7.5) -> None:
    """Put a symbol's number, white on a dark disc."""
    axes.text(
        x, y, str(number), ha="center", va="center_baseline", fontsize=size, color="white", zorder=6, clip_on=False,
        bbox={"boxstyle": "circle,pad=0.25", "facecolor": style.INK, "edgecolor": "none"},
    )  # fmt: skip


def wrapped_runs(curve: Array, periods: tuple[float | None, ...]) -> list[Array]:
    """Return a curve (K, D) as runs with each coordinate inside one period about zero, cut where it leaves."""
    finite = np.array([period if period else np.inf for period in periods])
    turns = np.where(np.isfinite(finite), np.rint(curve / finite), 0.0)
    lengths = np.where(np.isfinite(finite), finite, 0.0)
    breaks = np.flatnonzero((np.diff(turns, axis=0) != 0).any(axis=1)) + 1
    runs = []
    for start, end in zip(np.r_[0, breaks], np.r_[breaks, len(curve)], strict=True):
        # One point beyond each end lets runs meet the frame.
        low, high = max(start - 1, 0), min(end + 1, len(curve))
        runs.append(curve[low:high] - turns[start] * lengths)
    return [run for run in runs if len(run) > 1]
