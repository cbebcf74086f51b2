"""Decoding of walks from trajectories only.

The input is the states, orbits, sections and published connections. The classifier determines the stops with their
lattice points, the connections between them, and the number of wraps at each stop,
N = round((Δt - time_in - time_out)/T - f). Orbits and gaps are integrated by scipy's DOP853.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial import cKDTree

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.tubes.connections import Connection
from dpcontrol.walks.shadowing import ShadowingOrbit

Array = NDArray[np.float64]
Sampler = Callable[[Array], Array]

ENTERED = 6e-3
"""Required scaled distance of a stop from its orbit; published approaches are to 1e-3."""
NOT_WHOLE = 0.01
"""Error of published phases, which refer to the nearest point at a scaled distance of 1e-3."""
STEP = 4e-3
"""s between samples."""
GAP = 1e-11
"""Largest gap between nodes that are flown again."""
LEFT = 6e-2
"""Scaled distance that ends a stop, ten times that of the fewest wraps."""


@dataclass(frozen=True)
class Passage:
    """One symbol of a trajectory, and which of how many crossings of the section between its two stops it is."""

    connection: Connection
    time: float
    winding: tuple[int, ...]
    crossing: int
    crossings: int

    @property
    def consistent(self) -> bool:
        """True if winding and hits agree with the nearest published connection."""
        first, last = self.connection.hits
        return self.winding == self.connection.winding and (self.crossing, self.crossings) == (first, first + last - 1)


@dataclass(frozen=True)
class Reading:
    """Wraps at each stop between passages, and their distance from whole numbers before rounding."""

    passages: tuple[Passage, ...]
    wraps: tuple[int, ...]
    odd: tuple[float, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(p.connection.name for p in self.passages)


@dataclass(frozen=True)
class _Stop:
    saddle: str
    lattice: tuple[int, ...]
    first: int
    last: int


class WalkClassifier:
    """Reads walks on the connections of one energy."""

    def __init__(self, system: System, connections: Sequence[Connection]) -> None:
        self.system, self.connections = system, tuple(connections)
        self.n = system.dimension // 2
        orbits = {o.saddle: o for c in connections for o in (c.source, c.target)}
        self.orbits = orbits
        self.trees = {name: cKDTree(self._drawn(orbit.state, orbit.period)) for name, orbit in orbits.items()}

    def _drawn(self, state: Array, period: float) -> Array:
        """Return 20,000 scaled points of a periodic orbit; its multiplier leaves 1e-9 of the integrator's 1e-13."""
        solution = solve_ivp(
            lambda _, x: self.system.numeric.rate(x), (0.0, period), state, "DOP853", rtol=1e-13, atol=1e-13,
            t_eval=np.linspace(0.0, period, 20_001),
        )  # fmt: skip
        assert np.abs(solution.y[:, -1] - state).max() < 1e-6, "the orbit does not close"
        return solution.y.T / self.system.scale

    def complaints(self, orbit: ShadowingOrbit) -> list[str]:
        """Return the differences of a converged orbit from the requested walk, ideally none."""
        if orbit.periodic:
            seen = self.closed_walk(orbit.states, orbit.duration)
        else:
            seen = self.open_walk(orbit.states, orbit.duration)
        found = []
        if seen.names != orbit.walk:
            found.append(f"follows {seen.names}, not {orbit.walk}")
        if seen.wraps != orbit.wraps:
            found.append(f"wraps {seen.wraps}, not {orbit.wraps}")
        found += [f"not as published: {p}" for p in seen.passages if not p.consistent]
        found += [f"wraps are {odd:.3f} off a whole number" for odd in seen.odd if odd > NOT_WHOLE]
        flown = float(flown_gaps(self.system, orbit.orbit.states, np.diff(orbit.orbit.times)).max())
        if flown > GAP:
            found.append(f"flown again, gaps are {flown:.1e}")
        return found

    def open_walk(self, sample: Sampler, duration: float) -> Reading:
        """Read the walk of a trajectory from time 0 to `duration` s."""
        return self._reading(self._passages(sample, 0.0, duration))

    def closed_walk(self, sample: Sampler, period: float) -> Reading:
        """Read one period of a periodic trajectory, starting at time 0."""
        seen = self._passages(sample, -period, 2 * period)
        inside = [p for p in seen if -1e-9 <= p.time < period - 1e-9]
        after = next(p for p in seen if p.time >= period - 1e-9)
        assert inside[0].connection is after.connection, "the second round differs from the first"
        assert abs(after.time - inside[0].time - period) < 1e-6, "the second round is late"
        reading = self._reading([*inside, after])
        return Reading(reading.passages[:-1], reading.wraps, reading.odd)

    def _reading(self, passages: Sequence[Passage]) -> Reading:
        wraps, odd = [], []
        for a, b in pairwise(passages):
            before, after = a.connection, b.connection
            gap = (after.phase_out - before.phase_in) % 1.0
            counted = (b.time - a.time - before.time_in - after.time_out) / before.target.period - gap
            wraps.append(round(counted))
            odd.append(abs(counted - wraps[-1]))
        return Reading(tuple(passages), tuple(wraps), tuple(odd))

    def _passages(self, sample: Sampler, begin: float, end: float) -> list[Passage]:
        times = np.linspace(begin, end, int(np.ceil((end - begin) / STEP)) + 1)
        states = sample(times)
        stops = self._stops(states)
        return [self._passage(sample, times, states, a, b) for a, b in pairwise(stops)]

    def _stops(self, states: Array) -> list[_Stop]:
        """Return the maximal stretches within LEFT of one orbit on one lattice point that come within ENTERED."""
        found = []
        for saddle, tree in self.trees.items():
            home = self.orbits[saddle].centre
            turns = self.system.nearest_turns(states - home)
            reduced = (states - turns * self.system.turn_lengths) / self.system.scale
            distances, _ = tree.query(reduced, p=np.inf, distance_upper_bound=LEFT)
            near = np.isfinite(distances)
            edges = np.flatnonzero(np.diff(np.concatenate([[0], near.astype(int), [0]])))
            for first, beyond in edges.reshape(-1, 2):
                deepest = first + int(np.argmin(distances[first:beyond]))
                if distances[deepest] < ENTERED:
                    lattice = tuple(int(k) for k in turns[deepest, : self.n])
                    found.append(_Stop(saddle, lattice, int(first), int(beyond) - 1))
        found.sort(key=lambda stop: stop.first)
        for a, b in pairwise(found):
            assert a.last < b.first, f"near {a.saddle} and {b.saddle} at once"
        return found

    def _passage(self, sample: Sampler, times: Array, states: Array, a: _Stop, b: _Stop) -> Passage:
        """Return the connection between two stops."""
        candidates = [c for c in self.connections if (c.source.saddle, c.target.saddle) == (a.saddle, b.saddle)]
        winding = tuple(int(y - x) for x, y in zip(a.lattice, b.lattice, strict=True))
        assert candidates, f"no connection is known from {a.saddle} to {b.saddle}"
        lift = np.zeros(self.system.dimension)
        lift[: self.n] = a.lattice
        lift *= self.system.turn_lengths
        best: list[tuple[float, Passage]] = []
        for section in dict.fromkeys(c.section for c in candidates):
            at = self._crossings(sample, times[a.last : b.first + 1], states[a.last : b.first + 1], section)
            for place, (time, state) in enumerate(at, start=1):
                for c in candidates:
                    if c.section == section:
                        apart = float(np.max(np.abs(state - lift - c.state) / self.system.scale))
                        best.append((apart, Passage(c, time, winding, place, len(at))))
        assert best, f"no section is crossed between {a.saddle} and {b.saddle}"
        return min(best, key=lambda entry: entry[0])[1]

    def _crossings(self, sample: Sampler, times: Array, states: Array, section: Section) -> list[tuple[float, Array]]:
        """Return times and states of the crossings between samples, by bisection with ever finer samples."""
        heights = section.height(states)
        cell = np.zeros(len(heights)) if section.period is None else np.rint(heights / section.period)
        period = section.period or 0.0
        out = []
        for k in range(len(times) - 1):
            for level in {cell[k], cell[k + 1]}:
                goal = level * period
                if (heights[k] - goal) * (heights[k + 1] - goal) >= 0:
                    continue
                low, high = float(times[k]), float(times[k + 1])
                rising = heights[k + 1] > heights[k]
                for _ in range(8):
                    grid = np.linspace(low, high, 66)
                    above = (section.height(sample(grid)) > goal) == rising
                    first = int(np.argmax(above)) or 1
                    low, high = float(grid[first - 1]), float(grid[first])
                state = sample(np.array([0.5 * (low + high)]))[0]
                if section.admits(state):
                    out.append((0.5 * (low + high), state))
        return out


def flown_gaps(system: System, states: Array, durations: Array) -> Array:
    """Return the gaps between K + 1 nodes (K,), and those of forty by DOP853."""
    alone = np.array([system.propagator.flow(x, h) for x, h in zip(states[:-1], durations, strict=True)])
    chosen = np.unique(np.linspace(0, len(durations) - 1, 40).astype(int))
    seconds, shape = durations[chosen, None], (len(chosen), system.dimension)

    def rate(_: float, x: Array) -> Array:
        return (system.numeric.rate(x.reshape(shape)) * seconds).ravel()

    flown = solve_ivp(rate, (0.0, 1.0), states[chosen].ravel(), "DOP853", rtol=3e-14, atol=1e-15)
    together = flown.y[:, -1].reshape(shape)
    return np.abs(np.vstack([alone - states[1:], together - states[chosen + 1]])).max(axis=1)
