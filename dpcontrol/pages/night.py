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
from dpcontrol.judge.night import BETWEEN, BRAKING, FLYING, ITINERARY, STOPPED, UNKNOWN, Night
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, Panel
from dpcontrol.pages.panels import Bar, bars, empty, name_curves, quiet

_COLOURS = {
    ITINERARY: style.MODES["holding"],
    BRAKING: style.MODES["saturated"],
    FLYING: style.MODES["pulsing"],
    BETWEEN: style.MODES["tracking"],
    UNKNOWN: style.INK,
    STOPPED: style.PAPER,
}
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
    page.row(partial(_draw_strip, night=night, row=row, rows=rows), height=1.0 + 0.36 * rows)
    causes = Panel(partial(draw_causes, night=night), 1.1)
    page.row(Panel(partial(_draw_times, night=night)), causes, partial(_draw_returns, night=night), height=2.1)
    return page.row(
        partial(_draw_drift, night=night, title="Encoder zeros, change since the first file", names=zeros),
        partial(
            _draw_drift,
            night=night,
            title="Other parameters, change since the first file",
            names=[name for name in names if name not in zeros],
        ),
        height=2.3,
    ).figure()


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
    quiet(axes, "Rows of up to half an hour, with the share on the itinerary; triangles are falls", x="minutes")
    for k in range(rows):
        begin, known, on = k * row, 0.0, 0.0
        for span in night.spans:
            first, last = max(span.first, begin), min(span.end, begin + row)
            if last <= first:
                continue
            # The edge keeps short absences visible.
            edge = 0.0 if span.kind in (ITINERARY, STOPPED) else 0.8
            look = {"facecolor": _COLOURS[span.kind], "edgecolor": _COLOURS[span.kind], "linewidth": edge}
            axes.broken_barh([((first - begin) / 60, (last - first) / 60)], (k - 0.39, 0.78), **look)
            known += (last - first) * (span.kind != UNKNOWN)
            on += (last - first) * (span.kind == ITINERARY)
        text = f"{on / known:.0%}" if known else ""
        axes.text(1.008, k, text, transform=axes.get_yaxis_transform(), va="center", fontsize=style.SMALL)
    for fall in night.falls:
        k = min(int(fall.time / row), rows - 1)
        look = {"color": _FALLS.get(fall.cause, style.INK), "markersize": 4.5, "clip_on": False}
        axes.plot((fall.time - k * row) / 60, k - 0.42, "v", **look)
    minutes = [round(k * row / 60) for k in range(rows)]
    axes.set_yticks(range(rows), [f"{m // 60}:{m % 60:02d} h" if row >= _ROW else f"{m} min" for m in minutes])
    axes.set(xlim=(0, row / 60), ylim=(rows - 0.5, -0.65))


def _draw_times(axes: Axes, night: Night) -> None:
    spent = {kind: sum(s.end - s.first for s in night.spans if s.kind == kind) for kind in _COLOURS if kind != STOPPED}
    spent = {kind: time for kind, time in spent.items() if time}
    scale, unit = (1 / 3600, "hours") if max(spent.values(), default=0.0) > 3600 else (1 / 60, "minutes")
    rows = [Bar(kind, scale * time, _COLOURS[kind]) for kind, time in spent.items()]
    bars(axes, f"Time by activity ({unit}), in the strip's colours", rows)


def _draw_returns(axes: Axes, night: Night) -> None:
    returns = night.returns
    if not len(returns):
        empty(axes, "Time from the fall back onto the itinerary", "no falls")
        return
    median, late = np.quantile(returns, (0.5, 0.99))
    times = f"s; median {median:.1f}, 99 % within {late:.1f}"
    quiet(axes, "Time from the fall back onto the itinerary", x=times, y="share of falls within")
    axes.ecdf(returns, color=style.ARMS[0])
    axes.set(xlim=(0, 1.3 * max(returns)), ylim=(0, 1.03))


def draw_causes(axes: Axes, night: Night) -> None:
    rows = [Bar(cause, count, _FALLS.get(cause, style.INK)) for cause, count in night.causes.items()]
    bars(axes, "Falls by cause, in the triangles' colours", rows)
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
