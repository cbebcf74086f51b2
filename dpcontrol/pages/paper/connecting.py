"""Tubes, cuts and connections of the paper's orbits: of one to three turns, heteroclinic, returning and shadowed."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.progress import Progress
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.pages import single, style
from dpcontrol.pages.atlas import colours, connections_of, draw_cuts, draw_motions, kind_of, row_of, tubes_of_cut
from dpcontrol.pages.figures import IDENTIFIED, PaperFigure, atlas_at, model_named
from dpcontrol.pages.layout import Draw, Page, Panel
from dpcontrol.pages.page import angles
from dpcontrol.pages.panels import draw_graph, name_point, quiet_plane, wrapped_runs
from dpcontrol.tubes.connections import Connection, ConnectionSearch, find_connections
from dpcontrol.tubes.intersections import search_settings
from dpcontrol.walks.atlas import Atlas, AtlasConnection, walks
from dpcontrol.walks.shadowing import ShadowingOrbit, WalkSolver

ENERGY, SENSES_ENERGY = -0.07, 0.2
CUT_ENERGIES = (-0.147, -0.07, -0.034, 0.06, 0.102, 0.157)
SADDLE = "down-up"
_TURNING = {"down-up": ("outer", "θ₂ = 2πk", "θ₁"), "up-down": ("inner", "θ₁ = 2πk", "θ₂")}


def senses_page(_: Progress, *, saddle: str) -> PaperFigure:
    """Draw a saddle's tubes at 0.2 J and their cuts, separately for the two senses of rotation.

    Args:
        saddle: "down-up" or "up-down".
    """
    atlas = atlas_at(SENSES_ENERGY)
    kind = kind_of(atlas, saddle, saddle)
    arm, section, coordinate = _TURNING[saddle]
    spaces, panels, counts = [], [], []
    for letters, sense, way in (("ac", 1, "forward"), ("bd", -1, "backward")):
        shown = tuple(c for c in connections_of(atlas, kind) if c.sense == sense)
        turns, cuts = (f"{letters[0]}  the {arm} arm turns {way}", f"{letters[1]}  cuts on {section}, crossed {way}")
        tubes = [part for part in tubes_of_cut(atlas, atlas.cut(saddle, kind.section, 1)) if part.sense == sense]
        motions = partial(draw_motions, atlas=atlas, tubes=tubes, saddles=(saddle,), title=turns)
        spaces.append(Panel(motions, space=True))
        panels.append(partial(draw_cuts, atlas=atlas, kind=kind, shown=shown, legend=False, sense=sense, title=cuts))
        counts.append(f"{len(shown)} {way}")
    return PaperFigure(
        Page(f"The tubes of {saddle} at {SENSES_ENERGY:g} J: the {arm} arm turns either way")
        .row(*spaces, height=4.8)
        .row(*panels, height=3.4)
        .figure(),
        f"Trajectories that leave the Lyapunov orbit about {saddle} at {SENSES_ENERGY:g} J (red) and that approach it "
        f"(green), in (θ₁, θ₂, ω₁), up to the section {section}. Panels a and b: the two senses of the {arm} arm. "
        f"Below, the corresponding cuts: {coordinate} on the section and its momentum over p₀. Homoclinic "
        f"connections: {' and '.join(counts)}.",
        "Both tubes start at the orbit's named position, so the red one ends on one sheet of the section and the green "
        f"one begins on another, whole turns away. Momenta are canonical in place of the paper's rates. {IDENTIFIED}",
    )


def cuts_page(progress: Progress) -> PaperFigure:
    """Draw the first cuts of Down-Up's tubes by the section with the outer arm hanging, θ₂ = 2πk, at six energies."""
    panels: list[Draw] = []
    words = []
    for k, energy in enumerate(CUT_ENERGIES):
        progress(f"cuts at {energy:g} J", k / len(CUT_ENERGIES))
        atlas = atlas_at(energy)
        kind = kind_of(atlas, SADDLE, SADDLE)
        symmetric = sum(c.symmetric for c in connections_of(atlas, kind))
        title = f"{'abcdef'[k]}  {energy:g} J: {kind.count} connections, {symmetric} symmetric"
        panels.append(partial(draw_cuts, atlas=atlas, kind=kind, title=title, legend=k == 0))
        words.append(f"{kind.count} at {energy:g} J")
    return PaperFigure(
        Page("Cuts of the tubes of Down-Up on θ₂ = 2πk, as energy grows (first hits)")
        .grid(panels, across=3, height=3.4)
        .figure(),
        "First cuts of the unstable (red) and stable (green) tubes of the Lyapunov orbit about Down-Up on the section "
        "with the outer arm hanging, at six energies: the inner arm's angle and its momentum over p₀. Solid: a "
        "rising angle of the outer arm; dashed: a falling one. Homoclinic connections, both senses: "
        f"{', '.join(words)}.",
        f"Momenta are canonical in place of the paper's rates; both senses are in one panel. {IDENTIFIED}",
    )


