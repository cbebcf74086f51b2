"""Families of Lyapunov and rotating orbits, each on one page: shapes, periods and stability against energy."""

from collections.abc import Sequence
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
from dpcontrol.pages.page import angle_axis, key, new_figure, quiet

_SHAPES = 12
_SAMPLES = 300
_SHADES = colormaps["viridis"]


def draw_families(families: Sequence[LyapunovFamily], title: str) -> Figure:
    """Return a page on the families of one system.

    There must be at least one family.
    """
    count = len(families)
    figure = new_figure(5.6 + 3.9 * count, 5.0, title)
    grid = figure.add_gridspec(
        1, count + 2, left=0.06, right=0.985, top=0.84, bottom=0.2, wspace=0.42, width_ratios=[1.15] * count + [1, 1]
    )
    energies = np.concatenate([family.energies for family in families])
    scale = Normalize(float(energies.min()), float(energies.max()))
    angular = bool(np.isfinite(families[0].system.periods).any())
    for k, family in enumerate(families):
        _shapes(figure.add_subplot(grid[0, k]), family, scale, angular=angular)
    periods, multipliers = figure.add_subplot(grid[0, count]), figure.add_subplot(grid[0, count + 1])
    panels = ((periods, "period (s)" if angular else "period"), (multipliers, "unstable Floquet multiplier"))
    for axes, name in panels:
        quiet(axes, name, x="energy (J)" if angular else "energy")
    for family in families:
        colour, sizes = style.saddle_colour(family.saddle), np.abs(family.floquet_multipliers[:, 0])
        for axes, values in ((periods, family.periods), (multipliers, sizes)):
            axes.plot(family.energies, values, color=colour, label=family.saddle, linewidth=1.6)
        for event in family.events:
            orbit = event.orbit
            for axes, value in ((periods, orbit.period), (multipliers, np.abs(orbit.floquet_multipliers[0]))):
                axes.plot(orbit.energy, value, "x", color=style.LIMIT, ms=7)
                axes.annotate(event.kind, (orbit.energy, float(value)), fontsize=8, color=style.LIMIT)
    multipliers.set_yscale("log")
    multipliers.tick_params(axis="y", which="minor", labelsize=7)
    for axes, _ in panels:
        axes.legend(fontsize=8.5, frameon=False)
    ends = [
        f"{family.saddle} from {first.energy:.6g}: {first.reason}; to {last.energy:.6g}: {last.reason}"
        for family in families
        for first, last in (family.ends,)
    ]
    figure.text(0.015, 0.02, "\n".join(ends), fontsize=8, color=style.NOTE, va="bottom")
    return figure


def _shapes(axes: Axes, family: LyapunovFamily, scale: Normalize, *, angular: bool) -> None:
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
    arm = int(np.argmax(np.ptp(curves[-1][:, :n], axis=0))) if angular else 0
    columns = [arm, n + arm] if angular else [0, 1]
    # Small orbits are drawn on top, because they lie within the large ones.
    for orbit, curve in zip(chosen[::-1], curves[::-1], strict=True):
        axes.plot(*curve[:, columns].T, color=_SHADES(scale(orbit.energy)), linewidth=1.3)
    axes.plot(*system.equilibrium(family.saddle)[columns], "+", color=style.LIMIT, markersize=9, zorder=5)
    x, y = (f"θ{style.number(arm)} (rad)", f"ω{style.number(arm)} (rad/s)") if angular else ("x", "y")
    quiet(axes, f"about {family.saddle}", x=x, y=y)
    if angular:
        angle_axis(axes, "x")
    assert axes.figure is not None
    bar = axes.figure.colorbar(ScalarMappable(scale, _SHADES), ax=axes, fraction=0.05, pad=0.03)
    bar.ax.tick_params(labelsize=7.5)
    bar.ax.set_title("J" if angular else "energy", fontsize=8)


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
    figure = new_figure(14.0, 6.0, f"Orbits of {first.system.name} that turn the {arm} arm over")
    grid = figure.add_gridspec(2, 2, left=0.06, right=0.985, top=0.86, bottom=0.1, hspace=0.28, wspace=0.16)
    traces, periods = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, 0])
    shapes = figure.add_subplot(grid[:, 1])
    for family in families:
        # Adjacent runs share a member to join lines of two kinds.
        for kind, members in _runs(family.members):
            energies = [m.energy for m in members]
            traces.plot(energies, [m.trace for m in members], color=KINDS[kind], linewidth=1.6)
            periods.plot(energies, [m.period for m in members], color=KINDS[kind], linewidth=1.6)
        for orbit in (*(c.orbit for c in family.changes), *family.folds):
            traces.plot(orbit.energy, orbit.trace, "o", color=style.INK, markersize=4)
            periods.plot(orbit.energy, orbit.period, "o", color=style.INK, markersize=4)
        for k in np.unique(np.rint(np.linspace(0, len(family.members) - 1, _ROTATING_SHAPES)).astype(int)):
            orbit = family.members[k]
            states = orbit.system.propagator.sample(orbit.state, np.linspace(0.0, orbit.period, _SAMPLES))
            shapes.plot(states[:, 0], states[:, 1], color=KINDS[orbit.kind], linewidth=1.0)
    traces.set_yscale("symlog", linthresh=4)
    traces.yaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=10))
    for critical in (2, -2):
        traces.axhline(critical, color=style.FAINT, linewidth=1.0, linestyle="--")
    quiet(traces, "trace of the section's map, ±2 dashed (dots: stability changes or the family folds)")
    quiet(periods, "period (s)", x="energy (J)")
    quiet(shapes, "some of the orbits over one period", x="θ₁ (rad)", y="θ₂ (rad)")
    angle_axis(shapes, "x")
    angle_axis(shapes, "y")
    seen = {member.kind for family in families for member in family.members}
    looks = [(kind, colour) for kind, colour in KINDS.items() if kind in seen]
    key(figure, looks, loc="upper right", ncols=len(looks), fontsize=9)
    return figure


def _runs(members: Sequence[RotatingOrbit]) -> list[tuple[str, list[RotatingOrbit]]]:
    runs = [(kind, list(group)) for kind, group in groupby(members, key=lambda m: m.kind)]
    for (_, before), (_, after) in pairwise(runs):
        before.append(after[0])
    return runs
