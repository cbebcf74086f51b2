"""Exported code with every available compiler and level, sanitizers and valgrind, on a Cortex-M4 under qemu, and
for every shipped itinerary. These tests are slow because of minutes of compilation.
"""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from c_compilers import SANITIZED, SOURCES, WARNINGS, compiled, needed, ran, with_sanitizers

pytestmark = pytest.mark.slow

HOSTILE_STEPS = "20000"  # Faults of one step in 100 to one in 3,000 are found within some thousand.
REPLAY = [*SOURCES, "main_replay.c"]
CORTEX_M4 = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
TARGET = Path(__file__).with_name("cortex_m")
GUIDE = Path(__file__).parents[2] / "dpcontrol" / "guide" / "export.md"
SIZES = re.findall(
    r"^\| (\S+) \| (\w+) \| ([\d.]+) KiB \| ([\d.]+) KiB \| ([\d.]+) KiB \|$", GUIDE.read_text("utf-8"), re.M
)
"""The guide's rows: itinerary, law, code with -O2 and with -Os, stack of a step."""
SIZE = 0.03  # Relative: releases of gcc differ by less than this.


@pytest.mark.parametrize(("compiler", "level"), [("gcc", "-O3"), ("clang", "-O0")])
def test_every_compiler_and_level_gives_the_loops_commands(double: Path, compiler: str, level: str) -> None:
    program = compiled(compiler, level, folder=double, out="by_level", sources=REPLAY)
    done = ran(program, "readings.csv", folder=double)
    assert done.returncode == 0, done.stderr


def test_sanitizers_of_clang_find_nothing(double: Path) -> None:
    program = compiled(with_sanitizers("clang", double), *SANITIZED, folder=double, out="sanitized", sources=REPLAY)
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
    folder = exported_law(itinerary, law, precise, belt)
    shutil.copy(Path(__file__).with_name("hostile_inputs.c"), folder)
    options = [*SANITIZED, "-fsanitize=float-cast-overflow"]
    sources = [*SOURCES, "hostile_inputs.c"]
    program = compiled(with_sanitizers("gcc", folder), *options, folder=folder, out="hostile", sources=sources)
    done = ran(program, HOSTILE_STEPS, "1", folder=folder)
    assert done.returncode == 0, done.stdout + done.stderr


def test_valgrind_finds_nothing(double: Path) -> None:
    program = compiled("gcc", "-g1", "-O1", folder=double, out="watched", sources=REPLAY)
    options = ["--quiet", "--error-exitcode=9", "--leak-check=full"]
    done = ran(needed("valgrind"), *options, program, "readings.csv", folder=double)
    assert done.returncode == 0, done.stderr


def test_make_and_cmake_build_and_check_it(double: Path) -> None:
    folder = double
    done = ran(needed("make"), "-s", "all", "check", "CC=cc", "CFLAGS=-O0", folder=folder)
    assert done.returncode == 0, done.stderr
    for command in (["-S", ".", "-B", "build", "-DCMAKE_BUILD_TYPE=Debug"], ["--build", "build"]):
        done = ran(needed("cmake"), *command, folder=folder)
        assert done.returncode == 0, done.stdout + done.stderr
    assert ran("ctest", "--test-dir", "build", folder=folder).returncode == 0


@pytest.mark.parametrize("row", SIZES, ids=lambda row: row[1])
def test_the_guide_has_the_sizes_on_a_cortex_m4(exported_law: Callable[..., Path], row: tuple[str, ...]) -> None:
    itinerary, law, *sizes = row
    folder, kib = exported_law(itinerary, law, "single"), []
    for level in ("-Os", "-O2"):
        options = [*WARNINGS, *CORTEX_M4, level, "-fstack-usage", "-c", "-o", "target.o", SOURCES[0]]
        done = ran(needed("arm-none-eabi-gcc"), *options, folder=folder)
        assert done.returncode == 0, done.stderr
        sizes_line = ran("arm-none-eabi-size", "target.o", folder=folder).stdout.splitlines()[1]
        kib.insert(0, int(sizes_line.split()[0]) / 1024)
    usage = [line.split("\t") for line in (folder / "target.su").read_text().splitlines()]
    kib.append(sum(int(size) for place, size, *_ in usage if re.search(r":dpc_(step|tick)\b", place)) / 1024)
    assert kib == pytest.approx([float(size) for size in sizes], rel=SIZE)


def test_a_cortex_m4_gives_the_loops_commands(single: Path) -> None:
    folder = single
    lines = (folder / "readings.csv").read_text().splitlines(keepends=True)
    few = folder / "few"
    few.mkdir()
    (few / "readings.csv").write_text("".join(lines[:1500]))
    options = [*CORTEX_M4, "-O2", "-ffp-contract=off"]
    for source in SOURCES:
        done = ran(
            needed("arm-none-eabi-gcc"), *WARNINGS, "-Wdouble-promotion", *options, "-c", "-o", few / f"{source}.o",
            source, folder=folder,
        )  # fmt: skip
        assert (done.returncode, done.stderr) == (0, "")
    size = ran(needed("arm-none-eabi-size"), few / "dpc_controller.c.o", folder=folder).stdout.splitlines()[1].split()
    assert size[1:3] == ["0", "0"], "it has variables"
    done = ran(
        "arm-none-eabi-gcc", "-std=c99", *options, "--specs=rdimon.specs",
        "-nostartfiles", "-T", TARGET / "memory.ld", "-o", few / "replay.elf", TARGET / "start.c", REPLAY[-1],
        *(few / f"{source}.o" for source in SOURCES), "-lm",
        folder=folder,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    done = ran(
        needed("qemu-system-arm"), "-M", "netduinoplus2", "-nographic", "-monitor", "none", "-serial", "none",
        "-semihosting-config", "enable=on,target=native", "-kernel", "replay.elf", folder=few,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "1499 ticks, commands differ by" in done.stderr
