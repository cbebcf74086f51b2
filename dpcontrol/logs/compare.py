"""Are two logs the same, message for message?"""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Channel

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import layout
from dpcontrol.logs.reader import batches
from dpcontrol.logs.verified import MALFORMED, VerifiedFile, damaged, open_verified

_HEAD = struct.Struct("<BQHIQ")


@dataclass(frozen=True)
class Comparison:
    """Two logs side by side: how many messages are the same, and the first that is not, as a sentence, or None."""

    messages: int
    difference: str | None


def compare_messages(one: Path | str, other: Path | str) -> Comparison:
    """Compare two logs message by message: topics, order, times and every byte; metadata may differ.

    What `one` has lost, if it was recovered, or if it ends early, is passed over in `other`.

    Raises:
        InputError: one of them is missing, damaged or no log of this program.
    """
    one, other = Path(one), Path(other)
    sides = [open_verified(path) for path in (one, other)]
    for side in sides:
        if layout.LAYOUT_RECORD not in side.metadata:
            raise InputError(f"{side.path} is not a log of dpcontrol: it lacks {layout.LAYOUT_RECORD}")
    partial = bool(sides[0].metadata.get(layout.RECOVERY_RECORD, {}).get(layout.LOST))
    first, second = (_messages(path, side) for path, side in zip((one, other), sides, strict=True))
    same = 0
    for record in first:
        for against in second:
            if record == against:
                same += 1
                break
            if not partial or _identity(record) == _identity(against):
                return Comparison(same, _differs(record, against, sides[0].channels))
        else:
            return Comparison(same, f"{other} ends after {same} messages, {one} goes on")
    if not partial and next(second, None) is not None:
        return Comparison(same, f"{one} ends after {same} messages, {other} goes on")
    return Comparison(same, None)


def _messages(path: Path, side: VerifiedFile) -> Iterator[bytes]:
    try:
        for data, places in batches(side):
            for place in sorted(place for offsets in places.values() for place in offsets):
                yield data[place : place + 9 + int.from_bytes(data[place + 1 : place + 9], "little")]
    except MALFORMED as error:
        damaged(path, f"its messages do not decode: {error}", cause=error)


def _identity(record: bytes) -> tuple[int, int]:
    _, _, channel, sequence, _ = _HEAD.unpack_from(record)
    return channel, sequence


def _differs(record: bytes, against: bytes, channels: Mapping[int, Channel]) -> str:
    _, _, channel, sequence, time = _HEAD.unpack_from(record)
    topic = channels[channel].topic if channel in channels else f"channel {channel}"
    if _identity(record) != _identity(against):
        return f"at {time / 1e9:.3f} s another message stands where message {sequence} of {topic} was"
    return f"message {sequence} of {topic} at {time / 1e9:.3f} s differs"
