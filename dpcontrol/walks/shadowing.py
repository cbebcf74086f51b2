"""Shadowing orbits, which follow a walk with given wraps at each stop.

At a stop between connections A and B, the orbit stays near the periodic orbit for N + f periods T. Here f is the phase
gap from A's arrival to B's departure (mod 1), and N is the number of wraps,

    N = round((Δt - time_in of A - time_out of B)/T - f).

The initial guess follows A to the middle of the stop and B afterwards. Both are within 1e-3 λ^(-N/2) of the periodic
orbit there. The guess is assembled from samples without integration. Multiple shooting refines it, either between the
local manifolds of the first and last periodic orbits or as a closed orbit.

The minimum number of wraps (M_k in the theorem) is found for each walk, starting from zero. After a failure, one wrap
is added at the stops next to the failed symbol. Finally, each increased count is reduced as far as possible.

Source: Kaheman et al. (2023), theorem 4.1, made constructive.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import WalkCause, WrapsCause
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.shown import Timed, checked_times
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
from dpcontrol.words.searches import Concluded


@dataclass(frozen=True)
class ShadowingSettings:
    """Settings of the search for shadowing orbits.

    Attributes:
        segments: shooting nodes per period of the stop's orbit.
        amplitude: scaled distance of the ends from their orbits. The error of the local manifold is its square.
    """

    segments: int = 8
    amplitude: float = 1e-8
    newton: NewtonSettings = NewtonSettings()  # noqa: RUF009 - frozen, so it may be shared


def phase_gap(before: Connection, after: Connection) -> float:
    """Return the part of a period that a stop needs beyond whole wraps, so that arrival and departure are in phase.

    Args:
        before: connection to an orbit.
        after: next connection, which leaves this orbit.

    Returns:
        Phase from the arrival to the next departure, in [0, 1) of the orbit's period.
    """
    return (after.phase_out - before.phase_in) % 1.0


def passage(before: Connection, after: Connection, wraps: int) -> float:
    """Return the time (s) from one connection's section crossing to the next one's, if the stop between has its wraps.

    It uses the asymptotic phases, those of the point of the periodic orbit that a connection approaches for ever. The
    attributes phase_in and phase_out of connections are less exact: they refer to the point of the orbit that is
    nearest at a distance of 1e-3, and differ from the asymptotic phases by about as much.

    Args:
        before: connection to the stop.
        after: connection that leaves the stop.
        wraps: number of wraps at the stop.
    """
    arrival_phase, departure_phase = _asymptotic_phases(before, after)
    return (departure_phase - arrival_phase + stop_rounds(before, after, wraps)) * before.target.period


def stop_rounds(before: Connection, after: Connection, wraps: int) -> int:
    """Return the whole periods to add to the difference of two connections' phases, so that a stop has its wraps.

    The asymptotic phases are those of the point of the stop's orbit that a connection approaches for ever. They are
    known only up to whole periods. At a rotating orbit, each period shifts the next connection by one turn.

    Args:
        before: connection to an orbit.
        after: next connection, which leaves this orbit.
        wraps: periods of the orbit during the stop.
    """
    arrival_phase, departure_phase = _asymptotic_phases(before, after)
    periods_needed = (before.time_in + after.time_out) / before.target.period + wraps + phase_gap(before, after)
    return round(periods_needed - (departure_phase - arrival_phase))


def _asymptotic_phases(before: Connection, after: Connection) -> tuple[float, float]:
    """Return the phases on the stop's orbit (in periods) that belong to the section crossings of two connections.

    The first is the phase of the connection `before` at its crossing, extrapolated backward from its end on the stop's
    stable manifold. The second is that of `after`, extrapolated forward from its start on the unstable manifold.
    """
    period = before.target.period
    arrival, departure = before.orbit.end, after.orbit.start
    arrival_phase = arrival.orbit_phase - float(before.orbit.times[-1]) / period
    departure_phase = departure.orbit_phase - float(after.orbit.times[0]) / period
    return arrival_phase, departure_phase


class Strands:
    """Samples of connections at equal steps, shared by all walks.

    `_kept` holds states (K, N) from the section crossing outward, by the connection's name, its energy (J) and the side
    of the section, +1 after it and -1 before it. Samples are replaced when a longer stay needs more of them.
    """

    def __init__(self, segments: int) -> None:
        """Create an empty cache of samples with `segments` steps per period of the stop's orbit."""
        self.segments = segments
        self._kept: dict[tuple[str, float, int], Array] = {}

    def states(self, connection: Connection, sign: int, count: int) -> tuple[Array, float]:
        """Return equally spaced states of a connection from its section crossing outward, and the step between them.

        Args:
            connection: sampled connection.
            sign: +1 after the section, -1 before it.
            count: number of steps.

        Returns:
            States (count + 1, N), and the step, s, a fixed fraction of the target's period (for sign -1, of the
                source's).
        """
        period = (connection.target if sign > 0 else connection.source).period
        step = period / self.segments
        key = (connection.name, connection.source.energy, sign)
        samples = self._kept.get(key)
        if samples is None or len(samples) <= count:
            # One extra period, because longer stays with the same connection usually follow.
            samples = connection.orbit.sample(sign * step * np.arange(count + self.segments + 1.0))
            self._kept[key] = samples
        return samples[: count + 1], step


