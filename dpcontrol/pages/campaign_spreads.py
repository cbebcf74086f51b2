"""Spreads of a campaign's runs: values of completed ones and of others."""

from collections.abc import Sequence
from textwrap import shorten

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from dpcontrol.judge.campaign import CampaignSummary
from dpcontrol.pages import style
from dpcontrol.pages.panels import empty, quiet


def group_colours(summary: CampaignSummary, labels: Sequence[str]) -> list[str]:
    order = list(dict.fromkeys(group.family for group in summary.groups))
    return [style.RUNS[order.index(label) % len(style.RUNS)] for label in labels]


def draw_spread(axes: Axes, summary: CampaignSummary, name: str, title: str) -> None:
    if name not in summary.spreads:
        empty(axes, title, f"the table has no {name}")
        return
    families = dict(list(summary.spreads[name].items())[: len(style.RUNS)])
    every = 1e3 * np.concatenate([values for both in families.values() for values in both])
    edges = np.linspace(float(every.min()), float(np.quantile(every, 0.99)) + 1e-9, 31)
    if len(families) == 1:
        good, bad = next(iter(families.values()))
        alone = "all completed" if len(good) else "all failed"
        quiet(axes, f"{title}: {'completed green, failed red' if len(good) and len(bad) else alone}", y="runs")
        _bars(axes, good, bad, edges, colour=style.GOOD)
        axes.yaxis.set_major_locator(MaxNLocator(3, integer=True))
        return
    hidden = len(summary.spreads[name]) - len(families)
    more = f", first {len(families)} of {len(families) + hidden} groups" if hidden else ""
    quiet(axes, f"{title}: failed red{more}")
    # Each group has a row as high as its fullest bin: a common one would hide the differences.
    colours = group_colours(summary, list(families))
    for row, ((family, (good, bad)), colour) in enumerate(zip(families.items(), colours, strict=True)):
        _bars(axes, good, bad, edges, colour=colour, row=-row)
        name = shorten(family, 40, placeholder=" …")
        look = {"ha": "right", "va": "top", "fontsize": style.SMALL, "color": colour}
        box = {"color": style.PAPER, "alpha": 0.7, "pad": 1, "linewidth": 0}
        axes.text(0.99, 0.9 - row, name, transform=axes.get_yaxis_transform(), bbox=box, **look)
    axes.set(yticks=[-row for row in range(len(families))], yticklabels=[], ylim=(1 - len(families), 1))


def _bars(
    axes: Axes,
    good: NDArray[np.float64],
    bad: NDArray[np.float64],
    edges: NDArray[np.float64],
    *,
    colour: str,
    row: int | None = None,
) -> None:
    """Draw a histogram, failed runs stacked on completed ones.

    A given row sets the scale.
    """
    counts = [np.histogram(np.clip(1e3 * values, edges[0], edges[-1]), edges)[0] for values in (good, bad)]
    scale = 1.0 if row is None else 0.85 / max(int(np.add(*counts).max()), 1)
    look = {"width": np.diff(edges), "align": "edge", "alpha": 0.75}
    axes.bar(edges[:-1], counts[0] * scale, bottom=row or 0, color=colour, **look)
    axes.bar(edges[:-1], counts[1] * scale, bottom=(row or 0) + counts[0] * scale, color=style.LIMIT, **look)
