"""The graph of orbits and connections at two energies."""

from functools import partial
from itertools import permutations
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch

from dpcontrol.pages import style
from dpcontrol.pages.gallery import Gallery, PaperFigure
from dpcontrol.pages.layout import Page, Panel
from dpcontrol.walks.atlas import Atlas, AtlasConnection, walks

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
    places = {orbit.name: 3.9 * k for k, orbit in enumerate(atlas.orbits)}
    middle, look = 3.9 * (len(places) - 1) / 2, {"ha": "center", "va": "center", "fontsize": style.SMALL}
    for orbit in atlas.orbits:
        x, colour = places[orbit.name], style.saddle_colour(orbit.saddle)
        axes.add_patch(Circle((x, 0.0), _RADIUS, color=colour, zorder=5))
        axes.text(x, 0.0, orbit.name, color="white", weight="bold", zorder=6, **look)
        for sign in (1, -1):
            loops = [c for c in atlas.between(orbit.saddle, orbit.saddle) if c.sense == sign]
            for k, c in enumerate(sorted(loops, key=lambda c: not c.symmetric)):
                _loop(axes, (x, sign * 0.85 * _RADIUS), sign * (0.4 + 0.12 * k), colour, _line(c))
            if loops:
                turning = "outer" if loops[0].winding[1] else "inner"
                text, top = f"{len(loops)}: {turning} arm {sign:+d} turn", _RADIUS + 0.68 + 0.24 * len(loops)
                axes.text(x, sign * top, text, color=style.INK, **look)
    for source, target in permutations(places, 2):
        connections, side = atlas.between(source, target), np.sign(places[target] - places[source])
        ends = [(places[source] + side * _RADIUS, 0.0), (places[target] - side * _RADIUS, 0.0)]
        for k, c in enumerate(connections):
            look_of = {"color": style.saddle_colour(source), "linewidth": 1.4, "linestyle": _line(c)}
            bend = f"arc3,rad={-(0.1 + 0.16 * k)}"
            axes.add_patch(FancyArrowPatch(*ends, connectionstyle=bend, arrowstyle="-|>", mutation_scale=13, **look_of))
        if connections:
            text = f"{len(connections)}: {source} → {target}"
            axes.text(middle, side * 1.28, text, color=style.INK, **look)
    axes.set(xlim=(-1.6, 2 * middle + 1.6), ylim=(-3.0, 3.35), aspect="equal")
    axes.axis("off")
    axes.text(middle, 3.2, f"{atlas.energy:g} J", ha="center", fontsize=style.VERDICT, color=style.INK)


def _line(connection: AtlasConnection) -> Any:
    return "-" if connection.symmetric else (0, (5, 2))


def _loop(axes: Axes, at: tuple[float, float], size: float, colour: str, line: Any) -> None:
    """Draw an arrow from a node to itself: an ellipse that touches the node, with a head at its end."""
    t = np.linspace(0.02, 0.98, 120) * 2 * np.pi
    x, y = at[0] - 0.55 * abs(size) * np.sin(t), at[1] + size * (1 - np.cos(t))
    axes.plot(x, y, color=colour, linewidth=1.3, linestyle=line, zorder=3)
    head = {"arrowstyle": "-|>", "color": colour, "mutation_scale": 10}
    axes.annotate("", (x[-12], y[-12]), (x[-18], y[-18]), arrowprops=head)
