"""Lyapunov orbits of different sizes, the arms along one of them, and the families against energy."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.orbits.lyapunov import LyapunovOrbit, lyapunov_orbit
from dpcontrol.pages import style
from dpcontrol.pages.gallery import IDENTIFIED, Gallery, PaperFigure
from dpcontrol.pages.layout import Page, Panel
from dpcontrol.pages.panels import bare, name_curves, quiet_plane
from dpcontrol.pages.planes import arm_points

_SIZES = (0.002, 0.02, 0.06, 0.12, 0.2)
"""Energies of the drawn Lyapunov orbits above the saddle, J."""
_POSES = 7
_HIGHEST = 0.45


def lyapunov_orbits_page(gallery: Gallery) -> PaperFigure:
    """Draw Lyapunov orbits about both saddles in both phase planes.

    The motion of one is also drawn.
    """
    system = gallery.system("lab")
    page = Page("Lyapunov orbits of the lab pendulum, in the phase plane of either arm")
    for saddle in ("down-up", "up-down"):
        birth = float(system.numeric.hamiltonian(system.equilibria[saddle]))
        orbits = [lyapunov_orbit(system, saddle, energy=birth + above) for above in _SIZES]
        planes = [partial(_orbits, orbits=orbits, arm=arm) for arm in (0, 1)]
        page.row(*planes, Panel(partial(_motion, orbit=orbits[2]), 0.8), height=3.4)
    return PaperFigure(
        page.figure(),
        f"Lyapunov orbits about Down-Up (above) and Up-Down (below), {', '.join(f'{a:g}' for a in _SIZES)} J above "
        "their saddle (cross): left the inner arm's angle and rate, middle the outer arm's. Right: half a period of "
        "the third orbit, from pale to dark; the dot is the pivot. The hanging arm swings widely while the upright "
        "one balances.",
        f"The paper gives no energies for its curves, so these are chosen. {IDENTIFIED}",
    )


def _orbits(axes: Axes, orbits: Sequence[LyapunovOrbit], arm: int) -> None:
    """Draw orbits in the phase plane of an arm, whose energies are named beside the inner arm's."""
    saddle, system = orbits[0].saddle, orbits[0].system
    for orbit, colour in zip(orbits, style.SERIES, strict=False):
        axes.plot(*orbit.sample(400)[:, [arm, 2 + arm]].T, color=colour, linewidth=1.4)
    axes.plot(system.equilibria[saddle][arm], 0, "+", color=style.LIMIT, markersize=9)
    quiet_plane(axes, system, (arm, 2 + arm), "" if arm else f"about {saddle}")
    if arm == 0:
        named = zip(orbits, style.SERIES, strict=False)
        name_curves(axes, [(orbit.energy, f"{orbit.energy:.3g} J", colour) for orbit, colour in named])


def _motion(axes: Axes, orbit: LyapunovOrbit) -> None:
    """Draw the arms to scale at some times of half a period, which leads from rest on one side to rest on the other."""
    lengths = orbit.system.model.arms.length if hasattr(orbit.system, "model") else (1.0, 1.0)  # type: ignore[attr-defined]
    states = orbit.states(orbit.period * np.linspace(0.25, 0.75, _POSES))
    for points, shade in zip(arm_points(states[:, :2], lengths), np.linspace(0.2, 1.0, _POSES), strict=True):
        for arm in (0, 1):
            look = {"color": style.arm_colour(arm), "linewidth": 3, "alpha": shade, "solid_capstyle": "round"}
            axes.plot(*points[arm : arm + 2].T, **look)
    axes.plot(0, 0, "o", color=style.INK, markersize=6)
    axes.set_aspect("equal")
    axes.margins(0.15)
    bare(axes, f"the motion at {orbit.energy:.3g} J")
