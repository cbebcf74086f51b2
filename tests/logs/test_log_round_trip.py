"""What is written is read back, by our reader and by the public ROS 2 decoder."""

import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from log_samples import ATTACHMENTS, EXTRAS, METADATA, RATE, open_writer, sample, tick_all, write_sample
from mcap.reader import make_reader
from mcap_ros2.reader import read_ros2_messages

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import Event, LogWriter, compare_messages, read_log, recover

NANOSECOND = 1e-9


STATES = ("estimate", "reference", "truth")
EVENTS = (
    Event(0.0, "info", "loop", words="started"),
    Event(0.1, "warn", "drive", words="command cut at 5 m/s²"),
    Event(0.249, "error", "supervisor", words="ended"),
)


@pytest.mark.parametrize(
    ("arms", "has_cart", "parts"),
    [
        (2, True, (*STATES, "control", "extras")),
        (1, False, ()),
        (2, True, ("rates", "reference", "truth")),
        (3, False, ("estimate", "control")),
    ],
)
def test_a_log_gives_back_its_input_bit_for_bit(
    tmp_path: Path, arms: int, has_cart: bool, parts: tuple[str, ...]
) -> None:
    run = sample(arms=arms, has_cart=has_cart)
    rows = {"measured": run.measured} | {p: run.measured[::-1] if p == "rates" else getattr(run, p) for p in parts}
    with LogWriter(
        tmp_path / "run.mcap", arm_lengths=run.arm_lengths, rate_hz=RATE, has_cart=has_cart, limits=(0.9, 3.0, 30.0),
        extras=EXTRAS if "extras" in parts else (), metadata=METADATA, attachments=ATTACHMENTS,
    ) as writer:  # fmt: skip
        for event in EVENTS:
            writer.event(event)
        writer.ticks(run.time, **rows)
    log = read_log(tmp_path / "run.mcap")
    assert log.parts == set(parts) - {"extras"}
    read = {"measured": log.measured, "rates": log.rates, **log.states}
    read["control"] = np.column_stack([*log.controls.values()] or [[]])
    for part, values in rows.items():
        if part != "extras":
            np.testing.assert_array_equal(read[part], values)
    np.testing.assert_allclose(log.time, run.time, atol=NANOSECOND)
    if log.extras is not None:
        np.testing.assert_array_equal(np.hstack([log.extras.sigmas, log.extras.values]), run.extras[::20])
        np.testing.assert_allclose(log.extras.time, run.time[::20], atol=NANOSECOND)
    assert (log.extras is not None) == ("extras" in parts)
    assert (log.events, log.attachments) == (EVENTS, ATTACHMENTS)
    assert (log.arm_lengths, log.has_cart, log.limits) == (run.arm_lengths, has_cart, (0.9, 3.0, 30.0))
    assert METADATA.items() <= log.metadata.items()
    for part in {"estimate", "reference", "control"} - set(parts):
        with pytest.raises(InputError, match=f"has no /{part}"):
            getattr(log, part)


def test_a_state_that_is_no_number_is_logged_but_not_as_a_transform(tmp_path: Path) -> None:
    run = sample(60)
    run.truth[15:45] = np.nan
    with open_writer(tmp_path / "run.mcap", run) as log:
        tick_all(log, run)
    np.testing.assert_array_equal(read_log(tmp_path / "run.mcap").truth, run.truth)
    stamps = [message.log_time_ns for message in read_ros2_messages(str(tmp_path / "run.mcap"), topics=["/tf"])]
    assert stamps == [0]


def test_attachments_and_metadata_precede_the_first_message(tmp_path: Path) -> None:
    path = write_sample(tmp_path / "run.mcap", sample())
    with path.open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    first = min(index.chunk_start_offset for index in summary.chunk_indexes)
    before = [index.offset for index in summary.metadata_indexes if index.name != "dpcontrol.result"]
    assert max(*before, *(index.offset for index in summary.attachment_indexes)) < first
    assert summary.statistics.message_count == 5 * 250 + 2 * 13 + 3 + 2


