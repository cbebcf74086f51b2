"""A preflight's forecast on one page to print."""

import math
from functools import partial

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, PercentFormatter

from dpcontrol.foundation.statistics import wilson
from dpcontrol.judge.preflight import HazardBorder, Preflight, shown_number
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, cropped
from dpcontrol.pages.panels import Bar, bars, quiet

_WIDTH = 8.27
"""A4 in portrait, inches."""
_COLUMNS = 4


def draw_preflight(found: Preflight) -> Figure:
    """Return a preflight's page as a figure."""
    title = f"Before the first run: {found.itinerary}"
    page = Page(title, found.status, found.likely, width=_WIDTH)
    page.text(found.advice, colour=style.INK, size=style.TEXT)
    page.text(f"The bench as described, model {found.model}", colour=style.INK, size=style.HEAD)
    text = partial(cropped, size=style.TEXT)
    page.table([(one.name, text(one.value, width=2.4), text(one.source, width=4.0)) for one in found.known])
    page.text("Endings of failed runs, share of all runs", colour=style.INK, size=style.HEAD)
    runs, endings = found.share.runs, found.endings[:_REASONS]
    rows = [(f"{e.runs / runs:.1%}", text(e.cause, width=1.6), text(e.example, width=5.0)) for e in endings]
    page.table(rows or [("", "none: every run completed", "")])
    if found.borders:
        title = "Borders: half as many runs complete as on the bench as described"
        page.text(title, colour=style.INK, size=style.HEAD)
        page.grid([partial(_border, border=border) for border in found.borders], across=_COLUMNS, height=1.55)
        page.text(
            "Dots: share of completed runs, relative to the bench as described; to the right it gets worse. Dashed "
            "green: the bench as described. Red: border with its 95 % interval."
        )
    if found.changes:
        page.row(partial(_changes, found=found), height=0.75 + 0.19 * len(found.changes))
    else:
        page.text("No change was tried, because no run failed or none was compared.")
    for note in found.notes:
        page.text(f"Mind: {note}")
    return page.figure()


_REASONS = 5


def _border(axes: Axes, border: HazardBorder) -> None:
    margin = "" if border.margin is None else f" ({border.margin:.1f}×)"
    quiet(axes, f"{border.name}: {border.sentence}{margin}", x=border.unit)
    own = border.set if border.set and math.isfinite(border.set) else None
    values = [point.value for point in border.points]
    for point in border.points:
        band = wilson(min(point.completed, point.reference), point.reference)
        axes.plot([point.value] * 2, [band.low, band.high], color=style.CART, linewidth=0.9, alpha=0.6)
        axes.plot(point.value, min(point.share, 1.0), "o", color=style.INK, markersize=3)
    if own is not None:
        axes.axvline(own, color=style.GOOD, linewidth=1.2, linestyle=style.DASHED)
        values.append(own)
    if border.border is not None:
        axes.axvspan(border.low or border.border, border.high or border.border, color=style.LIMIT, alpha=0.15)
        axes.axvline(border.border, color=style.LIMIT, linewidth=1.2)
    axes.axhline(0.5, color=style.MARK, linewidth=0.7, linestyle=style.DASHED)
    low, high = min(values), max(values)
    axes.set_xscale("log")
    axes.set(xlim=(low / 1.3, high * 1.3), ylim=(-0.03, 1.06))
    if border.falling:
        axes.invert_xaxis()
    ticks = sorted({float(f"{v:.2g}") for v in ((low, high) if high > 1.5 * low else (low,))})
    axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: shown_number(value)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.set_yticks([0, 0.5, 1])


def _changes(axes: Axes, found: Preflight) -> None:
    rows = [
        Bar(one.text, gain, style.GOOD if gain > reach else style.FAINT, (gain - reach, gain + reach))
        for one, gain, reach in ((one, 100 * one.gain, 200 * one.error) for one in found.changes)
    ]
    bars(axes, "Gain of each change, on the same seeds; lines: two standard errors", rows, x="points of all runs")
    axes.axvline(0, color=style.MARK, linewidth=0.8)


def whole_preflight(axes: Axes, found: Preflight) -> None:
    """Draw the shares of completed runs and of each other ending.

    Args:
        axes: panel to draw on.
        found: preflight to draw.
    """
    rows = [Bar("completed", found.share.rate, style.GOOD)]
    rows += [Bar(one.cause, one.runs / found.share.runs, style.LIMIT) for one in found.endings]
    bars(axes, found.status, rows, x="share of runs that end so")
