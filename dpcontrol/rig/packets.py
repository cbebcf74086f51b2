"""What a bench and its loop say to each other over UDP, version 2, and who may speak.

Little-endian, one packet a datagram. Every packet begins with a head of 20 bytes:

    magic 4 bytes "dpcb", version u8, kind u8, count u16, session u64, sequence u32

    kind         from    count                    then
    HELLO    1   loop    0                        nothing
    WELCOME  2   bench   arms                     f64 period s, u32 ticks that the bench can run for, u64 session
    START    7   loop    commands that follow     f64 each: m/s², on their way when the run begins, oldest first; the
                                                  loop is ready for the first reading
    READING  3   bench   arms                     u32 tick, u32 tick of the newest command heard (no tick: 2³²-1),
                                                  u32 periods that had to do with an old command, u32 packets ignored,
                                                  f64 s from that reading to its command, i8 switch, u8 condition,
                                                  u16 bytes of a sentence, f64 positions (arms, then the cart), the
                                                  sentence; then, if the bench knows it, f64 s: age of the positions
    COMMAND  4   loop    0                        u32 tick of the reading that it answers, f64 acceleration m/s²
    STOP     5   loop    0                        nothing: brake to a standstill
    BYE      6   both    bytes of a sentence      the sentence: the run is over

and ends, where the two share a key, with a seal of 16 bytes: the first of HMAC-SHA256, with that key, of "loop" or
"bench", whoever sends it, and of all that stands before the seal.

The session of HELLO is a number that the loop draws, and the answer (WELCOME, or BYE) repeats it, so that no old answer
serves. WELCOME names the run's own session, which the bench draws and which goes to the address of the loop only; all
later packets carry it, so that none of another run, or of someone who cannot read these, counts. HELLO binds the bench
to nothing: the run begins with START. The sequence rises with each packet of a sender; one that is not above all before
it is not believed. A lost packet is not sent again, and READING and COMMAND carry the tick that they belong to.

Version 1 had a head of eight bytes, without session and sequence, and HELLO carried the commands on their way.

A bench moves a cart. Away from loopback its packets can be read and made by others, so there they are sealed with a
shared key, unless the user says that they need not be. The key stands in a file or in the environment, never on the
command line, which every user of a computer can read.
"""

import hmac
import os
import socket
import struct
from collections.abc import Sequence
from enum import Enum, IntEnum
from ipaddress import ip_address
from pathlib import Path
from typing import NamedTuple

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import checked_source

MAGIC, VERSION = b"dpcb", 2
LARGEST = 4096
"""Bytes of a datagram at most."""
_LONGEST_TEXT = 2048
NO_TICK = 2**32 - 1

_HEAD = struct.Struct("<4sBBHQI")
_OLD_HEAD = struct.Struct("<4sBBH")
_WELCOME = struct.Struct("<dIQ")
_READING = struct.Struct("<IIIIdbBH")
_COMMAND = struct.Struct("<Id")
_AGE = struct.Struct("<d")
_SEAL = 16


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


class Role(Enum):
    """An end of the line."""

    LOOP = b"loop"
    BENCH = b"bench"

    @property
    def other(self) -> "Role":
        """The other end."""
        return Role.BENCH if self is Role.LOOP else Role.LOOP


class OtherVersion(ValueError):
    """The packet is of another version of the protocol."""


class Unsealed(ValueError):
    """The packet is not sealed with the shared key, or with one where none is shared."""


class Packet(NamedTuple):
    """A packet without its head: kind, the head's count, and what follows the head."""

    kind: Kind
    number: int = 0
    body: bytes = b""


class Start(NamedTuple):
    """A loop begins its run: the commands on their way, m/s², oldest first."""

    queued: tuple[float, ...]


class Welcome(NamedTuple):
    """The bench is ready: arms, period s, ticks that it can run for, number of the session."""

    arms: int
    period: float
    ticks: int
    session: int = 0


class ReadingPacket(NamedTuple):
    """What the sensors said at `tick`: positions, absolute angles in rad, then the cart's in m.

    heard: tick of the newest command that has come, -1 for none; held: periods so far in which no new one came; trip s:
    from the reading `heard` to its command; switch -1, 0, +1; condition of the bench, and a sentence on it; ignored:
    packets so far that were not of this run's loop, or not new. age s: how long before the tick the positions were
    taken, None if the bench does not know.
    """

    tick: int
    positions: tuple[float, ...]
    heard: int
    held: int
    trip: float
    switch: int
    condition: Condition
    text: str
    ignored: int = 0
    age: float | None = None


class CommandPacket(NamedTuple):
    """The cart's wanted acceleration, m/s², in answer to the reading of `tick`."""

    tick: int
    acceleration: float


Content = Start | Welcome | ReadingPacket | CommandPacket | str | None
"""Of BYE the sentence, of HELLO and STOP None."""


class Heard(NamedTuple):
    """A packet that has come; new: whether its sequence is above all that were heard before."""

    kind: Kind
    session: int
    sequence: int
    content: Content
    new: bool = True


