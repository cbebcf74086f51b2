"""Rebuild a log from the remains of a killed run, a cut copy or a damaged file.

Chunks are sorted by the sequence numbers of their messages. Swapped chunks are reordered, duplicates are dropped and
lost ticks are counted. Messages are copied bit for bit, and no gap is filled.

A record is accepted only if its checksum agrees: MCAP's for chunks and attachments, the package's for metadata (see
`unsealed`). Lengths and indexes are not trusted. The file is therefore searched everywhere for the bytes that start
such records. Source: the MCAP format specification, version 0.
"""

import json
import re
import struct
import zlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO, FileIO
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, Metadata
from numpy.typing import NDArray

from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import checked_other_file, whole_file
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.foundation.version import PROGRAM
from dpcontrol.logs import layout
from dpcontrol.logs.container import SUFFIX, McapFile, located, unsealed
from dpcontrol.logs.reader import (
    MALFORMED,
    check_replaced,
    described_layout,
    read_log,
    recorded_bytes,
    unpacked,
)
from dpcontrol.logs.writer import LONGEST_CHUNK

_BEGINNING = re.compile(
    # A chunk up to its compression, an attachment without times, or metadata, all as this package writes them.
    rb"\x06.{36}\x04\x00\x00\x00zstd|\x09.{6}\x00{18}..\x00\x00|\x0c.{12}dpcontrol\.",
    re.DOTALL,
)
_KINDS: dict[int, Any] = {Opcode.CHUNK: Chunk, Opcode.ATTACHMENT: Attachment, Opcode.METADATA: Metadata}


class Salvage(NamedTuple):
    """The records of a file whose checksums agree.

    Attributes:
        chunks: unpacked content of the chunks, each once, as keys.
        attachments: content by name.
        metadata: values by name of the record, without their checksums.
    """

    chunks: dict[bytes, None]
    attachments: dict[str, bytes]
    metadata: dict[str, dict[str, str]]


_SEVERAL = "it holds pieces of several logs that cannot be told apart; recover each log separately"


def salvage(data: bytes, *, progress: Progress = no_progress) -> Salvage:
    """Return the records of a damaged log whose checksums agree, wherever they are in the file.

    Args:
        data: content of the file.
        progress: receiver of progress reports.

    Raises:
        InputError: the records are those of several logs.
    """
    rescued, position = Salvage({}, {}, {}), 0
    while (match := _BEGINNING.search(data, position)) is not None:
        # Unless the record is valid, the search goes on within it.
        position = match.start() + 1
        opcode, length = struct.unpack_from("<BQ", data, match.start())
        end = match.start() + layout.LENGTH_FROM + length
        record_content = data[match.start() + layout.LENGTH_FROM : end]
        with suppress(*MALFORMED):
            match _KINDS[opcode].read(ReadDataStream(BytesIO(record_content))):
                case Chunk(uncompressed_crc=checksum) as chunk if checksum:
                    rescued.chunks[unpacked(chunk)] = None
                case Attachment(name=name, data=content) if (
                    zlib.crc32(record_content[:-4]).to_bytes(4, "little") == record_content[-4:]
                ):
                    rescued.attachments[name] = content
                case Metadata(name=name, metadata=record) if (values := unsealed(name, record)) is not None:
                    if rescued.metadata.setdefault(name, values) != values:
                        raise InputError(_SEVERAL)
                case _:
                    continue
            position = end
            progress("reading valid records", end / len(data))
    return rescued


_AFTER_ALL = 1 << 32
"""Number of the first tick of chunks without ticks: these hold the last events."""


def _numbered(data: bytes, tick: layout.TickLayout) -> tuple[int, bytes]:
    """Return the number of the first tick in a chunk's content, and its message records.

    The recovery sorts chunks by this number. A chunk without ticks comes last. `data` is the content, and `tick` the
    layout of the log's ticks.
    """
    messages = located(data, tick, {})
    start = min(int(part.offsets[0]) for part in messages.values() if len(part.offsets))
    numbers = messages[layout.MEASURED].records["sequence"].tolist()
    return (numbers or [_AFTER_ALL])[0], data[start:]


