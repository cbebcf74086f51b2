"""Log a long run to many files.

Each is a complete log of some minutes with a digest beside it:

    logs/NAME-SEED/NAME-SEED-0001.mcap      a log that can be opened alone, with all metadata and attachments
    logs/NAME-SEED/NAME-SEED-0001.json      its digest, which remains when the log is thinned out

Times continue from file to file. A digest holds the figures of the night report: the times on and off the itinerary,
the reasons for leaving it, the cart's travel and the estimated parameters. The same code computes it from ticks and
events, during the run and when a log is read.

If a file cannot be written, for example on a full disk, the run continues without a log and tries again at the next
file. Finished files are never reopened.
"""

import json
import math
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError, remark
from dpcontrol.foundation.files import write_whole
from dpcontrol.foundation.settings import adapter
from dpcontrol.logs.layout import FLIGHT, LAP, LEVELS, RESUME, RETURN, Event
from dpcontrol.logs.reader import RunLog
from dpcontrol.logs.writer import LogWriter

NIGHT_METADATA = "night"
"""Metadata record of each file, in JSON: its position in the night, see `RollingLog`."""
_RECORDED = (RETURN, FLIGHT, RESUME, LAP)
_DEADLINES = "deadlines_"
_SOON = 1e-6
"""Tolerance for the rounding of times, s; far less than a period."""


