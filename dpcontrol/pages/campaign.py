"""A campaign's table and a preflight's forecast for a rig, as numbers and each on one page to print.

*A campaign*: one row for each run; shares of success, failures, spreads. Shares come with Wilson's 95 % interval
(`foundation.statistics`). Only the column `completed` is required. Optional columns are itinerary, controller,
estimator, mismatch, symbols_completed, symbols_total, reason, ending, rms_tracking_error (rad), max_cart_position (m).
A table with kind and level comes from the standard score: its groups are formed by kind of trouble, its levels over all
kinds together. Cases with equal values in these columns are distinguished by `case`. Other columns are ignored. The
page omits empty panels, such as failures.

*A preflight*: the share of completed runs on the bench as described, the causes of failure, the distance of each
border, and the gain from a measurement or a change. `dpcontrol.runs.preflight` computes it.
"""

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from textwrap import shorten, wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullFormatter, PercentFormatter
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import check_seal, checked_size, checked_source, picked
from dpcontrol.foundation.parts import part
from dpcontrol.foundation.statistics import Share, wilson
from dpcontrol.pages import style
from dpcontrol.pages.page import DASHED, SMALL, new_figure, quiet

_WHAT = ("itinerary", "controller", "estimator")
_KIND, _LEVEL, _CASE = "kind", "level", "case"
_EARLY = re.compile(r"; the run ended [^:;]* early: ")
_APART, _BINS = 21, 6
"""Most values shown individually, and the number of bins for more."""
_NUMBER = re.compile(r"[-+]?\d[\d.,]*(?:e[-+]?\d+)?")
_MOST_LETTERS = 90


@dataclass(frozen=True)
class Group:
    """Runs with equal `names` and similar mismatch or trouble.

    The mismatch or level lies between two bounds.
    """

    names: dict[str, str]
    share: Share
    low: float = -np.inf
    high: float = np.inf

    @property
    def label(self) -> str:
        """The names as one line, without those that the case repeats."""
        return self._line()

    @property
    def family(self) -> str:
        """The names except the kind of trouble, as one line."""
        return self._line(without=_KIND)

    def _line(self, *, without: str = "") -> str:
        named = self.names.get(_CASE, "").split(", ")
        parts = (n for column, n in self.names.items() if column != without and f"{column}={n}" not in named)
        return " · ".join(parts) or "all runs"


@dataclass(frozen=True, eq=False)
class CampaignSummary:
    """Summary of a campaign's table.

    Attributes:
        path: of the table.
        runs: rows with a known outcome.
        unknown: other rows.
        share: of all runs.
        groups: by itinerary, controller and estimator if these differ, by kind of trouble, and by case if these and
            the mismatch do not distinguish cases.
        axis: "mismatch", or "level" of the standard score.
        levels: by family and mismatch or level; empty if it does not vary.
        failed_symbols: (family, symbol from 1, number of runs that failed at it), symbol 0 if unknown.
        reasons: number of failed runs by reason without its numbers, the most frequent first.
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
        """Return the output of `dpcontrol report --json` for a campaign."""
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
    """Return the summary of a campaign's Parquet table.

    Raises:
        InputError: the file is missing, not a Parquet table, has no runs, or no column of completed runs.
    """
    columns = _columns(Path(path))
    if "completed" not in columns:
        found = ", ".join(sorted(columns)) or "no columns"
        raise InputError(f"{path} has no column of completed runs, only {found}; give a table of `dpcontrol campaign`")
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
    """True if the columns of groups and levels do not separate all cases."""
    columns = [table[name] for name in (*_WHAT, "mismatch") if name in table]
    places = list(zip(*columns, strict=True)) if columns else [()] * len(table[_CASE])
    return len(set(zip(places, table[_CASE], strict=True))) > len(set(places))


def _groups(table: dict[str, list[Any]], columns: list[str], done: Rows) -> list[tuple[Group, Rows]]:
    """Return the groups of runs with equal values in columns, and the rows (K,) of each."""
    keys = [tuple(str(table[name][k]) for name in columns) for k in range(len(done))]
    found = []
    for key in sorted(set(keys)):
        mine = np.array([other == key for other in keys])
        found.append((Group(dict(zip(columns, key, strict=True)), _share(done, mine)), mine))
    return found


def _columns(path: Path) -> dict[str, list[Any]]:
    # Importing pyarrow takes a third of a second.
    arrow = part("pyarrow")
    if not checked_source(path).is_file():
        raise InputError(f"there is no campaign {path}")
    try:
        check_seal(path.read_bytes())
        file = part("pyarrow.parquet").ParquetFile(path)
        checked_size(8.0 * file.metadata.num_rows * file.metadata.num_columns)
        return file.read().to_pydict()
    except (arrow.ArrowException, OSError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{path} is not a Parquet table, or is damaged: {reason}; run the campaign again") from error


def _share(done: Rows, chosen: Rows) -> Share:
    return wilson(int(done[chosen].sum()), int(chosen.sum()))


def _numbers(table: dict[str, list[Any]], name: str) -> NDArray[np.float64] | None:
    """Return a column as numbers, nan for missing values, or None if it has no numbers."""
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
        # All symbols were done, but end, wraps or limits failed: the failure is after the last.
        symbols = np.fmin(symbols, total + 1)
    counts = ((group.label, Counter(symbols[mine & ~done].astype(int).tolist())) for group, mine in groups)
    return tuple((label, symbol, count) for label, some in counts for symbol, count in sorted(some.items()))


def _reasons(table: dict[str, list[Any]], done: Rows) -> tuple[tuple[str, int], ...]:
    texts = table.get("reason") or table.get("ending") or [""] * len(done)
    counts = Counter(plain_reason(str(texts[k] or "not named")) for k in np.flatnonzero(~done))
    return tuple(counts.most_common())


def plain_reason(reason: str) -> str:
    """Return the reason for a run's failure, without numbers and remedy."""
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
    for k, (name, title) in enumerate(_SPREADS.items()):
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


