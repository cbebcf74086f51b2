"""The connection graph of periodic orbits at one energy.

The graph contains the orbits of all saddles. A rotating orbit is added if a walk names it, for example
"outer-rotating" or "inner-rotating-back-2". The name consists of the rotating arm, "-back" for clockwise rotation, and
the rank among the hyperbolic orbits, fastest first. Its connections with saddle orbits are found on successive laps of
its tube. At a rotating orbit, one wrap is one turn.

Source: Kaheman et al. (2023), section 4.
"""

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.budget import Budget
from dpcontrol.foundation.checked import checked
from dpcontrol.foundation.document import Documented, counted
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Cost, Progress, announce, no_progress, part_of
from dpcontrol.foundation.settings import check_choice
from dpcontrol.foundation.shown import Brief, Shown
from dpcontrol.orbits.cut import Cut, tube_cut
from dpcontrol.orbits.lyapunov import LyapunovOrbit, lyapunov_orbit
from dpcontrol.orbits.manifold import OrbitCurve, UnstableManifold, local_manifold
from dpcontrol.orbits.rotating import can_rotate, rotating_orbits
from dpcontrol.orbits.vertex import HyperbolicOrbit, rotating_vertex
from dpcontrol.tubes.connections import (
    Connection,
    ConnectionSearch,
    can_be_reversed,
    find_connections,
    find_lap_connections,
    grown_crossing,
    own_crossings,
    reversed_search,
)
from dpcontrol.tubes.intersections import ConnectionSettings
from dpcontrol.walks.atlas import connection_graph
from dpcontrol.walks.symbols import ROTATING, Symbol

if TYPE_CHECKING:
    import networkx as nx

_LONGER = 3
"""Crossings tried after the first; each one stretches the cut by |λ| and slows the search."""
_ARMS = {"inner": 1, "outer": 2}


def rotating_names(system: System) -> list[str]:
    """Return the names of a system's fastest rotating orbits, one per arm and direction; none if it has no such orbits.

    Args:
        system: system of the graph.
    """
    return [text for text, name in ROTATING.items() if name.rank == 1] * can_rotate(system)


def rotating_named(system: System, name: str, energy: float) -> HyperbolicOrbit:
    """Return the rotating orbit of this name at an energy, as a stop of walks.

    Args:
        system: system of two arms.
        name: name such as "outer-rotating" or "inner-rotating-back".
        energy: energy of the orbit, J.

    Raises:
        InputError: the orbit was not found, or the system does not have two arms.
    """
    if name not in ROTATING:
        raise InputError(f"{name!r} is not a rotating orbit; choose from {', '.join(rotating_names(system))}")
    rotation = ROTATING[name]
    orbits = rotating_orbits(system, _ARMS[rotation.arm], energy, sense=rotation.sense)
    hyperbolic = [orbit for orbit in reversed(orbits) if orbit.hyperbolic]
    if rotation.rank > len(hyperbolic):
        raise InputError(
            f"no {name!r} at {energy:g} J: {len(orbits)} orbits were found that rotate the {rotation.arm} arm in this "
            f"direction, {len(hyperbolic)} of them hyperbolic; try another energy (`dpcontrol orbit --rotating "
            f"{rotation.arm}` lists them)"
        )
    return rotating_vertex(hyperbolic[rotation.rank - 1], name=name)


def rotating_connections(
    source: LyapunovOrbit, target: LyapunovOrbit, *, section: str | None = None
) -> ConnectionSearch:
    """Find connections between a rotating orbit and a saddle's orbit, on successive laps of the rotating orbit's tube.

    A lap is one turn of the rotating orbit, on which its tube crosses the section again. The search begins at the last
    crossing before the tube is large, at a scaled distance of about 0.4 from its orbit, whose number is `first` in the
    result. If the two tubes do not meet there, up to three later crossings are searched. If they do not meet at any of
    these, the result has no connections.

    Args:
        source: orbit that the connections leave.
        target: orbit that they join.
        section: short name of the section. The default is the first of "rotating arm straight down" and "arms
            aligned" that the rotating orbit crosses and the other does not.

    Raises:
        InputError: both orbits rotate, or no section is suitable.
    """
    rotating = [orbit for orbit in (source, target) if orbit.laps]
    if len(rotating) != 1:
        raise InputError(
            f"{source.saddle} > {target.saddle}: only connections between a rotating orbit and a saddle can be "
            "searched; go by way of a saddle"
        )
    saddle_orbit = target if rotating[0] is source else source
    chosen_section = _section(rotating[0], saddle_orbit, section)
    first_crossing = crossing = grown_crossing(rotating[0], chosen_section)
    search = find_lap_connections(source, target, section=chosen_section, crossing=crossing)
    while not search.connections and crossing < first_crossing + _LONGER:
        crossing += 1
        search = find_lap_connections(source, target, section=chosen_section, crossing=crossing)
    return replace(search, first=first_crossing)


