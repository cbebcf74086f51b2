"""An atlas: every Lyapunov orbit of an energy, their tubes' cuts, and the connections between them, as plain records.

The records hold numbers only, so that an atlas read from its file and one just made are the same thing. Lengths N (the
state) and units are those of the model: rad and rad/s for arms, the primaries' units for three bodies.

The connection graph: orbits as nodes, connections as edges; a walk on it is an itinerary.

Source: Kaheman et al. (2023), section 4, where the graph's walks are the itineraries.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import picked
from dpcontrol.orbits.lyapunov import OrbitRecord
from dpcontrol.orbits.rotating import RotatingRecord
from dpcontrol.tubes.connections import ConnectionRecord
from dpcontrol.tubes.cut import Piece


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


@dataclass(frozen=True)
class AtlasPoint:
    """An equilibrium: state (N,), energy in J, kind: "centre" or "index-k saddle"."""

    name: str
    state: Array
    energy: float
    kind: str


@dataclass(frozen=True)
class AtlasOrbit(OrbitRecord):
    """A Lyapunov orbit with samples (M, N) at equally spaced phases from zero."""

    samples: Array


@dataclass(frozen=True)
class AtlasRotatingOrbit(RotatingRecord):
    """An orbit that turns one arm forward, with samples (M, N).

    Each stands for its reflection as well, which turns backward.
    """

    samples: Array


@dataclass(frozen=True)
class AtlasPiece(Piece):
    """One connected piece of a tube's cut; stable_points (K, 2): of the stable tube, which is this one turned around in
    time."""

    stable_points: Array


@dataclass(frozen=True)
class AtlasCut:
    """An orbit's unstable tube up to the `hit`-th crossing of a section.

    open_ends: (branch, (phase, phase), reason). strands (B, M, N): trajectories of the tube from their seeds to the
    section, M instants spread evenly over half the time and half the path, of branches (B,) and seeds' phases (B,).
    """

    saddle: str
    section: Section
    hit: int
    pieces: tuple[AtlasPiece, ...]
    open_ends: tuple[tuple[int, tuple[float, float], str], ...]
    trajectories: int
    resolved: bool
    status: str
    strands: Array
    strand_branches: NDArray[np.int64]
    strand_phases: Array


@dataclass(frozen=True)
class AtlasConnection(ConnectionRecord):
    """A connection, its place on the section, and its flight; source and target by their saddles' names.

    point (2,): (q, p/p₀). times (F,) s from the section and states (F, N): from one period before it leaves the source
    orbit to one after it joins the target. node_times (K,), nodes (K, N): the multiple shooting's own.
    """

    source: str
    target: str
    point: Array
    times: Array
    states: Array
    node_times: Array
    nodes: Array


@dataclass(frozen=True)
class AtlasKind:
    """How the search for connections of one kind ended: from, to, hits.

    failed: crossings of the cuts that did not converge. complete: none failed and both cuts are closed. open_ends:
    (tube, branch, (phase, phase), reason) where they are not. by_reversal: made from the opposite kind. partial: the
    search's time was over before its work was done.
    """

    source: str
    target: str
    section: str
    hits: tuple[int, int]
    count: int
    failed: int
    complete: bool
    open_ends: tuple[tuple[str, int, tuple[float, float], str], ...]
    by_reversal: bool
    status: str
    partial: bool = False


@dataclass(frozen=True)
class Atlas:
    """All of one energy of one model.

    periods (N,): 2π for angles, infinity otherwise. reverser (N, N): turns unstable tubes into stable ones about
    their saddle. absent: (saddle, reason) where there is no orbit. rotating_orbits: of either arm, forward, for
    double pendulums only. seconds: what orbits, tubes, connections and compiling took when the atlas was made.
    """

    model: str
    title: str
    energy: float
    periods: Array
    reverser: Array
    points: tuple[AtlasPoint, ...]
    orbits: tuple[AtlasOrbit, ...]
    rotating_orbits: tuple[AtlasRotatingOrbit, ...]
    absent: tuple[tuple[str, str], ...]
    cuts: tuple[AtlasCut, ...]
    kinds: tuple[AtlasKind, ...]
    connections: tuple[AtlasConnection, ...]
    seconds: Mapping[str, float]
    status: str

    def __repr__(self) -> str:
        return f"<atlas of {self.model} at {self.energy:g}: {self.status}>"

    @property
    def turn_lengths(self) -> Array:
        """Lengths (N,) of a whole turn of each coordinate, zero where it is no angle."""
        return np.where(np.isfinite(self.periods), self.periods, 0.0)

    @property
    def complete(self) -> bool:
        """Whether nothing that was searched may hide a connection at its hits."""
        return all(kind.complete for kind in self.kinds)

    def graph(self) -> "nx.MultiDiGraph[str]":
        """Return the multigraph: orbits of all families as nodes, connections as edges."""
        return connection_graph(self.orbits, ((c.source, c.target, c) for c in self.connections))

    def between(self, source: str, target: str) -> tuple[AtlasConnection, ...]:
        """Return the connections from one saddle's orbit to another's."""
        return tuple(c for c in self.connections if (c.source, c.target) == (source, target))

    def cut(self, saddle: str, section: str, hit: int) -> AtlasCut:
        """Return a tube's cut.

        Raises:
            InputError: the atlas has none such.
        """
        for cut in self.cuts:
            if (cut.saddle, cut.section.name, cut.hit) == (saddle, section, hit):
                return cut
        raise InputError(f"the atlas of {self.model} holds no crossing {hit} of {section} by the tube of {saddle}")

    def turned(self, states: Array, saddle: str) -> Array:
        """Map states (…, N) of a saddle's unstable tube to its stable tube."""
        centre = next(point.state for point in self.points if point.name == saddle)
        return (states - centre) @ self.reverser.T + centre

    def document(self) -> dict[str, Any]:
        """Return what `dpcontrol atlas --json` prints, the file apart."""
        return {
            **picked(self, "energy", "model", "complete", "status"),
            "orbits": [orbit.document() for orbit in self.orbits],
            "rotating_orbits": [orbit.document() for orbit in self.rotating_orbits],
            "count": len(self.connections),
            "connections": [{**c.document(), "from": c.source, "to": c.target} for c in self.connections],
            "kinds": [
                {
                    "from": kind.source,
                    "to": kind.target,
                    **picked(kind, "section", "hits", "count", "complete", "by_reversal", "status"),
                    "open_cuts": [
                        {"branch": f"{tube} {branch:+d}", "phase_interval": interval, "reason": reason}
                        for tube, branch, interval, reason in kind.open_ends
                    ],
                }
                for kind in self.kinds
            ],
            "absent": [{"saddle": saddle, "reason": reason} for saddle, reason in self.absent],
            "seconds": dict(self.seconds),
        }


def section_axes(section: Section, periods: Array) -> tuple[str, float | None]:
    """Return the name of a section's coordinate q and its period, None on a line."""
    coordinate = int(np.argmax(np.abs(section.position)))
    angular = np.isfinite(periods).any()
    name = f"θ{'₁₂₃₄₅₆'[coordinate]}" if angular else "xyz"[coordinate]
    period = float(periods[coordinate])
    return name, period if np.isfinite(period) else None
