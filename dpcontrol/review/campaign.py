"""A campaign's table, one row for each run, as numbers and on one page: shares of success, failures, spreads.

Shares come with Wilson's 95 % interval (`foundation.statistics`). Only `completed` is required; other columns are used
where they are present: itinerary, controller, estimator, mismatch, symbols_completed, symbols_total, reason, ending,
rms_tracking_error (rad), max_cart_position (m). A table with kind and level comes from the standard score: its groups
are formed by kind of trouble, its levels over all kinds together. Other columns are ignored. The page leaves out panels
for which there is nothing to show, such as failures.
"""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import picked
from dpcontrol.foundation.statistics import Share, wilson
from dpcontrol.review import style
from dpcontrol.review.page import new_figure, quiet

_WHAT = ("itinerary", "controller", "estimator")
_KIND, _LEVEL = "kind", "level"
_EARLY = re.compile(r"; the run ended [^:;]* early: ")
_APART, _BINS = 21, 6
"""The most values that are shown one by one, and the number of bins for more."""
_NUMBER = re.compile(r"[-+]?\d[\d.,]*(?:e[-+]?\d+)?")
_MOST_LETTERS = 90


@dataclass(frozen=True)
class Group:
    """Runs that share what `names` says, by column, and how many of them completed."""

    names: dict[str, str]
    share: Share

    @property
    def label(self) -> str:
        """The names as one line."""
        return _label(self.names.values())

    @property
    def family(self) -> str:
        """The names but for the kind of trouble, as one line."""
        return _label(name for column, name in self.names.items() if column != _KIND)


@dataclass(frozen=True)
class LevelShare:
    """Runs of a family whose mismatch, or level of trouble, lies between two bounds."""

    label: str
    low: float
    high: float
    share: Share


@dataclass(frozen=True, eq=False)
class CampaignSummary:
    """What a campaign's table says.

    Attributes:
        path: of the table.
        runs: rows whose outcome is known. unknown: other rows.
        share: of all runs.
        groups: by itinerary, controller and estimator as far as these differ, and by kind of trouble.
        axis: "mismatch", or "level" of the standard score.
        levels: by family and mismatch or level; empty where it does not vary.
        failed_symbols: (family, symbol from 1, how many runs failed at it), symbol 0 where that is not known.
        reasons: how many runs failed for each reason, the most frequent first; numbers in it are left out.
        spreads: by column, values of runs that completed and of those that did not.
    """

    path: Path
    runs: int
    unknown: int
    share: Share
    groups: tuple[Group, ...]
    axis: str
    levels: tuple[LevelShare, ...]
    failed_symbols: tuple[tuple[str, int, int], ...]
    reasons: tuple[tuple[str, int], ...]
    spreads: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]

    @property
    def status(self) -> str:
        """The result in one line."""
        share, rest = self.share, f"; {self.unknown} without a verdict" if self.unknown else ""
        chance = f"{share.rate:.1%} ({share.low:.1%} to {share.high:.1%} with 95 % confidence)"
        return f"{share.successes} of {share.runs} runs completed: {chance}{rest}"

    def document(self) -> dict[str, Any]:
        """Return what `dpcontrol report --json` prints of a campaign."""
        return {
            "campaign": str(self.path),
            **picked(self, "status", "runs", "unknown"),
            **_share_document(self.share),
            "groups": [{**group.names, **_share_document(group.share)} for group in self.groups],
            self.axis: [
                {"group": level.label, "from": level.low, "to": level.high, **_share_document(level.share)}
                for level in self.levels
            ],
            "failures": {
                "by_symbol": [
                    {"group": label, "symbol": symbol or None, "runs": count}
                    for label, symbol, count in self.failed_symbols
                ],
                "by_reason": [{"reason": reason, "runs": count} for reason, count in self.reasons],
            },
        }


def _share_document(share: Share) -> dict[str, Any]:
    return {"completed": share.successes, "of": share.runs, **picked(share, "rate", "low", "high")}


def campaign_summary(path: Path) -> CampaignSummary:
    """Return what a campaign's Parquet table says.

    Raises:
        InputError: there is no such file, it is not a Parquet table, holds no runs, or does not say which completed.
    """
    columns = _columns(Path(path))
    if "completed" not in columns:
        found = ", ".join(sorted(columns)) or "no columns"
        raise InputError(
            f"{path} does not say which runs completed: it has {found}; give a table of `dpcontrol campaign`"
        )
    outcome = [None if v is None or v != v else bool(v) for v in columns["completed"]]
    rows = [k for k, done in enumerate(outcome) if done is not None]
    if not rows:
        raise InputError(f"{path} holds no runs with a verdict; run the campaign again")
    table = {name: [values[k] for k in rows] for name, values in columns.items()}
    done = np.array([bool(outcome[k]) for k in rows])
    families = [name for name in _WHAT if name in table and len(set(table[name])) > 1]
    standard = _KIND in table and _LEVEL in table
    varied = [*families, _KIND] if standard else families
    keys = [tuple(str(table[name][k]) for name in varied) for k in range(len(rows))]
    groups = tuple(
        Group(dict(zip(varied, key, strict=True)), _share(done, [k == key for k in keys])) for key in sorted(set(keys))
    )
    labels = [_label(key[: len(families)]) for key in keys]
    axis = _LEVEL if standard else "mismatch"
    return CampaignSummary(
        path=Path(path),
        runs=len(rows),
        unknown=len(outcome) - len(rows),
        share=wilson(int(done.sum()), len(done)),
        groups=groups,
        axis=axis,
        levels=_levels(_numbers(table, axis), labels, done),
        failed_symbols=_symbols(table, labels, done),
        reasons=_reasons(table, done),
        spreads=_spreads(table, done),
    )


