"""Chart of log formats, their chunks and their compression: loss on a kill and size against the time of a message.

Every format holds the same run. The time of a message is the run's logging time over its messages, five or six per
tick. Formats without messages hold the same numbers, and are divided by the same count.

A kill loses the data in the process and keeps those passed to the system. A copy of the file during the run is
therefore equal to the remains after a kill. It is read with each format's method for cut files.
"""

import csv
import json
import shutil
import tempfile
from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np

from dpcontrol.bench.chart import Missing, Panel, Point, PrecisionChart
from dpcontrol.bench.measure import Alternative, Judged, compare
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.parts import Later
from dpcontrol.foundation.progress import Progress
from dpcontrol.logs import LogWriter, recover
from dpcontrol.logs.container import Messages, MessageWriter, messages_of, ticks_left
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.result import LogSink, Ticks
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.plans.run_options import RunOptions

pa, pq = Later("pyarrow"), Later("pyarrow.parquet")

SURVIVES = 0.25
"""Limit of the mean loss as a share of a run; a format above it keeps too little."""
_SEED = 5
_WHY = (
    "the loss is one chunk at most, and a chunk of 20 ms is as short as the loop's buffer; longer "
    "ones are slightly faster and lose more"
)


def chart(quick: bool, progress: Progress) -> PrecisionChart:
    """Return the chart of log formats.

    If quick, it has one second of a run, fewer kills, chunks and levels.
    """
    ticks, kills = (1000, 5) if quick else (4000, 20)
    chunks = (0.005, 0.02, 0.2) if quick else (0.005, 0.01, 0.02, 0.05, 0.2, 1.0)
    kinds: list[Format] = [Blocks(chunk) for chunk in chunks]
    kinds += [Blocks(compression=level) for level in ((9,) if quick else (-5, 3, 9))]
    kinds += [ByMessage(1024 * 1024), ByMessage(16 * 1024), ByMessage(16 * 1024, "none")]
    kinds += [Lines(kind, flush=flush) for kind in ("JSON", "CSV") for flush in (False, True)]
    kinds += [Arrays(compressed=False), Arrays(compressed=True), RowGroups(100), RowGroups(1000)]
    with tempfile.TemporaryDirectory() as folder:
        run = recording(Path(folder), ticks)
        tried = trials(kinds, Path(folder), run, kills=kills, progress=progress)
    seconds = len(run.ticks.times) / run.rate_hz
    alive = tuple(p for p in tried.points if p.error < SURVIVES * seconds)
    lost = tuple(
        Missing(p.method, p.setting, f"loses {p.error:.2g} s of {seconds:g} s on a kill, {_size(p):.0f} bytes a tick")
        for p in tried.points
        if p not in alive
    )
    blocks = tuple(replace(p, seconds=_size(p)) for p in tried.points if p.method == Blocks.method)
    sizes = tuple(replace(p, error=_size(p)) for p in alive)
    time, loss = "s per message", "mean loss, s"
    return PrecisionChart(
        name="logging",
        title="Logging: loss on a kill and size against the time of a message",
        parts=(
            tried.titled("A kill", time, f"mean loss of a run of {seconds:g} s, s", why=_WHY),
            tried.titled("Size, of what outlives a kill", time, "bytes per tick", points=sizes, missing=lost, why=_WHY),
            tried.titled("Chunks and compression of our blocks", "bytes per tick", loss, points=blocks, why=_WHY,
                        timed=False),
        ),
        reading=(
            "Left: seconds of a run lost by a kill, including the current tick. npz and parquet lose all of it: "
            "they are readable only when complete.",
            "Middle: bytes of a tick, of formats that keep most of a run. MCAP holds messages with types, times and "
            "checksums; the tables hold bare columns of numbers.",
            "Right: the package's writer by length of chunk and zstd's level: longer chunks pack better and lose more.",
        ),
        chosen=(
            "Chunks of 20 ms at zstd's level 1, written as arrays: including message assembly no slower than mcap's "
            "writer with prepared ones, and never more lost than a chunk. Higher levels: twice the time for 2 %."
        ),
    )  # fmt: skip


def _size(point: Point) -> float:
    return point.others["bytes_per_tick"]


