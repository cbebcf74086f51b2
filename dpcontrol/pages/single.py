"""One chart of each result, the most informative one, drawn in given axes."""

from collections.abc import Iterable, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.control.flight import Flight
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.document import counted
from dpcontrol.orbits.cut import Cut, Piece
from dpcontrol.orbits.orbit import PeriodicOrbit
from dpcontrol.orbits.tube import Tube
from dpcontrol.pages import style
from dpcontrol.pages.atlas import BRANCHES
from dpcontrol.pages.layout import key
from dpcontrol.pages.panels import draw_graph, quiet_plane, wrapped_runs
from dpcontrol.recordings.recording import Recording
from dpcontrol.tubes.connections import Connection, ConnectionSearch
from dpcontrol.tubes.symmetric import SymmetricSearch
from dpcontrol.walks.edges import Edges


def tube(axes: Axes, shown: Tube) -> None:
    """Draw the trajectories of a tube and its orbit in the plane of positions.

    Args:
        axes: panel to draw on.
        shown: tube to draw.
    """
    strands = shown.strands()
    for k, strand in enumerate(strands):
        # The strands of the first branch come first, as many as of the second.
        branch = shown.branches[k * len(shown.branches) // len(strands)]
        axes.plot(*strand[:, :2].T, color=BRANCHES[shown.stable, branch], linewidth=0.5, alpha=0.8)
    _ring(axes, shown.orbit)
    quiet_plane(axes, shown.orbit.system, title=f"{'' if shown.stable else 'un'}stable tube of {shown.orbit.name}")


def _ring(axes: Axes, orbit: PeriodicOrbit, shift: Array | float = 0.0) -> None:
    """Draw a periodic orbit in the plane of positions, shifted by `shift`, a state of whole turns."""
    axes.plot(*(orbit.sample() + shift)[:, :2].T, color=style.saddle_colour(orbit.saddle), linewidth=2.5)


def _curves(axes: Axes, pieces: Iterable[Piece], *, stable: bool, period: float = np.inf) -> None:
    """Draw pieces of a cut on a section, dashed if the tube crosses it backward.

    Args:
        axes: panel to draw on.
        pieces: pieces of the cut, with points (K, 2) of position and momentum.
        stable: True for the cut of a stable tube.
        period: period of the position; infinite if it has none.
    """
    for piece in pieces:
        points = np.vstack([piece.points, piece.points[:1]]) if piece.closed else piece.points
        line = "-" if piece.direction > 0 else "--"
        for stretch in wrapped_runs(points, (period if np.isfinite(period) else None, None)):
            axes.plot(*stretch.T, color=BRANCHES[stable, 1], linewidth=1.3, linestyle=line, zorder=2)


def cut(axes: Axes, shown: Cut) -> None:
    """Draw a cut in the section's coordinates.

    Args:
        axes: panel to draw on.
        shown: cut to draw.
    """
    _curves(axes, shown.pieces, stable=shown.stable)
    title = f"crossing {shown.hit} of {shown.section.name}"
    axes.set(title=title, xlabel="coordinate on the section", ylabel=_MOMENTUM)
    key(axes, [(f"{'stable' if shown.stable else 'unstable'} tube", BRANCHES[shown.stable, 1]), _BACKWARD])


_BACKWARD: tuple[str, dict[str, Any]] = ("crossed backward", {"color": style.CART, "linestyle": "--"})
"""Entry of a key for dashed curves."""
_MOMENTUM = "its momentum on the section, p / p₀"


def search(axes: Axes, result: ConnectionSearch, shown: Sequence[Connection] | None = None) -> None:
    """Draw the cuts of both tubes of a search on its section, and the connections as their common points.

    Args:
        axes: panel to draw on.
        result: search to draw.
        shown: marked connections; all by default.
    """
    shown = result.connections if shown is None else shown
    section = result.cuts[0].section
    # The coordinate of the states that the position on the section mainly measures.
    coordinate = int(np.argmax(np.abs(section.position)))
    period = float(result.source.system.periods[coordinate])
    for manifold, cut in zip((result.source.manifold(), result.target.manifold(stable=True)), result.cuts, strict=True):
        _curves(axes, (manifold.placed(piece, section) for piece in cut.pieces), stable=manifold.stable, period=period)
    for q, p in (connection.place for connection in shown):
        turns = np.rint(q / period)
        # Without a period no turns exist, and 0 times infinity would be nan.
        axes.plot(
            q - (turns and turns * period), p, "o", color=style.INK, markeredgecolor="white", markersize=6, zorder=4
        )
    title = f"{result.source.saddle} → {result.target.saddle}: {counted(len(shown), 'connection')}"
    axis_label = f"{result.source.system.labels[coordinate]} on the section"
    axes.set(title=f"{title} on {section.name}", xlabel=axis_label, ylabel=_MOMENTUM)
    dot = {"color": style.INK, "marker": "o", "linestyle": ""}
    tubes = [(f"tube from {result.source.saddle}", style.UNSTABLE), (f"tube to {result.target.saddle}", style.STABLE)]
    key(axes, [*tubes, _BACKWARD, ("connections", dot)])


def flights(axes: Axes, connections: Sequence[Connection]) -> None:
    """Draw connections and the orbits that they leave and join, in the plane of positions.

    Args:
        axes: panel to draw on.
        connections: connections of one source and one target.
    """
    for connection, colour in zip(connections, cycle(style.SERIES), strict=False):
        _ring(axes, connection.source)
        # The target orbit is drawn where the connection ends, which may be whole turns away.
        _ring(axes, connection.target, connection.orbit.end.turns * connection.source.system.turn_lengths)
        axes.plot(*connection.sample(600)[:, :2].T, color=colour, linewidth=1.0)


def flown(axes: Axes, result: Connection | SymmetricSearch) -> None:
    """Draw a connection, or all connections of a search, between their orbits in the plane of positions.

    Args:
        axes: panel to draw on.
        result: connection or search to draw.
    """
    connections = result.connections if isinstance(result, SymmetricSearch) else (result,)
    flights(axes, connections)
    counts = (
        f"{result.saddle}: {counted(len(connections), 'connection')}" if isinstance(result, SymmetricSearch) else ""
    )
    if connections:
        quiet_plane(axes, connections[0].source.system, title=counts or connections[0].name)


def edges(axes: Axes, result: Edges) -> None:
    """Draw a connection graph: the saddles' orbits at one energy, and arrows with the numbers of connections.

    Args:
        axes: panel to draw on.
        result: edges of the graph.
    """
    draw_graph(axes, result.graph(), f"{result.system.name} at {result.energy:g}{result.system.unit('J')}")


def flight(axes: Axes, result: Flight) -> None:
    """Draw the angles of a flight in turns, and the cart's position as a share of its limit.

    Args:
        axes: panel to draw on.
        result: flight to draw.
    """
    times = np.linspace(*result.time_range, 400)
    # A state has the angle and the rate of each arm, and the cart's position and velocity, which come last.
    states, arms = result.states(times), result.nodes.shape[1] // 2 - 1
    for arm in range(arms):
        axes.plot(times, states[:, arm] / (2 * np.pi), color=style.arm_colour(arm), label=f"arm {arm + 1}, turns")
    limit = result.limits.position
    axes.plot(times, states[:, -2] / limit, color=style.INK, linestyle="--", label=f"cart, shares of {limit:g} m")
    axes.set(title=result.status, xlabel="s")
    key(axes)


def recording(axes: Axes, shown: Recording) -> None:
    """Draw the measured angles of a recording over time, interrupted between its segments.

    Args:
        axes: panel to draw on.
        shown: recording to draw.
    """
    for segment in shown.split():
        for arm in range(shown.arms):
            axes.plot(segment.time, segment.angles[:, arm], color=style.arm_colour(arm), linewidth=0.9)
    axes.set(title=f"{shown.name}: {len(shown.segments)} segments", xlabel="time (s)", ylabel="angles (rad)")
