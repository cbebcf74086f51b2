"""A preflight's forecast on one page to print."""

import math
from textwrap import shorten, wrap
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, PercentFormatter

from dpcontrol.foundation.statistics import wilson
from dpcontrol.judge.preflight import HazardBorder, Preflight, shown_number
from dpcontrol.pages import style
from dpcontrol.pages.page import DASHED, SMALL, new_figure, quiet

_SIZE = (8.27, 11.69)
"""Size of a sheet of A4, inches."""
_LEFT, _WIDE = 0.07, 0.88


def draw_preflight(found: Preflight) -> Figure:
    """Return a preflight's page as a figure."""
    figure = new_figure(*_SIZE)
    look: dict[str, Any] = {"va": "top", "color": style.INK}
    title = shorten(f"Before the first run: {found.itinerary}", 60, placeholder=" …")
    figure.text(_LEFT, 0.973, title, fontsize=15, weight="bold", **look)
    below = shorten(f"{found.title} · model {found.model}", 110, placeholder=" …")
    figure.text(_LEFT, 0.947, below, fontsize=SMALL, **{**look, "color": style.NOTE})
    figure.text(_LEFT, 0.928, found.status, fontsize=11, **{**look, "color": style.verdict_colour(found.likely)})
    _rate(figure.add_axes((_LEFT, 0.888, _WIDE, 0.016)), found)
    figure.text(_LEFT, 0.866, "\n".join(wrap(found.advice, 105)), fontsize=9.5, **look)
    _known(figure.add_axes((_LEFT, 0.635, 0.42, 0.187)), found)
    _endings(figure.add_axes((0.53, 0.637, 0.42, 0.185)), found)
    heading = {"fontsize": 9.5, **look}
    columns, tall = 4, 0.1
    for k, border in enumerate(found.borders):
        row, column = divmod(k, columns)
        wide = _WIDE / columns
        axes = figure.add_axes((_LEFT + column * wide, 0.485 - row * (tall + 0.06), wide - 0.045, tall))
        _border(axes, border)
    if found.borders:
        row, column = divmod(len(found.borders), columns)
        place = (_LEFT + column * _WIDE / columns, 0.485 - row * (tall + 0.06), _WIDE / columns - 0.03, tall)
        _legend(figure.add_axes(place))
        figure.text(_LEFT, 0.618, "Borders: half as many runs complete", **heading)
    helps = "Gain of each change, on the same seeds; lines: two standard errors"
    none = "Gain of changes: none tried, because no run failed or none was compared"
    figure.text(_LEFT, 0.277, helps if found.changes else none, **heading)
    _changes(figure.add_axes((0.42, 0.11, 0.53, 0.145)), found)
    notes = [line for note in found.notes for line in wrap(f"Mind: {note}", 120)]
    figure.text(_LEFT, 0.066, "\n".join(notes[:4]), fontsize=7.5, **{**look, "color": style.NOTE})
    return figure


def _rate(axes: Axes, found: Preflight) -> None:
    share, colour = found.share, style.verdict_colour(found.likely)
    axes.barh(0, 1, color=style.GRID, height=1)
    axes.barh(0, share.high - share.low, left=share.low, color=colour, alpha=0.35, height=1)
    axes.plot([share.rate, share.rate], [-0.5, 0.5], color=colour, linewidth=2.5, clip_on=False)
    axes.set(xlim=(0, 1), ylim=(-0.5, 0.5), yticks=[])
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))
    axes.tick_params(labelsize=7.5, colors=style.NOTE, length=2)
    axes.spines[:].set_visible(False)


def _known(axes: Axes, found: Preflight) -> None:
    axes.set_title("The bench as described", loc="left", fontsize=9.5, color=style.INK, pad=4)
    axes.axis("off")
    rows = max(len(found.known), 9)
    for k, one in enumerate(found.known):
        y = 1 - k / rows
        axes.text(0.0, y, one.name, fontsize=7.5, color=style.NOTE, va="top")
        axes.text(0.24, y, shorten(one.value, 44, placeholder=" …"), fontsize=7.5, color=style.INK, va="top")
        source = shorten(one.source, 70, placeholder=" …")
        axes.text(0.24, y - 0.5 / rows, source, fontsize=5.5, color=style.MARK, va="top")