def shown_number(value: float) -> str:
    """Return a value for display: three digits, and whole numbers unchanged."""
    return f"{value:,.3g}" if abs(value) < 1000 else f"{value:,.0f}"


@dataclass(frozen=True)
class Known:
    """A known property of the bench, as text, and its source."""

    name: str
    value: str
    source: str


@dataclass(frozen=True)
class EndingShare:
    """Number of runs with an ending.

    It has the reason without numbers, and a seed with its full reason.
    """

    ending: str
    reason: str
    runs: int
    seed: int
    example: str

    @property
    def words(self) -> str:
        """Short text of the ending.

        Finished runs off their target have "at the end, but off target".
        """
        return "at the end, but off target" if self.ending == "finished" else self.ending


@dataclass(frozen=True)
class ShareAt:
    """Completed runs at a value of a trouble.

    For comparison it holds those of the same seeds on the described bench.
    """

    value: float
    runs: int
    completed: int
    reference: int

    @property
    def share(self) -> float:
        """Completed runs relative to those on the described bench."""
        return self.completed / self.reference if self.reference else math.nan


_NEAR = 1.25
"""Largest factor between a border and the ends of its interval if it counts as known."""


@dataclass(frozen=True)
class HazardBorder:
    """Border of a trouble, at half the described bench's completed runs.

    Attributes:
        setting: the run setting.
        set: value on the bench, in `unit`.
        border: in `unit`.
        low: of the border's 95 % interval, None if no value was below the border.
        high: of the interval, None if no value was beyond the border.
        end: last value tried, if the border is beyond it.
        falling: True if less is worse.
    """

    name: str
    setting: str
    unit: str
    set: float
    border: float | None
    low: float | None
    high: float | None
    end: float
    falling: bool
    points: tuple[ShareAt, ...]

    @property
    def margin(self) -> float | None:
        """Factor by which the bench may worsen, or None.

        It is None without this trouble or without a known border.
        """
        if self.border is None or not self.set or math.isinf(self.set):
            return None
        return self.set / self.border if self.falling else self.border / self.set

    @property
    def own(self) -> str:
        """The bench's value, as text."""
        return "none" if math.isinf(self.set) else f"{shown_number(self.set)} {self.unit}"

    @property
    def order(self) -> tuple[bool, float, str]:
        """Sort key that puts the nearest border first.

        Those without a margin are last.
        """
        return self.margin is None, self.margin or 0.0, self.name

    @property
    def interval(self) -> str:
        """The border's 95 % interval, as text; "…" for an unknown end."""
        ends = ("" if end is None else shown_number(end) for end in (self.low, self.high))
        return "" if self.border is None else " … ".join(ends)

    @property
    def sure(self) -> bool:
        """True if its interval is known and within a quarter of it.

        At slowly falling shares it is wider.
        """
        if self.border is None or self.low is None or self.high is None:
            return False
        return max(self.low, self.high) <= _NEAR * self.border and min(self.low, self.high) >= self.border / _NEAR

    @property
    def sentence(self) -> str:
        """Position of the border, as text."""
        if self.border is None:
            return f"{'below' if self.falling else 'beyond'} {shown_number(self.end)} {self.unit}"
        return f"{'' if self.sure else 'about '}{shown_number(self.border)} {self.unit}"


