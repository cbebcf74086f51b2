"""A made-up run as the chart of logging takes it: random numbers, in the shapes of a double pendulum's ticks."""

from pathlib import Path

import numpy as np

from dpcontrol.bench.log_formats import Format, Recording
from dpcontrol.logs import LogWriter, control_fields
from dpcontrol.logs.by_message import messages_of
from dpcontrol.loop.result import Ticks

RATE = 1000.0
LENGTHS = (0.2, 0.3)


def recording(folder: Path, ticks: int) -> Recording:
    rng = np.random.default_rng(2)
    states = rng.standard_normal((3, ticks, 6))
    control = rng.standard_normal((ticks, len(control_fields(2, has_cart=True))))
    rows = Ticks(np.arange(ticks) / RATE, states[0][:, [0, 1, 4]], states[0], states[1], states[2], control)
    path = folder / "source.mcap"
    with LogWriter(path, arm_lengths=LENGTHS, rate_hz=RATE) as log:
        log.ticks(rows.times, measured=rows.measured, estimate=rows.estimates, reference=rows.references,
                  truth=rows.truth, control=rows.control)  # fmt: skip
    return Recording(rows, messages_of(path), LENGTHS, RATE)


def hand_over(kind: Format, path: Path, run: Recording, until: int) -> None:
    """Begin `path` and hand over whole blocks of the ticks before `until`."""
    kind.begin(path, run)
    for first in range(0, until // kind.block * kind.block, kind.block):
        kind.add(first, first + kind.block)
