"""A log written again by the mcap package's own writer, one message at a time: what our writer is compared with.

Messages come ready-made, so that what is timed is the writer alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from io import BufferedWriter, RawIOBase
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from dpcontrol.logs.layout import MEASURED


@dataclass(frozen=True)
class Messages:
    """The messages of a log in their order, with the schemas and channels that they need."""

    schemas: tuple[Schema, ...]
    channels: tuple[Channel, ...]
    messages: tuple[Message, ...]

    @property
    def ends(self) -> tuple[int, ...]:
        """For each tick, how many messages there are up to its last one."""
        measured = next(c.id for c in self.channels if c.topic == MEASURED)
        starts = [k for k, message in enumerate(self.messages) if message.channel_id == measured]
        return (*starts[1:], len(self.messages))


def messages_of(path: Path) -> Messages:
    """Return the messages of a whole log."""
    with path.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        messages = tuple(message for _, _, message in reader.iter_messages(log_time_order=False))
    if summary is None:
        raise ValueError(f"{path} has no summary: it is not whole")
    return Messages(tuple(summary.schemas.values()), tuple(summary.channels.values()), messages)


class MessageWriter:
    """The package's writer on an unbuffered stream, with chunks of `chunk_bytes`; "zstd" or "none".

    It buffers what it writes to a bare stream, so that it is given a buffer that can be emptied.
    """

    def __init__(self, stream: RawIOBase, known: Messages, *, chunk_bytes: int, compression: str = "zstd") -> None:
        kind = {"zstd": CompressionType.ZSTD, "none": CompressionType.NONE}[compression]
        self._buffer = BufferedWriter(stream)
        self._writer = Writer(self._buffer, chunk_size=chunk_bytes, compression=kind, enable_data_crcs=True)
        self._writer.start(profile="ros2")
        schemas = {s.id: self._writer.register_schema(s.name, s.encoding, s.data) for s in known.schemas}
        self._channels = {
            c.id: self._writer.register_channel(c.topic, c.message_encoding, schemas[c.schema_id])
            for c in known.channels
        }

    def add(self, messages: Sequence[Message]) -> None:
        """Write messages, one after the other, and hand whole chunks to the system."""
        for m in messages:
            self._writer.add_message(self._channels[m.channel_id], m.log_time, m.data, m.publish_time, m.sequence)
        self._buffer.flush()

    def finish(self) -> None:
        """Write the end of the file."""
        self._writer.finish()
        self._buffer.flush()


def ticks_left(path: Path) -> int:
    """Return how many ticks can be read of a file that may be cut anywhere."""
    count, measured = 0, set()
    with path.open("rb") as stream:
        try:
            for record in StreamReader(stream).records:
                if isinstance(record, Channel) and record.topic == MEASURED:
                    measured.add(record.id)
                count += isinstance(record, Message) and record.channel_id in measured
        except (McapError, EOFError):
            return count
    return count