def first_guess(
    chain: Sequence[Connection],
    wraps: Sequence[int],
    *,
    periodic: bool = False,
    settings: ShadowingSettings | None = None,
    strands: Strands | None = None,
) -> Guess:
    """Return the initial guess of a walk's orbit: samples of its connections, joined in the middle of each stop.

    The guess consists of nodes and of the durations of the segments between them. Its `markers` are the nodes that
    Newton's method keeps on a section, one for each symbol: the index of the node, the section's normal n (N,) and the
    level of n·x, which shifts with the symbol's whole turns. Its `owners` are the indices of the nodes' symbols, its
    `joints` the segments between two connections. An open walk has two `ends` on the local manifolds of its first and
    last orbits; a closed walk has a `turn` (N,), the difference of its last and first node.

    Args:
        chain: connections of the walk.
        wraps: periods at each stop.
        periodic: True for a closed walk.
        settings: settings of the solver.
        strands: cache of sampled connections.
    """
    settings = settings or ShadowingSettings()
    strands = strands if strands is not None and strands.segments == settings.segments else Strands(settings.segments)
    system = chain[0].source.system
    offsets = lattice_offsets(chain, wraps)
    pairs = [(chain[k], chain[(k + 1) % len(chain)]) for k in range(len(wraps))]
    passages = [passage(first, second, count) for count, (first, second) in zip(wraps, pairs, strict=True)]
    stays = [time - first.time_in - second.time_out for time, (first, second) in zip(passages, pairs, strict=True)]
    states, durations, owners = [], [], []
    markers: dict[int, tuple[Array, float]] = {}
    ends: list[ManifoldEnd] = []
    joints: list[int] = []
    for k, connection in enumerate(chain):
        shift = offsets[k] * system.turn_lengths
        arriving = stays[k - 1] if k > 0 or periodic else None
        leaving = stays[k] if k < len(stays) else None
        steps_before = _count(connection, -1, arriving, settings)
        steps_after = _count(connection, +1, leaving, settings)
        before, step_before = strands.states(connection, -1, steps_before)
        after, step_after = strands.states(connection, +1, steps_after)
        if k == 0 and not periodic:
            ends.append(connection.orbit.start.moved(-steps_before * step_before - float(connection.orbit.times[0])))
        if leaving is None:
            end = connection.orbit.end.moved(steps_after * step_after - float(connection.orbit.times[-1]))
            ends.append(replace(end, turns=tuple(float(t) for t in np.asarray(end.turns) + offsets[k])))
        if k > 0:
            joints.append(len(durations))
            # The joint lasts for the rest of the stay, after whole steps.
            durations.append(_joint(chain[k - 1], connection, stays[k - 1], settings))
        normal = np.asarray(connection.section.normal)
        level = connection.section.level(connection.state) + float(normal @ shift)
        markers[len(owners) + steps_before] = normal, level
        states += [before[::-1] + shift, after[1:] + shift]
        durations += [step_before] * steps_before + [step_after] * steps_after
        owners += [k] * (steps_before + steps_after + 1)
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
    """Return the whole turns by which each symbol of a walk is shifted, since it starts where the previous one ends.

    Args:
        chain: connections of the walk (k,).
        wraps: periods at each stop.

    Returns:
        Turns (k + 1, N) of each coordinate at the symbols and after the last one; zero for the first symbol.
    """
    offsets = np.zeros((len(chain) + 1, chain[0].source.system.dimension))
    for k, connection in enumerate(chain):
        offsets[k + 1] = offsets[k]
        offsets[k + 1, : len(connection.winding)] += connection.winding
        if k < len(wraps):
            rounds = stop_rounds(connection, chain[(k + 1) % len(chain)], wraps[k])
            offsets[k + 1] += rounds * connection.target.whole_turns
    return offsets


