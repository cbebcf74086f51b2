"""A campaign on one page: shares of success by group and by mismatch, where and why runs failed, and their spreads.

What a campaign has nothing of, such as failures, has no panel.
"""

from collections.abc import Sequence
from textwrap import shorten

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from dpcontrol.foundation.statistics import Share
from dpcontrol.review import style
from dpcontrol.review.campaign import CampaignSummary
from dpcontrol.review.panel_frame import new_figure, quiet

_MOST = 28
_SPREADS = {
    "max_cart_position": ("Cart's largest distance (mm)", 1e3),
    "rms_tracking_error": ("Tracking (mrad rms)", 1e3),
}


def draw_campaign(summary: CampaignSummary) -> Figure:
    """Return the page as a figure."""
    figure = new_figure(15.0, 9.6, f"Campaign {summary.path.stem}")
    share = summary.share
    colour = style.GOOD if share.rate >= 0.5 else style.LIMIT
    figure.text(0.015, 0.935, summary.status, fontsize=11, color=colour, va="center")
    failed, levels = bool(summary.failed_symbols or summary.reasons), bool(summary.levels)
    wide = (0.36 if len(summary.groups) < 2 else 0.30) if levels else 0.70
    _groups(figure.add_axes((0.22, 0.55, wide, 0.32)), summary)
    if levels:
        _levels(figure.add_axes((0.66, 0.55, 0.325, 0.32)), summary)
    if failed:
        _symbols(figure.add_axes((0.045, 0.075, 0.27, 0.36)), summary)
        _reasons(figure.add_axes((0.62, 0.285, 0.365, 0.15)), summary)
    for k, (name, (title, scale)) in enumerate(_SPREADS.items()):
        place = (0.37 + 0.32 * k, 0.075, 0.295, 0.13) if failed else (0.045 + 0.49 * k, 0.075, 0.45, 0.34)
        _spread(figure.add_axes(place), summary, name, title=title, scale=scale)
    return figure


def _bars(axes: Axes, labels: Sequence[str], shares: Sequence[Share], colours: Sequence[str]) -> None:
    places = np.arange(len(labels))[::-1]
    for place, share, colour in zip(places, shares, colours, strict=True):
        axes.barh(place, share.rate, color=colour, height=0.62, alpha=0.85)
        axes.plot([share.low, share.high], [place, place], color=style.INK, linewidth=1.4)
        text = f"{share.successes} of {share.runs}"
        axes.text(1.02, place, text, va="center", fontsize=_letters(len(labels)), color=style.NOTE)
    axes.set_yticks(places, [shorten(label, 44, placeholder=" …") for label in labels])
    axes.tick_params(axis="y", labelsize=_letters(len(labels)))
    axes.set_xlim(0, 1)
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))
    axes.set_ylim(-0.6, max(len(labels) - 0.4, 0.6))


def _letters(rows: int) -> float:
    return 7.0 if rows > 18 else 8.5


def _groups(axes: Axes, summary: CampaignSummary) -> None:
    quiet(axes, "Runs completed; lines: Wilson's 95 % interval")
    # Of one kind of trouble the controllers stand side by side.
    groups = sorted(summary.groups, key=lambda group: (group.names.get("kind", ""), -group.share.rate))[:_MOST]
    _bars(axes, [g.label for g in groups], [g.share for g in groups], _colours(summary, [g.family for g in groups]))
    hidden = len(summary.groups) - len(groups)
    if hidden:
        axes.set_xlabel(f"… and {hidden} groups more", fontsize=8.5, color=style.NOTE)


def _colours(summary: CampaignSummary, labels: Sequence[str]) -> list[str]:
    order = list(dict.fromkeys(group.family for group in summary.groups))
    return [style.RUNS[order.index(label) % len(style.RUNS)] for label in labels]