@dataclass(frozen=True)
class Improvement:
    """A change on the same seeds.

    Of `failing` runs, `rescued` now complete; of `completing` ones, `lost` no longer do.

    Attributes:
        options: run settings of the change.
        rate: share of completed runs without it.
    """

    text: str
    options: Mapping[str, Any]
    rescued: int
    failing: int
    lost: int
    completing: int
    rate: float

    @property
    def gain(self) -> float:
        """Increase of the share of completed runs."""
        up = (1 - self.rate) * self.rescued / self.failing if self.failing else 0.0
        return up - (self.rate * self.lost / self.completing if self.completing else 0.0)

    @property
    def error(self) -> float:
        """Standard error of the gain.

        Two more of each kind keep it above zero (Agresti and Coull, 1998).
        """
        variance = 0.0
        up, down = (1 - self.rate, self.rescued, self.failing), (self.rate, self.lost, self.completing)
        for weight, hits, count in (up, down):
            if count:
                share = (hits + 2) / (count + 4)
                variance += weight**2 * share * (1 - share) / (count + 4)
        return math.sqrt(variance)


@dataclass(frozen=True)
class Preflight:
    """Forecast before the first run.

    Attributes:
        share: completed runs, with its interval at `confidence`.
        known: properties of the bench.
        notes: warnings.
        endings: of failed runs, the most frequent first.
        borders: the nearest first.
        changes: the largest gain first.
        seconds: computing time.
    """

    itinerary: str
    title: str
    model: str
    share: Share
    confidence: float
    known: tuple[Known, ...]
    notes: tuple[str, ...]
    endings: tuple[EndingShare, ...]
    borders: tuple[HazardBorder, ...]
    changes: tuple[Improvement, ...]
    seconds: float

    def __repr__(self) -> str:
        return f"<preflight of {self.itinerary!r}: {self.status}>"

    @property
    def likely(self) -> bool | None:
        """True if at least nine of ten runs complete.

        The value is False if less than half do, and None in between.
        """
        return True if self.share.low >= 0.9 else False if self.share.high < 0.5 else None

    @property
    def status(self) -> str:
        """Sentence on the share of completed runs."""
        s = self.share
        band = f"{s.low:.1%} to {s.high:.1%} with {self.confidence:.0%} confidence"
        return f"{s.successes} of {s.runs} runs completed: {s.rate:.1%} ({band})"

    @property
    def advice(self) -> str:
        """Sentence on the best change, or on the nearest border."""
        best = self.changes[0] if self.changes else None
        if best is not None and best.gain > 2 * best.error:
            return f"{best.text} would gain most: {100 * best.gain:+.0f} points of {self.share.rate:.0%}"
        nearest = next((b for b in self.borders if b.margin is not None), None)
        at = "" if nearest is None else f"; the nearest border is that of {nearest.name}, at {nearest.sentence}"
        none = "no run failed, so no change can help" if best is None else "no change gains more than chance"
        return none + at

    def document(self) -> dict[str, Any]:
        """Return the output of `dpcontrol preflight --json`."""
        s = self.share
        return {
            **picked(self, "itinerary", "title", "model", "status", "advice"),
            "runs": s.runs,
            "completed": s.successes,
            "success_rate": s.rate,
            "wilson": [s.low, s.high],
            "confidence": self.confidence,
            "known": [asdict(one) for one in self.known],
            "notes": list(self.notes),
            "endings": [{**asdict(one), "share": one.runs / s.runs} for one in self.endings],
            "borders": [{**asdict(one), "margin": one.margin, "sure": one.sure} for one in self.borders],
            "changes": [{**asdict(one), "gain": one.gain, "error": one.error} for one in self.changes],
            "seconds": self.seconds,
        }

    def plot(self) -> Figure:
        """Return the page to print."""
        return draw_preflight(self)


