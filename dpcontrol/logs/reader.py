"""Read a log into arrays, or compare two logs message by message.

No record is trusted before the checksums agree. Checking indexes and single chunks is not enough: an index can point
elsewhere, and two chunks can be swapped without invalidating their checksums. The mcap package therefore reads the file
from front to back and compares the checksums of the data section and of each chunk; that of the summary is compared
here.

The messages of a log that another program has rewritten are read by topic (`dpcontrol.logs.rewritten`).
Source: the MCAP format specification, version 0.
"""

import zlib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Header, Metadata, Schema
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError, remark
from dpcontrol.foundation.files import UNREADABLE, InTheWay, checked_size, checked_source, in_the_way
from dpcontrol.foundation.rendering import DataFrame
from dpcontrol.foundation.shown import Brief, Shown, data_frame
from dpcontrol.logs import layout
from dpcontrol.logs.container import MAGIC, declarations, located, partials_of, unsealed
from dpcontrol.logs.rewritten import Batch, Topic, by_topic, ticks_in

_TOGETHER = 200
"""Number of chunks that are read in one step."""
LARGEST_CHUNK, LARGEST_LOG = 1 << 28, 1 << 33
"""Greatest unpacked size of a chunk and of a log, bytes: five hours at 1 kHz."""
_AGAIN = "make it again with `dpcontrol run`"
_AS_WRITTEN = "give the log as `dpcontrol run` wrote it"
MALFORMED = (*UNREADABLE, McapError, zstandard.ZstdError)
"""Exceptions raised when a malformed record is parsed."""


@dataclass
class VerifiedFile:
    """The records of an MCAP file whose checksums agree, before they are decoded.

    Attributes:
        path: file that was read.
        data: its bytes.
        records: records outside of chunks, and packed chunks, by type.
    """

    path: Path
    data: bytes
    records: Mapping[type, list[Any]]

    @contextmanager
    def decoding(self) -> Iterator[None]:
        """Report errors of decoding within the block as damage of this file.

        Raises:
            InputError: the block raised one of `MALFORMED`.
        """
        try:
            yield
        except MALFORMED as error:
            reason = next(iter(str(error).splitlines()), type(error).__name__)
            raise InputError(
                f"{self.path} is damaged ({reason}); copy it again from its source, write it again with the program "
                f"that wrote it, or {_recover(self.path)}"
            ) from error

    def values(self, name: str) -> dict[str, str]:
        """Return the values of a metadata record, none if the record is missing or its checksum differs.

        Args:
            name: name of the record.
        """
        records = {record.name: record.metadata for record in self.records[Metadata]}
        return unsealed(name, records.get(name, {})) or {}

    @property
    def attachments(self) -> dict[str, bytes]:
        """Content of the attachments, by name."""
        return {record.name: record.data for record in self.records[Attachment]}

    @cached_property
    def tick(self) -> layout.TickLayout:
        """Layout of the log's ticks, from its own metadata."""
        return described_layout(self.path, self.values(layout.LAYOUT_RECORD))

    @property
    def is_native(self) -> bool:
        """True if this program wrote the file and its channels are those of its layout."""
        written_by_dpcontrol = (
            self.records[Header][0].library.startswith("dpcontrol ") and self.records[DataEnd][0].data_section_crc
        )
        declared = [*self.records[Schema], *self.records[Channel]]
        return bool(written_by_dpcontrol and self.values(layout.LAYOUT_RECORD)) and declared == declarations(self.tick)

    def topics(self) -> dict[str, Topic]:
        """Return the messages by topic, for logs that another program has rewritten.

        Raises:
            InputError: a message is damaged.
        """
        with self.decoding():
            return by_topic(
                NonSeekingReader(BytesIO(self.data), validate_crcs=True).iter_messages(log_time_order=False)
            )


class _Records(StreamReader):
    """Reads all records but indexes of messages, whose entries the mcap package reads one by one."""

    def _read_record(self, opcode: int, length: int) -> Any:
        """Return the record of this opcode and length from the stream as an object of the mcap package.

        An index of messages is skipped, and the result is None.
        """
        if opcode != Opcode.MESSAGE_INDEX:
            return super()._read_record(opcode, length)
        self._stream.read(length)
        return None


def unpacked(chunk: Chunk) -> bytes:
    """Return the records in a chunk as bytes, after checking its checksum.

    Args:
        chunk: the chunk.

    Raises:
        Exception: one of `MALFORMED`: the chunk does not unpack, or its checksum differs.
    """
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    return stream.read(size)


