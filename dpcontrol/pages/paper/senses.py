"""Tubes and their cuts for both senses of an arm's rotation."""

from functools import partial

from dpcontrol.pages import style
from dpcontrol.pages.atlas_cuts import draw_cuts
from dpcontrol.pages.atlas_flights import space_panel
from dpcontrol.pages.atlas_parts import connections_of, kind_of
from dpcontrol.pages.gallery import IDENTIFIED, Gallery, PaperFigure
from dpcontrol.pages.layout import Page

SENSES_ENERGY = 0.2
_TURNING = {"down-up": ("outer", "θ₂ = 2πk", "θ₁"), "up-down": ("inner", "θ₁ = 2πk", "θ₂")}


def senses_page(gallery: Gallery, *, saddle: str) -> PaperFigure:
    """Draw a saddle's tubes at 0.2 J and their cuts.

    The two senses of rotation are separate.

    Args:
        gallery: data sources.
        saddle: "down-up" or "up-down".
    """
    atlas = gallery.atlas("lab", SENSES_ENERGY, (1, 1))
    kind = kind_of(atlas, saddle, saddle)
    assert kind is not None
    arm, section, coordinate = _TURNING[saddle]
    cuts = [cut for cut in atlas.cuts if (cut.saddle, cut.section.name, cut.hit) == (saddle, kind.section, 1)]
    page = Page(f"The tubes of {saddle} at {SENSES_ENERGY:g} J: the {arm} arm turns either way")
    looks = [("tube out", style.UNSTABLE), ("tube in", style.STABLE)]
    looks += [("Lyapunov orbit", style.saddle_colour(saddle)), ("cut", style.CUT)]
    spaces, panels, counts = [], [], []
    for column, sense in enumerate((1, -1)):
        way = "forward" if sense > 0 else "backward"
        shown = tuple(c for c in connections_of(atlas, kind) if c.sense == sense)
        title = f"{'ab'[column]}  the {arm} arm turns {way}"
        spaces.append(space_panel(title, looks, atlas=atlas, cuts=cuts, sense=sense, saddles=(saddle,)))
        title = f"{'cd'[column]}  cuts on {section}, crossed {way}"
        panels.append(partial(draw_cuts, atlas=atlas, kind=kind, shown=shown, legend=False, sense=sense, title=title))
        counts.append(f"{len(shown)} {way}")
    page.row(*spaces, height=4.8).row(*panels, height=3.4)
    return PaperFigure(
        page.figure(),
        f"Trajectories that leave the Lyapunov orbit about {saddle} at {SENSES_ENERGY:g} J (red) and that approach it "
        f"(green), in (θ₁, θ₂, ω₁), up to the section {section}. Panels a and b: the two senses of the {arm} arm. "
        f"Below, the corresponding cuts: {coordinate} on the section and its momentum over p₀. Homoclinic "
        f"connections: {' and '.join(counts)}.",
        "Both tubes start at the orbit's named position, so the red one ends on one sheet of the section and the green "
        f"one begins on another, whole turns away. Momenta are canonical in place of the paper's rates. {IDENTIFIED}",
    )
