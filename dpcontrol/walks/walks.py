"""Walks on the connection graph: resolve, list, count, draw, solve and save.

Counting and uniform sampling use powers of the matrix that holds the number of connections between saddles.

A shadowing orbit is itself a connection and can serve as an edge of longer walks, so the theorem is iterative. It
leaves the walk's first orbit and joins the last one, and its winding is the sum of its symbols' windings. Its section
is that of its first symbol, and its time is zero at this crossing. The part between the first and last symbols
belongs to its arrival, which ends when it comes near the last orbit after its last symbol.

Source: Kaheman et al. (2023), theorem 4.1.
"""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Exact, Section, digits
from dpcontrol.dynamics.system import System, momentum_scale
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.document import Documented, document_of, picked
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.files import write_archive
from dpcontrol.foundation.progress import Cost, Progress, announce, no_progress
from dpcontrol.foundation.settings import suggest
from dpcontrol.orbits.manifold import OrbitCurve
from dpcontrol.shooting.extended import ExtendedOrbit, refine
from dpcontrol.shooting.newton import ShootingOrbit
from dpcontrol.tubes.connections import Connection, angle_between, approach, connection_sense
from dpcontrol.tubes.intersections import ConnectionSettings
from dpcontrol.tubes.symmetric import SymmetricSearch, mirror_image
from dpcontrol.walks.atlas import walks
from dpcontrol.walks.edges import Edges, rotating_names
from dpcontrol.walks.shadowing import MOST_WRAPS, FewestWraps, ShadowingOrbit, WalkSolver, check_stops, walk_of_one
from dpcontrol.walks.symbols import ROTATING, Loss, Symbol, choose, composed, parse_walk

_FAR = 0.05  # scaled distance; exceeded between two stops, but not after the arrival at the last orbit
_MIRRORED = 1e-7  # scaled distance; above the error of states (1e-11), below the distance of near mirror images


def as_connection(orbit: ShadowingOrbit) -> Connection:
    """Return a converged open shadowing orbit as a connection, which longer walks can use as one symbol.

    Such a connection is a composite edge of the connection graph. Its name consists of its source and target, its
    winding (whole turns of each arm), its hits (crossing numbers of the section) and its symbols with their wraps. It
    is symmetric if a reverser, a matrix of time reversal, maps its part between the first and last symbols to itself.

    Args:
        orbit: converged orbit of an open walk.
    """
    first_symbol, last_symbol = orbit.connections[0], orbit.connections[-1]
    source, target, section = first_symbol.source, last_symbol.target, first_symbol.section
    system = source.system
    nodes = sorted(orbit.shot.guess.markers)
    motion = replace(orbit.orbit, times=orbit.orbit.times - orbit.symbol_times[0])
    state = motion.states[nodes[0]]
    winding = tuple(int(k) for k in orbit.offsets[-1][: len(first_symbol.winding)])
    # Reversed in time, the mirror image starts at the last symbol. Equal ends are not enough, so samples of the whole
    # part between the first and last symbols are compared.
    stay = float(orbit.symbol_times[-1] - orbit.symbol_times[0])
    middle_part = motion.sample(np.linspace(0.0, stay, 1 + 16 * (len(orbit.walk) - 1)))
    symmetric = source.saddle == target.saddle and any(
        float(
            system.scaled_distance((middle_part[::-1] - source.centre) @ reverser.T + source.centre, middle_part).max()
        )
        < _MIRRORED
        for reverser in system.reversers
    )
    approach_distance = ConnectionSettings().near
    time_out, phase_out = approach(motion, OrbitCurve(source), -1, approach_distance)
    curve = OrbitCurve(target)
    last_far_time = _last_far(motion, curve)
    time_in, phase_in = approach(replace(motion, times=motion.times - last_far_time), curve, +1, approach_distance)
    # A rotating orbit (`laps` is True) crosses the section itself, and its laps outside this span must not count.
    departure = -time_out if source.laps else float(motion.times[0])
    arrival = last_far_time + time_in if target.laps else float(motion.times[-1])
    hits = section_hits(motion, section, (departure, arrival))
    turns = ",".join(str(k) for k in winding)
    edge = Connection(
        name=f"{source.saddle}>{target.saddle}[{turns}]h{hits[0]}.{hits[1]}@{composed(orbit.walk, orbit.wraps)}",
        source=source,
        target=target,
        section=section,
        state=state,
        winding=winding,
        sense=0,
        symmetric=symmetric,
        residual=orbit.residual,
        transversality_angle=transversality_angle(orbit, nodes[0]),
        hits=hits,
        time_out=time_out,
        time_in=last_far_time + time_in,
        phase_out=phase_out,
        phase_in=phase_in,
        orbit=motion,
    )
    return replace(edge, sense=connection_sense(edge))