def recorded_bytes(path: Path) -> bytes:
    """Return the bytes of a log, damaged or not.

    Args:
        path: the file.

    Raises:
        InputError: the file is missing or unreadable.
    """
    try:
        return checked_source(path).read_bytes()
    except FileNotFoundError as error:
        partials = partials_of(path)
        remedy = f"a run left {partials[-1]}: {_recover(partials[-1])}" if partials else f"check the name or {_AGAIN}"
        raise InputError(f"there is no log {path}; {remedy}") from error
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}; give the path of a .mcap file") from error


def _recover(path: Path) -> str:
    """Return the remedy for a damaged log, as a part of error messages."""
    return f"`dpcontrol recover {path}` rebuilds a log from the rest"


def open_mcap(path: Path) -> VerifiedFile:
    """Read an MCAP file of any contents, and compare its checksums before anything is decoded.

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
    file, stream = VerifiedFile(path, data, defaultdict(list)), BytesIO(data)
    with file.decoding():
        for record in _Records(stream, emit_chunks=True, validate_crcs=True).records:
            file.records[type(record)].append(record)
        footer = file.records[Footer][0]
        # Without a summary, its checksum is that of the footer. The last 12 bytes are the checksum and the file's end.
        summary = data[footer.summary_start or len(data) - _FOOTER : -12]
        if stream.read(1) or footer.summary_crc not in (0, zlib.crc32(summary)):
            raise ValueError("the checksum of the summary differs")
        sizes = [chunk.uncompressed_size for chunk in file.records[Chunk]]
        checked_size(max(sizes, default=0), most=LARGEST_CHUNK)
        checked_size(sum(sizes), most=LARGEST_LOG)
    return file


_FOOTER = 37
"""Length of the footer with the file's last bytes."""


def _batches(file: VerifiedFile) -> Iterator[Batch]:
    """Yield the messages of a native log in order, `_TOGETHER` chunks at a time, to save memory."""
    chunks = file.records[Chunk]
    for first in range(0, len(chunks), _TOGETHER):
        data = b"".join(map(unpacked, chunks[first : first + _TOGETHER]))
        messages = located(data, file.tick, file.tick.types)
        # Events have different lengths, so only their heads are in the table.
        events = []
        for start, record_head in zip(*messages[layout.EVENTS], strict=True):
            end = start + layout.LENGTH_FROM + int(record_head["length"])
            events.append((int(record_head["log_time"]), data[start + layout.RECORD_HEADER.itemsize : end]))
        tables = {topic: located_messages.records for topic, located_messages in messages.items()}
        yield Batch(tables, {topic: table["log_time"] for topic, table in tables.items()}, events)


def described_layout(path: Path, described: Mapping[str, str]) -> layout.TickLayout:
    """Return the tick layout in a metadata record, with the errors of `VerifiedFile.tick`.

    Args:
        path: path of the log, for messages.
        described: values of the metadata record `LAYOUT_RECORD`, by key.
    """
    if described.get("format") != layout.FORMAT:
        raise InputError(
            f"{path} is not a log of `dpcontrol run` with layout {layout.FORMAT} (its metadata record "
            f"{layout.LAYOUT_RECORD} is of layout {described.get('format', 'none')}); read it with the version that "
            "wrote it, or make a recording of it with `dpcontrol import`"
        )
    return layout.TickLayout.of(described)


