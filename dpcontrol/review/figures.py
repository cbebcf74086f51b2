"""The paper's computational figures: pages with their words, what they are drawn from, and drawing them by name.

The lab pendulum's tubes, its homoclinic connections of one and more turns and its heteroclinic ones, and the first
connection between L1 and L2 of three bodies. Hill's regions, families of orbits, the connection graph, and colour
wheels: where each point inside a tube's cut goes at every return to the section. Branches are connections against
energy: where each crosses its section, is born, splits, or grazes it.
"""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import hsv_to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch

from dpcontrol.bifurcations.bifurcations import BranchDiagram
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import write_whole
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.orbits.family import lyapunov_family
from dpcontrol.orbits.lyapunov import equilibria, lyapunov_orbit
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.review import style
from dpcontrol.review.atlas import (
    BRANCHES,
    colours,
    connections_of,
    draw_angles,
    draw_cuts,
    draw_row,
    draw_space,
    kind_of,
    one_of_each,
    placed,
)  # fmt: skip
from dpcontrol.review.orbits import draw_families
from dpcontrol.review.page import DOTTED, angle_axis, key, new_figure, quiet, save_figure
from dpcontrol.tubes.cut import tube_cut
from dpcontrol.tubes.intersections import InteriorSettings, Outline, Returns, TubeInterior, tube_interior
from dpcontrol.walks.atlas import Atlas, AtlasConnection, walks


@dataclass(frozen=True)
class Gallery:
    """What figures are drawn from; each figure asks for what it needs.

    system: of a model by name. atlas: of a model, an energy in J and hits (None: the first that there are).
    branches: of a model, a source and a target, with what to report to: their connections against energy.
    progress: where the figure being drawn reports how far it is.
    """

    system: Callable[[str], System]
    atlas: Callable[[str, float, tuple[int, int] | None], Atlas]
    branches: Callable[[str, str, str, Progress], BranchDiagram]
    progress: Progress = no_progress


@dataclass(frozen=True)
class Page:
    """A figure with its words: what it shows, and what differs from the paper's and why."""

    figure: Figure
    caption: str
    differs: str


ENERGY = -0.07
SADDLE = "down-up"


def tubes_page(gallery: Gallery) -> Page:
    """Draw the tubes of Down-Up at -0.07 J up to the section, and their cuts."""
    atlas = gallery.atlas("lab", ENERGY, (1, 1))
    kind = kind_of(atlas, SADDLE, SADDLE)
    assert kind is not None
    figure = new_figure(13.5, 5.8, f"The tubes of the Lyapunov orbit about Down-Up at {ENERGY:g} J, and their cuts")
    space = figure.add_axes((0.06, -0.03, 0.5, 0.98), projection="3d")
    cuts = [cut for cut in atlas.cuts if (cut.saddle, cut.section.name, cut.hit) == (SADDLE, kind.section, 1)]
    draw_space(space, atlas, cuts, one_colour=style.INK, steps=(0.25, 1.0))
    looks = [
        (f"{'stable' if stable else 'unstable'} tube, {'forward' if branch > 0 else 'backward'} branch", colour)
        for (stable, branch), colour in BRANCHES.items()
    ]
    orbit, cut = {"color": style.INK, "linewidth": 2.5}, {"color": style.CUT, "linewidth": 2}
    looks += [("Lyapunov orbit", orbit), ("cut on θ₂ = 2πk", cut)]
    key(space, looks, fontsize=8, loc="upper left", bbox_to_anchor=(-0.22, 0.97))
    axes = figure.add_axes((0.62, 0.1, 0.37, 0.75))
    draw_cuts(axes, atlas, kind)
    return Page(
        figure,
        f"Left: trajectories that leave the Lyapunov orbit about Down-Up at {ENERGY:g} J (red) and that come to it "
        "(green) form tubes; the two shades are the tube's two branches, on which the outer arm turns one way or the "
        "other. They end on the section on which the outer arm hangs straight down. Right: there each tube is a closed "
        "curve, q the inner arm's angle, p its momentum over p₀; solid where it is crossed with the outer arm's angle "
        f"rising, dashed where falling. Where two of one kind meet lie the {kind.count} homoclinic connections.",
        f"The energy is that of the homoclinic connections, {ENERGY:g} J; the paper need not have drawn its tubes at "
        "the same. The section's coordinates are canonical. Parameters are the rig's identified ones, which reproduce "
        "the paper's pictures; those it prints do not.",
    )


