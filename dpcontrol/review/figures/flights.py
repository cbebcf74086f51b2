"""Flights of connections: in the plane of the two coordinates, beside the cuts where they meet, and against time."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from numpy.typing import NDArray

from dpcontrol.review import style
from dpcontrol.review.figures.cuts import colours, connections_of, draw_cuts
from dpcontrol.review.panel_frame import angle_axis, quiet
from dpcontrol.walks.atlas import Atlas, AtlasConnection, AtlasKind

Array = NDArray[np.float64]


def draw_row(
    figure: Figure,
    cell: SubplotSpec,
    atlas: Atlas,
    kind: AtlasKind,
    shown: Sequence[AtlasConnection],
    *,
    numbers: dict[str, str],
    marked: tuple[AtlasConnection, ...] | None = None,
    flat: bool = False,
    share: float = 1.65,
) -> list[Axes]:
    """Draw a kind's cuts left and the flights of `shown` right, each under its number; return the flights' axes.

    numbers: by connection's name. marked: on the cuts, all connections if not given. flat: flights one below the other.
    share: width of the flights over that of the cuts.
    """
    left, right = cell.subgridspec(1, 2, wspace=0.1, width_ratios=[1, share])
    draw_cuts(figure.add_subplot(left), atlas, kind, shown=marked, numbers=numbers)
    count = max(len(shown), 1)
    flights = right.subgridspec(*((count, 1) if flat else (1, count)), wspace=0.27, hspace=0.75)
    look = colours(connections_of(atlas, kind) if marked is None else marked)
    drawn = []
    for k, c in enumerate(shown):
        axes = figure.add_subplot(flights[k, 0] if flat else flights[0, k])
        draw_flight(axes, atlas, c, look[c.name], labelled=k == 0 or flat)
        turns = ", ".join(f"{turn:+d}" if turn else "0" for turn in c.winding)
        title = f"{numbers[c.name]}  {c.transversality_angle:.1f}°, winding [{turns}]"
        axes.set_title(title, fontsize=9 if count < 5 else 7.5, loc="left", color=look[c.name])
        drawn.append(axes)
    return drawn


def draw_flight(axes: Axes, atlas: Atlas, connection: AtlasConnection, colour: str, *, labelled: bool = True) -> None:
    """Draw a flight in the plane of the first two coordinates, from its source's named place, with both orbits."""
    n = len(atlas.periods) // 2
    lift = atlas.turn_lengths
    turns = np.concatenate([np.asarray(connection.winding, dtype=float), np.zeros(n)])
    for saddle, offset in ((connection.source, 0 * turns), (connection.target, turns)):
        orbit = next(o for o in atlas.orbits if o.saddle == saddle)
        closed = np.vstack([orbit.samples, orbit.samples[:1]]) + offset * lift
        axes.plot(closed[:, 0], closed[:, 1], color=style.saddle_colour(saddle), linewidth=3.5, alpha=0.45, zorder=1)
        centre = next(p.state for p in atlas.points if p.name == saddle) + offset * lift
        axes.plot(centre[0], centre[1], "+", color=style.INK, markersize=7, zorder=1)
    axes.plot(connection.states[:, 0], connection.states[:, 1], color=colour, linewidth=1.3, zorder=3)
    axes.plot(*connection.state[:2], "o", color=colour, markeredgecolor="white", markersize=6, zorder=4)
    quiet(axes)
    if np.isfinite(atlas.periods).any():
        angle_axis(axes, "x", step=1.0)
        angle_axis(axes, "y", step=1.0)
        axes.set_xlabel("θ₁", fontsize=9, labelpad=1)
        if labelled:
            axes.set_ylabel("θ₂", fontsize=9, labelpad=1)
    # Turns of the inner arm alone are wide and flat: their panels shrink to them.
    flat = connection.source == connection.target and not connection.winding[-1]
    axes.set_aspect("equal", adjustable="box" if flat else "datalim", anchor="W")


def draw_angles(axes: Axes, atlas: Atlas, connection: AtlasConnection) -> None:
    """Draw both angles against the time from the section."""
    for arm in range(len(atlas.periods) // 2):
        axes.plot(connection.times, connection.states[:, arm], color=style.arm_colour(arm), linewidth=1.3)
    for time in (-connection.time_out, connection.time_in):
        if np.isfinite(time):
            axes.axvline(time, color=style.REFERENCE, linewidth=0.9, linestyle=(0, (2, 2)))
    quiet(axes)
    axes.margins(x=0)
    angle_axis(axes, "y", step=1.0)
