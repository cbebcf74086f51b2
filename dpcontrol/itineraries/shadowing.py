"""The orbit that shadows a walk: it follows the connections in order and wobbles at each stop as often as asked.

At a stop between connections A and B the orbit stays near the periodic orbit for (N + f) periods T, f the phase gap
from A's arrival to B's departure (mod 1) and N the wraps. The guess is A + B - γ there (each is within a multiple
of λ^(-N/2) of the orbit at the middle of the stop), refined by multiple shooting between the local manifolds of the
first and last periodic orbits. Never integrated on: a wobble is tiled.

Source: Kaheman et al. (2023), theorem 4.1, made constructive; the wraps' formula is N = round((Δt - time_in of A -
time_out of B)/T - f).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import InputError
from dpcontrol.tubes.connecting_orbit import Anchor, ConnectingOrbit, ShootingSettings, solve_connecting_orbit
from dpcontrol.tubes.connections import Connection

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ShadowingSettings:
    """segments: shooting nodes per period of the stop's orbit; longest: s between nodes off the orbits."""

    segments: int = 8
    shooting: ShootingSettings = ShootingSettings()  # noqa: RUF009 - frozen, so it may be shared


@dataclass(frozen=True)
class ShadowingOrbit:
    """An orbit on one energy that realises a walk; time runs from 0 to `duration` s.

    symbol_times (k,): s at which each symbol crosses its section. wraps_realised: counted on the result.
    offsets: whole turns (k + 1, N) added to each symbol's lift, the last that of the final orbit's.
    """

    walk: tuple[str, ...]
    connections: tuple[Connection, ...]
    wraps: tuple[int, ...]
    wraps_realised: tuple[int, ...]
    lead_in: int
    lead_out: int
    symbol_times: Array
    offsets: Array
    orbit: ConnectingOrbit
    residual: float
    converged: bool
    status: str

    @property
    def duration(self) -> float:
        """Seconds from start to end."""
        return self.orbit.duration

    def sample(self, times: Array) -> Array:
        """Return states (M, N) at times (M,) s."""
        return self.orbit.sample(times)


def phase_gap(before: Connection, after: Connection) -> float:
    """Return f in [0, 1): the phase from the arrival of one connection to the departure of the next."""
    return (after.phase_out - before.phase_in) % 1.0


def realised_wraps(connections: Sequence[Connection], crossings: Array) -> tuple[int, ...]:
    """Count the wraps at each interior stop from the times (k,) at which the sections are crossed."""
    counts = []
    for k in range(len(connections) - 1):
        before, after = connections[k], connections[k + 1]
        spare = crossings[k + 1] - crossings[k] - before.time_in - after.time_out
        counts.append(round(float(spare) / before.target.period - phase_gap(before, after)))
    return tuple(counts)


def shadow(
    connections: Sequence[Connection],
    *,
    wraps: Sequence[int] = (),
    lead_in: int = 2,
    lead_out: int = 2,
    settings: ShadowingSettings | None = None,
) -> ShadowingOrbit:
    """Return the orbit that follows `connections`, with `wraps[k]` wobbles after connection k.

    lead_in and lead_out are the wobbles on the first orbit before the first connection leaves it, and on the last.

    Raises:
        InputError: not one wrap count for each interior stop, a negative count, or connections of different energies.
    """
    settings = settings or ShadowingSettings()
    chain = tuple(connections)
    _check(chain, wraps, lead_in, lead_out)
    system = chain[0].source.system
    lengths = np.where(np.isfinite(system.periods), system.periods, 0.0)
    offsets = np.zeros((len(chain) + 1, system.dimension))
    for k, connection in enumerate(chain):
        offsets[k + 1] = offsets[k]
        offsets[k + 1, : len(connection.winding)] += connection.winding
    crossings = [chain[0].time_out + lead_in * chain[0].source.period]
    for k, count in enumerate(wraps):
        stay = (count + phase_gap(chain[k], chain[k + 1])) * chain[k].target.period
        crossings.append(crossings[-1] + chain[k].time_in + stay + chain[k + 1].time_out)
    total = crossings[-1] + chain[-1].time_in + lead_out * chain[-1].target.period
    times, markers = _node_times(np.array(crossings), total, chain, settings)
    states = _guess(system, chain, np.array(crossings), offsets * lengths, times)
    first, last = chain[0].orbit, chain[-1].orbit
    start = first.start.moved(-crossings[0] - float(first.times[0]))
    end = last.end.moved(total - crossings[-1] - float(last.times[-1]))
    turns = np.asarray(end.turns) + offsets[-2]
    end = type(end)(end.manifold, end.stable, end.phase, end.amplitude, tuple(float(k) for k in turns))
    section = chain[0].section
    anchor = Anchor(int(markers[0]), section.normal, float(np.dot(section.normal, states[markers[0]])))
    orbit = solve_connecting_orbit(system, start, end, times, states, anchor=anchor, settings=settings.shooting)
    realised_times = _crossings(system, chain, orbit, markers)
    realised = realised_wraps(chain, realised_times)
    converged, status = orbit.converged, orbit.status
    if converged and realised != tuple(wraps):
        converged = False
        status = f"converged, but with wraps {list(realised)} instead of {list(wraps)}: ask for more wraps"
    return ShadowingOrbit(
        walk=tuple(c.name for c in chain),
        connections=chain,
        wraps=tuple(int(w) for w in wraps),
        wraps_realised=realised,
        lead_in=lead_in,
        lead_out=lead_out,
        symbol_times=realised_times,
        offsets=offsets,
        orbit=orbit,
        residual=orbit.residual,
        converged=converged,
        status=status,
    )


