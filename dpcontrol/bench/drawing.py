"""Pictures of charts: at most three diagrams a page, each with its result as title.

A page of up to two methods has a legend for them; with more, each method's name is beside its best mark. Settings are
beside the marks on the front and the defaults. Axes have units with SI prefixes.
"""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator, PercentFormatter

from dpcontrol.bench.chart import LEADING, ChartPage, Diagram, EdgeMap, Point, Searches, name_of, unit_of
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.files import whole_file
from dpcontrol.foundation.units import quantity
from dpcontrol.pages.style import FAINT, GOOD, INK, LIMIT, MARK, SERIES

MARKS = "osD^v<>Pph*X8d"
FLOOR = 1e-17
"""Drawn position of an error of exactly zero."""
WIDTH, HEIGHT = 6.4, 5.6
LEGEND = 2
"""Methods in a legend; with more, each has its name beside a mark."""
_FEW, _MANY = 6.0, 100.0
"""Ranges of a logarithmic axis: below the first 1, 2, 5 give too few labels, from the second on powers are enough."""


def save_chart(page: ChartPage, picture: Path, parts: Sequence[Any] | None = None) -> None:
    """Draw some of a chart's diagrams, by default all, to a PNG.

    Raises:
        InputError: the file cannot be written.
    """
    with whole_file(picture, suffix=".png") as temporary:
        figure(page, page.parts if parts is None else parts).savefig(temporary, format="png")


