"""A log that is not whole is refused or recovered with a sentence, whatever happened to it or to its run."""

import errno
import os
from collections.abc import Callable
from dataclasses import fields
from io import BytesIO
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from log_corruption import KINDS, damaged, records
from log_samples import RATE, log_ticks, open_writer, sample, tick_all, write_sample
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import Writer

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import LogWriter, Recovery, RunLog, read_log, recover

EXAMPLES = 100
CHUNK = 20
"""Ticks in a chunk at 1 kHz: what a damaged byte may cost."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sample(tmp_path_factory.mktemp("logs") / "run.mcap", sample())


def foreign(*topics: str) -> bytes:
    stream = BytesIO()
    writer = Writer(stream, enable_data_crcs=True)
    writer.start(library="somebody else's")
    for topic in topics:
        channel = writer.register_channel(topic, "json", writer.register_schema("x", "jsonschema", b"{}"))
        writer.add_message(channel, log_time=0, data=b"{}", publish_time=0)
    writer.finish()
    return stream.getvalue()


Result = TypeVar("Result")


def rows_of(log: RunLog) -> np.ndarray:
    """Return all numbers of each tick as one row of bits."""
    columns = [log.time[:, None], log.measured, *(log.states[part] for part in sorted(log.states))]
    columns += [values[:, None] for _, values in sorted(log.controls.items())]
    return np.column_stack(columns).view(np.int64)


def is_part_of(found: RunLog, log: RunLog) -> None:
    """Assert that all that was recovered is in the log, at its place."""
    assert found.parts == log.parts
    places = np.searchsorted(log.time, found.time)
    assert (np.diff(places) > 0).all()
    np.testing.assert_array_equal(rows_of(found), rows_of(log)[places])
    if found.extras is not None:
        assert found.extras.names == log.extras.names
        places = np.searchsorted(log.extras.time, found.extras.time)
        for part in ("time", "values", "sigmas"):
            np.testing.assert_array_equal(getattr(found.extras, part), getattr(log.extras, part)[places])
    assert [e for e in log.events if e in found.events] == list(found.events)
    assert found.attachments.items() <= log.attachments.items()
    assert found.metadata.items() <= log.metadata.items()


def is_same(found: RunLog, log: RunLog) -> None:
    is_part_of(found, log)
    is_part_of(log, found)
    for field in fields(RunLog):
        if field.name not in ("path", "states", "controls", "time", "measured", "rates", "extras"):
            assert getattr(found, field.name) == getattr(log, field.name)


def is_honest(done: Recovery, found: RunLog, log: RunLog) -> None:
    """Assert that a recovery reports exactly the missing data."""
    assert done.ticks == len(found.time)
    assert (found.recovered or "") == done.lost
    if done.end_known:
        assert done.ticks + done.ticks_lost == len(log.time)
    assert set(done.attachments) | set(done.attachments_lost) == set(log.attachments)
    if not done.lost:
        is_same(found, log)


def endure(whole: RunLog, folder: Path, data: bytes) -> str:
    """Read and recover a damaged copy of a log; return how it ended."""
    bad, out = folder / "bad.mcap", folder / "out.mcap"
    bad.write_bytes(data)
    out.unlink(missing_ok=True)
    as_read = tried(read_log, bad)
    if as_read is not None:
        is_same(as_read, whole)
        return "harmless"
    done = tried(lambda path: recover(path, out), bad)
    if done is None:
        assert not out.exists()
        return "refused"
    found = read_log(out)
    is_part_of(found, whole)
    is_honest(done, found, whole)
    return "partly" if done.lost else "wholly"


def tried(function: Callable[[Path], Result], path: Path) -> Result | None:
    """Return a function's result for a file, or None if it refuses the file by name."""
    try:
        return function(path)
    except InputError as error:
        if str(path) not in str(error) or "\n" in str(error):
            raise AssertionError(f"no sentence on {path}: {error}") from error
        return None


@settings(derandomize=True, deadline=None, max_examples=EXAMPLES, suppress_health_check=list(HealthCheck))
@given(kind=st.sampled_from(KINDS), seed=st.integers(0, 2**32 - 1))
def test_a_damaged_log_is_read_as_written_or_refused_and_its_recovery_is_honest(
    whole: Path, tmp_path_factory: pytest.TempPathFactory, kind: str, seed: int
) -> None:
    folder = tmp_path_factory.getbasetemp()
    ended = endure(read_log(whole), folder, damaged(whole.read_bytes(), kind, seed))
    assert ended in ("wholly", "harmless") or kind not in ("swap", "repeat", "index", "tail", "joined")


def test_a_flipped_bit_costs_one_chunk_at_most(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    chunks = [(a, b) for opcode, a, b in records(data) if opcode == Opcode.CHUNK]
    for number, (start, end) in list(enumerate(chunks))[1:-1:3]:
        changed = bytearray(data)
        changed[(start + end) // 2] ^= 4
        (tmp_path / "bad.mcap").write_bytes(changed)
        done = recover(tmp_path / "bad.mcap", tmp_path / "out.mcap", force=True)
        assert done.ticks_lost == CHUNK
        assert np.flatnonzero(np.diff(read_log(done.log).time) > 1.5 / RATE) == [number * CHUNK - 1]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "not an MCAP file"),
        (b"time,angle\n0,1\n", "not an MCAP file"),
        (foreign("/joint_states"), "not a log of `dpcontrol run`"),
        (foreign(), "not a log of `dpcontrol run`"),
    ],
    ids=["empty", "text", "foreign", "no topics"],
)
def test_other_files_are_rejected_with_their_kind(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(InputError, match=said):
        read_log(path)
    with pytest.raises(InputError):
        recover(path)
    assert [*tmp_path.iterdir()] == [path]


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
