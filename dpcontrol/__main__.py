"""The program: `dpcontrol`, or `python -m dpcontrol`. Ctrl-C ends it from the first moment to the last."""

import atexit
import os
import signal
import sys
from contextlib import suppress
from types import FrameType

INTERRUPTED, TERMINATED = 130, 143


def main() -> None:
    """Run the command line and exit."""
    _open_streams()
    # Matrices are small here: threads of a BLAS cost more than they bring, up to four times the seconds on two cores,
    # and let the last digits depend on how many there are.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    # Notebooks set a backend that other programs may not have. Pictures are files here, and need none.
    os.environ["MPLBACKEND"] = "agg"
    # The command line's own imports take a while; nothing is begun before they are done.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _ended_at_once)
    from dpcontrol.foundation.interrupts import confirm_interrupt, kill_if_unresponsive

    kill_if_unresponsive()
    from dpcontrol.cli.main import main as run

    try:
        run()
    except SystemExit as ended:
        if ended.code in (INTERRUPTED, TERMINATED):
            _end_quickly(ended.code)
        raise
    finally:
        # The work is done and its exit code known, however long the interpreter takes to end.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        confirm_interrupt()
        # Python takes an interrupt in a text that it ran, as of a dataclass, for one that nobody caught, until it runs
        # another.
        exec("")


def _open_streams() -> None:
    """Open standard streams that the caller has closed: their numbers would be given to the next files."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), "r" if name == "stdin" else "w"))


def _ended_at_once(number: int, frame: FrameType | None) -> None:
    how = b"interrupted" if number == signal.SIGINT else b"ended by SIGTERM"
    os.write(2, b"dpcontrol: " + how + b"; nothing was begun\n")
    os._exit(128 + number)


def _end_quickly(code: int) -> None:
    """End in order, but without taking modules apart: those of compiled code need a second for it on a busy machine."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        # Whoever read them may have gone, as `head` does.
        with suppress(OSError):
            stream.flush()
    os._exit(code)


if __name__ == "__main__":
    main()
