"""A campaign's table, one row for each run, as numbers and on one page: shares of success, failures, spreads.

Shares come with Wilson's 95 % interval (`foundation.statistics`). Only `completed` is required; other columns are used
where they are present: itinerary, controller, estimator, mismatch, symbols_completed, symbols_total, reason, ending,
rms_tracking_error (rad), max_cart_position (m). A table with kind and level comes from the standard score: its groups
are formed by kind of trouble, its levels over all kinds together. Cases that these columns do not tell apart are told
apart by `case`. Other columns are ignored. The page leaves out panels for which there is nothing to show, such as
failures.
"""

import re
from collections import Counter
from collections.abc import Sequence
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
from dpcontrol.foundation.files import checked_size, checked_source, picked
from dpcontrol.foundation.parts import part
from dpcontrol.foundation.statistics import Share, wilson
from dpcontrol.review import style
from dpcontrol.review.page import new_figure, quiet

_WHAT = ("itinerary", "controller", "estimator")
_KIND, _LEVEL, _CASE = "kind", "level", "case"
_EARLY = re.compile(r"; the run ended [^:;]* early: ")
_APART, _BINS = 21, 6
"""The most values that are shown one by one, and the number of bins for more."""
_NUMBER = re.compile(r"[-+]?\d[\d.,]*(?:e[-+]?\d+)?")
_MOST_LETTERS = 90


@dataclass(frozen=True)
class Group:
    """Runs that share what `names` says, by column, and whose mismatch or level of trouble lies between two bounds."""

    names: dict[str, str]
    share: Share
    low: float = -np.inf
    high: float = np.inf

    @property
    def label(self) -> str:
        """The names as one line, once each where the case holds them too."""
        return self._line()

    @property
    def family(self) -> str:
        """The names but for the kind of trouble, as one line."""
        return self._line(without=_KIND)

    def _line(self, *, without: str = "") -> str:
        said = self.names.get(_CASE, "").split(", ")
        parts = (n for column, n in self.names.items() if column != without and f"{column}={n}" not in said)
        return " · ".join(parts) or "all runs"


@dataclass(frozen=True, eq=False)
class CampaignSummary:
    """What a campaign's table says.

    Attributes:
        path: of the table.
        runs: rows whose outcome is known. unknown: other rows.
        share: of all runs.
        groups: by itinerary, controller and estimator as far as these differ, by case where they and the mismatch do
            not tell cases apart, and by kind of trouble.
        axis: "mismatch", or "level" of the standard score.
        levels: by family and mismatch or level; empty where it does not vary.
        failed_symbols: (family, symbol from 1, how many runs failed at it), symbol 0 where that is not known.
        reasons: how many runs failed for each reason, the most frequent first; numbers in it are left out.
        spreads: by column and family, values of runs that completed and of those that did not.
    """

    path: Path
    runs: int
    unknown: int
    share: Share
    groups: tuple[Group, ...]
    axis: str
    levels: tuple[Group, ...]
    failed_symbols: tuple[tuple[str, int, int], ...]
    reasons: tuple[tuple[str, int], ...]
    spreads: dict[str, dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]]

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
    rows = [k for k, value in enumerate(columns["completed"]) if value is not None and value == value]
    if not rows:
        raise InputError(f"{path} holds no runs with a verdict; run the campaign again")
    table = {name: [values[k] for k in rows] for name, values in columns.items()}
    done = np.array(table["completed"], dtype=bool)
    families = [name for name in _WHAT if name in table and len(set(table[name])) > 1]
    standard = _KIND in table and _LEVEL in table
    if not standard and _CASE in table and _merged(table):
        families.append(_CASE)
    axis = _LEVEL if standard else "mismatch"
    groups = _groups(table, [*families, _KIND] if standard else families, done)
    alone = _groups(table, families, done)
    return CampaignSummary(
        path=Path(path),
        runs=len(rows),
        unknown=len(columns["completed"]) - len(rows),
        share=wilson(int(done.sum()), len(done)),
        groups=tuple(group for group, _ in groups),
        axis=axis,
        levels=_levels(_numbers(table, axis), alone, done),
        failed_symbols=_symbols(table, alone, done),
        reasons=_reasons(table, done),
        spreads=_spreads(table, alone, done),
    )


Rows = NDArray[np.bool_]


def _merged(table: dict[str, list[Any]]) -> bool:
    """Tell whether columns that groups and levels are formed by leave runs of several cases together."""
    columns = [table[name] for name in (*_WHAT, "mismatch") if name in table]
    places = list(zip(*columns, strict=True)) if columns else [()] * len(table[_CASE])
    return len(set(zip(places, table[_CASE], strict=True))) > len(set(places))


def _groups(table: dict[str, list[Any]], columns: list[str], done: Rows) -> list[tuple[Group, Rows]]:
    """Return the groups of runs by what columns say, and the rows (K,) of each."""
    keys = [tuple(str(table[name][k]) for name in columns) for k in range(len(done))]
    found = []
    for key in sorted(set(keys)):
        mine = np.array([other == key for other in keys])
        found.append((Group(dict(zip(columns, key, strict=True)), _share(done, mine)), mine))
    return found


