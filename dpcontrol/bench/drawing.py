"""A chart as a page: one work-precision diagram for each panel, the front drawn, the default ringed."""

from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

from dpcontrol.bench.chart import Chart, Panel
from dpcontrol.review.style import FAINT, INK, LIMIT

MARKS = "osD^v<>Pph*X8d"
COLOURS = ("#1f6fb4", "#d9640d", "#2c8a4b", "#8a4fa3", "#9a6b15", "#c2185b", "#0f8b8d", "#5b6470")
FLOOR = 1e-17
"""Where an error of exactly zero is drawn."""
WIDTH, HEIGHT = 6.4, 5.6
_FEW, _MANY = 6.0, 100.0
"""Ranges of a logarithmic axis: below the first 1, 2, 5 are too few labels, from the second on powers are enough."""


def draw(chart: Chart) -> Figure:
    """Return the chart's page; panels side by side, methods in one colour and mark throughout."""
    columns = 2 if len(chart.panels) == 4 else min(len(chart.panels), 3)
    rows = -(-len(chart.panels) // columns)
    figure = Figure(figsize=(WIDTH * columns, HEIGHT * rows + 0.9), layout="constrained", dpi=110)
    figure.suptitle(chart.title, fontsize=13, color=INK)
    methods = list(dict.fromkeys(p.method for panel in chart.panels for p in panel.points))
    looks = {m: (MARKS[k % len(MARKS)], COLOURS[k % len(COLOURS)]) for k, m in enumerate(methods)}
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, panel in zip(axes, chart.panels, strict=False):
        _panel(axis, panel, looks)
    for axis in axes[len(chart.panels) :]:
        axis.set_visible(False)
    figure.supxlabel("\n".join(chart.reading), fontsize=9, color=INK, x=0.01, ha="left")
    return figure


def _panel(axis: Any, panel: Panel, looks: dict[str, tuple[str, str]]) -> None:
    def height(error: float) -> float:
        return max(error, panel.floor, FLOOR) if panel.log_y else error

    for method in dict.fromkeys(p.method for p in panel.points):
        mark, colour = looks[method]
        points = sorted((p for p in panel.points if p.method == method), key=lambda p: p.seconds)
        hollow = any(p.outside or p.stored for p in points)
        axis.plot(
            [p.seconds for p in points], [height(p.error) for p in points], mark, color=colour, markersize=6,
            markerfacecolor="white" if hollow else colour, label=method, zorder=3,
        )  # fmt: skip
        for p in points:
            if p.setting:
                axis.annotate(
                    p.setting, (p.seconds, height(p.error)), xytext=(4, 3), textcoords="offset points", fontsize=5.5,
                    color=colour, alpha=0.9,
                )  # fmt: skip
    front = panel.front
    axis.plot(
        [p.seconds for p in front], [height(p.error) for p in front], color=FAINT, linewidth=4, zorder=1,
        drawstyle="steps-post", label="front",
    )  # fmt: skip
    for p in panel.defaults:
        axis.plot(p.seconds, height(p.error), "o", markersize=15, markerfacecolor="none", color=LIMIT, zorder=4)
    if panel.defaults:
        standing = "; ".join(dict.fromkeys(panel.standing(p) for p in panel.defaults))
        axis.plot([], [], "o", markersize=9, markerfacecolor="none", color=LIMIT, label=f"default: {standing}")
    axis.set_xscale("log")
    if panel.log_y:
        axis.set_yscale("log")
    axis.set_title(panel.title, fontsize=10, color=INK)
    axis.set_xlabel(panel.x_label)
    axis.set_ylabel(panel.y_label)
    axis.grid(True, which="major", color=FAINT, linewidth=0.5)
    axis.margins(0.12, 0.08)
    _readable_ticks(axis.xaxis)
    if panel.log_y:
        _readable_ticks(axis.yaxis)
    axis.legend(fontsize=6, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)


def _readable_ticks(axis: Any) -> None:
    """Keep labels of a logarithmic axis apart: powers of ten; 1, 2, 5 where it holds few; else a few round numbers."""
    low, high = axis.get_view_interval()
    axis.set_minor_formatter(NullFormatter())
    if high / low >= _MANY:
        return
    few = high / low < _FEW
    axis.set_major_locator(MaxNLocator(4, min_n_ticks=2) if few else LogLocator(subs=(1.0, 2.0, 5.0)))
    if few:
        axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
