"""An identification on one page.

It shows accuracy on recordings that the fit did not use, errors, and profiles of the loss.
"""

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.identification.identify import Identification, LossProfile
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, Panel, key
from dpcontrol.pages.panels import quiet

USED, LEFT, _BEFORE, LINE = style.REFERENCE, style.SERIES[1], style.NOTE, style.SERIES[0]
_PER_ROW = 4


def draw_identification(
    found: Identification, curves: tuple[LossProfile, ...] = (), *, title: str = "Identified arms"
) -> Figure:
    """Return the page on an identification as a figure.

    Args:
        found: identification to draw.
        curves: profiles of the loss, which take a minute; none by default.
        title: title of the page.
    """
    page = Page(title)
    candidates = 1.0 + 0.2 * (len(found.candidates) + 1)
    page.row(partial(draw_candidates, found=found), height=candidates)
    correlation = Panel(partial(_correlation, found=found), 0.9)
    page.row(Panel(partial(_errors, found=found), 1.4), correlation, height=0.9 + max(2.4, 0.19 * len(found.names)))
    page.grid([partial(_profile, curve=curve) for curve in curves], across=_PER_ROW, height=1.9)
    if curves:
        page.text(
            "Profiles: rise of the misfit over the parameter's error in standard errors. Grey line: linearised; blue "
            "dots: fitted again."
        )
    return page.figure()


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


def _profile(axes: Axes, curve: LossProfile) -> None:
    order = np.argsort(np.append(curve.values, curve.best))
    values = np.append(curve.values, curve.best)[order]
    spread = curve.error if np.isfinite(curve.error) and curve.error > 0 else 1.0
    at = (values - curve.best) / spread
    axes.plot(at, 100 * np.append(curve.promised, 0.0)[order], color=USED, linewidth=2.5)
    axes.plot(at, 100 * np.append(curve.rises, 0.0)[order], "o", color=LINE, markersize=4)
    axes.set_xlim(-3.4, 3.4)
    quiet(axes, f"{curve.name} = {curve.best:.4g} ± {curve.error:.1g}", y="misfit rises by (%)")