def _count(connection: Connection, sign: int, stay: float | None, settings: ShadowingSettings) -> int:
    """Return the number of steps from a connection's section crossing to the middle of its stop or to its end.

    `sign` is +1 after the section and -1 before it. `stay` is the duration of the stop, s, or None at an end of an open
    walk. There, steps continue until the orbit is as near to its periodic orbit as `settings.amplitude`.
    """
    orbit, flight = (connection.target, connection.time_in) if sign > 0 else (connection.source, connection.time_out)
    step = orbit.period / settings.segments
    if stay is not None:
        return max(1, int((flight + stay / 2) / step))
    end = connection.orbit.end if sign > 0 else connection.orbit.start
    end_time = abs(float(connection.orbit.times[-1 if sign > 0 else 0]))
    further_periods = np.log(abs(end.amplitude) / settings.amplitude) / end.manifold.exponent
    return max(1, int(np.ceil((end_time + further_periods * orbit.period) / step)))


def _joint(before: Connection, after: Connection, stay: float, settings: ShadowingSettings) -> float:
    """Return the duration (s) of the segment in mid-stop that joins the samples of two connections.

    It is the rest of the time between their section crossings, which whole steps on both sides do not fill: less than
    two steps. `stay` is the duration of the stop, s.
    """
    step = before.target.period / settings.segments
    counts = _count(before, +1, stay, settings) + _count(after, -1, stay, settings)
    return before.time_in + stay + after.time_out - counts * step