def _last_far(orbit: ShootingOrbit, curve: OrbitCurve) -> float:
    """Return the last time (s) at which a composite edge is still far from the periodic orbit that it joins.

    `orbit` has time zero at its first symbol's section crossing, and `curve` is the last periodic orbit. Far means at a
    scaled distance of more than 0.05. The edge's arrival is sought after this time only, since it may pass near that
    orbit at earlier stops too. Times before zero are not examined. If the edge is never far, the result is zero.
    """
    end_time = float(orbit.times[-1])
    grid = np.linspace(0.0, end_time, max(2, int(np.ceil(end_time / curve.orbit.period * 50))))
    far_samples = np.flatnonzero(curve.distances(orbit.sample(grid))[1] > _FAR)
    return float(grid[far_samples[-1]]) if far_samples.size else 0.0


def section_hits(
    orbit: ShootingOrbit, section: Section, span: tuple[float, float], *, per_segment: int = 40
) -> tuple[int, int]:
    """Return (n_u, n_s), the crossing number of time zero counted from the start and from the end of an orbit.

    At time zero, the unstable tube crosses the section for the n_u-th time, and the stable tube for the n_s-th time,
    which are the hits of a connection.

    Args:
        orbit: orbit that crosses the section at time zero.
        section: the section.
        span: time interval in which crossings count, s.
        per_segment: samples per shooting segment.
    """
    shares = np.linspace(0.0, 1.0, per_segment, endpoint=False)
    segment_times = orbit.times[:-1, None] + np.diff(orbit.times)[:, None] * shares
    grid = np.append(segment_times.ravel(), orbit.times[-1])
    grid = grid[(grid >= span[0]) & (grid <= span[1])]
    states = orbit.sample(grid)
    # A sheet is one of the parallel planes of an angle's section; its number changes at a crossing. `admits` tests the
    # section's condition on the side. The crossing at time zero lies on a node, so rounding decides its side of the
    # section. It is left out of both sums and counted by the 1.
    crossings = [k for k in np.flatnonzero(np.diff(section.sheets(states))) if section.admits(states[k])]
    spacing = float(np.diff(grid).max())
    crossings_before = sum(1 for k in crossings if grid[k + 1] < -spacing / 2)
    crossings_after = sum(1 for k in crossings if grid[k] > spacing / 2)
    return crossings_before + 1, crossings_after + 1


def transversality_angle(orbit: ShadowingOrbit, node: int) -> float:
    """Return the angle (deg) between the unstable and the stable manifold at a node, in section coordinates (q, p/p₀).

    Here q is the coordinate along the section and p its conjugate momentum in units of p₀. State-transition matrices
    (`stms`) propagate the unstable tangent forward from the first node and the stable tangent backward from the last
    node. Both propagations are contracting in direction, so errors of the first tangents vanish.

    Args:
        orbit: open shadowing orbit.
        node: index of a node on the first symbol's section.
    """
    shot = orbit.shot
    section, system = orbit.connections[0].section, shot.guess.system
    scale = system.scale
    # `point` returns the end's state and its derivative by the amplitude, which is the tangent.
    unstable = shot.orbit.start.point()[1] / scale
    for stm in shot.stms[:node]:
        unstable = (stm @ (unstable * scale)) / scale
        unstable = unstable / np.linalg.norm(unstable)
    stable = shot.orbit.end.point()[1] / scale
    for stm in shot.stms[node:][::-1]:
        stable = np.linalg.solve(stm, stable * scale) / scale
        stable = stable / np.linalg.norm(stable)
    tangents = [_on_section(system, section, shot.orbit.states[node], t * scale) for t in (unstable, stable)]
    return angle_between(*tangents)


def _on_section(system: System, section: Section, state: Array, tangent: Array) -> Array:
    """Project a tangent vector (N,) at a state (N,) onto the section along the flow.

    The result (2,) is in the section's coordinates: q along it, and the conjugate momentum p in units of p₀. The cuts
    of tubes are curves there, and the angle between two tangents is that of their manifolds.
    """
    rate, normal = system.numeric.rate(state), np.asarray(section.normal)
    across = tangent - rate * (normal @ tangent) / (normal @ rate)
    momentum = np.asarray(section.momentum) @ (system.numeric.momentum_jacobian(state) @ across)
    return np.array([np.asarray(section.position) @ across, momentum / momentum_scale(system, section)])


Walk = tuple[Connection, ...]
LISTED = 100_000
"""Largest number of walks to list; more can be counted."""


