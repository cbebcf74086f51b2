"""Families of Lyapunov orbits on one page.

It shows period and multipliers against energy, and the orbits' shapes.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from dpcontrol.orbits.family import LyapunovFamily
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page
from dpcontrol.pages.panels import angle_axis, name_curves, quiet

_SHAPES = 12
SAMPLES = 300
_SHADES = colormaps["viridis"]


def draw_families(families: Sequence[LyapunovFamily], title: str) -> Figure:
    """Return a page on the families of one system.

    Args:
        families: families to draw, at least one.
        title: title of the page.
    """
    energies = np.concatenate([family.energies for family in families])
    scale = Normalize(float(energies.min()), float(energies.max()))
    page = Page(title)
    shapes = [partial(_shapes, family=family, scale=scale) for family in families]
    page.grid(shapes, across=min(len(shapes), 3), height=3.3)
    curves = [partial(_against_energy, families=families, multipliers=some) for some in (False, True)]
    page.row(*curves, height=2.9)
    for family in families:
        first, last = family.ends
        text = f"{family.saddle} from {first.energy:.6g}: {first.status}; to {last.energy:.6g}: {last.status}"
        page.text(text)
    return page.figure()


def _against_energy(axes: Axes, families: Sequence[LyapunovFamily], *, multipliers: bool) -> None:
    """Draw the periods or the unstable multipliers of families against energy."""
    unit = families[0].system.unit
    name = "Unstable Floquet multiplier" if multipliers else f"Period{unit('s', ' ({})')}"
    quiet(axes, name, x=f"energy{unit('J', ' ({})')}")
    ends = []
    for family in families:
        colour = style.saddle_colour(family.saddle)
        values = np.abs(family.floquet_multipliers[:, 0]) if multipliers else family.periods
        axes.plot(family.energies, values, color=colour, linewidth=1.6)
        ends.append((float(values[-1]), family.saddle, colour))
        for event in family.events:
            orbit = event.orbit
            value = float(np.abs(orbit.floquet_multipliers[0])) if multipliers else orbit.period
            axes.plot(orbit.energy, value, "x", color=style.LIMIT, ms=7)
            axes.annotate(
                event.kind, (orbit.energy, value), xytext=(4, 4), textcoords="offset points", fontsize=style.SMALL,
                color=style.LIMIT,
            )  # fmt: skip
    if multipliers:
        axes.set_yscale("log")
    name_curves(axes, ends)


def _shapes(axes: Axes, family: LyapunovFamily, scale: Normalize) -> None:
    """Draw orbits in the phase plane of the most active arm.

    Without angles they are drawn in the plane of positions.
    """
    system, n = family.system, family.system.dimension // 2
    birth = float(system.numeric.hamiltonian(system.equilibrium(family.saddle)))
    # Evenly spaced in amplitude, which grows as the root of the energy above the saddle.
    amplitude = np.sqrt(np.abs(family.energies - birth))
    wanted = np.linspace(amplitude.min(), amplitude.max(), _SHAPES)
    chosen = [family.members[k] for k in dict.fromkeys(int(np.argmin(np.abs(amplitude - a))) for a in wanted)]
    curves = [system.propagator.sample(o.state, np.linspace(0.0, o.period, SAMPLES)) for o in chosen]
    arm = int(np.argmax(np.ptp(curves[-1][:, :n], axis=0)))
    columns = [arm, n + arm] if system.si else [0, 1]
    # Small orbits are drawn on top, because they lie within the large ones.
    for orbit, curve in zip(chosen[::-1], curves[::-1], strict=True):
        axes.plot(*curve[:, columns].T, color=_SHADES(scale(orbit.energy)), linewidth=1.3)
    axes.plot(*system.equilibrium(family.saddle)[columns], "+", color=style.LIMIT, markersize=9, zorder=5)
    quiet(axes, f"Orbits about {family.saddle}", x=system.labels[columns[0]], y=system.labels[columns[1]])
    if np.isfinite(system.periods[columns[0]]):
        angle_axis(axes, "x")
    bar = axes.figure.colorbar(ScalarMappable(scale, _SHADES), ax=axes, fraction=0.05, pad=0.03)
    bar.ax.tick_params(labelsize=style.SMALL)
    bar.ax.set_title(system.unit("J", "{}") or "energy", fontsize=style.SMALL)
