"""Rebuild a log from its remains.

Remains are those of a killed run, a cut copy or a damaged file.

Chunks are sorted by the sequence numbers of their messages. Swapped chunks are reordered, duplicates are dropped and
gaps are counted. Messages are copied bit for bit, and no gap is filled.

A record is accepted only if its checksum agrees: MCAP's for chunks and attachments, the package's for metadata (see
`sealed`). Lengths and indexes are not trusted. The file is therefore searched everywhere for the bytes that start such
records. Source: the MCAP format specification, version 0.
"""

import json
import os
import re
import struct
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from io import FileIO
from itertools import count, pairwise
from pathlib import Path

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import checked_other_file, whole_file
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.foundation.version import PROGRAM
from dpcontrol.logs import layout
from dpcontrol.logs.container import CHUNK_HEAD, SUFFIX, ChunkMessages, McapFile, sealed, unsealed
from dpcontrol.logs.layout import TickLayout
from dpcontrol.logs.reader import (
    LARGEST_CHUNK,
    MALFORMED,
    Batch,
    check_channels,
    check_replaced,
    described_layout,
    gathered,
    other_writer,
    parsed,
    read_log,
    recorded_bytes,
    unpacked,
)
from dpcontrol.logs.writer import CHUNK_SECONDS

_BEGINNING = re.compile(
    # A chunk up to its compression, an attachment without times, or metadata, all as this package writes them.
    rb"\x06.{36}\x04\x00\x00\x00zstd|\x09.{6}\x00{18}..\x00\x00|\x0c.{12}dpcontrol\.",
    re.DOTALL,
)


@dataclass(frozen=True)
class SoundChunk:
    """A chunk with a valid checksum.

    Attributes:
        body: of the record.
        size: unpacked, bytes.
        checksum: unpacked.
        sequences: first and last number by channel.
        times: first and last tick, ns, or None.
        schemas: by number.
        channels: by number.
    """

    body: memoryview
    size: int
    checksum: int
    sequences: Mapping[int, tuple[int, int]]
    times: tuple[int, int] | None
    schemas: Mapping[int, Schema]
    channels: Mapping[int, Channel]

    @property
    def identity(self) -> tuple[int, int, tuple[tuple[int, tuple[int, int]], ...]]:
        """Key that distinguishes this chunk from others of its log."""
        return self.size, self.checksum, tuple(sorted(self.sequences.items()))

    def messages(self) -> tuple[bytes, list[ChunkMessages]]:
        """Return the message records and the offset of each.

        Schemas and channels are omitted.
        """
        start, batch = _message_start(self.body)
        found = []
        for channel, offsets in batch.others.items():
            times = gathered(batch.data, offsets, layout.RECORD_HEADER)["log_time"].astype(np.int64)
            found.append(ChunkMessages(channel=channel, times=times, offsets=np.array(offsets) - start))
        return batch.data[start:], found


