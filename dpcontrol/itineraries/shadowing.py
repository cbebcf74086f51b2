"""The orbit that shadows a walk: it follows the connections in order and wobbles at each stop as often as asked.

A guess that is tiled from the connections is refined by multiple shooting: between the local manifolds of the first and
last periodic orbits, or closed.

Source: Kaheman et al. (2023), theorem 4.1, made constructive; the wraps between connections A and B are N = round((Δt -
time_in of A - time_out of B)/T - f), f the phase gap from A's arrival to B's departure (mod 1).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import InputError
from dpcontrol.itineraries.certificate import Certificate, certify
from dpcontrol.itineraries.closed import ClosedOrbit
from dpcontrol.itineraries.shooting import Shot, solve_shooting
from dpcontrol.itineraries.tiling import ShadowingSettings, Strands, first_guess, lattice_offsets, phase_gap
from dpcontrol.tubes.connecting_orbit import ConnectingOrbit
from dpcontrol.tubes.connection import Connection

Array = NDArray[np.float64]


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
    periodic: bool
    symbol_times: Array
    offsets: Array
    duration: float
    orbit: ConnectingOrbit | ClosedOrbit
    shot: Shot = field(repr=False)
    certificate: Certificate | None
    residual: float
    converged: bool
    status: str
    fault: int | None

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


def described(
    shot: Shot,
    chain: tuple[Connection, ...],
    wraps: Sequence[int],
    *,
    leads: tuple[int, int] = (2, 2),
    rivals: Sequence[Connection] = (),
) -> ShadowingOrbit:
    """Return a solved shot as the orbit of its walk: its times, what it realises, and its certificate."""
    guess = shot.guess
    system, periodic = guess.system, guess.closed
    nodes = np.array(sorted(guess.markers))
    elapsed = np.concatenate([[0.0], np.cumsum(shot.durations)])
    crossings = elapsed[nodes]
    first, last = chain[0], chain[-1]
    lead_in, lead_out = leads
    if periodic:
        duration = float(elapsed[-1])
        stays = np.append(np.diff(crossings), duration - crossings[-1] + crossings[0])
        times = elapsed
    else:
        stays = np.diff(crossings)
        times = elapsed - crossings[0] + first.time_out + lead_in * first.source.period
        duration = float(times[nodes[-1]]) + last.time_in + lead_out * last.target.period
    realised = realised_wraps(chain, stays)
    offsets = lattice_offsets(chain, wraps)
    converged, status, fault = shot.converged, shot.status, shot.fault
    certificate = None
    if converged:
        strays = _strays(shot, chain, nodes, offsets, rivals, realised, tuple(wraps))
        certificate = certify(shot, chain, nodes, stays)
        if strays is None:
            fault = None
        else:
            converged, (fault, status) = False, strays
    else:
        status = f"symbol {fault + 1} of {len(chain)} ({chain[fault].name}): {status}"
    if guess.turn is not None:
        orbit: ConnectingOrbit | ClosedOrbit = ClosedOrbit(
            system, times, shot.states, guess.turn, shot.residual, shot.iterations, converged, status
        )
    else:
        assert shot.ends is not None
        orbit = ConnectingOrbit(
            system, *shot.ends, times, shot.states, shot.residual, 0.0, shot.iterations, converged, status
        )
    return ShadowingOrbit(
        walk=tuple(c.name for c in chain),
        connections=chain,
        wraps=tuple(int(w) for w in wraps),
        wraps_realised=realised,
        lead_in=lead_in,
        lead_out=lead_out,
        periodic=periodic,
        symbol_times=times[nodes],
        offsets=offsets,
        duration=duration,
        orbit=orbit,
        shot=shot,
        certificate=certificate,
        residual=shot.residual,
        converged=converged,
        status=status,
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
        state = shot.states[node] - offsets[k] * system.turn_lengths
        own = _apart(system, state, connection.state)
        for rival in rivals:
            same_kind = (rival.source.saddle, rival.target.saddle, rival.winding, rival.section) == (
                connection.source.saddle,
                connection.target.saddle,
                connection.winding,
                connection.section,
            )
            # Equality of both is no crime: the walk's own connection is among the rivals.
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


def _check(chain: tuple[Connection, ...], wraps: Sequence[int], lead_in: int, lead_out: int, periodic: bool) -> None:
    if not chain:
        raise InputError("walk = []: a walk has at least one symbol")
    stops = len(chain) if periodic else len(chain) - 1
    if len(wraps) != stops:
        kind = "stops, as it closes" if periodic else "interior stops"
        raise InputError(
            f"wraps = {list(wraps)}: a walk of {len(chain)} symbols has {stops} {kind}; give one integer for each"
        )
    for name, values in (("wraps", wraps), ("lead_in", (lead_in,)), ("lead_out", (lead_out,))):
        for value in values:
            if isinstance(value, bool) or int(value) != value or value < 0:
                raise InputError(f"{name} = {value!r}: must be a whole number, zero or more")
    energies = {c.source.energy for c in chain}
    if len(energies) > 1:
        raise InputError(
            f"the walk mixes energies {sorted(energies)} J: one orbit keeps one energy; join references of different "
            "energies instead"
        )
    if periodic and chain[0].source.saddle != chain[-1].target.saddle:
        raise InputError(
            f"the walk starts at {chain[0].source.saddle} and ends at {chain[-1].target.saddle}: a periodic walk "
            "ends where it starts"
        )
