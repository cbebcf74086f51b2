"""A sustained orbit on one page: the orbit beside its Lyapunov orbit, input, cart and energy over a period."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dpcontrol.references.sustained import SustainedOrbit
from dpcontrol.review import style
from dpcontrol.review.panel_frame import angle_axis, new_figure, quiet

Array = NDArray[np.float64]

_POINTS = 1200
_SHOWN_SECTIONS = 8


def draw_sustained(orbit: SustainedOrbit) -> Figure:
    """Return the page as a figure."""
    figure = new_figure(
        13.0,
        7.0,
        f"Sustained orbit about {orbit.lyapunov.saddle} at {orbit.energy:g} J: period {orbit.period:.5g} s, "
        f"{orbit.reference.rms_cart_acceleration:.3g} m/s² rms, within {orbit.departure:.2g} of the Lyapunov orbit",
    )
    times = np.linspace(0.0, orbit.period, _POINTS)
    # Just before the end: at the end the next period's first input holds, which may differ.
    times[-1] = np.nextafter(orbit.period, 0.0)
    states, inputs = orbit.state(times), orbit.input(times)
    grid = figure.add_gridspec(
        6, 2, width_ratios=(1.0, 1.1), left=0.06, right=0.985, top=0.865, bottom=0.075, hspace=1.5, wspace=0.16
    )
    planes = [figure.add_subplot(grid[3 * k : 3 * k + 3, 0]) for k in range(2)]
    for k, plane in enumerate(planes):
        # With more arms than two the innermost and the outermost stand for the rest.
        _phase_plane(plane, orbit, states, outermost=k == 1)
    handles, labels = planes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.008, 0.955), ncols=4, fontsize=9, frameon=False)
    energy = orbit.lyapunov.system.numeric.hamiltonian(states[:, :-2]) - orbit.energy
    rows = (
        ("Input: acceleration of the cart (m/s²)", inputs, style.CART),
        ("Cart position (mm)", 1e3 * states[:, -2], style.CART),
        ("Energy of the pendulum above that asked for (mJ)", 1e3 * energy, style.CART),
    )
    for row, (title, values, colour) in enumerate(rows):
        axes = figure.add_subplot(grid[2 * row : 2 * row + 2, 1])
        axes.plot(times, values, color=colour, linewidth=1.4)
        axes.axhline(0.0, color=style.REFERENCE, linewidth=0.8)
        axes.set_xlim(0.0, orbit.period)
        quiet(axes, title)
        axes.tick_params(labelbottom=row == len(rows) - 1)
        if row == len(rows) - 1:
            axes.set_xlabel("time (s)", fontsize=9)
    return figure


def _phase_plane(axes: Axes, orbit: SustainedOrbit, states: Array, *, outermost: bool) -> None:
    system, lyapunov = orbit.lyapunov.system, orbit.lyapunov
    n = system.dimension // 2
    arm = n - 1 if outermost else 0
    free = system.propagator.sample(lyapunov.state, np.linspace(0.0, lyapunov.period, _POINTS))
    colour = style.arm_colour(arm)
    axes.plot(free[:, arm], free[:, n + arm], color=style.FAINT, linewidth=4.5, label="Lyapunov orbit, no friction")
    axes.plot(states[:, arm], states[:, n + arm], color=colour, linewidth=1.2, label="sustained by the cart")
    for k, section in enumerate(orbit.sections(_SHOWN_SECTIONS)):
        label = f"{_SHOWN_SECTIONS} sections, equal times apart" if k == 0 else None
        axes.plot(section.state[arm], section.state[n + arm], ".", color=style.INK, markersize=6, label=label)
    axes.plot(
        states[0, arm], states[0, n + arm], "o", color=style.LIMIT, markersize=6, label="phase 0: energy held here"
    )
    axes.plot(lyapunov.centre[arm], 0.0, "+", color=style.INK, markersize=10)
    quiet(axes, f"{'Outer' if outermost else 'Inner'} arm: rate (rad/s) over angle")
    axes.margins(0.06)
    angle_axis(axes, "x")
