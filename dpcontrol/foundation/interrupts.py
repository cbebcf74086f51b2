"""Ctrl-C in compiled code that takes it for its own and returns as if it had merely failed."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from types import FrameType
from typing import Any


@contextmanager
def heeding_interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt at the end of the block where Ctrl-C was pressed in it, however the block ends.

    What the compiled code has to say about an interrupt on stderr is left out.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    noted: list[int] = []

    def interrupted(number: int, frame: FrameType | None) -> None:
        noted.append(number)
        before(number, frame)

    signal.signal(signal.SIGINT, interrupted)
    try:
        with redirect_stderr(_QuietOnceInterrupted(sys.stderr, noted)):
            yield
    except Exception as error:
        if noted:
            raise KeyboardInterrupt from error
        raise
    finally:
        signal.signal(signal.SIGINT, before)
    if noted:
        raise KeyboardInterrupt


class _QuietOnceInterrupted:
    """A stream that says nothing more once an interrupt is noted; in all else the stream that it is of."""

    def __init__(self, stream: Any, noted: list[int]) -> None:
        self._stream, self._noted = stream, noted

    def write(self, text: str) -> int:
        return len(text) if self._noted else self._stream.write(text)

    def flush(self) -> None:
        self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