def symmetric_walk(
    walk: Sequence[str], search: SymmetricSearch, *, energy: float | None = None, lead_in: int = 2, lead_out: int = 2
) -> ShadowingOrbit:
    """Return the orbit of a walk of one symbol for three arms, whose connections exist at single energies.

    Args:
        walk: one symbol, such as "down-down-up +" or a connection's name.
        search: symmetric connections found.
        energy: selects the nearest matching connection, J; the lowest by default.
        lead_in: periods on the first orbit.
        lead_out: periods on the last orbit.

    Raises:
        InputError: the walk has several symbols, or no connection matches.
    """
    if len(walk) != 1:
        raise InputError(
            f"walk = {list(walk)}: connections of three arms exist at different energies and cannot follow one "
            "another; give each symbol as a separate walk"
        )
    (symbol,) = parse_walk(walk, [search.saddle])
    candidates = [image for candidate in search.connections for image in (candidate, mirror_image(candidate))]
    matching = [
        candidate
        for candidate in candidates
        if symbol.name in (None, candidate.name) and symbol.sense in (None, candidate.sense)
    ]
    if not matching:
        names = f" ({', '.join(candidate.name for candidate in candidates)})" if candidates else ""
        raise InputError(
            f"{walk[0]!r} matches no symmetric connection, {search.status}{names}; `dpcontrol connect --energies` "
            "lists those in any range"
        )
    nearest = min(
        matching,
        key=lambda candidate: candidate.source.energy if energy is None else abs(candidate.source.energy - energy),
    )
    return walk_of_one(nearest, walk[0], lead_in=lead_in, lead_out=lead_out)


def resolve(texts: Sequence[str], edges: Edges, loss: Loss | None = None) -> Walk:
    """Return the connections that the symbols of a walk select at one energy, one for each symbol.

    Args:
        texts: symbols of the walk, such as "down-up +", a connection's name or a composite edge.
        edges: connections at one energy.
        loss: function from a connection to its cost for the feedback, such as its peak gain. Connections of more than
            twice the smallest cost are not selected, see `choose`.

    Raises:
        InputError: a text is not a symbol, the walk is not connected, or a connection does not exist at this energy.
            The message gives the reason and the nearest existing walk.
        GoalMissed: a composite edge has no orbit with its wraps.
    """
    symbols = parse_walk(texts, vertex_names(edges.system))
    if edges.system.dimension == 6:
        raise InputError(
            "connections of three arms exist at different energies: find them with `dpcontrol connect --energies`, and "
            "use one in an itinerary, such as third-turn"
        )
    chain: list[Connection] = []
    for k, symbol in enumerate(symbols):
        try:
            chain.append(_connection(symbol, edges, loss))
        except GoalMissed as error:
            raise GoalMissed(f"symbol {k + 1} of {len(symbols)} ({symbol.text}): {error}", symbol=k) from error
        except InputError as error:
            reasons = [reason for saddle, reason in edges.absent if saddle in (symbol.source, symbol.target)]
            reason = f" ({'; '.join(reasons)})" if reasons else ""
            sentence = f"symbol {k + 1} of {len(symbols)}: {error}{reason}{_nearest(symbols, edges)}"
            raise InputError(sentence, symbol=k) from error
    return tuple(chain)


def vertex_names(system: System) -> list[str]:
    """Return the names that a walk's symbols may use for their stops: the system's saddles and fastest rotating orbits.

    Args:
        system: system of the graph.
    """
    return [*system.saddles, *rotating_names(system)]


def _connection(symbol: Symbol, edges: Edges, loss: Loss | None) -> Connection:
    """Return the connection that a symbol selects at the graph's energy.

    If the symbol is a composite edge, a walk in brackets, the orbit of this walk is solved and becomes the connection.
    `loss` is a function from a connection to its cost for the feedback, such as its peak gain; see `choose`.

    Raises:
        InputError: no connection matches, or the composite edge has another name than the symbol.
        GoalMissed: a composite edge has no orbit with its wraps.
    """
    if symbol.parts:
        solver = WalkSolver(edges.known)
        orbit = solver.solve([_connection(part, edges, loss) for part in symbol.parts], symbol.wraps)
        if not orbit.converged:
            raise solver.missed(orbit)
        composite_edge = as_connection(orbit)
        if symbol.name not in (None, composite_edge.name):
            raise InputError(f"no edge is named {symbol.name!r}: its symbols give {composite_edge.name!r}")
        return composite_edge
    pair = (symbol.source, symbol.target)
    candidates = edges.between(*pair)
    if symbol.name is not None:
        candidates += tuple(c for c in edges.named if (c.source.saddle, c.target.saddle) == pair)
    elif not candidates and any(name in ROTATING for name in pair):
        searches = [search for search in edges.incomplete if (search.source.saddle, search.target.saddle) == pair]
        reason = f" ({searches[0].status})" if searches else ""
        place = f"{edges.energy:g}{edges.system.unit('J')}"
        raise InputError(f"{symbol.text!r}: no such connection was found at {place}{reason}; try another energy")
    return choose(symbol, candidates, loss)


