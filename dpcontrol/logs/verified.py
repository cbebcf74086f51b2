"""Read an MCAP file's records, and trust none before the checksums agree.

Indexes and single chunks are not enough: an index can point elsewhere and two chunks can change places without any
checksum of their own failing. So the file is walked from front to back, and the checksum of the whole data section
and that of the summary are compared first.

A tick's messages stand one after the other and their lengths are known from the layout, so that one look per tick finds
them all and one copy takes the numbers of thousands of ticks out. Source: the MCAP format specification, version 0.
"""

import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import NoReturn

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, Metadata, Schema
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs.container import MAGIC, partials_of, unsealed
from dpcontrol.logs.layout import FORMAT, LAYOUT_RECORD, MEASURED, MESSAGE_OPCODE, PARTS, TickLayout, message_type

_HEAD = struct.Struct("<BQ")
_RECORD = struct.Struct("<BQH")
_BATCH_BYTES = 4_000_000
CHUNK_HEAD = struct.Struct("<QQQI8sQ")
"""Of a chunk: first and last time, size and checksum unpacked, compression, bytes packed."""
ZSTD = b"\x04\x00\x00\x00zstd"
LARGEST_CHUNK = 1 << 28
_AGAIN = "make it again with `dpcontrol run`"
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
"""What parsing a record that is not as specified may raise (lz4 raises RuntimeError)."""


@dataclass
class VerifiedFile:
    """The records of an MCAP file whose checksums agree.

    Attributes:
        has_checksum: whether the data section carried one.
        library: the program that wrote it.
        metadata: text by name, by the record's name.
        attachments: content by name.
        schemas, channels: by number; those found within chunks are added while `batches` runs.
        chunks: the chunks' records, still packed.
    """

    path: Path
    has_checksum: bool
    library: str = ""
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[memoryview] = field(default_factory=list)

    def note(self, opcode: int, body: memoryview | bytes) -> None:
        """Take up a record; those that nobody asks for are passed over."""
        if opcode == Opcode.HEADER:
            self.library = Header.read(stream_of(body)).library
        elif opcode == Opcode.METADATA:
            record = Metadata.read(stream_of(body))
            self.metadata[record.name] = record.metadata
        elif opcode == Opcode.ATTACHMENT:
            attachment = Attachment.read(stream_of(body))
            self.attachments[attachment.name] = attachment.data
        elif opcode == Opcode.CHUNK:
            self.chunks.append(memoryview(body))
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(stream_of(body))
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream_of(body))
            self.channels[channel.id] = channel

    @contextmanager
    def decoding(self) -> Iterator[None]:
        """Report what does not decode as damage of this file."""
        try:
            yield
        except MALFORMED as error:
            damaged(self.path, f"its messages do not decode: {error}", cause=error)

    def values(self, name: str) -> dict[str, str]:
        """Return what the metadata record of this name says, empty where it is missing or its checksum differs."""
        return unsealed(name, self.metadata.get(name, {})) or {}

    @cached_property
    def tick(self) -> TickLayout:
        """What a tick of the log holds, by its own description."""
        described = self.metadata.get(LAYOUT_RECORD)
        if described is None:
            writer = f" (written by {self.library})" if self.library else ""
            raise InputError(
                f"{self.path}{writer} is not a log of dpcontrol: it lacks the metadata record {LAYOUT_RECORD}; "
                "give a log of `dpcontrol run`"
            )
        if unsealed(LAYOUT_RECORD, described) is None and described.get("format") == FORMAT:
            raise ValueError(f"the checksum of {LAYOUT_RECORD} differs")
        return described_layout(self.path, described)

    def batches(self) -> "Iterator[Batch]":
        """Yield the messages in order, those of several chunks at a time.

        Raises:
            InputError: a chunk does not unpack, or the channels are not those of the layout; names what differs.
            ValueError: a chunk's records do not follow one another.
        """
        decompressor = zstandard.ZstdDecompressor()
        pending, size = [], 0
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
        ticks: list[int] = []
        others: dict[int, list[int]] = {}
        template = self.tick.block_template
        beginning, size = template[: _RECORD.size], len(template)
        place, end, unpack = 0, len(data), _RECORD.unpack_from
        while place < end:
            if data.startswith(beginning, place):
                ticks.append(place)
                place += size
                continue
            opcode, length, channel = unpack(data, place)
            if opcode == MESSAGE_OPCODE:
                others.setdefault(channel, []).append(place)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.note(opcode, data[place + 9 : place + 9 + length])
            place += 9 + length
        if place != end:
            raise ValueError("a record runs over the end of its chunk")
        return Batch(data, ticks, others)

    def _check_channels(self) -> None:
        by_topic = {channel.topic: channel for channel in self.channels.values()}
        for topic, (name, definition) in self.tick.schemas.items():
            channel = by_topic.get(topic)
            schema = self.schemas.get(channel.schema_id) if channel else None
            encoding = channel.message_encoding if channel else ""
            number = channel.id if channel else None
            if schema is None or schema.data != definition or encoding != "cdr" or number != self.tick.channels[topic]:
                found = f"channel {number}: {schema.name if schema else 'no schema'} in {encoding or 'no encoding'}"
                raise InputError(
                    f"{self.path}: topic {topic} is on {found}, not on channel {self.tick.channels[topic]}: {name} "
                    "in cdr as in a log of `dpcontrol run`; give the log as it was written"
                )


