"""Read a run's log into arrays.

The file's checksums are compared first (see `verified`). Messages are then found by walking the chunks' records,
and those at loop rate are decoded as arrays, for their layout is known from the log's own metadata.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import cdr, layout
from dpcontrol.logs.verified import MALFORMED, VerifiedFile, damaged, note_channel, open_verified

_RECORD = struct.Struct("<BQH")
_BATCH_BYTES = 4_000_000
_LEVEL_NAMES = {number: name for name, number in layout.LEVELS.items()}


class Event(NamedTuple):
    """Something that happened: time in s, level (a key of `LEVELS`), the part it came from, a sentence."""

    time: float
    level: str
    name: str
    text: str


@dataclass(frozen=True)
class RunLog:
    """A run as it was logged; arrays are read-only.

    Attributes:
        path: where it was read from.
        time: (N,) in s.
        measured: (N, n+1) positions as the sensors gave them, in the order of `joint_names`; rad, m.
        estimate: (N, 2n+2) in state order; rad, rad/s, m, m/s (2n entries without a cart).
        reference: (N, 2n+2) likewise.
        truth: (N, 2n+2) likewise, or None where nobody knows it.
        control: (N,) for each name of `control_fields`.
        events: in the order in which they were logged.
        metadata: what the writer's caller passed at the start and at the end, and `program`, which wrote it.
        attachments: content by name.
        joint_names: `arm_1 …`, then `cart` where there is one.
        arm_lengths: (n,) in m.
        has_cart: whether the pivot is on a cart.
        rate_hz: rate of the loop in Hz.
        limits: the cart's greatest distance from the centre in m, velocity in m/s, acceleration in m/s²; or None.
    """

    path: Path
    time: NDArray[np.float64]
    measured: NDArray[np.float64]
    estimate: NDArray[np.float64]
    reference: NDArray[np.float64]
    truth: NDArray[np.float64] | None
    control: dict[str, NDArray[np.float64]]
    events: tuple[Event, ...]
    metadata: dict[str, str]
    attachments: dict[str, bytes]
    joint_names: tuple[str, ...]
    arm_lengths: tuple[float, ...]
    has_cart: bool
    rate_hz: float
    limits: tuple[float, float, float] | None


def read_log(path: Path | str) -> RunLog:
    """Return the run logged in `path`.

    Raises:
        InputError: the file is missing, empty, cut off, damaged, no MCAP file or not a log of a run.
    """
    path = Path(path)
    file = open_verified(path)
    try:
        return _decode(path, file)
    except MALFORMED as error:
        damaged(path, f"its messages do not decode: {error}", cause=error)


def _decode(path: Path, file: VerifiedFile) -> RunLog:
    batches = _batches(file)
    first = next(batches, None)
    tick = _tick_layout(path, file)
    if first is None or not file.has_checksum:
        reason = "holds no messages" if first is None else "carries no checksum of its data, so nothing vouches for it"
        raise InputError(f"{path} {reason}; make the log again with `dpcontrol run`")
    topics = {channel.id: channel.topic for channel in file.channels.values()}
    columns: dict[str, list[NDArray]] = {topic: [] for topic in tick.messages}
    events: list[Event] = []
    for data, places in chain([first], batches):
        for number, offsets in places.items():
            topic = topics.get(number, "")
            if topic in columns:
                columns[topic].append(_columns(path, data, offsets, topic=topic, tick=tick))
            elif topic == layout.EVENTS:
                events += [_event(data, offset) for offset in offsets]
    whole = {topic: np.concatenate(parts) if parts else None for topic, parts in columns.items()}
    return _run_log(path, file, tick=tick, records=whole, events=events)


def _batches(file: VerifiedFile) -> Iterator[tuple[bytes, dict[int, list[int]]]]:
    """Yield the records of several chunks, and the offsets of their messages by channel."""
    pending, size = [], 0
    for content in file.contents():
        pending.append(content)
        size += len(content)
        if size >= _BATCH_BYTES:
            yield _offsets(file, b"".join(pending))
            pending, size = [], 0
    if pending:
        yield _offsets(file, b"".join(pending))


def _offsets(file: VerifiedFile, data: bytes) -> tuple[bytes, dict[int, list[int]]]:
    found: dict[int, list[int]] = {}
    place, end, unpack = 0, len(data), _RECORD.unpack_from
    while place < end:
        opcode, length, channel = unpack(data, place)
        if place + 9 + length > end:
            raise ValueError("a record runs over the end of its chunk")
        if opcode == layout.MESSAGE_OPCODE:
            if channel in found:
                found[channel].append(place)
            else:
                found[channel] = [place]
        else:
            note_channel(file, opcode, data[place + 9 : place + 9 + length])
        place += 9 + length
    return data, found


def _tick_layout(path: Path, file: VerifiedFile) -> layout.TickLayout:
    """Return what a tick of this log holds, once topics, encodings and schemas are those of a run's log."""
    by_topic = {channel.topic: channel for channel in file.channels.values()}
    required = (layout.MEASURED, layout.ESTIMATE, layout.REFERENCE, layout.CONTROL)
    missing = [topic for topic in required if topic not in by_topic]
    described = file.metadata.get(layout.LAYOUT_RECORD)
    if missing or described is None:
        what = f"the topics {', '.join(missing)}" if missing else f"the metadata record {layout.LAYOUT_RECORD}"
        writer = f" (written by {file.library})" if file.library else ""
        raise InputError(f"{path}{writer} is not a log of a run: it lacks {what}; give a log of `dpcontrol run`")
    if described.get("format") != "1":
        raise InputError(
            f"{path} has layout {described.get('format')!r}, and this version of dpcontrol reads layout '1'; "
            "read it with the version that wrote it"
        )
    tick = layout.TickLayout(
        arms=len(described["arm_lengths"].split()),
        has_cart=described["has_cart"] == "1",
        has_truth=layout.TRUTH in by_topic,
    )
    for topic, (name, definition) in tick.schemas.items():
        channel = by_topic[topic]
        schema = file.schemas.get(channel.schema_id)
        if schema is None or schema.data != definition or channel.message_encoding != "cdr":
            found = f"{schema.name if schema else 'no schema'} in {channel.message_encoding or 'no encoding'}"
            raise InputError(
                f"{path}: topic {topic} carries {found}, not {name} in cdr as a log of `dpcontrol run` does"
            )
    return tick


