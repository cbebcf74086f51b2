"""The connection graph of one energy with its orbits: what walks are made of.

Source: Kaheman et al. (2023), section 4.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import networkx as nx

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import Progress, no_progress
from dpcontrol.tubes.connection import Connection
from dpcontrol.tubes.connections import find_connections
from dpcontrol.tubes.equilibria import equilibria
from dpcontrol.tubes.lyapunov import LyapunovOrbit, lyapunov_orbit
from dpcontrol.tubes.reversal import can_be_reversed, reversed_search


@dataclass(frozen=True)
class Edges:
    """All connections found at one energy.

    orbits: by saddle; absent: (saddle, reason) where there is none. searched: pairs of saddles whose connections were
    sought. notes: sentences on searches that may have missed some.
    """

    system: System
    energy: float
    orbits: dict[str, LyapunovOrbit]
    absent: tuple[tuple[str, str], ...]
    searched: tuple[tuple[str, str], ...]
    connections: tuple[Connection, ...]
    notes: tuple[str, ...]

    @property
    def saddles(self) -> tuple[str, ...]:
        """Saddles that have an orbit at this energy."""
        return tuple(self.orbits)

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


def saddles_with_tubes(system: System) -> list[str]:
    """Return the names of the saddles of index one: those that have Lyapunov orbits and tubes."""
    return [name for name, point in equilibria(system).items() if point.kind.startswith("index-1")]


def find_edges(
    system: System,
    energy: float,
    *,
    pairs: Sequence[tuple[str, str]] | None = None,
    hits: Iterable[tuple[int, int]] = ((1, 1),),
    progress: Progress = no_progress,
) -> Edges:
    """Find the connections at `energy` between all saddles that have orbits there, or between those of `pairs`.

    hits: crossings of the section by the unstable and the stable tube, one search for each; first hits by default.

    Raises:
        InputError: no saddle has an orbit at this energy, or a saddle of `pairs` has none.
    """
    wanted = dict.fromkeys(s for pair in pairs for s in pair) if pairs else dict.fromkeys(saddles_with_tubes(system))
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
    return Edges(system, energy, orbits, tuple(absent), tuple(kinds), connections, tuple(notes))
