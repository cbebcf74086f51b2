"""Columns of ROS bags and of MCAP files.

Bags have version 1, or version 2 as a folder. MCAP files hold messages of ROS 2 (CDR) or JSON, with any profile.

A column name starts with its topic.

    /joint_states/arm_1/position    of sensor_msgs/JointState: position, velocity or effort
    /encoders.data[1]               of other messages: a field, one element of a list
    log_time, TOPIC.header.stamp    times in seconds, of recording or from the header
    segment                         number of the segment, in a log that `dpcontrol import` wrote

The topic of the first column sets the sample times. Values of other topics are interpolated to these times. Times that
another topic does not cover are left out, and a remark gives their duration.
"""

import json
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError, remark
from dpcontrol.foundation.files import UNREADABLE, checked_size, is_bag_folder
from dpcontrol.foundation.parts import part
from dpcontrol.foundation.settings import suggest
from dpcontrol.foundation.units import quantity
from dpcontrol.logs.layout import RUN_RECORD
from dpcontrol.logs.reader import VerifiedFile, open_mcap, segment_numbers, segments_in

LOG_TIME, SEGMENT = "log_time", "segment"
"""Names of the columns of recording times, and of the segments' numbers."""
_FIELD = re.compile(r"\.(\w+)|\[(\d+)\]")
_JOINT_FIELDS = ("position", "velocity", "effort")
_JOINT = re.compile(rf"/([^/]+)/({'|'.join(_JOINT_FIELDS)})")
_SHOWN_FIELDS = 30


def is_bag(path: Path) -> bool:
    """True if the path is a bag.

    Bags are .bag or .mcap files, or folders with metadata.yaml.

    Args:
        path: file or folder.
    """
    return path.suffix.lower() in (".bag", ".mcap") or is_bag_folder(path)


def read_bag(
    path: Path, columns: Sequence[str], *, optional: Collection[str] = ()
) -> tuple[dict[str, Array], NDArray[np.bool_]]:
    """Return the named columns (K,) of a bag.

    The samples that all topics cover are returned too. A message without the number gives nan.

    Args:
        path: the bag.
        columns: names of columns, each with its topic.
        optional: columns that are left out if no message holds them.

    Raises:
        InputError: the file cannot be read, or lacks a topic, joint or field; lists the existing ones.
        PartMissing: rosbags is not installed.
    """
    with _opened(path, columns) as bag:
        topics = sorted(bag.counts)
        places = {name: _place(name, topics, path) for name in columns if name not in (LOG_TIME, SEGMENT)}
        base = next(iter(places.values()))[0]
        found = {topic: _of_topic(bag, topic, places, path, optional) for topic, _ in places.values()}
    moments, out = found[base][LOG_TIME], {}
    if SEGMENT in columns and (segments := segments_in(bag.segments, len(moments))):
        found[base][SEGMENT] = segment_numbers(segments, len(moments)).astype(float)
    for name in columns:
        topic = places[name][0] if name in places else base
        if name in found[topic]:
            values, at = found[topic][name], found[topic][LOG_TIME]
            out[name] = values if topic == base else np.interp(moments, at, values, left=np.nan, right=np.nan)
    return out, _covered(path, moments, {topic: values[LOG_TIME] for topic, values in found.items()})


def _covered(path: Path, moments: Array, times: dict[str, Array]) -> NDArray[np.bool_]:
    """Mark the samples that all topics cover, and remark on others."""
    late, early = max(times, key=lambda topic: times[topic][0]), min(times, key=lambda topic: times[topic][-1])
    begin, end = times[late][0], times[early][-1]
    covered = (moments >= begin) & (moments <= end)
    if not covered.any():
        raise InputError(f"{path}: {late} begins when {early} has ended; map topics that were recorded together")
    for what, left, reason in (
        ("first", begin - moments[0], f"before {late} began"),
        ("last", moments[-1] - end, f"after {early} ended"),
    ):
        if left > 0:
            remark(f"{path}: left out the {what} {quantity(left, 's')}, {reason}")
    return covered


