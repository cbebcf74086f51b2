"""One chart of each result, drawn in given axes.

It is the most informative chart of the result.
"""

from collections.abc import Iterable, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.bifurcations.bifurcations import BifurcationSearch, branch_diagram
from dpcontrol.control.flight import Flight
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.document import counted
from dpcontrol.judge.comparison import RunComparison
from dpcontrol.judge.of_log import reference_view, run_view, sustained_view
from dpcontrol.judge.preflight import Preflight
from dpcontrol.judge.run_view import series_of
from dpcontrol.logs import RunLog
from dpcontrol.orbits.cut import Cut, Piece
from dpcontrol.orbits.family import LyapunovFamily
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.orbits.orbit import PeriodicOrbit
from dpcontrol.orbits.rotating import RotatingFamily, RotatingOrbit
from dpcontrol.orbits.tube import Tube
from dpcontrol.pages import orbits, style
from dpcontrol.pages.atlas import BRANCHES, draw_cuts
from dpcontrol.pages.charts import draw_chart
from dpcontrol.pages.page import draw
from dpcontrol.pages.panels import Bar, bars, draw_graph, quiet, quiet_plane, wrapped_runs
from dpcontrol.pages.paper.branches import draw_momentum_branches
from dpcontrol.pages.run_charts import charts
from dpcontrol.pages.walks import WalkStory, draw_walk
from dpcontrol.pages.walks import plane as walk_plane
from dpcontrol.plans.model import ModelSystem
from dpcontrol.plans.plan import Plan
from dpcontrol.recordings.recording import Recording
from dpcontrol.references.sustained import SustainedOrbit
from dpcontrol.runs.polish import Polished
from dpcontrol.tubes.connections import Connection, ConnectionSearch
from dpcontrol.tubes.symmetric import SymmetricSearch
from dpcontrol.walks.atlas import Atlas
from dpcontrol.walks.edges import Edges
from dpcontrol.walks.shadowing import ShadowingOrbit


def orbit(axes: Axes, found: LyapunovOrbit | RotatingOrbit) -> None:
    """Draw an orbit in the phase plane of its most active arm.

    Without angles it is drawn in the plane of positions.

    Args:
        axes: panel to draw on.
        found: orbit to draw.
    """
    states, n = found.sample(400), found.system.dimension // 2
    arm = int(np.argmax(np.ptp(states[:, :n], axis=0)))
    columns = (arm, n + arm) if found.system.si else (0, 1)
    axes.plot(*states[:, list(columns)].T, color=style.saddle_colour(found.name), linewidth=1.8)
    energy = f"{found.energy:g}{found.system.unit('J')}"
    title = f"{found.name} at {energy}, period {found.period:.4g}{found.system.unit('s')}"
    quiet_plane(axes, found.system, columns, title)


def family(axes: Axes, found: LyapunovFamily | RotatingFamily) -> None:
    """Draw the periods of a family over the energy.

    Args:
        axes: panel to draw on.
        found: family to draw.
    """
    system = found.members[0].system
    axes.plot(found.energies, found.periods, color=style.INK, linewidth=1.6)
    energy, period = (f"{name}{system.unit(unit, ' ({})')}" for name, unit in (("energy", "J"), ("period", "s")))
    quiet(axes, f"{len(found.members)} orbits about {found.members[0].name}", x=energy, y=period)


def family_page(found: LyapunovFamily) -> Figure:
    """Return the page on one family."""
    return orbits.draw_families([found], f"Lyapunov orbits about {found.saddle} of {found.system.name}")


