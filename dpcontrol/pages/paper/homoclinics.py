"""Homoclinic connections of one turn, at a low and a high energy."""

import numpy as np

from dpcontrol.pages.atlas_flights import row_of
from dpcontrol.pages.atlas_parts import colours, kind_of, one_of_each
from dpcontrol.pages.gallery import Gallery, PaperFigure
from dpcontrol.pages.layout import Page
from dpcontrol.walks.atlas import Atlas, AtlasConnection

_MOST = 5


def low_page(gallery: Gallery) -> PaperFigure:
    return _page(
        gallery.atlas("lab", -0.07, (1, 1)),
        ["down-up"],
        "Below the energy of Up-Down only the outer arm can turn over.",
        "The search finds intersections without windows set by hand: in each sense two symmetric connections "
        "and a mirror pair, all counted on the torus of angles. Section coordinates are canonical.",
    )


def high_page(gallery: Gallery) -> PaperFigure:
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

    Args:
        connections: connections to number.
        kept: one connection of each colour, in numbered order.
    """
    look = colours(connections)
    number = {look[c.name]: str(k + 1) for k, c in enumerate(kept)}
    return {c.name: number[look[c.name]] for c in connections if look[c.name] in number and np.isfinite(c.point[1])}
