"""The orbit that shadows a walk: it follows the connections in order and wobbles at each stop as often as asked.

At a stop between connections A and B the orbit stays near the periodic orbit for (N + f) periods T, f the phase gap
from A's arrival to B's departure (mod 1) and N = round((Δt - time_in of A - time_out of B)/T - f) the wraps. The guess
follows A to the middle of the stop and B from there, where both are within 1e-3 λ^(-N/2) of the periodic orbit; it is
tiled, never integrated. Multiple shooting refines it: between the local manifolds of the first and last periodic
orbits, or closed.

How few wraps suffice (the theorem's M_k) is found for the walk at hand: it is tried with none; where no orbit is found,
the stops beside the symbol at fault are given one more, until there is one; then each stop that was raised is lowered
again as far as the orbit allows.

Source: Kaheman et al. (2023), theorem 4.1, made constructive.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.shooting.newton import (
    ErrorEstimate,
    Guess,
    ManifoldEnd,
    NewtonSettings,
    ShootingOrbit,
    Shot,
    estimate_error,
    solve_shooting,
)
from dpcontrol.tubes.connections import Connection


@dataclass(frozen=True)
class ShadowingSettings:
    """segments: shooting nodes per period of the stop's orbit.

    amplitude: scaled distance at which the ends leave their orbits; what the local manifold leaves out is its square.
    """

    segments: int = 8
    amplitude: float = 1e-8
    newton: NewtonSettings = NewtonSettings()  # noqa: RUF009 - frozen, so it may be shared


def phase_gap(before: Connection, after: Connection) -> float:
    """Return f in [0, 1): the phase from the arrival of one connection to the departure of the next."""
    return (after.phase_out - before.phase_in) % 1.0


def passage(before: Connection, after: Connection, wraps: int) -> float:
    """Return the time in s between the crossings of two connections' sections at a stop with that many wraps.

    Phases on the local manifolds are asymptotic, so both connections wobble in step there; the published phase_in and
    phase_out are those of the nearest point at a distance of 1e-3, off by about as much.
    """
    since, until = _asymptotic_phases(before, after)
    return (until - since + stop_rounds(before, after, wraps)) * before.target.period


def stop_rounds(before: Connection, after: Connection, wraps: int) -> int:
    """Return by how many whole periods the phase of one connection is ahead of the next one's, at the same time.

    At a stop that turns, each of them puts the next connection a turn farther on.
    """
    since, until = _asymptotic_phases(before, after)
    goal = (before.time_in + after.time_out) / before.target.period + wraps + phase_gap(before, after)
    return round(goal - (until - since))


def _asymptotic_phases(before: Connection, after: Connection) -> tuple[float, float]:
    """Return the phases, at the crossings of their sections, of the orbit that two connections join and leave."""
    period = before.target.period
    arrival, departure = before.orbit.end, after.orbit.start
    since = arrival.orbit_phase - float(before.orbit.times[-1]) / period
    until = departure.orbit_phase - float(after.orbit.times[0]) / period
    return since, until


class Strands:
    """Connections sampled from their sections on, at a fixed number of nodes per period, once for all walks."""

    def __init__(self, segments: int) -> None:
        self.segments = segments
        self._kept: dict[tuple[str, float, int], Array] = {}

    def states(self, connection: Connection, sign: int, count: int) -> tuple[Array, float]:
        """Return states (count + 1, N) at whole steps after the section (sign -1: before), and the step in s.

        The step is a fixed part of the period of the target (sign -1: source) orbit.
        """
        period = (connection.target if sign > 0 else connection.source).period
        step = period / self.segments
        key = (connection.name, connection.source.energy, sign)
        kept = self._kept.get(key)
        if kept is None or len(kept) <= count:
            # A period more than asked: longer stays with the same connection come next.
            kept = connection.orbit.sample(sign * step * np.arange(count + self.segments + 1.0))
            self._kept[key] = kept
        return kept[: count + 1], step


def first_guess(
    chain: Sequence[Connection],
    wraps: Sequence[int],
    *,
    periodic: bool = False,
    settings: ShadowingSettings | None = None,
    strands: Strands | None = None,
) -> Guess:
    """Return the nodes from which a walk's orbit is sought: strands of its connections, joined in mid-stop."""
    settings = settings or ShadowingSettings()
    strands = strands if strands is not None and strands.segments == settings.segments else Strands(settings.segments)
    system = chain[0].source.system
    offsets = lattice_offsets(chain, wraps)
    pairs = [(chain[k], chain[(k + 1) % len(chain)]) for k in range(len(wraps))]
    passages = [passage(a, b, n) for n, (a, b) in zip(wraps, pairs, strict=True)]
    stays = [seconds - a.time_in - b.time_out for seconds, (a, b) in zip(passages, pairs, strict=True)]
    states, durations, owners = [], [], []
    markers: dict[int, tuple[Array, float]] = {}
    ends: list[ManifoldEnd] = []
    joints: list[int] = []
    for k, connection in enumerate(chain):
        shift = offsets[k] * system.turn_lengths
        arriving = stays[k - 1] if k > 0 or periodic else None
        leaving = stays[k] if k < len(stays) else None
        back = _count(connection, -1, arriving, settings)
        ahead = _count(connection, +1, leaving, settings)
        before, early = strands.states(connection, -1, back)
        after, late = strands.states(connection, +1, ahead)
        if k == 0 and not periodic:
            ends.append(connection.orbit.start.moved(-back * early - float(connection.orbit.times[0])))
        if leaving is None:
            end = connection.orbit.end.moved(ahead * late - float(connection.orbit.times[-1]))
            ends.append(replace(end, turns=tuple(float(t) for t in np.asarray(end.turns) + offsets[k])))
        if k > 0:
            joints.append(len(durations))
            # The joint takes up what whole steps leave of the stay.
            durations.append(_joint(chain[k - 1], connection, stays[k - 1], settings))
        markers[len(owners) + back] = _level(connection, shift)
        states += [before[::-1] + shift, after[1:] + shift]
        durations += [early] * back + [late] * ahead
        owners += [k] * (back + ahead + 1)
    turn = None
    if periodic:
        turn = offsets[-1] * system.turn_lengths
        joints.append(len(durations))
        durations.append(_joint(chain[-1], chain[0], stays[-1], settings))
        states.append(states[0][:1] + turn)
        owners.append(0)
    return Guess(
        system=system,
        states=np.vstack(states),
        durations=np.array(durations),
        owners=np.array(owners, dtype=np.intp),
        markers=markers,
        joints=tuple(joints),
        energy=chain[0].source.energy,
        ends=None if periodic else (ends[0], ends[1]),
        turn=turn,
    )


