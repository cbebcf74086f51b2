"""Ctrl-C ends the program: before the command line is imported, and where other code makes another error of it."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress

import casadi as ca
import pytest
from command_line import dpcontrol

from dpcontrol.cli import main as program
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.interrupts import catching_interrupts

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
    """Return the exit code of a verb that interrupts itself, and restore the handler of Python."""
    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(program.cli, "main", lambda *_, **__: verb())
    try:
        return dpcontrol("verb").code
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("error", [GoalMissed("no reference"), InputError("no"), RuntimeError("__set_name__"), None])
def test_a_verb_that_makes_another_error_of_an_interrupt_counts_as_interrupted(
    error: Exception | None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def ending() -> None:
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        if error is not None:
            raise error

    assert interrupted_in(ending, monkeypatch) == 130


def test_an_interrupt_is_one_line_if_stderr_is_not_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(program.cli, "get_command", interrupted)
    try:
        ended = dpcontrol("model", "lab")
    finally:
        signal.signal(signal.SIGINT, before)
    assert (ended.code, ended.stderr) == (130, "dpcontrol: interrupted; finished results are kept\n")


def test_an_interrupted_optimisation_does_not_count_as_failed() -> None:
    """IPOPT takes an error in its callbacks for a point where functions cannot be evaluated, and goes on."""

    class Interrupting(ca.Callback):
        def __init__(self) -> None:
            super().__init__()
            self.construct("interrupting", {"enable_fd": True})

        def eval(self, arguments: Sequence[ca.DM]) -> list[ca.DM]:
            signal.raise_signal(signal.SIGINT)
            return [arguments[0] ** 2]

    square, x = Interrupting(), ca.MX.sym("x")
    options = {"print_time": False, "error_on_fail": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
    solver = ca.nlpsol("solver", "ipopt", {"x": x, "f": square(x)}, options)
    with pytest.raises(KeyboardInterrupt), catching_interrupts():
        solver(x0=1.0)


def test_a_verb_shows_its_progress_before_it_is_loaded() -> None:
    """For verbs whose imports take a second, a line is printed before the first of these imports."""
    code = """
import sys
from dpcontrol.foundation import progress
from dpcontrol.cli import charts, walk
for module in ("numpy", "scipy", "casadi", "heyoka", "matplotlib"):
    assert module not in sys.modules, module
class Shown(Exception):
    pass
def shown(label):
    assert not {"numpy", "scipy", "casadi", "heyoka", "matplotlib"} & set(sys.modules)
    print(label)
    raise Shown
for module, verb, line in (
    (charts, "bench", "connections --quick"), (charts, "figures", "graph"),
    (walk, "walk", "lab --energy 0.2 --length 2 --solve"),
):
    module.progress_bar = shown
    try:
        getattr(module, f"{verb}_command").main(line.split(), standalone_mode=False)
    except Shown:
        pass
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stdout.split(), done.stderr) == (["bench", "figures", "connections"], "")


SLOW_TO_CLEAN_UP = """
import signal, time
from dpcontrol.foundation.interrupts import interrupts
with interrupts():
    try:
        signal.raise_signal(signal.SIGINT)
    finally:
        print("cleaning", flush=True)
        time.sleep(60)
"""


@pytest.mark.parametrize("second", [signal.SIGINT, signal.SIGTERM])
def test_a_second_interrupt_ends_the_program_at_once(second: signal.Signals) -> None:
    with subprocess.Popen([sys.executable, "-c", SLOW_TO_CLEAN_UP], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"cleaning\n"
        process.send_signal(second)
        process.communicate()
    assert process.returncode == -second
