"""Ways to log a run, each tried alike: time of a message, size, and what a kill leaves.

A kill takes what the process holds and leaves what it has handed to the system. So a copy of the file, made while the
run goes on, is what a kill at that moment would have left; it is read by whatever the format offers for a cut file.
"""

import csv
import json
from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import LogWriter, recover
from dpcontrol.logs.by_message import Messages, MessageWriter, ticks_left
from dpcontrol.loop.result import Ticks

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Recording:
    """A run's ticks and the same as ready-made messages; rows (K, M): all its numbers side by side."""

    ticks: Ticks
    messages: Messages
    arm_lengths: tuple[float, ...]
    rate_hz: float
    rows: Array = field(init=False)
    lines: list[list[float]] = field(init=False)

    def __post_init__(self) -> None:
        t = self.ticks
        assert t.truth is not None
        rows = np.column_stack([t.times, t.measured, t.estimates, t.references, t.truth, t.control])
        object.__setattr__(self, "rows", rows)
        object.__setattr__(self, "lines", rows.tolist())


class Format(ABC):
    """A way to log: `begin` a file, hand over ticks in order, `end` it; `left` reads what a kill leaves."""

    method: str
    setting: str
    default = False
    outside = True
    block = 1
    """Ticks that are handed over at once."""

    @abstractmethod
    def begin(self, path: Path, run: Recording) -> None:
        """Create the file."""

    @abstractmethod
    def add(self, first: int, until: int) -> None:
        """Take the ticks from `first` up to `until`."""

    @abstractmethod
    def end(self) -> None:
        """Complete the file."""

    @abstractmethod
    def left(self, path: Path) -> int:
        """Return how many ticks can be read of a cut file."""

    def growing(self, path: Path) -> Path:
        """Return where the file is while it grows."""
        return path


class Blocks(Format):
    """This package's writer: whole chunks as arrays."""

    outside = False

    def __init__(self, chunk_seconds: float = 0.02, compression: int = 1) -> None:
        self.method = "our blocks"
        self.setting = f"{chunk_seconds * 1e3:g} ms, zstd {compression}"
        self.default = (chunk_seconds, compression) == (0.02, 1)
        self._chunk, self._level = chunk_seconds, compression

    def begin(self, path: Path, run: Recording) -> None:
        self._ticks = run.ticks
        # The loop hands over twenty at a time.
        self.block = min(20, max(1, round(self._chunk * run.rate_hz)))
        self._log = LogWriter(path, arm_lengths=run.arm_lengths, rate_hz=run.rate_hz, chunk_seconds=self._chunk,
                              compression=self._level)  # fmt: skip
        self._log.__enter__()

    def add(self, first: int, until: int) -> None:
        rows = self._ticks.between(first, until)
        self._log.ticks(rows.times, measured=rows.measured, estimate=rows.estimates, reference=rows.references,
                        truth=rows.truth, control=rows.control)  # fmt: skip

    def end(self) -> None:
        self._log.__exit__(None, None, None)

    def growing(self, path: Path) -> Path:
        return self._log.partial

    def left(self, path: Path) -> int:
        with suppress(InputError):
            return recover(path, path.with_suffix(".recovered")).ticks
        return 0


class ByMessage(Format):
    """The mcap package's own writer, one message at a time."""

    def __init__(self, chunk_bytes: int, compression: str = "zstd") -> None:
        self.method = "mcap's writer"
        self.setting = f"{chunk_bytes // 1024} KiB, {compression}"
        self._bytes, self._compression = chunk_bytes, compression

    def begin(self, path: Path, run: Recording) -> None:
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
    """Text, a line for each tick: CSV or JSON; flushed after every line or when Python's buffer is full."""

    def __init__(self, kind: str, *, flush: bool) -> None:
        self.method, self.setting = kind, "flushed" if flush else "buffered"
        self._flush = flush

    def begin(self, path: Path, run: Recording) -> None:
        self._lines, self._width = run.lines, run.rows.shape[1]
        self._file = path.open("w")
        self._csv = csv.writer(self._file) if self.method == "CSV" else None
        self._names = [f"column_{k}" for k in range(self._width)]

    def add(self, first: int, until: int) -> None:
        for line in self._lines[first:until]:
            if self._csv is not None:
                self._csv.writerow(line)
            else:
                self._file.write(json.dumps(dict(zip(self._names, line, strict=True))) + "\n")
            if self._flush:
                self._file.flush()

    def end(self) -> None:
        self._file.close()

    def left(self, path: Path) -> int:
        text = path.read_text()
        return text.count("\n")


class Arrays(Format):
    """NumPy's .npz, written when the run has ended; compressed or not."""

    def __init__(self, *, compressed: bool) -> None:
        self.method, self.setting = "npz", "compressed" if compressed else "plain"
        self._save: Any = np.savez_compressed if compressed else np.savez

    def begin(self, path: Path, run: Recording) -> None:
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

    def begin(self, path: Path, run: Recording) -> None:
        self._rows = run.rows
        self._names = [f"column_{k}" for k in range(run.rows.shape[1])]
        self._file = pq.ParquetWriter(path, pa.schema([(name, pa.float64()) for name in self._names]))

    def add(self, first: int, until: int) -> None:
        columns = [pa.array(column) for column in self._rows[first:until].T]
        self._file.write_table(pa.Table.from_arrays(columns, names=self._names))

    def end(self) -> None:
        self._file.close()

    def left(self, path: Path) -> int:
        with suppress(pa.ArrowInvalid):
            return pq.read_metadata(path).num_rows
        return 0