def _columns(path: Path) -> dict[str, list[Any]]:
    # pyarrow takes a third of a second to import.
    arrow = part("pyarrow")
    if not checked_source(path).is_file():
        raise InputError(f"there is no campaign {path}")
    try:
        file = part("pyarrow.parquet").ParquetFile(path)
        checked_size(8.0 * file.metadata.num_rows * file.metadata.num_columns)
        return file.read().to_pydict()
    except (arrow.ArrowException, OSError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{path} is not a Parquet table, or is damaged: {reason}; run the campaign again") from error


def _share(done: Rows, chosen: Rows) -> Share:
    return wilson(int(done[chosen].sum()), int(chosen.sum()))


def _numbers(table: dict[str, list[Any]], name: str) -> NDArray[np.float64] | None:
    """Return a column as numbers, nan where a value is missing, or None where it has no numbers."""
    try:
        values = np.array([np.nan if v is None else float(v) for v in table.get(name, [])])
    except (TypeError, ValueError):
        return None
    return values if np.isfinite(values).any() else None


def _levels(values: NDArray[np.float64] | None, groups: list[tuple[Group, Rows]], done: Rows) -> tuple[Group, ...]:
    if values is None or len(known := np.unique(values[np.isfinite(values)])) < 2:
        return ()
    if len(known) <= _APART:
        bounds = [(float(v), float(v)) for v in known]
    else:
        edges = np.unique(np.quantile(values[np.isfinite(values)], np.linspace(0, 1, _BINS + 1)))
        bounds = [(float(a), float(np.nextafter(b, -np.inf))) for a, b in pairwise(edges)]
        bounds[-1] = (bounds[-1][0], float(edges[-1]))
    return tuple(
        Group(group.names, _share(done, chosen), low, high)
        for group, mine in groups
        for low, high in bounds
        if (chosen := mine & (values >= low) & (values <= high)).any()
    )


def _symbols(
    table: dict[str, list[Any]], groups: list[tuple[Group, Rows]], done: Rows
) -> tuple[tuple[str, int, int], ...]:
    reached, total = (_numbers(table, name) for name in ("symbols_completed", "symbols_total"))
    symbols = np.zeros(len(done)) if reached is None else np.nan_to_num(reached + 1)
    if total is not None:
        # All symbols done, but not held to the end, wraps or limits: it failed after the last.
        symbols = np.fmin(symbols, total + 1)
    counts = ((group.label, Counter(symbols[mine & ~done].astype(int).tolist())) for group, mine in groups)
    return tuple((label, symbol, count) for label, some in counts for symbol, count in sorted(some.items()))


def _reasons(table: dict[str, list[Any]], done: Rows) -> tuple[tuple[str, int], ...]:
    texts = table.get("reason") or table.get("ending") or [""] * len(done)
    counts = Counter(plain_reason(str(texts[k] or "not said")) for k in np.flatnonzero(~done))
    return tuple(counts.most_common())


def plain_reason(reason: str) -> str:
    """Return why a run ended, else what was not done, without its numbers and remedy."""
    text = _NUMBER.sub("…", _EARLY.split(reason)[-1].split(";")[0].strip())
    return text if len(text) <= _MOST_LETTERS else text[: _MOST_LETTERS - 1] + "…"


def _spreads(
    table: dict[str, list[Any]], groups: list[tuple[Group, Rows]], done: Rows
) -> dict[str, dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]]:
    found = {}
    for name in _SPREADS:
        values = _numbers(table, name)
        if values is not None:
            known = np.isfinite(values)
            found[name] = {
                group.family: (values[mine & known & done], values[mine & known & ~done])
                for group, mine in groups
                if (mine & known).any()
            }
    return found


_MOST = 28
_SPREADS = {"max_cart_position": "Cart's largest distance (mm)", "rms_tracking_error": "Tracking (mrad rms)"}


def draw_campaign(summary: CampaignSummary) -> Figure:
    """Return the page as a figure."""
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
    for k, (name, title) in enumerate(_SPREADS.items()):
        place = (0.37 + 0.32 * k, 0.075, 0.295, 0.13) if failed else (0.045 + 0.49 * k, 0.075, 0.45, 0.34)
        _spread(figure.add_axes(place), summary, name, title)
    return figure


def _draw_groups(axes: Axes, summary: CampaignSummary) -> None:
    # Of one kind of trouble the controllers stand side by side.
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
        # Groups stand a little apart, so that their intervals do not cover each other.
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
    axes.set_xticks(numbers, ["not said" if symbol == 0 else str(symbol) for symbol in numbers])
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
    # One row for each group, as high as its fullest bin: all together would hide what is compared.
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
    """Draw a histogram, what failed upon what was completed; in a row of its own, scaled to it, where one is given."""
    counts = [np.histogram(np.clip(1e3 * values, edges[0], edges[-1]), edges)[0] for values in (good, bad)]
    scale = 1.0 if row is None else 0.85 / max(int(np.add(*counts).max()), 1)
    look = {"width": np.diff(edges), "align": "edge", "alpha": 0.75}
    axes.bar(edges[:-1], counts[0] * scale, bottom=row or 0, color=colour, **look)
    axes.bar(edges[:-1], counts[1] * scale, bottom=(row or 0) + counts[0] * scale, color=style.LIMIT, **look)
