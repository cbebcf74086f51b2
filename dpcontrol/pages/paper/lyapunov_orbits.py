"""Lyapunov orbits of different sizes, and the arms along one of them."""

from functools import partial

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.pages import style
from dpcontrol.pages.gallery import IDENTIFIED, Gallery, PaperFigure
from dpcontrol.pages.layout import Page, Panel
from dpcontrol.pages.panels import angle_axis, quiet

_SIZES = (0.002, 0.02, 0.06, 0.12, 0.2)
"""Energies of the drawn Lyapunov orbits above the saddle, J."""
_POSES = 7


def lyapunov_orbits_page(gallery: Gallery) -> PaperFigure:
    """Draw Lyapunov orbits about both saddles in both phase planes.

    The motion of one is also drawn.
    """
    system = gallery.system("lab")
    page = Page("Lyapunov orbits of the lab pendulum, in the phase plane of either arm")
    for saddle in ("down-up", "up-down"):
        birth = float(system.numeric.hamiltonian(system.equilibria[saddle]))
        curves: list[tuple[float, Array]] = []
        for above in _SIZES:
            orbit = lyapunov_orbit(system, saddle, energy=birth + above)
            curves.append((birth + above, system.propagator.sample(orbit.state, np.linspace(0.0, orbit.period, 400))))
        planes = [partial(_orbits, curves=curves, saddle=saddle, system=system, arm=arm) for arm in (0, 1)]
        page.row(*planes, Panel(partial(_motion, system=system, energy=curves[2][0], states=curves[2][1]), 0.8),
                 height=3.4)  # fmt: skip
    return PaperFigure(
        page.figure(),
        f"Lyapunov orbits about Down-Up (above) and Up-Down (below), {', '.join(f'{a:g}' for a in _SIZES)} J above "
        "their saddle (cross): left the inner arm's angle and rate, middle the outer arm's. Right: half a period of "
        "the third orbit, from pale to dark; the dot is the pivot. The hanging arm swings widely while the upright "
        "one balances.",
        f"The paper gives no energies for its curves, so these are chosen. {IDENTIFIED}",
    )


def _orbits(axes: Axes, curves: list[tuple[float, Array]], saddle: str, system: System, arm: int) -> None:
    """Draw orbits in the phase plane of an arm.

    The inner arm's panel has labels with their energies, from the top.
    """
    number = style.number(arm)
    for k, (energy, states) in enumerate(curves):
        colour = style.SERIES[k]
        axes.plot(states[:, arm], states[:, 2 + arm], color=colour, linewidth=1.4)
        if arm == 0:
            key_text = f"{energy:.3g} J"
            axes.annotate(
                key_text, (1.0, 1.0 - 0.09 * k), xycoords="axes fraction", xytext=(4, 0), textcoords="offset points",
                va="top", fontsize=style.SMALL, color=colour, annotation_clip=False,
            )  # fmt: skip
    axes.plot(system.equilibria[saddle][arm], 0, "+", color=style.LIMIT, markersize=9)
    quiet(axes, "" if arm else f"about {saddle}", x=f"θ{number} (rad)", y=f"ω{number} (rad/s)")
    angle_axis(axes, "x")


def _motion(axes: Axes, system: System, energy: float, states: Array) -> None:
    """Draw the arms to scale at some times of half a period."""
    arms = system.model.arms.length if hasattr(system, "model") else (1.0, 1.0)  # type: ignore[attr-defined]
    for share in np.linspace(0, 0.5, _POSES):
        # Half a period leads from rest on one side to rest on the other.
        first, second = states[round((share + 0.25) * (len(states) - 1)), :2]
        joint = arms[0] * np.array([np.sin(first), -np.cos(first)])
        tip = joint + arms[1] * np.array([np.sin(second), -np.cos(second)])
        for begin, end, arm in ((np.zeros(2), joint, 0), (joint, tip, 1)):
            axes.plot(*np.column_stack([begin, end]), color=style.arm_colour(arm), linewidth=3,
                      alpha=0.2 + 1.6 * share, solid_capstyle="round")  # fmt: skip
    axes.plot(0, 0, "o", color=style.INK, markersize=6)
    axes.set_aspect("equal")
    axes.margins(0.15)
    axes.axis("off")
    axes.set_title(f"the motion at {energy:.3g} J", loc="left")
