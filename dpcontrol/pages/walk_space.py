"""A walk's orbit in space, coloured by time."""

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform

from dpcontrol.foundation.arrays import Array
from dpcontrol.pages import style
from dpcontrol.pages.panels import quiet_space
from dpcontrol.pages.walk_story import WalkStory

NAMED = 20
"""Greatest number of symbols with numbers in space."""
TIME = colormaps["viridis"]
_TOGETHER = 0.015
"""In units of the projection, whose page is about 0.2 wide."""


def space(axes: Axes, story: WalkStory) -> None:
    """Draw the orbit in space, coloured by time, over periodic orbits.

    Space is (first coordinate, second, first rate), with whole turns counted.

    Args:
        axes: panel in space.
        story: walk to draw.
    """
    picked = [0, 1, story.states.shape[1] // 2]
    for copy, saddle in _base_orbits(story):
        axes.plot(*copy[:, picked].T, color=style.saddle_colour(saddle), linewidth=4.0, alpha=0.4)
    path = story.states[:, picked]
    colours = TIME(story.times[:-1] / story.orbit.duration)
    axes.add_collection3d(Line3DCollection(connected_pieces(path), colors=colours, linewidths=1.1))  # type: ignore[attr-defined]
    axes.auto_scale_xyz(*path.T)  # type: ignore[attr-defined]
    points = story.crossings[:, picked]
    for point, time in zip(points, story.orbit.symbol_times, strict=True):
        axes.plot(*point[:, None], "o", color=TIME(time / story.orbit.duration), markersize=5, markeredgecolor="white")
    quiet_space(axes, story.orbit.system, steps=(None, None))
    axes.set_box_aspect((1, 1, 0.85), zoom=1.06)  # type: ignore[attr-defined]
    if len(points) <= NAMED:
        # Points that are near each other on the page share a label.
        seen = np.column_stack(proj_transform(*points.T, axes.get_proj())[:2])  # type: ignore[attr-defined]
        groups: dict[tuple[float, ...], list[int]] = {}
        for k, place in enumerate(np.rint(seen / _TOGETHER)):
            groups.setdefault(tuple(place), []).append(k)
        for members in groups.values():
            text = ", ".join(str(k + 1) for k in members)
            axes.text(*points[members[0]], f"  {text}", fontsize=style.SMALL, weight="bold", color=style.INK, zorder=9)  # type: ignore[call-arg]
    if not story.has_angles:
        axes.locator_params(nbins=4)
    how = ", angles with whole turns counted" if story.has_angles else " and its first rate"
    axes.set_title(f"The orbit{how}; dark to light: time", loc="left")


def connected_pieces(points: Array) -> list[Array]:
    """Return the segments (2, D) between points (K, D), for separate colours."""
    return list(np.stack([points[:-1], points[1:]], axis=1))


def _base_orbits(story: WalkStory) -> list[tuple[Array, str]]:
    """Return each periodic orbit as a closed curve (M, N) at the lattice points of the walk."""
    chain, offsets = story.orbit.connections, story.orbit.offsets
    closed = {name: np.vstack([curve.samples, curve.samples[:1]]) for name, curve in story.curves.items()}
    turn = chain[0].source.system.turn_lengths
    names = [chain[0].source.saddle, *(c.target.saddle for c in chain)]
    places = {(name, tuple(offset)): closed[name] + offset * turn for name, offset in zip(names, offsets, strict=True)}
    return [(curve, name) for (name, _), curve in places.items()]