def _nearest(symbols: Sequence[Symbol], edges: Edges) -> str:
    """Return the end of an error message that names an existing walk with as many of the requested stops as possible.

    The text is empty if no walk leads through two of the stops.
    """
    stops = [symbols[0].source, *(s.target for s in symbols)]
    stops_with_orbits = [stop for stop in stops if stop in edges.orbits]
    # Stops are dropped from the end; as a last resort, any connection between them is offered.
    candidate_stops = [stops_with_orbits[:count] for count in range(len(stops_with_orbits), 1, -1)]
    candidate_stops += sorted(edges.searched, key=lambda pair: -len(set(pair) & set(stops)))
    for candidate in candidate_stops:
        with suppress(InputError):
            return "; the nearest existing walk is " + ", ".join(f"{c.name!r}" for c in through(candidate, edges))
    return ""


def ways(stops: Sequence[str]) -> tuple[Symbol, ...]:
    """Return one symbol for each two successive stops, which leaves the connection between them open.

    Args:
        stops: names of saddles or rotating orbits (k,), in order.

    Returns:
        Symbols (k - 1,) such as "down-up > up-down", without a sense.
    """
    return tuple(Symbol(f"{a} > {b}", a, b, None, None) for a, b in pairwise(stops))


def through(stops: Sequence[str], edges: Edges) -> Walk:
    """Return the shortest walk that visits saddles in order, with other stops between them if necessary.

    Each step uses the most transversal connection, preferably symmetric. A repeated stop gives a homoclinic connection.

    Args:
        stops: names of saddles, in order.
        edges: connections at one energy.

    Raises:
        InputError: fewer than two stops, an unknown saddle, or no path between successive stops.
    """
    import networkx as nx

    if len(stops) < 2:
        raise InputError(f"stops = {list(stops)}: must have at least two, for the start and the end")
    graph, place = edges.graph(), f"{edges.energy:g}{edges.system.unit('J')}"
    chain: list[Connection] = []
    for stop in stops:
        if stop not in graph:
            raise InputError(f"{stop!r} has no orbit at {place}: {suggest(stop, edges.orbits)}")
    for source, target in pairwise(stops):
        if not (graph.has_edge(source, target) or (source != target and nx.has_path(graph, source, target))):
            raise InputError(f"no walk at {place} leads from {source} to {target}; try a higher energy")
        path = [source, target] if source == target else nx.shortest_path(graph, source, target)
        chain += [choose(way, edges.between(way.source, way.target)) for way in ways(path)]
    return tuple(chain)


def _matrix(edges: Edges) -> tuple[list[str], NDArray[np.object_]]:
    """Return the k names of the graph's orbits and the matrix (k, k) of the number of connections from row to column.

    Its n-th power counts the walks of n symbols. Entries are Python's integers, since these counts exceed 64 bits.
    """
    import networkx as nx

    names = list(edges.orbits)
    # Whole numbers of Python have any length.
    return names, nx.to_numpy_array(edges.graph(), nodelist=names, dtype=np.dtype(int)).astype(object)


def count_walks(edges: Edges, length: int, *, source: str | None = None, target: str | None = None) -> int:
    """Return the number of walks with a number of symbols on the connection graph.

    Args:
        edges: connections at one energy.
        length: number of symbols.
        source: name of the first stop, or None for any.
        target: name of the last stop, or None for any.

    Raises:
        InputError: a saddle without an orbit.
    """
    names, counts = _matrix(edges)
    _check(edges, source, target)
    counts_of_walks = np.linalg.matrix_power(counts, length)
    rows = [k for k, name in enumerate(names) if source in (None, name)]
    columns = [k for k, name in enumerate(names) if target in (None, name)]
    return int(counts_of_walks[np.ix_(rows, columns)].sum())


def listed(
    edges: Edges, length: int, *, source: str | None = None, target: str | None = None, periodic: bool = False
) -> list[Walk]:
    """Return every walk with a number of symbols on the connection graph.

    Args:
        edges: connections at one energy.
        length: number of symbols.
        source: name of the first stop, or None for any.
        target: name of the last stop, or None for any.
        periodic: closed walks only.

    Raises:
        InputError: a saddle without an orbit, or more walks than can be listed.
    """
    total = count_walks(edges, length, source=source, target=target)
    if total > LISTED:
        count = f"{total:,}" if total < 10**12 else f"about 10^{int(total.bit_length() * math.log10(2))}"
        raise InputError(
            f"length = {length}: there are {count} such walks, and {LISTED:,} can be listed; draw some with "
            "--random (random_walks in Python)"
        )
    graph, connections = edges.graph(), {c.name: c for c in edges.connections}
    name_lists = (
        symbols
        for stop in edges.orbits
        if source in (None, stop)
        for symbols in walks(graph, stop, target=target, length=length)
    )
    chains = (tuple(connections[name] for name in walk) for walk in name_lists)
    return [chain for chain in chains if not periodic or chain[0].source.saddle == chain[-1].target.saddle]


