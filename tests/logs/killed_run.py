"""A run for tests that kill it. It logs at 1 kHz and prints each logged tick on stdout.

Arguments: the log, the number of ticks, and the seconds per tick (0: as fast as possible).
"""

import os
import sys
import time
from pathlib import Path

from log_samples import log_tick, open_writer, sample

if __name__ == "__main__":
    path, ticks, period = Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
    run = sample(ticks)
    with open_writer(path, run) as log:
        begin = time.perf_counter()
        for k in range(ticks):
            log_tick(log, run, k)
            os.write(sys.stdout.fileno(), k.to_bytes(4, "little"))
            while time.perf_counter() < begin + (k + 1) * period:
                time.sleep(0.2 * period)
