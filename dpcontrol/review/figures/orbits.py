"""Figures of what an energy allows: Hill's regions, families of orbits, the connection graph, colour wheels, branches.

A colour wheel shows where each point inside a tube's cut goes at every return to the section. Branches are connections
against energy: where each crosses its section, is born, splits, or grazes it.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import hsv_to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch
from numpy.typing import NDArray

from dpcontrol.bifurcations.bifurcations import BranchDiagram
from dpcontrol.foundation.progress import part_of
from dpcontrol.orbits.family import lyapunov_family
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.orbits.symmetric_shooting import equilibria
from dpcontrol.review import style
from dpcontrol.review.figures.page import Gallery, Page
from dpcontrol.review.orbits import draw_families
from dpcontrol.review.page import angle_axis, new_figure, quiet
from dpcontrol.tubes.cut import tube_cut
from dpcontrol.tubes.interior import InteriorSettings, Outline, Returns, TubeInterior, tube_interior
from dpcontrol.walks.atlas import Atlas, walks

ENERGIES = (-0.3, -0.07, 0.2, 0.55)
_GRID = 241


def landscape_page(gallery: Gallery) -> Page:
    """Draw the potential as a landscape and Hill's regions at four energies, for the lab pendulum."""
    system = gallery.system("lab")
    angles = np.linspace(-np.pi, np.pi, _GRID)
    first, second = np.meshgrid(angles, angles)
    states = np.stack([first, second, 0 * first, 0 * first], axis=-1)
    potential = system.numeric.hamiltonian(states.reshape(-1, 4)).reshape(first.shape)
    points = equilibria(system)
    figure = new_figure(13.5, 3.7, "Hill's regions of the lab pendulum: what each energy opens")
    grid = figure.add_gridspec(
        1, 5, left=0.012, right=0.985, top=0.86, bottom=0.12, wspace=0.32, width_ratios=[1.45, 1, 1, 1, 1]
    )
    relief = figure.add_subplot(grid[0, 0], projection="3d")
    relief.plot_surface(first, second, potential, cmap="viridis", linewidth=0, rcount=60, ccount=60, alpha=0.95)  # type: ignore[attr-defined]
    relief.view_init(elev=38, azim=-60)  # type: ignore[attr-defined]
    relief.set_title("potential energy (J)", fontsize=10, color=style.INK, y=1.02)
    for which, label in (("x", "θ₁"), ("y", "θ₂")):
        angle_axis(relief, which, step=1.0)
        getattr(relief, f"set_{which}label")(label, fontsize=9, labelpad=-4)
    relief.tick_params(labelsize=7.5, pad=-2)
    for k, energy in enumerate(ENERGIES):
        axes = figure.add_subplot(grid[0, k + 1])
        axes.contourf(first, second, potential, levels=[potential.min() - 1, energy], colors=["#dbe9f6"])
        axes.contourf(first, second, potential, levels=[energy, potential.max() + 1], colors=["#8d959e"])
        axes.contour(first, second, potential, levels=[energy], colors=[style.INK], linewidths=1.0, linestyles="solid")
        passable = []
        for name, point in points.items():
            reached = point.energy <= energy
            mark = "o" if point.kind == "centre" else ("s" if point.kind.startswith("index-1") else "^")
            for a in {-np.pi, np.pi} if point.state[0] else {0.0}:
                for b in {-np.pi, np.pi} if point.state[1] else {0.0}:
                    axes.plot(a, b, mark, color="#2c8a4b" if reached else style.LIMIT, clip_on=False, markersize=6)
            if reached and point.kind != "centre":
                passable.append(name)
        words = {0: "no saddle reached", 2: "both saddles open", 3: "everything reached"}.get(
            len(passable), " and ".join(passable) + " open"
        )
        quiet(axes, f"{energy:g} J: {words}")
        axes.title.set_fontsize(8.5)
        axes.grid(False)
        axes.set_aspect("equal")
        angle_axis(axes, "x", step=1.0)
        angle_axis(axes, "y", step=1.0)
        axes.set_xlabel("θ₁", fontsize=9, labelpad=1)
        if k == 0:
            axes.set_ylabel("θ₂", fontsize=9, labelpad=-2)
    listed = ", ".join(f"{name} {point.energy:+.4f} J" for name, point in points.items())
    return Page(
        figure,
        "Left: the potential energy over the torus of the two angles (from hanging). Right: Hill's regions at four "
        "energies; blue may be reached, grey may not, the line between is where both arms stand still. Circle: the "
        "stable equilibrium; squares: the saddles Down-Up and Up-Down, through whose necks an arm turns; triangle: the "
        "maximum Up-Up. Green: the energy reaches it; red: it does not. Equilibria: " + listed + ".",
        "Energies are chosen one between each two equilibria, so that every kind of Hill's region is seen once; "
        "parameters are the rig's identified ones, since those printed in the paper are not the values behind its "
        "pictures.",
    )


