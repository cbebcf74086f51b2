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
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
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
_JOINT_FIELDS = ("position", "velocity", "effort")
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
        topics = {name: _topic(name, sorted(bag.counts), path) for name in columns if name not in (LOG_TIME, SEGMENT)}
        base = next(iter(topics.values()))
        tables = {topic: _table(bag, topic, columns) for topic in topics.values()}
    moments, out = tables[base].times, {}
    if SEGMENT in columns and (segments := segments_in(bag.segments, len(moments))):
        out[SEGMENT] = segment_numbers(segments, len(moments)).astype(float)
    if LOG_TIME in columns:
        out[LOG_TIME] = moments
    for name, topic in topics.items():
        table = tables[topic]
        if name in table.columns:
            values = table.columns[name]
            between = np.interp(moments, table.times, values, left=np.nan, right=np.nan)
            out[name] = values if topic == base else between
        elif name not in optional:
            hint = suggest(name, table.fields)
            raise InputError(f"{path}: {name} holds no numbers in any message; {hint}; check file and mapping")
    return out, _covered(path, moments, {topic: table.times for topic, table in tables.items()})


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

    counts: Mapping[str, int]
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
        for connection, time, data in reader.messages(reader.topics[topic].connections):
            yield time, reader.deserialize(data, connection.msgtype)

    return _Bag({topic: about.msgcount for topic, about in reader.topics.items()}, reader.start_time, messages)


def _of_mcap(file: VerifiedFile, columns: Sequence[str]) -> _Bag:
    """Return the messages of an MCAP file.

    Only those of topics with a column are kept.
    """
    counts: Counter[str] = Counter()
    kept: dict[str, list[tuple[int, int, bytes]]] = {}
    start = 1 << 64
    with file.decoding():
        for number, time, body in file.messages():
            topic = file.channels[number].topic
            counts[topic] += 1
            start = min(start, time)
            if any(name.startswith(topic) for name in columns):
                kept.setdefault(topic, []).append((time, number, body))
    decoder = cache(partial(_decoder, file))
    return _Bag(
        counts,
        start,
        lambda topic: ((time, decoder(number)(body)) for time, number, body in kept[topic]),
        file.values(RUN_RECORD).get("segments", ""),
    )


def _decoder(file: VerifiedFile, number: int) -> Callable[[bytes], Any]:
    """Return the decoder of a channel's messages."""
    channel = file.channels[number]
    schema, encoding = file.schemas.get(channel.schema_id), channel.message_encoding
    if encoding == "json":
        return lambda body: json.loads(body, object_hook=lambda values: SimpleNamespace(**values))
    if encoding != "cdr" or schema is None or schema.encoding not in ("", "ros2msg", "ros2idl", "omgidl"):
        raise InputError(
            f"{file.path}: {channel.topic} holds messages in {encoding or 'no encoding'}; import reads json, "
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


def _topic(name: str, topics: Sequence[str], path: Path) -> str:
    """Return the topic with which a column's name begins."""
    fitting = [topic for topic in topics if name.startswith((f"{topic}/", f"{topic}."))]
    if not fitting:
        raise InputError(f"{path}: no topic holds the column {name!r}; {suggest(name, topics)}; check file and mapping")
    return max(fitting, key=len)


@dataclass(frozen=True)
class _Table:
    """Recording times (K,) of a topic's messages, s, in order, its columns (K,), and the names of its numbers."""

    times: Array
    columns: dict[str, Array]
    fields: Collection[str]


def _table(bag: _Bag, topic: str, columns: Sequence[str]) -> _Table:
    """Return those columns of a topic that have a number in some message."""
    checked_size(8.0 * bag.counts[topic] * (len(columns) + 1))
    rows: list[list[float]] = []
    fields: list[str] = []
    for time, message in bag.messages(topic):
        numbers = dict(_numbers(message, topic, bag.start))
        # In double precision today's clock times resolve 0.2 µs; times since the start resolve far less than 1 ns.
        rows.append([(time - bag.start) / 1e9, *(numbers.get(name, np.nan) for name in columns)])
        fields = fields or list(numbers)[:_SHOWN_FIELDS]
    values = np.array(sorted(rows, key=lambda row: row[0]), float).reshape(-1, len(columns) + 1).T
    found = {name: column for name, column in zip(columns, values[1:], strict=True) if not np.isnan(column).all()}
    return _Table(values[0], found, fields)


def _numbers(value: Any, name: str, start: int) -> Iterator[tuple[str, float]]:
    """Yield the columns in a message, or in a part of it, with their numbers; times are seconds since `start` ns."""
    if isinstance(value, int | float | np.number):
        yield name, float(value)
    elif hasattr(value, "nanosec"):
        yield name, (value.sec * 10**9 + value.nanosec - start) / 1e9
    elif isinstance(value, list | np.ndarray):
        for index, one in enumerate(value):
            yield from _numbers(one, f"{name}[{index}]", start)
    elif hasattr(value, "__dict__"):
        for key, one in vars(value).items():
            yield from _numbers(one, f"{name}.{key}", start)
            joints = getattr(value, "name", None) if key in _JOINT_FIELDS else None
            if isinstance(joints, list) and np.size(one) == len(joints):
                for joint, number in zip(joints, one, strict=True):
                    yield from _numbers(number, f"{name}/{joint}/{key}", start)
