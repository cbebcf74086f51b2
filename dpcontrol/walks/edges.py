"""The connection graph of one energy with its orbits: what walks are made of.

Source: Kaheman et al. (2023), section 4.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import networkx as nx

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.orbits.lyapunov import LyapunovOrbit, lyapunov_orbit
from dpcontrol.tubes.connection import Connection, can_be_reversed
from dpcontrol.tubes.connections import find_connections, reversed_search
from dpcontrol.walks.rotating import is_rotating, rotating_connections, rotating_named
from dpcontrol.walks.symbols import Symbol


@dataclass(frozen=True)
class Edges:
    """All connections found at one energy.

    orbits: by saddle; absent: (saddle, reason) where there is none. searched: pairs of saddles whose connections were
    sought. notes: sentences on searches that may have missed some. named: found for symbols that name them, on other
    sections or at other hits; no part of the graph.
    """

    system: System
    energy: float
    orbits: dict[str, LyapunovOrbit]
    absent: tuple[tuple[str, str], ...]
    searched: tuple[tuple[str, str], ...]
    connections: tuple[Connection, ...]
    notes: tuple[str, ...]
    named: tuple[Connection, ...] = ()

    @property
    def saddles(self) -> tuple[str, ...]:
        """Saddles that have an orbit at this energy."""
        return tuple(self.orbits)

    @property
    def known(self) -> tuple[Connection, ...]:
        """All connections that were found, in the graph or not."""
        return (*self.connections, *self.named)

    def between(self, source: str, target: str) -> tuple[Connection, ...]:
        """Return the connections from one saddle's orbit to another's."""
        return tuple(c for c in self.connections if (c.source.saddle, c.target.saddle) == (source, target))

    def leaving(self, saddle: str) -> tuple[Connection, ...]:
        """Return the connections that leave a saddle's orbit."""
        return tuple(c for c in self.connections if c.source.saddle == saddle)

    def graph(self) -> "nx.MultiDiGraph[str]":
        """Return the multigraph: saddles as nodes, connections as edges keyed by name."""
        graph: nx.MultiDiGraph[str] = nx.MultiDiGraph()
        graph.add_nodes_from(self.orbits)
        for c in self.connections:
            graph.add_edge(c.source.saddle, c.target.saddle, key=c.name, connection=c)
        return graph


def find_edges(
    system: System,
    energy: float,
    *,
    pairs: Sequence[tuple[str, str]] | None = None,
    hits: Iterable[tuple[int, int]] = ((1, 1),),
    symbols: Iterable[Symbol] = (),
    progress: Progress = no_progress,
) -> Edges:
    """Find the connections at `energy` between all saddles that have orbits there, or between those of `pairs`.

    hits: crossings of the section by the unstable and the stable tube, one search for each; first hits by default.
    symbols: what else they ask for: connections named on other sections or at other hits, and rotating orbits.

    Raises:
        InputError: no saddle has an orbit at this energy, a saddle of `pairs` or a rotating orbit of `symbols` has
            none, or a symbol names a section that there is not.
    """
    wanted = dict.fromkeys(s for pair in pairs for s in pair) if pairs else dict.fromkeys(system.saddles)
    orbits: dict[str, LyapunovOrbit] = {}
    absent: list[tuple[str, str]] = []
    for saddle in wanted:
        try:
            orbit = lyapunov_orbit(system, saddle, energy=energy)
        except InputError as error:
            if pairs:
                raise
            absent.append((saddle, str(error)))
            continue
        if orbit.converged:
            orbits[saddle] = orbit
        else:
            absent.append((saddle, f"the Lyapunov orbit about {saddle}: {orbit.status}"))
    if not orbits:
        raise InputError("; ".join(dict.fromkeys(reason for _, reason in absent)))
    kinds = [p for p in system.sections if p[0] in orbits and p[1] in orbits and (not pairs or p in pairs)]
    found: dict[tuple[str, str], tuple[Connection, ...]] = {}
    notes: list[str] = []
    numbers = sorted(set(hits))
    # An image under time reversal has its hits exchanged: it serves where both are asked for.
    both_ways = all((b, a) in numbers for a, b in numbers)
    for k, (source, target) in enumerate(kinds):
        here: Progress = lambda what, done, k=k: progress(what, (k + done) / len(kinds))  # noqa: E731
        if (source, target) in found:
            continue
        listed: list[Connection] = []
        for hit in numbers:
            search = find_connections(orbits[source], orbits[target], hits=hit, progress=here)
            listed += search.connections
            if search.failed or not all(cut.resolved for cut in search.cuts):
                notes.append(f"{source} → {target}, hits {hit[0]}.{hit[1]}: {search.status}")
            opposite = source != target and (target, source) in kinds and both_ways
            if opposite and can_be_reversed(system, source, target):
                image = reversed_search(search).connections
                found[target, source] = (*found.get((target, source), ()), *image)
        found[source, target] = tuple(listed)
    progress("connections", 1.0)
    connections = tuple(c for pair in kinds for c in found[pair])
    edges = Edges(system, energy, orbits, tuple(absent), tuple(kinds), connections, tuple(notes))
    simple = [s for symbol in symbols for s in symbol.simple]
    return _with_named(_with_rotating(edges, simple, progress), simple, numbers, progress)