_HIGHEST = 0.45


def families_page(gallery: Gallery) -> Page:
    """Draw the families about Down-Up and Up-Down of the lab pendulum from birth to 0.45 J."""
    system = gallery.system("lab")
    births = {name: point.energy for name, point in equilibria(system).items() if point.kind.startswith("index-1")}
    families = [lyapunov_family(system, name, energies=(birth + 1e-4, _HIGHEST)) for name, birth in births.items()]
    ends = "; ".join(f"{family.saddle}: {family.status}" for family in families)
    return Page(
        draw_families(families, "Families of Lyapunov orbits of the lab pendulum"),
        "Lyapunov orbits about each saddle from their birth at the saddle (cross) upwards in energy: their shapes in "
        "the phase plane of the arm that hangs, which swings most while the other balances; their periods; and "
        f"their unstable multipliers, by which a deviation grows in one period. {ends}.",
        "Each family is followed along its own curve until 0.45 J instead of being computed at chosen energies, so "
        "that periods and multipliers can be shown against energy. Parameters are the rig's identified ones.",
    )


GRAPH_ENERGIES = (-0.07, 0.2)
_RADIUS = 0.45
_LENGTH = 3


def graph_page(gallery: Gallery) -> Page:
    """Draw the graphs at -0.07 and 0.2 J."""
    atlases = [gallery.atlas("lab", energy, (1, 1)) for energy in GRAPH_ENERGIES]
    figure = new_figure(12, 5.6, "The connection graph: every walk on it is an itinerary")
    words = []
    for k, atlas in enumerate(atlases):
        axes = figure.add_axes((0.01 + 0.36 * k, 0.02, 0.36 if k == 0 else 0.62, 0.86))
        _graph(axes, atlas)
        graph = atlas.graph()
        count = sum(1 for node in graph.nodes for _ in walks(graph, node, length=_LENGTH))
        words.append(
            f"at {atlas.energy:g} J: {graph.number_of_nodes()} {'orbit' if len(graph) == 1 else 'orbits'}, "
            f"{graph.number_of_edges()} connections, {count:,} walks of {_LENGTH} symbols"
        )
    return Page(
        figure,
        "Nodes are Lyapunov orbits, each arrow is one connection: solid where it is symmetric, dashed where it is one "
        "of a mirror pair; above a node the positive sense, below it the negative. "
        f"There are {'; '.join(words)}. Before each symbol the arms may wobble as often as wanted.",
        "There is one arrow for each first-hit connection on the torus of angles, so that reflected and mirrored ones, "
        "which are different motions, are counted. At -0.07 J Up-Down has no orbit, and no arrow can lead there.",
    )