def figure(page: ChartPage, parts: Sequence[Any]) -> Figure:
    """Return a picture of some of a chart's diagrams, side by side.

    Each method has one colour and mark throughout.
    """
    if isinstance(parts[0], Searches):
        return _searches_figure(page, parts[0])
    columns = min(len(parts), LEADING)
    rows = -(-len(parts) // columns)
    picture = Figure(
        figsize=(WIDTH * columns, HEIGHT * rows + 1.2), layout=ConstrainedLayoutEngine(w_pad=0.15, h_pad=0.1), dpi=110
    )
    picture.suptitle(page.title, fontsize=14, color=INK, x=0.01, ha="left")
    panels = [part for part in parts if isinstance(part, Diagram)]
    methods = list(dict.fromkeys(p.method for panel in panels for p in panel.points))
    looks = {m: (MARKS[k % len(MARKS)], SERIES[k % len(SERIES)]) for k, m in enumerate(methods)}
    shared = _share_heights(parts)
    axes = picture.subplots(rows, columns, squeeze=False, sharey=shared).ravel()
    for axis in axes[len(parts) :]:
        axis.set_visible(False)
    axes = axes[: len(parts)]
    for axis, part in zip(axes, parts, strict=True):
        axis.margins(0.12, 0.1)
        if isinstance(part, Diagram):
            _draw_panel(axis, part, looks)
        else:
            _draw_map(axis, part)
        axis.set_title(fill(f"{part.title}: {part.finding()}", 64), fontsize=11, color=INK, loc="left")
        axis.set_xlabel(name_of(part.x_label))
        axis.set_ylabel(name_of(part.y_label))
        if shared:
            axis.label_outer()
    text = [fill(line, int(WIDTH * columns * 13)) for line in page.reading]
    picture.supxlabel("\n".join(text), fontsize=9, color=INK, x=0.01, ha="left")
    handles = dict(pair for axis in axes for pair in zip(*axis.get_legend_handles_labels()[::-1], strict=True))
    if handles:
        picture.legend(handles.values(), handles.keys(), loc="outside upper right", ncols=6, fontsize=9, frameon=False)
    if panels:
        # The space for labels is known once the axes have their positions.
        picture.draw_without_rendering()
        for axis, panel in zip(axes, panels, strict=True):
            _label_settings(axis, panel, looks, named=len(methods) > LEGEND)
    return picture


def _searches_figure(page: ChartPage, lead: Searches) -> Figure:
    """Return a picture of success rates on the left and of the time to a good solution on the right."""
    names = [s.method[:1].upper() + s.method[1:] for s in lead.searches]
    picture = Figure(figsize=(1.6 * WIDTH, 1.2 + 0.5 * len(names) + 1.0), layout="constrained", dpi=110)
    picture.suptitle(fill(lead.finding(), 88), fontsize=13, fontweight="bold", color=INK, x=0.01, ha="left")
    rates, times = picture.subplots(1, 2, sharey=True, width_ratios=(3, 2))
    for k, s in enumerate(lead.searches):
        colour = SERIES[0] if s.default else MARK
        rates.barh(k, s.found / s.tries, color=FAINT, height=0.62)
        rates.barh(k, s.good / s.tries, color=colour, height=0.62)
        rates.text(1.01, k, f"{s.good / s.tries:.0%} of {s.tries}", va="center", fontsize=9, color=INK)
        if s.good:
            times.barh(k, s.seconds_to_good, color=colour, height=0.62)
            times.text(s.seconds_to_good * 1.1, k, quantity(s.seconds_to_good, "s"), va="center", fontsize=9, color=INK)
        else:
            times.text(0.02, k, "none found", va="center", fontsize=9, color=INK, transform=times.get_yaxis_transform())
    rates.set_yticks(range(len(names)), names, fontsize=10)
    rates.invert_yaxis()
    rates.set_xlim(0, 1.18)
    rates.set_xticks([0, 0.25, 0.5, 0.75, 1.0])
    rates.xaxis.set_major_formatter(PercentFormatter(1.0))
    rates.set_xlabel(f"tries that find a flight (grey); {lead.good} (colour)")
    times.set_xscale("log")
    times.margins(x=0.25)
    _readable_ticks(times.xaxis, "s")
    times.set_xlabel("time of one core to a flight as cheap")
    for axis in (rates, times):
        axis.spines[["top", "right"]].set_visible(False)
        axis.tick_params(which="both", colors=INK)
        for part in (axis.xaxis.label, *axis.spines.values()):
            part.set_color(INK)
    return picture


def _share_heights(parts: Sequence[Any]) -> bool:
    """True if all diagrams are maps of one quantity."""
    return all(isinstance(part, EdgeMap) for part in parts) and len({part.y_label for part in parts}) == 1


def _draw_map(axis: Any, one: EdgeMap) -> None:
    names = {b.x: b.line for b in sorted(one.borders, key=lambda b: b.x)}
    # Numbered positions show the lines' names.
    named = not one.log_x and list(names) == list(range(len(names)))
    for works, mark, colour, label in ((True, "o", GOOD, one.near), (False, "x", LIMIT, one.far)):
        shown = [(b.x, t.y) for b in one.borders for t in b.trials if t.works is works]
        axis.plot([x for x, _ in shown], [y for _, y in shown], mark, color=colour, markersize=5, label=label)
    for places, style in (
        ([(b.x, b.measured) for b in one.borders if b.measured is not None],
         {"marker": "_", "linestyle": "-", "color": INK, "markersize": 16, "label": "measured border"}),
        ([(b.x, b.predicted) for b in one.borders if b.predicted is not None],
         {"marker": "D", "linestyle": "--", "color": MARK, "markersize": 7, "markerfacecolor": "none",
          "markeredgecolor": INK, "label": fill(f"predicted: {one.theory}", 60)}),
    ):  # fmt: skip
        if places:
            # Itineraries and laws have no order, so no line joins them.
            axis.plot(*zip(*places, strict=True), linewidth=1.2, **(style | {"linestyle": "none"} if named else style))
    if one.log_x and all(b.x > 0 for b in one.borders):
        axis.set_xscale("log")
    axis.set_yscale("log")
    labels = list(names.values()) if named else [f"{x:.4g}" for x in names]
    axis.set_xticks(list(names), labels, fontsize=8.5, rotation=35 if named else 0, ha="right" if named else "center")
    axis.xaxis.set_minor_locator(NullLocator())
    # Most borders span less than a decade, so its parts are labelled too.
    _readable_ticks(axis.yaxis, unit_of(one.y_label), many=10 * _MANY)


def _height(panel: Diagram, error: float) -> float:
    return max(error, panel.floor, FLOOR) if panel.log_y else error


def _draw_panel(axis: Any, panel: Diagram, looks: dict[str, tuple[str, str]]) -> None:
    for method in dict.fromkeys(p.method for p in panel.points):
        mark, colour = looks[method]
        points = sorted((p for p in panel.points if p.method == method), key=lambda p: p.seconds)
        hollow = any(p.outside or p.stored for p in points)
        axis.plot(
            [p.seconds for p in points], [_height(panel, p.error) for p in points], mark, color=colour, markersize=6,
            markerfacecolor="white" if hollow else colour, label=method if len(looks) <= LEGEND else "", zorder=3,
        )  # fmt: skip
    front = panel.front
    axis.plot(
        [p.seconds for p in front], [_height(panel, p.error) for p in front], color=FAINT, linewidth=4, zorder=1,
        drawstyle="steps-post", label="best at its cost",
    )  # fmt: skip
    for p in panel.defaults:
        axis.plot(p.seconds, _height(panel, p.error), "o", markersize=_RING, markerfacecolor="none", color=LIMIT,
                  zorder=4)  # fmt: skip
    if panel.defaults:
        axis.plot([], [], "o", markersize=9, markerfacecolor="none", color=LIMIT, label="default of dpcontrol")
    axis.set_xscale("log")
    if panel.log_y:
        axis.set_yscale("log")
    axis.grid(True, which="major", color=FAINT, linewidth=0.5)
    _readable_ticks(axis.xaxis, unit_of(panel.x_label))
    if panel.log_y:
        _readable_ticks(axis.yaxis, unit_of(panel.y_label))
    else:
        _share_axis(axis, max(p.error for p in panel.points))


def _share_axis(axis: Any, most: float) -> None:
    """Show shares from zero to one on an axis.

    If the maximum is at most a tenth, show slightly more than it.
    """
    top = 1.0 if most > 0.15 or most == 0 else 1.2 * most
    # The axis starts slightly below zero to show whole marks; labels start at zero.
    axis.set_ylim(-0.05 * top, 1.05 * top)
    axis.set_yticks([tick for tick in MaxNLocator(6).tick_values(0.0, top) if 0 <= tick <= 1.001 * top])
    axis.yaxis.set_major_formatter(PercentFormatter(1.0))


_RING, _LABEL, _CLEAR = 15.0, 8.5, 10.0
"""Diameter of a ring, height of a label's letters, and width of a mark, in points."""
_AWAY = np.array([0.0, 6.0, 12.0, 20.0, 30.0, 42.0, 60.0])
"""Tried distances between mark and label, in points; from `_LED` on a line connects them."""
_LED = 10.0
_ALONG = np.linspace(0.3, 0.8, 8)
"""Tested points of the line from a mark to its label, as shares of its length."""
_SIDES = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1), (1, 0), (-1, 0), (0, 1), (0, -1)])


