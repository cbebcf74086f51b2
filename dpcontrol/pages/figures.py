"""The paper's computational figures: pages with captions, their data sources, and drawing by name.

They show the lab pendulum's tubes, its homoclinic connections of one and more turns and its heteroclinic ones, and the
first connection between L1 and L2 of three bodies. Others show Hill's regions, families of orbits, the connection
graph, and colour wheels of the returns of a tube's inside. Branches are connections against energy, with their births,
splittings and grazes of the section.
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
from matplotlib.patches import Circle, FancyArrowPatch

from dpcontrol.bifurcations.bifurcations import BranchDiagram
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import write_whole
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.orbits.family import lyapunov_family
from dpcontrol.orbits.lyapunov import equilibria
from dpcontrol.pages import style
from dpcontrol.pages.atlas import (
    colours,
    connections_of,
    draw_angles,
    draw_cuts,
    draw_space,
    kind_of,
    one_of_each,
    row_of,
    section_place,
)  # fmt: skip
from dpcontrol.pages.gallery import Gallery, PaperFigure
from dpcontrol.pages.layout import Page, Panel, key, save_figure
from dpcontrol.pages.orbits import draw_families
from dpcontrol.pages.panels import angle_axis, quiet
from dpcontrol.pages.paper import (
    cuts_page,
    heteroclinic_orbits_page,
    landscape_page,
    lyapunov_orbits_page,
    returning_page,
    senses_page,
    shadowing_page,
    three_body_homoclinics_page,
    three_body_page,
    up_up_page,
)
from dpcontrol.pages.wheels import wheels_page
from dpcontrol.walks.atlas import Atlas, AtlasConnection, AtlasKind, walks

ENERGY = -0.07
SADDLE = "down-up"


def tubes_page(gallery: Gallery) -> PaperFigure:
    """Draw the tubes of Down-Up at -0.07 J and their cuts."""
    atlas = gallery.atlas("lab", ENERGY, (1, 1))
    kind = kind_of(atlas, SADDLE, SADDLE)
    assert kind is not None
    page = Page(f"The tubes of the Lyapunov orbit about Down-Up at {ENERGY:g} J, and their cuts")
    cuts = [cut for cut in atlas.cuts if (cut.saddle, cut.section.name, cut.hit) == (SADDLE, kind.section, 1)]
    spaces = Panel(partial(_tube_space, atlas=atlas, cuts=cuts), 1.35, space=True)
    page.row(spaces, partial(draw_cuts, atlas=atlas, kind=kind), height=5.2)
    return PaperFigure(
        page.figure(),
        f"Left: trajectories that leave the Lyapunov orbit about Down-Up at {ENERGY:g} J (red) and that approach it "
        "(green) form tubes. The two shades are the tube's branches, one for each sense of the outer arm's "
        "turn. They end on the section with the outer arm straight down. Right: there each tube is a closed "
        "curve, q the inner arm's angle, p its momentum over p₀; solid for crossings with the outer arm's angle "
        f"rising, dashed for falling. The {kind.count} homoclinic connections lie at intersections of one line type.",
        f"The energy is that of the homoclinic connections, {ENERGY:g} J; the paper may have used another for its "
        "tubes. The section's coordinates are canonical. Parameters are the rig's identified ones, which reproduce "
        "the paper's pictures; the printed ones do not.",
    )


def _tube_space(axes: Axes, atlas: Atlas, cuts: list) -> None:
    draw_space(axes, atlas, cuts, one_colour=style.INK, steps=(0.25, 1.0))
    orbit, cut = {"color": style.INK, "linewidth": 2.5}, {"color": style.CUT, "linewidth": 2}
    key(axes, [("tube out", style.UNSTABLE), ("tube in", style.STABLE), ("orbit", orbit), ("cut on θ₂ = 2πk", cut)])


_MOST = 5


def _low(gallery: Gallery) -> PaperFigure:
    return _page(
        gallery.atlas("lab", -0.07, (1, 1)),
        ["down-up"],
        "Below the energy of Up-Down only the outer arm can turn over.",
        "The search finds intersections without windows set by hand: in each sense two symmetric connections "
        "and a mirror pair, all counted on the torus of angles. Section coordinates are canonical.",
    )


def _high(gallery: Gallery) -> PaperFigure:
    return _page(
        gallery.atlas("lab", 0.2, (1, 1)),
        ["down-up", "up-down"],
        "At this energy both saddles have orbits: the outer arm turns about Down-Up, the inner arm about Up-Down.",
        "Counts are of first hits on these sections, both senses and mirror images included; cuts that graze the "
        "section are open there, and crossings beyond their ends belong to later hits.",
    )


def _page(atlas: Atlas, saddles: list[str], lead: str, differs: str) -> PaperFigure:
    """Draw the homoclinic connections of saddles, a row for each."""
    page = Page(f"Homoclinic connections at {atlas.energy:g} J (first hits)")
    words = []
    for saddle in saddles:
        kind = kind_of(atlas, saddle, saddle)
        assert kind is not None
        connections = atlas.between(saddle, saddle)
        kept = one_of_each(connections)[:_MOST]
        # Flights are tall if the outer arm turns, and wide if the inner one does.
        flat = not kept[0].winding[1]
        panels = row_of(atlas, kind, kept, numbers=numbered(connections, kept), flat=flat)
        page.row(*panels, height=1.0 + 0.9 * len(kept) if flat else 3.8)
        symmetric = sum(c.symmetric for c in connections)
        word = "closed" if kind.complete else "open in places"
        words.append(
            f"{saddle}: {kind.count} connections ({symmetric} symmetric, {kind.count - symmetric} in mirror pairs), "
            f"largest residual {max(c.residual for c in connections):.0e}, cuts {word}"
        )
    return PaperFigure(
        page.figure(),
        f"{lead} Left: the cuts of the unstable (red) and stable (green) tube; dots of one colour are one connection "
        "and its mirror images. Right: one flight of each colour, of positive sense, in the plane of the angles, and "
        "the angle between the cuts. Pale curves are its two orbits, the dot its section crossing. "
        f"{'; '.join(words)}.",
        differs,
    )


def numbered(connections: tuple[AtlasConnection, ...], kept: list[AtlasConnection]) -> dict[str, str]:
    """Return the number of each connection by name.

    Connections of one colour share a number.
    """
    look = colours(connections)
    number = {look[c.name]: str(k + 1) for k, c in enumerate(kept)}
    return {c.name: number[look[c.name]] for c in connections if look[c.name] in number and np.isfinite(c.point[1])}


HETEROCLINIC_ENERGY = 0.2
PAIRS = (("down-up", "up-down"), ("up-down", "down-up"))


def heteroclinics_page(gallery: Gallery) -> PaperFigure:
    """Draw the connections from Down-Up to Up-Down and back at 0.2 J."""
    atlas = gallery.atlas("lab", HETEROCLINIC_ENERGY, (1, 1))
    page = Page(f"Heteroclinic connections between Down-Up and Up-Down at {HETEROCLINIC_ENERGY:g} J (first hits)")
    counts = []
    for row, (source, target) in enumerate(PAIRS):
        kind = kind_of(atlas, source, target)
        assert kind is not None
        shown = atlas.between(source, target)[:4]
        numbers = {c.name: "abcdefgh"[4 * row + k] for k, c in enumerate(shown)}
        cuts, *flights = row_of(atlas, kind, shown, numbers=numbers, share=1.9)
        page.row(cuts, Panel(partial(_zoom, atlas=atlas, kind=kind), 0.6), *flights, height=3.7)
        counts.append(f"{kind.count} from {source} to {target}")
    return PaperFigure(
        page.figure(),
        "On the section both arms are aligned, θ₁ = θ₂ + 2πk. Left, with a part enlarged: the unstable tube "
        "(red) of the source orbit meets the stable tube (green) of the target orbit. Right: the flights "
        "in the plane of the angles, from the source's named position; pale teal is the orbit about Down-Up, pale "
        f"violet that about Up-Down. {' and '.join(counts)}; those in one direction are those in the other, "
        "run backward in time.",
        'The paper\'s heteroclinics "at H = -0.07" cannot exist, since Up-Down has no orbit below its energy of '
        "0.1754 J. Here both directions are drawn, and each connection with its reflection; the unstable tube's cut is "
        "open where its trajectories graze the section.",
    )


def _zoom(axes: Axes, atlas: Atlas, kind: AtlasKind) -> None:
    """Draw the neighbourhood of the connections of positive sense enlarged."""
    places = np.array([section_place(atlas, c) for c in connections_of(atlas, kind) if c.sense > 0])
    middle, reach = places.mean(axis=0), 1.2 * np.ptp(places, axis=0) + np.array([0.08, 0.05])
    draw_cuts(axes, atlas, kind, legend=False)
    axes.set(xlim=(middle[0] - reach[0], middle[0] + reach[0]), ylim=(middle[1] - reach[1], middle[1] + reach[1]))
    quiet(axes, "the middle enlarged")


_SHOWN = 3
_TURNS = {2: ("Double", "second", "twice", "two"), 3: ("Triple", "third", "three times", "three")}


def _angles(axes: Axes, atlas: Atlas, connection: AtlasConnection, name: str) -> None:
    draw_angles(axes, atlas, connection)
    axes.set_title(f"{name}: θ₁ blue, θ₂ orange, against time (s)", loc="left")


def draw_repeated(gallery: Gallery, *, turns: int) -> PaperFigure:
    """Draw connections of Down-Up that turn the outer arm several times.

    The energy is -0.07 J. Their angles are drawn over time.
    """
    # The outer arm passes hanging once per turn: for two turns the unstable tube's second crossing is the last.
    hits = (turns, 1)
    title, ordinal, times, number = _TURNS[turns]
    atlas = gallery.atlas("lab", ENERGY, hits)
    kind = kind_of(atlas, SADDLE, SADDLE)
    assert kind is not None
    connections = atlas.between(SADDLE, SADDLE)
    repeated = [c for c in connections if tuple(map(abs, c.winding)) == (0, turns) and c.sense > 0]
    # Time reversal maps the section to the other passage, so images of one flight are recognised by its length.
    lengths: dict[float, AtlasConnection] = {}
    for c in sorted(repeated, key=lambda c: (c.time_in + c.time_out, c.name)):
        lengths.setdefault(round(c.time_in + c.time_out, 4), c)
    kept = list(lengths.values())[:_SHOWN] or [c for c in connections if c.sense > 0][:_SHOWN]
    page = Page(f"{title} homoclinic connections of Down-Up at {ENERGY:g} J (hits {list(hits)})")
    names = {c.name: "abc"[k] for k, c in enumerate(kept)}
    page.row(*row_of(atlas, kind, kept, numbers=names, marked=tuple(kept)), height=4.4)
    page.row(*(partial(_angles, atlas=atlas, connection=c, name=names[c.name]) for c in kept), height=2.6)
    windings = {tuple(int(v) for v in np.abs(c.winding)) for c in connections}
    counts = ", ".join(
        f"{sum(tuple(map(abs, c.winding)) == t for c in connections)} of winding ±{list(t)}" for t in sorted(windings)
    )
    resolved = all(atlas.cut(SADDLE, kind.section, hit).resolved for hit in hits)
    torn = " and is drawn as far as it could be resolved: more connections than these exist"
    return PaperFigure(
        page.figure(),
        f"Above, left: the cuts of the unstable tube at its {ordinal} crossing of θ₂ = 2πk and of the stable tube at "
        "its first one back. Right: the connections as flights in the plane of the angles, with the "
        f"outer arm turning {times} before the arms settle about Down-Up again, {number} turns on (dot: the section at "
        "time zero). Below: both angles against time; dotted lines mark where the flight leaves one orbit and joins "
        f"the other. {'In all' if resolved else 'At least'} {len(connections)} connections were found at these hits: "
        f"{counts}; those of smaller winding turn there and back. The cut is in pieces, torn apart where the tube "
        f"passes near the orbit again{'' if resolved else torn}.",
        "The paper cuts them on θ₂ = 4π and 6π; here the section is that of the single ones, θ₂ = 2πk, at later hits. "
        "On θ₁ = θ₂ `dpcontrol connect --section aligned` lists them.",
    )


_HIGHEST = 0.45


def families_page(gallery: Gallery) -> PaperFigure:
    """Draw the families about Down-Up and Up-Down up to 0.45 J."""
    system = gallery.system("lab")
    births = {name: point.energy for name, point in equilibria(system).items() if point.kind.startswith("index-1")}
    families = [lyapunov_family(system, name, energies=(birth + 1e-4, _HIGHEST)) for name, birth in births.items()]
    ends = "; ".join(f"{family.saddle}: {family.status}" for family in families)
    return PaperFigure(
        draw_families(families, "Families of Lyapunov orbits of the lab pendulum"),
        "Lyapunov orbits about each saddle from their birth at the saddle (cross) upwards in energy: their shapes in "
        "the phase plane of the hanging arm, their periods and their unstable multipliers. The hanging arm swings most "
        f"while the other balances. A multiplier is the growth of a deviation in one period. {ends}.",
        "Each family is continued up to 0.45 J instead of being computed at chosen energies, which gives "
        "periods and multipliers against energy. Parameters are the rig's identified ones.",
    )


GRAPH_ENERGIES = (-0.07, 0.2)
_RADIUS = 0.45
_LENGTH = 3


def graph_page(gallery: Gallery) -> PaperFigure:
    """Draw the graphs at -0.07 and 0.2 J."""
    atlases = [gallery.atlas("lab", energy, (1, 1)) for energy in GRAPH_ENERGIES]
    page = Page("The connection graph: every walk on it is an itinerary")
    page.row(*(Panel(partial(_graph, atlas=atlas), 1 + 0.8 * k) for k, atlas in enumerate(atlases)), height=5.2)
    words = []
    for atlas in atlases:
        graph = atlas.graph()
        count = sum(1 for node in graph.nodes for _ in walks(graph, node, length=_LENGTH))
        words.append(
            f"at {atlas.energy:g} J: {graph.number_of_nodes()} {'orbit' if len(graph) == 1 else 'orbits'}, "
            f"{graph.number_of_edges()} connections, {count:,} walks of {_LENGTH} symbols"
        )
    return PaperFigure(
        page.figure(),
        "Nodes are Lyapunov orbits, each arrow is one connection: solid for symmetric ones, dashed for one of a "
        "mirror pair. The positive sense is above a node, the negative below. "
        f"There are {'; '.join(words)}. Before each symbol the arms may wobble any number of times.",
        "There is one arrow for each first-hit connection on the torus of angles. Reflected and mirrored ones are "
        "different motions and are counted. At -0.07 J Up-Down has no orbit, and no arrow can lead there.",
    )


def _graph(axes: Axes, atlas: Atlas) -> None:
    places = {orbit.name: (3.9 * k, 0.0) for k, orbit in enumerate(atlas.orbits)}
    for orbit in atlas.orbits:
        x, y = places[orbit.name]
        axes.add_patch(Circle((x, y), _RADIUS, color=style.saddle_colour(orbit.saddle), zorder=5))
        axes.text(
            x, y, orbit.name, ha="center", va="center", color="white", fontsize=style.SMALL, weight="bold", zorder=6
        )
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
                          fontsize=style.TEXT, color=style.INK)  # fmt: skip
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
            axes.text(
                1.95,
                side * 1.28,
                f"{len(found)}: {source} → {target}",
                ha="center",
                fontsize=style.TEXT,
                color=style.INK,
            )
    middle = 3.9 * (len(places) - 1) / 2
    axes.set(xlim=(-1.6, 2 * middle + 1.6), ylim=(-3.0, 3.35), aspect="equal")
    axes.axis("off")
    axes.text(middle, 3.2, f"{atlas.energy:g} J", ha="center", fontsize=style.VERDICT, color=style.INK)


def _loop(axes: Axes, x: float, y: float, sign: int, size: float, *, dashed: bool, saddle: str) -> None:
    """Draw an arrow from a node to itself.

    It is an ellipse that touches the node, with a head at its end.
    """
    t = np.linspace(0.02, 0.98, 120) * 2 * np.pi
    px, py = x - 0.55 * size * np.sin(t), y + sign * size * (1 - np.cos(t))
    colour = style.saddle_colour(saddle)
    axes.plot(px, py, color=colour, linewidth=1.3, linestyle=(0, (5, 2)) if dashed else "-", zorder=3)
    axes.annotate("", (px[-12], py[-12]), (px[-18], py[-18]),
                  arrowprops={"arrowstyle": "-|>", "color": colour, "mutation_scale": 10})  # fmt: skip


KINDS = (("down-up", "down-up"), ("up-down", "up-down"), ("down-up", "up-down"))
MARKS = {"saddle-node": "o", "pitchfork": "^", "section-artefact": "D"}
_BETWEEN, _PAIR = "#c2185b", "#7c858e"
_COORDINATES = {"down-up": ("θ₁", "θ₂ = 2πk"), "up-down": ("θ₂", "θ₁ = 2πk"), "between": ("θ₁", "θ₁ = θ₂ + 2πk")}
_ON_MIRROR = 1e-5  # rad


def branches_page(gallery: Gallery) -> PaperFigure:
    """Draw first-hit connections of the lab pendulum against energy.

    They are homoclinics of both saddles and heteroclinics.
    """
    diagrams = [
        gallery.branches("lab", source, target, part_of(gallery.progress, k / len(KINDS), (k + 1) / len(KINDS)))
        for k, (source, target) in enumerate(KINDS)
    ]
    page = Page("Connections of the lab pendulum against energy (first hits)")
    page.text(
        "Thick: symmetric. Thin grey: one of a mirror pair. Magenta: between different saddles. Marks: circles are "
        "saddle-nodes (two are born), triangles are pitchforks (one sheds a mirror pair), and diamonds are grazes of "
        "the section (no birth).",
        size=style.TEXT,
    )
    page.row(*(partial(_angle_branches, diagram=diagram) for diagram in diagrams), height=3.1)
    page.row(*(partial(draw_momentum_branches, diagram=diagram) for diagram in diagrams), height=3.1)
    return PaperFigure(page.figure(), _caption(diagrams), _differs(diagrams))


def _angle_branches(axes: Axes, diagram: BranchDiagram) -> None:
    coordinate, section = _COORDINATES[diagram.source if diagram.source == diagram.target else "between"]
    quiet(axes, f"{_pair(diagram)}: on {section}", y=f"{coordinate} (rad)")
    _branches(axes, diagram, 0)
    angle_axis(axes, "y")


def draw_momentum_branches(axes: Axes, diagram: BranchDiagram) -> None:
    """Draw connections by momentum and energy, with their bifurcations and counts."""
    quiet(axes, x="energy (J)", y="p / p₀")
    _branches(axes, diagram, 1)
    _counts(axes, diagram)


def _branches(axes: Axes, diagram: BranchDiagram, coordinate: int) -> None:
    homoclinic = diagram.source == diagram.target
    for energies, points in diagram.runs:
        symmetric = homoclinic and bool(np.all(np.abs(np.sin(points[:, 0])) < _ON_MIRROR))
        colour = style.saddle_colour(diagram.source) if symmetric else _PAIR if homoclinic else _BETWEEN
        look = {"color": colour, "linewidth": 1.8 if symmetric else 1.1, "solid_capstyle": "round"}
        values = _wrapped(points)[:, coordinate]
        # A branch that leaves the period on one side enters on the other.
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
    # On the mirror at half a turn, rounding would scatter points to both ends.
    angles = np.where(angles < -np.pi + _ON_MIRROR, angles + 2 * np.pi, angles)
    return np.column_stack([angles, points[:, 1]])


def _counts(axes: Axes, diagram: BranchDiagram) -> None:
    """Write along the lower edge the number of connections between consecutive events."""
    shown, last, span = -1, -np.inf, diagram.counts[-1][0] - diagram.counts[0][0]
    look = {
        "xycoords": ("data", "axes fraction"),
        "textcoords": "offset points",
        "fontsize": style.SMALL,
        "color": style.CART,
    }
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
        "The section crossing of each connection, as energy grows: its angle there (above) and the momentum across "
        "(below). Each curve is a connection followed by continuation, also round folds; marks are events, each "
        "solved separately. Numbers along the lower edge count all connections on the torus; curves show one "
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
        "Folds and splittings are located instead of read off a list of counts. They are distinguished from grazes of "
        "the section, which only change a connection's number of hits. Both orbits exist from 0.1754 J on, which "
        "the paper gives for the onset of heteroclinics; the first of them that meets its section once each appears at "
        f"{onset:.6f} J. With the parameters printed in the paper's text all these energies differ."
    )


FIGURES: dict[str, Callable[[Gallery], PaperFigure]] = {
    "energy-landscape": landscape_page,
    "three-body-homoclinics": three_body_homoclinics_page,
    "three-body": three_body_page,
    "lyapunov-orbits": lyapunov_orbits_page,
    "families": families_page,
    "tubes": tubes_page,
    "tubes-down-up": partial(senses_page, saddle="down-up"),
    "cuts": cuts_page,
    "colour-wheels": partial(wheels_page, saddle="down-up"),
    "tubes-up-down": partial(senses_page, saddle="up-down"),
    "colour-wheels-up-down": partial(wheels_page, saddle="up-down"),
    "homoclinics-low": _low,
    "homoclinics-high": _high,
    "heteroclinics": heteroclinics_page,
    "heteroclinic-orbits": heteroclinic_orbits_page,
    "branches": branches_page,
    "graph": graph_page,
    "shadowing": shadowing_page,
    "double-homoclinics": partial(draw_repeated, turns=2),
    "triple-homoclinics": partial(draw_repeated, turns=3),
    "returning-homoclinics": returning_page,
    "up-up": up_up_page,
}
"""In the order of the paper."""
CAPTIONS = "captions.json"


@dataclass(frozen=True)
class Drawn:
    """A figure on disk: file, caption, and seconds taken including its computations."""

    name: str
    file: Path
    caption: str
    differs: str
    seconds: float


def draw_figures(
    names: Sequence[str], gallery: Gallery, folder: Path, *, progress: Progress = no_progress
) -> tuple[Drawn, ...]:
    """Draw figures to NAME.png in `folder`, all if `names` is empty.

    Their captions are written to captions.json there.

    Captions of figures drawn there earlier are kept.

    Raises:
        InputError: a name is unknown, or the folder is not writable.
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
