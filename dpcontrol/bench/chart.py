"""Data structures of the charts: work-precision charts and maps of failure.

A work-precision chart shows methods as points of time and error, their front, and the package's default.

A point is on the *front* if no other point of its panel is at most as slow and at most as wrong, and better in one.
A default t, e is off the front by

    off = min(t / min{t' : e' ≤ e},  e / min{e' : t' ≤ t}) - 1

At `off` ≤ 0.2 no equally precise method is over 20 % faster, or no equally fast one is over 20 % more precise.

Source: Hairer, Nørsett & Wanner, Solving Ordinary Differential Equations I (1993), section II.10.

A map of failure shows the limit of a method, found by bisection, beside the predicted border.

On each line of a map one quantity y is varied between a working and a failing value. The border lies at

    measured = √(near · far),    far / near ≤ ratio,    off = max(measured / predicted, predicted / measured) - 1

A border agrees if `off` is at most a quarter, or the prediction lies between near and far. The package's message on the
far side is kept with the border; an unreported failure is a complaint.

Source: for bisection on a yes-or-no answer, Press et al., Numerical Recipes, 3rd ed., section 9.1.
"""

import importlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from textwrap import shorten
from typing import Any, ClassVar

from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.progress import Progress
from dpcontrol.foundation.settings import check_choice
from dpcontrol.foundation.units import quantity
from dpcontrol.words.table import Line, TextTable

ALLOWED = 0.2
"""Largest distance of a default from the front, with a reason."""
AGREES = 0.25
"""Tolerance between measured and predicted borders, as a share."""
LEADING = 3
"""Diagrams on a page of a chart."""


UNITS = ("s", "m", "rad", "J", "m/s²", "m/s² per rad", "m²/s³", "1/(N m s)", "N m s")
"""Units that axis labels can end with."""


def split_label(label: str) -> tuple[str, str]:
    """Return the quantity and the unit of an axis label, the unit after its last comma or "".

    Axes then show the unit with an SI prefix.

    Args:
        label: quantity, with or without a unit.
    """
    name, _, unit = label.rpartition(", ")
    return (name, unit) if unit in UNITS else (label, "")


