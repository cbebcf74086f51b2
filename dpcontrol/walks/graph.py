"""The connection graph: orbits as nodes, connections as edges; a walk on it is an itinerary.

Source: Kaheman et al. (2023), section 4, where the graph's walks are the itineraries.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import networkx as nx

from dpcontrol.foundation.errors import InputError


def connection_graph(orbits: Iterable[Any], connections: Iterable[tuple[str, str, Any]]) -> "nx.MultiDiGraph[str]":
    """Return the multigraph of orbits and connections: nodes by name, edges keyed by the connection's name.

    connections: (source, target, connection), ends by name. Nodes carry their `orbit`, edges their `connection`. Every
    orbit is a node, connected or not.
    """
    graph: nx.MultiDiGraph[str] = nx.MultiDiGraph()
    for orbit in orbits:
        graph.add_node(orbit.name, orbit=orbit)
    for source, target, connection in connections:
        graph.add_edge(source, target, key=connection.name, connection=connection)
    return graph


def walks(
    graph: "nx.MultiDiGraph[str]", source: str, *, target: str | None = None, length: int
) -> Iterator[tuple[str, ...]]:
    """Yield every walk of `length` connections from `source` (to `target`), each the names of its connections.

    Raises:
        InputError: a node that the graph does not have, or a length below one.
    """
    for node in (source, *([] if target is None else [target])):
        if node not in graph:
            raise InputError(f"the graph has no orbit {node!r}; choose one of {', '.join(graph.nodes)}")
    if length < 1:
        raise InputError(f"length = {length}: a walk has at least one connection")
    return _walks(graph, source, target, length)


def _walks(graph: "nx.MultiDiGraph[str]", at: str, target: str | None, left: int) -> Iterator[tuple[str, ...]]:
    if left == 0:
        if target is None or at == target:
            yield ()
        return
    for _, following, name in graph.out_edges(at, keys=True):
        for rest in _walks(graph, following, target, left - 1):
            yield (name, *rest)
