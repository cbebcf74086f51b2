"""The other end: a simulated bench that goes by its own clock and is spoken to over UDP, in real time.

At tick k, due at t_0 + k · period, the commands that have come are taken, the newest of them acts, and a reading goes
out. Where none has come the last one goes on acting. A loop that is silent for too long has its cart stopped; only time
in which the bench itself kept its ticks counts. A bench that overslept works off its ticks at once: physics waits for
nobody. Between ticks it sleeps, in `select`, so that a command's arrival is noted; the last `spin` seconds it polls.

One run at a time, which begins at START: HELLO is answered, and binds the bench to nothing. Packets are those of
`dpcontrol.rig.packets`. A run hears its own loop only, by a socket that the system lets nobody else's packets into, so
that a flood of them neither delays a tick nor drives out a command; they are counted in the time that is left.
The example bench of a run lives in a process of its own, so that the loop and it share neither interpreter nor core.
Where the loop is another program, the bench's own record of the run is what its log is made of: `RecordedRig` shows the
loop's ticks what that program saw, and compares what both command.
"""

import hmac
import json
import math
import multiprocessing
import os
import secrets
import select
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from dpcontrol.control.tick import TickProgram
from dpcontrol.dynamics.chain import ArmChainParameters, Uncertainty
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.processes import end_with_parent
from dpcontrol.foundation.settings import Settings, setting
from dpcontrol.foundation.shown import Brief
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.result import Reading, Rig
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.references.problem import Limits
from dpcontrol.rig import packets as packets
from dpcontrol.rig.client import Deadlines, real_time_priority, without_collecting
from dpcontrol.rig.packets import (
    KEY_VARIABLE,
    LARGEST,
    CommandPacket,
    Condition,
    Heard,
    Kind,
    OtherVersion,
    Packet,
    ReadingPacket,
    Role,
    Start,
    Talk,
    Unsealed,
    Welcome,
    checked_host,
)

Say = Callable[[str], None]

_STANDING = 1e-9
"""m/s: slower than any cart."""
_LEAVING = 2.0
"""Seconds of silence after which a loop counts as gone, and the next may come."""
_REFUSE_EVERY = 0.05
"""Seconds between refusals, so that the bench does not help to flood whoever a HELLO pretends to come from."""
_AT_ONCE, _STRANGERS_AT_ONCE = 64, 16
"""Packets that are taken before the clock is looked at: the loop's, and others'."""
_REMEMBERED = 1024
"""Ticks whose times of sending are kept, to time their answers."""


@dataclass(frozen=True)
class BenchServerSettings(Settings, table="bench"):
    """watchdog s: silence of the loop after which the cart is stopped; spin s: of each period spent in polling.
    real_time: ask the system for priority over all ordinary work.
    """

    watchdog: float = setting(0.1, least=0.001, most=60, unit="s")
    spin: float = setting(0.0001, least=0, most=1, unit="s")
    real_time: bool = False


class BenchRecord:
    """What happened on a bench in a run of K ticks, n arms.

    positions (K, n+1) rad and m; sent (K,): whether the reading went out; switch (K,); truth (K, 2n+2), not-a-number
    where it is not known; ages (K,) s of the readings, not-a-number where unknown; commands (K,) m/s²: in answer to
    each tick's reading, not-a-number where none came in time.
    last: the newest tick that was answered; fault: the bench's own, from tick `fault_at` on; ended: why the run did.
    Of a run that goes on longer the first K ticks are kept.
    """

    def __init__(self, ticks: int, arms: int, period: float) -> None:
        self.period, self.ticks, self.last = period, 0, -1
        self.positions, self.truth = np.full((ticks, arms + 1), np.nan), np.full((ticks, 2 * arms + 2), np.nan)
        self.sent, self.switch = np.zeros(ticks, dtype=bool), np.zeros(ticks, dtype=np.int8)
        self.commands, self.ages = np.full(ticks, np.nan), np.full(ticks, np.nan)
        self.fault, self.fault_at, self.ended = "", ticks, ""

    def read(self, k: int, reading: Reading, truth: Array | None, *, sent: bool) -> None:
        """Keep the reading of tick k."""
        if k >= len(self.sent):
            return
        self.ticks, self.sent[k], self.switch[k] = k + 1, sent, reading.switch
        self.positions[k] = reading.positions
        self.ages[k] = math.nan if reading.age is None else reading.age
        if truth is not None:
            self.truth[k] = truth

    def answered(self, k: int, command: float | None) -> None:
        """Keep the command in answer to the reading of tick k; None: the cart was to be stopped."""
        if k >= len(self.commands):
            return
        self.last = max(self.last, k)
        if command is not None:
            self.commands[k] = command

    @property
    def stood_at(self) -> float:
        """Time from which the cart stood to the end of the record, s; not-a-number where it did not."""
        moving = np.flatnonzero(~(np.abs(self.truth[: self.ticks, -1]) <= _STANDING))
        first = int(moving[-1]) + 1 if len(moving) else 0
        return first * self.period if first < self.ticks else math.nan


