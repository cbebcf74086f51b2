"""The other end: a simulated bench that goes by its own clock and is spoken to over UDP, in real time.

At tick k, due at t_0 + k · period, the commands that have come are taken, the newest of them acts, and a reading goes
out. Where none has come the last one goes on acting. A loop that is silent for too long has its cart stopped; only time
in which the bench itself kept its ticks counts. A bench that overslept works off its ticks at once: physics waits for
nobody. Between ticks it sleeps, in `select`, so that a command's arrival is noted; the last `spin` seconds it polls.

One run at a time, made ready at HELLO and begun at START; packets in `dpcontrol.rig.packets`.
The example bench of a run lives in a process of its own, so that the loop and it share neither interpreter nor core.
"""

import math
import multiprocessing
import select
import signal
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import ArmChainParameters, Uncertainty
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.processes import end_with_parent
from dpcontrol.foundation.settings import Settings, setting
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.result import Rig
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.references.problem import Limits
from dpcontrol.rig import packets as packets
from dpcontrol.rig.client import real_time_priority, without_collecting
from dpcontrol.rig.packets import CommandPacket, Condition, Hello, Kind, ReadingPacket, Welcome

Say = Callable[[str], None]

_LEAVING = 2.0
"""Seconds of silence after which a loop counts as gone, and the next may come."""
_HESITATING = 60.0
"""The same between HELLO and START; the arms are held until then."""
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


class UdpBench:
    """Serves a bench on a socket of its own; a context manager.

    make: makes the rig of a run from the commands on their way. say: called with what happens.

    Raises:
        InputError: the port is not available.
    """

    def __init__(
        self,
        make: Callable[[Sequence[float]], Rig],
        *,
        arms: int,
        ticks: int,
        host: str = "127.0.0.1",
        port: int = 0,
        settings: BenchServerSettings | None = None,
        say: Say = lambda text: None,
    ) -> None:
        self._make, self._arms, self._ticks, self._say = make, arms, ticks, say
        self._settings = settings or BenchServerSettings()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            why = getattr(error, "strerror", None) or error
            raise InputError(f"rig: port {port} of {host}: {why}; choose another --port, or 0 for any") from error
        self._socket.setblocking(False)
        self.address: tuple[str, int] = self._socket.getsockname()
        """Where the bench can be spoken to."""

    def __enter__(self) -> "UdpBench":
        return self

    def __exit__(self, *exception: object) -> None:
        self._socket.close()

    def serve(self, *, runs: int = 0) -> None:
        """Serve so many runs, one after the other; 0: until interrupted."""
        served = 0
        while not runs or served < runs:
            select.select([self._socket], [], [])
            for _, content, sender in _received(self._socket):
                if isinstance(content, Hello):
                    self._say(f"a run begins for {sender[0]}:{sender[1]}")
                    rig = self._make(content.queued)
                    with without_collecting(), real_time_priority() if self._settings.real_time else nullcontext():
                        welcome = Welcome(self._arms, rig.period, self._ticks)
                        run = _BenchRun(self._socket, sender, rig, welcome, self._settings)
                        ended = run.go()
                    self._say(f"run ended: {ended}; {run.sentence}")
                    served += 1
                    break


