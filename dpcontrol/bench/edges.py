"""Maps of failure: where a method stops working, found by bisection, beside the predicted border.

On each line of a map one quantity y is varied between a value that works and one that does not. The border lies at

    measured = √(near · far),    far / near ≤ ratio,    off = max(measured / predicted, predicted / measured) - 1

A border agrees where `off` is at most a quarter, or the prediction lies between near and far. Where chance decides,
near and far may be found otherwise: by a standard error to either side of a mean. What the product itself says on the
far side is kept with the border: a failure that nobody reports is a complaint.

Source: for bisection on a yes-or-no answer, Press et al., Numerical Recipes, 3rd ed., section 9.1.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from textwrap import shorten
from typing import Any, ClassVar, TypeVar

from dpcontrol.bench.chart import ChartPage, ChartTable
from dpcontrol.foundation.progress import Progress

AGREES = 0.25
"""How far measured and predicted borders may be apart, as a share."""
_MOST_PROBES = 60
_SHOWN = 90
"""Characters of what is said, in a table; the JSON holds all."""


@dataclass(frozen=True)
class Attempt:
    """Whether something works, and what is said of it where it does not."""

    works: bool
    says: str = ""


def half_of(answers: Sequence[Attempt], lost: str) -> Attempt:
    """Return whether at least half of the answers work, else how many do not (`lost` in words) and what one says."""
    said = [answer.says for answer in answers if not answer.works]
    if 2 * len(said) <= len(answers):
        return Attempt(True)
    first = next(filter(None, said), "")
    return Attempt(False, first and f"{len(said)} of {len(answers)} {lost}; {first}")


Probe = Callable[[float], Attempt]


@dataclass(frozen=True)
class Trial:
    """One value that was tried, and what came of it."""

    y: float
    works: bool
    says: str


@dataclass(frozen=True)
class Border:
    """The border on one line of a map.

    x: the line's place; line: its name; near, far: the last value that works and the first that does not, None where
    the range tried has none; predicted: by theory, None where there is none; says: what the product says at `far`.
    """

    x: float
    line: str
    near: float | None
    far: float | None
    predicted: float | None
    says: str
    trials: tuple[Trial, ...]

    @property
    def measured(self) -> float | None:
        """The border, None where one of its sides was not found."""
        return math.sqrt(self.near * self.far) if self.near and self.far else None

    @property
    def off(self) -> float | None:
        """By what share measured and predicted are apart: zero where the prediction lies between near and far."""
        if self.measured is None or self.predicted is None or not self.near or not self.far:
            return None
        if min(self.near, self.far) <= self.predicted <= max(self.near, self.far):
            return 0.0
        return max(self.measured / self.predicted, self.predicted / self.measured) - 1

    def document(self) -> dict[str, Any]:
        """Return the border in JSON's terms."""
        return {**asdict(self), "measured": self.measured, "off": self.off}


def find_border(
    probe: Probe,
    *,
    x: float,
    line: str,
    near: float,
    far: float,
    predicted: float | None = None,
    ratio: float = 1.1,
    unit: float = 0.0,
) -> Border:
    """Return the border between `near`, which is to work, and `far`, which is not; both positive, either may be larger.

    ratio: how near together its sides are brought; unit: only whole numbers of it are tried, down to neighbours.
    """
    trials: list[Trial] = []
    near, far = (max(round(y / unit), 1) * unit if unit else y for y in (near, far))

    def asked(y: float) -> bool:
        answer = probe(y)
        trials.append(Trial(y, answer.works, answer.says))
        return answer.works

    def done(says: str, good: float | None, bad: float | None) -> Border:
        return Border(x, line, good, bad, predicted, says, tuple(sorted(trials, key=lambda t: t.y)))

    if not asked(near):
        return done(trials[-1].says, None, near)
    if asked(far):
        return done("", far, None)
    good, bad, says = near, far, trials[-1].says
    while len(trials) < _MOST_PROBES and max(good / bad, bad / good) > ratio:
        middle = math.sqrt(good * bad)
        if unit:
            low, high = sorted((round(good / unit), round(bad / unit)))
            if high - low < 2:
                break
            middle = min(max(round(middle / unit), low + 1), high - 1) * unit
        if asked(middle):
            good = middle
        else:
            bad, says = middle, trials[-1].says
    return done(says, good, bad)


T = TypeVar("T")


def borders(border: Callable[[T], Border], values: Sequence[T], progress: Progress, what: str) -> tuple[Border, ...]:
    """Return the border at each value; what: names them to `progress`, with {} for the value."""
    found = []
    for k, value in enumerate(values):
        progress(what.format(value), k / len(values))
        found.append(border(value))
    return tuple(found)


@dataclass(frozen=True)
class EdgeMap:
    """One map: borders on its lines. theory: what predicts them, "" where nothing does; far, near: the sides in
    words.

    agrees: how far measured and predicted may be apart, as a share.
    """

    title: str
    x_label: str
    y_label: str
    borders: tuple[Border, ...]
    theory: str = ""
    far: str = "fails"
    near: str = "works"
    log_x: bool = True
    agrees: float = AGREES

    def complaints(self) -> tuple[str, ...]:
        """Return a sentence for each border that is not found, not where it is predicted, or passed in silence."""
        found = []
        for b in self.borders:
            where, predicted = f"{self.title}, {b.line}", f"predicted at {b.predicted or 0:.3g}"
            if b.predicted is not None and b.near is None:
                found.append(f"{where}: nothing works, not even {b.far:.3g}, {predicted}")
            elif b.predicted is not None and b.far is None:
                found.append(f"{where}: no border up to {b.near:.3g}, {predicted}")
            elif b.off is not None and b.off > self.agrees:
                found.append(f"{where}: border at {b.measured:.3g}, {predicted}, {b.off:.0%} apart")
            if b.far is not None and not b.says:
                found.append(f"{where}: what lies beyond {b.far:.3g} is not reported")
        return tuple(found)

    def document(self) -> dict[str, Any]:
        """Return the map in JSON's terms."""
        return {**asdict(self), "borders": [b.document() for b in self.borders], "complaints": list(self.complaints())}

    def table(self) -> ChartTable:
        """Return the borders as a table."""
        rows = tuple(
            (b.line, _number(b.near), _number(b.far), _number(b.predicted), "" if b.off is None else f"{b.off:.0%}",
             shorten(b.says, _SHOWN, placeholder=" …"))
            for b in self.borders
        )  # fmt: skip
        notes = (f"predicted: {self.theory}",) if self.theory else ()
        return ChartTable(
            f"{self.title}: {self.y_label}",
            ("line", self.near, self.far, "predicted", "apart", "what it says"),
            rows,
            notes,
        )


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


@dataclass(frozen=True)
class EdgeChart(ChartPage):
    """A page of maps of failure."""

    PARTS: ClassVar[str] = "maps"

    maps: tuple[EdgeMap, ...] = ()