PAIRS = (("down-up", "up-down"), ("up-down", "down-up"))
_MOST, _REPEATED = 5, 3
_TURNS = {2: ("Double", "second", "twice", "two"), 3: ("Triple", "third", "three times", "three")}


def heteroclinics_page(_: Progress) -> PaperFigure:
    """Draw the connections from Down-Up to Up-Down and back at 0.2 J, a row for each direction.

    A row has the cuts of both tubes, with the connections as common points, and some of the flights.
    """
    atlas = atlas_at(SENSES_ENERGY)
    page = Page(f"Heteroclinic connections between Down-Up and Up-Down at {SENSES_ENERGY:g} J (first hits)")
    counts = []
    for letters, (source, target) in zip(("abcd", "efgh"), PAIRS, strict=True):
        kind, shown = kind_of(atlas, source, target), atlas.between(source, target)[:4]
        numbers = {c.name: letter for c, letter in zip(shown, letters, strict=False)}
        page.row(*row_of(atlas, kind, shown, numbers=numbers), height=3.7)
        counts.append(f"{kind.count} from {source} to {target}")
    return PaperFigure(
        page.figure(),
        "On the section both arms are aligned, θ₁ = θ₂ + 2πk. Left: the unstable tube "
        "(red) of the source orbit meets the stable tube (green) of the target orbit. Right: the flights "
        "in the plane of the angles, from the source's named position; pale teal is the orbit about Down-Up, pale "
        f"violet that about Up-Down. {' and '.join(counts)}; those in one direction are those in the other, "
        "run backward in time.",
        'The paper\'s heteroclinics "at H = -0.07" cannot exist, since Up-Down has no orbit below its energy of '
        "0.1754 J. Here both directions are drawn, and each connection with its reflection; the unstable tube's cut is "
        "open where its trajectories graze the section.",
    )


def repeated_page(_: Progress, *, turns: int) -> PaperFigure:
    """Draw connections of Down-Up at -0.07 J that turn the outer arm several times.

    Args:
        turns: number of turns, 2 or 3.
    """
    title, ordinal, times, number = _TURNS[turns]
    # The outer arm passes hanging once per turn: for two turns the unstable tube's second crossing is the last.
    atlas = atlas_at(ENERGY, hits=(turns, 1))
    kind, connections = kind_of(atlas, SADDLE, SADDLE), atlas.between(SADDLE, SADDLE)
    repeated = [c for c in connections if tuple(map(abs, c.winding)) == (0, turns) and c.sense > 0]
    # Time reversal maps the section to the other passage, so images of one flight are recognised by its length.
    lengths: dict[float, AtlasConnection] = {}
    for c in sorted(repeated, key=lambda c: (c.time_in + c.time_out, c.name)):
        lengths.setdefault(round(c.time_in + c.time_out, 4), c)
    shown = list(lengths.values())[:_REPEATED] or [c for c in connections if c.sense > 0][:_REPEATED]
    names = {c.name: letter for c, letter in zip(shown, "abc", strict=False)}
    page = Page(f"{title} homoclinic connections of Down-Up at {ENERGY:g} J (hits {[turns, 1]})")
    windings = [tuple(abs(int(turn)) for turn in c.winding) for c in connections]
    counts = ", ".join(
        f"{windings.count(w)} {f'of winding ±{list(w)}' if any(w) else 'without winding'}"
        for w in sorted(set(windings))
    )
    resolved = all(atlas.cut(SADDLE, kind.section, hit).resolved for hit in kind.hits)
    torn = " and is drawn as far as it could be resolved: more connections than these exist"
    return PaperFigure(
        page.row(*row_of(atlas, kind, shown, numbers=names, marked=tuple(shown)), height=4.4).figure(),
        f"Above, left: the cuts of the unstable tube at its {ordinal} crossing of θ₂ = 2πk and of the stable tube at "
        "its first one back. Right: the connections as flights in the plane of the angles, with the "
        f"outer arm turning {times} before the arms settle about Down-Up again, {number} turns on (dot: the section at "
        f"time zero). {'In all' if resolved else 'At least'} {len(connections)} connections were found at these hits: "
        f"{counts}; those of smaller winding turn there and back. The cut is in pieces, torn apart where the tube "
        f"passes near the orbit again{'' if resolved else torn}.",
        "The paper cuts them on θ₂ = 4π and 6π; here the section is that of the single ones, θ₂ = 2πk, at later hits. "
        "On θ₁ = θ₂ `dpcontrol connect --section aligned` lists them.",
    )