RERUN = Path(sys.executable).parent / "rerun"


def test_a_summary_counts_every_message(tmp_path: Path) -> None:
    path = write_sample(tmp_path / "run.mcap", sample(250))
    summary = read_log(path)
    counts: dict[str, int] = {}
    for message in read_ros2_messages(str(path)):
        counts[message.channel.topic] = counts.get(message.channel.topic, 0) + 1
    assert {t.topic: t.count for t in summary.topics} == counts
    rates = {t.topic: t.rate_hz for t in summary.topics}
    assert rates["/joint_states"] == pytest.approx(RATE)
    assert rates["/tf"] == pytest.approx(50)


def test_a_frame_has_a_column_for_each_number_and_a_row_for_each_tick(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    run = sample(120)
    log = read_log(write_sample(tmp_path / "run.mcap", run))
    frame = log.frame()
    assert frame.index.name == "time"
    np.testing.assert_array_equal(frame.index, log.time)
    np.testing.assert_array_equal(frame["truth.rate_2"], run.truth[:, 3])
    np.testing.assert_array_equal(frame["measured.cart"], run.measured[:, 2])
    np.testing.assert_array_equal(frame["control.sigma_6"], run.control[:, -1])
    np.testing.assert_array_equal(frame["extra.drive"], np.repeat(run.extras[::20, 4], 20))
    np.testing.assert_array_equal(frame["sigma.M11"], np.repeat(run.extras[::20, 2], 20))
    assert frame.shape == (120, 3 + 3 * 6 + 13 + 6)


def test_equal_runs_compare_equal_and_one_changed_bit_is_named(tmp_path: Path) -> None:
    run, other = sample(250), sample(250)
    one = write_sample(tmp_path / "one.mcap", run)
    assert compare_messages(one, write_sample(tmp_path / "same.mcap", sample(250))).difference is None
    (bits,) = struct.unpack("<Q", struct.pack("<d", other.truth[123, 2]))
    (other.truth[123, 2],) = struct.unpack("<d", struct.pack("<Q", bits ^ 1))
    changed = compare_messages(one, write_sample(tmp_path / "other.mcap", other))
    assert changed.difference == "the message of /truth/joint_states at 0.123 s differs"
    longer, bare = (tmp_path / name for name in ("longer.mcap", "bare.mcap"))
    write_sample(longer, sample(260))
    write_sample(bare, sample(250, has_truth=False))
    for first, second in ((one, longer), (longer, one), (one, bare)):
        assert compare_messages(first, second).difference is not None


@pytest.mark.skipif(not RERUN.exists(), reason="the rerun command is not installed beside Python")
@pytest.mark.parametrize("kind", ["recording", "recovered"])
def test_rerun_finds_nothing_to_complain_about(tmp_path: Path, kind: str) -> None:
    path = write_sample(tmp_path / "run.mcap", sample(250))
    if kind == "recording":
        run = sample(60, has_cart=False)
        with LogWriter(path, arm_lengths=run.arm_lengths, rate_hz=RATE, has_cart=False) as log:
            log.ticks(run.time, measured=run.measured, rates=run.measured[::-1])
    if kind == "recovered":
        (tmp_path / "cut.mcap").write_bytes(path.read_bytes()[:80_000])
        path = recover(tmp_path / "cut.mcap").log
    rrd = tmp_path / "run.rrd"
    commands = (["mcap", "info", path], ["mcap", "check", path], ["mcap", "convert", path, "--output", rrd])
    for command in (*commands, ["rrd", "verify", rrd]):
        done = subprocess.run([RERUN, *command], capture_output=True, text=True, check=False)
        said = done.stdout + done.stderr
        assert done.returncode == 0, said
        if command[1] in ("info", "check"):
            assert not any(word in said.lower() for word in ("warn", "error", "invalid", "corrupt")), said
