"""An orbit that follows a walk, sampled once for drawing, and its page.

Stays are the periods near a periodic orbit. The page shows symbols over time, the arms as a filmstrip, and the orbit in
space and in the plane.
"""

from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.run_view import PlanView, RunView, Stay
from dpcontrol.orbits.manifold import OrbitCurve
from dpcontrol.pages import style
from dpcontrol.pages.chart import Chart, LevelLine, Line
from dpcontrol.pages.charts import draw_chart
from dpcontrol.pages.film import add_film, film_times
from dpcontrol.pages.layout import Page, Panel, Stack
from dpcontrol.pages.panels import badge, mark_times, quiet, quiet_space
from dpcontrol.pages.run_charts import charts
from dpcontrol.pages.story import story as draw_story
from dpcontrol.pages.story import story_height
from dpcontrol.tubes.connections import Connection
from dpcontrol.walks.shadowing import ShadowingOrbit

NEAR = 1e-3
"""Scaled distance from a periodic orbit at which flights end and wobbles begin, as for connection times."""
_PER_PERIOD = 120
_MOST_SAMPLES = 40_000


@dataclass(frozen=True)
class Wobble:
    """A period near a periodic orbit, with its number of wraps.

    It lasts from start to end (s) about `saddle`.

    `closing` marks a closed walk's stop between its last and its first symbol.
    """

    start: float
    end: float
    saddle: str
    wraps: int
    closing: bool = False


@dataclass(frozen=True)
class WalkStory:
    """An orbit that follows a walk, sampled for drawing.

    arm_lengths (n,) in m, from the pivot; None for a system without arms.
    """

    orbit: ShadowingOrbit
    arm_lengths: tuple[float, ...] | None

    @cached_property
    def curves(self) -> dict[str, OrbitCurve]:
        """Periodic orbits of the walk, by saddle, in visiting order."""
        chain = self.orbit.connections
        orbits = {orbit.saddle: orbit for orbit in (chain[0].source, *(c.target for c in chain))}
        return {saddle: OrbitCurve(orbit) for saddle, orbit in orbits.items()}

    @cached_property
    def times(self) -> Array:
        """Times (K,) of the samples over the whole walk, s."""
        shortest = min(curve.orbit.period for curve in self.curves.values())
        count = min(round(_PER_PERIOD * self.orbit.duration / shortest), _MOST_SAMPLES)
        return np.linspace(0.0, self.orbit.duration, max(count, 2))

    @cached_property
    def states(self) -> Array:
        """States (K, N) at the times, with whole turns counted."""
        return self.orbit.states(self.times)

    @cached_property
    def crossings(self) -> Array:
        """States (k, N) where the symbols cross their sections."""
        return self.orbit.states(self.orbit.symbol_times)

    @property
    def has_angles(self) -> bool:
        """True if a coordinate is an angle."""
        return bool(np.isfinite(self.orbit.system.periods).any())

    def wobbles(self) -> list[Wobble]:
        """Return the periods whose wraps are counted.

        They lie before the walk, at each stop, and after it.
        """
        orbit, chain = self.orbit, self.orbit.connections
        arrivals = [t + c.time_in for t, c in zip(orbit.symbol_times, chain, strict=True)]
        departures = [t - c.time_out for t, c in zip(orbit.symbol_times, chain, strict=True)]
        out = [
            Wobble(float(arrivals[k]), float(departures[k + 1]), chain[k].target.saddle, orbit.wraps_realised[k])
            for k in range(len(chain) - 1)
        ]
        first, last = chain[0].source.saddle, chain[-1].target.saddle
        if not orbit.periodic:
            before = Wobble(0.0, float(departures[0]), first, orbit.lead_in)
            return [before, *out, Wobble(float(arrivals[-1]), orbit.duration, last, orbit.lead_out)]
        # The closing stop extends over the end of the period; its longer part is shown.
        late, early = (float(arrivals[-1]), orbit.duration), (0.0, float(departures[0]))
        start, end = late if late[1] - late[0] >= early[1] - early[0] else early
        return [*out, Wobble(start, end, first, orbit.wraps_realised[-1], closing=True)]

    def view(self, model: str) -> RunView:
        """Return the walk of a model as a `RunView`.

        Wobbles become stays; symbols and periodic orbits are included.
        """
        orbit, count = self.orbit, len(self.orbit.symbol_times)
        kind = "A periodic orbit" if orbit.periodic else "An orbit"
        energy = f"{orbit.connections[0].source.energy:g}{orbit.system.unit('J')}"
        symbols = zip(orbit.symbol_times.tolist(), map(symbol_text, orbit.connections), strict=True)
        stays = (
            Stay(w.start, w.end, w.saddle, f"{w.saddle} {w.wraps}×{' ↻' if w.closing else ''}")
            for w in self.wobbles()
            if w.end > w.start
        )
        return RunView(
            path=Path(),
            title=f"{kind} of {model} at {energy} that follows {count} symbol{'s' if count > 1 else ''}",
            time=self.times,
            state=self.states,
            what="walk",
            arm_lengths=self.arm_lengths or (),
            has_cart=False,
            rate_hz=len(self.times) / orbit.duration,
            verdict=self._verdict(),
            plan=PlanView(symbols=tuple(symbols), planned=tuple(stays), duration=orbit.duration),
        )

    def _verdict(self) -> str:
        orbit = self.orbit
        kind, wraps = "period" if orbit.periodic else "lasts", list(orbit.wraps_realised)
        duration = f"{kind} {orbit.duration:.3f}{orbit.system.unit('s')}"
        return f"{duration}; largest gap at a node {orbit.residual:.1e}; wraps {wraps}"

    def nearness(self) -> Chart:
        """Return the distances between the orbit and the periodic orbits."""
        lines = tuple(
            Line(
                saddle,
                saddle,
                saddle,
                self.times,
                np.maximum(curve.distances(self.states)[1], 1e-16),
                style.saddle_colour(saddle),
            )
            for saddle, curve in self.curves.items()
        )
        title = "Distance from the periodic orbits (scaled); wobbles are counted below the dashed line"
        level = LevelLine("", "", NEAR, style.MARK, "named")
        return Chart("", title, "", lines, levels=(level,), log=True)


def symbol_text(connection: Connection) -> str:
    """Return a connection's symbol, such as "down-up > up-down -"."""
    sense = "+" if connection.sense > 0 else "-"
    source, target = connection.source.saddle, connection.target.saddle
    return f"{source} {sense}" if source == target else f"{source} > {target} {sense}"


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
