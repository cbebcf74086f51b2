"""Reliable KeyboardInterrupt for Ctrl-C, SIGTERM and SIGHUP, even if it is suppressed.

Other code may catch an interrupt, turn it into another error, or return as if it had merely failed. The program would
then continue. A timer therefore checks until the command line has caught the interrupt. If no code on the stack is
cleaning up after it, the interrupt was lost and is raised again. Python itself loses an interrupt that arrives in a
destructor or in a callback of `weakref`; the traceback that it would print is suppressed. A verb that was interrupted
counts as interrupted, however it ends. So does a call of compiled code in `catching_interrupts`.

Python handlers do not run while compiled code holds the interpreter. casadi does this for tens of seconds when it
derives a large program. A separate process therefore watches the program. Python's C handler notifies it of a signal,
and the Python handler confirms it. If the confirmation does not arrive, the watching process kills the program.
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

_AGAIN = 0.2  # s; clean-up in progress is not disturbed, however long it takes
_raised: list[int] = []
"""Signals for which KeyboardInterrupt was raised and not yet handled: SIGINT, those of `endings`, and the timer's."""
_PATIENCE = 0.7  # s; time limit for the interpreter to handle an interrupt before the program is killed
_CONFIRMED = b"\0"
_BY_FORCE = b"dpcontrol: interrupted, by force, in a computation that could not stop; finished results are kept\n"
_watcher: list[int] = []
"""Pipes to the watching process for confirmations; empty without one."""


def endings() -> list[signal.Signals]:
    """Return the signals other than Ctrl-C that end a program.

    A terminal sends SIGHUP when it is closed, and `nohup` ignores it.
    """
    there = [signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]
    return [one for one in there if one == signal.SIGTERM or signal.getsignal(one) != signal.SIG_IGN]


def kill_if_unresponsive() -> None:
    """Start a process that kills this one after ignored interrupts.

    It does so if this process does not handle an interrupt in time.

    Call this before any thread exists. The program then ends by SIGKILL. Files remain whole, because they are written
    under temporary names, and workers end with their parent.
    """
    if not hasattr(os, "fork"):
        return
    received, confirmations = os.pipe()
    program = os.getpid()
    try:
        child = os.fork()
    except OSError:
        os.close(received)
        os.close(confirmations)
        return
    if child == 0:
        try:
            os.close(confirmations)
            _watch(received, program)
        finally:
            os._exit(0)
    os.close(received)
    os.set_blocking(confirmations, False)
    signal.set_wakeup_fd(confirmations, warn_on_full_buffer=False)
    _watcher.append(confirmations)


def _watch(received: int, program: int) -> None:
    """Kill a program that does not handle interrupts in time."""
    interrupting = (signal.SIGINT, *endings(), signal.SIGALRM)
    for number in interrupting:
        signal.signal(number, signal.SIG_IGN)
    # A reader of the program's output must not have to wait for this process.
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(nothing, 1)
    while last := os.read(received, 4096):
        while last[-1] in interrupting:
            if not select.select([received], [], [], _PATIENCE)[0]:
                # The terminal may be closed.
                with suppress(OSError):
                    os.write(2, _BY_FORCE)
                os.kill(program, signal.SIGKILL)
                return
            if not (last := os.read(received, 4096)):
                return


def confirm_interrupt() -> None:
    """Confirm to the watching process, if any, that an interrupt was handled."""
    for confirmations in _watcher:
        with suppress(OSError):
            os.write(confirmations, _CONFIRMED)


@contextmanager
def interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt for Ctrl-C and `endings` in the block.

    This holds however the block ends. Only the main thread can set handlers; in others, those of Python remain.
    """
    insists = hasattr(signal, "setitimer")

    def interrupted(number: int, frame: FrameType | None) -> None:
        confirm_interrupt()
        _raised.append(number)
        if insists:
            signal.setitimer(signal.ITIMER_REAL, _AGAIN)
        raise KeyboardInterrupt

    def check_again(number: int, frame: FrameType | None) -> None:
        confirm_interrupt()
        if not insists:
            return
        signal.setitimer(signal.ITIMER_REAL, _AGAIN)
        if not _under_way():
            _raised.append(number)
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def unraisable(lost: Any) -> None:
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            show_others(lost)

    _raised.clear()
    show_others, sys.unraisablehook = sys.unraisablehook, unraisable
    signal.signal(signal.SIGINT, interrupted)
    others = {number: signal.signal(number, interrupted) for number in endings()}
    before = signal.signal(signal.SIGALRM, check_again) if insists else None
    try:
        # Imports turn an interrupt into another error, and searches into a failure to converge.
        with _replacing_errors(0):
            yield
    finally:
        sys.unraisablehook = show_others
        for number, handler in others.items():
            signal.signal(number, handler)
        if insists:
            # Further signals must not set the timer, which would end the program without a handler.
            insists = False
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)


@contextmanager
def catching_interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt after the block if Ctrl-C was pressed.

    For compiled code that catches Ctrl-C and returns as if it had failed. Its output on stderr about the interrupt is
    suppressed. This also works in programs without `interrupts`.
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
        with _replacing_errors(known), redirect_stderr(_SilencedStream(sys.stderr, known)):
            yield
    finally:
        signal.signal(signal.SIGINT, before)


def ended_by() -> signal.Signals:
    """Return the signal that interrupted the block of `interrupts`."""
    return next((one for one in endings() if one in _raised), signal.SIGINT)


def forget_interrupts() -> None:
    """Treat interrupts so far as handled, for verbs that Ctrl-C ends normally."""
    _raised.clear()
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0)


@contextmanager
def _replacing_errors(known: int) -> Iterator[None]:
    """Raise KeyboardInterrupt instead of other errors after an interrupt.

    It does so if there are more than `known` interrupts.
    """
    try:
        yield
    except BaseException as error:
        if len(_raised) > known and not isinstance(error, KeyboardInterrupt):
            raise KeyboardInterrupt from error
        raise
    if len(_raised) > known:
        raise KeyboardInterrupt


def _under_way() -> bool:
    """True if an interrupt is being handled on the stack.

    An error that an interrupt caused counts too.
    """
    error = sys.exception()
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


class _SilencedStream:
    """A stream that drops its output once another interrupt is raised."""

    def __init__(self, stream: Any, known: int) -> None:
        self._stream, self._known = stream, known

    def write(self, text: str) -> int:
        return len(text) if len(_raised) > self._known else self._stream.write(text)

    def flush(self) -> None:
        self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
