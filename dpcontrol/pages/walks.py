"""An orbit that follows a walk, sampled once for drawing, and its page.

Stays are the periods near a periodic orbit. The page shows symbols over time, the arms as a filmstrip, and the orbit in
space or in the plane.
"""

from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.run_view import PlanView, RunView, Stay
from dpcontrol.orbits.manifold import OrbitCurve
from dpcontrol.pages import style
from dpcontrol.pages.charts import draw_chart
from dpcontrol.pages.film import add_film, film_times
from dpcontrol.pages.layout import Page, Panel, Stack
from dpcontrol.pages.orbits import conditions
from dpcontrol.pages.panels import quiet_plane, quiet_space
from dpcontrol.pages.run_charts import Chart, LevelLine, Line, charts
from dpcontrol.pages.story import add_story
from dpcontrol.plans.model import ModelSystem
from dpcontrol.tubes.connections import Connection
from dpcontrol.walks.shadowing import ShadowingOrbit

NEAR = 1e-3
"""Scaled distance from a periodic orbit at which flights end and wraps begin, as for connection times."""
_PER_PERIOD = 120
"""Samples in a period of the fastest periodic orbit."""
_MOST_SAMPLES = 40_000
_TIME = colormaps["viridis"]
_DOTS = 15_000
"""Number of dots of an orbit whose colour is the time."""
_FRAMES = 12


@dataclass(frozen=True)
class WalkStory:
    """An orbit that follows a walk, sampled for drawing."""

    orbit: ShadowingOrbit

    @property
    def arm_lengths(self) -> tuple[float, ...]:
        """Lengths (n,) of the arms from the pivot, m; none for a system without arms."""
        system = self.orbit.system
        arms = system.model.parameters if isinstance(system, ModelSystem) else None
        return arms.length if isinstance(arms, ArmChainParameters) else ()

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

    @property
    def has_angles(self) -> bool:
        """True if a coordinate is an angle."""
        return bool(np.isfinite(self.orbit.system.periods).any())

    @cached_property
    def stays(self) -> tuple[Stay, ...]:
        """Periods near the periodic orbits of the walk: before the first symbol, at each stop, and after the last one.

        A symbol is a flight along a connection. It ends the stay at its source and begins that at its target, before
        and after the time of its section crossing. The label of a stay is the number of wraps about the orbit.
        """
        orbit, chain = self.orbit, self.orbit.connections
        arrivals = [symbol_time + c.time_in for symbol_time, c in zip(orbit.symbol_times.tolist(), chain, strict=True)]
        departures = [
            symbol_time - c.time_out for symbol_time, c in zip(orbit.symbol_times.tolist(), chain, strict=True)
        ]
        saddles, wraps = [chain[0].source.saddle, *(c.target.saddle for c in chain)], orbit.wraps_realised
        wraps = (wraps[-1], *wraps) if orbit.periodic else (orbit.lead_in, *wraps, orbit.lead_out)
        # A flight leaves its source `time_out` before its crossing, and joins its target `time_in` after it.
        edges = zip([0.0, *arrivals], [*departures, orbit.duration], saddles, wraps, strict=True)
        first, *inner, last = (Stay(start, end, saddle, f"{saddle} {count}×") for start, end, saddle, count in edges)
        stays = [first, *inner, last]
        if orbit.periodic:
            # The closing stop extends over the end of the period; its longer part is shown.
            closing = max(last, first, key=lambda stay: stay.last - stay.first)
            stays = [*inner, replace(closing, text=f"{closing.text} ↻")]
        return tuple(stay for stay in stays if stay.last > stay.first)

    @property
    def view(self) -> RunView:
        """The walk as a `RunView`, the motion that pages and films draw, with its stays and symbols."""
        orbit, count, system = self.orbit, len(self.orbit.symbol_times), self.orbit.system
        kind = "A periodic orbit" if orbit.periodic else "An orbit"
        energy = f"{orbit.connections[0].source.energy:g}{system.unit('J')}"
        symbols = zip(orbit.symbol_times.tolist(), map(_symbol_text, orbit.connections), strict=True)
        wraps = f"; wraps {list(orbit.wraps_realised)}" if orbit.wraps_realised else ""
        duration = f"{'period' if orbit.periodic else 'lasts'} {orbit.duration:.3f}{system.unit('s')}"
        return RunView(
            path=Path(),
            title=f"{kind} of {system.name} at {energy} that follows {count} symbol{'s' if count > 1 else ''}",
            time=self.times,
            state=self.states,
            what="walk",
            arm_lengths=self.arm_lengths,
            has_cart=False,
            rate_hz=len(self.times) / orbit.duration,
            verdict=f"{duration}; largest gap at a node {orbit.residual:.1e}{wraps}",
            plan=PlanView(symbols=tuple(symbols), planned=self.stays, duration=orbit.duration),
        )

    def nearness(self) -> Chart:
        """Return the chart of the distances between the walk and its periodic orbits, scaled as for counting wraps.

        Its axis is logarithmic, so distances below 1e-16 are drawn there.
        """
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
        title = "Distance from the periodic orbits (scaled); wraps are counted below the dashed line"
        return Chart("", title, "", lines, levels=(LevelLine("", "", NEAR, style.MARK, "named"),), log=True)


