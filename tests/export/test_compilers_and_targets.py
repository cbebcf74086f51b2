"""Exported code with every available compiler and level, sanitizers and valgrind, and on microcontrollers under qemu.

These tests are slow because of minutes of compilation.
"""

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
from c_compilers import REPLAY, SANITIZED, SOURCES, WARNINGS, compiled, needed, ran, with_sanitizers

import dpcontrol as dp
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan

pytestmark = pytest.mark.slow

HOSTILE_STEPS = "20000"  # Faults of one step in 100 to one in 3,000 are found within some thousand.


class Target(NamedTuple):
    """A microcontroller with its board in qemu; commands must agree with the loop's within `accuracy`, m/s²."""

    board: str
    precision: str
    accuracy: float
    options: tuple[str, ...]


TARGETS = {
    "Cortex-M7": Target("mps2-an500", "double", 1e-9, ("-mcpu=cortex-m7", "-mfpu=fpv5-d16")),
    "Cortex-M4": Target("mps2-an386", "single", 1e-3, ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16")),
}
START = Path(__file__).with_name("cortex_m")
GUIDE = Path(__file__).parents[2] / "dpcontrol" / "guide" / "export.md"
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in GUIDE.read_text("utf-8").splitlines()
    if line.startswith("| Cortex-M")
]
"""Of the guide: target, itinerary, law, code with -O2 and with -Os, tables, stack, and the instructions of a step."""
SIZE = 0.03  # Relative: releases of gcc differ by less than this.
MOST_TICKS = 25_000  # More take minutes in emulation.
FLASH = 2 * 1024 * 1024  # bytes of larger Cortex-M7
MOST_A_SECOND = 125 * 1024  # bytes of tables, half of what a row for each tick would take


@pytest.mark.parametrize(("compiler", "level"), [("gcc", "-O3"), ("clang", "-O0")])
def test_every_compiler_and_level_gives_the_loops_commands(double: Path, compiler: str, level: str) -> None:
    program = compiled(compiler, level, folder=double, out="by_level", sources=REPLAY)
    done = ran(program, "readings.csv", folder=double)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("itinerary", "law", "precise", "belt"),
    [
        ("outer-turn", "adaptive", "single", 0.0),
        ("hold-up-up", "lqr", "single", 0.0),
        ("outer-turn", "tvlqr", "double", 15.0),
    ],
)
def test_no_input_spoils_a_command_or_a_check(
    exported_law: Callable[..., Path], itinerary: str, law: str, precise: str, belt: float
) -> None:
    folder = exported_law(itinerary, law, precise, belt=belt)
    shutil.copy(Path(__file__).with_name("hostile_inputs.c"), folder)
    options = [*SANITIZED, "-fsanitize=float-cast-overflow"]
    sources = [*SOURCES, "hostile_inputs.c"]
    program = compiled(with_sanitizers("gcc", folder), *options, folder=folder, out="hostile", sources=sources)
    done = ran(program, HOSTILE_STEPS, "1", folder=folder)
    assert done.returncode == 0, done.stdout + done.stderr


def test_make_and_cmake_build_and_check_it(double: Path) -> None:
    folder = double
    done = ran(needed("make"), "-s", "all", "check", "CC=cc", "CFLAGS=-O0", folder=folder)
    assert done.returncode == 0, done.stderr
    for command in (["-S", ".", "-B", "build", "-DCMAKE_BUILD_TYPE=Debug"], ["--build", "build"]):
        done = ran(needed("cmake"), *command, folder=folder)
        assert done.returncode == 0, done.stdout + done.stderr
    assert ran("ctest", "--test-dir", "build", folder=folder).returncode == 0


@pytest.mark.parametrize("row", ROWS, ids=lambda row: "-".join(row[:3]))
def test_a_microcontroller_gives_the_commands_of_a_log_with_the_resources_of_the_guide(
    exported_law: Callable[..., Path], tmp_path: Path, row: list[str]
) -> None:
    (itinerary, law, *stated), target = row[1:], TARGETS[row[0]]
    folder = exported_law(itinerary, law, target.precision)
    machine, sizes = [*target.options, "-mthumb", "-mfloat-abi=hard"], {}
    options = [*machine, "-ffp-contract=off", "-fstack-usage", "-Wdouble-promotion"]
    for level in ("-Os", "-O2"):
        for source in SOURCES:
            made = tmp_path / f"{source}.o"
            done = ran(needed("arm-none-eabi-gcc"), *WARNINGS, *options, level, "-c", "-o", made, source, folder=folder)
            assert (done.returncode, done.stderr) == (0, "")
            text, *variables = ran("arm-none-eabi-size", made, folder=folder).stdout.splitlines()[1].split()[:3]
            assert variables == ["0", "0"], "it has variables"
            sizes[level, source] = int(text)
    usage = [line.split("\t") for line in (tmp_path / "dpc_controller.c.su").read_text().splitlines()]
    stack = sum(int(size) for place, size, *_ in usage if re.search(r":dpc_(step|tick)\b", place))
    program = tmp_path / "replay.elf"
    done = ran(
        "arm-none-eabi-gcc", "-std=c99", *machine, "-O2", "-I.", "--specs=rdimon.specs", "-nostartfiles",
        "-Wl,--wrap=dpc_step", "-T", START / "memory.ld", "-o", program, START / "start.c", REPLAY[-1],
        *(tmp_path / f"{source}.o" for source in SOURCES), "-lm",
        folder=folder,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    flash = ran("arm-none-eabi-size", program, folder=folder).stdout.splitlines()[1].split()[:2]
    assert sum(map(int, flash)) <= FLASH

    plan = make_plan(load_itinerary(itinerary).with_run({"controller": law}))
    dp.run(plan, mismatch=0.03, seed=4, log=tmp_path / "run.mcap")
    frame = dp.open_log(tmp_path / "run.mcap").frame()
    assert sizes["-O2", SOURCES[1]] <= MOST_A_SECOND * frame.index[-1]
    frame.head(MOST_TICKS).to_csv(tmp_path / "readings.csv")
    done = ran(
        needed("qemu-system-arm"), "-M", target.board, "-nographic", "-monitor", "none", "-serial", "none",
        "-icount", "shift=0", "-semihosting-config", "enable=on,target=native", "-kernel", program, folder=tmp_path,
    )  # fmt: skip
    replayed = re.search(
        r"^(\d+) ticks, commands differ by (\S+) .*\s+instructions: \d+ in the mean, (\d+) at most", done.stderr
    )
    assert replayed, done.stderr
    assert int(replayed[1]) == min(len(frame), MOST_TICKS)
    assert float(replayed[2]) <= target.accuracy
    parts = (sizes["-O2", SOURCES[0]], sizes["-Os", SOURCES[0]], sizes["-O2", SOURCES[1]], stack)
    measured = [*(f"{size / 1024:,.1f} KiB" for size in parts), f"{int(replayed[3]):,}"]
    found, expected = (
        [float(cell.removesuffix(" KiB").replace(",", "")) for cell in cells] for cells in (measured, stated)
    )
    assert found == pytest.approx(expected, rel=SIZE), " | ".join(measured)
