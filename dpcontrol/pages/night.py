"""A long run on one page."""

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dpcontrol.foundation.causes import Cause
from dpcontrol.foundation.units import prefixed
from dpcontrol.judge.night import BETWEEN, CALMING, ITINERARY, STARTING, STOPPED, UNKNOWN, Night
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, Panel
from dpcontrol.pages.panels import empty, name_curves, name_rows, quiet

_COLOURS = {
    ITINERARY: style.MODES["holding"], CALMING: style.MODES["saturated"], STARTING: style.MODES["pulsing"],
    BETWEEN: style.MODES["tracking"], UNKNOWN: style.INK, STOPPED: style.PAPER,
}  # fmt: skip
_ROW = 1800.0
"""Duration of a row of the strip, s, short enough to show absences of seconds; longer in long nights."""
_ROWS = 32
_REMAINDER = 5.0
"""Time at the end of a night, s, that gets no separate row, for example while the cart is braked."""


def draw_night(night: Night) -> Figure:
    """Return one page on a night.

    It shows strips of half an hour, times by activity and to return, causes, and drift of the parameters.
    """
    last = max(span.end for span in night.spans)
    row = last if last <= 600.0 + _REMAINDER else 600.0 if last <= 3600.0 else _ROW * math.ceil(last / _ROW / _ROWS)
    rows = max(1, math.ceil((last - _REMAINDER) / row))
    names = night.estimated
    zeros = [name for name in names if name.startswith("zero_")]
    page = Page(night.folder.name, night.sentence)
    page.strip(partial(_draw_strip, night=night, row=row, rows=rows), height=1.0 + 0.36 * rows)
    causes = Panel(partial(draw_causes, night=night), 1.1)
    page.row(Panel(partial(_draw_times, night=night)), causes, partial(_draw_returns, night=night), height=2.1)
    return page.row(
        partial(_draw_drift, night=night, title="Encoder zeros, change since the first file", names=zeros),
        partial(_draw_drift, night=night, title="Other parameters, change since the first file",
                names=[name for name in names if name not in zeros]),
        height=2.3,
    ).figure()  # fmt: skip


_FALLS: dict[str, str] = {
    Cause.TRACKING_LOST: style.LIMIT,
    Cause.FALLEN: style.LIMIT,
    Cause.TOO_FAST: style.LIMIT,
    Cause.NOT_HELD: style.LIMIT,
    Cause.ESTIMATE_LOST: style.ESTIMATE,
    Cause.CART: style.SERIES[5],
    Cause.SWITCH: style.SERIES[5],
    Cause.STUCK: style.SERIES[0],
    Cause.SILENT: style.SERIES[2],
}


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
            axes.text(
                1.008, k, f"{on / total:.0%}", transform=axes.get_yaxis_transform(), va="center", fontsize=style.SMALL
            )
    minutes = [round(k * row / 60) for k in range(rows)]
    labels = [f"{m // 60}:{m % 60:02d} h" if row >= _ROW else f"{m} min" for m in minutes]
    axes.set_yticks(range(rows), labels)
    axes.set(xlim=(0, row / scale), ylim=(rows - 0.5, -0.65))
    axes.set_xlabel("minutes", fontsize=style.SMALL)
    title = "Half an hour and less a row, with the share of it on the itinerary; triangles are falls"
    axes.set_title(title if row > 600 else "The run, with the share on the itinerary; triangles are falls", loc="left")


def _draw_times(axes: Axes, night: Night) -> None:
    spent = {kind: sum(s.end - s.first for s in night.spans if s.kind == kind) for kind in _COLOURS if kind != STOPPED}
    spent = {kind: time for kind, time in spent.items() if time}
    scale, unit = (1 / 3600, "hours") if max(spent.values(), default=0.0) > 3600 else (1 / 60, "minutes")
    quiet(axes, f"Time by activity ({unit}), in the strip's colours")
    axes.barh(range(len(spent)), [scale * t for t in spent.values()], color=[_COLOURS[k] for k in spent], height=0.6)
    name_rows(axes, list(spent))


def _draw_returns(axes: Axes, night: Night) -> None:
    quiet(axes, "Time from the fall back onto the itinerary", x="s", y="share of falls within")
    returns = np.sort(night.returns)
    if not len(returns):
        empty(axes, "Time from the fall back onto the itinerary", "no falls")
        return
    shares = np.arange(1, len(returns) + 1) / len(returns)
    axes.step(np.r_[0, returns], np.r_[0, shares], where="post", color=style.ARMS[0])
    # The curve leaves the upper left and the lower right free.
    for share, name, height, side in ((0.5, "median", 0.88, "right"), (0.99, "99 %", 0.05, "left")):
        value = float(np.quantile(returns, share))
        axes.axvline(value, color=style.MARK, linewidth=0.8, linestyle=":")
        axes.text(value, height, f" {name} {value:.1f} s ", fontsize=style.SMALL, color=style.NOTE, ha=side)
    axes.set(xlim=(0, 1.3 * returns[-1]), ylim=(0, 1.03))


def draw_causes(axes: Axes, night: Night) -> None:
    quiet(axes, "Falls by cause, in the triangles' colours")
    causes = night.causes
    axes.barh(range(len(causes)), list(causes.values()), color=[_FALLS.get(c, style.INK) for c in causes], height=0.6,
              alpha=0.8)  # fmt: skip
    name_rows(axes, list(causes))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_drift(axes: Axes, night: Night, title: str, names: Sequence[str]) -> None:
    if not names:
        empty(axes, title, "none estimated")
        return
    courses = [night.course(name) for name in names]
    angles = names[0].startswith("zero_")
    largest = max(float(np.abs(values - values[0]).max()) for _, values in courses)
    scale, unit = prefixed(largest, "rad") if angles else (100.0, "%")
    quiet(axes, f"{title} ({unit})", x="hours")
    ends = []
    for k, (name, (hours, values)) in enumerate(zip(names, courses, strict=True)):
        colour = style.RUNS[k % len(style.RUNS)]
        change = scale * (values - values[0])
        line = "-" if k < len(style.RUNS) else "--"
        axes.plot(hours, change, line, color=colour, marker="o", markersize=2.5, linewidth=1.1)
        ends.append((float(change[-1]), name, colour))
    name_curves(axes, ends)
