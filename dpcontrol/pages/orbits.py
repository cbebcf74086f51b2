"""Orbits and their families: multipliers and periods against energy, and the orbits' shapes.

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

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.orbits.family import LyapunovFamily
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.orbits.rotating import RotatingFamilies, RotatingFamily, RotatingOrbit
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, Stack, key
from dpcontrol.pages.panels import name_point, quiet_plane

Orbit = LyapunovOrbit | RotatingOrbit
Family = LyapunovFamily | RotatingFamily
_SHAPES, _ROTATING_SHAPES = 12, 3
"""Numbers of drawn orbits of a family about a saddle, and of a family of rotating orbits."""
_SHADES = colormaps["viridis"]
_KINDS = {
    "elliptic": style.GOOD,
    "hyperbolic": style.LIMIT,
    "inverse hyperbolic": style.ARMS[1],
    "parabolic": style.CART,
}
"""Colours of rotating orbits by their stability."""


def draw_family(family: LyapunovFamily) -> Figure:
    """Return the page on a family of Lyapunov orbits: multipliers and periods against energy, and orbits in a plane."""
    page = Page(f"Lyapunov orbits about {family.saddle} of {family.system.name}")
    over = Stack([partial(_multipliers, family=family), partial(_periods, families=[family])])
    page.origin(None, *conditions(family.system, family.energies))
    return page.row(over, partial(_shapes, family=family), height=5.2).figure()


def draw_rotating_families(search: RotatingFamilies) -> Figure:
    """Return the page on families of periodic orbits that turn an arm over.

    It shows the traces of the section's map, which give the stability, and the periods against energy, and some orbits.
    """
    families = search.families
    system = families[0].members[0].system
    page = Page(f"Orbits of {system.name} that turn the {search.arm} arm over")
    over = Stack([partial(_traces, families=families), partial(_periods, families=families)])
    return (
        page.origin(None, *conditions(system, search.energies))
        .row(over, partial(_rotations, families=families), height=5.2)
        .figure()
    )


def conditions(system: System, energies: Sequence[float] | Array) -> tuple[str, str]:
    """Return the model and the energies of orbits, for the head of a page.

    Args:
        system: system of the orbits.
        energies: energies in the system's unit.
    """
    ends = " to ".join(f"{energy:g}" for energy in dict.fromkeys((min(energies), max(energies))))
    return f"model {system.name}", f"energy {ends}{system.unit('J')}"


def _against_energy(axes: Axes, families: Sequence[Family], value: Callable[..., float]) -> None:
    """Draw a value of the orbits of families against energy, with marks where a family branches, changes or folds.

    Rotating orbits are coloured by their stability.

    Args:
        axes: panel to draw on.
        families: families of one system.
        value: function from an orbit to the drawn value.
    """
    for family in families:
        values = np.array([value(member) for member in family.members])
        if isinstance(family, LyapunovFamily):
            axes.plot(family.energies, values, color=style.saddle_colour(family.saddle), linewidth=1.6)
            events = [(event.orbit, event.kind) for event in family.events]
        else:
            for kind, colour in _KINDS.items():
                of_kind = np.where([member.kind == kind for member in family.members], values, np.nan)
                axes.plot(family.energies, of_kind, color=colour, linewidth=1.6)
            events = [(orbit, "") for orbit in (*(change.orbit for change in family.changes), *family.folds)]
        for orbit, text in events:
            axes.plot(orbit.energy, value(orbit), "o", color=style.INK, markersize=4)
            name_point(axes, text, (orbit.energy, value(orbit)), style.INK, weight="normal")


def _periods(axes: Axes, families: Sequence[Family], title: str = "") -> None:
    """Draw the periods of families against energy."""
    unit = families[0].members[0].system.unit
    _against_energy(axes, families, attrgetter("period"))
    period = f"period{unit('s', ' ({})')}"
    axes.set(title=title or period.capitalize(), xlabel=f"energy{unit('J', ' ({})')}", ylabel=period if title else "")


def _multipliers(axes: Axes, family: LyapunovFamily) -> None:
    """Draw the size of the unstable Floquet multiplier of Lyapunov orbits against energy, on a logarithmic axis."""
    _against_energy(axes, [family], lambda orbit: abs(orbit.floquet_multipliers[0]))
    axes.set(title="Unstable Floquet multiplier", yscale="log")


def _traces(axes: Axes, families: Sequence[RotatingFamily]) -> None:
    """Draw the traces of the section maps of rotating orbits against energy.

    An orbit is stable between the dashed values -2 and 2. The axis is linear about zero and logarithmic beyond.
    """
    _against_energy(axes, families, attrgetter("trace"))
    axes.set_yscale("symlog", linthresh=4)
    axes.yaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=10))
    for critical in (2, -2):
        axes.axhline(critical, color=style.FAINT, linewidth=1.0, linestyle="--")
    axes.set(title="Trace of the section's map, ±2 dashed; at dots stability changes or the family folds")
    drawn_kinds = {member.kind for family in families for member in family.members}
    key(axes, [(kind, colour) for kind, colour in _KINDS.items() if kind in drawn_kinds])


def _shapes(axes: Axes, family: LyapunovFamily) -> None:
    """Draw about `_SHAPES` orbits of a family in the plane of the most active arm, coloured by energy.

    A cross marks the saddle. Its energy is that of the family's birth, near which amplitudes vanish.
    """
    system, members, scale = family.system, family.members, Normalize(*np.sort(family.energies)[[0, -1]])
    birth = float(system.numeric.hamiltonian(system.equilibrium(family.saddle)))
    # Evenly spaced in amplitude, which grows as the root of the energy above the saddle.
    amplitude = np.sqrt(np.abs(family.energies - birth))
    amplitudes = np.linspace(amplitude.min(), amplitude.max(), _SHAPES)
    orbits = [members[k] for k in dict.fromkeys(int(np.argmin(np.abs(amplitude - target))) for target in amplitudes)]
    columns = _active(orbits[-1])
    # Small orbits are drawn on top, because they lie within the large ones.
    for orbit in reversed(orbits):
        axes.plot(*orbit.sample(300)[:, columns].T, color=_SHADES(scale(orbit.energy)), linewidth=1.3)
    axes.plot(*system.equilibrium(family.saddle)[list(columns)], "+", color=style.LIMIT, markersize=9, zorder=5)
    quiet_plane(axes, system, columns, f"Orbits about {family.saddle}")
    bar = axes.figure.colorbar(ScalarMappable(scale, _SHADES), ax=axes, fraction=0.05, pad=0.03)
    bar.ax.set_title(system.unit("J", "{}") or "energy", fontsize=style.SMALL)


def _active(orbit: Orbit) -> tuple[int, int]:
    """Return the two columns of the states that show an orbit best in a plane.

    In a system with SI units, a pendulum, they are the angle that changes most and its rate. In a system without units,
    three bodies, they are both positions.
    """
    n = orbit.system.dimension // 2
    arm = int(np.argmax(np.ptp(orbit.sample(400)[:, :n], axis=0)))
    return (arm, n + arm) if orbit.system.si else (0, 1)


def _rotations(axes: Axes, families: Sequence[RotatingFamily]) -> None:
    """Draw a few rotating orbits of each family in the plane of the angles, coloured by stability."""
    for family in families:
        for k in np.unique(np.rint(np.linspace(0, len(family.members) - 1, _ROTATING_SHAPES)).astype(int)):
            orbit = family.members[k]
            axes.plot(*orbit.sample(300)[:, :2].T, color=_KINDS[orbit.kind], linewidth=1.0)
    quiet_plane(axes, families[0].members[0].system, title="Some of the orbits over one period")


def orbit(axes: Axes, shown: Orbit) -> None:
    """Draw an orbit in the phase plane of its most active arm, or without angles in the plane of positions.

    Args:
        axes: panel to draw on.
        shown: orbit to draw.
    """
    columns, unit = _active(shown), shown.system.unit
    axes.plot(*shown.sample(400)[:, list(columns)].T, color=style.saddle_colour(shown.name), linewidth=1.8)
    title = f"{shown.name} at {shown.energy:g}{unit('J')}, period {shown.period:.4g}{unit('s')}"
    quiet_plane(axes, shown.system, columns, title)


def family(axes: Axes, shown: Family) -> None:
    """Draw the periods of a family over the energy.

    Args:
        axes: panel to draw on.
        shown: family to draw.
    """
    _periods(axes, [shown], f"{len(shown.members)} orbits about {shown.members[0].name}")
