"""Families of Lyapunov orbits about both saddles: shapes, periods and multipliers against energy."""

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from dpcontrol.orbits.equilibria import equilibria
from dpcontrol.orbits.family import LyapunovFamily, lyapunov_family
from dpcontrol.review import style
from dpcontrol.review.figures.page import Gallery, Page
from dpcontrol.review.panel_frame import angle_axis, new_figure, quiet

_HIGHEST = 0.45
_SHAPES = 12
_SAMPLES = 200
_SWINGING = {"down-up": 0, "up-down": 1}
"""The arm that swings most, counted from zero: the hanging one."""


def draw(gallery: Gallery) -> Page:
    """Draw the families about Down-Up and Up-Down of the lab pendulum from birth to 0.45 J."""
    system = gallery.system("lab")
    births = {name: point.energy for name, point in equilibria(system).items() if point.kind.startswith("index-1")}
    families = {
        name: lyapunov_family(system, name, energies=(birth + 1e-4, _HIGHEST)) for name, birth in births.items()
    }
    figure = new_figure(13.5, 4.6, "Families of Lyapunov orbits of the lab pendulum")
    grid = figure.add_gridspec(1, 4, left=0.05, right=0.985, top=0.85, bottom=0.12, wspace=0.33,
                               width_ratios=[1.15, 1.15, 1, 1])  # fmt: skip
    scale = Normalize(min(births.values()), _HIGHEST)
    shades = colormaps["viridis"]
    for k, (name, family) in enumerate(families.items()):
        axes = figure.add_subplot(grid[0, k])
        _shapes(axes, family, births[name], shades, scale)
        quiet(axes, f"about {name}")
        arm = _SWINGING[name]
        axes.set_xlabel(f"θ{'₁₂'[arm]} (rad)", fontsize=9)
        axes.set_ylabel(f"ω{'₁₂'[arm]} (rad/s)", fontsize=9, labelpad=1)
        angle_axis(axes, "x")
        bar = figure.colorbar(ScalarMappable(scale, shades), ax=axes, fraction=0.05, pad=0.03)
        bar.ax.tick_params(labelsize=7.5)
        bar.ax.set_title("J", fontsize=8)
    periods, multipliers = figure.add_subplot(grid[0, 2]), figure.add_subplot(grid[0, 3])
    for name, family in families.items():
        look = {"color": style.saddle_colour(name), "label": name, "linewidth": 1.6}
        periods.plot(family.energies, family.periods, **look)
        multipliers.semilogy(family.energies, np.abs(family.floquet_multipliers[:, 0]), **look)
    for axes, title in ((periods, "period (s)"), (multipliers, "unstable Floquet multiplier")):
        quiet(axes, title)
        axes.set_xlabel("energy (J)", fontsize=9)
        axes.legend(fontsize=8.5, frameon=False)
    ends = "; ".join(f"{name}: {family.status}" for name, family in families.items())
    return Page(
        figure,
        "Lyapunov orbits about each saddle from their birth at the saddle (cross) upwards in energy: their shapes in "
        "the phase plane of the arm that hangs, which swings most while the other balances; their periods; and "
        f"their unstable multipliers, by which a deviation grows in one period. {ends}.",
        "Each family is followed along its own curve until 0.45 J instead of being computed at chosen energies, so "
        "that periods and multipliers can be shown against energy. Parameters are the rig's identified ones.",
    )


def _shapes(axes: Axes, family: LyapunovFamily, birth: float, shades: object, scale: Normalize) -> None:
    arm = _SWINGING[family.saddle]
    # Evenly spread in amplitude, which grows as the root of the energy above the saddle.
    amplitude = np.sqrt(np.abs(family.energies - birth))
    wanted = np.linspace(amplitude.min(), amplitude.max(), _SHAPES)
    for k in dict.fromkeys(int(np.argmin(np.abs(amplitude - a))) for a in wanted):
        orbit = family.members[k]
        states = orbit.system.propagator.sample(orbit.state, np.linspace(0, orbit.period, _SAMPLES))
        axes.plot(states[:, arm], states[:, 2 + arm], color=shades(scale(orbit.energy)), linewidth=1.3)  # type: ignore[operator]
    centre = family.members[0].centre
    axes.plot(centre[arm], 0.0, "+", color=style.LIMIT, markersize=9, zorder=5)
