"""A bench that is attacked while a run goes on: only the run's own loop drives the cart, and what else came is counted.

A raw socket makes spoofed packets with the loop's address as their sender. If the system reserves that for root, other
sockets send them.
"""

import random
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path

import pytest
from bench_at_hand import KEY, LONG, PATIENT, Raw, Toy, next_reading, raw, served
from command_line import dpcontrol
from hypothesis import given, settings, strategies as st

from dpcontrol.foundation.errors import InputError
from dpcontrol.rig import packets as packets
from dpcontrol.rig.bench import BenchServerSettings, UdpBench
from dpcontrol.rig.client import LinkSettings, UdpRig
from dpcontrol.rig.packets import KEY_VARIABLE, Condition, Kind, Role, Talk, shared_key

FEW = 200  # Few enough that a socket holds them all, should the bench stall.
FORGED = 1e6
"""m/s² that every forged command asks for, and no loop here."""

Address = tuple[str, int]


@contextmanager
def sender_as(source: Address, to: Address) -> Iterator[tuple[Callable[[bytes], object], bool]]:
    """Yield what sends a datagram to `to` that seems to come from `source`, and false if the system forbids that."""
    try:
        forging = socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_UDP)
    except PermissionError:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plain:
            yield lambda data: plain.sendto(data, to), False
        return
    with forging:
        # A UDP head without a checksum, which IPv4 allows.
        yield lambda data: forging.sendto(struct.pack("!HHHH", source[1], to[1], 8 + len(data), 0) + data, to), True


def hostile(rng: random.Random, known: list[bytes]) -> bytes:
    """Return one packet of an attacker who has heard the packets `known`, and has no key."""
    match rng.randrange(5):
        case 0:
            return rng.randbytes(rng.randrange(120))
        case 1:
            whole = rng.choice(known)
            return whole[: rng.randrange(len(whole))]
        case 2:
            return rng.choice(known)
        case 3:
            forged = packets.CommandPacket(rng.randrange(2000), FORGED)
            return packets.packed(forged, Role.LOOP, session=rng.getrandbits(64), sequence=rng.getrandbits(32))
        case _:
            message = rng.choice([Kind.HELLO, packets.Start((FORGED,)), Kind.STOP, packets.Bye("go away")])
            return packets.packed(message, Role.LOOP, session=rng.getrandbits(64), sequence=rng.getrandbits(32))


@pytest.mark.parametrize("spoofed", [False, True])
@pytest.mark.parametrize("key", [b"", KEY], ids=["open", "sealed"])
def test_packets_from_anyone_but_the_runs_own_loop_are_ignored_and_counted(key: bytes, spoofed: bool) -> None:
    toy, rng = Toy(period=0.005), random.Random(1)
    with served(toy, key=key) as bench, raw(bench, key=key) as client, ExitStack() as stack:
        own = client.socket.getsockname()
        if spoofed:
            send, _ = stack.enter_context(sender_as(own, bench.address))
        else:
            others = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(5)]
            send = lambda data: rng.choice(others).sendto(data, bench.address)  # noqa: E731
        known = [client.send(packets.CommandPacket(next_reading(client).tick, 0.0))]
        sent = 0
        while sent < FEW:
            tick = next_reading(client).tick
            for _ in range(10):
                send(hostile(rng, known))
            sent += 10
            known.append(client.send(packets.CommandPacket(tick, float(tick))))
        while (reading := next_reading(client)).ignored < FEW:
            pass
        assert reading.condition is Condition.WELL
    assert reading.ignored == FEW
    assert toy.commands == [(tick, value) for tick, value in toy.commands if value <= tick]
    assert toy.stopped_at is None or toy.stopped_at >= reading.tick


def test_the_loop_accepts_its_bench_only_and_counts_other_packets() -> None:
    toy, rng = Toy(period=0.005), random.Random(2)
    with served(toy) as bench, UdpRig(bench.address, settings=LONG) as rig:
        own = rig._channel.getsockname()
        with sender_as(bench.address, own) as (send, forged):
            content = packets.ReadingPacket(10**6, (9e9,) * 3, 0, 0, 0.0, 0, Condition.FAULT, "on fire")
            for k in range(20):
                reading = rig.read()
                assert (reading.positions == k).all()
                send(packets.packed(content, Role.BENCH, session=5, sequence=10**6))
                send(packets.packed(packets.Bye("go home"), Role.BENCH, session=5, sequence=10**6))
                send(rng.randbytes(50))
        while forged and rig.deadlines.rejected < 60:
            rig.read()
        assert rig.fault is None
    assert (rig.deadlines.lost, rig.deadlines.rejected) == (0, 60 if forged else 0)


def test_a_run_that_was_recorded_cannot_be_played_again() -> None:
    first, second = Toy(), Toy()
    toys, ended = iter([first, second]), threading.Event()

    def say(text: str) -> None:
        if text.startswith("run ended"):
            ended.set()

    with UdpBench(
        lambda queued: next(toys), arms=2, ticks=10_000, period=0.002, settings=PATIENT, key=KEY, report=say
    ) as bench:
        thread = threading.Thread(target=bench.serve, kwargs={"runs": 2}, daemon=True)
        thread.start()
        client = Raw(bench.address, key=KEY)
        with closing(client.socket):
            recorded = [client.send(Kind.HELLO)]
            client.talk = Talk(Role.LOOP, client.heard().content.session, key=KEY)
            recorded.append(client.send(packets.Start(())))
            for k in range(5):
                next_reading(client)
                recorded.append(client.send(packets.CommandPacket(k, 1.0)))
            recorded.append(client.send(packets.Bye("done")))
            assert ended.wait(30)
            for data in recorded * 3:
                client.socket.send(data)
            # It still serves new loops.
            with UdpRig(bench.address, settings=LONG, key=KEY) as rig:
                rig.read()
        thread.join(30)
    assert not thread.is_alive()
    assert second.commands == []