def _label(names: Iterable[str]) -> str:
    return " · ".join(names) or "all runs"


def _columns(path: Path) -> dict[str, list[Any]]:
    # pyarrow takes a third of a second to import.
    import pyarrow
    import pyarrow.parquet

    if not path.is_file():
        raise InputError(f"there is no campaign {path}")
    try:
        return pyarrow.parquet.read_table(path).to_pydict()
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{path} is not a Parquet table, or is damaged: {reason}; run the campaign again") from error


def _share(done: NDArray[np.bool_], chosen: Any) -> Share:
    picked = done[np.asarray(chosen, dtype=bool)]
    return wilson(int(picked.sum()), len(picked))


def _numbers(table: dict[str, list[Any]], name: str) -> NDArray[np.float64] | None:
    """Return a column as numbers, nan where a value is missing, or None where it has no numbers."""
    try:
        values = np.array([np.nan if v is None else float(v) for v in table.get(name, [])])
    except (TypeError, ValueError):
        return None
    return values if np.isfinite(values).any() else None


def _levels(values: NDArray[np.float64] | None, labels: list[str], done: NDArray[np.bool_]) -> tuple[LevelShare, ...]:
    if values is None or len(np.unique(values[np.isfinite(values)])) < 2:
        return ()
    known = np.unique(values[np.isfinite(values)])
    if len(known) <= _APART:
        spans = [(float(v), float(v)) for v in known]
    else:
        edges = np.unique(np.quantile(values[np.isfinite(values)], np.linspace(0, 1, _BINS + 1)))
        spans = [(float(a), float(np.nextafter(b, -np.inf))) for a, b in pairwise(edges)]
        spans[-1] = (spans[-1][0], float(edges[-1]))
    found = []
    for label in sorted(set(labels)):
        mine = np.array([text == label for text in labels])
        for low, high in spans:
            chosen = mine & (values >= low) & (values <= high)
            if chosen.any():
                found.append(LevelShare(label, low, high, _share(done, chosen)))
    return tuple(found)


def _symbols(
    table: dict[str, list[Any]], labels: list[str], done: NDArray[np.bool_]
) -> tuple[tuple[str, int, int], ...]:
    reached = _numbers(table, "symbols_completed")
    total = _numbers(table, "symbols_total")
    counts: Counter[tuple[str, int]] = Counter()
    for k in np.flatnonzero(~done):
        symbol = 0
        if reached is not None and np.isfinite(reached[k]):
            symbol = int(reached[k]) + 1
            # All symbols done, but not held to the end, wraps or limits: it failed after the last.
            if total is not None and np.isfinite(total[k]):
                symbol = min(symbol, int(total[k]) + 1)
        counts[labels[k], symbol] += 1
    return tuple((label, symbol, count) for (label, symbol), count in sorted(counts.items()))


def _reasons(table: dict[str, list[Any]], done: NDArray[np.bool_]) -> tuple[tuple[str, int], ...]:
    texts = table.get("reason") or table.get("ending") or [""] * len(done)
    counts = Counter(_plain(str(texts[k] or "not said")) for k in np.flatnonzero(~done))
    return tuple(counts.most_common())


def _plain(reason: str) -> str:
    """Return why a run ended, else what was not done, without its numbers and remedy."""
    text = _EARLY.split(reason)[-1].split(";")[0].strip()
    text = _NUMBER.sub("…", text)
    return text if len(text) <= _MOST_LETTERS else text[: _MOST_LETTERS - 1] + "…"


def _spreads(
    table: dict[str, list[Any]], done: NDArray[np.bool_]
) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    found = {}
    for name in ("max_cart_position", "rms_tracking_error"):
        values = _numbers(table, name)
        if values is not None:
            known = np.isfinite(values)
            found[name] = (values[known & done], values[known & ~done])
    return found


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
        _draw_levels(figure.add_axes((0.66, 0.55, 0.325, 0.32)), summary)
    if failed:
        _draw_symbols(figure.add_axes((0.045, 0.075, 0.27, 0.36)), summary)
        _draw_reasons(figure.add_axes((0.62, 0.285, 0.365, 0.15)), summary)
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


def _draw_levels(axes: Axes, summary: CampaignSummary) -> None:
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


def _draw_symbols(axes: Axes, summary: CampaignSummary) -> None:
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


def _draw_reasons(axes: Axes, summary: CampaignSummary) -> None:
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
