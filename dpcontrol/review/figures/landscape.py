"""Hill's regions: where in the plane of the angles an energy allows the arms to be, and the saddles between."""

import numpy as np

from dpcontrol.orbits.equilibria import equilibria
from dpcontrol.review import style
from dpcontrol.review.figures.page import Gallery, Page
from dpcontrol.review.panel_frame import angle_axis, new_figure, quiet

ENERGIES = (-0.3, -0.07, 0.2, 0.55)
_GRID = 241


def draw(gallery: Gallery) -> Page:
    """Draw the potential as a landscape and Hill's regions at four energies, for the lab pendulum."""
    system = gallery.system("lab")
    angles = np.linspace(-np.pi, np.pi, _GRID)
    first, second = np.meshgrid(angles, angles)
    states = np.stack([first, second, 0 * first, 0 * first], axis=-1)
    potential = system.numeric.hamiltonian(states.reshape(-1, 4)).reshape(first.shape)
    points = equilibria(system)
    figure = new_figure(13.5, 3.7, "Hill's regions of the lab pendulum: what each energy opens")
    grid = figure.add_gridspec(
        1, 5, left=0.012, right=0.985, top=0.86, bottom=0.12, wspace=0.32, width_ratios=[1.45, 1, 1, 1, 1]
    )
    relief = figure.add_subplot(grid[0, 0], projection="3d")
    relief.plot_surface(first, second, potential, cmap="viridis", linewidth=0, rcount=60, ccount=60, alpha=0.95)  # type: ignore[attr-defined]
    relief.view_init(elev=38, azim=-60)  # type: ignore[attr-defined]
    relief.set_title("potential energy (J)", fontsize=10, color=style.INK, y=1.02)
    for which, label in (("x", "θ₁"), ("y", "θ₂")):
        angle_axis(relief, which, step=1.0)
        getattr(relief, f"set_{which}label")(label, fontsize=9, labelpad=-4)
    relief.tick_params(labelsize=7.5, pad=-2)
    for k, energy in enumerate(ENERGIES):
        axes = figure.add_subplot(grid[0, k + 1])
        axes.contourf(first, second, potential, levels=[potential.min() - 1, energy], colors=["#dbe9f6"])
        axes.contourf(first, second, potential, levels=[energy, potential.max() + 1], colors=["#8d959e"])
        axes.contour(first, second, potential, levels=[energy], colors=[style.INK], linewidths=1.0, linestyles="solid")
        passable = []
        for name, point in points.items():
            reached = point.energy <= energy
            mark = "o" if point.kind == "centre" else ("s" if point.kind.startswith("index-1") else "^")
            for a in {-np.pi, np.pi} if point.state[0] else {0.0}:
                for b in {-np.pi, np.pi} if point.state[1] else {0.0}:
                    axes.plot(a, b, mark, color="#2c8a4b" if reached else style.LIMIT, clip_on=False, markersize=6)
            if reached and point.kind != "centre":
                passable.append(name)
        words = {0: "no saddle reached", 2: "both saddles open", 3: "everything reached"}.get(
            len(passable), " and ".join(passable) + " open"
        )
        quiet(axes, f"{energy:g} J: {words}")
        axes.title.set_fontsize(8.5)
        axes.grid(False)
        axes.set_aspect("equal")
        angle_axis(axes, "x", step=1.0)
        angle_axis(axes, "y", step=1.0)
        axes.set_xlabel("θ₁", fontsize=9, labelpad=1)
        if k == 0:
            axes.set_ylabel("θ₂", fontsize=9, labelpad=-2)
    listed = ", ".join(f"{name} {point.energy:+.4f} J" for name, point in points.items())
    return Page(
        figure,
        "Left: the potential energy over the torus of the two angles (from hanging). Right: Hill's regions at four "
        "energies; blue may be reached, grey may not, the line between is where both arms stand still. Circle: the "
        "stable equilibrium; squares: the saddles Down-Up and Up-Down, through whose necks an arm turns; triangle: the "
        "maximum Up-Up. Green: the energy reaches it; red: it does not. Equilibria: " + listed + ".",
        "Energies are chosen one between each two equilibria, so that every kind of Hill's region is seen once; "
        "parameters are the rig's identified ones, since those printed in the paper are not the values behind its "
        "pictures.",
    )
