"""Families of orbits on one page: period and multipliers against energy, and the orbits' shapes.

Lyapunov orbits are drawn in the phase plane of their most active arm, rotating orbits in the plane of the angles.
"""

from collections.abc import Callable, Sequence
from functools import partial
from operator import attrgetter

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import SymmetricalLogLocator

from dpcontrol.orbits.family import LyapunovFamily
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.orbits.rotating import RotatingFamilies, RotatingFamily, RotatingOrbit
from dpcontrol.pages import orbits, style
from dpcontrol.pages.layout import Page, Stack, key
from dpcontrol.pages.panels import name_curves, name_point, quiet, quiet_plane

_SHAPES = 12
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
            name_point(axes, event.kind, (orbit.energy, value), style.LIMIT, weight="normal")
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
    arm = int(np.argmax(np.ptp(chosen[-1].sample()[:, :n], axis=0)))
    columns = (arm, n + arm) if system.si else (0, 1)
    # Small orbits are drawn on top, because they lie within the large ones.
    for orbit in reversed(chosen):
        axes.plot(*orbit.sample(300)[:, columns].T, color=_SHADES(scale(orbit.energy)), linewidth=1.3)
    axes.plot(*system.equilibrium(family.saddle)[list(columns)], "+", color=style.LIMIT, markersize=9, zorder=5)
    quiet_plane(axes, system, columns, f"Orbits about {family.saddle}")
    bar = axes.figure.colorbar(ScalarMappable(scale, _SHADES), ax=axes, fraction=0.05, pad=0.03)
    bar.ax.set_title(system.unit("J", "{}") or "energy", fontsize=style.SMALL)


KINDS = {
    "elliptic": style.GOOD,
    "hyperbolic": style.LIMIT,
    "inverse hyperbolic": style.ARMS[1],
    "parabolic": style.CART,
}
_ROTATING_SHAPES = 3


def draw_rotating_families(found: RotatingFamilies) -> Figure:
    """Return the page on rotating orbits as a figure."""
    families = found.families
    page = Page(f"Orbits of {families[0].members[0].system.name} that turn the {found.arm} arm over")
    over = Stack([partial(_traces, families=families), partial(_periods, families=families)])
    return page.row(over, partial(_rotations, families=families), height=5.2).figure()


def _by_stability(axes: Axes, families: Sequence[RotatingFamily], value: Callable[[RotatingOrbit], float]) -> None:
    """Draw a value of the orbits against energy, coloured by stability."""
    for family in families:
        for kind, colour in KINDS.items():
            values = [value(member) if member.kind == kind else np.nan for member in family.members]
            axes.plot([member.energy for member in family.members], values, color=colour, linewidth=1.6)
        for orbit in (*(change.orbit for change in family.changes), *family.folds):
            axes.plot(orbit.energy, value(orbit), "o", color=style.INK, markersize=4)


def _traces(axes: Axes, families: Sequence[RotatingFamily]) -> None:
    _by_stability(axes, families, attrgetter("trace"))
    axes.set_yscale("symlog", linthresh=4)
    axes.yaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=10))
    for critical in (2, -2):
        axes.axhline(critical, color=style.FAINT, linewidth=1.0, linestyle="--")
    quiet(axes, "Trace of the section's map, ±2 dashed; at dots stability changes or the family folds")
    seen = {member.kind for family in families for member in family.members}
    key(axes, [(kind, colour) for kind, colour in KINDS.items() if kind in seen])


def _periods(axes: Axes, families: Sequence[RotatingFamily]) -> None:
    _by_stability(axes, families, attrgetter("period"))
    quiet(axes, "Period (s)", x="energy (J)")


def _rotations(axes: Axes, families: Sequence[RotatingFamily]) -> None:
    for family in families:
        for k in np.unique(np.rint(np.linspace(0, len(family.members) - 1, _ROTATING_SHAPES)).astype(int)):
            orbit = family.members[k]
            axes.plot(*orbit.sample(300)[:, :2].T, color=KINDS[orbit.kind], linewidth=1.0)
    quiet_plane(axes, families[0].members[0].system, title="Some of the orbits over one period")


def orbit(axes: Axes, found: LyapunovOrbit | RotatingOrbit) -> None:
    """Draw an orbit in the phase plane of its most active arm.

    Without angles it is drawn in the plane of positions.

    Args:
        axes: panel to draw on.
        found: orbit to draw.
    """
    states, n = found.sample(400), found.system.dimension // 2
    arm = int(np.argmax(np.ptp(states[:, :n], axis=0)))
    columns = (arm, n + arm) if found.system.si else (0, 1)
    axes.plot(*states[:, list(columns)].T, color=style.saddle_colour(found.name), linewidth=1.8)
    energy = f"{found.energy:g}{found.system.unit('J')}"
    title = f"{found.name} at {energy}, period {found.period:.4g}{found.system.unit('s')}"
    quiet_plane(axes, found.system, columns, title)


def family(axes: Axes, found: LyapunovFamily | RotatingFamily) -> None:
    """Draw the periods of a family over the energy.

    Args:
        axes: panel to draw on.
        found: family to draw.
    """
    system = found.members[0].system
    axes.plot(found.energies, found.periods, color=style.INK, linewidth=1.6)
    energy, period = (f"{name}{system.unit(unit, ' ({})')}" for name, unit in (("energy", "J"), ("period", "s")))
    quiet(axes, f"{len(found.members)} orbits about {found.members[0].name}", x=energy, y=period)


def family_page(found: LyapunovFamily) -> Figure:
    """Return the page on one family."""
    return orbits.draw_families([found], f"Lyapunov orbits about {found.saddle} of {found.system.name}")
