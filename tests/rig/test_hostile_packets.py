"""A bench that is attacked while a run goes on: only the run's own loop drives the cart, and what else came is counted.

A raw socket makes spoofed packets with the loop's address as their sender. If the system reserves that for root, other
sockets send them.
"""

import math
import random
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path

import pytest
from bench_at_hand import KEY, LONG, PATIENT, Raw, Toy, next_reading, raw, served, welcomed
from command_line import PROGRAM, dpcontrol, dpcontrol_program

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import read_log
from dpcontrol.rig import packets as packets
from dpcontrol.rig.bench import BenchServerSettings, UdpBench
from dpcontrol.rig.client import Deadlines, LinkSettings, UdpRig, parse_address
from dpcontrol.rig.packets import KEY_VARIABLE, Condition, Kind, Role, Talk, shared_key

FEW, MANY = 200, 100_000  # Few enough that a socket holds them all, should the bench stall.
PAUSE = 0.001
"""s between bursts of the flood, each of as many packets as FEW."""
FORGED = 1e6
"""m/s² that every forged command asks for, and no loop here."""

Address = tuple[str, int]


def spoofs() -> bool:
    """True if the system permits packets with a forged sender."""
    try:
        socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_UDP).close()
    except PermissionError:
        return False
    return True


@contextmanager
def sender_as(source: Address, to: Address) -> Iterator[Callable[[bytes], None]]:
    """Yield what sends a datagram to `to` that seems to come from `source`; from elsewhere where the system objects."""
    with ExitStack() as stack:
        if not spoofs():
            plain = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            yield lambda data: plain.sendto(data, to)
            return
        spoofing = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_UDP))
        # A UDP head without a checksum, which IPv4 allows.
        yield lambda data: spoofing.sendto(struct.pack("!HHHH", source[1], to[1], 8 + len(data), 0) + data, to)


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
            forged = packets.command(rng.randrange(2000), FORGED)
            return packets.packed(forged, Role.LOOP, session=rng.getrandbits(64), sequence=rng.getrandbits(32))
        case _:
            message = rng.choice([packets.HELLO, packets.start([FORGED]), packets.STOP, packets.bye("go away")])
            return packets.packed(message, Role.LOOP, session=rng.getrandbits(64), sequence=rng.getrandbits(32))


@pytest.mark.parametrize("spoofed", [False, True])
@pytest.mark.parametrize("key", [b"", KEY], ids=["open", "sealed"])
def test_packets_from_anyone_but_the_runs_own_loop_are_ignored_and_counted(key: bytes, spoofed: bool) -> None:
    toy, rng = Toy(period=0.005), random.Random(1)
    with served(toy, key=key) as bench, raw(bench, key=key) as client, ExitStack() as stack:
        own = client.socket.getsockname()
        if spoofed:
            send = stack.enter_context(sender_as(own, bench.address))
        else:
            others = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(5)]
            send = lambda data: rng.choice(others).sendto(data, bench.address)  # noqa: E731
        known = [client.send(packets.command(next_reading(client).tick, 0.0))]
        sent = 0
        while sent < FEW:
            tick = next_reading(client).tick
            for _ in range(10):
                send(hostile(rng, known))
            sent += 10
            known.append(client.send(packets.command(tick, float(tick))))
        while (reading := next_reading(client)).ignored < FEW:
            pass
        assert reading.condition is Condition.WELL
    assert reading.ignored == FEW
    assert toy.commands == [(tick, value) for tick, value in toy.commands if value <= tick]
    assert toy.stopped_at is None or toy.stopped_at >= reading.tick


