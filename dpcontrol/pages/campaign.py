"""A campaign on one page, with its completed and failed runs.

It shows the shares of completed runs, and where and why the others failed.
"""

from collections.abc import Sequence
from functools import partial
from textwrap import shorten

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter
from numpy.typing import NDArray

from dpcontrol.judge.campaign import CampaignSummary, Group
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, Panel
from dpcontrol.pages.panels import Bar, bars, empty, name_curves, name_rows, quiet

_TITLES = {"max_cart_position": "Cart's largest distance (mm)", "rms_tracking_error": "Tracking (mrad rms)"}
_MOST, _APART = 28, 6
"""Most bars, and most mismatches that are drawn as separate bars."""


def draw_campaign(summary: CampaignSummary) -> Figure:
    """Return a campaign's page as a figure."""
    page = Page(f"Campaign {summary.path.stem}", summary.status, summary.good)
    groups = min(len(_bars_of(summary)), _MOST)
    above: list[Panel] = [Panel(partial(draw_groups, summary=summary), 1.3)]
    if summary.levels:
        above.append(Panel(partial(_draw_levels, summary=summary)))
    page.row(*above, height=max(2.6, 0.8 + 0.21 * groups))
    if summary.failed_symbols or summary.reasons:
        failures = [Panel(partial(_draw_symbols, summary=summary)), Panel(partial(_draw_reasons, summary=summary), 1.3)]
        page.row(*failures, height=2.4)
    rows = max((len(_spreads(summary, name)) for name in _TITLES), default=0)
    spreads = [partial(_draw_spread, summary=summary, name=name, title=title) for name, title in _TITLES.items()]
    return page.row(*spreads, height=0.9 + 0.21 * max(rows, 2)).figure()


def _spreads(summary: CampaignSummary, name: str) -> list[tuple[str, NDArray[np.float64], str]]:
    """Return the values of the completed and of the failed runs of each group, with their labels and colours."""
    families = dict(list(summary.spreads.get(name, {}).items())[: len(style.RUNS)])
    rows = []
    for (family, (good, bad)), colour in zip(families.items(), _group_colours(summary, list(families)), strict=True):
        rows += [(family, good, colour), (f"{family}, failed".removeprefix(", "), bad, style.LIMIT)]
    return [row for row in rows if len(row[1])]


def _draw_spread(axes: Axes, summary: CampaignSummary, name: str, title: str) -> None:
    rows = _spreads(summary, name)
    if not rows:
        empty(axes, title, f"the table has no {name}")
        return
    quiet(axes, f"{title}: median, middle half and range; failed red")
    names, values, colours = zip(*rows, strict=True)
    look = {"orientation": "horizontal", "whis": (0, 100), "positions": range(len(rows)), "patch_artist": True}
    boxes = axes.boxplot([1e3 * part for part in values], medianprops={"color": style.INK}, **look)["boxes"]
    for box, colour in zip(boxes, colours, strict=True):
        box.set(facecolor=colour, alpha=0.6)
    name_rows(axes, [shorten(name, 40, placeholder=" …") for name in names])


def _group_colours(summary: CampaignSummary, labels: Sequence[str]) -> list[str]:
    order = list(dict.fromkeys(group.family for group in summary.groups))
    return [style.RUNS[order.index(label) % len(style.RUNS)] for label in labels]


def _bars_of(summary: CampaignSummary) -> list[tuple[Group, str]]:
    """Return the groups to draw as bars with their labels.

    Few mismatches are kept apart.
    """
    families = {level.label for level in summary.levels}
    if summary.axis == "mismatch" and 0 < len(summary.levels) <= _APART * len(families):
        return [(level, f"{level.label} · mismatch {level.low:.3g}") for level in summary.levels]
    # Controllers of one kind of trouble are adjacent.
    groups = sorted(summary.groups, key=lambda group: (group.names.get("kind", ""), -group.share.rate))
    return [(group, group.label) for group in groups]


def draw_groups(axes: Axes, summary: CampaignSummary) -> None:
    every = _bars_of(summary)
    shown = every[:_MOST]
    more = f"… and {len(every) - len(shown)} groups more" if len(every) > len(shown) else ""
    colours = _group_colours(summary, [group.family for group, _ in shown])
    rows = [
        Bar(label, g.share.rate, colour, (g.share.low, g.share.high), f"{g.share.successes} of {g.share.runs}")
        for (g, label), colour in zip(shown, colours, strict=True)
    ]
    bars(axes, "Runs completed; lines: Wilson's 95 % interval", rows, x=more)
    axes.set_xlim(0, 1)
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))


def _draw_levels(axes: Axes, summary: CampaignSummary) -> None:
    standard = summary.axis == "level"
    text = "level of each kind of trouble" if standard else "mismatch, share of each parameter"
    over = "over the level, of all kinds" if standard else "over the mismatch"
    labels = list(dict.fromkeys(level.label for level in summary.levels))
    shown = labels[: len(style.RUNS)]
    hidden = f"; first {len(shown)} of {len(labels)} groups" if len(labels) > len(shown) else ""
    quiet(axes, f"Runs completed {over}{hidden}", x=text)
    names: list[tuple[float, str, str]] = []
    axes.set_ylim(-0.03, 1.03)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    reach = max(level.high for level in summary.levels) - min(level.low for level in summary.levels)
    for k, (label, colour) in enumerate(zip(shown, _group_colours(summary, shown), strict=True)):
        levels = [level for level in summary.levels if level.label == label]
        # Groups are offset slightly, so that their intervals do not overlap.
        x = np.array([(level.low + level.high) / 2 for level in levels]) + 0.006 * reach * (k - len(shown) / 2)
        low, rates, high = np.array([(level.share.low, level.share.rate, level.share.high) for level in levels]).T
        spread = np.maximum([rates - low, high - rates], 0)
        axes.errorbar(x, rates, yerr=spread, color=colour, marker="o", markersize=4.5, linewidth=1.3, capsize=2)
        names.append((float(rates[-1]), shorten(label, 24, placeholder=" …"), colour))
    if standard:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    else:
        axes.xaxis.set_major_formatter(PercentFormatter(1.0))
    if len(labels) > 1:
        name_curves(axes, names)


def _draw_symbols(axes: Axes, summary: CampaignSummary) -> None:
    quiet(axes, "Failed runs by the symbol that was not done", x="symbol, from 1; beyond the last: not held to the end")
    numbers = sorted({symbol for _, symbol, _ in summary.failed_symbols})
    bottoms = dict.fromkeys(numbers, 0)
    labels = list(dict.fromkeys(label for label, _, _ in summary.failed_symbols))
    colours = dict(zip(labels, _group_colours(summary, labels), strict=True))
    for label, symbol, count in summary.failed_symbols:
        axes.bar(symbol, count, bottom=bottoms[symbol], color=colours[label], alpha=0.85)
        bottoms[symbol] += count
    axes.set_xticks(numbers, ["not named" if symbol == 0 else str(symbol) for symbol in numbers])
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylim(0, 1.1 * max(bottoms.values()) + 0.5)


def _draw_reasons(axes: Axes, summary: CampaignSummary) -> None:
    rest = sum(count for _, count in summary.reasons[6:])
    shown = [*summary.reasons[:6], *([("other reasons", rest)] if rest else [])]
    bars(axes, "Failed runs by cause", [Bar(text, count, style.LIMIT) for text, count in shown])
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
