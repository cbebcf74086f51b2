"""Connections in space and over time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.pages import style
from dpcontrol.pages.atlas_cuts import draw_cuts
from dpcontrol.pages.atlas_parts import colours, connections_of, placed, tubes_of_cut
from dpcontrol.pages.layout import Panel, Stack, key
from dpcontrol.pages.panels import angle_axis, quiet, quiet_space
from dpcontrol.walks.atlas import Atlas, AtlasConnection, AtlasCut, AtlasKind


def row_of(
    atlas: Atlas,
    kind: AtlasKind,
    shown: Sequence[AtlasConnection],
    *,
    numbers: dict[str, str],
    marked: tuple[AtlasConnection, ...] | None = None,
    flat: bool = False,
    share: float = 1.65,
) -> list[Panel | Stack]:
    """Return a row of panels: cuts and flights.

    The cuts are those of a kind; the flights of `shown` have their numbers.

    Args:
        atlas: with the kind.
        kind: of the connections.
        shown: connections with a panel each.
        numbers: labels by connection name.
        marked: connections on the cuts; all by default.
        flat: True to stack the flights.
        share: width of the flights relative to the cuts.
    """
    look = colours(connections_of(atlas, kind) if marked is None else marked)

    def flight(axes: Axes, connection: AtlasConnection, labelled: bool) -> None:
        draw_flight(axes, atlas, connection, look[connection.name], labelled=labelled)
        turns = ", ".join(f"{turn:+d}" if turn else "0" for turn in connection.winding)
        axes.set_title(f"{numbers[connection.name]}  {connection.transversality_angle:.1f}° [{turns}]", loc="left")

    cuts = Panel(partial(draw_cuts, atlas=atlas, kind=kind, shown=marked, numbers=numbers), 1.0)
    flights = [partial(flight, connection=c, labelled=k == 0 or flat) for k, c in enumerate(shown)]
    if flat:
        return [cuts, Stack(flights, share)]
    return [cuts, *(Panel(draw, share / max(len(flights), 1)) for draw in flights)]


def draw_flight(axes: Axes, atlas: Atlas, connection: AtlasConnection, colour: str, *, labelled: bool = True) -> None:
    """Draw a flight with both orbits in the plane of coordinates.

    It starts at its source's named position.

    Args:
        axes: panel to draw on.
        atlas: atlas with the connection.
        connection: connection to draw.
        colour: colour of the flight.
        labelled: True to label the vertical axis.
    """
    for saddle, winding in ((connection.source, ()), (connection.target, connection.winding)):
        orbit = next(o for o in atlas.orbits if o.saddle == saddle)
        closed = placed(atlas, orbit, winding)
        axes.plot(closed[:, 0], closed[:, 1], color=style.saddle_colour(saddle), linewidth=3.5, alpha=0.45, zorder=1)
        centre = next(p.state for p in atlas.points if p.name == saddle) + closed[0] - orbit.samples[0]
        axes.plot(centre[0], centre[1], "+", color=style.INK, markersize=7, zorder=1)
    axes.plot(connection.states[:, 0], connection.states[:, 1], color=colour, linewidth=1.3, zorder=3)
    axes.plot(*connection.state[:2], "o", color=colour, markeredgecolor="white", markersize=6, zorder=4)
    quiet(axes)
    x, y = (label.partition(" ")[0] for label in atlas.labels[:2])
    axes.set_xlabel(x, fontsize=style.SMALL)
    axes.set_ylabel(y if labelled else "", fontsize=style.SMALL)
    for which, period in zip("xy", atlas.periods, strict=False):
        if np.isfinite(period):
            angle_axis(axes, which, step=1.0)
    # Turns of the inner arm alone are wide and flat, so their panels are lower.
    flat = connection.source == connection.target and not connection.winding[-1]
    axes.set_aspect("equal", adjustable="box" if flat else "datalim", anchor="W")


def draw_angles(axes: Axes, atlas: Atlas, connection: AtlasConnection, *, title: str) -> None:
    """Draw both angles over time, with the section crossing at zero.

    Args:
        axes: panel to draw on.
        atlas: atlas with the connection.
        connection: connection to draw.
        title: title of the panel.
    """
    for arm in range(len(atlas.periods) // 2):
        axes.plot(connection.times, connection.states[:, arm], color=style.arm_colour(arm), linewidth=1.3)
    for time in (-connection.time_out, connection.time_in):
        if np.isfinite(time):
            axes.axvline(time, color=style.REFERENCE, linewidth=0.9, linestyle=style.DOTTED)
    quiet(axes, title)
    axes.margins(x=0)
    angle_axis(axes, "y", step=1.0)


def draw_space(
    axes: Axes,
    atlas: Atlas,
    cuts: Iterable[AtlasCut],
    *,
    one_colour: str | None = None,
    flights: Sequence[tuple[AtlasConnection, str]] = (),
    steps: tuple[float, float] = (1.0, 1.0),
    sense: int | None = None,
    saddles: tuple[str, ...] | None = None,
) -> None:
    """Draw the tubes of cuts, all orbits, and flights in space.

    Ticks of x and y are `steps` half turns apart. Orbits have `one_colour`, by default their saddle's. `sense` selects
    branches by the sense of their final crossings; None draws both. `saddles` selects orbits; None draws all.

    Flights start at their source's named position. If they end whole turns away, the target orbit is drawn there.

    Args:
        axes: panel in space.
        atlas: with the orbits.
        cuts: of tubes.
        one_colour: of all orbits.
        flights: connections with their colours.
        steps: half turns.
        sense: 1, -1 or None.
        saddles: of the orbits.
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
        colour = one_colour or style.saddle_colour(orbit.saddle)
        axes.plot(*placed(atlas, orbit)[:, picked].T, color=colour, linewidth=2.5, zorder=10)
        for winding in (w for saddle, w in ends if saddle == orbit.saddle and orbit.family == 0):
            axes.plot(*placed(atlas, orbit, winding)[:, picked].T, color=colour, linewidth=1.6, alpha=0.6, zorder=9)
    quiet_space(axes, atlas, steps=steps)


def space_panel(
    title: str, entries: Iterable[tuple[str, str | dict[str, Any]]], *, share: float = 1.0, **drawn: Any
) -> Panel:
    """Return a panel in space with a title and a key.

    Args:
        title: title of the panel.
        entries: entries of the key.
        share: width of the panel in its row.
        **drawn: arguments of `draw_space`.
    """

    def draw(axes: Axes) -> None:
        draw_space(axes, **drawn)
        axes.set_title(title, loc="left")
        key(axes, entries)

    return Panel(draw, share, space=True)
