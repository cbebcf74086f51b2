"""What every figure is made of: a page, its words, quiet axes, and the gallery that figures are drawn from."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MultipleLocator
from numpy.typing import NDArray

from dpcontrol.bifurcations.bifurcations import BranchDiagram
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.review import style
from dpcontrol.walks.atlas import Atlas

Array = NDArray[np.float64]

UNSTABLE, STABLE = "#b3261e", "#1e7a3c"
"""The usual red for what leaves an orbit and green for what comes to it."""
SADDLES = {"down-up": "#1f6fb4", "up-down": "#d9640d", "L1": "#1f6fb4", "L2": "#d9640d"}
FEW = ("#1f6fb4", "#d9640d", "#8a4fa3", "#9a6b15", "#0f8b8d", "#c2185b", "#5b6470", "#6b8e23")
"""Colours that tell connections apart."""
DPI = 110


@dataclass(frozen=True)
class Gallery:
    """What figures are drawn from; each figure asks for what it needs.

    system: of a model by name. atlas: of a model, an energy in J and hits (None: the first that there are).
    branches: of a model, a source and a target, with what to report to: their connections against energy.
    progress: where the figure being drawn reports how far it is.
    """

    system: Callable[[str], System]
    atlas: Callable[[str, float, tuple[int, int] | None], Atlas]
    branches: Callable[[str, str, str, Progress], BranchDiagram]
    progress: Progress = no_progress


@dataclass(frozen=True)
class Page:
    """A figure with its words: what it shows, and what differs from the paper's and why."""

    figure: Figure
    caption: str
    differs: str


def new_figure(width: float, height: float, title: str) -> Figure:
    """Return an empty figure of a size in inches with a title."""
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=0.015, y=0.985, ha="left", va="top", fontsize=13, weight="bold", color=style.INK)
    return figure


def quiet(axes: Axes, title: str = "") -> None:
    """Give axes the quiet frame and grid of every figure."""
    if title:
        axes.set_title(title, loc="left", fontsize=10, color=style.INK)
    axes.tick_params(labelsize=8.5, colors="#555c64", length=2.5)
    axes.grid(color="#e6e9ec", linewidth=0.7)
    axes.set_axisbelow(True)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(style.FAINT)


def in_pi(value: float, _: object = None) -> str:
    """Return an angle in units of π."""
    share = value / np.pi
    if abs(share) < 1e-9:
        return "0"
    text = f"{share:.3g}"
    return {"1": "π", "-1": "−π"}.get(text, f"{text}π".replace("-", "−"))


def angle_axis(axes: Axes, which: str, *, step: float | None = None) -> None:
    """Tick the "x" or "y" axis in multiples of π, by `step` of them or as fits what has been drawn."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    if step is None:
        low, high = axis.get_view_interval()
        span = (high - low) / np.pi
        step = next((s for s in (0.05, 0.1, 0.25, 0.5, 1.0, 2.0) if span / s <= 5), 4.0)
    axis.set_major_locator(MultipleLocator(step * np.pi))
    axis.set_major_formatter(FuncFormatter(in_pi))


def saddle_colour(saddle: str) -> str:
    """Return the colour of what belongs to a saddle."""
    return SADDLES.get(saddle, style.CART)


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


def short_name(name: str) -> str:
    """Return a connection's winding and place, without what the figure says already."""
    return name[name.index("[") :] if "[" in name else name
