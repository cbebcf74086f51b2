"""Cuts of the tubes against energy."""

from functools import partial

from dpcontrol.pages.atlas_cuts import draw_cuts
from dpcontrol.pages.atlas_parts import connections_of, kind_of
from dpcontrol.pages.gallery import IDENTIFIED, Gallery, PaperFigure
from dpcontrol.pages.layout import Draw, Page

CUT_ENERGIES = (-0.147, -0.07, -0.034, 0.06, 0.102, 0.157)


def cuts_page(gallery: Gallery) -> PaperFigure:
    """Draw the cuts of Down-Up's tubes at six energies."""
    page = Page("Cuts of the tubes of Down-Up on θ₂ = 2πk, as energy grows (first hits)")
    panels: list[Draw] = []
    words = []
    for k, energy in enumerate(CUT_ENERGIES):
        gallery.progress(f"cuts at {energy:g} J", k / len(CUT_ENERGIES))
        atlas = gallery.atlas("lab", energy, (1, 1))
        kind = kind_of(atlas, "down-up", "down-up")
        assert kind is not None
        symmetric = sum(c.symmetric for c in connections_of(atlas, kind))
        title = f"{'abcdef'[k]}  {energy:g} J: {kind.count} connections, {symmetric} symmetric"
        panels.append(partial(draw_cuts, atlas=atlas, kind=kind, title=title, legend=k == 0))
        words.append(f"{kind.count} at {energy:g} J")
    page.row(*panels[:3], height=3.5).row(*panels[3:], height=3.3)
    return PaperFigure(
        page.figure(),
        "First cuts of the unstable (red) and stable (green) tubes of the Lyapunov orbit about Down-Up on the section "
        "with the outer arm hanging, at six energies: the inner arm's angle and its momentum over p₀. Solid: a "
        "rising angle of the outer arm; dashed: a falling one. Homoclinic connections, both senses: "
        f"{', '.join(words)}.",
        f"Momenta are canonical in place of the paper's rates; both senses are in one panel. {IDENTIFIED}",
    )
