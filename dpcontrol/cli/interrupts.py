"""Ctrl-C as the command line takes it: a KeyboardInterrupt, and another one where the first was swallowed.

Other code may take an interrupt for its own, or make another error of it, and the program goes on. So a timer looks
again, until what runs the command line has caught the interrupt: where nothing on the stack is being cleaned up for it,
it was lost, and is raised anew. However a verb ends that was interrupted, it counts as interrupted.
"""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_AGAIN = 0.2  # s; clean-up that is under way is not disturbed, however long it takes
_unanswered: list[int] = []
"""Interrupts of what runs now; there is one SIGINT to a process."""


@contextmanager
def interrupts() -> Iterator[None]:
    """Make Ctrl-C raise KeyboardInterrupt, in the block until it is left by it, and whatever else the block ends with.

    Only the main thread may set handlers; called from another, Python's own stay.
    """
    insists = hasattr(signal, "setitimer")

    def interrupted(number: int, frame: FrameType | None) -> None:
        _unanswered.append(number)
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
    _unanswered.clear()
    signal.signal(signal.SIGINT, interrupted)
    before = signal.signal(signal.SIGALRM, looked_again) if insists else None
    try:
        yield
    except BaseException as error:
        # Imports report an interrupt as an error of their own, and a search as one that did not converge.
        if _unanswered and not isinstance(error, KeyboardInterrupt):
            raise KeyboardInterrupt from error
        raise
    finally:
        if insists:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)
    if _unanswered:
        raise KeyboardInterrupt


def forget_interrupts() -> None:
    """Take the interrupts so far as answered, where Ctrl-C is how a verb is ended in good order."""
    _unanswered.clear()
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
