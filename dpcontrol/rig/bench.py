"""Server side of a rig: a simulated bench with its own clock.

Loops control it over UDP in real time.

Tick k is due at t_0 + k · period. At each tick, the bench reads the received commands, applies the newest and sends a
reading. Without a new command, the last one continues to act. If the loop is silent too long, the bench stops its cart.
Only time in which the bench itself kept its ticks counts as silence. A bench that was delayed computes its missed ticks
at once, as physics would not wait. Between ticks it sleeps in `select`, which wakes it when a command arrives.

The bench serves one run at a time, which begins with START. It answers HELLO but does not reserve anything.
`dpcontrol.rig.packets` defines the packets. Packets of other senders are counted, and do not act on a run.
The example bench of a run has its own process, so bench and loop share neither interpreter nor core. If another program
is the loop, its log is made from the bench's record of the run. `RecordedRig` replays that program's readings to the
Python loop and compares the commands of both.
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
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from dpcontrol.control.tick import TickProgram
from dpcontrol.dynamics.chain import ArmChainParameters, Uncertainty
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import Cause
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.processes import end_with_parent
from dpcontrol.foundation.settings import Setting, Settings, check_choice
from dpcontrol.foundation.shown import Brief
from dpcontrol.logs import Event
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.protocols import Reading
from dpcontrol.loop.result import Rig
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.references.problem import Limits
from dpcontrol.rig.client import Deadlines, real_time_priority, without_collecting
from dpcontrol.rig.packets import (
    KEY_VARIABLE,
    LARGEST,
    Bye,
    CommandPacket,
    Condition,
    Kind,
    Message,
    ReadingPacket,
    ReceivedPacket,
    Role,
    Start,
    Talk,
    Welcome,
    packed,
    resolved,
    unpacked,
)

Report = Callable[[str], None]

_STILL = 1e-9
"""Velocity below which a cart counts as still, m/s."""
_LEAVING = 2.0
"""Silence after which a loop counts as disconnected and the next one can connect, s."""
_AT_ONCE = 64
"""Packets that are read before the clock is checked."""


@dataclass(frozen=True)
class BenchServerSettings(Settings, table="bench"):
    """Watchdog and priority of a bench in real time.

    Attributes:
        watchdog: silence of the loop after which the cart is stopped, s.
        real_time: request priority over all ordinary processes.
        runs: number of runs to serve, 0 for no limit.
    """

    watchdog: Annotated[float, Setting(least=0.001, most=60, unit="s")] = 0.1
    real_time: bool = False
    runs: int = 0


class BenchRecord:
    """Record of a run of K ticks with n arms, from which the log is made if another program is the loop.

    If the run is longer, the first K ticks are kept.

    Attributes:
        positions: positions (K, n+1), rad and m.
        sent: True if the reading was sent (K,).
        switch: state of the limit switches (K,).
        truth: true states (K, 2n+2), NaN if unknown.
        ages: ages of the readings (K,), s, NaN if unknown.
        commands: command for each tick's reading (K,), m/s², NaN if none came in time.
        last: newest tick that was answered.
        fault: fault of the bench, from tick `fault_at` onward.
        ended: cause of the end.
    """

    def __init__(self, ticks: int, arms: int, period: float) -> None:
        self.period, self.ticks, self.last = period, 0, -1
        self.positions, self.truth = np.full((ticks, arms + 1), np.nan), np.full((ticks, 2 * arms + 2), np.nan)
        self.sent, self.switch = np.zeros(ticks, dtype=bool), np.zeros(ticks, dtype=np.int8)
        self.commands, self.ages = np.full(ticks, np.nan), np.full(ticks, np.nan)
        self.fault: Event | None = None
        self.fault_at, self.ended = ticks, ""

    def read(self, k: int, reading: Reading, truth: Array | None, *, sent: bool) -> None:
        """Store the reading of tick k, also if it was not sent.

        Args:
            k: tick.
            reading: its reading.
            truth: true state (2n+2,), None if unknown.
            sent: True if the reading was sent.
        """
        if k < len(self.sent):
            self.ticks, self.sent[k], self.switch[k] = k + 1, sent, reading.switch
            self.positions[k], self.ages[k] = reading.positions, math.nan if reading.age is None else reading.age
            self.truth[k] = math.nan if truth is None else truth

    def answered(self, k: int, command: float | None) -> None:
        """Store the loop's command for the reading of tick k.

        Args:
            k: tick.
            command: command, m/s²; None if the cart had to stop.
        """
        if k < len(self.commands):
            self.last = max(self.last, k)
            self.commands[k] = self.commands[k] if command is None else command

    @property
    def still_from(self) -> float:
        """Time from which the cart stood still until the end, s, for the report of an ended run; NaN if it did not."""
        moving_ticks = np.flatnonzero(~(np.abs(self.truth[: self.ticks, -1]) <= _STILL))
        first_still_tick = int(moving_ticks[-1]) + 1 if len(moving_ticks) else 0
        return first_still_tick * self.period if first_still_tick < self.ticks else math.nan


class RecordedRig:
    """Replays a bench's record as a `Rig`, so that the Python loop can log a run of another program.

    It ends when its loop stopped the cart or was last heard.

    The program's estimator receives the recorded commands. With its own commands it would drift away from the readings,
    since a controller alone is not stable.

    Args:
        record: record of the bench.
        program: program of the loop that reads the record.
    """

    def __init__(self, record: BenchRecord, program: TickProgram) -> None:
        self._record, self._program, self.period = record, program, record.period
        # Tick of the last reading, and True once the loop has stopped the cart.
        self._tick, self._stopped = -1, False
        # Sensors of a reading that was not sent.
        self._nothing = np.zeros(record.positions.shape[1], dtype=bool)
        # Largest difference so far between the loop's commands and the recorded ones, m/s².
        self.difference = 0.0

    @property
    def truth(self) -> Array:
        """The true state (2n+2,) at the last reading."""
        return self._record.truth[max(self._tick, 0)]

    @property
    def fault(self) -> Event | None:
        """The bench's fault up to now, or None."""
        return self._record.fault if self._tick >= self._record.fault_at else None

    def read(self) -> Reading:
        """Return the recorded reading of the next tick.

        A reading that was not sent has no sensors. Once the loop has stopped the cart, readings continue to the
        record's end; before that, they end with the last tick that the recorded loop answered.

        Raises:
            ArithmeticError: the recorded loop no longer responded at that time, or the record ends.
        """
        record = self._record
        k = self._tick + 1
        if k >= record.ticks or (k > record.last and not self._stopped):
            pause = f"; the cart stood still from t = {record.still_from:.3f} s" if record.still_from > 0 else ""
            last = f"the controller's last command came at t = {record.last * self.period:.3f} s"
            raise ArithmeticError(f"{last}: {record.ended}{pause}")
        self._tick = k
        present = None if record.sent[k] else self._nothing
        age = float(record.ages[k]) if math.isfinite(record.ages[k]) else None
        return Reading(k * self.period, record.positions[k], present, int(record.switch[k]), age=age)

    def command(self, acceleration: float) -> None:
        """Compare the loop's command with the recorded one, and keep the largest difference in `difference`, m/s².

        The estimator then uses the recorded command instead. A tick without a recorded command is not compared.

        Args:
            acceleration: command, m/s².
        """
        sent = float(self._record.commands[self._tick])
        if math.isfinite(sent):
            self.difference = max(self.difference, abs(acceleration - sent))
            memory = self._program.memory
            # The program has already added its own command to the cart's velocity.
            memory.velocity[:] += (sent - acceleration) * self.period
            memory.sent[-1] = sent

    def stop(self) -> None:
        """Do nothing, since the record contains the braking."""
        self._stopped = True


