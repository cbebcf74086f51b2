"""A campaign's summary on one page. Empty panels, such as failures, are omitted."""

from collections.abc import Sequence
from textwrap import shorten

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter
from numpy.typing import NDArray

from dpcontrol.judge.campaign import CampaignSummary
from dpcontrol.pages import style
from dpcontrol.pages.page import new_figure, quiet

_TITLES = {"max_cart_position": "Cart's largest distance (mm)", "rms_tracking_error": "Tracking (mrad rms)"}
_MOST = 28


def draw_campaign(summary: CampaignSummary) -> Figure:
    """Return a campaign's page as a figure."""
    figure = new_figure(15.0, 9.6, f"Campaign {summary.path.stem}")
    colour = style.GOOD if summary.share.rate >= 0.5 else style.LIMIT
    figure.text(0.015, 0.935, summary.status, fontsize=11, color=colour, va="center")
    failed, levels = bool(summary.failed_symbols or summary.reasons), bool(summary.levels)
    wide = (0.36 if len(summary.groups) < 2 else 0.30) if levels else 0.70
    _draw_groups(figure.add_axes((0.22, 0.55, wide, 0.32)), summary)
    if levels:
        _draw_levels(figure.add_axes((0.66, 0.55, 0.325, 0.32)), summary)
    if failed:
        _draw_symbols(figure.add_axes((0.045, 0.075, 0.27, 0.36)), summary)
        _draw_reasons(figure.add_axes((0.62, 0.285, 0.365, 0.15)), summary)
    for k, (name, title) in enumerate(_TITLES.items()):
        place = (0.37 + 0.32 * k, 0.075, 0.295, 0.13) if failed else (0.045 + 0.49 * k, 0.075, 0.45, 0.34)
        _spread(figure.add_axes(place), summary, name, title)
    return figure


def _draw_groups(axes: Axes, summary: CampaignSummary) -> None:
    # Controllers of one kind of trouble are adjacent.
    groups = sorted(summary.groups, key=lambda group: (group.names.get("kind", ""), -group.share.rate))[:_MOST]
    hidden = len(summary.groups) - len(groups)
    more = f"… and {hidden} groups more" if hidden else ""
    quiet(axes, "Runs completed; lines: Wilson's 95 % interval", x=more)
    size = 7.0 if len(groups) > 18 else 8.5
    for k, (group, colour) in enumerate(zip(groups, _colours(summary, [g.family for g in groups]), strict=True)):
        share = group.share
        axes.barh(k, share.rate, color=colour, height=0.62, alpha=0.85)
        axes.plot([share.low, share.high], [k, k], color=style.INK, linewidth=1.4)
        axes.text(1.02, k, f"{share.successes} of {share.runs}", va="center", fontsize=size, color=style.NOTE)
    axes.set_yticks(range(len(groups)), [shorten(g.label, 44, placeholder=" …") for g in groups], fontsize=size)
    axes.set(xlim=(0, 1), ylim=(max(len(groups) - 0.4, 0.6), -0.6))
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))


def _colours(summary: CampaignSummary, labels: Sequence[str]) -> list[str]:
    order = list(dict.fromkeys(group.family for group in summary.groups))
    return [style.RUNS[order.index(label) % len(style.RUNS)] for label in labels]


