"""The program main_udp.c: for a bench it equals the loop in Python, and its runs are logged like others.

Most tests replace the exported controller by a short one, whose command identifies the reading that it answers. No
time is asserted except the bench's, because a busy computer may be late.
"""

import json
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from bench_at_hand import KEY, Toy, served, until_tick
from command_line import dpcontrol

import dpcontrol as dp
from dpcontrol.control import export
from dpcontrol.rig.packets import KEY_VARIABLE

TEMPLATES = Path(dp.__file__).parent / "control" / "target"
STRICT = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off"]
STUB = """
#include "dpc_controller.h"
#include <string.h>
void dpc_init(dpc_controller *c) { memset(c, 0, sizeof *c); }
dpc_real dpc_step(dpc_controller *c, const dpc_reading *reading, dpc_report *report)
{
    memset(report, 0, sizeof *report);
    c->tick++;
    report->command = reading->present[0] ? (dpc_real)(reading->positions[0] + 0.5) : -1;
    return report->command;
}
dpc_real dpc_queued(long k) { return 7 + (dpc_real)k; }
"""
NUMBERS = {"REAL": "double", "ARMS": "2", "POSITIONS": "3", "STATES": "6", "MEMORY": "1", "TICKS": "120", "LEAD": "2",
           "PERIOD": "0.002", "RATE": "500.0", "ITINERARY": "stub"}  # fmt: skip
KEEPING_TIME = 4  # attempts
compiled = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
pytestmark = compiled


def made(folder: Path, compiler: str = "gcc", *flags: str, **numbers: str) -> Path:
    known = {**NUMBERS, **numbers}
    header = (TEMPLATES / "dpc_controller.h").read_text()
    (folder / "dpc_controller.h").write_text(re.sub(r"@([A-Z_]+)@", lambda name: known.get(name[1], "0"), header))
    (folder / "stub.c").write_text(STUB)
    shutil.copy(TEMPLATES / "main_udp.c", folder)
    program = folder / "main_udp"
    subprocess.run([compiler, *STRICT, *flags, "-o", program, "main_udp.c", "stub.c", "-lm"], cwd=folder, check=True)
    return program


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("stub"))


@contextmanager
def begun(program: Path, port: int, *, key: bytes = b"") -> Iterator[subprocess.Popen[str]]:
    how = {"env": {**os.environ, KEY_VARIABLE: key.hex()} if key else None, "text": True}
    command = [program, f"udp://127.0.0.1:{port}"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **how) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_it_compiles_without_a_warning_and_takes_no_heap(compiler: str, tmp_path: Path) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"there is no {compiler} here")
    flags = ("-O2", "-Wconversion", "-Wshadow")
    subprocess.run(["nm", "-u", made(tmp_path, compiler, *flags)], check=True, stdout=(tmp_path / "symbols").open("w"))
    assert "alloc" not in (tmp_path / "symbols").read_text()
    made(tmp_path, compiler, *flags, LEAD="0", ARMS="3", POSITIONS="4", STATES="8", EXTRAS="2", REAL="float")


@pytest.mark.parametrize("key", [b"", KEY, bytes(range(100))], ids=["open", "sealed", "long key"])
def test_every_reading_is_answered_and_deadlines_are_counted(program: Path, key: bytes) -> None:
    toy = Toy()
    with served(toy, key=key.hex().encode()) as bench, begun(program, bench.address[1], key=key) as loop:
        figures, said = loop.communicate(timeout=60)
    counted, record = json.loads(figures), bench.record
    assert loop.returncode == 0, said
    assert counted["ticks"] == 120
    assert record is not None
    # The final STOP may come one tick later.
    assert record.last >= 119
    answers = record.commands[np.isfinite(record.commands)]
    ticks = np.flatnonzero(np.isfinite(record.commands))
    # A late reading, for example on a busy computer, counts as missing.
    assert (np.isclose(answers, ticks + 0.5) | (answers == -1)).all()
    assert len(ticks) > 60
    assert toy.queued == (7.0, 8.0)
    assert toy.stopped_at is not None
    assert record.ended.startswith("the run is over")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_stops_the_cart_and_ends_the_run(program: Path, number: signal.Signals, tmp_path: Path) -> None:
    toy = Toy()
    long = made(tmp_path, TICKS="100000")
    with served(toy) as bench, begun(long, bench.address[1]) as loop:
        until_tick(toy, 20)
        loop.send_signal(number)
        _, said = loop.communicate(timeout=60)
    assert loop.returncode == 1
    assert "interrupted at t = " in said
    assert toy.stopped_at is not None
    assert "the cart was stopped" in bench.record.ended


@pytest.mark.slow  # Two runs in real time, each with a bench in a separate process.
def test_a_run_by_the_exported_program_is_logged_and_scored_as_any(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Compiling the code to measure it is for others.
    monkeypatch.setattr(export, "_measured", lambda files: (None, None))
    folder, log = tmp_path / "controller", tmp_path / "run.mcap"
    assert dpcontrol("export", "outer-turn", "--out", folder).code == 0
    subprocess.run(["make", "-s", "-C", folder, "main_udp"], check=True)
    run = ("run", "outer-turn", "--rig", "udp", "--real-time", "--force", "--json", "--out")
    # If the computer stalls for a tenth of a second, the arms fall, which must be reported.
    for _ in range(KEEPING_TIME):
        ended = dpcontrol(*run, log, "--controller-program", folder / "main_udp")
        shown = ended.document
        assert ended.code == (0 if shown["completed"] else 1)
        if shown["completed"]:
            break
    else:
        pytest.fail(shown["reason"])
    assert shown["ending"] == "finished"
    # A lost reading also counts as a tick.
    assert shown["deadlines"]["ticks"] == 4877
    assert shown["command_difference"] < 1e-6
    found = dpcontrol("info", log, "--json").document
    assert found["metadata"]["deadlines_missed"] == str(shown["deadlines"]["missed"])
    assert "/truth/joint_states" in json.dumps(found)
    killed = tmp_path / "killed"
    killed.write_text(f'#!/bin/sh\nexec timeout -s KILL 1 {folder / "main_udp"} "$1"\n')
    killed.chmod(0o755)
    ended = dpcontrol(*run, log, "--controller-program", killed)
    assert ended.code == 1
    assert "the cart stood still from t = " in ended.message
    assert dpcontrol(*run, log, "--controller-program", "/bin/false").code == 2
