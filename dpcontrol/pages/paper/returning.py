"""Homoclinic connections that return to their initial angles without a whole turn."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.orbits.cut import section_points
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.pages import style
from dpcontrol.pages.gallery import IDENTIFIED, Gallery, PaperFigure
from dpcontrol.pages.layout import Page, Panel, key
from dpcontrol.pages.panels import angle_axis, quiet, quiet_plane, quiet_space, wrapped_runs
from dpcontrol.pages.paper.tubes import SENSES_ENERGY
from dpcontrol.tubes.connections import ConnectionSearch, find_connections
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
    system = gallery.system("lab")
    search = returning_search(system)
    back = [c for c in search.connections if not any(c.winding)]
    shades, orbit = _by_flight(back), search.source.sample()
    curves = [(shades[c.name], c.sample(900)) for c in back if c.sense > 0]
    flights = partial(_flights, system=system, curves=curves, orbit=orbit)
    page = Page("Homoclinic orbits of Down-Up that return through θ₁ = θ₂ the other way, at 0.2 J").row(
        Panel(flights, 1.5, space=True),
        flights,
        partial(_cuts, search=search, back=back, shades=shades),
        height=4.8,
    )
    whole = "" if search.complete else "at least "
    return PaperFigure(
        page.figure(),
        f"Connections from the Lyapunov orbit about Down-Up at {SENSES_ENERGY:g} J to the same orbit without a turn "
        "of an arm. They pass θ₁ = θ₂ (dotted) towards Up-Down's side and return the other way. a and b: flights "
        "of one sense. c: the unstable tube at its first crossing of θ₁ = θ₂ and the stable tube at the second before "
        f"it arrives. Found: {whole}{len(back)} of flights up to {_RETURN_FLIGHT:g} periods; dots of one colour are "
        "one connection and its images.",
        "Tubes scatter before later crossings, so longer flights are not listed; `dpcontrol connect lab --section "
        f"aligned --hits 1,2 --longest 2` lists these. {IDENTIFIED}",
    )


Curves = list[tuple[str, Array]]
"""Colours and states of flights."""


def _flights(axes: Axes, system: System, curves: Curves, orbit: Array) -> None:
    """Draw flights and their orbit in space or in the plane of the angles, by the axes' kind."""
    space = axes.name == "3d"
    shown = slice(0, 3 if space else 2)
    for colour, states in curves:
        axes.plot(*states[:, shown].T, color=colour, linewidth=1.0)
    axes.plot(*orbit[:, shown].T, color=style.saddle_colour("down-up"), linewidth=2.8)
    if space:
        quiet_space(axes, system)
        axes.set_title("a  in (θ₁, θ₂, ω₁)", loc="left")
        return
    for turn in (0, 1):
        axes.axline((0, 2 * np.pi * turn), slope=1, color=style.MARK, linestyle=style.DOTTED, linewidth=0.9, zorder=1)
    quiet_plane(axes, system, title="b  in the plane of the angles", step=1.0)


def _cuts(axes: Axes, search: ConnectionSearch, back: Sequence, shades: dict[str, str]) -> None:
    quiet(axes, "c  cuts on θ₁ = θ₂ + 2πk", x="θ₁ on the section (rad)", y="p / p₀")
    for cut, colour, sign in ((search.cuts[0], style.UNSTABLE, 1), (search.cuts[1], style.STABLE, -1)):
        for piece in cut.pieces:
            # Time reversal keeps the angles and reverses momenta.
            for part in wrapped_runs(piece.points * np.array([1.0, sign]), (2 * np.pi, None)):
                axes.plot(*part.T, color=colour, linewidth=0.9)
    for c in back:
        q, p = section_points(search.source.system, c.section, c.state)
        axes.plot(q - 2 * np.pi * np.rint(q / (2 * np.pi)), p, "o", color=shades[c.name], markersize=6, mec="white")
    angle_axis(axes, "x")
    key(axes, [("tube out, 1st crossing", style.UNSTABLE), ("tube in, 2nd crossing", style.STABLE)])


def _by_flight(connections: Sequence) -> dict[str, str]:
    """Return a colour for each connection by name; symmetric images have equal durations and share one."""
    lengths = {c.name: round(c.time_in + c.time_out, 5) for c in connections}
    order = sorted(set(lengths.values()))
    return {name: style.CONNECTIONS[order.index(length) % len(style.CONNECTIONS)] for name, length in lengths.items()}