@dataclass(frozen=True)
class Point:
    """One method at one setting, with its cost and error.

    Attributes:
        method: name of the method.
        setting: its setting.
        seconds: cost of a unit of work, s, or the x of the diagram.
        error: error of the result, the y of the diagram.
        default: True for the package's choice.
        outside: True for another package's method.
        stored: True if measured elsewhere, drawn but excluded from the front.
        note: a few words for display.
        others: further measures by name, for the JSON.
    """

    method: str
    setting: str
    seconds: float
    error: float
    default: bool = False
    outside: bool = False
    stored: bool = False
    note: str = ""
    others: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Method and setting."""
        return f"{self.method}, {self.setting}" if self.setting else self.method


@dataclass(frozen=True)
class Missing:
    """A method and setting without a point, because it failed or its package is not installed."""

    method: str
    setting: str
    reason: str


@dataclass(frozen=True)
class Diagram(Documented):
    """One diagram of points for the same work.

    Attributes:
        title: title of the diagram.
        x_label: quantity of the points' cost, with its unit.
        y_label: quantity of their error, with its unit.
        points: methods at their settings.
        missing: those without a point.
        why: reason for keeping a default off the front, or "".
        log_y: False for shares.
        floor: errors below it are rounding and count as equal.
        judged: False for a second view of work that another panel judges.
        joined: True for methods with three points each, of a first result with an empty and a filled cache, and of
            later results; their points are joined instead of the front.
    """

    KEYS: ClassVar[str] = "* front=front.name defaults=standings"

    title: str
    x_label: str
    y_label: str
    points: tuple[Point, ...]
    missing: tuple[Missing, ...] = ()
    why: str = ""
    log_y: bool = True
    floor: float = 0.0
    judged: bool = True
    joined: bool = False

    @property
    def _running(self) -> list[tuple[Point, float]]:
        """Points that take part in the front, with their errors of at least the floor."""
        return [(point, max(point.error, self.floor)) for point in self.points if not point.stored]

    @property
    def front(self) -> tuple[Point, ...]:
        """Points on the front, fastest first: no other point is at most as slow and as wrong, and better in one."""
        competitors = self._running
        undominated = [
            point
            for point, error in competitors
            if not any(
                other.seconds <= point.seconds
                and other_error <= error
                and (other.seconds, other_error) != (point.seconds, error)
                for other, other_error in competitors
            )
        ]
        return tuple(sorted(undominated, key=lambda point: (point.seconds, point.error)))

    @property
    def defaults(self) -> tuple[Point, ...]:
        """Points of the package's defaults."""
        return tuple(point for point in self.points if point.default)

    def off_front(self, point: Point) -> float:
        """Return the distance `off` of a point from the front as a share, 0 on the front; see the head of this module.

        Args:
            point: point of this diagram.
        """
        error = max(point.error, self.floor)
        fastest = min(rival.seconds for rival, rival_error in self._running if rival_error <= error)
        most_precise = min(rival_error for rival, rival_error in self._running if rival.seconds <= point.seconds)
        # If no equally fast point is more precise, only time measures the distance.
        error_ratio = error / most_precise if 0 < most_precise < error else math.inf
        return min(point.seconds / fastest, error_ratio) - 1

    def standing(self, point: Point) -> str:
        """Return the position of a point in words.

        Args:
            point: point of this diagram.
        """
        return "on the front" if point in self.front else f"{self.off_front(point):.0%} off the front"

    def finding(self) -> str:
        """Return the diagram's result in one sentence: the first default against the fastest other point as precise.

        Without a default, the most precise point of the front is compared. If lines join the points, each method has
        three, of an empty cache, a filled one and later results, and the result is the range of the first two's ratio.
        """
        if self.joined:
            times = [point.seconds for point in self.points]
            shares = [empty / filled for empty, filled in zip(times[::3], times[1::3], strict=True)]
            return f"a first result takes {min(shares):.2g} to {max(shares):.2g} times as long with an empty cache"
        default = next(iter(self.defaults), self.front[-1])
        error, unit = max(default.error, self.floor), split_label(self.y_label)[1]
        measured, cost = (label.partition(",")[0] for label in (self.y_label, self.x_label))
        as_precise = [point for point, point_error in self._running if point is not default and point_error <= error]
        if not as_precise:
            return (
                f"{default.name} has the smallest {measured}, {quantity(error, unit) if self.log_y else f'{error:.0%}'}"
            )
        other = min(as_precise, key=lambda point: point.seconds)
        return f"{other.name} does as well as {default.name} at {other.seconds / default.seconds:.2g} times its {cost}"

    def complaints(self) -> tuple[str, ...]:
        """Return a sentence for each default off the front without reason, or too far off even with a reason."""
        return tuple(
            f"{self.title}: the default {p.name} is {self.standing(p)}{'' if self.why else ' and no reason is given'}"
            for p in self.defaults
            if self.judged and (self.off_front(p) > ALLOWED or not (self.why or p in self.front))
        )

    @property
    def standings(self) -> list[dict[str, Any]]:
        """Position of each default, for the JSON."""
        return [
            {"name": point.name, "off_front": self.off_front(point), "standing": self.standing(point)}
            for point in self.defaults
        ]

    def text(self) -> Iterator[Line]:
        """Yield a table, then the result and notes.

        The table has all points if a line joins them, otherwise the front and the defaults off it.
        """
        listed_points = (
            self.points
            if self.joined
            else [*self.front, *(point for point in self.defaults if point not in self.front)]
        )
        rows = tuple(
            (
                point.method,
                point.setting,
                f"{point.seconds:.3g}",
                f"{point.error:.2g}",
                self.standing(point) if point.default else "",
                point.note,
            )
            for point in listed_points
        )
        yield TextTable(self.title, ("front", "setting", self.x_label, self.y_label, "default", ""), rows)
        yield f"  {self.finding()}"
        yield from (f"  without {m.method} {m.setting}: {m.reason}" for m in self.missing)
        if self.why:
            yield f"  the default is kept: {self.why}"


@dataclass(frozen=True)
class Attempt:
    """Outcome of a trial at one value.

    Attributes:
        works: True for success.
        says: message of a failure.
    """

    works: bool
    says: str = ""


def half_of(answers: Sequence[Attempt], lost: str) -> Attempt:
    """Return success if at least half of the runs succeed, otherwise the number of failures and one message.

    Borders of random outcomes lie at half the successes.

    Args:
        answers: outcome of each run.
        lost: what failed runs did, for the message.
    """
    messages = [answer.says for answer in answers if not answer.works]
    if 2 * len(messages) <= len(answers):
        return Attempt(True)
    first_message = next(filter(None, messages), "")
    return Attempt(False, first_message and f"{len(messages)} of {len(answers)} {lost}; {first_message}")


