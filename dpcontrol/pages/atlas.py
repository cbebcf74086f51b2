"""Drawings of an atlas: tubes, cuts on a section, connections in space and in the plane, and the page of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.document import counted
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, Panel, Stack, key
from dpcontrol.pages.panels import angle_axis, name_point, quiet, quiet_plane, quiet_space, wrapped_runs
from dpcontrol.walks.atlas import Atlas, AtlasConnection, AtlasCut, AtlasKind, AtlasOrbit, section_axes

BRANCHES = {
    (False, 1): style.UNSTABLE,
    (False, -1): style.PALE_UNSTABLE,
    (True, 1): style.STABLE,
    (True, -1): style.PALE_STABLE,
}
"""Colours by (stable, branch): unstable tubes red, stable ones green; the second branch is pale."""


@dataclass(frozen=True, eq=False)
class TubePart:
    """One branch of a tube in space.

    It has trajectories (M, N) up to its section, and their end points (K, N).

    `sense` is the sign of the final crossing, 0 without one.
    """

    stable: bool
    branch: int
    strands: list[Array]
    ends: list[Array]
    sense: int = 0

    @property
    def colour(self) -> str:
        """Colour of the trajectories."""
        return BRANCHES[self.stable, self.branch]


def section_curves(atlas: Atlas, kind: AtlasKind) -> list[tuple[bool, int, Array]]:
    """Return the cuts of a kind's tubes as runs.

    A run has (stable, sign of the crossing, points (K, 2) within a period).

    Args:
        atlas: atlas with the kind.
        kind: kind of connection.
    """
    found = []
    for stable, saddle, hit in ((False, kind.source, kind.hits[0]), (True, kind.target, kind.hits[1])):
        cut = atlas.cut(saddle, kind.section, hit)
        _, period = section_axes(cut.section, atlas)
        for piece in cut.pieces:
            points = piece.stable_points if stable else piece.points
            closed = np.vstack([points, points[:1]]) if piece.closed else points
            sign = stable_direction(atlas, cut, piece.direction) if stable else piece.direction
            runs = wrapped_runs(closed, (period, None))
            found += [(stable, 1 if sign > 0 else -1, run) for run in runs]
    return found


def section_place(atlas: Atlas, connection: AtlasConnection) -> Array:
    """Return the point (q, p/p₀) of a connection on its section.

    The angle q is within a period.

    Args:
        atlas: atlas with the connection.
        connection: connection with a section.
    """
    _, period = section_axes(connection.section, atlas)
    q, p = connection.point
    return np.array([q - (np.rint(q / period) * period if period else 0.0), p])


def tubes_of_cut(atlas: Atlas, cut: AtlasCut) -> list[TubePart]:
    """Return both branches of a saddle's tubes up to a cut.

    The stable tube is found by time reversal.

    Args:
        atlas: atlas with the cut.
        cut: cut of the saddle's tubes.
    """
    parts = []
    for stable in (False, True):
        for branch in (1, -1):
            strands = list(cut.strands[cut.strand_branches == branch])
            pieces = [piece for piece in cut.pieces if piece.branch == branch]
            closed = [np.vstack([p.states, p.states[:1]]) if p.closed else p.states for p in pieces]
            if stable:
                strands, closed = ([atlas.turned(states, cut.saddle) for states in some] for some in (strands, closed))
            ways = {stable_direction(atlas, cut, p.direction) if stable else p.direction for p in pieces}
            parts.append(TubePart(stable, branch, strands, closed, ways.pop() if len(ways) == 1 else 0))
    return parts


def kind_of(atlas: Atlas, source: str, target: str) -> AtlasKind:
    """Return the last kind searched between two saddles.

    A search ends with the first kind that has connections.

    Args:
        atlas: atlas with the kinds.
        source: saddle that the connections leave.
        target: saddle that they join.
    """
    return [kind for kind in atlas.kinds if (kind.source, kind.target) == (source, target)][-1]


def connections_of(atlas: Atlas, kind: AtlasKind) -> tuple[AtlasConnection, ...]:
    """Return the connections of a kind.

    Args:
        atlas: atlas with the kind.
        kind: kind of connection.
    """
    return tuple(c for c in atlas.between(kind.source, kind.target) if c.hits == kind.hits)


def stable_direction(atlas: Atlas, cut: AtlasCut, direction: int) -> int:
    """Return the sign of a stable tube's crossing of the section.

    It follows from its unstable image's.

    Args:
        atlas: atlas with the cut.
        cut: cut of the saddle's tubes.
        direction: sign of the unstable image's crossing.
    """
    normal = np.asarray(cut.section.normal)
    # Under time reversal a crossing changes sides unless the reverser also flips the section.
    return -direction * int(np.sign(normal @ atlas.reverser @ normal))


def colours(connections: tuple[AtlasConnection, ...]) -> dict[str, str]:
    """Return a colour for each connection by name.

    Mirror images (the other sense) share one.
    """
    chosen: dict[str, str] = {}
    keys: list[tuple[object, ...]] = []
    for c in sorted(connections, key=lambda c: -round(c.transversality_angle, 3)):
        # Quantities that mirror images share, rounded as coarsely as in names.
        key = (round(c.transversality_angle, 3), round(c.time_in + c.time_out, 3))
        if key not in keys:
            keys.append(key)
        chosen[c.name] = style.CONNECTIONS[keys.index(key) % len(style.CONNECTIONS)]
    return chosen


def placed(atlas: Atlas, orbit: AtlasOrbit, winding: Sequence[int] = ()) -> Array:
    """Return an orbit as a closed curve (M, N), shifted by turns.

    Args:
        atlas: atlas with the orbit.
        orbit: orbit to shift.
        winding: whole turns of each coordinate; none by default.
    """
    turns = np.zeros(len(atlas.periods))
    turns[: len(winding)] = winding
    return np.vstack([orbit.samples, orbit.samples[:1]]) + turns * atlas.turn_lengths


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
    every = len(connections_of(atlas, kind))
    marked = f"{len(connections)} of {every} connections" if len(connections) < every else "connections"
    key(axes, [*_LINES, (marked, {"color": style.INK, "marker": "o", "linestyle": ""})] if legend else [])


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
        flights.append(partial(draw_motions, atlas=atlas, flights=[(c, look[c.name])], saddles=(), title=title))
    cuts = Panel(partial(draw_cuts, atlas=atlas, kind=kind, shown=marked, numbers=numbers), 1.0)
    return [cuts, *(Panel(draw, _FLIGHTS / max(len(flights), 1)) for draw in flights)]


_FLIGHTS = 1.75
"""Width of all flights in a row, relative to the cuts."""


def draw_motions(
    axes: Axes,
    atlas: Atlas,
    tubes: Sequence[TubePart] = (),
    *,
    flights: Sequence[tuple[AtlasConnection, str]] = (),
    saddles: tuple[str, ...] | None = None,
    title: str = "",
) -> None:
    """Draw tubes, orbits and flights in space, or in the plane of coordinates.

    Flights start at their source's named position. If they end whole turns away, the target orbit is drawn there.

    Args:
        axes: panel in space or in the plane.
        atlas: with the orbits.
        tubes: parts of tubes.
        flights: connections with their colours.
        saddles: saddles whose orbits are drawn at their named position, besides those of flights; all by default.
        title: of the panel.
    """
    space = axes.name == "3d"
    picked = [0, 1, len(atlas.periods) // 2][: 3 if space else 2]
    for tube in tubes:
        for states in tube.strands:
            axes.plot(*states[:, picked].T, color=tube.colour, linewidth=0.5, alpha=0.8)
        for states in tube.ends:
            axes.plot(*states[:, picked].T, color=style.CUT, linewidth=1.6)
    ends = {end for c, _ in flights for end in ((c.source, ()), (c.target, c.winding if any(c.winding) else ()))}
    for c, colour in flights:
        axes.plot(*c.states[:, picked].T, color=colour, linewidth=1.1, zorder=8)
        axes.plot(*c.state[picked, None], "o", color=colour, markeredgecolor="white", markersize=5, zorder=9)
    look = {"linewidth": 2.5, "zorder": 10} if space else {"linewidth": 3.5, "alpha": 0.45, "zorder": 1}
    for orbit in atlas.orbits:
        own = {winding for saddle, winding in ends if saddle == orbit.saddle and orbit.family == 0}
        for winding in own | ({()} if saddles is None or orbit.saddle in saddles else set()):
            closed = placed(atlas, orbit, winding)
            axes.plot(*closed[:, picked].T, color=style.saddle_colour(orbit.saddle), **look)
    if space:
        quiet_space(axes, atlas)
        axes.set_title(title, loc="left")
    else:
        quiet_plane(axes, atlas, title=title)
        axes.set_aspect("equal", adjustable="datalim")
    lines: list[tuple[str, str | dict[str, Any]]] = [("tubes out", style.UNSTABLE), ("tubes in", style.STABLE)]
    lines += [("cuts", style.CUT), *([("connections", style.INK)] if flights else [])]
    key(axes, lines if tubes else [])


def draw_atlas(atlas: Atlas) -> Figure:
    """Return the atlas on one page.

    It shows tubes, orbits and flights in space, and the cuts of every kind.
    """
    kinds = [kind for kind in atlas.kinds if connections_of(atlas, kind)]
    counts = f"{counted(len(atlas.orbits), 'orbit')}, {counted(len(atlas.connections), 'connection')}"
    page = Page(f"{atlas.title} at {atlas.energy:g}{atlas.unit('J')}: {counts}")
    space = Panel(partial(_draw_whole, atlas=atlas), space=True)
    panels = [
        partial(draw_cuts, atlas=atlas, kind=k, title=f"{k.source} → {k.target}: {k.count} at hits {list(k.hits)}")
        for k in kinds
    ]
    page.row(space, *([Stack(panels[:2])] if panels else []), height=6.4 if len(panels) > 1 else 5.2)
    return page.grid(panels[2:], across=2, height=3.2).figure()


def _draw_whole(axes: Axes, atlas: Atlas) -> None:
    tubes = [part for cut in atlas.cuts for part in tubes_of_cut(atlas, cut)]
    draw_motions(axes, atlas, tubes, flights=[(c, style.INK) for c in atlas.connections])
    for k, orbit in enumerate(atlas.orbits):
        look = {"fontsize": style.SMALL, "color": style.saddle_colour(orbit.saddle), "weight": "bold"}
        axes.text2D(0.0, 0.04 * k, f"orbit about {orbit.name}", transform=axes.transAxes, **look)  # type: ignore[attr-defined]
    axes.set_box_aspect(None, zoom=1.1)  # type: ignore[call-arg]


def atlas(axes: Axes, found: Atlas) -> None:
    """Draw the cuts of the first kind of connections.

    Args:
        axes: panel to draw on.
        found: atlas to draw.
    """
    if found.kinds:
        draw_cuts(axes, found, max(found.kinds, key=lambda kind: kind.count), legend=False)
