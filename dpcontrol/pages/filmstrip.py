"""A filmstrip: arms on their cart at several times, side by side."""

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.run_view import RunView
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page
from dpcontrol.pages.planes import arm_points
from dpcontrol.pages.ranges import Range

_FRAME_STEP = 2.12
"""Distance between the film's frames, in lengths of all arms: enough for two stretched towards one another."""
_TRACE = 0.25
"""Longest visible path of the tip, s."""


def draw_film(axes: Axes, view: RunView, times: Array) -> None:
    """Draw the arms at several times.

    The reference is grey behind them. The tip's path begins at the last frame.
    Times outside the motion are skipped.

    Args:
        axes: panel to draw on.
        view: motion to draw.
        times: (K,) s.
    """
    pivot, reach = view.pivot, sum(view.arm_lengths)
    horizontal, vertical = film_extent(view, times)
    axes.set(xlim=horizontal, ylim=vertical)
    rows = film_rows(view, times)
    for i, (time, row) in enumerate(zip(times, rows, strict=True)):
        at = i * _FRAME_STEP * reach
        if not view.time[0] <= time <= view.time[-1]:
            look = {"ha": "center", "va": "center", "fontsize": style.SMALL, "color": style.MARK}
            axes.text(at, 0, f"no data at\n{time:.2f} s", **look)
            continue
        if view.has_cart:
            axes.plot([at - 0.98 * reach, at + 0.98 * reach], [0, 0], color=style.FAINT, linewidth=2.5, zorder=1)
        before = max(1, round((_TRACE if i else 0.1) * view.rate_hz))
        draw_pose(axes, view, (max(rows[i - 1] if i else 0, row - before), row), at=at, thick=2.6)
        cart = f"\ncart {round(1000 * float(pivot[row])):+d} mm" if np.isfinite(pivot[row]) else "\nlost"
        text = f"{view.time[row]:.2f} s{cart if view.has_cart else ''}"
        look = {"ha": "center", "va": "top", "fontsize": style.SMALL, "color": style.NOTE, "linespacing": 1.25}
        axes.text(at, vertical[0] + 0.46 * reach, text, **look)
    axes.set_aspect("equal")
    axes.axis("off")


def draw_pose(
    axes: Axes, view: RunView, ticks: tuple[int, int], *, at: float, thick: float, shade: float = 1.0
) -> None:
    """Draw the arms at a tick on their cart, with the grey reference behind them and the tip's path.

    Args:
        axes: panel to draw on.
        view: motion to draw.
        ticks: first tick of the tip's path, and tick of the pose.
        at: drawn position of the pivot, m.
        thick: width of the arms, points.
        shade: opacity of the arms and the cart.
    """
    look: dict[str, Any]
    since, row = ticks
    arms, reach, pivot = view.arms, sum(view.arm_lengths), view.pivot
    tip = style.arm_colour(arms - 1)
    if view.has_cart:
        corner, look = (at - 0.13 * reach, -0.05 * reach), {"color": style.CART, "alpha": shade, "zorder": 2}
        axes.add_patch(Rectangle(corner, 0.26 * reach, 0.1 * reach, **look))
    points = arm_points(view.state[since : row + 1, :arms], view.arm_lengths)
    points[..., 0] += at + (pivot[since : row + 1] - pivot[row])[:, None]
    axes.plot(*points[:, -1].T, color=tip, linewidth=thick / 2, alpha=0.4)
    for arm in range(arms):
        look = {"color": style.arm_colour(arm), "alpha": shade, "solid_capstyle": "round", "zorder": 3}
        # Outer arms are drawn narrower, so that overlapping arms remain visible.
        axes.plot(*points[-1, arm : arm + 2].T, linewidth=thick * (1 - 0.8 * arm / arms), **look)
    axes.plot(*points[-1, :-1].T, "o", color=style.INK, markersize=1.2 * thick, alpha=shade, zorder=4)
    axes.plot(*points[-1, -1], "o", color=tip, markersize=2.0 * thick, alpha=shade, zorder=4)
    if view.reference is not None:
        ghost = arm_points(view.reference[row : row + 1, :arms], view.arm_lengths)[0]
        shift = at + (view.reference[row, 2 * arms] - pivot[row] if view.has_cart else 0.0)
        look = {"color": style.REFERENCE, "linewidth": 2.0 * thick, "solid_capstyle": "round", "zorder": 1.5}
        axes.plot(shift + ghost[:, 0], ghost[:, 1], **look)


def film_extent(view: RunView, times: Array) -> tuple[Range, Range]:
    """Return the x and y limits in m for `draw_film`.

    Vertically they cover the arms in its frames.

    Args:
        view: motion in the film.
        times: (K,) s of the frames.
    """
    reach, before = sum(view.arm_lengths), round(_TRACE * view.rate_hz)
    rows = np.unique(np.add.outer(film_rows(view, times), np.arange(-before, 1)).clip(0))
    shown = [view.state] if view.reference is None else [view.state, view.reference]
    both = np.concatenate([states[rows, : view.arms] for states in shown])
    heights = arm_points(both[np.isfinite(both).all(axis=1)], view.arm_lengths)[..., 1].ravel()
    heights = np.append(heights, 0.0)
    low, high = min(float(heights.min()), -0.2 * reach), max(float(heights.max()), 0.1 * reach)
    step = _FRAME_STEP * reach
    return (-0.53 * step, (len(times) - 0.47) * step), (low - 0.62 * reach, high + 0.1 * reach)


def add_film(page: Page, view: RunView, times: Array) -> None:
    """Add a filmstrip to a page, as high as equal scales require.

    Args:
        page: page to extend.
        view: motion in the film.
        times: (K,) s of the frames.
    """
    (left, right), (low, high) = film_extent(view, times)
    page.row(partial(draw_film, view=view, times=times), height=page.width * (high - low) / (right - left))


def film_rows(view: RunView, times: Array) -> NDArray[np.int64]:
    """Return the ticks shown in the film.

    Args:
        view: motion in the film.
        times: (K,) s of the frames.
    """
    return np.searchsorted(view.time, times).clip(0, len(view.time) - 1)


def film_times(view: RunView, *, frames: int) -> Array:
    """Return (frames,) times in s for a filmstrip, about the symbols' crossings, otherwise evenly.

    On either side of a crossing they span a third of the period of a simple pendulum as long as all arms. The end of a
    run that failed counts as a crossing.

    Args:
        view: motion in the film.
        frames: number of frames.
    """
    begin, end = view.time_range
    half = 0.33 * 2 * np.pi * np.sqrt(sum(view.arm_lengths) / 9.81)
    moments = [done or planned for _, planned, done in view.symbols if begin <= (done or planned) <= end]
    if view.good is False:
        moments.append(end - half)
    if not moments:
        return np.linspace(begin, end, frames)
    chosen = np.array(moments)[np.linspace(0, len(moments) - 1, min(len(moments), frames)).astype(int)]
    shares = [len(part) for part in np.array_split(np.arange(frames), len(chosen))]
    parts = [moment + half * np.linspace(-1, 1, n + 2)[1:-1] for moment, n in zip(chosen, shares, strict=True)]
    return np.sort(np.clip(np.concatenate(parts), begin, end))
