"""A walk's orbit on one page.

It shows symbols over time, the arms as a filmstrip, and the orbit in space and in the plane.
"""

from functools import partial

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.run_view import RunView
from dpcontrol.pages import style
from dpcontrol.pages.chart import Chart
from dpcontrol.pages.charts import draw_chart
from dpcontrol.pages.filmstrip import add_film, film_times
from dpcontrol.pages.layout import Page, Panel, Stack
from dpcontrol.pages.panels import badge, mark_times, quiet, quiet_space
from dpcontrol.pages.run_charts import charts
from dpcontrol.pages.story import story as draw_story
from dpcontrol.pages.story import story_height
from dpcontrol.pages.walk_story import WalkStory, symbol_text
from dpcontrol.walks.shadowing import ShadowingOrbit

TIME = colormaps["viridis"]
_DOTS = 15_000
"""Number of dots of an orbit whose colour is the time."""


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
    times = np.linspace(0.0, story.orbit.duration, _DOTS)
    axes.scatter(*story.orbit.states(times)[:, :2].T, c=times, cmap=TIME, s=1.5, zorder=3, rasterized=True)
    for k, state in enumerate(story.crossings):
        badge(axes, k + 1, float(state[0]), float(state[1]))
    axes.set_aspect("equal", adjustable="datalim")
    x, y, *_ = story.orbit.system.labels
    quiet(axes, "The orbit in the plane; dark to light: time", x=x, y=y)


_LISTED = 16
"""Most symbols in the list; beyond that the numbers over time must do."""
_FRAMES = 12


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
        add_film(page, view, film_times(view, frames=_FRAMES))
    shown = [*([charts(view)["angles"]] if walk.has_angles else []), walk.nearness()]
    panels = [partial(_chart, chart=chart, view=view, orbit=orbit) for chart in shown]
    shape = partial(space, story=walk) if walk.has_angles else partial(plane, story=walk)
    page.row(Stack(panels), Panel(shape, 0.75, space=walk.has_angles), height=4.4)
    heading = ("", "symbol", f"at{orbit.system.unit('s', ' ({})')}", "connection")
    return page.table(_list(walk, view), heading=heading).figure()


def _chart(axes: Axes, chart: Chart, view: RunView, orbit: ShadowingOrbit) -> None:
    draw_chart(axes, chart, view)
    axes.set_xlim(0.0, orbit.duration)
    mark_times(axes, list(orbit.symbol_times))


def _list(walk: WalkStory, view: RunView) -> list[tuple[str, ...]]:
    """Return each symbol's number, description and time, and its connection's name."""
    chain = walk.orbit.connections
    rows = [
        (str(k + 1), symbol_text(connection), f"{at:.3f}", connection.name)
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
    times = np.linspace(0.0, story.orbit.duration, _DOTS)
    axes.scatter(*story.orbit.states(times)[:, picked].T, c=times, cmap=TIME, s=1.0, rasterized=True)
    for point, time in zip(story.crossings[:, picked], story.orbit.symbol_times, strict=True):
        axes.plot(*point[:, None], "o", color=TIME(time / story.orbit.duration), markersize=5, markeredgecolor="white")
    quiet_space(axes, story.orbit.system)
    axes.set_box_aspect((1, 1, 0.85), zoom=1.06)  # type: ignore[attr-defined]
    axes.set_title("The orbit, angles with whole turns counted; dark to light: time", loc="left")


def _base_orbits(story: WalkStory) -> list[tuple[Array, str]]:
    """Return each periodic orbit as a closed curve (M, N) at the lattice points of the walk."""
    chain, offsets = story.orbit.connections, story.orbit.offsets
    closed = {name: np.vstack([curve.samples, curve.samples[:1]]) for name, curve in story.curves.items()}
    turn = chain[0].source.system.turn_lengths
    names = [chain[0].source.saddle, *(c.target.saddle for c in chain)]
    places = {(name, tuple(offset)): closed[name] + offset * turn for name, offset in zip(names, offsets, strict=True)}
    return [(curve, name) for (name, _), curve in places.items()]
