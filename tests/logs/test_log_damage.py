"""A log that is not whole is refused with a sentence, whatever happened to it."""

from collections.abc import Callable
from dataclasses import fields
from io import BytesIO
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from log_corruption import KINDS, damaged, records
from log_samples import RATE, sample, write_sample
from mcap.opcode import Opcode
from mcap.writer import Writer

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import Recovery, RunLog, read_log, recover

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
        assert log.extras is not None
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