_REASONS = 5


def _endings(axes: Axes, found: Preflight) -> None:
    axes.set_title("Endings of failed runs, share of all runs", loc="left", fontsize=9.5, color=style.INK, pad=4)
    axes.axis("off")
    shown, runs = found.endings[:_REASONS], found.share.runs
    if not shown:
        axes.text(0.0, 0.95, "nothing: every run completed", fontsize=SMALL, color=style.GOOD, va="top")
        return
    for k, one in enumerate(shown):
        share, top = one.runs / runs, k + 0.1
        axes.barh(top + 0.12, share / (shown[0].runs / runs), color=style.LIMIT, alpha=0.25, height=0.3)
        axes.text(0.01, top + 0.12, f"{share:.1%}", fontsize=8, color=style.INK, va="center", weight="bold")
        axes.text(0.16, top + 0.12, one.words, fontsize=8, color=style.INK, va="center")
        text = "\n".join(wrap(one.example, 82, max_lines=2, placeholder=" …"))
        axes.text(0.01, top + 0.33, text, fontsize=5.5, color=style.NOTE, va="top", linespacing=1.2)
    axes.set(xlim=(0, 1), ylim=(max(len(shown), _REASONS), 0))


def _border(axes: Axes, border: HazardBorder) -> None:
    margin = "" if border.margin is None else f" ({border.margin:.1f} ×)"
    quiet(axes, f"{border.name}: {border.sentence}{margin}", size=8)
    own = border.set if border.set and math.isfinite(border.set) else None
    values = [point.value for point in border.points]
    for point in border.points:
        band = wilson(min(point.completed, point.reference), point.reference)
        axes.plot([point.value] * 2, [band.low, band.high], color=style.CART, linewidth=0.9, alpha=0.6)
        axes.plot(point.value, min(point.share, 1.0), "o", color=style.INK, markersize=3)
    if own is not None:
        axes.axvline(own, color=style.GOOD, linewidth=1.2, linestyle=DASHED)
        values.append(own)
    if border.border is not None:
        axes.axvspan(border.low or border.border, border.high or border.border, color=style.LIMIT, alpha=0.15)
        axes.axvline(border.border, color=style.LIMIT, linewidth=1.2)
    axes.axhline(0.5, color=style.MARK, linewidth=0.7, linestyle=DASHED)
    low, high = min(values), max(values)
    axes.set_xscale("log")
    axes.set(xlim=(low / 1.3, high * 1.3), ylim=(-0.03, 1.06))
    if border.falling:
        axes.invert_xaxis()
    ticks = sorted({float(f"{v:.2g}") for v in (low, math.sqrt(low * high), high)})
    axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: shown_number(value)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.set_yticks([0, 0.5, 1])
    axes.tick_params(labelsize=6.5)
    axes.set_xlabel(border.unit, fontsize=7, color=style.NOTE, labelpad=0)


def _legend(axes: Axes) -> None:
    axes.axis("off")
    lines = [
        (style.INK, "● share that completes, of those"), ("", "    that do on the bench as described"),
        (style.GOOD, "- - the bench as described"), (style.LIMIT, "│ border, with its 95 % interval"),
        ("", "to the right: worse"),
    ]  # fmt: skip
    for k, (colour, text) in enumerate(lines):
        axes.text(0, 0.95 - 0.19 * k, text, fontsize=7, color=colour or style.INK, va="top")


def _changes(axes: Axes, found: Preflight) -> None:
    quiet(axes, x="points of all runs")
    if not found.changes:
        axes.axis("off")
        return
    for k, one in enumerate(found.changes):
        gain, reach = 100 * one.gain, 200 * one.error
        sure = gain > reach
        axes.barh(k, gain, color=style.GOOD if sure else style.FAINT, height=0.6)
        axes.plot([gain - reach, gain + reach], [k, k], color=style.INK, linewidth=0.9)
    axes.axvline(0, color=style.MARK, linewidth=0.8)
    axes.set_yticks(range(len(found.changes)), [shorten(c.text, 52, placeholder=" …") for c in found.changes])
    axes.tick_params(axis="y", labelsize=7.5, length=0)
    axes.set_ylim(len(found.changes) - 0.4, -0.6)
