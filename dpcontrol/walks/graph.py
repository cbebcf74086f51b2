"""The connection graph: orbits as nodes, connections as edges; a walk on it is an itinerary.

Source: Kaheman et al. (2023), section 4, where the graph's walks are the itineraries.
"""

from collections.abc import Iterator

import networkx as nx

from dpcontrol.foundation.errors import InputError
from dpcontrol.walks.atlas import Atlas


def connection_graph(atlas: Atlas) -> "nx.MultiDiGraph[str]":
    """Return the multigraph of an atlas: nodes are orbits by name, edges are connections keyed by name.

    Nodes carry saddle, family, energy (J), period (s) and multiplier; edges carry winding, sense, symmetric, hits,
    transversality_angle (degrees), time_out and time_in (s). Every orbit is a node, connected or not.
    """
    graph: nx.MultiDiGraph[str] = nx.MultiDiGraph(model=atlas.model, energy=atlas.energy)
    for orbit in atlas.orbits:
        graph.add_node(
            orbit.name,
            saddle=orbit.saddle,
            family=orbit.family,
            energy=orbit.energy,
            period=orbit.period,
            multiplier=float(orbit.floquet_multipliers[0].real),
        )
    for c in atlas.connections:
        graph.add_edge(
            c.source,
            c.target,
            key=c.name,
            winding=c.winding,
            sense=c.sense,
            symmetric=c.symmetric,
            hits=c.hits,
            transversality_angle=c.transversality_angle,
            time_out=c.time_out,
            time_in=c.time_in,
        )
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