def random_walk(edges: Edges, length: int, generator: np.random.Generator, *, periodic: bool = False) -> Walk:
    """Draw a walk on the connection graph, such that all walks of this length are equally likely.

    Args:
        edges: connections at one energy.
        length: number of symbols.
        generator: random generator, which is advanced.
        periodic: True for closed walks only.

    Raises:
        InputError: there is no such walk.
    """
    names, counts = _matrix(edges)
    # Entry (i, j) of power k counts the walks of k symbols from i to j. Each step is drawn in proportion to the number
    # of ways in which the walk can be completed, so that all walks are equally likely.
    powers = [np.linalg.matrix_power(counts, k) for k in range(length + 1)]
    ones = np.ones(len(names), dtype=object)
    start_weights = np.array(
        [powers[length][k, k] if periodic else (powers[length] @ ones)[k] for k in range(len(names))]
    )
    if not start_weights.sum():
        place, kind = f"{edges.energy:g}{edges.system.unit('J')}", "closed walk" if periodic else "walk"
        raise InputError(f"no {kind} of {length} symbols exists at {place}")
    stop = start = _drawn(start_weights, generator)
    chain: list[Connection] = []
    for remaining in range(length - 1, -1, -1):
        leaving = edges.leaving(names[stop])
        end_stops = [names.index(c.target.saddle) for c in leaving]
        weights = np.array(
            [powers[remaining][e, start] if periodic else (powers[remaining] @ ones)[e] for e in end_stops]
        )
        connection = leaving[_drawn(weights, generator)]
        chain.append(connection)
        stop = names.index(connection.target.saddle)
    return tuple(chain)


def _drawn(weights: NDArray[np.object_], generator: np.random.Generator) -> int:
    """Draw an index of `weights` with probability proportional to its entry, an integer of any size."""
    total = weights.sum()
    shares = np.array([float(weight / total) for weight in weights])
    return int(generator.choice(len(shares), p=shares / shares.sum()))


def _check(edges: Edges, source: str | None, target: str | None) -> None:
    """Reject a name of a first or last stop that has no orbit in the graph; None stands for any stop.

    Raises:
        InputError: the saddle has no orbit at this energy; the message gives the reason.
    """
    for saddle in (source, target):
        if saddle is not None and saddle not in edges.orbits:
            reasons = [reason for name, reason in edges.absent if name == saddle]
            raise InputError(f"{saddle!r}: {reasons[0] if reasons else suggest(saddle, edges.orbits)}")


FORMAT = 1
"""Version of the file format of a walk's orbit."""


@dataclass(frozen=True)
class WalkRequest(Documented):
    """A walk to solve.

    Attributes:
        chain: connections of the walk.
        periodic: True for a closed walk.
        wraps: at each stop, or None for the fewest possible.
        extra: wraps added to the fewest possible.
        lead_in: wraps before the first symbol.
        lead_out: wraps after the last symbol.
    """

    KEYS: ClassVar[str] = "walk=chain.name wraps periodic"

    chain: Walk
    periodic: bool
    wraps: tuple[int, ...] | None
    extra: tuple[int, ...]
    lead_in: int = 2
    lead_out: int = 2

    def __repr__(self) -> str:
        return f"<walk to solve: {', '.join(c.name for c in self.chain)}>"


@dataclass(frozen=True)
class WalkAnswer:
    """Orbit of a requested walk, with the fewest sufficient wraps.

    Attributes:
        least: fewest sufficient wraps; None if the request gives the wraps, or if no number of wraps suffices.
        orbit: None if no number of wraps suffices.
        seconds: solution time, s, without the search for the fewest wraps.
        advice: result of the search for wraps that suffice, if the orbit was not found, else None.
        refined: orbit in extended precision, if requested.
        file: file of the orbit, if it was saved.
    """

    request: WalkRequest
    least: tuple[int, ...] | None
    orbit: ShadowingOrbit | None
    seconds: float
    advice: FewestWraps | None = None
    refined: ExtendedOrbit | None = None
    file: Path | None = None

    @property
    def status(self) -> str:
        """The outcome in words."""
        parts = (self.orbit, self.advice) if self.refined is None else (self.refined,)
        return "; ".join(part.status for part in parts if part is not None)

    @property
    def converged(self) -> bool:
        """True if the orbit converged in the requested precision."""
        shadows = self.orbit is not None and self.orbit.converged
        return shadows and (self.refined is None or self.refined.converged)

    def document(self) -> dict[str, Any]:
        """Return the document printed by `dpcontrol walk --solve --json`."""
        orbit, refined = self.orbit, self.refined
        document = {**self.request.document(), **document_of(self, "least_wraps=least seconds converged status file")}
        if orbit is None:
            return document | dict.fromkeys(("wraps", "wraps_realised", "residual", "duration", "iterations"))
        figures = "wraps wraps_realised residual duration iterations=orbit.iterations symbol_times"
        document |= document_of(orbit, figures) | {"certificate": _estimate(orbit)}
        if not orbit.periodic and len(orbit.walk) > 1:
            document["edge"] = composed(orbit.walk, orbit.wraps)
        if refined is not None:
            # Strings of digits replace doubles; times start at the first symbol's section.
            document |= {
                "precision": "extended",
                "state": refined.digits,
                "state_double": orbit.orbit.states[min(orbit.shot.guess.markers)],
                "period": str(refined.duration) if orbit.periodic else None,
                "symbol_times_digits": digits(refined.times[refined.marked]),
                "residual": f"{float(refined.residual):.3e}",
                "residual_double": orbit.residual,
                "correction": refined.correction,
            }
        return document


