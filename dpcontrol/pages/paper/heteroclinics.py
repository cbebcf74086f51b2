"""Heteroclinic connections between both saddles, with their cuts."""

from functools import partial

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.pages.atlas_cuts import draw_cuts
from dpcontrol.pages.atlas_flights import row_of
from dpcontrol.pages.atlas_parts import connections_of, kind_of, section_place
from dpcontrol.pages.gallery import Gallery, PaperFigure
from dpcontrol.pages.layout import Page, Panel
from dpcontrol.pages.panels import quiet
from dpcontrol.walks.atlas import Atlas, AtlasKind

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
