"""Write a log: `ticks` for periods of the loop, `event` for what happens in between.

One writer serves simulation, rig, import and replay. A tick needs the measured positions only; rates, estimate,
reference, truth and control are each given in every tick of a log or in none, which the first tick decides. There is
one rate in a log: what comes at a lower one is an event, or logged again with each tick. Times may jump forward.

Ticks are collected as rows of numbers and turned into messages some twenty milliseconds at a time, so that a run
that is killed loses no more than that. The file grows as `NAME.mcap.partial` and gets its name when complete and on
the disk.

Before the first tick stand the layout and the arms' descriptions for viewers: both depend on what a tick holds, which
is known from the first one on (`layout.TickLayout`).
"""

import json
import os
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from io import FileIO
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import ArrayLike, NDArray

import dpcontrol
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import checked_target
from dpcontrol.logs import cdr, layout, urdf
from dpcontrol.logs.blocks import REFERENCE_PREFIX, ChunkEncoder, Note, TickRows
from dpcontrol.logs.container import COMPRESSION, McapFile
from dpcontrol.logs.partial import moved_away, open_partial, sealed, sync_folder

Row = NDArray[np.float64]


class TickBuffer:
    """Room for `size` ticks of a layout with all its parts; which of them a log has, its first tick decides."""

    def __init__(self, tick: layout.TickLayout, *, rows: int) -> None:
        self.size, self.filled, self.last = rows, 0, 0.0
        self._time = np.zeros(rows)
        widths = {"measured": len(tick.names), **tick.widths}
        self._rooms = {name: np.zeros((rows, width)) for name, width in widths.items()}
        self._parts: frozenset[str] | None = None

    @property
    def full(self) -> bool:
        """Whether no further tick has room."""
        return self.filled == self.size

    @property
    def first(self) -> float:
        """The time of the first tick in s; 0 where there is none."""
        return float(self._time[0]) if self.filled else 0.0

    @property
    def parts(self) -> frozenset[str]:
        """Which of `layout.PARTS` the log has."""
        return self._parts or frozenset()

    def checked(self, times: Row, given: Mapping[str, Row | None]) -> dict[str, Row]:
        """Return those of the rows (K, …), `measured` and parts by name, that there are.

        Raises:
            ValueError: rows of another shape, times that decrease, or a part in some ticks only.
        """
        rows = {name: values for name, values in given.items() if values is not None}
        for name, values in rows.items():
            expected = (len(times), self._rooms[name].shape[1])
            if np.shape(values) != expected:
                raise ValueError(f"{name}: expected rows of shape {expected}, got {np.shape(values)}")
        if len(times) and not (times[0] >= self.last and (np.diff(times) >= 0).all()):
            raise ValueError("the times of ticks must not decrease")
        parts = frozenset(rows) - {"measured"}
        if self._parts is not None and parts != self._parts:
            names = (part for part in layout.PARTS if part in parts ^ self._parts)
            raise ValueError(f"{', '.join(names)} must be given in every tick of a run or in none")
        self._parts = parts
        return rows

    def put(self, times: Row, rows: Mapping[str, Row], *, since: int) -> int:
        """Take rows from `since` on, as many as have room; return how many."""
        count = min(self.size - self.filled, len(times) - since)
        into, taken = slice(self.filled, self.filled + count), slice(since, since + count)
        self._time[into] = times[taken]
        for name, values in rows.items():
            self._rooms[name][into] = values[taken]
        self.filled += count
        self.last = float(times[since + count - 1])
        return count

    def taken(self, parts: frozenset[str]) -> TickRows:
        """Return the ticks with these parts; views, good until the next tick comes."""
        count = self.filled
        return TickRows(
            time_ns=np.rint(self._time[:count] * 1e9).astype(np.int64),
            measured=self._rooms["measured"][:count],
            parts={part: self._rooms[part][:count] for part in layout.PARTS if part in parts},
        )

    def clear(self) -> None:
        """Make room; the ticks have been written."""
        self.filled = 0


Limits = tuple[float, float, float] | None


def layout_record(
    tick: layout.TickLayout,
    arm_lengths: Sequence[float],
    *,
    rate_hz: float,
    limits: Limits,
    attachments: Collection[str],
) -> dict[str, str]:
    """Return the metadata by which a log is read: arms' lengths in m, rate in Hz, limits, parts of a tick."""
    return {
        "format": layout.FORMAT,
        "arm_lengths": " ".join(repr(length) for length in arm_lengths),
        "has_cart": "1" if tick.has_cart else "0",
        "rate_hz": repr(rate_hz),
        "limits": " ".join(repr(float(limit)) for limit in limits or ()),
        "parts": " ".join(part for part in layout.PARTS if part in tick.parts),
        "attachments": json.dumps(list(attachments)),
        "program": f"dpcontrol {dpcontrol.__version__}",
    }