def drawn_requests(
    edges: Edges,
    count: int,
    *,
    lengths: tuple[int, int],
    extra: tuple[int, int],
    seed: int,
    periodic: bool,
    leads: tuple[int, int] = (2, 2),
) -> list[WalkRequest]:
    """Draw `count` walks on the connection graph with random lengths and random wraps beyond the fewest possible.

    Args:
        edges: connections at one energy.
        count: number of walks.
        lengths: inclusive range.
        extra: wraps added to the fewest possible, inclusive range.
        seed: seed of the random generator.
        periodic: draw closed walks.
        leads: periods on the first and last orbits.

    Raises:
        InputError: an empty range, or no such walk at this energy.
    """
    for name, (low, high), least in (("lengths", lengths, 1), ("extra wraps", extra, 0)):
        if not least <= low <= high <= MOST_WRAPS:
            raise InputError(
                f"{name} {low} to {high}: must be two whole numbers from {least} to {MOST_WRAPS:,} in ascending order"
            )
    generator = np.random.default_rng(seed)
    requests = []
    for _ in range(count):
        length = int(generator.integers(lengths[0], lengths[1] + 1))
        chain = random_walk(edges, length, generator, periodic=periodic)
        stops = length if periodic else length - 1
        extra_wraps = tuple(int(n) for n in generator.integers(extra[0], extra[1] + 1, stops))
        requests.append(WalkRequest(chain, periodic, None, extra_wraps, *leads))
    return requests


@dataclass(frozen=True)
class WalkSelection:
    """Walks of a graph, selected in one of four ways, and their wraps.

    Attributes:
        symbols: symbols of one walk.
        through: stops of one walk, the shortest.
        length: number of symbols of all walks, from `source` to `target` if these are given.
        random: number of walks to draw with `seed`, with least and greatest `lengths`.
        periodic: closed walks only.
        wraps: at the stops of one walk, or None for the fewest that suffice.
        extra_wraps: range of wraps in addition to the fewest at each stop.
        leads: periods on the first and the last orbit.
    """

    symbols: Sequence[str] = ()
    through: Sequence[str] = ()
    length: int | None = None
    source: str | None = None
    target: str | None = None
    random: int | None = None
    lengths: tuple[int, int] = (1, 8)
    seed: int = 0
    periodic: bool = False
    wraps: Sequence[int] | None = None
    extra_wraps: tuple[int, int] = (0, 0)
    leads: tuple[int, int] = (2, 2)

    @property
    def selected_by(self) -> list[str]:
        """Names of the ways in which the attributes select walks; more than one is a contradiction."""
        return [name for name in ("symbols", "through", "length", "random") if getattr(self, name)]

    def check(self, *, solve: bool, yes: bool) -> None:
        """Reject contradictory selections, and announce long work before it begins.

        Args:
            solve: the walks' orbits are requested.
            yes: accept work of any duration.

        Raises:
            InputError: two ways of selecting walks, wraps of several walks, or too much work.
        """
        names, stops = self.selected_by, self.symbols or self.through
        if len(names) > 1:
            raise InputError(f"{' and '.join(names)} both select walks: give one of them")
        if self.wraps is not None and not stops:
            raise InputError(
                "wraps belong to one walk: give its symbols or the stops to go through, or use extra_wraps"
            )
        if self.random is not None:
            key = "random" if self.random > max(self.lengths) else "lengths"
            self._announce(self.random, max(self.lengths), key, solve=solve, yes=yes)
        elif stops:
            self._announce(1, len(stops), "wraps" if self.wraps else names[0], solve=solve, yes=yes)

    def _announce(self, count: int, longest: int, key: str, *, solve: bool, yes: bool) -> None:
        """Report the cost of `count` walks of up to `longest` symbols, and reject long work that `yes` does not accept.

        The message names `key`, the option that sets the cost; `solve` includes the solution of the orbits.
        """
        wraps = max(sum(self.wraps or ()), self.extra_wraps[1] * longest)
        announce(walks_cost(count, symbols=longest, wraps=wraps, solve=solve, key=key), yes=yes)

    def parsed(self, system: System) -> tuple[Symbol, ...]:
        """Return the symbols of one walk, or those for any connection between its stops.

        Args:
            system: system of the graph.
        """
        return parse_walk(self.symbols, vertex_names(system)) if self.symbols else ways(self.through)

    def requests(self, edges: Edges, *, solve: bool, yes: bool) -> tuple[WalkRequest, ...]:
        """Return the selected walks of a graph, each with the wraps that its orbit must make.

        Args:
            edges: connections at one energy.
            solve: the walks' orbits are requested.
            yes: accept work of any duration.

        Raises:
            InputError: no such walk, or too many.
        """
        if self.random is not None:
            return tuple(
                drawn_requests(
                    edges,
                    self.random,
                    lengths=self.lengths,
                    extra=self.extra_wraps,
                    seed=self.seed,
                    periodic=self.periodic,
                    leads=self.leads,
                )
            )
        if self.length is None:
            walks = [resolve(self.symbols, edges) if self.symbols else through(self.through, edges)]
        else:
            walks = listed(edges, self.length, source=self.source, target=self.target, periodic=self.periodic)
            self._announce(len(walks), self.length, "length", solve=solve, yes=yes)
        wraps = None if self.wraps is None else tuple(self.wraps)
        stops = [check_stops(walk, wraps, periodic=self.periodic) for walk in walks]
        return tuple(
            WalkRequest(walk, self.periodic, wraps, (self.extra_wraps[0],) * count, *self.leads)
            for walk, count in zip(walks, stops, strict=True)
        )