class UdpBench(AbstractContextManager["UdpBench"]):
    """Bench server on its own socket, as a context manager: it waits for loops and serves one run after the other.

    Args:
        make: returns the rig of a run, given the pending commands.
        arms: number of arms.
        ticks: maximum ticks of a run.
        period: control period, s.
        host: address of this computer at which loops can reach the bench.
        port: port, 0 for any free one.
        key: key shared with the loops.
        insecure: accept loops on other computers without a key.
        settings: watchdog, priority and number of runs.
        recorded: maximum ticks in the record.
        report: receives messages about events.

    Raises:
        InputError: the address or port is not available, or other computers can reach it without a key.
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
        report: Report = lambda text: None,
    ) -> None:
        self._make, self._arms, self._ticks, self._period, self._report = make, arms, ticks, period, report
        self._key, self._settings = key, settings or BenchServerSettings()
        self._recorded = min(ticks, ticks if recorded is None else recorded)
        _, socket_address = resolved(
            host, port, name=f"rig: --host {host}", key=key, insecure=insecure, family=socket.AF_INET
        )
        # Session numbers are derived from it, so that only the addressee of a welcome can begin a run.
        self._secret = secrets.token_bytes(16)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(socket_address)
        except OSError as error:
            self._socket.close()
            raise InputError(
                f"rig: port {port} of {host}: {error.strerror}; choose another --port, or 0 for any"
            ) from error
        self._socket.setblocking(False)
        self.address: tuple[str, int] = self._socket.getsockname()
        """Address of the bench."""
        self.record: BenchRecord | None = None
        """Record of the last run."""

    @property
    def url(self) -> str:
        """Address for loops, `udp://HOST:PORT`."""
        return f"udp://{self.address[0]}:{self.address[1]}"

    def document(self) -> dict[str, Any]:
        """Return the fields that `dpcontrol rig --json` prints."""
        return {"address": self.url, "rate": 1 / self._period, "arms": self._arms, "ticks": self._ticks}

    def __repr__(self) -> str:
        return f"<bench at {self.url}>"

    def __exit__(self, *exception: object) -> None:
        self._socket.close()

    def serve(self, *, runs: int | None = None) -> None:
        """Serve runs in sequence, and answer greetings between them.

        Args:
            runs: number of runs; 0 to continue until interrupted (default: that of the settings).
        """
        served, runs = 0, self._settings.runs if runs is None else runs
        while not runs or served < runs:
            select.select([self._socket], [], [])
            try:
                data, sender = self._socket.recvfrom(LARGEST)
            except OSError:
                # The packet was damaged, or a loop has disconnected, which the system reports once.
                continue
            served += self._served(data, sender)

    def _served(self, data: bytes, sender: Any) -> bool:
        """Handle a packet that comes between runs, and serve the run if it is a START.

        Return True if the packet led to a run that has ended, or the loop declined the bench, either of which counts as
        a run. Other packets are answered if necessary, and the result is False. `sender` is the socket address, host
        and port, of the packet's sender.
        """
        # The session that this sender may begin is not stored, so nobody can lock out others, and a forged sender does
        # not receive it.
        session = int.from_bytes(hmac.digest(self._secret, repr(sender).encode(), "sha256")[:8])
        packet = self._greeted(data, sender, Welcome(self._arms, self._period, self._ticks, session))
        if packet is None or packet.session != session:
            return False
        if not isinstance(packet.content, Start):
            # The loop found that the bench is not suitable.
            return isinstance(packet.content, Bye)
        if not all(map(math.isfinite, packet.content.queued)):
            self._answer(packet, Bye("the run was rejected: a pending command is not a finite number"), sender)
            return False
        self._report(f"run started for {sender[0]}:{sender[1]}")
        # Packets of this run cannot begin another one.
        self._secret = secrets.token_bytes(16)
        rig = self._make(packet.content.queued)
        self.record = BenchRecord(self._recorded, self._arms, self._period)
        with without_collecting(), real_time_priority() if self._settings.real_time else nullcontext():
            talk = Talk(Role.BENCH, session, key=self._key)
            # The run's end of the session then refuses a repetition of the START.
            talk.unpack(data)
            run = _BenchRun(
                self._socket, sender, rig, talk, ticks=self._ticks, settings=self._settings, others=self._greeted,
                record=self.record,
            )  # fmt: skip
            ending = run.go()
        self.record.ended = self.record.ended or ending
        self._report(f"run ended: {ending}; {run.sentence}")
        return True

    def _greeted(self, data: bytes, sender: Any, answer: Message) -> ReceivedPacket | None:
        """Return the unpacked packet of a loop, or None if it is not valid, and answer a HELLO with `answer`.

        During a run, the answer to another loop is that the bench is busy.
        """
        try:
            packet = unpacked(data, Role.LOOP, key=self._key)
        except ValueError:
            return None
        if packet.content is Kind.HELLO:
            self._answer(packet, answer, sender)
        return packet

    def _answer(self, heard: ReceivedPacket, message: Message, sender: Any) -> None:
        """Send a message to the sender of a packet, with that packet's session; it is lost if the system refuses it.

        `heard` is that packet.
        """
        data = packed(message, Role.BENCH, session=heard.session, sequence=1, key=self._key)
        with suppress(OSError):
            self._socket.sendto(data, sender)


class _BenchRun:
    """One run of the bench for one loop: it reads the rig at each tick, sends readings and applies commands.

    Args:
        sock: socket of the bench.
        client: socket address of the loop; packets from others do not act on the run.
        rig: the simulated rig.
        talk: the run's end of the session, which packs and checks packets.
        ticks: length of the run.
        settings: watchdog and priority.
        others: receives packets of other senders, and the answer to their HELLO.
        record: filled during the run.
    """

    def __init__(
        self, sock: socket.socket, client: Any, rig: Rig, talk: Talk, *, ticks: int,
        settings: BenchServerSettings, others: Callable[[bytes, Any, Message], object], record: BenchRecord,
    ) -> None:  # fmt: skip
        self._socket, self._client, self._rig, self._talk, self._settings = sock, client, rig, talk, settings
        self._others, self._record = others, record
        self._ticks, self._tick = ticks, -1
        # Newest tick with a command, periods in which an old command was repeated, and whether a command came since the
        # last tick.
        self._heard, self._held, self._fresh = -1, 0, True
        # Ticks since the loop's last packet, whether the cart is braked, the loop's farewell or "", and rejected
        # packets.
        self._silent, self._stopped, self._over, self._ignored = 0, False, "", 0
        # Condition of the bench and its text, which all readings carry.
        self._condition, self._text = Condition.WELL, ""

    @property
    def sentence(self) -> str:
        """Summary of ticks and packets for the report of the run's end."""
        return (
            f"{self._tick + 1} ticks; a command was repeated {self._held} times; {self._ignored} packets were rejected"
        )

    def go(self) -> str:
        """Run tick by tick until the loop says goodbye or disconnects, the rig fails, or all ticks are done.

        Return the cause of the end as a text. `_silent` counts the ticks since the loop's last packet, and `_held`
        those without a new command, in which the last one is repeated. `_heard` is the newest tick with a command.
        `_condition` and `_text` are the condition of the bench, which all readings report.
        """
        period, watchdog, clock = self._rig.period, self._settings.watchdog, time.perf_counter
        start = clock()
        for k in range(self._ticks):
            due = start + k * period
            self._wait(due)
            if self._over:
                return self._over
            # Only ticks that the bench itself kept count as silence of the loop.
            self._silent += clock() - due <= period
            self._held += k > 0 and not self._fresh and not self._stopped
            self._fresh = False
            if self._silent * period > _LEAVING:
                return "the loop has disconnected"
            if self._silent * period > watchdog and not self._stopped:
                silence = f"received nothing from the loop for {watchdog:g} s until t = {k * period:.3f} s"
                self._record.ended = f"the bench {silence}"
                self._stop(Condition.SILENCE, f"it {silence}")
            try:
                reading = self._rig.read()
            except ArithmeticError as failure:
                self._send(Bye(str(failure)))
                return str(failure)
            fault = self._rig.fault
            if fault is not None and self._condition is Condition.WELL:
                at_hard_stop = fault.cause == Cause.HARD_STOP
                self._condition, self._text = Condition.HARD_STOP if at_hard_stop else Condition.FAULT, fault.text
                self._record.fault, self._record.fault_at = fault, k
            self._tick = k
            # A tick without any reading sends none, so the loop counts it as lost.
            is_sent = reading.present is None or bool(reading.present.any())
            self._record.read(k, reading, self._rig.truth, sent=is_sent)
            if is_sent:
                content = ReadingPacket(
                    k, tuple(reading.positions.tolist()), self._heard, self._held, 0.0, reading.switch,
                    self._condition, self._text, self._ignored, reading.age,
                )  # fmt: skip
                self._send(content)
        text = f"the bench has completed its {self._ticks} ticks"
        self._send(Bye(text))
        return text

    def _wait(self, due: float) -> None:
        """Handle packets as they come until the time `due` of the next tick, s on the clock `perf_counter`."""
        while (remaining := due - time.perf_counter()) > 0:
            if select.select([self._socket], [], [], remaining)[0]:
                self._handle_packets()
        self._handle_packets()

    def _handle_packets(self) -> None:
        """Handle a few received packets without delaying a tick."""
        for _ in range(_AT_ONCE):
            try:
                data, sender = self._socket.recvfrom(LARGEST)
            except OSError:
                # No more packets, or a loop that has disconnected, which the system reports once.
                return
            if sender == self._client:
                self._receive(data)
            else:
                self._ignored += 1
                self._others(data, sender, Bye("the bench is busy with another loop; wait until it has ended"))

    def _receive(self, data: bytes) -> None:
        """Handle a packet from the loop's address: apply a command, stop the cart on a STOP, end the run on a BYE.

        Each ends the loop's silence. A packet that is not valid or comes again is counted and has no effect.
        """
        try:
            packet = self._talk.unpack(data)
        except ValueError:
            self._ignored += 1
            return
        self._silent = 0
        if isinstance(packet.content, CommandPacket):
            self._apply(packet.content)
        elif packet.content is Kind.STOP:
            if not self._stopped:
                self._record.answered(max(self._tick, 0), None)
            self._stop(self._condition, self._text)
        elif isinstance(packet.content, Bye):
            self._over = packet.content.text
            self._rig.stop()

    def _apply(self, content: CommandPacket) -> None:
        """Apply the loop's command to the rig, unless a newer one has come or its tick is in the future.

        `_heard` is the newest tick with a command, and `_tick` the present one. An acceleration that is not finite
        stops the cart.
        """
        if not self._heard < content.tick <= self._tick:
            return
        self._heard, self._fresh = content.tick, True
        self._record.answered(content.tick, content.acceleration)
        if not math.isfinite(content.acceleration):
            self._stop(Condition.FAULT, f"the command at tick {content.tick} was not finite; the cart was stopped")
        elif not self._stopped:
            self._rig.command(content.acceleration)

    def _stop(self, condition: Condition, text: str) -> None:
        """Brake the cart, and report the condition and its text in all later readings."""
        self._condition, self._text, self._stopped = condition, text, True
        self._rig.stop()

    def _send(self, message: Message) -> None:
        """Send a message to the loop."""
        # A packet that cannot be sent counts as lost; the loop notices.
        with suppress(OSError):
            self._socket.sendto(self._talk.pack(message), self._client)