@dataclass(frozen=True)
class ShadowingOrbit(Timed, Documented, Concluded):
    """An orbit that realises a walk from time 0 to `duration` s.

    A walk of k symbols has k - 1 stops, or k if periodic. The last stop then leads back to the first symbol.

    Attributes:
        walk: names of the connections.
        connections: connections of the walk.
        wraps: requested wraps at each stop.
        wraps_realised: counted on the result.
        lead_in: wraps before the first symbol.
        lead_out: wraps after the last symbol.
        symbol_times (k,): section crossings, s.
        offsets (k + 1, N): whole turns of each symbol and the final orbit.
        duration: duration, or the period of a closed walk, s.
        orbit: trajectory by multiple shooting.
        shot: result of the multiple shooting.
        estimate: estimate of the error, or None without convergence.
        cause: how the computation ended.
        fault: index of the failed symbol, or None.
        rival: name of the connection that the orbit follows instead of the failed symbol.
    """

    KEYS: ClassVar[str] = (
        "walk wraps wraps_realised lead_in lead_out periodic duration residual symbol_times converged cause status "
        "fault energy=connections.0.source.energy connections=connections.name"
    )

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
    cause: WalkCause
    fault: int | None = None
    rival: str = ""

    def __repr__(self) -> str:
        return f"<walk {', '.join(self.walk)}: {self.status}>"

    @property
    def periodic(self) -> bool:
        """True if the walk is closed."""
        return self.orbit.closed

    @property
    def residual(self) -> float:
        """The largest defect at a node (rad, rad/s)."""
        return self.orbit.residual

    @property
    def converged(self) -> bool:
        """True if Newton's method converged to the requested walk."""
        return self.fault is None

    @property
    def system(self) -> System:
        """The system of the walk."""
        return self.orbit.system

    @property
    def time_range(self) -> tuple[float, float]:
        """Zero and the duration, s."""
        return 0.0, self.duration

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the N entries of a state."""
        return self.system.columns

    def states(self, times: Any = None) -> Array:
        """Return the states at given times.

        Args:
            times: times (…) from the start, s; by default 200 over the whole walk.

        Returns:
            States (…, N), with whole turns counted.

        Raises:
            InputError: the times are not finite numbers.
        """
        return self.sample() if times is None else self.orbit.sample(checked_times(times))


def realised_wraps(connections: Sequence[Connection], stays: Array) -> tuple[int, ...]:
    """Return the number of wraps that an orbit makes at each stop, from the time between section crossings.

    A stop is a stay near the periodic orbit between two connections, and wraps are the whole periods of this stay.

    Args:
        connections: the walk. Stop k lies between connections k and k + 1.
        stays: times (S,) between the section crossings on either side of each of the S stops, s.

    Returns:
        Wraps (S,).
    """
    counts = []
    pairs = zip(connections, [*connections[1:], connections[0]], strict=True)
    # An open walk has no stop for the last pair, which leads from the last connection to the first.
    for seconds, (before, after) in zip(stays, pairs, strict=False):
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
    """Return the orbit that follows the connections of a walk in order, with given wraps at the stops between them.

    At a stop, the orbit stays near the periodic orbit between two connections; its wraps are periods of this orbit. If
    Newton's method does not converge to this walk, the result has the cause and is not `converged`.

    Args:
        connections: connections of the walk.
        wraps: number of periods at each stop.
        lead_in: periods on the first orbit.
        lead_out: periods on the last orbit.
        periodic: close the walk with one more stop.
        settings: settings of the solver.
        strands: cache of sampled connections.
        rivals: other connections that the orbit might follow by mistake.

    Raises:
        InputError: a wrong number of wraps, a negative wrap count, different energies, or a periodic walk with
            different ends.
    """
    settings = settings or ShadowingSettings()
    chain = tuple(connections)
    check_stops(chain, wraps, periodic=periodic)
    for name, value in (*(("wraps", count) for count in wraps), ("lead_in", lead_in), ("lead_out", lead_out)):
        if not 0 <= value <= MOST_WRAPS:
            raise InputError(f"{name} = {value}: must be 0 to {MOST_WRAPS:,}")
    if len(energies := {c.source.energy for c in chain}) > 1:
        unit = chain[0].source.system.unit("J")
        raise InputError(
            f"the walk mixes energies {sorted(energies)}{unit}: an orbit has constant energy; join references of "
            "different energies instead"
        )
    guess = first_guess(chain, wraps, periodic=periodic, settings=settings, strands=strands)
    shot = solve_shooting(guess, settings.newton)
    return described(shot, chain, wraps, leads=(lead_in, lead_out), rivals=rivals)


def walk_of_one(connection: Connection, text: str, *, lead_in: int = 2, lead_out: int = 2) -> ShadowingOrbit:
    """Return a connection that exists at one energy only as the walk of one symbol, without an error estimate.

    Args:
        connection: the connection.
        text: its symbol.
        lead_in: periods on the first orbit.
        lead_out: periods on the last orbit.
    """
    crossing_time = connection.time_out + lead_in * connection.source.period
    offsets = np.zeros((2, len(connection.state)))
    offsets[1, : len(connection.winding)] = connection.winding
    orbit = replace(connection.orbit, times=connection.orbit.times + crossing_time)
    return ShadowingOrbit(
        walk=(text,),
        connections=(connection,),
        wraps=(),
        wraps_realised=(),
        lead_in=lead_in,
        lead_out=lead_out,
        symbol_times=np.array([crossing_time]),
        offsets=offsets,
        duration=crossing_time + connection.time_in + lead_out * connection.target.period,
        orbit=orbit,
        # No walk was solved, so the shot has no derivatives from which an error could be estimated.
        shot=Shot(connection.solution, orbit, 0.0, None, np.nan, np.empty((0, 0, 0)), 0),
        estimate=None,
        cause=WalkCause.CONNECTION,
    )


def described(
    shot: Shot,
    chain: tuple[Connection, ...],
    wraps: Sequence[int],
    *,
    leads: tuple[int, int] = (2, 2),
    rivals: Sequence[Connection] = (),
) -> ShadowingOrbit:
    """Return a solved shot as a shadowing orbit with its error estimate and with the wraps and walk that it realises.

    If the shot did not converge, or follows another walk, the result's cause and its index of the failed symbol
    (`fault`) are set. Only a converged shot has an error estimate.

    Args:
        shot: last orbit of the multiple shooting, and the guess from which it started.
        chain: connections of the walk.
        wraps: periods at each stop.
        leads: periods on the first and the last orbit.
        rivals: connections that the orbit may follow by mistake.
    """
    guess, orbit = shot.guess, shot.orbit
    periodic = guess.closed
    nodes = np.array(sorted(guess.markers))
    crossings = orbit.times[nodes]
    first, last = chain[0], chain[-1]
    lead_in, lead_out = leads
    stays = np.diff(crossings)
    if periodic:
        # The last stop of a closed walk leads back to its first symbol.
        stays = np.append(stays, orbit.duration - stays.sum())
        times, duration = orbit.times - orbit.times[0], orbit.duration
    else:
        times = orbit.times + first.time_out + lead_in * first.source.period
        duration = float(times[nodes[-1]]) + last.time_in + lead_out * last.target.period
    realised = realised_wraps(chain, stays)
    offsets = lattice_offsets(chain, wraps)
    result = ShadowingOrbit(
        walk=tuple(c.name for c in chain),
        connections=chain,
        wraps=tuple(int(w) for w in wraps),
        wraps_realised=realised,
        lead_in=lead_in,
        lead_out=lead_out,
        symbol_times=times[nodes],
        offsets=offsets,
        duration=duration,
        orbit=replace(orbit, times=times),
        shot=shot,
        estimate=None,
        cause=WalkCause.CONVERGED,
    )
    if not orbit.converged:
        return replace(result, cause=WalkCause.SHOOTING, fault=shot.fault)
    estimate = estimate_error(shot, [connection.target for connection in chain[: len(stays)]])
    return _on_its_walk(replace(result, estimate=estimate), nodes, rivals)


def _on_its_walk(orbit: ShadowingOrbit, nodes: NDArray[np.intp], rivals: Sequence[Connection]) -> ShadowingOrbit:
    """Return the orbit unchanged if it follows its walk, otherwise with the failed symbol and the cause.

    Newton's method may converge to another walk. This is so if the orbit crosses a section nearer to another connection
    of the same kind, one of `rivals`, or if its counted wraps differ from the requested ones. Connections are of the
    same kind if their source, target, winding (whole turns of each arm) and section agree. `nodes` holds the indices of
    the orbit's nodes on the symbols' sections.
    """
    system = orbit.system
    for k, (connection, node) in enumerate(zip(orbit.connections, nodes, strict=True)):
        # A connection starts without whole turns, a symbol of the walk with those of the symbols before it.
        state = orbit.orbit.states[node] - orbit.offsets[k] * system.turn_lengths
        distance = _apart(system, state, connection.state)
        for rival in rivals:
            same_kind = (rival.source.saddle, rival.target.saddle, rival.winding, rival.section) == (
                connection.source.saddle,
                connection.target.saddle,
                connection.winding,
                connection.section,
            )
            # The rivals include the walk's own connection, so equal distances are allowed.
            if same_kind and _apart(system, state, rival.state) < distance:
                return replace(orbit, cause=WalkCause.RIVAL, fault=k, rival=rival.name)
    for k, (count, requested) in enumerate(zip(orbit.wraps_realised, orbit.wraps, strict=True)):
        if count != requested:
            return replace(orbit, cause=WalkCause.OTHER_WRAPS, fault=k)
    return orbit


def _apart(system: System, first: Array, second: Array) -> float:
    """Return the largest difference between two states (N,) in units of the system's scale."""
    return float(np.max(np.abs(first - second) / system.scale))


