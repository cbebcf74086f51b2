"""Run a trial in this process or in a supervised child, and report errors of its outcome."""

import json
import multiprocessing
import os
import re
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import psutil
from hostile import Trial
from laboratory import Laboratory

PROGRESS = re.compile(r"^[\w ./()-]+: done$")
"""Output of the progress bar if stderr is not a terminal."""
ENOUGH, MOST = 6.0, 10.0
"""Processor time before an interrupt as by Ctrl-C, and limit for the end after it, s."""
IDLE = 30.0
"""Time that a trial may be idle, s; on a busy machine, work itself waits for a processor."""
MEMORY = 3 << 30
"""Memory limit of a child in bytes, to protect the machine."""
RENEWED = 400
"""Number of trials before a child is replaced."""


@dataclass(frozen=True)
class Ended:
    """Outcome of a trial, with new or changed files (`left`) and a traceback (`escaped`)."""

    code: int | None
    stdout: str
    stderr: str
    left: tuple[str, ...]
    escaped: str = ""
    interrupted: bool = False
    seconds: float = 0.0


def complaints(trial: Trial, ended: Ended) -> list[str]:
    """Return the errors of a trial's outcome, empty if there are none."""
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
    elif ended.code == 1 and not (said and any(line.startswith("dpcontrol: ") for line in said)):
        found.append(f"no reason for exit code 1: {ended.stderr!r}")
    if ended.code != 130 and (half := [name for name in ended.left if _half_written(name, trial)]):
        found.append(f"half written: {', '.join(half)}")
    if "\x1b" in ended.stdout + ended.stderr:
        found.append(f"escape sequences of the input are printed: {ended.stdout + ended.stderr!r}"[:400])
    if "--json" in trial.arguments and ended.code in (0, 1):
        found += _not_json(ended.stdout)
    return found


def _half_written(name: str, trial: Trial) -> bool:
    last = name.rsplit("/", 1)[-1]
    if any(argument.endswith(name) for argument in trial.arguments):
        return False
    return last.startswith(".") or last.endswith((".partial", ".tmp")) or name.startswith("tmp/")


def _not_json(text: str) -> list[str]:
    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is no JSON")

    try:
        json.loads(text, parse_constant=refuse)
    except ValueError as error:
        return [f"--json printed no JSON document: {error}: {text[:200]!r}"]
    return []


@contextmanager
def _within(folder: Path) -> Iterator[None]:
    """Work in a folder, which also has the temporary files."""
    before, temporary = Path.cwd(), tempfile.tempdir
    os.chdir(folder)
    tempfile.tempdir = str(folder / "tmp")
    try:
        yield
    finally:
        os.chdir(before)
        tempfile.tempdir = temporary


def _listing(folder: Path) -> dict[str, tuple[int, int]]:
    entries = {str(one.relative_to(folder)): one.lstat() for one in folder.rglob("*")}
    files = {name: (seen.st_size, seen.st_mtime_ns) for name, seen in entries.items()}
    return {name: (0, 0) if (folder / name).is_dir() else seen for name, seen in files.items()}


def attempt(trial: Trial, laboratory: Laboratory) -> Ended:
    """Run a trial in this process, in a separate folder."""
    from dpcontrol.cli.main import main

    began = time.process_time()
    folder = Path(tempfile.mkdtemp(prefix="trial-"))
    out, err, escaped, code = StringIO(), StringIO(), "", None
    try:
        (folder / "tmp").mkdir()
        laboratory.fill(folder, trial.arguments, trial.files)
        before = _listing(folder)
        with _within(folder), redirect_stdout(out), redirect_stderr(err):
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
    return Ended(code, out.getvalue(), err.getvalue(), left, escaped, seconds=time.process_time() - began)


def without_programs() -> None:
    """Prevent trials from opening viewers, rendering pictures or serving runs."""
    from dpcontrol.pages import picture
    from dpcontrol.rig import bench

    picture.viewer_program = lambda: Path("/bin/true")
    bench.UdpBench.serve = lambda self, *, runs=0: None  # type: ignore[method-assign]


