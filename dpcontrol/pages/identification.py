"""Identification on one page: errors before and after, candidates, correlations, profiles; and designs compared."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.identification.fit import Design
from dpcontrol.identification.identify import Identification, LossProfile
from dpcontrol.pages import style
from dpcontrol.pages.page import new_figure, quiet

_USED, _LEFT, _BEFORE, _LINE = style.REFERENCE, style.ARMS[1], style.NOTE, style.ARMS[0]
_PER_ROW = 6


def draw_identification(found: Identification, curves: tuple[LossProfile, ...], *, title: str) -> Figure:
    """Return the page on an identification as a figure."""
    rows = int(np.ceil(len(curves) / _PER_ROW))
    figure = new_figure(16.0, 7.6 + 2.1 * rows, title)
    grid = figure.add_gridspec(
        2 + rows, 12, left=0.06, right=0.985, top=0.92, bottom=0.06, hspace=0.62, wspace=1.2,
        height_ratios=(1.5, 1.5, *([1.0] * rows)),
    )  # fmt: skip
    _candidates(figure.add_subplot(grid[0, 2:7]), found)
    _segments(figure.add_subplot(grid[0, 8:]), found)
    _errors(figure.add_subplot(grid[1, :7]), found)
    _correlation(figure.add_subplot(grid[1, 8:]), found, figure)
    for k, curve in enumerate(curves):
        at = 2 * (k % _PER_ROW)
        _profile(figure.add_subplot(grid[2 + k // _PER_ROW, at : at + 2]), curve, first=k == 0)
    return figure


def _candidates(axes: Axes, found: Identification) -> None:
    """Draw each candidate's errors on the segments left out."""
    rows = [("the starting model", found.started_at), *((" + ".join(c.terms), c.left_out) for c in found.candidates)]
    for y, (_, rms) in enumerate(rows):
        chosen = y == found.chosen + 1
        axes.plot(1e3 * rms, np.full(len(rms), y), "o", color=_LEFT if chosen else _USED, markersize=4)
        axes.plot(1e3 * np.sqrt((rms**2).mean()), y, "|", color=_BEFORE, markersize=14, markeredgewidth=2)
    axes.set_yticks(range(len(rows)), [name for name, _ in rows], fontsize=8)
    axes.invert_yaxis()
    axes.set_xlim(left=0.0)
    quiet(axes, "Terms tried; the chosen ones in colour", x="error (mrad): each segment left out, and | all together")


def _segments(axes: Axes, found: Identification) -> None:
    """Draw the error of each segment, fitted or left out."""
    index = np.array([s.index for s in found.segments])
    used = np.array([s.used for s in found.segments])
    rms = 1e3 * np.array([s.rms for s in found.segments])
    axes.bar(index[used], rms[used], color=_USED, label="used")
    axes.bar(index[~used], rms[~used], color=_LEFT, label="left out")
    axes.legend(fontsize=8, frameon=False)
    quiet(axes, "Error of each segment (mrad, rms)", x="segment")


def _errors(axes: Axes, found: Identification) -> None:
    """Draw the residual angles over time, on the segments left out."""
    shown = [k for k, s in enumerate(found.segments) if not s.used]
    for k in shown:
        residual, period = found.residuals[k], found.swings[k].period
        times = found.segments[k].start + period * np.arange(len(residual))
        for arm in range(residual.shape[1]):
            label = f"arm {arm + 1}" if k == shown[0] else None
            axes.plot(times, 1e3 * residual[:, arm], linewidth=0.8, color=style.arm_colour(arm), label=label)
    axes.axhline(0.0, color=_BEFORE, linewidth=0.6)
    axes.legend(fontsize=8, frameon=False, ncols=3)
    quiet(axes, "Measured less predicted angle on segments left out (mrad)", x="time in the recording (s)")


def _correlation(axes: Axes, found: Identification, figure: Figure) -> None:
    matrix = np.nan_to_num(found.correlation)
    image = axes.imshow(matrix, cmap="RdBu_r", vmin=-1, vmax=1)
    names = [name.partition("/")[0] for name in found.names]
    axes.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=7)
    axes.set_yticks(range(len(names)), names, fontsize=7)
    axes.set_title("Correlation of the errors", fontsize=10, loc="left")
    figure.colorbar(image, ax=axes, shrink=0.8).ax.tick_params(labelsize=7)


