"""An orbit that follows a walk, sampled once for drawing.

Stays are the periods near a periodic orbit.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.run_view import PlanView, RunView, Stay
from dpcontrol.orbits.manifold import OrbitCurve
from dpcontrol.pages import style
from dpcontrol.pages.chart import Chart, LevelLine, Line
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
