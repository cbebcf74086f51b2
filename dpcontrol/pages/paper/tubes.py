"""The tubes of one orbit in space, their cuts and a connection."""

from functools import partial

from dpcontrol.pages import style
from dpcontrol.pages.atlas_cuts import draw_cuts
from dpcontrol.pages.atlas_flights import space_panel
from dpcontrol.pages.atlas_parts import kind_of
from dpcontrol.pages.gallery import Gallery, PaperFigure
from dpcontrol.pages.layout import Page

ENERGY = -0.07
SADDLE = "down-up"


def tubes_page(gallery: Gallery) -> PaperFigure:
    """Draw the tubes of Down-Up at -0.07 J and their cuts."""
    atlas = gallery.atlas("lab", ENERGY, (1, 1))
    kind = kind_of(atlas, SADDLE, SADDLE)
    assert kind is not None
    page = Page(f"The tubes of the Lyapunov orbit about Down-Up at {ENERGY:g} J, and their cuts")
    cuts = [cut for cut in atlas.cuts if (cut.saddle, cut.section.name, cut.hit) == (SADDLE, kind.section, 1)]
    orbit, cut = {"color": style.INK, "linewidth": 2.5}, {"color": style.CUT, "linewidth": 2}
    looks = [("tube out", style.UNSTABLE), ("tube in", style.STABLE), ("orbit", orbit), ("cut on θ₂ = 2πk", cut)]
    space = space_panel("", looks, share=1.35, atlas=atlas, cuts=cuts, one_colour=style.INK, steps=(0.25, 1.0))
    page.row(space, partial(draw_cuts, atlas=atlas, kind=kind), height=5.2)
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
