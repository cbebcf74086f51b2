"""A reference's transfers between equilibria on one page: a square of pictures, from row to column."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.pages import style
from dpcontrol.pages.page import new_figure
from dpcontrol.pages.series import arm_points
from dpcontrol.references.reference import ReferenceSummary, plan_notes, transitions_in

_WIDE, _NAMES, _HEAD, _EDGE = 13.0, 0.65, 0.95, 0.12
"""Inches: page, names beside the pictures, header; and the margin."""
_POSES, _TRACE = 9, 240
"""Number of drawn poses of the arms, and points of their tip's path."""
_FAINTEST = 0.12


def draw_transitions(summary: ReferenceSummary) -> Figure:
    """Draw each transfer in the cell of its two equilibria.

    Repeated ones are drawn once.

    Raises:
        InputError: the reference has no transfers between equilibria, or does not name its arms.
    """
    reference = summary.reference
    if summary.arms is None:
        raise InputError("the reference does not name the arms that it was made for: plan the itinerary again")
    notes, arm_lengths = plan_notes(reference), summary.arms.length
    n = len(arm_lengths)
    motions: dict[tuple[str, str], tuple[float, Array]] = {}
    for k, way in transitions_in(notes):
        symbol, (begin, end) = notes["symbols"][k], notes["transfers"][way]
        states = reference.state(np.linspace(begin, end, _TRACE))
        # The cart's starting position is the middle of its picture.
        moved = np.column_stack([states[:, :n], states[:, 2 * n] - states[0, 2 * n]])
        motions[symbol["source"], symbol["target"]] = end - begin, moved
    if not motions:
        raise InputError(
            f"{notes.get('itinerary') or 'this reference'} has no transfers from one equilibrium to another to draw; "
            "plan an itinerary of holds, such as twelve"
        )
    names = [name for name in sorted(notes["saddles"]) if any(name in pair for pair in motions)]
    for name in names:
        motions[name, name] = 0.0, np.append(notes["saddles"][name]["angles"], 0.0)[None]
    places = np.concatenate([_points(motion, arm_lengths).reshape(-1, 2) for _, motion in motions.values()])
    reach = sum(arm_lengths)
    half, high = np.abs(places).max(axis=0) + 0.06 * reach
    cell = (_WIDE - _NAMES - _EDGE) / len(names)
    tall = cell * high / half
    height = _HEAD + tall * len(names) + _EDGE
    figure = new_figure(_WIDE, height, notes["title"] or notes["itinerary"])
    caption = (
        "From each row's equilibrium to each column's: the arms at equal times, later ones darker, the tip's path;\n"
        "duration, and the cart's greatest distance from its start in the middle. All pictures share one scale."
    )
    figure.text(0.015, 1 - 0.42 / height, caption, va="top", fontsize=9.5, color=style.NOTE)
    for i, source in enumerate(names):
        bottom = 1 - (_HEAD + (i + 1) * tall) / height
        beside = {"va": "center", "fontsize": 9.5, "color": style.INK}
        figure.text(0.015, bottom + tall / height / 2, source.replace("-", "\n"), **beside)
        for j, target in enumerate(names):
            left = (_NAMES + j * cell) / _WIDE
            if i == 0:
                above = {"ha": "center", "va": "bottom", "fontsize": 9.5, "color": style.INK}
                figure.text(left + cell / _WIDE / 2, bottom + (tall + 0.04) / height, target, **above)
            axes = figure.add_axes((left, bottom, cell / _WIDE, tall / height))
            axes.set(xlim=(-half, half), ylim=(-high, high), xticks=[], yticks=[])
            for spine in axes.spines.values():
                spine.set_color(style.FAINT)
            if source == target:
                axes.set_facecolor("#f4f6f8")
            if (source, target) in motions:
                seconds, motion = motions[source, target]
                _draw_motion(axes, motion, arm_lengths)
                if seconds:
                    text = f"{seconds:.3g} s, {100 * np.abs(motion[:, n]).max():.0f} cm"
                    axes.text(0.03, 0.04, text, transform=axes.transAxes, fontsize=7.5, color=style.NOTE)
    return figure


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
    steps = np.stack([points[:-1, -1], points[1:, -1]], axis=1)
    shades = [(style.arm_colour(n - 1), float(shade)) for shade in np.linspace(_FAINTEST, 0.8, len(steps))]
    axes.add_collection(LineCollection(list(steps), colors=shades, linewidths=0.7))
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
