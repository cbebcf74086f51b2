"""Read a log into arrays, summarise it, or compare two logs.

Summaries are by topic, comparisons message by message.

No record is trusted before the checksums agree. Checking indexes and single chunks is not enough: an index can point
elsewhere, and two chunks can be swapped without invalidating their checksums. The file is therefore read from front to
back, and the checksums of the whole data section and of the summary are compared first.

Messages are found by walking the chunks' records. The messages of a tick are contiguous, and the layout in the log's
metadata gives their lengths. One look per tick finds them all, and one copy extracts the numbers of thousands of ticks.
Source: the MCAP format specification, version 0.
"""

import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Header, Metadata, Schema
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError, remark
from dpcontrol.foundation.files import UNREADABLE, checked_size, checked_source, in_the_way
from dpcontrol.foundation.shown import Brief, Shown, pandas_classes
from dpcontrol.logs import layout
from dpcontrol.logs.container import CHUNK_HEAD, MAGIC, partials_of, unsealed
from dpcontrol.logs.layout import Event, TickLayout, logged_event
from dpcontrol.logs.rewritten import Rewritten, by_topic, found_in, mixed

if TYPE_CHECKING:
    from pandas import DataFrame


_T = TypeVar("_T")
_RECORD = struct.Struct("<BQH")
"""Head of a record: opcode, length and, for a message, its channel."""
_MESSAGE = struct.Struct("<HIQQ")
"""Head of a message's body: channel, sequence, log time and publish time; the data follow."""
_BATCH_BYTES = 4_000_000
LARGEST_CHUNK, LARGEST_LOG = 1 << 28, 1 << 33
"""Greatest unpacked size of a chunk and of a log, bytes: five hours at 1 kHz."""
_AGAIN = "make it again with `dpcontrol run`"
_AS_WRITTEN = "give the log as `dpcontrol run` wrote it"
MALFORMED = (*UNREADABLE, McapError, zstandard.ZstdError)
"""Exceptions raised when a malformed record is parsed."""
_PARSED: dict[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.METADATA: Metadata,
    Opcode.ATTACHMENT: Attachment,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.DATA_END: DataEnd,
    Opcode.FOOTER: Footer,
}


