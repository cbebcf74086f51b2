"""The program: `dpcontrol`, or `python -m dpcontrol`.

Ctrl-C ends it from the first moment to the last.
"""

import atexit
import os
import signal
import sys
from contextlib import suppress
from types import FrameType

INTERRUPTED = (129, 130, 143)
"""Exit codes after SIGHUP, Ctrl-C and SIGTERM."""


def main() -> None:
    """Run the command line and exit."""
    _open_streams()
    # Matrices are small here, so threads of a BLAS cost up to four times the time on two cores. The last digits would
    # also depend on their number.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    # Notebooks set a backend that may be missing here. The command line writes pictures as files and needs none.
    os.environ["MPLBACKEND"] = "agg"
    # The imports of the command line take a while. An interrupt before their end needs no cleaning up.
    signal.signal(signal.SIGINT, _ended_at_once)
    from dpcontrol.foundation.interrupts import confirm_interrupt, endings, kill_if_unresponsive

    for number in (ends := endings()):
        signal.signal(number, _ended_at_once)

    kill_if_unresponsive()
    from dpcontrol.cli.main import main as run

    try:
        run()
    except SystemExit as ended:
        if ended.code in INTERRUPTED:
            _end_quickly(ended.code)
        raise
    finally:
        _discard_unwritable_output()
        # The work is done and its exit code is known. The end of the interpreter must not change it.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        for number in ends:
            signal.signal(number, signal.SIG_DFL)
        confirm_interrupt()
        # Python treats an interrupt inside executed text, such as that of a dataclass, as uncaught until it executes
        # another text.
        exec("")


def _open_streams() -> None:
    """Open closed standard streams; the next files would get their numbers."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), "r" if name == "stdin" else "w"))


def _discard_unwritable_output() -> None:
    """Empty the buffers of full or closed streams.

    Python's own attempt at exit would replace the exit code by 120.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            with suppress(OSError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _ended_at_once(number: int, frame: FrameType | None) -> None:
    how = "interrupted" if number == signal.SIGINT else f"ended by {signal.Signals(number).name}"
    with suppress(OSError):
        os.write(2, f"dpcontrol: {how}; nothing was begun\n".encode())
    os._exit(128 + number)


def _end_quickly(code: int) -> None:
    """End with exit handlers, but without unloading modules.

    Unloading takes a second for compiled code.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        # The reader can have ended, as `head` does.
        with suppress(OSError):
            stream.flush()
    os._exit(code)


if __name__ == "__main__":
    main()
