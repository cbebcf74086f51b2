"""A connection's flight: in the plane of the two coordinates, with its orbits, and its angles against time."""

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from dpcontrol.review import style
from dpcontrol.review.panel_frame import angle_axis, quiet
from dpcontrol.walks.atlas import Atlas, AtlasConnection

Array = NDArray[np.float64]


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