_MOST = 5


def _low(gallery: Gallery) -> Page:
    return _page(
        gallery.atlas("lab", -0.07, (1, 1)),
        ["down-up"],
        "Below the energy of Up-Down only the outer arm can turn over.",
        "The search finds its own intersections, without windows set by hand: in each sense two symmetric connections "
        "and a mirror pair, all counted on the torus of angles. Section coordinates are canonical.",
    )


def _high(gallery: Gallery) -> Page:
    return _page(
        gallery.atlas("lab", 0.2, (1, 1)),
        ["down-up", "up-down"],
        "At this energy both saddles have orbits: the outer arm turns about Down-Up, the inner arm about Up-Down.",
        "Counts are of first hits on these sections, both senses and mirror images included; cuts that graze the "
        "section are open there, and crossings beyond their ends belong to later hits.",
    )


def _page(atlas: Atlas, saddles: list[str], lead: str, differs: str) -> Page:
    """Draw the homoclinic connections of saddles, a row for each."""
    tall = 0.7 + 4.3 * len(saddles)
    figure = new_figure(14, tall, f"Homoclinic connections at {atlas.energy:g} J (first hits)")
    grid = figure.add_gridspec(
        len(saddles), 1, left=0.05, right=0.99, top=1 - 0.95 / tall, bottom=0.5 / tall, hspace=0.32
    )
    words = []
    for row, saddle in enumerate(saddles):
        kind = kind_of(atlas, saddle, saddle)
        assert kind is not None
        connections = atlas.between(saddle, saddle)
        kept = one_of_each(connections)[:_MOST]
        # Where the outer arm turns flights are tall, where the inner one does they are wide.
        flat = not kept[0].winding[1]
        draw_row(figure, grid[row, 0], atlas, kind, kept, numbers=numbered(connections, kept), flat=flat)
        symmetric = sum(c.symmetric for c in connections)
        word = "closed" if kind.complete else "open in places"
        words.append(
            f"{saddle}: {kind.count} connections ({symmetric} symmetric, {kind.count - symmetric} in mirror pairs), "
            f"largest residual {max(c.residual for c in connections):.0e}, cuts {word}"
        )
    return Page(
        figure,
        f"{lead} Left: the cuts of the unstable (red) and stable (green) tube; dots of one colour are one connection "
        "and its mirror images. Right: one flight of each colour, of positive sense, in the plane of the angles (pale: "
        "the orbits it leaves and joins; dot: where it passes the section), with the angle at which the cuts meet. "
        f"{'; '.join(words)}.",
        differs,
    )


def numbered(connections: tuple[AtlasConnection, ...], kept: list[AtlasConnection]) -> dict[str, str]:
    """Return the number of each connection by name: that of the kept one of its colour."""
    look = colours(connections)
    number = {look[c.name]: str(k + 1) for k, c in enumerate(kept)}
    return {c.name: number[look[c.name]] for c in connections if look[c.name] in number and np.isfinite(c.point[1])}


HETEROCLINIC_ENERGY = 0.2
PAIRS = (("down-up", "up-down"), ("up-down", "down-up"))


