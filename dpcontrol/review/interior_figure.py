"""The inside of a tube as colour wheels: where each point of its cut goes at every return to the section."""

from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import hsv_to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dpcontrol.review import style
from dpcontrol.tubes.interior import Outline, Returns, TubeInterior

Array = NDArray[np.float64]


def draw_interior(interior: TubeInterior) -> Figure:
    """Return the figure: the start and its forward returns above, its backward returns below."""
    if not len(interior.points):
        return _nothing(interior)
    returns = interior.forward.arrived.shape[1]
    figure = Figure(figsize=(3.5 * (returns + 1), 7.9), dpi=110, facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplots(
        2, returns + 1, sharex=True, sharey=True,
        gridspec_kw={"left": 0.055, "right": 0.99, "top": 0.855, "bottom": 0.08, "wspace": 0.06, "hspace": 0.2},
    )  # fmt: skip
    figure.suptitle(_heading(interior), x=0.055, y=0.975, ha="left", fontsize=13, color=style.INK)
    saturation = 0.12 + 0.88 * np.clip(interior.radius, 0, 1)
    hue = interior.angle / (2 * np.pi)
    colours = hsv_to_rgb(np.column_stack([hue, saturation, np.full(len(hue), 0.93)]))
    own = next(o for o in interior.outlines if o.branch == interior.branch and not o.stable)
    direction = -own.direction if interior.stable else own.direction
    size = _marker(interior)
    both = (interior.forward, interior.backward)
    for row, run in enumerate(both):
        _start(axes[row, 0], interior, colours, direction, size)
        for k in range(returns):
            ax = axes[row, k + 1]
            _returned(ax, run, k, colours, direction, size)
            _outlines(ax, interior.outlines, direction)
            word = "forward" if row == 0 else "backward"
            ax.set_title(_title(run, k, f"return {k + 1} {word}"), fontsize=9, color=style.INK)
    axes[0, 0].set_title(f"start: {len(hue)} points", fontsize=9, color=style.INK)
    axes[1, 0].set_title("start", fontsize=9, color=style.INK)
    arrived = np.concatenate([r.points[r.arrived] for r in both] + [o.vertices for o in interior.outlines])
    high = 1.08 * float(np.abs(arrived[:, 1]).max())
    wide = min(np.pi, 1.08 * float(np.abs(arrived[:, 0]).max()))
    axes[0, 0].set_xlim(-wide, wide)
    axes[0, 0].set_ylim(-high, high)
    for ax in axes[1]:
        ax.set_xlabel("q (rad)", fontsize=9)
    for ax in axes[:, 0]:
        ax.set_ylabel("p / p₀", fontsize=9)
    figure.text(
        0.055, 0.928,
        "Hue: angle about the innermost point at the start; saturation: how near to the cut. Pale dots cross the "
        "section against the start's direction.\nRed: cut of the unstable tube; green: of the stable tube; pale: "
        "cuts crossed against the start's direction.",
        fontsize=9, color=style.CART, va="center",
    )  # fmt: skip
    return figure


def _heading(interior: TubeInterior) -> str:
    orbit = interior.orbit
    return (
        f"Inside the {'stable' if interior.stable else 'unstable'} tube of {orbit.saddle} at {orbit.energy:g} J "
        f"(branch {interior.branch:+d}), cut on {interior.section.name}"
    )


def _nothing(interior: TubeInterior) -> Figure:
    """Return a small figure that says why there is nothing to draw."""
    figure = Figure(figsize=(9.0, 1.8), dpi=110, facecolor="white")
    FigureCanvasAgg(figure)
    figure.text(0.03, 0.82, _heading(interior), fontsize=12, color=style.INK, va="top")
    figure.text(0.03, 0.55, fill(interior.status, 110), fontsize=10, color=style.LIMIT, va="top")
    return figure


def _marker(interior: TubeInterior) -> float:
    """Return the marker's area in points² at which neighbours of the start's grid overlap."""
    spans = np.ptp(interior.points, axis=0)
    across = max(len(np.unique(np.round(interior.points[:, k], 9))) for k in (0, 1))
    # A cut takes about a half of an axis that is 230 points long either way.
    share = float(np.clip(max(spans / (2 * np.abs(interior.points).max(axis=0))), 0.3, 1.0))
    return float(np.clip((1.05 * 230 * share / across) ** 2, 2.5, 60.0))


def _start(ax: Axes, interior: TubeInterior, colours: Array, direction: int, size: float) -> None:
    q = (interior.points[:, 0] + np.pi) % (2 * np.pi) - np.pi
    ax.scatter(q, interior.points[:, 1], s=size, c=colours, marker="s", linewidths=0)
    _outlines(ax, interior.outlines, direction)


def _returned(ax: Axes, run: Returns, k: int, colours: Array, direction: int, size: float) -> None:
    for way, opacity in ((-direction, 0.3), (direction, 1.0)):
        here = run.arrived[:, k] & (run.direction[:, k] == way)
        points = run.points[here, k]
        ax.scatter(points[:, 0], points[:, 1], s=0.5 * size, c=colours[here], alpha=opacity, linewidths=0)


def _outlines(ax: Axes, outlines: tuple[Outline, ...], direction: int) -> None:
    for outline in outlines:
        closed = np.vstack([outline.vertices, outline.vertices[:1]])
        turns = np.rint((closed[:, 0].min() + closed[:, 0].max()) / 2 / (2 * np.pi))
        colour = style.STABLE if outline.stable else style.UNSTABLE
        opacity = 1.0 if outline.direction == direction else 0.25
        ax.plot(closed[:, 0] - 2 * np.pi * turns, closed[:, 1], color=colour, lw=1.1, alpha=opacity)
    ax.tick_params(labelsize=8, colors=style.CART)
    for spine in ax.spines.values():
        spine.set_color(style.FAINT)


def _title(run: Returns, k: int, name: str) -> str:
    arrived = run.arrived[:, k]
    count = max(1, int(arrived.sum()))
    stable = np.count_nonzero(run.in_stable[arrived, k]) / count
    unstable = np.count_nonzero(run.in_unstable[arrived, k]) / count
    missing = np.count_nonzero(~arrived)
    text = f"{name}\n{unstable:.0%} in unstable, {stable:.0%} in stable cuts"
    return text + (f", {missing} do not return" if missing else "")
