"""A test bench: a rig that records its commands, served over UDP, and loops that send any packet."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dpcontrol.logs import Event
from dpcontrol.loop.protocols import Reading
from dpcontrol.rig import packets as packets
from dpcontrol.rig.bench import BenchServerSettings, UdpBench
from dpcontrol.rig.client import LinkSettings
from dpcontrol.rig.packets import Kind, Role, Talk

KEY = bytes(range(32))
PATIENT = BenchServerSettings(watchdog=60.0)  # A stalled test must not count as a silent loop.
LONG = LinkSettings(answer=60.0, patience=60.0, silence=60.0)


@dataclass
class Toy:
    """A rig whose positions are its tick, and which records its commands."""

    period: float = 0.002
    fault: Event | None = None
    tick: int = -1
    commands: list[tuple[int, float]] = field(default_factory=list)
    stopped_at: int | None = None
    queued: tuple[float, ...] = ()
    truth: None = None
    age: float | None = None

    def read(self) -> Reading:
        self.tick += 1
        return Reading(self.tick * self.period, np.full(3, float(self.tick)), age=self.age)

    def command(self, acceleration: float) -> None:
        self.commands.append((self.tick, acceleration))

    def stop(self) -> None:
        if self.stopped_at is None:
            self.stopped_at = self.tick


@contextmanager
def served(
    toy: Toy, *, settings: BenchServerSettings = PATIENT, ticks: int = 100_000, key: bytes = b""
) -> Iterator[UdpBench]:
    def made(commands: tuple[float, ...]) -> Toy:
        toy.queued = commands
        return toy

    with UdpBench(made, arms=2, ticks=ticks, period=toy.period, settings=settings, key=key) as bench:
        thread = threading.Thread(target=bench.serve, kwargs={"runs": 1}, daemon=True)
        thread.start()
        yield bench
        thread.join(60)
        assert not thread.is_alive()


class Raw:
    def __init__(self, address: tuple[str, int], *, key: bytes = b"") -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(30)
        self.socket.connect(address)
        self.talk, self.key = Talk(Role.LOOP, 77, key=key), key

    def send(self, message: packets.Message) -> bytes:
        data = self.talk.pack(message)
        self.socket.send(data)
        return data

    def heard(self) -> packets.ReceivedPacket:
        return packets.unpacked(self.socket.recv(4096), Role.BENCH, key=self.key)

    def greet(self) -> packets.Welcome:
        self.send(Kind.HELLO)
        welcome = self.heard().content
        assert isinstance(welcome, packets.Welcome)
        self.talk = Talk(Role.LOOP, welcome.session, key=self.key)
        return welcome


@contextmanager
def raw(bench: UdpBench, *, key: bytes = b"") -> Iterator[Raw]:
    """Yield a plain loop during a run, and end the run."""
    client = Raw(bench.address, key=key)
    with closing(client.socket):
        client.greet()
        client.send(packets.Start(()))
        yield client
        client.send(packets.Bye("done"))


@contextmanager
def relayed(address: tuple[str, int], passes: Callable[[bytes], bool]) -> Iterator[tuple[str, int]]:
    """Yield the address of a relay that forwards only some packets."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as relay:
        relay.bind(("127.0.0.1", 0))
        relay.settimeout(0.05)
        over = threading.Event()

        def carry() -> None:
            loop: tuple[str, int] | None = None
            while not over.is_set():
                with suppress(TimeoutError):
                    data, sender = relay.recvfrom(4096)
                    if sender != address:
                        loop = sender
                    if passes(data) and loop is not None:
                        relay.sendto(data, address if sender != address else loop)

        thread = threading.Thread(target=carry, daemon=True)
        thread.start()
        yield relay.getsockname()
        over.set()
        thread.join()


def welcomed(bench: socket.socket, welcome: packets.Welcome) -> tuple[Any, Talk]:
    """Accept a loop at a bench; return the loop's address and the bench's side of the run."""
    data, client = bench.recvfrom(4096)
    session = packets.unpacked(data, Role.LOOP).session
    bench.sendto(packets.packed(welcome, Role.BENCH, session=session, sequence=1), client)
    return client, Talk(Role.BENCH, welcome.session)


def next_reading(client: Raw) -> packets.ReadingPacket:
    content = client.heard().content
    assert isinstance(content, packets.ReadingPacket)
    return content


def until_tick(toy: Toy, tick: int) -> None:
    """Wait until the bench reaches a tick of its run, which may end early on a busy computer."""
    end = time.monotonic() + 60
    while toy.tick < tick:
        assert time.monotonic() < end, f"the run stays at tick {toy.tick}"
        threading.Event().wait(0.002)