def _label_settings(axis: Any, panel: Diagram, looks: dict[str, tuple[str, str]], *, named: bool) -> None:
    """Write settings beside their marks, with the method's name if `named`.

    The place has the least overlap with marks, rings, the front and other labels.
    """
    unit = axis.figure.dpi / 72
    renderer = axis.figure._get_renderer()

    def pixels(points: Sequence[Point]) -> Array:
        return axis.transData.transform([(p.seconds, _height(panel, p.error)) for p in points])

    spots, front = pixels(panel.points), pixels(panel.front)
    clear = [unit * (_RING + 2 if p.default else _CLEAR) for p in panel.points]
    taken = [_box(spot, size) for spot, size in zip(spots, clear, strict=True)]
    labels: list[Array] = []
    for one, other in pairwise(front):
        corner = np.array([other[0], one[1]])
        taken += [_box((a + b) / 2, np.abs(b - a) + 4 * unit) for a, b in ((one, corner), (corner, other))]
    shown = _labels(panel, named=named)
    for p, spot, size in zip(panel.points, spots, clear, strict=True):
        if not shown.get(id(p)):
            continue
        look = {"textcoords": "offset points", "xy": (p.seconds, _height(panel, p.error)), "in_layout": False}
        colour = looks[p.method][1]
        look |= {"fontsize": _LABEL, "color": colour, "ha": "center", "va": "center"}
        text = axis.annotate(shown[id(p)], xytext=(0, 0), **look)
        extent = np.array([*text.get_window_extent(renderer).size])
        away = np.repeat(_AWAY, len(_SIDES))
        offsets = np.tile(_SIDES, (len(_AWAY), 1)) * (size / 2 + unit * away[:, None] + extent / 2)
        boxes = np.array([_box(spot + offset, extent) for offset in offsets])
        outside = extent.prod() - _common(boxes, axis.bbox.extents)
        # A line to a label must not cross other labels, and conversely.
        dots = np.array([[_box(spot + share * offset, 3 * unit) for share in _ALONG] for offset in offsets])
        crossed = sum(_common(dots.reshape(-1, 4), label).reshape(len(offsets), -1).sum(axis=1) for label in labels)
        covered = sum(_common(boxes, other) for other in taken)
        cost = 10 * (covered + outside) + away + crossed * (away >= _LED)
        best = int(np.argmin(cost))
        text.set_position(offsets[best] / unit)
        labels.append(boxes[best])
        taken.append(boxes[best])
        if away[best] >= _LED:
            line = {"arrowstyle": "-", "color": colour, "linewidth": 0.5, "shrinkA": 1, "shrinkB": 3}
            nearest = np.clip(0.0, offsets[best] - extent / 2, offsets[best] + extent / 2)
            axis.annotate("", xytext=nearest / unit, arrowprops=line, **look)


