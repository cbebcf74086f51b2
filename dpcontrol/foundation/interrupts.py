"""KeyboardInterrupt for Ctrl-C, SIGTERM and SIGHUP, and the end of the program at the second of them.

Other code may catch an interrupt, turn it into another error, or return as if it had merely failed, as IPOPT does. A
verb that was interrupted counts as interrupted, however it ends. So does a call of compiled code in
`catching_interrupts`.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_received: list[int] = []
"""Numbers of the signals for which KeyboardInterrupt was raised and that are not handled yet."""


def endings() -> list[signal.Signals]:
    """Return the signals that end a program: Ctrl-C, SIGTERM and, unless `nohup` ignores it, SIGHUP."""
    hang_up = getattr(signal, "SIGHUP", signal.SIGTERM)
    hung_up = {hang_up} if signal.getsignal(hang_up) != signal.SIG_IGN else set()
    return sorted({signal.SIGINT, signal.SIGTERM} | hung_up)


def _interrupted(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt for the first signal, and leave the next one to the system, which ends the program.

    Args:
        number: number of the signal.
        frame: interrupted frame, as handlers of signals receive it.
    """
    _received.append(number)
    for ending in endings():
        signal.signal(ending, signal.SIG_DFL)
    raise KeyboardInterrupt


@contextmanager
def interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt for the first of `endings` in the block, however the block ends.

    Only the main thread can set handlers; in others, those of Python remain.
    """
    _received.clear()
    in_main = threading.current_thread() is threading.main_thread()
    handlers = {number: signal.signal(number, _interrupted) for number in endings()} if in_main else {}
    try:
        with _as_interrupt():
            yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


@contextmanager
def catching_interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt after the block if Ctrl-C was pressed in it or, unnoticed, before.

    For compiled code that catches Ctrl-C and returns as if it had failed. It also works in programs without
    `interrupts`.
    """
    has_default_handler = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with interrupts() if has_default_handler else _as_interrupt():
        yield


@contextmanager
def _as_interrupt() -> Iterator[None]:
    """Raise KeyboardInterrupt at the end of the block if it was interrupted, even if other code hid the interrupt."""
    try:
        yield
    except Exception as error:
        if _received:
            raise KeyboardInterrupt from error
        raise
    if _received:
        raise KeyboardInterrupt


def ended_by() -> signal.Signals:
    """Return the signal that interrupted the block of `interrupts`."""
    return signal.Signals(_received[0]) if _received else signal.SIGINT


def forget_interrupts() -> None:
    """Treat interrupts so far as handled, for verbs that Ctrl-C ends normally."""
    _received.clear()
