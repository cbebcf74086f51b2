"""A bench at the other end of a UDP socket: what is lost, late, silent or damaged is counted and survived.

No time is asserted: a busy computer can be late, and must then report it.
"""

import hmac
import math
import socket
import threading
from contextlib import closing

import pytest
from bench_at_hand import KEY, LONG, Toy, next_reading, raw, relayed, served, welcomed

from dpcontrol.foundation.causes import Cause
from dpcontrol.foundation.errors import InputError
from dpcontrol.loop.result import ended
from dpcontrol.rig import packets as packets
from dpcontrol.rig.bench import BenchServerSettings, UdpBench
from dpcontrol.rig.client import LinkSettings, UdpRig
from dpcontrol.rig.packets import Condition, Kind, Role


def read_on(rig: UdpRig) -> None:
    for _ in range(10_000):
        rig.read()


def test_a_sealed_packet_ends_with_half_of_its_hmac_with_the_senders_name() -> None:
    plain, sealed = (
        packets.packed(packets.CommandPacket(7, -1.5), Role.LOOP, session=258, sequence=3, key=k) for k in (b"", KEY)
    )
    assert sealed == plain + hmac.new(KEY, b"loop" + plain, "sha256").digest()[:16]
    assert packets.unpacked(sealed, Role.LOOP, key=KEY).content == packets.CommandPacket(7, -1.5)


def test_every_tick_comes_once_and_its_command_goes_back() -> None:
    toy = Toy()
    with served(toy) as bench, UdpRig(bench.address, queued=[1.0, 2.0], settings=LONG) as rig:
        assert (rig.period, rig.welcome.arms, rig.truth) == (0.002, 2, None)
        for k in range(100):
            reading = rig.read()
            assert reading.time == pytest.approx(k * 0.002)
            assert (reading.positions == k).all()
            assert reading.present is None
            rig.command(float(k))
        rig.read()
    found = rig.deadlines
    assert (found.ticks, found.lost, found.rejected) == (101, 0, 0)
    values = [value for _, value in toy.commands]
    assert values == sorted(set(values))
    # None came before the reading that it answers.
    assert all(tick >= value for tick, value in toy.commands)


def test_zeros_are_taken_off_the_arms_readings() -> None:
    with served(Toy()) as bench, UdpRig(bench.address, zeros=[0.25, -0.5], settings=LONG) as rig:
        rig.read()
        assert rig.read().positions == pytest.approx([0.75, 1.5, 1.0])


@pytest.mark.parametrize(("sent", "comes"), [(0.0003, 0.0003), (5.0, None)])
def test_a_readings_age_comes_with_it_unless_it_is_none(sent: float | None, comes: float | None) -> None:
    with served(Toy(age=sent)) as bench, UdpRig(bench.address, settings=LONG) as rig:
        assert [rig.read().age, rig.read().age] == [comes, comes]


def test_overtaken_and_repeated_readings_are_counted_and_dropped() -> None:
    # A bench of ours that keeps reading 1 back until after reading 3, on a network that repeats readings 2 and 1.
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as bench:
        bench.bind(("127.0.0.1", 0))
        bench.settimeout(30)

        def shuffled() -> None:
            client, talk = welcomed(bench, packets.Welcome(2, 0.001, 100, 5))
            while bench.recvfrom(4096)[0][5] != Kind.START:
                pass
            contents = [packets.ReadingPacket(k, (float(k),) * 3, -1, 0, 0.0, 0, Condition.WELL, "") for k in range(5)]
            made = [talk.pack(content) for content in contents]
            for tick in (0, 2, 3, 1, 2, 1, 4):
                bench.sendto(made[tick], client)

        thread = threading.Thread(target=shuffled)
        thread.start()
        with UdpRig(bench.getsockname(), settings=LONG) as rig:
            readings = [rig.read() for _ in range(5)]
        thread.join()
    assert [reading.present is None for reading in readings] == [True, False, True, True, True]
    assert [reading.positions[0] for reading in readings] == [0.0, 0.0, 2.0, 3.0, 4.0]
    assert (rig.deadlines.lost, rig.deadlines.rejected) == (1, 3)


