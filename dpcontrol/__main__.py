"""The program: `dpcontrol`, or `python -m dpcontrol`."""

import os
import signal
import sys
from contextlib import suppress
from types import FrameType


def main() -> None:
    """Run the command line and exit, with threads and pictures set up before any numerical module is imported."""
    # The imports of the command line take a while. An interrupt before their end needs no cleaning up.
    signal.signal(signal.SIGINT, _ended_at_once)
    # Matrices are small here, so threads of a BLAS cost up to four times the time on two cores. The last digits would
    # also depend on their number.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    # Notebooks set a backend that may be missing here. The command line writes pictures as files and needs none.
    os.environ["MPLBACKEND"] = "agg"
    from dpcontrol.cli.main import main as run

    try:
        run()
    finally:
        # The work is done and its exit code is known. The end of the interpreter must not change it.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        _discard_unwritable_output()


def _discard_unwritable_output() -> None:
    """Write the buffered output, and discard it if its stream is full or closed.

    Python's own attempt at exit would replace the exit code by 120.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            with suppress(OSError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _ended_at_once(number: int, frame: FrameType | None) -> None:
    """End the program at an interrupt while the command line is loaded, before any work that needs cleaning up."""
    with suppress(OSError):
        os.write(2, b"dpcontrol: interrupted; nothing was begun\n")
    os._exit(128 + number)


if __name__ == "__main__":
    main()
