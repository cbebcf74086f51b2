"""What a picture of a walk shows: the orbit sampled, its symbols in words, where it wobbles and how often."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dpcontrol.orbits.curve import OrbitCurve
from dpcontrol.review import style
from dpcontrol.review.context import PlanView, Stay
from dpcontrol.review.motion import RunView
from dpcontrol.review.series import Chart, Level, Line
from dpcontrol.tubes.connection import Connection
from dpcontrol.walks.shadowing import ShadowingOrbit

Array = NDArray[np.float64]

NEAR = 1e-3
"""Scaled distance from a periodic orbit at which flights end and wobbles begin to be counted, as connections' times."""

_PER_PERIOD = 120
_MOST_SAMPLES = 40_000


@dataclass(frozen=True)
class Wobble:
    """A stretch near a periodic orbit: from start to end (s) about `saddle`, with so many wraps; closing: the stop of
    a closed walk from its last symbol back to its first.
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
    def saddles(self) -> tuple[str, ...]:
        """The saddles whose orbits the walk visits, in the order of its visits."""
        chain = self.orbit.connections
        return tuple(dict.fromkeys([chain[0].source.saddle, *(c.target.saddle for c in chain)]))

    @cached_property
    def curves(self) -> dict[str, OrbitCurve]:
        """The periodic orbits of the walk, by saddle."""
        orbits = {c.source.saddle: c.source for c in self.orbit.connections}
        orbits |= {c.target.saddle: c.target for c in self.orbit.connections}
        return {saddle: OrbitCurve(orbits[saddle]) for saddle in self.saddles}

    @cached_property
    def times(self) -> Array:
        """Times (K,) in s of the samples, from the walk's start to its end."""
        shortest = min(curve.orbit.period for curve in self.curves.values())
        count = min(round(_PER_PERIOD * self.orbit.duration / shortest), _MOST_SAMPLES)
        return np.linspace(0.0, self.orbit.duration, max(count, 2))

    @cached_property
    def states(self) -> Array:
        """States (K, N) at the times, angles as they come: whole turns counted."""
        return self.orbit.sample(self.times)

    @cached_property
    def crossings(self) -> Array:
        """States (k, N) where the symbols cross their sections."""
        return self.orbit.sample(self.orbit.symbol_times)

    @cached_property
    def distances(self) -> dict[str, Array]:
        """Scaled distance (K,) of each sample from each periodic orbit, by saddle."""
        return {saddle: curve.distances(self.states)[1] for saddle, curve in self.curves.items()}

    @property
    def has_angles(self) -> bool:
        """Whether the coordinates are angles."""
        return bool(np.isfinite(self.orbit.connections[0].source.system.periods).any())

    def wobbles(self) -> list[Wobble]:
        """Return the stretches whose wraps are counted: before the walk, at each stop, and after it."""
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
        # The closing stop runs over the end of the period: shown where more of it is.
        late, early = (float(arrivals[-1]), orbit.duration), (0.0, float(departures[0]))
        start, end = late if late[1] - late[0] >= early[1] - early[0] else early
        return [*out, Wobble(start, end, first, orbit.wraps_realised[-1], closing=True)]

    def view(self, model: str) -> RunView:
        """Return the walk as a run is seen, of a model by name: wobbles as stays, symbols, periodic orbits."""
        orbit, count = self.orbit, len(self.orbit.symbol_times)
        kind = "A periodic orbit" if orbit.periodic else "An orbit"
        energy = f"{orbit.connections[0].source.energy:g}{' J' if self.has_angles else ''}"
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
            plan=PlanView(
                symbols=tuple(
                    (float(t), symbol_text(c)) for t, c in zip(orbit.symbol_times, orbit.connections, strict=True)
                ),
                planned=tuple(
                    Stay(w.start, w.end, w.saddle, f"{w.saddle} {w.wraps}×{' ↻' if w.closing else ''}")
                    for w in self.wobbles()
                    if w.end > w.start
                ),
                duration=orbit.duration,
            ),
        )

    def _verdict(self) -> str:
        orbit, estimate = self.orbit, self.orbit.estimate
        unit = " s" if self.has_angles else ""
        parts = [f"{'period' if orbit.periodic else 'lasts'} {orbit.duration:.3f}{unit}"]
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
        """Return the angles over time, whole turns counted; positions for a system without angles."""
        names = ("θ₁ inner arm", "θ₂ outer arm") if self.has_angles else ("x", "y")
        lines = tuple(
            Line(name, name, name, self.times, self.states[:, k], style.arm_colour(k))
            for k, name in zip(range(self.states.shape[1] // 2), names, strict=False)
        )
        title = "Angles from hanging, whole turns counted" if self.has_angles else "Position"
        return Chart("", title, title, lines, half_turns=self.has_angles)

    def nearness(self) -> Chart:
        """Return how near the orbit comes to the periodic orbits."""
        lines = tuple(
            Line(saddle, saddle, saddle, self.times, np.maximum(self.distances[saddle], 1e-16),
                 style.saddle_colour(saddle))
            for saddle in self.saddles
        )  # fmt: skip
        title = "Distance from the periodic orbits (scaled)"
        level = Level("", "wobbles are counted below", NEAR, style.MARK, "named")
        return Chart("", title, title, lines, levels=(level,), log=True)


def symbol_text(connection: Connection) -> str:
    """Return a connection as an itinerary asks for its kind: "down-up +", "down-up > up-down -"."""
    sense = "+" if connection.sense > 0 else "-"
    source, target = connection.source.saddle, connection.target.saddle
    return f"{source} {sense}" if source == target else f"{source} > {target} {sense}"


def symbol_words(connection: Connection) -> str:
    """Return in plain words what the system does during a symbol."""
    source, target = connection.source.saddle, connection.target.saddle
    if source != target:
        return f"crosses from {source} to {target}"
    angular = np.isfinite(connection.source.system.periods)
    if not angular.any():
        return f"leaves {source} and comes back"
    arms = ("inner arm", "outer arm") if len(connection.winding) == 2 else tuple(
        f"arm {k + 1}" for k in range(len(connection.winding)))  # fmt: skip
    turns = []
    for arm, count in zip(arms, connection.winding, strict=True):
        if count:
            often = {1: "once", 2: "twice"}.get(abs(count), f"{abs(count)} times")
            turns.append(f"{arm} turns {often} {'counter-clockwise' if count > 0 else 'clockwise'}")
    return ", ".join(turns) or f"swings away from {source} and back"
