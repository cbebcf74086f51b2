"""Heteroclinic connections of the lab pendulum at 0.2 J, there and back."""

from dpcontrol.review.figures.cuts import colours, draw_cuts, kind_of
from dpcontrol.review.figures.flights import draw_flight
from dpcontrol.review.figures.page import Gallery, Page
from dpcontrol.review.panel_frame import new_figure

ENERGY = 0.2
PAIRS = (("down-up", "up-down"), ("up-down", "down-up"))


def draw(gallery: Gallery) -> Page:
    """Draw the connections from Down-Up to Up-Down and back at 0.2 J."""
    atlas = gallery.atlas("lab", ENERGY, (1, 1))
    figure = new_figure(14, 9.2, f"Heteroclinic connections between Down-Up and Up-Down at {ENERGY:g} J (first hits)")
    grid = figure.add_gridspec(2, 2, left=0.05, right=0.99, top=0.89, bottom=0.06, hspace=0.32, wspace=0.08,
                               width_ratios=[1, 1.75])  # fmt: skip
    counts = []
    for row, (source, target) in enumerate(PAIRS):
        kind = kind_of(atlas, source, target)
        assert kind is not None
        connections = atlas.between(source, target)
        look = colours(connections)
        numbers = {c.name: "abcd efgh"[5 * row + k] for k, c in enumerate(connections[:4])}
        axes = figure.add_subplot(grid[row, 0])
        draw_cuts(axes, atlas, kind, numbers=numbers)
        flights = grid[row, 1].subgridspec(1, min(len(connections), 4), wspace=0.28)
        for k, c in enumerate(connections[:4]):
            panel = figure.add_subplot(flights[0, k])
            draw_flight(panel, atlas, c, look[c.name], labelled=k == 0)
            turns = ", ".join(f"{t:+d}" if t else "0" for t in c.winding)
            panel.set_title(f"{numbers[c.name]}  {c.transversality_angle:.1f}°, winding [{turns}]", fontsize=9,
                            color=look[c.name], loc="left")  # fmt: skip
        counts.append(f"{kind.count} from {source} to {target}")
    return Page(
        figure,
        "On the section both arms are aligned, θ₁ = θ₂ + 2πk. Left: where the unstable tube (red) of the orbit that is "
        "left meets the stable tube (green) of the orbit that is joined. Right: the flights in the plane of the "
        "angles, from the source's named position; pale teal is the orbit about Down-Up, pale violet that about "
        f"Up-Down. {' and '.join(counts)}; those in one direction are those in the other, run backward in time.",
        'The paper\'s heteroclinics "at H = -0.07" cannot exist, since Up-Down has no orbit below its energy of '
        "0.1754 J. Here both directions are drawn, and each connection with its reflection; the unstable tube's cut is "
        "open where its trajectories graze the section.",
    )