@dataclass(frozen=True)
class WalkList(Documented):
    """Walks of a graph without their orbits.

    Attributes:
        edges: graph of the walks.
        walks: walks in order.
    """

    KEYS: ClassVar[str] = "energy=edges.energy count=#walks walks notes=edges.notes"

    edges: Edges
    walks: tuple[WalkRequest, ...]


@dataclass(frozen=True)
class SolvedWalks(Documented):
    """Walks of a graph with their orbits.

    Attributes:
        edges: graph of the walks.
        answers: walks with their orbits, in order.
        least_seen: fewest sufficient wraps between two connections, by their names.
        picture, film: files that show the orbit, if they were written.
    """

    edges: Edges
    answers: tuple[WalkAnswer, ...]
    least_seen: Mapping[tuple[str, str], int]
    picture: Path | str | None = None
    film: Path | str | None = None

    @property
    def converged(self) -> bool:
        """True if every orbit converged in the requested precision."""
        return all(answer.converged for answer in self.answers)

    @property
    def status(self) -> str:
        """Number of the orbits, and the cause of the first failure."""
        failed = [(k, answer.status) for k, answer in enumerate(self.answers, start=1) if not answer.converged]
        status = f"{len(self.answers) - len(failed)} of {len(self.answers)} walks converged"
        return "; walk ".join([status, *("{}: {}".format(*failure) for failure in failed[:1])])

    def document(self) -> dict[str, Any]:
        """Return the document printed by `dpcontrol walk --solve --json`."""
        return {
            "energy": self.edges.energy,
            "walks": [answer.document() for answer in self.answers],
            "least_seen": [{"before": a, "after": b, "wraps": n} for (a, b), n in sorted(self.least_seen.items())],
            "notes": self.edges.notes,
            **picked(self, "picture", "film", "status"),
        }


def solve_walks(
    walks: WalkList,
    *,
    energy: Exact | None = None,
    parameters: Sequence[Exact] | None = None,
    folder: Path | None = None,
    progress: Progress = no_progress,
) -> SolvedWalks:
    """Solve walks, and refine and save their orbits on request.

    Args:
        walks: walks of one graph.
        energy: exact energy, J, to refine the orbits in 113-bit arithmetic (default: not refined).
        parameters: exact values (p,) of the equations' parameters (default: those of the system).
        folder: folder for the orbits that converge; none by default.
        progress: called with a label and the completed share.

    Raises:
        GoalMissed: a periodic orbit cannot be refined, or the machine has no 113-bit floating-point type.
        InputError: a file cannot be written.
    """
    edges, solver, count = walks.edges, WalkSolver(walks.edges.connections), len(walks.walks)
    answers: list[WalkAnswer] = []
    for k, answer in enumerate(solved(walks.walks, solver)):
        if energy is not None and answer.orbit is not None and answer.converged:
            progress("refining in 113-bit arithmetic", (k + 0.5) / count)
            refined = refine(answer.orbit.shot.solution, energy=energy, parameters=parameters)
            answer = replace(answer, refined=refined)
        if folder is not None and answer.orbit is not None and answer.converged:
            file = folder / f"walk-{k + 1}.npz"
            save_walk(file, edges.system.name, answer.orbit, refined=answer.refined)
            answer = replace(answer, file=file)
        answers.append(answer)
        progress("walks", (k + 1) / count)
    return SolvedWalks(edges, tuple(answers), solver.least_seen)


_DRAWN, _SOLVED_SYMBOL, _SOLVED_WRAP, _TRIED = 5e-4, 0.05, 0.01, 0.002
"""Time, s: to draw a symbol, to solve a symbol, to solve a wrap, and to find the fewest wraps per pair of symbols. The
last term is quadratic because each increase of a count requires a new solution."""
_NODES, _NODE_BYTES = 8, 7_000.0
"""Nodes per period of an orbit, and memory per node in bytes."""


