"""A family of Lyapunov orbits on one page: period and multipliers against energy, orbits in the plane of positions."""

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from dpcontrol.orbits.family import LyapunovFamily
from dpcontrol.review import style

_DRAWN = 24  # orbits in the plane: more run into each other
_POINTS = 300
_COLOURS = colormaps["viridis"]


def draw_family(family: LyapunovFamily) -> Figure:
    """Return the page as a figure."""
    figure = Figure(figsize=(13.0, 6.2), dpi=120, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.25))
    colours = Normalize(float(family.energies.min()), float(family.energies.max()))
    _period(figure.add_subplot(grid[0, 0]), family, colours)
    _multipliers(figure.add_subplot(grid[1, 0]), family)
    plane = figure.add_subplot(grid[:, 1])
    _plane(plane, family, colours)
    unit = "J" if np.isfinite(family.system.periods).any() else "non-dimensional"
    bar = figure.colorbar(ScalarMappable(colours, _COLOURS), ax=plane, pad=0.01)
    bar.set_label(f"energy ({unit})")
    figure.suptitle(
        f"Lyapunov orbits about {family.saddle} of {family.system.name}", fontsize=14, weight="bold", color=style.INK
    )
    lines = [f"{side} {end.energy:.6g}: {end.reason}" for side, end in zip(("from", "to"), family.ends, strict=True)]
    figure.supxlabel("\n".join(lines), fontsize=8.5, color="#555c64", wrap=True)
    return figure


def _period(axes: Axes, family: LyapunovFamily, colours: Normalize) -> None:
    axes.plot(family.energies, family.periods, color=style.REFERENCE, lw=1.0, zorder=1)
    axes.scatter(family.energies, family.periods, c=_COLOURS(colours(family.energies)), s=9, zorder=2)
    for event in family.events:
        axes.plot(event.orbit.energy, event.orbit.period, "x", color=style.LIMIT, ms=7)
        axes.annotate(event.kind, (event.orbit.energy, event.orbit.period), fontsize=8, color=style.LIMIT)
    axes.set_ylabel("period (s)" if np.isfinite(family.system.periods).any() else "period")
    axes.tick_params(labelbottom=False)
    axes.grid(color=style.FAINT, lw=0.4)


def _multipliers(axes: Axes, family: LyapunovFamily) -> None:
    values = np.abs(family.floquet_multipliers)
    for k in range(values.shape[1]):
        neutral = np.abs(np.log10(values[:, k])).max() < 0.02
        colour = style.REFERENCE if neutral else style.arm_colour(0 if k < values.shape[1] // 2 else 1)
        axes.plot(family.energies, values[:, k], color=colour, lw=0.9 if neutral else 1.6)
    axes.set_yscale("log")
    axes.set_ylabel("|Floquet multipliers|")
    axes.set_xlabel("energy (J)" if np.isfinite(family.system.periods).any() else "energy")
    axes.grid(color=style.FAINT, lw=0.4)


def _plane(axes: Axes, family: LyapunovFamily, colours: Normalize) -> None:
    system = family.system
    angular = bool(np.isfinite(system.periods[:2]).all())
    # Small orbits on top: they lie within the large ones.
    wanted = np.linspace(0, len(family.members) - 1, min(_DRAWN, len(family.members)))
    for member in (family.members[round(k)] for k in wanted[::-1]):
        states = system.propagator.sample(member.state, np.linspace(0.0, member.period, _POINTS))
        axes.plot(states[:, 0], states[:, 1], color=_COLOURS(colours(member.energy)), lw=1.0)
    centre = system.equilibrium(family.saddle)
    axes.plot(centre[0], centre[1], "+", color=style.INK, ms=9)
    axes.annotate(f" {family.saddle}", (float(centre[0]), float(centre[1])), fontsize=9, color=style.INK)
    axes.set_xlabel("θ₁ (rad)" if angular else "x")
    axes.set_ylabel("θ₂ (rad)" if angular else "y")
    axes.grid(color=style.FAINT, lw=0.4)
