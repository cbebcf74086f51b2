"""Pictures of charts: pages of at most three diagrams or maps.

Each has its result as title. The layout engine of pages places them.

A diagram has errors over times, and each method has its name beside its first mark. Settings are beside the other
marks, in full diagrams only beside those on the front and the defaults. A map has a row for each of its lines. Axes
have units with SI prefixes.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, PercentFormatter

from dpcontrol.bench.chart import ChartPage, Diagram, EdgeMap, Point, split_label
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.units import quantity
from dpcontrol.pages.layout import Page, key, save_figure
from dpcontrol.pages.panels import name_rows, quiet
from dpcontrol.pages.style import FAINT, GOOD, INK, LIMIT, MARK, PAPER, SERIES, SMALL

Look = dict[str, Any]
Layer = tuple[str, Sequence[tuple[float, float]], Look]
"""Label in the key, or "", places in data, and look."""
MARKS = "osD^v<>Pph*X8d"
FLOOR = 1e-17
"""Drawn position of an error of exactly zero."""
MOST_LABELS = 20
"""Points of a diagram that all have their settings beside them."""
_RING, _CLEAR = 15.0, 10.0
"""Diameter of a ring about a default, and width of another mark, points."""
_DEFAULT: Look = {
    "marker": "o",
    "linestyle": "none",
    "markerfacecolor": "none",
    "color": LIMIT,
    "markersize": _RING,
}
_FEW, _LONG = 6.0, 50.0
"""Ranges of a logarithmic axis: below the first, 1, 2, 5 give too few labels, from the second on they give too many."""


def save_chart(page: ChartPage, picture: Path, parts: Sequence[Any] | None = None) -> None:
    """Draw some of a chart's diagrams to a PNG.

    Args:
        page: page of the chart.
        picture: file to write.
        parts: diagrams, by default all.

    Raises:
        InputError: the file cannot be written.
    """
    save_figure(figure(page, page.parts if parts is None else parts), picture)


def figure(page: ChartPage, parts: Sequence[Any]) -> Figure:
    """Return a picture of some of a chart's diagrams.

    Each method has one colour and mark throughout.

    Args:
        page: page of the chart.
        parts: diagrams or maps.
    """
    methods = dict.fromkeys(p.method for part in parts if isinstance(part, Diagram) for p in part.points)
    looks: dict[str, Look] = {
        m: {"marker": MARKS[k % len(MARKS)], "color": SERIES[k % len(SERIES)]} for k, m in enumerate(methods)
    }
    panels = [partial(_draw, part=part, looks=looks) for part in parts]
    drawn = Page(page.title, page.chosen).grid(panels, across=min(len(parts), 2), height=3.7)
    picture = drawn.text("\n".join(page.reading)).figure()
    for axes, part in zip(picture.axes, parts, strict=False):
        # The space for labels is known once the axes have their positions.
        if isinstance(part, Diagram):
            _label_points(axes, part, looks)
    return picture


def _draw(axes: Axes, part: Diagram | EdgeMap, looks: dict[str, Look]) -> None:
    of_points = isinstance(part, Diagram)
    layers = [layer for layer in (_points(part, looks) if of_points else _borders(part)) if layer[1]]
    for _, places, look in layers:
        axes.plot(*np.transpose(places), **look)
    key(axes, [(label, {**look, "markersize": 6}) for label, _, look in layers if label])
    axes.margins(0.12, 0.1)
    axes.set_xscale("log")
    across, up = (part.x_label, part.y_label) if of_points else (part.y_label, part.x_label)
    (x, x_unit), (y, y_unit) = split_label(across), split_label(up)
    quiet(axes, f"{part.title}: {part.finding()}", x=x, y=y)
    _readable_ticks(axes.xaxis, x_unit)
    if not of_points:
        name_rows(axes, [border.line for border in part.borders])
    elif part.log_y:
        axes.set_yscale("log")
        _readable_ticks(axes.yaxis, y_unit)
    else:
        axes.set_ylim(-0.05, 1.05)
        axes.set_yticks(np.linspace(0.0, 1.0, 6))
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))


def _place(panel: Diagram, point: Point) -> tuple[float, float]:
    return point.seconds, max(point.error, panel.floor, FLOOR) if panel.log_y else point.error


def _points(panel: Diagram, looks: dict[str, Look]) -> Iterator[Layer]:
    front: Look = {"color": FAINT, "linewidth": 4, "drawstyle": "steps-post"}
    yield "best at its cost", [_place(panel, p) for p in panel.front], front
    for p in panel.points:
        face = PAPER if p.outside or p.stored else looks[p.method]["color"]
        yield "", [_place(panel, p)], {**looks[p.method], "markersize": 6, "markerfacecolor": face, "zorder": 3}
    yield "default of dpcontrol", [_place(panel, p) for p in panel.defaults], {**_DEFAULT, "zorder": 4}


def _borders(one: EdgeMap) -> Iterator[Layer]:
    rows = list(enumerate(one.borders))
    marks: Look = {"linestyle": "none", "markersize": 5}
    trials = [(t.y, k, t.works) for k, b in rows for t in b.trials]
    yield one.near, [(y, k) for y, k, works in trials if works], {**marks, "marker": "o", "color": GOOD}
    yield one.far, [(y, k) for y, k, works in trials if not works], {**marks, "marker": "x", "color": LIMIT}
    measured = [(b.measured, k) for k, b in rows if b.measured is not None]
    yield "measured", measured, {**marks, "marker": "|", "color": INK, "markersize": 14}
    predicted = [(b.predicted, k) for k, b in rows if b.predicted is not None]
    yield "predicted", predicted, {**marks, "marker": "D", "color": MARK, "markersize": 7, "markerfacecolor": "none"}
    x, value = one.default or (None, 0.0)
    yield "default of dpcontrol", [(value, k) for k, b in rows if b.x == x], _DEFAULT


_AWAY = np.repeat([0.0, 6.0, 12.0, 20.0, 30.0, 42.0, 60.0], 8)
"""Tried distances between mark and label, in points; from `_LED` on a line connects them."""
_LED = 10.0
_SIDES = np.tile([(1, 1), (1, -1), (-1, 1), (-1, -1), (1, 0), (-1, 0), (0, 1), (0, -1)], (7, 1))
"""Direction of the label at each of these distances."""


def _label_points(axes: Any, panel: Diagram, looks: dict[str, Look]) -> None:
    """Write names and settings beside their marks.

    The place has the least overlap with marks, rings and other labels.
    """
    picture = axes.get_figure(root=True)
    unit, renderer = picture.dpi / 72, picture.canvas.get_renderer()
    spots = axes.transData.transform([_place(panel, p) for p in panel.points])
    taken = [_box(spot, unit * (_RING if p.default else _CLEAR)) for p, spot in zip(panel.points, spots, strict=True)]
    for p, spot in zip(panel.points, spots, strict=True):
        colour = looks[p.method]["color"]
        look = {"textcoords": "offset points", "xy": _place(panel, p), "in_layout": False, "color": colour}
        look |= {"fontsize": SMALL, "ha": "center", "va": "center"}
        look |= {"path_effects": [withStroke(linewidth=2, foreground=PAPER)]}
        text = axes.annotate(_label(panel, p), xytext=(0, 0), **look)
        extent = np.array(text.get_window_extent(renderer).size)
        offsets = _SIDES * (unit * (_CLEAR / 2 + _AWAY[:, None]) + extent / 2)
        boxes = np.array([_box(spot + offset, extent) for offset in offsets])
        outside = extent.prod() - _common(boxes, axes.bbox.extents)
        best = int(np.argmin(10 * (outside + sum(_common(boxes, other) for other in taken)) + _AWAY))
        text.set_position(offsets[best] / unit)
        # Text over text is worse than text over marks.
        taken += [boxes[best]] * 4
        if _AWAY[best] >= _LED:
            line = {"arrowstyle": "-", "color": colour, "linewidth": 0.5, "shrinkA": 1, "shrinkB": 3}
            nearest = np.clip(0.0, offsets[best] - extent / 2, offsets[best] + extent / 2)
            axes.annotate("", xytext=nearest / unit, arrowprops=line, **look)


def _label(panel: Diagram, point: Point) -> str:
    full = len(panel.points) > MOST_LABELS
    setting = "" if full and not point.default and point not in panel.front else point.setting
    named = point is next(p for p in panel.points if p.method == point.method)
    return ", ".join(filter(None, (point.method * named, setting)))


def _box(middle: Array, size: Array | float) -> Array:
    """Return left, bottom, right and top."""
    return np.concatenate([middle - np.divide(size, 2), middle + np.divide(size, 2)])


def _common(boxes: Array, other: Array) -> Array:
    """Return the overlap areas of boxes (K, 4) with another."""
    return np.clip(np.minimum(boxes[:, 2:], other[2:]) - np.maximum(boxes[:, :2], other[:2]), 0, None).prod(axis=1)


def _readable_ticks(axis: Any, unit: str) -> None:
    """Label a logarithmic axis by powers of ten, short ranges also between them, with prefixed units."""
    low, high = axis.get_view_interval()
    between = (1.0, 2.0, 5.0) if high < _LONG * low else (1.0,)
    axis.set_major_locator(MaxNLocator(4, min_n_ticks=2) if high < _FEW * low else LogLocator(subs=between))
    if unit or high < _LONG * low:
        axis.set_major_formatter(FuncFormatter(lambda value, _: quantity(value, unit)))
    axis.set_minor_formatter(NullFormatter())