GRAPH_ENERGIES = (-0.07, 0.2)
_LENGTH = 3


def graph_page(_: Progress) -> PaperFigure:
    """Draw the connection graphs at -0.07 and 0.2 J, with orbits as nodes and the numbers of connections at arrows.

    The caption has the number of walks of `_LENGTH` symbols, which are paths along connections of the graph.
    """
    page, panels, words = Page("The connection graph: every walk on it is an itinerary"), [], []
    for energy in GRAPH_ENERGIES:
        graph = atlas_at(energy).graph()
        panels.append(partial(draw_graph, graph=graph, title=f"{energy:g} J"))
        count = sum(1 for node in graph.nodes for _ in walks(graph, node, length=_LENGTH))
        words.append(
            f"at {energy:g} J: {graph.number_of_nodes()} {'orbit' if len(graph) == 1 else 'orbits'}, "
            f"{graph.number_of_edges()} connections, {count:,} walks of {_LENGTH} symbols"
        )
    return PaperFigure(
        page.row(*panels, height=4.0).figure(),
        "Nodes are Lyapunov orbits, arrows the connections between them, with their number and that of the symmetric "
        f"ones. There are {'; '.join(words)}. Before each symbol the arms may wrap round an orbit any number of times.",
        "Numbers are of first-hit connections on the torus of angles. Reflected and mirrored ones are different "
        "motions and are counted. At -0.07 J Up-Down has no orbit, and no arrow can lead there.",
    )


_RETURN_FLIGHT = 2.0
"""Longest flight in periods of its orbit; longer ones scatter."""


def returning_search(system: System) -> ConnectionSearch:
    """Search homoclinics of Down-Up at 0.2 J that cross θ₁ = θ₂ twice.

    They are where the unstable tube's first crossing meets the stable tube's second one, counted back from its orbit.
    """
    orbit = lyapunov_orbit(system, "down-up", energy=SENSES_ENERGY)
    return find_connections(
        orbit,
        orbit,
        hits=(1, 2),
        section=system.named_sections["aligned"],
        settings=search_settings(longest=_RETURN_FLIGHT),
    )


def returning_page(_: Progress) -> PaperFigure:
    """Draw homoclinics of Down-Up that cross θ₁ = θ₂ towards Up-Down's side and return without a turn of an arm."""
    search = returning_search(model_named("lab").system)
    back = [c for c in search.connections if not any(c.winding)]
    page = Page("Homoclinic orbits of Down-Up that return through θ₁ = θ₂ the other way, at 0.2 J")
    flights = partial(_returning_flights, search=search, connections=[c for c in back if c.sense > 0])
    at_least = "" if search.complete else "at least "
    return PaperFigure(
        page.row(flights, partial(single.search, result=search, shown=back), height=4.8).figure(),
        f"Connections from the Lyapunov orbit about Down-Up at {SENSES_ENERGY:g} J to the same orbit without a turn "
        "of an arm. They pass θ₁ = θ₂ (dotted) towards Up-Down's side and return the other way. Left: flights "
        "of one sense. Right: the unstable tube (red) at its first crossing of θ₁ = θ₂ and the stable tube (green) at "
        f"the second before it arrives, with the connections. Found: {at_least}{len(back)} of flights up to "
        f"{_RETURN_FLIGHT:g} periods.",
        "Tubes scatter before later crossings, so longer flights are not listed; `dpcontrol connect lab --section "
        f"aligned --hits 1,2 --longest 2` lists these. {IDENTIFIED}",
    )


def _returning_flights(axes: Axes, search: ConnectionSearch, connections: Sequence[Connection]) -> None:
    """Draw connections in the plane of the angles, with the section θ₁ = θ₂ and its copy a turn away dotted."""
    for turn in (0, 1):
        axes.axline((0, 2 * np.pi * turn), slope=1, color=style.MARK, linestyle=style.DOTTED, linewidth=0.9, zorder=1)
    single.flights(axes, connections)
    quiet_plane(axes, search.source.system, title="Flights in the plane of the angles")


