"""The program: `dpcontrol`, or `python -m dpcontrol`. Ctrl-C ends it from the first moment to the last."""

import os
import signal
from types import FrameType


def main() -> None:
    """Run the command line and exit."""
    # The command line's own imports take a while; nothing is begun before they are done.
    signal.signal(signal.SIGINT, _ended_at_once)
    from dpcontrol.foundation.interrupts import end_by_force_where_deaf, interrupt_taken

    end_by_force_where_deaf()
    from dpcontrol.cli.main import main as run

    try:
        run()
    finally:
        # The work is done and its exit code known, however long the interpreter takes to end.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        interrupt_taken()
        # Python takes an interrupt in a text that it ran, as of a dataclass, for one that nobody caught, until it runs
        # another.
        exec("")


def _ended_at_once(number: int, frame: FrameType | None) -> None:
    os.write(2, b"dpcontrol: interrupted; nothing was begun\n")
    os._exit(130)


if __name__ == "__main__":
    main()
