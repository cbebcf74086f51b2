"""For any arguments and files, a call ends with 0, 1 or 2 and a message, without partial files."""

import json
import os
import re
import shutil
import signal
import tempfile
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from hostile import KINDS, VERBS, Trial, file_trials, option_trials
from hypothesis import HealthCheck, given, settings, strategies as st
from laboratory import Laboratory, make_laboratory

from dpcontrol.cli.main import main

PROGRESS = re.compile(r"^[\w ./()-]+: done$")
"""Output of the progress bar if stderr is not a terminal."""
HALF = re.compile(r"^tmp/|(^|/)\.[^/]*$|\.(partial|tmp)$")
"""Names of files that a call leaves half written."""
ENOUGH, MORE = 20.0, 40.0
"""Time before an interrupt as by Ctrl-C, and for the end after it, s."""


@dataclass(frozen=True)
class Ended:
    """Outcome of a trial, with new or changed files (`left`) and a traceback (`escaped`)."""

    code: int | None
    stdout: str
    stderr: str
    left: tuple[str, ...]
    escaped: str = ""
    interrupted: bool = False


class HangError(BaseException):
    """A trial did not end, even when interrupted."""


def complaints(trial: Trial, ended: Ended) -> list[str]:
    said = [line for line in ended.stderr.splitlines() if line.strip() and not PROGRESS.match(line)]
    found = []
    if ended.escaped or "Traceback (most recent call last)" in ended.stderr:
        found.append(f"traceback: {ended.escaped or ended.stderr}")
    elif ended.code not in ((0, 1, 2, 130) if ended.interrupted else (0, 1, 2)):
        found.append(f"exit code {ended.code}: {ended.stderr}")
    elif ended.code == 2:
        if ended.left:
            found.append(f"bad input left {', '.join(ended.left)}")
        # Several mistakes of one file are reported together, one line each.
        if not said or not all(line.startswith("dpcontrol: ") for line in said):
            found.append(f"not one sentence for each mistake: {ended.stderr!r}")
    elif ended.code == 1 and not any(line.startswith("dpcontrol: ") for line in said):
        found.append(f"no reason for exit code 1: {ended.stderr!r}")
    named = [name for name in ended.left if any(argument.endswith(name) for argument in trial.arguments)]
    half = [name for name in ended.left if name not in named and HALF.search(name)]
    if half and ended.code != 130:
        found.append(f"half written: {', '.join(half)}")
    if "\x1b" in ended.stdout + ended.stderr:
        found.append(f"escape sequences of the input are printed: {ended.stdout + ended.stderr!r}"[:400])
    if "--json" in trial.arguments and ended.code in (0, 1):
        try:
            json.dumps(json.loads(ended.stdout), allow_nan=False)
        except ValueError as error:
            found.append(f"--json printed no JSON document: {error}: {ended.stdout[:200]!r}")
    return found


@contextmanager
def _within(folder: Path) -> Iterator[list[int]]:
    """Work in a folder, which also has the temporary files; yields the interrupts of work that takes long."""
    interrupts: list[int] = []

    def late(signum: int, _: Any) -> None:
        interrupts.append(signum)
        raise KeyboardInterrupt if len(interrupts) == 1 else HangError

    before, temporary, handler = Path.cwd(), tempfile.tempdir, signal.signal(signal.SIGALRM, late)
    os.chdir(folder)
    tempfile.tempdir = str(folder / "tmp")
    signal.setitimer(signal.ITIMER_REAL, ENOUGH, MORE)
    try:
        yield interrupts
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, handler)
        os.chdir(before)
        tempfile.tempdir = temporary


def _listing(folder: Path) -> dict[str, tuple[int, int]]:
    entries = {str(one.relative_to(folder)): one.lstat() for one in folder.rglob("*")}
    files = {name: (seen.st_size, seen.st_mtime_ns) for name, seen in entries.items()}
    return {name: (0, 0) if (folder / name).is_dir() else seen for name, seen in files.items()}


def attempt(trial: Trial, laboratory: Laboratory) -> Ended:
    folder = Path(tempfile.mkdtemp(prefix="trial-"))
    out, err, escaped, code = StringIO(), StringIO(), "", None
    try:
        (folder / "tmp").mkdir()
        laboratory.fill(folder, trial.arguments, trial.files)
        before = _listing(folder)
        with _within(folder) as interrupts, redirect_stdout(out), redirect_stderr(err):
            try:
                main(list(trial.arguments))
            except SystemExit as ended:
                code = ended.code if isinstance(ended.code, int) else None
            except BaseException:  # noqa: BLE001 - the test looks for any escaping exception
                escaped = traceback.format_exc()
        for trace in (folder / "tmp").glob("dpcontrol-error-*"):
            escaped = trace.read_text()
            trace.unlink()
        after = _listing(folder)
        left = tuple(sorted(name for name, seen in after.items() if before.get(name) != seen))
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return Ended(code, out.getvalue(), err.getvalue(), left, escaped, bool(interrupts))


def explained(trial: Trial, wrong: list[str]) -> str:
    texts = [text if len(text) < 3000 else f"{text[:300]}\n…\n{text[-2600:]}" for text in wrong]
    return "\n".join([repr(trial), *texts])


OPTIONS, FILES = 6, 6
"""Number of inputs per verb and kind of file."""
LONG = {"demo", "atlas", "export", "identify", "plan", "prove", "report"}
"""Verbs that take seconds, reserved for the slow tests."""
COMMON = {"deadline": None, "database": None, "suppress_health_check": list(HealthCheck)}


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Laboratory:
    return make_laboratory(tmp_path_factory.mktemp("laboratory"))


@pytest.fixture(autouse=True)
def no_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Prevent trials from opening viewers or serving runs."""
    monkeypatch.setattr("dpcontrol.pages.viewer.viewer_program", lambda: "/bin/true")
    monkeypatch.setattr("dpcontrol.rig.bench.UdpBench.serve", lambda self, *, runs=0: None)


def tried(trials: st.SearchStrategy[Trial], laboratory: Laboratory, *, count: int) -> None:
    @settings(derandomize=True, max_examples=count, **COMMON)
    @given(trials)
    def check(trial: Trial) -> None:
        wrong = complaints(trial, attempt(trial, laboratory))
        assert not wrong, explained(trial, wrong)

    check()


@pytest.mark.parametrize("verb", [pytest.param(v, marks=pytest.mark.slow) if v in LONG else v for v in VERBS])
def test_every_option_is_accepted_or_refused_with_a_message(verb: str, laboratory: Laboratory) -> None:
    tried(option_trials(verb, laboratory), laboratory, count=OPTIONS // 2 if verb in LONG else OPTIONS)


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_is_read_or_refused_with_a_message(kind: str, laboratory: Laboratory) -> None:
    tried(file_trials(kind, laboratory), laboratory, count=FILES)