def test_the_loop_accepts_its_bench_only_and_counts_other_packets() -> None:
    toy, rng = Toy(period=0.005), random.Random(2)
    with served(toy) as bench, UdpRig(bench.address, settings=LONG) as rig:
        own = rig._socket.getsockname()
        with sender_as(bench.address, own) as send:
            content = packets.ReadingPacket(10**6, (9e9,) * 3, 0, 0, 0.0, 0, Condition.FAULT, "on fire")
            for k in range(20):
                reading = rig.read()
                assert (reading.positions == k).all()
                send(packets.packed(packets.reading(content), Role.BENCH, session=5, sequence=10**6))
                send(packets.packed(packets.bye("go home"), Role.BENCH, session=5, sequence=10**6))
                send(rng.randbytes(50))
        while spoofs() and rig.deadlines.refused < 60:
            rig.read()
        assert rig.fault == ""
    assert (rig.deadlines.lost, rig.deadlines.refused) == (0, 60 if spoofs() else 0)


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
            recorded = [client.send(packets.HELLO)]
            client.talk = Talk(Role.LOOP, client.heard().content.session, key=KEY)
            recorded.append(client.send(packets.start()))
            for k in range(5):
                next_reading(client)
                recorded.append(client.send(packets.command(k, 1.0)))
            recorded.append(client.send(packets.bye("done")))
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
        data = client.send(packets.command(next_reading(client).tick, 1.0))
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


def test_only_who_gets_the_welcome_can_start_a_run() -> None:
    made: list[object] = []
    with UdpBench(made.append, arms=2, ticks=9, period=0.002) as bench, Raw(bench.address).socket as client:  # type: ignore[arg-type]
        client.sendto(packets.packed(packets.start(), Role.LOOP, session=0, sequence=1), bench.address)
        assert not bench._served(*bench._socket.recvfrom(4096))
    assert made == []


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_commands_on_their_way_that_are_not_finite_begin_nothing(value: float) -> None:
    with served(Toy()) as bench:
        with pytest.raises(ArithmeticError, match="a pending command is not a finite number"):
            UdpRig(bench.address, queued=[value], settings=LONG).read()
        with UdpRig(bench.address, settings=LONG) as rig:
            rig.read()


def test_a_bench_beyond_loopback_requires_a_key_or_insecure(tmp_path: Path) -> None:
    for host in ("0.0.0.0", "192.0.2.1"):
        ended = dpcontrol("rig", "outer-turn", "--host", host)
        assert (ended.code, host in ended.message, "--key-file" in ended.message) == (2, True, True)
        assert "--insecure" in ended.message
    with pytest.raises(InputError, match="shared key"):
        UdpBench(lambda queued: Toy(), arms=2, ticks=1, period=1.0, host="0.0.0.0")
    for allowed in ({"key": KEY}, {"insecure": True}):
        UdpBench(lambda queued: Toy(), arms=2, ticks=1, period=1.0, host="0.0.0.0", **allowed).__exit__()
    with pytest.raises(InputError, match=r"192\.0\.2\.1.*--key-file.*--insecure"):
        UdpRig(("192.0.2.1", 9))


def test_a_bench_on_all_interfaces_serves_one_loop_with_its_key_and_rejects_a_second_as_busy() -> None:
    toy = Toy()
    bench = UdpBench(lambda queued: toy, arms=2, ticks=10_000, period=0.002, host="0.0.0.0", key=KEY, settings=PATIENT)
    with bench:
        thread = threading.Thread(target=bench.serve, kwargs={"runs": 1}, daemon=True)
        thread.start()
        here = ("127.0.0.1", bench.address[1])
        with UdpRig(here, settings=LONG, key=KEY) as rig:
            for k in range(20):
                assert (rig.read().positions == k).all()
                rig.command(1.0)
            with pytest.raises(InputError, match="busy with another loop"):
                UdpRig(here, settings=LONG, key=KEY)
            rig.read()
        thread.join(30)
    assert not thread.is_alive()
    assert toy.commands


def test_an_empty_host_does_not_mean_all_interfaces() -> None:
    for host in ("", " "):
        ended = dpcontrol("rig", "outer-turn", "--host", host, "--insecure")
        assert ended.code == 2
        assert "--host is empty; give 127.0.0.1 for this computer alone, 0.0.0.0 for all interfaces" in ended.message