def lattice_offsets(chain: Sequence[Connection], wraps: Sequence[int]) -> Array:
    """Return whole turns (k + 1, N) by which each connection, and the final orbit, is lifted."""
    offsets = np.zeros((len(chain) + 1, chain[0].source.system.dimension))
    for k, connection in enumerate(chain):
        offsets[k + 1] = offsets[k]
        offsets[k + 1, : len(connection.winding)] += connection.winding
        if k < len(wraps):
            rounds = stop_rounds(connection, chain[(k + 1) % len(chain)], wraps[k])
            offsets[k + 1] += rounds * connection.target.whole_turns
    return offsets


def _count(connection: Connection, sign: int, stay: float | None, settings: ShadowingSettings) -> int:
    """Return how many nodes a connection gives before (sign -1) or after its section: to mid-stop, or to its end."""
    orbit, flight = (connection.target, connection.time_in) if sign > 0 else (connection.source, connection.time_out)
    step = orbit.period / settings.segments
    if stay is not None:
        return max(1, int((flight + stay / 2) / step))
    end = connection.orbit.end if sign > 0 else connection.orbit.start
    at = abs(float(connection.orbit.times[-1 if sign > 0 else 0]))
    periods = np.log(abs(end.amplitude) / settings.amplitude) / end.manifold.exponent
    return max(1, int(np.ceil((at + periods * orbit.period) / step)))


def _joint(before: Connection, after: Connection, stay: float, settings: ShadowingSettings) -> float:
    """Return the time in s between the last node of one connection and the first of the next: one to three steps."""
    step = before.target.period / settings.segments
    counts = _count(before, +1, stay, settings) + _count(after, -1, stay, settings)
    return before.time_in + stay + after.time_out - counts * step


def _level(connection: Connection, shift: Array) -> tuple[Array, float]:
    """Return the normal and the value of normal · x on a connection's lifted section."""
    section = connection.section
    normal = np.asarray(section.normal)
    return normal, section.level(connection.state) + float(normal @ shift)


