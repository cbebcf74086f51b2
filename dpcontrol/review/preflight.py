"""What is known before the first run on a rig, as numbers and on one page to print.

How often the itinerary completes on the bench as it is known, what ends it otherwise, how far each border is, and what
a measurement or a change would gain. `dpcontrol.scenes.preflight` finds it.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from textwrap import shorten, wrap
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, PercentFormatter

from dpcontrol.foundation.files import picked
from dpcontrol.foundation.statistics import Share, wilson
from dpcontrol.review import style
from dpcontrol.review.page import DASHED, SMALL, new_figure, quiet


def shown_number(value: float) -> str:
    """Return a value for people: three digits, and whole numbers as they are."""
    return f"{value:,.3g}" if abs(value) < 1000 else f"{value:,.0f}"


@dataclass(frozen=True)
class Known:
    """What is known of the bench, as text, and where from."""

    name: str
    value: str
    source: str


@dataclass(frozen=True)
class EndingShare:
    """How many runs ended so: the loop's ending, its reason without numbers, and a seed of it with its whole reason."""

    ending: str
    reason: str
    runs: int
    seed: int
    example: str

    @property
    def words(self) -> str:
        """What ended it, in few words: the loop's, but for runs that came to the end and were not where they should."""
        return "at the end, but not as asked" if self.ending == "finished" else self.ending


@dataclass(frozen=True)
class ShareAt:
    """A value of a trouble on some seeds: how many completed, and how many of the same do so on the bench as it is."""

    value: float
    runs: int
    completed: int
    reference: int

    @property
    def share(self) -> float:
        """What completes, as a share of what does on the bench as it is."""
        return self.completed / self.reference if self.reference else math.nan


_NEAR = 1.25
"""The factor from a border to the ends of its interval up to which it counts as known."""


@dataclass(frozen=True)
class HazardBorder:
    """Where a trouble lets half as many runs complete as on the bench as it is.

    setting: the run setting; set, border, low and high in `unit`, low and high the border's 95 % interval, None where
    nothing that was tried is beyond it. end: the last value that was tried, if the border is beyond it. falling: less
    is worse.
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
        """How many times as bad the bench may become; None where it has none of this trouble, or no border is known."""
        if self.border is None or not self.set or math.isinf(self.set):
            return None
        return self.set / self.border if self.falling else self.border / self.set

    @property
    def order(self) -> tuple[bool, float, str]:
        """What puts the nearest border first, and those without a margin last."""
        return self.margin is None, self.margin or 0.0, self.name

    @property
    def interval(self) -> str:
        """The border's 95 % interval, as text; "…" for an end that was not found."""
        ends = ("" if end is None else shown_number(end) for end in (self.low, self.high))
        return "" if self.border is None else " … ".join(ends)

    @property
    def sure(self) -> bool:
        """Whether its interval is known, and within a quarter of it: not so where what completes falls slowly."""
        if self.border is None or self.low is None or self.high is None:
            return False
        return max(self.low, self.high) <= _NEAR * self.border and min(self.low, self.high) >= self.border / _NEAR

    @property
    def sentence(self) -> str:
        """Where the border is."""
        if self.border is None:
            return f"{'below' if self.falling else 'beyond'} {shown_number(self.end)} {self.unit}"
        return f"{'' if self.sure else 'about '}{shown_number(self.border)} {self.unit}"


@dataclass(frozen=True)
class Improvement:
    """A change on the same seeds: of `failing` that failed `rescued` complete, of `completing` `lost` no longer do.

    options: its run settings; rate: the share that completes without it.
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
        """By how much the share that completes grows."""
        up = (1 - self.rate) * self.rescued / self.failing if self.failing else 0.0
        return up - (self.rate * self.lost / self.completing if self.completing else 0.0)

    @property
    def error(self) -> float:
        """The standard error of the gain; two more of each kind keep it above zero (Agresti and Coull, 1998)."""
        variance = 0.0
        up, down = (1 - self.rate, self.rescued, self.failing), (self.rate, self.lost, self.completing)
        for weight, hits, count in (up, down):
            if count:
                share = (hits + 2) / (count + 4)
                variance += weight**2 * share * (1 - share) / (count + 4)
        return math.sqrt(variance)


@dataclass(frozen=True)
class Preflight:
    """What is known before the first run. share: of runs that complete, with its interval at `confidence`.

    known: of the bench; notes: what to mind; endings: of the runs that do not complete, the most frequent first;
    borders: the nearest first; changes: what gains most first. seconds: what it took.
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
        """Whether nine of ten runs complete at least (True) or less than half do (False), None for in between."""
        return True if self.share.low >= 0.9 else False if self.share.high < 0.5 else None

    @property
    def status(self) -> str:
        """How likely it completes, in a sentence."""
        s = self.share
        band = f"{s.low:.1%} to {s.high:.1%} with {self.confidence:.0%} confidence"
        return f"{s.successes} of {s.runs} runs completed: {s.rate:.1%} ({band})"

    @property
    def advice(self) -> str:
        """What would help most, or which border is nearest, in a sentence."""
        best = self.changes[0] if self.changes else None
        if best is not None and best.gain > 2 * best.error:
            return f"{best.text} would gain most: {100 * best.gain:+.0f} points of {self.share.rate:.0%}"
        nearest = next((b for b in self.borders if b.margin is not None), None)
        at = "" if nearest is None else f"; the nearest border is that of {nearest.name}, at {nearest.sentence}"
        none = "nothing failed, so nothing is to be gained" if best is None else "no change gains more than chance"
        return none + at

    def document(self) -> dict[str, Any]:
        """Return what `dpcontrol preflight --json` prints."""
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
"""Of a sheet of A4, inches."""
_LEFT, _WIDE = 0.07, 0.88


def draw_preflight(found: Preflight) -> Figure:
    """Return the page as a figure."""
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
        figure.text(_LEFT, 0.618, "How far each border is: where half as many runs complete", **heading)
    helps = "What would help, on the same seeds; lines: two standard errors"
    none = "What would help: nothing was tried, as no run failed or none was compared"
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
    axes.set_title("The bench, as far as it is known", loc="left", fontsize=9.5, color=style.INK, pad=4)
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
    axes.set_title("What ends it otherwise, of all runs", loc="left", fontsize=9.5, color=style.INK, pad=4)
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
        (style.INK, "● share that completes, of those"), ("", "    that do on the bench as it is"),
        (style.GOOD, "- - the bench as it is"), (style.LIMIT, "│ border, with its 95 % interval"),
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
