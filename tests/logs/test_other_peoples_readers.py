"""Third-party readers read logs completely: rosbags and Foxglove's mcap-ros2-support.

Each message of every type must equal the intended one, field by field. The intended message follows from the numbers of
the run and the ROS 2 definitions, not from our reader. Links are placed by the specification of URDF: coordinates of
continuous joints are in rad about the axis, those of prismatic joints in m along it, and a mimic joint has
multiplier · coordinate + offset.
"""

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from log_samples import EXTRAS, open_writer, sample, tick_all
from mcap_ros2.reader import read_ros2_messages
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from dpcontrol.logs import Event, control_fields, joint_names
from dpcontrol.logs.writer import robot_description

TICKS = 120
LIMITS = (0.9, 3.0, 30.0)
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