_START = 120.0
"""Time limit for the process to load and compile, s."""
_END = 5.0
_RECORDED = 700_000
"""Recorded ticks of a run that continues beyond its itinerary, as at night."""


FAULTS: Mapping[str, str] = {
    "drive-reversed": "the cart goes the other way",
    "cart-reversed": "the cart's scale counts backwards",
    "encoder-1-reversed": "the inner arm's encoder counts backwards",
    "encoder-2-reversed": "the next arm's encoder counts backwards",
    "encoders-swapped": "the first two encoders are swapped",
    "angles-not-summed": "each arm's angle is that to the arm before it",
    "encoder-1-factor-4": "the inner arm's encoder counts four times too much",
    "zeros-off": "the encoders are off by 0.03 and -0.02 rad",
    "switch-dead": "the limit switch at the right does not respond",
    "switches-swapped": "the limit switches are swapped",
}
"""Faults that the example bench can simulate, for practice with `dpcontrol commission`."""
_PRACTICE_ZEROS = (0.03, -0.02)


def checked_faults(faults: Sequence[str], arms: int) -> tuple[str, ...]:
    """Return the names of wiring faults that the example bench simulates for practice, after a check.

    Args:
        faults: names of faults, see `FAULTS`.
        arms: number of arms.

    Raises:
        InputError: an unknown fault, or one of an arm that does not exist.
    """
    check_choice("fault", FAULTS, *faults)
    two_arm_faults = [name for name in faults if "-2-" in name or name in ("encoders-swapped", "angles-not-summed")]
    if arms < 2 and two_arm_faults:
        raise InputError(
            f"--fault {two_arm_faults[0]}: requires at least two arms, and the model has {arms}; choose another"
        )
    return tuple(faults)


