"""A bench in C behind a pseudo-terminal: frames, damaged bytes, a pulled cable, and whole runs over the line."""

import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import casadi as ca
import pytest
from hypothesis import given, strategies

import dpcontrol as dp
from dpcontrol.dynamics.chain import Level, equations_of
from dpcontrol.dynamics.compiled import fixed_step
from dpcontrol.foundation.errors import InputError
from dpcontrol.plans.model import load_model
from dpcontrol.rig.client import Deadlines, LinkSettings
from dpcontrol.rig.serial_line import SerialLine, SerialRig, framed, parse_line, unframed

EXAMPLES = Path(dp.__file__).parent / "examples"
LONG = LinkSettings(answer=60.0, patience=60.0, silence=60.0)


@given(strategies.binary(min_size=1, max_size=600), strategies.integers(0, 10**6))
def test_a_frame_holds_its_packet_without_zeros_and_shows_each_wrong_bit(packet: bytes, place: int) -> None:
    frame = framed(packet)
    assert frame[0] == frame[-1] == 0
    assert 0 not in frame[1:-1]
    assert unframed(frame[1:-1]) == packet
    bits = bytearray(frame[1:-1])
    bits[place // 8 % len(bits)] ^= 1 << place % 8
    assert unframed(bytes(bits)) in (b"", packet[:0])


def test_a_line_gives_whole_packets_whatever_comes_between_them() -> None:
    ours, theirs = os.openpty()
    with closing(SerialLine(os.ttyname(theirs), 1_000_000)) as line:
        os.write(ours, b"boot message\n" + framed(b"first")[:4])
        os.write(ours, framed(b"second") + framed(b"third"))
        received = list[bytes]()
        while received[-1:] != [b"third"]:
            try:
                received.append(line.recv(4096))
            except BlockingIOError:
                time.sleep(0.001)
        assert [packet for packet in received if packet] == [b"second", b"third"]
        line.send(b"answer")
        assert os.read(ours, 100) == framed(b"answer")
        with pytest.raises(InputError, match="no other program"):
            SerialLine(os.ttyname(theirs), 1_000_000)
        os.close(ours)
        with pytest.raises(OSError, match=r"."):
            line.recv(4096)
    assert parse_line("serial:///dev/ttyS0?baud=115200") == ("/dev/ttyS0", 115_200)


@pytest.fixture(scope="module")
def compiled_bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the sources of the example, the test's board, and the arms of `lab` at 500 Hz."""
    if shutil.which("cc") is None:
        pytest.skip("needs a C compiler")
    folder = tmp_path_factory.mktemp("serial")
    arms = load_model("lab").arms
    step = fixed_step(equations_of(arms, Level.CART))
    state, acceleration = ca.SX.sym("state", 2 * arms.count + 2), ca.SX.sym("acceleration")
    following = step(state, acceleration, 0.002, arms.base())
    before = Path.cwd()
    os.chdir(folder)
    try:
        ca.Function("plant", [state, acceleration], [following]).generate("plant.c", {"with_header": True})
    finally:
        os.chdir(before)
    for file in (EXAMPLES / "serial_bench.c", EXAMPLES / "serial_bench.h", Path(__file__).with_name("host_hardware.c")):
        shutil.copy(file, folder)
    return folder


@contextmanager
def connected(folder: Path, *options: str) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Yield the address of a bench in C and its process."""
    sources = ["serial_bench.c", "host_hardware.c", "plant.c"]
    made = ["cc", "-O1", "-Wall", "-DPERIOD=0.002", "-DWATCHDOG=10.0", *options, "-o", "bench", *sources, "-lm"]
    subprocess.run(made, cwd=folder, check=True, capture_output=True)
    ours, theirs = os.openpty()
    with subprocess.Popen([folder / "bench"], stdin=ours, pass_fds=[theirs]) as program:
        # A microcontroller keeps its periods whatever this computer does.
        with suppress(OSError):
            os.sched_setscheduler(program.pid, os.SCHED_FIFO, os.sched_param(2))
        os.close(ours)
        try:
            yield f"serial://{os.ttyname(theirs)}", program
        finally:
            program.kill()
            os.close(theirs)


def read_on(rig: SerialRig, ticks: int) -> None:
    for _ in range(ticks):
        rig.read()
        rig.command(0.0)


def test_two_runs_survive_damaged_frames_and_the_cart_brakes(compiled_bench: Path) -> None:
    with connected(compiled_bench, "-DSPOILT=40") as (address, _):
        for _ in range(2):
            with SerialRig(address, settings=LONG) as rig:
                assert (rig.period, rig.welcome.arms) == (0.002, 2)
                first = rig.read().positions[-1]
                for _ in range(400):
                    rig.command(1.0)
                    reading = rig.read()
                assert reading.positions[-1] > first
                rig.stop()
                before, stood = reading.positions[-1], 0
                while stood < 5 and rig.deadlines.ticks < 10_000:
                    now = rig.read().positions[-1]
                    stood, before = (stood + 1 if now == before else 0), now
                    rig.command(9.0)
                counted = rig.deadlines
                assert stood == 5
                # Two frames in 40 are spoilt, and none of them counts as a reading.
                assert counted.ticks / 40 <= counted.lost
                assert counted.rejected > 0


def test_a_pulled_cable_ends_the_run(compiled_bench: Path) -> None:
    brief = LinkSettings(answer=60.0, silence=0.5)
    with connected(compiled_bench) as (address, program), SerialRig(address, settings=brief) as rig:
        read_on(rig, 100)
        program.kill()
        with pytest.raises(ArithmeticError, match="does not respond"):
            read_on(rig, 100_000)


@pytest.mark.slow
def test_a_rig_on_a_line_is_commissioned_run_and_repeated(compiled_bench: Path, tmp_path: Path) -> None:
    with connected(compiled_bench) as (address, _):
        loop = dp.closed_loop("turn-from-rest", rate=500.0, delay=1.0)
        # A busy computer would hold commands for too long.
        link = dp.rig_link(address, real_time=True)
        found = dp.commission(loop.plan, rig=link)
        # A busy computer begins some ticks late.
        assert [one.sentence for one in found.wrong if one.step != "deadlines"] == []
        run = loop.run(rig=link, log=tmp_path / "run.mcap")
        counted = Deadlines.of(run.log.metadata)
        assert counted is not None
        # A busy computer may lose the arms.
        assert "1 of 1 symbols" in run.status or counted.held > 20, run.status
        loop.night(0.003, tmp_path / "night", rig=link, yes=True)
        assert list((tmp_path / "night").glob("*.mcap"))


@pytest.mark.slow
@pytest.mark.parametrize("core", [["cortex-m7", "fpv5-d16"], ["cortex-m4", "fpv4-sp-d16"]])
def test_the_example_compiles_for_microcontrollers(core: list[str], tmp_path: Path) -> None:
    if shutil.which("arm-none-eabi-gcc") is None:
        pytest.skip("arm-none-eabi-gcc is not installed")
    target = ["-mthumb", f"-mcpu={core[0]}", "-mfloat-abi=hard", f"-mfpu={core[1]}"]
    for name in ("serial_bench.c", "serial_hardware.c"):
        made = ["arm-none-eabi-gcc", *target, "-Os", "-Wall", "-Wextra", "-Werror", "-c", str(EXAMPLES / name)]
        subprocess.run([*made, "-o", str(tmp_path / "part.o")], check=True, capture_output=True)
