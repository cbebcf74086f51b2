"""Evaluate a long run from the folder of its logs: times on and off the itinerary, and the reasons.

    uptime = time on the itinerary / known time

At a fall the supervisor gives up the itinerary. The time until the itinerary is joined again is one
absence, regardless of further falls in it. The files' digests are read one by one; a missing digest, as after a killed
run, is computed from the log.
"""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import Cause
from dpcontrol.foundation.checked import checked
from dpcontrol.foundation.document import Documented, picked
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.rendering import DataFrame
from dpcontrol.foundation.settings import check_choice
from dpcontrol.foundation.shown import Shown, data_frame
from dpcontrol.judge.score import ENDINGS
from dpcontrol.logs.container import partials_of
from dpcontrol.logs.layout import CATCH, FLIGHT, LAP, RESUME, RETURN, Event
from dpcontrol.logs.reader import read_log
from dpcontrol.logs.rolling import Digest, digest_of_log

ITINERARY, BRAKING, FLYING = "on the itinerary", "braking", "in flight"
BETWEEN, UNKNOWN = "between repetitions", "no log"
"""Kinds of spans, as displayed."""
STOPPED = "ended"
_SHORT = 0.05
"""Share of the longest file's time below which a mean does not count: estimates drift while the cart is at rest."""
_GAP = 0.5
"""Least gap between two files, s."""


@dataclass(frozen=True)
class NightSpan:
    """A part of a night of one kind, such as "braking".

    Attributes:
        first: begin, s.
        end: end, s.
        kind: activity.
        cause: cause of the preceding fall, or "".
    """

    first: float
    end: float
    kind: str
    cause: str = ""


@dataclass(frozen=True)
class Fall:
    """A fall off the itinerary, or of a flight back to it.

    Attributes:
        time: time of the fall, s.
        cause: cause of the fall.
        text: logged text.
        back: time until the itinerary was joined again, s, from the first of consecutive falls, or None.
    """

    time: float
    cause: str
    text: str
    back: float | None = None


@dataclass(frozen=True)
class Drift:
    """Course of one estimated parameter, which shows a drift of the bench.

    Attributes:
        name: name of the parameter.
        first: mean over the first file.
        last: mean over the last file.
        per_hour: change per hour by a straight line through the files' means; not-a-number for a single file.
    """

    name: str
    first: float
    last: float
    per_hour: float


