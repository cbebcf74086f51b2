"""The connection graph, a multigraph of orbits and connections."""

from types import SimpleNamespace

import numpy as np
import pytest

from dpcontrol.walks.atlas import connection_graph, walks


@pytest.fixture
def graph():
    """Two loops at a, one at b, an edge in each direction, and an isolated node c."""
    edges = [("p", "a", "a"), ("q", "a", "a"), ("r", "b", "b"), ("ab", "a", "b"), ("ba", "b", "a")]
    orbits = [SimpleNamespace(name=name) for name in ("a", "b", "c", "c family 1")]
    return connection_graph(orbits, [(a, b, SimpleNamespace(name=name)) for name, a, b in edges])


def test_every_orbit_is_a_node_and_every_connection_an_edge(graph):
    assert set(graph.nodes) == {"a", "b", "c", "c family 1"}
    assert graph.number_of_edges("a", "a") == 2
    assert graph.edges["a", "b", "ab"]["connection"].name == "ab"
    assert graph.nodes["a"]["orbit"].name == "a"


def test_the_number_of_walks_is_a_power_of_the_adjacency_matrix(graph):
    names = list(graph.nodes)
    adjacency = np.array([[graph.number_of_edges(a, b) for b in names] for a in names])
    for length in (1, 2, 5):
        power = np.linalg.matrix_power(adjacency, length)
        for i, source in enumerate(names):
            assert len(list(walks(graph, source, length=length))) == power[i].sum()
            for j, target in enumerate(names):
                assert len(list(walks(graph, source, target=target, length=length))) == power[i, j]
