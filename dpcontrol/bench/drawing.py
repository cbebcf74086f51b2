"""Pages as pictures: work-precision diagrams with their fronts and ringed defaults, and maps of failure."""

from textwrap import fill
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

from dpcontrol.bench.chart import ChartPage, EdgeMap, Panel, PrecisionChart
from dpcontrol.review.style import FAINT, INK, LIMIT, REFERENCE, STABLE

MARKS = "osD^v<>Pph*X8d"
COLOURS = ("#1f6fb4", "#d9640d", "#2c8a4b", "#8a4fa3", "#9a6b15", "#c2185b", "#0f8b8d", "#5b6470")
FLOOR = 1e-17
"""Where an error of exactly zero is drawn."""
WIDTH, HEIGHT = 6.4, 5.6
_FEW, _MANY = 6.0, 100.0
"""Ranges of a logarithmic axis: below the first 1, 2, 5 are too few labels, from the second on powers are enough."""
_FOR_LEGEND = 0.3
"""Share of a map's height that is kept free above what it shows."""
_WIDE = 1e3
"""Ratio of a map's ends from which on powers of ten are labels enough."""


def figure(page: ChartPage) -> Figure:
    """Return a page's picture: its diagrams side by side, methods in one colour and mark throughout."""
    columns = 2 if len(page.parts) == 4 and isinstance(page, PrecisionChart) else min(len(page.parts), 3)
    rows = -(-len(page.parts) // columns)
    picture = Figure(figsize=(WIDTH * columns, HEIGHT * rows + 1.0), layout="constrained", dpi=110)
    picture.suptitle(page.title, fontsize=13, color=INK)
    panels = page.panels if isinstance(page, PrecisionChart) else ()
    methods = list(dict.fromkeys(p.method for panel in panels for p in panel.points))
    looks = {m: (MARKS[k % len(MARKS)], COLOURS[k % len(COLOURS)]) for k, m in enumerate(methods)}
    axes = picture.subplots(rows, columns, squeeze=False).ravel()
    for axis, part in zip(axes, page.parts, strict=False):
        if isinstance(part, Panel):
            _draw_panel(axis, part, looks)
        elif isinstance(part, EdgeMap):
            _map(axis, part)
    for axis in axes[len(page.parts) :]:
        axis.set_visible(False)
    text = [fill(line, int(WIDTH * columns * 13)) for line in page.reading]
    picture.supxlabel("\n".join(text), fontsize=9, color=INK, x=0.01, ha="left")
    return picture


def _map(axis: Any, one: EdgeMap) -> None:
    trials = [(b.x, t) for b in one.borders for t in b.trials]
    for works, mark, colour, label in ((True, "o", STABLE, one.near), (False, "x", LIMIT, one.far)):
        shown = [(x, t.y) for x, t in trials if t.works is works]
        axis.plot([x for x, _ in shown], [y for _, y in shown], mark, color=colour, markersize=5, label=label)
    measured = [(b.x, b.measured) for b in one.borders if b.measured is not None]
    if measured:
        axis.plot(*zip(*measured, strict=True), "_-", color=INK, markersize=16, linewidth=1.2, label="measured border")
    predicted = [(b.x, b.predicted) for b in one.borders if b.predicted is not None]
    if predicted:
        axis.plot(
            *zip(*predicted, strict=True), "D--", color=REFERENCE, markersize=7, linewidth=1.2, markerfacecolor="none",
            markeredgecolor=INK, label=fill(f"predicted: {one.theory}", 60),
        )  # fmt: skip
    if one.log_x and all(b.x > 0 for b in one.borders):
        axis.set_xscale("log")
    axis.set_yscale("log")
    names = {b.x: b.line for b in one.borders}
    # Places that are only numbered show the lines' names.
    named = not one.log_x and list(names) == list(range(len(names)))
    places = sorted(names)
    labels = [names[x] if named else f"{x:.4g}" for x in places]
    axis.set_xticks(places, labels, fontsize=8, rotation=20 if named else 0)
    axis.xaxis.set_minor_locator(NullLocator())
    axis.margins(0.12, 0.08)
    low, high = axis.get_ylim()
    axis.set_ylim(low, high * (high / low) ** _FOR_LEGEND)
    # Most borders span less than a decade: its parts are labelled too.
    axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high / low < _WIDE else (1.0,)))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:.3g}"))
    axis.yaxis.set_minor_formatter(NullFormatter())
    axis.set_title(one.title, fontsize=10, color=INK)
    axis.set_xlabel(one.x_label)
    axis.set_ylabel(one.y_label)
    axis.legend(fontsize=7, loc="upper left", framealpha=0.85)


def _draw_panel(axis: Any, panel: Panel, looks: dict[str, tuple[str, str]]) -> None:
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
