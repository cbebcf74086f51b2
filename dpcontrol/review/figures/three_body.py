"""Three bodies: the same search about L1 and L2: orbits, tubes in the plane, and the first connection between them."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from dpcontrol.review import style
from dpcontrol.review.figures.cuts import draw_cuts, kind_of
from dpcontrol.review.figures.page import Gallery, Page
from dpcontrol.review.panel_frame import new_figure, quiet
from dpcontrol.walks.atlas import Atlas

ENERGY = -1.5175


def draw(gallery: Gallery) -> Page:
    """Draw L1's and L2's Lyapunov orbits, their tubes to x = 1 - μ, and the first connection from L1 to L2."""
    atlas, system = gallery.atlas("three-body", ENERGY, None), gallery.system("three-body")
    kind = kind_of(atlas, "L1", "L2")
    assert kind is not None
    mu = float(system.parameters[0])
    figure = new_figure(14, 5.6, f"Three bodies: orbits about L1 and L2 at energy {ENERGY:g}, tubes, first connection")
    plane = figure.add_axes((0.045, 0.1, 0.36, 0.76))
    _forbidden(plane, gallery)
    _tubes(plane, atlas, kind.section, kind.hits[0])
    _bodies(plane, atlas, mu)
    plane.legend(
        handles=[
            Line2D([], [], color=style.UNSTABLE, label="unstable tube of L1"),
            Line2D([], [], color=style.STABLE, label="stable tube of L2"),
        ],
        fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=2, borderaxespad=0.2,
    )  # fmt: skip
    cuts = figure.add_axes((0.46, 0.1, 0.22, 0.76))
    draw_cuts(cuts, atlas, kind, numbers={c.name: "ab"[k] for k, c in enumerate(atlas.between("L1", "L2")[:2])},
              legend=False)  # fmt: skip
    cuts.set_title(f"cuts on {kind.section.replace('mu', 'μ')}, hits {list(kind.hits)}", fontsize=10, loc="left")
    flight = figure.add_axes((0.72, 0.1, 0.27, 0.76))
    _forbidden(flight, gallery)
    connections = atlas.between("L1", "L2")
    for c in connections[:1]:
        flight.plot(c.states[:, 0], c.states[:, 1], color=style.CONNECTIONS[0], linewidth=1.1, zorder=3)
    _bodies(flight, atlas, mu)
    flight.set_title("a  from L1's orbit to L2's" if connections else "none found", fontsize=10, loc="left")
    return Page(
        figure,
        "The planar circular restricted three-body problem in the rotating frame, mass ratio "
        f"{mu:g}, near the smaller primary (dot). Grey: out of reach at this energy. Left: Lyapunov orbits about L1 "
        f"(teal) and L2 (violet), the unstable tube of L1 and the stable tube of L2 up to their crossing number "
        f"{kind.hits[0]} of the line x = 1 - μ. Middle: the cuts there, with the {kind.count} connections found. "
        "Right: the first of them, whole.",
        f"Both tubes pass the line once before they can meet: hits {list(kind.hits)} are the first at which there are "
        "connections from L1 to L2. The code is that of the pendulum; the energy's constant is that of the paper's "
        "appendix. Cuts are open where trajectories of the tube pass close to the smaller primary and are scattered.",
    )


def _forbidden(axes: Axes, gallery: Gallery) -> None:
    system = gallery.system("three-body")
    x, y = np.meshgrid(np.linspace(0.88, 1.12, 240), np.linspace(-0.12, 0.12, 240))
    # At rest in the rotating frame the energy is the effective potential.
    states = np.stack([x, y, 0 * x, 0 * x], axis=-1).reshape(-1, 4)
    potential = system.numeric.hamiltonian(states).reshape(x.shape)
    axes.contourf(x, y, potential, levels=[ENERGY, 1e9], colors=["#c4c9cf"])
    quiet(axes)
    axes.grid(False)
    axes.set_xlim(0.89, 1.11)
    axes.set_ylim(-0.11, 0.11)
    axes.set_aspect("equal")
    axes.set_xlabel("x", fontsize=9)
    axes.set_ylabel("y", fontsize=9, labelpad=1)


def _tubes(axes: Axes, atlas: Atlas, section: str, hit: int) -> None:
    for saddle, colour in (("L1", style.UNSTABLE), ("L2", style.STABLE)):
        cut = atlas.cut(saddle, section, hit)
        for strand in cut.strands:
            states = atlas.turned(strand, saddle) if colour == style.STABLE else strand
            axes.plot(states[:, 0], states[:, 1], color=colour, linewidth=0.45, alpha=0.75)


def _bodies(axes: Axes, atlas: Atlas, mu: float) -> None:
    for orbit in atlas.orbits:
        closed = np.vstack([orbit.samples, orbit.samples[:1]])
        axes.plot(closed[:, 0], closed[:, 1], color=style.saddle_colour(orbit.saddle), linewidth=2.4, zorder=5)
        axes.annotate(orbit.saddle, closed[:, :2].max(axis=0), fontsize=9, color=style.saddle_colour(orbit.saddle))
    axes.plot(1 - mu, 0, "o", color=style.INK, markersize=5, zorder=6)
    axes.axvline(1 - mu, color=style.MARK, linewidth=0.8, linestyle=(0, (2, 2)))