def heteroclinics_page(gallery: Gallery) -> Page:
    """Draw the connections from Down-Up to Up-Down and back at 0.2 J."""
    atlas = gallery.atlas("lab", HETEROCLINIC_ENERGY, (1, 1))
    figure = new_figure(
        14, 9.2, f"Heteroclinic connections between Down-Up and Up-Down at {HETEROCLINIC_ENERGY:g} J (first hits)"
    )
    grid = figure.add_gridspec(2, 1, left=0.05, right=0.99, top=0.89, bottom=0.06, hspace=0.32)
    counts = []
    for row, (source, target) in enumerate(PAIRS):
        kind = kind_of(atlas, source, target)
        assert kind is not None
        shown = atlas.between(source, target)[:4]
        numbers = {c.name: "abcdefgh"[4 * row + k] for k, c in enumerate(shown)}
        draw_row(figure, grid[row, 0], atlas, kind, shown, numbers=numbers, share=1.75)
        counts.append(f"{kind.count} from {source} to {target}")
    return Page(
        figure,
        "On the section both arms are aligned, θ₁ = θ₂ + 2πk. Left: where the unstable tube (red) of the orbit that is "
        "left meets the stable tube (green) of the orbit that is joined. Right: the flights in the plane of the "
        "angles, from the source's named position; pale teal is the orbit about Down-Up, pale violet that about "
        f"Up-Down. {' and '.join(counts)}; those in one direction are those in the other, run backward in time.",
        'The paper\'s heteroclinics "at H = -0.07" cannot exist, since Up-Down has no orbit below its energy of '
        "0.1754 J. Here both directions are drawn, and each connection with its reflection; the unstable tube's cut is "
        "open where its trajectories graze the section.",
    )


_SHOWN = 3
_TURNS = {2: ("Double", "second", "twice", "two"), 3: ("Triple", "third", "three times", "three")}


def draw_repeated(gallery: Gallery, *, turns: int) -> Page:
    """Draw connections of Down-Up at -0.07 J that turn the outer arm several times, and how they go."""
    # A flight that turns the outer arm twice passes it hanging twice: the unstable tube's second time is the last.
    hits = (turns, 1)
    title, ordinal, times, number = _TURNS[turns]
    atlas = gallery.atlas("lab", ENERGY, hits)
    kind = kind_of(atlas, SADDLE, SADDLE)
    assert kind is not None
    connections = atlas.between(SADDLE, SADDLE)
    repeated = [c for c in connections if tuple(map(abs, c.winding)) == (0, turns) and c.sense > 0]
    # Time reversal moves the section to the other passage, so images of one flight are recognised by its length.
    lengths: dict[float, AtlasConnection] = {}
    for c in sorted(repeated, key=lambda c: (c.time_in + c.time_out, c.name)):
        lengths.setdefault(round(c.time_in + c.time_out, 4), c)
    kept = list(lengths.values())[:_SHOWN] or [c for c in connections if c.sense > 0][:_SHOWN]
    figure = new_figure(14, 8.2, f"{title} homoclinic connections of Down-Up at {ENERGY:g} J (hits {list(hits)})")
    grid = figure.add_gridspec(2, 1, left=0.05, right=0.99, top=0.84, bottom=0.09, hspace=0.3, height_ratios=[1.5, 1])
    names = {c.name: "abc"[k] for k, c in enumerate(kept)}
    draw_row(figure, grid[0, 0], atlas, kind, kept, numbers=names, marked=tuple(kept))
    below = grid[1, 0].subgridspec(1, max(len(kept), 1), wspace=0.15)
    for k, c in enumerate(kept):
        panel = figure.add_subplot(below[0, k])
        draw_angles(panel, atlas, c)
        panel.set_title(f"{names[c.name]}: θ₁ blue, θ₂ orange, against time (s)", fontsize=8.5, loc="left")
    windings = {tuple(int(v) for v in np.abs(c.winding)) for c in connections}
    counts = ", ".join(
        f"{sum(tuple(map(abs, c.winding)) == t for c in connections)} of winding ±{list(t)}" for t in sorted(windings)
    )
    resolved = all(atlas.cut(SADDLE, kind.section, hit).resolved for hit in hits)
    torn = " and is drawn as far as it could be resolved: more connections than these exist"
    return Page(
        figure,
        f"Above, left: the cuts of the unstable tube at its {ordinal} crossing of θ₂ = 2πk and of the stable tube at "
        "its first one back, with the connections shown at right: flights in the plane of the angles, in which the "
        f"outer arm turns {times} before the arms settle about Down-Up again, {number} turns on (dot: the section at "
        "time zero). Below: both angles against time; dotted lines mark where the flight leaves one orbit and joins "
        f"the other. {'In all' if resolved else 'At least'} {len(connections)} connections were found at these hits: "
        f"{counts}; those of smaller winding turn there and back. The cut is in pieces, torn apart where the tube "
        f"passes near the orbit again{'' if resolved else torn}.",
        "The paper cuts them on θ₂ = 4π and 6π; here the section is that of the single ones, θ₂ = 2πk, at later hits. "
        "On θ₁ = θ₂ `dpcontrol connect --section aligned` lists them.",
    )


