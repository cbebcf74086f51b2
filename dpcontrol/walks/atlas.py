"""Atlases of Lyapunov orbits, tube cuts and connections at one energy.

The records hold numbers only, so an atlas read from a file equals the computed one. The state has length N, in units
of the model: rad and rad/s for arms, normalised units for three bodies.

In the connection graph, orbits are nodes and connections are edges. A walk on the graph is an itinerary.

Source: Kaheman et al. (2023), section 4.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.foundation.arrays import Array, checked_array
from dpcontrol.foundation.checked import Hit, checked
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import check_choice
from dpcontrol.foundation.shown import Brief, Shown
from dpcontrol.foundation.units import InUnits
from dpcontrol.orbits.cut import Piece
from dpcontrol.orbits.orbit import OrbitRecord
from dpcontrol.orbits.rotating import RotatingRecord
from dpcontrol.tubes.connections import ConnectionRecord
from dpcontrol.tubes.transport import Transport

if TYPE_CHECKING:
    import networkx as nx


def connection_graph(orbits: Iterable[Any], connections: Iterable[tuple[str, str, Any]]) -> "nx.MultiDiGraph[str]":
    """Return the connection graph, a multigraph whose nodes are orbits and whose edges are connections.

    Nodes are named after orbits and edges are keyed by the connection's name. Isolated orbits are included.

    Args:
        orbits: objects with a `name`, stored as the node attribute `orbit`.
        connections: (source name, target name, connection), stored as the edge attribute `connection`.
    """
    # The import takes a fifth of a second, which a plan without walks does not need.
    import networkx as nx

    graph: nx.MultiDiGraph[str] = nx.MultiDiGraph()
    for orbit in orbits:
        graph.add_node(orbit.name, orbit=orbit)
    for source, target, connection in connections:
        graph.add_edge(source, target, key=connection.name, connection=connection)
    return graph


def walks(
    graph: "nx.MultiDiGraph[str]", source: str, *, target: str | None = None, length: int
) -> Iterator[tuple[str, ...]]:
    """Yield all walks of `length` connections on the graph, each as the names of its connections in order.

    Args:
        graph: connection graph.
        source: first node.
        target: last node; any by default.
        length: number of connections.
    """
    # The recursion takes one connection per level.
    if length == 0:
        if target in (None, source):
            yield ()
        return
    for _, next_stop, name in graph.out_edges(source, keys=True):
        for later_names in walks(graph, next_stop, target=target, length=length - 1):
            yield (name, *later_names)


@dataclass(frozen=True)
class AtlasPoint(Brief):
    """An equilibrium: state (N,), energy in J, kind: "centre" or "index-k saddle"."""

    name: str
    state: Array
    energy: float
    kind: str


@dataclass(frozen=True)
class AtlasOrbit(OrbitRecord):
    """A Lyapunov orbit with samples (M, N) at equally spaced phases."""

    status: str
    samples: Array


@dataclass(frozen=True)
class AtlasRotatingOrbit(RotatingRecord):
    """An orbit on which one arm rotates forward, with samples (M, N); its reflection rotates backward."""

    status: str
    samples: Array


@dataclass(frozen=True)
class AtlasPiece(Piece):
    """One connected piece of a tube's cut.

    `stable_points` (K, 2) are those of its time-reversed image on the stable tube.
    """

    stable_points: Array


@dataclass(frozen=True)
class AtlasCut(Brief):
    """The cut of an unstable tube at the `hit`-th section crossing.

    Attributes:
        open_ends: (branch, (phase, phase), reason) for each gap.
        strands (B, M, N): sample trajectories from seed to section.
        strand_branches (B,): their branches, ±1.
        strand_phases (B,): phases of their seeds.
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
    """A connection with its point on the section and its trajectory.

    The trajectory extends one period beyond the departure from the source orbit and the arrival at the target orbit.

    Attributes:
        point (2,): coordinates (q, p/p₀).
        times (F,): since the section crossing, s.
        states (F, N): trajectory at `times`.
        node_times (K,), nodes (K, N): shooting nodes.
    """

    source: str
    target: str
    point: Array
    times: Array
    states: Array
    node_times: Array
    nodes: Array


@dataclass(frozen=True)
class AtlasKind(Brief, Documented):
    """Outcome of a search for given source, target and hits.

    Attributes:
        failed: intersections that did not converge.
        complete: True if none failed and both cuts are closed.
        open_ends: (tube, branch, (phase, phase), reason) per gap.
        by_reversal: True for a time-reversed image.
    """

    KEYS: ClassVar[str] = (
        "from=source to=target section hits count complete by_reversal status open_cuts:branch,phase_interval,reason"
    )

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

    @property
    def open_cuts(self) -> list[tuple[str, tuple[float, float], str]]:
        """Branch, phase interval and reason of each gap."""
        return [(f"{tube} {branch:+d}", interval, reason) for tube, branch, interval, reason in self.open_ends]


