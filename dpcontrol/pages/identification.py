"""An identification on one page.

It shows accuracy on recordings that the fit did not use, and the errors with their correlation.
"""

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.identification.identify import Identification
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, Panel, key
from dpcontrol.pages.panels import quiet

USED, LEFT, _BEFORE, LINE = style.REFERENCE, style.SERIES[1], style.NOTE, style.SERIES[0]


def draw_identification(found: Identification, *, title: str = "Identified arms") -> Figure:
    """Return the page on an identification as a figure.

    Args:
        found: identification to draw.
        title: title of the page.
    """
    errors = Panel(partial(_errors, found=found), 1.4), Panel(partial(_correlation, found=found), 0.9)
    page = Page(title).row(partial(draw_candidates, found=found), height=1.2 + 0.2 * len(found.candidates))
    return page.row(*errors, height=0.9 + max(2.4, 0.19 * len(found.names))).figure()


def draw_candidates(axes: Axes, found: Identification) -> None:
    """Draw each candidate's errors on the segments left out.

    Args:
        axes: panel to draw on.
        found: identification with the candidates.
    """
    rows = [("the starting model", found.started_at), *((" + ".join(c.terms), c.left_out) for c in found.candidates)]
    for y, (_, rms) in enumerate(rows):
        chosen = y == found.chosen + 1
        axes.plot(1e3 * rms, np.full(len(rms), y), "o", color=LEFT if chosen else USED, markersize=4)
        axes.plot(1e3 * np.sqrt((rms**2).mean()), y, "|", color=_BEFORE, markersize=14, markeredgewidth=2)
    axes.set_yticks(range(len(rows)), [name for name, _ in rows], fontsize=style.SMALL)
    axes.invert_yaxis()
    axes.set_xlim(left=0.0)
    quiet(axes, "Terms tried; the chosen ones in colour", x="error (mrad): each segment left out, and | all together")


def _errors(axes: Axes, found: Identification) -> None:
    """Draw the residual angles over time, on the segments left out."""
    shown = [k for k, s in enumerate(found.segments) if not s.used]
    for k in shown:
        residual, period = found.residuals[k], found.swings[k].period
        times = found.segments[k].start + period * np.arange(len(residual))
        for arm in range(residual.shape[1]):
            axes.plot(times, 1e3 * residual[:, arm], linewidth=0.8, color=style.arm_colour(arm))
    axes.axhline(0.0, color=_BEFORE, linewidth=0.6)
    arms = found.residuals[0].shape[1]
    key(axes, [(f"arm {arm + 1}", style.arm_colour(arm)) for arm in range(arms)])
    quiet(axes, "Measured less predicted angle on segments left out (mrad)", x="time in the recording (s)")


def _correlation(axes: Axes, found: Identification) -> None:
    matrix = np.nan_to_num(found.correlation)
    image = axes.imshow(matrix, cmap="RdBu_r", vmin=-1, vmax=1)
    names = [name.partition("/")[0] for name in found.names]
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=style.SMALL)
    axes.set_yticks(range(len(names)), names, fontsize=style.SMALL)
    axes.set_title("Correlation of the errors", loc="left")
    axes.figure.colorbar(image, ax=axes, shrink=0.8)
    axes.grid(False)
