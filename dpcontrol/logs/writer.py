"""Write a log: `ticks` for periods of the loop, `event` for what happens in between.

One writer serves simulation, rig, import and replay. A tick needs the measured positions only; rates, estimate,
reference, truth and control are each given in every tick of a log or in none, which the first tick decides. There is
one rate in a log: what comes at a lower one is an event, or logged again with each tick. Times may jump forward.

Ticks are collected as rows of numbers and turned into messages some twenty milliseconds at a time, so that a run
that is killed loses no more than that. The file grows as `NAME.mcap.partial` and gets its name when complete and on
the disk.

Before the first tick stand the layout and the arms' descriptions for viewers: both depend on what a tick holds, which
is known from the first one on (`layout.TickLayout`).

Turn rows of numbers into a chunk of message records, whole arrays at a time.

Every message's bytes are known but for its numbers (see `cdr`), so a block of K ticks is one numpy structured
array of K copies of a template, filled column by column.
"""

import json
import os
import struct
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import ArrayLike, NDArray

import dpcontrol
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import checked_target
from dpcontrol.logs import urdf
from dpcontrol.logs.container import COMPRESSION, ChunkMessages, McapFile, moved_away, open_partial, sealed, sync_folder
from dpcontrol.logs.layout import (
    CONTROL,
    ENCAPSULATION,
    EVENTS,
    FORMAT,
    GHOST,
    LATCHED,
    LAYOUT_RECORD,
    LEVELS,
    MEASURED,
    MESSAGE_OPCODE,
    PARTS,
    RECORD_HEADER,
    RESULT_RECORD,
    RUN_RECORD,
    STATE_TOPICS,
    TICKS,
    TRANSFORM_RATE,
    TRANSFORMS,
    TickLayout,
    joint_order,
    log,
    string,
    transforms,
)

REFERENCE_PREFIX = "reference/"
_SECOND = 1_000_000_000
_HEAD = struct.Struct("<BQHIQQ")
_STAMP = np.dtype([("sec", "<i4"), ("nanosec", "<u4")])
_MEASURED = "measured"
_TICK_HEAD = np.dtype(
    [("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8"), ("encapsulation", "V4"), *_STAMP.descr]
)
"""What all messages of a tick have in common, as it stands in each: from a record's sequence to its message's stamp."""
_UNSTAMPED = _TICK_HEAD.fields["encapsulation"][1]  # type: ignore[index]
"""Bytes of it in messages without a stamp."""


@dataclass(frozen=True)
class TickRows:
    """K ticks: `time_ns` (K,) in ns, `measured` (K, n+1) positions, and rows (K, width) of each part that is logged."""

    time_ns: NDArray[np.int64]
    measured: NDArray[np.float64]
    parts: Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Note:
    """A single message, written before the tick in `row` of the chunk: its topic, time in ns and content."""

    row: int
    topic: str
    time_ns: int
    content: bytes