_SIZE = (8.27, 11.69)
"""Size of a sheet of A4, inches."""
_LEFT, _WIDE = 0.07, 0.88


def draw_preflight(found: Preflight) -> Figure:
    """Return a preflight's page as a figure."""
    figure = new_figure(*_SIZE)
    look: dict[str, Any] = {"va": "top", "color": style.INK}
    title = shorten(f"Before the first run: {found.itinerary}", 60, placeholder=" …")
    figure.text(_LEFT, 0.973, title, fontsize=15, weight="bold", **look)
    below = shorten(f"{found.title} · model {found.model}", 110, placeholder=" …")
    figure.text(_LEFT, 0.947, below, fontsize=SMALL, **{**look, "color": style.NOTE})
    figure.text(_LEFT, 0.928, found.status, fontsize=11, **{**look, "color": style.verdict_colour(found.likely)})
    _rate(figure.add_axes((_LEFT, 0.888, _WIDE, 0.016)), found)
    figure.text(_LEFT, 0.866, "\n".join(wrap(found.advice, 105)), fontsize=9.5, **look)
    _known(figure.add_axes((_LEFT, 0.635, 0.42, 0.187)), found)
    _endings(figure.add_axes((0.53, 0.637, 0.42, 0.185)), found)
    heading = {"fontsize": 9.5, **look}
    columns, tall = 4, 0.1
    for k, border in enumerate(found.borders):
        row, column = divmod(k, columns)
        wide = _WIDE / columns
        axes = figure.add_axes((_LEFT + column * wide, 0.485 - row * (tall + 0.06), wide - 0.045, tall))
        _border(axes, border)
    if found.borders:
        row, column = divmod(len(found.borders), columns)
        place = (_LEFT + column * _WIDE / columns, 0.485 - row * (tall + 0.06), _WIDE / columns - 0.03, tall)
        _legend(figure.add_axes(place))
        figure.text(_LEFT, 0.618, "Borders: half as many runs complete", **heading)
    helps = "Gain of each change, on the same seeds; lines: two standard errors"
    none = "Gain of changes: none tried, because no run failed or none was compared"
    figure.text(_LEFT, 0.277, helps if found.changes else none, **heading)
    _changes(figure.add_axes((0.42, 0.11, 0.53, 0.145)), found)
    notes = [line for note in found.notes for line in wrap(f"Mind: {note}", 120)]
    figure.text(_LEFT, 0.066, "\n".join(notes[:4]), fontsize=7.5, **{**look, "color": style.NOTE})
    return figure


def _rate(axes: Axes, found: Preflight) -> None:
    share, colour = found.share, style.verdict_colour(found.likely)
    axes.barh(0, 1, color=style.GRID, height=1)
    axes.barh(0, share.high - share.low, left=share.low, color=colour, alpha=0.35, height=1)
    axes.plot([share.rate, share.rate], [-0.5, 0.5], color=colour, linewidth=2.5, clip_on=False)
    axes.set(xlim=(0, 1), ylim=(-0.5, 0.5), yticks=[])
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))
    axes.tick_params(labelsize=7.5, colors=style.NOTE, length=2)
    axes.spines[:].set_visible(False)


def _known(axes: Axes, found: Preflight) -> None:
    axes.set_title("The bench as described", loc="left", fontsize=9.5, color=style.INK, pad=4)
    axes.axis("off")
    rows = max(len(found.known), 9)
    for k, one in enumerate(found.known):
        y = 1 - k / rows
        axes.text(0.0, y, one.name, fontsize=7.5, color=style.NOTE, va="top")
        axes.text(0.24, y, shorten(one.value, 44, placeholder=" …"), fontsize=7.5, color=style.INK, va="top")
        source = shorten(one.source, 70, placeholder=" …")
        axes.text(0.24, y - 0.5 / rows, source, fontsize=5.5, color=style.MARK, va="top")


