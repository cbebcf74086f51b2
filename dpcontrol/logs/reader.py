"""Read a run's log into arrays.

The file's checksums are compared first (see `verified`). Messages are then found by walking the chunks' records,
and those at loop rate are decoded as arrays, for their layout is known from the log's own metadata.
"""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import cdr, layout
from dpcontrol.logs.sealed import unsealed
from dpcontrol.logs.verified import MALFORMED, VerifiedFile, damaged, note_channel, open_verified

if TYPE_CHECKING:
    from pandas import DataFrame

Array = NDArray[np.float64]

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
    """A log in memory; arrays are read-only.

    Attributes:
        path: where it was read from.
        time: (N,) in s.
        measured: (N, n+1) positions as the sensors gave them, in the order of `joint_names`; rad, m.
        rates: (N, n+1) rates as the sensors gave them, rad/s and m/s, or None.
        states: (N, 2n+2) in state order, rad, rad/s, m, m/s (2n entries without a cart), for each of "estimate",
            "reference" and "truth" that the log has.
        controls: (N,) for each name of `control_fields`; empty where no controller ran.
        events: in the order in which they were logged.
        metadata: what the writer's caller passed at the start and at the end, and `program`, which wrote it.
        attachments: content by name.
        joint_names: `arm_1 …`, then `cart` where there is one.
        arm_lengths: (n,) in m.
        has_cart: whether the pivot is on a cart.
        rate_hz: rate of the loop in Hz.
        limits: the cart's greatest distance from the centre in m, velocity in m/s, acceleration in m/s²; or None.
        recovered: what `dpcontrol recover` could not save of this log, a sentence; None where nothing was recovered.
    """

    path: Path
    time: Array
    measured: Array
    rates: Array | None
    states: dict[str, Array]
    controls: dict[str, Array]
    events: tuple[Event, ...]
    metadata: dict[str, str]
    attachments: dict[str, bytes]
    joint_names: tuple[str, ...]
    arm_lengths: tuple[float, ...]
    has_cart: bool
    rate_hz: float
    limits: tuple[float, float, float] | None
    recovered: str | None = None

    @property
    def parts(self) -> frozenset[str]:
        """Which of "rates", "estimate", "reference", "truth" and "control" the log has; `measured` is always there."""
        found = {*self.states} | ({"control"} if self.controls else set())
        return frozenset(found | ({"rates"} if self.rates is not None else set()))

    @property
    def truth(self) -> Array | None:
        """The plant's own states, or None where nobody knows them."""
        return self.states.get("truth")

    @property
    def estimate(self) -> Array:
        """The estimator's states.

        Raises:
            InputError: the log has none.
        """
        return self._state("estimate", "/estimate/joint_states")

    @property
    def reference(self) -> Array:
        """The states to follow.

        Raises:
            InputError: the log has none.
        """
        return self._state("reference", "/reference/joint_states")

    @property
    def control(self) -> dict[str, Array]:
        """What the controller did, by name of field.

        Raises:
            InputError: no controller ran.
        """
        if not self.controls:
            raise InputError(self._lacks("/control"))
        return self.controls

    def _state(self, part: str, topic: str) -> Array:
        if part not in self.states:
            raise InputError(self._lacks(topic))
        return self.states[part]

    def _lacks(self, topic: str) -> str:
        return f"{self.path} has no {topic}: it is a recording, not a run; give a log of `dpcontrol run`"

    def frame(self) -> "DataFrame":
        """Return a pandas table: one row for each tick, indexed by `time` in s.

        Columns: `measured.arm_1` …, `rates.arm_1` …, `estimate.angle_1`, `estimate.rate_1`, `estimate.cart_position`,
        `estimate.cart_velocity`, likewise `reference` and `truth`, and `control.command` …; those that the log has.

        Raises:
            InputError: pandas is not installed.
        """
        try:
            from pandas import DataFrame, Index
        except ImportError as error:
            raise InputError("a table of a log needs pandas; install it with `pip install pandas`") from error
        columns = {f"measured.{name}": self.measured[:, i] for i, name in enumerate(self.joint_names)}
        if self.rates is not None:
            columns |= {f"rates.{name}": self.rates[:, i] for i, name in enumerate(self.joint_names)}
        names = layout.state_names(len(self.arm_lengths), has_cart=self.has_cart)
        for part, values in self.states.items():
            columns |= {f"{part}.{name}": values[:, i] for i, name in enumerate(names)}
        columns |= {f"control.{name}": values for name, values in self.controls.items()}
        return DataFrame(columns, index=Index(self.time, name="time"))


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
    found = batches(file)
    first = next(found, None)
    tick = _tick_layout(path, file)
    if first is None or not file.has_checksum:
        reason = "holds no messages" if first is None else "carries no checksum of its data, so nothing vouches for it"
        raise InputError(f"{path} {reason}; make the log again with `dpcontrol run`")
    topics = {channel.id: channel.topic for channel in file.channels.values()}
    columns: dict[str, list[NDArray]] = {topic: [] for topic in tick.messages}
    events: list[Event] = []
    for data, places in chain([first], found):
        for number, offsets in places.items():
            topic = topics.get(number, "")
            if topic in columns:
                columns[topic].append(_columns(path, data, offsets, topic=topic, tick=tick))
            elif topic == layout.EVENTS:
                events += [_event(data, offset) for offset in offsets]
    whole = {topic: np.concatenate(parts) if parts else None for topic, parts in columns.items()}
    return _run_log(path, file, tick=tick, records=whole, events=events)


