"""Parts of panels that every page shares: frames, axes in units of π, badges, marks and direct labels."""

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import shorten
from typing import Any

import networkx as nx
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.units import quantity
from dpcontrol.pages import style
from dpcontrol.walks.atlas import Atlas


def quiet_space(axes: Axes, of: System | Atlas, title: str = "") -> None:
    """Label the axes of a panel in space with the first and second coordinate and the first rate, seen from above.

    Args:
        axes: panel in space.
        of: system or atlas with the labels.
        title: title of the panel.
    """
    quiet_plane(axes, of, title=title)
    axes.set(zlabel=of.labels[len(of.labels) // 2])
    axes.locator_params(nbins=4)
    axes.view_init(elev=22, azim=-122)  # type: ignore[attr-defined]


def quiet_plane(axes: Axes, of: System | Atlas, columns: tuple[int, int] = (0, 1), title: str = "") -> None:
    """Label a panel that shows two entries of the states of a system, with angles in multiples of π.

    Args:
        axes: panel to label.
        of: system or atlas with the labels.
        columns: indices of the entries.
        title: title of the panel.
    """
    axes.set(title=title, xlabel=of.labels[columns[0]], ylabel=of.labels[columns[1]])
    for column, which in zip(columns, "xy", strict=True):
        if np.isfinite(of.periods[column]):
            angle_axis(axes, which)


class _HalfTurns(MaxNLocator):
    """Round multiples of half a turn, as many as the axis has room for."""

    def tick_values(self, vmin: float, vmax: float) -> Any:
        """Return the angles, rad, between two angles at which matplotlib draws ticks."""
        return np.pi * np.asarray(super().tick_values(vmin / np.pi, vmax / np.pi))


def angle_axis(axes: Axes, which: str) -> None:
    """Tick the "x" or "y" axis in multiples of π.

    Args:
        axes: panel with the axis.
        which: "x" or "y".
    """
    axis = axes.xaxis if which == "x" else axes.yaxis
    axis.set_major_locator(_HalfTurns("auto", steps=[1, 2, 2.5, 5, 10]))
    axis.set_major_formatter(FuncFormatter(lambda value, _: style.in_pi(value / np.pi)))


_FEW, _LONG = 6.0, 50.0
"""Ranges of a logarithmic axis: below the first, 1, 2, 5 give too few labels, from the second on they give too many."""


def readable_ticks(axis: Any, unit: str) -> None:
    """Label a logarithmic axis by powers of ten, short ranges also between them, with prefixed units.

    Args:
        axis: x or y axis of matplotlib, whose range is final.
        unit: unit of its values, "" for plain numbers.
    """
    low, high = axis.get_view_interval()
    multiples = (1.0, 2.0, 5.0) if high < _LONG * low else (1.0,)
    axis.set_major_locator(MaxNLocator(4, min_n_ticks=2) if high < _FEW * low else LogLocator(subs=multiples))
    if unit or high < _LONG * low:
        axis.set_major_formatter(FuncFormatter(lambda value, _: quantity(value, unit)))
    axis.set_minor_formatter(NullFormatter())


def wrapped_runs(curve: Array, periods: tuple[float | None, ...]) -> list[Array]:
    """Return a curve (K, D) as stretches within one period about zero, split where it leaves the period.

    A stretch extends one point beyond its bounds, so that it is drawn up to the frame.

    Args:
        curve: (K, D) in any unit.
        periods: (D,) in the curve's unit, None or zero for coordinates without a period.
    """
    lengths = np.array([period or 0.0 for period in periods])
    turns = np.rint(curve / np.where(lengths, lengths, np.inf))
    breaks = np.flatnonzero((np.diff(turns, axis=0) != 0).any(axis=1)) + 1
    stretches = []
    for start, end in zip(np.r_[0, breaks], np.r_[breaks, len(curve)], strict=True):
        low, high = max(start - 1, 0), min(end + 1, len(curve))
        stretches.append(curve[low:high] - turns[start] * lengths)
    return [stretch for stretch in stretches if len(stretch) > 1]


def name_curves(axes: Axes, names: Sequence[tuple[Any, ...]]) -> None:
    """Name curves at the right of a panel, in the order of their ends, as a key beside the curves.

    Args:
        axes: panel with the curves.
        names: height of the curve's end in data, text and colour of each name, and its kind of line if not solid.
    """
    handles = [
        Line2D([], [], label=text, color=colour, linestyle=dashes[0] if dashes else "-")
        for _, text, colour, *dashes in sorted(names, reverse=True)
    ]
    place: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5), "borderaxespad": 0.4}
    axes.legend(handles=handles, handlelength=1.4, labelcolor="linecolor", **place)