@dataclass(frozen=True)
class _Bag:
    """The messages of a bag.

    It holds their number by topic, the time of the first in ns, a reader of one topic, and the segments of a recording.
    """

    counts: dict[str, int]
    start: int
    messages: Callable[[str], Iterable[tuple[int, Any]]]
    segments: str = ""


@contextmanager
def _opened(path: Path, columns: Sequence[str]) -> Iterator[_Bag]:
    """Open a bag; any fault in it becomes an InputError."""
    try:
        if path.suffix.lower() == ".mcap" and path.is_file():
            yield _of_mcap(open_mcap(path), columns)
            return
        rosbags, types = part("rosbags.highlevel"), part("rosbags.typesys")
        store = types.get_typestore(types.Stores.ROS2_HUMBLE)
        with rosbags.AnyReader([path], default_typestore=store) as reader:
            yield _of_rosbags(reader)
    except Exception as error:
        if not isinstance(error, UNREADABLE) and not type(error).__module__.startswith("rosbags."):
            raise
        reason = next(iter(str(error).splitlines()), type(error).__name__)[:200]
        raise InputError(f"{path} is not a readable bag ({reason}); record or convert it again") from error


def _of_rosbags(reader: Any) -> _Bag:
    def messages(topic: str) -> Iterator[tuple[int, Any]]:
        for connection, time, data in reader.messages([one for one in reader.connections if one.topic == topic]):
            yield time, reader.deserialize(data, connection.msgtype)

    counts: dict[str, int] = {}
    for connection in reader.connections:
        counts[connection.topic] = counts.get(connection.topic, 0) + connection.msgcount
    return _Bag(counts, reader.start_time, messages)


def _of_mcap(file: VerifiedFile, columns: Sequence[str]) -> _Bag:
    """Return the messages of an MCAP file.

    Only those of topics with a column are kept.
    """
    counts: dict[str, int] = {}
    kept: dict[str, list[tuple[int, int, bytes]]] = {}
    start = 1 << 64
    with file.decoding():
        for number, time, body in file.messages():
            topic = file.channels[number].topic
            counts[topic], start = counts.get(topic, 0) + 1, min(start, time)
            if any(name.startswith(topic) for name in columns):
                kept.setdefault(topic, []).append((time, number, body))
    decoders: dict[int, Callable[[bytes], Any]] = {}

    def messages(topic: str) -> Iterator[tuple[int, Any]]:
        for time, number, body in kept[topic]:
            if number not in decoders:
                decoders[number] = _decoder(file, number)
            yield time, decoders[number](body)

    return _Bag(counts, start, messages, file.values(RUN_RECORD).get("segments", ""))


def _decoder(file: VerifiedFile, number: int) -> Callable[[bytes], Any]:
    """Return the decoder of a channel's messages."""
    channel = file.channels[number]
    schema, encoding = file.schemas.get(channel.schema_id), channel.message_encoding
    if encoding == "json":
        return lambda body: json.loads(body, object_hook=lambda values: SimpleNamespace(**values))
    if encoding != "cdr" or schema is None or schema.encoding not in ("", "ros2msg", "ros2idl", "omgidl"):
        by = f" described by {schema.encoding}" if schema and schema.encoding else ""
        raise InputError(
            f"{file.path}: {channel.topic} holds messages in {encoding or 'no encoding'}{by}; import reads json, "
            "and cdr with definitions of ROS 2; convert the file to one of these"
        )
    types, text = part("rosbags.typesys"), schema.data.decode()
    name = schema.name if schema.name.count("/") > 1 else schema.name.replace("/", "/msg/")
    store = types.get_typestore(types.Stores.EMPTY if text else types.Stores.ROS2_HUMBLE)
    if schema.encoding == "ros2msg":
        store.register(types.get_types_from_msg(text, name))
    for one in re.split(r"^=+\n(?:IDL: .*\n)?", text, flags=re.MULTILINE) if schema.encoding.endswith("idl") else ():
        store.register(types.get_types_from_idl(one) if one.strip() else {})
    return lambda body: store.deserialize_cdr(body, name)


