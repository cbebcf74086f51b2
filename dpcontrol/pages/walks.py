"""An orbit that follows a walk, on one page: its symbols over time, the arms as a filmstrip, the orbit in space.

The orbit is sampled once (`WalkStory`) and drawn like a run; stays are the periods near a periodic orbit, with the
number of wraps. In space and in the plane the orbit is coloured by time.
"""

from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.run_view import PlanView, RunView, Stay
from dpcontrol.orbits.manifold import OrbitCurve
from dpcontrol.pages import style
from dpcontrol.pages.charts import draw_chart
from dpcontrol.pages.filmstrip import draw_film, film_height, frame_position
from dpcontrol.pages.layout import Page, Panel, Stack
from dpcontrol.pages.panels import badge, mark_times, quiet, quiet_space, wrapped_runs
from dpcontrol.pages.series import Chart, LevelLine, Line
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
        orbit, estimate = self.orbit, self.orbit.estimate
        parts = [f"{'period' if orbit.periodic else 'lasts'} {orbit.duration:.3f}{orbit.system.unit('s')}"]
        parts.append(f"largest gap at a node {orbit.residual:.1e}")
        if estimate is not None and estimate.radius is not None:
            parts.append(f"estimated distance from the true orbit {estimate.radius:.1e}")
        if estimate is not None and estimate.multipliers is not None:
            sign = "−" if estimate.multipliers.sign < 0 else ""
            parts.append(f"unstable multiplier {sign}exp({estimate.multipliers.log_unstable:.4g})")
        if orbit.wraps:
            parts.append(f"wraps {list(orbit.wraps_realised)} as asked")
        return "; ".join(parts)

    def coordinates(self) -> Chart:
        """Return the angles over time, whole turns counted.

        A system without angles has positions.
        """
        names = self.orbit.system.coordinates if self.arm_lengths is None else ("θ₁ inner arm", "θ₂ outer arm")
        lines = tuple(
            Line(name, name, name, self.times, self.states[:, k], style.arm_colour(k))
            for k, name in zip(range(self.states.shape[1] // 2), names, strict=False)
        )
        title = "Position" if self.arm_lengths is None else "Angles from hanging, whole turns counted"
        return Chart("", title, "", lines, half_turns=self.arm_lengths is not None)

    def nearness(self) -> Chart:
        """Return the distances between the orbit and the periodic orbits."""
        lines = tuple(
            Line(saddle, saddle, saddle, self.times, np.maximum(curve.distances(self.states)[1], 1e-16),
                 style.saddle_colour(saddle))
            for saddle, curve in self.curves.items()
        )  # fmt: skip
        title = "Distance from the periodic orbits (scaled); wobbles are counted below the dashed line"
        level = LevelLine("", "", NEAR, style.MARK, "named")
        return Chart("", title, "", lines, levels=(level,), log=True)


def symbol_text(connection: Connection) -> str:
    """Return a connection's symbol, such as "down-up > up-down -"."""
    sense = "+" if connection.sense > 0 else "-"
    source, target = connection.source.saddle, connection.target.saddle
    return f"{source} {sense}" if source == target else f"{source} > {target} {sense}"


def symbol_words(connection: Connection) -> str:
    """Return a description of the motion during a symbol."""
    source, target = connection.source.saddle, connection.target.saddle
    if source != target:
        return f"crosses from {source} to {target}"
    if not np.isfinite(connection.source.system.periods).any():
        return f"leaves {source} and comes back"
    count = len(connection.winding)
    arms = ("inner arm", "outer arm") if count == 2 else [f"arm {k + 1}" for k in range(count)]
    turns = []
    for arm, count in zip(arms, connection.winding, strict=True):
        if count:
            often = {1: "once", 2: "twice"}.get(abs(count), f"{abs(count)} times")
            turns.append(f"{arm} turns {often} {'counter-clockwise' if count > 0 else 'clockwise'}")
    return ", ".join(turns) or f"swings away from {source} and back"


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
        axes.add_collection3d(Line3DCollection(_pieces(run[:, :3]), colors=colours, linewidths=1.1))  # type: ignore[attr-defined]
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


def _pieces(points: Array) -> list[Array]:
    """Return the segments (2, D) between points (K, D), for separate colours."""
    return list(np.stack([points[:-1], points[1:]], axis=1))


def _lengths(story: WalkStory) -> Array:
    """Return the period (N,) of each coordinate, zero for those that are not angles."""
    periods = story.orbit.connections[0].source.system.periods
    return np.where(np.isfinite(periods), periods, 0.0)


def _window(story: WalkStory, lifted: bool) -> Array:
    """Return the middle (N,) of the drawn period, with bounds that intersect no periodic orbit."""
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
    """Return indices of points (k, 2) in groups that share a label: those within a small distance on the page."""
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


def plane(axes: Axes, story: WalkStory) -> None:
    """Draw the orbit in the plane of positions, coloured by time.

    This is for a system without arms.
    """
    for saddle, curve in story.curves.items():
        closed = np.vstack([curve.samples, curve.samples[:1]])
        axes.plot(closed[:, 0], closed[:, 1], color=style.saddle_colour(saddle), linewidth=4.0, alpha=0.4)
        centre = curve.orbit.centre
        axes.plot(*centre[:2], "+", color=style.INK, markersize=8)
        axes.annotate(f" {saddle}", (float(centre[0]), float(centre[1])), fontsize=style.SMALL, color=style.INK)
    colours = TIME(story.times[:-1] / story.orbit.duration)
    axes.add_collection(LineCollection(_pieces(story.states[:, :2]), colors=colours, linewidths=1.2, zorder=3))
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

    The arm_lengths (n,) are in m, or None for a system without arms and film.
    """
    walk = WalkStory(orbit, arm_lengths)
    view = walk.view(model)
    page = Page(view.title, view.verdict)
    page.strip(partial(draw_story, view=view), height=story_height(view))
    across = film_shape(len(orbit.symbol_times))[1]
    for first, times, height in [] if arm_lengths is None else _film_rows(walk, view):
        film = Panel(partial(_film, view=view, first=first, times=times), len(times))
        # A last row with fewer symbols is shorter in proportion.
        rest = [Panel(_nothing, across - len(times))] if len(times) < across else []
        page.row(film, *rest, height=height)
    charts = [partial(_chart, chart=chart, view=view, orbit=orbit) for chart in (walk.coordinates(), walk.nearness())]
    plain = [] if walk.arm_lengths is not None else [Panel(partial(plane, story=walk), share=2.6)]
    shown = Stack([Panel(partial(space, story=walk), share=3.9, space=True), *plain], share=0.75)
    page.row(Stack(charts), shown, height=4.4 + 2.6 * len(plain))
    heading = ("", "symbol", f"at{orbit.system.unit('s', ' ({})')}", "connection")
    return page.table(_list(walk, view), heading=heading).figure()


def _nothing(axes: Axes) -> None:
    axes.axis("off")


def _film(axes: Axes, view: RunView, first: int, times: NDArray[np.float64]) -> None:
    draw_film(axes, view, times.ravel())
    reach = sum(view.arm_lengths)
    for k in range(len(times)):
        badge(axes, first + k + 1, frame_position(view, k * times.shape[1]) - 0.6 * reach, axes.get_ylim()[1])


def _chart(axes: Axes, chart: Chart, view: RunView, orbit: ShadowingOrbit) -> None:
    draw_chart(axes, chart, view)
    axes.set_xlim(0.0, orbit.duration)
    mark_times(axes, list(orbit.symbol_times))


def film_shape(count: int) -> tuple[int, int, int]:
    """Return rows, symbols per row and poses per symbol of a film.

    The film has `count` symbols.
    """
    count = min(count, FILM_SYMBOLS)
    poses = 9 if count == 1 else 7 if count == 2 else 5 if count <= 6 else 3 if count <= 16 else 1
    rows = int(np.ceil(count * poses / 18))
    return rows, int(np.ceil(count / rows)), poses


def _film_rows(story: WalkStory, view: RunView) -> list[tuple[int, NDArray[np.float64], float]]:
    """Return the film's rows.

    A row has its first symbol's index, times (symbols, poses) in s about each, and inches.
    """
    orbit = story.orbit
    _, across, poses = film_shape(len(orbit.symbol_times))
    share = np.linspace(-0.55, 0.55, poses) if poses > 1 else np.zeros(1)
    spans = np.array([[c.time_in if s > 0 else c.time_out for s in share] for c in orbit.connections])
    every = (orbit.symbol_times[:, None] + share * spans)[:FILM_SYMBOLS]
    rows = []
    for first in range(0, len(every), across):
        times = every[first : first + across]
        wide = style.WIDTH * len(times) / across
        rows.append((first, times, film_height(view, times.ravel(), width=wide) + 0.15))
    return rows


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
