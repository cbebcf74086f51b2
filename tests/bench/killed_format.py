"""A script that logs in several formats up to a tick and then kills itself. Arguments: a folder, the tick."""

import os
import signal
import sys
from pathlib import Path

from log_recording import hand_over, recording

from dpcontrol.bench.logging import Blocks, ByMessage, Format, Lines

if __name__ == "__main__":
    folder, tick = Path(sys.argv[1]), int(sys.argv[2])
    run = recording(folder, 400)
    formats: list[Format] = [Blocks(), ByMessage(16 * 1024), Lines("CSV", flush=False), Lines("JSON", flush=True)]
    for k, kind in enumerate(formats):
        hand_over(kind, folder / f"killed-{k}", run, tick)
    os.kill(os.getpid(), signal.SIGKILL)
