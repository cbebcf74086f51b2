"""A run that is killed, interrupted, or left without a disk keeps what it had, and says where."""

import errno
import os
from pathlib import Path

import numpy as np
import pytest
from log_samples import log_ticks, open_writer, sample, tick_all
from mcap.reader import make_reader

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import LogWriter, read_log, recover

ROOM = 60_000
"""Bytes that the small disk takes: a few chunks of the sample."""


@pytest.mark.parametrize("rate", [33.0, 10_000.0])
def test_at_any_rate_unwritten_data_are_at_most_twenty_milliseconds_or_a_tick(tmp_path: Path, rate: float) -> None:
    ticks = round(0.5 * rate)
    log = LogWriter(tmp_path / "run.mcap", arm_lengths=(0.2,), rate_hz=rate, has_cart=False).__enter__()
    for k in range(ticks):
        log.ticks([k / rate], measured=np.zeros((1, 1)))
    copy = tmp_path / "copy.mcap.partial"
    copy.write_bytes(log.partial.read_bytes())
    log.__exit__(None, None, None)
    assert (ticks - recover(copy).ticks) / rate <= max(0.02, 1 / rate)


def test_ticks_that_arrive_together_form_long_chunks_which_read_back_equal(tmp_path: Path) -> None:
    run = sample(1000)
    together, singly = tmp_path / "together.mcap", tmp_path / "singly.mcap"
    with open_writer(singly, run) as log:
        tick_all(log, run)
    with open_writer(together, run) as log:
        log_ticks(log, run, 0, len(run.time))
    chunks = [make_reader(path.open("rb")).get_summary().chunk_indexes for path in (singly, together)]
    assert [len(indexes) for indexes in chunks] == [50, 5]
    assert sum(index.compressed_size for index in chunks[1]) < sum(index.compressed_size for index in chunks[0])
    one, other = read_log(singly), read_log(together)
    assert (one.time == other.time).all()
    for part in one.states:
        assert (one.states[part] == other.states[part]).all()


class FullDisk:
    """A stream on a disk with little room left, in place of the writer's own."""

    def __init__(self, stream, room: int) -> None:
        self.stream, self.room = stream, room

    def write(self, data: memoryview) -> int:
        if not self.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        count = self.stream.write(data[: self.room])
        self.room -= count
        return count

    def __getattr__(self, name: str):
        return getattr(self.stream, name)


@pytest.mark.parametrize("room", [0, ROOM])
def test_a_full_disk_stops_a_run_with_a_message_and_keeps_the_written_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    from dpcontrol.logs import writer

    open_partial = writer.open_partial

    def small(path: Path):
        name, stream = open_partial(path)
        return name, FullDisk(stream, room)

    monkeypatch.setattr(writer, "open_partial", small)
    run = sample(1000)
    with pytest.raises(InputError, match="No space left") as caught, open_writer(tmp_path / "run.mcap", run) as log:
        tick_all(log, run)
    assert not (tmp_path / "run.mcap").exists()
    left = tmp_path / "run.mcap.partial"
    if room < ROOM:
        return
    (note,) = caught.value.__notes__
    assert f"dpcontrol recover {left}" in note
    done = recover(left)
    np.testing.assert_array_equal(read_log(done.log).truth, run.truth[: done.ticks])
    assert done.ticks >= 100
