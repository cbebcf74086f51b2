"""Families of Lyapunov and rotating orbits, each on one page: shapes, periods and stability against energy."""

from collections.abc import Sequence
from functools import partial
from itertools import groupby, pairwise

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import SymmetricalLogLocator

from dpcontrol.orbits.family import LyapunovFamily
from dpcontrol.orbits.rotating import RotatingFamily, RotatingOrbit
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, Stack, key
from dpcontrol.pages.panels import angle_axis, name_curves, quiet

_SHAPES = 12
_SAMPLES = 300
_SHADES = colormaps["viridis"]


def draw_families(families: Sequence[LyapunovFamily], title: str) -> Figure:
    """Return a page on the families of one system.

    There must be at least one family.
    """
    energies = np.concatenate([family.energies for family in families])
    scale = Normalize(float(energies.min()), float(energies.max()))
    page = Page(title)
    shapes = [partial(_shapes, family=family, scale=scale) for family in families]
    for first in range(0, len(shapes), 3):
        page.row(*shapes[first : first + 3], height=3.3)
    curves = [partial(_against_energy, families=families, multipliers=some) for some in (False, True)]
    page.row(*curves, height=2.9)
    for family in families:
        first, last = family.ends
        text = f"{family.saddle} from {first.energy:.6g}: {first.reason}; to {last.energy:.6g}: {last.reason}"
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
    curves = [system.propagator.sample(o.state, np.linspace(0.0, o.period, _SAMPLES)) for o in chosen]
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


KINDS = {
    "elliptic": style.GOOD,
    "hyperbolic": style.LIMIT,
    "inverse hyperbolic": style.ARMS[1],
    "parabolic": style.CART,
}
_ROTATING_SHAPES = 3


def draw_rotating_families(families: Sequence[RotatingFamily]) -> Figure:
    """Return the page on rotating orbits as a figure."""
    first = families[0].members[0]
    arm = ("inner", "outer")[first.arm - 1]
    page = Page(f"Orbits of {first.system.name} that turn the {arm} arm over")
    over = Stack([partial(_traces, families=families), partial(_periods, families=families)])
    return page.row(over, partial(_rotations, families=families), height=5.2).figure()


def _points(family: RotatingFamily) -> Sequence[RotatingOrbit]:
    """Return the orbits at which stability changes or the family folds."""
    return (*(c.orbit for c in family.changes), *family.folds)


def _traces(axes: Axes, families: Sequence[RotatingFamily]) -> None:
    for family in families:
        # Adjacent runs share a member to join lines of two kinds.
        for kind, members in _runs(family.members):
            axes.plot([m.energy for m in members], [m.trace for m in members], color=KINDS[kind], linewidth=1.6)
        for orbit in _points(family):
            axes.plot(orbit.energy, orbit.trace, "o", color=style.INK, markersize=4)
    axes.set_yscale("symlog", linthresh=4)
    axes.yaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=10))
    for critical in (2, -2):
        axes.axhline(critical, color=style.FAINT, linewidth=1.0, linestyle="--")
    quiet(axes, "Trace of the section's map, ±2 dashed; at dots stability changes or the family folds")
    seen = {member.kind for family in families for member in family.members}
    key(axes, [(kind, colour) for kind, colour in KINDS.items() if kind in seen])


def _periods(axes: Axes, families: Sequence[RotatingFamily]) -> None:
    for family in families:
        for kind, members in _runs(family.members):
            axes.plot([m.energy for m in members], [m.period for m in members], color=KINDS[kind], linewidth=1.6)
        for orbit in _points(family):
            axes.plot(orbit.energy, orbit.period, "o", color=style.INK, markersize=4)
    quiet(axes, "Period (s)", x="energy (J)")


def _rotations(axes: Axes, families: Sequence[RotatingFamily]) -> None:
    for family in families:
        for k in np.unique(np.rint(np.linspace(0, len(family.members) - 1, _ROTATING_SHAPES)).astype(int)):
            orbit = family.members[k]
            states = orbit.system.propagator.sample(orbit.state, np.linspace(0.0, orbit.period, _SAMPLES))
            axes.plot(states[:, 0], states[:, 1], color=KINDS[orbit.kind], linewidth=1.0)
    quiet(axes, "Some of the orbits over one period", x="θ₁ (rad)", y="θ₂ (rad)")
    angle_axis(axes, "x")
    angle_axis(axes, "y")


def _runs(members: Sequence[RotatingOrbit]) -> list[tuple[str, list[RotatingOrbit]]]:
    runs = [(kind, list(group)) for kind, group in groupby(members, key=lambda m: m.kind)]
    for (_, before), (_, after) in pairwise(runs):
        before.append(after[0])
    return runs
