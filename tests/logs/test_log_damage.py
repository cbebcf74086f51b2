"""A log that is not whole is refused with a sentence, whatever happened to it."""

from dataclasses import fields
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from log_samples import open_writer, sample, write_sample
from mcap.opcode import Opcode
from mcap.writer import Writer

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import Extras, RunLog, read_log

FLIPS = 200
SEED = 20
"""Of the places of the flipped bits."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sample(tmp_path_factory.mktemp("logs") / "run.mcap", sample())


def _same(one: RunLog, other: RunLog) -> bool:
    def equal(a: object, b: object) -> bool:
        if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
            return np.array_equal(a, b, equal_nan=True)
        if isinstance(a, dict) and isinstance(b, dict):
            return a.keys() == b.keys() and all(equal(a[key], b[key]) for key in a)
        if isinstance(a, Extras) and isinstance(b, Extras):
            return equal(vars(a), vars(b))
        return a == b

    return all(
        equal(getattr(one, field.name), getattr(other, field.name)) for field in fields(RunLog) if field.name != "path"
    )


def _refused(path: Path, data: bytes) -> str:
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_log(path)
    sentence = str(caught.value)
    assert str(path) in sentence
    assert "\n" not in sentence
    return sentence


def test_a_truncated_log_is_rejected_wherever_it_is_cut(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    ends = [0, 1, 7, 8, 9, 30, *np.linspace(31, len(data) - 9, 80).astype(int), *range(len(data) - 8, len(data))]
    for end in ends:
        _refused(tmp_path / "cut.mcap", data[:end])


def test_the_time_of_the_truncation_of_a_log_is_reported(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    sentence = _refused(tmp_path / "cut.mcap", data[: len(data) // 2])
    assert "cut off at 0." in sentence
    assert "dpcontrol recover" in sentence
    assert "before its first tick" in _refused(tmp_path / "cut.mcap", data[:300])


def test_a_flipped_bit_is_rejected_or_changes_nothing(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    expected = read_log(whole)
    rng = np.random.default_rng(SEED)
    # The last kilobytes hold the summary and the footer, which a uniform draw would seldom hit.
    places = np.concatenate([rng.integers(0, len(data), FLIPS - 60), rng.integers(len(data) - 400, len(data), 60)])
    for place in places:
        changed = bytearray(data)
        changed[place] ^= 1 << rng.integers(8)
        path = tmp_path / "flipped.mcap"
        path.write_bytes(changed)
        try:
            found = read_log(path)
        except InputError:
            continue
        assert _same(found, expected), f"bit flipped at byte {place} was believed"


def test_swapped_chunks_are_rejected(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    chunks, place = [], 8
    while place < len(data) - 8:
        length = int.from_bytes(data[place + 1 : place + 9], "little")
        if data[place] == Opcode.CHUNK:
            chunks.append((place, place + 9 + length))
        place += 9 + length
    (a, b), (c, d) = chunks[3], chunks[5]
    swapped = data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]
    assert len(swapped) == len(data)
    assert "checksum" in _refused(tmp_path / "swapped.mcap", swapped)


def test_joined_and_padded_files_are_rejected(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    for changed in (
        data + data,
        data[:500] + bytes(4096),
        data[:500] + data[600:],
    ):
        _refused(tmp_path / "odd.mcap", changed)


def test_other_files_are_rejected_with_their_kind(tmp_path: Path) -> None:
    assert "is empty" in _refused(tmp_path / "empty.mcap", b"")
    assert "not an MCAP file" in _refused(tmp_path / "text.mcap", b"time,angle\n0,1\n")
    with pytest.raises(InputError, match="there is no log"):
        read_log(tmp_path / "none.mcap")
    with pytest.raises(InputError, match="cannot read"):
        read_log(tmp_path)


@pytest.mark.parametrize("topic", ["/camera", "/joint_states"])
def test_a_foreign_mcap_file_is_rejected_with_its_missing_parts(tmp_path: Path, topic: str) -> None:
    stream = BytesIO()
    writer = Writer(stream, enable_data_crcs=True)
    writer.start(library="somebody else's")
    schema = writer.register_schema("x", "jsonschema", b"{}")
    channel = writer.register_channel(topic, "json", schema)
    writer.add_message(channel, log_time=0, data=b"{}", publish_time=0)
    writer.finish()
    sentence = _refused(tmp_path / "foreign.mcap", stream.getvalue())
    assert "dpcontrol.layout" in sentence
    assert "somebody else's" in sentence


def test_an_mcap_file_without_messages_is_rejected(tmp_path: Path) -> None:
    stream = BytesIO()
    writer = Writer(stream)
    writer.start()
    writer.finish()
    assert "lacks" in _refused(tmp_path / "bare.mcap", stream.getvalue())


def test_a_log_without_ticks_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "eventful.mcap"
    with open_writer(path, sample()) as log:
        log.event(0.0, "fatal", "loop", "could not start")
    with pytest.raises(InputError, match="no ticks"):
        read_log(path)
    with open_writer(path, sample()):
        pass
    with pytest.raises(InputError, match="no ticks"):
        read_log(path)
