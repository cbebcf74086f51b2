"""Rebuild a log from its remains.

Remains are those of a killed run, a cut copy or a damaged file.

Chunks are sorted by the sequence numbers of their messages. Swapped chunks are reordered, duplicates are dropped and
lost ticks are counted. Messages are copied bit for bit, and no gap is filled.

A record is accepted only if its checksum agrees: MCAP's for chunks and attachments, the package's for metadata (see
`sealed`). Lengths and indexes are not trusted. The file is therefore searched everywhere for the bytes that start such
records. Source: the MCAP format specification, version 0.
"""

import json
import os
import re
import struct
import zlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from io import FileIO
from itertools import count
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel

from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import checked_other_file, whole_file
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.foundation.version import PROGRAM
from dpcontrol.logs import layout
from dpcontrol.logs.container import CHUNK_HEAD, SUFFIX, ChunkMessages, McapFile, sealed, unsealed
from dpcontrol.logs.layout import LENGTH_FROM, MEASURED_CHANNEL, TickLayout
from dpcontrol.logs.reader import (
    MALFORMED,
    check_replaced,
    described_layout,
    gathered,
    parsed,
    read_log,
    recorded_bytes,
    records_in,
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
        checksum: of the unpacked records.
        sequences: first and last number of the messages of each channel.
        end_s: time of the last tick, s, or None.
        channels: number of each topic that the chunk declares.
    """

    body: memoryview
    checksum: int
    sequences: Mapping[int, tuple[int, int]]
    end_s: float | None
    channels: Mapping[str, int]

    def messages(self) -> tuple[bytes, list[ChunkMessages]]:
        """Return the message records and the offset of each, without schemas and channels."""
        data, start, places = _messages(self.body)
        found = []
        for channel, offsets in places.items():
            times = gathered(data, offsets, layout.RECORD_HEADER)["log_time"].astype(np.int64)
            found.append(ChunkMessages(channel=channel, times=times, offsets=np.array(offsets) - start))
        return data[start:], found


def _messages(body: memoryview) -> tuple[bytes, int, dict[int, list[int]]]:
    """Return a chunk's records, the offset of the first message, and the offsets of the messages by channel."""
    data, places = unpacked(body), dict[int, list[int]]()
    records = list(records_in(data))
    first = [opcode for opcode, _, _ in records].index(Opcode.MESSAGE)
    for opcode, start, _ in records[first:]:
        if opcode != Opcode.MESSAGE:
            raise ValueError("a channel is declared after a chunk's first message")
        places.setdefault(int.from_bytes(data[start : start + 2], "little"), []).append(start - LENGTH_FROM)
    return data, records[first][1] - LENGTH_FROM, places


@dataclass
class Salvage:
    """The valid records of a file.

    Attributes:
        metadata: values by name of the record, without their checksums.
        attachments: content by name.
        chunks: valid chunks.
        is_mixed: True if the records are those of several logs.
    """

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    chunks: list[SoundChunk] = field(default_factory=list)
    is_mixed: bool = False


def salvage(path: Path, *, progress: Progress = no_progress) -> Salvage:
    """Return the valid records of a log, each chunk once and in the order of writing.

    Args:
        path: the log.
        progress: receiver of progress reports.

    Raises:
        InputError: the file is missing, or holds pieces of several logs.
    """
    data, found, place = recorded_bytes(path), Salvage(), 0
    while (match := _BEGINNING.search(data, place)) is not None:
        place = match.start() + 1
        opcode, length = struct.unpack_from("<BQ", data, match.start())
        end = match.start() + LENGTH_FROM + length
        if end > len(data):
            continue
        body = memoryview(data)[match.start() + LENGTH_FROM : end]
        with suppress(*MALFORMED):
            if opcode == Opcode.CHUNK:
                found.chunks.append(_chunk(body))
                progress("reading valid records", end / len(data))
            else:
                _add(found, opcode, body)
            place = end
    once = {(chunk.checksum, *chunk.sequences.items()): chunk for chunk in found.chunks}
    after_all_ticks = (1 << 32, 0)
    found.chunks = sorted(once.values(), key=lambda chunk: chunk.sequences.get(MEASURED_CHANNEL, after_all_ticks))
    last: dict[int, int] = {}
    for chunk in found.chunks:
        found.is_mixed |= any(first <= last.get(channel, -1) for channel, (first, _) in chunk.sequences.items())
        last |= {channel: end for channel, (_, end) in chunk.sequences.items()}
    if found.is_mixed:
        raise InputError(f"{path} holds pieces of several logs that cannot be told apart; recover each log separately")
    return found


def _add(found: Salvage, opcode: int, body: memoryview) -> None:
    """Add an attachment or metadata.

    Raises:
        Exception: one of `MALFORMED`: its checksum differs.
    """
    record = parsed(opcode, body)
    if opcode == Opcode.ATTACHMENT:
        if zlib.crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
            raise ValueError("the checksum of an attachment differs")
        found.attachments[record.name] = record.data
        return
    values = unsealed(record.name, record.metadata)
    if values is None:
        raise ValueError("the checksum of a metadata record differs")
    found.is_mixed |= found.metadata.setdefault(record.name, values) != values


def _chunk(body: memoryview) -> SoundChunk:
    checksum = CHUNK_HEAD.unpack_from(body)[3]
    if not checksum:
        raise ValueError("a chunk carries no checksum")
    data, first, places = _messages(body)
    heads = {k: gathered(data, [offsets[0], offsets[-1]], layout.RECORD_HEADER) for k, offsets in places.items()}
    sequences = {k: (int(head["sequence"][0]), int(head["sequence"][1])) for k, head in heads.items()}
    end_s = heads[MEASURED_CHANNEL]["log_time"][1] / 1e9 if MEASURED_CHANNEL in heads else None
    declared = [parsed(opcode, data[start:end]) for opcode, start, end in records_in(data[:first])]
    return SoundChunk(
        body, checksum, sequences, end_s, {one.topic: one.id for one in declared if isinstance(one, Channel)}
    )


@dataclass(frozen=True)
class Recovery(Documented):
    """Ticks and losses of a recovered log.

    Attributes:
        source: file that was read.
        log: recovered log; equal to `source`, with nothing written, if that was readable.
        ticks: number of ticks recovered.
        end_s: time of the last tick, s.
        ticks_lost: ticks missing inside, and at the end if the file records their number.
        milliseconds_lost: duration of the lost ticks, ms.
        end_known: True if the file records how the run ended.
        attachments: names of those recovered.
        attachments_lost: names of those missing.
        lost: sentence that lists everything missing; empty if the log is complete.
    """

    source: Path
    log: Path
    ticks: int
    end_s: float
    ticks_lost: int = 0
    milliseconds_lost: float = 0.0
    end_known: bool = True
    attachments: tuple[str, ...] = ()
    attachments_lost: tuple[str, ...] = ()
    lost: str = ""


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
    if out is not None:
        checked_other_file(Path(out), path, what="the log to recover")
    with suppress(InputError):
        # A readable log may be one that another program has rewritten.
        log = read_log(path)
        end, kept = float(log.time[-1]), tuple(log.attachments)
        return Recovery(path, path, len(log.time), end, end_known=log.end_s is not None, attachments=kept)
    found = salvage(path, progress=progress)
    described = found.metadata.get(layout.LAYOUT_RECORD, {})
    try:
        tick = described_layout(path, described)
        declared = {topic: number for chunk in found.chunks for topic, number in chunk.channels.items()}
        if not declared.items() <= tick.channels.items():
            raise ValueError("its channels are those of another program")
        done = _account(path, _free_name(path) if out is None else Path(out), found, described=described)
    except (InputError, *MALFORMED) as error:
        raise InputError(
            f"{path} cannot be recovered: too little of it is sound, or another program has rewritten it; make "
            "it again with `dpcontrol run` or with that program"
        ) from error
    check_replaced(done.log, found.metadata.get(layout.RUN_RECORD, {}), recovers=path, force=force)
    _write(found, tick, done)
    return done


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


def _account(path: Path, log: Path, found: Salvage, *, described: Mapping[str, str]) -> Recovery:
    """List the recovered and the missing parts of the log.

    Raises:
        Exception: one of `MALFORMED`: there is no tick, or a record has other contents.
    """
    period, names = 1 / float(described["rate_hz"]), json.loads(described["attachments"])
    ticked = [chunk.sequences[MEASURED_CHANNEL] for chunk in found.chunks if chunk.end_s is not None]
    end_s = max(chunk.end_s for chunk in found.chunks if chunk.end_s is not None)
    result = found.metadata.get(layout.RESULT_RECORD)
    ticks = sum(last - first + 1 for first, last in ticked)
    missing = (ticked[-1][1] + 1 if result is None else int(result[layout.TICKS])) - ticks
    attachments_lost = tuple(name for name in names if name not in found.attachments)
    lost = [found.metadata.get(layout.RECOVERY_RECORD, {}).get(layout.LOST, "")]
    if missing:
        lost.append(f"{missing} ticks ({1e3 * missing * period:.0f} ms)")
    if result is None:
        most = 1e3 * max(CHUNK_SECONDS, period)
        lost.append(f"everything after {end_s:.3f} s (at most {most:.0f} ms if the run was killed)")
    if attachments_lost:
        lost.append(f"the attachments {', '.join(attachments_lost)}")
    if layout.RUN_RECORD not in found.metadata:
        lost.append("the metadata of the run")
    return Recovery(
        source=path,
        log=log,
        ticks=ticks,
        end_s=float(end_s),
        ticks_lost=missing,
        milliseconds_lost=1e3 * missing * period,
        end_known=result is not None,
        attachments=tuple(name for name in found.attachments if name in names),
        attachments_lost=attachments_lost,
        lost="; ".join(filter(None, lost)),
    )


def _write(found: Salvage, tick: TickLayout, done: Recovery) -> None:
    """Write the new log, read it back, and move it to its final name."""
    records = {**found.metadata, layout.RECOVERY_RECORD: {layout.LOST: done.lost, "source": done.source.name}}
    result = records.pop(layout.RESULT_RECORD, None)
    with whole_file(done.log) as temporary:
        with FileIO(temporary, "wb") as stream:
            file = McapFile(stream, library=PROGRAM)
            for name, values in records.items():
                file.add_metadata(name, sealed(name, values))
            for name in done.attachments:
                file.add_attachment(name, found.attachments[name])
            file.add_channels(tick.schemas, latched=layout.LATCHED)
            for chunk in found.chunks:
                file.add_chunk(*chunk.messages())
            if result is not None:
                file.add_metadata(layout.RESULT_RECORD, sealed(layout.RESULT_RECORD, result))
            file.finish()
            os.fsync(stream.fileno())
        try:
            ticks = len(read_log(temporary).time)
        except InputError:
            # The file named in the error no longer exists.
            ticks = -1
        if ticks != done.ticks:
            raise InputError(f"{done.source} cannot be recovered: the rebuilt log is not readable or differs")