def _section(lapping: LyapunovOrbit, home: LyapunovOrbit, name: str | None) -> Section:
    """Return the section for connections between a rotating orbit (`lapping`) and a saddle's orbit (`home`).

    The rotating orbit must cross the section in each turn and the saddle's orbit must not. `name` is a section's short
    name, or None for the first suitable one of "rotating arm straight down" and "arms aligned".

    Raises:
        InputError: no candidate is suitable.
    """
    system = lapping.system
    if name is not None:
        candidates = [system.section_between(home.saddle, home.saddle, name)]
    else:
        arm = ROTATING[lapping.saddle].arm if lapping.saddle in ROTATING else "outer"
        candidates = [system.named_sections[key] for key in (f"{arm}-down", "aligned")]
    for section in candidates:
        if own_crossings(OrbitCurve(lapping), section) and not own_crossings(OrbitCurve(home), section):
            return section
    raise InputError(
        f"{lapping.saddle} and {home.saddle}: no suitable section among {', '.join(s.name for s in candidates)}: the "
        "first orbit must cross the section and the second must not; go by way of another saddle"
    )


@dataclass(frozen=True)
class Edges(Shown, Documented):
    """All connections found at one energy.

    Attributes:
        system: system of the orbits.
        energy: J.
        orbits: orbits by saddle.
        absent: (saddle, reason) for missing orbits.
        searched: pairs of saddles searched.
        connections: edges of the graph.
        incomplete: searches that may have missed connections.
        named: connections on other sections or at other hits, outside the graph.
    """

    KEYS: ClassVar[str] = (
        "energy saddles notes absent:saddle,reason edges=connections:name,winding,sense,from=source.saddle,"
        "to=target.saddle,transversality_angle_deg=transversality_angle walks_by_length"
    )

    system: System
    energy: float
    orbits: dict[str, LyapunovOrbit]
    absent: tuple[tuple[str, str], ...]
    searched: tuple[tuple[str, str], ...]
    connections: tuple[Connection, ...]
    incomplete: tuple[ConnectionSearch, ...]
    named: tuple[Connection, ...] = ()

    def __repr__(self) -> str:
        return (
            f"<graph at {self.energy:g}: {counted(len(self.orbits), 'orbit')}, "
            f"{counted(len(self.connections), 'connection')}>"
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on incomplete searches."""
        return tuple(
            f"{search.source.saddle} → {search.target.saddle}, hits {'.'.join(str(cut.hit) for cut in search.cuts)}: "
            f"{search.status}"
            for search in self.incomplete
        )

    @property
    def walks_by_length(self) -> dict[int, int]:
        """Number of walks with one to eight symbols."""
        walks_from, counts = dict.fromkeys(self.orbits, 1), {}
        for length in range(1, 9):
            walks_from = {name: sum(walks_from[c.target.saddle] for c in self.leaving(name)) for name in walks_from}
            counts[length] = sum(walks_from.values())
        return counts

    @property
    def saddles(self) -> tuple[str, ...]:
        """Saddles that have an orbit at this energy."""
        return tuple(self.orbits)

    @property
    def known(self) -> tuple[Connection, ...]:
        """All connections, including those outside the graph."""
        return (*self.connections, *self.named)

    @checked
    def between(self, source: str, target: str) -> tuple[Connection, ...]:
        """Return the connections that lead from one saddle's orbit to another's, or back to the same one.

        Args:
            source: saddle that the connections leave.
            target: saddle that they join.

        Raises:
            InputError: unknown saddle.
        """
        check_choice("saddle", (*self.system.equilibria, *self.orbits), source, target)
        return tuple(c for c in self.connections if (c.source.saddle, c.target.saddle) == (source, target))

    @checked
    def leaving(self, saddle: str) -> tuple[Connection, ...]:
        """Return the connections that leave a saddle's orbit, which may follow a symbol that ends there.

        Args:
            saddle: name of the saddle.

        Raises:
            InputError: unknown saddle.
        """
        check_choice("saddle", (*self.system.equilibria, *self.orbits), saddle)
        return tuple(c for c in self.connections if c.source.saddle == saddle)

    def graph(self) -> "nx.MultiDiGraph[str]":
        """Return the connection graph, with orbits as nodes."""
        return connection_graph(self.orbits.values(), ((c.source.saddle, c.target.saddle, c) for c in self.connections))


class TubeCuts:
    """Cuts of tubes of one energy, each computed on first use.

    `cuts` holds them by saddle, name of the section and number of the crossing, and `_manifolds` the manifolds by
    saddle. `seconds` is the time of all cuts so far, s.
    """

    def __init__(self, system: System, settings: ConnectionSettings | None = None) -> None:
        """Create an empty cache of the system's tube cuts."""
        self.system, self.settings, self.seconds = system, settings or ConnectionSettings(), 0.0
        self.cuts: dict[tuple[str, str, int], Cut] = {}
        self._manifolds: dict[str, UnstableManifold] = {}

    def manifold(self, orbit: LyapunovOrbit) -> UnstableManifold:
        """Return the local unstable manifold of an orbit, on which its tube begins; computed once for each saddle."""
        if orbit.saddle not in self._manifolds:
            self._manifolds[orbit.saddle] = local_manifold(orbit, self.settings.distance)
        return self._manifolds[orbit.saddle]

    def cut(
        self, orbit: LyapunovOrbit, section: Section, hit: int, *, budget: Budget, progress: Progress = no_progress
    ) -> Cut:
        """Return the curves in which an orbit's unstable tube cuts a section at a crossing; computed once.

        Args:
            orbit: orbit of the tube.
            section: section of the orbit's system.
            hit: number of the crossing, from 1.
            budget: processor time of a new cut.
            progress: called with a label and the completed share.
        """
        key = (orbit.saddle, section.name, hit)
        if key not in self.cuts:
            begin = time.perf_counter()
            self.cuts[key] = tube_cut(
                self.manifold(orbit), section, hit=hit, settings=self.settings.cut, budget=budget, progress=progress
            )
            self.seconds += time.perf_counter() - begin
        return self.cuts[key]


@dataclass(frozen=True)
class PairSearch(Brief):
    """One search between two saddle orbits.

    Attributes:
        search: the search's result.
        by_reversal: True if it is the time-reversed image of another search.
    """

    search: ConnectionSearch
    by_reversal: bool

    @property
    def pair(self) -> tuple[str, str]:
        """The saddles whose orbits the connections leave and join."""
        return self.search.source.saddle, self.search.target.saddle


def orbits_at(
    system: System, families: Mapping[str, int], energy: float, *, required: bool = False
) -> tuple[list[LyapunovOrbit], list[tuple[str, str]]]:
    """Return the Lyapunov orbits that exist at an energy, and (saddle, reason) for the missing ones.

    Args:
        system: dynamical system.
        families: number of families for each saddle.
        energy: energy, J.
        required: raise an error if an orbit does not exist.

    Returns:
        Orbits that converged, and one reason for each of the others. If an orbit does not exist, later families of the
            same saddle are not tried.

    Raises:
        InputError: a required orbit does not exist.
    """
    orbits: list[LyapunovOrbit] = []
    absent: list[tuple[str, str]] = []
    for saddle, count in families.items():
        for family in range(count):
            try:
                orbit = lyapunov_orbit(system, saddle, energy=energy, family=family)
            except InputError as error:
                if required:
                    raise
                absent.append((saddle, str(error)))
                break
            if orbit.converged:
                orbits.append(orbit)
            else:
                absent.append((saddle, f"the Lyapunov orbit about {orbit.name}: {orbit.status}"))
    return orbits, absent


_SEARCHED, _SEARCHED_MOST = 1.0, 60.0
"""Duration of a search, s: at the first crossings; at later crossings, where tubes scatter, or if thorough."""
_HIT_BYTES = 1e8
"""Memory of a thorough search per crossing, bytes."""


def searches_cost(
    pairs: Sequence[tuple[str, str]], hits: Sequence[tuple[int, int]], settings: ConnectionSettings
) -> Cost:
    """Estimate the time and memory of searches for connections, for a message before long work.

    Args:
        pairs: names of source and target orbits.
        hits: section crossings of both tubes, all searched for each pair.
        settings: settings of the searches.
    """
    # Opposite pairs are images of one another.
    pair_count = len({frozenset(pair) for pair in pairs})
    seconds_per_hit = [_SEARCHED_MOST if max(hit) > 2 or settings.thorough else _SEARCHED * max(hit) for hit in hits]
    memory = pair_count * sum(_HIT_BYTES * max(hit) for hit in hits) if settings.thorough else _HIT_BYTES
    key = f"hits up to {max(hits)[0]},{max(hits)[1]}"
    return Cost(f"up to {pair_count * len(hits):,} searches", pair_count * sum(seconds_per_hit), memory, key)


def search_pairs(
    tubes: TubeCuts,
    orbits: Mapping[str, LyapunovOrbit],
    pairs: Sequence[tuple[str, str]],
    hits: Sequence[tuple[int, int]],
    *,
    until_found: bool = False,
    yes: bool = False,
    progress: Progress = no_progress,
) -> list[PairSearch]:
    """Search for connections between pairs of saddles by intersecting their tubes, each of which is cut once.

    Of two opposite pairs, only one is searched if time reversal preserves the section.

    Args:
        tubes: cuts so far.
        orbits: orbits by saddle.
        pairs: (source saddle, target saddle).
        hits: (unstable, stable) crossing numbers.
        until_found: stop at the first hits with connections.
        yes: accept any duration.
        progress: called with a label and the completed share.

    Returns:
        Searches in order, one for each pair and hits, or fewer with `until_found`.
    """
    if pairs:
        announce(searches_cost(pairs, hits, tubes.settings), yes=yes)
    searches: list[PairSearch] = []
    # Time reversal exchanges the two hits, so an image is usable only if both orders are searched.
    both_ways = all((b, a) in hits for a, b in hits)
    for k, (source, target) in enumerate(pairs):
        opposite = [result.search for result in searches if result.pair == (target, source)]
        if opposite and source != target and both_ways and can_be_reversed(tubes.system, source, target):
            searches += [PairSearch(reversed_search(search), by_reversal=True) for search in opposite]
            continue
        section = tubes.system.sections[source, target]
        portion = part_of(progress, k / len(pairs), (k + 1) / len(pairs))
        for hit in hits:
            portion(f"tubes {source} → {target}", 0.0)
            # The first cut may last until 40 % of the time has passed, and the second until 80 %.
            budget = Budget(tubes.settings.seconds)
            unstable_cut, stable_cut = (
                tubes.cut(orbits[saddle], section, number, budget=budget.until(0.4 * (side + 1)),
                          progress=part_of(portion, 0.25 * side, 0.25 * (side + 1)))
                for side, (saddle, number) in enumerate(zip((source, target), hit, strict=True))
            )  # fmt: skip
            search = find_connections(
                orbits[source], orbits[target], hits=hit, settings=tubes.settings, cuts=(unstable_cut, stable_cut),
                budget=budget, progress=part_of(portion, 0.5, 1.0),
            )  # fmt: skip
            searches.append(PairSearch(search, by_reversal=False))
            if until_found and search.connections:
                break
    return searches


def find_edges(
    system: System,
    energy: float,
    *,
    pairs: Sequence[tuple[str, str]] | None = None,
    hits: Iterable[tuple[int, int]] = ((1, 1),),
    symbols: Iterable[Symbol] = (),
    yes: bool = False,
    progress: Progress = no_progress,
) -> Edges:
    """Return the connection graph at one energy, after a search for the connections between its orbits.

    Args:
        system: Hamiltonian system.
        energy: J.
        pairs: (source saddle, target saddle), all by default.
        hits: (unstable, stable) crossing numbers.
        symbols: their rotating orbits and named connections are added.
        yes: accept any duration.
        progress: called with a label and the completed share.

    Raises:
        InputError: no saddle has an orbit at this energy, an orbit named in `pairs` or `symbols` does not exist, or
            a symbol names an unknown section.
    """
    saddles = dict.fromkeys(s for pair in pairs for s in pair) if pairs else dict.fromkeys(system.saddles)
    orbits_found, absent = orbits_at(system, dict.fromkeys(saddles, 1), energy, required=bool(pairs))
    orbits = {orbit.saddle: orbit for orbit in orbits_found}
    if not orbits:
        raise InputError("; ".join(dict.fromkeys(reason for _, reason in absent)))
    searched_pairs = [p for p in system.sections if p[0] in orbits and p[1] in orbits and (not pairs or p in pairs)]
    hit_numbers = sorted(set(hits))
    searches = search_pairs(TubeCuts(system), orbits, searched_pairs, hit_numbers, yes=yes, progress=progress)
    progress("connections", 1.0)
    incomplete = tuple(result.search for result in searches if not result.by_reversal and not result.search.complete)
    connections = tuple(c for result in searches for c in result.search.connections)
    edges = Edges(system, energy, orbits, tuple(absent), tuple(searched_pairs), connections, incomplete)
    elementary = [s for symbol in symbols for s in symbol.simple]
    return _with_named(_with_rotating(edges, elementary, progress), elementary, hit_numbers, progress)


def _with_rotating(edges: Edges, symbols: Sequence[Symbol], progress: Progress) -> Edges:
    """Return the graph with the rotating orbits that `symbols` name, and with their connections.

    `symbols` are elementary ones, no composite edges. Those between two saddles are ignored. `progress` is called with
    a label and the completed share.

    Raises:
        InputError: a named rotating orbit was not found, both stops of a symbol rotate, or no section is suitable.
    """
    orbits, searched, connections, incomplete = dict(edges.orbits), list(edges.searched), list(edges.connections), []
    requested = [((s.source, s.target), s.section) for s in symbols if {s.source, s.target} & ROTATING.keys()]
    for pair, section in dict.fromkeys(requested):
        for name in pair:
            if name in ROTATING and name not in orbits:
                orbits[name] = rotating_named(edges.system, name, edges.energy)
        # A missing saddle orbit is reported when the symbol is resolved.
        if set(pair) <= orbits.keys():
            progress(f"connections {pair[0]} > {pair[1]}", 0.0)
            search = rotating_connections(*(orbits[name] for name in pair), section=section)
            names = {c.name for c in connections}
            connections += [c for c in search.connections if c.name not in names]
            searched += [pair] * (pair not in searched)
            # The tube of a rotating orbit crosses the section without end, so the search is never complete.
            incomplete.append(search)
    incomplete = (*edges.incomplete, *incomplete)
    return replace(
        edges, orbits=orbits, searched=tuple(searched), connections=tuple(connections), incomplete=incomplete
    )


def _with_named(
    edges: Edges, symbols: Sequence[Symbol], numbers: Sequence[tuple[int, int]], progress: Progress
) -> Edges:
    """Return the graph with the connections that `symbols` name by their hits and section and that it does not contain.

    `symbols` are elementary ones, no composite edges. Their hits are the numbers of the section crossings at which the
    unstable and the stable tube meet. `numbers` are the hits that the graph's own search covered. The new connections
    are kept outside the graph, in `named`, so that they do not change the number of its walks. Names of connections
    with a missing or rotating orbit are ignored here and reported when the symbol is resolved.

    Raises:
        InputError: a symbol names an unknown section.
    """
    named: list[Connection] = []
    incomplete: list[ConnectionSearch] = []
    searches = [(s.source, s.target, s.hits, s.section) for s in symbols if s.hits is not None]
    for source, target, hit, section in dict.fromkeys(searches):
        in_graph = section is None and hit in numbers and (source, target) in edges.searched
        if in_graph or not {source, target} <= set(edges.orbits) or {source, target} & ROTATING.keys():
            continue
        progress(f"connections {source} > {target}", 0.0)
        search = find_connections(
            edges.orbits[source],
            edges.orbits[target],
            hits=hit,
            section=edges.system.section_between(source, target, section),
            progress=progress,
        )
        named += search.connections
        incomplete += [] if search.complete else [search]
    return replace(edges, named=tuple(named), incomplete=(*edges.incomplete, *incomplete))
