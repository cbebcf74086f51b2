"""Find the messages of a verified file, whole ticks at a time.

A tick's messages stand one after the other and their lengths are known from the layout, so that one look per tick
finds them all and one copy takes the numbers of thousands of ticks out.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import layout
from dpcontrol.logs.sealed import unsealed
from dpcontrol.logs.verified import VerifiedFile, note_channel

_RECORD = Struct("<BQH")
_BATCH_BYTES = 4_000_000


@dataclass(frozen=True)
class Batch:
    """The records of several chunks: offsets (K,) of whole ticks, and offsets of all other messages by channel."""

    data: bytes
    ticks: list[int]
    others: dict[int, list[int]]

    def ticks_as(self, tick: layout.TickLayout) -> NDArray:
        """Return the ticks (K,) as the layout's structured type.

        Raises:
            ValueError: their messages are not those of the layout.
        """
        rows = gathered(self.data, self.ticks, tick.block_type)
        times = rows[layout.MEASURED]["log_time"]
        for topic, message in tick.messages.items():
            records = rows[topic]
            length = layout.message_type(message).itemsize - 9
            for name, value in (
                ("opcode", layout.MESSAGE_OPCODE), ("length", length), ("channel", tick.channels[topic])
            ):  # fmt: skip
                if (records[name] != value).any():
                    raise ValueError(f"a tick lacks its message of {topic}")
            if (records["log_time"] != times).any():
                raise ValueError(f"the messages of {topic} do not pair with those of {layout.MEASURED}")
        return rows


def batches(file: VerifiedFile, tick: layout.TickLayout) -> Iterator[Batch]:
    """Yield a file's messages in order, those of several chunks at a time; channels declared there are noted.

    Raises:
        InputError: a chunk does not unpack.
        ValueError: a chunk's records do not follow one another.
    """
    pending, size = [], 0
    for content in file.contents():
        pending.append(content)
        size += len(content)
        if size >= _BATCH_BYTES:
            yield _batch(file, tick, b"".join(pending))
            pending, size = [], 0
    if pending:
        yield _batch(file, tick, b"".join(pending))


def _batch(file: VerifiedFile, tick: layout.TickLayout, data: bytes) -> Batch:
    ticks: list[int] = []
    others: dict[int, list[int]] = {}
    beginning, size = tick.block_template[: _RECORD.size], len(tick.block_template)
    place, end, unpack = 0, len(data), _RECORD.unpack_from
    while place < end:
        if data.startswith(beginning, place):
            ticks.append(place)
            place += size
            continue
        opcode, length, channel = unpack(data, place)
        if opcode == layout.MESSAGE_OPCODE:
            others.setdefault(channel, []).append(place)
        else:
            note_channel(file, opcode, data[place + 9 : place + 9 + length])
        place += 9 + length
    if place != end:
        raise ValueError("a record runs over the end of its chunk")
    return Batch(data, ticks, others)


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


def tick_layout_of(file: VerifiedFile) -> layout.TickLayout:
    """Return what a tick of a log holds, by its own description.

    Raises:
        InputError: it is no log of this program or of another version of it.
        LookupError, ValueError: the description is not as the writer makes it.
    """
    described = file.metadata.get(layout.LAYOUT_RECORD)
    if described is None:
        writer = f" (written by {file.library})" if file.library else ""
        raise InputError(
            f"{file.path}{writer} is not a log of dpcontrol: it lacks the metadata record {layout.LAYOUT_RECORD}; give "
            "a log of `dpcontrol run`"
        )
    if unsealed(layout.LAYOUT_RECORD, described) is None and described.get("format") == layout.FORMAT:
        raise ValueError(f"the checksum of {layout.LAYOUT_RECORD} differs")
    return described_layout(file.path, described)


def described_layout(path: Path, described: Mapping[str, str]) -> layout.TickLayout:
    """Return what a tick holds by a metadata record that describes it; errors as in `tick_layout_of`."""
    if described.get("format") != layout.FORMAT:
        raise InputError(
            f"{path} has layout {described.get('format')!r}, and this version of dpcontrol reads layout "
            f"{layout.FORMAT!r}; read it with the version that wrote it, or run the itinerary again"
        )
    parts = frozenset(described["parts"].split())
    if not parts <= set(layout.PARTS):
        raise ValueError(f"unknown parts {sorted(parts)}")
    return layout.TickLayout(len(described["arm_lengths"].split()), described["has_cart"] == "1", parts)


def check_channels(file: VerifiedFile, tick: layout.TickLayout) -> None:
    """Refuse a file whose channels are not those of the layout.

    Raises:
        InputError: names the topic and what it carries.
    """
    by_topic = {channel.topic: channel for channel in file.channels.values()}
    for topic, (name, definition) in tick.schemas.items():
        channel = by_topic.get(topic)
        schema = file.schemas.get(channel.schema_id) if channel else None
        encoding = channel.message_encoding if channel else ""
        number = channel.id if channel else None
        if schema is None or schema.data != definition or encoding != "cdr" or number != tick.channels[topic]:
            found = f"{schema.name if schema else 'no schema'} in {encoding or 'no encoding'}"
            raise InputError(
                f"{file.path}: topic {topic} carries {found}, not {name} in cdr as a log of `dpcontrol run` does"
            )
