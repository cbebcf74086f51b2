"""Rates of passage through the necks against energy, beside passages counted in simulations."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.dynamics.system import System
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.pages import style
from dpcontrol.pages.figures import IDENTIFIED, Gallery, PaperFigure
from dpcontrol.pages.layout import Page, key
from dpcontrol.pages.panels import quiet
from dpcontrol.tubes.transport import transport

COUNTED = Path(__file__).with_suffix(".json")
"""Passages of the lab pendulum that `tests/independent_passages.py` counted, with its conditions."""
_SAMPLES = 24


def transport_page(gallery: Gallery) -> PaperFigure:
    """Draw the rates of both necks of the lab pendulum against energy."""
    system, counts = gallery.system("lab"), json.loads(COUNTED.read_text(encoding="utf-8"))
    page = Page("Passages of the necks of the lab pendulum, from volume and action alone")
    panels = (partial(_rates, system=system, saddle=saddle, counts=counts) for saddle in ("down-up", "up-down"))
    return PaperFigure(
        page.row(*panels, height=4.2).figure(),
        "Rate of passages in both directions through the necks of Down-Up and Up-Down. Curves: twice the action of the "
        "Lyapunov orbit over the volume of the energy surface, without simulation. Points: passages counted by a "
        f"separate program over the microcanonical ensemble, {counts[0]['motions']:,} motions of "
        f"{counts[0]['window']:g} s each without friction, from states drawn evenly from the energy surface; bars are "
        "two standard errors. Dashed: energy of the other saddle, above which its neck is open, too.",
        f"The paper gives no rates. {IDENTIFIED}",
    )


def _rates(axes: Axes, system: System, saddle: str, counts: list[dict[str, Any]]) -> None:
    """Draw the rate of a neck from just above its saddle to beyond the last counted energy."""
    rows = [row for row in counts if row["saddle"] == saddle]
    heights = {name: float(system.numeric.hamiltonian(system.equilibria[name])) for name in system.saddles}
    energies = np.linspace(heights[saddle] + 1e-3, rows[-1]["energy"] + 0.02, _SAMPLES)
    rates = [1 / transport(lyapunov_orbit(system, saddle, energy=energy)).mean_time for energy in energies]
    axes.plot(energies, rates, color=style.saddle_colour(saddle), linewidth=1.6)
    bars = [2 * row["error"] / row["mean_time"] ** 2 for row in rows]
    look = {"color": style.INK, "markersize": 4, "capsize": 3, "linewidth": 1.0}
    axes.errorbar([row["energy"] for row in rows], [1 / row["mean_time"] for row in rows], bars, fmt="o", **look)
    for other in (height for name, height in heights.items() if name != saddle and height > energies[0]):
        axes.axvline(other, color=style.MARK, linewidth=1.0, linestyle="--")
    quiet(axes, f"neck of {saddle}", x="energy (J)", y="passages per second")
    key(axes, [("2A/Ω", style.saddle_colour(saddle)), ("counted", {"color": style.INK, "marker": "o", "linestyle": ""})])
