"""Identification on one page: accuracy on recordings that the fit did not use."""

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.identification.identify import Identification
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, Panel, key

USED, LEFT, _BEFORE, LINE = style.REFERENCE, style.SERIES[1], style.NOTE, style.SERIES[0]


def draw_identification(identification: Identification, *, title: str = "Identified arms") -> Figure:
    """Return the page on an identification as a figure: candidates, prediction errors, and errors' correlations.

    Args:
        identification: identification to draw.
        title: title of the page.
    """
    errors = (
        Panel(partial(_errors, identification=identification), 1.4),
        Panel(partial(_correlation, identification=identification), 0.9),
    )
    page = Page(title).row(
        partial(draw_candidates, identification=identification), height=1.2 + 0.2 * len(identification.candidates)
    )
    return page.row(*errors, height=0.9 + max(2.4, 0.19 * len(identification.names))).figure()


def draw_candidates(axes: Axes, identification: Identification) -> None:
    """Draw the prediction errors of each candidate, a set of model terms, on the segments that no fit used.

    A row has a dot for the rms error of each segment and a bar for that of all. The first row is the starting model, so
    the row of a candidate is one more than its index.

    Args:
        axes: panel to draw on.
        identification: identification with the candidates.
    """
    rows = [
        ("the starting model", identification.started_at),
        *((" + ".join(candidate.terms), candidate.left_out) for candidate in identification.candidates),
    ]
    for y, (_, rms) in enumerate(rows):
        is_chosen = y == identification.chosen + 1
        axes.plot(1e3 * rms, np.full(len(rms), y), "o", color=LEFT if is_chosen else USED, markersize=4)
        axes.plot(1e3 * np.sqrt((rms**2).mean()), y, "|", color=_BEFORE, markersize=14, markeredgewidth=2)
    axes.set(
        title="Terms tried; the chosen ones in colour",
        xlabel="error (mrad): each segment left out, and | all together",
        xlim=(0.0, None),
        yticks=range(len(rows)),
        yticklabels=[name for name, _ in rows],
    )
    axes.invert_yaxis()


def _errors(axes: Axes, identification: Identification) -> None:
    """Draw the measured less the predicted angles over time, mrad, on the segments that the fit did not use."""
    segments_left_out = [k for k, segment in enumerate(identification.segments) if not segment.used]
    for k in segments_left_out:
        residual, period = identification.residuals[k], identification.swings[k].period
        times = identification.segments[k].start + period * np.arange(len(residual))
        for arm in range(residual.shape[1]):
            axes.plot(times, 1e3 * residual[:, arm], linewidth=0.8, color=style.arm_colour(arm))
    axes.axhline(0.0, color=_BEFORE, linewidth=0.6)
    key(axes, [(f"arm {arm + 1}", style.arm_colour(arm)) for arm in range(identification.arms.count)])
    axes.set(title="Measured less predicted angle on segments left out (mrad)", xlabel="time in the recording (s)")


def _correlation(axes: Axes, identification: Identification) -> None:
    """Draw the correlation matrix of the errors of the identified parameters, from -1 in blue to 1 in red."""
    image = axes.imshow(np.nan_to_num(identification.correlation), cmap="RdBu_r", vmin=-1, vmax=1)
    names = [name.partition("/")[0] for name in identification.names]
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=style.SMALL)
    axes.set(title="Correlation of the errors", yticks=range(len(names)), yticklabels=names)
    axes.figure.colorbar(image, ax=axes, shrink=0.8)
    axes.grid(False)
