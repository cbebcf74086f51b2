"""A long run on one page."""

import math
from collections.abc import Sequence
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from dpcontrol.judge.night import BETWEEN, CALMING, ITINERARY, STARTING, STOPPED, UNKNOWN, Night
from dpcontrol.pages import style
from dpcontrol.pages.page import new_figure, quiet

_COLOURS = {
    ITINERARY: "#9fd3a8", CALMING: "#e8877f", STARTING: "#f2c46d", BETWEEN: "#8fbce6", UNKNOWN: "#22262b",
    STOPPED: "#ffffff",
}  # fmt: skip
_ROW = 1800.0
"""Duration of a row of the strip, s, short enough to show absences of seconds; longer in long nights."""
_ROWS = 32
_REMAINDER = 5.0
"""Time at the end of a night, s, that gets no separate row, for example while the cart is braked."""


def draw_night(night: Night) -> Figure:
    """Return one page on a night.

    It shows strips of half an hour, times to return, causes, and drift of the parameters.
    """
    last = max(span.end for span in night.spans)
    row = last if last <= 600.0 + _REMAINDER else 600.0 if last <= 3600.0 else _ROW * math.ceil(last / _ROW / _ROWS)
    rows = max(1, math.ceil((last - _REMAINDER) / row))
    strip, others = max(1.0, 0.42 * rows), 1.7
    height = 4.6 + 0.42 * rows
    figure = new_figure(12.0, height)
    grid = figure.add_gridspec(
        3, 2, height_ratios=[strip, others, others], left=0.09, right=0.94, top=1 - 0.75 / height,
        bottom=0.75 / height, hspace=2.7 / (strip + 2 * others), wspace=0.25,
    )  # fmt: skip
    title = fill(f"{night.folder.name}: {night.sentence}", 150)
    figure.text(0.03, 1 - 0.22 / height, title, fontsize=9.5, va="center")
    _draw_strip(figure.add_subplot(grid[0, :]), night, row, rows)
    _draw_returns(figure.add_subplot(grid[1, 0]), night)
    _draw_causes(figure.add_subplot(grid[1, 1]), night)
    names = night.estimated
    zeros = [name for name in names if name.startswith("zero_")]
    _draw_drift(figure.add_subplot(grid[2, 0]), night, "Encoder zeros, change since the first file", "mrad", zeros, 1e3)
    others = [name for name in names if name not in zeros]
    _draw_drift(
        figure.add_subplot(grid[2, 1]), night, "Other parameters, change since first file", "share", others, 1.0
    )
    return figure


_FALLS = {
    "tracking lost": "#b3261e", "estimate lost": "#8a4fa3", "cart near its stop": "#d9640d", "limit switch": "#d9640d",
    "sensor stuck": "#1f6fb4", "no measurement": "#0f8b8d",
}  # fmt: skip


def _draw_strip(axes: Axes, night: Night, row: float, rows: int) -> None:
    quiet(axes)
    scale = 60.0
    for span in night.spans:
        first = span.first
        while first < span.end - 1e-9:
            k = int(first / row + 1e-9)
            end = min(span.end, (k + 1) * row)
            # The edge keeps short absences visible.
            colour, edge = _COLOURS[span.kind], 0.0 if span.kind in (ITINERARY, STOPPED) else 0.8
            axes.barh(k, (end - first) / scale, left=(first - k * row) / scale, height=0.78, color=colour,
                      edgecolor=colour, linewidth=edge)  # fmt: skip
            first = end
    for fall in night.falls:
        k = min(int(fall.time / row), rows - 1)
        axes.plot((fall.time - k * row) / scale, k - 0.42, marker="v", markersize=4.5, clip_on=False,
                  color=_FALLS.get(fall.cause, style.INK), linewidth=0)  # fmt: skip
    for k in range(rows):
        within = [(max(s.first, k * row), min(s.end, (k + 1) * row), s.kind) for s in night.spans]
        total = sum(max(b - a, 0.0) for a, b, kind in within if kind != UNKNOWN)
        on = sum(max(b - a, 0.0) for a, b, kind in within if kind == ITINERARY)
        if total:
            axes.text(1.008, k, f"{on / total:.0%}", transform=axes.get_yaxis_transform(), va="center", fontsize=8.5)
    minutes = [round(k * row / 60) for k in range(rows)]
    labels = [f"{m // 60}:{m % 60:02d} h" if row >= _ROW else f"{m} min" for m in minutes]
    axes.set_yticks(range(rows), labels)
    axes.set(xlim=(0, row / scale), ylim=(rows - 0.5, -0.65))
    axes.set_xlabel("minutes", fontsize=8.5)
    axes.set_title("up", loc="right", fontsize=8.5, color=style.NOTE)
    shown = [kind for kind in _COLOURS if any(s.kind == kind for s in night.spans) and kind != STOPPED]
    handles: list[Any] = [Patch(color=_COLOURS[kind], label=kind) for kind in shown]
    handles += [
        axes.plot([], [], marker="v", linewidth=0, markersize=5, color=_FALLS.get(cause, style.INK),
                  label=f"fall: {cause}")[0]
        for cause in night.causes
    ]  # fmt: skip
    axes.legend(handles=handles, ncols=len(handles), loc="lower left", bbox_to_anchor=(0, 1.0), fontsize=8.5,
                frameon=False, handlelength=1.2, columnspacing=1.4)  # fmt: skip


def _draw_returns(axes: Axes, night: Night) -> None:
    quiet(axes, "Time from the fall back onto the itinerary", x="s", y="share of falls within")
    returns = np.sort(night.returns)
    if not len(returns):
        axes.text(0.5, 0.5, "no falls", transform=axes.transAxes, ha="center", color=style.NOTE)
        return
    shares = np.arange(1, len(returns) + 1) / len(returns)
    axes.step(np.r_[0, returns], np.r_[0, shares], where="post", color=style.ARMS[0])
    for share, name, height in ((0.5, "median", 0.16), (0.99, "99 %", 0.04)):
        value = float(np.quantile(returns, share))
        axes.axvline(value, color=style.MARK, linewidth=0.8, linestyle=":")
        axes.text(value, height, f" {name} {value:.1f} s", fontsize=8, color=style.NOTE)
    axes.set(xlim=(0, 1.3 * returns[-1]), ylim=(0, 1.03))


def _draw_causes(axes: Axes, night: Night) -> None:
    quiet(axes, "Falls by cause")
    causes = night.causes
    axes.barh(range(len(causes)), list(causes.values()), color=[_FALLS.get(c, style.INK) for c in causes], height=0.6,
              alpha=0.8)  # fmt: skip
    axes.set_yticks(range(len(causes)), list(causes))
    axes.set_ylim(max(len(causes) - 0.4, 0.6), -0.6)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_drift(axes: Axes, night: Night, title: str, unit: str, names: Sequence[str], scale: float) -> None:
    quiet(axes, title, x="hours", y=unit)
    for k, name in enumerate(names):
        hours, values = night.course(name)
        colour = style.RUNS[k % len(style.RUNS)]
        line = "-" if k < len(style.RUNS) else "--"
        axes.plot(hours, scale * (values - values[0]), line, color=colour, marker="o", markersize=2.5, linewidth=1.1,
                  label=name)  # fmt: skip
    if names:
        axes.legend(ncols=len(names), fontsize=7.5, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.24),
                    handlelength=1.4, columnspacing=1.0)  # fmt: skip