@dataclass(frozen=True, eq=False)
class Night(Shown, Documented):
    """A long run, represented by its digests in order.

    Attributes:
        folder: folder of the night.
        digests: figures and events of each file, in order.
        partials: unfinished logs.
        spans: periods by activity, in order.
        falls: falls in order of time.
    """

    folder: Path
    digests: tuple[Digest, ...]
    partials: tuple[Path, ...]
    spans: Sequence[NightSpan]
    falls: Sequence[Fall]
    endings: Sequence[Event]
    """Events of endings, except by the planned time."""

    @property
    def failure(self) -> str:
        """Reason why the night ended before its planned time, or ""."""
        return next((end.text for end in reversed(self.endings) if end.time >= self.digests[-1].first), "")

    @property
    def missed(self) -> str:
        """Reason for an end before the planned time, or ""."""
        return self.failure and f"ended early: {self.failure}"

    def _time(self, *kinds: str) -> float:
        """Return the total time of spans of these kinds, s, such as that on the itinerary."""
        return sum(span.end - span.first for span in self.spans if span.kind in kinds)

    @property
    def known(self) -> float:
        """Time with a log, s, to which shares and rates refer."""
        return sum(digest.end - digest.first for digest in self.digests)

    @property
    def uptime(self) -> float:
        """Share of the known time on the itinerary."""
        return self._time(ITINERARY) / self.known

    @property
    def falls_per_hour(self) -> float:
        """Falls in an hour of the known time."""
        return 3600 * len(self.falls) / self.known

    @property
    def causes(self) -> dict[str, int]:
        """Number of falls by cause, the most frequent first."""
        return dict(Counter(fall.cause for fall in self.falls).most_common())

    @property
    def returns(self) -> Array:
        """Time from each fall until the itinerary was joined again, s."""
        return np.array([fall.back for fall in self.falls if fall.back is not None])

    @property
    def repetitions(self) -> int:
        """Number of completed repetitions of the itinerary."""
        return sum(digest.repetitions for digest in self.digests)

    @property
    def catches(self) -> int:
        """Number of catches before a fall."""
        return sum(digest.others.get(CATCH, 0) for digest in self.digests)

    @property
    def tracking(self) -> float:
        """Rms distance of the angles from the reference on the itinerary, rad."""
        followed = sum(digest.followed for digest in self.digests)
        return math.sqrt(sum(digest.squares for digest in self.digests) / followed / 2) if followed else math.nan

    @property
    def cart(self) -> float:
        """Greatest distance of the cart from the centre, m."""
        return max(digest.cart for digest in self.digests)

    @property
    def stop_hits(self) -> int:
        """Number of times the cart hit an end stop of its track."""
        return sum(end.cause == Cause.HARD_STOP for end in self.endings)

    @property
    def estimated(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        return tuple(dict.fromkeys(name for digest in self.digests for name in digest.extras))

    @checked
    def course(self, name: str) -> tuple[Array, Array]:
        """Return hours (K,) and means (K,) of a parameter by file, without short files.

        The hour is that of the file's middle, from the start of the night. Estimates of files shorter than `_SHORT` of
        the longest one do not count.

        Args:
            name: estimated parameter, such as "zero_1".

        Raises:
            InputError: unknown parameter.
        """
        check_choice("parameter", self.estimated, name)
        with_parameter = [digest for digest in self.digests if name in digest.extras]
        shortest = _SHORT * max(digest.end - digest.first for digest in with_parameter)
        long_digests = [digest for digest in with_parameter if digest.end - digest.first >= shortest]
        return np.array(
            [(digest_of_file.first + digest_of_file.end) / 7200 for digest_of_file in long_digests]
        ), np.array([digest_of_file.extras[name][0] for digest_of_file in long_digests])

    @property
    def drifts(self) -> tuple[Drift, ...]:
        """Courses of the estimated parameters."""
        courses = {name: self.course(name) for name in self.estimated}
        return tuple(
            Drift(
                name,
                float(means[0]),
                float(means[-1]),
                float(np.polyfit(hours, means, 1)[0]) if len(means) > 1 else math.nan,
            )
            for name, (hours, means) in courses.items()
        )

    @property
    def memory_growth(self) -> float:
        """Final memory of the process relative to the session's first file, not-a-number if unknown.

        A leak would end a long run.
        """
        last_digest = self.digests[-1]
        memories = [
            digest.memory
            for digest in self.digests
            if digest.session == last_digest.session and math.isfinite(digest.memory)
        ]
        return memories[-1] / memories[0] if memories else math.nan

    @property
    def unlogged(self) -> tuple[NightSpan, ...]:
        """Times without a log."""
        return tuple(span for span in self.spans if span.kind == UNKNOWN)

    @property
    def deadlines(self) -> dict[str, float] | None:
        """Deadline statistics of a rig, or None in simulation.

        Counts cover all sessions; the worst delay is in s.
        """
        records = [digest.deadlines for digest in self.digests if digest.deadlines]
        counts = {name: sum(int(record[name]) for record in records) for name in ("ticks", "missed", "lost", "held")}
        return {**counts, "worst": max(record["worst"] for record in records)} if records else None

    @property
    def sentence(self) -> str:
        """Summary of the night in one line."""
        hours, back = self.known / 3600, ""
        if len(self.returns):
            median, slowest = np.quantile(self.returns, [0.5, 0.99])
            back = f", back on it after {median:.1f} s in the median, 99 % within {slowest:.1f} s"
        catches = f"caught {self.catches} time{'s' * (self.catches > 1)}, " if self.catches else ""
        return (
            f"{hours:.3g} hours: {self.uptime:.1%} of the time on the itinerary, {self.repetitions} repetitions; "
            f"{catches}{len(self.falls)} fall{'s' * (len(self.falls) != 1)} ({self.falls_per_hour:.3g} an hour){back}"
        )

    def document(self) -> dict[str, Any]:
        """Return the output of `dpcontrol score FOLDER --json`."""
        quantiles = np.quantile(self.returns, [0.5, 0.99]).tolist() if len(self.returns) else [None, None]
        # Falls that took the run off its itinerary.
        ends = [span.end for span in self.spans if span.kind == ITINERARY]
        departures = [fall for fall in self.falls if np.isclose(ends, fall.time, rtol=0, atol=1e-6).any()]
        unlogged_times = [picked(span, "first", "end") for span in self.unlogged]
        return {
            "log": self.folder, "hours": self.known / 3600, "files": len(self.digests),
            "files_kept": len([*self.folder.glob("*.mcap")]),
            "sessions": len({digest.session for digest in self.digests}),
            "uptime": self.uptime, "repetitions": self.repetitions, "falls": len(self.falls),
            "catches": self.catches, "falls_per_hour": self.falls_per_hour, "causes": self.causes,
            "return_median": quantiles[0], "return_99": quantiles[1],
            "not_back": sum(fall.back is None for fall in departures),
            "stop_hits": self.stop_hits, "max_cart_position": self.cart, "rms_tracking_error": self.tracking,
            "seconds": {kind: self._time(kind) for kind in (ITINERARY, BRAKING, FLYING, BETWEEN)},
            "not_logged": unlogged_times, "endings": [picked(end, "time", "text", "cause") for end in self.endings],
            "drift": [asdict(drift) for drift in self.drifts],
            "memory_growth": self.memory_growth, "deadlines": self.deadlines, "partials": list(self.partials),
        }  # fmt: skip

    def frame(self) -> DataFrame:
        """Return a pandas table, one row for each file.

        The index `time` is the start of the file since the start of the night, s. The columns are the end (s), the
        session, ticks, repetitions, falls, the cart's greatest distance from the centre (m), and the means of the
        estimated parameters.

        Raises:
            PartMissing: pandas is not installed.
        """
        rows = [
            {
                **picked(digest, "end", "session", "ticks", "repetitions", "cart"),
                "falls": sum(digest.first <= fall.time < digest.end for fall in self.falls),
                **{name: mean for name, (mean, _) in digest.extras.items()},
            }
            for digest in self.digests
        ]
        return data_frame(rows, times=[digest.first for digest in self.digests])


def followed(digests: Sequence[Digest]) -> tuple[list[NightSpan], list[Fall], list[Event]]:
    """Return the spans, falls and early endings of a night, from the events of its digests in order.

    Spans are the times on the itinerary, braking, in flight, between repetitions, after an end, and without a log.
    Endings at the planned time are left out. Several falls before the itinerary is joined again count one by one, and
    the first of them has the time back.

    Args:
        digests: digests in order.
    """
    falls: list[Fall] = []
    endings: list[Event] = []
    end, first_fall = digests[0].first, None
    changes = [(end, STOPPED, "")]

    def change(time: float, kind: str, cause: str = "") -> None:
        """Append the begin of a span to `changes`, unless the present span has the same kind and cause."""
        if changes[-1][1:] != (kind, cause):
            changes.append((time, kind, cause))

    # `first_fall` is the index of the fall that began the present absence, None on the itinerary.
    for digest in digests:
        if digest.first > end + _GAP:
            change(end, UNKNOWN)
            change(digest.first, ITINERARY if digest.on else STOPPED)
            first_fall = None
        for event in digest.events:
            (_, kind, cause), time, name = changes[-1], event.time, event.name
            if name in (RESUME, LAP):
                if first_fall is not None:
                    falls[first_fall] = replace(falls[first_fall], back=time - falls[first_fall].time)
                    first_fall = None
                change(time, ITINERARY)
            elif name == RETURN and event.level == "info":
                change(time, BETWEEN)
            elif name == RETURN:
                first_fall = len(falls) if first_fall is None else first_fall
                falls.append(Fall(time, event.cause, event.text))
                change(time, BRAKING, falls[first_fall].cause)
            elif name == FLIGHT and kind not in (STOPPED, ITINERARY):
                change(time, kind if kind == BETWEEN else FLYING if event.level == "info" else BRAKING, cause)
            elif name in ENDINGS:
                if name != "finished":
                    endings.append(event)
                change(time, STOPPED)
        end = digest.end
    ends = [*(time for time, _, _ in changes[1:]), end]
    spans = [
        NightSpan(change[0], end_of_span, *change[1:])
        for change, end_of_span in zip(changes, ends, strict=True)
        if end_of_span > change[0]
    ]
    return spans, falls, endings


def read_night(folder: Path) -> Night:
    """Return the long run in a folder.

    Args:
        folder: folder of the logs.

    Raises:
        InputError: the folder holds none, or one of its files is damaged or from another run.
    """
    folder = Path(folder)
    if not (digests := [*_digests(folder)]):
        raise InputError(
            f"cannot read {folder}: it is a folder without logs of a long run; give a log, or a folder that "
            "`dpcontrol run --hours` made"
        )
    partials = partials_of(folder / folder.resolve().name)
    # Partial files with a recovered log are not reported.
    unrecovered = [file for file in partials if not (folder / f"{file.name.partition('.mcap')[0]}.mcap").exists()]
    return Night(folder, tuple(digests), tuple(unrecovered), *followed(digests))


def _digests(folder: Path) -> Iterator[Digest]:
    """Yield the digests of a night's files in order: figures and events of each log.

    A night is evaluated from them, without reading hours of logs. A digest that is missing, damaged or made of a log of
    another size, as after a killed run, is computed from its log.

    Raises:
        InputError: a digest is damaged and its log missing.
    """
    name = folder.resolve().name
    numbers = sorted({file.stem for file in folder.glob(f"{name}-[0-9]*") if file.suffix in (".mcap", ".json")})
    for stem in numbers:
        log, digest_file = folder / f"{stem}.mcap", folder / f"{stem}.json"
        size = log.stat().st_size if log.is_file() else None
        digest = None
        with suppress(OSError, ValueError, TypeError, KeyError):
            digest = Digest.of(digest_file.read_text(encoding="utf-8"))
        if digest is not None and size in (None, digest.size):
            yield digest
        elif size is not None:
            yield digest_of_log(read_log(log), size=size)
        else:
            raise InputError(f"{digest_file} is damaged, and its log was thinned; remove it to score the other files")
