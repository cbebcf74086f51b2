"""Ctrl-C as the command line takes it: a KeyboardInterrupt, and another one where the first was swallowed.

Compiled code that calls back into Python (IPOPT through casadi) takes an interrupt for its own, stops, and the program
goes on. So a timer looks again, until what runs the command line has caught the interrupt: where nothing on the stack
is being cleaned up for it, it was lost, and is raised anew.
"""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_AGAIN = 0.2  # s; clean-up that is under way is not disturbed, however long it takes


@contextmanager
def interrupts(noted: list[int]) -> Iterator[None]:
    """Make Ctrl-C raise KeyboardInterrupt, in the block until it is left by it, and add to a list each time.

    Only the main thread may set handlers; called from another, Python's own stay.
    """
    insists = hasattr(signal, "setitimer")

    def interrupted(number: int, frame: FrameType | None) -> None:
        noted.append(number)
        if insists:
            signal.setitimer(signal.ITIMER_REAL, _AGAIN)
        raise KeyboardInterrupt

    def looked_again(number: int, frame: FrameType | None) -> None:
        signal.setitimer(signal.ITIMER_REAL, _AGAIN)
        if not _under_way():
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    signal.signal(signal.SIGINT, interrupted)
    before = signal.signal(signal.SIGALRM, looked_again) if insists else None
    try:
        yield
    finally:
        if insists:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)


def forget_interrupts() -> None:
    """Take the interrupts so far as answered, where Ctrl-C is how a verb is ended in good order."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0)


def _under_way() -> bool:
    """Tell whether an interrupt, or what came of it, is being handled on the stack."""
    error = sys.exception()
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False