@dataclass(frozen=True)
class ShadowingOrbit:
    """An orbit on one energy that realises a walk; time runs from 0 to `duration` s.

    symbol_times (k,): s at which each symbol crosses its section. wraps: one for each stop, k - 1 of them, or k if
    periodic (the last from the last symbol back to the first); wraps_realised: counted on the result. offsets: whole
    turns (k + 1, N) added to each symbol's lift, the last that of the final orbit's. orbit: its nodes. fault: index of
    the symbol that failed, None where none did.
    """

    walk: tuple[str, ...]
    connections: tuple[Connection, ...]
    wraps: tuple[int, ...]
    wraps_realised: tuple[int, ...]
    lead_in: int
    lead_out: int
    symbol_times: Array
    offsets: Array
    duration: float
    orbit: ShootingOrbit
    shot: Shot = field(repr=False)
    estimate: ErrorEstimate | None
    fault: int | None

    def __repr__(self) -> str:
        return f"<walk {', '.join(self.walk)}: {self.status}>"

    @property
    def periodic(self) -> bool:
        """Whether the walk closes."""
        return self.orbit.closed

    @property
    def residual(self) -> float:
        """The largest gap at a node (rad, rad/s)."""
        return self.orbit.residual

    @property
    def converged(self) -> bool:
        """Whether Newton's method converged, and to the walk that was asked for."""
        return self.orbit.converged

    @property
    def status(self) -> str:
        """A sentence on how the search ended."""
        return self.orbit.status

    def sample(self, times: Array) -> Array:
        """Return states (M, N) at times (M,) s."""
        return self.orbit.sample(times)


def realised_wraps(connections: Sequence[Connection], stays: Array) -> tuple[int, ...]:
    """Count the wraps at each stop from the times (s,) between the crossings of its two sections.

    Stop k lies between connections k and k + 1; as many stops as connections close the walk.
    """
    counts = []
    for k, seconds in enumerate(stays):
        before, after = connections[k], connections[(k + 1) % len(connections)]
        spare = seconds - before.time_in - after.time_out
        counts.append(round(float(spare) / before.target.period - phase_gap(before, after)))
    return tuple(counts)


def shadow(
    connections: Sequence[Connection],
    *,
    wraps: Sequence[int] = (),
    lead_in: int = 2,
    lead_out: int = 2,
    periodic: bool = False,
    settings: ShadowingSettings | None = None,
    strands: Strands | None = None,
    rivals: Sequence[Connection] = (),
) -> ShadowingOrbit:
    """Return the orbit that follows `connections`, with `wraps[k]` wobbles after connection k.

    lead_in and lead_out are the wobbles on the first orbit before the first connection leaves it, and on the last.
    periodic: the walk closes, with one more stop (and wrap count) from its last connection to its first. rivals: other
    connections that an orbit with too few wraps might follow instead; strands: kept samples, shared between walks.

    Raises:
        InputError: not one wrap count for each stop, a negative count, connections of different energies, or a
            periodic walk whose end is not its start.
    """
    settings = settings or ShadowingSettings()
    chain = tuple(connections)
    _check(chain, wraps, lead_in, lead_out, periodic)
    guess = first_guess(chain, wraps, periodic=periodic, settings=settings, strands=strands)
    shot = solve_shooting(guess, settings.newton)
    return described(shot, chain, wraps, leads=(lead_in, lead_out), rivals=rivals)


def walk_of_one(connection: Connection, text: str, *, lead_in: int = 2, lead_out: int = 2) -> ShadowingOrbit:
    """Return the walk of one symbol, `text`, that a connection is by itself; nothing is solved, and no error estimated.

    For connections that exist at their own energy only: the equations of a walk keep the energy.
    """
    begin = connection.time_out + lead_in * connection.source.period
    ends = np.zeros((2, len(connection.state)))
    ends[1, : len(connection.winding)] = connection.winding
    orbit = replace(
        connection.orbit,
        times=connection.orbit.times + begin,
        status=f"converged: the connection itself, at {connection.source.energy:.12g} J",
    )
    return ShadowingOrbit(
        walk=(text,),
        connections=(connection,),
        wraps=(),
        wraps_realised=(),
        lead_in=lead_in,
        lead_out=lead_out,
        symbol_times=np.array([begin]),
        offsets=ends,
        duration=begin + connection.time_in + lead_out * connection.target.period,
        orbit=orbit,
        shot=Shot(connection.solution, orbit, 0.0, None, np.nan, np.empty((0, 0, 0)), 0),
        estimate=None,
        fault=None,
    )