def test_a_silent_loop_has_its_cart_stopped_and_is_notified() -> None:
    toy = Toy()
    with served(toy, settings=BenchServerSettings(watchdog=0.05)) as bench, UdpRig(bench.address) as rig:
        for _ in range(5):
            rig.read()
            rig.command(1.0)
        threading.Event().wait(0.5)
        with pytest.raises(ArithmeticError, match=r"stopped the cart: it received nothing from the loop for 0\.05 s"):
            read_on(rig)
    assert toy.stopped_at is not None


def test_a_stop_brakes_and_later_commands_do_nothing() -> None:
    toy = Toy()
    with served(toy) as bench, UdpRig(bench.address, settings=LONG) as rig:
        for _ in range(5):
            rig.read()
            rig.command(1.0)
        rig.stop()
        before = len(toy.commands)
        for _ in range(20):
            rig.read()
            rig.command(9.0)
    assert toy.stopped_at is not None
    assert len(toy.commands) <= max(before, 5)
    assert 9.0 not in [value for _, value in toy.commands]


def test_old_and_future_commands_do_not_act_and_one_that_is_not_finite_stops() -> None:
    toy = Toy()
    with served(toy) as bench, raw(bench) as client:
        while next_reading(client).tick < 5:
            pass
        client.send(packets.CommandPacket(4, 40.0))
        client.send(packets.CommandPacket(3, 30.0))
        client.send(packets.CommandPacket(4, 41.0))
        client.send(packets.CommandPacket(10**6, 99.0))
        client.socket.send(b"noise")
        client.send(packets.CommandPacket(5, 50.0))
        while next_reading(client).heard < 5:
            pass
        client.send(packets.CommandPacket(6, math.nan))
        while (reading := next_reading(client)).condition is Condition.WELL:
            pass
    assert [value for _, value in toy.commands] == [40.0, 50.0]
    assert reading.condition is Condition.FAULT
    assert "not finite" in reading.text
    assert toy.stopped_at is not None


def test_the_benchs_grief_becomes_the_rigs_fault() -> None:
    toy = Toy()
    with served(toy) as bench, UdpRig(bench.address, settings=LONG) as rig:
        rig.read()
        toy.fault = ended(Cause.HARD_STOP, {"time": 1.0, "position": 0.4, "velocity": 2.0})
        for _ in range(10):
            rig.read()
        assert (rig.fault.cause, rig.fault.text) == (Cause.HARD_STOP, toy.fault.text)


def test_a_bench_that_is_gone_ends_the_run_by_name() -> None:
    ends = pytest.raises(ArithmeticError, match="has completed its 3 ticks")
    with served(Toy(), ticks=3) as bench, UdpRig(bench.address, settings=LONG) as rig, ends:
        read_on(rig)
    toy = Toy()

    def passes(data: bytes) -> bool:
        return data[5] != Kind.READING or toy.tick < 5

    ends = pytest.raises(ArithmeticError, match="does not respond: received nothing from it")
    with (
        served(toy) as bench,
        relayed(bench.address, passes) as address,
        UdpRig(address, settings=LinkSettings(silence=0.2)) as rig,
        ends,
    ):
        read_on(rig)


def test_a_missing_or_busy_bench_is_reported_in_one_sentence() -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as nobody:
        nobody.bind(("127.0.0.1", 0))
        with pytest.raises(InputError, match="no bench responded"):
            UdpRig(nobody.getsockname(), settings=LinkSettings(answer=0.3))
    with served(Toy()) as bench, UdpRig(bench.address, settings=LONG) as rig:
        rig.read()
        with pytest.raises(InputError, match="busy with another loop"):
            UdpRig(bench.address, settings=LONG)
    with served(Toy()) as bench:
        with pytest.raises(InputError, match=f"port {bench.address[1]} "):
            UdpBench(lambda queued: Toy(), arms=2, ticks=1, period=1.0, port=bench.address[1])
        with UdpRig(bench.address, settings=LONG) as rig, pytest.raises(ArithmeticError, match="finite"):
            rig.command(math.inf)