def _serve(pipe: "multiprocessing.connection.Connection", laboratory: Laboratory, cache: str) -> None:
    """Run the trials from a pipe in order."""
    os.environ["DPCONTROL_CACHE"] = cache
    quiet = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(quiet, stream)
    without_programs()
    while True:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        trial = pipe.recv()
        if trial is None:
            return
        pipe.send(attempt(trial, laboratory))


class Watched:
    """A child that runs trials, interrupted if it does not finish and killed if it hangs."""

    def __init__(self, laboratory: Laboratory, cache: Path) -> None:
        self._laboratory, self._cache = laboratory, cache
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._child = context.Process(target=_serve, args=(theirs, self._laboratory, str(self._cache)))
        self._child.start()
        theirs.close()
        self._seen, self._done = psutil.Process(self._child.pid), 0

    def _worked(self) -> float:
        """Return the processor time of the child and its children, s."""
        total = 0.0
        with suppress(psutil.NoSuchProcess):
            for one in (self._seen, *self._seen.children(recursive=True)):
                times = one.cpu_times()
                total += times.user + times.system
        return total

    def _sleeps(self) -> bool:
        """Return True if the child and its children are idle and do not wait for a processor."""
        with suppress(psutil.NoSuchProcess):
            return all(one.status() == psutil.STATUS_SLEEPING for one in (self._seen, *self._seen.children(True)))
        return False

    def _held(self) -> int:
        """Return the memory of the child in bytes."""
        with suppress(psutil.NoSuchProcess):
            return self._seen.memory_info().rss
        return 0

    def attempt(self, trial: Trial) -> Ended | None:
        """Return the outcome of a trial, None if it hung."""
        if self._done >= RENEWED:
            self.close()
            self._start()
        self._done += 1
        before, began, idle = self._worked(), time.monotonic(), 0.0
        self._pipe.send(trial)
        interrupted = False
        # The first trial includes imports and compilation.
        extra = 20.0 if self._done < 4 else 0.0
        while not self._pipe.poll(step := 0.2 if time.monotonic() - began > 0.5 else 0.02):
            worked = self._worked() - before - extra
            idle = idle + step if self._sleeps() else 0.0
            if not self._child.is_alive():
                self._start()
                return Ended(None, "", "", (), f"the process died with {self._child.exitcode}", interrupted)
            if worked > MOST or idle > IDLE:
                self._kill()
                self._start()
                return None
            if self._held() > MEMORY:
                self._kill()
                self._start()
                return Ended(None, "", "", (), "it took all memory", interrupted)
            if not interrupted and (worked > ENOUGH or idle > IDLE / 2):
                os.kill(self._child.pid or 0, signal.SIGINT)
                interrupted = True
        try:
            ended = self._pipe.recv()
        except EOFError:
            self._child.join()
            code = self._child.exitcode
            self._start()
            return Ended(None, "", "", (), f"the process died with {code}", interrupted)
        return Ended(**{**vars(ended), "interrupted": interrupted})

    def _kill(self) -> None:
        with suppress(psutil.NoSuchProcess):
            for one in self._seen.children(recursive=True):
                one.kill()
        self._child.kill()
        self._child.join()

    def close(self) -> None:
        """Stop the child."""
        with suppress(OSError):
            self._pipe.send(None)
        self._child.join(5)
        self._kill()


def explained(trial: Trial, wrong: list[str]) -> str:
    """Return a trial's errors, with the last lines of tracebacks."""
    texts = [text if len(text) < 3000 else f"{text[:300]}\n…\n{text[-2600:]}" for text in wrong]
    return "\n".join([repr(trial), *texts])


if __name__ == "__main__":
    sys.exit("run it by pytest: pytest -m benchmark tests/fuzz -s")
