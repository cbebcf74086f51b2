"""Where the search for a shadowing orbit starts: its connections, joined in the middle of each stop.

At a stop between connections A and B the orbit stays near the periodic orbit for (N + f) periods T, f the phase gap
from A's arrival to B's departure (mod 1) and N the wraps. The guess follows A to the middle of the stop and B from
there, where both are within 1e-3 λ^(-N/2) of the periodic orbit. Never integrated on: a wobble is tiled.

Source: Kaheman et al. (2023), theorem 4.1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dpcontrol.itineraries.shooting import NewtonSettings
from dpcontrol.itineraries.shooting_equations import Guess
from dpcontrol.tubes.connecting_orbit import ManifoldEnd
from dpcontrol.tubes.connection import Connection

Array = NDArray[np.float64]


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
    lift = 0.0
    if section.period is not None:
        away = float(normal @ connection.state) - section.offset
        lift = float(np.rint(away / section.period)) * section.period
    return normal, section.offset + lift + float(normal @ shift)
