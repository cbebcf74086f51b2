"""The filmstrip of the drawn picture: the arms at several instants, side by side, as seen from the cart."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from dpcontrol.review import series, style
from dpcontrol.review.context import ReviewContext
from dpcontrol.review.motion import Motion

Array = NDArray[np.float64]
Span = tuple[float, float]

_FRAME_STEP = 2.12
"""Between the film's frames, in lengths of all arms: just enough for two stretched towards one another."""


def draw_film(axes: Axes, motion: Motion, context: ReviewContext, *, frames: int, times: Array | None = None) -> None:
    """Draw the arms at several instants, the reference grey behind them, the tip's path since the last frame.

    Without `times` (frames,) in s the film chooses its own; an instant outside the motion is left out.
    """
    state, arms = motion.state, motion.arms
    reach = sum(context.arm_lengths)
    step = _FRAME_STEP * reach
    rows = film_rows(motion, context, frames=frames, times=times)
    horizontal, vertical = film_extent(motion, context, frames=frames, times=times)
    axes.set_xlim(*horizontal)
    axes.set_ylim(*vertical)
    pivot = motion.pivot
    width = 0.05 * reach
    for i, row in enumerate(rows):
        at = i * step
        if times is not None and not motion.time[0] <= times[i] <= motion.time[-1]:
            axes.text(at, 0, f"no data at\n{times[i]:.2f} s", ha="center", va="center", fontsize=8.5, color="#7a828b")
            continue
        if motion.has_cart:
            axes.plot([at - 0.98 * reach, at + 0.98 * reach], [0, 0], color=style.FAINT, linewidth=2.5, zorder=1)
            axes.add_patch(Rectangle((at - 0.13 * reach, -width), 0.26 * reach, 2 * width, color=style.CART, zorder=2))
        since = max(rows[i - 1], row - _rows_in(motion, 0.25)) if i else max(row - _rows_in(motion, 0.1), 0)
        tips = series.arm_points(state[since : row + 1, :arms], context.arm_lengths)[:, -1]
        drift = pivot[since : row + 1] - pivot[row]
        axes.plot(at + tips[:, 0] + drift, tips[:, 1], color=style.arm_colour(arms - 1), alpha=0.3, linewidth=1.3)
        if motion.reference is not None:
            ghost = series.arm_points(motion.reference[row : row + 1, :arms], context.arm_lengths)[0]
            shift = at + (motion.reference[row, 2 * arms] - pivot[row] if motion.has_cart else 0.0)
            look = {"color": "#b4bbc3", "linewidth": 6.5, "solid_capstyle": "round", "zorder": 2.5}
            axes.plot(shift + ghost[:, 0], ghost[:, 1], **look)
        points = series.arm_points(state[row : row + 1, :arms], context.arm_lengths)[0]
        for arm in range(arms):
            x, y = points[arm : arm + 2].T
            axes.plot(at + x, y, color=style.arm_colour(arm), linewidth=2.6, solid_capstyle="round", zorder=3)
        axes.plot(at + points[:-1, 0], points[:-1, 1], "o", color=style.INK, markersize=3.2, zorder=4)
        axes.plot(at + points[-1, 0], points[-1, 1], "o", color=style.arm_colour(arms - 1), markersize=5.5, zorder=4)
        text = f"{motion.time[row]:.2f} s" + (_cart_text(float(pivot[row])) if motion.has_cart else "")
        axes.text(
            at,
            vertical[0] + 0.46 * reach,
            text,
            ha="center",
            va="top",
            fontsize=8.5,
            color="#555c64",
            linespacing=1.25,
        )
    axes.axis("off")


def _cart_text(position: float) -> str:
    return f"\ncart {round(1000 * position):+d} mm" if np.isfinite(position) else "\nlost"


def film_extent(
    motion: Motion, context: ReviewContext, *, frames: int, times: Array | None = None
) -> tuple[Span, Span]:
    """Return the x and y limits in m that `draw_film` needs: as low and as high as the arms reach in its frames."""
    reach = sum(context.arm_lengths)
    rows = film_rows(motion, context, frames=frames, times=times)
    shown = [motion.state] if motion.reference is None else [motion.state, motion.reference]
    both = np.concatenate([states[rows, : motion.arms] for states in shown])
    heights = series.arm_points(both[np.isfinite(both).all(axis=1)], context.arm_lengths)[..., 1].ravel()
    heights = np.append(heights, 0.0)
    low, high = min(float(heights.min()), -0.2 * reach), max(float(heights.max()), 0.1 * reach)
    step = _FRAME_STEP * reach
    return (-0.53 * step, (frames - 0.47) * step), (low - 0.62 * reach, high + 0.1 * reach)


def film_rows(motion: Motion, context: ReviewContext, *, frames: int, times: Array | None = None) -> NDArray[np.int64]:
    """Return the ticks that the film shows."""
    if times is None:
        times = series.film_times(context, motion.time, frames=frames)
    return np.searchsorted(motion.time, times).clip(0, len(motion.time) - 1)


def _rows_in(motion: Motion, seconds: float) -> int:
    return max(1, round(seconds * motion.rate_hz))
