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
        frames = [
            frame
            for prefix in (("", REFERENCE_PREFIX) if "reference" in tick.parts else ("",))
            for frame in urdf.frames(tick.arms, has_cart=tick.has_cart, prefix=prefix)
        ]
        self._frames = len(frames)
        self._transforms = cdr.transforms(frames)
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

    def _fill(self, rows: TickRows) -> NDArray:
        count = len(rows.time_ns)
        block = self._block[:count]
        seconds, nanoseconds = np.divmod(rows.time_ns, _SECOND)
        parts = {topic: rows.parts[part] for part, topic in layout.STATE_TOPICS.items() if part in rows.parts}
        for topic in self._tick.messages:
            records = block[topic]
            records["log_time"] = records["publish_time"] = rows.time_ns
            records["sequence"] = np.arange(self._counts[topic], self._counts[topic] + count)
            self._counts[topic] += count
            if topic == layout.CONTROL:
                records["row"] = rows.parts["control"]
                continue
            records["stamp.sec"] = seconds
            records["stamp.nanosec"] = nanoseconds
            if topic == layout.MEASURED:
                records["position"] = rows.measured
                if "rates" in rows.parts:
                    records["velocity"] = rows.parts["rates"]
            else:
                records["position"] = parts[topic][:, self._positions]
                records["velocity"] = parts[topic][:, self._velocities]
        return block

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
        if not len(number):
            return []
        chosen = np.flatnonzero(np.diff(number, prepend=self._last_transform) > 0)
        self._last_transform = int(number[-1])
        if not len(chosen):
            return []
        robots = [self._robot(rows)] + ([rows.parts["reference"]] if "reference" in rows.parts else [])
        states = np.concatenate([robot[chosen] for robot in robots], axis=1)
        # A pose of a state that is no number would be refused by every reader of transforms.
        finite = np.isfinite(states).all(axis=1)
        chosen, states = chosen[finite], states[finite]
        if not len(chosen):
            return []
        poses = urdf.poses(
            states.reshape(len(chosen) * len(robots), -1), arm_lengths=self._lengths, has_cart=self._tick.has_cart
        )
        poses = poses.reshape(len(chosen), -1)
        times = rows.time_ns[chosen]
        stamps = np.empty(len(chosen), _STAMP)
        stamps["sec"], stamps["nanosec"] = np.divmod(times, _SECOND)
        # All stamps and all poses at once, byte by byte: thirty columns one at a time cost more than the rest.
        records = np.tile(np.frombuffer(self._transforms.template, np.uint8), (len(chosen), 1))
        records[:, self._stamp_bytes] = stamps.view(np.uint8).reshape(len(chosen), 1, _STAMP.itemsize)
        records[:, self._pose_bytes] = poses.view(np.uint8).reshape(len(chosen), self._frames, -1)
        return [
            Note(row=int(row), topic=layout.TRANSFORMS, time_ns=int(time), content=record.tobytes())
            for row, time, record in zip(chosen, times, records, strict=True)
        ]

    def _record(self, note: Note) -> bytes:
        number, length = self._counts[note.topic], layout.RECORD_HEADER.itemsize - 9 + len(note.content)
        self._counts[note.topic] += 1
        channel = self._channels[note.topic]
        head = _HEAD.pack(layout.MESSAGE_OPCODE, length, channel, number, note.time_ns, note.time_ns)
        return head + note.content
