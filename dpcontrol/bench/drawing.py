"""Pictures of charts: pages of at most three diagrams.

Each diagram has its result as title. The layout engine of pages places them.

A page of up to two methods has a key for them; with more, each method's name is beside its best mark. Settings are
beside the marks on the front and the defaults. Axes have units with SI prefixes.
"""

from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator, PercentFormatter

from dpcontrol.bench.chart import LEADING, ChartPage, Diagram, EdgeMap, Point, name_of, unit_of
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.units import quantity
from dpcontrol.pages.layout import Page, key, save_figure
from dpcontrol.pages.panels import quiet
from dpcontrol.pages.style import FAINT, GOOD, INK, LIMIT, MARK, PAPER, SERIES, SMALL

MARKS = "osD^v<>Pph*X8d"
_DEFAULT: dict[str, Any] = {
    "marker": "o",
    "linestyle": "none",
    "markerfacecolor": "none",
    "color": LIMIT,
    "markersize": 9,
}
"""Ring about the package's choice."""
FLOOR = 1e-17
"""Drawn position of an error of exactly zero."""
_TALL, _LINE = 3.7, 0.3
"""Heights of a row of diagrams and of a search's bar, inches."""
IN_KEY = 2
"""Methods in a key; with more, each has its name beside a mark."""
_FEW, _LONG, _MANY = 6.0, 50.0, 100.0
"""Ranges of a logarithmic axis: below the first 1, 2, 5 give too few labels, from the second on they give too many, and
from the third on powers are enough."""


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
    """Return a picture of some of a chart's diagrams, side by side.

    Each method has one colour and mark throughout.

    Args:
        page: page of the chart.
        parts: diagrams of one kind.
    """
    panels = [part for part in parts if isinstance(part, Diagram)]
    methods = list(dict.fromkeys(p.method for panel in panels for p in panel.points))
    looks = {m: (MARKS[k % len(MARKS)], SERIES[k % len(SERIES)]) for k, m in enumerate(methods)}
    drawn, columns = Page(page.headline, page.chosen), 2 if panels else LEADING
    for row in (parts[k : k + columns] for k in range(0, len(parts), columns)):
        drawn.row(*(partial(_draw, part=part, looks=looks, first=part is row[0]) for part in row), height=_TALL)
    picture = drawn.text("\n".join(page.reading)).figure()
    for axes, panel in zip(picture.axes, panels, strict=False):
        # The space for labels is known once the axes have their positions.
        _label_settings(axes, panel, looks, named=len(methods) > IN_KEY)
    return picture


def _draw(axes: Axes, part: Any, looks: dict[str, tuple[str, str]], *, first: bool) -> None:
    """Draw a diagram or a map.

    The first of a row names the cases of all.
    """
    axes.margins(0.12, 0.1)
    quiet(axes, f"{part.title}: {part.finding()}", x=name_of(part.x_label), y=name_of(part.y_label))
    if isinstance(part, Diagram):
        _draw_panel(axes, part, looks)
    else:
        _draw_map(axes, part, first=first)


def _draw_map(axes: Axes, one: EdgeMap, *, first: bool) -> None:
    """Draw a map upright, or with lines across.

    Lines are across if they have names, such as itineraries, instead of numbers.
    """
    names = {b.x: b.line for b in sorted(one.borders, key=lambda b: b.x)}
    across = not one.log_x and list(names) == list(range(len(names)))
    borders = [{"x": b.x, "measured": b.measured, "predicted": b.predicted} for b in one.borders]
    trials = [{"x": b.x, one.near if t.works else one.far: t.y} for b in one.borders for t in b.trials]
    looks: dict[str, dict[str, Any]] = {
        one.near: {"marker": "o", "linestyle": "none", "color": GOOD, "markersize": 5},
        one.far: {"marker": "x", "linestyle": "none", "color": LIMIT, "markersize": 5},
        "measured": {"marker": "|" if across else "_", "color": INK, "markersize": 14},
        "predicted": {"marker": "D", "linestyle": "--", "color": MARK, "markersize": 7, "markerfacecolor": "none"},
    }
    shown = {}
    for label, look in looks.items():
        places = [(row["x"], row[label]) for row in (*trials, *borders) if row.get(label) is not None]
        if places:
            # Cases with names have no order, so no line joins them.
            shown[label] = {"linewidth": 1.2, **look, **({"linestyle": "none"} if across else {})}
            axes.plot(*zip(*(place[:: -1 if across else 1] for place in places), strict=True), **shown[label])
    if one.default is not None:
        shown["default of dpcontrol"] = _DEFAULT
        axes.plot(*one.default[:: -1 if across else 1], **{**_DEFAULT, "markersize": _RING})
    key(axes, [(label, {**look, "markersize": 6}) for label, look in shown.items()])
    cases, values = (axes.yaxis, axes.xaxis) if across else (axes.xaxis, axes.yaxis)
    if across:
        axes.set_xscale("log")
        axes.set_xlabel(name_of(one.y_label))
        axes.set_ylabel("")
        axes.invert_yaxis()
    else:
        axes.set_yscale("log")
        axes.set_xscale("log" if one.log_x and min(names, default=0) > 0 else "linear")
    labels = [line * first for line in names.values()] if across else [quantity(x, unit_of(one.x_label)) for x in names]
    cases.set_ticks(list(names), labels)
    cases.set_minor_locator(NullLocator())
    # Most borders span less than a decade, so its parts are labelled too.
    _readable_ticks(values, unit_of(one.y_label), many=10 * _MANY)