class _BenchRun:
    """One run of the bench for one loop."""

    def __init__(
        self, sock: socket.socket, client: Any, rig: Rig, welcome: Welcome, settings: BenchServerSettings
    ) -> None:
        self._socket, self._client, self._rig, self._settings = sock, client, rig, settings
        self._welcome = packets.welcome(welcome)
        self._ticks, self._tick = welcome.ticks, -1
        self._sent_at = [0.0] * _REMEMBERED
        self._heard, self._held, self._trip, self._fresh = -1, 0, 0.0, True
        self._silent, self._stopped, self._ready, self._over = 0, False, False, ""
        self._condition, self._text = Condition.WELL, ""
        self._worst, self._behind = 0.0, 0

    @property
    def sentence(self) -> str:
        """How it kept time."""
        return (
            f"{self._tick + 1} ticks, {self._behind} of them a period late or later, the worst {1e3 * self._worst:.3g} "
            f"ms; a command was repeated {self._held} times"
        )

    def go(self) -> str:
        """Run until the loop says goodbye or is gone; return why it ended."""
        period, clock = self._rig.period, time.perf_counter
        watchdog, leaving = self._settings.watchdog / period, _LEAVING / period
        if not self._started():
            return self._over or "the loop did not start"
        begin = clock()
        for k in range(self._ticks):
            due = begin + k * period
            self._wait(due)
            self._take(clock())
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
                self._stop(
                    Condition.SILENCE, f"it heard nothing from the loop for {self._settings.watchdog:g} s "
                    f"until t = {k * period:.3f} s",
                )  # fmt: skip
            try:
                reading = self._rig.read()
            except ArithmeticError as failure:
                self._send(packets.bye(str(failure)))
                return str(failure)
            if self._rig.fault and self._condition is Condition.WELL:
                self._condition, self._text = Condition.FAULT, self._rig.fault
            self._tick = k
            self._sent_at[k % _REMEMBERED] = clock()
            # A tick without any reading sends none: the loop finds it lost.
            if reading.present is None or reading.present.any():
                content = ReadingPacket(
                    k, tuple(reading.positions.tolist()), self._heard, self._held, self._trip, reading.switch,
                    self._condition, self._text,
                )  # fmt: skip
                self._send(packets.reading(content))
        text = f"the bench was made for {self._ticks} ticks and has run them"
        self._send(packets.bye(text))
        return text

    def _started(self) -> bool:
        """Answer HELLO and wait for START; tell whether it came."""
        self._send(self._welcome)
        until = time.perf_counter() + _HESITATING
        while not self._ready and not self._over and (left := until - time.perf_counter()) > 0:
            select.select([self._socket], [], [], left)
            self._take(time.perf_counter())
        return self._ready and not self._over

    def _wait(self, due: float) -> None:
        """Wait until `due`, taking what comes: asleep, then polling."""
        clock, spin = time.perf_counter, self._settings.spin
        while (left := due - clock() - spin) > 0:
            if select.select([self._socket], [], [], left)[0]:
                self._take(clock())
        while clock() < due:
            pass

    def _take(self, now: float) -> None:
        """Take the packets that have come."""
        for kind, content, sender in _received(self._socket):
            if sender != self._client:
                if kind is Kind.HELLO:
                    self._send(packets.bye("the bench is busy with another loop; wait for it to end"), sender)
                continue
            self._silent = 0
            if isinstance(content, CommandPacket):
                self._obey(content, now)
            elif kind is Kind.HELLO and self._tick < 0:
                self._send(self._welcome)
            elif kind is Kind.START:
                self._ready = True
            elif kind is Kind.STOP:
                self._stop(self._condition, self._text)
            elif kind is Kind.BYE:
                self._over = str(content)
                self._rig.stop()

    def _obey(self, content: CommandPacket, now: float) -> None:
        """Let a command act, unless a newer one has come or it is for a tick that has not been."""
        if not self._heard < content.tick <= self._tick:
            return
        self._heard, self._fresh = content.tick, True
        if self._tick - content.tick < _REMEMBERED:
            self._trip = now - self._sent_at[content.tick % _REMEMBERED]
        if not math.isfinite(content.acceleration):
            self._stop(Condition.FAULT, f"the command at tick {content.tick} was not finite; the cart was stopped")
        elif not self._stopped:
            self._rig.command(content.acceleration)

    def _stop(self, condition: Condition, text: str) -> None:
        self._condition, self._text, self._stopped = condition, text, True
        self._rig.stop()

    def _send(self, data: bytes, to: Any = None) -> None:
        # A packet that cannot be sent is like one lost on the way: the loop notices.
        with suppress(OSError):
            self._socket.sendto(data, self._client if to is None else to)


def _received(sock: socket.socket) -> list[tuple[Kind, packets.Packet, Any]]:
    """Return the packets that have come, with their senders; malformed packets are skipped."""
    out = []
    while True:
        try:
            kind, content, sender = packets.received(sock)
        except OSError:
            # Nothing more; or a loop that has left, which the system reports once.
            return out
        if kind is not None:
            out.append((kind, content, sender))


_START = 120.0
"""Seconds for the process to load and compile."""
_END = 5.0


@dataclass(frozen=True, eq=False)
class BenchRecipe:
    """What makes a simulated bench anew for each run: the model's arms, what is drawn; start (2n+2,), ticks."""

    parameters: ArmChainParameters
    settings: LoopSettings
    limits: Limits
    start: NDArray[np.float64]
    ticks: int
    uncertainty: Uncertainty | None = None

    def rig(self, queued: Sequence[float]) -> SimulatedRig:
        """Return a bench at its start, with the commands (m/s²) on their way, oldest first."""
        draw = self.settings.draw(self.parameters, ticks=self.ticks, uncertainty=self.uncertainty)
        return SimulatedRig(draw, self.settings.bench, limits=self.limits, start=self.start, queued=queued)

    def rehearse(self) -> None:
        """Have everything compiled and in memory before the first run."""
        rig = self.rig(())
        for _ in range(min(self.ticks, 100)):
            rig.read()
            rig.command(0.0)


def _serve(recipe: BenchRecipe, settings: BenchServerSettings, pipe: Connection) -> None:
    # An interrupt from the terminal is for the loop, which stops the cart first.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    recipe.rehearse()
    arms = recipe.parameters.count
    with UdpBench(recipe.rig, arms=arms, ticks=recipe.ticks, settings=settings, say=pipe.send) as bench:
        pipe.send(bench.address)
        bench.serve(runs=1)


class BenchProcess:
    """Serves one run of the recipe's bench on loopback; a context manager, which ends the process.

    Raises:
        InputError: the process did not come up.
    """

    def __init__(self, recipe: BenchRecipe, settings: BenchServerSettings | None = None) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe(duplex=False)
        self._process = context.Process(
            target=_serve, args=(recipe, settings or BenchServerSettings(), theirs), daemon=True
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
        """What the bench said of the run, once the block has been left."""

    def __enter__(self) -> "BenchProcess":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.join(_END)
        with suppress(EOFError, OSError):
            while self._pipe.poll():
                self.said.append(self._pipe.recv())
        self._end()

    def _end(self) -> None:
        if self._process.is_alive():
            self._process.terminate()
        self._process.join(_END)
        self._pipe.close()