class FaultyRig:
    """A rig with wiring faults, with which users practise commissioning.

    Args:
        rig: the simulated rig without faults.
        faults: names from `FAULTS`.
        zeros: readings (n,) of its hanging arms, rad.
    """

    truth: None = None

    def __init__(self, rig: Rig, *, faults: Sequence[str], zeros: Sequence[float] = ()) -> None:
        self._rig, self._faults, self.period = rig, frozenset(faults), rig.period
        self._zeros: Sequence[float] = _PRACTICE_ZEROS if "zeros-off" in faults else zeros

    @property
    def fault(self) -> Event | None:
        """Return the bench's fault, or None."""
        return self._rig.fault

    def read(self) -> Reading:
        """Return the next reading through the faulty wiring.

        The angles of the reading are absolute. They are converted to those of the joints, changed as faulty encoders
        would, and added up again, unless that is the fault.
        """
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
        """Accelerate the cart, to the other side if the drive is reversed.

        Args:
            acceleration: demanded acceleration of the cart, m/s².
        """
        self._rig.command(-acceleration if "drive-reversed" in self._faults else acceleration)

    def stop(self) -> None:
        """Brake the cart."""
        self._rig.stop()


_FACTORS = (("encoder-1-reversed", 0, -1.0), ("encoder-2-reversed", 1, -1.0), ("encoder-1-factor-4", 0, 4.0))


