"""A rig at the other end of a UDP socket: the client's side, for any bench that speaks `dpcontrol.rig.packets`.

The bench has the clock: it sends a reading each period, and uses the newest command it has. A reading that is lost
counts as a tick at which no sensor was read, so that the loop's ticks stay the bench's; a command that is lost is made
good by the next. After a stall the readings that wait are worked off one by one, which takes a fraction of a period
each. A tick is due a period after the one before it, counted from the earliest that a reading ever came.
How well the loop kept time, what was lost on the way and how long answers took is counted (`Deadlines`), and so are
packets that are not of the run: neither end believes them.
"""

import gc
import math
import os
import secrets
import select
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from urllib.parse import urlsplit

import numpy as np

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import Settings, setting
from dpcontrol.loop.result import Reading
from dpcontrol.rig import packets as packets
from dpcontrol.rig.packets import (
    LARGEST,
    Condition,
    Heard,
    Kind,
    Packet,
    ReadingPacket,
    Role,
    Talk,
    Welcome,
    check_access,
    resolved,
)


@contextmanager
def without_collecting() -> Iterator[None]:
    """Keep Python from looking for cycles of garbage meanwhile, which takes many milliseconds at a time."""
    was = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


@contextmanager
def real_time_priority() -> Iterator[bool]:
    """Run before all ordinary work meanwhile (SCHED_FIFO); yield whether the system allowed it.

    For processes that sleep most of the time: one that does not would keep its core to itself.
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
    """A run in real time; times in s.

    ticks: of the run; missed: those that began a whole period late or later, so that their commands came too late;
    worst, lateness_99, lateness_median: of how late ticks began, the quantiles (also of trips) of the last million.
    lost: readings that never came; stale: readings that came when their tick had passed; held: periods in which the
    bench had to do with an old command; trip_median, trip_99, trip_worst: from a reading leaving the bench to its
    command arriving there; not-a-number: none arrived. ignored: packets that came to the bench and were not of this
    run's loop, or repeated; refused: the same at the loop.
    """

    ticks: int
    missed: int
    worst: float
    lateness_median: float
    lateness_99: float
    lost: int
    stale: int
    held: int
    trip_median: float
    trip_99: float
    trip_worst: float
    ignored: int = 0
    refused: int = 0

    @property
    def strangers(self) -> str:
        """A sentence on packets that neither end believed; empty where there were none."""
        if not (self.ignored or self.refused):
            return ""
        return (
            f"packets that were not of this run, or not new, came and were ignored: {self.ignored} by the bench, "
            f"{self.refused} by the loop"
        )

    @property
    def sentence(self) -> str:
        """What a user should know of it."""
        return (
            f"{self.missed} of {self.ticks} deadlines missed; ticks began up to {1e3 * self.worst:.3g} ms late (99 %: "
            f"{1e3 * self.lateness_99:.3g} ms); {self.lost} readings lost, {self.stale} too late; the bench repeated a "
            f"command {self.held} times; from reading to command {1e3 * self.trip_median:.3g} ms (99 %: "
            f"{1e3 * self.trip_99:.3g} ms){self.strangers and f'; {self.strangers}'}"
        )

    def record(self) -> dict[str, str]:
        """Return the statistics as text by name, for a log's result record."""
        return {f"deadlines_{name}": repr(value) for name, value in asdict(self).items()}


SCHEME = "udp"
_DRIFT = 1e-4
"""By how much the two clocks may differ in pace; clocks of computers differ by some 5e-5."""
_ASK_EVERY = 0.2
"""Seconds between HELLOs."""
_LONGEST_PERIOD = 60.0
"""Seconds."""
_LATEST = 1_000_000
"""Ticks, the last, of which it is kept how late they began and how long their answers took."""
_OLDEST = 1.0
"""s: an older reading counts as one whose age is not known."""
_MOST_REFUSED = 256
"""Packets that are refused in a row before the loop looks at its clock again."""


@dataclass(frozen=True)
class LinkSettings(Settings, table="link"):
    """answer s: longest time to wait for the bench's welcome, and for its first reading; patience s: how long a reading
    may be overdue before its tick goes on without it; silence s: without any packet after which the bench counts as
    gone.
    """

    answer: float = setting(10.0, above=0, most=3600, unit="s")
    patience: float = setting(0.02, above=0, most=3600, unit="s")
    silence: float = setting(1.0, above=0, most=3600, unit="s")


def parse_address(text: str) -> tuple[str, int]:
    """Return host and port of `udp://HOST:PORT`.

    Raises:
        InputError: it is not such an address.
    """
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port
        # A host that is absurd is a ValueError here, and would be one at the first look for it.
        (host or "").encode("idna")
    except ValueError:
        parts = host = port = None
    if not (parts and host and port) or parts.scheme != SCHEME or parts.path.strip("/"):
        shown = text if len(text) <= 100 else f"{text[:100]}…"
        raise InputError(f"rig {shown!r}: must be udp://HOST:PORT, as `dpcontrol rig` prints it, or udp alone")
    return host, port