@dataclass(frozen=True, eq=False)
class Extras(Brief):
    """Parameters estimated in addition to the state, as the log has them.

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
        topics: summary of each topic.
    """

    path: Path
    time: Array
    measured: Array
    rates: Array | None
    states: dict[str, Array]
    controls: dict[str, Array]
    events: tuple[layout.Event, ...]
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
    topics: "tuple[TopicSummary, ...]" = ()

    def __repr__(self) -> str:
        return f"<log {self.path}: {len(self.time):,} rows at {self.rate_hz:g} Hz>"

    def document(self) -> dict[str, Any]:
        """Return the contents of the log without its rows; the size of a log in memory is None."""
        return {
            "log": self.path, "size": self.path.stat().st_size if self.path.is_file() else None,
            "format": layout.FORMAT,
            "program": self.metadata.get("program"), "rows": len(self.time),
            "duration": float(np.ptp(self.time)) if len(self.time) else 0.0,
            "rate_hz": self.rate_hz, "joints": self.joint_names,
            "parts": [part for part in layout.PARTS if part in self.parts], "events": len(self.events),
            "topics": self.topics, "attachments": {name: len(data) for name, data in self.attachments.items()},
            "metadata": {name: value for name, value in self.metadata.items() if name != "program"},
            "recovered": self.recovered, "partials": partials_of(self.path), "rewritten": self.rewritten,
        }  # fmt: skip

    @property
    def segments(self) -> tuple[tuple[int, int], ...]:
        """First and end rows of a recording's segments, none for a run or if they do not fit the rows."""
        return segments_in(self.metadata.get("segments", ""), len(self.time))

    @property
    def parts(self) -> frozenset[str]:
        """Members of "rates", "estimate", "reference", "truth", "control" in the log.

        Every log has `measured`.
        """
        present = {"control": bool(self.controls), "rates": self.rates is not None}
        return frozenset({*self.states, *(part for part, present_part in present.items() if present_part)})

    @property
    def truth(self) -> Array | None:
        """True states of the plant (N, 2n+2), or None if they are unknown, as on a rig."""
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
        # No log has states of this name, so the call raises the error.
        return self.controls or self._state("control")

    def _state(self, part: str) -> Any:
        """Return the states (N, 2n+2) of a part of the log, "estimate", "reference" or "truth".

        Raises:
            InputError: the log does not have this part.
        """
        if part not in self.states:
            raise InputError(
                f"{self.path} has no {layout.STATE_TOPICS.get(part, layout.CONTROL)}: it is a recording, not a run, or "
                f"another program has left the topic out; {_AS_WRITTEN}"
            )
        return self.states[part]

    def frame(self) -> DataFrame:
        """Return a pandas table with one row per tick.

        Its index is `time` in s.

        Columns, if the log has them: `measured.arm_1` …, `rates.arm_1` …, `estimate.angle_1`, `estimate.rate_1`,
        `estimate.cart_position`, `estimate.cart_velocity`, the same for `reference` and `truth`, `control.command` ….
        `extra.zero_1` and `sigma.zero_1` … hold the last logged values. `segment` numbers the segments of a recording.

        Raises:
            PartMissing: pandas is not installed.
        """
        states = layout.state_names(len(self.arm_lengths), has_cart=self.has_cart)
        groups: dict[str, tuple[Sequence[str], Array]] = {"measured": (self.joint_names, self.measured)}
        if self.rates is not None:
            groups["rates"] = (self.joint_names, self.rates)
        groups |= {part: (states, values) for part, values in self.states.items()}
        groups["control"] = (tuple(self.controls), np.transpose(list(self.controls.values())))
        if self.extras is not None:
            last_logged = np.searchsorted(self.extras.time, self.time, side="right") - 1
            for prefix, values in (("extra", self.extras.values), ("sigma", self.extras.sigmas)):
                groups[prefix] = (self.extras.names, np.where((last_logged >= 0)[:, None], values[last_logged], np.nan))
        columns: dict[str, Any] = {
            f"{prefix}.{name}": values[:, i]
            for prefix, (names, values) in groups.items()
            for i, name in enumerate(names)
        }
        if self.segments:
            columns["segment"] = segment_numbers(self.segments, len(self.time))
        return data_frame(columns, times=self.time)


def segments_in(text: str, rows: int) -> tuple[tuple[int, int], ...]:
    """Return first and end row of each segment from a recording's metadata, or none if they do not fit the rows.

    Args:
        text: pairs as `write_recording` writes them, "0:300 300:600".
        rows: number of samples.
    """
    numbers = [int(number) for number in text.replace(":", " ").split()]
    segments = tuple(zip(numbers[::2], numbers[1::2], strict=False))
    return segments if all(0 <= first < end <= rows for first, end in segments) else ()


def segment_numbers(segments: Sequence[tuple[int, int]], rows: int) -> NDArray[np.intp]:
    """Return the number of each row's segment (K,), from 0, as a column of tables.

    Args:
        segments: first and end row of each segment, in order.
        rows: number of rows K.
    """
    return np.searchsorted([first for first, _ in segments], np.arange(rows), side="right") - 1


_LATEST = np.iinfo(np.int64).max
"""ns: viewers and arrays of times hold signed nanoseconds."""


def _joined(parts: Sequence[dict[str, NDArray]]) -> dict[str, NDArray]:
    """Return the arrays of all parts of a log, joined by name and read-only."""
    # Each array is removed from its part as it is joined, so that a long log is held only once.
    arrays = {name: np.concatenate([part.pop(name) for part in parts]) for name in list(parts[0])}
    for array in arrays.values():
        array.flags.writeable = False
    return arrays