def walks_cost(count: int, *, symbols: int, wraps: int, solve: bool, key: str) -> Cost:
    """Estimate the time and memory of drawing and solving walks, for a message before long work.

    Args:
        count: number of walks.
        symbols: symbols of each walk.
        wraps: total wraps of each walk.
        solve: include the solution of the orbits.
        key: name of the option that sets the cost.
    """
    seconds, memory = _DRAWN * count * symbols, 200.0 * count * symbols
    work = f"{count:,} walk{'s' if count > 1 else ''} of up to {symbols:,} symbols"
    if not solve:
        return Cost(work, seconds, memory, key)
    nodes = _NODES * (wraps + symbols)
    seconds += count * (_SOLVED_SYMBOL * symbols + _TRIED * symbols**2 + _SOLVED_WRAP * wraps)
    return Cost(f"{work}, {nodes:,} states each,", seconds, memory + _NODE_BYTES * nodes, key)


def solved(requests: Sequence[WalkRequest], solver: WalkSolver) -> Iterator[WalkAnswer]:
    """Yield the orbit of each requested walk, in order and as soon as it is solved.

    Args:
        requests: walks of one graph.
        solver: solver of that graph.
    """
    if requests:
        # One-off compilation and sampling should not count towards the first walk's time.
        solver.solve(requests[0].chain[:1], ())
    for request in requests:
        yield _solve_request(request, solver)


def _solve_request(request: WalkRequest, solver: WalkSolver) -> WalkAnswer:
    """Return the orbit of a walk with the requested wraps, or with the fewest that suffice and the requested extra
    ones.

    If up to MOST wraps at a stop do not suffice, the answer has no orbit. If the orbit does not converge, the answer
    holds this orbit and, as advice, the fewest wraps that suffice, if any do.
    """
    fewest_wraps, wraps = None, request.wraps
    if wraps is None:
        fewest = solver.fewest(request.chain, periodic=request.periodic)
        if fewest.failed is not None:
            return WalkAnswer(request, None, None, 0.0, fewest)
        fewest_wraps = fewest.wraps
        wraps = tuple(n + extra_wraps for n, extra_wraps in zip(fewest_wraps, request.extra, strict=True))
    begin = time.perf_counter()
    orbit = solver.solve(
        request.chain, wraps, periodic=request.periodic, lead_in=request.lead_in, lead_out=request.lead_out
    )
    seconds = time.perf_counter() - begin
    return WalkAnswer(request, fewest_wraps, orbit, seconds, None if orbit.converged else solver.advice(orbit))


_ESTIMATE = (
    "condition kantorovich radius energy_error departure stops multipliers?:log_unstable,log_stable,sign,reciprocity"
)
"""Entries of an error estimate, with logarithms of a periodic orbit's Floquet multipliers."""


def _estimate(orbit: ShadowingOrbit) -> dict[str, Any] | None:
    """Return the error estimate of a walk's orbit as entries of a document or a file's header, None without one."""
    return None if orbit.estimate is None else document_of(orbit.estimate, _ESTIMATE)


def save_walk(path: Path, model: str, orbit: ShadowingOrbit, *, refined: ExtendedOrbit | None = None) -> None:
    """Write the orbit of a walk to a .npz file, which numpy alone can read.

    The file has a `header` (JSON text) and these arrays:

        times (K + 1,)            node times, s
        states (K + 1, N)         node states (rad, rad/s), connected by the conservative equations
        symbol_times (k,)         section crossings, s
        turn (N,)                 increment of a periodic orbit per period, or zeros
        times_digits (L + 1,)     with `refined`: s from the first symbol's section, decimal strings
        states_digits (L + 1, N)  with `refined`: decimal strings

    Args:
        path: file to write.
        model: name of the model, for the header.
        orbit: orbit of the walk.
        refined: the same orbit in 113-bit arithmetic.
    """
    header = {
        "format": FORMAT,
        "kind": "shadowing orbit",
        "model": model,
        "energy": orbit.connections[0].source.energy,
        "walk": list(orbit.walk),
        "wraps": list(orbit.wraps),
        "wraps_realised": list(orbit.wraps_realised),
        **picked(orbit, "periodic", "lead_in", "lead_out", "duration", "residual", "status"),
        "certificate": _estimate(orbit),
    }
    turn = orbit.orbit.turn
    arrays: dict[str, Any] = {
        **picked(orbit.orbit, "times", "states"),
        "symbol_times": orbit.symbol_times,
        "turn": np.zeros(orbit.orbit.states.shape[1]) if turn is None else turn,
    }
    if refined is not None:
        arrays["times_digits"] = np.array(digits(refined.times))
        arrays["states_digits"] = np.array([digits(state) for state in refined.states])
    write_archive(path, header, arrays, compressed=True)
