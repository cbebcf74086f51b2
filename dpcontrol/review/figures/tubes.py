"""Tubes of Down-Up in space, and the cuts in which they meet the section."""

from matplotlib.lines import Line2D

from dpcontrol.review import style
from dpcontrol.review.figures.cuts import draw_cuts, kind_of
from dpcontrol.review.figures.page import Gallery, Page
from dpcontrol.review.figures.space import draw_space
from dpcontrol.review.panel_frame import new_figure

ENERGY = -0.07
SADDLE = "down-up"


def draw(gallery: Gallery) -> Page:
    """Draw the tubes of Down-Up at -0.07 J up to the section, and their cuts."""
    atlas = gallery.atlas("lab", ENERGY, (1, 1))
    kind = kind_of(atlas, SADDLE, SADDLE)
    assert kind is not None
    figure = new_figure(13.5, 5.8, f"The tubes of the Lyapunov orbit about Down-Up at {ENERGY:g} J, and their cuts")
    space = figure.add_axes((0.06, -0.03, 0.5, 0.98), projection="3d")
    draw_space(space, atlas, hit_of=lambda cut: 1 if cut.section.name == kind.section else None, only=SADDLE,
               one_colour=style.INK)  # fmt: skip
    space.legend(
        handles=[
            Line2D([], [], color=style.UNSTABLE, label="unstable tube, forward branch"),
            Line2D([], [], color=style.PALE_UNSTABLE, label="unstable tube, backward branch"),
            Line2D([], [], color=style.STABLE, label="stable tube, forward branch"),
            Line2D([], [], color=style.PALE_STABLE, label="stable tube, backward branch"),
            Line2D([], [], color=style.INK, linewidth=2.5, label="Lyapunov orbit"),
            Line2D([], [], color=style.CUT, linewidth=2, label="cut on θ₂ = 2πk"),
        ],
        fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(-0.22, 0.97),
    )  # fmt: skip
    axes = figure.add_axes((0.62, 0.1, 0.37, 0.75))
    draw_cuts(axes, atlas, kind)
    return Page(
        figure,
        f"Left: trajectories that leave the Lyapunov orbit about Down-Up at {ENERGY:g} J (red) and that come to it "
        "(green) form tubes; the two shades are the tube's two branches, on which the outer arm turns one way or the "
        "other. They are drawn in the angles and the inner arm's rate as far as the section on which the outer arm "
        "hangs straight down. Right: on that section each tube is a closed curve, q the inner arm's angle, p its "
        f"momentum over p₀. Solid curves are crossed with the outer arm's angle rising, dashed ones with it falling; "
        f"where two of one kind meet lie the {kind.count} homoclinic connections, both senses together.",
        f"The energy is that of the homoclinic connections, {ENERGY:g} J; the paper need not have drawn its tubes at "
        "the same. Both branches of both tubes are drawn, and the section's coordinates are canonical, so that areas "
        "on it are those that the flow keeps. Parameters are the rig's identified ones, which reproduce the paper's "
        "pictures; those it prints do not.",
    )