THREE_BODY_ENERGY = -1.5175


def three_body_page(gallery: Gallery) -> Page:
    """Draw L1's and L2's Lyapunov orbits, their tubes to x = 1 - μ, and the first connection from L1 to L2."""
    atlas, system = gallery.atlas("three-body", THREE_BODY_ENERGY, None), gallery.system("three-body")
    kind = kind_of(atlas, "L1", "L2")
    assert kind is not None
    mu = float(system.parameters[0])
    figure = new_figure(
        14, 5.6, f"Three bodies: orbits about L1 and L2 at energy {THREE_BODY_ENERGY:g}, tubes, first connection"
    )
    plane = figure.add_axes((0.045, 0.1, 0.36, 0.76))
    _forbidden(plane, gallery)
    _tubes(plane, atlas, kind.section, kind.hits[0])
    _bodies(plane, atlas, mu)
    looks = [("unstable tube of L1", style.UNSTABLE), ("stable tube of L2", style.STABLE)]
    key(plane, looks, fontsize=8, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=2, borderaxespad=0.2)
    cuts = figure.add_axes((0.46, 0.1, 0.22, 0.76))
    draw_cuts(cuts, atlas, kind, numbers={c.name: "ab"[k] for k, c in enumerate(connections_of(atlas, kind)[:2])},
              legend=False)  # fmt: skip
    cuts.set_title(f"cuts on {kind.section.replace('mu', 'μ')}, hits {list(kind.hits)}", fontsize=10, loc="left")
    flight = figure.add_axes((0.72, 0.1, 0.27, 0.76))
    _forbidden(flight, gallery)
    connections = connections_of(atlas, kind)
    look = colours(connections)
    for c in connections[:1]:
        flight.plot(c.states[:, 0], c.states[:, 1], color=look[c.name], linewidth=1.1, zorder=3)
    _bodies(flight, atlas, mu)
    flight.set_title("a  from L1's orbit to L2's" if connections else "none found", fontsize=10, loc="left")
    return Page(
        figure,
        "The planar circular restricted three-body problem in the rotating frame, mass ratio "
        f"{mu:g}, near the smaller primary (dot). Grey: out of reach at this energy. Left: Lyapunov orbits about L1 "
        f"(teal) and L2 (violet), the unstable tube of L1 and the stable tube of L2 up to their crossing number "
        f"{kind.hits[0]} of the line x = 1 - μ. Middle: the cuts there, with the {kind.count} connections found. "
        "Right: the first of them, whole.",
        f"Both tubes pass the line once before they can meet: hits {list(kind.hits)} are the first at which there are "
        "connections from L1 to L2. The energy's constant is that of the paper's appendix. Cuts are open where "
        "trajectories of the tube pass close to the smaller primary and are scattered.",
    )