@dataclass(frozen=True)
class Border(Documented):
    """The border on one line of a map.

    Attributes:
        x: position of the line.
        line: its name.
        near: last working value, or None.
        far: first failing value, or None.
        predicted: by theory, or None.
        says: the package's message at `far`.
        trials: tried values with their outcomes.
    """

    KEYS: ClassVar[str] = "* trials:y,attempt measured off"

    x: float
    line: str
    near: float | None
    far: float | None
    predicted: float | None
    says: str
    trials: tuple[tuple[float, Attempt], ...]

    @property
    def measured(self) -> float | None:
        """The border, None if one of its sides is missing."""
        return math.sqrt(self.near * self.far) if self.near and self.far else None

    @property
    def off(self) -> float | None:
        """Difference of measured and predicted border, as a share, zero if the prediction lies between the sides.

        It is None without a border or a prediction.
        """
        if self.measured is None or self.predicted is None or not self.near or not self.far:
            return None
        if min(self.near, self.far) <= self.predicted <= max(self.near, self.far):
            return 0.0
        return max(self.measured / self.predicted, self.predicted / self.measured) - 1


def find_border(
    probe: Callable[[float], Attempt],
    *,
    x: float,
    line: str,
    near: float,
    far: float,
    predicted: float | None = None,
    ratio: float = 1.1,
    unit: float = 0.0,
) -> Border:
    """Find the border between a value that works and a value that fails by bisection of their ratio.

    Both values are positive, in either order. If `near` fails already, the border has no working side; if `far` works
    as well, it has no failing side. No value between them is then tried.

    Args:
        probe: function of a value, which tries it.
        x: position of the border's line on its map.
        line: name of this line.
        near: value that is expected to work, which is tried first.
        far: value that is expected to fail, which is tried second.
        predicted: value from theory, or None.
        ratio: largest final ratio of the sides.
        unit: restricts values to its multiples; the search ends at neighbours.
    """
    trials: dict[float, Attempt] = {}
    working, failing = (max(round(value / unit), 1) * unit if unit else value for value in (near, far))

    def works(value: float) -> bool:
        """Try a value by `probe`, store the outcome in `trials`, and return True for success."""
        trials[value] = probe(value)
        return trials[value].works

    sides: tuple[float | None, float | None] = failing, None
    if not works(working):
        sides = None, working
    elif not works(failing):
        while max(working / failing, failing / working) > ratio:
            middle = math.sqrt(working * failing)
            if unit:
                middle = round(middle / unit) * unit
            if middle in (working, failing):
                break
            working, failing = (middle, failing) if works(middle) else (working, middle)
        sides = working, failing
    message = "" if sides[1] is None else trials[sides[1]].says
    return Border(x, line, *sides, predicted, message, tuple(sorted(trials.items())))


@dataclass(frozen=True)
class EdgeMap(Documented):
    """One map: borders on its lines.

    Attributes:
        theory: basis of the prediction, "" without one.
        far: name of the failing side.
        near: name of the working side.
        agrees: tolerance between measured and predicted borders, as a share.
        default: place of the package's choice, (x, y).
    """

    KEYS: ClassVar[str] = "* complaints"

    title: str
    x_label: str
    y_label: str
    borders: tuple[Border, ...] = ()
    theory: str = ""
    far: str = "fails"
    near: str = "works"
    agrees: float = AGREES
    default: tuple[float, float] | None = None

    def finding(self) -> str:
        """Return the map's result in one sentence: the range of the borders, and how well theory predicts them."""
        measured = [border.measured for border in self.borders if border.measured is not None]
        if not measured:
            return f"no line {self.far}"
        limits = dict.fromkeys(
            quantity(value, split_label(self.y_label)[1]) for value in (min(measured), max(measured))
        )
        differences = [border.off for border in self.borders if border.off is not None]
        predicted = f", at most {max(differences):.0%} from the prediction" if differences else ""
        return f"{self.far} at {' to '.join(limits)}{predicted}"

    def complaints(self) -> tuple[str, ...]:
        """Return a sentence for each border that is missing, contradicts its prediction, or is a silent failure."""
        complaints = []
        for border_on_line in self.borders:
            place = f"{self.title}, {border_on_line.line}"
            if border_on_line.predicted is not None and (
                border_on_line.off is None or border_on_line.off > self.agrees
            ):
                border = "no border" if border_on_line.measured is None else f"border at {border_on_line.measured:.3g}"
                complaints.append(f"{place}: {border}, predicted at {border_on_line.predicted:.3g}")
            if border_on_line.far is not None and not border_on_line.says:
                complaints.append(f"{place}: the failure at {border_on_line.far:.3g} is not reported")
        return tuple(complaints)

    def text(self) -> Iterator[Line]:
        """Yield the borders as a table, then the result and the basis of the prediction."""
        rows = tuple(
            (b.line, *("-" if y is None else f"{y:.4g}" for y in (b.near, b.far, b.predicted)),
             "" if b.off is None else f"{b.off:.0%}", shorten(b.says, 90, placeholder=" …"))
            for b in self.borders
        )  # fmt: skip
        columns = ("line", self.near, self.far, "predicted", "apart", "message")
        yield TextTable(f"{self.title}: {self.y_label}", columns, rows)
        yield f"  {self.finding()}"
        if self.theory:
            yield f"  predicted: {self.theory}"