def hello() -> Packet:
    """Return what asks a bench for a run."""
    return Packet(Kind.HELLO)


def welcome(content: Welcome) -> Packet:
    """Return the bench's answer to HELLO."""
    return Packet(Kind.WELCOME, content.arms, _WELCOME.pack(content.period, content.ticks, content.session))


def start(queued: Sequence[float] = ()) -> Packet:
    """Return what begins a run and lets the first tick come, with the commands on their way (m/s²), oldest first."""
    return Packet(Kind.START, len(queued), struct.pack(f"<{len(queued)}d", *queued))


def reading(content: ReadingPacket) -> Packet:
    """Return the message of one tick."""
    text = content.text.encode()[:_LONGEST_TEXT]
    count, heard = len(content.positions), NO_TICK if content.heard < 0 else content.heard
    body = _READING.pack(
        content.tick, heard, content.held, min(content.ignored, NO_TICK), content.trip, content.switch,
        content.condition, len(text),
    )  # fmt: skip
    age = b"" if content.age is None else _AGE.pack(content.age)
    return Packet(Kind.READING, count - 1, body + struct.pack(f"<{count}d", *content.positions) + text + age)


def command(tick: int, acceleration: float) -> Packet:
    """Return the answer to the reading of `tick`, acceleration in m/s²."""
    return Packet(Kind.COMMAND, 0, _COMMAND.pack(tick, acceleration))


def stop() -> Packet:
    """Return what stops the cart."""
    return Packet(Kind.STOP)


def bye(text: str) -> Packet:
    """Return what ends a run, and why."""
    said = text.encode()[:_LONGEST_TEXT]
    return Packet(Kind.BYE, len(said), said)


def packed(message: Packet, role: Role, *, session: int, sequence: int, key: bytes = b"") -> bytes:
    """Return the packet of a message from `role`; sealed if there is a key."""
    kind, count, body = message
    data = _HEAD.pack(MAGIC, VERSION, kind, count, session, sequence) + body
    return data + _seal(data, role, key) if key else data


def _seal(data: bytes, role: Role, key: bytes) -> bytes:
    return hmac.digest(key, role.value + data, "sha256")[:_SEAL]


def unpacked(data: bytes, role: Role, *, key: bytes = b"") -> Heard:
    """Return a packet's head and content, if `role` sent it and, where there is a key, has sealed it.

    Raises:
        OtherVersion: it is of another version.
        Unsealed: the seal is missing, or of another key, or there is one and no key.
        ValueError: it is not a packet, or damaged; says how.
    """
    if len(data) < _OLD_HEAD.size:
        raise ValueError(f"a packet of {len(data)} bytes has no head")
    magic, version, number, count = _OLD_HEAD.unpack_from(data)
    if magic != MAGIC:
        raise ValueError(f"a packet that begins with {magic!r} is not from a bench")
    if version != VERSION:
        raise OtherVersion(f"the packet's version is {version}, this program speaks {VERSION}")
    if key:
        data, seal = data[:-_SEAL], data[-_SEAL:]
        if not hmac.compare_digest(seal, _seal(data, role, key)):
            raise Unsealed("a packet is not sealed with the shared key")
    try:
        session, sequence = _HEAD.unpack_from(data)[-2:]
        kind = Kind(number)
        content, end = _content(kind, data, count)
    except (struct.error, UnicodeDecodeError) as error:
        raise ValueError(f"a packet of kind {number} is damaged: {error}") from error
    if len(data) == end + _SEAL and not key:
        raise Unsealed("a packet is sealed with a key, and none is given here")
    if len(data) != end:
        raise ValueError(f"a packet of kind {number} is damaged: it has {len(data)} bytes instead of {end}")
    return Heard(kind, session, sequence, content)


def _content(kind: Kind, data: bytes, count: int) -> tuple[Content, int]:
    """Return the content of a packet, and where it ends."""
    at = _HEAD.size
    if kind is Kind.READING:
        tick, heard, held, ignored, trip, switch, condition, size = _READING.unpack_from(data, at)
        at += _READING.size
        positions = struct.unpack_from(f"<{count + 1}d", data, at)
        at += 8 * (count + 1)
        if abs(switch) > 1:
            raise struct.error(f"a switch of {switch}")
        heard = -1 if heard == NO_TICK else heard
        text = _text(data, at, size)
        at += size
        age = None
        # A seal has 16 bytes, so eight more are an age.
        if len(data) - at in (_AGE.size, _AGE.size + _SEAL):
            (age,) = _AGE.unpack_from(data, at)
            at += _AGE.size
        return ReadingPacket(tick, positions, heard, held, trip, switch, Condition(condition), text, ignored, age), at
    if kind is Kind.COMMAND:
        return CommandPacket(*_COMMAND.unpack_from(data, at)), at + _COMMAND.size
    if kind is Kind.START:
        return Start(struct.unpack_from(f"<{count}d", data, at)), at + 8 * count
    if kind is Kind.WELCOME:
        return Welcome(count, *_WELCOME.unpack_from(data, at)), at + _WELCOME.size
    return (_text(data, at, count), at + count) if kind is Kind.BYE else (None, at)