def _symbol_text(connection: Connection) -> str:
    """Return the symbol of a connection as users write it, such as "down-up > up-down -", with its sense."""
    sense = "+" if connection.sense > 0 else "-"
    source, target = connection.source.saddle, connection.target.saddle
    return f"{source} {sense}" if source == target else f"{source} > {target} {sense}"


def draw_walk(orbit: ShadowingOrbit) -> Figure:
    """Return the page of an orbit that follows a walk: story, film, angles, distances and shape."""
    walk = WalkStory(orbit)
    view = walk.view
    page = Page(view.title, view.verdict).origin(
        None, *conditions(orbit.system, [c.source.energy for c in orbit.connections])
    )
    add_story(page, view)
    if view.arm_lengths:
        add_film(page, view, film_times(view, frames=_FRAMES))
    shown_charts = [*([charts(view)["angles"]] if walk.has_angles else []), walk.nearness()]
    panels = [partial(draw_chart, chart=chart, view=view, span=view.time_range) for chart in shown_charts]
    shape = Panel(partial(draw_shape, story=walk), 0.75, space=walk.has_angles)
    return page.row(Stack(panels), shape, height=4.4).figure()


def draw_shape(axes: Axes, story: WalkStory) -> None:
    """Draw the orbit over its periodic orbits, coloured by time.

    Angles are drawn in space: the first two, with whole turns counted, and the first rate. Positions are drawn in their
    plane.

    Args:
        axes: panel, in space for angles.
        story: walk to draw.
    """
    orbit, system = story.orbit, story.orbit.system
    columns = [0, 1, system.dimension // 2][: 3 if story.has_angles else 2]
    for copy, saddle in _base_orbits(story):
        axes.plot(*copy[:, columns].T, color=style.saddle_colour(saddle), linewidth=4.0, alpha=0.4)
    times = np.linspace(0.0, orbit.duration, _DOTS)
    axes.scatter(*orbit.states(times)[:, columns].T, c=times, cmap=_TIME, s=1.0, rasterized=True)
    for point, time in zip(orbit.states(orbit.symbol_times)[:, columns], orbit.symbol_times, strict=True):
        axes.plot(*point[:, None], "o", color=_TIME(time / orbit.duration), markersize=5, markeredgecolor="white")
    if story.has_angles:
        quiet_space(axes, system, "The orbit, angles with whole turns counted; dark to light: time")
        axes.set_box_aspect((1, 1, 0.85), zoom=1.06)  # type: ignore[call-arg]
    else:
        quiet_plane(axes, system, title="The orbit in the plane; dark to light: time")
        axes.set_aspect("equal", adjustable="datalim")


def _base_orbits(story: WalkStory) -> list[tuple[Array, str]]:
    """Return the periodic orbits where the walk passes them, with their saddles: closed curves (M, N) of states.

    A walk that turns over passes an orbit again whole turns away, where another copy of it is drawn. The walk's offsets
    are these turns of each coordinate, at each orbit in the order of visits.
    """
    chain, offsets = story.orbit.connections, story.orbit.offsets
    closed = {name: np.vstack([curve.samples, curve.samples[:1]]) for name, curve in story.curves.items()}
    turn_lengths = chain[0].source.system.turn_lengths
    names = [chain[0].source.saddle, *(c.target.saddle for c in chain)]
    copies = {
        (name, tuple(offset)): closed[name] + offset * turn_lengths for name, offset in zip(names, offsets, strict=True)
    }
    return [(curve, name) for (name, _), curve in copies.items()]