@dataclass(frozen=True)
class ChartPage(Documented):
    """A page of `dpcontrol bench` with its diagrams or maps.

    Attributes:
        name: name on the command line and of the files.
        title: title with the result.
        reading: hints for reading the diagrams.
        chosen: reason for the choice of dpcontrol.
        parts: diagrams or maps.
        file: file of a chart that is drawn alone, or None.
    """

    KEYS: ClassVar[str] = "name title headline=title reading chosen complaints findings file? panels=parts"

    name: str
    title: str
    reading: tuple[str, ...]
    chosen: str
    parts: tuple[Any, ...]
    file: Path | None = None

    @property
    def pages(self) -> dict[str, tuple[Any, ...]]:
        """The diagrams of each picture, the first ones and then the appendix, by the end of the picture's file name."""
        pictures = [self.parts[k : k + LEADING] for k in range(0, len(self.parts), LEADING)]
        name_ends = ["", "-more", *(f"-more-{k}" for k in range(2, len(pictures)))]
        return dict(zip(name_ends, pictures, strict=False))

    @property
    def complaints(self) -> tuple[str, ...]:
        """A sentence for each deviation from the requirements."""
        return tuple(text for part in self.parts for text in part.complaints())

    @property
    def findings(self) -> list[str]:
        """The result of each diagram."""
        return [f"{part.title}: {part.finding()}" for part in self.parts]


def measured_maps(
    progress: Progress, *plans: tuple[EdgeMap, Callable[[Any], Border], Sequence[Any]]
) -> tuple[EdgeMap, ...]:
    """Return maps of two settings with the borders between success and failure, measured along lines of one setting.

    Args:
        progress: called with a label and the completed share.
        *plans: a map without borders, the function that finds the border at a value of the first setting, and all
            values of this setting.
    """
    maps = []
    for k, (edge_map, border, values) in enumerate(plans):
        progress(edge_map.title, k / len(plans))
        maps.append(replace(edge_map, borders=tuple(map(border, values))))
    return tuple(maps)


def _drawn(module: str, name: str, quick: bool, progress: Progress) -> ChartPage:
    """Return the chart of one of this package's modules, which is imported only now.

    Args:
        module: name of the module.
        name: name of its function without "_chart".
        quick: reduce the work.
        progress: called with a label and the completed share.
    """
    return getattr(importlib.import_module(f"dpcontrol.bench.{module}"), f"{name}_chart")(quick, progress)


CHARTS: dict[str, Callable[[bool, Progress], ChartPage]] = {
    "stages": partial(_drawn, "stages", "stages"),
    "propagation": partial(_drawn, "propagation", "propagation"),
    **{name: partial(_drawn, "design", name) for name in ("connections", "transcription")},
    **{name: partial(_drawn, "control", name) for name in ("estimation", "control")},
    **{f"edges-{name}": partial(_drawn, "edges", name) for name in ("moving", "ogy", "estimation", "margins")},
}
"""Functions (quick, progress) -> chart; modules are imported on use. `quick` reduces the work but keeps the order on
fronts."""
GROUPS = {"edges": tuple(name for name in CHARTS if name.startswith("edges-"))}
"""Names for groups of charts."""
NAMES = (*CHARTS, *GROUPS)


def check_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the charts to draw, each once: those named, or all.

    Args:
        names: charts or groups of charts; none for all.

    Raises:
        InputError: a name is unknown.
    """
    check_choice("chart", NAMES, *names)
    charts = [chart for name in names for chart in GROUPS.get(name, (name,))]
    return tuple(dict.fromkeys(charts or CHARTS))