def _forbidden(axes: Axes, gallery: Gallery) -> None:
    system = gallery.system("three-body")
    x, y = np.meshgrid(np.linspace(0.88, 1.12, 240), np.linspace(-0.12, 0.12, 240))
    # At rest in the rotating frame the energy is the effective potential.
    states = np.stack([x, y, 0 * x, 0 * x], axis=-1).reshape(-1, 4)
    potential = system.numeric.hamiltonian(states).reshape(x.shape)
    axes.contourf(x, y, potential, levels=[THREE_BODY_ENERGY, 1e9], colors=["#c4c9cf"])
    quiet(axes, x="x", y="y")
    axes.grid(False)
    axes.set(xlim=(0.89, 1.11), ylim=(-0.11, 0.11), aspect="equal")


def _tubes(axes: Axes, atlas: Atlas, section: str, hit: int) -> None:
    for saddle, colour in (("L1", style.UNSTABLE), ("L2", style.STABLE)):
        cut = atlas.cut(saddle, section, hit)
        for strand in cut.strands:
            states = atlas.turned(strand, saddle) if colour == style.STABLE else strand
            axes.plot(states[:, 0], states[:, 1], color=colour, linewidth=0.45, alpha=0.75)


def _bodies(axes: Axes, atlas: Atlas, mu: float) -> None:
    for orbit in atlas.orbits:
        closed = placed(atlas, orbit)
        axes.plot(closed[:, 0], closed[:, 1], color=style.saddle_colour(orbit.saddle), linewidth=2.4, zorder=5)
        axes.annotate(orbit.saddle, closed[:, :2].max(axis=0), fontsize=9, color=style.saddle_colour(orbit.saddle))
    axes.plot(1 - mu, 0, "o", color=style.INK, markersize=5, zorder=6)
    axes.axvline(1 - mu, color=style.MARK, linewidth=0.8, linestyle=DOTTED)


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
        quiet(axes, f"{energy:g} J: {words}", x="θ₁", y="" if k else "θ₂", size=8.5)
        axes.grid(False)
        axes.set_aspect("equal")
        angle_axis(axes, "x", step=1.0)
        angle_axis(axes, "y", step=1.0)
    listed = ", ".join(f"{name} {point.energy:+.4f} J" for name, point in points.items())
    return Page(
        figure,
        "Left: the potential energy over the torus of the two angles (from hanging). Right: Hill's regions at four "
        "energies; blue may be reached, grey may not. Circle: the stable equilibrium; squares: the saddles Down-Up and "
        "Up-Down, through whose necks an arm turns; triangle: the maximum Up-Up. Green: the energy reaches it; red: it "
        "does not. Equilibria: " + listed + ".",
        "Energies are chosen one between each two equilibria; parameters are the rig's identified ones, since those "
        "printed in the paper are not the values behind its pictures.",
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
    for source, target in permutations(places, 2):
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
    middle = 3.9 * (len(places) - 1) / 2
    axes.set(xlim=(-1.6, 2 * middle + 1.6), ylim=(-3.0, 3.35), aspect="equal")
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


def draw_interior(interior: TubeInterior) -> Figure:
    """Return the figure: the start and its forward returns above, its backward returns below."""
    returns, orbit = interior.forward.arrived.shape[1], interior.orbit
    figure = new_figure(
        3.5 * (returns + 1), 7.9, f"Inside the unstable tube of {orbit.saddle} at {orbit.energy:g} J "
        f"(branch {interior.branch:+d}), cut on {interior.section.name}"
    )  # fmt: skip
    panels = figure.subplots(
        2, returns + 1, sharex=True, sharey=True,
        gridspec_kw={"left": 0.055, "right": 0.99, "top": 0.855, "bottom": 0.08, "wspace": 0.06, "hspace": 0.2},
    )  # fmt: skip
    saturation = 0.12 + 0.88 * np.clip(interior.radius, 0, 1)
    hue = interior.angle / (2 * np.pi)
    colours = hsv_to_rgb(np.column_stack([hue, saturation, np.full(len(hue), 0.93)]))
    direction = next(o.direction for o in interior.outlines if o.branch == interior.branch and not o.stable)
    size = _marker(interior)
    for row, (word, run) in enumerate((("forward", interior.forward), ("backward", interior.backward))):
        for k, axes in enumerate(panels[row]):
            quiet(axes, f"start: {len(hue)} points", x="q (rad)" if row else "", y="" if k else "p / p₀", size=9)
            axes.grid(False)
            _outlines(axes, interior.outlines, direction)
            if k == 0:
                q = (interior.points[:, 0] + np.pi) % (2 * np.pi) - np.pi
                axes.scatter(q, interior.points[:, 1], s=size, c=colours, marker="s", linewidths=0)
                continue
            for way, opacity in ((-direction, 0.3), (direction, 1.0)):
                here = run.arrived[:, k - 1] & (run.direction[:, k - 1] == way)
                points = run.points[here, k - 1]
                axes.scatter(*points.T, s=0.5 * size, c=colours[here], alpha=opacity, linewidths=0)
            axes.set_title(_returned(run, k, word), loc="left", fontsize=9)
    both = (interior.forward, interior.backward)
    arrived = np.concatenate([r.points[r.arrived] for r in both] + [o.vertices for o in interior.outlines])
    wide, high = 1.08 * np.abs(arrived).max(axis=0)
    panels[0, 0].set(xlim=(-min(np.pi, wide), min(np.pi, wide)), ylim=(-high, high))
    figure.text(
        0.055, 0.928,
        "Hue: angle about the innermost point at the start; saturation: how near to the cut. Pale dots cross the "
        "section against the start's direction.\nRed: cut of the unstable tube; green: of the stable tube; pale: "
        "cuts crossed against the start's direction.",
        fontsize=9, color=style.CART, va="center",
    )  # fmt: skip
    return figure


def _marker(interior: TubeInterior) -> float:
    """Return the marker's area in points² at which neighbours of the start's grid overlap."""
    spans = np.ptp(interior.points, axis=0)
    across = max(len(np.unique(np.round(interior.points[:, k], 9))) for k in (0, 1))
    # A cut takes about a half of an axis that is 230 points long either way.
    share = float(np.clip(max(spans / (2 * np.abs(interior.points).max(axis=0))), 0.3, 1.0))
    return float(np.clip((1.05 * 230 * share / across) ** 2, 2.5, 60.0))


def _outlines(axes: Axes, outlines: tuple[Outline, ...], direction: int) -> None:
    for outline in outlines:
        closed = np.vstack([outline.vertices, outline.vertices[:1]])
        turns = np.rint((closed[:, 0].min() + closed[:, 0].max()) / 2 / (2 * np.pi))
        colour = style.STABLE if outline.stable else style.UNSTABLE
        opacity = 1.0 if outline.direction == direction else 0.25
        axes.plot(closed[:, 0] - 2 * np.pi * turns, closed[:, 1], color=colour, lw=1.1, alpha=opacity, zorder=3)


def _returned(run: Returns, k: int, word: str) -> str:
    arrived = run.arrived[:, k - 1]
    count = max(1, int(arrived.sum()))
    stable = np.count_nonzero(run.in_stable[arrived, k - 1]) / count
    unstable = np.count_nonzero(run.in_unstable[arrived, k - 1]) / count
    missing = np.count_nonzero(~arrived)
    text = f"return {k} {word}\n{unstable:.0%} in unstable, {stable:.0%} in stable cuts"
    return text + (f", {missing} do not return" if missing else "")


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
_EVENTS = {
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
        title = f"{_pair(diagram)}: on {section}"
        angle, momentum = figure.add_subplot(grid[0, column]), figure.add_subplot(grid[1, column])
        quiet(angle, title, y=f"{coordinate} (rad)")
        quiet(momentum, x="energy (J)", y="p / p₀")
        _branches(angle, diagram, 0)
        _branches(momentum, diagram, 1)
        angle_axis(angle, "y")
        _counts(momentum, diagram)
    looks: list[tuple[str, dict]] = [
        ("symmetric (teal, violet)", {"color": style.saddle_colour("down-up"), "lw": 1.8}),
        ("one of a mirror pair", {"color": _PAIR, "lw": 1.2}),
        ("between different saddles", {"color": _BETWEEN, "lw": 1.1}),
        *((_EVENTS[kind], {"color": style.INK, "marker": m, "lw": 0, "mfc": "white"}) for kind, m in MARKS.items()),
    ]
    key(figure, looks, loc="upper left", bbox_to_anchor=(0.042, 0.955), ncols=6, columnspacing=1.2)
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


def _pair(diagram: BranchDiagram) -> str:
    return f"{diagram.source} to {'itself' if diagram.source == diagram.target else diagram.target}"


def _caption(diagrams: list[BranchDiagram]) -> str:
    words = []
    for d in diagrams:
        counted = {kind: sum(m.kind == kind for m in d.marks) for kind in MARKS}
        kinds = ", ".join(f"{n} {kind}{'s' if n > 1 else ''}" for kind, n in counted.items() if n)
        (begin, first, _), (end, last, whole) = d.counts[0], d.counts[-1]
        least = "" if whole else "at least "
        words.append(f"{_pair(d)}: {first} connections at {begin:.4f} J and {least}{last} at {end:.4f} J by {kinds}")
    unexplained = sum(d.unexplained for d in diagrams)
    causes = (
        f"{unexplained} changes of the numbers have no located cause"
        if unexplained
        else "Every change of the numbers has a located cause"
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
        f"{onset:.6f} J. With the parameters printed in the paper's text all these energies differ."
    )


FIGURES: dict[str, Callable[[Gallery], Page]] = {
    "energy-landscape": landscape_page,
    "families": families_page,
    "tubes": tubes_page,
    "homoclinics-low": _low,
    "homoclinics-high": _high,
    "heteroclinics": heteroclinics_page,
    "branches": branches_page,
    "graph": graph_page,
    "double-homoclinics": partial(draw_repeated, turns=2),
    "triple-homoclinics": partial(draw_repeated, turns=3),
    "colour-wheels": wheels_page,
    "three-body": three_body_page,
}
"""In the order of the paper."""
CAPTIONS = "captions.json"


@dataclass(frozen=True)
class Drawn:
    """A figure that was drawn: its file, its words, the seconds it took with all that it was computed from."""

    name: str
    file: Path
    caption: str
    differs: str
    seconds: float


def draw_figures(
    names: Sequence[str], gallery: Gallery, folder: Path, *, progress: Progress = no_progress
) -> tuple[Drawn, ...]:
    """Draw figures (all where `names` is empty) to NAME.png in `folder`, and their words to captions.json there.

    Words of figures drawn there before are kept.

    Raises:
        InputError: an unknown name, or a folder that cannot be written to.
    """
    for name in names:
        if name not in FIGURES:
            raise InputError(f"there is no figure {name!r}; choose from {', '.join(FIGURES)}")
    chosen = list(dict.fromkeys(names)) or list(FIGURES)
    drawn = []
    for k, name in enumerate(chosen):
        progress(name, k / len(chosen))
        began = time.perf_counter()
        part = part_of(progress, k / len(chosen), (k + 1) / len(chosen))
        page = FIGURES[name](replace(gallery, progress=part))
        file = Path(folder) / f"{name}.png"
        save_figure(page.figure, file)
        drawn.append(Drawn(name, file, page.caption, page.differs, time.perf_counter() - began))
    _write_captions(Path(folder) / CAPTIONS, drawn)
    return tuple(drawn)


def _write_captions(file: Path, drawn: Sequence[Drawn]) -> None:
    try:
        known = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        known = {}
    words = known if isinstance(known, dict) else {}
    words |= {d.name: {"file": d.file.name, "caption": d.caption, "differs": d.differs} for d in drawn}
    ordered = {name: words[name] for name in FIGURES if name in words}
    write_whole(file, json.dumps(ordered, indent=1, ensure_ascii=False) + "\n")