def _rows(batch: Batch, tick: layout.TickLayout) -> dict[str, Array]:
    """Return a batch's ticks as arrays: times (K,), s, rows (K, …) by part, and the extras (M, …) after their times.

    `tick` is the layout of the log's ticks.
    """
    tables, widths = batch.tables, tick.widths
    arrays = {part: np.empty((len(tables[layout.MEASURED]), widths[part])) for part in ("measured", *tick.parts)}
    for topic, field_name, joints, part, columns in tick.rooms:
        arrays[part][:, columns] = tables[topic][field_name][:, joints]
    arrays["time"] = tables[layout.MEASURED]["log_time"] / 1e9
    if tick.extras:
        extras = tables[layout.EXTRAS]
        arrays["extras"] = np.column_stack([extras["log_time"] / 1e9, extras["row"]])
    return arrays


def _rewritten(file: VerifiedFile) -> tuple[layout.TickLayout, dict[str, str], list[Batch]]:
    """Return layout, types of topics and messages of a log that another program has rewritten.

    A remark tells the user which program it was, and which topics the log lacks.

    Raises:
        InputError: the file holds no run, or several.
    """
    topics, writer = file.topics(), file.records[Header][0].library or "another program"
    try:
        tick, batch = ticks_in(topics, file.tick)
    except MALFORMED as error:
        raise InputError(
            f"{file.path} (written by {writer}) is not a log of `dpcontrol run`: {error}; {_AS_WRITTEN}, or make a "
            "recording of it with `dpcontrol import`"
        ) from error
    left_out = ", ".join(topic for topic in file.tick.schemas if topic not in topics)
    remark(
        f"{file.path} was rewritten by {writer} and is read by its topics; its integrity cannot be checked"
        f"{f', and it lacks {left_out}' if left_out else ''}"
    )
    return tick, {**tick.kinds, **{name: topic.schema for name, topic in topics.items()}}, [batch]


def read_log(path: Path | str) -> RunLog:
    """Return the run in a log with its arrays; a log that another program has rewritten is read by its topics.

    Args:
        path: the log.

    Raises:
        InputError: the file is missing, empty, cut off, damaged, not an MCAP file or not a log of a run.
    """
    file = open_mcap(Path(path))
    with file.decoding():
        is_native = file.is_native
        tick, message_types, batches = (file.tick, file.tick.kinds, _batches(file)) if is_native else _rewritten(file)
        row_batches, time_batches, events = zip(
            *((_rows(batch, tick), batch.times, batch.events) for batch in batches), strict=True
        )
        rows, times = _joined(row_batches), _joined(time_batches)
        logged_events = tuple(layout.logged_event(time / 1e9, content) for part in events for time, content in part)
        if any((time > _LATEST).any() for time in times.values()):
            raise ValueError(f"a message is later than {_LATEST / 1e9:.3g} s")
    if not len(rows["time"]):
        raise InputError(f"{file.path} holds no ticks: the run ended before its first; {_AGAIN}")
    described, result = file.values(layout.LAYOUT_RECORD), file.values(layout.RESULT_RECORD)
    ticks = result.get(layout.TICKS)
    columns = rows["control"].T if "control" in rows else ()
    # Columns of the extras: time, then all standard deviations, then all values.
    extras, extra_count = rows.get("extras", np.empty((0, 1))), len(tick.extras)
    return RunLog(
        path=file.path,
        time=rows["time"],
        measured=rows["measured"],
        rates=rows.get("rates"),
        states={part: rows[part] for part in layout.STATE_TOPICS if part in rows},
        controls=dict(zip(tick.fields, columns, strict=False)),
        events=logged_events,
        metadata={**result, **file.values(layout.RUN_RECORD), "program": described["program"]},
        attachments=file.attachments,
        joint_names=tick.names,
        arm_lengths=tick.arm_lengths,
        has_cart=tick.has_cart,
        rate_hz=tick.rate_hz,
        limits=tick.limits,
        recovered=file.values(layout.RECOVERY_RECORD).get(layout.LOST) or None,
        extras=Extras(tick.extras, extras[:, 0], extras[:, 1 + extra_count :], extras[:, 1 : 1 + extra_count])
        if len(extras)
        else None,
        rewritten=not is_native,
        end_s=(int(ticks) - 1) / file.tick.rate_hz if ticks else None,
        topics=tuple(_topic(topic, kind, times.get(topic, np.empty(0))) for topic, kind in message_types.items()),
    )


