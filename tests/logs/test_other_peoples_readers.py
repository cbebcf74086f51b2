"""Third-party readers read logs completely: rosbags, mcap-ros2-support, Foxglove's JavaScript, Rerun's loader.

Each message of every type must equal the intended one, field by field. The intended message follows from the numbers of
the run and the ROS 2 definitions, not from our reader.
"""

import json
import math
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_samples import EXTRAS, open_writer, sample, tick_all
from mcap_ros2.reader import read_ros2_messages
from rosbags.highlevel import AnyReader

from dpcontrol.logs import control_fields, joint_names
from dpcontrol.logs.writer import link_frames, link_poses, robot_description

TICKS = 120
LIMITS = (0.9, 3.0, 30.0)
SEVERITIES = {"debug": 10, "info": 20, "warn": 30, "error": 40, "fatal": 50}
"""rcl_interfaces/msg/Log."""
PACKAGES = ("@mcap/core@2.2.2", "@foxglove/rosmsg@5.0.5", "@foxglove/rosmsg2-serialization@3.1.0", "fzstd@0.1.1")
"""fzstd unpacks the log's chunks."""

Messages = dict[str, list[tuple[int, Any]]]


@pytest.fixture(scope="module", params=[(2, True), (1, False)], ids=["two arms on a cart", "one arm"])
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Messages]:
    """A log with messages of every type and events of every severity, and what is in it: time in ns and message."""
    arms, has_cart = request.param
    run = sample(TICKS, arms=arms, has_cart=has_cart)
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    with open_writer(path, run) as log:
        tick_all(log, run)
        for k, level in enumerate(SEVERITIES):
            log.event(0.02 * k, level, f"part {k}", f"{level}: 5 m/s², ünd mehr")
    return path, expected(run, arms=arms, has_cart=has_cart)


