"""ROS bags of both versions and MCAP files are imported by a mapping of topics, joints and fields."""

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from dpcontrol.foundation.errors import Remark
from dpcontrol.recordings.importing import import_recording

SAMPLES, PERIOD, START = 300, 0.002, 1_700_000_000
"""A clock of days, as benches have."""
TIME = PERIOD * np.arange(SAMPLES)
ANGLES = np.column_stack([0.5 * np.cos(6.0 * TIME), 0.3 * np.sin(9.0 * TIME)])
MAPPING = """
arm_lengths = [0.2, 0.3]
[time]
column = "{time}"
[angles]
columns = ["/bench/joints/elbow/position", "/bench/joints/shoulder/position"]
zero = "upright"
relative = true
[cart]
position = "/bench/rail.data[1]"
unit = "mm"
"""


def bag(folder: Path, kind: str) -> Path:
    """Write joints in another order than the arms, and a cart in mm on a separate topic, half a period later."""
    store = get_typestore(Stores.ROS1_NOETIC if kind == "bag1" else Stores.ROS2_HUMBLE)
    types = store.types
    path = folder / ("swing.bag" if kind == "bag1" else "swing")
    with Writer1(path) if kind == "bag1" else Writer2(path, version=8) as writer:
        joints = writer.add_connection("/bench/joints", "sensor_msgs/msg/JointState", typestore=store)
        rail = writer.add_connection("/bench/rail", "std_msgs/msg/Float64MultiArray", typestore=store)
        layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
        for k in range(-1, SAMPLES):
            moment = START * 10**9 + round(1e9 * PERIOD * k)
            stamp = types["builtin_interfaces/msg/Time"](sec=moment // 10**9, nanosec=moment % 10**9)
            first = {"seq": 0} if kind == "bag1" else {}
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="bench", **first)
            relative = np.array([0.0, ANGLES[k, 0] + np.pi, ANGLES[k, 1] - ANGLES[k, 0] + np.pi])
            state = types["sensor_msgs/msg/JointState"](
                header=header, name=["wheel", "elbow", "shoulder"], position=relative, velocity=np.zeros(0),
                effort=np.zeros(0),
            )  # fmt: skip
            late = types["std_msgs/msg/Float64MultiArray"](layout=layout, data=np.array([7.0, 100.0 * (k + 0.5)]))
            messages = [(rail, moment + round(5e8 * PERIOD), late)] + ([(joints, moment, state)] if k >= 0 else [])
            for connection, at, message in messages:
                pack = store.serialize_ros1 if kind == "bag1" else store.serialize_cdr
                writer.write(connection, at, pack(message, connection.msgtype))
    return path


@pytest.mark.parametrize(("kind", "time"), [("bag1", "log_time"), ("bag2", "/bench/joints.header.stamp")])
def test_a_bag_is_imported_by_a_mapping(tmp_path: Path, kind: str, time: str) -> None:
    (tmp_path / "bench.toml").write_text(MAPPING.format(time=time))
    found = import_recording(bag(tmp_path, kind), str(tmp_path / "bench.toml"))
    # The bag counts each angle from upright, the outer one from the inner arm.
    expected = np.cumsum(np.column_stack([ANGLES[:, 0], ANGLES[:, 1] - ANGLES[:, 0]]), axis=1)
    assert np.allclose(found.angles, expected, atol=1e-12)
    assert found.dt == pytest.approx(PERIOD)
    assert found.rates is None
    # Millimetres on a straight line, interpolated between messages half a period off.
    assert np.allclose(found.cart, 0.1 * np.arange(SAMPLES), atol=1e-9)


ENCODERS = "float64[] data\nbuiltin_interfaces/Time stamp\n"
TIME_PART = f"{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
MOMENTS = [START * 10**9 + round(1e9 * PERIOD * k) for k in range(SAMPLES)]
Topic = tuple[str, str, str, list[tuple[int, bytes]]]


def encoders() -> Topic:
    """Return a topic of the angles: its name, encoding, definition and messages with their times."""
    messages = []
    for moment, angles in zip(MOMENTS, ANGLES, strict=True):
        # A header, the length of the list, its padding, the numbers, and the time.
        stamp = [value.to_bytes(4, "little") for value in divmod(moment, 10**9)]
        messages.append((moment, b"".join([b"\0\1\0\0" + (2).to_bytes(8, "little"), angles.tobytes(), *stamp])))
    return "/encoders", "cdr", ENCODERS + TIME_PART, messages


def rig_file(folder: Path, *topics: Topic, time: str = "log_time", more: str = "") -> tuple[Path, str]:
    """Write topics as an MCAP file and its mapping, with `more` lines; return both."""
    with (folder / "rig.mcap").open("wb") as target:
        writer = Writer(target)
        writer.start(profile="ros2", library="rig")
        for name, encoding, definition, messages in topics:
            schema = definition and writer.register_schema(f"rig_msgs/msg/{name[1:]}", "ros2msg", definition.encode())
            channel = writer.register_channel(name, encoding, schema or 0)
            for moment, data in messages:
                writer.add_message(channel, moment, data, moment)
        writer.finish()
    columns = '["/encoders.data[0]", "/encoders.data[1]"]'
    text = f'arm_lengths = [0.2, 0.3]\n[time]\ncolumn = "{time}"\n[angles]\ncolumns = {columns}\n{more}'
    (folder / "bench.toml").write_text(text)
    return folder / "rig.mcap", str(folder / "bench.toml")


@pytest.mark.parametrize("time", ["log_time", "/encoders.stamp"])
def test_an_mcap_file_of_a_rigs_own_messages_is_imported(tmp_path: Path, time: str) -> None:
    chat = ("/chat", "text", "", [(moment, b"?") for moment in MOMENTS])
    found = import_recording(*rig_file(tmp_path, encoders(), chat, time=time))
    assert np.allclose(found.angles, ANGLES, atol=1e-12)
    assert found.dt == pytest.approx(PERIOD)


def test_a_bag_is_imported_where_all_its_topics_have_values(tmp_path: Path) -> None:
    """The rail begins 0.2 ms late and covers 200 samples of the encoders."""
    moved = [(MOMENTS[k] + 200_000, b"\0\1\0\0" + np.float64(0.1 * k).tobytes()) for k in range(200)]
    rail = ("/rail", "cdr", "float64 x\n", moved)
    file, mapping = rig_file(tmp_path, encoders(), rail, more='[cart]\nposition = "/rail.x"\n')
    with pytest.warns(Remark, match="left out 202 ms, for which some topics have no values"):
        found = import_recording(file, mapping)
    # The last message of the rail is 0.2 ms after sample 199.
    assert np.allclose(found.angles, ANGLES[1:200], atol=1e-12)
    assert np.allclose(found.cart, 0.1 * (np.arange(1, 200) - 0.1), atol=1e-9)
    assert not found.notes
