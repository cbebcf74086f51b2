"""Panels of an atlas: cuts of the tubes on a section, connections in space, in the plane and over time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

from matplotlib.axes import Axes

from dpcontrol.pages import style
from dpcontrol.pages.atlas_parts import (
    BRANCHES,
    colours,
    connections_of,
    placed,
    section_curves,
    section_place,
    tubes_of_cut,
)
from dpcontrol.pages.layout import Panel, key
from dpcontrol.pages.panels import angle_axis, name_point, quiet, quiet_plane, quiet_space
from dpcontrol.walks.atlas import Atlas, AtlasConnection, AtlasCut, AtlasKind, section_axes


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


def row_of(
    atlas: Atlas,
    kind: AtlasKind,
    shown: Sequence[AtlasConnection],
    *,
    numbers: dict[str, str],
    marked: tuple[AtlasConnection, ...] | None = None,
) -> list[Panel]:
    """Return a row of panels: the cuts of a kind, and the flights of `shown` with their numbers.

    Args:
        atlas: with the kind.
        kind: of the connections.
        shown: connections with a panel each.
        numbers: labels by connection name.
        marked: connections on the cuts; all by default.
    """
    look = colours(connections_of(atlas, kind) if marked is None else marked)
    flights = []
    for c in shown:
        turns = ", ".join(f"{turn:+d}" if turn else "0" for turn in c.winding)
        title = f"{numbers[c.name]}  {c.transversality_angle:.1f}° [{turns}]"
        flights.append(partial(draw_flight, atlas=atlas, connection=c, colour=look[c.name], title=title))
    cuts = Panel(partial(draw_cuts, atlas=atlas, kind=kind, shown=marked, numbers=numbers), 1.0)
    return [cuts, *(Panel(draw, _FLIGHTS / max(len(flights), 1)) for draw in flights)]


_FLIGHTS = 1.75
"""Width of all flights in a row, relative to the cuts."""


def draw_flight(axes: Axes, atlas: Atlas, connection: AtlasConnection, colour: str, *, title: str) -> None:
    """Draw a flight with both orbits in the plane of coordinates.

    It starts at its source's named position.

    Args:
        axes: panel to draw on.
        atlas: atlas with the connection.
        connection: connection to draw.
        colour: colour of the flight.
        title: title of the panel.
    """
    for saddle, winding in ((connection.source, ()), (connection.target, connection.winding)):
        orbit = next(o for o in atlas.orbits if o.saddle == saddle)
        look = {"color": style.saddle_colour(saddle), "linewidth": 3.5, "alpha": 0.45}
        axes.plot(*placed(atlas, orbit, winding)[:, :2].T, zorder=1, **look)
    axes.plot(*connection.states[:, :2].T, color=colour, linewidth=1.3, zorder=3)
    axes.plot(*connection.state[:2], "o", color=colour, markeredgecolor="white", markersize=6, zorder=4)
    quiet_plane(axes, atlas, title=title)
    axes.set_aspect("equal", adjustable="datalim")


def draw_space(
    axes: Axes,
    atlas: Atlas,
    cuts: Iterable[AtlasCut],
    *,
    flights: Sequence[tuple[AtlasConnection, str]] = (),
    sense: int | None = None,
    saddles: tuple[str, ...] | None = None,
    title: str = "",
) -> None:
    """Draw the tubes of cuts, all orbits, and flights in space.

    `sense` selects branches by the sense of their final crossings; None draws both. `saddles` selects orbits; None
    draws all.

    Flights start at their source's named position. If they end whole turns away, the target orbit is drawn there.

    Args:
        axes: panel in space.
        atlas: with the orbits.
        cuts: of tubes.
        flights: connections with their colours.
        sense: 1, -1 or None.
        saddles: of the orbits.
        title: of the panel.
    """
    picked = [0, 1, len(atlas.periods) // 2]
    for tube in (part for cut in cuts for part in tubes_of_cut(atlas, cut) if sense in (None, part.sense)):
        for states in tube.strands:
            axes.plot(*states[:, picked].T, color=tube.colour, linewidth=0.5, alpha=0.8)
        for states in tube.ends:
            axes.plot(*states[:, picked].T, color=style.CUT, linewidth=1.6)
    ends = sorted({(c.target, c.winding) for c, _ in flights if any(c.winding)})
    for c, colour in flights:
        axes.plot(*c.states[:, picked].T, color=colour, linewidth=0.9, alpha=0.9, zorder=8)
    for orbit in (o for o in atlas.orbits if saddles is None or o.saddle in saddles):
        colour = style.saddle_colour(orbit.saddle)
        axes.plot(*placed(atlas, orbit)[:, picked].T, color=colour, linewidth=2.5, zorder=10)
        for winding in (w for saddle, w in ends if saddle == orbit.saddle and orbit.family == 0):
            axes.plot(*placed(atlas, orbit, winding)[:, picked].T, color=colour, linewidth=1.6, alpha=0.6, zorder=9)
    quiet_space(axes, atlas)
    axes.set_title(title, loc="left")
    looks: list[tuple[str, str | dict[str, Any]]] = [("tubes out", style.UNSTABLE), ("tubes in", style.STABLE)]
    looks += [("cuts", style.CUT), *([("connections", style.INK)] if flights else [])]
    key(axes, looks)
