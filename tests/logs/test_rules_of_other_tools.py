"""Logs follow the published rules of the tools that read them: PlotJuggler's series, and URDF by Foxglove and rviz.

sensor_msgs/JointState has rad or m and rad/s or m/s. Each array is as long as the names or empty, and names are unique.

PlotJuggler (plotjuggler_ros, ros2_parsers/jointstates_msg.h) has a series TOPIC/JOINT/position if there are as many
positions as names, and the same for velocity. Values are unchanged, under the header's stamp or the log's time.

In URDF, coordinates of continuous joints are in rad about the axis, and those of prismatic joints in m along it. A
mimic joint has multiplier · coordinate + offset. Foxglove's 3D panel and robot_state_publisher place links in this way.
"""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from log_samples import EXTRAS, sample, write_sample
from mcap.reader import make_reader
from mcap_ros2.reader import read_ros2_messages
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from dpcontrol.logs import control_fields, joint_names, read_log
from dpcontrol.logs.writer import link_frames, link_poses, robot_description

TICKS = 120
SAME = 1e-12
"""Rad, m: a rotation vector from a quaternion and back."""
WRITTEN = 1e-6
"""m: lengths stand in the URDF to six digits."""
LEVELS = {"info": 20, "warn": 30, "error": 40}
"""rcl_interfaces/msg/Log."""
TOPICS = ("/joint_states", "/estimate/joint_states", "/reference/joint_states", "/truth/joint_states")

Messages = dict[str, list]


@pytest.fixture(scope="module", params=[(2, True), (3, False)])
def messages(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Messages:
    """A log's messages by topic, as the public decoder gives them."""
    arms, has_cart = request.param
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    write_sample(path, sample(TICKS, arms=arms, has_cart=has_cart))
    found: Messages = {}
    for message in read_ros2_messages(str(path)):
        found.setdefault(message.channel.topic, []).append((message.log_time_ns, message.ros_msg))
    return found


def test_joint_states_obey_the_messages_own_rules(messages: Messages) -> None:
    for topic in TOPICS:
        for time, joints in messages[topic]:
            assert len(set(joints.name)) == len(joints.name) == len(joints.position)
            assert len(joints.velocity) in (0, len(joints.name))
            assert len(joints.effort) == 0
            assert joints.header.stamp.sec * 10**9 + joints.header.stamp.nanosec == time


def test_descriptions_offer_a_complete_quality_of_service(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_sample(path, sample(TICKS))
    with path.open("rb") as stream:
        channels = make_reader(stream).get_summary().channels.values()
    profiles = [channel.metadata["offered_qos_profiles"] for channel in channels if "description" in channel.topic]
    assert len(profiles) == 2
    policies = [line[2:].partition(":")[0] for line in profiles[0].splitlines() if not line.startswith("    ")]
    # rosbags 0.11 reads each of these, and refuses the log where one is missing.
    assert policies == [
        "history", "depth", "reliability", "durability", "deadline", "lifespan", "liveliness",
        "liveliness_lease_duration", "avoid_ros_namespace_conventions",
    ]  # fmt: skip


def test_rosbags_reads_a_log_whole_and_sees_every_message_as_written(tmp_path: Path) -> None:
    run = sample(TICKS)
    path = write_sample(tmp_path / "run.mcap", run)
    found: Messages = {}
    with AnyReader([path]) as reader:
        for connection, time, data in reader.messages():
            found.setdefault(connection.topic, []).append((time, reader.deserialize(data, connection.msgtype)))
    log, names = read_log(path), list(joint_names(2, has_cart=True))
    positions, velocities = [0, 1, 4], [2, 3, 5]
    for topic, state in zip(TOPICS, (None, log.estimate, log.reference, log.truth), strict=True):
        joints = [message for _, message in found.pop(topic)]
        assert [message.name for message in joints] == [names] * TICKS
        assert [message.header.stamp.nanosec for message in joints] == [k * 10**6 for k in range(TICKS)]
        expected = log.measured if state is None else state[:, positions]
        assert np.array_equal([message.position for message in joints], expected)
        if state is not None:
            assert np.array_equal([message.velocity for message in joints], state[:, velocities])
    for time, message in (control := found.pop("/control")):
        row = [getattr(message, name) for name in control_fields(2, has_cart=True)]
        assert np.array_equal(row, run.control[time // 10**6], equal_nan=True)
    assert [time for time, _ in control] == [k * 10**6 for k in range(TICKS)]
    for time, message in (slow := found.pop("/estimate/extras")):
        row = [getattr(message, f"{of}{name.lower()}") for of in ("sigma_", "") for name in EXTRAS]
        assert np.array_equal(row, run.extras[time // 10**6])
    assert len(slow) == TICKS / 20
    events = [(time / 1e9, message.level, message.name, message.msg) for time, message in found.pop("/rosout")]
    assert events == [(e.time, LEVELS[e.level], e.name, e.text) for e in log.events]
    links = (*link_frames(2, has_cart=True), *link_frames(2, has_cart=True, prefix="reference/"))
    for time, message in (moved := found.pop("/tf")):
        assert [(t.header.frame_id, t.child_frame_id) for t in message.transforms] == list(links)
        shown = [(t.transform.translation, t.transform.rotation) for t in message.transforms]
        rows = np.stack([states[time // 10**6] for states in (log.truth, log.reference)])
        placed_at = link_poses(rows, arm_lengths=run.arm_lengths, has_cart=True).reshape(-1, 7)
        assert np.array_equal([[at.x, at.y, at.z, q.x, q.y, q.z, q.w] for at, q in shown], placed_at)
    assert len(moved) == TICKS / 20
    limits = (0.9, 3.0, 30.0)
    ghost = robot_description(run.arm_lengths, limits=limits, prefix="reference/", ghost=True)
    assert [message.data for _, message in found.pop("/reference/robot_description")] == [ghost]
    robot = robot_description(run.arm_lengths, limits=limits)
    assert [message.data for _, message in found.pop("/robot_description")] == [robot]
    assert not found


def test_plotjuggler_makes_a_series_of_every_joint(messages: Messages) -> None:
    series: dict[str, list[float]] = {}
    for topic in TOPICS:
        for _, joints in messages[topic]:
            for i, name in enumerate(joints.name):
                for kind, values in (("position", joints.position), ("velocity", joints.velocity)):
                    if len(values) == len(joints.name):
                        series.setdefault(f"{topic}/{name}/{kind}", []).append(values[i])
    names = messages["/joint_states"][0][1].name
    # Measurements have no rates here.
    due = {f"{topic}/{name}/position" for topic in TOPICS for name in names}
    due |= {f"{topic}/{name}/velocity" for topic in TOPICS[1:] for name in names}
    assert set(series) == due
    assert {len(values) for values in series.values()} == {TICKS}


@pytest.mark.parametrize("ghost", [False, True])
def test_joint_states_and_transforms_agree_on_the_urdf(messages: Messages, ghost: bool) -> None:
    prefix = "reference/" if ghost else ""
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
            assert (turn.inv() * Rotation.from_quat([q.x, q.y, q.z, q.w])).magnitude() < 1e3 * SAME
            compared += 1
    assert compared == len(messages["/tf"]) * len(robot.findall("joint")) > 0


def placed(joint: ElementTree.Element, positions: dict[str, float]) -> tuple[Rotation, np.ndarray]:
    """Return a child link's turn and place in its parent, by the specification."""
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
