"""What is written is read back by our reader, as a table, and by third-party readers: rosbags and mcap-ros2-support."""

import math
import struct
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from log_samples import ATTACHMENTS, EXTRAS, METADATA, RATE, open_writer, sample, tick_all, write_sample
from mcap.reader import make_reader
from mcap_ros2.reader import read_ros2_messages
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import Event, LogWriter, compare_messages, control_fields, joint_names, read_log, recover
from dpcontrol.logs.writer import robot_description

NANOSECOND = 1e-9
LIMITS = (0.9, 3.0, 30.0)


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
        tmp_path / "run.mcap", arm_lengths=run.arm_lengths, rate_hz=RATE, has_cart=has_cart, limits=LIMITS,
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
    assert (log.arm_lengths, log.has_cart, log.limits) == (run.arm_lengths, has_cart, LIMITS)
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


TICKS = 120
SAME = 1e-9
"""Rad: a rotation vector from a quaternion and back."""
WRITTEN = 1e-6
"""m: lengths stand in the URDF to six digits."""
SEVERITIES = {"debug": 10, "info": 20, "warn": 30, "error": 40, "fatal": 50}
"""rcl_interfaces/msg/Log."""
Messages = dict[str, list[tuple[int, Any]]]


@pytest.fixture(scope="module", params=[(2, True), (3, False)], ids=["two arms on a cart", "three arms"])
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Messages]:
    """A log with messages of every type and events of every severity, and what is in it: time in ns and message."""
    arms, has_cart = request.param
    run = sample(TICKS, arms=arms, has_cart=has_cart)
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    with open_writer(path, run) as log:
        tick_all(log, run)
        for k, level in enumerate(SEVERITIES):
            log.event(Event(0.02 * k, level, f"part {k}", words=f"{level}: 5 m/s², ünd mehr"))
    return path, expected(run, arms=arms, has_cart=has_cart)


