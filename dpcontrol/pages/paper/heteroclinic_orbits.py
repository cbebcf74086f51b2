"""Heteroclinic connections in space, from either saddle to the other."""

from dpcontrol.pages import style
from dpcontrol.pages.atlas_flights import space_panel
from dpcontrol.pages.atlas_parts import connections_of, kind_of
from dpcontrol.pages.gallery import IDENTIFIED, Gallery, PaperFigure
from dpcontrol.pages.layout import MOST_IN_KEY, Page
from dpcontrol.pages.paper.senses import SENSES_ENERGY


def heteroclinic_orbits_page(gallery: Gallery) -> PaperFigure:
    """Draw heteroclinic connections at 0.2 J in (θ₁, θ₂, ω₁).

    Both Lyapunov orbits are included.
    """
    atlas = gallery.atlas("lab", SENSES_ENERGY, (1, 1))
    page = Page(f"Heteroclinic orbits in (θ₁, θ₂, ω₁) at {SENSES_ENERGY:g} J")
    words, spaces = [], []
    for column, (source, target) in enumerate((("down-up", "up-down"), ("up-down", "down-up"))):
        kind = kind_of(atlas, source, target)
        assert kind is not None
        # One of each pair of reflections is drawn.
        kept = [c for c in connections_of(atlas, kind) if c.sense > 0]
        title = f"{'ab'[column]}  {source} → {target}"
        flights = [(c, style.SERIES[k % len(style.SERIES)]) for k, c in enumerate(kept)]
        looks = [(f"{c.transversality_angle:.1f}°", colour) for c, colour in flights[:MOST_IN_KEY]]
        spaces.append(space_panel(title, looks, atlas=atlas, cuts=(), flights=flights))
        words.append(f"{len(kept)} from {source} to {target}")
    page.row(*spaces, height=5.4)
    return PaperFigure(
        page.figure(),
        f"The heteroclinic connections at {SENSES_ENERGY:g} J whose difference of angles grows on the section θ₁ = θ₂ "
        f"({' and '.join(words)}; each has a reflection). They lead from one Lyapunov orbit to the other, "
        "or to its thin copy whole turns away, and are labelled with the angle between the tubes. Those of b are those "
        "of a, run backward in time.",
        f"The paper draws one direction. {IDENTIFIED}",
    )