def _draw_levels(axes: Axes, summary: CampaignSummary) -> None:
    standard = summary.axis == "level"
    text = "level of each kind of trouble" if standard else "mismatch, share of each parameter"
    over = "over the level, of all kinds" if standard else "over the mismatch"
    quiet(axes, f"Runs completed {over}", x=text)
    axes.set_ylim(-0.03, 1.03)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    labels = list(dict.fromkeys(level.label for level in summary.levels))
    shown = labels[: len(style.RUNS)]
    reach = max(level.high for level in summary.levels) - min(level.low for level in summary.levels)
    for k, (label, colour) in enumerate(zip(shown, _colours(summary, shown), strict=True)):
        levels = [level for level in summary.levels if level.label == label]
        # Groups are offset slightly, so that their intervals do not overlap.
        x = np.array([(level.low + level.high) / 2 for level in levels]) + 0.006 * reach * (k - len(shown) / 2)
        low, rates, high = np.array([(level.share.low, level.share.rate, level.share.high) for level in levels]).T
        spread = np.maximum([rates - low, high - rates], 0)
        axes.errorbar(x, rates, yerr=spread, color=colour, marker="o", markersize=4.5, linewidth=1.3, capsize=2)
    if standard:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    else:
        axes.xaxis.set_major_formatter(PercentFormatter(1.0))
    if len(labels) > 1:
        axes.set_title("colours as on the left", loc="right", fontsize=8.5, color=style.NOTE)
    if len(labels) > len(shown):
        axes.text(0.99, 1.01, f"first {len(shown)} of {len(labels)} groups", transform=axes.transAxes, fontsize=8,
                  ha="right", color=style.NOTE)  # fmt: skip


def _draw_symbols(axes: Axes, summary: CampaignSummary) -> None:
    quiet(axes, "Failed runs by the symbol that was not done", x="symbol, from 1; beyond the last: not held to the end")
    numbers = sorted({symbol for _, symbol, _ in summary.failed_symbols})
    bottoms = dict.fromkeys(numbers, 0)
    labels = list(dict.fromkeys(label for label, _, _ in summary.failed_symbols))
    colours = dict(zip(labels, _colours(summary, labels), strict=True))
    for label, symbol, count in summary.failed_symbols:
        axes.bar(symbol, count, bottom=bottoms[symbol], color=colours[label], alpha=0.85)
        bottoms[symbol] += count
    axes.set_xticks(numbers, ["not named" if symbol == 0 else str(symbol) for symbol in numbers])
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylim(0, 1.1 * max(bottoms.values()) + 0.5)


def _draw_reasons(axes: Axes, summary: CampaignSummary) -> None:
    quiet(axes, "Failed runs by reason, numbers left out")
    shown = list(summary.reasons[:6])
    rest = sum(count for _, count in summary.reasons[6:])
    shown += [("other reasons", rest)] if rest else []
    texts = [shorten(text, 62, placeholder=" …") for text, _ in shown]
    axes.barh(range(len(shown)), [count for _, count in shown], color=style.LIMIT, alpha=0.7, height=0.62)
    axes.set_yticks(range(len(shown)), texts)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylim(max(len(shown) - 0.4, 0.6), -0.6)


def _spread(axes: Axes, summary: CampaignSummary, name: str, title: str) -> None:
    if name not in summary.spreads:
        quiet(axes, title)
        axes.text(0.5, 0.5, f"the table has no {name}", transform=axes.transAxes, ha="center", color=style.NOTE)
        axes.set(xticks=[], yticks=[])
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
    colours = _colours(summary, list(families))
    for row, ((family, (good, bad)), colour) in enumerate(zip(families.items(), colours, strict=True)):
        _bars(axes, good, bad, edges, colour=colour, row=-row)
        name = shorten(family, 40, placeholder=" …")
        axes.text(0.99, 0.9 - row, name, transform=axes.get_yaxis_transform(), fontsize=7.5, ha="right", va="top",
                  color=colour, bbox={"color": "white", "alpha": 0.7, "pad": 1, "linewidth": 0})  # fmt: skip
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
    """Draw a histogram, failed runs stacked on completed ones; a given row sets the scale."""
    counts = [np.histogram(np.clip(1e3 * values, edges[0], edges[-1]), edges)[0] for values in (good, bad)]
    scale = 1.0 if row is None else 0.85 / max(int(np.add(*counts).max()), 1)
    look = {"width": np.diff(edges), "align": "edge", "alpha": 0.75}
    axes.bar(edges[:-1], counts[0] * scale, bottom=row or 0, color=colour, **look)
    axes.bar(edges[:-1], counts[1] * scale, bottom=(row or 0) + counts[0] * scale, color=style.LIMIT, **look)
