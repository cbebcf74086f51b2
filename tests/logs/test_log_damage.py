"""A log that is not whole is refused with a sentence, whatever happened to it."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from log_corruption import records
from log_endurance import is_same, tried
from log_samples import open_writer, sample, write_sample
from mcap.opcode import Opcode
from mcap.writer import Writer

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import Event, read_log, recover

FLIPS = 200
SEED = 20
"""Of the places of the flipped bits."""


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


def test_a_truncated_log_is_rejected_wherever_it_is_cut(whole: Path, tmp_path: Path) -> None:
    data, cut = whole.read_bytes(), tmp_path / "cut.mcap"
    ends = [0, 1, 7, 8, 9, 30, *np.linspace(31, len(data) - 9, 80).astype(int), *range(len(data) - 8, len(data))]
    for end in ends:
        cut.write_bytes(data[:end])
        assert tried(read_log, cut) is None


def test_a_flipped_bit_is_rejected_or_changes_nothing(whole: Path, tmp_path: Path) -> None:
    data, expected, path = whole.read_bytes(), read_log(whole), tmp_path / "flipped.mcap"
    rng = np.random.default_rng(SEED)
    # The last kilobytes hold the summary and the footer, which a uniform draw would seldom hit.
    places = np.concatenate([rng.integers(0, len(data), FLIPS - 60), rng.integers(len(data) - 400, len(data), 60)])
    for place in places:
        changed = bytearray(data)
        changed[place] ^= 1 << rng.integers(8)
        path.write_bytes(changed)
        found = tried(read_log, path)
        if found is not None:
            is_same(found, expected)


def test_swapped_chunks_and_joined_padded_or_shortened_files_are_rejected(whole: Path, tmp_path: Path) -> None:
    data, odd = whole.read_bytes(), tmp_path / "odd.mcap"
    chunks = [(start, end) for opcode, start, end in records(data) if opcode == Opcode.CHUNK]
    (a, b), (c, d) = chunks[3], chunks[5]
    swapped = data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]
    assert len(swapped) == len(data)
    for changed in (swapped, data + data, data + b"\0", data[:500] + bytes(4096), data[:500] + data[600:]):
        odd.write_bytes(changed)
        assert tried(read_log, odd) is None


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "not an MCAP file"),
        (b"time,angle\n0,1\n", "not an MCAP file"),
        (foreign("/joint_states"), "somebody else's"),
        (foreign(), "lacks"),
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


def test_a_missing_log_and_a_folder_are_rejected(whole: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read"):
        read_log(tmp_path)
    with pytest.raises(InputError, match="there is no log"):
        read_log(tmp_path / "run.mcap")
    (tmp_path / "run.mcap.partial").write_bytes(whole.read_bytes()[:40_000])
    with pytest.raises(InputError, match=r"dpcontrol recover .*run\.mcap\.partial"):
        read_log(tmp_path / "run.mcap")


def test_a_log_without_ticks_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "eventful.mcap"
    with open_writer(path, sample()) as log:
        log.event(Event(0.0, "fatal", "loop", words="could not start"))
    with pytest.raises(InputError, match="no ticks"):
        read_log(path)
