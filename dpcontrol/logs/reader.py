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
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import numpy as np
import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, Metadata, Schema
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError, remark
from dpcontrol.foundation.files import checked_size, checked_source, in_the_way
from dpcontrol.foundation.shown import Brief, Shown, pandas_classes
from dpcontrol.logs import layout
from dpcontrol.logs.container import CHUNK_HEAD, MAGIC, ZSTD, partials_of, unsealed
from dpcontrol.logs.layout import Event, TickLayout, logged_event
from dpcontrol.logs.rewritten import Rewritten, by_topic, found_in, mixed

if TYPE_CHECKING:
    from pandas import DataFrame


_T = TypeVar("_T")
_RECORD = struct.Struct("<BQH")
"""Head of a record: opcode, length and, for a message, its channel."""
_BATCH_BYTES = 4_000_000
LARGEST_CHUNK, LARGEST_LOG = 1 << 28, 1 << 33
"""Greatest unpacked size of a chunk and of a log, bytes: five hours at 1 kHz."""
_LONGEST_HEADER = 10_000
_OWN = "dpcontrol "
"""Beginning of the library's name in the header of this program's files."""
_AGAIN = "make it again with `dpcontrol run`"
_AS_WRITTEN = "give the log as `dpcontrol run` wrote it"
MALFORMED = (
    McapError,
    CRCValidationError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    RuntimeError,
    OverflowError,
    MemoryError,
    LookupError,
)
"""Exceptions raised when a malformed record is parsed (lz4 raises RuntimeError)."""


class OtherChannels(InputError):
    """Channels of the layout are missing or have other numbers."""


