"""Homoclinic connections that return to their initial angles without a whole turn."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.dynamics.system import System
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.pages import single, style
from dpcontrol.pages.gallery import IDENTIFIED, Gallery, PaperFigure
from dpcontrol.pages.layout import Page
from dpcontrol.pages.panels import quiet_plane
from dpcontrol.pages.paper.tubes import SENSES_ENERGY
from dpcontrol.tubes.connections import Connection, ConnectionSearch, find_connections
from dpcontrol.tubes.intersections import search_settings

_RETURN_FLIGHT = 2.0
"""Longest flight in periods of its orbit; longer ones scatter."""


def returning_search(system: System) -> ConnectionSearch:
    """Search homoclinics of Down-Up that cross θ₁ = θ₂ twice.

    The energy is 0.2 J.
    """
    orbit = lyapunov_orbit(system, "down-up", energy=SENSES_ENERGY)
    return find_connections(
        orbit,
        orbit,
        hits=(1, 2),
        section=system.named_sections["aligned"],
        settings=search_settings(longest=_RETURN_FLIGHT),
    )


def returning_page(gallery: Gallery) -> PaperFigure:
    """Draw homoclinics of Down-Up that cross θ₁ = θ₂ and return.

    They pass Up-Down's side.
    """
    search = returning_search(gallery.system("lab"))
    back = [c for c in search.connections if not any(c.winding)]
    page = Page("Homoclinic orbits of Down-Up that return through θ₁ = θ₂ the other way, at 0.2 J")
    flights = partial(_flights, search=search, connections=[c for c in back if c.sense > 0])
    page.row(flights, partial(single.search, found=search, shown=back), height=4.8)
    whole = "" if search.complete else "at least "
    return PaperFigure(
        page.figure(),
        f"Connections from the Lyapunov orbit about Down-Up at {SENSES_ENERGY:g} J to the same orbit without a turn "
        "of an arm. They pass θ₁ = θ₂ (dotted) towards Up-Down's side and return the other way. Left: flights "
        "of one sense. Right: the unstable tube (red) at its first crossing of θ₁ = θ₂ and the stable tube (green) at "
        f"the second before it arrives, with the connections. Found: {whole}{len(back)} of flights up to "
        f"{_RETURN_FLIGHT:g} periods.",
        "Tubes scatter before later crossings, so longer flights are not listed; `dpcontrol connect lab --section "
        f"aligned --hits 1,2 --longest 2` lists these. {IDENTIFIED}",
    )


def _flights(axes: Axes, search: ConnectionSearch, connections: Sequence[Connection]) -> None:
    for turn in (0, 1):
        axes.axline((0, 2 * np.pi * turn), slope=1, color=style.MARK, linestyle=style.DOTTED, linewidth=0.9, zorder=1)
    single.flights(axes, connections)
    quiet_plane(axes, search.source.system, title="Flights in the plane of the angles")
