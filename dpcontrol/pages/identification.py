"""Identification on one page: errors before and after, candidates, correlations, profiles; and designs compared."""

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.identification.fit import Design
from dpcontrol.identification.identify import Identification, LossProfile
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, Panel, key
from dpcontrol.pages.panels import name_curves, quiet

_USED, _LEFT, _BEFORE, _LINE = style.REFERENCE, style.SERIES[1], style.NOTE, style.SERIES[0]
_PER_ROW = 4


def draw_identification(found: Identification, curves: tuple[LossProfile, ...], *, title: str) -> Figure:
    """Return the page on an identification as a figure."""
    page = Page(title)
    candidates = 1.0 + 0.2 * (len(found.candidates) + 1)
    page.row(
        Panel(partial(draw_candidates, found=found), 1.4), partial(_segments, found=found), height=max(candidates, 2.4)
    )
    correlation = Panel(partial(_correlation, found=found), 0.9)
    page.row(Panel(partial(_errors, found=found), 1.4), correlation, height=0.9 + max(2.4, 0.19 * len(found.names)))
    for first in range(0, len(curves), _PER_ROW):
        some = [partial(_profile, curve=curve) for curve in curves[first : first + _PER_ROW]]
        page.row(*some, *[_nothing] * (_PER_ROW - len(some)), height=1.9)
    if curves:
        page.text(
            "Profiles: rise of the misfit over the parameter's error in standard errors. Grey line: linearised; blue "
            "dots: fitted again."
        )
    return page.figure()


def _nothing(axes: Axes) -> None:
    axes.axis("off")


def draw_candidates(axes: Axes, found: Identification) -> None:
    """Draw each candidate's errors on the segments left out."""
    rows = [("the starting model", found.started_at), *((" + ".join(c.terms), c.left_out) for c in found.candidates)]
    for y, (_, rms) in enumerate(rows):
        chosen = y == found.chosen + 1
        axes.plot(1e3 * rms, np.full(len(rms), y), "o", color=_LEFT if chosen else _USED, markersize=4)
        axes.plot(1e3 * np.sqrt((rms**2).mean()), y, "|", color=_BEFORE, markersize=14, markeredgewidth=2)
    axes.set_yticks(range(len(rows)), [name for name, _ in rows], fontsize=style.SMALL)
    axes.invert_yaxis()
    axes.set_xlim(left=0.0)
    quiet(axes, "Terms tried; the chosen ones in colour", x="error (mrad): each segment left out, and | all together")


def _segments(axes: Axes, found: Identification) -> None:
    """Draw the error of each segment, fitted or left out."""
    index = np.array([s.index for s in found.segments])
    used = np.array([s.used for s in found.segments])
    rms = 1e3 * np.array([s.rms for s in found.segments])
    axes.bar(index[used], rms[used], color=_USED)
    axes.bar(index[~used], rms[~used], color=_LEFT)
    key(axes, [("used", {"color": _USED, "linewidth": 6}), ("left out", {"color": _LEFT, "linewidth": 6})])
    quiet(axes, "Error of each segment (mrad, rms)", x="segment")


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
    axes.set_title("Correlation of the errors", fontsize=style.HEAD, loc="left")
    axes.figure.colorbar(image, ax=axes, shrink=0.8).ax.tick_params(labelsize=style.SMALL)


def _profile(axes: Axes, curve: LossProfile) -> None:
    order = np.argsort(np.append(curve.values, curve.best))
    values = np.append(curve.values, curve.best)[order]
    spread = curve.error if np.isfinite(curve.error) and curve.error > 0 else 1.0
    at = (values - curve.best) / spread
    axes.plot(at, 100 * np.append(curve.promised, 0.0)[order], color=_USED, linewidth=2.5)
    axes.plot(at, 100 * np.append(curve.rises, 0.0)[order], "o", color=_LINE, markersize=4)
    axes.set_xlim(-3.4, 3.4)
    quiet(axes, f"{curve.name} = {curve.best:.4g} ± {curve.error:.1g}", y="misfit rises by (%)")