def name_rows(axes: Axes, names: Sequence[str]) -> None:
    """Name the rows of a bar chart, the first at the top.

    Args:
        axes: panel with a bar at each whole number from 0.
        names: name of each row.
    """
    axes.set(yticks=range(len(names)), yticklabels=names, ylim=(max(len(names) - 0.4, 0.6), -0.6))


@dataclass(frozen=True)
class Bar:
    """A row of a bar chart.

    Attributes:
        name: name of the row.
        value: length of the bar.
        colour: colour of the bar.
        interval: ends of a line over the bar, or none.
        note: text at the right of the panel.
    """

    name: str
    value: float
    colour: str
    interval: tuple[float, ...] = ()
    note: str = ""


def bars(axes: Axes, title: str, rows: Sequence[Bar], *, x: str = "") -> None:
    """Draw a bar chart, the first row at the top.

    Args:
        axes: panel to draw on.
        title: title of the panel.
        rows: bars.
        x: label of the x axis.
    """
    axes.set(title=title, xlabel=x)
    for k, bar in enumerate(rows):
        axes.barh(k, bar.value, color=bar.colour, height=0.62, alpha=0.85)
        axes.plot(bar.interval, [k] * len(bar.interval), color=style.INK, linewidth=1.4)
        look = {"xytext": (5, 0), "textcoords": "offset points", "va": "center", "fontsize": style.SMALL}
        axes.annotate(
            bar.note, (1.0, k), xycoords=("axes fraction", "data"), color=style.NOTE, annotation_clip=False, **look
        )
    name_rows(axes, [shorten(bar.name, 52, placeholder=" …") for bar in rows])


def draw_graph(axes: Axes, graph: "nx.MultiDiGraph[str]", title: str) -> None:
    """Draw a connection graph: orbits with an arrow for each pair that is connected, and the numbers of connections.

    A connection is symmetric if time reversal maps it to itself.

    Args:
        axes: panel to draw on.
        graph: orbits as nodes, connections as edges.
        title: title of the panel.
    """
    places = nx.circular_layout(graph, scale=1.3)
    for name, (x, y) in places.items():
        axes.plot(x, y, "o", color=style.saddle_colour(name), markersize=50)
        axes.text(x, y, name, ha="center", va="center", color=style.PAPER, weight="bold")
    for source, target in dict.fromkeys(graph.edges()):
        connections = [data["connection"] for data in graph.get_edge_data(source, target).values()]
        ends, bend, shrink = np.array([places[source], places[target]]), 0.25, 28.0
        # Beside the middle of the arrow, on the side to which it bends.
        label_place = ends.mean(axis=0) + 0.18 * (ends[1] - ends[0])[::-1] * (1, -1)
        # An arrow from an orbit to itself is a loop above its disc.
        if source == target:
            ends, bend, shrink = ends + np.array([(-0.12, 0.38), (0.12, 0.38)]), -3.5, 0.0
            label_place = places[source] + (0.0, 0.95)
        look = {"connectionstyle": f"arc3,rad={bend}", "color": style.CART, "shrinkA": shrink, "shrinkB": shrink}
        axes.annotate("", ends[1], ends[0], arrowprops={"arrowstyle": "-|>", **look})
        text = f"{len(connections)}, {sum(c.symmetric for c in connections)} symmetric"
        axes.text(float(label_place[0]), float(label_place[1]), text, ha="center", va="center", color=style.INK)
    axes.axis("off")
    axes.set(title=title, xlim=(-2.2, 2.2), ylim=(-1.5, 1.5), aspect="equal")


BESIDE = "label beside a point"
"""Identifier of labels that the layout engine may move."""


def name_point(axes: Axes, text: str, at: tuple[float, float], colour: str, *, weight: str = "bold") -> None:
    """Label a point directly, with an outline.

    The layout engine moves labels round their points if they cover marks or other labels.

    Args:
        axes: panel with the point.
        text: text of the label.
        at: (x, y) in data.
        colour: colour of the label.
        weight: weight of its letters.
    """
    axes.annotate(
        text,
        at,
        xytext=(5, 5),
        textcoords="offset points",
        fontsize=style.SMALL,
        color=colour,
        weight=weight,
        zorder=7,
        path_effects=[withStroke(linewidth=2.5, foreground=style.PAPER)],
        gid=BESIDE,
        in_layout=False,
    )