@dataclass
class VerifiedFile:
    """The records of an MCAP file whose checksums agree.

    Attributes:
        path: file that was read.
        has_checksum: True if the data section has a checksum.
        library: the program that wrote it.
        metadata: text by key, by record name.
        attachments: content by name.
        schemas: by number; those within chunks are added while `batches` runs.
        channels: by number, like `schemas`.
        chunks: the chunks' records, still packed.
        loose: messages outside of chunks.
    """

    path: Path
    has_checksum: bool
    library: str = ""
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
            damaged(self.path, f"its messages do not decode: {error}", cause=error)

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
        described = self.metadata.get(layout.LAYOUT_RECORD)
        if described is None:
            raise InputError(
                f"{self.path}{self.writer} is not a log of `dpcontrol run`: it lacks the metadata record "
                f"{layout.LAYOUT_RECORD}, as after cutting a log in time; {_AS_WRITTEN}, or make a recording of it "
                "with `dpcontrol import`"
            )
        if unsealed(layout.LAYOUT_RECORD, described) is None and described.get("format") == layout.FORMAT:
            raise ValueError(f"the checksum of {layout.LAYOUT_RECORD} differs")
        return described_layout(self.path, described)

    def messages(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield channel, time in ns and body of every message.

        Schemas and channels are stored as they are found.

        Raises:
            Exception: one of `MALFORMED`.
        """
        decompressor = zstandard.ZstdDecompressor()
        for chunk in self.chunks:
            batch = Batch(data := unpacked(chunk, decompressor))
            self._declare(batch)
            places = sorted(place for offsets in batch.others.values() for place in offsets)
            for place in places:
                size = int.from_bytes(data[place + 1 : place + layout.LENGTH_FROM], "little")
                start = place + layout.LENGTH_FROM
                yield _message(data[start : start + size])
        for body in self.loose:
            yield _message(bytes(body))

    def batches(self) -> "Iterator[Batch]":
        """Yield the messages in order, several chunks at a time.

        Raises:
            InputError: a chunk does not unpack, or the channels differ from the layout.
            ValueError: the records of a chunk are not contiguous.
        """
        decompressor = zstandard.ZstdDecompressor()
        pending, size = [], 0
        if not self.chunks and not self.is_native:
            self._check_channels()
        for k, chunk in enumerate(self.chunks, start=1):
            try:
                pending.append(unpacked(chunk, decompressor))
            except MALFORMED as error:
                damaged(self.path, f"a chunk does not unpack: {error}", cause=error)
            size += len(pending[-1])
            if size >= _BATCH_BYTES or k == len(self.chunks):
                batch = self._batch(b"".join(pending))
                self._check_channels()
                yield batch
                pending, size = [], 0

    def _batch(self, data: bytes) -> "Batch":
        try:
            batch = Batch(data, self.tick)
        except ValueError:
            # Ticks that differ from the layout mislead the walk; the channels may show the reason.
            self._declare(Batch(data))
            self._check_channels()
            raise
        self._declare(batch)
        return batch

    def _declare(self, batch: "Batch") -> None:
        for opcode, start, end in batch.declared:
            self.note(opcode, batch.data[start:end])

    def _check_channels(self) -> None:
        check_channels(self.path, self.tick, schemas=self.schemas, channels=self.channels, writer=self.writer)

    @property
    def is_native(self) -> bool:
        """True if the header names this program as the writer."""
        return self.library.startswith(_OWN)

    @property
    def writer(self) -> str:
        return f" (written by {self.library})" if self.library else ""


_MESSAGE = struct.Struct("<HIQQ")
"""Head of a message's body: channel, sequence, log time and publish time; the data follow."""


def _message(body: bytes) -> tuple[int, int, bytes]:
    channel, _, time, _ = _MESSAGE.unpack_from(body)
    return channel, time, body[_MESSAGE.size :]


def _other_messages(channel: Channel, schemas: Mapping[int, Schema], name: str, definition: bytes) -> str:
    """Describe the messages in a channel that are unexpected.

    Expected are messages `name` in CDR. The result is "" if all are expected.
    """
    schema = schemas.get(channel.schema_id)
    encoding = channel.message_encoding or "no encoding"
    if schema is None or schema.name != name or encoding != "cdr":
        return f"{schema.name if schema else 'messages without a schema'} in {encoding}"
    return "" if schema.data == definition else "messages of that name with other fields"


def check_channels(
    path: Path, tick: TickLayout, *, schemas: Mapping[int, Schema], channels: Mapping[int, Channel], writer: str = ""
) -> None:
    """Reject a log whose channels differ from its layout.

    Rewriting by another program can cause this.

    Args:
        path: path of the log, for messages.
        tick: layout of the ticks.
        schemas: schemas of the log, by number.
        channels: channels of the log, by number.
        writer: phrase on the writing program, for messages.

    Raises:
        InputError: a topic is missing, holds other messages or has another number.
    """
    by_topic = {channel.topic: channel for channel in channels.values()}
    if missing := [topic for topic in tick.schemas if topic not in by_topic]:
        raise OtherChannels(
            f"{path}{writer} lacks {', '.join(missing)}, listed in its description: another program has removed "
            f"topics; {_AS_WRITTEN}"
        )
    for topic, (name, definition) in tick.schemas.items():
        if found := _other_messages(by_topic[topic], schemas, name, definition):
            raise InputError(f"{path}{writer}: topic {topic} holds {found}, not {name} in cdr; {_AS_WRITTEN}")
    for topic, due in tick.channels.items():
        if by_topic[topic].id != due:
            raise OtherChannels(
                f"{path}{writer}: another program has renumbered the channels ({topic} is channel "
                f"{by_topic[topic].id} instead of {due}); {_AS_WRITTEN}"
            )


def unpacked(chunk: memoryview, decompressor: zstandard.ZstdDecompressor) -> bytes:
    """Return the records in a chunk after checking its checksum.

    One decompressor serves any number of chunks.

    Args:
        chunk: body of the chunk's record.
        decompressor: decompressor of zstd.

    Raises:
        Exception: one of `MALFORMED`: the chunk does not unpack, or its checksum differs.
    """
    _, _, size, checksum, kind, packed = CHUNK_HEAD.unpack_from(chunk)
    checked_size(size, most=LARGEST_CHUNK)
    if kind == ZSTD:
        content = decompressor.decompress(chunk[CHUNK_HEAD.size :], max_output_size=size)
    else:
        other = Chunk.read(ReadDataStream(BytesIO(chunk)))
        if other.compression != "lz4":
            stream, length = get_chunk_data_stream(other, validate_crc=True)
            return stream.read(length)
        # The lz4 package would unpack everything, regardless of the declared size.
        content = LZ4FrameDecompressor().decompress(other.data, max_length=size + 1)
        packed = len(chunk) - CHUNK_HEAD.size
    # Other programs may omit the checksum, which is then zero.
    other = checksum and zlib.crc32(content) != checksum
    if len(content) != size or packed != len(chunk) - CHUNK_HEAD.size or other:
        raise ValueError("its checksum or its size differs")
    return content


def damaged(path: Path, reason: str, *, cause: BaseException | None = None) -> NoReturn:
    """Raise the InputError for a file whose bytes have changed.

    Args:
        path: path of the file.
        reason: what has changed.
        cause: exception that led to this error, None for none.
    """
    raise InputError(f"{path} is damaged ({reason}); {_remedy(path)}") from cause


_PARSED: dict[int, type[Header | Metadata | Attachment | Schema | Channel]] = {
    Opcode.HEADER: Header, Opcode.METADATA: Metadata, Opcode.ATTACHMENT: Attachment, Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
}  # fmt: skip


def parsed(opcode: int, body: memoryview | bytes) -> Header | Metadata | Attachment | Schema | Channel | None:
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
        InputError: the file is missing, unreadable or empty.
    """
    try:
        data = checked_source(path).read_bytes()
    except FileNotFoundError as error:
        left = partials_of(path)
        remedy = f"a run left {left[-1]}: {_recover(left[-1])}" if left else f"check the name or {_AGAIN}"
        raise InputError(f"there is no log {path}; {remedy}") from error
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}; give the path of a .mcap file") from error
    if not data:
        raise InputError(f"{path} is empty; {_AGAIN}")
    return data


def _walk(path: Path, data: bytes) -> list[tuple[int, int, int]]:
    """Return opcode, start and end of each record.

    Start and end are those of its body. The footer is the last.
    """
    found: list[tuple[int, int, int]] = []
    place, closed = len(MAGIC), False
    while place + layout.LENGTH_FROM <= len(data) and not closed:
        opcode, length = data[place], int.from_bytes(data[place + 1 : place + layout.LENGTH_FROM], "little")
        end = place + layout.LENGTH_FROM + length
        if end > len(data) or opcode == 0:
            break
        found.append((opcode, place + layout.LENGTH_FROM, end))
        place, closed = end, opcode == Opcode.FOOTER
    if closed and data[place:] == MAGIC and any(opcode == Opcode.DATA_END for opcode, _, _ in found):
        return found
    if closed and data[place:].startswith(MAGIC):
        extra = len(data) - place - len(MAGIC)
        what = "byte that does" if extra == 1 else "bytes that do"
        raise InputError(f"{path} is followed by {extra} {what} not belong to it; {_remedy(path)}")
    if data.endswith(MAGIC) and len(data) > len(MAGIC):
        damaged(path, f"its records are not contiguous at byte {place}")
    ends = [
        struct.unpack_from("<Q", data, start + 8)[0]
        for opcode, start, end in found
        if opcode == Opcode.CHUNK and end - start >= 16
    ]
    moment = f"at {max(ends) / 1e9:.3f} s" if ends else "before its first tick"
    raise InputError(f"{path} is cut off {moment}: the run was interrupted or the copy is incomplete; {_remedy(path)}")


def _recover(path: Path) -> str:
    return f"`dpcontrol recover {path}` rebuilds a log from the rest"


def _remedy(path: Path) -> str:
    writer = other_writer(path)
    again = f"write it again with the program that wrote it ({writer})" if writer else _recover(path)
    return f"copy it again from its source, or {again}"


def other_writer(path: Path) -> str:
    """Return the program that wrote a file.

    The result is "" for this program, or if the header is not readable.

    Args:
        path: any file.
    """
    with suppress(OSError, *MALFORMED), path.open("rb") as stream:
        opcode, length = struct.unpack("<BQ", stream.read(len(MAGIC) + layout.LENGTH_FROM)[len(MAGIC) :])
        header = parsed(opcode, stream.read(min(length, _LONGEST_HEADER)))
        if isinstance(header, Header) and not header.library.startswith(_OWN):
            return header.library or "another program"
    return ""


def _check(path: Path, data: bytes, records: list[tuple[int, int, int]]) -> bool:
    """Compare both checksums; return True if the data section has one."""
    start, end = next((start, end) for opcode, start, end in records if opcode == Opcode.DATA_END)
    footer_start, footer_end = records[-1][1:]
    if end - start < 4 or footer_end - footer_start < 20:
        damaged(path, "its closing records are too short")
    (stored,) = struct.unpack_from("<I", data, start)
    computed = zlib.crc32(memoryview(data)[: start - layout.LENGTH_FROM])
    if stored and stored != computed:
        damaged(path, f"the checksum of its data is {computed:#010x} instead of {stored:#010x}")
    summary, _, summary_crc = struct.unpack_from("<QQI", data, footer_start)
    computed = zlib.crc32(memoryview(data)[summary or footer_start - layout.LENGTH_FROM : footer_start + 16])
    if summary_crc and summary_crc != computed:
        damaged(path, f"the checksum of its summary is {computed:#010x} instead of {summary_crc:#010x}")
    return bool(stored)


def open_verified(path: Path) -> VerifiedFile:
    """Read a log, compare its checksums and find its tick layout.

    Args:
        path: the log.

    Raises:
        InputError: the file is missing, empty, no MCAP file, cut off, damaged or not a log of this program.
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
        InputError: the file is missing, empty, no MCAP file, cut off or damaged.
    """
    data = recorded_bytes(path)
    if not (data.startswith(MAGIC) or MAGIC.startswith(data)):
        raise InputError(
            f"{path} is not a log because it is not an MCAP file (it begins with {data[:8]!r}); import a recording "
            "with `dpcontrol import` first, or give a log of `dpcontrol run`"
        )
    records = _walk(path, data)
    view = memoryview(data)
    file = VerifiedFile(path, _check(path, data, records))
    try:
        for opcode, start, end in records:
            if opcode == Opcode.DATA_END:
                break
            if opcode != Opcode.MESSAGE_INDEX:
                file.note(opcode, view[start:end])
        checked_size(sum(CHUNK_HEAD.unpack_from(chunk)[2] for chunk in file.chunks), most=LARGEST_LOG)
    except MALFORMED as error:
        damaged(path, f"a record is not readable: {error}", cause=error)
    return file


class Batch:
    """Records of several chunks.

    Attributes:
        ticks: offsets (K,) of whole ticks.
        others: offsets of all other messages by channel.
        declared: opcode, start and end of the body of each schema and channel.

    Args:
        data: the records.
        tick: the ticks' layout; without one no message counts as part of a tick.

    Raises:
        ValueError: the records are not contiguous.
    """

    def __init__(self, data: bytes, tick: TickLayout | None = None) -> None:
        self.data = data
        self.ticks: list[int] = []
        self.others: dict[int, list[int]] = {}
        self.declared: list[tuple[int, int, int]] = []
        template = tick.block_template if tick else b""
        beginning, size = template[: _RECORD.size], len(template)
        place, whole, unpack = 0, len(data), _RECORD.unpack_from
        while place < whole:
            if template and data.startswith(beginning, place):
                self.ticks.append(place)
                place += size
                continue
            opcode, length, channel = unpack(data, place)
            end = place + layout.LENGTH_FROM + length
            if opcode == layout.MESSAGE_OPCODE:
                self.others.setdefault(channel, []).append(place)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.declared.append((opcode, place + layout.LENGTH_FROM, end))
            place = end
        if place != whole:
            raise ValueError("a record runs over the end of its chunk")

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
            due = {"opcode": layout.MESSAGE_OPCODE, "length": length, "channel": tick.channels[topic]}
            if any((ticks[topic][name] != value).any() for name, value in due.items()):
                raise ValueError(f"a tick lacks its message of {topic}")
            if (ticks[topic]["log_time"] != times).any():
                raise ValueError(f"the messages of {topic} do not pair with those of {layout.MEASURED}")
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
            f"{path} has layout {described.get('format')!r}, and this version of dpcontrol reads layout "
            f"{layout.FORMAT!r}; read it with the version that wrote it, or run the itinerary again"
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
        if self.rewritten:
            why, remedy = "or another program has left the topic out", _AS_WRITTEN
        else:
            why, remedy = "not a run", "give a log of `dpcontrol run`"
        return InputError(f"{self.path} has no {topic}: it is a recording, {why}; {remedy}")

    def frame(self) -> "DataFrame":
        """Return a pandas table with one row per tick.

        Its index is `time` in s.

        Columns, if the log has them: `measured.arm_1` …, `rates.arm_1` …, `estimate.angle_1`, `estimate.rate_1`,
        `estimate.cart_position`, `estimate.cart_velocity`, the same for `reference` and `truth`, `control.command` ….
        `extra.zero_1` and `sigma.zero_1` … hold the last logged values. `segment` numbers the segments of a recording.

        Raises:
            InputError: pandas is not installed.
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
    found = None if file.is_native else _rewritten(file)
    try:
        if found is None:
            with file.decoding():
                return native(file)
    except InputError as error:
        found = _rewritten(file, error) if file.is_native or isinstance(error, OtherChannels) else None
        if found is None:
            raise
    return rewritten(file, found)


def _rewritten(file: VerifiedFile, other: InputError | None = None) -> Rewritten | None:
    """Return a log that another program has rewritten, or None.

    A warning is issued for such a log. `other` is the error of reading it as a native log.
    """
    try:
        topics = by_topic(file.messages(), file.channels, file.schemas)
        described = file.values(layout.LAYOUT_RECORD)
        found = found_in(topics, described)
        whole = described_layout(file.path, described) if described else found and found.tick
    except MALFORMED as error:
        # Such a log is readable by its topics, so their messages are at fault.
        if isinstance(other, OtherChannels):
            raise InputError(f"{file.path}{file.writer}: {error}; {_AS_WRITTEN}") from error
        # The caller reports a more specific error.
        return None
    if found is not None and (name := mixed(topics)):
        raise InputError(f"{file.path}: {name} has different messages at one time, as of two runs; give one run's log")
    if found is not None and whole is not None:
        there = found.tick.schemas.keys() & found.topics.keys()
        left_out = ", ".join(topic for topic in whole.schemas if topic not in there)
        remark(
            f"{file.path} was rewritten by {file.library or 'another program'} and is read by its topics; its "
            f"integrity cannot be checked{f', and it lacks {left_out}' if left_out else ''}"
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
    if not file.has_checksum:
        raise InputError(f"{file.path} has no checksum of its data, so it cannot be verified; {_AGAIN}")
    if not sum(map(len, rows["time"])):
        raise InputError(f"{file.path} holds no ticks: the run ended before its first; {_AGAIN}")
    # Each part is removed from the mapping as it is joined, so that a long log is held only once.
    whole = {name: _frozen(np.concatenate(rows.pop(name))) for name in list(rows)}
    described = file.metadata[layout.LAYOUT_RECORD]
    return _run_log(file, tick, described, rows=whole, events=events, extras=_extras(tick.extras, extras))


def _decode_rewritten(file: VerifiedFile, found: Rewritten) -> RunLog:
    with file.decoding():
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
    if not all(0 < length < np.inf for length in lengths):
        damaged(file.path, f"its arms are {described['arm_lengths']} m long")
    for event in events:
        if event.time >= _LATEST:
            damaged(file.path, f"an event is at {event.time:.3g} s")
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
class LogSummary:
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
    return _read(
        Path(path),
        lambda file: _summary(file, file.tick, file.metadata[layout.LAYOUT_RECORD], _spans(file)),
        _summary_of_rewritten,
    )


def _summary_of_rewritten(file: VerifiedFile, found: Rewritten) -> LogSummary:
    spans = {name: (len(topic.times), min(topic.times), max(topic.times)) for name, topic in found.topics.items()}
    channels = found.tick.channels
    known = {channels[name]: span for name, span in spans.items() if name in channels}
    summary = _summary(file, found.tick, found.described, known)
    # Without metadata the layout lacks topics whose names of fields were there.
    others = [_topic(name, found.topics[name].schema, span) for name, span in spans.items() if name not in channels]
    return replace(summary, topics=(*summary.topics, *others), rewritten=True)


Spans = dict[int, tuple[int, int, int]]
"""By channel: number of messages, first and last time, ns."""


def _spans(file: VerifiedFile) -> Spans:
    tick, spans = file.tick, Spans()
    for batch in file.batches():
        ticks = gathered(batch.data, batch.ticks, layout.RECORD_HEADER)
        found = {tick.channels[topic]: ticks for topic in tick.messages}
        found |= {k: gathered(batch.data, places, layout.RECORD_HEADER) for k, places in batch.others.items()}
        for channel, heads in found.items():
            if len(heads):
                low, high = int(heads["log_time"].min()), int(heads["log_time"].max())
                count, first, last = spans.get(channel, (0, low, high))
                spans[channel] = (count + len(heads), min(first, low), max(last, high))
    return spans


def _summary(file: VerifiedFile, tick: TickLayout, described: Mapping[str, str], spans: Spans) -> LogSummary:
    ends = [(first, last) for _, first, last in spans.values()]
    return LogSummary(
        log=str(file.path),
        size=file.path.stat().st_size,
        format=described["format"],
        program=described["program"],
        duration=(max(last for _, last in ends) - min(first for first, _ in ends)) / 1e9 if ends else 0.0,
        rate_hz=float(described["rate_hz"]),
        joints=tick.names,
        parts=tuple(part for part in layout.PARTS if part in tick.parts),
        topics=tuple(_topic(topic, kind, spans.get(tick.channels[topic])) for topic, (kind, _) in tick.schemas.items()),
        attachments={name: len(data) for name, data in file.attachments.items()},
        metadata={**file.values(layout.RESULT_RECORD), **file.values(layout.RUN_RECORD)},
        recovered=file.values(layout.RECOVERY_RECORD).get(layout.LOST) or None,
        partials=tuple(str(other) for other in partials_of(file.path)),
    )


def _topic(topic: str, kind: str, span: tuple[int, int, int] | None) -> TopicSummary:
    if span is None:
        return TopicSummary(topic, kind, layout.UNITS[topic], 0, None, None, None)
    count, first, last = span
    rate = (count - 1) * 1e9 / (last - first) if last > first else None
    return TopicSummary(topic, kind, layout.UNITS.get(topic, ""), count, first / 1e9, last / 1e9, rate)


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
