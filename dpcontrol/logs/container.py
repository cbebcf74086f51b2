"""Write an MCAP file chunk by chunk, and find the messages in a chunk.

The chunks are blocks of prepared message records. The messages of a tick are contiguous, and the layout in the log's
metadata gives their lengths. One look per tick finds them all, and one copy extracts the numbers of thousands of ticks.

The writer of the mcap package takes one message at a time, 3–4 µs each: more than the control loop costs. Here a chunk
is passed as a whole, and the times and offsets of its messages are arrays. All other records come from that package.

A growing log is named `NAME.mcap.partial` and lies beside its final path. A killed run leaves this file, which is never
overwritten or removed. A later run of the same log uses a different name, and `dpcontrol recover` rebuilds a log from
the file that was left.

MCAP has checksums for chunks and attachments, but metadata is covered only by the checksum of the data section. In a
cut or damaged file metadata could not be verified. Each metadata record therefore carries a CRC-32 of name and values.

Source: the MCAP format specification, version 0.
"""

import glob
import json
import os
import struct
import zlib
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from io import FileIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from numpy.typing import NDArray

from dpcontrol.logs.layout import LATCHED, LENGTH_FROM, RECORD_HEADER, TickLayout

_COMPRESSION = -5
"""Level of zstd. Level 1 takes twice as long and saves 6 %, because noise does not compress."""
MAGIC = b"\x89MCAP0\r\n"
_LATCHED_QOS = """\
- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
"""
"""Quality of service of a latched topic, in the numbers of ROS 2's rmw_qos_profile_t. Some readers reject an
incomplete profile."""
_RECORD = struct.Struct("<BQH")
"""Head of a record: opcode, length and, for a message, its channel."""
_INDEX = struct.Struct("<BQHI")
"""Head of a message index: opcode, length, channel, and length of its entries."""


_MOST = 256
"""Ticks of a chunk that are compared at once."""


class LocatedMessages(NamedTuple):
    """Messages of one topic in a chunk.

    Attributes:
        offsets: offsets (K,) of the messages' records in the chunk, bytes.
        records: copies (K,) of these records.
    """

    offsets: NDArray[np.int64]
    records: NDArray[Any]