def shadowing_page(_: Progress) -> PaperFigure:
    """Draw a homoclinic connection of Down-Up and two orbits that shadow it, one of them twice, the other periodically.

    To shadow means to stay close to it, with some wraps about the Lyapunov orbit between two turns.
    """
    orbit = lyapunov_orbit(model_named("lab").system, "down-up", energy=-0.07)
    search = find_connections(orbit, orbit)
    connection = next(c for c in search.connections if c.symmetric and c.sense > 0)
    solver = WalkSolver([connection])
    once = [connection]
    shapes = {
        "a  the homoclinic orbit": solver.solve(once, (), lead_in=1, lead_out=1),
        "b  a double homoclinic orbit beside it": solver.solve(once * 2, solver.least(once * 2), lead_in=1, lead_out=1),
        "c  a periodic orbit beside it": solver.solve(once, solver.least(once, periodic=True), periodic=True),
    }
    words, above, below = [], [], []
    for title, shadow in shapes.items():
        assert shadow.converged, shadow.status
        above.append(partial(_outer_arm, orbit=shadow, title=title))
        below.append(partial(angles, motion=shadow))
        words.append(f"{title[0]} {shadow.duration:.2f} s, residual {shadow.residual:.0e}")
    return PaperFigure(
        Page("One homoclinic orbit of Down-Up at -0.07 J, and orbits that shadow it")
        .row(*above, height=3.2)
        .row(*below, height=3.0)
        .figure(),
        "Above, the outer arm in its phase plane; below, both angles against time. The homoclinic orbit leaves the "
        "Lyapunov orbit, turns the outer arm once and returns. Beside it lie an orbit that does this twice, "
        "with the fewest sufficient wobbles between, and a periodic one that repeats it with as many wobbles in each "
        f"period. Durations: {'; '.join(words)}.",
        f"All three are solved by multiple shooting, with the fewest wobbles that converge. {IDENTIFIED}",
    )


def _outer_arm(axes: Axes, orbit: ShadowingOrbit, title: str) -> None:
    """Draw the outer arm in its phase plane, with its angle within the turn about upright."""
    for part in wrapped_runs(orbit.sample(1500)[:, [1, 3]] - [np.pi, 0.0], (2 * np.pi, None)):
        axes.plot(part[:, 0] + np.pi, part[:, 1], color=style.arm_colour(1), linewidth=1.1)
    quiet_plane(axes, orbit.system, (1, 3), title)


BETWEEN_ENERGY = -1.5175
HOMOCLINIC_ENERGIES = {"L1": -1.5185, "L2": -1.518}
Extent = tuple[tuple[float, float], tuple[float, float]]
NEAR: Extent = ((0.89, 1.11), (-0.11, 0.11))
WHOLE: dict[str, Extent] = {"L1": ((-1.15, 1.25), (-1.15, 1.15)), "L2": ((-2.2, 2.2), (-2.1, 2.1))}


def three_body_page(_: Progress) -> PaperFigure:
    """Draw L1's and L2's orbits, their tubes, and their first connections in both directions on x = 1 - μ."""
    atlas = atlas_at(BETWEEN_ENERGY, model="three-body", hits=None)
    pairs = (("L1", "L2"), ("L2", "L1"))
    page = Page(f"Three bodies: heteroclinic connections of L1 and L2 at energy {BETWEEN_ENERGY:g}")
    counts = _rows(page, [(atlas, *pair, NEAR) for pair in pairs])
    hits = list(kind_of(atlas, "L1", "L2").hits)
    return PaperFigure(
        page.figure(),
        "The planar circular restricted three-body problem in the rotating frame, mass ratio "
        f"{float(model_named('three-body').system.parameters[0]):g}, near the smaller primary (dot). Grey: "
        "inaccessible at this energy. Left: Lyapunov orbits about L1 (teal) and L2 (violet). The unstable tube (red) "
        f"of one and the stable tube (green) of the other reach crossing number {hits[0]} of the line x = 1 - μ. "
        "Middle: the cuts there with the connections found. Right: the complete flight of the first. Below: the "
        f"opposite direction, which is the image under time reversal. {counts}.",
        f"Both tubes pass the line once before they can meet: hits {hits} are the first with "
        "connections. The energy's constant is that of the paper's appendix. Cuts are open at trajectories of the "
        "tube that pass close to the smaller primary and are scattered.",
    )


def three_body_homoclinics_page(_: Progress) -> PaperFigure:
    """Draw the homoclinic connections of L1 and of L2, with tubes, orbits and the cuts on y = 0, x < 0."""
    rows = [
        (atlas_at(energy, model="three-body"), saddle, saddle, WHOLE[saddle])
        for saddle, energy in HOMOCLINIC_ENERGIES.items()
    ]
    page = Page("Three bodies: homoclinic connections of L1 and of L2")
    counts = _rows(page, rows)
    return PaperFigure(
        page.figure(),
        "The planar circular restricted three-body problem in the rotating frame; above the orbit about L1, below that "
        "about L2. Left: the branches of its unstable (red) and stable (green) tubes that go round the larger primary "
        "to the section y = 0, x < 0 (dotted). Grey: inaccessible. Middle: the cuts there, x and its momentum, with "
        f"the connections found. Right: one flight of each colour. {counts}.",
        "The chosen energies are slightly above those of the points, with few connections. Flights are limited to "
        "four periods of their orbit before the section; longer ones exist.",
    )