def _with_rotating(edges: Edges, symbols: Sequence[Symbol], progress: Progress) -> Edges:
    """Add the rotating orbits that symbols name, and their connections with the saddles' orbits beside them."""
    orbits, searched, connections, notes = dict(edges.orbits), list(edges.searched), list(edges.connections), []
    done: set[tuple[tuple[str, str], str | None]] = set()
    for symbol in symbols:
        pair = (symbol.source, symbol.target)
        if not any(is_rotating(name) for name in pair):
            continue
        for name in pair:
            if is_rotating(name) and name not in orbits:
                orbits[name] = rotating_named(edges.system, name, edges.energy)
        # A saddle without an orbit is told of where the symbol is resolved.
        if all(name in orbits for name in pair) and (pair, symbol.section) not in done:
            progress(f"connections {pair[0]} > {pair[1]}", 0.0)
            search = rotating_connections(*(orbits[name] for name in pair), section=symbol.section)
            known = {c.name for c in connections}
            connections += [c for c in search.connections if c.name not in known]
            searched += [pair] * (pair not in searched)
            done.add((pair, symbol.section))
            # A tube that laps has more crossings than are ever searched.
            notes.append(f"{pair[0]} → {pair[1]}: {search.status}")
    return replace(
        edges, orbits=orbits, searched=tuple(searched), connections=tuple(connections), notes=(*edges.notes, *notes)
    )


def _with_named(
    edges: Edges, symbols: Sequence[Symbol], numbers: Sequence[tuple[int, int]], progress: Progress
) -> Edges:
    """Search what a named symbol needs beyond the graph, for its own pair of saddles only."""
    found: list[Connection] = []
    notes: list[str] = []
    searches = [(s.source, s.target, s.hits, s.section) for s in symbols if s.hits is not None]
    for source, target, hit, section in dict.fromkeys(searches):
        in_graph = section is None and hit in numbers and (source, target) in edges.searched
        if in_graph or not {source, target} <= set(edges.orbits) or is_rotating(source) or is_rotating(target):
            continue
        progress(f"connections {source} > {target}", 0.0)
        search = find_connections(
            edges.orbits[source],
            edges.orbits[target],
            hits=hit,
            section=edges.system.section_between(source, target, section),
            progress=progress,
        )
        found += search.connections
        if search.failed or not all(cut.resolved for cut in search.cuts):
            notes.append(f"{source} → {target}, hits {hit[0]}.{hit[1]}: {search.status}")
    return replace(edges, named=tuple(found), notes=(*edges.notes, *notes))