_REASONS = 5


def _endings(axes: Axes, found: Preflight) -> None:
    axes.set_title("Endings of failed runs, share of all runs", loc="left", fontsize=9.5, color=style.INK, pad=4)
    axes.axis("off")
    shown, runs = found.endings[:_REASONS], found.share.runs
    if not shown:
        axes.text(0.0, 0.95, "nothing: every run completed", fontsize=SMALL, color=style.GOOD, va="top")
        return
    for k, one in enumerate(shown):
        share, top = one.runs / runs, k + 0.1
        axes.barh(top + 0.12, share / (shown[0].runs / runs), color=style.LIMIT, alpha=0.25, height=0.3)
        axes.text(0.01, top + 0.12, f"{share:.1%}", fontsize=8, color=style.INK, va="center", weight="bold")
        axes.text(0.16, top + 0.12, one.words, fontsize=8, color=style.INK, va="center")
        text = "\n".join(wrap(one.example, 82, max_lines=2, placeholder=" …"))
        axes.text(0.01, top + 0.33, text, fontsize=5.5, color=style.NOTE, va="top", linespacing=1.2)
    axes.set(xlim=(0, 1), ylim=(max(len(shown), _REASONS), 0))


def _border(axes: Axes, border: HazardBorder) -> None:
    margin = "" if border.margin is None else f" ({border.margin:.1f} ×)"
    quiet(axes, f"{border.name}: {border.sentence}{margin}", size=8)
    own = border.set if border.set and math.isfinite(border.set) else None
    values = [point.value for point in border.points]
    for point in border.points:
        band = wilson(min(point.completed, point.reference), point.reference)
        axes.plot([point.value] * 2, [band.low, band.high], color=style.CART, linewidth=0.9, alpha=0.6)
        axes.plot(point.value, min(point.share, 1.0), "o", color=style.INK, markersize=3)
    if own is not None:
        axes.axvline(own, color=style.GOOD, linewidth=1.2, linestyle=DASHED)
        values.append(own)
    if border.border is not None:
        axes.axvspan(border.low or border.border, border.high or border.border, color=style.LIMIT, alpha=0.15)
        axes.axvline(border.border, color=style.LIMIT, linewidth=1.2)
    axes.axhline(0.5, color=style.MARK, linewidth=0.7, linestyle=DASHED)
    low, high = min(values), max(values)
    axes.set_xscale("log")
    axes.set(xlim=(low / 1.3, high * 1.3), ylim=(-0.03, 1.06))
    if border.falling:
        axes.invert_xaxis()
    ticks = sorted({float(f"{v:.2g}") for v in (low, math.sqrt(low * high), high)})
    axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: shown_number(value)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.set_yticks([0, 0.5, 1])
    axes.tick_params(labelsize=6.5)
    axes.set_xlabel(border.unit, fontsize=7, color=style.NOTE, labelpad=0)


def _legend(axes: Axes) -> None:
    axes.axis("off")
    lines = [
        (style.INK, "● share that completes, of those"), ("", "    that do on the bench as described"),
        (style.GOOD, "- - the bench as described"), (style.LIMIT, "│ border, with its 95 % interval"),
        ("", "to the right: worse"),
    ]  # fmt: skip
    for k, (colour, text) in enumerate(lines):
        axes.text(0, 0.95 - 0.19 * k, text, fontsize=7, color=colour or style.INK, va="top")


def _changes(axes: Axes, found: Preflight) -> None:
    quiet(axes, x="points of all runs")
    if not found.changes:
        axes.axis("off")
        return
    for k, one in enumerate(found.changes):
        gain, reach = 100 * one.gain, 200 * one.error
        sure = gain > reach
        axes.barh(k, gain, color=style.GOOD if sure else style.FAINT, height=0.6)
        axes.plot([gain - reach, gain + reach], [k, k], color=style.INK, linewidth=0.9)
    axes.axvline(0, color=style.MARK, linewidth=0.8)
    axes.set_yticks(range(len(found.changes)), [shorten(c.text, 52, placeholder=" …") for c in found.changes])
    axes.tick_params(axis="y", labelsize=7.5, length=0)
    axes.set_ylim(len(found.changes) - 0.4, -0.6)
