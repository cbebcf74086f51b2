"""A preflight's forecast for the bench as described: completed runs, endings, borders, and gains of changes.

`dpcontrol.runs.preflight` computes it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from dpcontrol.foundation.document import Documented, document_of
from dpcontrol.foundation.shown import Shown
from dpcontrol.foundation.statistics import Share


def shown_number(value: float) -> str:
    """Return a value for display: three digits, and whole numbers unchanged.

    Args:
        value: any number.
    """
    return f"{value:,.3g}" if abs(value) < 1000 else f"{value:,.0f}"


@dataclass(frozen=True)
class Assumption:
    """A property of the bench on which the forecast depends.

    Attributes:
        name: name of the property.
        value: its value as text.
        source: origin of the value, such as a setting.
    """

    name: str
    value: str
    source: str


@dataclass(frozen=True)
class EndingShare:
    """Number of failed runs with one cause, and one of them as an example.

    Attributes:
        cause: cause of the failure.
        runs: number of runs.
        seed: seed of the example.
        example: reason of its verdict, a sentence.
    """

    cause: str
    runs: int
    seed: int
    example: str


@dataclass(frozen=True)
class ShareAt:
    """Completed runs at one value of a trouble, compared with runs of the same seeds on the described bench.

    Attributes:
        value: value of the trouble.
        runs: number of runs.
        completed: number of completed ones.
        reference: number of completed runs of the same seeds on the described bench.
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
class HazardBorder(Documented):
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

    KEYS: ClassVar[str] = "* margin sure"

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
        """Factor by which the bench may worsen until half its completed runs are lost.

        The factor is None without this trouble or without a known border.
        """
        if self.border is None or not self.set or math.isinf(self.set):
            return None
        return self.set / self.border if self.falling else self.border / self.set

    @property
    def own(self) -> str:
        """The bench's value of the trouble, as text."""
        return "none" if math.isinf(self.set) else f"{shown_number(self.set)} {self.unit}"

    @property
    def interval(self) -> str:
        """The border's 95 % interval, as text; "…" for an unknown end."""
        ends = ("" if end is None else shown_number(end) for end in (self.low, self.high))
        return "" if self.border is None else " … ".join(ends)

    @property
    def sure(self) -> bool:
        """True if the border's interval is known and within a quarter of it; it is wider at slowly falling shares."""
        ends = (self.low or math.nan, self.high or math.nan)
        return all(1 / _NEAR <= end / (self.border or math.nan) <= _NEAR for end in ends)

    @property
    def sentence(self) -> str:
        """Place of the border, as text: about its value, or beyond the last value tried."""
        if self.border is None:
            return f"{'below' if self.falling else 'beyond'} {shown_number(self.end)} {self.unit}"
        return f"{'' if self.sure else 'about '}{shown_number(self.border)} {self.unit}"


@dataclass(frozen=True)
class Improvement(Documented):
    """A change on the same seeds.

    Of `failing` runs, `rescued` now complete; of `completing` ones, `lost` no longer do.

    Attributes:
        options: run settings of the change.
        typed: the same as options of the command line.
        rate: share of completed runs without it.
    """

    KEYS: ClassVar[str] = "* gain error"

    text: str
    options: Mapping[str, Any]
    rescued: int
    failing: int
    lost: int
    completing: int
    rate: float
    typed: str = ""

    @property
    def gain(self) -> float:
        """Increase of the share of completed runs by the change, as a difference of shares."""
        increase = (1 - self.rate) * self.rescued / max(self.failing, 1)
        return increase - self.rate * self.lost / max(self.completing, 1)

    @property
    def error(self) -> float:
        """Standard error of the gain, from binomial counts.

        Two more of each kind keep it above zero (Agresti and Coull, 1998).
        """
        groups = ((1 - self.rate, self.rescued, self.failing), (self.rate, self.lost, self.completing))
        shares = [(weight, (hits + 2) / (count + 4), count + 4) for weight, hits, count in groups if count]
        return math.sqrt(sum(weight**2 * share * (1 - share) / count for weight, share, count in shares))


@dataclass(frozen=True)
class Preflight(Shown, Documented):
    """Forecast before the first run.

    Attributes:
        itinerary: name of the itinerary.
        title: title of the itinerary.
        model: name of the model.
        share: completed runs, with its interval at `confidence`.
        confidence: confidence of the intervals, such as 0.95.
        known: properties of the bench.
        notes: warnings.
        endings: of failed runs, the most frequent first.
        borders: the nearest first.
        changes: the largest gain first.
        seconds: computing time.
        picture: page that was written, if any.
        warnings: figures of plan and bench that explain the failures, as in `Plan.warnings`.
    """

    KEYS: ClassVar[str] = (
        "itinerary title model status advice **share:runs,completed=successes,success_rate=rate,wilson=interval "
        "confidence known notes warnings endings=ending_shares borders changes seconds"
    )

    itinerary: str
    title: str
    model: str
    share: Share
    confidence: float
    known: tuple[Assumption, ...]
    notes: tuple[str, ...]
    endings: tuple[EndingShare, ...]
    borders: tuple[HazardBorder, ...]
    changes: tuple[Improvement, ...]
    seconds: float
    picture: Path | None = None
    warnings: tuple[Any, ...] = ()

    def __repr__(self) -> str:
        return f"<preflight of {self.itinerary!r}: {self.status}>"

    @property
    def likely(self) -> bool | None:
        """True if at least nine of ten runs complete, False if less than half do, and None in between."""
        return self.share.likely

    @property
    def status(self) -> str:
        """Sentence on the share of completed runs."""
        return self.share.sentence(self.confidence)

    @property
    def advice(self) -> str:
        """Sentence on the best change, or on the nearest border."""
        best_change = self.changes[0] if self.changes else None
        if best_change is not None and best_change.gain > 2 * best_change.error:
            return f"{best_change.text} would gain most: {100 * best_change.gain:+.0f} points of {self.share.rate:.0%}"
        nearest = next((border for border in self.borders if border.margin is not None), None)
        border_text = (
            "" if nearest is None else f"; the nearest border is that of {nearest.name}, at {nearest.sentence}"
        )
        no_change_text = (
            "no run failed, so no change can help" if best_change is None else "no change gains more than chance"
        )
        return no_change_text + border_text

    @property
    def ending_shares(self) -> list[dict[str, Any]]:
        """Endings with their shares of all runs."""
        return [{**document_of(ending), "share": ending.runs / self.share.runs} for ending in self.endings]