@dataclass(frozen=True, eq=False)
class BenchRecipe(Brief):
    """Recipe of a simulated bench, which is built for each run in the bench's process."""

    parameters: ArmChainParameters
    settings: LoopSettings
    limits: Limits
    start: Array
    """Initial state (2n+2,)."""
    ticks: int
    """Ticks of the itinerary."""
    uncertainty: Uncertainty | None = None
    zeros: tuple[float, ...] = ()
    """Readings (n,) of its hanging arms, rad."""
    faults: tuple[str, ...] = ()
    """Names from `FAULTS`."""
    recovering: int = 0
    """Additional ticks for recoveries from falls."""

    @property
    def all_ticks(self) -> int:
        """The maximum number of ticks of a run."""
        return self.ticks + self.recovering

    @property
    def period(self) -> float:
        """Control period, s."""
        return 1 / self.settings.rate

    def rig(self, queued: Sequence[float]) -> Rig:
        """Return a bench at its start, with the disturbances that the settings draw, and any wiring faults and zeros.

        Args:
            queued: pending commands, oldest first, m/s².
        """
        draw = self.settings.draw(self.parameters, ticks=self.ticks, uncertainty=self.uncertainty)
        if self.recovering:
            draw = draw.endless()
        rig = SimulatedRig(draw, self.settings.bench, limits=self.limits, start=self.start, queued=queued)
        return FaultyRig(rig, faults=self.faults, zeros=self.zeros) if self.faults or any(self.zeros) else rig

    def rehearse(self) -> None:
        """Run a few ticks, so that everything is compiled and loaded before the first run in real time."""
        rig = self.rig(())
        for _ in range(min(self.ticks, 100)):
            rig.read()
            rig.command(0.0)


