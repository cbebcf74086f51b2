"""Ctrl-C ends the program: before the command line is imported, and where other code has swallowed it."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable

import pytest
from command_line import dpcontrol

from dpcontrol.cli import main as program

EARLY = """
import os, signal, sys
class Finder:
    def find_spec(self, name, *_):
        if name == "click":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
signal.signal(signal.SIGINT, {before})
from dpcontrol.__main__ import main
main()
"""


@pytest.mark.parametrize("before", ["signal.SIG_IGN", "signal.default_int_handler"])
def test_an_interrupt_while_the_command_line_is_imported_ends_the_program(before: str) -> None:
    code = EARLY.format(before=before)
    done = subprocess.run([sys.executable, "-c", code, "model", "lab"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "dpcontrol: interrupted; nothing was begun\n"


LATE = """
import atexit, os, signal, sys
atexit.register(os.kill, os.getpid(), signal.SIGINT)
sys.argv = ["dpcontrol", "--version"]
from dpcontrol.__main__ import main
main()
"""


def test_an_interrupt_after_the_work_is_done_leaves_its_exit_code() -> None:
    done = subprocess.run([sys.executable, "-c", LATE], capture_output=True, text=True, check=False, env=os.environ)
    assert (done.returncode, done.stderr) == (0, "")


def interrupted_in(verb: Callable[[], None], monkeypatch: pytest.MonkeyPatch) -> int:
    """Return the exit code of a verb that is interrupted by itself; Python's own handler is put back."""
    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(program.cli, "main", lambda *_, **__: verb())
    try:
        return dpcontrol("verb").code
    finally:
        signal.signal(signal.SIGINT, before)


def test_an_interrupt_that_other_code_swallows_is_raised_again(monkeypatch: pytest.MonkeyPatch) -> None:
    def swallowing() -> None:
        for _ in range(2):
            try:
                signal.raise_signal(signal.SIGINT)
                time.sleep(60)
            except KeyboardInterrupt:
                pass
        time.sleep(60)

    assert interrupted_in(swallowing, monkeypatch) == 130


def test_cleaning_up_after_an_interrupt_is_not_interrupted_by_it(monkeypatch: pytest.MonkeyPatch) -> None:
    cleaned = []

    def cleaning() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            # Longer than the time after which a lost interrupt is raised again.
            time.sleep(0.5)
            cleaned.append(True)

    assert interrupted_in(cleaning, monkeypatch) == 130
    assert cleaned