class RecordedRig:
    """A record behind the `Rig` protocol, up to where its loop stopped the cart or was heard last.

    program: of the loop that it is shown to. It is made to believe in the commands that were sent: one that believed in
    its own would drift away from the readings, as a controller on its own is not stable. difference m/s²: the largest
    between a command that was sent then and what is commanded now.
    """

    def __init__(self, record: BenchRecord, program: TickProgram) -> None:
        self._record, self._program, self.period = record, program, record.period
        self._tick, self._stopped = -1, False
        self._nothing = np.zeros(record.positions.shape[1], dtype=bool)
        self.difference = 0.0

    @property
    def truth(self) -> Array:
        """The true state (2n+2,) at the last reading's tick."""
        return self._record.truth[max(self._tick, 0)]

    @property
    def fault(self) -> str:
        """Why the bench had failed by then, or ""."""
        return self._record.fault if self._tick >= self._record.fault_at else ""

    def read(self) -> Reading:
        """Return the next tick's reading.

        Raises:
            ArithmeticError: the loop answered no more then.
        """
        record = self._record
        k = self._tick + 1
        if k >= record.ticks or (k > record.last and not self._stopped):
            stood = f"; the cart stood from t = {record.stood_at:.3f} s on" if record.stood_at > 0 else ""
            last = f"the controller's last command came at t = {record.last * self.period:.3f} s"
            raise ArithmeticError(f"{last}: {record.ended}{stood}")
        self._tick = k
        present = None if record.sent[k] else self._nothing
        age = float(record.ages[k]) if math.isfinite(record.ages[k]) else None
        return Reading(k * self.period, record.positions[k], present, int(record.switch[k]), age=age)

    def command(self, acceleration: float) -> None:
        """Compare a command, m/s², with the one that was sent then, and let that one be on its way."""
        sent = float(self._record.commands[self._tick])
        if math.isfinite(sent):
            self.difference = max(self.difference, abs(acceleration - sent))
            memory, at = self._program.memory, self._program.equations.memory.slices
            memory[at["velocity"]] += (sent - acceleration) * self.period
            memory[at["sent"].stop - 1] = sent

    def stop(self) -> None:
        """Note that the cart is brought to rest, as the record shows."""
        self._stopped = True


