"""The orbit of a walk in space and in the plane, coloured by time, over the periodic orbits that it wobbles about."""

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from numpy.typing import NDArray

from dpcontrol.review import style
from dpcontrol.review.panel_frame import angle_axis, badge, quiet, wrapped_runs
from dpcontrol.review.walk_story import WalkStory

Array = NDArray[np.float64]

NAMED = 20
"""Symbols that have room for a number in space."""
TIME = colormaps["viridis"]
_TOGETHER = 0.05
LIFTED_TURNS = 2.2
"""Whole turns that an angle may cover before the orbit in space is drawn modulo a turn."""


def is_lifted(story: WalkStory) -> bool:
    """Whether the orbit in space counts whole turns: while it does not run off over many of them."""
    return bool(np.ptp(story.states[:, :2], axis=0).max() <= LIFTED_TURNS * 2 * np.pi) or not story.has_angles


def space(axes: Axes, story: WalkStory) -> None:
    """Draw the orbit in (first coordinate, second, first rate), coloured by time, over the periodic orbits."""
    rate = story.states.shape[1] // 2
    picked = [0, 1, rate]
    lifted = is_lifted(story)
    for copy, saddle in _base_orbits(story, lifted):
        axes.plot(*copy[:, picked].T, color=style.saddle_colour(saddle), linewidth=4.0, alpha=0.4)
    curve = np.column_stack([story.states[:, picked], story.times])
    start = np.append(_window(story, lifted)[picked], 0.0)
    periods = (*(_periods(story)[k] for k in picked), None)
    runs = [curve] if lifted else [run + start for run in wrapped_runs(curve - start, periods)]
    for run in runs:
        pieces = np.stack([run[:-1, :3], run[1:, :3]], axis=1)
        share = run[:-1, 3] / story.orbit.duration
        axes.add_collection3d(Line3DCollection(list(pieces), colors=TIME(share), linewidths=1.1))  # type: ignore[attr-defined]
    axes.auto_scale_xyz(*np.vstack([run[:, :3] for run in runs]).T)  # type: ignore[attr-defined]
    points = story.crossings[:, picked]
    if not lifted:
        turns = np.array([p or np.inf for p in periods[:3]])
        points = points - np.rint((points - start[:3]) / turns) * np.where(np.isfinite(turns), turns, 0.0)
    for point, time in zip(points, story.orbit.symbol_times, strict=True):
        axes.plot(*point[:, None], "o", color=TIME(time / story.orbit.duration), markersize=5, markeredgecolor="white")
    if len(points) <= NAMED:
        for members in _together(points):
            text = ", ".join(str(k + 1) for k in members)
            axes.text(*points[members[0]], f"  {text}", fontsize=8.5, weight="bold", color=style.INK, zorder=9)  # type: ignore[call-arg]
    labels = ("θ₁ (rad)", "θ₂ (rad)", "ω₁ (rad/s)") if story.has_angles else ("x", "y", "x rate")
    for which, label in zip("xyz", labels, strict=True):
        getattr(axes, f"set_{which}label")(label, fontsize=9)
        if which != "z" and story.has_angles:
            angle_axis(axes, which, step=1.0)
    axes.view_init(elev=22, azim=-122)  # type: ignore[attr-defined]
    axes.set_box_aspect((1, 1, 0.85), zoom=1.06)  # type: ignore[attr-defined]
    axes.tick_params(labelsize=8, colors=style.CART)
    if not story.has_angles:
        axes.locator_params(nbins=4)
    how = ", angles with whole turns counted" if lifted else ", angles modulo 2π"
    how = how if story.has_angles else " and its first rate"
    axes.set_title(f"The orbit{how}; dark to light: time", loc="left", fontsize=10, color=style.INK, y=1.0)


def _periods(story: WalkStory) -> tuple[float | None, ...]:
    """Return the period of each coordinate, None where it is no angle."""
    return tuple(float(p) if np.isfinite(p) else None for p in story.orbit.connections[0].source.system.periods)


def _window(story: WalkStory, lifted: bool) -> Array:
    """Return the middle (N,) of the period that is drawn: bounds lie where no periodic orbit is cut by them."""
    middle = np.zeros(story.states.shape[1])
    samples = np.vstack([curve.samples for curve in story.curves.values()])
    for k, period in enumerate(_periods(story)):
        if period is None or lifted:
            continue
        taken = np.sort(samples[:, k] % period)
        gaps = np.diff(taken, append=taken[0] + period)
        widest = int(np.argmax(gaps))
        # Off the gap's middle, where sections lie and rounding would tell on which side a symbol is drawn.
        bound = taken[widest] + 0.35 * gaps[widest]
        middle[k] = (bound - period / 4) % period - period / 4
    return middle


def _together(points: Array) -> list[list[int]]:
    """Return indices of points (k, 3) in groups that one label serves: nearer than a small part of what all span."""
    span = np.maximum(np.ptp(points, axis=0), 1.0)
    groups: list[list[int]] = []
    for k, point in enumerate(points):
        near = [g for g in groups if np.abs((points[g[0]] - point) / span).max() < _TOGETHER]
        if near:
            near[0].append(k)
        else:
            groups.append([k])
    return groups


def _base_orbits(story: WalkStory, lifted: bool) -> list[tuple[Array, str]]:
    """Return each periodic orbit as a closed curve (M, N) at the lattice points that the walk visits."""
    chain, offsets = story.orbit.connections, story.orbit.offsets
    closed = {name: np.vstack([curve.samples, curve.samples[:1]]) for name, curve in story.curves.items()}
    if not lifted:
        middle, periods = _window(story, lifted), _periods(story)
        return [(run + middle, name) for name, curve in closed.items() for run in wrapped_runs(curve - middle, periods)]
    turn = chain[0].source.system.turn_lengths
    names = [chain[0].source.saddle, *(c.target.saddle for c in chain)]
    places = {(name, tuple(offset)): closed[name] + offset * turn for name, offset in zip(names, offsets, strict=True)}
    return [(curve, name) for (name, _), curve in places.items()]


def plane(axes: Axes, story: WalkStory) -> None:
    """Draw the orbit in the plane of positions, coloured by time, for a system without arms."""
    for saddle, curve in story.curves.items():
        closed = np.vstack([curve.samples, curve.samples[:1]])
        axes.plot(closed[:, 0], closed[:, 1], color=style.saddle_colour(saddle), linewidth=4.0, alpha=0.4)
        centre = curve.orbit.centre
        axes.plot(*centre[:2], "+", color=style.INK, markersize=8)
        axes.annotate(f" {saddle}", (float(centre[0]), float(centre[1])), fontsize=9, color=style.INK)
    pieces = np.stack([story.states[:-1, :2], story.states[1:, :2]], axis=1)
    colours = TIME(story.times[:-1] / story.orbit.duration)
    axes.add_collection(LineCollection(list(pieces), colors=colours, linewidths=1.2, zorder=3))
    axes.autoscale_view()
    for k, state in enumerate(story.crossings):
        badge(axes, k + 1, float(state[0]), float(state[1]))
    axes.set_aspect("equal", adjustable="datalim")
    quiet(axes, "The orbit in the plane; dark to light: time")
    axes.set_xlabel("x", fontsize=9)
    axes.set_ylabel("y", fontsize=9)
