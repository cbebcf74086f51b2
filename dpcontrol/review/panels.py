"""Panels of the drawn picture that show a motion: angles, rates, cart, command, phase planes with orbits and tubes."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from dpcontrol.review import series, style
from dpcontrol.review.context import ReviewContext
from dpcontrol.review.motion import ACTUAL, Motion
from dpcontrol.review.panel_frame import ghost, label_in_pi, legend, limit_lines, number, plot, prepare

_POINTS = 20_000


def angles(axes: Axes, motion: Motion, context: ReviewContext) -> None:
    """Draw the arms' angles in turns of π with the reference behind."""
    # An estimate's legend takes the room of the longer title.
    prepare(axes, "Angles (rad)" if motion.what == "estimate" else "Angles from hanging (rad)")
    entries: list[tuple[str, dict]] = []
    for arm in range(motion.arms):
        colour = style.arm_colour(arm)
        if motion.reference is not None:
            plot(axes, motion, motion.reference[:, arm] / np.pi, **ghost(colour))
        plot(axes, motion, motion.state[:, arm] / np.pi, color=colour, linewidth=1.3)
        entries.append((f"θ{number(arm)} {motion.what}", {"color": colour, "linewidth": 1.5}))
    if motion.reference is not None:
        entries.append((motion.against, {"color": style.REFERENCE, "linewidth": 4.5, "alpha": 0.6}))
    axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    label_in_pi(axes.yaxis)
    legend(axes, entries)


def rates(axes: Axes, motion: Motion, context: ReviewContext) -> None:
    """Draw the arms' rates with the reference behind."""
    arms = motion.arms
    prepare(axes, "Rates (rad/s)" + (", by differences" if motion.differenced else ""))
    for arm in range(arms):
        colour = style.arm_colour(arm)
        if motion.reference is not None:
            plot(axes, motion, motion.reference[:, arms + arm], **ghost(colour))
        plot(axes, motion, motion.state[:, arms + arm], color=colour, linewidth=1.3)
    legend(axes, [(f"ω{number(arm)}", {"color": style.arm_colour(arm), "linewidth": 1.5}) for arm in range(arms)])


def cart(axes: Axes, motion: Motion, context: ReviewContext) -> None:
    """Draw the cart's position in mm; its limits as lines where they are near, in the title always."""
    track = f", track ±{1000 * context.limits[0]:.0f}" if context.limits else ""
    prepare(axes, f"Cart position (mm){track}")
    position = 2 * motion.arms
    entries: list[tuple[str, dict]] = [(motion.what, {"color": style.CART})]
    if motion.reference is not None:
        plot(axes, motion, 1000 * motion.reference[:, position], **ghost(style.CART))
        entries.append((motion.against, {"color": style.REFERENCE, "linewidth": 4.5, "alpha": 0.6}))
    plot(axes, motion, 1000 * motion.state[:, position], color=style.CART, linewidth=1.3)
    if context.limits:
        limit_lines(axes, 1000 * context.limits[0])
    legend(axes, entries)


def command(axes: Axes, motion: Motion, context: ReviewContext) -> None:
    """Draw the acceleration as applied, its planned part, and the plant's own; where it was cut the panel is shaded."""
    limit = f" ≤ {context.limits[2]:g} m/s²" if context.limits else " (m/s²)"
    prepare(axes, f"Acceleration{limit}")
    control = motion.control or {}
    entries: list[tuple[str, dict]] = []
    for name, said, colour, width in (
        (ACTUAL, "plant", style.ARMS[2], 2.6),
        ("applied", "applied", style.INK, 1.0),
        ("feedforward", "plan", style.ARMS[1], 1.4),
    ):
        if name in control:
            plot(axes, motion, control[name], color=colour, linewidth=width)
            entries.append((said, {"color": colour, "linewidth": max(width, 1.5)}))
    if "saturated" in control and (control["saturated"] > 0).any():
        for start, end in series.spans(motion.time, control["saturated"] > 0):
            axes.axvspan(start, end, color=style.LIMIT, alpha=0.3, linewidth=0.8, zorder=0.5)
        entries.append(("cut", {"color": style.LIMIT, "linewidth": 6, "alpha": 0.3}))
    if context.limits:
        limit_lines(axes, context.limits[2])
    legend(axes, entries)


def phase_plane(axes: Axes, motion: Motion, context: ReviewContext, *, arm: int) -> None:
    """Draw an arm's angle and rate, whole turns counted, over the orbits and tubes that the plan uses."""
    state, arms = motion.state, motion.arms
    prepare(axes, f"Arm {arm + 1}: ω{number(arm)} (rad/s) over θ{number(arm)}")
    columns = [arm, arms + arm]
    scale = [1 / np.pi, 1]
    for tube in context.tubes:
        colour = style.STABLE if tube.stable else style.UNSTABLE
        lines = np.full((len(tube.strands), tube.strands.shape[1] + 1, 2), np.nan)
        lines[:, :-1] = tube.strands[:, :, columns] * scale
        axes.plot(*lines.reshape(-1, 2).T, color=colour, linewidth=0.45, alpha=0.35, zorder=1.2)
        axes.plot(*(tube.cut[:, columns] * scale).T, color=colour, linewidth=1.8, zorder=2.5)
    for orbit in context.orbits:
        points = orbit.states[:, columns] * scale
        look = {"color": style.saddle_colour(orbit.saddle), "zorder": 1.5, "alpha": 0.75}
        if len(points) > 2:
            axes.plot(*np.vstack([points, points[:1]]).T, linewidth=3.2, **look)
        else:
            axes.plot(*points[0], "D", markersize=8, **look)
    step = max(1, len(motion.time) // _POINTS)
    walked = state[:, columns] * scale
    rows = np.arange(0, len(walked), step)
    path = np.insert(walked[rows], np.searchsorted(rows, motion.breaks), np.nan, axis=0)
    # The ink keeps the run apart from the tubes' red and green.
    axes.plot(*path.T, color=style.INK, linewidth=1.1, zorder=3)
    axes.plot(*walked[0], "o", color=style.INK, markersize=5, zorder=4)
    axes.plot(*walked[-1], "s", color=style.INK, markersize=5, zorder=4)
    _name_ends(axes, walked)
    entries: list[tuple[str, dict]] = []
    if context.orbits:
        entries.append(("orbits", {"color": style.saddle_colour(context.orbits[0].saddle), "linewidth": 3.2}))
    if context.tubes:
        entries.append(("tubes from", {"color": style.UNSTABLE, "linewidth": 1.5}))
        entries.append(("to them", {"color": style.STABLE, "linewidth": 1.5}))
    axes.margins(x=0.04)
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))
    label_in_pi(axes.xaxis)
    if entries:
        legend(axes, entries)


def _name_ends(axes: Axes, walked: NDArray[np.float64]) -> None:
    """Write start and end beside their marks, as one word where they are near each other."""
    first, last = walked[0], walked[-1]
    spans = [max(high - low, 1e-9) for low, high in (axes.get_xlim(), axes.get_ylim())]
    near = bool((np.abs(last - first) < np.array([0.16, 0.12]) * spans).all())
    ends = [("start, end", first)] if near else [("start", first), ("end", last)]
    for text, place in ends:
        if np.isfinite(place).all():
            axes.annotate(
                text,
                place,
                xytext=(4, -4),
                textcoords="offset points",
                ha="left",
                va="top",
                fontsize=7.5,
                color=style.INK,
                bbox={"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 0.6},
                zorder=5,
            )
