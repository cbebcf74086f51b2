"""Ctrl-C and SIGTERM: a KeyboardInterrupt, and another one where the first was swallowed.

Other code may take an interrupt for its own, make another error of it, or return as if it had merely failed, and the
program goes on. So a timer looks again, until what runs the command line has caught the interrupt: where nothing on the
stack is being cleaned up for it, it was lost, and is raised anew. However a verb ends that was interrupted, it counts
as interrupted; so does a call of compiled code in `heeding_interrupts`.

None of this runs while compiled code holds the interpreter, as casadi does for tens of seconds where it derives a large
program. So the program is watched by a process of its own, which is told of a signal by Python's handler in C, and of
the answer by the one in Python; where that does not come, it ends the program.
"""

import os
import select
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, suppress
from types import FrameType
from typing import Any

_AGAIN = 0.2  # s; clean-up that is under way is not disturbed, however long it takes
_raised: list[int] = []
"""Signals for which KeyboardInterrupt was raised and not yet answered: SIGINT, SIGTERM, and the timer's."""
_PATIENCE = 0.7  # s; in which the interpreter takes an interrupt, else the program is ended by force
_TAKEN = b"\0"
_BY_FORCE = b"dpcontrol: interrupted, by force, in a computation that could not stop; what was finished is kept\n"
_watcher: list[int] = []
"""Where the process that watches this one is told that an interrupt is taken; empty where none watches."""


def end_by_force_where_deaf() -> None:
    """Have this process killed where it does not take an interrupt at once; to be called before threads exist.

    It ends by SIGKILL then: whoever writes files writes them beside their place first, and workers end with their
    parent.
    """
    if not hasattr(os, "fork"):
        return
    heard, told = os.pipe()
    program = os.getpid()
    try:
        child = os.fork()
    except OSError:
        os.close(heard)
        os.close(told)
        return
    if child == 0:
        try:
            os.close(told)
            _watch(heard, program)
        finally:
            os._exit(0)
    os.close(heard)
    os.set_blocking(told, False)
    signal.set_wakeup_fd(told, warn_on_full_buffer=False)
    _watcher.append(told)


def _watch(heard: int, program: int) -> None:
    """Kill a program that was sent an interrupt and did not take it in time, until it has ended."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    # Whoever reads the program's output waits for nothing else.
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(nothing, 1)
    while last := os.read(heard, 4096):
        while last[-1] in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM):
            if not select.select([heard], [], [], _PATIENCE)[0]:
                os.write(2, _BY_FORCE)
                os.kill(program, signal.SIGKILL)
                return
            if not (last := os.read(heard, 4096)):
                return


def interrupt_taken() -> None:
    """Tell the process that watches this one, if any, that an interrupt is taken."""
    for told in _watcher:
        with suppress(OSError):
            os.write(told, _TAKEN)


@contextmanager
def interrupts() -> Iterator[None]:
    """Have Ctrl-C and SIGTERM raise KeyboardInterrupt in the block until it ends, whatever else the block ends with.

    Only the main thread may set handlers; called from another, Python's own stay.
    """
    insists = hasattr(signal, "setitimer")

    def interrupted(number: int, frame: FrameType | None) -> None:
        interrupt_taken()
        _raised.append(number)
        if insists:
            signal.setitimer(signal.ITIMER_REAL, _AGAIN)
        raise KeyboardInterrupt

    def looked_again(number: int, frame: FrameType | None) -> None:
        interrupt_taken()
        if not insists:
            return
        signal.setitimer(signal.ITIMER_REAL, _AGAIN)
        if not _under_way():
            _raised.append(number)
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _raised.clear()
    signal.signal(signal.SIGINT, interrupted)
    on_terminate = signal.signal(signal.SIGTERM, interrupted)
    before = signal.signal(signal.SIGALRM, looked_again) if insists else None
    try:
        # Imports report an interrupt as an error of their own, and a search as one that did not converge.
        with _meant_by_all_errors(0):
            yield
    finally:
        signal.signal(signal.SIGTERM, on_terminate)
        if insists:
            # Whatever still comes sets no alarm: nobody would hear it, and it would end the program.
            insists = False
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)


@contextmanager
def heeding_interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt at the end of the block where Ctrl-C was pressed in it, however the block ends.

    For compiled code that takes Ctrl-C for its own and returns as if it had failed; what it has to say about an
    interrupt on stderr is left out. It serves programs without `interrupts`, too.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    known = len(_raised)

    def interrupted(number: int, frame: FrameType | None) -> None:
        _raised.append(number)
        before(number, frame)

    signal.signal(signal.SIGINT, interrupted)
    try:
        with _meant_by_all_errors(known), redirect_stderr(_QuietOnceInterrupted(sys.stderr, known)):
            yield
    finally:
        signal.signal(signal.SIGINT, before)


def terminated() -> bool:
    """Return whether the interrupt that ended the block of `interrupts` was a SIGTERM."""
    return signal.SIGTERM in _raised


def forget_interrupts() -> None:
    """Take the interrupts so far as answered, where Ctrl-C is how a verb is ended in good order."""
    _raised.clear()
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0)


@contextmanager
def _meant_by_all_errors(known: int) -> Iterator[None]:
    """Raise KeyboardInterrupt in place of whatever the block ends with, where more than `known` were raised."""
    try:
        yield
    except BaseException as error:
        if len(_raised) > known and not isinstance(error, KeyboardInterrupt):
            raise KeyboardInterrupt from error
        raise
    if len(_raised) > known:
        raise KeyboardInterrupt


def _under_way() -> bool:
    """Tell whether an interrupt, or what came of it, is being handled on the stack."""
    error = sys.exception()
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


class _QuietOnceInterrupted:
    """A stream that says nothing more once another interrupt is raised; in all else the stream that it is of."""

    def __init__(self, stream: Any, known: int) -> None:
        self._stream, self._known = stream, known

    def write(self, text: str) -> int:
        return len(text) if len(_raised) > self._known else self._stream.write(text)

    def flush(self) -> None:
        self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
