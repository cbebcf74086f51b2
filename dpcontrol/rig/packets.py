"""Protocol between a bench and its loop over UDP.

This is version 2 of the protocol, with its security.

Numbers are little-endian, with one packet per datagram. Each packet begins with a head of 20 bytes:

    magic 4 bytes "dpcb", version u8, kind u8, count u16, session u64, sequence u32

    kind         from    count                    then
    HELLO    1   loop    0                        nothing
    WELCOME  2   bench   arms                     f64 period s, u32 maximum ticks of a run, u64 session
    START    7   loop    commands that follow     f64 each: pending commands, m/s², oldest first; the loop is
                                                  ready for the first reading
    READING  3   bench   arms                     u32 tick, u32 tick of the newest command received (none: 2³²-1),
                                                  u32 periods with a repeated command, u32 packets ignored,
                                                  f64 s from that reading to its command or 0, i8 switch, u8 condition,
                                                  u16 bytes of a sentence, f64 positions (arms, then the cart), the
                                                  sentence; then, if the bench knows it, f64 s: age of the positions
    COMMAND  4   loop    0                        u32 tick of the reading that it answers, f64 acceleration m/s²
    STOP     5   loop    0                        nothing: brake to a standstill
    BYE      6   both    bytes of a sentence      the sentence: the run is over

If both ends share a key, a packet ends with a seal of 16 bytes. The seal is the first half of the HMAC-SHA256 with that
key of "loop" or "bench", the sender's role, followed by the packet before the seal.

The loop draws a session number for HELLO, and the answer (WELCOME or BYE) repeats it. Old answers are therefore
invalid. WELCOME contains the session of the run, which the bench draws and sends only to the loop's address. All later
packets carry it, which excludes packets of other runs and of senders that cannot read them. HELLO reserves nothing: the
run begins with START. The sequence number increases with each packet of a sender. A packet with a number that is not
above all earlier ones is ignored. Lost packets are not repeated. READING and COMMAND carry their tick.

A bench moves a cart. Beyond loopback, others can read and forge packets, so there they are sealed with a shared key
unless the user disables this. The key is in a file or in the environment. It is not accepted on the command line, which
all users of a computer can read.
"""

import hmac
import os
import socket
import struct
from enum import Enum, IntEnum
from ipaddress import ip_address
from pathlib import Path
from typing import Any, NamedTuple

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import checked_source

MAGIC, VERSION = b"dpcb", 2
LARGEST = 4096
"""Maximum bytes of a datagram."""
_LONGEST_TEXT = 2048
NO_TICK = 2**32 - 1

_HEAD = struct.Struct("<4sBBHQI")
_WELCOME = struct.Struct("<dIQ")
_READING = struct.Struct("<IIIIdbBH")
_COMMAND = struct.Struct("<Id")
_SEAL = 16


class Kind(IntEnum):
    """Message type of a packet, as its header numbers it."""

    HELLO = 1
    WELCOME = 2
    READING = 3
    COMMAND = 4
    STOP = 5
    BYE = 6
    START = 7


class Condition(IntEnum):
    """Condition of the bench, which each reading reports."""

    WELL = 0
    FAULT = 1
    """The bench has failed, as the sentence describes."""
    SILENCE = 2
    """The bench received nothing from the loop for too long and has stopped the cart."""
    HARD_STOP = 3
    """The cart hit the end of its track."""


class Role(Enum):
    """One of the two ends, loop or bench; a seal depends on it."""

    LOOP = b"loop"
    BENCH = b"bench"


class Start(NamedTuple):
    """Start of a loop's run: pending commands, m/s², oldest first."""

    queued: tuple[float, ...]


class Welcome(NamedTuple):
    """Readiness of the bench: arms, period s, maximum ticks, session number."""

    arms: int
    period: float
    ticks: int
    session: int = 0


class ReadingPacket(NamedTuple):
    """Readings of the sensors at `tick`, and the bench's condition."""

    tick: int
    positions: tuple[float, ...]
    """Absolute angles, rad, then the cart's position, m."""
    heard: int
    """Tick of the newest command received, -1 for none."""
    held: int
    """Periods so far without a new command."""
    trip: float
    """Time from the reading `heard` to its command, s."""
    switch: int
    """-1, 0 or +1."""
    condition: Condition
    text: str
    ignored: int = 0
    """Foreign or repeated packets so far."""
    age: float | None = None
    """Age of the positions at the tick, s; None if unknown."""