class UdpBench:
    """Serves a bench on a socket of its own; a context manager.

    make: makes the rig of a run from the commands on their way; its period in s. key: the one that loops share;
    insecure: loops on other computers need none. recorded: ticks of a run that its record holds at most, all by
    default. say: called with what happens.

    Raises:
        InputError: the address or port is not available, or other computers can reach it and there is no key.
    """

    def __init__(
        self,
        make: Callable[[Sequence[float]], Rig],
        *,
        arms: int,
        ticks: int,
        period: float,
        host: str = "127.0.0.1",
        port: int = 0,
        key: bytes = b"",
        insecure: bool = False,
        settings: BenchServerSettings | None = None,
        recorded: int | None = None,
        say: Say = lambda text: None,
    ) -> None:
        self._make, self._arms, self._ticks, self._period, self._say = make, arms, ticks, period, say
        self._key, self._settings = key, settings or BenchServerSettings()
        self._recorded = min(ticks, ticks if recorded is None else recorded)
        where = checked_host(host, port, key=key, insecure=insecure)
        self._secret, self._refused_at = secrets.token_bytes(16), -math.inf
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(where)
        except (OSError, OverflowError) as error:
            self._socket.close()
            why = getattr(error, "strerror", None) or error
            raise InputError(f"rig: port {port} of {host}: {why}; choose another --port, or 0 for any") from error
        self._socket.setblocking(False)
        self.address: tuple[str, int] = self._socket.getsockname()
        """Where the bench can be spoken to."""
        self.record: BenchRecord | None = None
        """Of the last run."""

    @property
    def url(self) -> str:
        """Address for loops, `udp://HOST:PORT`."""
        return f"udp://{self.address[0]}:{self.address[1]}"

    def document(self) -> dict[str, Any]:
        """Return the fields that `dpcontrol rig --json` prints."""
        return {"address": self.url, "rate": 1 / self._period, "arms": self._arms, "ticks": self._ticks}

    def __repr__(self) -> str:
        return f"<bench at {self.url}>"

    def __enter__(self) -> "UdpBench":
        return self

    def __exit__(self, *exception: object) -> None:
        self._socket.close()

    def serve(self, *, runs: int = 0) -> None:
        """Serve so many runs, one after the other; 0: until interrupted."""
        served = 0
        while not runs or served < runs:
            select.select([self._socket], [], [])
            try:
                data, sender = self._socket.recvfrom(LARGEST)
            except OSError:
                # It was damaged on the way, or a loop has left, which the system reports once.
                continue
            served += self._served(data, sender)

    def _served(self, data: bytes, sender: Any) -> bool:
        """Take a packet that came while nothing runs; tell whether it led to a run that has ended."""
        try:
            heard = packets.unpacked(data, Role.LOOP, key=self._key)
        except ValueError as error:
            if packets.is_hello(data) and (why := self._remedy(error)):
                self._refuse(packets.refusal(data, why), sender)
            return False
        session = self._session(sender)
        if heard.kind is Kind.HELLO:
            self._answer(heard, packets.welcome(Welcome(self._arms, self._period, self._ticks, session)), sender)
            return False
        if heard.session != session:
            if heard.kind is Kind.START:
                self._refuse(self._packed(heard, packets.bye("the bench does not know this run; begin again")), sender)
            return False
        if not isinstance(heard.content, Start):
            # A loop that finds that the bench does not suit it.
            return heard.kind is Kind.BYE
        if not all(map(math.isfinite, heard.content.queued)):
            self._answer(heard, packets.bye("no run begins: a command on its way is not a finite number"), sender)
            return False
        self._say(f"a run begins for {sender[0]}:{sender[1]}")
        # So that nothing of this run can begin another.
        self._secret = secrets.token_bytes(16)
        rig = self._make(heard.content.queued)
        self.record = BenchRecord(self._recorded, self._arms, self._period)
        with without_collecting(), real_time_priority() if self._settings.real_time else nullcontext():
            talk = Talk(Role.BENCH, session, key=self._key)
            talk.hear(data)
            with ExitStack() as stack:
                sockets = [(self._socket, _AT_ONCE)]
                if own := _own_socket(self._socket, sender):
                    sockets = [(stack.enter_context(own), _AT_ONCE), (self._socket, _STRANGERS_AT_ONCE)]
                run = _BenchRun(
                    sockets, sender, rig, talk, ticks=self._ticks, settings=self._settings, busy=self._busy,
                    record=self.record,
                )  # fmt: skip
                ended = run.go()
        self.record.ended = run.silence or ended
        self._say(f"run ended: {ended}; {run.sentence}")
        return True

    def _session(self, sender: Any) -> int:
        """Return the number of the session that `sender` may begin.

        Nothing is kept of it, so that nobody can lock others out; who pretends to be elsewhere does not get to know it.
        """
        return int.from_bytes(hmac.digest(self._secret, repr(sender).encode(), "sha256")[:8])

    def _remedy(self, error: ValueError) -> str:
        """Return what the sender of a HELLO that is not taken should be told; empty: nothing."""
        if isinstance(error, OtherVersion):
            return f"this bench speaks version {packets.VERSION} of the protocol; update the loop's dpcontrol"
        if not isinstance(error, Unsealed):
            return ""
        if self._key:
            return f"this bench asks for the key that it shares: give its file with --key-file, or set {KEY_VARIABLE}"
        return f"this bench has no key: start it with one, or run without --key-file and {KEY_VARIABLE}"

    def _busy(self, data: bytes, sender: Any) -> None:
        """Tell a loop that asks for a run while there is one."""
        with suppress(ValueError):
            heard = packets.unpacked(data, Role.LOOP, key=self._key)
            if heard.kind in (Kind.HELLO, Kind.START):
                busy = packets.bye("the bench is busy with another loop; wait for it to end")
                self._refuse(self._packed(heard, busy), sender)

    def _packed(self, heard: Heard, message: Packet) -> bytes:
        return packets.packed(message, Role.BENCH, session=heard.session, sequence=1, key=self._key)

    def _answer(self, heard: Heard, message: Packet, sender: Any) -> None:
        with suppress(OSError):
            self._socket.sendto(self._packed(heard, message), sender)

    def _refuse(self, data: bytes, sender: Any) -> None:
        now = time.perf_counter()
        if now - self._refused_at >= _REFUSE_EVERY:
            self._refused_at = now
            with suppress(OSError):
                self._socket.sendto(data, sender)


