"""Tubes of the pendulum's orbits in space, and their cuts on a section."""

from functools import partial

from dpcontrol.pages.atlas_panels import draw_cuts, draw_space
from dpcontrol.pages.atlas_parts import connections_of, kind_of
from dpcontrol.pages.gallery import IDENTIFIED, Gallery, PaperFigure
from dpcontrol.pages.layout import Draw, Page, Panel

ENERGY, SENSES_ENERGY = -0.07, 0.2
CUT_ENERGIES = (-0.147, -0.07, -0.034, 0.06, 0.102, 0.157)
SADDLE = "down-up"
_TURNING = {"down-up": ("outer", "θ₂ = 2πk", "θ₁"), "up-down": ("inner", "θ₁ = 2πk", "θ₂")}


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
        tubes = {"cuts": [atlas.cut(saddle, kind.section, 1)], "sense": sense, "saddles": (saddle,), "title": turns}
        spaces.append(Panel(partial(draw_space, atlas=atlas, **tubes), space=True))
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
