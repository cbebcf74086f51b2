"""Tubes of the pendulum's orbits in space, and their cuts on a section."""

from functools import partial
from typing import Any

from dpcontrol.pages import style
from dpcontrol.pages.atlas_panels import draw_cuts, space_panel
from dpcontrol.pages.atlas_parts import connections_of, kind_of
from dpcontrol.pages.gallery import IDENTIFIED, Gallery, PaperFigure
from dpcontrol.pages.layout import Draw, Page, Panel
from dpcontrol.walks.atlas import Atlas, AtlasKind

ENERGY, SENSES_ENERGY = -0.07, 0.2
CUT_ENERGIES = (-0.147, -0.07, -0.034, 0.06, 0.102, 0.157)
SADDLE = "down-up"
_TURNING = {"down-up": ("outer", "θ₂ = 2πk", "θ₁"), "up-down": ("inner", "θ₁ = 2πk", "θ₂")}


def _tubes(title: str, orbit: str, atlas: Atlas, kind: AtlasKind, **drawn: Any) -> Panel:
    """Return a panel of the tubes of a kind's source up to their first cut; `orbit` is the orbit's colour."""
    looks = [("tube out", style.UNSTABLE), ("tube in", style.STABLE), ("Lyapunov orbit", orbit), ("cut", style.CUT)]
    return space_panel(title, looks, atlas=atlas, cuts=[atlas.cut(kind.source, kind.section, 1)], **drawn)


def tubes_page(gallery: Gallery) -> PaperFigure:
    """Draw the tubes of Down-Up at -0.07 J and their cuts."""
    atlas = gallery.atlas("lab", ENERGY, (1, 1))
    kind = kind_of(atlas, SADDLE, SADDLE)
    page = Page(f"The tubes of the Lyapunov orbit about Down-Up at {ENERGY:g} J, and their cuts on θ₂ = 2πk")
    space = _tubes("", style.INK, atlas, kind, share=1.35, one_colour=style.INK, steps=(0.25, 1.0))
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


def senses_page(gallery: Gallery, *, saddle: str) -> PaperFigure:
    """Draw a saddle's tubes at 0.2 J and their cuts, separately for the two senses of rotation.

    Args:
        gallery: data sources.
        saddle: "down-up" or "up-down".
    """
    atlas = gallery.atlas("lab", SENSES_ENERGY, (1, 1))
    kind = kind_of(atlas, saddle, saddle)
    arm, section, coordinate = _TURNING[saddle]
    spaces, panels, counts = [], [], []
    for letters, sense, way in (("ac", 1, "forward"), ("bd", -1, "backward")):
        shown = tuple(c for c in connections_of(atlas, kind) if c.sense == sense)
        turns, cuts = (f"{letters[0]}  the {arm} arm turns {way}", f"{letters[1]}  cuts on {section}, crossed {way}")
        spaces.append(_tubes(turns, style.saddle_colour(saddle), atlas, kind, sense=sense, saddles=(saddle,)))
        panels.append(partial(draw_cuts, atlas=atlas, kind=kind, shown=shown, legend=False, sense=sense, title=cuts))
        counts.append(f"{len(shown)} {way}")
    page = Page(f"The tubes of {saddle} at {SENSES_ENERGY:g} J: the {arm} arm turns either way")
    return PaperFigure(
        page.row(*spaces, height=4.8).row(*panels, height=3.4).figure(),
        f"Trajectories that leave the Lyapunov orbit about {saddle} at {SENSES_ENERGY:g} J (red) and that approach it "
        f"(green), in (θ₁, θ₂, ω₁), up to the section {section}. Panels a and b: the two senses of the {arm} arm. "
        f"Below, the corresponding cuts: {coordinate} on the section and its momentum over p₀. Homoclinic "
        f"connections: {' and '.join(counts)}.",
        "Both tubes start at the orbit's named position, so the red one ends on one sheet of the section and the green "
        f"one begins on another, whole turns away. Momenta are canonical in place of the paper's rates. {IDENTIFIED}",
    )


def cuts_page(gallery: Gallery) -> PaperFigure:
    """Draw the cuts of Down-Up's tubes at six energies."""
    panels: list[Draw] = []
    words = []
    for k, energy in enumerate(CUT_ENERGIES):
        gallery.progress(f"cuts at {energy:g} J", k / len(CUT_ENERGIES))
        atlas = gallery.atlas("lab", energy, (1, 1))
        kind = kind_of(atlas, SADDLE, SADDLE)
        symmetric = sum(c.symmetric for c in connections_of(atlas, kind))
        title = f"{'abcdef'[k]}  {energy:g} J: {kind.count} connections, {symmetric} symmetric"
        panels.append(partial(draw_cuts, atlas=atlas, kind=kind, title=title, legend=k == 0))
        words.append(f"{kind.count} at {energy:g} J")
    page = Page("Cuts of the tubes of Down-Up on θ₂ = 2πk, as energy grows (first hits)")
    return PaperFigure(
        page.grid(panels, across=3, height=3.4).figure(),
        "First cuts of the unstable (red) and stable (green) tubes of the Lyapunov orbit about Down-Up on the section "
        "with the outer arm hanging, at six energies: the inner arm's angle and its momentum over p₀. Solid: a "
        "rising angle of the outer arm; dashed: a falling one. Homoclinic connections, both senses: "
        f"{', '.join(words)}.",
        f"Momenta are canonical in place of the paper's rates; both senses are in one panel. {IDENTIFIED}",
    )