def _graph(axes: Axes, atlas: Atlas) -> None:
    places = {orbit.name: (3.9 * k, 0.0) for k, orbit in enumerate(atlas.orbits)}
    for orbit in atlas.orbits:
        x, y = places[orbit.name]
        axes.add_patch(Circle((x, y), _RADIUS, color=style.saddle_colour(orbit.saddle), zorder=5))
        axes.text(x, y, orbit.name, ha="center", va="center", color="white", fontsize=8.5, weight="bold", zorder=6)
        for sign in (1, -1):
            loops = [c for c in atlas.between(orbit.saddle, orbit.saddle) if c.sense == sign]
            loops.sort(key=lambda c: not c.symmetric)
            for k, c in enumerate(loops):
                size = 0.4 + 0.12 * k
                _loop(axes, x, y + sign * _RADIUS * 0.85, sign, size, dashed=not c.symmetric, saddle=orbit.saddle)
            if loops:
                top = y + sign * (_RADIUS + 2 * (0.4 + 0.12 * (len(loops) - 1)) + 0.12)
                turning = "outer" if loops[0].winding[1] else "inner"
                axes.text(x, top, f"{len(loops)}: {turning} arm {sign:+d} turn", ha="center", va="center",
                          fontsize=9, color=style.INK)  # fmt: skip
    for source, target in ((a, b) for a in places for b in places if a != b):
        found = atlas.between(source, target)
        for k, c in enumerate(found):
            bend = -(0.1 + 0.16 * k)
            (x0, _), (x1, _) = places[source], places[target]
            step = np.sign(x1 - x0) * _RADIUS
            axes.add_patch(
                FancyArrowPatch(
                    (x0 + step, 0), (x1 - step, 0), connectionstyle=f"arc3,rad={bend}", arrowstyle="-|>",
                    mutation_scale=13, color=style.saddle_colour(source), linewidth=1.4,
                    linestyle="-" if c.symmetric else (0, (5, 2)), shrinkA=4, shrinkB=4,
                )
            )  # fmt: skip
        if found:
            side = 1 if places[target][0] > places[source][0] else -1
            axes.text(1.95, side * 1.28, f"{len(found)}: {source} → {target}", ha="center", fontsize=9, color=style.INK)
    width = 1.6 + 3.9 * (len(places) - 1) / 2
    middle = 3.9 * (len(places) - 1) / 2
    axes.set_xlim(middle - width, middle + width)
    axes.set_ylim(-3.0, 3.35)
    axes.set_aspect("equal")
    axes.axis("off")
    axes.text(middle, 3.2, f"{atlas.energy:g} J", ha="center", fontsize=12, color=style.INK)


def _loop(axes: Axes, x: float, y: float, sign: int, size: float, *, dashed: bool, saddle: str) -> None:
    """Draw an arrow from a node to itself: an ellipse that touches it, with a head where it comes back."""
    t = np.linspace(0.02, 0.98, 120) * 2 * np.pi
    px, py = x - 0.55 * size * np.sin(t), y + sign * size * (1 - np.cos(t))
    colour = style.saddle_colour(saddle)
    axes.plot(px, py, color=colour, linewidth=1.3, linestyle=(0, (5, 2)) if dashed else "-", zorder=3)
    axes.annotate("", (px[-12], py[-12]), (px[-18], py[-18]),
                  arrowprops={"arrowstyle": "-|>", "color": colour, "mutation_scale": 10})  # fmt: skip


Array = NDArray[np.float64]