def _own_socket(shared: socket.socket, client: Any) -> socket.socket | None:
    """Return a socket at the same address that hears `client` only; None where the system cannot do so."""
    own = socket.socket(shared.family, socket.SOCK_DGRAM)
    try:
        # On the other one after its bind only, which has found out whether the port is free.
        shared.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        own.bind(shared.getsockname())
        own.connect(client)
        shared.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 0)
    except (OSError, AttributeError):
        own.close()
        return None
    own.setblocking(False)
    return own


class _BenchRun:
    """One run of the bench for one loop.

    sockets: where packets come in, the first also where they go out, with how many to take before a look at the clock.
    busy: called with what others sent, and from where, once a tick at most. record: to be filled.
    """

    def __init__(
        self, sockets: list[tuple[socket.socket, int]], client: Any, rig: Rig, talk: Talk, *, ticks: int,
        settings: BenchServerSettings, busy: Callable[[bytes, Any], None], record: BenchRecord,
    ) -> None:  # fmt: skip
        self._sockets, self._client, self._rig, self._talk, self._settings = sockets, client, rig, talk, settings
        self._busy, self._busy_at, self._record = busy, -1, record
        self._ticks, self._tick = ticks, -1
        self._sent_at = [0.0] * _REMEMBERED
        self._heard, self._held, self._trip, self._fresh = -1, 0, 0.0, True
        self._silent, self._stopped, self._over, self._ignored = 0, False, "", 0
        self._condition, self._text = Condition.WELL, ""
        self._worst, self._behind = 0.0, 0
        self.silence = ""
        """A sentence, where the cart was stopped because the loop was not heard."""

    @property
    def sentence(self) -> str:
        """How it kept time, and what it ignored."""
        ignored = f"; {self._ignored} packets that were not this loop's, or not new, were ignored"
        return (
            f"{self._tick + 1} ticks, {self._behind} of them a period late or later, the worst {1e3 * self._worst:.3g} "
            f"ms; a command was repeated {self._held} times{ignored if self._ignored else ''}"
        )

    def go(self) -> str:
        """Run until the loop says goodbye or is gone; return why it ended."""
        period, clock = self._rig.period, time.perf_counter
        watchdog, leaving = self._settings.watchdog / period, _LEAVING / period
        begin = clock()
        for k in range(self._ticks):
            due = begin + k * period
            self._wait(due)
            self._take()
            if self._over:
                return self._over
            late = clock() - due
            self._worst = max(self._worst, late)
            self._behind += late > period
            self._silent += late <= period
            if k and not self._fresh and not self._stopped:
                self._held += 1
            self._fresh = False
            if self._silent > leaving:
                return "the loop is gone"
            if self._silent > watchdog and not self._stopped:
                silent = f"heard nothing from the loop for {self._settings.watchdog:g} s until t = {k * period:.3f} s"
                self.silence = f"the bench {silent}"
                self._stop(Condition.SILENCE, f"it {silent}")
            try:
                reading = self._rig.read()
            except ArithmeticError as failure:
                self._send(packets.bye(str(failure)))
                return str(failure)
            if self._rig.fault and self._condition is Condition.WELL:
                self._condition, self._text = Condition.FAULT, self._rig.fault
                self._record.fault, self._record.fault_at = self._text, k
            self._tick = k
            self._sent_at[k % _REMEMBERED] = clock()
            # A tick without any reading sends none: the loop finds it lost.
            sends = reading.present is None or bool(reading.present.any())
            self._record.read(k, reading, self._rig.truth, sent=sends)
            if sends:
                content = ReadingPacket(
                    k, tuple(reading.positions.tolist()), self._heard, self._held, self._trip, reading.switch,
                    self._condition, self._text, self._ignored, reading.age,
                )  # fmt: skip
                self._send(packets.reading(content))
        text = f"the bench was made for {self._ticks} ticks and has run them"
        self._send(packets.bye(text))
        return text

    def _wait(self, due: float) -> None:
        """Wait until `due`, taking what comes: asleep, then polling."""
        clock, spin = time.perf_counter, self._settings.spin
        sockets = [sock for sock, _ in self._sockets]
        while (left := due - clock() - spin) > 0:
            if select.select(sockets, [], [], left)[0]:
                self._take()
        while clock() < due:
            pass

    def _take(self) -> None:
        """Take packets that have come, so few that no tick is late for them."""
        for sock, most in self._sockets:
            for _ in range(most):
                try:
                    data, sender = sock.recvfrom(LARGEST)
                except OSError:
                    # Nothing more; or a loop that has left, which the system reports once.
                    break
                if sender == self._client:
                    self._hear(data)
                    continue
                self._ignored += 1
                if self._busy_at != self._tick:
                    self._busy_at = self._tick
                    self._busy(data, sender)

    def _hear(self, data: bytes) -> None:
        """Take a packet from the loop's address."""
        try:
            heard = self._talk.hear(data)
        except ValueError:
            heard = None
        if heard is None or not heard.new:
            self._ignored += 1
            return
        self._silent = 0
        if isinstance(heard.content, CommandPacket):
            self._obey(heard.content)
        elif heard.kind is Kind.STOP:
            if not self._stopped:
                self._record.answered(max(self._tick, 0), None)
            self._stop(self._condition, self._text)
        elif heard.kind is Kind.BYE:
            self._over = str(heard.content)
            self._rig.stop()

    def _obey(self, content: CommandPacket) -> None:
        """Let a command act, unless a newer one has come or it is for a tick that has not been."""
        if not self._heard < content.tick <= self._tick:
            return
        self._heard, self._fresh = content.tick, True
        self._record.answered(content.tick, content.acceleration)
        if self._tick - content.tick < _REMEMBERED:
            self._trip = time.perf_counter() - self._sent_at[content.tick % _REMEMBERED]
        if not math.isfinite(content.acceleration):
            self._stop(Condition.FAULT, f"the command at tick {content.tick} was not finite; the cart was stopped")
        elif not self._stopped:
            self._rig.command(content.acceleration)

    def _stop(self, condition: Condition, text: str) -> None:
        self._condition, self._text, self._stopped = condition, text, True
        self._rig.stop()

    def _send(self, message: Packet) -> None:
        # A packet that cannot be sent is like one lost on the way: the loop notices.
        with suppress(OSError):
            self._sockets[0][0].sendto(self._talk.say(message), self._client)