@pytest.mark.parametrize(
    ("benchs", "loops", "said"),
    [
        (KEY, b"", "requires its shared key: give its file with --key-file"),
        (KEY, KEY[::-1], r"refused: a packet is not sealed with the shared key\).*the same key"),
        (b"", KEY, r"refused: a packet is not sealed with the shared key\).*the same key"),
    ],
    ids=["loop has none", "another", "bench has none"],
)
def test_ends_without_the_same_key_report_it(benchs: bytes, loops: bytes, said: str) -> None:
    with served(Toy(), key=benchs) as bench:
        with pytest.raises(InputError, match=said):
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
    for wrong, said in ((file, "a key of 5 bytes is too short"), (tmp_path / "none", "No such file")):
        ended = dpcontrol("rig", "outer-turn", "--key-file", wrong)
        assert (ended.code, said in ended.message) == (2, True), ended.message
        assert "--key-file" in ended.message
    monkeypatch.setenv(KEY_VARIABLE, "")
    with pytest.raises(InputError, match=KEY_VARIABLE):
        shared_key()
    assert dpcontrol("run", "outer-turn", "--insecure").code == 2


def test_a_loop_of_another_version_is_rejected_with_the_remedy() -> None:
    with served(Toy()) as bench, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.settimeout(30)
        other.sendto(struct.pack("<4sBBHQI", b"dpcb", 3, Kind.HELLO, 0, 7, 1), bench.address)
        heard = packets.unpacked(other.recv(4096), Role.BENCH)
        assert (heard.kind, heard.session) == (Kind.BYE, 7)
        assert heard.content == "this bench uses version 2 of the protocol; update the loop's dpcontrol"
        with UdpRig(bench.address, settings=LONG) as rig:
            rig.read()


@pytest.mark.parametrize("period", [0.0, -0.001, math.nan, math.inf, 1e9])
def test_a_welcome_with_an_impossible_period_is_one_sentence(period: float) -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as bench:
        bench.bind(("127.0.0.1", 0))
        bench.settimeout(30)
        thread = threading.Thread(target=welcomed, args=(bench, packets.Welcome(2, period, 100, 5)))
        thread.start()
        with pytest.raises(InputError, match=r"announces a period of .* s: it must be above 0 and at most 60 s"):
            UdpRig(bench.getsockname(), settings=LONG)
        thread.join()


def test_readings_that_do_not_fit_the_welcome_are_rejected_and_invalid_numbers_are_absent() -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as bench:
        bench.bind(("127.0.0.1", 0))
        bench.settimeout(30)

        def odd() -> None:
            client, talk = welcomed(bench, packets.Welcome(2, 0.001, 100, 5))
            while bench.recvfrom(4096)[0][5] != Kind.START:
                pass
            for tick, positions in (
                (0, (1.0, 2.0)), (4000, (1.0, 2.0, 3.0)), (0, (1.0, 2.0, 3.0)), (1, (math.nan, 5.0, math.inf)),
            ):  # fmt: skip
                content = packets.ReadingPacket(tick, positions, -1, 0, 0.0, 0, Condition.WELL, "")
                bench.sendto(talk.pack(packets.reading(content)), client)

        thread = threading.Thread(target=odd)
        thread.start()
        with UdpRig(bench.getsockname(), settings=LONG) as rig:
            first, second = rig.read(), rig.read()
        thread.join()
    assert first.present is None
    assert first.positions.tolist() == [1.0, 2.0, 3.0]
    assert second.positions.tolist() == [1.0, 5.0, 3.0]
    assert second.present is not None
    assert second.present.tolist() == [False, True, False]
    assert rig.deadlines.refused == 2


@pytest.mark.parametrize("host", ["a" * 64, "a" * 300, "a..b", "x" * 100_000, "ü" * 70], ids=range(5))
def test_an_absurd_host_is_one_sentence(host: str) -> None:
    ended = dpcontrol("run", "outer-turn", "--rig", f"udp://{host}:47000")
    assert (ended.code, len(ended.message) < 300) == (2, True)
    assert "rig 'udp://" in ended.message
    assert "must be udp://HOST:PORT" in ended.message
    with pytest.raises(InputError, match="check the address"):
        UdpRig((host, 47000))


def test_a_host_that_is_no_text_is_one_sentence() -> None:
    ended = dpcontrol("run", "outer-turn", "--rig", "udp://\ud800:47000")
    assert ended.code == 2
    assert "must be one line of UTF-8" in ended.message
    with pytest.raises(InputError, match="check the address"):
        UdpRig(("\ud800", 47000))