def _height(panel: Diagram, error: float) -> float:
    return max(error, panel.floor, FLOOR) if panel.log_y else error


def _draw_panel(axis: Axes, panel: Diagram, looks: dict[str, tuple[str, str]]) -> None:
    entries: list[tuple[str, str | dict[str, Any]]] = []
    for method in dict.fromkeys(p.method for p in panel.points):
        mark, colour = looks[method]
        points = sorted((p for p in panel.points if p.method == method), key=lambda p: p.seconds)
        hollow = any(p.outside or p.stored for p in points)
        axis.plot(
            [p.seconds for p in points], [_height(panel, p.error) for p in points], mark, color=colour, markersize=6,
            markerfacecolor=PAPER if hollow else colour, zorder=3,
        )  # fmt: skip
        if len(looks) <= IN_KEY:
            entries.append((method, {"marker": mark, "linestyle": "none", "color": colour, "markersize": 6}))
    front = panel.front
    look: dict[str, Any] = {"color": FAINT, "linewidth": 4}
    axis.plot(
        [p.seconds for p in front], [_height(panel, p.error) for p in front], zorder=1, drawstyle="steps-post", **look
    )
    entries.append(("best at its cost", look))
    for p in panel.defaults:
        axis.plot(p.seconds, _height(panel, p.error), zorder=4, **{**_DEFAULT, "markersize": _RING})
    if panel.defaults:
        entries.append(("default of dpcontrol", _DEFAULT))
    key(axis, entries)
    axis.set_xscale("log")
    if panel.log_y:
        axis.set_yscale("log")
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


_RING, _CLEAR = 15.0, 10.0
"""Diameter of a ring and width of a mark, in points."""
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
    picture = axis.get_figure(root=True)
    unit, renderer = picture.dpi / 72, picture.canvas.get_renderer()

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
        look |= {"fontsize": SMALL, "color": colour, "ha": "center", "va": "center"}
        look |= {"path_effects": [withStroke(linewidth=2, foreground=PAPER)]}
        text = axis.annotate(shown[id(p)], xytext=(0, 0), **look)
        extent = np.array([*text.get_window_extent(renderer).size])
        away = np.repeat(_AWAY, len(_SIDES))
        offsets = np.tile(_SIDES, (len(_AWAY), 1)) * (size / 2 + unit * away[:, None] + extent / 2)
        boxes = np.array([_box(spot + offset, extent) for offset in offsets])
        outside = extent.prod() - _common(boxes, axis.bbox.extents)
        # A line to a label must not cross other labels, and conversely.
        dots = np.array([[_box(spot + share * offset, 3 * unit) for share in _ALONG] for offset in offsets])
        crossed = sum(_common(dots.reshape(-1, 4), label).reshape(len(offsets), -1).sum(axis=1) for label in labels)
        # Text over text is worse than text over marks.
        covered = sum(_common(boxes, other) for other in (*taken, *4 * labels))
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
    """Return the label of each point that has one.

    These are settings on the front and of defaults, and each method once.
    """
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
    """Thin labels of a logarithmic axis, and give them units.

    The unit has an SI prefix.

    Powers of ten remain, with 1, 2, 5 or 1, 3 on short ranges, otherwise a few round numbers.
    """
    low, high = axis.get_view_interval()
    axis.set_minor_formatter(NullFormatter())
    if high / low < many:
        few = high / low < _FEW
        between = (1.0, 2.0, 5.0) if high / low < _LONG else (1.0, 3.0)
        axis.set_major_locator(MaxNLocator(4, min_n_ticks=2) if few else LogLocator(subs=between))
        if few:
            axis.set_minor_locator(NullLocator())
    if unit or high / low < many:
        axis.set_major_formatter(FuncFormatter(lambda value, _: quantity(value, unit)))
