# %% [markdown]
# # A tube and its cut
# The trajectories that leave an orbit form a tube. Its cut with a section, here the outer arm upright after a turn, is
# a closed curve. The mirror image of this curve belongs to the tube that approaches the orbit. At each intersection of
# the two curves, a trajectory leaves the orbit and returns. It is a homoclinic orbit.

# %%
from matplotlib.axes import Axes

import dpcontrol as dp
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, key, save_figure
from dpcontrol.pages.panels import angle_axis

atlas = dp.atlas(dp.load_model("lab"), energy=-0.07)
cut = atlas.cuts[0]


# %%
def tube(axes: Axes) -> None:
    """Draw the trajectories that leave the orbit, and the orbit."""
    axes.set_title("Trajectories that leave the orbit form a tube", loc="left")
    axes.set(xlabel="angle of the outer arm (rad)", ylabel="rate of the outer arm (rad/s)")
    for strand in cut.strands:
        axes.plot(strand[:, 1], strand[:, 3], color=style.UNSTABLE, linewidth=0.5, alpha=0.6)
    samples = atlas.orbits[0].samples
    axes.plot(samples[:, 1], samples[:, 3], color=style.INK, linewidth=2)
    angle_axis(axes, "x")
    key(axes, [("tube that leaves", style.UNSTABLE), ("orbit", style.INK)])


def section(axes: Axes) -> None:
    """Draw the cuts of both tubes, and their connections."""
    axes.set_title(f"The cuts of both tubes meet in {len(atlas.connections)} connections", loc="left")
    axes.set(xlabel="angle of the inner arm (rad)", ylabel="momentum of the inner arm, p / p₀")
    for piece in cut.pieces:
        axes.plot(*piece.points.T, color=style.UNSTABLE)
        axes.plot(*piece.stable_points.T, color=style.STABLE)
    for connection in atlas.connections:
        axes.plot(*connection.point, "o", color=style.INK, markersize=5)
    dot = {"color": style.INK, "marker": "o", "linestyle": ""}
    key(axes, [("tube that leaves", style.UNSTABLE), ("tube that arrives", style.STABLE), ("connections", dot)])


# %%
page = Page("The tubes that leave and reach an orbit meet in connections").row(tube, section, height=4.6)
save_figure(page.figure(), "tube.png")