MOST_WRAPS = 1_000_000


def check_stops(chain: Sequence[Connection], wraps: Sequence[int] | None, *, periodic: bool) -> int:
    """Return the number of stops of a walk: one between neighbouring connections, and one more if it is closed.

    Args:
        chain: connections of the walk.
        wraps: periods at each stop; None if they are not given.
        periodic: True for a closed walk.

    Raises:
        InputError: a wrong number of wraps, or a periodic walk with different ends.
    """
    stops = len(chain) if periodic else len(chain) - 1
    if periodic and chain[0].source.saddle != chain[-1].target.saddle:
        raise InputError(
            f"the walk starts at {chain[0].source.saddle} and ends at {chain[-1].target.saddle}: a periodic walk "
            "must end where it starts"
        )
    if wraps is not None and len(wraps) != stops:
        kind = "stops if closed" if periodic else f"interior stop{'s' if stops != 1 else ''}"
        raise InputError(
            f"wraps = {list(wraps)}: a walk of {len(chain)} symbols has {stops} {kind}; give one integer for each"
        )
    return stops


MOST = 12
"""Largest number of wraps tried at a stop; λ^-12 is below rounding for λ > 20."""


@dataclass(frozen=True)
class FewestWraps(Concluded):
    """Result of a search for the fewest wraps of a walk.

    Attributes:
        wraps: counts at each stop of the last attempt.
        failed: its orbit if no number of wraps suffices, else None.
        tried: counts for which advice is wanted.
        most: largest count tried at a stop.
    """

    wraps: tuple[int, ...]
    failed: ShadowingOrbit | None
    tried: tuple[int, ...] = ()
    most: int = MOST

    @property
    def cause(self) -> WrapsCause:
        """Cause of the end of the search."""
        if self.failed is not None:
            return WrapsCause.NONE_SUFFICE
        fewer = any(count < enough for count, enough in zip(self.tried, self.wraps, strict=False))
        return WrapsCause.TOO_FEW if fewer else WrapsCause.OTHERS_WORK


