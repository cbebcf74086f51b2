"""Drawings of an atlas: tubes, cuts, connections in space and in the plane, and their page and Rerun recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.document import counted
from dpcontrol.foundation.version import PROGRAM
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, Panel, Stack, key
from dpcontrol.pages.panels import angle_axis, name_point, quiet_plane, quiet_space, wrapped_runs
from dpcontrol.pages.rerun_recording import DARK, page, record_curves, recording_to, rr, rrb, summary_view
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

    Attributes:
        stable: True for the stable tube, whose trajectories lead to the orbit, False for the unstable one.
        branch: side of the orbit, 1 or -1.
        strands: trajectories (M, N) up to the section.
        ends: curves of their end points (K, N).
        sense: sign of the final crossing of the section, 0 if the branch crosses in both senses or has no section.
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
    """Return the cuts of both tubes of a kind of connections, as curves to draw on the section.

    Args:
        atlas: atlas with the kind.
        kind: kind of connections: two saddles, the section, and the number of crossings of each tube.

    Returns:
        For each curve: True if it belongs to the stable tube, the sign of its crossings, and its points (K, 2) of
        position and momentum. A curve that leaves the period of an angle is split into several.
    """
    curves = []
    for stable, saddle, hit in ((False, kind.source, kind.hits[0]), (True, kind.target, kind.hits[1])):
        cut = atlas.cut(saddle, kind.section, hit)
        _, period = section_axes(cut.section, atlas)
        # The atlas stores cuts of unstable tubes, and the time-reversed image of each, which lies on the stable tube.
        for piece in cut.pieces:
            points = piece.stable_points if stable else piece.points
            closed = np.vstack([points, points[:1]]) if piece.closed else points
            sign = stable_direction(atlas, cut, piece.direction) if stable else piece.direction
            curves += [(stable, 1 if sign > 0 else -1, stretch) for stretch in wrapped_runs(closed, (period, None))]
    return curves


def section_place(atlas: Atlas, connection: AtlasConnection) -> Array:
    """Return the point (q, p/p₀) of a connection on its section, with an angle q shifted into the period about zero.

    q is the coordinate along the section, and p is its momentum, scaled by the section's momentum p₀.

    Args:
        atlas: atlas with the connection.
        connection: connection with a section.
    """
    _, period = section_axes(connection.section, atlas)
    q, p = connection.point
    return np.array([q - (np.rint(q / period) * period if period else 0.0), p])


def tubes_of_cut(atlas: Atlas, cut: AtlasCut) -> list[TubePart]:
    """Return the four parts of a saddle's tubes up to a cut: both branches, unstable and stable.

    A branch is one of the two sides, 1 and -1, on which trajectories leave the orbit. The atlas stores the unstable
    tube only; time reversal gives the stable one.

    Args:
        atlas: atlas with the cut.
        cut: cut of the saddle's tubes.
    """
    parts = []
    for stable in (False, True):
        for branch in (1, -1):
            strands = list(cut.strands[cut.strand_branches == branch])
            pieces = [piece for piece in cut.pieces if piece.branch == branch]
            ends = [np.vstack([p.states, p.states[:1]]) if p.closed else p.states for p in pieces]
            if stable:
                strands, ends = ([atlas.turned(states, cut.saddle) for states in curves] for curves in (strands, ends))
            senses = {stable_direction(atlas, cut, p.direction) if stable else p.direction for p in pieces}
            # Sense 0 stands for a branch whose pieces cross the section in both senses.
            parts.append(TubePart(stable, branch, strands, ends, senses.pop() if len(senses) == 1 else 0))
    return parts


def kind_of(atlas: Atlas, source: str, target: str) -> AtlasKind:
    """Return the last kind searched between two saddles, since a search ends with the first kind that has connections.

    Args:
        atlas: atlas with the kinds.
        source: saddle that the connections leave.
        target: saddle that they join.
    """
    return [kind for kind in atlas.kinds if (kind.source, kind.target) == (source, target)][-1]


def connections_of(atlas: Atlas, kind: AtlasKind) -> tuple[AtlasConnection, ...]:
    """Return the connections of a kind, which are those with its numbers of crossings.

    Args:
        atlas: atlas with the kind.
        kind: kind of connection.
    """
    return tuple(connection for connection in atlas.between(kind.source, kind.target) if connection.hits == kind.hits)


def stable_direction(atlas: Atlas, cut: AtlasCut, direction: int) -> int:
    """Return the sign of a stable tube's crossing of the section, which follows from that of its unstable image.

    Args:
        atlas: atlas with the cut.
        cut: cut of the saddle's tubes.
        direction: sign of the unstable image's crossing.
    """
    normal = np.asarray(cut.section.normal)
    # Under time reversal a crossing changes sides unless the reverser also flips the section.
    return -direction * int(np.sign(normal @ atlas.reverser @ normal))


def colours(connections: tuple[AtlasConnection, ...]) -> dict[str, str]:
    """Return the colour of each connection by its name; mirror images, which differ in their sense only, share it."""
    by_name: dict[str, str] = {}
    shades: dict[tuple[float, float], str] = {}
    for connection in sorted(connections, key=lambda connection: -round(connection.transversality_angle, 3)):
        # Quantities that mirror images share, rounded as coarsely as in names.
        shared = (
            round(connection.transversality_angle, 3),
            round(connection.time_in + connection.time_out, 3),
        )
        by_name[connection.name] = shades.setdefault(shared, style.CONNECTIONS[len(shades) % len(style.CONNECTIONS)])
    return by_name


def placed(atlas: Atlas, orbit: AtlasOrbit, winding: Sequence[int] = ()) -> Array:
    """Return an orbit as a closed curve (M, N) of states, shifted by whole turns, to draw it where a connection ends.

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
    """Draw both tubes' cuts of a kind on its section and mark its connections, which are points of both cuts.

    A kind has the connections from one saddle's orbit to another's that meet a section after given numbers of
    crossings. A cut is the curve in which a tube meets the section.

    Args:
        axes: panel to draw on.
        atlas: atlas with the kind.
        kind: kind of connections.
        shown: marked connections, all by default.
        numbers: labels of the marks by the connections' names, none by default.
        legend: True adds a key.
        sense: sign of the drawn crossings of the section, or None for both, with backward crossings dashed.
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
    tints = colours(connections)
    for connection in connections:
        place = section_place(atlas, connection)
        axes.plot(*place, "o", color=tints[connection.name], markeredgecolor="white", markersize=7, zorder=4)
        if numbers and connection.name in numbers:
            name_point(axes, numbers[connection.name], (float(place[0]), float(place[1])), tints[connection.name])
    unit, momentum = (" (rad)", "p / p₀") if period else ("", "momentum")
    axes.set(title=title, xlabel=f"{coordinate} on the section{unit}", ylabel=momentum)
    if period:
        angle_axis(axes, "x")
    total = len(connections_of(atlas, kind))
    entry = f"{len(connections)} of {total} connections" if len(connections) < total else "connections"
    key(axes, [*_LINES, (entry, {"color": style.INK, "marker": "o", "linestyle": ""})] if legend else [])


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
    """Return a row of panels: the cuts of a kind, and the flight of each connection of `shown`.

    Above a flight are its label, the angle between both cuts at the connection, and the whole turns of each coordinate.

    Args:
        atlas: atlas with the kind.
        kind: kind of the connections.
        shown: connections with a panel each.
        numbers: labels by the connections' names, in the cuts and above the flights.
        marked: connections that are marked on the cuts; all by default.
    """
    tints = colours(connections_of(atlas, kind) if marked is None else marked)
    flights = []
    for connection in shown:
        turns = ", ".join(f"{turn:+d}" if turn else "0" for turn in connection.winding)
        title = f"{numbers[connection.name]}  {connection.transversality_angle:.1f}° [{turns}]"
        flights.append(
            partial(draw_motions, atlas=atlas, flights=[(connection, tints[connection.name])], saddles=(), title=title)
        )
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

    A flight is the trajectory of a connection. It starts at its source's named position. If flights end whole turns
    away, the target orbit is drawn there.

    Args:
        axes: panel in space or in the plane.
        atlas: atlas with the orbits.
        tubes: parts of tubes.
        flights: connections with their colours.
        saddles: saddles whose orbits are drawn at their named position in addition to those of flights, by default all.
        title: title of the panel.
    """
    space = axes.name == "3d"
    # In space: the first two coordinates and the first rate; in the plane: the coordinates.
    columns = [0, 1, len(atlas.periods) // 2][: 3 if space else 2]
    for tube in tubes:
        for states in tube.strands:
            axes.plot(*states[:, columns].T, color=tube.colour, linewidth=0.5, alpha=0.8)
        for states in tube.ends:
            axes.plot(*states[:, columns].T, color=style.CUT, linewidth=1.6, zorder=1.5)
    # Orbits at the ends of flights, each as its saddle and the whole turns by which it is shifted.
    ends = {end for c, _ in flights for end in ((c.source, ()), (c.target, c.winding if any(c.winding) else ()))}
    for c, colour in flights:
        axes.plot(*c.states[:, columns].T, color=colour, linewidth=1.1, zorder=8)
        if not space:
            axes.plot(*c.state[:2], "o", color=colour, markeredgecolor="white", markersize=6, zorder=9)
    look = {"linewidth": 2.5, "zorder": 10} if space else {"linewidth": 3.5, "alpha": 0.45, "zorder": 1}
    for orbit in atlas.orbits:
        # Flights end at orbits of a saddle's first family, number 0.
        windings = {winding for saddle, winding in ends if saddle == orbit.saddle and orbit.family == 0}
        for winding in windings | ({()} if saddles is None or orbit.saddle in saddles else set()):
            closed = placed(atlas, orbit, winding)
            axes.plot(*closed[:, columns].T, color=style.saddle_colour(orbit.saddle), **look)
    if space:
        quiet_space(axes, atlas, title)
    else:
        quiet_plane(axes, atlas, title=title)
        axes.set_aspect("equal", adjustable="datalim")
    if tubes:
        lines = [("tubes out", style.UNSTABLE), ("tubes in", style.STABLE), ("cuts", style.CUT)]
        key(axes, [*lines, *([("connections", style.INK)] if flights else [])])


def draw_atlas(atlas: Atlas) -> Figure:
    """Return the page of an atlas, which holds all that was computed at one energy.

    It shows the periodic orbits, their tubes and the flights along connections in space. For each kind of connection it
    shows the cuts of both tubes by the section.
    """
    kinds = [kind for kind in atlas.kinds if connections_of(atlas, kind)]
    counts = f"{counted(len(atlas.orbits), 'orbit')}, {counted(len(atlas.connections), 'connection')}"
    energy = f"{atlas.energy:g}{atlas.unit('J')}"
    page = Page(f"{atlas.title} at {energy}: {counts}")
    page.origin(atlas.file, f"model {atlas.model}", f"energy {energy}", PROGRAM if atlas.file else "")
    space = Panel(partial(_draw_whole, atlas=atlas), space=True)
    panels = [
        partial(draw_cuts, atlas=atlas, kind=k, title=f"{k.source} → {k.target}: {k.count} at hits {list(k.hits)}")
        for k in kinds
    ]
    # The first two panels of cuts stand beside the space, the others below it.
    page.row(space, *([Stack(panels[:2])] if panels else []), height=6.4 if len(panels) > 1 else 5.2)
    return page.grid(panels[2:], across=2, height=3.2).figure()


def _draw_whole(axes: Axes, atlas: Atlas) -> None:
    """Draw the panel of the whole atlas in space: all tubes, orbits and flights, with the names of the orbits."""
    tubes = [part for cut in atlas.cuts for part in tubes_of_cut(atlas, cut)]
    draw_motions(axes, atlas, tubes, flights=[(c, style.INK) for c in atlas.connections])
    for k, orbit in enumerate(atlas.orbits):
        look = {"fontsize": style.SMALL, "color": style.saddle_colour(orbit.saddle), "weight": "bold"}
        axes.text2D(0.0, 0.04 * k, f"orbit about {orbit.name}", transform=axes.transAxes, **look)  # type: ignore[attr-defined]
    axes.set_box_aspect(None, zoom=0.95)  # type: ignore[call-arg]


def atlas(axes: Axes, shown: Atlas) -> None:
    """Draw the cuts of the kind with most connections, the chart of an atlas that fits in one panel.

    Args:
        axes: panel to draw on.
        shown: atlas to draw.
    """
    if shown.kinds:
        draw_cuts(axes, shown, max(shown.kinds, key=lambda kind: kind.count), legend=False)


def write_atlas_recording(atlas: Atlas, path: Path) -> None:
    """Write an atlas as a recording for the Rerun viewer, with the layout (blueprint) in the same file.

    Args:
        atlas: atlas to write.
        path: file, `*.rrd`.

    Raises:
        InputError: the recording cannot be written.
    """
    first_rate = len(atlas.periods) // 2
    states = np.concatenate(
        [o.samples for o in atlas.orbits] + [c.strands.reshape(-1, len(atlas.periods)) for c in atlas.cuts]
    )
    # Fast passages close to a body would otherwise flatten the rest.
    low, high = np.quantile(states[:, [0, 1, first_rate]], [0.02, 0.98], axis=0)
    size, spans = float(max((high - low)[:2])), np.maximum(high - low, 1e-12)
    factor = size / float(spans[2])
    view = _blueprint(atlas, centre=(low + high) / 2 * [1, 1, factor], size=size)
    name = f"{atlas.model} at {atlas.energy:g}{atlas.unit('J')}"

    def places(states: Array) -> Array:
        """Return the drawn points (…, 3) of states (…, N): two coordinates, and the first rate times `factor`.

        The factor gives the rate the same range as the coordinates. `first_rate` is the column of the rate.
        """
        return states[..., [0, 1, first_rate]] * [1, 1, factor]

    with recording_to(path, name, view, atlas.status) as recording:
        for cut in atlas.cuts:
            for tube in tubes_of_cut(atlas, cut):
                stability, branch = "stable" if tube.stable else "unstable", "plus" if tube.branch > 0 else "minus"
                home = f"{_tube_path(cut)}/{stability}_{branch}"
                pale = [(*style.rgb(tube.colour), 110)]
                record_curves(recording, home, [*map(places, tube.strands)], [tube.colour], 0.4, colors=pale)
                record_curves(recording, f"{home}/cut", [*map(places, tube.ends)], [style.CUT], 0.8)
        for orbit in atlas.orbits:
            # A target orbit is recorded at its named position and wherever a connection reaches it, whole turns away.
            windings = {(0,) * first_rate} | {c.winding for c in atlas.connections if c.target == orbit.saddle}
            copies = [places(placed(atlas, orbit, winding)) for winding in sorted(windings)]
            # Copies of an orbit share its label, which is written once.
            labels = [orbit.name, *[""] * (len(copies) - 1)]
            home, colour = f"space/orbits/{_path(orbit.name)}", style.saddle_colour(orbit.saddle)
            record_curves(recording, home, copies, [colour], 2.5, labels=labels)
        for kind in atlas.kinds:
            _connections(recording, places, atlas, kind)


def _path(name: str) -> str:
    """Return a name as one part of a path in a recording, where only letters and digits are kept."""
    return "".join(letter if letter.isalnum() else "_" for letter in name)


def _tube_path(cut: AtlasCut) -> str:
    """Return the path of a cut's tubes in a recording, under which their strands and end curves are recorded."""
    return f"space/tubes/{_path(cut.saddle)}/hit_{cut.hit}_{_path(cut.section.name)}"


def _connections(
    recording: rr.RecordingStream, places: Callable[[Array], Array], atlas: Atlas, kind: AtlasKind
) -> None:
    """Record the flights of a kind, each under a path that contains its name.

    Args:
        recording: recording to extend.
        places: function from states (…, N) to drawn points (…, 3).
        atlas: atlas with the kind.
        kind: kind of connections.
    """
    home = f"space/connections/{_path(kind.source)}_to_{_path(kind.target)}_{kind.hits[0]}_{kind.hits[1]}"
    connections = connections_of(atlas, kind)
    tints = colours(connections)
    for k, connection in enumerate(connections):
        # The viewer shows the path under the pointer, which therefore contains the name.
        flight = f"{home}/{k + 1}_{_path(connection.name)}"
        label = {"labels": [connection.name], "show_labels": False}
        record_curves(recording, flight, [places(connection.states)], [tints[connection.name]], 0.9, **label)


def _blueprint(atlas: Atlas, *, centre: Array, size: float) -> rrb.Blueprint:
    """Return the layout, space with the summary beside it.

    At first only each saddle's tubes to one section are visible, because all together would hide everything.
    `centre` is the drawn point (3,) that the eye looks at from a distance of about twice `size`.
    """
    axes = ", ".join(atlas.labels[k].partition(" ")[0] for k in (0, 1, len(atlas.labels) // 2))
    eye = centre + np.array([-1.0, -1.4, 0.8]) * size
    # Cuts of connections from a saddle to itself, as saddle, section and number of the crossing.
    first_crossings = {(k.source, k.section, k.hits[0]) for k in atlas.kinds if k.source == k.target}
    hidden = [
        _tube_path(c)
        for c in atlas.cuts
        if first_crossings and (c.saddle, c.section.name, c.hit) not in first_crossings
    ]
    space = rrb.Spatial3DView(
        name=f"Space ({axes}): orbits thick, tubes from them red, to them green, where these end golden",
        origin="/space",
        eye_controls=rrb.EyeControls3D(position=tuple(eye), look_target=tuple(centre), eye_up=(0.0, 0.0, 1.0)),
        line_grid=False,
        background=DARK,
        overrides={path: rrb.EntityBehavior(visible=False) for path in hidden},
    )
    return page([space, summary_view()], [3, 1])
