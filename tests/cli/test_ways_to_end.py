"""Interrupts, signals and closed streams end a command with its exit code, and finished results are kept."""

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress

import casadi as ca
import pytest
from command_line import PROGRAM, dpcontrol

from dpcontrol.cli import main as program
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.interrupts import catching_interrupts


@pytest.mark.parametrize("error", [GoalMissed("no reference"), InputError("no"), RuntimeError("__set_name__"), None])
def test_a_verb_that_makes_another_error_of_an_interrupt_counts_as_interrupted(
    error: Exception | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ending(*_: object, **__: object) -> None:
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        if error is not None:
            raise error

    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(program.cli, "main", ending)
    try:
        assert dpcontrol("verb").code == 130
        # The interrupt is over for what the program does next, also where Ctrl-C is ignored.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        with catching_interrupts():
            pass
    finally:
        signal.signal(signal.SIGINT, before)


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


ENDED = """
import os, signal, sys, time
from dpcontrol.__main__ import main
from dpcontrol.cli import main as program
def works(*_, **__):
    os.kill(os.getpid(), {number})
    time.sleep({seconds})
program.cli.main = works
main()
"""


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="SIGHUP is POSIX's")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_signal_ends_a_command_with_a_sentence(name: str) -> None:
    number = signal.Signals[name]
    # The tests may run under nohup.
    default = f"import signal; signal.signal({int(number)}, signal.SIG_DFL)\n"
    code = default + ENDED.format(number=int(number), seconds=60)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=50)
    assert done.returncode == 128 + number
    assert f"ended by {name}" in done.stderr


@pytest.mark.parametrize("command", ["--help", "model lab"])
def test_a_command_whose_reader_has_ended_misses_no_goal(command: str) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    done = subprocess.run(
        [PROGRAM, *command.split()], stdout=writer, stderr=subprocess.PIPE, env=environment, check=False
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, b"")
