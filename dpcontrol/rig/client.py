"""Client of a rig over UDP or a serial line, for any bench that implements `dpcontrol.rig.packets`.

The bench has the clock. It sends a reading each period and applies the newest command. A lost reading counts as a tick
without sensors, so the loop's ticks stay aligned with the bench's. A lost command is replaced by the next. After a
stall, the waiting readings are handled one by one, each in a fraction of a period. A tick is due one period after the
last, counted from the earliest arrival of any reading.
`Deadlines` counts late ticks, lost and late packets, and those that do not belong to the run, which both ends ignore.
"""

import gc
import json
import math
import os
import re
import secrets
import select
import socket
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, fields
from typing import Annotated, Any, NoReturn, TypeVar

import numpy as np

from dpcontrol.foundation.causes import Cause
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import Setting, Settings
from dpcontrol.logs import Event
from dpcontrol.loop.protocols import Reading
from dpcontrol.loop.result import ended
from dpcontrol.rig.packets import (
    LARGEST,
    Bye,
    CommandPacket,
    Condition,
    Kind,
    Message,
    ReadingPacket,
    Role,
    Start,
    Talk,
    Welcome,
    resolved,
)

T = TypeVar("T", Welcome, ReadingPacket)
_FAULTS = {Condition.FAULT: Cause.RIG_FAULT, Condition.HARD_STOP: Cause.HARD_STOP}


@contextmanager
def without_collecting() -> Iterator[None]:
    """Disable Python's cyclic garbage collection in the block.

    A collection takes many milliseconds, and seconds in a large program. So there is none before the block either.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


@contextmanager
def real_time_priority() -> Iterator[bool]:
    """Run with real-time priority (SCHED_FIFO) in the block, so that other programs do not delay ticks.

    Yield True if the system allowed it; otherwise False, and the priority stays.

    Only for processes that sleep most of the time, because others would block their core.
    """
    try:
        policy, priority = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except (AttributeError, OSError):
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, policy, priority)


@dataclass(frozen=True)
class Deadlines:
    """Ticks and packets of a run in real time, by which users judge whether computer and network are fast enough."""

    ticks: int
    """Ticks of the run, each with a command that was sent."""
    missed: int
    """Ticks that began at least a period late, so that their commands came too late."""
    worst: float
    """Largest delay of a tick, s."""
    lost: int
    """Readings that did not arrive in time for their tick."""
    held: int
    """Periods in which the bench repeated an old command."""
    rejected: int
    """Foreign, repeated and damaged packets at both ends."""

    @property
    def sentence(self) -> str:
        """Summary of the run's ticks and packets."""
        return (
            f"{self.missed} of {self.ticks} deadlines missed; ticks began up to {1e3 * self.worst:.3g} ms late; "
            f"{self.lost} readings lost or too late; {self.rejected} packets rejected; the bench repeated a command "
            f"{self.held} times"
        )

    def record(self) -> dict[str, str]:
        """Return the statistics by name as text, for a log's result record."""
        return {f"deadlines_{name}": repr(value) for name, value in asdict(self).items()}

    @classmethod
    def of(cls, record: Mapping[str, str]) -> "Deadlines | None":
        """Return the statistics of a log's result record, or None for a run in simulated time.

        Args:
            record: metadata of the log.
        """
        texts = {entry.name: record.get(f"deadlines_{entry.name}", "") for entry in fields(cls)}
        return cls(**{name: json.loads(text) for name, text in texts.items()}) if all(texts.values()) else None


SCHEME = "udp"
_DRIFT = 1e-4
"""Relative difference in the pace of the two clocks; those of computers differ by some 5e-5."""
_REQUEST_INTERVAL = 0.2
"""Interval between HELLOs, s."""
_LONGEST_PERIOD = 60.0
"""Upper bound of a bench's period, s."""
_UNKNOWN = Welcome(0, math.nan, 0)
"""Bench that has not answered, whose readings are all rejected."""
_OLDEST = 1.0
"""Maximum age of a reading, s; older ones count as of unknown age."""
_MOST_PACKETS = 256
"""Packets that are read before the loop checks its clock."""