def _levels(axes: Axes, summary: CampaignSummary) -> None:
    standard = summary.axis == "level"
    quiet(axes, "Runs completed over the level, of all kinds" if standard else "Runs completed over the mismatch")
    axes.set_ylim(-0.03, 1.03)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    labels = list(dict.fromkeys(level.label for level in summary.levels))
    shown = labels[: len(style.RUNS)]
    reach = max(level.high for level in summary.levels) - min(level.low for level in summary.levels)
    for k, (label, colour) in enumerate(zip(shown, _colours(summary, shown), strict=True)):
        levels = [level for level in summary.levels if level.label == label]
        # Groups stand a little apart, so that their intervals do not cover each other.
        x = np.array([(level.low + level.high) / 2 for level in levels]) + 0.006 * reach * (k - len(shown) / 2)
        rates = np.array([level.share.rate for level in levels])
        below = rates - [level.share.low for level in levels]
        above = np.array([level.share.high for level in levels]) - rates
        look = {"color": colour, "marker": "o", "markersize": 4.5, "linewidth": 1.3, "capsize": 2}
        axes.errorbar(x, rates, yerr=[np.maximum(below, 0), np.maximum(above, 0)], label=label, **look)
    if standard:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    else:
        axes.xaxis.set_major_formatter(PercentFormatter(1.0))
    text = "level of each kind of trouble" if standard else "mismatch, share of each parameter"
    axes.set_xlabel(text, fontsize=8.5, color=style.NOTE)
    if len(labels) > 1:
        axes.set_title("colours as on the left", loc="right", fontsize=8.5, color=style.NOTE)
    if len(labels) > len(shown):
        axes.text(0.99, 1.01, f"first {len(shown)} of {len(labels)} groups", transform=axes.transAxes, fontsize=8,
                  ha="right", color=style.NOTE)  # fmt: skip


def _symbols(axes: Axes, summary: CampaignSummary) -> None:
    quiet(axes, "Failed runs by the symbol that was not done")
    if not summary.failed_symbols:
        _empty(axes, "no failed run says which")
        return
    numbers = sorted({symbol for _, symbol, _ in summary.failed_symbols})
    bottoms = dict.fromkeys(numbers, 0)
    labels = list(dict.fromkeys(label for label, _, _ in summary.failed_symbols))
    for label, colour in zip(labels, _colours(summary, labels), strict=True):
        counts = {symbol: count for name, symbol, count in summary.failed_symbols if name == label}
        axes.bar(list(counts), list(counts.values()), bottom=[bottoms[s] for s in counts], color=colour, alpha=0.85,
                 label=shorten(label, 40, placeholder=" …"))  # fmt: skip
        for symbol, count in counts.items():
            bottoms[symbol] += count
    axes.set_xlabel("symbol, from 1; beyond the last: not held to the end", fontsize=8.5, color=style.NOTE)
    axes.set_xticks(numbers, ["not said" if symbol == 0 else str(symbol) for symbol in numbers])
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylim(0, 1.1 * max(bottoms.values()) + 0.5)


def _reasons(axes: Axes, summary: CampaignSummary) -> None:
    quiet(axes, "Failed runs by reason, numbers left out")
    if not summary.reasons:
        _empty(axes, "no failed run gives one")
        return
    shown = list(summary.reasons[:6])
    rest = sum(count for _, count in summary.reasons[6:])
    shown += [("other reasons", rest)] if rest else []
    places = np.arange(len(shown))[::-1]
    axes.barh(places, [count for _, count in shown], color=style.LIMIT, alpha=0.7, height=0.62)
    axes.set_yticks(places, [shorten(text, 62, placeholder=" …") for text, _ in shown])
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylim(-0.6, max(len(shown) - 0.4, 0.6))


def _spread(axes: Axes, summary: CampaignSummary, name: str, *, title: str, scale: float) -> None:
    if name not in summary.spreads:
        quiet(axes, title)
        _empty(axes, f"the table has no {name}")
        return
    good, bad = (scale * values for values in summary.spreads[name])
    both = "completed green, failed red" if len(good) and len(bad) else "all completed" if len(good) else "all failed"
    quiet(axes, f"{title}: number of runs, {both}")
    every = np.concatenate([good, bad])
    edges = np.linspace(float(every.min()), float(np.quantile(every, 0.99)) + 1e-9, 31)
    parts = [np.clip(values, edges[0], edges[-1]) for values in (good, bad)]
    axes.hist(parts, bins=list(edges), color=[style.GOOD, style.LIMIT], stacked=True, alpha=0.75)
    axes.yaxis.set_major_locator(MaxNLocator(3, integer=True))


def _empty(axes: Axes, why: str) -> None:
    axes.text(0.5, 0.5, why, transform=axes.transAxes, ha="center", va="center", fontsize=9, color=style.NOTE)
    axes.set_xticks([])
    axes.set_yticks([])
