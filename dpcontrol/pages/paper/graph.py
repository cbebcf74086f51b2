"""The graph of orbits and connections at two energies."""

from functools import partial
from itertools import permutations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch

from dpcontrol.pages import style
from dpcontrol.pages.gallery import Gallery, PaperFigure
from dpcontrol.pages.layout import Page, Panel
from dpcontrol.walks.atlas import Atlas, walks

GRAPH_ENERGIES = (-0.07, 0.2)
_RADIUS = 0.45
_LENGTH = 3


def graph_page(gallery: Gallery) -> PaperFigure:
    """Draw the graphs at -0.07 and 0.2 J."""
    atlases = [gallery.atlas("lab", energy, (1, 1)) for energy in GRAPH_ENERGIES]
    page = Page("The connection graph: every walk on it is an itinerary")
    page.row(*(Panel(partial(_graph, atlas=atlas), 1 + 0.8 * k) for k, atlas in enumerate(atlases)), height=5.2)
    words = []
    for atlas in atlases:
        graph = atlas.graph()
        count = sum(1 for node in graph.nodes for _ in walks(graph, node, length=_LENGTH))
        words.append(
            f"at {atlas.energy:g} J: {graph.number_of_nodes()} {'orbit' if len(graph) == 1 else 'orbits'}, "
            f"{graph.number_of_edges()} connections, {count:,} walks of {_LENGTH} symbols"
        )
    return PaperFigure(
        page.figure(),
        "Nodes are Lyapunov orbits, each arrow is one connection: solid for symmetric ones, dashed for one of a "
        "mirror pair. The positive sense is above a node, the negative below. "
        f"There are {'; '.join(words)}. Before each symbol the arms may wobble any number of times.",
        "There is one arrow for each first-hit connection on the torus of angles. Reflected and mirrored ones are "
        "different motions and are counted. At -0.07 J Up-Down has no orbit, and no arrow can lead there.",
    )


def _graph(axes: Axes, atlas: Atlas) -> None:
    places = {orbit.name: (3.9 * k, 0.0) for k, orbit in enumerate(atlas.orbits)}
    for orbit in atlas.orbits:
        x, y = places[orbit.name]
        axes.add_patch(Circle((x, y), _RADIUS, color=style.saddle_colour(orbit.saddle), zorder=5))
        axes.text(
            x, y, orbit.name, ha="center", va="center", color="white", fontsize=style.SMALL, weight="bold", zorder=6
        )
        for sign in (1, -1):
            loops = [c for c in atlas.between(orbit.saddle, orbit.saddle) if c.sense == sign]
            loops.sort(key=lambda c: not c.symmetric)
            for k, c in enumerate(loops):
                size = 0.4 + 0.12 * k
                _loop(axes, x, y + sign * _RADIUS * 0.85, sign, size, dashed=not c.symmetric, saddle=orbit.saddle)
            if loops:
                top = y + sign * (_RADIUS + 2 * (0.4 + 0.12 * (len(loops) - 1)) + 0.12)
                turning = "outer" if loops[0].winding[1] else "inner"
                axes.text(x, top, f"{len(loops)}: {turning} arm {sign:+d} turn", ha="center", va="center",
                          fontsize=style.TEXT, color=style.INK)  # fmt: skip
    for source, target in permutations(places, 2):
        found = atlas.between(source, target)
        for k, c in enumerate(found):
            bend = -(0.1 + 0.16 * k)
            (x0, _), (x1, _) = places[source], places[target]
            step = np.sign(x1 - x0) * _RADIUS
            axes.add_patch(
                FancyArrowPatch(
                    (x0 + step, 0), (x1 - step, 0), connectionstyle=f"arc3,rad={bend}", arrowstyle="-|>",
                    mutation_scale=13, color=style.saddle_colour(source), linewidth=1.4,
                    linestyle="-" if c.symmetric else (0, (5, 2)), shrinkA=4, shrinkB=4,
                )
            )  # fmt: skip
        if found:
            side = 1 if places[target][0] > places[source][0] else -1
            axes.text(
                1.95,
                side * 1.28,
                f"{len(found)}: {source} → {target}",
                ha="center",
                fontsize=style.TEXT,
                color=style.INK,
            )
    middle = 3.9 * (len(places) - 1) / 2
    axes.set(xlim=(-1.6, 2 * middle + 1.6), ylim=(-3.0, 3.35), aspect="equal")
    axes.axis("off")
    axes.text(middle, 3.2, f"{atlas.energy:g} J", ha="center", fontsize=style.VERDICT, color=style.INK)


def _loop(axes: Axes, x: float, y: float, sign: int, size: float, *, dashed: bool, saddle: str) -> None:
    """Draw an arrow from a node to itself.

    It is an ellipse that touches the node, with a head at its end.
    """
    t = np.linspace(0.02, 0.98, 120) * 2 * np.pi
    px, py = x - 0.55 * size * np.sin(t), y + sign * size * (1 - np.cos(t))
    colour = style.saddle_colour(saddle)
    axes.plot(px, py, color=colour, linewidth=1.3, linestyle=(0, (5, 2)) if dashed else "-", zorder=3)
    axes.annotate("", (px[-12], py[-12]), (px[-18], py[-18]),
                  arrowprops={"arrowstyle": "-|>", "color": colour, "mutation_scale": 10})  # fmt: skip
