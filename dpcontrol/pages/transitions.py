"""A reference's transfers between equilibria on one page.

It shows a square of pictures, from row to column.
"""

from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.foundation.errors import InputError
from dpcontrol.judge.of_log import reference_view
from dpcontrol.judge.run_view import RunView
from dpcontrol.pages import style
from dpcontrol.pages.film import draw_pose
from dpcontrol.pages.layout import Page
from dpcontrol.pages.planes import Range
from dpcontrol.references.reference import Reference

_NAMES = 0.65
"""Width of the names beside the pictures, inches."""
_POSES, _FAINTEST = 9, 0.12
"""Number of drawn poses of the arms, and opacity of the first."""


def draw_transitions(reference: Reference) -> Figure:
    """Draw each transfer in the cell of its two equilibria.

    Repeated ones are drawn once.

    Raises:
        InputError: the reference has no plan, or no transfers between equilibria.
    """
    content, view = reference.content, reference_view(reference, Path())
    transfers: dict[tuple[str, str], Range] = {}
    for k, way in content.transitions():
        symbol, (begin, end) = content.symbols[k], content.transfers[way]
        transfers[symbol.source, symbol.target] = begin, end
        transfers[symbol.source, symbol.source] = begin, begin
        transfers[symbol.target, symbol.target] = end, end
    if not transfers:
        raise InputError(
            f"{content.itinerary} has no transfers from one equilibrium to another to draw; "
            "plan an itinerary of holds, such as twelve"
        )
    names = [name for name in sorted(content.saddles) if (name, name) in transfers]
    travel = max(float(np.abs(_ways(view, spent)[1]).max()) for spent in transfers.values())
    high = 1.06 * sum(view.arm_lengths)
    box, cell = (high + travel, high), (style.WIDTH - _NAMES) / len(names)
    page = Page(
        content.title,
        "From each row's equilibrium to each column's: the arms at equal times, later ones darker, with the tip's "
        "path. Below each picture: duration, and the cart's greatest distance from its start in the middle.",
    )
    for source in names:
        row = [
            partial(
                _cell,
                view=view,
                transfer=transfers.get((source, target)),
                box=box,
                title=target if source == names[0] else "",
                name=source if target == names[0] else "",
            )
            for target in names
        ]
        page.row(*row, height=cell * box[1] / box[0] + 0.3 + 0.2 * (source == names[0]))
    return page.figure()


def _ways(view: RunView, transfer: Range) -> tuple[list[int], np.ndarray]:
    """Return the ticks of a transfer, and the cart's distances from its start, m."""
    first, last = np.searchsorted(view.time, transfer).clip(0, len(view.time) - 1)
    rows = np.arange(first, last + 1)
    return rows.tolist(), view.pivot[rows] - view.pivot[first]


def _cell(axes: Axes, view: RunView, transfer: Range | None, box: Range, *, title: str, name: str) -> None:
    """Draw one transfer in its cell.

    Its equilibria's names are at the edges of the square.
    """
    half, high = box
    axes.set(xlim=(-half, half), ylim=(-high, high), xticks=[], yticks=[])
    axes.set_aspect("equal")
    axes.spines[:].set_visible(True)
    axes.grid(False)
    axes.set_title(title, loc="center")
    upright = {"rotation": 0, "ha": "right", "va": "center"}
    axes.set_ylabel(name.replace("-", "\n"), fontsize=style.HEAD, color=style.INK, **upright)
    if transfer is None:
        return
    rows, cart = _ways(view, transfer)
    axes.axhline(0.0, color=style.GRID, linewidth=1.0, zorder=0)
    for share in np.linspace(0, 1, _POSES) if len(rows) > 1 else (1.0,):
        k, shade = round(share * (len(rows) - 1)), _FAINTEST + (1 - _FAINTEST) * share**2
        draw_pose(axes, view, (rows[0 if share == 1 else k], rows[k]), at=cart[k], thick=2.4, shade=shade)
    if len(rows) > 1:
        text = f"{transfer[1] - transfer[0]:.3g} s, {100 * np.abs(cart).max():.0f} cm"
        axes.set_xlabel(text, fontsize=style.SMALL, color=style.NOTE, labelpad=2)
    else:
        axes.set_facecolor("#f4f6f8")
