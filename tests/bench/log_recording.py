"""A made-up run as the chart of logging takes it: random numbers, in the shapes of a double pendulum's ticks."""

from pathlib import Path

import numpy as np

from dpcontrol.bench.logging import Blocks, Format, LoggedRun, write
from dpcontrol.logs import control_fields
from dpcontrol.loop.result import Ticks

RATE = 1000.0
LENGTHS = (0.2, 0.3)


def recording(folder: Path, ticks: int) -> LoggedRun:
    rng = np.random.default_rng(2)
    states = rng.standard_normal((3, ticks, 6))
    control = rng.standard_normal((ticks, len(control_fields(2, has_cart=True))))
    rows = Ticks(np.arange(ticks) / RATE, states[0][:, [0, 1, 4]], states[0], states[1], states[2], control)
    run = LoggedRun(rows, folder / "source.mcap", LENGTHS, RATE)
    write(Blocks(), run.log, run)
    return run


def hand_over(kind: Format, path: Path, run: LoggedRun, until: int) -> None:
    """Begin `path` and hand over whole blocks of the ticks before `until`."""
    kind.begin(path, run)
    for first in range(0, until // kind.block * kind.block, kind.block):
        kind.add(first, first + kind.block)