class CommandPacket(NamedTuple):
    """The demanded acceleration of the cart, m/s².

    It responds to the reading of `tick`.
    """

    tick: int
    acceleration: float


class Bye(NamedTuple):
    """End of the run, with its reason."""

    text: str


Message = Start | Welcome | ReadingPacket | CommandPacket | Bye | Kind
"""Content of a packet; its kind for HELLO and STOP, which have none."""


class ReceivedPacket(NamedTuple):
    """Head and content of a packet."""

    session: int
    sequence: int
    content: Message


def _body(message: Message) -> tuple[Kind, int, bytes]:
    """Return kind, count and body of a packet, the parts after magic and version that depend on the message."""
    match message:
        case Welcome():
            return Kind.WELCOME, message.arms, _WELCOME.pack(*message[1:])
        case Start(queued):
            return Kind.START, len(queued), struct.pack(f"<{len(queued)}d", *queued)
        case CommandPacket():
            return Kind.COMMAND, 0, _COMMAND.pack(*message)
        case Bye(text):
            sentence = text.encode()[:_LONGEST_TEXT]
            return Kind.BYE, len(sentence), sentence
        case ReadingPacket(tick, positions, heard, held, trip, switch, condition, text, ignored, age):
            sentence, age = text.encode()[:_LONGEST_TEXT], () if age is None else (age,)
            heard, ignored = NO_TICK if heard < 0 else heard, min(ignored, NO_TICK)
            numbers = _READING.pack(tick, heard, held, ignored, trip, switch, condition, len(sentence))
            tail = struct.pack(f"<{len(positions)}d{len(sentence)}s{len(age)}d", *positions, sentence, *age)
            return Kind.READING, len(positions) - 1, numbers + tail
    return message, 0, b""


def packed(message: Message, role: Role, *, session: int, sequence: int, key: bytes = b"") -> bytes:
    """Return the packet of a message as bytes, sealed if there is a key.

    Args:
        message: packet to encode.
        role: end that sends it.
        session: number of the session.
        sequence: number of the packet within the session.
        key: shared key, default none.
    """
    kind, count, body = _body(message)
    data = _HEAD.pack(MAGIC, VERSION, kind, count, session, sequence) + body
    return data + _seal(data, role, key) if key else data


def _seal(data: bytes, role: Role, key: bytes) -> bytes:
    """Return the seal (16 bytes) of a packet that an end sends, by which the other end recognises forged packets.

    `data` is the packet before the seal, and `role` the end that sends it.
    """
    return hmac.digest(key, role.value + data, "sha256")[:_SEAL]


def unpacked(data: bytes, role: Role, *, key: bytes = b"") -> ReceivedPacket:
    """Return session, number and message of a packet after checking its seal.

    Args:
        data: the received bytes.
        role: end that has sent them.
        key: shared key, default none.

    Raises:
        ValueError: the packet is invalid, damaged or of another version, or its seal is missing, wrong or unexpected.
    """
    try:
        magic, version, number, count, session, sequence = _HEAD.unpack_from(data)
        if (magic, version) != (MAGIC, VERSION):
            raise ValueError(f"a packet begins with {magic!r}, {version}, not with version {VERSION} of the protocol")
        if key:
            data, seal = data[:-_SEAL], data[-_SEAL:]
            if not hmac.compare_digest(seal, _seal(data, role, key)):
                raise ValueError("a packet is not sealed with the shared key")
        return ReceivedPacket(session, sequence, _message(Kind(number), data[_HEAD.size :], count))
    except struct.error as error:
        raise ValueError(f"a packet of {len(data)} bytes is damaged: {error}") from error


