"""Find what is sound in a file that is cut or damaged.

A record is believed only if a checksum of its own agrees: chunks and attachments by MCAP's, metadata by ours (see
`sealed`). Nothing else is trusted, no length and no index, so the file is searched for the bytes with which such
records begin, wherever they stand. Source: the MCAP format specification, version 0.
"""

import re
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from io import BytesIO

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata
from numpy.typing import NDArray

from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.logs import layout
from dpcontrol.logs.container import ChunkMessages
from dpcontrol.logs.sealed import unsealed
from dpcontrol.logs.verified import MALFORMED

_BEGINNING = re.compile(
    # A chunk up to its compression; an attachment without times, as ours are; metadata of ours.
    rb"\x06.{36}\x04\x00\x00\x00zstd|\x09.{6}\x00{18}..\x00\x00|\x0c.{12}dpcontrol\.",
    re.DOTALL,
)
_CHUNK = struct.Struct("<QQQII4sQ")
_RECORD = struct.Struct("<BQH")
_LARGEST_CHUNK = 1 << 28


@dataclass(frozen=True)
class SoundChunk:
    """A chunk whose checksum agrees: its packed bytes, size and checksum unpacked, and what messages it holds.

    sequences: first and last sequence number by channel. times: first and last tick in ns, or None without ticks.
    """

    packed: memoryview
    size: int
    checksum: int
    sequences: Mapping[int, tuple[int, int]]
    times: tuple[int, int] | None

    @property
    def identity(self) -> tuple[int, int, tuple[tuple[int, tuple[int, int]], ...]]:
        """What tells this chunk from others of its log."""
        return self.size, self.checksum, tuple(sorted(self.sequences.items()))

    def messages(self) -> tuple[bytes, list[ChunkMessages]]:
        """Return the records of its messages, without those of schemas and channels, and where each stands."""
        content = _unpacked(self.packed, self.size)
        start, places = _places(content)
        found = []
        for channel, offsets in places.items():
            times = _heads(content, offsets)["log_time"].astype(np.int64)
            found.append(ChunkMessages(channel=channel, times=times, offsets=np.array(offsets) - start))
        return content[start:], found


@dataclass
class Salvage:
    """What is sound in a file, in the order in which it stands there.

    metadata: all distinct records by name, without their checksums. dropped: beginnings of records that are not sound.
    """

    metadata: dict[str, list[dict[str, str]]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    chunks: list[SoundChunk] = field(default_factory=list)
    dropped: int = 0


def salvage(data: bytes, *, progress: Progress = no_progress) -> Salvage:
    """Return what is sound in the bytes of a log."""
    found = Salvage()
    view, place = memoryview(data), 0
    while (match := _BEGINNING.search(data, place)) is not None:
        place = match.start()
        opcode, length = struct.unpack_from("<BQ", data, place)
        end = place + 9 + length
        if end <= len(data) and _take(found, opcode, view[place + 9 : end]):
            place = end
            if len(found.chunks) % 500 == 0:
                progress("reading what is there", place / len(data))
        else:
            found.dropped += opcode == Opcode.CHUNK
            place += 1
    return found


def _take(found: Salvage, opcode: int, body: memoryview) -> bool:
    """Take up a record if its checksum agrees; tell whether it does."""
    try:
        if opcode == Opcode.CHUNK:
            found.chunks.append(_chunk(body))
        elif opcode == Opcode.METADATA:
            record = Metadata.read(ReadDataStream(BytesIO(body)))
            values = unsealed(record.name, record.metadata)
            if values is None:
                return False
            known = found.metadata.setdefault(record.name, [])
            if values not in known:
                known.append(values)
        else:
            if zlib.crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
                return False
            attachment = Attachment.read(ReadDataStream(BytesIO(body)))
            found.attachments[attachment.name] = attachment.data
    except MALFORMED:
        return False
    return True


def _chunk(body: memoryview) -> SoundChunk:
    _, _, size, checksum, _, _, length = _CHUNK.unpack_from(body)
    packed = body[_CHUNK.size :]
    if len(packed) != length or size > _LARGEST_CHUNK:
        raise ValueError("a chunk's lengths disagree")
    content = _unpacked(packed, size)
    if not checksum or zlib.crc32(content) != checksum:
        raise ValueError("a chunk's checksum differs")
    sequences, times = {}, None
    for channel, offsets in _places(content)[1].items():
        heads = _heads(content, [offsets[0], offsets[-1]])
        sequences[channel] = (int(heads["sequence"][0]), int(heads["sequence"][1]))
        if channel == layout.MEASURED_CHANNEL:
            times = (int(heads["log_time"][0]), int(heads["log_time"][1]))
    return SoundChunk(packed, size, checksum, sequences, times)


def _unpacked(packed: memoryview, size: int) -> bytes:
    content = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    if len(content) != size:
        raise ValueError("a chunk is of another size than it says")
    return content


def _places(content: bytes) -> tuple[int, dict[int, list[int]]]:
    """Return where a chunk's messages begin, and the offsets of the messages by channel."""
    start, place, found = None, 0, {}
    while place < len(content):
        opcode, length, channel = _RECORD.unpack_from(content, place)
        if opcode == Opcode.MESSAGE:
            start = place if start is None else start
            found.setdefault(channel, []).append(place)
        elif start is not None:
            raise ValueError("a channel is declared after a chunk's first message")
        place += 9 + length
    if place != len(content):
        raise ValueError("a record runs over the end of its chunk")
    return (len(content) if start is None else start), found


def _heads(content: bytes, offsets: list[int]) -> NDArray:
    size = layout.RECORD_HEADER.itemsize
    everywhere = np.ndarray((len(content) - size + 1,), f"V{size}", buffer=content, strides=(1,))
    return everywhere[np.array(offsets)].view(layout.RECORD_HEADER)