def descriptions(tick: layout.TickLayout, arm_lengths: Sequence[float], *, limits: Limits, time_ns: int) -> list[Note]:
    """Return the URDF of the arms, and of the reference's ghost where a tick has a reference, as messages."""
    notes: list[Note] = []
    for topic in (topic for topic in tick.channels if topic in layout.LATCHED):
        ghost = topic == layout.GHOST
        text = urdf.robot_description(
            arm_lengths,
            has_cart=tick.has_cart,
            limits=limits,
            prefix=REFERENCE_PREFIX if ghost else "",
            ghost=ghost,
        )
        notes.insert(0, Note(row=0, topic=topic, time_ns=time_ns, content=cdr.string(text)))
    return notes


CHUNK_SECONDS = 0.02
"""Of a chunk: what a run that is killed loses at most, and a tick."""


class LogWriter:
    """Writes one log; a context manager.

    Leaving the block normally completes the file and renames it; leaving it by an exception keeps what was written
    as `NAME.mcap.partial`, which `dpcontrol recover` makes a log of, and adds a note to the exception that says so.

    Args:
        path: the log, by convention `*.mcap`; an older one is replaced when this one is complete.
        arm_lengths: (n,) in m.
        rate_hz: rate of the loop in Hz.
        has_cart: whether the pivot is on a cart; without one, states have 2n and measurements n entries.
        limits: the cart's greatest distance from the centre in m, velocity in m/s, acceleration in m/s².
        metadata: text by name: version, commit, seed, hashes, whatever tells this run from others.
        attachments: content by file name: scene, model, reference.
        chunk_seconds, compression: length of a chunk in s, on whose default `recover` counts, and zstd's level.

    Raises:
        InputError: the file cannot be written.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        arm_lengths: Sequence[float],
        rate_hz: float,
        has_cart: bool = True,
        limits: tuple[float, float, float] | None = None,
        metadata: Mapping[str, str] | None = None,
        attachments: Mapping[str, bytes] | None = None,
        chunk_seconds: float = CHUNK_SECONDS,
        compression: int = COMPRESSION,
    ):
        self.path = Path(path)
        self.partial = self.path.with_name(self.path.name + ".partial")
        self._lengths = tuple(float(length) for length in arm_lengths)
        self._has_cart = has_cart
        self._limits = limits
        self._metadata = sealed(layout.RUN_RECORD, dict(metadata or {}))
        self._attachments = dict(attachments or {})
        self._rate = float(rate_hz)
        self._compression = compression
        if not self._lengths or not self._rate > 0:
            raise ValueError(f"a log needs arms and a positive rate; got {len(self._lengths)} arms at {rate_hz} Hz")
        tick = layout.TickLayout(len(self._lengths), has_cart, frozenset(layout.PARTS))
        self._buffer = TickBuffer(tick, rows=max(1, round(chunk_seconds * self._rate)))
        self._ticks = 0
        self._notes: list[Note] = []
        self._result: dict[str, str] = {}
        self._encoder: ChunkEncoder | None = None
        self._file: McapFile | None = None
        self._stream: FileIO | None = None
        self._torn = False

    def __enter__(self) -> "LogWriter":
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            checked_target(self.path)
            self.partial, self._stream = open_partial(self.path)
            self._start(self._stream)
        except OSError as error:
            raise self._unwritable(error) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._stream is None or self._file is None:
            return
        try:
            if error is None:
                self._finish(self._file, self._stream)
            else:
                self._give_up(error)
        except OSError as failure:
            raise self._unwritable(failure) from failure
        finally:
            self._stream.close()
            self._stream = self._file = None

    def _finish(self, file: McapFile, stream: FileIO) -> None:
        if self._encoder is None:
            self._encoder = self._prepare(file)
        self._write_chunk()
        values = {**self._result, layout.TICKS: str(self._ticks)}
        file.add_metadata(layout.RESULT_RECORD, sealed(layout.RESULT_RECORD, values))
        file.finish()
        os.fsync(stream.fileno())
        stream.close()
        self.partial.replace(self.path)
        sync_folder(self.path.parent)

    def _give_up(self, error: BaseException) -> None:
        """Keep what was written and say where it is; a chunk that was cut short is followed by no other."""
        if self._encoder is None and not self._buffer.filled:
            # A run that failed before its first tick leaves nothing worth keeping.
            self.partial.unlink(missing_ok=True)
            return
        if not self._torn:
            # Where this fails too, the exception under way says what went wrong first.
            with suppress(InputError):
                self._write_chunk()
        if self.partial.exists():
            error.add_note(
                f"{self.partial} keeps the run up to {self._buffer.last:.3f} s at most; "
                f"`dpcontrol recover {self.partial}` makes a log of it"
            )

    def _unwritable(self, error: OSError) -> InputError:
        return InputError(f"cannot write {self.path}: {error.strerror or error}; choose another file or folder")

    def _start(self, stream: FileIO) -> None:
        self._file = McapFile(stream, library=f"dpcontrol {dpcontrol.__version__}", level=self._compression)
        self._file.add_metadata(layout.RUN_RECORD, self._metadata)
        for name, data in self._attachments.items():
            self._file.add_attachment(name, data)

    def ticks(
        self,
        time_s: ArrayLike,
        *,
        measured: Row,
        rates: Row | None = None,
        estimate: Row | None = None,
        reference: Row | None = None,
        truth: Row | None = None,
        control: Row | None = None,
    ) -> None:
        """Log K periods of the loop; all but `measured` in every tick of a log or in none.

        Args:
            time_s: (K,) times since the start in s, none before that of the last tick.
            measured: (K, n+1) positions as the sensors gave them: rad, and m for the cart.
            rates: (K, n+1) rates as the sensors gave them, rad/s and m/s, where they give any.
            estimate: (K, 2n+2) in state order: rad, rad/s, m, m/s.
            reference: (K, 2n+2) likewise.
            truth: (K, 2n+2) likewise, the plant's own states.
            control: (K, 13) for a double pendulum on a cart: rows of `layout.control_fields`.

        Raises:
            ValueError: rows of another shape, times that decrease, or a part in some ticks only.
            InputError: the file cannot be written.
        """
        times = np.asarray(time_s, float)
        rows = self._buffer.checked(
            times,
            {"measured": measured, "rates": rates, "estimate": estimate, "reference": reference, "truth": truth,
             "control": control},
        )  # fmt: skip
        done = 0
        while done < len(times):
            done += self._buffer.put(times, rows, since=done)
            if self._buffer.full:
                self._write_chunk()

    def tick(self, time_s: float, *, measured: Row, **parts: Row | None) -> None:
        """Log one period: arguments as in `ticks`, one row each."""
        rows = {name: None if row is None else row[None] for name, row in parts.items()}
        self.ticks([time_s], measured=measured[None], **rows)

    def result(self, **values: str) -> None:
        """Note how the run went, as metadata at the end of the log: what need not be the same when it is repeated."""
        self._result.update(values)

    def event(self, time_s: float, level: str, name: str, text: str) -> None:
        """Log an event: `level` is debug, info, warn, error or fatal, `name` the part it came from."""
        if level not in layout.LEVELS:
            raise ValueError(f"event level {level!r}: must be one of {', '.join(layout.LEVELS)}")
        time_ns = round(time_s * 1e9)
        message = cdr.log(time_ns, layout.LEVELS[level], name=name, text=text)
        self._notes.append(Note(row=self._buffer.filled, topic=layout.EVENTS, time_ns=time_ns, content=message))

    def _prepare(self, file: McapFile) -> ChunkEncoder:
        # Done with the first chunk: only then is it known what a tick holds.
        tick = layout.TickLayout(len(self._lengths), self._has_cart, self._buffer.parts)
        described = layout_record(
            tick, self._lengths, rate_hz=self._rate, limits=self._limits, attachments=self._attachments
        )
        file.add_metadata(layout.LAYOUT_RECORD, sealed(layout.LAYOUT_RECORD, described))
        file.add_channels(tick.schemas, latched=layout.LATCHED)
        first = round(self._buffer.first * 1e9)
        self._notes[:0] = descriptions(tick, self._lengths, limits=self._limits, time_ns=first)
        return ChunkEncoder(tick, self._lengths, rows=self._buffer.size)

    def _write_chunk(self) -> None:
        if self._file is None:
            raise ValueError(f"the log {self.path} is not open: use LogWriter in a with statement")
        count = self._buffer.filled
        if not count and not self._notes:
            return
        self._torn = True
        try:
            if self._encoder is None:
                self._encoder = self._prepare(self._file)
            self._file.add_chunk(*self._encoder.encode(self._buffer.taken(self._encoder.parts), self._notes))
        except OSError as error:
            raise self._unwritable(error) from error
        self._notes.clear()
        self._ticks += count
        self._buffer.clear()
        self._torn = False
        if self._stream is not None and moved_away(self.partial, self._stream):
            raise InputError(
                f"cannot go on writing {self.path}: {self.partial.name} or its folder was moved or removed meanwhile; "
                "run again, and leave the folder alone until the run has ended"
            )