def _labels(panel: Diagram, *, named: bool) -> dict[int, str]:
    """Return the label of each point that has one: settings on the front and of defaults, and each method once."""
    chosen = {id(p) for p in (*panel.front, *panel.defaults)}
    few = len(panel.points) <= MOST_LABELS
    labels = {id(p): p.setting for p in panel.points if few or id(p) in chosen}
    if not named:
        return labels
    for method in dict.fromkeys(p.method for p in panel.points):
        own = [p for p in panel.points if p.method == method]
        best = min(own, key=lambda p: (id(p) not in chosen, panel.off_front(p)))
        labels[id(best)] = best.name if id(best) in labels else method
    return labels


MOST_LABELS = 20
"""Points of a diagram that all have their settings beside them."""


def _box(middle: Array, size: Array | float) -> Array:
    """Return left, bottom, right and top."""
    return np.concatenate([middle - np.divide(size, 2), middle + np.divide(size, 2)])


def _common(boxes: Array, other: Array) -> Array:
    """Return the overlap areas of boxes (K, 4) with another."""
    return np.clip(np.minimum(boxes[:, 2:], other[2:]) - np.maximum(boxes[:, :2], other[:2]), 0, None).prod(axis=1)


def _readable_ticks(axis: Any, unit: str, many: float = _MANY) -> None:
    """Thin labels of a logarithmic axis, and give them their unit with an SI prefix.

    Powers of ten remain, with 1, 2, 5 on short ranges, otherwise a few round numbers.
    """
    low, high = axis.get_view_interval()
    axis.set_minor_formatter(NullFormatter())
    if high / low < many:
        few = high / low < _FEW
        axis.set_major_locator(MaxNLocator(4, min_n_ticks=2) if few else LogLocator(subs=(1.0, 2.0, 5.0)))
        if few:
            axis.set_minor_locator(NullLocator())
    if unit or high / low < many:
        axis.set_major_formatter(FuncFormatter(lambda value, _: quantity(value, unit)))
