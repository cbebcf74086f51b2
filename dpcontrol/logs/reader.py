"""Read a run's log into arrays, say topic by topic what is in it, or compare it with another message by message.

The file's checksums are compared first (see `verified`). Messages are then found by walking the chunks' records,
and those at loop rate are decoded as arrays, for their layout is known from the log's own metadata.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs.container import partials_of
from dpcontrol.logs.layout import (
    CONTROL,
    EVENTS,
    LAYOUT_RECORD,
    LEVELS,
    LOST,
    MEASURED,
    PARTS,
    RECORD_HEADER,
    RECOVERY_RECORD,
    RESULT_RECORD,
    RUN_RECORD,
    STATE_TOPICS,
    TICKS,
    UNITS,
    TickLayout,
    joint_order,
    read_log_message,
    state_names,
)
from dpcontrol.logs.verified import (
    VerifiedFile,
    gathered,
    open_verified,
)

if TYPE_CHECKING:
    from pandas import DataFrame

Array = NDArray[np.float64]

_AGAIN = "make the log again with `dpcontrol run`"
_LEVEL_NAMES = {number: name for name, number in LEVELS.items()}


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
        names = state_names(len(self.arm_lengths), has_cart=self.has_cart)
        for part, values in self.states.items():
            columns |= {f"{part}.{name}": values[:, i] for i, name in enumerate(names)}
        columns |= {f"control.{name}": values for name, values in self.controls.items()}
        return DataFrame(columns, index=Index(self.time, name="time"))


def read_log(path: Path | str) -> RunLog:
    """Return the run logged in `path`.

    Raises:
        InputError: the file is missing, empty, cut off, damaged, not an MCAP file or not a log of a run.
    """
    file = open_verified(Path(path))
    with file.decoding():
        return _decode(file)


def _decode(file: VerifiedFile) -> RunLog:
    tick = file.tick
    events: list[Event] = []
    rows: dict[str, list[Array]] = {name: [] for name in ("time", "measured", *tick.parts)}
    for batch in file.batches():
        for name, values in _numbers(batch.ticks_as(tick), tick):
            rows[name].append(values)
        events += [_event(batch.data, offset) for offset in batch.others.get(tick.channels[EVENTS], ())]
    if not file.has_checksum:
        raise InputError(f"{file.path} carries no checksum of its data, so nothing vouches for it; {_AGAIN}")
    if not sum(map(len, rows["time"])):
        raise InputError(f"{file.path} holds no ticks: the run ended before its first; {_AGAIN}")
    # Taken out of the mapping as they are joined: a long log is held once, not twice.
    whole = {name: _frozen(np.concatenate(rows.pop(name))) for name in list(rows)}
    return _run_log(file, rows=whole, events=events)


def _numbers(ticks: NDArray, tick: TickLayout) -> Iterator[tuple[str, Array]]:
    """Yield the rows of each part, by its name, from ticks as the file has them."""
    measured = ticks[MEASURED]
    yield "time", measured["log_time"] / 1e9
    yield "measured", measured["position"].copy()
    if "rates" in tick.parts:
        yield "rates", measured["velocity"].copy()
    positions, velocities = joint_order(tick.arms, has_cart=tick.has_cart)
    for part, topic in STATE_TOPICS.items():
        if part in tick.parts:
            joined = np.empty((len(ticks), tick.widths[part]))
            joined[:, positions] = ticks[topic]["position"]
            joined[:, velocities] = ticks[topic]["velocity"]
            yield part, joined
    if "control" in tick.parts:
        yield "control", ticks[CONTROL]["row"].copy()


def _event(data: bytes, offset: int) -> Event:
    head = np.frombuffer(data, RECORD_HEADER, count=1, offset=offset)[0]
    end = offset + 9 + int(head["length"])
    level, name, text = read_log_message(data[offset + RECORD_HEADER.itemsize : end])
    return Event(int(head["log_time"]) / 1e9, _LEVEL_NAMES.get(level, "info"), name, text)


def _run_log(file: VerifiedFile, *, rows: dict[str, Array], events: list[Event]) -> RunLog:
    tick, described = file.tick, file.metadata[LAYOUT_RECORD]
    limits = tuple(float(text) for text in described["limits"].split())
    columns = _frozen(np.ascontiguousarray(rows.pop("control").T)) if "control" in rows else ()
    metadata = {**file.values(RESULT_RECORD), **file.values(RUN_RECORD)}
    metadata.pop(TICKS, None)
    return RunLog(
        path=file.path,
        time=rows["time"],
        measured=rows["measured"],
        rates=rows.get("rates"),
        states={part: rows[part] for part in STATE_TOPICS if part in rows},
        controls=dict(zip(tick.fields, columns, strict=False)),
        events=tuple(events),
        metadata={**metadata, "program": described["program"]},
        attachments=file.attachments,
        joint_names=tick.names,
        arm_lengths=tuple(float(text) for text in described["arm_lengths"].split()),
        has_cart=tick.has_cart,
        rate_hz=float(described["rate_hz"]),
        limits=(limits[0], limits[1], limits[2]) if limits else None,
        recovered=file.values(RECOVERY_RECORD).get(LOST) or None,
    )


def _frozen(array: NDArray[np.float64]) -> NDArray[np.float64]:
    array.flags.writeable = False
    return array


@dataclass(frozen=True)
class TopicSummary:
    """A topic: its messages' type and units, how many there are, first and last time in s, and rate in Hz.

    rate_hz: messages over the time from first to last; None for fewer than two messages or no time between.
    """

    topic: str
    type: str
    units: str
    count: int
    first_s: float | None
    last_s: float | None
    rate_hz: float | None


@dataclass(frozen=True)
class LogSummary:
    """A log that is whole: duration s from first to last message, size in bytes, attachments' sizes in bytes.

    format: version of the layout. metadata: what the writer's caller passed. recovered: what `dpcontrol recover` could
    not save, or None. partials: files beside it that other runs of this log have left or are writing.
    """

    log: str
    size: int
    format: str
    program: str
    duration: float
    rate_hz: float
    joints: tuple[str, ...]
    parts: tuple[str, ...]
    topics: tuple[TopicSummary, ...]
    attachments: dict[str, int]
    metadata: dict[str, str]
    recovered: str | None
    partials: tuple[str, ...]


def summarise(path: Path | str) -> LogSummary:
    """Return what is in the log `path`, its checksums compared.

    Raises:
        InputError: the file is missing, cut off, damaged or not a log of this program.
    """
    file = open_verified(Path(path))
    with file.decoding():
        return _summary(file)


def _summary(file: VerifiedFile) -> LogSummary:
    tick, described = file.tick, file.metadata[LAYOUT_RECORD]
    spans: dict[int, tuple[int, int, int]] = {}
    for batch in file.batches():
        ticks = gathered(batch.data, batch.ticks, RECORD_HEADER)
        found = {tick.channels[topic]: ticks for topic in tick.messages}
        found |= {k: gathered(batch.data, places, RECORD_HEADER) for k, places in batch.others.items()}
        for channel, heads in found.items():
            if len(heads):
                low, high = int(heads["log_time"].min()), int(heads["log_time"].max())
                count, first, last = spans.get(channel, (0, low, high))
                spans[channel] = (count + len(heads), min(first, low), max(last, high))
    ends = [(first, last) for _, first, last in spans.values()]
    return LogSummary(
        log=str(file.path),
        size=file.path.stat().st_size,
        format=described["format"],
        program=described["program"],
        duration=(max(last for _, last in ends) - min(first for first, _ in ends)) / 1e9 if ends else 0.0,
        rate_hz=float(described["rate_hz"]),
        joints=tick.names,
        parts=tuple(part for part in PARTS if part in tick.parts),
        topics=tuple(
            _topic(topic, kind, units=UNITS[topic], span=spans.get(tick.channels[topic]))
            for topic, (kind, _) in tick.schemas.items()
        ),
        attachments={name: len(data) for name, data in file.attachments.items()},
        metadata={**file.values(RESULT_RECORD), **file.values(RUN_RECORD)},
        recovered=file.values(RECOVERY_RECORD).get(LOST) or None,
        partials=tuple(str(other) for other in partials_of(file.path)),
    )


def _topic(topic: str, kind: str, *, units: str, span: tuple[int, int, int] | None) -> TopicSummary:
    if span is None:
        return TopicSummary(topic, kind, units, 0, None, None, None)
    count, first, last = span
    rate = (count - 1) * 1e9 / (last - first) if last > first else None
    return TopicSummary(topic, kind, units, count, first / 1e9, last / 1e9, rate)


_HEAD = struct.Struct("<BQHIQ")


@dataclass(frozen=True)
class Comparison:
    """Two logs side by side: how many messages are the same, and the first that is not, as a sentence, or None."""

    messages: int
    difference: str | None


def compare_messages(one: Path | str, other: Path | str) -> Comparison:
    """Compare two logs message by message: topics, order, times and every byte; metadata may differ.

    What `one` has lost, if it was recovered, or if it ends early, is passed over in `other`.

    Raises:
        InputError: one of them is missing, damaged or not a log of this program.
    """
    sides = [open_verified(Path(path)) for path in (one, other)]
    tick = sides[0].tick
    if tick != sides[1].tick:
        return Comparison(0, f"{one} and {other} do not have the same topics")
    partial = bool(sides[0].metadata.get(RECOVERY_RECORD, {}).get(LOST))
    first, second = (_pieces(side) for side in sides)
    same = 0
    for piece in first:
        for against in second:
            if piece == against:
                same += _count(piece, tick)
                break
            if not partial or _head(piece)[2:4] == _head(against)[2:4]:
                return Comparison(same, _differs(piece, against, tick))
        else:
            return Comparison(same, f"{other} ends after {same} messages, {one} goes on")
    if not partial and next(second, None) is not None:
        return Comparison(same, f"{one} ends after {same} messages, {other} goes on")
    return Comparison(same, None)


def _pieces(side: VerifiedFile) -> Iterator[bytes]:
    """Yield the bytes of each tick and of each other message, in order."""
    with side.decoding():
        for batch in side.batches():
            places = [(place, len(side.tick.block_template)) for place in batch.ticks]
            others = (place for offsets in batch.others.values() for place in offsets)
            places += [(place, 9 + int.from_bytes(batch.data[place + 1 : place + 9], "little")) for place in others]
            for place, length in sorted(places):
                yield batch.data[place : place + length]


def _count(piece: bytes, tick: TickLayout) -> int:
    return len(tick.messages) if piece[:11] == tick.block_template[:11] else 1


def _head(piece: bytes, offset: int = 0) -> tuple[int, int, int, int, int]:
    """Return opcode, length, channel, sequence number and time of a message."""
    return _HEAD.unpack_from(piece, offset)


def _differs(piece: bytes, against: bytes, tick: TickLayout) -> str:
    if _head(piece)[2:4] == _head(against)[2:4] and _count(piece, tick) > 1:
        ends = [*tick.block_offsets.values(), len(piece)]
        at = next(a for a, b in pairwise(ends) if piece[a:b] != against[a:b])
    else:
        at = 0
    _, _, channel, sequence, time = _head(piece, at)
    topic = next((name for name, number in tick.channels.items() if number == channel), f"channel {channel}")
    if _head(piece)[2:4] != _head(against)[2:4]:
        return f"at {time / 1e9:.3f} s another message stands where message {sequence} of {topic} was"
    return f"message {sequence} of {topic} at {time / 1e9:.3f} s differs"