def draw_interior(interior: TubeInterior) -> Figure:
    """Return the figure: the start and its forward returns above, its backward returns below."""
    returns = interior.forward.arrived.shape[1]
    figure = Figure(figsize=(3.5 * (returns + 1), 7.9), dpi=110, facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplots(
        2, returns + 1, sharex=True, sharey=True,
        gridspec_kw={"left": 0.055, "right": 0.99, "top": 0.855, "bottom": 0.08, "wspace": 0.06, "hspace": 0.2},
    )  # fmt: skip
    figure.suptitle(_heading(interior), x=0.055, y=0.975, ha="left", fontsize=13, color=style.INK)
    saturation = 0.12 + 0.88 * np.clip(interior.radius, 0, 1)
    hue = interior.angle / (2 * np.pi)
    colours = hsv_to_rgb(np.column_stack([hue, saturation, np.full(len(hue), 0.93)]))
    own = next(o for o in interior.outlines if o.branch == interior.branch and not o.stable)
    direction = own.direction
    size = _marker(interior)
    both = (interior.forward, interior.backward)
    for row, run in enumerate(both):
        _start(axes[row, 0], interior, colours, direction, size)
        for k in range(returns):
            ax = axes[row, k + 1]
            _returned(ax, run, k, colours, direction, size)
            _outlines(ax, interior.outlines, direction)
            word = "forward" if row == 0 else "backward"
            ax.set_title(_title(run, k, f"return {k + 1} {word}"), fontsize=9, color=style.INK)
    axes[0, 0].set_title(f"start: {len(hue)} points", fontsize=9, color=style.INK)
    axes[1, 0].set_title("start", fontsize=9, color=style.INK)
    arrived = np.concatenate([r.points[r.arrived] for r in both] + [o.vertices for o in interior.outlines])
    high = 1.08 * float(np.abs(arrived[:, 1]).max())
    wide = min(np.pi, 1.08 * float(np.abs(arrived[:, 0]).max()))
    axes[0, 0].set_xlim(-wide, wide)
    axes[0, 0].set_ylim(-high, high)
    for ax in axes[1]:
        ax.set_xlabel("q (rad)", fontsize=9)
    for ax in axes[:, 0]:
        ax.set_ylabel("p / p₀", fontsize=9)
    figure.text(
        0.055, 0.928,
        "Hue: angle about the innermost point at the start; saturation: how near to the cut. Pale dots cross the "
        "section against the start's direction.\nRed: cut of the unstable tube; green: of the stable tube; pale: "
        "cuts crossed against the start's direction.",
        fontsize=9, color=style.CART, va="center",
    )  # fmt: skip
    return figure


def _heading(interior: TubeInterior) -> str:
    orbit = interior.orbit
    return (
        f"Inside the unstable tube of {orbit.saddle} at {orbit.energy:g} J "
        f"(branch {interior.branch:+d}), cut on {interior.section.name}"
    )


def _marker(interior: TubeInterior) -> float:
    """Return the marker's area in points² at which neighbours of the start's grid overlap."""
    spans = np.ptp(interior.points, axis=0)
    across = max(len(np.unique(np.round(interior.points[:, k], 9))) for k in (0, 1))
    # A cut takes about a half of an axis that is 230 points long either way.
    share = float(np.clip(max(spans / (2 * np.abs(interior.points).max(axis=0))), 0.3, 1.0))
    return float(np.clip((1.05 * 230 * share / across) ** 2, 2.5, 60.0))


def _start(ax: Axes, interior: TubeInterior, colours: Array, direction: int, size: float) -> None:
    q = (interior.points[:, 0] + np.pi) % (2 * np.pi) - np.pi
    ax.scatter(q, interior.points[:, 1], s=size, c=colours, marker="s", linewidths=0)
    _outlines(ax, interior.outlines, direction)


def _returned(ax: Axes, run: Returns, k: int, colours: Array, direction: int, size: float) -> None:
    for way, opacity in ((-direction, 0.3), (direction, 1.0)):
        here = run.arrived[:, k] & (run.direction[:, k] == way)
        points = run.points[here, k]
        ax.scatter(points[:, 0], points[:, 1], s=0.5 * size, c=colours[here], alpha=opacity, linewidths=0)


def _outlines(ax: Axes, outlines: tuple[Outline, ...], direction: int) -> None:
    for outline in outlines:
        closed = np.vstack([outline.vertices, outline.vertices[:1]])
        turns = np.rint((closed[:, 0].min() + closed[:, 0].max()) / 2 / (2 * np.pi))
        colour = style.STABLE if outline.stable else style.UNSTABLE
        opacity = 1.0 if outline.direction == direction else 0.25
        ax.plot(closed[:, 0] - 2 * np.pi * turns, closed[:, 1], color=colour, lw=1.1, alpha=opacity)
    ax.tick_params(labelsize=8, colors=style.CART)
    for spine in ax.spines.values():
        spine.set_color(style.FAINT)


def _title(run: Returns, k: int, name: str) -> str:
    arrived = run.arrived[:, k]
    count = max(1, int(arrived.sum()))
    stable = np.count_nonzero(run.in_stable[arrived, k]) / count
    unstable = np.count_nonzero(run.in_unstable[arrived, k]) / count
    missing = np.count_nonzero(~arrived)
    text = f"{name}\n{unstable:.0%} in unstable, {stable:.0%} in stable cuts"
    return text + (f", {missing} do not return" if missing else "")


ENERGY = -0.07
SADDLE = "down-up"


def wheels_page(gallery: Gallery) -> Page:
    """Draw two returns each way of the inside of Down-Up's unstable tube at -0.07 J."""
    system = gallery.system("lab")
    orbit = lyapunov_orbit(system, SADDLE, energy=ENERGY)
    manifold = UnstableManifold(orbit)
    cut = tube_cut(manifold, system.sections[SADDLE, SADDLE])
    interior = tube_interior(manifold, cut, settings=InteriorSettings(returns=2))
    return Page(
        draw_interior(interior),
        f"A grid over the inside of the unstable tube of Down-Up at {ENERGY:g} J, coloured like a wheel where it first "
        "meets the section, and where its points are at each return forward (above) and backward (below) in time. "
        f"What lands inside a tube's cut will pass, or has passed, the neck at Down-Up again. {interior.status}.",
        "Coordinates are canonical, so that coloured areas keep their size from return to return, and returns are "
        "drawn in both directions of time.",
    )


KINDS = (("down-up", "down-up"), ("up-down", "up-down"), ("down-up", "up-down"))
MARKS = {"saddle-node": "o", "pitchfork": "^", "section-artefact": "D"}
_BETWEEN, _PAIR = "#c2185b", "#7c858e"
_WORDS = {
    "saddle-node": "saddle-node: two are born",
    "pitchfork": "pitchfork: one sheds a mirror pair",
    "section-artefact": "artefact: the section is grazed, none is born",
}
_COORDINATES = {"down-up": ("θ₁", "θ₂ = 2πk"), "up-down": ("θ₂", "θ₁ = 2πk"), "between": ("θ₁", "θ₁ = θ₂ + 2πk")}
_ON_MIRROR = 1e-5  # rad


def branches_page(gallery: Gallery) -> Page:
    """Draw first-hit homoclinics of both saddles and the heteroclinics of the lab pendulum against energy."""
    diagrams = [
        gallery.branches("lab", source, target, part_of(gallery.progress, k / len(KINDS), (k + 1) / len(KINDS)))
        for k, (source, target) in enumerate(KINDS)
    ]
    figure = new_figure(15, 8.2, "Connections of the lab pendulum against energy (first hits)")
    grid = figure.add_gridspec(2, 3, left=0.05, right=0.99, top=0.86, bottom=0.07, hspace=0.2, wspace=0.2)
    for column, diagram in enumerate(diagrams):
        coordinate, section = _COORDINATES[diagram.source if diagram.source == diagram.target else "between"]
        title = (
            f"{diagram.source} to itself"
            if diagram.source == diagram.target
            else (f"{diagram.source} to {diagram.target}")
        )
        for row, label in enumerate((f"{coordinate} (rad)", "p / p₀")):
            axes = figure.add_subplot(grid[row, column])
            _branches(axes, diagram, row)
            quiet(axes, f"{title}: on {section}" if row == 0 else "")
            axes.set_ylabel(label, fontsize=9, labelpad=1)
            if row == 0:
                angle_axis(axes, "y")
            else:
                axes.set_xlabel("energy (J)", fontsize=9)
                _counts(axes, diagram)
    lines = [
        Line2D([], [], color=style.saddle_colour("down-up"), lw=1.8, label="symmetric (teal, violet)"),
        Line2D([], [], color=_PAIR, lw=1.2, label="one of a mirror pair"),
        Line2D([], [], color=_BETWEEN, lw=1.1, label="between different saddles"),
        *(
            Line2D([], [], color=style.INK, marker=MARKS[kind], lw=0, markersize=6, mfc="white", label=_WORDS[kind])
            for kind in MARKS
        ),
    ]
    figure.legend(
        handles=lines,
        loc="upper left",
        bbox_to_anchor=(0.042, 0.955),
        ncol=6,
        fontsize=8.5,
        columnspacing=1.2,
        frameon=False,
    )
    return Page(figure, _caption(diagrams), _differs(diagrams))


def _branches(axes: Axes, diagram: BranchDiagram, coordinate: int) -> None:
    homoclinic = diagram.source == diagram.target
    for energies, points in diagram.runs:
        symmetric = homoclinic and bool(np.all(np.abs(np.sin(points[:, 0])) < _ON_MIRROR))
        colour = style.saddle_colour(diagram.source) if symmetric else _PAIR if homoclinic else _BETWEEN
        look = {"color": colour, "linewidth": 1.8 if symmetric else 1.1, "solid_capstyle": "round"}
        values = _wrapped(points)[:, coordinate]
        # A branch that leaves the period on one side comes in on the other.
        for part in np.split(np.arange(len(values)), np.flatnonzero(np.abs(np.diff(values)) > np.pi) + 1):
            axes.plot(energies[part], values[part], **look, zorder=3 if symmetric else 2)
    for mark in diagram.marks:
        value = _wrapped(np.array([mark.point]))[0, coordinate]
        axes.plot(mark.energy, value, MARKS[mark.kind], color=style.INK, mfc="white", markersize=5.5, zorder=5)
    if diagram.scatters_from is not None:
        axes.axvspan(diagram.scatters_from, diagram.counts[-1][0], color="#f3e9e8", zorder=0)
    axes.set_xlim(diagram.counts[0][0], diagram.counts[-1][0])


def _wrapped(points: Array) -> Array:
    """Return points (K, 2) with the angle inside one turn about zero."""
    angles = (points[:, 0] + np.pi) % (2 * np.pi) - np.pi
    # On the mirror at half a turn, rounding would throw points to both ends.
    angles = np.where(angles < -np.pi + _ON_MIRROR, angles + 2 * np.pi, angles)
    return np.column_stack([angles, points[:, 1]])


def _counts(axes: Axes, diagram: BranchDiagram) -> None:
    """Write along the lower edge how many connections there are between one event and the next."""
    shown, last, span = -1, -np.inf, diagram.counts[-1][0] - diagram.counts[0][0]
    look = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points", "fontsize": 8, "color": style.CART}
    for energy, count, complete in diagram.counts:
        room = energy - last > 0.05 * span and diagram.counts[-1][0] - energy > 0.1 * span
        if count != shown and room:
            axes.annotate(f"{'' if complete else '≥'}{count}", (energy, 0.0), xytext=(2, 3), **look)
            shown, last = count, energy
    energy, count, complete = diagram.counts[-1]
    if count != shown:
        axes.annotate(f"{'' if complete else '≥'}{count}", (energy, 0.0), xytext=(-2, 3), ha="right", **look)


def _caption(diagrams: list[BranchDiagram]) -> str:
    words = []
    for d in diagrams:
        name = f"{d.source} to itself" if d.source == d.target else f"{d.source} to {d.target}"
        kinds = ", ".join(
            f"{n} {kind}{'s' if n > 1 else ''}" for kind in MARKS if (n := sum(m.kind == kind for m in d.marks))
        )
        least = "" if d.counts[-1][2] else "at least "
        words.append(f"{name}: {d.counts[0][1]} connections at {d.counts[0][0]:.4f} J and {least}{d.counts[-1][1]} at "
                     f"{d.counts[-1][0]:.4f} J by {kinds}")  # fmt: skip
    unexplained = sum(d.unexplained for d in diagrams)
    causes = (
        "Every change of the numbers has a located cause"
        if not unexplained
        else (f"{unexplained} changes of the numbers have no located cause")
    )
    return (
        "Where each connection crosses its section, as energy grows: its angle there (above) and the momentum across "
        "(below). Each curve is a connection followed by continuation, round its folds too; marks are events, each "
        "solved by its own equations. Numbers along the lower edge count all connections on the torus; curves show one "
        f"sense, whose mirror images under (θ, ω) → (-θ, -ω) are the other. {_scattering(diagrams)}"
        f"{'; '.join(words)}. {causes}."
    )


def _scattering(diagrams: list[BranchDiagram]) -> str:
    what = (
        "trajectories of a tube pass by another orbit and scatter before they arrive, connections accumulate, and "
        "those found are some of them"
    )
    if any(d.scatters_from is not None for d in diagrams):
        return f"Shaded: {what}. "
    highest = diagrams[2].counts[-1][0]
    return f"Those between different saddles are drawn up to {highest:.3f} J; from about 0.237 J on {what}. "


def _differs(diagrams: list[BranchDiagram]) -> str:
    onset = min((m.energy for m in diagrams[2].marks), default=float("nan"))
    return (
        "Folds and splittings are located instead of read off a list of counts, and distinguished from grazes of the "
        "section, which only move a connection to another number of hits. Both orbits exist from 0.1754 J on, which "
        "the paper gives for the onset of heteroclinics; the first of them that meets its section once each appears at "
        f"{onset:.6f} J, and none below it. Counts are of both senses and of all images on the torus. Parameters are "
        "the rig's identified ones; with those printed in the text all these energies differ."
    )
