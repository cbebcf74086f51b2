"""Walks on the connection graph: resolved from symbols, listed, counted, drawn at random.

Counting and uniform drawing use powers of the matrix that holds the number of connections between saddles.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import pairwise

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.tables import suggest
from dpcontrol.tubes.connection import Connection
from dpcontrol.walks.edges import Edges
from dpcontrol.walks.graph import walks
from dpcontrol.walks.grow import as_connection
from dpcontrol.walks.rotating import is_rotating, rotating_names
from dpcontrol.walks.shadowing import WalkSolver
from dpcontrol.walks.symbols import Symbol, choose, parse_walk

Walk = tuple[Connection, ...]


def resolve(texts: Sequence[str], edges: Edges) -> Walk:
    """Return the connections that the symbols of a walk stand for.

    Raises:
        InputError: a text that is no symbol, a walk that is not connected, or a connection that does not exist at this
            energy; with the reason and the nearest walk that exists.
        GoalMissed: the walk of a grown edge has no orbit with those wraps.
    """
    symbols = parse_walk(texts, vertex_names(edges.system))
    chain: list[Connection] = []
    for k, symbol in enumerate(symbols, start=1):
        try:
            chain.append(_connection(symbol, edges))
        except GoalMissed as error:
            raise GoalMissed(f"symbol {k} of {len(symbols)} ({symbol.text}): {error}") from error
        except InputError as error:
            reasons = [why for saddle, why in edges.absent if saddle in (symbol.source, symbol.target)]
            why = f" ({'; '.join(reasons)})" if reasons else ""
            raise InputError(f"symbol {k} of {len(symbols)}: {error}{why}{_nearest(symbols, edges)}") from error
    return tuple(chain)


def vertex_names(system: System) -> list[str]:
    """Return the names of the orbits that a walk may stop at: those of saddles, and rotating ones."""
    return [*system.saddles, *rotating_names(system)]


def _connection(symbol: Symbol, edges: Edges) -> Connection:
    """Return the connection that a symbol stands for; a grown edge is solved for.

    Raises:
        InputError: there is none.
        GoalMissed: a grown edge's walk has no orbit with its wraps.
    """
    if symbol.parts:
        solver = WalkSolver(edges.known)
        orbit = solver.solve([_connection(part, edges) for part in symbol.parts], symbol.wraps)
        if not orbit.converged:
            raise GoalMissed(f"{orbit.status}; {solver.advice(orbit)}")
        edge = as_connection(orbit)
        if symbol.name not in (None, edge.name):
            raise InputError(f"no edge is named {symbol.name!r}: what it is made of makes {edge.name!r}")
        return edge
    pair = (symbol.source, symbol.target)
    candidates = edges.between(*pair)
    if symbol.name is not None:
        candidates += tuple(c for c in edges.named if (c.source.saddle, c.target.saddle) == pair)
    elif not candidates and any(is_rotating(name) for name in pair):
        told = [note for note in edges.notes if note.startswith(f"{pair[0]} → {pair[1]}: ")]
        why = f" ({told[0]})" if told else ""
        raise InputError(
            f"{symbol.text!r}: no such connection was found at {edges.energy:g} J{why}; try another energy"
        )
    return choose(symbol, candidates)


def _nearest(symbols: Sequence[Symbol], edges: Edges) -> str:
    """Return a sentence that names the nearest walk that exists: through the same stops, or as many as can be had."""
    stops = [symbols[0].source, *(s.target for s in symbols)]
    left = [stop for stop in stops if stop in edges.orbits]
    # A walk that must lose stops loses its end; where none of it can be had, any connection is nearer than none.
    tries = [left[:count] for count in range(len(left), 1, -1)]
    tries += sorted(edges.searched, key=lambda pair: -len(set(pair) & set(stops)))
    for wanted in tries:
        with suppress(InputError):
            return "; the nearest walk that exists is " + ", ".join(f"{c.name!r}" for c in through(wanted, edges))
    return ""


def ways(stops: Sequence[str]) -> tuple[Symbol, ...]:
    """Return symbols that ask for the ways between stops, any connection of each."""
    return tuple(Symbol(f"{a} > {b}", a, b, None, None) for a, b in pairwise(stops))


def through(stops: Sequence[str], edges: Edges) -> Walk:
    """Return the shortest walk that visits saddles in order, each step by its most transversal symmetric connection.

    A stop that follows itself asks for a homoclinic connection.

    Raises:
        InputError: fewer than two stops, an unknown saddle, or no way from one to the next.
    """
    if len(stops) < 2:
        raise InputError(f"stops = {list(stops)}: a walk needs two at least, where it starts and where it ends")
    graph = edges.graph()
    chain: list[Connection] = []
    for stop in stops:
        if stop not in graph:
            raise InputError(f"{stop!r} has no orbit at {edges.energy:g} J: {suggest(stop, edges.orbits)}")
    for here, there in pairwise(stops):
        if here == there:
            path = [here, there] if graph.has_edge(here, there) else []
        else:
            path = nx.shortest_path(graph, here, there) if nx.has_path(graph, here, there) else []
        if not path:
            raise InputError(f"no walk at {edges.energy:g} J leads from {here} to {there}; try a higher energy")
        chain += [choose(way, edges.between(way.source, way.target)) for way in ways(path)]
    return tuple(chain)


def _matrix(edges: Edges) -> tuple[list[str], NDArray[np.object_]]:
    """Return the saddles and how many connections lead from each to each, as whole numbers of any size."""
    names = list(edges.orbits)
    counts = np.zeros((len(names), len(names)), dtype=object)
    for c in edges.connections:
        counts[names.index(c.source.saddle), names.index(c.target.saddle)] += 1
    return names, counts


def count_walks(edges: Edges, length: int, *, source: str | None = None, target: str | None = None) -> int:
    """Return how many walks of `length` symbols there are (from `source`, to `target`).

    Raises:
        InputError: a length below one, or a saddle without an orbit.
    """
    names, counts = _matrix(edges)
    _check(edges, length, source, target)
    power = np.linalg.matrix_power(counts, length)
    rows = [k for k, name in enumerate(names) if source in (None, name)]
    columns = [k for k, name in enumerate(names) if target in (None, name)]
    return int(power[np.ix_(rows, columns)].sum())


def all_walks(edges: Edges, length: int, *, source: str | None = None, target: str | None = None) -> Iterator[Walk]:
    """Yield every walk of `length` symbols (from `source`, to `target`).

    Raises:
        InputError: a length below one, or a saddle without an orbit.
    """
    _check(edges, length, source, target)
    graph = edges.graph()
    named = {c.name: c for c in edges.connections}
    for start in edges.orbits if source is None else (source,):
        for names in walks(graph, start, target=target, length=length):
            yield tuple(named[name] for name in names)


def random_walk(edges: Edges, length: int, generator: np.random.Generator, *, periodic: bool = False) -> Walk:
    """Draw one of all walks of `length` symbols (of those that close, if periodic), each as likely as any other.

    Raises:
        InputError: a length below one, or no such walk.
    """
    _check(edges, length, None, None)
    names, counts = _matrix(edges)
    powers = [np.linalg.matrix_power(counts, k) for k in range(length + 1)]
    onward = np.ones(len(names), dtype=object)
    first = np.array([powers[length][k, k] if periodic else (powers[length] @ onward)[k] for k in range(len(names))])
    if not first.sum():
        raise InputError(f"there is no {'closed ' if periodic else ''}walk of {length} symbols at {edges.energy:g} J")
    at = start = _drawn(first, generator)
    chain: list[Connection] = []
    for left in range(length - 1, -1, -1):
        leaving = edges.leaving(names[at])
        ends = [names.index(c.target.saddle) for c in leaving]
        weights = np.array([powers[left][e, start] if periodic else (powers[left] @ onward)[e] for e in ends])
        chosen = leaving[_drawn(weights, generator)]
        chain.append(chosen)
        at = names.index(chosen.target.saddle)
    return tuple(chain)


def _drawn(weights: NDArray[np.object_], generator: np.random.Generator) -> int:
    """Draw an index with probability proportional to whole-number weights of any size."""
    total = weights.sum()
    shares = np.array([float(weight / total) for weight in weights])
    return int(generator.choice(len(shares), p=shares / shares.sum()))


def _check(edges: Edges, length: int, source: str | None, target: str | None) -> None:
    if length < 1:
        raise InputError(f"length = {length}: a walk has at least one symbol")
    for saddle in (source, target):
        if saddle is not None and saddle not in edges.orbits:
            reasons = [why for name, why in edges.absent if name == saddle]
            raise InputError(f"{saddle!r}: {reasons[0] if reasons else suggest(saddle, edges.orbits)}")


def is_closed(chain: Sequence[Connection]) -> bool:
    """Tell whether a walk ends where it starts."""
    return chain[0].source.saddle == chain[-1].target.saddle