def batches(file: VerifiedFile) -> Iterator[tuple[bytes, dict[int, list[int]]]]:
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


def log_times(data: bytes, offsets: list[int]) -> NDArray[np.int64]:
    """Return the times in ns of the messages at `offsets`."""
    size = layout.RECORD_HEADER.itemsize
    everywhere = np.ndarray((len(data) - size + 1,), f"V{size}", buffer=data, strides=(1,))
    return everywhere[np.array(offsets)].view(layout.RECORD_HEADER)["log_time"].astype(np.int64)


def _tick_layout(path: Path, file: VerifiedFile) -> layout.TickLayout:
    """Return what a tick of this log holds, once topics, encodings and schemas are those of a run's log."""
    by_topic = {channel.topic: channel for channel in file.channels.values()}
    described = file.metadata.get(layout.LAYOUT_RECORD)
    if described is None:
        writer = f" (written by {file.library})" if file.library else ""
        raise InputError(
            f"{path}{writer} is not a log of dpcontrol: it lacks the metadata record {layout.LAYOUT_RECORD}; give a "
            "log of `dpcontrol run`"
        )
    tick = tick_layout_of(path, described)
    for topic, (name, definition) in tick.schemas.items():
        channel = by_topic.get(topic)
        schema = file.schemas.get(channel.schema_id) if channel else None
        if channel is None or schema is None or schema.data != definition or channel.message_encoding != "cdr":
            encoding = channel.message_encoding if channel else ""
            found = f"{schema.name if schema else 'no schema'} in {encoding or 'no encoding'}"
            raise InputError(
                f"{path}: topic {topic} carries {found}, not {name} in cdr as a log of `dpcontrol run` does"
            )
    return tick


def tick_layout_of(path: Path, described: Mapping[str, str]) -> layout.TickLayout:
    """Return what a tick holds by the metadata record of a log's layout.

    Raises:
        InputError: the layout is of another version of this program.
        LookupError, ValueError: the record is not as the writer makes it.
    """
    if described.get("format") != layout.FORMAT:
        raise InputError(
            f"{path} has layout {described.get('format')!r}, and this version of dpcontrol reads layout "
            f"{layout.FORMAT!r}; read it with the version that wrote it, or run the itinerary again"
        )
    if unsealed(layout.LAYOUT_RECORD, described) is None:
        raise ValueError(f"the checksum of {layout.LAYOUT_RECORD} differs")
    parts = frozenset(described["parts"].split())
    if not parts <= set(layout.PARTS):
        raise ValueError(f"unknown parts {sorted(parts)}")
    return layout.TickLayout(len(described["arm_lengths"].split()), described["has_cart"] == "1", parts)


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
    states: dict[str, Array] = {}
    for part, topic in layout.STATE_TOPICS.items():
        # Taken out of the mapping as they are used: a long log is held once, not twice.
        rows = records.pop(topic, None)
        if rows is not None:
            joined = np.empty((len(rows), len(positions) + len(velocities)))
            joined[:, positions] = rows["position"]
            joined[:, velocities] = rows["velocity"]
            states[part] = _frozen(joined)
    rows = records.pop(layout.CONTROL, None)
    control = {} if rows is None else {name: _frozen(rows["row"][:, i].copy()) for i, name in enumerate(tick.fields)}
    described = file.metadata[layout.LAYOUT_RECORD]
    limits = tuple(float(text) for text in described["limits"].split())
    said = {name: unsealed(name, record) or {} for name, record in file.metadata.items()}
    result = {key: value for key, value in said.get(layout.RESULT_RECORD, {}).items() if key != layout.TICKS}
    return RunLog(
        path=path,
        time=_frozen(measured["log_time"] / 1e9),
        measured=_frozen(measured["position"].copy()),
        rates=_frozen(measured["velocity"].copy()) if "rates" in tick.parts else None,
        states=states,
        controls=control,
        events=tuple(events),
        metadata={**result, **said.get(layout.RUN_RECORD, {}), "program": described["program"]},
        attachments=dict(file.attachments),
        joint_names=tick.names,
        arm_lengths=tuple(float(text) for text in described["arm_lengths"].split()),
        has_cart=tick.has_cart,
        rate_hz=float(described["rate_hz"]),
        limits=(limits[0], limits[1], limits[2]) if limits else None,
        recovered=said.get(layout.RECOVERY_RECORD, {}).get(layout.LOST) or None,
    )


def _frozen(array: NDArray[np.float64]) -> NDArray[np.float64]:
    array.flags.writeable = False
    return array