def tube(axes: Axes, found: Tube) -> None:
    """Draw the trajectories of a tube and its orbit in the plane of positions.

    Args:
        axes: panel to draw on.
        found: tube to draw.
    """
    strands = found.strands()
    for k, strand in enumerate(strands):
        branch = found.branches[k * len(found.branches) // len(strands)]
        axes.plot(*strand[:, :2].T, color=BRANCHES[found.stable, branch], linewidth=0.5, alpha=0.8)
    _ring(axes, found.orbit)
    kind = "stable" if found.stable else "unstable"
    quiet_plane(axes, found.orbit.system, title=f"{kind} tube of {found.orbit.name}")


def _ring(axes: Axes, orbit: PeriodicOrbit, shift: Array | float = 0.0) -> None:
    axes.plot(*(orbit.sample() + shift)[:, :2].T, color=style.saddle_colour(orbit.saddle), linewidth=2.5)


def _curves(axes: Axes, pieces: Iterable[Piece], *, stable: bool, period: float = np.inf) -> None:
    for piece in pieces:
        points = np.vstack([piece.points, piece.points[:1]]) if piece.closed else piece.points
        line = "-" if piece.direction > 0 else "--"
        for run in wrapped_runs(points, (period if np.isfinite(period) else None, None)):
            axes.plot(*run.T, color=BRANCHES[stable, 1], linewidth=1.3, linestyle=line, zorder=2)


def cut(axes: Axes, found: Cut) -> None:
    """Draw a cut in the section's coordinates.

    Args:
        axes: panel to draw on.
        found: cut to draw.
    """
    _curves(axes, found.pieces, stable=found.stable)
    quiet(axes, f"crossing {found.hit} of {found.section.name}", x="q", y="p / p₀")


def search(axes: Axes, found: ConnectionSearch, shown: Sequence[Connection] | None = None) -> None:
    """Draw the cuts of both tubes and the connections.

    Args:
        axes: panel to draw on.
        found: search to draw.
        shown: marked connections; all by default.
    """
    shown = found.connections if shown is None else shown
    section = found.cuts[0].section
    period = float(found.source.system.periods[int(np.argmax(np.abs(section.position)))])
    for side, cut in zip((found.source.manifold(), found.target.manifold(stable=True)), found.cuts, strict=True):
        _curves(axes, (side.placed(piece, section) for piece in cut.pieces), stable=side.stable, period=period)
    for q, p in (connection.place for connection in shown):
        turns = np.rint(q / period)
        axes.plot(
            q - (turns and turns * period), p, "o", color=style.INK, markeredgecolor="white", markersize=6, zorder=4
        )
    title = f"{found.source.saddle} → {found.target.saddle}: {counted(len(shown), 'connection')}"
    quiet(axes, f"{title} on {section.name}", x="q", y="p / p₀")


def flights(axes: Axes, connections: Sequence[Connection]) -> None:
    """Draw connections and their orbits in the plane of positions.

    Args:
        axes: panel to draw on.
        connections: connections of one source and one target.
    """
    for connection, colour in zip(connections, cycle(style.SERIES), strict=False):
        turn_lengths = connection.source.system.turn_lengths
        _ring(axes, connection.source)
        _ring(axes, connection.target, np.asarray(connection.orbit.end.turns) * turn_lengths)
        axes.plot(*connection.sample(600)[:, :2].T, color=colour, linewidth=1.0)


def connection(axes: Axes, found: Connection) -> None:
    """Draw a connection between its orbits in the plane of positions.

    Args:
        axes: panel to draw on.
        found: connection to draw.
    """
    flights(axes, [found])
    quiet_plane(axes, found.source.system, title=found.name)


def symmetric(axes: Axes, found: SymmetricSearch) -> None:
    """Draw all connections of a search in the plane of positions.

    Args:
        axes: panel to draw on.
        found: search to draw.
    """
    flights(axes, found.connections)
    if found.connections:
        title = f"{found.saddle}: {counted(len(found.connections), 'connection')}"
        quiet_plane(axes, found.connections[0].source.system, title=title)


def bifurcations(axes: Axes, found: BifurcationSearch) -> None:
    """Draw the section's momentum of each connection over the energy.

    The bifurcations and the counts are added.

    Args:
        axes: panel to draw on.
        found: search to draw.
    """
    draw_momentum_branches(axes, branch_diagram(found))
    title = f"{found.source} → {found.target}: {counted(len(found.events), 'bifurcation')} on {found.section.name}"
    quiet(axes, title, x=f"energy{found.system.unit('J', ' ({})')}", y="p / p₀")


def proof(axes: Axes, found: Any) -> None:
    """Draw the bounds of a proof that are small numbers.

    The radii of its balls are an example.

    Args:
        axes: panel to draw on.
        found: proof to draw.
    """
    colour = style.GOOD if found.proved else style.LIMIT
    sizes = {name.replace("_", " "): _size(value) for name, value in found.figures.items()}
    title = f"{found.kind}: {'proved' if found.proved else 'not proved'}"
    bars(axes, title, [Bar(name, size, colour) for name, size in sizes.items() if 0 < size < 1])
    axes.set_xscale("log")


def _size(value: object) -> float:
    """Return a number of a proof's figures, or 0.

    Enclosures and lists return 0.
    """
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return 0.0


def polished(axes: Axes, found: Polished) -> None:
    """Draw the effort of the robust plan and of the polished one.

    Args:
        axes: panel to draw on.
        found: both plans.
    """
    bars(axes, found.status, [Bar(side.name, side.effort, style.ARMS[0]) for side in found.sides], x="effort (m²/s³)")


def walk(axes: Axes, found: ShadowingOrbit) -> None:
    """Draw the angles of a walk over time.

    Without angles its orbit is drawn in the plane of positions.

    Args:
        axes: panel to draw on.
        found: orbit of the walk.
    """
    story = _story(found)
    if story.has_angles:
        angles(axes, found)
    else:
        walk_plane(axes, story)


def _story(found: ShadowingOrbit) -> WalkStory:
    arms = found.system.model.parameters if isinstance(found.system, ModelSystem) else None
    return WalkStory(found, arms.length if isinstance(arms, ArmChainParameters) else None)


def walk_page(found: ShadowingOrbit) -> Figure:
    """Return the page of a walk."""
    return draw_walk(found, arm_lengths=_story(found).arm_lengths, model=found.system.name)


def edges(axes: Axes, found: Edges) -> None:
    """Draw a connection graph.

    Args:
        axes: panel to draw on.
        found: edges of the graph.
    """
    draw_graph(axes, found.graph(), f"{found.system.name} at {found.energy:g}{found.system.unit('J')}")


def atlas(axes: Axes, found: Atlas) -> None:
    """Draw the cuts of the first kind of connections.

    Args:
        axes: panel to draw on.
        found: atlas to draw.
    """
    if found.kinds:
        draw_cuts(axes, found, max(found.kinds, key=lambda kind: kind.count), legend=False)


def view_of(found: Any) -> Any:
    """Return the motion to draw of a run, a plan, a log, a sustained orbit or a walk, or the object itself."""
    found = getattr(found, "log", found)
    match found:
        case Plan():
            return reference_view(found.reference, found.file)
        case SustainedOrbit():
            return sustained_view(found, found.arms.length)
        case ShadowingOrbit():
            return _story(found).view(found.system.name)
        case RunLog():
            return run_view(found) if "reference.npz" in found.attachments else series_of(found)
        case _:
            return found


def angles(axes: Axes, found: Plan | RunLog | SustainedOrbit | ShadowingOrbit) -> None:
    """Draw the angles of a plan, a log, a sustained orbit or a walk over time.

    Args:
        axes: panel to draw on.
        found: motion to draw.
    """
    view = view_of(found)
    draw_chart(axes, charts(view)["angles"], view)


def flight(axes: Axes, found: Flight) -> None:
    """Draw the angles of a flight in turns, and the cart's position as a share of its limit.

    Args:
        axes: panel to draw on.
        found: flight to draw.
    """
    times = np.linspace(*found.time_range, 400)
    states, arms = found.states(times), found.nodes.shape[1] // 2 - 1
    for arm in range(arms):
        axes.plot(times, states[:, arm] / (2 * np.pi), color=style.arm_colour(arm), label=f"arm {arm + 1}, turns")
    limit = found.limits.position
    axes.plot(times, states[:, -2] / limit, color=style.INK, linestyle="--", label=f"cart, shares of {limit:g} m")
    axes.legend()
    quiet(axes, found.status, x="s")


def plan_page(found: Plan) -> Figure:
    """Return the page of a plan."""
    return draw(view_of(found))


def comparison(axes: Axes, found: RunComparison) -> None:
    """Draw the angles of all runs on one clock.

    Args:
        axes: panel to draw on.
        found: runs to draw.
    """
    for run in found.runs:
        for arm in range(run.view.arms):
            axes.plot(run.view.time, run.view.state[:, arm], color=style.arm_colour(arm), linewidth=0.9)
    quiet(axes, found.title, x="time (s)", y="angles (rad)")


def whole_preflight(axes: Axes, found: Preflight) -> None:
    """Draw the shares of completed runs and of each other ending.

    Args:
        axes: panel to draw on.
        found: preflight to draw.
    """
    rows = [Bar("completed", found.share.rate, style.GOOD)]
    rows += [Bar(one.cause, one.runs / found.share.runs, style.LIMIT) for one in found.endings]
    bars(axes, found.status, rows, x="share of runs that end so")


def recording(axes: Axes, found: Recording) -> None:
    """Draw the measured angles, segment by segment.

    Args:
        axes: panel to draw on.
        found: recording to draw.
    """
    for part in found.split():
        for arm in range(found.arms):
            axes.plot(part.time, part.angles[:, arm], color=style.arm_colour(arm), linewidth=0.9)
    quiet(axes, f"{found.name}: {len(found.segments)} segments", x="time (s)", y="angles (rad)")