_START = 120.0
"""Seconds for the process to load and compile."""
_END = 5.0
_RECORDED = 700_000
"""Ticks of which a record is kept where a run goes on beyond its itinerary, as for a night."""


FAULTS: Mapping[str, str] = {
    "drive-reversed": "the cart goes the other way",
    "cart-reversed": "the cart's scale counts backwards",
    "encoder-1-reversed": "the inner arm's encoder counts backwards",
    "encoder-2-reversed": "the next arm's encoder counts backwards",
    "encoders-swapped": "the first two encoders are swapped",
    "angles-not-summed": "each arm's angle is that to the arm before it",
    "encoder-1-factor-4": "the inner arm's encoder counts four times too much",
    "zeros-off": "the encoders are off by 0.03 and -0.02 rad",
    "switch-dead": "the limit switch at the right never answers",
    "switches-swapped": "the limit switches are swapped",
}
"""Mistakes that the example bench can be given, for practice with `dpcontrol commission`."""
_PRACTICE_ZEROS = (0.03, -0.02)


def checked_faults(faults: Sequence[str], arms: int) -> tuple[str, ...]:
    """Return faults for practice.

    Raises:
        InputError: one of them is about an arm that these have not.
    """
    for name in faults:
        if arms < 2 and ("-2-" in name or name in ("encoders-swapped", "angles-not-summed")):
            raise InputError(f"--fault {name}: is for two arms and more, and the model has {arms}; choose another")
    return tuple(faults)