def draw_design(design: Design, *, title: str) -> Figure:
    """Return a figure that compares designs.

    Swings are drawn over their first two angles, the cart's sines over frequency.
    """
    first, second = design.best_pair()
    swings = [e for e in design.experiments if e.kind == "swing"]
    page = Page(f"Accuracy expected from a recording of {design.settings.seconds:g} s: {title}")
    page.row(
        Panel(partial(_swing_map, swings=swings, pair=(first, second)), 1.1),
        partial(_sines, design=design, swings=swings),
        partial(_accuracy, design=design, pair=(first, second)),
        height=4.4,
    )
    return page.figure()


def _sines(axes: Axes, design: Design, swings: list) -> None:
    best = max((e.information for e in swings if e.usable), default=None)
    quiet(axes, "From hanging, the cart driven: digits known", x="frequency of the cart's acceleration (Hz)")
    ends = []
    if best is not None:
        axes.axhline(best, color=style.INK, linewidth=1.5, linestyle=style.DASHED)
        ends.append((best, "best swing", style.INK))
    for k, amplitude in enumerate(design.settings.amplitudes):
        of = [e for e in design.experiments if e.kind == "cart" and e.amplitude == amplitude and e.usable]
        colour = style.SERIES[k % len(style.SERIES)]
        axes.plot([e.frequency for e in of], [e.information for e in of], "o-", markersize=4, color=colour)
        if of:
            ends.append((of[-1].information, f"{amplitude:g} m/s²", colour))
    name_curves(axes, ends)


def _accuracy(axes: Axes, design: Design, pair: tuple) -> None:
    first, second = pair
    for k, matrix in enumerate((first.matrix, first.matrix + second.matrix)):
        values = np.sqrt(np.diag(np.linalg.pinv(matrix, hermitian=True)))
        axes.barh(np.arange(len(values)) + 0.38 * k, values, height=0.36, color=(_USED, _LEFT)[k])
    names = [n.partition("/")[0] for n in design.names]
    axes.set_yticks(np.arange(len(names)) + 0.19, names, fontsize=style.SMALL)
    axes.set_xscale("log")
    axes.invert_yaxis()
    quiet(axes, f"Relative standard error from rounding alone. Grey: {first.text}. Colour: with {second.text}")


def _swing_map(axes: Axes, swings: list, pair: tuple) -> None:
    if len(swings[0].angles) == 1:
        axes.plot([np.degrees(e.angles[0]) for e in swings], [e.information for e in swings], "o-", color=_LINE)
        labels = ("let go at (degrees)", "")
    else:
        shown = [e for e in swings if len(e.angles) == 2 or abs(e.angles[2]) < 1e-9]
        usable = np.array([e.usable for e in shown])
        x, y = (np.degrees([e.angles[k] for e in shown]) for k in range(2))
        colours = np.array([e.information for e in shown])
        dots = axes.scatter(x[usable], y[usable], c=colours[usable], s=150, marker="s", cmap="viridis")
        axes.plot(x[~usable], y[~usable], "x", color=_USED, markersize=6)
        for number, one in enumerate(pair, start=1):
            if one.kind == "swing":
                axes.annotate(
                    str(number),
                    np.degrees(one.angles[:2]),
                    color="white",
                    ha="center",
                    va="center",
                    weight="bold",
                    fontsize=style.TEXT,
                )
        bar = axes.figure.colorbar(dots, ax=axes)
        bar.ax.tick_params(labelsize=style.SMALL)
        bar.ax.set_title("digits", fontsize=style.SMALL)
        labels = ("inner arm let go at (degrees)", "outer arm (degrees)")
    quiet(axes, "Free swings from rest; 1, 2: the best pair; crosses magnify errors", x=labels[0], y=labels[1])