_INCIDENTAL = ("version", "commit", "plan", "plant_parameters", "drawn")
"""Keys of a run's record that do not determine the run."""


def check_replaced(
    path: Path | str, metadata: Mapping[str, str], *, recovers: Path | None = None, force: bool = False
) -> None:
    """Reject an existing file that the same command would not make.

    The record of the run identifies the command. A log from a rig is always rejected, because it cannot be repeated.

    Args:
        path: path of the new log.
        metadata: metadata of the run in the new log: settings, seed, hashes.
        recovers: damaged log from which the new one is recovered, or None.
        force: replace any file.

    Raises:
        InputError: another log or file exists.
    """
    path = Path(path)
    if force or not path.is_file():
        return
    try:
        file = open_mcap(path)
    except InputError as error:
        raise in_the_way(path, "is not a complete log") from error
    existing, recovery = file.values(layout.RUN_RECORD), file.values(layout.RECOVERY_RECORD)
    if "rig" in {**file.values(layout.RESULT_RECORD), **existing}:
        raise in_the_way(path, "is a log from a rig")
    differing = _differing(metadata, existing)
    if differing or recovery.get("source") != (recovers and recovers.name):
        raise in_the_way(path, f"holds another log{f' (not the same: {differing})' if differing else ''}")


def _differing(metadata: Mapping[str, str], existing: Mapping[str, str], *, also: tuple[str, ...] = ()) -> str:
    """Return the keys, separated by commas, whose values differ between the records of two runs.

    Incidental keys and those in `also` are not compared.
    """
    names = [name for name in {**metadata, **existing} if name not in (*_INCIDENTAL, *also)]
    return ", ".join(name for name in names if metadata.get(name) != existing.get(name))


def check_same_run(path: Path, metadata: Mapping[str, str], *, also: tuple[str, ...] = ()) -> None:
    """Reject the log of a run that a different command made, before a resumed night continues it.

    Args:
        path: the existing log.
        metadata: metadata of the run.
        also: keys that are not compared either.

    Raises:
        InTheWay: entries differ.
        InputError: the log is not readable.
    """
    if differing := _differing(metadata, open_mcap(path).values(layout.RUN_RECORD), also=also):
        raise InTheWay(
            f"{path} is of another run (not the same: {differing}); go on with the command and the options that made it"
        )


@dataclass(frozen=True)
class TopicSummary:
    """Summary of the messages of one topic, for the overview of a log.

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


def _topic(topic: str, kind: str, times: NDArray) -> TopicSummary:
    """Return the summary of a topic with messages of type `kind` at `times` (K,), ns."""
    first, last = (float(end(times)) / 1e9 if len(times) else None for end in (np.min, np.max))
    span = 0.0 if first is None or last is None else last - first
    rate = (len(times) - 1) / span if span > 0 else None
    return TopicSummary(topic, kind, layout.UNITS.get(topic, ""), len(times), first, last, rate)


@dataclass(frozen=True)
class Comparison:
    """Comparison of two logs: number of equal messages, and a sentence on the first difference, or None."""

    messages: int
    difference: str | None


def compare_messages(first_path: Path | str, other: Path | str) -> Comparison:
    """Compare two logs topic by topic, as a check that a run is repeatable.

    Times and every byte of each message count; metadata may differ. If `first_path` was recovered or another program
    has rewritten one of them, the messages that `first_path` lacks are skipped.

    Args:
        first_path: a log.
        other: another log.

    Raises:
        InputError: a log is missing, damaged or not of this program.
    """
    files = [open_mcap(Path(path)) for path in (first_path, other)]
    if files[0].tick != files[1].tick:
        return Comparison(0, f"{first_path} and {other} do not have the same topics")
    complete = all(side.is_native and not side.values(layout.RECOVERY_RECORD).get(layout.LOST) for side in files)
    first, second = (
        {name: set(zip(topic.times, topic.bodies, strict=True)) for name, topic in side.topics().items()}
        for side in files
    )
    equal = sum(len(messages & second.get(name, set())) for name, messages in first.items())
    for name in files[0].tick.schemas:
        messages, second_messages = first.get(name, set()), second.get(name, set())
        if differing := messages ^ second_messages if complete else messages - second_messages:
            return Comparison(equal, f"the message of {name} at {min(differing)[0] / 1e9:.3f} s differs")
    return Comparison(equal, None)
