"""Compilation of exported code, and comparison of its library with the loop's tick."""

import shutil
import subprocess
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from library_program import LibraryProgram, library_ticker

from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.protocols import Reading
from dpcontrol.plans.plan import Plan

SANITIZED = ["-g1", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
"""With gcc, more debugging information than lines is too much."""
WARNINGS = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off"]
SOURCES = ["dpc_controller.c", "dpc_tables.c"]
REPLAY = [*SOURCES, "main_replay.c"]


def needed(program: str) -> str:
    """Return a program's name, or skip the test if it is not installed."""
    if shutil.which(program) is None:
        pytest.skip(f"{program} is not installed")
    return program


def with_sanitizers(compiler: str, folder: Path) -> str:
    """Return a compiler's name, or skip the test if it lacks the library of its sanitizers."""
    (folder / "empty.c").write_text("int main(void) { return 0; }\n")
    if ran(needed(compiler), *SANITIZED, "-o", "empty", "empty.c", folder=folder).returncode:
        pytest.skip(f"{compiler} has no sanitizers: install the package of its runtime library")
    return compiler


def ran(*command: str | Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a program in `folder` to its end, with any exit code."""
    return subprocess.run([*map(str, command)], cwd=folder, capture_output=True, text=True, check=False)


def compiled(compiler: str, *options: str, folder: Path, out: str, sources: Iterable[str] = SOURCES) -> Path:
    """Compile sources of `folder` without warnings; return the output file."""
    done = ran(needed(compiler), *WARNINGS, *options, "-o", out, *sources, "-lm", folder=folder)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    return folder / out


def library(folder: Path, *options: str) -> Path:
    """Return the shared library of an exported folder."""
    made = folder / "libdpc.so"
    if made.exists():
        return made
    return compiled("gcc", "-O0", "-fPIC", "-shared", *options, folder=folder, out=made.name)


class SideBySide:
    """The ticks of the loop and of a library with the same readings.

    If `told`, the library receives the commands of the loop's tick, because its own commands would drift.
    """

    def __init__(self, plan: Plan, made: Path, *, told: bool = True) -> None:
        assembly = Assembly(plan.reference, plan.itinerary.model.arms, plan.itinerary.loop)
        self.own, self.other = assembly.ticker(), library_ticker(assembly, made)
        self.references, self.count = self.own.references, self.own.count
        self._told, self._k = told, 0

    @property
    def c(self) -> LibraryProgram:
        return self.other.program

    def __call__(
        self, positions: np.ndarray, *, present: np.ndarray | None = None, switch: int = 0
    ) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Run a tick by both; return their reports by name.

        The loop's rigs mark a position that is not a number as missing. The exported code finds it itself.
        """
        finite = np.isfinite(positions)
        marked = present if finite.all() else finite if present is None else present & finite
        readings = [Reading(0.0, positions, present=here, switch=switch) for here in (marked, present)]
        k, self._k = min(self._k, self.count - 1), self._k + 1
        own, other = (
            {name: part[:, 0].copy() for name, part in ticker(k, reading)._asdict().items()}
            for ticker, reading in zip((self.own, self.other), readings, strict=True)
        )
        if self._told:
            self.c.set_sent(float(own["command"][0]))
        return own, other
