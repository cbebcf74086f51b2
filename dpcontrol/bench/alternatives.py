"""Panels from alternatives: what each does is timed in turns with the others, its result judged."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Generic, TypeVar

from dpcontrol.bench.chart import Missing, Panel, Point
from dpcontrol.bench.measure import timed_in_turns
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.progress import Progress, no_progress

T = TypeVar("T")


@dataclass(frozen=True)
class Alternative(Generic[T]):
    """A method at one setting: `work` is what is timed; it does `units` of what a point's time is of."""

    method: str
    setting: str
    work: Callable[[], T]
    default: bool = False
    outside: bool = False
    units: float = 1.0


@dataclass(frozen=True)
class Judged:
    """What is thought of a result: its error, further measures, a note."""

    error: float
    others: Mapping[str, float] = field(default_factory=dict)
    note: str = ""


@dataclass(frozen=True)
class Compared:
    """Points of alternatives, seconds that each method needs once, and what has no point."""

    points: tuple[Point, ...]
    start_up: Mapping[str, float]
    missing: tuple[Missing, ...]

    def panel(self, title: str, x_label: str, y_label: str, **more: Any) -> Panel:
        """Return the diagram of these points; more: of `Panel`."""
        known: dict[str, Any] = {"points": self.points, "start_up": self.start_up, "missing": self.missing}
        return Panel(title, x_label, y_label, **{**known, **more})


@dataclass(frozen=True)
class _Failed:
    reason: str


def compare(
    alternatives: Sequence[Alternative[T]],
    judge: Callable[[Alternative[T], T], Judged | str],
    *,
    rounds: int = 31,
    most: float = float("inf"),
    least: int = 3,
    starts_up: bool = True,
    progress: Progress = no_progress,
) -> Compared:
    """Time alternatives in turns and judge each with what its first call returns: a text is why it has no point.

    Work that raises an ArithmeticError, RuntimeError or GoalMissed has none either.

    rounds, most, least, starts_up, progress: see `timed_in_turns`.
    """
    judged: dict[int, Judged | str] = {}

    def tried(work: Callable[[], T]) -> T | _Failed:
        try:
            return work()
        except (ArithmeticError, RuntimeError, GoalMissed) as failure:
            return _Failed(str(failure).splitlines()[0][:200])

    def worth(k: int, result: T | _Failed) -> bool:
        judged[k] = result.reason if isinstance(result, _Failed) else judge(alternatives[k], result)
        return not isinstance(judged[k], str)

    works = {k: partial(tried, one.work) for k, one in enumerate(alternatives)}
    spent = timed_in_turns(
        works, rounds, most=most, least=least, worth=worth, starts_up=starts_up, progress=progress
    )  # fmt: skip
    points, missing = [], []
    start_up: dict[str, float] = {}
    for k, one in enumerate(alternatives):
        found, run = judged[k], spent[k]
        if isinstance(found, str):
            missing.append(Missing(one.method, one.setting, found))
            continue
        if starts_up:
            start_up[one.method] = max(start_up.get(one.method, 0.0), run.start_up)
        points.append(
            Point(one.method, one.setting, run.seconds / one.units, found.error, default=one.default,
                  outside=one.outside, note=found.note, others=found.others, yardstick=run.yardstick)
        )  # fmt: skip
    return Compared(tuple(points), start_up, tuple(missing))
