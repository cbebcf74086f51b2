"""Families of Lyapunov orbits on one page: their shapes, and periods and multipliers against energy."""

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from dpcontrol.orbits.family import LyapunovFamily
from dpcontrol.review import style
from dpcontrol.review.panel_frame import angle_axis, new_figure, quiet

_SHAPES = 12
_SAMPLES = 300
_SHADES = colormaps["viridis"]


def draw_families(families: Sequence[LyapunovFamily], title: str) -> Figure:
    """Return the page of one system's families, at least one, as a figure."""
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
    for family in families:
        look = {"color": style.saddle_colour(family.saddle), "label": family.saddle, "linewidth": 1.6}
        sizes = np.abs(family.floquet_multipliers[:, 0])
        periods.plot(family.energies, family.periods, **look)
        multipliers.semilogy(family.energies, sizes, **look)
        for event in family.events:
            for axes, value in (
                (periods, event.orbit.period),
                (multipliers, np.abs(event.orbit.floquet_multipliers[0])),
            ):
                axes.plot(event.orbit.energy, value, "x", color=style.LIMIT, ms=7)
                axes.annotate(event.kind, (event.orbit.energy, float(value)), fontsize=8, color=style.LIMIT)
    for axes, name in ((periods, "period (s)" if angular else "period"), (multipliers, "unstable Floquet multiplier")):
        quiet(axes, name)
        axes.tick_params(axis="y", which="minor", labelsize=7)
        axes.set_xlabel("energy (J)" if angular else "energy", fontsize=9)
        axes.legend(fontsize=8.5, frameon=False)
    ends = [
        f"{family.saddle} {'; '.join(f'{way} {end.energy:.6g}: {end.reason}' for way, end in ways)}"
        for family in families
        for ways in (list(zip(("from", "to"), family.ends, strict=True)),)
    ]
    figure.text(0.015, 0.02, "\n".join(ends), fontsize=8, color=style.NOTE, va="bottom")
    return figure


def _shapes(axes: Axes, family: LyapunovFamily, scale: Normalize, *, angular: bool) -> None:
    """Draw orbits in the phase plane of the arm that swings most; without angles, in the plane of positions."""
    system, n = family.system, family.system.dimension // 2
    birth = float(system.numeric.hamiltonian(system.equilibrium(family.saddle)))
    # Evenly spread in amplitude, which grows as the root of the energy above the saddle.
    amplitude = np.sqrt(np.abs(family.energies - birth))
    wanted = np.linspace(amplitude.min(), amplitude.max(), _SHAPES)
    chosen = [family.members[k] for k in dict.fromkeys(int(np.argmin(np.abs(amplitude - a))) for a in wanted)]
    curves = [system.propagator.sample(o.state, np.linspace(0.0, o.period, _SAMPLES)) for o in chosen]
    arm = int(np.argmax(np.ptp(curves[-1][:, :n], axis=0))) if angular else 0
    columns = [arm, n + arm] if angular else [0, 1]
    # Small orbits on top: they lie within the large ones.
    for orbit, curve in zip(chosen[::-1], curves[::-1], strict=True):
        axes.plot(*curve[:, columns].T, color=_SHADES(scale(orbit.energy)), linewidth=1.3)
    axes.plot(*system.equilibrium(family.saddle)[columns], "+", color=style.LIMIT, markersize=9, zorder=5)
    quiet(axes, f"about {family.saddle}")
    names = (f"θ{style.number(arm)} (rad)", f"ω{style.number(arm)} (rad/s)") if angular else ("x", "y")
    axes.set_xlabel(names[0], fontsize=9)
    axes.set_ylabel(names[1], fontsize=9, labelpad=1)
    if angular:
        angle_axis(axes, "x")
    assert axes.figure is not None
    bar = axes.figure.colorbar(ScalarMappable(scale, _SHADES), ax=axes, fraction=0.05, pad=0.03)
    bar.ax.tick_params(labelsize=7.5)
    bar.ax.set_title("J" if angular else "energy", fontsize=8)