@dataclass(frozen=True)
class Atlas(Shown, InUnits, Documented):
    """The atlas of one model at one energy.

    Attributes:
        model: name of the model.
        title: title of the model.
        energy: energy of all orbits, J.
        periods (N,): 2π for angles, infinity otherwise.
        reverser (N, N): maps unstable to stable tubes.
        points: equilibria, each with its state and its energy.
        orbits: Lyapunov orbits about the saddles.
        rotating_orbits: orbits on which an arm turns over.
        absent: (saddle, reason) for missing orbits.
        cuts: cuts of the tubes with the sections.
        kinds: searched pairs of orbits, each with its section, hits and count.
        connections: all connections, by kind.
        transport: rates of passage through the necks, of two coordinates.
        seconds: computing time by stage, s.
        status: numbers of orbits and connections in words.
        labels: axis labels of the N entries of a state.
        si: True if units are those of SI.
        file: file that holds it, if there is one.
        cached: True if it was read from the cache.

    The rotating orbits are those of both arms, forward.
    """

    __pydantic_config__: ClassVar[Any] = {"arbitrary_types_allowed": True}
    KEYS: ClassVar[str] = (
        "energy model complete status orbits rotating_orbits count=#connections connections:**,from=source,to=target "
        "kinds transport absent:saddle,reason seconds file cached"
    )

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
    labels: tuple[str, ...] = ("θ₁ (rad)", "θ₂ (rad)", "ω₁ (rad/s)", "ω₂ (rad/s)")
    si: bool = True
    transport: tuple[Transport, ...] = ()
    file: Path | None = field(default=None, compare=False)
    cached: bool = field(default=False, compare=False)

    def __repr__(self) -> str:
        return f"<atlas of {self.model} at {self.energy:g}: {self.status}>"

    @property
    def turn_lengths(self) -> Array:
        """Length (N,) of a whole turn of angles, zero for other coordinates."""
        return np.where(np.isfinite(self.periods), self.periods, 0.0)

    @property
    def complete(self) -> bool:
        """True if every search was complete."""
        return all(kind.complete for kind in self.kinds)

    @property
    def missed(self) -> str:
        """Reasons for which the list of connections may be incomplete."""
        place = f"{self.model} at {self.energy:g}{self.unit('J')}"
        return "" if self.complete else f"the atlas of {place} is not complete: {self.status}"

    def graph(self) -> "nx.MultiDiGraph[str]":
        """Return the connection graph, with orbits of all families as nodes."""
        return connection_graph(self.orbits, ((c.source, c.target, c) for c in self.connections))

    @checked
    def between(self, source: str, target: str) -> tuple[AtlasConnection, ...]:
        """Return the connections that lead from one saddle's orbit to another's, or back to the same one.

        Args:
            source: saddle that the connections leave.
            target: saddle that they join.

        Raises:
            InputError: unknown saddle.
        """
        check_choice("saddle", [point.name for point in self.points], source, target)
        return tuple(c for c in self.connections if (c.source, c.target) == (source, target))

    @checked
    def cut(self, saddle: str, section: str, hit: Hit) -> AtlasCut:
        """Return the curves in which the unstable tube of a saddle's orbit cuts a section at one of its crossings.

        Args:
            saddle: saddle whose tube it is.
            section: name of the section.
            hit: number of the crossing.

        Raises:
            InputError: the atlas does not contain this cut.
        """
        for cut in self.cuts:
            if (cut.saddle, cut.section.name, cut.hit) == (saddle, section, hit):
                return cut
        raise InputError(f"the atlas of {self.model} holds no crossing {hit} of {section} by the tube of {saddle}")

    @checked
    def turned(self, states: Array, saddle: str) -> Array:
        """Return the time-reversed images of states on a saddle's unstable tube, which lie on its stable tube.

        Args:
            states: states (…, N).
            saddle: saddle whose tubes they are.

        Returns:
            States (…, N).

        Raises:
            InputError: unknown saddle, or states of another length.
        """
        check_choice("saddle", [point.name for point in self.points], saddle)
        states = checked_array("states", states, len(self.reverser))
        centre = next(point.state for point in self.points if point.name == saddle)
        return (states - centre) @ self.reverser.T + centre


def section_axes(section: Section, atlas: Atlas) -> tuple[str, float | None]:
    """Return the name of the coordinate along which a section is drawn, and its period (None if it does not turn).

    Args:
        section: section of the atlas.
        atlas: atlas with labels and periods of the coordinates.
    """
    coordinate = int(np.argmax(np.abs(section.position)))
    period = float(atlas.periods[coordinate])
    return atlas.labels[coordinate].partition(" ")[0], period if np.isfinite(period) else None