def stamp(time: int) -> dict[str, int]:
    return {"sec": time // 10**9, "nanosec": time % 10**9}


def header(time: int, frame: str) -> dict[str, Any]:
    return {"stamp": stamp(time), "frame_id": frame}


def expected(run: Any, *, arms: int, has_cart: bool) -> Messages:
    names, size = list(joint_names(arms, has_cart=has_cart)), 2 * arms
    positions = [*range(arms), size][: len(names)]
    velocities = [*range(arms, size), size + 1][: len(names)]
    times = [k * 10**6 for k in range(TICKS)]
    none = [[]] * TICKS
    rows = {"/joint_states": (run.measured.tolist(), none)} | {
        f"/{part}/joint_states": (state[:, positions].tolist(), state[:, velocities].tolist())
        for part, state in (("estimate", run.estimate), ("reference", run.reference), ("truth", run.truth))
    }
    found: Messages = {
        topic: [
            (t, {"header": header(t, ""), "name": names, "position": p, "velocity": v, "effort": []})
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
    links = (*link_frames(arms, has_cart=has_cart), *link_frames(arms, has_cart=has_cart, prefix="reference/"))
    shown = range(0, TICKS, 20)
    found["/tf"] = [(times[k], {"transforms": transforms(times[k], links, run, k, has_cart)}) for k in shown]
    for topic, text in (
        ("/robot_description", robot_description(run.arm_lengths, has_cart=has_cart, limits=LIMITS)),
        (
            "/reference/robot_description",
            robot_description(run.arm_lengths, has_cart=has_cart, limits=LIMITS, prefix="reference/", ghost=True),
        ),
    ):
        found[topic] = [(0, {"data": text})]
    return found


def transforms(time: int, links: Any, run: Any, k: int, has_cart: bool) -> list[dict[str, Any]]:
    rows = np.stack([run.truth[k], run.reference[k]])
    places = link_poses(rows, arm_lengths=run.arm_lengths, has_cart=has_cart).reshape(-1, 7).tolist()
    return [
        {
            "header": header(time, parent),
            "child_frame_id": child,
            "transform": {
                "translation": dict(zip("xyz", place[:3], strict=True)),
                "rotation": dict(zip("xyzw", place[3:], strict=True)),
            },
        }
        for (parent, child), place in zip(links, places, strict=True)
    ]


def plain(message: Any) -> Any:
    """Return a message of any reader as dicts, lists, numbers and text."""
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
    assert found.keys() == due.keys()
    for topic, messages in due.items():
        assert [time for time, _ in found[topic]] == [time for time, _ in messages], topic
        for (_, one), (_, other) in zip(found[topic], messages, strict=True):
            assert same(one, other), (topic, one, other)


def test_rosbags_reads_every_message_as_written(written: tuple[Path, Messages]) -> None:
    found: Messages = {}
    with AnyReader([written[0]]) as reader:
        for connection, time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((time, plain(message)))
    check(found, written[1])


def test_the_public_ros2_decoder_reads_every_message_as_written(written: tuple[Path, Messages]) -> None:
    found: Messages = {}
    for message in read_ros2_messages(str(written[0])):
        found.setdefault(message.channel.topic, []).append((message.log_time_ns, plain(message.ros_msg)))
    check(found, written[1])


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with Foxglove's packages from npm."""
    npm = shutil.which("npm")
    if npm is None or shutil.which("node") is None:
        pytest.skip("node or npm is not installed")
    folder = tmp_path_factory.mktemp("node")
    (folder / "package.json").write_text("{}")
    options = ("--no-audit", "--no-fund", "--ignore-scripts", "--fetch-retries=0", "--fetch-timeout=10000")
    try:
        done = subprocess.run(
            [npm, "install", "--prefer-offline", *options, *PACKAGES], cwd=folder, capture_output=True, text=True,
            check=False, timeout=120,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        pytest.skip("npm did not bring the packages within two minutes")
    if done.returncode:
        pytest.skip(f"npm cannot bring the packages: {done.stderr.strip()[:300]}")
    return folder


@pytest.mark.slow  # It fetches packages from npm.
def test_foxgloves_packages_read_every_message_as_written(written: tuple[Path, Messages], packages: Path) -> None:
    script = Path(__file__).with_name("read_log.mjs")
    done = subprocess.run(["node", script, written[0], packages], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found: Messages = {}
    for line in done.stdout.splitlines():
        topic, time, message = json.loads(line)
        found.setdefault(topic, []).append((time, message))
    check(found, written[1])


def test_reruns_loader_shows_every_message_as_written(written: tuple[Path, Messages]) -> None:
    chunk = pytest.importorskip("rerun.chunk", reason="this version of rerun-sdk has no reader of chunks")
    columns: dict[tuple[str, str], list[tuple[int, Any]]] = {}
    for part in chunk.McapReader(written[0]).stream():
        batch = part.to_record_batch()
        if "message_log_time" in batch.schema.names:
            times = batch.column("message_log_time").cast("int64").to_pylist()
            for name in batch.schema.names:
                values = batch.column(name).to_pylist()
                columns.setdefault((str(part.entity_path), name), []).extend(zip(times, values, strict=True))
    due = written[1]

    def column(path: str, name: str) -> list[tuple[int, Any]]:
        return [(time, value) for time, value in columns[path, name] if value is not None]

    for topic in (topic for topic in due if topic.endswith("joint_states")):
        for field in ("position", "velocity"):
            found = column(f"{topic}/{field}", "Scalars:scalars")
            assert found == [(time, message[field]) for time, message in due[topic]], topic
        # Rerun gives the names once if they do not change.
        names = {tuple(value) for _, value in column(f"{topic}/position", "SeriesLines:names")}
        assert names == {tuple(due[topic][0][1]["name"])}
    control = [(time, value[0]) for time, value in column("/control", "dpcontrol_msgs.msg.Control:message")]
    for topic in ("/robot_description", "/reference/robot_description"):
        assert column(topic, "TextDocument:text") == [(time, [message["data"]]) for time, message in due[topic]]
    check({"/control": control}, {"/control": due["/control"]})
    levels = {10: "DEBUG", 20: "INFO", 30: "WARN", 40: "ERROR", 50: "CRITICAL"}
    events = [(time, levels[m["level"]], f"[{m['name']}] {m['msg']}") for time, m in due["/rosout"]]
    shown = zip(column("/rosout", "TextLog:level"), column("/rosout", "TextLog:text"), strict=True)
    assert [(time, level[0], text[0]) for (time, level), (_, text) in shown] == events
    moved = [(time, t) for time, message in due["/tf"] for t in message["transforms"]]
    assert column("/tf", "Transform3D:parent_frame") == [(time, [t["header"]["frame_id"]]) for time, t in moved]
    assert column("/tf", "Transform3D:child_frame") == [(time, [t["child_frame_id"]]) for time, t in moved]
    for name, part in (("translation", "translation"), ("quaternion", "rotation")):
        found = [value[0] for _, value in column("/tf", f"Transform3D:{name}")]
        # Rerun keeps places in single precision.
        values = np.array([list(t["transform"][part].values()) for _, t in moved], dtype=np.float32)
        assert np.array_equal(np.array(found, dtype=np.float32), values)
