"""A walk's orbit on one page.

It shows symbols over time, the arms as a filmstrip, and the orbit in space and in the plane.
"""

from functools import partial

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.run_view import RunView
from dpcontrol.pages import style
from dpcontrol.pages.chart import Chart
from dpcontrol.pages.charts import draw_chart
from dpcontrol.pages.filmstrip import draw_film, film_height, frame_position
from dpcontrol.pages.layout import Page, Panel, Stack
from dpcontrol.pages.panels import badge, bare, mark_times, quiet, quiet_space
from dpcontrol.pages.story import story as draw_story
from dpcontrol.pages.story import story_height
from dpcontrol.pages.walk_story import WalkStory, symbol_words
from dpcontrol.walks.shadowing import ShadowingOrbit

NAMED = 20
"""Greatest number of symbols with numbers in space."""
TIME = colormaps["viridis"]
_TOGETHER = 0.015
"""In units of the projection, whose page is about 0.2 wide."""


def plane(axes: Axes, story: WalkStory) -> None:
    """Draw the orbit in the plane of positions, coloured by time.

    This is for a system without arms.

    Args:
        axes: panel to draw on.
        story: walk to draw.
    """
    for saddle, curve in story.curves.items():
        closed = np.vstack([curve.samples, curve.samples[:1]])
        axes.plot(closed[:, 0], closed[:, 1], color=style.saddle_colour(saddle), linewidth=4.0, alpha=0.4)
        centre = curve.orbit.centre
        axes.plot(*centre[:2], "+", color=style.INK, markersize=8)
        axes.annotate(f" {saddle}", (float(centre[0]), float(centre[1])), fontsize=style.SMALL, color=style.INK)
    colours = TIME(story.times[:-1] / story.orbit.duration)
    axes.add_collection(LineCollection(connected_pieces(story.states[:, :2]), colors=colours, linewidths=1.2, zorder=3))
    axes.autoscale_view()
    for k, state in enumerate(story.crossings):
        badge(axes, k + 1, float(state[0]), float(state[1]))
    axes.set_aspect("equal", adjustable="datalim")
    x, y, *_ = story.orbit.system.labels
    quiet(axes, "The orbit in the plane; dark to light: time", x=x, y=y)


_LISTED = 16
"""Most symbols in the list; beyond that the numbers over time must do."""
FILM_SYMBOLS = 48


def draw_walk(orbit: ShadowingOrbit, *, arm_lengths: tuple[float, ...] | None, model: str) -> Figure:
    """Return the page of a walk as a figure.

    Args:
        orbit: orbit of the walk.
        arm_lengths: (n,) m; None for a system without arms and film.
        model: name of the model.
    """
    walk = WalkStory(orbit, arm_lengths)
    view = walk.view(model)
    page = Page(view.title, view.verdict)
    page.row(partial(draw_story, view=view), height=story_height(view))
    if arm_lengths is not None:
        _add_film(page, walk, view)
    charts = [partial(_chart, chart=chart, view=view, orbit=orbit) for chart in (walk.coordinates(), walk.nearness())]
    plain = [] if walk.arm_lengths is not None else [Panel(partial(plane, story=walk), share=2.6)]
    shown = Stack([Panel(partial(space, story=walk), share=3.9, space=True), *plain], share=0.75)
    page.row(Stack(charts), shown, height=4.4 + 2.6 * len(plain))
    heading = ("", "symbol", f"at{orbit.system.unit('s', ' ({})')}", "connection")
    return page.table(_list(walk, view), heading=heading).figure()


def _film(axes: Axes, view: RunView, first: int, times: NDArray[np.float64]) -> None:
    draw_film(axes, view, times.ravel())
    reach = sum(view.arm_lengths)
    for k in range(len(times)):
        badge(axes, first + k + 1, frame_position(view, k * times.shape[1]) - 0.6 * reach, axes.get_ylim()[1])


def _chart(axes: Axes, chart: Chart, view: RunView, orbit: ShadowingOrbit) -> None:
    draw_chart(axes, chart, view)
    axes.set_xlim(0.0, orbit.duration)
    mark_times(axes, list(orbit.symbol_times))


def _add_film(page: Page, walk: WalkStory, view: RunView) -> None:
    """Add rows of a film, with some poses about each symbol's crossing."""
    orbit, count = walk.orbit, min(len(walk.orbit.symbol_times), FILM_SYMBOLS)
    poses = 9 if count == 1 else 7 if count == 2 else 5 if count <= 6 else 3 if count <= 16 else 1
    across = int(np.ceil(count / np.ceil(count * poses / 18)))
    share = np.linspace(-0.55, 0.55, poses) if poses > 1 else np.zeros(1)
    spans = np.array([[c.time_in if s > 0 else c.time_out for s in share] for c in orbit.connections])
    every = (orbit.symbol_times[:, None] + share * spans)[:count]
    for first in range(0, count, across):
        times = every[first : first + across]
        film = Panel(partial(_film, view=view, first=first, times=times), len(times))
        # A last row with fewer symbols is shorter in proportion.
        rest = [Panel(bare, across - len(times))] if len(times) < across else []
        height = film_height(view, times.ravel(), width=style.WIDTH * len(times) / across)
        page.row(film, *rest, height=height + 0.15)


def _list(walk: WalkStory, view: RunView) -> list[tuple[str, ...]]:
    """Return each symbol's number, description and time, and its connection's name."""
    chain = walk.orbit.connections
    rows = [
        (str(k + 1), symbol_words(connection), f"{at:.3f}", connection.name)
        for k, (connection, (_, at, _)) in enumerate(zip(chain, view.symbols, strict=True))
    ]
    if len(rows) > _LISTED:
        rows = [*rows[: _LISTED - 1], ("", f"… and {len(rows) - _LISTED + 1} more", "", "")]
    return rows


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
