"""Tubes and connections of three bodies: L1 to L2, and homoclinic ones."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.dynamics.system import System
from dpcontrol.pages import style
from dpcontrol.pages.atlas_panels import draw_cuts
from dpcontrol.pages.atlas_parts import colours, connections_of, kind_of, placed
from dpcontrol.pages.gallery import Gallery, PaperFigure
from dpcontrol.pages.layout import Draw, Page, Panel
from dpcontrol.pages.panels import name_point, quiet_plane
from dpcontrol.walks.atlas import Atlas, AtlasConnection, AtlasKind

BETWEEN_ENERGY = -1.5175
HOMOCLINIC_ENERGIES = {"L1": -1.5185, "L2": -1.518}
Extent = tuple[tuple[float, float], tuple[float, float]]
NEAR: Extent = ((0.89, 1.11), (-0.11, 0.11))
WHOLE: dict[str, Extent] = {"L1": ((-1.15, 1.25), (-1.15, 1.15)), "L2": ((-2.2, 2.2), (-2.1, 2.1))}


def three_body_page(gallery: Gallery) -> PaperFigure:
    """Draw L1's and L2's orbits, their tubes and first connections.

    The section is x = 1 - μ. Both directions are drawn.
    """
    atlas = gallery.atlas("three-body", BETWEEN_ENERGY, None)
    pairs = (("L1", "L2"), ("L2", "L1"))
    page = Page(f"Three bodies: heteroclinic connections of L1 and L2 at energy {BETWEEN_ENERGY:g}")
    counts = _rows(page, gallery, [(atlas, *pair, NEAR) for pair in pairs])
    hits = list(kind_of(atlas, "L1", "L2").hits)
    return PaperFigure(
        page.figure(),
        "The planar circular restricted three-body problem in the rotating frame, mass ratio "
        f"{float(gallery.system('three-body').parameters[0]):g}, near the smaller primary (dot). Grey: inaccessible at "
        "this energy. Left: Lyapunov orbits about L1 (teal) and L2 (violet). The unstable tube (red) of one and the "
        f"stable tube (green) of the other reach crossing number {hits[0]} of the line x = 1 - μ. Middle: "
        "the cuts there with the connections found. Right: the complete flight of the first. Below: the opposite "
        f"direction, which is the image under time reversal. {counts}.",
        f"Both tubes pass the line once before they can meet: hits {hits} are the first with "
        "connections. The energy's constant is that of the paper's appendix. Cuts are open at trajectories of the "
        "tube that pass close to the smaller primary and are scattered.",
    )


def three_body_homoclinics_page(gallery: Gallery) -> PaperFigure:
    """Draw the homoclinic connections of L1 and of L2.

    The page shows tubes, cuts on y = 0, x < 0, and the orbits.
    """
    rows = [
        (gallery.atlas("three-body", energy, (1, 1)), saddle, saddle, WHOLE[saddle])
        for saddle, energy in HOMOCLINIC_ENERGIES.items()
    ]
    page = Page("Three bodies: homoclinic connections of L1 and of L2")
    counts = _rows(page, gallery, rows)
    return PaperFigure(
        page.figure(),
        "The planar circular restricted three-body problem in the rotating frame; above the orbit about L1, below that "
        "about L2. Left: the branches of its unstable (red) and stable (green) tubes that go round the larger primary "
        "to the section y = 0, x < 0 (dotted). Grey: inaccessible. Middle: the cuts there, x and its momentum, with "
        "the connections found. Right: one flight of each colour, solid for a symmetric one and dashed for one "
        f"of a mirror pair. {counts}.",
        "The chosen energies are slightly above those of the points, with few connections. Flights are limited to "
        "four periods of their orbit before the section; longer ones exist.",
    )


def _rows(page: Page, gallery: Gallery, rows: Sequence[tuple[Atlas, str, str, Extent]]) -> str:
    """Add tubes, cuts and flights, a row for each (atlas, source, target, extent), and return their counts in words."""
    words = []
    for letters, (atlas, source, target, extent) in zip(("abc", "def"), rows, strict=True):
        kind, between = kind_of(atlas, source, target), source != target
        connections, section = connections_of(atlas, kind), kind.section.replace("mu", "μ")
        look = colours(connections)
        chosen = {look[c.name]: c for c in sorted(connections, key=lambda c: c.name, reverse=True)}.values()
        kept = sorted(chosen, key=lambda c: (not c.symmetric, c.name))[: 1 if between else 4]
        numbers = {c.name: str(k) for k, c in enumerate(kept, start=1)}
        cuts = f"{letters[1]}  cuts on {section}, hits {list(kind.hits)}"
        plane = partial(_plane, system=gallery.system("three-body"), atlas=atlas, extent=extent, section=section)
        page.row(
            Panel(partial(_tubes, plane=plane, atlas=atlas, kind=kind, letter=letters[0]), 1.3),
            partial(draw_cuts, atlas=atlas, kind=kind, numbers=numbers, legend=False, title=cuts),
            Panel(partial(_flights, plane=plane, kind=kind, kept=kept, look=look, letter=letters[2]), 1.3),
            height=4.0,
        )
        energy, least = "" if between else f"at {atlas.energy:g} ", "" if kind.complete else "at least "
        symmetric = "" if between else f" ({sum(c.symmetric for c in connections)} symmetric)"
        words.append(f"{source} to {target}: {energy}{least}{kind.count} connections{symmetric}")
    return "; ".join(words)


def _tubes(axes: Axes, plane: Draw, atlas: Atlas, kind: AtlasKind, letter: str) -> None:
    plane(axes)
    source, target = kind.source, kind.target
    for strand in atlas.cut(source, kind.section, kind.hits[0]).strands:
        axes.plot(*strand[:, :2].T, color=style.UNSTABLE, linewidth=0.45, alpha=0.75)
    for strand in atlas.cut(target, kind.section, kind.hits[1]).strands:
        axes.plot(*atlas.turned(strand, target)[:, :2].T, color=style.STABLE, linewidth=0.45, alpha=0.75)
    both = f"{source} and {target}" if source != target else source
    axes.set_title(f"{letter}  tubes of {both}, energy {atlas.energy:g}", loc="left")


def _flights(
    axes: Axes, plane: Draw, kind: AtlasKind, kept: Sequence[AtlasConnection], look: dict[str, str], letter: str
) -> None:
    plane(axes)
    for c in kept:
        line = "-" if c.symmetric or kind.source != kind.target else (0, (5, 2))
        axes.plot(*c.states[:, :2].T, color=look[c.name], linewidth=1.1, linestyle=line, zorder=3)
    axes.set_title(f"{letter}  from {kind.source}'s orbit to {kind.target}'s" if kept else "none found", loc="left")


def _plane(axes: Axes, system: System, atlas: Atlas, extent: Extent, *, section: str) -> None:
    """Draw the inaccessible region, the orbits, the primaries and the section."""
    (wide, high), mu = extent, float(system.parameters[0])
    x, y = np.meshgrid(np.linspace(*wide, 300), np.linspace(*high, 300))
    states = np.stack([x, y, 0 * x, 0 * x], axis=-1).reshape(-1, 4)
    potential = system.numeric.hamiltonian(states).reshape(x.shape)
    axes.contourf(x, y, potential, levels=[atlas.energy, 1e9], colors=["#c4c9cf"])
    for orbit in atlas.orbits:
        closed, colour = placed(atlas, orbit), style.saddle_colour(orbit.saddle)
        axes.plot(*closed[:, :2].T, color=colour, linewidth=2.4, zorder=5)
        name_point(axes, orbit.saddle, (float(closed[:, 0].mean()), float(closed[:, 1].max())), colour)
    axes.scatter([1 - mu, -mu], [0, 0], s=[16, 64], color=style.INK, zorder=6)
    dotted, vertical = {"color": style.MARK, "linewidth": 0.9, "linestyle": style.DOTTED}, section.startswith("x")
    axes.plot(*(([1 - mu, 1 - mu], high) if vertical else ([wide[0], 0], [0, 0])), **dotted)
    quiet_plane(axes, system)
    axes.grid(False)
    axes.set(xlim=wide, ylim=high, aspect="equal")