@dataclass(frozen=True)
class LinkSettings(Settings, table="link"):
    """Time limits of the packets from the bench."""

    answer: Annotated[float, Setting(above=0, most=3600, unit="s")] = 10.0
    """Time limit for the bench's welcome and first reading, s."""
    patience: Annotated[float, Setting(above=0, most=3600, unit="s")] = 0.02
    """Delay of a reading after which its tick continues without it, s."""
    silence: Annotated[float, Setting(above=0, most=3600, unit="s")] = 1.0
    """Time without packets after which the bench counts as disconnected, s."""


def parse_address(text: str) -> tuple[str, int]:
    """Return host and port of a bench's address `udp://HOST:PORT`.

    Args:
        text: address of a bench.

    Raises:
        InputError: the text has another form.
    """
    match = re.fullmatch(rf"{SCHEME}://\[?([^/\[\]]+)\]?:(\d+)/?", text)
    if match is None or not 0 < int(match[2]) < 1 << 16:
        raise InputError(f"rig {text!r}: must be udp://HOST:PORT as `dpcontrol rig` prints it, serial://PORT, or udp")
    return match[1], int(match[2])


class PacketRig(AbstractContextManager["PacketRig"]):
    """A bench at the other end of a channel as a `Rig` and context manager.

    The first `read` starts the bench. On exit, the client says goodbye.

    Args:
        channel: socket or other line that carries whole packets, with `send`, `recv`, `fileno` and `close`.
        address: address of the bench, for messages.
        queued: pending commands at the start, oldest first, m/s².
        zeros: readings (n,) of its hanging arms, which are subtracted, rad.
        settings: time limits.
        key: key shared with the bench.

    Raises:
        InputError: no bench responds, or the key is missing or wrong.
    """

    # The true state is unknown.
    truth: None = None

    def __init__(
        self,
        channel: Any,
        address: str,
        *,
        queued: Sequence[float] = (),
        zeros: Sequence[float] = (),
        settings: LinkSettings | None = None,
        key: bytes = b"",
    ) -> None:
        self._settings, self._queued = settings or LinkSettings(), queued
        self.fault: Event | None = None
        self.address, self._channel = address, channel
        # A reading that came before its tick, which its tick uses.
        self._early: ReadingPacket | None = None
        # The present tick, and the time of tick 0 on this computer's clock, s.
        self._tick, self._begin = -1, math.inf
        # The last error of the channel or of a packet explains why a bench does not respond.
        self._stopped, self._problem = False, ""
        # Largest delay of a tick, s.
        self._worst = 0.0
        # Figures of `Deadlines`. The bench counts the first and the fourth; refused packets are those at this end.
        self._held = self._missed = self._lost = self._ignored = self._refused = 0
        # An unpredictable number shows that an answer belongs to this HELLO.
        self._request = secrets.token_bytes(8)
        self._talk, self.welcome = Talk(Role.LOOP, int.from_bytes(self._request, "little"), key=key), _UNKNOWN
        try:
            self.welcome = self._introduced()
        except BaseException:
            self._channel.close()
            raise
        self._talk = Talk(Role.LOOP, self.welcome.session, key=key)
        self._refused = 0
        self.period = self.welcome.period
        self._last_packet = time.perf_counter()
        # Sensors of a tick without a reading, and the last positions, which such a tick repeats.
        self._nothing = np.zeros(self.welcome.arms + 1, dtype=bool)
        self._positions = np.zeros(self.welcome.arms + 1)
        arm_zeros = zeros[: self.welcome.arms]
        self._zeros = np.array([*arm_zeros, *[0.0] * (self.welcome.arms + 1 - len(arm_zeros))])

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._send(Bye("the run is over"))
        self._channel.close()

    @property
    def deadlines(self) -> Deadlines:
        """The statistics of ticks and packets so far."""
        rejected = self._ignored + self._refused
        return Deadlines(self._tick + 1, self._missed, self._worst, self._lost, self._held, rejected)

    def read(self) -> Reading:
        """Wait for the reading of the next tick, and return it with the zeros subtracted.

        If it is lost or overdue, the result has no sensors and repeats the last positions. The reading also says how
        many s the tick began beyond a period too late.

        Raises:
            ArithmeticError: the bench has disconnected, ended the run, or stopped the cart for lack of packets.
        """
        self._tick = k = self._tick + 1
        packet = self._packet_of(k)
        period = self.period
        # Before the first reading, the beginning is infinite and no tick is late.
        lateness = time.perf_counter() - (self._begin + k * period)
        self._worst = max(self._worst, lateness)
        late = max(lateness - period, 0.0)
        self._missed += late > 0
        if packet is None:
            self._lost += 1
            return Reading(k * period, self._positions, self._nothing, 0, late)
        self._held, self._ignored = packet.held, packet.ignored
        if packet.condition is Condition.SILENCE and not self._stopped:
            raise ArithmeticError(f"the bench stopped the cart: {packet.text or 'it received nothing for too long'}")
        if packet.condition in _FAULTS:
            self.fault = ended(_FAULTS[packet.condition], words=packet.text)
        positions = np.array(packet.positions) - self._zeros
        finite = np.isfinite(positions)
        # A NaN counts as a missing reading.
        self._positions = np.where(finite, positions, self._positions)
        # An age out of bounds counts as unknown.
        age = packet.age if packet.age is not None and 0 <= packet.age <= _OLDEST else None
        return Reading(k * period, self._positions, None if finite.all() else finite, packet.switch, late, age)

    def command(self, acceleration: float) -> None:
        """Send a command that accelerates the cart.

        Args:
            acceleration: demanded acceleration, m/s², positive to the right.

        Raises:
            ArithmeticError: the demand is not finite.
        """
        if not math.isfinite(acceleration):
            raise ArithmeticError(f"command = {acceleration!r}: the drive takes finite accelerations only")
        # A STOP may be lost, so each tick repeats it until the bench reports standstill.
        self._send(Kind.STOP if self._stopped else CommandPacket(max(self._tick, 0), acceleration))

    def stop(self) -> None:
        """Have the bench brake the cart to a standstill.

        No further commands are sent.
        """
        self._stopped = True
        self._send(Kind.STOP)

    def _introduced(self) -> Welcome:
        """Exchange HELLO and WELCOME with the bench, and return its welcome.

        Raises:
            InputError: no answer in time, a refusal, or an impossible period.
        """
        answer = self._answer(Kind.HELLO, Welcome)
        if answer is None:
            raise InputError(
                f"rig {self.address}: no bench responded for {self._settings.answer:g} s{self._problem}; start one "
                "with `dpcontrol rig` of this version, and give both the same key, if any"
            )
        if isinstance(answer, Bye):
            raise InputError(f"rig {self.address}: {answer.text}")
        if not 0 < answer.period <= _LONGEST_PERIOD:
            raise InputError(
                f"rig {self.address} announces a period of {answer.period:g} s: it must be above 0 and "
                f"at most {_LONGEST_PERIOD:g} s; fix the bench"
            )
        return answer

    def _answer(self, message: Message, kind: type[T]) -> T | Bye | None:
        """Repeat a message until an answer of this kind or a BYE comes, and return it, or None if the time is over.

        The first packets of a session may be lost, and the bench may still be starting.
        """
        time_limit = time.perf_counter() + self._settings.answer
        while time.perf_counter() < time_limit:
            self._send(message)
            for content in self._arrivals(time.perf_counter() + _REQUEST_INTERVAL):
                if isinstance(content, (kind, Bye)):
                    return content
        return None

    def _packet_of(self, k: int) -> ReadingPacket | None:
        """Return the reading of tick k, or None if it is lost or overdue, in which case the tick has no sensors.

        A reading of a later tick is stored until its tick, since the one of tick k cannot come after it. Tick 0 starts
        the run.
        """
        packet, self._early = self._early, None
        if k == 0:
            packet = self._taken(self._answer(Start(tuple(self._queued)), ReadingPacket) or self._lost_contact())
        elif packet is None:
            packet = self._awaited(k)
        if packet is not None and packet.tick > k:
            self._early, packet = packet, None
        return packet

    def _awaited(self, k: int) -> ReadingPacket | None:
        """Return the first reading of tick k or a later one that comes in time, else None; earlier ones are dropped.

        In time is up to `patience` s after tick k is due, which is k periods after tick 0 (`_begin`, s).

        Raises:
            ArithmeticError: the bench has been silent for too long.
        """
        for content in self._arrivals(self._begin + k * self.period + self._settings.patience):
            packet = self._taken(content)
            if packet is not None and packet.tick >= k:
                return packet
        if time.perf_counter() - self._last_packet > self._settings.silence:
            self._lost_contact()
        return None

    def _taken(self, content: Message) -> ReadingPacket | None:
        """Return the reading in a message, or None if it is none, and date the begin of the run by its arrival.

        `_begin` is the time of tick 0 on this computer's clock, s: the earliest that any reading's arrival implies.

        Raises:
            ArithmeticError: the bench ended the run.
        """
        if isinstance(content, Bye):
            raise ArithmeticError(f"the bench ended the run: {content.text}")
        if not isinstance(content, ReadingPacket):
            return None
        # The bench counts as lost if this time is too long ago.
        self._last_packet = arrival = time.perf_counter()
        # The earliest arrival of any reading on the bench's clock, which may run slightly slower.
        self._begin = min(self._begin + _DRIFT * self.period, arrival - content.tick * self.period)
        return content

    def _lost_contact(self) -> NoReturn:
        """Raise ArithmeticError, since the bench no longer responds."""
        raise ArithmeticError(
            f"the bench at {self.address} does not respond: received nothing from it for "
            f"{time.perf_counter() - self._last_packet:.3g} s{self._problem}"
        )

    def _arrivals(self, until: float) -> Iterator[Message]:
        """Yield the messages of valid packets that wait already or arrive until a time, s on the clock `perf_counter`.

        The text of a channel's error is stored in `_problem`, for the report of a lost bench.
        """
        try:
            for _ in range(_MOST_PACKETS):
                try:
                    yield from self._accepted(self._channel.recv(LARGEST))
                except BlockingIOError:
                    if not select.select([self._channel], [], [], max(until - time.perf_counter(), 0.0))[0]:
                        return
        except OSError as error:
            self._problem = f" ({error.strerror or error})"
            # No program listens there now, but a restarted bench might.
            time.sleep(max(min(until - time.perf_counter(), _REQUEST_INTERVAL), 0.0))

    def _accepted(self, data: bytes) -> Iterator[Message]:
        """Yield the message in the packet `data` if it is valid, new and of this run's bench.

        Other packets are counted as refused, and the reason is stored in `_problem`. A reading must have the positions
        (n+1) of the bench's arms and a tick of its run, which the bench's welcome gives.
        """
        try:
            content, welcome = self._talk.unpack(data).content, self.welcome
        except ValueError as error:
            # A second answer to a repeated HELLO is not foreign; bytes 8 to 16 of a packet are its session.
            if self._tick < 0 or data[8:16] != self._request:
                self._refused += 1
                self._problem = f" ({error})"
            return
        if isinstance(content, ReadingPacket) and not (
            len(content.positions) == welcome.arms + 1 and content.tick < welcome.ticks
        ):
            self._refused += 1
        else:
            yield content

    def _send(self, message: Message) -> None:
        """Send a message to the bench; it is lost if the system refuses it."""
        try:
            self._channel.send(self._talk.pack(message))
        except OSError as error:
            # It counts as lost.
            self._problem = f" ({error.strerror or error})"


class UdpRig(PacketRig):
    """A bench over UDP as a `Rig` and context manager.

    Args:
        address: host and port of the bench.
        key: key shared with the bench.
        insecure: accept a bench on another computer without a key.
        **settings: further arguments of `PacketRig`.

    Raises:
        InputError: the address is invalid, no bench responds, or the key is missing or wrong.
    """

    def __init__(self, address: tuple[str, int], *, key: bytes = b"", insecure: bool = False, **settings: Any) -> None:
        name = f"{SCHEME}://{address[0]}:{address[1]}"
        family, socket_address = resolved(*address, name=f"rig {name}", key=key, insecure=insecure)
        try:
            channel = socket.socket(family, socket.SOCK_DGRAM)
            channel.connect(socket_address)
        except OSError as error:
            raise InputError(f"rig {name}: {error.strerror or error}; check the address") from error
        # Packets that arrive during a stall should wait there.
        channel.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        channel.setblocking(False)
        super().__init__(channel, name, key=key, **settings)