def stamp(time: int) -> dict[str, int]:
    return {"sec": time // 10**9, "nanosec": time % 10**9}


def expected(run: Any, *, arms: int, has_cart: bool) -> Messages:
    """Return the intended messages by the numbers of the run and the definitions of ROS 2, not by our reader."""
    names, size = list(joint_names(arms, has_cart=has_cart)), 2 * arms
    positions = [*range(arms), size][: len(names)]
    velocities = [*range(arms, size), size + 1][: len(names)]
    times = [k * 10**6 for k in range(TICKS)]
    none, known = [[]] * TICKS, {"name": names, "effort": []}
    rows = {"/joint_states": (run.measured.tolist(), none)} | {
        f"/{part}/joint_states": (state[:, positions].tolist(), state[:, velocities].tolist())
        for part, state in (("estimate", run.estimate), ("reference", run.reference), ("truth", run.truth))
    }
    found: Messages = {
        topic: [
            (t, {**known, "header": {"stamp": stamp(t), "frame_id": ""}, "position": p, "velocity": v})
            for t, p, v in zip(times, *values, strict=True)
        ]
        for topic, values in rows.items()
    }  # fmt: skip
    columns = control_fields(arms, has_cart=has_cart)
    actions = [dict(zip(columns, row, strict=True)) for row in run.control.tolist()]
    found["/control"] = list(zip(times, actions, strict=True))
    columns = [f"{of}{name.lower()}" for of in ("sigma_", "") for name in EXTRAS]
    extras = [dict(zip(columns, row, strict=True)) for row in run.extras[::20].tolist()]
    found["/estimate/extras"] = list(zip(times[::20], extras, strict=True))
    found["/rosout"] = [
        (
            20 * 10**6 * k,
            {
                "stamp": stamp(20 * 10**6 * k), "level": number, "name": f"part {k}",
                "msg": f"{level}: 5 m/s², ünd mehr", "file": "", "function": "", "line": 0,
            },
        )
        for k, (level, number) in enumerate(SEVERITIES.items())
    ]  # fmt: skip
    for topic, ghost in (("/robot_description", False), ("/reference/robot_description", True)):
        text = robot_description(run.arm_lengths, has_cart=has_cart, limits=LIMITS, ghost=ghost)
        found[topic] = [(0, {"data": text})]
    return found


def plain(message: Any) -> Any:
    if isinstance(message, np.ndarray):
        return message.tolist()
    if isinstance(message, list | tuple):
        return [plain(item) for item in message]
    if is_dataclass(message):
        # rosbags counts a definition's constants, in capitals, and its name as fields too.
        names = [field.name for field in fields(message) if field.name.islower() and field.name[0] != "_"]
        return {name: plain(getattr(message, name)) for name in names}
    names = getattr(message, "__slots__", None)
    return {name: plain(getattr(message, name)) for name in names} if names else message


def same(found: Any, due: Any) -> bool:
    """Return True if two messages are equal to the last bit, with NaN equal to NaN."""
    if isinstance(due, Mapping):
        return found.keys() == due.keys() and all(same(found[name], value) for name, value in due.items())
    if isinstance(due, list):
        return len(found) == len(due) and all(map(same, found, due))
    return found == due or (isinstance(due, float) and math.isnan(due) and math.isnan(float(found)))


def check(found: Messages, due: Messages) -> None:
    # Transforms are compared with the URDF below.
    assert found.keys() == due.keys() | {"/tf"}
    assert [time for time, _ in found["/tf"]] == [time for time, _ in due["/joint_states"]][::20]
    for topic, messages in due.items():
        assert [time for time, _ in found[topic]] == [time for time, _ in messages], topic
        for (_, one), (_, other) in zip(found[topic], messages, strict=True):
            assert same(one, other), (topic, one, other)


def decoded(path: Path) -> Messages:
    """Return a log's messages by topic, as the public decoder gives them."""
    found: Messages = {}
    for message in read_ros2_messages(str(path)):
        found.setdefault(message.channel.topic, []).append((message.log_time_ns, message.ros_msg))
    return found


def by_rosbags(path: Path) -> Messages:
    found: Messages = {}
    with AnyReader([path]) as reader:
        for connection, time, data in reader.messages():
            found.setdefault(connection.topic, []).append((time, reader.deserialize(data, connection.msgtype)))
    return found


@pytest.mark.parametrize("read", [decoded, by_rosbags])
def test_public_readers_give_every_message_as_written(read: Any, written: tuple[Path, Messages]) -> None:
    found = read(written[0])
    check({topic: [(time, plain(one)) for time, one in messages] for topic, messages in found.items()}, written[1])


@pytest.mark.parametrize("ghost", [False, True])
def test_joint_states_and_transforms_agree_on_the_urdf(written: tuple[Path, Messages], ghost: bool) -> None:
    """As Foxglove's 3D panel and robot_state_publisher place links."""
    prefix, messages = "reference/" if ghost else "", decoded(written[0])
    # The links are those of the plant, if it is known.
    states = messages["/reference/joint_states" if ghost else "/truth/joint_states"]
    (_, text), *_ = messages[f"{'/reference' if ghost else ''}/robot_description"]
    robot = ElementTree.fromstring(text.data)
    moving = {joint.get("name", "") for joint in robot.findall("joint") if joint.find("mimic") is None}
    (_, first), *_ = states
    assert moving == {prefix + name for name in first.name}
    by_time = {time: dict(zip(joints.name, joints.position, strict=True)) for time, joints in states}
    compared = 0
    for time, transforms in messages["/tf"]:
        found = {item.child_frame_id: item for item in transforms.transforms}
        for joint in robot.findall("joint"):
            turn, move = placed(joint, {prefix + name: value for name, value in by_time[time].items()})
            pose = found[joint.find("child").get("link")].transform
            assert found[joint.find("child").get("link")].header.frame_id == joint.find("parent").get("link")
            at, q = pose.translation, pose.rotation
            assert np.allclose([at.x, at.y, at.z], move, atol=WRITTEN)
            assert (turn.inv() * Rotation.from_quat([q.x, q.y, q.z, q.w])).magnitude() < SAME
            compared += 1
    assert compared == len(messages["/tf"]) * len(robot.findall("joint")) > 0
    assert {len(transforms.transforms) for _, transforms in messages["/tf"]} == {2 * len(robot.findall("link"))}


def placed(joint: ElementTree.Element, positions: dict[str, float]) -> tuple[Rotation, np.ndarray]:
    """Return a child link's turn and place in its parent, by the specification of URDF.

    Coordinates of continuous joints are in rad about the axis, those of prismatic joints in m along it, and a mimic
    joint has multiplier · coordinate + offset.
    """
    origin, mimic = joint.find("origin"), joint.find("mimic")
    place = np.zeros(3) if origin is None else np.array(origin.get("xyz", "0 0 0").split(), dtype=float)
    axis = np.array(joint.find("axis").get("xyz").split(), dtype=float)
    value = (
        positions[joint.get("name", "")]
        if mimic is None
        else float(mimic.get("multiplier", "1")) * positions[mimic.get("joint", "")] + float(mimic.get("offset", "0"))
    )
    if joint.get("type") == "prismatic":
        return Rotation.identity(), place + value * axis
    assert joint.get("type") == "continuous"
    return Rotation.from_rotvec(value * axis), place
