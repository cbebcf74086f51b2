"""What a bench and its loop say to each other over UDP, version 1.

Little-endian, one packet a datagram. Every packet begins with a head of eight bytes:

    magic 4 bytes "dpcb", version u8, kind u8, count u16

    kind         from    count                    then
    HELLO    1   loop    commands that follow     f64 each: m/s², on their way when the run begins, oldest first
    WELCOME  2   bench   arms                     f64 period s, u32 ticks that the bench can run for
    START    7   loop    0                        nothing: the loop is ready for the first reading
    READING  3   bench   arms                     u32 tick, u32 tick of the newest command heard (no tick: 2³²-1),
                                                  u32 periods that had to do with an old command, f64 s from that
                                                  reading to its command, i8 switch, u8 condition, u16 bytes of a
                                                  sentence, f64 positions (arms, then the cart), the sentence
    COMMAND  4   loop    0                        u32 tick of the reading that it answers, f64 acceleration m/s²
    STOP     5   loop    0                        nothing: brake to a standstill
    BYE      6   both    bytes of a sentence      the sentence: the run is over

A lost packet is not sent again, and a packet counts once: READING and COMMAND carry the tick that they belong to.
"""

import socket
import struct
from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple

MAGIC, VERSION = b"dpcb", 1
LARGEST = 4096
"""Bytes of a datagram at most."""
_LONGEST_TEXT = 2048
NO_TICK = 2**32 - 1

_HEAD = struct.Struct("<4sBBH")
_WELCOME = struct.Struct("<dI")
_READING = struct.Struct("<IIIdbBH")
_COMMAND = struct.Struct("<Id")


class Kind(IntEnum):
    """What a packet is."""

    HELLO = 1
    WELCOME = 2
    READING = 3
    COMMAND = 4
    STOP = 5
    BYE = 6
    START = 7


class Condition(IntEnum):
    """How the bench is."""

    WELL = 0
    FAULT = 1
    """It has failed, as the sentence says."""
    SILENCE = 2
    """It heard nothing from the loop for too long and has stopped the cart."""


class Hello(NamedTuple):
    """A loop wants a run: the commands on their way when it begins, m/s², oldest first."""

    queued: tuple[float, ...]


class Welcome(NamedTuple):
    """The bench is ready: arms, period s, ticks that it can run for."""

    arms: int
    period: float
    ticks: int


class ReadingPacket(NamedTuple):
    """What the sensors said at `tick`: positions, absolute angles in rad, then the cart's in m.

    heard: tick of the newest command that has come, -1 for none; held: periods so far in which no new one came; trip s:
    from the reading `heard` to its command; switch -1, 0, +1; condition of the bench, and a sentence on it.
    """

    tick: int
    positions: tuple[float, ...]
    heard: int
    held: int
    trip: float
    switch: int
    condition: Condition
    text: str


class CommandPacket(NamedTuple):
    """The cart's wanted acceleration, m/s², in answer to the reading of `tick`."""

    tick: int
    acceleration: float


def _packed(kind: Kind, count: int = 0, *rest: bytes) -> bytes:
    return b"".join([_HEAD.pack(MAGIC, VERSION, kind, count), *rest])


def hello(queued: Sequence[float]) -> bytes:
    """Return the packet that begins a run, with the commands on their way (m/s²), oldest first."""
    return _packed(Kind.HELLO, len(queued), struct.pack(f"<{len(queued)}d", *queued))


def welcome(content: Welcome) -> bytes:
    """Return the bench's answer to HELLO."""
    return _packed(Kind.WELCOME, content.arms, _WELCOME.pack(content.period, content.ticks))


def start() -> bytes:
    """Return the packet that lets the first tick come."""
    return _packed(Kind.START)


def reading(content: ReadingPacket) -> bytes:
    """Return the packet of one tick."""
    text = content.text.encode()[:_LONGEST_TEXT]
    count, heard = len(content.positions), NO_TICK if content.heard < 0 else content.heard
    body = _READING.pack(content.tick, heard, content.held, content.trip, content.switch, content.condition, len(text))
    return _packed(Kind.READING, count - 1, body, struct.pack(f"<{count}d", *content.positions), text)


def command(tick: int, acceleration: float) -> bytes:
    """Return the packet that answers the reading of `tick`, acceleration in m/s²."""
    return _packed(Kind.COMMAND, 0, _COMMAND.pack(tick, acceleration))


def stop() -> bytes:
    """Return the packet that stops the cart."""
    return _packed(Kind.STOP)


def bye(text: str) -> bytes:
    """Return the packet that ends a run, and why."""
    said = text.encode()[:_LONGEST_TEXT]
    return _packed(Kind.BYE, len(said), said)


Packet = Hello | Welcome | ReadingPacket | CommandPacket | str | None
"""Of BYE the sentence, of STOP and START None."""


def unpacked(data: bytes) -> tuple[Kind, Packet]:
    """Return a packet's kind and content.

    Raises:
        ValueError: it is not of version 1, or damaged; says how.
    """
    if len(data) < _HEAD.size:
        raise ValueError(f"a packet of {len(data)} bytes has no head")
    magic, version, number, count = _HEAD.unpack_from(data)
    if magic != MAGIC:
        raise ValueError(f"a packet that begins with {magic!r} is not from a bench")
    if version != VERSION:
        raise ValueError(f"the packet's version is {version}, this program speaks {VERSION}")
    try:
        kind = Kind(number)
        content = _content(kind, data, count)
    except (struct.error, UnicodeDecodeError) as error:
        raise ValueError(f"a packet of kind {number} is damaged: {error}") from error
    return kind, content


def _content(kind: Kind, data: bytes, count: int) -> Packet:
    at = _HEAD.size
    if kind is Kind.READING:
        tick, heard, held, trip, switch, condition, size = _READING.unpack_from(data, at)
        at += _READING.size
        positions = struct.unpack_from(f"<{count + 1}d", data, at)
        text = _text(data, at + 8 * (count + 1), size) if size else ""
        heard = -1 if heard == NO_TICK else heard
        return ReadingPacket(tick, positions, heard, held, trip, switch, Condition(condition), text)
    if kind is Kind.COMMAND:
        return CommandPacket(*_COMMAND.unpack_from(data, at))
    if kind is Kind.HELLO:
        return Hello(struct.unpack_from(f"<{count}d", data, at))
    if kind is Kind.WELCOME:
        return Welcome(count, *_WELCOME.unpack_from(data, at))
    return _text(data, at, count) if kind is Kind.BYE else None


def _text(data: bytes, at: int, size: int) -> str:
    if len(data) < at + size:
        raise struct.error(f"{size} bytes of text were announced, {len(data) - at} came")
    return data[at : at + size].decode()


def received(sock: socket.socket) -> tuple[Kind | None, Packet, Any]:
    """Return kind, content and sender of the packet that waits; no kind where it is malformed.

    Raises:
        OSError: none waits, or the other end is gone.
    """
    data, sender = sock.recvfrom(LARGEST)
    try:
        return (*unpacked(data), sender)
    except ValueError:
        return None, None, sender