def _profile(axes: Axes, curve: LossProfile, *, first: bool) -> None:
    order = np.argsort(np.append(curve.values, curve.best))
    values = np.append(curve.values, curve.best)[order]
    spread = curve.error if np.isfinite(curve.error) and curve.error > 0 else 1.0
    at = (values - curve.best) / spread
    axes.plot(at, 100 * np.append(curve.promised, 0.0)[order], color=_USED, linewidth=2.5, label="linearised")
    axes.plot(at, 100 * np.append(curve.rises, 0.0)[order], "o", color=_LINE, markersize=4, label="fitted again")
    axes.set_xlim(-3.4, 3.4)
    x, y = ("off by (standard errors)", "misfit rises by (%)") if first else ("", "")
    quiet(axes, f"{curve.name} = {curve.best:.4g} ± {curve.error:.1g}", x=x, y=y, size=8)
    if first:
        axes.legend(fontsize=6, frameon=False)


def draw_design(design: Design, *, title: str) -> Figure:
    """Return a figure that compares designs.

    Swings are drawn over their first two angles, the cart's sines over frequency.
    """
    figure = new_figure(14.0, 6.2, f"Accuracy expected from a recording of {design.settings.seconds:g} s: {title}")
    grid = figure.add_gridspec(
        1, 3, left=0.06, right=0.985, top=0.84, bottom=0.12, wspace=0.3, width_ratios=(1.1, 1, 0.9)
    )
    first, second = design.best_pair()
    swings = [e for e in design.experiments if e.kind == "swing"]
    _swing_map(figure.add_subplot(grid[0]), swings, (first, second), figure)
    axes = figure.add_subplot(grid[1])
    best = max(e.information for e in swings if e.usable) if any(e.usable for e in swings) else None
    if best is not None:
        axes.axhline(best, color=_LEFT, linewidth=1.5, label="best free swing")
    for amplitude in design.settings.amplitudes:
        of = [e for e in design.experiments if e.kind == "cart" and e.amplitude == amplitude and e.usable]
        axes.plot(
            [e.frequency for e in of], [e.information for e in of], "o-", markersize=4, label=f"{amplitude:g} m/s²"
        )
    axes.legend(fontsize=8, frameon=False)
    quiet(axes, "From hanging, the cart driven: digits known", x="frequency of the cart's acceleration (Hz)")
    axes = figure.add_subplot(grid[2])
    known = {f"best: {first.text}": first.matrix, f"with {second.text}": first.matrix + second.matrix}
    for k, (label, matrix) in enumerate(known.items()):
        values = np.sqrt(np.diag(np.linalg.pinv(matrix, hermitian=True)))
        axes.barh(np.arange(len(values)) + 0.38 * k, values, height=0.36, color=(_USED, _LEFT)[k], label=label)
    axes.set_yticks(np.arange(len(design.names)) + 0.19, [n.partition("/")[0] for n in design.names], fontsize=8)
    axes.set_xscale("log")
    axes.invert_yaxis()
    axes.legend(fontsize=7, frameon=False, loc="upper center", bbox_to_anchor=(0.4, -0.07))
    quiet(axes, "Relative standard error from rounding alone")
    return figure


def _swing_map(axes: Axes, swings: list, pair: tuple, figure: Figure) -> None:
    if len(swings[0].angles) == 1:
        axes.plot([np.degrees(e.angles[0]) for e in swings], [e.information for e in swings], "o-", color=_LINE)
        labels = ("let go at (degrees)", "")
    else:
        shown = [e for e in swings if len(e.angles) == 2 or abs(e.angles[2]) < 1e-9]
        usable = np.array([e.usable for e in shown])
        x, y = (np.degrees([e.angles[k] for e in shown]) for k in range(2))
        colours = np.array([e.information for e in shown])
        dots = axes.scatter(x[usable], y[usable], c=colours[usable], s=150, marker="s", cmap="viridis")
        axes.plot(x[~usable], y[~usable], "x", color=_USED, markersize=6, label="magnifies errors: not usable")
        for number, one in enumerate(pair, start=1):
            if one.kind == "swing":
                axes.annotate(
                    str(number), np.degrees(one.angles[:2]), color="white", ha="center", va="center", weight="bold"
                )
        figure.colorbar(dots, ax=axes, label="digits known")
        labels = ("inner arm let go at (degrees)", "outer arm (degrees)")
        axes.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(0.0, -0.09))
    quiet(axes, "Free swings from rest; 1, 2: the best pair", x=labels[0], y=labels[1])
