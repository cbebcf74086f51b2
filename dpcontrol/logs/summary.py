"""What is in a log, topic by topic, without reading its numbers."""

from dataclasses import dataclass
from pathlib import Path

from dpcontrol.logs import layout
from dpcontrol.logs.decoding import batches, check_channels, gathered, tick_layout_of
from dpcontrol.logs.partial import partials_of
from dpcontrol.logs.sealed import unsealed
from dpcontrol.logs.verified import MALFORMED, VerifiedFile, damaged, open_verified


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
        InputError: the file is missing, cut off, damaged or no log of this program.
    """
    path = Path(path)
    file = open_verified(path)
    try:
        return _summary(path, file)
    except MALFORMED as error:
        damaged(path, f"its messages do not decode: {error}", cause=error)


def _summary(path: Path, file: VerifiedFile) -> LogSummary:
    tick = tick_layout_of(file)
    described = file.metadata[layout.LAYOUT_RECORD]
    spans: dict[int, tuple[int, int, int]] = {}
    for batch in batches(file, tick):
        check_channels(file, tick)
        ticks = gathered(batch.data, batch.ticks, layout.RECORD_HEADER)
        found = {tick.channels[topic]: ticks for topic in tick.messages}
        found |= {k: gathered(batch.data, places, layout.RECORD_HEADER) for k, places in batch.others.items()}
        for channel, heads in found.items():
            if len(heads):
                low, high = int(heads["log_time"].min()), int(heads["log_time"].max())
                count, first, last = spans.get(channel, (0, low, high))
                spans[channel] = (count + len(heads), min(first, low), max(last, high))
    said = {name: unsealed(name, record) or {} for name, record in file.metadata.items()}
    ends = [(first, last) for _, first, last in spans.values()]
    return LogSummary(
        log=str(path),
        size=path.stat().st_size,
        format=described["format"],
        program=described["program"],
        duration=(max(last for _, last in ends) - min(first for first, _ in ends)) / 1e9 if ends else 0.0,
        rate_hz=float(described["rate_hz"]),
        joints=tick.names,
        parts=tuple(part for part in layout.PARTS if part in tick.parts),
        topics=tuple(
            _topic(topic, kind, units=layout.UNITS[topic], span=spans.get(tick.channels[topic]))
            for topic, (kind, _) in tick.schemas.items()
        ),
        attachments={name: len(data) for name, data in file.attachments.items()},
        metadata={**said.get(layout.RESULT_RECORD, {}), **said.get(layout.RUN_RECORD, {})},
        recovered=said.get(layout.RECOVERY_RECORD, {}).get(layout.LOST) or None,
        partials=tuple(str(file) for file in partials_of(path)),
    )


def _topic(topic: str, kind: str, *, units: str, span: tuple[int, int, int] | None) -> TopicSummary:
    if span is None:
        return TopicSummary(topic, kind, units, 0, None, None, None)
    count, first, last = span
    rate = (count - 1) * 1e9 / (last - first) if last > first else None
    return TopicSummary(topic, kind, units, count, first / 1e9, last / 1e9, rate)
