"""Maps of failure as a page: what works, what fails, the measured border and the foretold one."""

from textwrap import fill
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from dpcontrol.bench.edges import EdgeChart, EdgeMap
from dpcontrol.review.style import INK, LIMIT, REFERENCE, STABLE

WIDTH, HEIGHT = 6.6, 5.4
_FOR_LEGEND = 0.3
"""Share of the diagram's height that is kept free above what it shows."""
_MANY = 1e3
"""Ratio of a diagram's ends from which on powers of ten are labels enough."""


def draw(chart: EdgeChart) -> Figure:
    """Return the chart's page, its maps side by side."""
    columns = min(len(chart.maps), 3)
    rows = -(-len(chart.maps) // columns)
    figure = Figure(figsize=(WIDTH * columns, HEIGHT * rows + 1.1), layout="constrained", dpi=110)
    figure.suptitle(chart.title, fontsize=13, color=INK)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, one in zip(axes, chart.maps, strict=False):
        _map(axis, one)
    for axis in axes[len(chart.maps) :]:
        axis.set_visible(False)
    text = [fill(line, int(WIDTH * columns * 13)) for line in chart.reading]
    figure.supxlabel("\n".join(text), fontsize=9, color=INK, x=0.01, ha="left")
    return figure


def _map(axis: Any, one: EdgeMap) -> None:
    trials = [(b.x, t) for b in one.borders for t in b.trials]
    for works, mark, colour, label in ((True, "o", STABLE, one.near), (False, "x", LIMIT, one.far)):
        shown = [(x, t.y) for x, t in trials if t.works is works]
        axis.plot([x for x, _ in shown], [y for _, y in shown], mark, color=colour, markersize=5, label=label)
    ends = [(b.x, b.measured, b.near, b.far) for b in one.borders if b.measured is not None]
    if ends:
        axis.plot(
            [e[0] for e in ends],
            [e[1] for e in ends],
            "_-",
            color=INK,
            markersize=16,
            linewidth=1.2,
            label="measured border",
        )
    known = [(b.x, b.predicted) for b in one.borders if b.predicted is not None]
    if known:
        axis.plot(
            [x for x, _ in known], [y for _, y in known], "D--", color=REFERENCE, markersize=7, linewidth=1.2,
            markerfacecolor="none", markeredgecolor=INK, label=fill(f"foretold: {one.theory}", 60),
        )  # fmt: skip
    if one.log_x and all(b.x > 0 for b in one.borders):
        axis.set_xscale("log")
    axis.set_yscale("log")
    places = sorted({b.x for b in one.borders})
    axis.set_xticks(places, [_label(one, x) for x in places], fontsize=8, rotation=20 if _named(one) else 0)
    axis.xaxis.set_minor_locator(NullLocator())
    axis.margins(0.12, 0.08)
    low, high = axis.get_ylim()
    axis.set_ylim(low, high * (high / low) ** _FOR_LEGEND)
    # Most borders span less than a decade: its parts are labelled too.
    axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high / low < _MANY else (1.0,)))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:.3g}"))
    axis.yaxis.set_minor_formatter(NullFormatter())
    axis.set_title(one.title, fontsize=10, color=INK)
    axis.set_xlabel(one.x_label)
    axis.set_ylabel(one.y_label)
    axis.legend(fontsize=7, loc="upper left", framealpha=0.85)


def _named(one: EdgeMap) -> bool:
    """Say whether the places of the lines are their order only."""
    return not one.log_x and [b.x for b in one.borders] == list(range(len(one.borders)))


def _label(one: EdgeMap, x: float) -> str:
    """Return a tick's text: the line's name where places are only numbered."""
    if _named(one):
        return next(b.line for b in one.borders if b.x == x)
    return f"{x:.4g}"