@dataclass
class Digest:
    """Figures and events of one file of a night, from which the night's report is made.

    Attributes:
        number: number of the file, from 1.
        session: number of starts of the night so far.
        first: time of the first tick since the start of the night, s.
        end: end of the period after the last tick, s since the start of the night.
        ticks: number of ticks.
        on: True if the run was on its itinerary at `first`.
        events: the run's decisions and its end.
        others: number of other events by name.
        repetitions: completed repetitions of the itinerary.
        cart: greatest distance of the cart from the centre, m.
        limit: travel limit of the cart, m, or zero if unknown.
        squares: sum of squared angle errors against the reference on the itinerary, rad².
        followed: number of ticks in that sum.
        extras: mean on the itinerary and last standard deviation of each estimated parameter.
        memory: resident memory of the process at the end, bytes, or NaN if the system does not report it.
        size: size of the file, bytes, or zero if it could not be written.
        loss: reason for a missing file, or "".
        deadlines: deadline statistics by name, on a rig at the end of a session.
    """

    number: int
    session: int = 1
    first: float = math.nan
    end: float = math.nan
    ticks: int = 0
    on: bool = False
    events: list[Event] = field(default_factory=list)
    others: dict[str, int] = field(default_factory=dict)
    repetitions: int = 0
    cart: float = 0.0
    limit: float = 0.0
    squares: float = 0.0
    followed: int = 0
    extras: dict[str, tuple[float, float]] = field(default_factory=dict)
    memory: float = math.nan
    size: int = 0
    loss: str = ""
    deadlines: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Initialise the running sums, which are not part of the JSON text.

        `_now_on` is True while the run is on its itinerary. `_sums` are the sums of the estimated parameters' standard
        deviations and values on the itinerary, from which `close` makes means, and `_last` the last of them.
        """
        self._now_on = self.on
        self._sums: Array | float = 0.0

    def text(self) -> str:
        """Return the digest in JSON, as the file beside the log holds it."""
        return json.dumps(asdict(self), indent=1)

    @classmethod
    def of(cls, text: str) -> "Digest":
        """Return the digest in a JSON text.

        Args:
            text: JSON text.

        Raises:
            ValueError: the text is not a digest.
        """
        return adapter(cls).validate_json(text)

    def following(self, number: int) -> "Digest":
        """Return the digest of the next file of the same session.

        Args:
            number: number of the next file.
        """
        return Digest(number, self.session, on=self._now_on, limit=self.limit)

    def add_event(self, event: Event) -> None:
        """Add an event, and find from it whether the run is now on its itinerary.

        All earlier ticks must have been added. Decisions of the run and its end are stored, other events are counted.

        Args:
            event: the event.
        """
        name, ends_run = event.name, LEVELS[event.level] >= LEVELS["error"] or event.name == "finished"
        if name in _RECORDED or ends_run:
            self.events.append(event)
        else:
            self.others[name] = self.others.get(name, 0) + 1
        # A repetition that joins the next is reported at once, any other repetition when the itinerary is left.
        self.repetitions += self._now_on if name == LAP else name == RETURN and event.level == "info"
        self._now_on = name in (RESUME, LAP) or (self._now_on and name != RETURN and not ends_run)

    def add_ticks(self, times: Array, period: float, state: Array, reference: Array, extras: Array | None) -> None:
        """Add the next rows of the loop to the figures.

        Args:
            times: times (K,) of the rows, s.
            period: period of the loop, s.
            state: states (K, N), the true ones or, if these are unknown, the estimated ones.
            reference: reference states (K, N).
            extras: standard deviations, then values, of the estimated parameters (K, 2E); None if there are none.
        """
        if not len(times):
            return
        if not self.ticks:
            self.first = float(times[0])
        self.end, self.ticks = float(times[-1]) + period, self.ticks + len(times)
        # The last two states are the cart's position and velocity.
        self.cart = max(self.cart, float(np.abs(state[:, -2]).max()))
        if self._now_on:
            arms = state.shape[1] // 2 - 1
            self.squares += float(((state[:, :arms] - reference[:, :arms]) ** 2).sum())
            self.followed += len(times)
        # Estimates between a fall and the restart of the filter are meaningless.
        if self._now_on and extras is not None:
            self._sums = self._sums + extras.sum(axis=0)
            self._last = extras[-1]

    def add_result(self, values: Mapping[str, str]) -> None:
        """Add the results of a session at its end.

        Args:
            values: results by name, as text.
        """
        self.deadlines = {
            name.removeprefix(_DEADLINES): float(value) for name, value in values.items() if name.startswith(_DEADLINES)
        }

    def close(self, names: tuple[str, ...]) -> None:
        """Complete the digest at the end of the file, with the estimated parameters and the process's memory.

        Args:
            names: names (E,) of the estimated parameters, none if the filter estimates none.
        """
        if names and self.followed:
            means = np.asarray(self._sums)[len(names) :] / self.followed
            self.extras = dict(zip(names, zip(means.tolist(), self._last.tolist(), strict=False), strict=True))
        with suppress(OSError, ValueError, IndexError):
            pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
            self.memory = float(pages * os.sysconf("SC_PAGE_SIZE"))


def digest_of_log(log: RunLog, *, size: int) -> Digest:
    """Return the digest of one file of a night, without estimated parameters and memory, if its own digest is missing.

    Args:
        log: log of that file.
        size: size of the file, bytes.

    Raises:
        InputError: the log is not a file of a night.
    """
    if NIGHT_METADATA not in log.metadata:
        raise InputError(f"{log.path} is not a log of a long run; give a folder that `dpcontrol run --hours` made")
    limit = 0.0 if log.limits is None else log.limits[0]
    digest = Digest(**json.loads(log.metadata[NIGHT_METADATA]), limit=limit, size=size)
    state = log.estimate if log.truth is None else log.truth
    # An event belongs before the tick of its time, as during the run.
    event_rows = np.searchsorted(log.time, [event.time - _SOON for event in log.events]).tolist()
    row_edges = [0, *accumulate(event_rows, max), len(log.time)]
    for (first, end), event in zip(pairwise(row_edges), [*log.events, None], strict=True):
        rows = slice(first, end)
        digest.add_ticks(log.time[rows], 1 / log.rate_hz, state[rows], log.reference[rows], None)
        if event is not None:
            digest.add_event(event)
    digest.add_result(log.metadata)
    return digest


class RollingLog:
    """Writes a log of many files, like a `LogWriter`; it is a context manager.

    Args:
        folder: folder of the files.
        name: common beginning of the file names.
        make: function that opens the writer of a file, given its path and additional metadata.
        seconds: length of a file, s.
        rate_hz: rate of the loop, Hz.
        limit: travel limit of the cart, m.
        extras: names of the estimated parameters.
        keep_every: every so many files one is kept; the others are deleted later.
        session: number of the session, above 1 for a resumed night.
        number: number of the first file.
        begin: start of the session, s since the start of the night.
        end: end of the night, s.

    Raises:
        InputError: the first file cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        make: Callable[[Path, Mapping[str, str]], LogWriter],
        *,
        seconds: float,
        rate_hz: float,
        limit: float,
        extras: tuple[str, ...] = (),
        keep_every: int = 1,
        session: int = 1,
        number: int = 1,
        begin: float = 0.0,
        end: float = math.inf,
    ) -> None:
        self.folder, self.name, self.extras = folder, name, extras
        self._make, self._seconds, self._keep_every, self._begin = make, seconds, keep_every, begin
        self._period, self._end = 1 / rate_hz, end
        # None while no file can be written.
        self._writer: LogWriter | None = None
        # Figures and events of the present file, which are written beside it when it ends.
        self._digest = Digest(number, session, limit=limit)
        self._file_ends(begin)

    def path(self, number: int, suffix: str = ".mcap") -> Path:
        """Return the path of a file or of its companion.

        Args:
            number: number of the file.
            suffix: ending, ".mcap" for the log or ".json" for the digest.
        """
        return self.folder / f"{self.name}-{number:04d}{suffix}"

    def __enter__(self) -> "RollingLog":
        self._open()
        return self

    def __exit__(self, *_: object) -> None:
        # An interrupted night also leaves complete files.
        self._finish()

    def ticks(self, time_s: Any, **parts: Any) -> None:
        """Log K periods of the loop, in one file; see `LogWriter.ticks`.

        If they begin after the end of the current file, the next file is begun before.

        Args:
            time_s: times (K,) since the start of this session, s.
            **parts: rows (K, …) by name.
        """
        times = np.asarray(time_s, dtype=float) + self._begin
        if times[0] >= self._until - _SOON:
            self._roll(float(times[0]))
        state = parts["estimate"] if parts.get("truth") is None else parts["truth"]
        self._digest.add_ticks(times, self._period, state, parts["reference"], parts.get("extras"))
        self._attempt(lambda writer: writer.ticks(times, **parts))

    def event(self, event: Event) -> None:
        """Log an event; see `LogWriter.event`.

        Args:
            event: the event, with its time since the start of this session.
        """
        event = replace(event, time=event.time + self._begin)
        if event.time >= self._until - _SOON:
            self._roll(event.time)
        self._digest.add_event(event)
        self._attempt(lambda writer: writer.event(event))

    def result(self, **values: str) -> None:
        """Record the results of the run in the last file.

        Args:
            **values: results by name.
        """
        self._digest.add_result(values)
        self._attempt(lambda writer: writer.result(**values))

    def _roll(self, now: float) -> None:
        """Finish the current file, and begin the next one at `now` s since the start of the night.

        The log before the finished one may be deleted then.
        """
        self._finish()
        self._thin(self._digest.number - 1)
        self._digest = self._digest.following(self._digest.number + 1)
        self._file_ends(now)
        try:
            self._open()
        except InputError as error:
            self._lose(error)

    def _file_ends(self, now: float) -> None:
        """Set the time at which the file that begins at `now` s ends: the next multiple of a file's length.

        The last file of the night has no end, so that it takes everything until the run ends.
        """
        end = (math.floor(now / self._seconds + _SOON) + 1) * self._seconds
        self._until = end if end < self._end - _SOON else math.inf

    def _open(self) -> None:
        """Open the writer of the current file, whose metadata contain its position in the night.

        Raises:
            InputError: the file cannot be written.
        """
        digest = self._digest
        position = {"number": digest.number, "session": digest.session, "on": digest.on}
        self._writer = self._make(self.path(digest.number), {NIGHT_METADATA: json.dumps(position)}).__enter__()

    def _attempt(self, write: Callable[[LogWriter], None]) -> None:
        """Call `write` with the writer of the current file, if there is one.

        After an error the writer is given up, and the night continues without a log until the next file.
        """
        if self._writer is None:
            return
        try:
            write(self._writer)
        except (InputError, OSError) as error:
            with suppress(InputError, OSError):
                self._writer.__exit__(type(error), error, None)
            self._writer = None
            self._lose(error)

    def _lose(self, error: Exception) -> None:
        """Store in the digest why the current file is missing, and print a remark with the time without a log.

        `error` is the reason: an InputError or OSError of the writer.
        """
        self._digest.loss = str(error)
        duration = f"up to {self._until / 60:g} minutes at least" if self._until < math.inf else "to its end"
        remark(f"{error}; the run goes on, without a log {duration}")

    def _finish(self) -> None:
        """Finish the current file and write its digest; a file without ticks is discarded."""
        digest = self._digest
        path = self.path(digest.number)
        # A writer that is left by an exception before its first tick deletes its file.
        no_ticks = None if digest.ticks else InputError(f"{path}: no ticks to log")
        self._attempt(lambda writer: writer.__exit__(no_ticks and InputError, no_ticks, None))
        digest.close(self.extras)
        if digest.ticks:
            digest.size = 0 if self._writer is None else path.stat().st_size
            with suppress(InputError):
                write_whole(self.path(digest.number, ".json"), digest.text())
        self._writer = None

    def _thin(self, number: int) -> None:
        """Delete a log unless its digest is missing or it is one of every `keep_every` logs, to save disk space.

        `number` is that of the log.
        """
        if (number - 1) % self._keep_every and self.path(number, ".json").is_file():
            with suppress(OSError):
                self.path(number).unlink()