def described(
    shot: Shot,
    chain: tuple[Connection, ...],
    wraps: Sequence[int],
    *,
    leads: tuple[int, int] = (2, 2),
    rivals: Sequence[Connection] = (),
) -> ShadowingOrbit:
    """Return a solved shot as the orbit of its walk: its times, what it realises, and its error estimate."""
    guess, orbit = shot.guess, shot.orbit
    periodic = guess.closed
    nodes = np.array(sorted(guess.markers))
    crossings = orbit.times[nodes]
    first, last = chain[0], chain[-1]
    lead_in, lead_out = leads
    stays = np.diff(crossings)
    if periodic:
        stays = np.append(stays, orbit.duration - stays.sum())
        times, duration = orbit.times - orbit.times[0], orbit.duration
    else:
        times = orbit.times + first.time_out + lead_in * first.source.period
        duration = float(times[nodes[-1]]) + last.time_in + lead_out * last.target.period
    realised = realised_wraps(chain, stays)
    offsets = lattice_offsets(chain, wraps)
    converged, status, fault, estimate = orbit.converged, orbit.status, shot.fault, None
    if converged:
        strays = _strays(shot, chain, nodes, offsets, rivals, realised, tuple(wraps))
        estimate = estimate_error(shot, [connection.target for connection in chain[: len(stays)]])
        if strays is None:
            fault = None
        else:
            converged, (fault, status) = False, strays
    else:
        status = f"symbol {fault + 1} of {len(chain)} ({chain[fault].name}): {status}"
    return ShadowingOrbit(
        walk=tuple(c.name for c in chain),
        connections=chain,
        wraps=tuple(int(w) for w in wraps),
        wraps_realised=realised,
        lead_in=lead_in,
        lead_out=lead_out,
        symbol_times=times[nodes],
        offsets=offsets,
        duration=duration,
        orbit=replace(orbit, times=times, converged=converged, status=status),
        shot=shot,
        estimate=estimate,
        fault=fault,
    )


def _strays(
    shot: Shot,
    chain: tuple[Connection, ...],
    nodes: NDArray[np.intp],
    offsets: Array,
    rivals: Sequence[Connection],
    realised: tuple[int, ...],
    wraps: tuple[int, ...],
) -> tuple[int, str] | None:
    """Return (symbol, sentence) where a converged orbit is not the one that was asked for, None where it is."""
    system = shot.guess.system
    for k, (connection, node) in enumerate(zip(chain, nodes, strict=True)):
        state = shot.orbit.states[node] - offsets[k] * system.turn_lengths
        own = _apart(system, state, connection.state)
        for rival in rivals:
            same_kind = (rival.source.saddle, rival.target.saddle, rival.winding, rival.section) == (
                connection.source.saddle,
                connection.target.saddle,
                connection.winding,
                connection.section,
            )
            # The walk's own connection is among the rivals, so equal distances are fine.
            if same_kind and _apart(system, state, rival.state) < own:
                return k, (
                    f"symbol {k + 1} of {len(chain)}: converged, but the orbit follows {rival.name} there instead of "
                    f"{connection.name}: ask for more wraps beside it"
                )
    for k, (count, asked) in enumerate(zip(realised, wraps, strict=True)):
        if count != asked:
            return k, (
                f"symbol {k + 1} of {len(chain)}: converged, but with wraps {list(realised)} instead of {list(wraps)}: "
                "ask for more wraps"
            )
    return None


def _apart(system: System, first: Array, second: Array) -> float:
    return float(np.max(np.abs(first - second) / system.scale))


MOST_WRAPS = 1_000_000


def check_stops(chain: Sequence[Connection], wraps: Sequence[int] | None, *, periodic: bool) -> int:
    """Return how many stops a walk has, one more if it closes.

    Raises:
        InputError: not one wrap count for each stop, or a periodic walk whose end is not its start.
    """
    stops = len(chain) if periodic else len(chain) - 1
    if periodic and chain[0].source.saddle != chain[-1].target.saddle:
        raise InputError(
            f"the walk starts at {chain[0].source.saddle} and ends at {chain[-1].target.saddle}: a periodic walk "
            "ends where it starts"
        )
    if wraps is not None and len(wraps) != stops:
        kind = "stops, as it closes" if periodic else f"interior stop{'s' if stops != 1 else ''}"
        raise InputError(
            f"wraps = {list(wraps)}: a walk of {len(chain)} symbols has {stops} {kind}; give one integer for each"
        )
    return stops


