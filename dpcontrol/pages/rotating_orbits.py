"""Families of rotating orbits on one page.

It shows trace and period against energy, and the orbits.
"""

from collections.abc import Callable, Sequence
from functools import partial
from operator import attrgetter

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import SymmetricalLogLocator

from dpcontrol.orbits.rotating import RotatingFamilies, RotatingFamily, RotatingOrbit
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, Stack, key
from dpcontrol.pages.panels import quiet, quiet_plane

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


def _against_energy(axes: Axes, families: Sequence[RotatingFamily], value: Callable[[RotatingOrbit], float]) -> None:
    """Draw a value of the orbits against energy, coloured by stability."""
    for family in families:
        for kind, colour in KINDS.items():
            values = [value(member) if member.kind == kind else np.nan for member in family.members]
            axes.plot([member.energy for member in family.members], values, color=colour, linewidth=1.6)
        for orbit in (*(change.orbit for change in family.changes), *family.folds):
            axes.plot(orbit.energy, value(orbit), "o", color=style.INK, markersize=4)


def _traces(axes: Axes, families: Sequence[RotatingFamily]) -> None:
    _against_energy(axes, families, attrgetter("trace"))
    axes.set_yscale("symlog", linthresh=4)
    axes.yaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=10))
    for critical in (2, -2):
        axes.axhline(critical, color=style.FAINT, linewidth=1.0, linestyle="--")
    quiet(axes, "Trace of the section's map, ±2 dashed; at dots stability changes or the family folds")
    seen = {member.kind for family in families for member in family.members}
    key(axes, [(kind, colour) for kind, colour in KINDS.items() if kind in seen])


def _periods(axes: Axes, families: Sequence[RotatingFamily]) -> None:
    _against_energy(axes, families, attrgetter("period"))
    quiet(axes, "Period (s)", x="energy (J)")


def _rotations(axes: Axes, families: Sequence[RotatingFamily]) -> None:
    for family in families:
        for k in np.unique(np.rint(np.linspace(0, len(family.members) - 1, _ROTATING_SHAPES)).astype(int)):
            orbit = family.members[k]
            axes.plot(*orbit.sample(300)[:, :2].T, color=KINDS[orbit.kind], linewidth=1.0)
    quiet_plane(axes, families[0].members[0].system, title="Some of the orbits over one period")