class UdpRig:
    """A bench at `address` (host, port) behind the `Rig` protocol; a context manager, which says goodbye.

    queued m/s²: the commands to be on their way when the run begins, oldest first. The first `read` lets the
    bench begin. zeros (n,) rad: what its hanging arms read, which is taken off. key: the one that is shared with it;
    insecure: a bench on another computer needs none. fault: why the bench says that it has failed, or "".

    Raises:
        InputError: no such address, or no bench answers there, or it needs a key or another one.
    """

    # Nobody knows the true state.
    truth: None = None

    def __init__(
        self,
        address: tuple[str, int],
        *,
        queued: Sequence[float] = (),
        zeros: Sequence[float] = (),
        settings: LinkSettings | None = None,
        key: bytes = b"",
        insecure: bool = False,
    ) -> None:
        self._settings, self._queued = settings or LinkSettings(), queued
        self.fault = ""
        self.address = f"{SCHEME}://{address[0]}:{address[1]}"
        family, where = resolved(*address, name=f"rig {self.address}")
        check_access(where, name=f"rig {self.address}", key=key, insecure=insecure)
        try:
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
            self._socket.connect(where)
        except OSError as error:
            raise InputError(f"rig {self.address}: {error.strerror or error}; check the address") from error
        # What comes during a stall should wait there.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self._socket.setblocking(False)
        self._waiting: dict[int, ReadingPacket] = {}
        self._tick, self._begin = -1, math.inf
        self._stopped, self._gone = False, ""
        # A night would fill the memory.
        self._lateness, self._trips = np.empty(_LATEST), np.empty(_LATEST)
        self._begun = self._answered = 0
        self._worst = self._worst_trip = math.nan
        self._heard, self._held, self._missed, self._lost, self._stale = -1, 0, 0, 0, 0
        self._ignored = self._refused = 0
        self._why_refused = ""
        # A number that nobody can guess shows that the answer is to this HELLO.
        self._asked = secrets.token_bytes(8)
        self._talk = Talk(Role.LOOP, int.from_bytes(self._asked, "little"), key=key)
        try:
            self.welcome = self._introduced()
        except BaseException:
            self._socket.close()
            raise
        self._talk = Talk(Role.LOOP, self.welcome.session, key=key)
        self._refused = 0
        self.period = self.welcome.period
        self._last_packet = 0.0
        self._nothing = np.zeros(self.welcome.arms + 1, dtype=bool)
        self._positions = np.zeros(self.welcome.arms + 1)
        self._zeros = np.zeros(self.welcome.arms + 1)
        self._zeros[: min(len(zeros), self.welcome.arms)] = zeros[: self.welcome.arms]

    def __enter__(self) -> "UdpRig":
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._say(packets.bye("the run is over"))
        self._socket.close()

    @property
    def deadlines(self) -> Deadlines:
        """Return the statistics so far."""
        none = np.array([math.nan])
        late = self._lateness[: self._begun] if self._begun else none
        trip = self._trips[: self._answered] if self._answered else none
        return Deadlines(
            ticks=self._begun, missed=self._missed, worst=self._worst,
            lateness_median=float(np.median(late)), lateness_99=float(np.percentile(late, 99)),
            lost=self._lost, stale=self._stale, held=self._held,
            trip_median=float(np.median(trip)), trip_99=float(np.percentile(trip, 99)), trip_worst=self._worst_trip,
            ignored=self._ignored, refused=self._refused,
        )  # fmt: skip

    def read(self) -> Reading:
        """Wait for the next tick's reading, or for so long that the tick must go on without it.

        Raises:
            ArithmeticError: the bench is gone, has ended the run, or has stopped the cart because it heard nothing.
        """
        self._tick = k = self._tick + 1
        packet = self._packet_of(k)
        now, period = time.perf_counter(), self.period
        lateness = max(now - (self._begin + k * period), 0.0)
        self._lateness[self._begun % _LATEST] = lateness
        self._begun += 1
        # Not-a-number, which there is before the first one, is not above anything.
        self._worst = lateness if not self._worst >= lateness else self._worst
        late = max(lateness - period, 0.0)
        self._missed += late > 0
        if packet is None:
            self._lost += 1
            return Reading(k * period, self._positions, self._nothing, 0, late)
        if packet.heard > self._heard:
            self._heard = packet.heard
            self._trips[self._answered % _LATEST] = packet.trip
            self._answered += 1
            self._worst_trip = packet.trip if not self._worst_trip >= packet.trip else self._worst_trip
        self._held, self._ignored = packet.held, packet.ignored
        if packet.condition is Condition.SILENCE and not self._stopped:
            raise ArithmeticError(f"the bench stopped the cart: {packet.text}")
        if packet.condition is Condition.FAULT:
            self.fault = packet.text
        positions = np.array(packet.positions) - self._zeros
        finite = np.isfinite(positions)
        # What is not a number is not a reading.
        self._positions = np.where(finite, positions, self._positions)
        # An age beyond the bounds of a reading's is as good as none.
        age = packet.age if packet.age is not None and 0 <= packet.age <= _OLDEST else None
        return Reading(k * period, self._positions, None if finite.all() else finite, packet.switch, late, age)

    def command(self, acceleration: float) -> None:
        """Send the cart's wanted acceleration, m/s² to the right.

        Raises:
            ArithmeticError: it is not a finite number.
        """
        if not math.isfinite(acceleration):
            raise ArithmeticError(f"command = {acceleration!r}: the drive takes finite accelerations only")
        # A STOP may be lost; until the bench is known to stand, each tick says it again.
        self._say(packets.stop() if self._stopped else packets.command(max(self._tick, 0), acceleration))

    def stop(self) -> None:
        """Have the bench brake the cart to a standstill, and send no further commands."""
        self._stopped = True
        self._say(packets.stop())

    def _introduced(self) -> Welcome:
        """Return the bench's welcome."""
        until = time.perf_counter() + self._settings.answer
        while (now := time.perf_counter()) < until:
            self._say(packets.hello())
            waited = now + _ASK_EVERY
            while (now := time.perf_counter()) < waited:
                heard = self._received(waited - now)
                if heard is None:
                    continue
                if isinstance(heard.content, Welcome):
                    return self._checked(heard.content)
                if heard.kind is Kind.BYE:
                    raise InputError(f"rig {self.address}: {heard.content}")
        came = f" ({self._refused} packets came and were refused: {self._why_refused})" if self._refused else ""
        raise InputError(
            f"rig {self.address}: no bench answered for {self._settings.answer:g} s{came}; start one with "
            "`dpcontrol rig` of this version, and give both the same key, if any"
        )

    def _checked(self, welcome: Welcome) -> Welcome:
        if not 0 < welcome.period <= _LONGEST_PERIOD:
            raise InputError(
                f"rig {self.address} announces a period of {welcome.period:g} s: it must be above 0 and at most "
                f"{_LONGEST_PERIOD:g} s; mend the bench"
            )
        return welcome

    def _packet_of(self, k: int) -> ReadingPacket | None:
        """Return the reading of tick k, or None where it is lost or overdue."""
        waiting, settings, period = self._waiting, self._settings, self.period
        if k in waiting:
            return waiting.pop(k)
        if waiting:
            return None
        if k == 0:
            self._last_packet = time.perf_counter()
            self._say(packets.start(self._queued))
        while True:
            now = time.perf_counter()
            due = self._begin + k * period if k else now
            heard = self._received(max(due + settings.patience - now, 0.0))
            content = heard.content if heard else None
            now = time.perf_counter()
            if isinstance(content, ReadingPacket):
                self._last_packet = now
                tick = content.tick
                # The earliest that any reading came, in units of the bench's clock, which may go a little slower.
                self._begin = min(self._begin + _DRIFT * period, now - tick * period)
                if tick == k:
                    return content
                if tick > k:
                    waiting[tick] = content
                    return None
                self._stale += 1
            elif heard and heard.kind is Kind.BYE:
                raise ArithmeticError(f"the bench ended the run: {content}")
            elif now - self._last_packet > (settings.silence if k else settings.answer):
                why = self._gone or "nothing came from it"
                raise ArithmeticError(f"the bench at {self.address} is gone: {why} for {now - self._last_packet:.3g} s")
            elif k == 0:
                # The first reading is waited for; START may have been lost.
                self._say(packets.start(self._queued))
            elif now >= due + settings.patience:
                return None

    def _received(self, wait: float) -> Heard | None:
        """Return the next packet that is to be believed, or None if none came within `wait` s."""
        until = time.perf_counter() + wait
        try:
            for _ in range(_MOST_REFUSED):
                try:
                    heard = self._believed(self._socket.recv(LARGEST))
                except BlockingIOError:
                    if not select.select([self._socket], [], [], max(until - time.perf_counter(), 0.0))[0]:
                        return None
                    continue
                if heard is not None:
                    return heard
        except OSError as error:
            self._gone = f"{error.strerror or error}"
            # Nobody listens there now; a bench that is restarted might.
            time.sleep(min(wait, _ASK_EVERY))
        return None

    def _believed(self, data: bytes) -> Heard | None:
        """Return a packet that is the bench's, of this run, new and fits its welcome; others are counted."""
        try:
            heard = self._talk.hear(data)
        except ValueError as error:
            # A second answer to a HELLO that was sent twice is no sign of strangers.
            if self._tick < 0 or data[8:16] != self._asked:
                self._refused += 1
                self._why_refused = str(error)
            return None
        content = heard.content
        if isinstance(content, ReadingPacket):
            if len(content.positions) != self.welcome.arms + 1 or content.tick >= self.welcome.ticks:
                self._refused += 1
                return None
            if not heard.new:
                self._stale += 1
                return None
        return heard if heard.new else None

    def _say(self, message: Packet) -> None:
        try:
            self._socket.send(self._talk.say(message))
        except OSError as error:
            # Like a packet lost on the way.
            self._gone = f"{error.strerror or error}"