def _rows(page: Page, rows: Sequence[tuple[Atlas, str, str, Extent]]) -> str:
    """Add tubes, cuts and flights, a row for each (atlas, source, target, extent), and return their counts in words.

    Source and target are saddles, and the extent has the drawn ranges of x and y. Connections that are mirror images
    share a colour. Of each colour one flight is shown, in total up to four of a saddle with itself, and one between
    two saddles.
    """
    words = []
    for letters, (atlas, source, target, extent) in zip(("abc", "def"), rows, strict=True):
        kind, between = kind_of(atlas, source, target), source != target
        connections, section = connections_of(atlas, kind), kind.section.replace("mu", "μ")
        look = colours(connections)
        chosen = {look[c.name]: c for c in sorted(connections, key=lambda c: c.name, reverse=True)}.values()
        shown = sorted(chosen, key=lambda c: (not c.symmetric, c.name))[: 1 if between else 4]
        numbers = {c.name: str(k) for k, c in enumerate(shown, start=1)}
        cuts = f"{letters[1]}  cuts on {section}, hits {list(kind.hits)}"
        ends = ((source, kind.hits[0], False), (target, kind.hits[1], True))
        tubes = [
            # Both branches have the full colour, because only one tube of each kind is drawn.
            replace(part, branch=1)
            for saddle, hit, stable in ends
            for part in tubes_of_cut(atlas, atlas.cut(saddle, kind.section, hit))
            if part.stable is stable
        ]
        both = f"{source} and {target}" if between else source
        plane = partial(_plane, atlas=atlas, system=model_named("three-body").system, extent=extent, section=section)
        of_tubes = partial(plane, tubes=tubes, title=f"{letters[0]}  tubes of {both}, energy {atlas.energy:g}")
        flown = f"{letters[2]}  from {source}'s orbit to {target}'s" if shown else "none found"
        of_flights = partial(plane, flights=[(c, look[c.name]) for c in shown], title=flown)
        of_cuts = partial(draw_cuts, atlas=atlas, kind=kind, numbers=numbers, legend=False, title=cuts)
        page.row(Panel(of_tubes, 1.3), of_cuts, Panel(of_flights, 1.3), height=4.0)
        energy, least = "" if between else f"at {atlas.energy:g} ", "" if kind.complete else "at least "
        symmetric = "" if between else f" ({sum(c.symmetric for c in connections)} symmetric)"
        words.append(f"{source} to {target}: {energy}{least}{kind.count} connections{symmetric}")
    return "; ".join(words)


def _plane(axes: Axes, atlas: Atlas, system: System, extent: Extent, section: str, **motions: Any) -> None:
    """Draw tubes or flights of three bodies in the plane, with primaries, inaccessible region and section.

    `extent` has the ranges of x and y. `section` is "x = 1 - μ", a vertical line through the smaller primary, or else
    the negative half of the line y = 0. `motions` are further arguments of `draw_motions`: the tubes or flights.
    """
    draw_motions(axes, atlas, **motions)
    (wide, high), mu = extent, float(system.parameters[0])
    x, y = np.meshgrid(np.linspace(*wide, 300), np.linspace(*high, 300))
    states = np.stack([x, y, 0 * x, 0 * x], axis=-1).reshape(-1, 4)
    potential = system.numeric.hamiltonian(states).reshape(x.shape)
    axes.contourf(x, y, potential, levels=[atlas.energy, 1e9], colors=["#c4c9cf"], zorder=0)
    for orbit in atlas.orbits:
        place = float(orbit.samples[:, 0].mean()), float(orbit.samples[:, 1].max())
        name_point(axes, orbit.saddle, place, style.saddle_colour(orbit.saddle))
    axes.scatter([1 - mu, -mu], [0, 0], s=[16, 64], color=style.INK, zorder=6)
    dotted, vertical = {"color": style.MARK, "linewidth": 0.9, "linestyle": style.DOTTED}, section.startswith("x")
    axes.plot(*(([1 - mu, 1 - mu], high) if vertical else ([wide[0], 0], [0, 0])), **dotted)
    axes.grid(False)
    axes.set(aspect="equal", adjustable="box", xlim=wide, ylim=high)