def located(data: bytes, tick: TickLayout, types: Mapping[str, np.dtype]) -> dict[str, LocatedMessages]:
    """Return the messages in the records of chunks, by topic, for indexes of a chunk and for a log's arrays.

    Args:
        data: records of one chunk or more.
        tick: layout of the ticks.
        types: structured type of the records of topics; only the heads of those of other topics are read.

    Raises:
        ValueError: the records are not those of a log with this layout.
    """
    tick_starts = [np.empty(0, np.int64)]
    message_offsets: dict[int, list[int]] = {number: [] for number in tick.channels.values()}
    block = tick.block
    tick_head, size = block.template[: _RECORD.size], len(block.template)
    position, end, unpack = 0, len(data), _RECORD.unpack_from
    while position < end:
        # The first record of a tick has an opcode, length and channel that no other record has.
        if data.startswith(tick_head, position):
            # Ticks follow one another; many are compared at once.
            candidates = min(max((end - position) // size, 1), _MOST)
            is_tick = np.ndarray((candidates,), f"S{_RECORD.size}", data, position, (size,)) == tick_head
            tick_count = candidates if is_tick.all() else int(is_tick.argmin())
            tick_starts.append(position + size * np.arange(tick_count))
            position += size * tick_count
            continue
        opcode, length, channel = unpack(data, position)
        if opcode == Opcode.MESSAGE:
            message_offsets[channel].append(position)
        position += LENGTH_FROM + length
    if position != end:
        raise ValueError("a record runs over the end of its chunk")
    fields: Any = block.kind.fields
    messages = {}
    for topic, number in tick.channels.items():
        # A tick has its messages at fixed places.
        offsets = np.concatenate(tick_starts) if topic in fields else np.array(message_offsets[number], np.int64)
        offsets += fields[topic][1] if topic in fields else 0
        kind = types.get(topic, RECORD_HEADER)
        # A view at every byte, so that fancy indexing copies whole records.
        shape = (max(len(data) - kind.itemsize + 1, 0),)
        record_at_each_byte = np.ndarray(shape, f"V{kind.itemsize}", buffer=data, strides=(1,))
        messages[topic] = LocatedMessages(offsets, record_at_each_byte[offsets].view(kind))
        if (messages[topic].records["channel"] != number).any():
            raise ValueError("a tick lacks a message")
    return messages


def _bytes_of(record: McapRecord) -> bytes:
    """Return the encoded record, opcode and length included."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def declarations(tick: TickLayout) -> list[McapRecord]:
    """Return the schemas and channels of a log, which describe its messages to any reader of MCAP.

    Args:
        tick: layout of the ticks.
    """
    definitions = dict(tick.schemas.values())
    numbers = {name: number for number, name in enumerate(definitions, start=1)}
    schemas = [Schema(id=numbers[name], name=name, encoding="ros2msg", data=definitions[name]) for name in numbers]
    latched = {"offered_qos_profiles": _LATCHED_QOS}
    channels = [
        Channel(
            id=tick.channels[topic],
            topic=topic,
            message_encoding="cdr",
            metadata=latched if topic in LATCHED else {},
            schema_id=numbers[name],
        )
        for topic, (name, _) in tick.schemas.items()
    ]
    return [*schemas, *channels]


class McapFile:
    """Writes one MCAP file to an unbuffered binary stream.

    The order is header, metadata and attachments, chunks, summary. Checksums of each chunk and of the whole data
    section are always written.

    Args:
        stream: unbuffered binary stream.
        library: name of the writing program.
    """

    def __init__(self, stream: FileIO, *, library: str):
        self.stream = stream
        # Checksum of all bytes up to now.
        self._crc = 0
        self._compressor = zstandard.ZstdCompressor(level=_COMPRESSION)
        # Records of the summary, and records that the next chunk begins with.
        self._summary: list[bytes] = []
        self._unwritten: list[bytes] = []
        # Messages of each channel, and the first and last time of all, ns.
        self._counts: dict[int, int] = {}
        self._times: list[int] = []
        self._write(MAGIC + _bytes_of(Header(profile="ros2", library=library)))

    def _write(self, data: bytes | bytearray) -> None:
        """Write bytes to the stream, and add them to the checksum of the data section."""
        self._crc = zlib.crc32(data, self._crc)
        remaining = memoryview(data)
        # An unbuffered stream may accept only a part, for example on a nearly full disk.
        while remaining:
            remaining = remaining[self.stream.write(remaining) or 0 :]

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Write a metadata record with its checksum, and its entry in the summary.

        Args:
            name: name of the record.
            data: text by key.
        """
        record = _bytes_of(Metadata(name=name, metadata={**data, _KEY: _checksum(name, data)}))
        self._summary.append(_bytes_of(MetadataIndex(offset=self.stream.tell(), length=len(record), name=name)))
        self._write(record)

    def add_attachment(self, name: str, data: bytes) -> None:
        """Write an attachment with times zero, since simulated time has no date.

        Args:
            name: name of the attachment, whose ending gives its media type.
            data: content.
        """
        media_type = "application/toml" if name.endswith(".toml") else "application/octet-stream"
        shared_fields = {"create_time": 0, "log_time": 0, "name": name, "media_type": media_type}
        record = _bytes_of(Attachment(data=data, **shared_fields))
        index = AttachmentIndex(offset=self.stream.tell(), length=len(record), data_size=len(data), **shared_fields)
        self._summary.append(_bytes_of(index))
        self._write(record)

    def add_channels(self, tick: TickLayout) -> None:
        """Register the channels of a log, written with the next chunk.

        Args:
            tick: layout of the ticks.
        """
        self._tick = tick
        self._counts = dict.fromkeys(tick.channels.values(), 0)
        self._unwritten = [*map(_bytes_of, declarations(tick))]
        self._summary += self._unwritten

    def add_chunk(self, data: bytes) -> None:
        """Write one compressed chunk with its indexes to the stream.

        Args:
            data: message records of the chunk.
        """
        messages = {topic: part for topic, part in located(data, self._tick, {}).items() if len(part.offsets)}
        declared = b"".join(self._unwritten)
        self._unwritten.clear()
        content = declared + data
        times = np.concatenate([part.records["log_time"] for part in messages.values()])
        shared_fields = {
            "message_start_time": int(times.min()), "message_end_time": int(times.max()), "compression": "zstd",
            "uncompressed_size": len(content),
        }  # fmt: skip
        compressed = self._compressor.compress(content)
        start, index_offsets = self.stream.tell(), {}
        chunk_and_indexes = bytearray(
            _bytes_of(Chunk(data=compressed, uncompressed_crc=zlib.crc32(content), **shared_fields))
        )
        chunk_length = len(chunk_and_indexes)
        for topic, part in messages.items():
            number, offsets = self._tick.channels[topic], part.offsets + len(declared)
            index_offsets[number] = start + len(chunk_and_indexes)
            # The library writes its entries one by one. The record's length counts channel and length with six bytes.
            entries = np.stack([part.records["log_time"], offsets], axis=1).astype("<u8").tobytes()
            chunk_and_indexes += _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), number, len(entries)) + entries
            self._counts[number] += len(offsets)
        index = ChunkIndex(
            chunk_start_offset=start, chunk_length=chunk_length, message_index_offsets=index_offsets,
            message_index_length=len(chunk_and_indexes) - chunk_length, compressed_size=len(compressed),
            **shared_fields,
        )  # fmt: skip
        self._summary.append(_bytes_of(index))
        self._times = [min([index.message_start_time, *self._times]), max([index.message_end_time, *self._times])]
        self._write(chunk_and_indexes)

    def finish(self) -> None:
        """Write the end of the data, the summary and the footer, and close the stream when they are on the disk."""
        self._write(b"".join(self._unwritten))
        # The checksum of the data section covers everything before this record.
        self._write(_bytes_of(DataEnd(data_section_crc=self._crc)))
        record_counts = Counter(record[0] for record in self._summary)
        start, end = self._times or (0, 0)
        statistics = Statistics(
            attachment_count=record_counts[Opcode.ATTACHMENT_INDEX], channel_count=record_counts[Opcode.CHANNEL],
            channel_message_counts=dict(self._counts), chunk_count=record_counts[Opcode.CHUNK_INDEX],
            message_count=sum(self._counts.values()), metadata_count=record_counts[Opcode.METADATA_INDEX],
            message_start_time=start, message_end_time=end, schema_count=record_counts[Opcode.SCHEMA],
        )  # fmt: skip
        # Records of a summary are grouped by their opcodes, which come first.
        records = sorted([*self._summary, _bytes_of(statistics)], key=lambda record: record[0])
        summary, start = b"".join(records), self.stream.tell()
        # The footer's checksum covers the summary and the footer up to the checksum itself.
        footer_head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, 0)
        checksum = zlib.crc32(footer_head, zlib.crc32(summary))
        footer = Footer(summary_start=start, summary_offset_start=0, summary_crc=checksum)
        self._write(summary + _bytes_of(footer) + MAGIC)
        os.fsync(self.stream.fileno())
        self.stream.close()