@dataclass(frozen=True, eq=False)
class LoggedRun:
    """Ticks of a run, and the path of its log."""

    ticks: Ticks
    log: Path
    arm_lengths: tuple[float, ...]
    rate_hz: float

    @cached_property
    def messages(self) -> Messages:
        """Prepared messages of the log."""
        return messages_of(self.log)

    @cached_property
    def rows(self) -> Array:
        """All numbers of the ticks as columns (K, M)."""
        t = self.ticks
        assert t.truth is not None
        return np.column_stack([t.times, t.measured, t.estimates, t.references, t.truth, t.control])

    @cached_property
    def lines(self) -> list[list[float]]:
        """The rows as Python numbers."""
        return self.rows.tolist()

    @cached_property
    def names(self) -> list[str]:
        """Names of the rows' columns."""
        return [f"column_{k}" for k in range(self.rows.shape[1])]


class Format(ABC):
    """A log format.

    The order of calls is `begin`, `add` for ticks, `end`. The remains after a kill are read by `left`.
    """

    method: str
    setting: str
    default = False
    outside = True
    block = 1
    """Ticks passed at once."""

    @abstractmethod
    def begin(self, path: Path, run: LoggedRun) -> None:
        """Create the file."""

    @abstractmethod
    def add(self, first: int, until: int) -> None:
        """Write the ticks from `first` up to `until`."""

    @abstractmethod
    def end(self) -> None:
        """Complete the file."""

    @abstractmethod
    def left(self, path: Path) -> int:
        """Return the number of readable ticks in a cut file."""

    def growing(self, path: Path) -> Path:
        """Return the path of the growing file."""
        return path


class Blocks(Format):
    """This package's writer: whole chunks as arrays."""

    method, outside = "our blocks", False

    def __init__(self, chunk_seconds: float = 0.02, compression: int = 1) -> None:
        self.setting = f"{chunk_seconds * 1e3:g} ms, zstd {compression}"
        self.default = (chunk_seconds, compression) == (0.02, 1)
        self._chunk, self._level = chunk_seconds, compression

    def begin(self, path: Path, run: LoggedRun) -> None:
        self._ticks = run.ticks
        # The loop passes twenty ticks at a time.
        self.block = min(20, max(1, round(self._chunk * run.rate_hz)))
        self._log = LogWriter(path, arm_lengths=run.arm_lengths, rate_hz=run.rate_hz, chunk_seconds=self._chunk,
                              compression=self._level)  # fmt: skip
        self._log.__enter__()

    def add(self, first: int, until: int) -> None:
        LogSink(self._log).ticks(self._ticks.between(first, until))

    def end(self) -> None:
        self._log.__exit__(None, None, None)

    def growing(self, path: Path) -> Path:
        return self._log.partial

    def left(self, path: Path) -> int:
        with suppress(InputError):
            return recover(path, path.with_suffix(".recovered")).ticks
        return 0


class ByMessage(Format):
    """The writer of the mcap package, one message at a time."""

    def __init__(self, chunk_bytes: int, compression: str = "zstd") -> None:
        self.method = "mcap's writer"
        self.setting = f"{chunk_bytes // 1024} KiB, {compression}"
        self._bytes, self._compression = chunk_bytes, compression

    def begin(self, path: Path, run: LoggedRun) -> None:
        self._messages, self._ends = run.messages, (0, *run.messages.ends)
        self._stream = FileIO(path, "wb")
        self._writer = MessageWriter(self._stream, run.messages, chunk_bytes=self._bytes, compression=self._compression)

    def add(self, first: int, until: int) -> None:
        self._writer.add(self._messages.messages[self._ends[first] : self._ends[until]])

    def end(self) -> None:
        self._writer.finish()
        self._stream.close()

    def left(self, path: Path) -> int:
        return ticks_left(path)


class Lines(Format):
    """Text with a line for each tick, CSV or JSON.

    It is flushed after every line or when Python's buffer is full.
    """

    def __init__(self, kind: str, *, flush: bool) -> None:
        self.method, self.setting = kind, "flushed" if flush else "buffered"
        self._flush = flush

    def begin(self, path: Path, run: LoggedRun) -> None:
        self._run, self._file = run, path.open("w")
        self._csv = csv.writer(self._file)

    def add(self, first: int, until: int) -> None:
        for line in self._run.lines[first:until]:
            if self.method == "CSV":
                self._csv.writerow(line)
            else:
                self._file.write(json.dumps(dict(zip(self._run.names, line, strict=True))) + "\n")
            if self._flush:
                self._file.flush()

    def end(self) -> None:
        self._file.close()

    def left(self, path: Path) -> int:
        return path.read_text(encoding="utf-8").count("\n")