def _check(chain: tuple[Connection, ...], wraps: Sequence[int], lead_in: int, lead_out: int, periodic: bool) -> None:
    if not chain:
        raise InputError("walk = []: a walk has at least one symbol")
    check_stops(chain, wraps, periodic=periodic)
    for name, values in (("wraps", wraps), ("lead_in", (lead_in,)), ("lead_out", (lead_out,))):
        for value in values:
            number = isinstance(value, int | float | np.number) and not isinstance(value, bool) and np.isfinite(value)
            if not number or int(value) != value or value < 0:
                raise InputError(f"{name} = {value!r}: must be a whole number, zero or more")
            if value > MOST_WRAPS:
                raise InputError(f"{name} = {value}: must be at most {MOST_WRAPS:,}")
    energies = {c.source.energy for c in chain}
    if len(energies) > 1:
        raise InputError(
            f"the walk mixes energies {sorted(energies)} J: one orbit keeps one energy; join references of different "
            "energies instead"
        )


MOST = 12
"""Wraps at one stop beyond which fewer are not the reason for failure: λ^-12 is below rounding for λ > 20."""


@dataclass
class WalkSolver:
    """Solves walks of one graph, and remembers the least wraps seen between each pair of neighbours.

    rivals: all connections of the graph, which an orbit might follow instead of its own.
    """

    rivals: Sequence[Connection]
    settings: ShadowingSettings = field(default_factory=ShadowingSettings)
    least_seen: dict[tuple[str, str], int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Make room for the samples that walks share."""
        self._strands = Strands(self.settings.segments)

    def solve(
        self,
        chain: Sequence[Connection],
        wraps: Sequence[int],
        *,
        periodic: bool = False,
        lead_in: int = 2,
        lead_out: int = 2,
    ) -> ShadowingOrbit:
        """Return the orbit of a walk with the wraps asked for; where it fails, the status names the least that work.

        Raises:
            InputError: wraps that do not fit the walk.
        """
        orbit = shadow(
            chain,
            wraps=wraps,
            periodic=periodic,
            lead_in=lead_in,
            lead_out=lead_out,
            settings=self.settings,
            strands=self._strands,
            rivals=self.rivals,
        )
        if orbit.converged:
            self._remember(orbit)
        return orbit

    def least(self, chain: Sequence[Connection], *, periodic: bool = False) -> tuple[int, ...]:
        """Return the fewest wraps at each stop with which the walk's orbit is found.

        Fewest stop by stop: none of them can be lowered alone.

        Raises:
            GoalMissed: no number of wraps up to MOST suffices; names the symbol at fault.
        """
        count = len(chain) if periodic else len(chain) - 1
        wraps, failed = [0] * count, self.solve(chain, [0] * count, periodic=periodic)
        raised: set[int] = set()
        while not failed.converged:
            beside = _stops_beside(failed, count, periodic)
            if not beside or max(wraps[k] for k in beside) >= MOST:
                raise GoalMissed(f"no wraps up to {MOST} suffice: {failed.status}")
            for k in beside:
                wraps[k] += 1
            raised.update(beside)
            failed = self.solve(chain, wraps, periodic=periodic)
        for k in sorted(raised):
            while wraps[k] > 0:
                fewer = [n - (j == k) for j, n in enumerate(wraps)]
                if not self.solve(chain, fewer, periodic=periodic).converged:
                    break
                wraps = fewer
        return tuple(wraps)

    def advice(self, orbit: ShadowingOrbit) -> str:
        """Return a sentence on the least wraps of a walk that failed, if fewer wraps are its fault."""
        try:
            least = self.least(orbit.connections, periodic=orbit.periodic)
        except GoalMissed as error:
            return str(error)
        if any(asked < enough for asked, enough in zip(orbit.wraps, least, strict=True)):
            return f"wraps {list(orbit.wraps)} are too few: the least that work are {list(least)}"
        return f"wraps {list(least)} work where {list(orbit.wraps)} do not"

    def _remember(self, orbit: ShadowingOrbit) -> None:
        chain = orbit.connections
        for k, count in enumerate(orbit.wraps):
            pair = (chain[k].name, chain[(k + 1) % len(chain)].name)
            self.least_seen[pair] = min(count, self.least_seen.get(pair, count))


def _stops_beside(orbit: ShadowingOrbit, count: int, periodic: bool) -> set[int]:
    """Return the stops on both sides of the symbol at fault."""
    fault = orbit.fault or 0
    if periodic:
        return {(fault - 1) % count, fault}
    return {k for k in (fault - 1, fault) if 0 <= k < count}