def _serve(recipe: BenchRecipe, settings: BenchServerSettings, key: bytes, pipe: Connection) -> None:
    """Serve one run in its own process, and send address and record to its parent through the pipe.

    `key` is the key that the loop must have.
    """
    # An interrupt from the terminal is meant for the loop, which stops the cart first.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    recipe.rehearse()
    arms = recipe.parameters.count
    with UdpBench(
        recipe.rig, arms=arms, ticks=recipe.all_ticks, period=recipe.period, key=key, settings=settings,
        recorded=max(recipe.ticks, _RECORDED),
    ) as bench:  # fmt: skip
        pipe.send(bench.address)
        bench.serve(runs=1)
        pipe.send(bench.record)


class BenchProcess(AbstractContextManager["BenchProcess"]):
    """Server process of the recipe's bench for one run on loopback, as a context manager.

    The process has a random key, so no other program on this computer can take over the run.

    Raises:
        InputError: the process did not start.
    """

    def __init__(self, recipe: BenchRecipe, settings: BenchServerSettings | None = None) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, child_pipe = context.Pipe(duplex=False)
        # As text, so that an environment variable can carry it.
        self.key = secrets.token_hex(32).encode()
        self._process = context.Process(
            target=_serve, args=(recipe, settings or BenchServerSettings(), self.key, child_pipe), daemon=True
        )
        self._process.start()
        child_pipe.close()
        self.address: tuple[str, int] = ("", 0)
        with suppress(EOFError):
            if self._pipe.poll(_START):
                self.address = self._pipe.recv()
        if not self.address[1]:
            self._end()
            raise InputError("the example bench did not start; `dpcontrol rig` shows why")
        self.record: BenchRecord | None = None
        """Record of the run, available after `controlled_by`."""

    def __exit__(self, *_: object) -> None:
        self._end()

    def controlled_by(self, program: Path, *arguments: str) -> Deadlines | None:
        """Let a program control the run, and return the deadlines that it reports, or None if it reports none.

        The program is called with the bench's address and the arguments. Its environment contains the key. It may print
        its deadlines on stdout as a line of JSON. An interrupt ends it.

        Args:
            program: program to start.
            *arguments: its arguments after the bench's address.

        Raises:
            InputError: the program cannot be started, or ended before the run began.
        """
        host, port = self.address
        name, command = f"--controller-program {program}", [str(program.absolute()), f"udp://{host}:{port}", *arguments]
        environment = {**os.environ, KEY_VARIABLE: self.key.decode()}
        try:
            completed = subprocess.run(
                command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace",
                check=False,
            )  # fmt: skip
        except OSError as error:
            raise InputError(f"{name}: {error.strerror or error}; give an executable program") from error
        finally:
            # An interrupted run has a record too.
            with suppress(EOFError):
                self.record = self._pipe.recv() if self._pipe.poll(_END) else None
        if self.record is None:
            last_error = completed.stderr.strip().splitlines()[-1:] or ["it printed nothing"]
            raise InputError(f"{name} ended with {completed.returncode} before a run began: {last_error[0]}")
        try:
            return Deadlines(**json.loads(completed.stdout))
        except (TypeError, ValueError):
            return None

    def _end(self) -> None:
        """End the server process, also one that hangs, and close the pipe."""
        self._process.terminate()
        self._process.join(_END)
        self._pipe.close()
