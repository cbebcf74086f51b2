"""Charts over time and phase planes, drawn from their descriptions (`run_charts`)."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator

from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.run_view import RunView
from dpcontrol.pages import style
from dpcontrol.pages.layout import MOST_IN_KEY, key
from dpcontrol.pages.panels import angle_axis, name_curves
from dpcontrol.pages.planes import Plane, Range, extreme_rows, gap_times
from dpcontrol.pages.run_charts import Chart, Line

_BINS = 1500
"""Number of bins of a curve on a page; the least and the greatest value of each are drawn."""


def curve(view: RunView, time: Array, values: Array) -> tuple[Array, Array]:
    """Return a series (K,) with the points that suffice to draw it, and with nan in the gaps of a view.

    The points are the extremes of narrow bins, so that long runs are drawn quickly and keep their peaks.

    Args:
        view: run with the gaps, which interrupt the line.
        time: (K,) s.
        values: (K,) in any unit.
    """
    rows = extreme_rows(values, bins=_BINS)
    time, values = time[rows], values[rows]
    if not len(view.breaks):
        return time, values
    gaps = gap_times(view)
    places = np.searchsorted(time, gaps)
    return np.insert(time, places, gaps), np.insert(values, places, np.nan)


_BROAD: dict[str, Any] = {"alpha": 0.3, "linewidth": 4.5}
"""Style of a reference behind the curve that follows it."""


MOST_MARKED = 20
"""Greatest number of motions whose times are marked in charts and listed."""


def draw_chart(axes: Axes, chart: Chart, view: RunView, *, span: Range | None = None) -> None:
    """Draw a chart's lines, bands, levels and limits.

    Lines are interrupted at the gaps of `view`, also those of other runs.

    Args:
        axes: panel to draw on.
        chart: chart to draw.
        view: run with gaps and symbols.
        span: time range to show, s; all by default.
    """
    scale, title = chart.scaled()
    axes.set(title=title, xlabel="time (s)" if view.arm_lengths else "time")
    axes.margins(x=0)
    # For a key the style of each label, and for names at the right the end, label and colour of each curve.
    entries: dict[str, dict] = {}
    ends: dict[str, tuple[float, str, str]] = {}
    for line in (line for line in chart.lines if line.role != "detail"):
        _line(axes, line, view, scale=scale)
        if line.label:
            finite = line.values[np.isfinite(line.values)]
            look = {"color": style.REFERENCE, **_BROAD, "alpha": 0.6} if line.role == "reference" else {}
            dashes = {"linestyle": style.DASHED} if line.dashed else {}
            entries[line.label] = {"color": line.colour, "linewidth": max(line.width, 1.5)} | look | dashes
            ends[line.label] = (scale * float(finite[-1]) if len(finite) else 0.0, line.label, line.colour)
    if chart.half_turns:
        angle_axis(axes, "y")
    if chart.log:
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(base=10, numticks=6))
    elif chart.shown is not None:
        axes.set_ylim(scale * chart.shown[0], scale * chart.shown[1])
    entries |= _levels(axes, chart, scale=scale)
    if span is not None:
        axes.set_xlim(*span)
        symbol_times = [symbol_time for symbol_time, _ in view.plan.symbols if span[0] <= symbol_time <= span[1]]
        for symbol_time in symbol_times if len(symbol_times) <= MOST_MARKED else ():
            axes.axvline(symbol_time, color=style.MARK, linewidth=0.9, linestyle=style.DOTTED, zorder=1.5)
    if len(entries) > MOST_IN_KEY:
        name_curves(axes, list(ends.values()))
    else:
        # The reference is listed after the following curve.
        key(axes, sorted(entries.items(), key=lambda entry: "alpha" in entry[1]))


def _levels(axes: Axes, chart: Chart, *, scale: float) -> dict[str, dict[str, Any]]:
    """Draw the constants of a chart: limits, an expected band, and named levels.

    Limits near the range of the curves widen the axis. One or two visible named levels are returned as entries of the
    key; more would not fit, and are only drawn.

    Args:
        axes: panel with the curves.
        chart: chart with the levels.
        scale: factor from SI units to those of the panel.
    """
    low, high = axes.get_ylim()
    reach = 0.35 * (high - low)
    limits = [scale * level.value for level in chart.levels if level.kind == "limit"]
    near_limits = [value for value in limits if low - reach < value < high + reach]
    for value in near_limits:
        axes.axhline(value, color=style.LIMIT, linewidth=1.1, linestyle=style.DASHED)
        # The forbidden side is shaded far beyond the panel.
        axes.axhspan(value, 1e3 * value, color=style.LIMIT, alpha=0.08, linewidth=0)
    band = [scale * level.value for level in chart.levels if level.kind == "band"]
    if band:
        axes.axhspan(min(band), max(band), color=style.MODES["holding"], alpha=0.35, linewidth=0)
    low, high = (
        min([low, *(1.06 * value for value in near_limits)]),
        max([high, *(1.06 * value for value in near_limits)]),
    )
    axes.set_ylim(low, high)
    named_levels = [level for level in chart.levels if level.kind == "named" and low <= level.value <= high]
    for level in named_levels:
        axes.axhline(level.value, color=level.colour, linewidth=1.0, linestyle=style.DASHED)
    levels_in_key = [level for level in named_levels if level.name] if len(named_levels) <= 2 else []
    return {level.name: {"color": level.colour, "linewidth": 1.0, "linestyle": style.DASHED} for level in levels_in_key}


def _line(axes: Axes, line: Line, view: RunView, *, scale: float) -> None:
    """Draw a line of a chart, with its band; a reference is broad and pale behind the others.

    Args:
        axes: panel to draw on.
        line: line to draw.
        view: run with the gaps that interrupt it.
        scale: factor from SI units to those of the panel.
    """
    time, values = curve(view, line.time, scale * line.values)
    look: dict[str, Any] = {"color": line.colour, "linewidth": line.width, "linestyle": "-"}
    if line.role == "reference":
        look |= _BROAD
    if line.dashed:
        look["linestyle"] = (0, (5, 1.2))
    if line.reach is not None:
        low, high = (scale * (line.values + side * line.reach) for side in (-1, 1))
        axes.fill_between(line.time, low, high, color=line.colour, alpha=0.15, linewidth=0)
    axes.plot(time, values, **look)


_ORBIT: dict[str, Any] = {"linewidth": 3.2}
_REST: dict[str, Any] = {"marker": "D", "markersize": 8, "linestyle": ""}


def draw_plane(axes: Axes, runs: list[tuple[Plane, str]], *, tubes: bool = True) -> None:
    """Draw runs in one arm's phase plane, with the orbits and tubes of the first run.

    Args:
        axes: panel to draw on.
        runs: phase planes, each with a colour.
        tubes: True to draw the tubes.
    """
    first_plane, _ = runs[0]
    number, ends = style.number(first_plane.arm), ", from ○ to ■" if len(runs) == 1 else ""
    axes.set(title=f"Arm {first_plane.arm + 1}: ω{number} (rad/s) over θ{number}{ends}")
    for stable, colour, name in ((False, style.UNSTABLE, "tubes from"), (True, style.STABLE, "to them")):
        if tubes and first_plane.strands[stable]:
            axes.plot(*_joined(first_plane.strands[stable]), color=colour, linewidth=0.45, alpha=0.35, zorder=1.2)
            axes.plot(*_joined(first_plane.cuts[stable]), color=colour, linewidth=1.8, zorder=2.5, label=name)
    kinds_in_key: list[str] = []
    for colour, points in first_plane.orbits:
        # An equilibrium is a single point.
        kind, look = ("orbits", _ORBIT) if len(points) > 3 else ("equilibria", _REST)
        label = kind if kind not in kinds_in_key else None
        kinds_in_key.append(kind)
        axes.plot(*points.T, color=colour, zorder=1.5, alpha=0.75 if tubes else 0.4, label=label, **look)
    for plane, colour in runs:
        (start, end), face = plane.ends, style.PAPER
        axes.plot(*_joined(plane.run), color=colour, linewidth=1.1, zorder=3)
        axes.plot(*end, "s", color=colour, markersize=5, zorder=4)
        if len(runs) == 1:
            axes.plot(*start, "o", color=colour, markerfacecolor=face, markersize=6, zorder=5)
    axes.margins(x=0.04)
    angle_axis(axes, "x")
    key(axes)


def _joined(curves: list[Array]) -> Array:
    """Return curves (K, 2) as one curve (2, M) interrupted by nan, so that one call draws all of them quickly."""
    gap = np.full((1, 2), np.nan)
    parts = [part for points in curves for part in (points, gap)]
    return np.concatenate(parts).T if parts else np.zeros((2, 0))
