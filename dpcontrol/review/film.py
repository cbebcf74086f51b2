"""The filmstrip of the drawn picture: the arms at several instants, side by side, as seen from the cart."""

from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from dpcontrol.review import style
from dpcontrol.review.motion import RunView
from dpcontrol.review.series import Range, arm_points

Array = NDArray[np.float64]

_FRAME_STEP = 2.12
"""Between the film's frames, in lengths of all arms: just enough for two stretched towards one another."""


def draw_film(axes: Axes, view: RunView, *, frames: int, times: Array | None = None) -> None:
    """Draw the arms at several instants, the reference grey behind them, the tip's path since the last frame.

    Without `times` (frames,) in s the film chooses its own; an instant outside the motion is left out.
    """
    state, arms = view.state, view.arms
    reach = sum(view.arm_lengths)
    rows = film_rows(view, frames=frames, times=times)
    horizontal, vertical = film_extent(view, frames=frames, times=times)
    axes.set_xlim(*horizontal)
    axes.set_ylim(*vertical)
    pivot = view.pivot
    width = 0.05 * reach
    for i, row in enumerate(rows):
        at = frame_place(view, i)
        if times is not None and not view.time[0] <= times[i] <= view.time[-1]:
            axes.text(at, 0, f"no data at\n{times[i]:.2f} s", ha="center", va="center", fontsize=8.5, color=style.MARK)
            continue
        if view.has_cart:
            axes.plot([at - 0.98 * reach, at + 0.98 * reach], [0, 0], color=style.FAINT, linewidth=2.5, zorder=1)
            axes.add_patch(Rectangle((at - 0.13 * reach, -width), 0.26 * reach, 2 * width, color=style.CART, zorder=2))
        since = max(rows[i - 1], row - _rows_in(view, 0.25)) if i else max(row - _rows_in(view, 0.1), 0)
        points = arm_points(state[since : row + 1, :arms], view.arm_lengths)
        points[..., 0] += at + (pivot[since : row + 1] - pivot[row])[:, None]
        draw_arms(axes, points)
        if view.reference is not None:
            ghost = arm_points(view.reference[row : row + 1, :arms], view.arm_lengths)[0]
            shift = at + (view.reference[row, 2 * arms] - pivot[row] if view.has_cart else 0.0)
            look = {"color": "#b4bbc3", "linewidth": 6.5, "solid_capstyle": "round", "zorder": 2.5}
            axes.plot(shift + ghost[:, 0], ghost[:, 1], **look)
        text = f"{view.time[row]:.2f} s" + (_cart_text(float(pivot[row])) if view.has_cart else "")
        look = {"ha": "center", "va": "top", "fontsize": 8.5, "color": style.NOTE, "linespacing": 1.25}
        axes.text(at, vertical[0] + 0.46 * reach, text, **look)
    axes.axis("off")


def frame_place(view: RunView, frame: int) -> float:
    """Return where the pivot of a frame is drawn, m."""
    return frame * _FRAME_STEP * sum(view.arm_lengths)


def draw_arms(axes: Axes, points: Array, *, size: float = 1.0) -> None:
    """Draw the last of the poses (K, n + 1, 2), pivot to tip, and the tip's path through all of them."""
    last, arms = points[-1], points.shape[1] - 1
    tip = style.arm_colour(arms - 1)
    axes.plot(*points[:, -1].T, color=tip, alpha=0.3, linewidth=1.3 * size)
    for arm in range(arms):
        look = {"color": style.arm_colour(arm), "linewidth": 2.6 * size, "solid_capstyle": "round", "zorder": 3}
        axes.plot(*last[arm : arm + 2].T, **look)
    axes.plot(*last[:-1].T, "o", color=style.INK, markersize=3.2 * size, zorder=4)
    axes.plot(*last[-1], "o", color=tip, markersize=5.5 * size, zorder=4)


def _cart_text(position: float) -> str:
    return f"\ncart {round(1000 * position):+d} mm" if np.isfinite(position) else "\nlost"


def film_extent(view: RunView, *, frames: int, times: Array | None = None) -> tuple[Range, Range]:
    """Return the x and y limits in m that `draw_film` needs: as low and as high as the arms reach in its frames."""
    reach = sum(view.arm_lengths)
    rows = film_rows(view, frames=frames, times=times)
    shown = [view.state] if view.reference is None else [view.state, view.reference]
    both = np.concatenate([states[rows, : view.arms] for states in shown])
    heights = arm_points(both[np.isfinite(both).all(axis=1)], view.arm_lengths)[..., 1].ravel()
    heights = np.append(heights, 0.0)
    low, high = min(float(heights.min()), -0.2 * reach), max(float(heights.max()), 0.1 * reach)
    step = _FRAME_STEP * reach
    return (-0.53 * step, (frames - 0.47) * step), (low - 0.62 * reach, high + 0.1 * reach)


def film_rows(view: RunView, *, frames: int, times: Array | None = None) -> NDArray[np.int64]:
    """Return the ticks that the film shows."""
    if times is None:
        times = film_times(view, frames=frames)
    return np.searchsorted(view.time, times).clip(0, len(view.time) - 1)


def _rows_in(view: RunView, seconds: float) -> int:
    return max(1, round(seconds * view.rate_hz))


def film_times(view: RunView, *, frames: int, until: float = np.inf) -> Array:
    """Return (frames,) instants for a filmstrip, shared out among the symbols' crossings; without any, evenly spread.

    Around a crossing they span a third of the period of a simple pendulum as long as all arms, on either side. Of a run
    that went wrong the last quarter of the frames shows how it ended. until: s, where they end at the latest.
    """
    time = view.time[view.time <= until]
    if view.good is False and frames > 3 and time[-1] > time[0]:
        last = frames // 4
        # Of a run that ended at once no more than its share.
        length = min(0.2 * last, (time[-1] - time[0]) * last / frames)
        ending = np.linspace(time[-1] - length, time[-1], last + 1)
        before = film_times(replace(view, good=None), frames=frames - last, until=ending[0])
        return np.concatenate([before, ending[1:]])
    moments = np.array([done or planned for _, planned, done in view.symbols])
    moments = moments[(moments >= time[0]) & (moments <= time[-1])] if len(moments) else moments
    if not len(moments):
        return np.linspace(time[0], time[-1], frames)
    moments = moments[np.linspace(0, len(moments) - 1, min(len(moments), frames)).astype(int)]
    half = 0.33 * 2 * np.pi * np.sqrt(sum(view.arm_lengths) / 9.81)
    parts = []
    for i, moment in enumerate(moments):
        share = frames // len(moments) + (i < frames % len(moments))
        parts.append(
            moment + half * np.linspace(-1, 1, share)
            if share > 2
            else np.linspace(moment - half / 2, moment, share + 1)[1:]
        )
    return np.sort(np.clip(np.concatenate(parts), time[0], time[-1]))
