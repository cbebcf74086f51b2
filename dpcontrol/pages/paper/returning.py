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
from dpcontrol.pages.panels import angle_axis, quiet, quiet_space, wrapped_runs
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
        orbit, orbit, hits=(1, 2), section=system.named_sections["aligned"],
        settings=search_settings(longest=_RETURN_FLIGHT),
    )  # fmt: skip


def returning_page(gallery: Gallery) -> PaperFigure:
    """Draw homoclinics of Down-Up that cross θ₁ = θ₂ and return.

    They pass Up-Down's side.
    """
    system = gallery.system("lab")
    search = returning_search(system)
    back = [c for c in search.connections if not any(c.winding)]
    orbit = search.source
    page = Page("Homoclinic orbits of Down-Up that return through θ₁ = θ₂ the other way, at 0.2 J")
    shades = _by_flight(back)
    closed = system.propagator.sample(orbit.state, np.linspace(0, orbit.period, 200))
    curves = []
    for c in (c for c in back if c.sense > 0):
        times = np.linspace(float(c.orbit.times[0]), float(c.orbit.times[-1]), 900)
        curves.append((shades[c.name], c.orbit.sample(times)))
    page.row(
        Panel(partial(_returning_space, system=system, curves=curves, closed=closed), 1.5, space=True),
        partial(_returning_plane, curves=curves, closed=closed),
        partial(_returning_cuts, search=search, back=back, shades=shades),
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


def _returning_space(axes: Axes, system: System, curves: Curves, closed: Array) -> None:
    for colour, states in curves:
        axes.plot(*states[:, :3].T, color=colour, linewidth=1.0)
    axes.plot(*closed[:, :3].T, color=style.saddle_colour("down-up"), linewidth=2.6, zorder=10)
    quiet_space(axes, system)
    axes.set_title("a  in (θ₁, θ₂, ω₁)", loc="left")


def _returning_plane(axes: Axes, curves: Curves, closed: Array) -> None:
    for colour, states in curves:
        axes.plot(states[:, 0], states[:, 1], color=colour, linewidth=1.1)
    axes.plot(closed[:, 0], closed[:, 1], color=style.saddle_colour("down-up"), linewidth=3)
    reach = np.array(axes.get_xlim())
    for turn in (0, 1):
        axes.plot(reach, reach + 2 * np.pi * turn, color=style.MARK, linestyle=style.DOTTED, linewidth=0.9, zorder=1)
    axes.set_xlim(*reach)
    quiet(axes, "b  in the plane of the angles", x="θ₁", y="θ₂")
    for which in "xy":
        angle_axis(axes, which, step=1.0)


def _returning_cuts(axes: Axes, search: ConnectionSearch, back: Sequence, shades: dict[str, str]) -> None:
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
    """Return a colour for each connection by name.

    Symmetric images have equal durations and share one.
    """
    lengths: list[float] = []
    for c in sorted(connections, key=lambda c: c.time_in + c.time_out):
        if not lengths or c.time_in + c.time_out - lengths[-1] > 1e-6:
            lengths.append(c.time_in + c.time_out)
    shades = style.CONNECTIONS
    return {c.name: shades[int(np.argmin(np.abs(np.array(lengths) - c.time_in - c.time_out))) % len(shades)]
            for c in connections}  # fmt: skip
