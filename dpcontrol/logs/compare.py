"""Are two logs the same, message for message?"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from dpcontrol.logs import layout
from dpcontrol.logs.verified import (
    VerifiedFile,
    open_verified,
)

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
        InputError: one of them is missing, damaged or not a log of this program.
    """
    sides = [open_verified(Path(path)) for path in (one, other)]
    tick = sides[0].tick
    if tick != sides[1].tick:
        return Comparison(0, f"{one} and {other} do not have the same topics")
    partial = bool(sides[0].metadata.get(layout.RECOVERY_RECORD, {}).get(layout.LOST))
    first, second = (_pieces(side) for side in sides)
    same = 0
    for piece in first:
        for against in second:
            if piece == against:
                same += _count(piece, tick)
                break
            if not partial or _head(piece)[2:4] == _head(against)[2:4]:
                return Comparison(same, _differs(piece, against, tick))
        else:
            return Comparison(same, f"{other} ends after {same} messages, {one} goes on")
    if not partial and next(second, None) is not None:
        return Comparison(same, f"{one} ends after {same} messages, {other} goes on")
    return Comparison(same, None)


def _pieces(side: VerifiedFile) -> Iterator[bytes]:
    """Yield the bytes of each tick and of each other message, in order."""
    with side.decoding():
        for batch in side.batches():
            places = [(place, len(side.tick.block_template)) for place in batch.ticks]
            others = (place for offsets in batch.others.values() for place in offsets)
            places += [(place, 9 + int.from_bytes(batch.data[place + 1 : place + 9], "little")) for place in others]
            for place, length in sorted(places):
                yield batch.data[place : place + length]


def _count(piece: bytes, tick: layout.TickLayout) -> int:
    return len(tick.messages) if piece[:11] == tick.block_template[:11] else 1


def _head(piece: bytes, offset: int = 0) -> tuple[int, int, int, int, int]:
    """Return opcode, length, channel, sequence number and time of a message."""
    return _HEAD.unpack_from(piece, offset)


def _differs(piece: bytes, against: bytes, tick: layout.TickLayout) -> str:
    if _head(piece)[2:4] == _head(against)[2:4] and _count(piece, tick) > 1:
        ends = [*tick.block_offsets.values(), len(piece)]
        at = next(a for a, b in pairwise(ends) if piece[a:b] != against[a:b])
    else:
        at = 0
    _, _, channel, sequence, time = _head(piece, at)
    topic = next((name for name, number in tick.channels.items() if number == channel), f"channel {channel}")
    if _head(piece)[2:4] != _head(against)[2:4]:
        return f"at {time / 1e9:.3f} s another message stands where message {sequence} of {topic} was"
    return f"message {sequence} of {topic} at {time / 1e9:.3f} s differs"
