"""Panels of the drawn picture that tell how well a run went: tracking, estimation, energy, innovations."""

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.review import series, style
from dpcontrol.review.context import ReviewContext
from dpcontrol.review.motion import Motion
from dpcontrol.review.panel_frame import legend, number, plot, prepare


def tracking_error(axes: Axes, motion: Motion, context: ReviewContext) -> None:
    """Draw how far the arms are from the reference, in rad."""
    prepare(axes, f"{motion.error_name}: {motion.what} minus {motion.against} (rad)")
    axes.axhline(0, color=style.FAINT, linewidth=1)
    if motion.reference is not None:
        away = motion.state - motion.reference
        for arm in range(motion.arms):
            plot(axes, motion, away[:, arm], color=style.arm_colour(arm), linewidth=1.1)
    legend(axes, [(f"θ{number(arm)}", {"color": style.arm_colour(arm)}) for arm in range(motion.arms)])


def estimation_error(axes: Axes, motion: Motion, context: ReviewContext) -> None:
    """Draw the estimate's error in the angles with two standard deviations either side; the band only if no truth."""
    error, sigma = motion.error, motion.sigma
    title = "Estimation error, lines ±2σ (mrad)"
    prepare(axes, title if error is not None else "Estimate's ±2σ (mrad); the truth is not known")
    for arm in range(motion.arms):
        colour = style.arm_colour(arm)
        if error is not None:
            plot(axes, motion, 1000 * error[:, arm], color=colour, linewidth=0.6, alpha=0.45, zorder=2)
        if sigma is not None:
            time, band = series.curve(motion, 2000 * sigma[:, arm])
            axes.fill_between(time, -band, band, color=colour, alpha=0.10, linewidth=0)
            axes.plot(time, band, time, -band, color=colour, linewidth=1.1, zorder=3)
    reach = 1000 * series.error_reach(motion)
    axes.set_ylim(-reach, reach)
    legend(axes, [(f"θ{number(arm)}", {"color": style.arm_colour(arm)}) for arm in range(motion.arms)])


def energy(axes: Axes, motion: Motion, context: ReviewContext) -> None:
    """Draw the pendulum's energy and the saddles' levels next to it."""
    prepare(axes, "Energy of the pendulum (J), dashed: the saddles'")
    values = series.energy_of(motion, context)
    if values is None:
        return
    plot(axes, motion, values, color=style.INK, linewidth=1.1)
    low, high = series.energy_range(values, context.saddle_energies)
    axes.set_ylim(low, high)
    for name, level in context.saddle_energies.items():
        if low <= level <= high:
            colour = style.saddle_colour(name)
            axes.axhline(level, color=colour, linewidth=1.0, linestyle=(0, (5, 3)))
            # Above the lower levels and below the upper, so that a name does not leave the panel.
            upper = level > (low + high) / 2
            axes.annotate(
                name,
                (1.0, level),
                xycoords=("axes fraction", "data"),
                xytext=(-2, -2 if upper else 2),
                textcoords="offset points",
                ha="right",
                va="top" if upper else "bottom",
                fontsize=7.5,
                color=colour,
                bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 0.8},
            )


def innovations(axes: Axes, motion: Motion, context: ReviewContext) -> None:
    """Draw means of the NIS over windows, and where 95 % of them lie if the estimator is consistent."""
    time, means, spread = series.smoothed_nis(motion)
    expected = motion.sensors
    band = f"{max(expected - spread, 0):.1f} to {expected + spread:.1f}"
    prepare(axes, f"NIS, means of 50 updates; 95 % belong in {band}")
    axes.axhspan(max(expected - spread, 0), expected + spread, color="#9fd3a8", alpha=0.35, linewidth=0)
    axes.plot(*series.thinned(time, means), color=style.CART, linewidth=1.0)
    highest = float(np.nanquantile(means, 0.98)) if len(means) else 0.0
    if highest > series.NIS_LOST * expected:
        # An estimate that is lost would press all that went before into the axis.
        axes.set_yscale("log")
        axes.set_ylim(0.3 * expected, 2 * float(np.nanmax(means)))
    elif len(means):
        axes.set_ylim(0, max(1.15 * highest, 1.6 * expected))