@dataclass
class WalkSolver:
    """Solver for the walks of one graph, which stores the fewest wraps between neighbouring symbols.

    Attributes:
        rivals: all connections of the graph, to detect orbits that follow another one.
        settings: settings of the search for orbits.
        least_seen: fewest wraps with which an orbit was found so far, by the names of the connections before and after
            the stop.
    """

    rivals: Sequence[Connection]
    settings: ShadowingSettings = field(default_factory=ShadowingSettings)
    least_seen: dict[tuple[str, str], int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Create the samples that all walks share."""
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
        """Return the orbit of a walk with the given wraps.

        The orbit is compared with all connections of the graph, and its wraps are remembered as sufficient.

        Args:
            chain: connections of the walk.
            wraps: periods at each stop.
            periodic: True for a closed walk.
            lead_in: periods on the first orbit.
            lead_out: periods on the last orbit.

        Raises:
            InputError: the wraps do not match the walk.
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
        for k, count in enumerate(orbit.wraps if orbit.converged else ()):
            pair = (chain[k].name, chain[(k + 1) % len(chain)].name)
            self.least_seen[pair] = min(count, self.least_seen.get(pair, count))
        return orbit

    def least(self, chain: Sequence[Connection], *, periodic: bool = False) -> tuple[int, ...]:
        """Return the fewest wraps at each stop with which a walk has an orbit.

        Each count that was raised has been reduced as far as possible, one after the other.

        Args:
            chain: connections of the walk.
            periodic: True for a closed walk.

        Raises:
            GoalMissed: up to MOST wraps do not suffice; names the failed symbol.
        """
        fewest = self.fewest(chain, periodic=periodic)
        if fewest.failed is not None:
            raise GoalMissed(fewest.status, symbol=fewest.failed.fault)
        return fewest.wraps

    def fewest(self, chain: Sequence[Connection], *, periodic: bool = False) -> FewestWraps:
        """Search for the fewest wraps at each stop that give an orbit.

        Wraps are the periods for which the orbit stays near the periodic orbit between two connections. The search
        starts with none. After a failure, one wrap is added at the stops beside the failed symbol.

        Args:
            chain: connections of the walk.
            periodic: True for a closed walk.

        Returns:
            The wraps, or those and the orbit of the last attempt if up to MOST wraps at a stop do not suffice, or if
            the walk has no stop at which more wraps could help.
        """
        count = len(chain) if periodic else len(chain) - 1
        wraps, orbit = [0] * count, self.solve(chain, [0] * count, periodic=periodic)
        raised: set[int] = set()
        while not orbit.converged:
            neighbours = _stops_beside(orbit, count, periodic)
            if not neighbours or max(wraps[k] for k in neighbours) >= MOST:
                return FewestWraps(tuple(wraps), orbit)
            for k in neighbours:
                wraps[k] += 1
            raised.update(neighbours)
            orbit = self.solve(chain, wraps, periodic=periodic)
        # Counts were raised in pairs, so one of the two may be higher than necessary.
        for k in sorted(raised):
            while wraps[k] > 0:
                fewer = [n - (j == k) for j, n in enumerate(wraps)]
                if not self.solve(chain, fewer, periodic=periodic).converged:
                    break
                wraps = fewer
        return FewestWraps(tuple(wraps), None)

    def advice(self, orbit: ShadowingOrbit) -> FewestWraps:
        """Return the fewest wraps with which a failed walk has an orbit, as advice in the message of the failure.

        Args:
            orbit: result that has not converged.
        """
        return replace(self.fewest(orbit.connections, periodic=orbit.periodic), tried=orbit.wraps)

    def missed(self, orbit: ShadowingOrbit, what: str = "", *, first: int = 0) -> GoalMissed:
        """Return the error to raise for a failed walk, with its symbol and the wraps that work.

        Args:
            orbit: result that has not converged.
            what: beginning of the message.
            first: index of the orbit's first symbol in the whole walk.
        """
        advice = self.advice(orbit)
        wraps = advice.wraps if advice.failed is None else None
        return GoalMissed(f"{what}{orbit.status}; {advice.status}", symbol=first + (orbit.fault or 0), wraps=wraps)


def _stops_beside(orbit: ShadowingOrbit, count: int, periodic: bool) -> set[int]:
    """Return the indices of the stops before and after an orbit's failed symbol, at which more wraps may help.

    `count` is the number of the walk's stops. Stop k follows symbol k, and the last stop of a periodic walk precedes
    the first symbol.
    """
    fault = orbit.fault or 0
    if periodic:
        return {(fault - 1) % count, fault}
    return {k for k in (fault - 1, fault) if 0 <= k < count}