def test_repeated_packets_do_not_keep_a_dead_loops_cart_moving() -> None:
    toy = Toy()
    with served(toy, settings=BenchServerSettings(watchdog=0.05)) as bench, raw(bench) as client:
        data = client.send(packets.CommandPacket(next_reading(client).tick, 1.0))
        while (reading := next_reading(client)).condition is Condition.WELL:
            client.socket.send(data)
        assert reading.condition is Condition.SILENCE
    assert toy.stopped_at is not None


def test_a_loop_that_never_starts_does_not_block_others() -> None:
    with served(Toy()) as bench, ExitStack() as stack:
        for _ in range(50):
            client = Raw(bench.address)
            stack.enter_context(closing(client.socket))
            client.greet()
        with UdpRig(bench.address, settings=LONG) as rig:
            assert (rig.read().positions == 0).all()


def test_a_bench_beyond_loopback_requires_a_key_or_insecure() -> None:
    assert dpcontrol("rig", "outer-turn", "--host", "0.0.0.0").code == 2
    assert dpcontrol("rig", "outer-turn", "--host", "", "--insecure").code == 2
    with pytest.raises(InputError, match="shared key"):
        UdpBench(lambda queued: Toy(), arms=2, ticks=1, period=1.0, host="0.0.0.0")
    for allowed in ({"key": KEY}, {"insecure": True}):
        UdpBench(lambda queued: Toy(), arms=2, ticks=1, period=1.0, host="0.0.0.0", **allowed).__exit__()
    with pytest.raises(InputError, match="--key-file"):
        UdpRig(("192.0.2.1", 9))


@pytest.mark.parametrize(
    ("benchs", "loops"),
    [
        pytest.param(KEY, b"", id="loop has none"),
        pytest.param(KEY, KEY[::-1], id="another"),
        pytest.param(b"", KEY, id="bench has none"),
    ],
)
def test_ends_without_the_same_key_report_it(benchs: bytes, loops: bytes) -> None:
    with served(Toy(), key=benchs) as bench:
        with pytest.raises(InputError, match="the same key"):
            UdpRig(bench.address, key=loops, settings=LinkSettings(answer=0.3))
        with UdpRig(bench.address, key=benchs, settings=LONG) as rig:
            assert (rig.read().positions == 0).all()


def test_the_key_comes_from_a_file_or_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(KEY_VARIABLE, raising=False)
    assert shared_key() == b""
    file = tmp_path / "key"
    file.write_bytes(b"0123456789abcdef\n")
    assert shared_key(file) == b"0123456789abcdef"
    monkeypatch.setenv(KEY_VARIABLE, "another-key-of-some-length")
    assert shared_key() == b"another-key-of-some-length"
    assert shared_key(file) == b"0123456789abcdef"
    file.write_text("short")
    with pytest.raises(InputError, match="too short"):
        shared_key(file)
    with pytest.raises(InputError):
        shared_key(tmp_path / "none")
    monkeypatch.setenv(KEY_VARIABLE, "")
    with pytest.raises(InputError, match=KEY_VARIABLE):
        shared_key()
    assert dpcontrol("run", "outer-turn", "--insecure").code == 2


READING = packets.ReadingPacket(9, (0.1, 0.2, 0.3), 8, 4, 0.002, 0, Condition.WELL, "so")
MESSAGES: list[packets.Message] = [
    Kind.HELLO, packets.Start((1.0,)), packets.Welcome(2, 0.1, 3, 4), Kind.STOP, READING,
    READING._replace(age=0.1), packets.CommandPacket(3, 1.0), packets.Bye("so"),
]  # fmt: skip


@settings(derandomize=True, deadline=None, max_examples=2000)
@given(
    message=st.sampled_from(MESSAGES), changes=st.dictionaries(st.integers(0, 80), st.integers(0, 255), max_size=3),
    end=st.none() | st.integers(0, 80), more=st.binary(max_size=30),
)  # fmt: skip
def test_a_packet_is_read_as_it_was_sent_or_refused(
    message: packets.Message, changes: dict[int, int], end: int | None, more: bytes
) -> None:
    whole = packets.packed(message, Role.LOOP, session=1, sequence=1)
    assert packets.unpacked(whole, Role.LOOP) == packets.ReceivedPacket(1, 1, message)
    spoilt = bytearray(whole[:end] + more)
    for place, value in changes.items():
        spoilt[place : place + 1] = bytes([value])[: len(spoilt[place : place + 1])]
    for key in (b"", KEY):
        data = bytes(spoilt) if not key else bytes(spoilt) + more[:16]
        with suppress(ValueError):
            heard = packets.unpacked(data, Role.LOOP, key=key)
            assert not key
            again = packets.packed(heard.content, Role.LOOP, session=heard.session, sequence=heard.sequence)
            # Packets without content ignore the head's count, and NaN differs from itself.
            assert (again[:6], again[8:]) == (data[:6], data[8:])