class FaultyRig:
    """A rig that is wired wrongly, for practice; zeros (n,) rad: what its hanging arms read."""

    truth: None = None

    def __init__(self, rig: Rig, *, faults: Sequence[str], zeros: Sequence[float] = ()) -> None:
        self._rig, self._faults, self.period = rig, frozenset(faults), rig.period
        self._zeros: Sequence[float] = _PRACTICE_ZEROS if "zeros-off" in faults else zeros

    @property
    def fault(self) -> str:
        """Return why the bench has failed, or ""."""
        return self._rig.fault

    def read(self) -> Reading:
        """Return the next tick's reading as this wiring gives it."""
        reading, faults = self._rig.read(), self._faults
        joints, cart = np.diff(reading.positions[:-1], prepend=0.0), reading.positions[-1]
        if "encoders-swapped" in faults:
            joints[[0, 1]] = joints[[1, 0]]
        for name, arm, factor in _FACTORS:
            if name in faults:
                joints[arm] *= factor
        angles = joints if "angles-not-summed" in faults else np.cumsum(joints)
        angles[: len(self._zeros)] += self._zeros[: len(angles)]
        switch = -reading.switch if "switches-swapped" in faults else reading.switch
        if "switch-dead" in faults:
            switch = min(switch, 0)
        return reading._replace(
            positions=np.append(angles, -cart if "cart-reversed" in faults else cart), switch=switch
        )  # fmt: skip

    def command(self, acceleration: float) -> None:
        """Send the cart's wanted acceleration, m/s²."""
        self._rig.command(-acceleration if "drive-reversed" in self._faults else acceleration)

    def stop(self) -> None:
        """Brake the cart."""
        self._rig.stop()


_FACTORS = (("encoder-1-reversed", 0, -1.0), ("encoder-2-reversed", 1, -1.0), ("encoder-1-factor-4", 0, 4.0))


@dataclass(frozen=True, eq=False)
class BenchRecipe(Brief):
    """What makes a simulated bench anew for each run: the model's arms, what is drawn; start (2n+2,), ticks.

    zeros (n,) rad: what its hanging arms read; faults: of `FAULTS`. recovering: further ticks that it can run for, so
    that a run may go on after falls.
    """

    parameters: ArmChainParameters
    settings: LoopSettings
    limits: Limits
    start: Array
    ticks: int
    uncertainty: Uncertainty | None = None
    zeros: tuple[float, ...] = ()
    faults: tuple[str, ...] = ()
    recovering: int = 0

    @property
    def all_ticks(self) -> int:
        """For how many ticks it can run."""
        return self.ticks + self.recovering

    @property
    def period(self) -> float:
        """Time from tick to tick, s."""
        return 1 / self.settings.rate

    def rig(self, queued: Sequence[float]) -> Rig:
        """Return a bench at its start, with the commands (m/s²) on their way, oldest first."""
        draw = self.settings.draw(self.parameters, ticks=self.ticks, uncertainty=self.uncertainty)
        if self.recovering:
            draw = draw.endless()
        rig = SimulatedRig(draw, self.settings.bench, limits=self.limits, start=self.start, queued=queued)
        return FaultyRig(rig, faults=self.faults, zeros=self.zeros) if self.faults or any(self.zeros) else rig

    def rehearse(self) -> None:
        """Have everything compiled and in memory before the first run."""
        rig = self.rig(())
        for _ in range(min(self.ticks, 100)):
            rig.read()
            rig.command(0.0)


