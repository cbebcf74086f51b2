"""Homoclinic connections of the lab pendulum at two energies: where cuts meet, and the flights."""

import numpy as np

from dpcontrol.review.figures.cuts import colours, kind_of, one_of_each
from dpcontrol.review.figures.flights import draw_row
from dpcontrol.review.figures.page import Gallery, Page
from dpcontrol.review.panel_frame import new_figure
from dpcontrol.walks.atlas import Atlas, AtlasConnection

_MOST = 5


def draw_low(gallery: Gallery) -> Page:
    """Draw Down-Up's homoclinics at -0.07 J."""
    atlas = gallery.atlas("lab", -0.07, (1, 1))
    return _page(
        atlas,
        ["down-up"],
        "Below the energy of Up-Down only the outer arm can turn over.",
        "The search finds its own intersections, without windows set by hand: in each sense two symmetric connections "
        "and a mirror pair, all counted on the torus of angles. Section coordinates are canonical, angles at the "
        "crossings are measured in them.",
    )


def draw_high(gallery: Gallery) -> Page:
    """Draw both saddles' homoclinics at 0.2 J."""
    atlas = gallery.atlas("lab", 0.2, (1, 1))
    return _page(
        atlas,
        ["down-up", "up-down"],
        "At this energy both saddles have orbits: the outer arm turns about Down-Up, the inner arm about Up-Down.",
        "Counts are of first hits on these sections, both senses and mirror images included; cuts that graze the "
        "section are open there, and crossings beyond their ends belong to later hits. A count at a section is not the "
        "number of connections.",
    )


def _page(atlas: Atlas, saddles: list[str], lead: str, differs: str) -> Page:
    tall = 0.7 + 4.3 * len(saddles)
    figure = new_figure(14, tall, f"Homoclinic connections at {atlas.energy:g} J (first hits)")
    grid = figure.add_gridspec(
        len(saddles), 1, left=0.05, right=0.99, top=1 - 0.95 / tall, bottom=0.5 / tall, hspace=0.32
    )
    words = []
    for row, saddle in enumerate(saddles):
        kind = kind_of(atlas, saddle, saddle)
        assert kind is not None
        connections = atlas.between(saddle, saddle)
        kept = one_of_each(connections)[:_MOST]
        # Where the outer arm turns flights are tall, where the inner one does they are wide.
        flat = not kept[0].winding[1]
        draw_row(figure, grid[row, 0], atlas, kind, kept, numbers=numbered(connections, kept), flat=flat)
        symmetric = sum(c.symmetric for c in connections)
        word = "closed" if kind.complete else "open in places"
        words.append(
            f"{saddle}: {kind.count} connections ({symmetric} symmetric, {kind.count - symmetric} in mirror pairs), "
            f"largest residual {max(c.residual for c in connections):.0e}, cuts {word}"
        )
    return Page(
        figure,
        f"{lead} Left: the cuts of the unstable (red) and stable (green) tube; dots of one colour are one connection "
        "and its mirror images, and carry its number. Right: one flight of each colour, of positive sense, in the "
        "plane of the angles (thick and pale: the orbits it leaves and joins; dot: where it passes the section), with "
        f"the angle at which the cuts meet. {'; '.join(words)}.",
        differs,
    )


def numbered(connections: tuple[AtlasConnection, ...], kept: list[AtlasConnection]) -> dict[str, str]:
    """Return the number of each connection by name: that of the kept one of its colour."""
    look = colours(connections)
    number = {look[c.name]: str(k + 1) for k, c in enumerate(kept)}
    return {c.name: number[look[c.name]] for c in connections if look[c.name] in number and np.isfinite(c.point[1])}
