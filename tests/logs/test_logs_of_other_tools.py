"""Logs that other tools wrote again are read by their topics."""

import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import dpcontrol
from log_samples import sample, write_sample
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from dpcontrol.foundation.errors import InputError, Remark
from dpcontrol.judge.of_log import run_view
from dpcontrol.judge.score import score
from dpcontrol.logs import read_log
from dpcontrol.plans.plan import Plan
from dpcontrol.recordings.bags import read_bag
from dpcontrol.runs.run import run_plan

TICKED = ("/joint_states", "/estimate/joint_states", "/reference/joint_states", "/truth/joint_states", "/control")


def rewritten(source, *, keeps=None, backwards=False, thinned=1, shifted=0, library="another program", **how) -> Path:
    """Write a log again by Python's mcap package, with all of its checksums unless `how` says otherwise.

    Args:
        keeps: whether a message of a topic and time, s, is kept; None: all are.
        backwards: register the channels in reverse order.
        thinned: keep each n-th message of the state topics.
        shifted: seconds between the clocks of run and recorder.
    """
    seen: Counter[str] = Counter()
    out = source.with_name("other.mcap")
    with source.open("rb") as stream, out.open("wb") as target:
        reader, writer = make_reader(stream), Writer(target, **{"enable_data_crcs": True, **how})
        writer.start(profile="ros2", library=library)
        summary = reader.get_summary()
        schemas = {k: writer.register_schema(s.name, s.encoding, s.data) for k, s in summary.schemas.items()}
        numbers = {
            c.id: writer.register_channel(c.topic, "cdr", schemas[c.schema_id], c.metadata)
            for c in sorted(summary.channels.values(), key=lambda channel: channel.id, reverse=backwards)
        }
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        for record in reader.iter_attachments():
            writer.add_attachment(0, 0, record.name, record.media_type, record.data)
        for _, channel, m in reader.iter_messages(log_time_order=False):
            seen[channel.topic] += 1
            if channel.topic in TICKED and (seen[channel.topic] - 1) % thinned:
                continue
            if keeps is None or keeps(channel.topic, m.log_time / 1e9):
                time = m.log_time + shifted * 10**9
                writer.add_message(numbers[channel.id], time, m.data, time, m.sequence)
        writer.finish()
    return out


@pytest.fixture(scope="module")
def completed_run(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run") / "run.mcap"
    run_plan(plan, out)
    return out


def unchecked() -> Any:
    return pytest.warns(Remark, match="integrity cannot be checked")


WAYS: tuple[dict[str, Any], ...] = (
    {"enable_data_crcs": False, "enable_crcs": False, "library": "dpcontrol 0.2.0"},
    {"backwards": True, "use_chunking": False},
    {"compression": CompressionType.LZ4, "shifted": 1_700_000_000},
    {"compression": CompressionType.NONE, "chunk_size": 10_000, "use_statistics": False},
    {"index_types": IndexType.NONE, "repeat_channels": False, "repeat_schemas": False, "thinned": 5},
)


@pytest.mark.parametrize("how", WAYS)
def test_a_log_that_was_written_again_otherwise_holds_the_same_run(tmp_path: Path, how: dict[str, Any]) -> None:
    first = read_log(write_sample(tmp_path / "run.mcap", sample()))
    with unchecked():
        log = read_log(rewritten(tmp_path / "run.mcap", **how))
    each = how.get("thinned", 1)
    rows, others = (np.column_stack([*one.states.values(), *one.controls.values()]) for one in (log, first))
    assert np.array_equal(rows, others[::each], equal_nan=True)
    assert np.array_equal(log.measured, first.measured[::each])
    assert log.rate_hz == pytest.approx(first.rate_hz / each)
    assert (log.parts, log.events, log.attachments) == (first.parts, first.events, first.attachments)
    assert (log.arm_lengths, log.metadata, log.limits) == (first.arm_lengths, first.metadata, first.limits)
    assert np.array_equal(log.extras.values, first.extras.values)


@pytest.mark.parametrize(
    "keeps", [lambda topic, time: 1.0 <= time <= 2.0 and topic != "/rosout", lambda topic, time: not 2.0 < time < 3.0]
)
def test_the_completion_of_a_run_is_unknown_from_a_part_of_its_log(completed_run: Path, keeps: Any) -> None:
    part = rewritten(completed_run, keeps=keeps)
    with unchecked():
        log = read_log(part)
    assert score(log).completed is None
    assert score(replace(log, time=log.time + 1.7e9)).completed is None
    assert run_view(log).good is None
    ended = dpcontrol("score", part, completed_run)
    assert ended.code == 1
    assert "1 of 2 not known to be completed" in ended.message


def test_a_log_that_rosbags_converts_is_a_recording(tmp_path: Path) -> None:
    """The converter drops metadata and attachments, so what is left is measured positions."""
    pytest.importorskip("rosbags")
    first = read_log(write_sample(tmp_path / "run.mcap", sample()))
    convert = [sys.executable, "-m", "rosbags.convert", "--src", "run.mcap", "--dst", "converted"]
    options = ["--dst-storage", "mcap", "--compress", "zstd", "--compress-mode", "storage"]
    subprocess.run([*convert, *options], check=True, capture_output=True, cwd=tmp_path)
    log = tmp_path / "converted" / "converted.mcap"
    with pytest.raises(InputError, match="make a recording of it with `dpcontrol import`"):
        read_log(log)
    columns = [f"/joint_states/arm_{arm}/position" for arm in (1, 2)]
    found = read_bag(log, columns)
    assert np.array_equal(np.column_stack([found[name] for name in columns]), first.measured[:, :2])