@dataclass
class Salvage:
    """The valid records of a file, in file order.

    Attributes:
        metadata: all distinct records by name, without their checksums.
        attachments: content by name.
        chunks: valid chunks.
        dropped: number of chunks that start but are not valid.
    """

    metadata: dict[str, list[dict[str, str]]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    chunks: list[SoundChunk] = field(default_factory=list)
    dropped: int = 0


def salvage(data: bytes, *, progress: Progress = no_progress) -> Salvage:
    """Return the valid records in the bytes of a log.

    Args:
        data: bytes of the log.
        progress: receiver of progress reports.
    """
    found = Salvage()
    view, place = memoryview(data), 0
    while (match := _BEGINNING.search(data, place)) is not None:
        place = match.start()
        opcode, length = struct.unpack_from("<BQ", data, place)
        end = place + 9 + length
        if end <= len(data) and _accept(found, opcode, view[place + 9 : end]):
            place = end
            if len(found.chunks) % 500 == 0:
                progress("reading valid records", place / len(data))
        else:
            found.dropped += opcode == Opcode.CHUNK
            place += 1
    return found


def _accept(found: Salvage, opcode: int, body: memoryview) -> bool:
    """Add a record if its checksum agrees.

    Return True if it was added.
    """
    try:
        if opcode == Opcode.CHUNK:
            found.chunks.append(_chunk(body))
            return True
        record = parsed(opcode, body)
    except MALFORMED:
        return False
    if isinstance(record, Metadata):
        values = unsealed(record.name, record.metadata)
        known = found.metadata.setdefault(record.name, []) if values is not None else []
        if values is not None and values not in known:
            known.append(values)
        return values is not None
    if isinstance(record, Attachment) and zlib.crc32(body[:-4]) == int.from_bytes(body[-4:], "little"):
        found.attachments[record.name] = record.data
        return True
    return False


def _chunk(body: memoryview) -> SoundChunk:
    _, _, size, checksum, _, _ = CHUNK_HEAD.unpack_from(body)
    if size > LARGEST_CHUNK or not checksum:
        raise ValueError("a chunk is too large, or carries no checksum")
    _, batch = _message_start(body)
    sequences, times = {}, None
    for channel, offsets in batch.others.items():
        heads = gathered(batch.data, [offsets[0], offsets[-1]], layout.RECORD_HEADER)
        sequences[channel] = (int(heads["sequence"][0]), int(heads["sequence"][1]))
        if channel == layout.MEASURED_CHANNEL:
            times = (int(heads["log_time"][0]), int(heads["log_time"][1]))
    declared = [parsed(opcode, batch.data[start:end]) for opcode, start, end in batch.declared]
    schemas = {record.id: record for record in declared if isinstance(record, Schema)}
    channels = {record.id: record for record in declared if isinstance(record, Channel)}
    return SoundChunk(body, size, checksum, sequences, times, schemas, channels)


def _message_start(body: memoryview) -> tuple[int, Batch]:
    """Return the offset of a chunk's first message, and its records."""
    batch = Batch(unpacked(body, zstandard.ZstdDecompressor()))
    start = max((end for _, _, end in batch.declared), default=0)
    if any(offsets[0] < start for offsets in batch.others.values()):
        raise ValueError("a channel is declared after a chunk's first message")
    return start, batch


_SHOWN_GAPS = 3


@dataclass(frozen=True)
class Recovery:
    """Ticks, gaps and losses of a recovered log.

    Attributes:
        source: file that was read.
        log: recovered log; equal to `source`, with nothing written, if that was readable.
        ticks: number of ticks recovered.
        end_s: time of the last tick, s.
        ticks_lost: ticks missing inside, and at the end if the file records their number.
        milliseconds_lost: duration of the lost ticks, ms.
        gaps: (from, to) of each, s.
        end_known: True if the file records how the run ended.
        chunks_dropped: chunks that are damaged or cut.
        attachments: names of those recovered.
        attachments_lost: names of those missing.
        lost: sentence that lists everything missing; empty if the log is complete.
    """

    source: Path
    log: Path
    ticks: int
    end_s: float
    ticks_lost: int
    milliseconds_lost: float
    gaps: tuple[tuple[float, float], ...]
    end_known: bool
    chunks_dropped: int
    attachments: tuple[str, ...]
    attachments_lost: tuple[str, ...]
    lost: str


def recover(
    path: Path | str, out: Path | None = None, *, force: bool = False, progress: Progress = no_progress
) -> Recovery:
    """Rebuild the log in `path` and write it to `out`.

    Args:
        path: file to recover.
        out: new log; by default a free name beside `path`.
        force: replace any log at `out`.
        progress: called with a label and the completed share.

    Raises:
        InputError: the file is missing, holds nothing recoverable or pieces of several logs, another program has
            rewritten it and it is damaged, or the new log cannot be written or would replace another.
    """
    path = Path(path)
    data = recorded_bytes(path)
    if out is not None:
        checked_other_file(Path(out), path, what="the log to recover")
    with suppress(InputError):
        # A readable log may be one that another program has rewritten.
        log = read_log(path)
        return Recovery(
            path, path, ticks=len(log.time), end_s=float(log.time[-1]), ticks_lost=0, milliseconds_lost=0.0, gaps=(),
            end_known=log.end_s is not None, chunks_dropped=0,
            attachments=tuple(log.attachments), attachments_lost=(), lost="",
        )  # fmt: skip
    found = salvage(data, progress=part_of(progress, 0.0, 0.6))
    described = _single_record(path, found, layout.LAYOUT_RECORD)
    if described is None or not any(chunk.times for chunk in found.chunks):
        if other_writer(path):
            # This raises the reason and the remedy.
            read_log(path)
        raise InputError(f"{path} cannot be recovered: {_nothing(found)}; make the log again with `dpcontrol run`")
    try:
        tick = described_layout(path, described)
        _check_declared(path, tick, found.chunks)
        chunks = _in_order(path, found.chunks)
        done = _account(path, found, chunks, described=described)
    except MALFORMED as error:
        raise InputError(f"{path} cannot be recovered: its valid records contradict each other: {error}") from error
    done = replace(done, log=_free_name(path) if out is None else Path(out))
    check_replaced(done.log, _single_record(path, found, layout.RUN_RECORD) or {}, recovers=path, force=force)
    _write(found, chunks, described=described, tick=tick, done=done, progress=part_of(progress, 0.6, 1.0))
    return done


def _check_declared(path: Path, tick: TickLayout, chunks: Sequence[SoundChunk]) -> None:
    """Reject a log that another program has rewritten.

    A log without declarations is rebuilt without them.
    """
    schemas = {number: schema for chunk in chunks for number, schema in chunk.schemas.items()}
    channels = {number: channel for chunk in chunks for number, channel in chunk.channels.items()}
    if channels:
        check_channels(path, tick, schemas=schemas, channels=channels)


def _free_name(path: Path) -> Path:
    """Return a free name for the recovered log.

    The log's name if it is free, or a similar free name.
    """
    named = re.sub(r"(\.\d+-\d+)?\.partial$", "", path.name)
    if path.suffix == SUFFIX and not path.with_name(named).exists():
        return path.with_name(named)
    stem = named.removesuffix(".mcap")
    names = (path.with_name(f"{stem}-recovered{f'-{k}' if k > 1 else ''}.mcap") for k in count(1))
    return next(name for name in names if not name.exists())


def _single_record(path: Path, found: Salvage, name: str) -> dict[str, str] | None:
    """Return the record of this name, or None.

    Raises:
        InputError: the file holds several.
    """
    records = found.metadata.get(name, [])
    if len(records) > 1:
        raise _several(path)
    return records[0] if records else None


def _several(path: Path) -> InputError:
    return InputError(f"{path} holds pieces of several logs that cannot be told apart; recover each log separately")


def _nothing(found: Salvage) -> str:
    if layout.LAYOUT_RECORD in found.metadata:
        return "it holds no complete tick"
    if not found.chunks:
        return "it ends before its first tick"
    return "the description of its layout is damaged, or it is not a log of `dpcontrol run`"


def _in_order(path: Path, chunks: Sequence[SoundChunk]) -> list[SoundChunk]:
    """Return each chunk once, sorted by sequence number."""
    once = {chunk.identity: chunk for chunk in chunks}.values()
    after_all_ticks = (1 << 32, 0)

    def key(chunk: SoundChunk) -> tuple:
        return chunk.sequences.get(layout.MEASURED_CHANNEL, after_all_ticks), sorted(chunk.sequences.items())

    ordered = sorted(once, key=key)
    last: dict[int, int] = {}
    for chunk in ordered:
        for channel, (first, end) in chunk.sequences.items():
            if first <= last.get(channel, -1):
                raise _several(path)
            last[channel] = end
    return ordered


def _account(path: Path, found: Salvage, chunks: Sequence[SoundChunk], *, described: dict[str, str]) -> Recovery:
    """List the recovered and the missing parts of the log."""
    ticked = [(*c.sequences[layout.MEASURED_CHANNEL], *c.times) for c in chunks if c.times is not None]
    period = 1 / float(described["rate_hz"])
    result = _single_record(path, found, layout.RESULT_RECORD)
    end_s = ticked[-1][3] / 1e9
    missing, gaps = ticked[0][0], [(0.0, ticked[0][2] / 1e9)] if ticked[0][0] else []
    for (_, last, _, before), (first, _, after, _) in pairwise(ticked):
        if first > last + 1:
            missing += first - last - 1
            gaps.append((before / 1e9, after / 1e9))
    if result is not None and (at_end := int(result[layout.TICKS]) - ticked[-1][1] - 1):
        missing += at_end
        gaps.append((end_s, end_s + at_end * period))
    names = json.loads(described["attachments"])
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError(f"{path}: its layout names no list of attachments but {names!r:.80}; nothing can be recovered")
    attachments_lost = tuple(name for name in names if name not in found.attachments)
    before = _single_record(path, found, layout.RECOVERY_RECORD) or {}
    lost = [before[layout.LOST]] if before.get(layout.LOST) else []
    if missing:
        shown = ", ".join(f"{a:.3f} to {b:.3f} s" for a, b in gaps[:_SHOWN_GAPS])
        lost.append(f"{missing} ticks ({1e3 * missing * period:.0f} ms): {shown}{', …' * (len(gaps) > _SHOWN_GAPS)}")
    if result is None:
        most = 1e3 * max(CHUNK_SECONDS, period)
        lost.append(f"everything after {end_s:.3f} s (at most {most:.0f} ms if the run was killed)")
    if attachments_lost:
        lost.append(f"the attachment{'s'[: len(attachments_lost) > 1]} {', '.join(attachments_lost)}")
    if layout.RUN_RECORD not in found.metadata:
        lost.append("the metadata of the run")
    return Recovery(
        source=path,
        log=path,
        ticks=sum(last - first + 1 for first, last, _, _ in ticked),
        end_s=end_s,
        ticks_lost=missing,
        milliseconds_lost=1e3 * missing * period,
        gaps=tuple(gaps),
        end_known=result is not None,
        chunks_dropped=found.dropped,
        attachments=tuple(name for name in found.attachments if name in names),
        attachments_lost=attachments_lost,
        lost="; ".join(lost),
    )


def _write(
    found: Salvage,
    chunks: Sequence[SoundChunk],
    *,
    described: dict[str, str],
    tick: TickLayout,
    done: Recovery,
    progress: Progress,
) -> None:
    """Write the new log and read it back.

    It is then moved to its final name.
    """
    with whole_file(done.log) as temporary:
        with FileIO(temporary, "wb") as stream:
            file = McapFile(stream, library=PROGRAM)
            for values in found.metadata.get(layout.RUN_RECORD, [])[:1]:
                file.add_metadata(layout.RUN_RECORD, sealed(layout.RUN_RECORD, values))
            for name in done.attachments:
                file.add_attachment(name, found.attachments[name])
            file.add_metadata(layout.LAYOUT_RECORD, sealed(layout.LAYOUT_RECORD, described))
            record_values = {layout.LOST: done.lost, "source": done.source.name}
            file.add_metadata(layout.RECOVERY_RECORD, sealed(layout.RECOVERY_RECORD, record_values))
            file.add_channels(tick.schemas, latched=layout.LATCHED)
            for k, chunk in enumerate(chunks):
                file.add_chunk(*chunk.messages())
                progress("writing valid records", k / len(chunks))
            for values in found.metadata.get(layout.RESULT_RECORD, []):
                file.add_metadata(layout.RESULT_RECORD, sealed(layout.RESULT_RECORD, values))
            file.finish()
            os.fsync(stream.fileno())
        try:
            written = read_log(temporary)
        except InputError as error:
            # The file named in the error no longer exists.
            raise InputError(f"{done.source} cannot be recovered: the rebuilt log is not readable") from error
        if len(written.time) != done.ticks or tuple(written.attachments) != done.attachments:
            raise InputError(f"{done.source} cannot be recovered: the rebuilt log differs when it is read back")
    progress("writing valid records", 1.0)
