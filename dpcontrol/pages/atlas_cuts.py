"""Cuts of the tubes on a section, with the connections."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes

from dpcontrol.pages import style
from dpcontrol.pages.atlas_parts import BRANCHES, colours, connections_of, section_curves, section_place
from dpcontrol.pages.layout import key
from dpcontrol.pages.panels import angle_axis, name_point, quiet
from dpcontrol.walks.atlas import Atlas, AtlasConnection, AtlasKind, section_axes


def draw_cuts(
    axes: Axes,
    atlas: Atlas,
    kind: AtlasKind,
    *,
    shown: tuple[AtlasConnection, ...] | None = None,
    numbers: dict[str, str] | None = None,
    legend: bool = True,
    sense: int | None = None,
    title: str = "",
) -> None:
    """Draw both tubes' cuts of a kind and mark its connections.

    Args:
        axes: panel.
        atlas: with the kind.
        kind: of connections.
        shown: marked connections, all by default.
        numbers: labels by connection name.
        legend: True adds a key.
        sense: drawn crossings, None for both.
        title: title of the panel.
    """
    section = atlas.cut(kind.source, kind.section, kind.hits[0]).section
    coordinate, period = section_axes(section, atlas)
    for is_stable, direction, points in section_curves(atlas, kind):
        if sense not in (None, direction):
            continue
        line = "-" if direction > 0 or sense else (0, (4, 1.6))
        axes.plot(*points.T, color=BRANCHES[is_stable, 1], linewidth=1.3, linestyle=line, zorder=2)
    connections = connections_of(atlas, kind) if shown is None else shown
    look = colours(connections)
    for c in connections:
        place = section_place(atlas, c)
        axes.plot(*place, "o", color=look[c.name], markeredgecolor="white", markersize=7, zorder=4)
        if numbers and c.name in numbers:
            name_point(axes, numbers[c.name], (float(place[0]), float(place[1])), look[c.name])
    label = f"{coordinate} on the section" + (" (rad)" if period else "")
    quiet(axes, title, x=label, y="p / p₀" if period else "momentum")
    if period:
        angle_axis(axes, "x")
    if legend:
        every = len(connections_of(atlas, kind))
        marked = f"{len(connections)} of {every} connections" if len(connections) < every else "connections"
        key(axes, [*_LINES, (marked, {"color": style.INK, "marker": "o", "linestyle": ""})])


_LINES: list[tuple[str, str | dict[str, Any]]] = [
    ("tube out", style.UNSTABLE),
    ("tube in", style.STABLE),
    ("backward", {"color": style.CART, "linestyle": (0, (4, 1.6))}),
]
"""Key of the lines in a panel of cuts."""
