"""Logs of every shape: what is in them, as a table, side by side, and by the tools of others."""

import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from log_samples import METADATA, RATE, open_writer, sample, tick_all, write_sample
from mcap_ros2.reader import read_ros2_messages

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import LogWriter, RunLog, compare_messages, joint_names, read_log, summarise

TICKS = 60
PARTS = [(), ("rates",), ("estimate",), ("estimate", "control"), ("rates", "reference", "truth"), ("control",)]
SHAPES = [(arms, has_cart, parts) for arms in (1, 2, 3) for has_cart in (True, False) for parts in PARTS]
RERUN = Path(sys.executable).parent / "rerun"

has_rerun = pytest.mark.skipif(not RERUN.exists(), reason="the rerun command is not installed beside Python")


def write_parts(path: Path, *, arms: int, has_cart: bool, parts: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Write a log of random numbers with these parts; return them."""
    run = sample(TICKS, arms=arms, has_cart=has_cart)
    rates = np.random.default_rng(1).standard_normal(run.measured.shape)
    rows = {"measured": run.measured} | {p: rates if p == "rates" else getattr(run, p) for p in parts}
    with LogWriter(path, arm_lengths=run.arm_lengths, rate_hz=RATE, has_cart=has_cart) as log:
        half = TICKS // 2
        for k in range(half):
            log.ticks(run.time[k : k + 1], **{part: values[k : k + 1] for part, values in rows.items()})
        log.ticks(run.time[half:], **{part: values[half:] for part, values in rows.items()})
    return rows


@pytest.mark.parametrize(("arms", "has_cart", "parts"), SHAPES)
def test_a_log_holds_exactly_its_input(tmp_path: Path, arms: int, has_cart: bool, parts: tuple[str, ...]) -> None:
    rows = write_parts(tmp_path / "run.mcap", arms=arms, has_cart=has_cart, parts=parts)
    log = read_log(tmp_path / "run.mcap")
    assert log.parts == set(parts)
    np.testing.assert_array_equal(log.measured, rows["measured"])
    for part, values in rows.items():
        if part in ("estimate", "reference", "truth"):
            np.testing.assert_array_equal(log.states[part], values)
    if "rates" in parts:
        np.testing.assert_array_equal(log.rates, rows["rates"])
    if "control" in parts:
        np.testing.assert_array_equal(np.column_stack(list(log.control.values())), rows["control"])

    seen: dict[str, list] = {}
    for message in read_ros2_messages(str(tmp_path / "run.mcap")):
        seen.setdefault(message.channel.topic, []).append(message.ros_msg)
    topics = {part: f"/{part}/joint_states" for part in ("estimate", "reference", "truth")} | {"control": "/control"}
    assert {topic for part, topic in topics.items() if part in parts} == set(seen) & set(topics.values())
    joints = seen["/joint_states"]
    assert list(joints[0].name) == list(joint_names(arms, has_cart=has_cart))
    np.testing.assert_array_equal([m.position for m in joints], rows["measured"])
    assert [len(m.velocity) for m in joints] == [len(joints[0].name) if "rates" in parts else 0] * TICKS
    frames = {item.child_frame_id for item in seen["/tf"][0].transforms}
    assert len(seen["/tf"]) == TICKS / RATE * 50
    assert any(name.startswith("reference/") for name in frames) == ("reference" in parts)
    assert ("/reference/robot_description" in seen) == ("reference" in parts)


def test_missing_parts_of_a_recording_are_named_and_not_guessed(tmp_path: Path) -> None:
    write_parts(tmp_path / "bench.mcap", arms=2, has_cart=False, parts=())
    log = read_log(tmp_path / "bench.mcap")
    assert log.truth is None
    for part, topic in (("estimate", "/estimate"), ("reference", "/reference"), ("control", "/control")):
        with pytest.raises(InputError, match=f"has no {topic}"):
            getattr(log, part)


def test_a_part_that_appears_only_sometimes_is_rejected(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "run.mcap", arm_lengths=(0.2,), rate_hz=RATE, has_cart=False) as log:
        log.ticks([0.0], measured=np.zeros((1, 1)))
        with pytest.raises(ValueError, match="rates must be given in every tick"):
            log.ticks([0.001], measured=np.zeros((1, 1)), rates=np.zeros((1, 1)))
        with pytest.raises(ValueError, match="control must be given in every tick"):
            log.ticks([0.001], measured=np.zeros((1, 1)), control=np.zeros((1, 9)))


def test_metadata_cannot_replace_the_checksum(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="crc32"):
        LogWriter(tmp_path / "run.mcap", arm_lengths=(0.2,), rate_hz=RATE, metadata={"crc32": "0"})


def test_a_summary_counts_every_message(tmp_path: Path) -> None:
    path = write_sample(tmp_path / "run.mcap", sample(250))
    summary = summarise(path)
    counts: dict[str, int] = {}
    for message in read_ros2_messages(str(path)):
        counts[message.channel.topic] = counts.get(message.channel.topic, 0) + 1
    assert {t.topic: t.count for t in summary.topics} == counts
    rates = {t.topic: t.rate_hz for t in summary.topics}
    assert rates["/joint_states"] == pytest.approx(RATE)
    assert rates["/tf"] == pytest.approx(50)
    assert summary.duration == pytest.approx(0.249)
    assert summary.size == path.stat().st_size
    assert METADATA.items() <= summary.metadata.items()
    assert summary.attachments == {"scene.toml": 12, "reference.npz": 256}
    assert summary.partials == ()


def test_a_summary_of_a_log_without_ticks_has_no_rates(tmp_path: Path) -> None:
    with open_writer(tmp_path / "run.mcap", sample()) as log:
        log.event(0.0, "fatal", "loop", "could not start")
    counts = {t.topic: t.count for t in summarise(tmp_path / "run.mcap").topics}
    assert (counts["/rosout"], counts["/joint_states"]) == (1, 0)


def test_a_frame_has_a_column_for_each_number_and_a_row_for_each_tick(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    run = sample(40)
    log = read_log(write_sample(tmp_path / "run.mcap", run) if len(run.time) > 100 else _small(tmp_path, run))
    frame = log.frame()
    assert frame.index.name == "time"
    np.testing.assert_array_equal(frame.index, log.time)
    assert run.truth is not None
    np.testing.assert_array_equal(frame["truth.rate_2"], run.truth[:, 3])
    np.testing.assert_array_equal(frame["measured.cart"], run.measured[:, 2])
    np.testing.assert_array_equal(frame["control.sigma_6"], run.control[:, -1])
    np.testing.assert_array_equal(frame["extra.drive"], np.repeat(run.extras[::20, 4], 20))
    np.testing.assert_array_equal(frame["sigma.M11"], np.repeat(run.extras[::20, 2], 20))
    assert frame.shape == (40, 3 + 3 * 6 + 13 + 6)


def test_without_pandas_a_frame_is_rejected_with_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = read_log(_small(tmp_path, sample(5)))
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match="pip install pandas"):
        log.frame()


def _small(folder: Path, run) -> Path:
    with open_writer(folder / "run.mcap", run) as log:
        tick_all(log, run)
    return folder / "run.mcap"


def test_equal_runs_compare_equal_and_one_changed_bit_is_named(tmp_path: Path) -> None:
    run, other = sample(250), sample(250)
    one = write_sample(tmp_path / "one.mcap", run)
    assert compare_messages(one, write_sample(tmp_path / "same.mcap", sample(250))).difference is None
    assert other.truth is not None
    (bits,) = struct.unpack("<Q", struct.pack("<d", other.truth[123, 2]))
    (other.truth[123, 2],) = struct.unpack("<d", struct.pack("<Q", bits ^ 1))
    changed = compare_messages(one, write_sample(tmp_path / "other.mcap", other))
    assert changed.difference == "message 123 of /truth/joint_states at 0.123 s differs"


def test_logs_of_other_lengths_or_topics_compare_as_different(tmp_path: Path) -> None:
    one = write_sample(tmp_path / "one.mcap", sample(250))
    longer = write_sample(tmp_path / "longer.mcap", sample(260))
    assert compare_messages(one, longer).difference is not None
    assert compare_messages(longer, one).difference is not None
    bare = write_sample(tmp_path / "bare.mcap", sample(250, has_truth=False))
    assert "topics" in str(compare_messages(one, bare).difference)


@has_rerun
@pytest.mark.parametrize("kind", ["run", "recording", "recovered"])
def test_rerun_finds_nothing_to_complain_about(tmp_path: Path, kind: str) -> None:
    path = write_sample(tmp_path / "run.mcap", sample(250))
    if kind == "recording":
        write_parts(path, arms=2, has_cart=False, parts=("rates",))
    if kind == "recovered":
        from dpcontrol.logs import recover

        (tmp_path / "cut.mcap").write_bytes(path.read_bytes()[:80_000])
        path = recover(tmp_path / "cut.mcap").log
    for verb in ("info", "check"):
        done = subprocess.run([RERUN, "mcap", verb, path], capture_output=True, text=True, check=False)
        said = done.stdout + done.stderr
        assert done.returncode == 0, said
        assert "/joint_states" in said or verb == "check"
        assert not any(word in said.lower() for word in ("warn", "error", "invalid", "corrupt")), said
    convert = subprocess.run(
        [RERUN, "mcap", "convert", path, "--output", tmp_path / "run.rrd"], capture_output=True, text=True, check=False
    )
    assert convert.returncode == 0, convert.stderr
    verify = subprocess.run([RERUN, "rrd", "verify", tmp_path / "run.rrd"], capture_output=True, text=True, check=False)
    assert verify.returncode == 0, verify.stderr
    assert isinstance(read_log(path), RunLog)
