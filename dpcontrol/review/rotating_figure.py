"""Families of rotating orbits on one page: trace, period and shapes against energy, coloured by stability."""

from collections.abc import Sequence
from itertools import groupby, pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import SymmetricalLogLocator
from numpy.typing import NDArray

from dpcontrol.orbits.rotating import RotatingFamily, RotatingOrbit
from dpcontrol.review import style
from dpcontrol.review.panel_frame import angle_axis, new_figure, quiet

KINDS = {"elliptic": "#1e7a3c", "hyperbolic": "#b3261e", "inverse hyperbolic": "#d9640d", "parabolic": "#5b6470"}
_SHAPES = 3
_POINTS = 300


def draw_rotating_families(families: Sequence[RotatingFamily]) -> Figure:
    """Return the page as a figure."""
    first = families[0].members[0]
    arm = ("inner", "outer")[first.arm - 1]
    figure = new_figure(14.0, 6.0, f"Orbits of {first.system.name} that turn the {arm} arm over")
    grid = figure.add_gridspec(2, 2, left=0.06, right=0.985, top=0.86, bottom=0.1, hspace=0.28, wspace=0.16)
    traces, periods = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, 0])
    shapes = figure.add_subplot(grid[:, 1])
    for family in families:
        # Neighbouring runs share a member, so that lines of two kinds meet.
        for kind, members in _runs(family.members):
            energies = [m.energy for m in members]
            traces.plot(energies, [m.trace for m in members], color=KINDS[kind], linewidth=1.6)
            periods.plot(energies, [m.period for m in members], color=KINDS[kind], linewidth=1.6)
        for orbit in (*(c.orbit for c in family.changes), *family.folds):
            traces.plot(orbit.energy, orbit.trace, "o", color=style.INK, markersize=4)
            periods.plot(orbit.energy, orbit.period, "o", color=style.INK, markersize=4)
        for k in np.unique(np.rint(np.linspace(0, len(family.members) - 1, _SHAPES)).astype(int)):
            _shape(shapes, family.members[k])
    traces.set_yscale("symlog", linthresh=4)
    traces.yaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=10))
    for critical in (2, -2):
        traces.axhline(critical, color=style.FAINT, linewidth=1.0, linestyle="--")
    quiet(traces, "trace of the section's map, ±2 dashed (dots: stability changes or the family folds)")
    quiet(periods, "period (s)")
    periods.set_xlabel("energy (J)", fontsize=9)
    quiet(shapes, "some of the orbits over one period")
    shapes.set_xlabel("θ₁ (rad)", fontsize=9)
    shapes.set_ylabel("θ₂ (rad)", fontsize=9)
    for axis in ("x", "y"):
        angle_axis(shapes, axis)
    seen = {member.kind for family in families for member in family.members}
    handles = [Line2D([], [], color=KINDS[kind], label=kind) for kind in KINDS if kind in seen]
    figure.legend(handles=handles, loc="upper right", ncols=len(handles), fontsize=9, frameon=False)
    return figure


def _runs(members: Sequence[RotatingOrbit]) -> list[tuple[str, list[RotatingOrbit]]]:
    runs = [(kind, list(group)) for kind, group in groupby(members, key=lambda m: m.kind)]
    for (_, before), (_, after) in pairwise(runs):
        before.append(after[0])
    return runs


def _shape(axes: Axes, orbit: RotatingOrbit) -> None:
    times = np.linspace(0.0, orbit.period, _POINTS)
    states: NDArray[np.float64] = orbit.system.propagator.sample(orbit.state, times)
    axes.plot(states[:, 0], states[:, 1], color=KINDS[orbit.kind], linewidth=1.0)