@dataclass
class VerifiedFile:
    """The records of an MCAP file whose checksums agree.

    Attributes:
        path: file that was read.
        library: the program that wrote it.
        has_checksum: True if the data section has a checksum.
        metadata: text by key, by record name.
        attachments: content by name.
        schemas: by number; those within chunks are added while `messages` runs.
        channels: by number, like `schemas`.
        chunks: the chunks' records, still packed.
        loose: messages outside of chunks.
    """

    path: Path
    library: str = ""
    has_checksum: bool = False
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[memoryview] = field(default_factory=list)
    loose: list[memoryview] = field(default_factory=list)

    def note(self, opcode: int, body: memoryview | bytes) -> None:
        """Store a record; kinds that are not needed are skipped.

        Args:
            opcode: kind of the record.
            body: content of the record.
        """
        match parsed(opcode, body):
            case Header(library=library):
                self.library = library
            case Metadata(name=name, metadata=values):
                self.metadata[name] = values
            case Attachment(name=name, data=data):
                self.attachments[name] = data
            case Schema() as schema:
                self.schemas[schema.id] = schema
            case Channel() as channel:
                self.channels[channel.id] = channel
            case None if opcode == Opcode.CHUNK:
                self.chunks.append(memoryview(body))
            case None if opcode == Opcode.MESSAGE:
                self.loose.append(memoryview(body))

    @contextmanager
    def decoding(self) -> Iterator[None]:
        """Report decoding errors as damage of this file."""
        try:
            yield
        except MALFORMED as error:
            raise _damaged(self.path, error) from error

    def values(self, name: str) -> dict[str, str]:
        """Return the values of a metadata record.

        The result is empty if the record is missing or its checksum differs.

        Args:
            name: name of the record.
        """
        return unsealed(name, self.metadata.get(name, {})) or {}

    @cached_property
    def tick(self) -> TickLayout:
        """Tick layout from the log's own description."""
        return described_layout(self.path, self.values(layout.LAYOUT_RECORD))

    @property
    def is_native(self) -> bool:
        """True if this program wrote the file and its channels are those of its layout."""
        if not (self.library.startswith("dpcontrol ") and self.has_checksum and self.values(layout.LAYOUT_RECORD)):
            return False
        declared = {c.topic: (c.id, self.schemas[c.schema_id].data) for c in self.channels.values()}
        return declared == {name: (number, self.tick.schemas[name][1]) for name, number in self.tick.channels.items()}

    @property
    def writer(self) -> str:
        """Phrase on the writing program, for messages."""
        return f" (written by {self.library})" if self.library else ""

    def messages(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield channel, time in ns and body of every message.

        Schemas and channels are stored as they are found.

        Raises:
            Exception: one of `MALFORMED`.
        """
        for chunk in self.chunks:
            data = unpacked(chunk)
            for opcode, start, end in records_in(data):
                if opcode == Opcode.MESSAGE:
                    yield _message(data[start:end])
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self.note(opcode, data[start:end])
        for body in self.loose:
            yield _message(bytes(body))

    def batches(self) -> "Iterator[Batch]":
        """Yield the messages of a native log in order, several chunks at a time.

        Raises:
            Exception: one of `MALFORMED`.
        """
        pending, size = [], 0
        for k, chunk in enumerate(self.chunks, start=1):
            pending.append(unpacked(chunk))
            size += len(pending[-1])
            if size >= _BATCH_BYTES or k == len(self.chunks):
                yield Batch(b"".join(pending), self.tick)
                pending, size = [], 0


def _message(body: bytes) -> tuple[int, int, bytes]:
    channel, _, time, _ = _MESSAGE.unpack_from(body)
    return channel, time, body[_MESSAGE.size :]


def unpacked(chunk: memoryview) -> bytes:
    """Return the records in a chunk after checking its checksum.

    Args:
        chunk: body of the chunk's record.

    Raises:
        Exception: one of `MALFORMED`: the chunk does not unpack, or its checksum differs.
    """
    _, _, size, checksum, _, _ = CHUNK_HEAD.unpack_from(chunk)
    checked_size(size, most=LARGEST_CHUNK)
    found = Chunk.read(ReadDataStream(BytesIO(chunk)))
    content = found.data
    if found.compression == "zstd":
        content = zstandard.decompress(content, size)
    elif found.compression:
        # The function of the lz4 package would unpack everything, regardless of the declared size.
        content = LZ4FrameDecompressor().decompress(content, max_length=size + 1)
    # Other programs may omit the checksum, which is then zero.
    if len(content) != size or (checksum and zlib.crc32(content) != checksum):
        raise ValueError("the checksum or the size of a chunk differs")
    return content


def parsed(opcode: int, body: memoryview | bytes) -> Any:
    """Return the parsed record, or None for other kinds.

    Args:
        opcode: kind of the record.
        body: content of the record.
    """
    kind = _PARSED.get(opcode)
    return kind.read(ReadDataStream(BytesIO(body))) if kind else None


def recorded_bytes(path: Path) -> bytes:
    """Return the bytes of a file of any kind.

    Args:
        path: the file.

    Raises:
        InputError: the file is missing or unreadable.
    """
    try:
        return checked_source(path).read_bytes()
    except FileNotFoundError as error:
        left = partials_of(path)
        remedy = f"a run left {left[-1]}: {_recover(left[-1])}" if left else f"check the name or {_AGAIN}"
        raise InputError(f"there is no log {path}; {remedy}") from error
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}; give the path of a .mcap file") from error


def records_in(data: memoryview | bytes, place: int = 0) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and end of each record's body; contiguous records fill the data.

    Args:
        data: the records.
        place: start of the first record.

    Raises:
        ValueError: the last record runs over the end.
    """
    whole = len(data)
    while place < whole:
        opcode, start = data[place], place + layout.LENGTH_FROM
        place = start + int.from_bytes(data[place + 1 : start], "little")
        if place > whole:
            raise ValueError("a record runs over the end")
        yield opcode, start, place


def _recover(path: Path) -> str:
    return f"`dpcontrol recover {path}` rebuilds a log from the rest"


def _damaged(path: Path, reason: object) -> InputError:
    said = next(iter(str(reason).splitlines()), type(reason).__name__)
    return InputError(
        f"{path} is damaged ({said}); copy it again from its source, write it again with the program that wrote it, "
        f"or {_recover(path)}"
    )


def open_verified(path: Path) -> VerifiedFile:
    """Read a log, compare its checksums and find its tick layout.

    Args:
        path: the log.

    Raises:
        InputError: the file is missing, no MCAP file, without its end, damaged or not a log of this program.
    """
    file = open_mcap(path)
    with file.decoding():
        # Evaluated once here, so that later uses cannot fail.
        _ = file.tick
    return file


def open_mcap(path: Path) -> VerifiedFile:
    """Read an MCAP file of any contents, and compare its checksums.

    Args:
        path: the file.

    Raises:
        InputError: the file is missing, no MCAP file, without its end, or damaged.
    """
    data = recorded_bytes(path)
    if not data.startswith(MAGIC):
        raise InputError(
            f"{path} is not a log because it is not an MCAP file (it begins with {data[:8]!r}); import a recording "
            "with `dpcontrol import` first, or give a log of `dpcontrol run`"
        )
    if not data[len(MAGIC) :].endswith(MAGIC):
        raise InputError(
            f"{path} has no end: the run was interrupted or the copy is incomplete; copy it again from its source, "
            f"or {_recover(path)}"
        )
    file, view = VerifiedFile(path), memoryview(data)
    with file.decoding():
        records = list(records_in(view[: -len(MAGIC)], len(MAGIC)))
        file.has_checksum = _check(view, records)
        for opcode, start, end in records:
            file.note(opcode, view[start:end])
        checked_size(sum(CHUNK_HEAD.unpack_from(chunk)[2] for chunk in file.chunks), most=LARGEST_LOG)
    return file


def _check(view: memoryview, records: list[tuple[int, int, int]]) -> bool:
    """Compare both checksums of a file; return True if the data section has one.

    Raises:
        Exception: one of `MALFORMED`: a checksum differs, or the closing records are not readable.
    """
    closing = [(start, end) for opcode, start, end in records if opcode == Opcode.DATA_END]
    start, end = closing[0]
    stored = parsed(Opcode.DATA_END, view[start:end]).data_section_crc
    _, at, last = records[-1]
    footer: Footer = parsed(records[-1][0], view[at:last])
    data, summary = view[: start - layout.LENGTH_FROM], view[footer.summary_start or at - layout.LENGTH_FROM : last - 4]
    if stored not in (0, zlib.crc32(data)) or footer.summary_crc not in (0, zlib.crc32(summary)):
        raise ValueError("a checksum differs")
    return stored != 0


class Batch:
    """Records of several chunks.

    Attributes:
        ticks: offsets (K,) of whole ticks.
        others: offsets of all other messages by channel.

    Args:
        data: the records.
        tick: layout of the ticks.

    Raises:
        ValueError: the records are not contiguous.
    """

    def __init__(self, data: bytes, tick: TickLayout) -> None:
        self.data = data
        self.ticks: list[int] = []
        self.others: dict[int, list[int]] = {}
        template = tick.block_template
        beginning, size = template[: _RECORD.size], len(template)
        place, whole, unpack = 0, len(data), _RECORD.unpack_from
        while place < whole:
            if data.startswith(beginning, place):
                self.ticks.append(place)
                place += size
                continue
            opcode, length, channel = unpack(data, place)
            if opcode == Opcode.MESSAGE:
                self.others.setdefault(channel, []).append(place)
            place += layout.LENGTH_FROM + length
        if place != whole:
            raise ValueError("a record runs over the end of its chunk")

    def times(self, tick: TickLayout) -> dict[str, NDArray]:
        """Return the times (K,) of each topic's messages, ns.

        Args:
            tick: layout of the ticks.
        """
        found = dict.fromkeys(tick.messages, gathered(self.data, self.ticks, layout.RECORD_HEADER)["log_time"])
        for topic in tick.channels.keys() - found.keys():
            places = self.others.get(tick.channels[topic], [])
            found[topic] = gathered(self.data, places, layout.RECORD_HEADER)["log_time"]
        return found

    def extras(self, tick: TickLayout) -> Array:
        """Return the rows of the estimated parameters.

        A row has the time, s, then standard deviations and values.

        Args:
            tick: layout of the ticks.

        Raises:
            ValueError: a message differs from the layout.
        """
        kind = layout.record_type(tick.extras_message)
        found = gathered(self.data, self.others.get(tick.channels[layout.EXTRAS], []), kind)
        if (found["length"] != kind.itemsize - layout.LENGTH_FROM).any():
            raise ValueError(f"a message of {layout.EXTRAS} has another length")
        return np.column_stack([found["log_time"] / 1e9, found["row"]])

    def rows(self, tick: TickLayout) -> dict[str, Array]:
        """Return the ticks' times (K,) in s, and rows by part.

        Rows are (K, width).

        Args:
            tick: layout of the ticks.

        Raises:
            ValueError: the messages of a tick differ from the layout.
        """
        ticks = gathered(self.data, self.ticks, tick.block_type)
        times = ticks[layout.MEASURED]["log_time"]
        for topic, message in tick.messages.items():
            length = layout.record_type(message).itemsize - layout.LENGTH_FROM
            due = {"opcode": Opcode.MESSAGE, "length": length, "channel": tick.channels[topic], "log_time": times}
            if any((ticks[topic][name] != value).any() for name, value in due.items()):
                raise ValueError(f"a tick lacks its message of {topic}, or that has another time")
        found = {part: np.empty((len(ticks), tick.widths[part])) for part in ("measured", *tick.parts)}
        for topic, field_name, joints, part, columns in tick.rooms:
            found[part][:, columns] = ticks[topic][field_name][:, joints]
        return {"time": times / 1e9, **found}


def gathered(data: bytes, offsets: list[int], kind: np.dtype) -> NDArray:
    """Return a copy of records of one type.

    Args:
        data: bytes with the records.
        offsets: places of the records, in increasing order.
        kind: structured type of a record.

    Raises:
        ValueError: a record extends beyond the end.
    """
    if not offsets:
        return np.empty(0, kind)
    if offsets[-1] + kind.itemsize > len(data):
        raise ValueError("a message is too short")
    # A view at every byte, so that fancy indexing copies whole records.
    everywhere = np.ndarray((len(data) - kind.itemsize + 1,), f"V{kind.itemsize}", buffer=data, strides=(1,))
    return everywhere[np.array(offsets)].view(kind)


_SLOWEST, _FASTEST = 1e-6, 1e9
"""Limits of the tick rate, Hz; no recording comes near them."""


def described_layout(path: Path, described: Mapping[str, str]) -> TickLayout:
    """Return the tick layout in a metadata record.

    Errors are those of `VerifiedFile.tick`.

    Args:
        path: path of the log, for messages.
        described: values of the record.
    """
    if described.get("format") != layout.FORMAT:
        raise InputError(
            f"{path} is not a log of `dpcontrol run` with layout {layout.FORMAT} (its metadata record "
            f"{layout.LAYOUT_RECORD} is of layout {described.get('format', 'none')}); read it with the version that "
            "wrote it, or make a recording of it with `dpcontrol import`"
        )
    parts = frozenset(described["parts"].split())
    if not parts <= set(layout.PARTS):
        raise ValueError(f"unknown parts {sorted(parts)}")
    if not _SLOWEST <= float(described["rate_hz"]) <= _FASTEST:
        raise ValueError(f"the tick rate in its layout is {described['rate_hz']} Hz")
    extras = tuple(described.get(layout.EXTRAS_KEY, "").split())
    return TickLayout(len(described["arm_lengths"].split()), described["has_cart"] == "1", parts, extras)


@dataclass(frozen=True, eq=False)
class Extras(Brief):
    """Parameters estimated in addition to the state.

    Attributes:
        names: E names.
        time: (M,) s.
        values: (M, E); zeros in rad, disturbances in rad/s², the drive's error in m/s², all others shares.
        sigmas: (M, E) standard deviations of `values`.
    """

    names: tuple[str, ...]
    time: Array
    values: Array
    sigmas: Array


@dataclass(frozen=True)
class RunLog(Shown):
    """A log in memory. Arrays are read-only.

    Attributes:
        path: file that was read.
        time: (N,) in s.
        measured: (N, n+1) positions from the sensors, in the order of `joint_names`, in rad and m.
        rates: (N, n+1) rates from the sensors, rad/s and m/s, or None.
        states: (N, 2n+2) in state order, rad, rad/s, m, m/s (2n entries without a cart), for each of "estimate",
            "reference" and "truth" that the log has.
        controls: (N,) for each name of `control_fields`. Empty if no controller ran.
        extras: parameters estimated in addition to the state, at 50 Hz, or None.
        events: in the order of logging.
        metadata: the caller's text from the start and the end, and `program`, which wrote the log.
        attachments: content by name.
        joint_names: `arm_1 …`, then `cart` if present.
        arm_lengths: (n,) in m.
        has_cart: True if the pivot is on a cart.
        rate_hz: rate of the loop in Hz.
        limits: the cart's greatest distance from the centre in m, velocity in m/s, acceleration in m/s², or None.
        recovered: losses that `dpcontrol recover` reported, a sentence. None without losses.
        rewritten: True if another program has rewritten it, so that integrity cannot be checked.
        end_s: time of the run's last tick by its result record, s, or None.
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
    extras: Extras | None = None
    rewritten: bool = False
    end_s: float | None = None

    def __repr__(self) -> str:
        return f"<log {self.path}: {len(self.time):,} rows at {self.rate_hz:g} Hz>"

    def document(self) -> dict[str, Any]:
        """Return what the log holds, without its rows."""
        return {
            "log": self.path, "rows": len(self.time), "duration": float(np.ptp(self.time)) if len(self.time) else 0.0,
            "parts": sorted(self.parts), "events": len(self.events), "attachments": sorted(self.attachments),
            "metadata": self.metadata,
        }  # fmt: skip

    @property
    def segments(self) -> tuple[tuple[int, int], ...]:
        """First and end rows of a recording's segments.

        There are none for a run, or if they do not fit the rows.
        """
        return segments_in(self.metadata.get("segments", ""), len(self.time))

    @property
    def parts(self) -> frozenset[str]:
        """Members of "rates", "estimate", "reference", "truth", "control" in the log.

        Every log has `measured`.
        """
        found = {*self.states} | ({"control"} if self.controls else set())
        return frozenset(found | ({"rates"} if self.rates is not None else set()))

    @property
    def truth(self) -> Array | None:
        """States of the plant, or None if they are unknown."""
        return self.states.get("truth")

    @property
    def estimate(self) -> Array:
        """States of the estimator.

        Raises:
            InputError: the log has none.
        """
        return self._state("estimate")

    @property
    def reference(self) -> Array:
        """States of the reference.

        Raises:
            InputError: the log has none.
        """
        return self._state("reference")

    @property
    def control(self) -> dict[str, Array]:
        """Fields of the control message, by name.

        Raises:
            InputError: no controller ran.
        """
        if not self.controls:
            raise self._lacks(layout.CONTROL)
        return self.controls

    def _state(self, part: str) -> Array:
        if part not in self.states:
            raise self._lacks(layout.STATE_TOPICS[part])
        return self.states[part]

    def _lacks(self, topic: str) -> InputError:
        return InputError(
            f"{self.path} has no {topic}: it is a recording, not a run, or another program has left the topic out; "
            f"{_AS_WRITTEN}"
        )

    def frame(self) -> "DataFrame":
        """Return a pandas table with one row per tick.

        Its index is `time` in s.

        Columns, if the log has them: `measured.arm_1` …, `rates.arm_1` …, `estimate.angle_1`, `estimate.rate_1`,
        `estimate.cart_position`, `estimate.cart_velocity`, the same for `reference` and `truth`, `control.command` ….
        `extra.zero_1` and `sigma.zero_1` … hold the last logged values. `segment` numbers the segments of a recording.

        Raises:
            PartMissing: pandas is not installed.
        """
        data_frame, index = pandas_classes()
        columns: dict[str, Any] = {f"measured.{name}": self.measured[:, i] for i, name in enumerate(self.joint_names)}
        if self.rates is not None:
            columns |= {f"rates.{name}": self.rates[:, i] for i, name in enumerate(self.joint_names)}
        names = layout.state_names(len(self.arm_lengths), has_cart=self.has_cart)
        for part, values in self.states.items():
            columns |= {f"{part}.{name}": values[:, i] for i, name in enumerate(names)}
        columns |= {f"control.{name}": values for name, values in self.controls.items()}
        if self.extras is not None:
            last = np.searchsorted(self.extras.time, self.time, side="right") - 1
            for of, values in (("extra", self.extras.values), ("sigma", self.extras.sigmas)):
                held = np.where((last >= 0)[:, None], values[last], np.nan)
                columns |= {f"{of}.{name}": held[:, i] for i, name in enumerate(self.extras.names)}
        if self.segments:
            columns["segment"] = segment_numbers(self.segments, len(self.time))
        return data_frame(columns, index=index(self.time, name="time"))


def segments_in(text: str, rows: int) -> tuple[tuple[int, int], ...]:
    """Return first and end row of each segment, from a recording's metadata.

    There are none if they do not fit the rows.

    Args:
        text: pairs as `write_recording` writes them, "0:300 300:600".
        rows: number of samples.
    """
    try:
        numbers = [int(number) for number in text.replace(":", " ").split()]
    except ValueError:
        return ()
    segments = tuple(zip(numbers[::2], numbers[1::2], strict=False))
    return segments if all(0 <= first < end <= rows for first, end in segments) else ()


def segment_numbers(segments: Sequence[tuple[int, int]], rows: int) -> NDArray[np.intp]:
    """Return the number of each row's segment (K,), from 0.

    Args:
        segments: first and end row of each segment, in order.
        rows: number of rows K.
    """
    return np.searchsorted([first for first, _ in segments], np.arange(rows), side="right") - 1


def read_log(path: Path | str) -> RunLog:
    """Return the run in a log.

    A log that another program has rewritten is read by its topics.

    Args:
        path: the log.

    Raises:
        InputError: the file is missing, empty, cut off, damaged, not an MCAP file or not a log of a run.
    """
    return _read(Path(path), _decode, _decode_rewritten)


def _read(path: Path, native: Callable[[VerifiedFile], _T], rewritten: Callable[[VerifiedFile, Rewritten], _T]) -> _T:
    """Read a log by the function for native or for rewritten ones."""
    file = open_mcap(path)
    with file.decoding():
        return native(file) if file.is_native else rewritten(file, _rewritten(file))


def _rewritten(file: VerifiedFile) -> Rewritten:
    """Return a log that another program has rewritten, with a warning.

    Raises:
        InputError: the file holds no run, or several.
    """
    try:
        topics = by_topic(file.messages(), file.channels, file.schemas)
        described = file.values(layout.LAYOUT_RECORD)
        found = found_in(topics, described)
        if found is None:
            raise ValueError(f"it lacks {layout.MEASURED} as {layout.JOINT_STATE[0]} in cdr")
        whole = described_layout(file.path, described) if described else found.tick
    except MALFORMED as error:
        raise InputError(
            f"{file.path}{file.writer} is not a log of `dpcontrol run`: {error}; {_AS_WRITTEN}, or make a recording of "
            "it with `dpcontrol import`"
        ) from error
    if name := mixed(topics):
        raise InputError(f"{file.path}: {name} has different messages at one time, as of two runs; give one run's log")
    left_out = ", ".join(topic for topic in whole.schemas if topic not in found.tick.schemas.keys() & topics.keys())
    remark(
        f"{file.path} was rewritten by {file.library or 'another program'} and is read by its topics; its integrity "
        f"cannot be checked{f', and it lacks {left_out}' if left_out else ''}"
    )
    return found


_INCIDENTAL = ("version", "commit", "plan", "plant_parameters", "drawn")
"""Keys of a run's record that do not determine the run."""


def check_replaced(
    path: Path | str, metadata: Mapping[str, str], *, recovers: Path | None = None, force: bool = False
) -> None:
    """Reject an existing file that the same command would not make.

    The record of the run identifies the command. A log from a rig is always rejected, because it cannot be repeated.

    Args:
        path: of the new log.
        metadata: its record: settings, seed, hashes.
        recovers: source of the recovery, if any.
        force: replace any file.

    Raises:
        InputError: another log or file exists.
    """
    path = Path(path)
    if force or not path.is_file():
        return
    try:
        file = open_verified(path)
    except InputError as error:
        raise in_the_way(path, "is not a complete log") from error
    there = file.values(layout.RUN_RECORD)
    if "rig" in file.values(layout.RESULT_RECORD) or "rig" in there:
        raise in_the_way(path, "is a log from a rig")
    if file.values(layout.RECOVERY_RECORD).get("source") != (recovers and recovers.name):
        raise in_the_way(path, "holds another log")
    if differing := _differing(metadata, there):
        raise in_the_way(path, f"holds another log (not the same: {differing})")


def _differing(metadata: Mapping[str, str], there: Mapping[str, str], *, also: tuple[str, ...] = ()) -> str:
    """Return the keys whose values differ between two records.

    Incidental keys and those in `also` are not compared.
    """
    names = [k for k in {**metadata, **there} if k not in (*_INCIDENTAL, *also)]
    return ", ".join(name for name in names if metadata.get(name) != there.get(name))


def check_same_run(path: Path, metadata: Mapping[str, str], *, also: tuple[str, ...] = ()) -> None:
    """Reject the log of a run that a different command made.

    Args:
        path: the existing log.
        metadata: metadata of the run.
        also: keys that are not compared either.

    Raises:
        InputError: the log is not readable, or entries differ.
    """
    if differing := _differing(metadata, open_verified(path).values(layout.RUN_RECORD), also=also):
        raise InputError(
            f"{path} is of another run (not the same: {differing}); go on with the command and the options that made it"
        )


def _decode(file: VerifiedFile) -> RunLog:
    tick = file.tick
    events: list[Event] = []
    extras: list[Array] = []
    rows: dict[str, list[Array]] = {name: [] for name in ("time", "measured", *tick.parts)}
    for batch in file.batches():
        for name, values in batch.rows(tick).items():
            rows[name].append(values)
        if tick.extras:
            extras.append(batch.extras(tick))
        events += [_event(batch.data, offset) for offset in batch.others.get(tick.channels[layout.EVENTS], ())]
    if not sum(map(len, rows["time"])):
        raise InputError(f"{file.path} holds no ticks: the run ended before its first; {_AGAIN}")
    # Each part is removed from the mapping as it is joined, so that a long log is held only once.
    whole = {name: _frozen(np.concatenate(rows.pop(name))) for name in list(rows)}
    described = file.metadata[layout.LAYOUT_RECORD]
    return _run_log(file, tick, described, rows=whole, events=events, extras=_extras(tick.extras, extras))


def _decode_rewritten(file: VerifiedFile, found: Rewritten) -> RunLog:
    events = [logged_event(time / 1e9, body) for time, body in found.events]
    extras = _extras(found.tick.extras, found.extras)
    whole = {name: _frozen(values) for name, values in found.rows.items()}
    log = _run_log(file, found.tick, found.described, rows=whole, events=events, extras=extras)
    return replace(log, rewritten=True)


def _extras(names: tuple[str, ...], rows: list[Array]) -> Extras | None:
    """Return the extras in rows (time, standard deviations, values).

    The result is None if there are no rows.
    """
    if not sum(map(len, rows)):
        return None
    whole = _frozen(np.concatenate(rows))
    return Extras(names, whole[:, 0], whole[:, 1 + len(names) :], whole[:, 1 : 1 + len(names)])


def _event(data: bytes, offset: int) -> Event:
    head = np.frombuffer(data, layout.RECORD_HEADER, count=1, offset=offset)[0]
    end = offset + layout.LENGTH_FROM + int(head["length"])
    return logged_event(int(head["log_time"]) / 1e9, data[offset + layout.RECORD_HEADER.itemsize : end])


_LATEST = float(np.iinfo(np.int64).max) / 1e9
"""s: viewers and arrays of times hold signed nanoseconds."""


def _run_log(
    file: VerifiedFile,
    tick: TickLayout,
    described: Mapping[str, str],
    *,
    rows: dict[str, Array],
    events: list[Event],
    extras: Extras | None,
) -> RunLog:
    limits = tuple(float(text) for text in described["limits"].split())
    columns = _frozen(np.ascontiguousarray(rows.pop("control").T)) if "control" in rows else ()
    metadata = {**file.values(layout.RESULT_RECORD), **file.values(layout.RUN_RECORD)}
    ticks, rate = metadata.pop(layout.TICKS, None), file.values(layout.LAYOUT_RECORD).get("rate_hz")
    lengths = tuple(float(text) for text in described["arm_lengths"].split())
    if not all(0 < length < np.inf for length in lengths) or any(event.time >= _LATEST for event in events):
        raise ValueError(f"arms are {described['arm_lengths']} m long, or an event is later than {_LATEST:.3g} s")
    return RunLog(
        path=file.path,
        time=rows["time"],
        measured=rows["measured"],
        rates=rows.get("rates"),
        states={part: rows[part] for part in layout.STATE_TOPICS if part in rows},
        controls=dict(zip(tick.fields, columns, strict=False)),
        events=tuple(events),
        metadata={**metadata, "program": described["program"]},
        attachments=file.attachments,
        joint_names=tick.names,
        arm_lengths=lengths,
        has_cart=tick.has_cart,
        rate_hz=float(described["rate_hz"]),
        limits=(limits[0], limits[1], limits[2]) if limits else None,
        recovered=file.values(layout.RECOVERY_RECORD).get(layout.LOST) or None,
        extras=extras,
        end_s=(int(ticks) - 1) / float(rate) if ticks and rate else None,
    )


def _frozen(array: NDArray[np.float64]) -> NDArray[np.float64]:
    array.flags.writeable = False
    return array


@dataclass(frozen=True)
class TopicSummary:
    """Messages of one topic.

    Attributes:
        topic: name.
        type: schema.
        units: of the numbers.
        count: of messages.
        first_s: first time, s.
        last_s: last time, s.
        rate_hz: mean rate, Hz, or None.
    """

    topic: str
    type: str
    units: str
    count: int
    first_s: float | None
    last_s: float | None
    rate_hz: float | None


@dataclass(frozen=True)
class LogSummary(Documented):
    """Contents of a complete log: topics, attachments and metadata.

    Attributes:
        log: path of the log.
        size: bytes.
        format: version of the layout.
        program: program that wrote the log.
        duration: from first to last message, s.
        rate_hz: rate of the loop, Hz.
        joints: names of the joints.
        parts: members of `layout.PARTS` in the log.
        topics: summary of each topic.
        attachments: size by name, bytes.
        metadata: text passed by the caller.
        recovered: losses that `dpcontrol recover` reported, or None.
        partials: files beside it that other runs of this log have left or are writing.
        rewritten: True if another program has rewritten it, so that integrity cannot be checked.
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
    rewritten: bool = False


def summarise(path: Path | str) -> LogSummary:
    """Return a summary of a log after checking its checksums.

    Args:
        path: the log.

    Raises:
        InputError: the file is missing, cut off, damaged or not a log of this program.
    """
    return _read(Path(path), _summary_of_native, _summary_of_rewritten)


def _summary_of_native(file: VerifiedFile) -> LogSummary:
    batches = [batch.times(file.tick) for batch in file.batches()]
    times = {topic: np.concatenate([batch[topic] for batch in batches]) for topic in file.tick.schemas}
    topics = [_topic(topic, kind, times[topic]) for topic, (kind, _) in file.tick.schemas.items()]
    return _summary(file, file.tick, file.metadata[layout.LAYOUT_RECORD], topics)


def _summary_of_rewritten(file: VerifiedFile, found: Rewritten) -> LogSummary:
    # Without metadata the layout lacks topics whose names of fields were there.
    kinds = {topic: kind for topic, (kind, _) in found.tick.schemas.items()}
    kinds |= {name: topic.schema for name, topic in found.topics.items()}
    times = {name: np.array(topic.times) for name, topic in found.topics.items()}
    topics = [_topic(name, kind, times.get(name, np.empty(0))) for name, kind in kinds.items()]
    return replace(_summary(file, found.tick, found.described, topics), rewritten=True)


def _summary(
    file: VerifiedFile, tick: TickLayout, described: Mapping[str, str], topics: Sequence[TopicSummary]
) -> LogSummary:
    begin = min((topic.first_s for topic in topics if topic.first_s is not None), default=0.0)
    return LogSummary(
        log=str(file.path),
        size=file.path.stat().st_size,
        format=described["format"],
        program=described["program"],
        duration=max((topic.last_s for topic in topics if topic.last_s is not None), default=0.0) - begin,
        rate_hz=float(described["rate_hz"]),
        joints=tick.names,
        parts=tuple(part for part in layout.PARTS if part in tick.parts),
        topics=tuple(topics),
        attachments={name: len(data) for name, data in file.attachments.items()},
        metadata={**file.values(layout.RESULT_RECORD), **file.values(layout.RUN_RECORD)},
        recovered=file.values(layout.RECOVERY_RECORD).get(layout.LOST) or None,
        partials=tuple(str(other) for other in partials_of(file.path)),
    )


def _topic(topic: str, kind: str, times: NDArray) -> TopicSummary:
    units = layout.UNITS.get(topic, "")
    if not len(times):
        return TopicSummary(topic, kind, units, 0, None, None, None)
    first, last = int(times.min()), int(times.max())
    rate = (len(times) - 1) * 1e9 / (last - first) if last > first else None
    return TopicSummary(topic, kind, units, len(times), first / 1e9, last / 1e9, rate)


@dataclass(frozen=True)
class Comparison:
    """Comparison of two logs: equal messages and first difference.

    The difference is a sentence, or None.
    """

    messages: int
    difference: str | None


def compare_messages(one: Path | str, other: Path | str) -> Comparison:
    """Compare two logs topic by topic.

    Times and every byte of each message count; metadata may differ. If `one` was recovered or another program has
    rewritten one of them, the messages that `one` lacks are skipped.

    Args:
        one: a log.
        other: another log.

    Raises:
        InputError: a log is missing, damaged or not of this program.
    """
    sides = [open_verified(Path(path)) for path in (one, other)]
    if sides[0].tick != sides[1].tick:
        return Comparison(0, f"{one} and {other} do not have the same topics")
    whole = all(side.is_native and not side.values(layout.RECOVERY_RECORD).get(layout.LOST) for side in sides)
    logs = []
    for side in sides:
        with side.decoding():
            topics = by_topic(side.messages(), side.channels, side.schemas)
        logs.append({name: set(zip(topic.times, topic.bodies, strict=True)) for name, topic in topics.items()})
    same = 0
    for name in sides[0].tick.schemas:
        messages, others = (topics.get(name, set()) for topics in logs)
        same += len(messages & others)
        if differing := messages ^ others if whole else messages - others:
            return Comparison(same, f"the message of {name} at {min(differing)[0] / 1e9:.3f} s differs")
    return Comparison(same, None)