def unpacked(chunk: memoryview, decompressor: zstandard.ZstdDecompressor) -> bytes:
    """Return the records in a chunk, compared with its checksum; the decompressor serves any number of chunks.

    Raises:
        Exception: one of `MALFORMED`: it does not unpack, or not to what its checksum says.
    """
    _, _, size, checksum, kind, packed = CHUNK_HEAD.unpack_from(chunk)
    if kind != ZSTD or size > LARGEST_CHUNK:
        stream, length = get_chunk_data_stream(Chunk.read(stream_of(chunk)), validate_crc=True)
        return stream.read(length)
    content = decompressor.decompress(chunk[CHUNK_HEAD.size :], max_output_size=size)
    if len(content) != size or packed != len(chunk) - CHUNK_HEAD.size or zlib.crc32(content) != checksum:
        raise ValueError("its checksum or its size differs")
    return content


def damaged(path: Path, reason: str, *, cause: BaseException | None = None) -> NoReturn:
    """Raise the InputError for a file whose bytes are not those that were written."""
    raise InputError(f"{path} is damaged ({reason}); copy it again from its source, or {_recover(path)}") from cause


def stream_of(body: memoryview | bytes) -> ReadDataStream:
    """Return what the mcap package reads a record's body from."""
    return ReadDataStream(BytesIO(body))


def recorded_bytes(path: Path) -> bytes:
    """Return the bytes of a file, whatever they are.

    Raises:
        InputError: there is no such file, or it cannot be read or is empty.
    """
    try:
        data = path.read_bytes()
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
    """Return opcode, start and end of the body of each record up to the footer."""
    found: list[tuple[int, int, int]] = []
    place, size, unpack = len(MAGIC), len(data), _HEAD.unpack_from
    while place + 9 <= size:
        opcode, length = unpack(data, place)
        end = place + 9 + length
        if end > size or opcode == 0:
            break
        found.append((opcode, place + 9, end))
        place = end
        if opcode == Opcode.FOOTER:
            break
    closed = bool(found) and found[-1][0] == Opcode.FOOTER
    whole = closed and data[place:] == MAGIC
    if whole and any(opcode == Opcode.DATA_END for opcode, _, _ in found):
        return found
    if closed and data[place:].startswith(MAGIC):
        extra = len(data) - place - len(MAGIC)
        what = "byte that does" if extra == 1 else "bytes that do"
        raise InputError(f"{path} is followed by {extra} {what} not belong to it; {_recover(path)}")
    if data.endswith(MAGIC) and len(data) > len(MAGIC):
        damaged(path, f"its records do not follow one another at byte {place}")
    ends = [
        struct.unpack_from("<Q", data, start + 8)[0]
        for opcode, start, end in found
        if opcode == Opcode.CHUNK and end - start >= 16
    ]
    moment = f"at {max(ends) / 1e9:.3f} s" if ends else "before its first tick"
    raise InputError(f"{path} is cut off {moment}: the run was interrupted or the copy is incomplete; {_recover(path)}")


def _recover(path: Path) -> str:
    return f"`dpcontrol recover {path}` makes a log of what is there"


