"""Planned experiments on one page: which recordings would identify the arms best."""

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.identification.fit import Design
from dpcontrol.pages import style
from dpcontrol.pages.identification import LEFT, LINE, USED
from dpcontrol.pages.layout import Page, Panel
from dpcontrol.pages.panels import name_curves, quiet


def draw_design(design: Design, *, title: str) -> Figure:
    """Return a figure that compares designs.

    Swings are drawn over their first two angles, the cart's sines over frequency.

    Args:
        design: designs to compare.
        title: end of the page's title.
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
        axes.barh(np.arange(len(values)) + 0.38 * k, values, height=0.36, color=(USED, LEFT)[k])
    names = [n.partition("/")[0] for n in design.names]
    axes.set_yticks(np.arange(len(names)) + 0.19, names, fontsize=style.SMALL)
    axes.set_xscale("log")
    axes.invert_yaxis()
    quiet(axes, f"Relative standard error from rounding alone. Grey: {first.text}. Colour: with {second.text}")


def _swing_map(axes: Axes, swings: list, pair: tuple) -> None:
    if len(swings[0].angles) == 1:
        axes.plot([np.degrees(e.angles[0]) for e in swings], [e.information for e in swings], "o-", color=LINE)
        labels = ("let go at (degrees)", "")
    else:
        shown = [e for e in swings if len(e.angles) == 2 or abs(e.angles[2]) < 1e-9]
        usable = np.array([e.usable for e in shown])
        x, y = (np.degrees([e.angles[k] for e in shown]) for k in range(2))
        colours = np.array([e.information for e in shown])
        dots = axes.scatter(x[usable], y[usable], c=colours[usable], s=150, marker="s", cmap="viridis")
        axes.plot(x[~usable], y[~usable], "x", color=USED, markersize=6)
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
        bar.ax.set_title("digits", fontsize=style.SMALL)
        labels = ("inner arm let go at (degrees)", "outer arm (degrees)")
    quiet(axes, "Free swings from rest; 1, 2: the best pair; crosses magnify errors", x=labels[0], y=labels[1])
