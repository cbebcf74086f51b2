"""A reference's transfers between equilibria on one page.

It shows a square of pictures, from row to column.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page
from dpcontrol.pages.panels import draw_fading
from dpcontrol.pages.planes import arm_points
from dpcontrol.references.reference import Reference

Point = tuple[float, float]
_NAMES = 0.65
"""Width of the names beside the pictures, inches."""
_POSES, _TRACE = 9, 240
"""Number of drawn poses of the arms, and points of their tip's path."""
_FAINTEST = 0.12


def draw_transitions(reference: Reference) -> Figure:
    """Draw each transfer in the cell of its two equilibria.

    Repeated ones are drawn once.

    Raises:
        InputError: the reference has no plan, or no transfers between equilibria.
    """
    content = reference.content
    arm_lengths = content.origin.parameters.length
    n = len(arm_lengths)
    motions: dict[tuple[str, str], tuple[float, Array]] = {}
    for k, way in content.transitions():
        symbol, (begin, end) = content.symbols[k], content.transfers[way]
        states = reference.state(np.linspace(begin, end, _TRACE))
        # The cart's starting position is the middle of its picture.
        moved = np.column_stack([states[:, :n], states[:, 2 * n] - states[0, 2 * n]])
        motions[symbol.source, symbol.target] = end - begin, moved
    if not motions:
        raise InputError(
            f"{content.itinerary} has no transfers from one equilibrium to another to draw; "
            "plan an itinerary of holds, such as twelve"
        )
    names = [name for name in sorted(content.saddles) if any(name in pair for pair in motions)]
    for name in names:
        motions[name, name] = 0.0, np.append(content.saddles[name].angles, 0.0)[None]
    places = np.concatenate([_points(motion, arm_lengths).reshape(-1, 2) for _, motion in motions.values()])
    half, high = np.abs(places).max(axis=0) + 0.06 * sum(arm_lengths)
    cell = (style.WIDTH - _NAMES) / len(names)
    page = Page(
        content.title,
        "From each row's equilibrium to each column's: the arms at equal times, later ones darker, with the tip's "
        "path. Below each picture: duration, and the cart's greatest distance from its start in the middle.",
    )
    for source in names:
        row = [
            partial(
                _cell,
                motion=motions.get((source, target)),
                arm_lengths=arm_lengths,
                box=(half, high),
                title=target if source == names[0] else "",
                name=source if target == names[0] else "",
            )
            for target in names
        ]
        page.row(*row, height=cell * high / half + 0.3 + 0.2 * (source == names[0]))
    return page.figure()


def _cell(
    axes: Axes,
    motion: tuple[float, Array] | None,
    arm_lengths: Sequence[float],
    box: Point,
    *,
    title: str,
    name: str,
) -> None:
    """Draw one transfer in its cell.

    Its equilibria's names are at the edges of the square.
    """
    (half, high), n = box, len(arm_lengths)
    axes.set(xlim=(-half, half), ylim=(-high, high), xticks=[], yticks=[])
    axes.set_aspect("equal")
    axes.spines[:].set_visible(True)
    axes.grid(False)
    axes.set_title(title, loc="center")
    upright = {"rotation": 0, "ha": "right", "va": "center"}
    axes.set_ylabel(name.replace("-", "\n"), fontsize=style.HEAD, color=style.INK, **upright)
    if motion is None:
        return
    seconds, states = motion
    _draw_motion(axes, states, arm_lengths)
    if seconds:
        text = f"{seconds:.3g} s, {100 * np.abs(states[:, n]).max():.0f} cm"
        axes.set_xlabel(text, fontsize=style.SMALL, color=style.NOTE, labelpad=2)
    else:
        axes.set_facecolor("#f4f6f8")


def _points(motion: Array, arm_lengths: Sequence[float]) -> Array:
    """Return pivot, elbows and tip of a motion (K, n+1, 2).

    The motion (K, n + 1) has angles and cart.
    """
    points = arm_points(motion[:, :-1], arm_lengths)
    points[..., 0] += motion[:, -1:]
    return points


def _draw_motion(axes: Axes, motion: Array, arm_lengths: Sequence[float]) -> None:
    """Draw the arms at equal times, and their tip's path.

    The motion (K, n + 1) has angles and cart.
    """
    points, n = _points(motion, arm_lengths), len(arm_lengths)
    rows = np.unique(np.linspace(0, len(motion) - 1, _POSES).astype(int))
    axes.axhline(0.0, color=style.GRID, linewidth=1.0, zorder=0)
    draw_fading(axes, points[:, -1], style.arm_colour(n - 1), shades=(_FAINTEST, 0.8), linewidth=0.7)
    for row in rows:
        shade = 1.0 if len(rows) == 1 else _FAINTEST + (1 - _FAINTEST) * (row / rows[-1]) ** 2
        size = 0.045 * sum(arm_lengths)
        cart = Rectangle((motion[row, -1] - 2 * size, -size), 4 * size, 2 * size, color=style.CART, lw=0)
        cart.set(alpha=0.8 * shade, zorder=1 + shade)
        axes.add_patch(cart)
        for arm in range(n):
            # Outer arms are drawn narrower, so that overlapping arms remain visible.
            look = {"linewidth": 3.2 - 2.0 * arm / max(n - 1, 1), "solid_capstyle": "round", "zorder": 2 + shade}
            axes.plot(*points[row, arm : arm + 2].T, color=style.arm_colour(arm), alpha=shade, **look)