def _serve(recipe: BenchRecipe, settings: BenchServerSettings, key: bytes, pipe: Connection) -> None:
    # An interrupt from the terminal is for the loop, which stops the cart first.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    recipe.rehearse()
    arms = recipe.parameters.count
    with UdpBench(
        recipe.rig, arms=arms, ticks=recipe.all_ticks, period=recipe.period, key=key, settings=settings,
        recorded=max(recipe.ticks, _RECORDED), say=pipe.send,
    ) as bench:  # fmt: skip
        pipe.send(bench.address)
        bench.serve(runs=1)
        pipe.send(bench.record)


class BenchProcess:
    """Serves one run of the recipe's bench on loopback; a context manager, which ends the process.

    key: shared with it alone, so that no other program of this computer can take the run.

    Raises:
        InputError: the process did not come up.
    """

    def __init__(self, recipe: BenchRecipe, settings: BenchServerSettings | None = None) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe(duplex=False)
        # In letters, so that an environment can carry it.
        self.key = secrets.token_hex(32).encode()
        self._process = context.Process(
            target=_serve, args=(recipe, settings or BenchServerSettings(), self.key, theirs), daemon=True
        )
        self._process.start()
        theirs.close()
        self.address: tuple[str, int] = ("", 0)
        with suppress(EOFError):
            if self._pipe.poll(_START):
                self.address = self._pipe.recv()
        if not self.address[1]:
            self._end()
            raise InputError("the example bench did not start; `dpcontrol rig` shows why")
        self.said: list[str] = []
        self.record: BenchRecord | None = None
        """What the bench said of the run, and what happened in it, once the block has been left."""

    def __enter__(self) -> "BenchProcess":
        return self

    def __exit__(self, *_: object) -> None:
        if self.began:
            self._take(_END)
        self._end()

    @property
    def began(self) -> bool:
        """Whether a loop has begun its run."""
        self._take(0.0)
        return bool(self.said)

    def _take(self, wait: float) -> None:
        """Take what the bench says within so many seconds, or until it ends."""
        until = time.perf_counter() + wait
        with suppress(EOFError, OSError):
            while self._pipe.poll(max(until - time.perf_counter(), 0.0)):
                heard = self._pipe.recv()
                if isinstance(heard, BenchRecord):
                    self.record = heard
                elif heard is not None:
                    self.said.append(heard)

    def controlled_by(self, program: Path, *arguments: str) -> Deadlines | None:
        """Have a program control the run to its end, or stop it where interrupted; return what it says of deadlines.

        It is called with the bench's address, then the arguments; the key is in its environment. On stdout it may print
        its deadlines, a line of JSON.

        Raises:
            InputError: it cannot be started, or ended before the run began.
        """
        host, port = self.address
        name, command = f"--controller-program {program}", [str(program.absolute()), f"udp://{host}:{port}", *arguments]
        environment = {**os.environ, KEY_VARIABLE: self.key.decode()}
        try:
            process = subprocess.Popen(
                command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                text=True, errors="replace",
            )  # fmt: skip
        except OSError as error:
            raise InputError(f"{name}: {error.strerror or error}; give a program that can be run") from error
        try:
            figures, said = process.communicate()
        finally:
            if process.poll() is None:
                # It stops the cart first; Windows knows no way to ask.
                if os.name == "posix":
                    process.send_signal(signal.SIGINT)
                with suppress(subprocess.TimeoutExpired):
                    process.communicate(timeout=_END)
                process.kill()
        if not self.began:
            why = said.strip().splitlines()[-1:] or ["it said nothing"]
            raise InputError(f"{name} ended with {process.returncode} before a run began: {why[0]}")
        try:
            return Deadlines(**json.loads(figures))
        except (TypeError, ValueError):
            return None

    def _end(self) -> None:
        if self._process.is_alive():
            self._process.terminate()
        self._process.join(_END)
        self._pipe.close()