SUFFIX = ".partial"


def open_partial(path: Path) -> tuple[Path, FileIO]:
    """Create the unbuffered partial file of a log, and return its name and the open file.

    Args:
        path: path of the complete log.

    Raises:
        OSError: the file cannot be created.
    """
    for name in (path.name, *(f"{path.name}.{os.getpid()}-{k}" for k in range(1, 99))):
        with suppress(FileExistsError):
            return path.with_name(name + SUFFIX), FileIO(path.with_name(name + SUFFIX), "xb")
    raise FileExistsError(f"{path} and 98 other names beside it exist")


def partials_of(path: Path) -> tuple[Path, ...]:
    """Return the partial files of a log, abandoned or still growing, oldest first.

    Args:
        path: path of the complete log.
    """
    return tuple(sorted(path.parent.glob(f"{glob.escape(path.name)}*{SUFFIX}"), key=lambda file: file.stat().st_mtime))


_KEY = "crc32"


def unsealed(name: str, record: Mapping[str, str]) -> dict[str, str] | None:
    """Return the values of a metadata record without its checksum, or None if the checksum is missing or wrong.

    Args:
        name: name of the record.
        record: text by key, with the checksum.
    """
    values = {key: value for key, value in record.items() if key != _KEY}
    return values if record.get(_KEY) == _checksum(name, values) else None


def _checksum(name: str, values: Mapping[str, str]) -> str:
    """Return the CRC-32 of a metadata record's name and values as eight hexadecimal digits."""
    content = json.dumps([name, dict(sorted(values.items()))])
    return f"{zlib.crc32(content.encode()):08x}"