def _columns(path: Path, data: bytes, offsets: list[int], *, topic: str, tick: layout.TickLayout) -> NDArray:
    """Return log_time and the numbers of each message at `offsets`, as one structured array."""
    kind = layout.message_type(tick.messages[topic])
    if offsets[-1] + kind.itemsize > len(data):
        raise ValueError(f"a message of {topic} is too short")
    # A view at every byte, so that fancy indexing copies whole messages.
    everywhere = np.ndarray((len(data) - kind.itemsize + 1,), f"V{kind.itemsize}", buffer=data, strides=(1,))
    records = everywhere[np.array(offsets)].view(kind)
    if (records["length"] != kind.itemsize - 9).any():
        damaged(path, f"the messages of {topic} differ in length")
    names = ["log_time", *(name for name in kind.names or () if name in ("position", "velocity", "row"))]
    packed = np.empty(len(records), np.dtype([(name, kind[name]) for name in names]))
    for name in names:
        packed[name] = records[name]
    return packed


def _event(data: bytes, offset: int) -> Event:
    head = np.frombuffer(data, layout.RECORD_HEADER, count=1, offset=offset)[0]
    end = offset + 9 + int(head["length"])
    level, name, text = cdr.read_log_message(data[offset + layout.RECORD_HEADER.itemsize : end])
    return Event(int(head["log_time"]) / 1e9, _LEVEL_NAMES.get(level, "info"), name, text)


def _run_log(
    path: Path,
    file: VerifiedFile,
    *,
    tick: layout.TickLayout,
    records: dict[str, NDArray | None],
    events: list[Event],
) -> RunLog:
    measured = records[layout.MEASURED]
    if measured is None or not len(measured):
        raise InputError(f"{path} holds no ticks: the run ended before its first; make it again with `dpcontrol run`")
    for topic, part in records.items():
        if part is None or not np.array_equal(part["log_time"], measured["log_time"]):
            damaged(path, f"the messages of {topic} do not pair with those of {layout.MEASURED}")
    positions, velocities = layout.joint_order(tick.arms, has_cart=tick.has_cart)

    def state(topic: str) -> NDArray[np.float64]:
        part = records[topic]
        assert part is not None
        joined = np.empty((len(part), len(positions) + len(velocities)))
        joined[:, positions] = part["position"]
        joined[:, velocities] = part["velocity"]
        return _frozen(joined)

    rows = records[layout.CONTROL]
    assert rows is not None
    control = {name: _frozen(rows["row"][:, i].copy()) for i, name in enumerate(tick.fields)}
    described = file.metadata[layout.LAYOUT_RECORD]
    limits = tuple(float(text) for text in described["limits"].split())
    return RunLog(
        path=path,
        time=_frozen(measured["log_time"] / 1e9),
        measured=_frozen(measured["position"].copy()),
        estimate=state(layout.ESTIMATE),
        reference=state(layout.REFERENCE),
        truth=state(layout.TRUTH) if tick.has_truth else None,
        control=control,
        events=tuple(events),
        metadata={
            **file.metadata.get(layout.RESULT_RECORD, {}),
            **file.metadata.get(layout.RUN_RECORD, {}),
            "program": described["program"],
        },
        attachments=dict(file.attachments),
        joint_names=tick.names,
        arm_lengths=tuple(float(text) for text in described["arm_lengths"].split()),
        has_cart=tick.has_cart,
        rate_hz=float(described["rate_hz"]),
        limits=(limits[0], limits[1], limits[2]) if limits else None,
    )


def _frozen(array: NDArray[np.float64]) -> NDArray[np.float64]:
    array.flags.writeable = False
    return array