class ChunkEncoder:
    """Encodes chunks of a log in order.

    Args:
        tick: what a tick holds.
        arm_lengths: (n,) in m.
        rows: the greatest number of ticks in a chunk.
    """

    def __init__(self, tick: TickLayout, arm_lengths: Sequence[float], *, rows: int):
        self._tick = tick
        self._lengths = tuple(arm_lengths)
        self._channels = tick.channels
        self._counts = dict.fromkeys(tick.channels, 0)
        self._offsets = tick.block_offsets
        self._block = np.frombuffer(bytearray(tick.block_template * rows), tick.block_type)
        self._positions, self._velocities = joint_order(tick.arms, has_cart=tick.has_cart)
        self._heads, self._rooms = self._views()
        self._ticks = 0
        frames = [
            frame
            for prefix in (("", REFERENCE_PREFIX) if "reference" in tick.parts else ("",))
            for frame in urdf.frames(tick.arms, has_cart=tick.has_cart, prefix=prefix)
        ]
        self._frames = len(frames)
        self._transforms = transforms(frames)
        self._template = np.frombuffer(self._transforms.template, np.uint8)
        fields = self._transforms.fields
        stamp_starts = [fields[f"{i}.stamp.sec"][1] for i in range(self._frames)]
        pose_starts = [fields[f"{i}.pose"][1] for i in range(self._frames)]
        self._stamp_bytes = np.add.outer(stamp_starts, np.arange(_STAMP.itemsize))
        self._pose_bytes = np.add.outer(pose_starts, np.arange(7 * 8))
        self._last_transform = -1

    @property
    def parts(self) -> frozenset[str]:
        """What a tick holds besides the measured positions."""
        return self._tick.parts

    def encode(self, rows: TickRows, notes: Sequence[Note]) -> tuple[bytes, list[ChunkMessages]]:
        """Return the bytes of a chunk and where its messages stand in it, all messages in order of arrival."""
        count = len(rows.time_ns)
        block = self._fill(rows)
        marks = sorted([*notes, *self._transform_notes(rows)], key=lambda note: note.row)
        pieces, done, length, before = [], 0, 0, np.zeros(count, np.int64)
        single: dict[str, list[tuple[int, int]]] = {}
        for note in marks:
            if note.row > done:
                pieces.append(block[done : note.row].tobytes())
                length += len(pieces[-1])
                done = note.row
            record = self._record(note)
            single.setdefault(note.topic, []).append((note.time_ns, length))
            pieces.append(record)
            length += len(record)
            before[note.row :] += len(record)
        pieces.append(block[done:].tobytes())
        places = before + block.itemsize * np.arange(count)
        messages = [
            ChunkMessages(channel=self._channels[topic], times=rows.time_ns, offsets=places + offset)
            for topic, offset in self._offsets.items()
        ]
        for topic, entries in single.items():
            times, offsets = np.array(entries, np.int64).T
            messages.append(ChunkMessages(channel=self._channels[topic], times=times, offsets=offsets))
        return b"".join(pieces), messages

    def _views(self) -> tuple[list[NDArray[np.uint8]], list[tuple[NDArray[np.float64], str, slice]]]:
        """Return where a tick's head stands in each of its messages, and each room for numbers: which part's, which.

        Views are made once: for twenty ticks they cost more than what is copied through them.
        """
        block, arms = self._block, self._tick.arms
        raw = block.view(np.uint8).reshape(len(block), -1)
        heads, rooms = [], []
        for topic in self._tick.messages:
            stamped = topic != CONTROL
            first = self._offsets[topic] + RECORD_HEADER.fields["sequence"][1]  # type: ignore[index]
            heads.append(raw[:, first : first + (_TICK_HEAD.itemsize if stamped else _UNSTAMPED)])
            records = block[topic]
            if topic == CONTROL:
                rooms.append((records["row"], "control", slice(None)))
            elif topic == MEASURED:
                rooms.append((records["position"], _MEASURED, slice(None)))
                if "rates" in self._tick.parts:
                    rooms.append((records["velocity"], "rates", slice(None)))
            else:
                part = next(part for part, name in STATE_TOPICS.items() if name == topic)
                for k, field in enumerate(("position", "velocity")):
                    rooms.append((records[field][:, :arms], part, slice(k * arms, (k + 1) * arms)))
                    if self._tick.has_cart:
                        rooms.append((records[field][:, arms:], part, slice(2 * arms + k, 2 * arms + k + 1)))
        return heads, rooms

    def _fill(self, rows: TickRows) -> NDArray:
        count = len(rows.time_ns)
        head = np.empty(count, _TICK_HEAD)
        head["sequence"] = np.arange(self._ticks, self._ticks + count)
        head["log_time"] = head["publish_time"] = rows.time_ns
        head["encapsulation"] = ENCAPSULATION
        head["sec"], head["nanosec"] = np.divmod(rows.time_ns, _SECOND)
        self._ticks += count
        raw = head.view(np.uint8).reshape(count, _TICK_HEAD.itemsize)
        for into in self._heads:
            into[:count] = raw[:, : into.shape[1]]
        for into, part, columns in self._rooms:
            into[:count] = (rows.measured if part == _MEASURED else rows.parts[part])[:, columns]
        return self._block[:count]

    def _robot(self, rows: TickRows) -> NDArray[np.float64]:
        """Return the states that /tf shows: the best known."""
        for part in ("truth", "estimate"):
            if part in rows.parts:
                return rows.parts[part]
        states = np.zeros((len(rows.measured), 2 * rows.measured.shape[1]))
        states[:, self._positions] = rows.measured
        return states

    def _transform_notes(self, rows: TickRows) -> list[Note]:
        number = np.floor(rows.time_ns * (TRANSFORM_RATE / _SECOND) + 1e-6).astype(np.int64)
        chosen: list[int] = []
        for row, due in enumerate(number.tolist()):
            if due > self._last_transform:
                chosen.append(row)
            self._last_transform = due
        if not chosen:
            return []
        robots = [self._robot(rows)] + ([rows.parts["reference"]] if "reference" in rows.parts else [])
        states = np.concatenate([robot[chosen] for robot in robots], axis=1)
        # Readers of transforms reject poses that are not finite.
        if not np.isfinite(states).all():
            finite = np.flatnonzero(np.isfinite(states).all(axis=1))
            chosen, states = [chosen[k] for k in finite], states[finite]
            if not chosen:
                return []
        poses = urdf.poses(
            states.reshape(len(chosen) * len(robots), -1), arm_lengths=self._lengths, has_cart=self._tick.has_cart
        )
        poses = poses.reshape(len(chosen), -1)
        times = rows.time_ns[chosen]
        stamps = np.empty(len(chosen), _STAMP)
        stamps["sec"], stamps["nanosec"] = np.divmod(times, _SECOND)
        # All stamps and all poses at once, byte by byte: thirty columns one at a time cost more than the rest.
        records = np.empty((len(chosen), len(self._template)), np.uint8)
        records[:] = self._template
        records[:, self._stamp_bytes] = stamps.view(np.uint8).reshape(len(chosen), 1, _STAMP.itemsize)
        records[:, self._pose_bytes] = poses.view(np.uint8).reshape(len(chosen), self._frames, -1)
        return [
            Note(row=row, topic=TRANSFORMS, time_ns=time, content=record.tobytes())
            for row, time, record in zip(chosen, times.tolist(), records, strict=True)
        ]

    def _record(self, note: Note) -> bytes:
        number, length = self._counts[note.topic], RECORD_HEADER.itemsize - 9 + len(note.content)
        self._counts[note.topic] += 1
        channel = self._channels[note.topic]
        head = _HEAD.pack(MESSAGE_OPCODE, length, channel, number, note.time_ns, note.time_ns)
        return head + note.content