@dataclass(frozen=True)
class Recovery(Documented):
    """Ticks and losses of a recovered log, as `dpcontrol recover` reports them.

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
        end_known, attachments = log.end_s is not None, tuple(log.attachments)
        return Recovery(path, path, len(log.time), float(log.time[-1]), end_known=end_known, attachments=attachments)
    data = recorded_bytes(path)
    try:
        rescued = salvage(data, progress=progress)
        tick = described_layout(path, rescued.metadata.get(layout.LAYOUT_RECORD, {}))
        numbered_chunks = sorted((_numbered(data, tick) for data in rescued.chunks), key=itemgetter(0))
        pieces = [data for _, data in numbered_chunks]
        ticks = located(b"".join(pieces), tick, {})[layout.MEASURED].records
        if (np.diff(ticks["sequence"].astype(np.int64)) <= 0).any():
            raise InputError(_SEVERAL)
        recovery = _account(path, _free_name(path) if out is None else Path(out), rescued, ticks)
    except (InputError, *MALFORMED) as error:
        raise InputError(
            f"{path} cannot be recovered ({error}): too little of it is sound, or another program has rewritten it; "
            "make it again with `dpcontrol run` or with that program"
        ) from error
    check_replaced(recovery.log, rescued.metadata.get(layout.RUN_RECORD, {}), recovers=path, force=force)
    _write(rescued, tick, pieces, recovery)
    return recovery


def _free_name(path: Path) -> Path:
    """Return a free name for the recovered log: that of the log if only its partial file exists, else a similar one."""
    stem = re.sub(r"\.mcap((\.\d+-\d+)?\.partial)?$", "", path.name)
    endings = ("" if path.suffix == SUFFIX else "-recovered", "-recovered", *(f"-recovered-{k}" for k in range(2, 999)))
    return next(name for ending in endings if not (name := path.with_name(f"{stem}{ending}.mcap")).exists())


def _account(path: Path, log: Path, rescued: Salvage, measured: NDArray[Any]) -> Recovery:
    """List the recovered and the missing parts of the log, whose measured positions have these records.

    `path` is the damaged file, and `log` is the new log's path. `rescued` are the sound records.

    Raises:
        Exception: one of `MALFORMED`: there is no tick, or a record has other contents.
    """
    layout_values, result = rescued.metadata[layout.LAYOUT_RECORD], rescued.metadata.get(layout.RESULT_RECORD)
    period, names = 1 / float(layout_values["rate_hz"]), json.loads(layout_values["attachments"])
    ticks, end_s = len(measured), float(measured["log_time"][-1]) / 1e9
    missing = (int(measured["sequence"][-1]) + 1 if result is None else int(result[layout.TICKS])) - ticks
    attachments_lost = tuple(name for name in names if name not in rescued.attachments)
    largest_loss = 1e3 * max(LONGEST_CHUNK, period)
    losses = {
        rescued.metadata.get(layout.RECOVERY_RECORD, {}).get(layout.LOST, ""): True,
        f"{missing} ticks ({1e3 * missing * period:.0f} ms)": missing > 0,
        f"everything after {end_s:.3f} s (at most {largest_loss:.0f} ms if the run was killed)": result is None,
        f"the attachments {', '.join(attachments_lost)}": bool(attachments_lost),
        "the metadata of the run": layout.RUN_RECORD not in rescued.metadata,
    }
    return Recovery(
        source=path,
        log=log,
        ticks=ticks,
        end_s=end_s,
        ticks_lost=missing,
        milliseconds_lost=1e3 * missing * period,
        end_known=result is not None,
        attachments=tuple(name for name in rescued.attachments if name in names),
        attachments_lost=attachments_lost,
        lost="; ".join(loss for loss, applies in losses.items() if loss and applies),
    )


def _write(rescued: Salvage, tick: layout.TickLayout, pieces: Sequence[bytes], done: Recovery) -> None:
    """Write the new log from the sound records and the chunks `pieces`, read it back, and move it to its final name.

    `rescued` are the sound records, `tick` is the layout of the ticks, and `done` is the account of the recovery with
    the paths of both files. `pieces` are message records, in the order of their ticks.

    Raises:
        InputError: the new log cannot be written, or does not have the recovered ticks.
    """
    records = {**rescued.metadata, layout.RECOVERY_RECORD: {layout.LOST: done.lost, "source": done.source.name}}
    with whole_file(done.log) as temporary:
        file = McapFile(FileIO(temporary, "wb"), library=PROGRAM)
        for name, values in records.items():
            file.add_metadata(name, values)
        for name in done.attachments:
            file.add_attachment(name, rescued.attachments[name])
        file.add_channels(tick)
        for piece in pieces:
            file.add_chunk(piece)
        file.finish()
        if len(read_log(temporary).time) != done.ticks:
            raise InputError(f"{done.source} cannot be recovered: the rebuilt log differs")