def _check(path: Path, data: bytes, records: list[tuple[int, int, int]]) -> bool:
    """Compare both checksums; return whether the data section had one."""
    start, end = next((start, end) for opcode, start, end in records if opcode == Opcode.DATA_END)
    footer_start, footer_end = records[-1][1:]
    if end - start < 4 or footer_end - footer_start < 20:
        damaged(path, "its closing records are too short")
    (stored,) = struct.unpack_from("<I", data, start)
    computed = zlib.crc32(memoryview(data)[: start - _HEAD.size])
    if stored and stored != computed:
        damaged(path, f"the checksum of its data is {computed:#010x} instead of {stored:#010x}")
    summary, _, summary_crc = struct.unpack_from("<QQI", data, footer_start)
    computed = zlib.crc32(memoryview(data)[summary or footer_start - _HEAD.size : footer_start + 16])
    if summary_crc and summary_crc != computed:
        damaged(path, f"the checksum of its summary is {computed:#010x} instead of {summary_crc:#010x}")
    return bool(stored)


def open_verified(path: Path) -> VerifiedFile:
    """Read `path`, compare its checksums and find what a tick holds.

    Raises:
        InputError: there is no such file, or it is empty, no MCAP file, cut off, damaged or not a log of this program.
    """
    data = recorded_bytes(path)
    if not (data.startswith(MAGIC) or MAGIC.startswith(data)):
        raise InputError(f"{path} is not an MCAP file (it begins with {data[:8]!r}); give a log of `dpcontrol run`")
    records = _walk(path, data)
    view = memoryview(data)
    file = VerifiedFile(path, _check(path, data, records))
    try:
        for opcode, start, end in records:
            if opcode == Opcode.DATA_END:
                break
            if opcode != Opcode.MESSAGE_INDEX:
                file.note(opcode, view[start:end])
    except MALFORMED as error:
        damaged(path, f"a record does not read: {error}", cause=error)
    with file.decoding():
        # Read once, so that later uses cannot fail.
        _ = file.tick
    return file


@dataclass(frozen=True)
class Batch:
    """The records of several chunks: offsets (K,) of whole ticks, and offsets of all other messages by channel."""

    data: bytes
    ticks: list[int]
    others: dict[int, list[int]]

    def ticks_as(self, tick: TickLayout) -> NDArray:
        """Return the ticks (K,) as the layout's structured type.

        Raises:
            ValueError: their messages are not those of the layout.
        """
        rows = gathered(self.data, self.ticks, tick.block_type)
        times = rows[MEASURED]["log_time"]
        for topic, message in tick.messages.items():
            records = rows[topic]
            length = message_type(message).itemsize - 9
            for name, value in (
                ("opcode", MESSAGE_OPCODE), ("length", length), ("channel", tick.channels[topic])
            ):  # fmt: skip
                if (records[name] != value).any():
                    raise ValueError(f"a tick lacks its message of {topic}")
            if (records["log_time"] != times).any():
                raise ValueError(f"the messages of {topic} do not pair with those of {MEASURED}")
        return rows


def gathered(data: bytes, offsets: list[int], kind: np.dtype) -> NDArray:
    """Return the records of type `kind` at `offsets`, copied.

    Raises:
        ValueError: one runs over the end.
    """
    if not offsets:
        return np.empty(0, kind)
    if offsets[-1] + kind.itemsize > len(data):
        raise ValueError("a message is too short")
    # A view at every byte, so that fancy indexing copies whole records.
    everywhere = np.ndarray((len(data) - kind.itemsize + 1,), f"V{kind.itemsize}", buffer=data, strides=(1,))
    return everywhere[np.array(offsets)].view(kind)


def described_layout(path: Path, described: Mapping[str, str]) -> TickLayout:
    """Return what a tick holds by a metadata record that describes it; errors as in `VerifiedFile.tick`."""
    if described.get("format") != FORMAT:
        raise InputError(
            f"{path} has layout {described.get('format')!r}, and this version of dpcontrol reads layout "
            f"{FORMAT!r}; read it with the version that wrote it, or run the itinerary again"
        )
    parts = frozenset(described["parts"].split())
    if not parts <= set(PARTS):
        raise ValueError(f"unknown parts {sorted(parts)}")
    return TickLayout(len(described["arm_lengths"].split()), described["has_cart"] == "1", parts)