def _text(data: bytes, at: int, size: int) -> str:
    if len(data) < at + size:
        raise struct.error(f"{size} bytes of text were announced, {len(data) - at} came")
    return data[at : at + size].decode()


def is_hello(data: bytes) -> bool:
    """Tell whether these bytes begin as HELLO of some version does: its sender can be told why it gets no welcome."""
    return data[:4] == MAGIC and data[5:6] == bytes([Kind.HELLO])


def refusal(data: bytes, why: str) -> bytes:
    """Return an unsealed BYE that the sender of the HELLO `data`, of version 1 or of ours, understands."""
    said = bye(why)
    if data[4] == 1:
        return _OLD_HEAD.pack(MAGIC, 1, said.kind, said.number) + said.body
    session = int.from_bytes(data[_OLD_HEAD.size : _OLD_HEAD.size + 8], "little")
    return packed(said, Role.BENCH, session=session, sequence=1)


class Talk:
    """One end of a session: numbers and seals what it says, and believes only what the other end says in it."""

    def __init__(self, role: Role, session: int, *, key: bytes = b"") -> None:
        self._role, self._session, self._key = role, session, key
        self._said = self._newest = 0

    def say(self, message: Packet) -> bytes:
        """Return the packet to be sent."""
        self._said += 1
        return packed(message, self._role, session=self._session, sequence=self._said, key=self._key)

    def hear(self, data: bytes) -> Heard:
        """Return a packet that has come.

        Raises:
            ValueError: it is not of this session, or one of the errors of `unpacked`.
        """
        heard = unpacked(data, self._role.other, key=self._key)
        if heard.session != self._session:
            raise ValueError("a packet is not of this run")
        if heard.sequence <= self._newest:
            return heard._replace(new=False)
        self._newest = heard.sequence
        return heard


KEY_VARIABLE = "DPCONTROL_RIG_KEY"
SHORTEST_KEY = 16
"""Bytes."""
_LONGEST_KEY = 4096


def shared_key(file: Path | None = None) -> bytes:
    """Return the key in `file`, or else in the environment, or b"" where there is none; blanks at its ends are dropped.

    Raises:
        InputError: the file cannot be read, or the key is too short.
    """
    where = f"--key-file {file}" if file else KEY_VARIABLE
    if file is None and KEY_VARIABLE not in os.environ:
        return b""
    try:
        key = (_beginning(file) if file else os.fsencode(os.environ[KEY_VARIABLE])).strip()
    except OSError as error:
        raise InputError(f"{where}: {error.strerror or error}; give a file that holds the key") from error
    if len(key) < SHORTEST_KEY:
        raise InputError(
            f"{where}: a key of {len(key)} bytes is too short; at least {SHORTEST_KEY} are needed, as from "
            "`openssl rand -hex 32`"
        )
    return key


def _beginning(file: Path) -> bytes:
    # Not the whole file, which may be large.
    with checked_source(file).open("rb") as stream:
        return stream.read(_LONGEST_KEY)


def resolved(host: str, port: int, *, name: str, family: int = 0) -> tuple[int, tuple]:
    """Return address family and socket address of a host; `name` says in messages where it was given.

    Raises:
        InputError: there is no such host.
    """
    try:
        found = socket.getaddrinfo(host, port, family=family, type=socket.SOCK_DGRAM)[0]
    except (OSError, ValueError, OverflowError) as error:
        # A name that is too long, or that no encoding of host names takes, is a ValueError.
        why = (error.strerror if isinstance(error, OSError) else None) or error
        shown = name if len(name) <= 100 else f"{name[:100]}…"
        raise InputError(f"{shown}: {why}; check the address") from error
    return found[0], found[4]


def check_access(address: tuple, *, name: str, key: bytes, insecure: bool) -> None:
    """Reject an address beyond this computer where neither a key is shared nor the user says that none is needed.

    Raises:
        InputError: it is such an address.
    """
    if not (key or insecure or ip_address(address[0].partition("%")[0]).is_loopback):
        raise InputError(
            f"{name} can be reached from other computers, so both ends need a shared key: give its file with "
            f"--key-file or the key in {KEY_VARIABLE}, or --insecure to let anyone there drive the cart"
        )


def checked_host(host: str, port: int, *, key: bytes, insecure: bool) -> tuple:
    """Return the socket address at which a bench may listen.

    Raises:
        InputError: the host is empty or unknown, or other computers can reach it and there is no key.
    """
    if not host.strip():
        raise InputError("rig: --host is empty; give 127.0.0.1 for this computer alone, 0.0.0.0 for all interfaces")
    _, address = resolved(host, port, name=f"rig: --host {host}", family=socket.AF_INET)
    check_access(address, name=f"rig: --host {host}", key=key, insecure=insecure)
    return address
