"""Ctrl-C: a KeyboardInterrupt, and another one where the first was swallowed.

Other code may take an interrupt for its own, make another error of it, or return as if it had merely failed, and the
program goes on. So a timer looks again, until what runs the command line has caught the interrupt: where nothing on the
stack is being cleaned up for it, it was lost, and is raised anew. However a verb ends that was interrupted, it counts
as interrupted; so does a call of compiled code in `heeding_interrupts`.
"""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from types import FrameType
from typing import Any

_AGAIN = 0.2  # s; clean-up that is under way is not disturbed, however long it takes
_raised: list[int] = []
"""Signals for which KeyboardInterrupt was raised and not yet answered; there is one SIGINT to a process."""


@contextmanager
def interrupts() -> Iterator[None]:
    """Make Ctrl-C raise KeyboardInterrupt, in the block until it is left by it, and whatever else the block ends with.

    Only the main thread may set handlers; called from another, Python's own stay.
    """
    insists = hasattr(signal, "setitimer")

    def interrupted(number: int, frame: FrameType | None) -> None:
        _raised.append(number)
        if insists:
            signal.setitimer(signal.ITIMER_REAL, _AGAIN)
        raise KeyboardInterrupt

    def looked_again(number: int, frame: FrameType | None) -> None:
        signal.setitimer(signal.ITIMER_REAL, _AGAIN)
        if not _under_way():
            _raised.append(number)
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _raised.clear()
    signal.signal(signal.SIGINT, interrupted)
    before = signal.signal(signal.SIGALRM, looked_again) if insists else None
    try:
        # Imports report an interrupt as an error of their own, and a search as one that did not converge.
        with _meant_by_all_errors(0):
            yield
    finally:
        if insists:
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
