"""Damage is reported or repaired, and recovered data equal the written data to the last bit."""

from pathlib import Path

import numpy as np
import pytest
from log_corruption import records
from log_endurance import endure, is_part_of
from log_samples import ATTACHMENTS, METADATA, RATE, open_writer, sample, tick_all, write_sample
from mcap.opcode import Opcode

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import LogWriter, RunLog, compare_messages, read_log, recover

COUNT = 156
SEED = 8
TICKS = 250
CHUNK = 20
"""Ticks in a chunk at 1 kHz: what a damaged byte may cost."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> RunLog:
    return read_log(write_sample(tmp_path_factory.mktemp("logs") / "run.mcap", sample(TICKS)))


@pytest.mark.slow
def test_damage_is_always_detected_and_recovered_data_were_written(whole: RunLog, tmp_path: Path) -> None:
    ends = endure(whole, tmp_path, count=COUNT, seed=SEED)
    for kind in ("swap", "repeat", "index", "tail", "joined"):
        assert set(ends[kind]) <= {"wholly", "harmless"}, kind
    for kind in ("flip", "zeros", "missing", "foreign"):
        assert ends[kind].count("refused") <= len(ends[kind]) // 3, kind


def test_a_flipped_bit_costs_one_chunk_at_most(whole: RunLog, tmp_path: Path) -> None:
    data = whole.path.read_bytes()
    chunks = [(a, b) for opcode, a, b in records(data) if opcode == Opcode.CHUNK]
    for number, (start, end) in list(enumerate(chunks))[1:-1:3]:
        changed = bytearray(data)
        changed[(start + end) // 2] ^= 4
        (tmp_path / "bad.mcap").write_bytes(changed)
        done = recover(tmp_path / "bad.mcap", tmp_path / "out.mcap")
        assert (done.ticks_lost, done.chunks_dropped) == (CHUNK, 1)
        (gap,) = done.gaps
        assert gap == pytest.approx(((number * CHUNK - 1) / RATE, (number + 1) * CHUNK / RATE))
        assert f"{CHUNK} ticks ({CHUNK} ms)" in done.lost


def test_a_cut_log_keeps_all_that_came_before_the_cut(whole: RunLog, tmp_path: Path) -> None:
    data = whole.path.read_bytes()
    chunks = [b for opcode, _, b in records(data) if opcode == Opcode.CHUNK]
    for count in (1, 5, len(chunks) - 1):
        (tmp_path / "cut.mcap").write_bytes(data[: chunks[count - 1] + 11])
        done = recover(tmp_path / "cut.mcap", tmp_path / "out.mcap")
        assert done.ticks == count * CHUNK
        assert not done.end_known
        assert f"everything after {(count * CHUNK - 1) / RATE:.3f} s" in done.lost
        assert read_log(tmp_path / "out.mcap").attachments == ATTACHMENTS
        assert METADATA.items() <= read_log(tmp_path / "out.mcap").metadata.items()


def test_a_byte_after_the_end_is_called_so_and_nothing_is_lost(whole: RunLog, tmp_path: Path) -> None:
    for extra, what in ((b"\0", "1 byte that does not belong"), (bytes(4096), "4096 bytes that do not belong")):
        (tmp_path / "tail.mcap").write_bytes(whole.path.read_bytes() + extra)
        with pytest.raises(InputError, match=what):
            read_log(tmp_path / "tail.mcap")
        assert recover(tmp_path / "tail.mcap", tmp_path / "out.mcap").lost == ""
        same = compare_messages(whole.path, tmp_path / "out.mcap")
        assert (same.messages, same.difference) == (5 * TICKS + 2 * 13 + 3 + 2, None)


def test_a_whole_log_is_left_alone(whole: RunLog) -> None:
    beside = sorted(whole.path.parent.iterdir())
    done = recover(whole.path)
    assert done.log == done.source == whole.path
    assert done.lost == ""
    assert sorted(whole.path.parent.iterdir()) == beside


def test_a_recovered_log_can_be_recovered_again_and_keeps_its_losses(whole: RunLog, tmp_path: Path) -> None:
    data = bytearray(whole.path.read_bytes())
    chunks = [(a, b) for opcode, a, b in records(data) if opcode == Opcode.CHUNK]
    data[chunks[2][1] - 5] ^= 1
    (tmp_path / "bad.mcap").write_bytes(data)
    first = recover(tmp_path / "bad.mcap")
    again = first.log.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(again[: int(0.8 * len(again))])
    second = recover(tmp_path / "cut.mcap")
    assert first.lost in second.lost
    assert "everything after" in second.lost
    is_part_of(read_log(second.log), whole)


def test_two_logs_in_one_file_are_not_joined(whole: RunLog, tmp_path: Path) -> None:
    other = write_sample(tmp_path / "other.mcap", sample(TICKS, seed=4)).read_bytes()
    (tmp_path / "both.mcap").write_bytes(whole.path.read_bytes() + other)
    with pytest.raises(InputError, match="several logs"):
        recover(tmp_path / "both.mcap", tmp_path / "out.mcap")


def test_names_by_default_are_free_ones_and_the_old_file_stays(whole: RunLog, tmp_path: Path) -> None:
    cut = whole.path.read_bytes()[:40_000]
    left = tmp_path / "run.mcap.partial"
    left.write_bytes(cut)
    (tmp_path / "run.mcap.123-1.partial").write_bytes(cut)
    names = [recover(left).log.name, recover(left).log.name, recover(tmp_path / "run.mcap.123-1.partial").log.name]
    assert names == ["run.mcap", "run-recovered.mcap", "run-recovered-2.mcap"]
    assert left.read_bytes() == cut


def test_the_message_on_a_missing_log_names_the_remains_of_a_run(whole: RunLog, tmp_path: Path) -> None:
    (tmp_path / "run.mcap.partial").write_bytes(whole.path.read_bytes()[:40_000])
    with pytest.raises(InputError, match=r"dpcontrol recover .*run\.mcap\.partial"):
        read_log(tmp_path / "run.mcap")


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "is empty"),
        (b"time,angle\n0,1\n" * 100, "before its first tick"),
        (bytes(10_000), "before its first tick"),
        (np.random.default_rng(1).bytes(100_000), "before its first tick"),
    ],
)
def test_an_empty_file_is_rejected(tmp_path: Path, content: bytes, reason: str) -> None:
    (tmp_path / "odd.mcap").write_bytes(content)
    with pytest.raises(InputError, match=reason):
        recover(tmp_path / "odd.mcap")
    assert [file.name for file in tmp_path.iterdir()] == ["odd.mcap"]


def test_a_run_truncated_before_its_first_chunk_is_reported(tmp_path: Path) -> None:
    run = sample(5)
    log = open_writer(tmp_path / "run.mcap", run).__enter__()
    tick_all(log, run)
    with pytest.raises(InputError, match="before its first tick"):
        recover(log.partial)
    log.__exit__(None, None, None)
    assert len(read_log(tmp_path / "run.mcap").time) == 5


def test_recordings_of_any_shape_are_recovered_too(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    with LogWriter(tmp_path / "bench.mcap", arm_lengths=(0.2,), rate_hz=500.0, has_cart=False) as log:
        log.ticks(np.arange(100) / 500, measured=rng.random((100, 1)), rates=rng.random((100, 1)))
    before = read_log(tmp_path / "bench.mcap")
    (tmp_path / "cut.mcap").write_bytes((tmp_path / "bench.mcap").read_bytes()[:-2000])
    done = recover(tmp_path / "cut.mcap")
    after = read_log(done.log)
    assert after.parts == {"rates"}
    assert done.ticks >= 70
    np.testing.assert_array_equal(after.measured, before.measured[: done.ticks])
