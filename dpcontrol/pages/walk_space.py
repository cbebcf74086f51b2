"""A walk's orbit in space, coloured by time."""

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform

from dpcontrol.foundation.arrays import Array
from dpcontrol.pages import style
from dpcontrol.pages.panels import quiet_space, wrapped_runs
from dpcontrol.pages.walk_story import WalkStory

NAMED = 20
"""Greatest number of symbols with numbers in space."""
TIME = colormaps["viridis"]
_TOGETHER = 0.012
"""In units of the projection, whose page is about 0.2 wide."""
LIFTED_TURNS = 2.2
"""Most whole turns of an angle before the orbit in space is drawn modulo a turn."""


def is_lifted(story: WalkStory) -> bool:
    """True if the orbit in space counts whole turns.

    It does so as long as it does not span too many.
    """
    return bool(np.ptp(story.states[:, :2], axis=0).max() <= LIFTED_TURNS * 2 * np.pi) or not story.has_angles


def space(axes: Axes, story: WalkStory) -> None:
    """Draw the orbit in space, coloured by time, over periodic orbits.

    Space is (first coordinate, second, first rate).

    Args:
        axes: panel in space.
        story: walk to draw.
    """
    rate = story.states.shape[1] // 2
    picked = [0, 1, rate]
    lifted = is_lifted(story)
    for copy, saddle in _base_orbits(story, lifted):
        axes.plot(*copy[:, picked].T, color=style.saddle_colour(saddle), linewidth=4.0, alpha=0.4)
    curve = np.column_stack([story.states[:, picked], story.times])
    start = np.append(_window(story, lifted)[picked], 0.0)
    lengths = _lengths(story)[picked]
    runs = [curve] if lifted else [run + start for run in wrapped_runs(curve - start, (*lengths, None))]
    for run in runs:
        colours = TIME(run[:-1, 3] / story.orbit.duration)
        axes.add_collection3d(Line3DCollection(connected_pieces(run[:, :3]), colors=colours, linewidths=1.1))  # type: ignore[attr-defined]
    axes.auto_scale_xyz(*np.vstack([run[:, :3] for run in runs]).T)  # type: ignore[attr-defined]
    points = story.crossings[:, picked]
    if not lifted:
        points = points - np.rint((points - start[:3]) / np.where(lengths, lengths, np.inf)) * lengths
    for point, time in zip(points, story.orbit.symbol_times, strict=True):
        axes.plot(*point[:, None], "o", color=TIME(time / story.orbit.duration), markersize=5, markeredgecolor="white")
    quiet_space(axes, story.orbit.system)
    axes.set_box_aspect((1, 1, 0.85), zoom=1.06)  # type: ignore[attr-defined]
    if len(points) <= NAMED:
        # Points that are near each other on the page share a label.
        seen = np.column_stack(proj_transform(*points.T, axes.get_proj())[:2])  # type: ignore[attr-defined]
        for members in _together(seen):
            text = ", ".join(str(k + 1) for k in members)
            axes.text(*points[members[0]], f"  {text}", fontsize=style.SMALL, weight="bold", color=style.INK, zorder=9)  # type: ignore[call-arg]
    if not story.has_angles:
        axes.locator_params(nbins=4)
    how = ", angles with whole turns counted" if lifted else ", angles modulo 2π"
    how = how if story.has_angles else " and its first rate"
    axes.set_title(f"The orbit{how}; dark to light: time", loc="left")


def connected_pieces(points: Array) -> list[Array]:
    """Return the segments (2, D) between points (K, D), for separate colours."""
    return list(np.stack([points[:-1], points[1:]], axis=1))


def _lengths(story: WalkStory) -> Array:
    """Return the period (N,) of each coordinate.

    The period is zero for those that are not angles.
    """
    periods = story.orbit.connections[0].source.system.periods
    return np.where(np.isfinite(periods), periods, 0.0)


def _window(story: WalkStory, lifted: bool) -> Array:
    """Return the middle (N,) of the drawn period.

    Its bounds intersect no periodic orbit.
    """
    middle = np.zeros(story.states.shape[1])
    samples = np.vstack([curve.samples for curve in story.curves.values()])
    for k, period in enumerate(_lengths(story)):
        if not period or lifted:
            continue
        taken = np.sort(samples[:, k] % period)
        gaps = np.diff(taken, append=taken[0] + period)
        widest = int(np.argmax(gaps))
        # Off the gap's middle: sections lie there, and rounding would decide the side of a symbol.
        bound = taken[widest] + 0.35 * gaps[widest]
        middle[k] = (bound - period / 4) % period - period / 4
    return middle


def _together(points: Array) -> list[list[int]]:
    """Return indices of points (k, 2) in groups that share a label.

    Points of a group are within a small distance on the page.
    """
    groups: list[list[int]] = []
    for k, point in enumerate(points):
        near = (g for g in groups if np.abs(points[g[0]] - point).max() < _TOGETHER)
        group = next(near, None)
        if group is None:
            groups.append(group := [])
        group.append(k)
    return groups


def _base_orbits(story: WalkStory, lifted: bool) -> list[tuple[Array, str]]:
    """Return each periodic orbit as a closed curve (M, N).

    Curves are at the lattice points of the walk.
    """
    chain, offsets = story.orbit.connections, story.orbit.offsets
    closed = {name: np.vstack([curve.samples, curve.samples[:1]]) for name, curve in story.curves.items()}
    if not lifted:
        middle, lengths = _window(story, lifted), tuple(_lengths(story))
        return [(run + middle, name) for name, curve in closed.items() for run in wrapped_runs(curve - middle, lengths)]
    turn = chain[0].source.system.turn_lengths
    names = [chain[0].source.saddle, *(c.target.saddle for c in chain)]
    places = {(name, tuple(offset)): closed[name] + offset * turn for name, offset in zip(names, offsets, strict=True)}
    return [(curve, name) for (name, _), curve in places.items()]