def test_an_empty_address_does_not_mean_a_simulated_run() -> None:
    assert "must be udp://HOST:PORT" in dpcontrol("run", "outer-turn", "--rig", "").message
    with pytest.raises(InputError, match="check the address"):
        UdpRig(("\0", 5))


def test_no_bytes_whatever_break_the_parser() -> None:
    rng = random.Random(3)
    content = packets.ReadingPacket(9, (0.1, 0.2, 0.3), 8, 4, 0.002, 0, Condition.WELL, "so")
    messages = [packets.HELLO, packets.start([1.0]), packets.welcome(packets.Welcome(2, 0.1, 3, 4)), packets.STOP]
    messages += [packets.reading(content), packets.command(3, 1.0), packets.bye("so")]
    whole = [packets.packed(m, Role.LOOP, session=1, sequence=1) for m in messages]
    for k in range(20_000):
        data = bytearray(rng.choice(whole))
        if k % 2:
            del data[rng.randrange(len(data)) :]
        for _ in range(rng.randrange(4)):
            if data:
                data[rng.randrange(len(data))] = rng.randrange(256)
        with suppress(ValueError):
            packets.unpacked(bytes(data), Role.LOOP)
        assert packets.is_hello(bytes(data)) in (True, False)
        if packets.is_hello(bytes(data)):
            packets.refusal(bytes(data), "no")


def test_the_log_names_the_ignored_packets() -> None:
    quiet = Deadlines(9, 0, *[0.0] * 3, 0, 0, 0, *[0.0] * 3)
    assert quiet.strangers == ""
    assert "ignored" not in quiet.sentence
    attacked = Deadlines(9, 0, *[0.0] * 3, 0, 0, 0, *[0.0] * 3, ignored=7, refused=2)
    assert attacked.record()["deadlines_ignored"] == "7"
    assert "7 by the bench, 2 by the loop" in attacked.sentence


def _flood(to: Address, known: list[bytes], over: threading.Event, sent: list[int]) -> None:
    """Send at least `MANY` hostile packets, from a hundred addresses, for as long as the run goes on."""
    rng = random.Random(4)
    with ExitStack() as stack:
        others = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(100)]
        made = [hostile(rng, known) for _ in range(5000)]
        while not over.is_set() or sent[0] < MANY:
            for data in made[:FEW]:
                with suppress(OSError):
                    rng.choice(others).sendto(data, to)
            sent[0] += FEW
            time.sleep(PAUSE)


@pytest.mark.benchmark  # A whole run in real time, and a hundred thousand packets beside it.
def test_a_run_under_a_hundred_thousand_packets_obeys_its_loop_only_and_logs_the_flood(tmp_path: Path) -> None:
    command = [PROGRAM, "rig", "outer-turn", "--runs", "1", "--real-time"]
    over, sent = threading.Event(), [0]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as bench:
        assert bench.stdout is not None
        address = bench.stdout.readline().split()[-1]
        known = [packets.packed(packets.command(k, FORGED), Role.LOOP, session=k, sequence=k) for k in range(50)]
        flood = threading.Thread(target=_flood, args=(parse_address(address), known, over, sent))
        flood.start()
        log = tmp_path / "run.mcap"
        try:
            # In a separate process, because the flood would keep the interpreter from the loop.
            asked = ("run", "outer-turn", "--rig", address, "--real-time", "--out", log, "--json")
            ended = dpcontrol_program(*asked, folder=tmp_path)
        finally:
            over.set()
            flood.join()
        said = bench.communicate(timeout=60)[1]
    assert sent[0] >= MANY
    assert bench.returncode == 0
    deadlines = ended.document["deadlines"]
    assert deadlines["ignored"] > 1000
    assert "foreign or repeated packets were ignored" in said
    info = dpcontrol("info", log, "--json").document
    assert info["metadata"]["deadlines_ignored"] == str(deadlines["ignored"])
    run = read_log(log)
    assert any(f"{deadlines['ignored']} by the bench" in event.text for event in run.events)
    # A forged command would request a million m/s². A stalled computer can lose the arms and reports it.
    assert ended.document["ending"] == "finished" or deadlines["missed"] > 0
