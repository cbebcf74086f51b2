"""Columns of ROS bags and of MCAP files with ROS messages.

Bags have version 1, or version 2 as a folder.

A column name starts with its topic.

    /joint_states/arm_1/position    of sensor_msgs/JointState: position, velocity or effort
    /encoders.data[1]               of other messages: a field, one element of a list
    log_time, TOPIC.header.stamp    times in seconds, of recording or from the header

The topic of the first column sets the sample times. Values of other topics are interpolated to these times.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import UNREADABLE, checked_size
from dpcontrol.foundation.parts import part
from dpcontrol.foundation.settings import suggest

LOG_TIME = "log_time"
"""Name of the column of recording times."""
_FIELD = re.compile(r"\.(\w+)|\[(\d+)\]")
_JOINT = re.compile(r"/([^/]+)/(position|velocity|effort)")


def is_bag(path: Path) -> bool:
    """True if the path is a bag.

    Bags are .bag or .mcap files, or folders with metadata.yaml.

    Args:
        path: file or folder.
    """
    return path.suffix.lower() in (".bag", ".mcap") or (path.is_dir() and (path / "metadata.yaml").is_file())


def read_bag(path: Path, columns: Sequence[str]) -> dict[str, Array]:
    """Return the named columns (K,) of a bag.

    A message without the number gives nan.

    Args:
        path: the bag.
        columns: names of columns, each with its topic.

    Raises:
        InputError: the file cannot be read, or lacks a topic, joint or field; lists the existing ones.
        PartMissing: rosbags is not installed.
    """
    with _opened(path) as reader:
        there = sorted({connection.topic for connection in reader.connections})
        places = {name: _place(name, there, path) for name in columns if name != LOG_TIME}
        base = next(iter(places.values()))[0]
        found = {topic: _of_topic(reader, topic, places) for topic, _ in places.values()}
    moments, out = found[base][LOG_TIME], {}
    for name in columns:
        topic = base if name == LOG_TIME else places[name][0]
        values, at = found[topic][name], found[topic][LOG_TIME]
        if not len(values) or np.isnan(values).all():
            raise InputError(f"{path}: {name} holds no numbers in any message; check file and mapping")
        out[name] = values if topic == base else np.interp(moments, at, values, left=np.nan, right=np.nan)
    return out


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a bag; any fault in it becomes an InputError."""
    rosbags, types = part("rosbags.highlevel"), part("rosbags.typesys")
    wrong = (rosbags.AnyReaderError, types.TypesysError, *UNREADABLE)
    try:
        store = types.get_typestore(types.Stores.ROS2_HUMBLE)
        with rosbags.AnyReader([path], default_typestore=store) as reader:
            yield reader
    except wrong as error:
        reason = next(iter(str(error).splitlines()), type(error).__name__)[:200]
        raise InputError(f"{path} is not a readable bag ({reason}); record or convert it again") from error


def _place(name: str, topics: Sequence[str], path: Path) -> tuple[str, str]:
    """Return the topic of a column, and the rest.

    The rest is that of the column's name.
    """
    fitting = [topic for topic in topics if name.startswith(topic) and name[len(topic) : len(topic) + 1] in ("/", ".")]
    if not fitting:
        raise InputError(f"{path}: no topic holds the column {name!r}; {suggest(name, topics)}; check file and mapping")
    topic = max(fitting, key=len)
    return topic, name[len(topic) :]


def _of_topic(reader: Any, topic: str, places: dict[str, tuple[str, str]]) -> dict[str, Array]:
    """Return the columns of one topic in order of time.

    The recording times are in s.
    """
    wanted = {name: rest for name, (own, rest) in places.items() if own == topic}
    connections = [connection for connection in reader.connections if connection.topic == topic]
    checked_size(8.0 * sum(connection.msgcount for connection in connections) * (len(wanted) + 1))
    rows = []
    for connection, time, data in reader.messages(connections=connections):
        message = reader.deserialize(data, connection.msgtype)
        # In double precision today's clock times resolve 0.2 µs; times since the start resolve far less than 1 ns.
        moment = (time - reader.start_time) / 1e9
        rows.append([moment, *(_number(message, rest, reader.start_time) for rest in wanted.values())])
    values = np.array(sorted(rows, key=lambda row: row[0]), float).reshape(-1, len(wanted) + 1)
    return dict(zip((LOG_TIME, *wanted), values.T, strict=True))


def _number(message: Any, rest: str, start: int) -> float:
    """Return a number of a message, nan if it is missing.

    Times are seconds since `start` ns.
    """
    joint = _JOINT.fullmatch(rest)
    if joint is not None:
        names, values = list(message.name), getattr(message, joint[2])
        return float(values[names.index(joint[1])]) if joint[1] in names and len(values) == len(names) else np.nan
    value: Any = message
    for name, index in _FIELD.findall(rest):
        if name:
            value = getattr(value, name, None)
        else:
            value = value[int(index)] if isinstance(value, Sequence | np.ndarray) and int(index) < len(value) else None
    if hasattr(value, "nanosec"):
        return (value.sec * 10**9 + value.nanosec - start) / 1e9
    return float(value) if isinstance(value, int | float | np.number) else np.nan
