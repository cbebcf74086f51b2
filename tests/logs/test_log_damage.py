"""A log that is not whole is refused with a sentence, whatever happened to it."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from log_corruption import KINDS, damaged, records
from log_endurance import endure
from log_samples import RATE, sample, write_sample
from mcap.opcode import Opcode
from mcap.writer import Writer

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import read_log, recover

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
