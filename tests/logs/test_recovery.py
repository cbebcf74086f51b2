"""Damage is reported or repaired, and recovered data equal the written data to the last bit."""

from pathlib import Path

import numpy as np
import pytest
from log_corruption import records
from log_samples import RATE, sample, write_sample
from mcap.opcode import Opcode

from dpcontrol.logs import RunLog, read_log, recover

TICKS = 250
CHUNK = 20
"""Ticks in a chunk at 1 kHz: what a damaged byte may cost."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> RunLog:
    return read_log(write_sample(tmp_path_factory.mktemp("logs") / "run.mcap", sample(TICKS)))


def test_a_flipped_bit_costs_one_chunk_at_most(whole: RunLog, tmp_path: Path) -> None:
    data = whole.path.read_bytes()
    chunks = [(a, b) for opcode, a, b in records(data) if opcode == Opcode.CHUNK]
    for number, (start, end) in list(enumerate(chunks))[1:-1:3]:
        changed = bytearray(data)
        changed[(start + end) // 2] ^= 4
        (tmp_path / "bad.mcap").write_bytes(changed)
        done = recover(tmp_path / "bad.mcap", tmp_path / "out.mcap", force=True)
        assert done.ticks_lost == CHUNK
        times = read_log(done.log).time
        assert np.flatnonzero(np.diff(times) > 1.5 / RATE) == [number * CHUNK - 1]
        assert f"{CHUNK} ticks ({CHUNK} ms)" in done.lost