def _place(name: str, topics: Sequence[str], path: Path) -> tuple[str, str]:
    """Return the topic of a column, and the rest.

    The rest is that of the column's name.
    """
    fitting = [topic for topic in topics if name.startswith(topic) and name[len(topic) : len(topic) + 1] in ("/", ".")]
    if not fitting:
        raise InputError(f"{path}: no topic holds the column {name!r}; {suggest(name, topics)}; check file and mapping")
    topic = max(fitting, key=len)
    return topic, name[len(topic) :]


def _of_topic(
    bag: _Bag, topic: str, places: dict[str, tuple[str, str]], path: Path, optional: Collection[str]
) -> dict[str, Array]:
    """Return the columns of one topic in order of time.

    The recording times are in s.
    """
    wanted = {name: rest for name, (own, rest) in places.items() if own == topic}
    checked_size(8.0 * bag.counts[topic] * (len(wanted) + 1))
    rows, there = [], dict[str, None]()
    for time, message in bag.messages(topic):
        # In double precision today's clock times resolve 0.2 µs; times since the start resolve far less than 1 ns.
        moment = (time - bag.start) / 1e9
        rows.append([moment, *(_number(message, rest, bag.start) for rest in wanted.values())])
        there = there or dict.fromkeys(islice(_numbers(message, topic), _SHOWN_FIELDS))
    values = np.array(sorted(rows, key=lambda row: row[0]), float).reshape(-1, len(wanted) + 1)
    found = dict(zip((LOG_TIME, *wanted), values.T, strict=True))
    for name in [name for name in wanted if np.isnan(found[name]).all()]:
        if name not in optional:
            raise InputError(
                f"{path}: {name} holds no numbers in any message; {suggest(name, there)}; check file and mapping"
            )
        del found[name]
    return found


def _joints(message: Any) -> list[str]:
    """Return the joints of a sensor_msgs/JointState, or no names."""
    names = getattr(message, "name", None)
    return list(names) if isinstance(names, list) and hasattr(message, "position") else []


def _listed(message: Any, kind: str) -> list[Any]:
    """Return the values of a field, none if it is no list."""
    values = getattr(message, kind, None)
    return list(values) if isinstance(values, list | np.ndarray) else []


def _numbers(value: Any, name: str) -> Iterator[str]:
    """Yield the columns in a message, or in a part of it."""
    joints = _joints(value)
    for kind in _JOINT_FIELDS if joints else ():
        if len(_listed(value, kind)) == len(joints):
            yield from (f"{name}/{joint}/{kind}" for joint in joints)
    if isinstance(value, int | float | np.number) or hasattr(value, "nanosec"):
        yield name
    elif isinstance(value, list | np.ndarray):
        for index, one in enumerate(value):
            yield from _numbers(one, f"{name}[{index}]")
    elif hasattr(value, "__dict__"):
        for key, one in vars(value).items():
            yield from _numbers(one, f"{name}.{key}")


def _number(message: Any, rest: str, start: int) -> float:
    """Return a number of a message, nan if it is missing.

    Times are seconds since `start` ns.
    """
    joint = _JOINT.fullmatch(rest)
    if joint is not None:
        names, values = _joints(message), _listed(message, joint[2])
        found = joint[1] in names and len(values) == len(names)
        return _real(values[names.index(joint[1])]) if found else np.nan
    value: Any = message
    for name, index in _FIELD.findall(rest):
        if name:
            value = getattr(value, name, None)
        else:
            value = value[int(index)] if isinstance(value, list | np.ndarray) and int(index) < len(value) else None
    if hasattr(value, "nanosec"):
        return (value.sec * 10**9 + value.nanosec - start) / 1e9
    return _real(value)


def _real(value: Any) -> float:
    return float(value) if isinstance(value, int | float | np.number) else np.nan