def _check(chain: tuple[Connection, ...], wraps: Sequence[int], lead_in: int, lead_out: int) -> None:
    if not chain:
        raise InputError("walk = []: a walk has at least one symbol")
    if len(wraps) != len(chain) - 1:
        raise InputError(
            f"wraps = {list(wraps)}: a walk of {len(chain)} symbols has {len(chain) - 1} interior stops; give one "
            "integer for each"
        )
    for name, values in (("wraps", wraps), ("lead_in", (lead_in,)), ("lead_out", (lead_out,))):
        for value in values:
            if isinstance(value, bool) or int(value) != value or value < 0:
                raise InputError(f"{name} = {value!r}: must be a whole number, zero or more")
    energies = {c.source.energy for c in chain}
    if len(energies) > 1:
        raise InputError(f"the walk mixes energies {sorted(energies)} J: one orbit keeps one energy")


def _node_times(
    crossings: Array, total: float, chain: tuple[Connection, ...], settings: ShadowingSettings
) -> tuple[Array, NDArray[np.intp]]:
    """Return node times (K + 1,) with a node at every section crossing, and the indices (k,) of those."""
    marks = np.concatenate([[0.0], crossings, [total]])
    periods = [chain[0].source.period, *(c.target.period for c in chain)]
    times, markers = [0.0], []
    for k, (begin, finish) in enumerate(pairwise(marks)):
        count = max(1, int(np.ceil((finish - begin) / periods[k] * settings.segments)))
        times += list(np.linspace(begin, finish, count + 1)[1:])
        markers.append(len(times) - 1)
    return np.array(times), np.array(markers[:-1])


def _guess(system: System, chain: tuple[Connection, ...], crossings: Array, shifts: Array, times: Array) -> Array:
    """Return guessed states (K + 1, N): the connections, and A + B - γ between two of them."""
    states = np.empty((len(times), system.dimension))
    owner = np.clip(np.searchsorted(crossings, times, side="right") - 1, -1, len(chain) - 1)
    for k in range(-1, len(chain)):
        where = np.flatnonzero(owner == k)
        if where.size == 0:
            continue
        t = times[where]
        if k < 0:
            states[where] = chain[0].orbit.sample(t - crossings[0]) + shifts[0]
        elif k == len(chain) - 1:
            states[where] = chain[k].orbit.sample(t - crossings[k]) + shifts[k]
        else:
            states[where] = _between(chain[k], chain[k + 1], crossings[k : k + 2], shifts[k : k + 2], t)
    return states


def _between(before: Connection, after: Connection, crossings: Array, shifts: Array, t: Array) -> Array:
    """Return guesses between two sections: each connection alone far from the stop, their sum on it."""
    manifold = after.orbit.start.manifold
    since, until = t - crossings[0], t - crossings[1]
    arriving = before.orbit.sample(since) + shifts[0]
    leaving = after.orbit.sample(until) + shifts[1]
    phases = after.phase_out + (until + after.time_out) / manifold.orbit.period
    periodic = manifold.frame(phases).states + shifts[1]
    near_a, near_b = since >= before.time_in, until <= -after.time_out
    both = (near_a & near_b)[:, None]
    # A short stop's flights overlap: whichever section is nearer in time decides.
    nearer = ((since - before.time_in) < (-until - after.time_out))[:, None]
    return np.where(both, arriving + leaving - periodic, np.where(nearer, arriving, leaving))


def _crossings(
    system: System, chain: tuple[Connection, ...], orbit: ConnectingOrbit, markers: NDArray[np.intp]
) -> Array:
    """Return the times (k,) at which the solved orbit crosses the sections, by Newton steps from its nodes there."""
    out = np.empty(len(chain))
    for k, (connection, node) in enumerate(zip(chain, markers, strict=True)):
        section = connection.section
        normal = np.asarray(section.normal)
        state, time = orbit.states[node], float(orbit.times[node])
        for _ in range(4):
            height = float(section.height(state))
            if section.period is not None:
                height -= np.rint(height / section.period) * section.period
            step = -height / float(system.numeric.rate(state) @ normal)
            state, time = system.propagator.flow(state, step), time + step
        out[k] = time
    return out