class Arrays(Format):
    """NumPy's .npz, written after the run; compressed or not."""

    def __init__(self, *, compressed: bool) -> None:
        self.method, self.setting = "npz", "compressed" if compressed else "plain"
        self._save: Any = np.savez_compressed if compressed else np.savez

    def begin(self, path: Path, run: LoggedRun) -> None:
        self._path, self._rows, self._kept = path, run.rows, np.empty_like(run.rows)
        path.write_bytes(b"")

    def add(self, first: int, until: int) -> None:
        self._kept[first:until] = self._rows[first:until]

    def end(self) -> None:
        with self._path.open("wb") as file:
            self._save(file, rows=self._kept)

    def left(self, path: Path) -> int:
        with suppress(Exception), np.load(path) as data:
            return len(data["rows"])
        return 0


class RowGroups(Format):
    """Parquet, a row group for each `rows` ticks."""

    def __init__(self, rows: int) -> None:
        self.method, self.setting, self.block = "parquet", f"groups of {rows}", rows

    def begin(self, path: Path, run: LoggedRun) -> None:
        self._run = run
        self._file = pq.ParquetWriter(path, pa.schema([(name, pa.float64()) for name in run.names]))

    def add(self, first: int, until: int) -> None:
        columns = [pa.array(column) for column in self._run.rows[first:until].T]
        self._file.write_table(pa.Table.from_arrays(columns, names=self._run.names))

    def end(self) -> None:
        self._file.close()

    def left(self, path: Path) -> int:
        with suppress(pa.ArrowInvalid):
            return pq.read_metadata(path).num_rows
        return 0


def recording(folder: Path, ticks: int) -> LoggedRun:
    """Return the first ticks of an outer turn, with its messages."""
    scene = load_itinerary("outer-turn").with_run(RunOptions(mismatch=0.02, initial_error=0.02), seed=3)
    arms = scene.model.arms
    flown = Assembly(make_plan(scene).reference, arms, scene.loop).simulate().ticks.between(0, ticks)
    run = LoggedRun(flown, folder / "source.mcap", arms.length, scene.loop.rate)
    write(Blocks(), run.log, run)
    return run


def write(kind: Format, path: Path, run: LoggedRun) -> None:
    """Write a whole run."""
    kind.begin(path, run)
    _hand_over(kind, 0, len(run.ticks.times))
    kind.end()


def _hand_over(kind: Format, first: int, until: int) -> None:
    for tick in range(first, until, kind.block):
        kind.add(tick, min(tick + kind.block, until))


def trials(kinds: list[Format], folder: Path, run: LoggedRun, *, kills: int, progress: Progress) -> Panel:
    """Return the loss of each format at kills against time.

    The time is in seconds per message.
    """
    count = len(run.ticks.times)

    def written(kind: Format, path: Path) -> tuple[Format, Path]:
        write(kind, path, run)
        return kind, path

    def judge(_: Alternative[tuple[Format, Path]], made: tuple[Format, Path]) -> Judged:
        kind, path = made
        size = path.stat().st_size / count
        lost = losses(kind, path.with_suffix(".killed"), run, kills=kills)
        others = {"bytes_per_tick": size, "mean_loss": float(np.mean(lost)), "largest_loss": max(lost)}
        return Judged(others["mean_loss"], others, f"{max(lost) * 1e3:.0f} ms lost at most, {size:.0f} bytes a tick")

    messages = float(len(run.messages.messages))
    tried = [
        Alternative(kind.method, kind.setting, partial(written, kind, folder / f"run-{k}"), default=kind.default,
                  outside=kind.outside, units=messages)
        for k, kind in enumerate(kinds)
    ]  # fmt: skip
    found = compare(tried, judge, rounds=9, progress=progress)
    points = tuple(replace(p, others={**p.others, "seconds_per_message": p.seconds}) for p in found.points)
    return replace(found, points=points, start_up={})


def losses(kind: Format, path: Path, run: LoggedRun, *, kills: int) -> list[float]:
    """Return the seconds lost at kills at random ticks.

    They include the current tick.
    """
    count = len(run.ticks.times)
    moments = np.sort(np.random.default_rng(_SEED).integers(count // 10, count, kills))
    lost, done = [], 0
    kind.begin(path, run)
    for k, moment in enumerate(moments.tolist()):
        # Ticks passed in blocks wait until a block is full.
        until = moment // kind.block * kind.block
        _hand_over(kind, done, until)
        done = until
        copy = path.with_name(f"killed-{k}")
        shutil.copyfile(kind.growing(path), copy)
        lost.append((moment + 1 - kind.left(copy)) / run.rate_hz)
    kind.end()
    return lost
