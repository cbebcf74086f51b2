"""The graph of orbits and connections at two energies."""

from functools import partial

from dpcontrol.pages.gallery import Gallery, PaperFigure
from dpcontrol.pages.layout import Page
from dpcontrol.pages.panels import draw_graph
from dpcontrol.walks.atlas import walks

GRAPH_ENERGIES = (-0.07, 0.2)
_LENGTH = 3


def graph_page(gallery: Gallery) -> PaperFigure:
    """Draw the graphs at -0.07 and 0.2 J."""
    page, panels, words = Page("The connection graph: every walk on it is an itinerary"), [], []
    for energy in GRAPH_ENERGIES:
        graph = gallery.atlas("lab", energy, (1, 1)).graph()
        panels.append(partial(draw_graph, graph=graph, title=f"{energy:g} J"))
        count = sum(1 for node in graph.nodes for _ in walks(graph, node, length=_LENGTH))
        words.append(
            f"at {energy:g} J: {graph.number_of_nodes()} {'orbit' if len(graph) == 1 else 'orbits'}, "
            f"{graph.number_of_edges()} connections, {count:,} walks of {_LENGTH} symbols"
        )
    return PaperFigure(
        page.row(*panels, height=4.0).figure(),
        "Nodes are Lyapunov orbits, arrows the connections between them, with their number and that of the symmetric "
        f"ones. There are {'; '.join(words)}. Before each symbol the arms may wrap round an orbit any number of times.",
        "Numbers are of first-hit connections on the torus of angles. Reflected and mirrored ones are different "
        "motions and are counted. At -0.07 J Up-Down has no orbit, and no arrow can lead there.",
    )
