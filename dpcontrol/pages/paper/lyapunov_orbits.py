"""Lyapunov orbits of different sizes."""

from collections.abc import Sequence
from functools import partial

from matplotlib.axes import Axes

from dpcontrol.orbits.lyapunov import LyapunovOrbit, lyapunov_orbit
from dpcontrol.pages import style
from dpcontrol.pages.gallery import IDENTIFIED, Gallery, PaperFigure
from dpcontrol.pages.layout import Page
from dpcontrol.pages.panels import name_curves, quiet_plane

_SIZES = (0.002, 0.02, 0.06, 0.12, 0.2)
"""Energies of the drawn Lyapunov orbits above the saddle, J."""


def lyapunov_orbits_page(gallery: Gallery) -> PaperFigure:
    """Draw Lyapunov orbits about both saddles in both phase planes."""
    system = gallery.system("lab")
    page = Page("Lyapunov orbits of the lab pendulum, in the phase plane of either arm")
    for saddle in ("down-up", "up-down"):
        birth = float(system.numeric.hamiltonian(system.equilibria[saddle]))
        orbits = [lyapunov_orbit(system, saddle, energy=birth + above) for above in _SIZES]
        planes = [partial(_orbits, orbits=orbits, arm=arm) for arm in (0, 1)]
        page.row(*planes, height=3.4)
    return PaperFigure(
        page.figure(),
        f"Lyapunov orbits about Down-Up (above) and Up-Down (below), {', '.join(f'{a:g}' for a in _SIZES)} J above "
        "their saddle (cross): left the inner arm's angle and rate, right the outer arm's. The hanging arm swings "
        "widely while the upright one balances.",
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
