"""Ctrl-C ends the program: before the command line is imported, and where other code has swallowed it."""

import os
import signal
import subprocess
import sys
import time
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


DEAF = """
import itertools
from dpcontrol.__main__ import main
from dpcontrol.cli import main as program
from dpcontrol.foundation import interrupts
interrupts._PATIENCE = 0.1
def deaf(*_, **__):
    print("begun", flush=True)
    sum(itertools.repeat(0))
program.cli.main = deaf
main()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="a program is watched by a fork of itself, which is POSIX's")
def test_an_interrupt_ends_compiled_code_that_holds_the_interpreter() -> None:
    """A sum of a C iterator without end looks for no signals, as casadi does not where it derives a program."""
    with subprocess.Popen([sys.executable, "-c", DEAF], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as program:
        assert program.stdout is not None
        program.stdout.readline()
        time.sleep(0.05)
        program.send_signal(signal.SIGINT)
        _, said = program.communicate()
    assert program.returncode == -signal.SIGKILL
    assert said.decode() == (
        "dpcontrol: interrupted, by force, in a computation that could not stop; finished results are kept\n"
    )


def test_the_process_that_watches_a_program_ends_with_it() -> None:
    code = """
import os, signal
from dpcontrol.__main__ import main
from dpcontrol.cli import main as program
program.cli.main = lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL)
main()
"""
    with subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE) as program:
        # It would keep the stream open.
        assert program.communicate() == (None, b"")
    assert program.returncode == -signal.SIGKILL


OVER = """
import signal, time
from dpcontrol.foundation.interrupts import interrupts
with interrupts():
    pass
try:
    signal.raise_signal(signal.SIGINT)
except KeyboardInterrupt:
    time.sleep(0.4)
    print("caught")
"""


def test_an_interrupt_after_the_block_is_one_for_the_caller_and_no_alarm_follows() -> None:
    done = subprocess.run([sys.executable, "-c", OVER], capture_output=True, text=True, check=False, env=os.environ)
    assert (done.returncode, done.stdout, done.stderr) == (0, "caught\n", "")


def test_an_interrupted_program_runs_its_exit_handlers_and_unloads_no_modules() -> None:
    """Unloading heyoka and casadi took a second and more on a busy machine, after the final message."""
    code = """
import atexit, os
from dpcontrol.__main__ import main
from dpcontrol.cli import main as program
class Slow:
    def __del__(self):
        os.write(2, b"taken apart")
program.slow = Slow()
atexit.register(os.write, 2, b"swept")
def interrupted(*_, **__):
    print("begun")
    raise KeyboardInterrupt
program.cli.main = interrupted
main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (130, "begun\n")
    assert done.stderr == "dpcontrol: interrupted; finished results are kept\nswept"


def interrupted_in(verb: Callable[[], None], monkeypatch: pytest.MonkeyPatch) -> int:
    """Return the exit code of a verb that interrupts itself, and restore the handler of Python."""
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


IN_A_DESTRUCTOR = """
import signal, time
from dpcontrol.foundation.interrupts import interrupts
class Slow:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)
class Broken:
    def __del__(self):
        raise ValueError("shown")
try:
    with interrupts():
        Broken()
        Slow()
        time.sleep(60)
except KeyboardInterrupt:
    print("caught")
"""


def test_an_interrupt_in_a_destructor_is_raised_again_without_a_traceback() -> None:
    """Python loses it. Its traceback was printed, for one in thousands of interrupts."""
    done = subprocess.run([sys.executable, "-c", IN_A_DESTRUCTOR], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "caught\n")
    assert "KeyboardInterrupt" not in done.stderr
    assert "ValueError: shown" in done.stderr


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


def test_an_interrupted_optimisation_prints_nothing_and_does_not_count_as_failed(
    capsys: pytest.CaptureFixture[str],
) -> None:
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
    assert capsys.readouterr().err == ""


def test_a_repeated_interrupt_stops_the_current_optimisation(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where casadi's own Python swallowed the first, IPOPT took the next for a failure, and another search began."""
    went_on = []

    def solving() -> None:
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        with catching_interrupts(), suppress(KeyboardInterrupt):
            time.sleep(60)
        went_on.append(True)

    assert interrupted_in(solving, monkeypatch) == 130
    assert not went_on


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
