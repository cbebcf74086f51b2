"""Turn rows of numbers into a chunk of message records, whole arrays at a time.

Every message's bytes are known but for its numbers (see `cdr`), so a block of K ticks is one numpy structured
array of K copies of a template, filled column by column.
"""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.logs import cdr, layout, urdf
from dpcontrol.logs.container import ChunkMessages

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

    def __init__(self, tick: layout.TickLayout, arm_lengths: Sequence[float], *, rows: int):
        self._tick = tick
        self._lengths = tuple(arm_lengths)
        self._channels = tick.channels
        self._counts = dict.fromkeys(tick.channels, 0)
        self._offsets = tick.block_offsets
        self._block = np.frombuffer(bytearray(tick.block_template * rows), tick.block_type)
        self._positions, self._velocities = layout.joint_order(tick.arms, has_cart=tick.has_cart)
        self._heads, self._rooms = self._views()
        self._ticks = 0
        frames = [
            frame
            for prefix in (("", REFERENCE_PREFIX) if "reference" in tick.parts else ("",))
            for frame in urdf.frames(tick.arms, has_cart=tick.has_cart, prefix=prefix)
        ]
        self._frames = len(frames)
        self._transforms = cdr.transforms(frames)
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
            stamped = topic != layout.CONTROL
            first = self._offsets[topic] + layout.RECORD_HEADER.fields["sequence"][1]  # type: ignore[index]
            heads.append(raw[:, first : first + (_TICK_HEAD.itemsize if stamped else _UNSTAMPED)])
            records = block[topic]
            if topic == layout.CONTROL:
                rooms.append((records["row"], "control", slice(None)))
            elif topic == layout.MEASURED:
                rooms.append((records["position"], _MEASURED, slice(None)))
                if "rates" in self._tick.parts:
                    rooms.append((records["velocity"], "rates", slice(None)))
            else:
                part = next(part for part, name in layout.STATE_TOPICS.items() if name == topic)
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
        head["encapsulation"] = cdr.ENCAPSULATION
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
        number = np.floor(rows.time_ns * (layout.TRANSFORM_RATE / _SECOND) + 1e-6).astype(np.int64)
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
            Note(row=row, topic=layout.TRANSFORMS, time_ns=time, content=record.tobytes())
            for row, time, record in zip(chosen, times.tolist(), records, strict=True)
        ]

    def _record(self, note: Note) -> bytes:
        number, length = self._counts[note.topic], layout.RECORD_HEADER.itemsize - 9 + len(note.content)
        self._counts[note.topic] += 1
        channel = self._channels[note.topic]
        head = _HEAD.pack(layout.MESSAGE_OPCODE, length, channel, number, note.time_ns, note.time_ns)
        return head + note.content
