"""Logs follow the published rules of the tools that read them: JointState by PlotJuggler, URDF by Foxglove and rviz.

sensor_msgs/JointState has rad or m and rad/s or m/s. Each array is as long as the names or empty, and names are unique.
PlotJuggler (plotjuggler_ros, ros2_parsers/jointstates_msg.h) has a series of a joint if it
has as many values as names.

In URDF, coordinates of continuous joints are in rad about the axis, and those of prismatic joints in m along it. A
mimic joint has multiplier · coordinate + offset. Foxglove's 3D panel and robot_state_publisher place links in this way.
"""

from xml.etree import ElementTree

import numpy as np
import pytest
from log_samples import sample, write_sample
from mcap_ros2.reader import read_ros2_messages
from scipy.spatial.transform import Rotation

TICKS = 120
SAME = 1e-12
"""Rad, m: a rotation vector from a quaternion and back."""
WRITTEN = 1e-6
"""m: lengths stand in the URDF to six digits."""
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