def _message(kind: Kind, body: bytes, count: int) -> Message:
    """Return the message in the body of a packet, which must have the length that its numbers require.

    `count` is the count in the packet's head: the number of arms, pending commands or bytes of a text. A HELLO or STOP
    has no body, and its kind is the message.

    Raises:
        struct.error: another length, or a switch other than -1, 0 and 1.
    """
    match kind:
        case Kind.WELCOME:
            return Welcome(count, *_WELCOME.unpack(body))
        case Kind.START:
            return Start(struct.unpack(f"<{count}d", body))
        case Kind.COMMAND:
            return CommandPacket(*_COMMAND.unpack(body))
        case Kind.BYE:
            return Bye(*(text.decode() for text in struct.unpack(f"<{count}s", body)))
        case Kind.READING:
            *_, size = _READING.unpack_from(body)
            layout = f"{_READING.format}{count + 1}d{size}s"
            has_age = len(body) > struct.calcsize(layout)
            tick, heard, held, ignored, trip, switch, condition, _, *values = struct.unpack(
                layout + "d" * has_age, body
            )
            if abs(switch) > 1:
                raise struct.error(f"a switch of {switch}")
            heard, text, age = (
                -1 if heard == NO_TICK else heard,
                values[count + 1].decode(),
                values[-1] if has_age else None,
            )
            positions = tuple(values[: count + 1])
            return ReadingPacket(tick, positions, heard, held, trip, switch, Condition(condition), text, ignored, age)
    struct.unpack("", body)
    return kind


class Talk:
    """One end of a session: numbers and seals its packets, and checks those received.

    Args:
        role: this end.
        session: number of the session.
        key: shared key, b"" for none.
    """

    def __init__(self, role: Role, session: int, *, key: bytes = b"") -> None:
        self._role, self._session, self._key = role, session, key
        self._other = Role.BENCH if role is Role.LOOP else Role.LOOP
        # Sequence numbers of the last packet sent, and of the newest one received.
        self._sequence = self._newest = 0

    def pack(self, message: Message) -> bytes:
        """Return the packet of a message as bytes, with the next sequence number.

        Args:
            message: packet to send.
        """
        self._sequence += 1
        return packed(message, self._role, session=self._session, sequence=self._sequence, key=self._key)

    def unpack(self, data: bytes) -> ReceivedPacket:
        """Return a received packet after all checks.

        Args:
            data: the received bytes.

        Raises:
            ValueError: the packet belongs to another session, its number is not above all earlier ones, or it is
                invalid as described in `unpacked`.
        """
        packet = unpacked(data, self._other, key=self._key)
        if packet.session != self._session:
            raise ValueError("a packet does not belong to this run")
        if packet.sequence <= self._newest:
            raise ValueError("a packet came again or after a newer one")
        self._newest = packet.sequence
        return packet


KEY_VARIABLE = "DPCONTROL_RIG_KEY"
SHORTEST_KEY = 16
"""Minimum length of a key, bytes."""


def shared_key(file: Path | None = None) -> bytes:
    """Return the key that both ends share, or b"" without one.

    Surrounding blanks are removed.

    Args:
        file: file of the key; None for that of the environment.

    Raises:
        InputError: the file cannot be read, or the key is too short.
    """
    source = f"--key-file {file}" if file else KEY_VARIABLE
    if file is None and KEY_VARIABLE not in os.environ:
        return b""
    try:
        key = (checked_source(file).read_bytes() if file else os.fsencode(os.environ[KEY_VARIABLE])).strip()
    except OSError as error:
        raise InputError(f"{source}: {error.strerror or error}; give a file that contains the key") from error
    if len(key) < SHORTEST_KEY:
        raise InputError(
            f"{source}: a key of {len(key)} bytes is too short; at least {SHORTEST_KEY} are needed, as from "
            "`openssl rand -hex 32`"
        )
    return key


def resolved(
    host: str, port: int, *, name: str, key: bytes, insecure: bool, family: int = 0
) -> tuple[int, tuple[Any, ...]]:
    """Return address family and socket address of a host, and require a key if other computers can reach it.

    Args:
        host: name or address of the host.
        port: port.
        name: name of the host in messages.
        key: shared key, b"" for none.
        insecure: accept other computers without a key.
        family: address family, 0 for any.

    Raises:
        InputError: the host does not exist, or other computers can reach it without a key.
    """
    try:
        family, *_, address = socket.getaddrinfo(host, port, family=family, type=socket.SOCK_DGRAM)[0]
    except (OSError, ValueError, OverflowError) as error:
        # A name that is too long, or not a valid host name, is a ValueError.
        raise InputError(f"{name}: {getattr(error, 'strerror', None) or error}; check the address") from error
    if not (key or insecure or ip_address(str(address[0]).partition("%")[0]).is_loopback):
        raise InputError(
            f"{name} can be reached from other computers, so both ends need a shared key: give its file with "
            f"--key-file or the key in {KEY_VARIABLE}, or --insecure to let any computer there drive the cart"
        )
    return family, address
