"""Heteroclinic connections of the lab pendulum at 0.2 J, there and back."""

from dpcontrol.review.figures.cuts import kind_of
from dpcontrol.review.figures.flights import draw_row
from dpcontrol.review.figures.page import Gallery, Page
from dpcontrol.review.panel_frame import new_figure

ENERGY = 0.2
PAIRS = (("down-up", "up-down"), ("up-down", "down-up"))


def draw(gallery: Gallery) -> Page:
    """Draw the connections from Down-Up to Up-Down and back at 0.2 J."""
    atlas = gallery.atlas("lab", ENERGY, (1, 1))
    figure = new_figure(14, 9.2, f"Heteroclinic connections between Down-Up and Up-Down at {ENERGY:g} J (first hits)")
    grid = figure.add_gridspec(2, 1, left=0.05, right=0.99, top=0.89, bottom=0.06, hspace=0.32)
    counts = []
    for row, (source, target) in enumerate(PAIRS):
        kind = kind_of(atlas, source, target)
        assert kind is not None
        shown = atlas.between(source, target)[:4]
        numbers = {c.name: "abcdefgh"[4 * row + k] for k, c in enumerate(shown)}
        draw_row(figure, grid[row, 0], atlas, kind, shown, numbers=numbers, share=1.75)
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