Row = NDArray[np.float64]


class TickBuffer:
    """Room for `size` ticks of a layout with all its parts; which of them a log has, its first tick decides."""

    def __init__(self, tick: TickLayout, *, rows: int) -> None:
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
            names = (part for part in PARTS if part in parts ^ self._parts)
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
            parts={part: self._rooms[part][:count] for part in PARTS if part in parts},
        )

    def clear(self) -> None:
        """Make room; the ticks have been written."""
        self.filled = 0


Limits = tuple[float, float, float] | None


def layout_record(
    tick: TickLayout,
    arm_lengths: Sequence[float],
    *,
    rate_hz: float,
    limits: Limits,
    attachments: Collection[str],
) -> dict[str, str]:
    """Return the metadata by which a log is read: arms' lengths in m, rate in Hz, limits, parts of a tick."""
    return {
        "format": FORMAT,
        "arm_lengths": " ".join(repr(length) for length in arm_lengths),
        "has_cart": "1" if tick.has_cart else "0",
        "rate_hz": repr(rate_hz),
        "limits": " ".join(repr(float(limit)) for limit in limits or ()),
        "parts": " ".join(part for part in PARTS if part in tick.parts),
        "attachments": json.dumps(list(attachments)),
        "program": f"dpcontrol {dpcontrol.__version__}",
    }


def descriptions(tick: TickLayout, arm_lengths: Sequence[float], *, limits: Limits, time_ns: int) -> list[Note]:
    """Return the URDF of the arms, and of the reference's ghost where a tick has a reference, as messages."""
    notes: list[Note] = []
    for topic in (topic for topic in tick.channels if topic in LATCHED):
        ghost = topic == GHOST
        text = urdf.robot_description(
            arm_lengths,
            has_cart=tick.has_cart,
            limits=limits,
            prefix=REFERENCE_PREFIX if ghost else "",
            ghost=ghost,
        )
        notes.insert(0, Note(row=0, topic=topic, time_ns=time_ns, content=string(text)))
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
        self._metadata = sealed(RUN_RECORD, dict(metadata or {}))
        self._attachments = dict(attachments or {})
        self._rate = float(rate_hz)
        self._compression = compression
        if not self._lengths or not self._rate > 0:
            raise ValueError(f"a log needs arms and a positive rate; got {len(self._lengths)} arms at {rate_hz} Hz")
        tick = TickLayout(len(self._lengths), has_cart, frozenset(PARTS))
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
        values = {**self._result, TICKS: str(self._ticks)}
        file.add_metadata(RESULT_RECORD, sealed(RESULT_RECORD, values))
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
        self._file.add_metadata(RUN_RECORD, self._metadata)
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
        if level not in LEVELS:
            raise ValueError(f"event level {level!r}: must be one of {', '.join(LEVELS)}")
        time_ns = round(time_s * 1e9)
        message = log(time_ns, LEVELS[level], name=name, text=text)
        self._notes.append(Note(row=self._buffer.filled, topic=EVENTS, time_ns=time_ns, content=message))

    def _prepare(self, file: McapFile) -> ChunkEncoder:
        # Done with the first chunk: only then is it known what a tick holds.
        tick = TickLayout(len(self._lengths), self._has_cart, self._buffer.parts)
        described = layout_record(
            tick, self._lengths, rate_hz=self._rate, limits=self._limits, attachments=self._attachments
        )
        file.add_metadata(LAYOUT_RECORD, sealed(LAYOUT_RECORD, described))
        file.add_channels(tick.schemas, latched=LATCHED)
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
