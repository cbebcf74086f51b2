"""Turn rows of numbers into a chunk of message records, whole arrays at a time.

Every message's bytes are known but for its numbers (see `cdr`), so a block of K ticks is one numpy structured
array of K copies of a template, filled column by column.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.logs import cdr, layout, urdf
from dpcontrol.logs.container import ChunkMessages

REFERENCE_PREFIX = "reference/"
_SECOND = 1_000_000_000
_STAMP = np.dtype([("sec", "<i4"), ("nanosec", "<u4")])


@dataclass(frozen=True)
class TickRows:
    """K ticks: `time_ns` (K,) in ns, `measured` (K, n+1), states (K, 2n+2) or None, `control` (K, fields)."""

    time_ns: NDArray[np.int64]
    measured: NDArray[np.float64]
    estimate: NDArray[np.float64]
    reference: NDArray[np.float64]
    truth: NDArray[np.float64] | None
    control: NDArray[np.float64]


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
        channels: the number of each topic's channel.
        rows: the greatest number of ticks in a chunk.
    """

    def __init__(
        self,
        tick: layout.TickLayout,
        arm_lengths: Sequence[float],
        *,
        channels: Mapping[str, int],
        rows: int,
    ):
        self._tick = tick
        self._lengths = tuple(arm_lengths)
        self._channels = dict(channels)
        self._counts = dict.fromkeys(channels, 0)
        formats = [layout.message_type(message) for message in tick.messages.values()]
        template, offsets = b"", []
        for topic, message in tick.messages.items():
            offsets.append(len(template))
            template += layout.message_template(message, channels[topic])
        self._offsets = dict(zip(tick.messages, offsets, strict=True))
        block = np.dtype(
            {"names": list(tick.messages), "formats": formats, "offsets": offsets, "itemsize": len(template)}
        )
        self._block = np.frombuffer(bytearray(template * rows), block)
        self._positions, self._velocities = layout.joint_order(tick.arms, has_cart=tick.has_cart)
        frames = [
            frame
            for prefix in ("", REFERENCE_PREFIX)
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
        states = {layout.ESTIMATE: rows.estimate, layout.REFERENCE: rows.reference, layout.TRUTH: rows.truth}
        for topic in self._tick.messages:
            records = block[topic]
            records["log_time"] = records["publish_time"] = rows.time_ns
            records["sequence"] = np.arange(self._counts[topic], self._counts[topic] + count)
            self._counts[topic] += count
            if topic == layout.CONTROL:
                records["row"] = rows.control
                continue
            records["stamp.sec"] = seconds
            records["stamp.nanosec"] = nanoseconds
            if topic == layout.MEASURED:
                records["position"] = rows.measured
            else:
                state = states[topic]
                assert state is not None
                records["position"] = state[:, self._positions]
                records["velocity"] = state[:, self._velocities]
        return block

    def _transform_notes(self, rows: TickRows) -> list[Note]:
        number = np.floor(rows.time_ns * (layout.TRANSFORM_RATE / _SECOND) + 1e-6).astype(np.int64)
        if not len(number):
            return []
        chosen = np.flatnonzero(np.diff(number, prepend=self._last_transform) > 0)
        self._last_transform = int(number[-1])
        robot = rows.estimate if rows.truth is None else rows.truth
        # A pose of a state that is no number would be refused by every reader of transforms.
        chosen = chosen[np.isfinite(robot[chosen]).all(axis=1) & np.isfinite(rows.reference[chosen]).all(axis=1)]
        if not len(chosen):
            return []
        states = np.concatenate([robot[chosen], rows.reference[chosen]])
        poses = urdf.poses(states, arm_lengths=self._lengths, has_cart=self._tick.has_cart)
        poses = np.concatenate([poses[: len(chosen)], poses[len(chosen) :]], axis=1)
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
        header = np.zeros(1, layout.RECORD_HEADER)
        header["opcode"] = layout.MESSAGE_OPCODE
        header["length"] = layout.RECORD_HEADER.itemsize - 9 + len(note.content)
        header["channel"] = self._channels[note.topic]
        header["sequence"] = self._counts[note.topic]
        header["log_time"] = header["publish_time"] = note.time_ns
        self._counts[note.topic] += 1
        return header.tobytes() + note.content
