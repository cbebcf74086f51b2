"""Columns of ROS bags and of MCAP files.

Bags have version 1, or version 2 as a folder. MCAP files have the profile of ROS 2.

A column name starts with its topic.

    /joint_states/arm_1/position    of sensor_msgs/JointState: position, velocity or effort
    /encoders.data[1]               of other messages: a field, one element of a list
    log_time, TOPIC.header.stamp    times in seconds, of recording or from the header
    segment                         number of the segment, in a log that `dpcontrol import` wrote

The topic of the first column sets the sample times. Values of other topics are interpolated to these times. Times that
another topic does not cover are left out, and a remark gives their duration.
"""

import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError, PartMissing, remark
from dpcontrol.foundation.files import checked_size, is_bag_folder
from dpcontrol.foundation.parts import part
from dpcontrol.foundation.settings import suggest
from dpcontrol.foundation.units import quantity
from dpcontrol.logs.layout import RUN_RECORD
from dpcontrol.logs.reader import open_mcap, segment_numbers, segments_in

LOG_TIME, SEGMENT = "log_time", "segment"
"""Names of the columns of recording times, and of the segments' numbers."""


def is_bag(path: Path) -> bool:
    """True if the path is a bag: a .bag or .mcap file, or a folder with metadata.yaml.

    Args:
        path: file or folder.
    """
    return path.suffix.lower() in (".bag", ".mcap") or is_bag_folder(path)


@contextmanager
def reading(path: Path, kind: str) -> Iterator[None]:
    """Report any error of a library that reads a file as an InputError, since damaged files raise errors of many kinds.

    Args:
        path: the file.
        kind: its kind for the message, such as "a table".

    Raises:
        InputError: the file cannot be read.
    """
    try:
        yield
    except (InputError, PartMissing):
        raise
    except Exception as error:
        reason = next(iter(str(error).strip().splitlines()), type(error).__name__)[:200]
        raise InputError(
            f"cannot read {path} as {kind} ({reason}); check the name, or record, save or copy it again"
        ) from error


def read_bag(path: Path, columns: Sequence[str], *, optional: Collection[str] = ()) -> dict[str, Array]:
    """Return the named columns (K,) of a bag, in the time that all of their topics cover.

    A message without the number gives nan.

    Args:
        path: the bag.
        columns: names of columns, each with its topic.
        optional: columns that are left out if no message holds them.

    Raises:
        InputError: the file cannot be read, or lacks a topic, joint or field; lists the existing ones.
        PartMissing: rosbags is not installed.
    """
    rosbags, types = part("rosbags.highlevel"), part("rosbags.typesys")
    # rosbags compares the checksums of chunks only.
    record = open_mcap(path).values(RUN_RECORD) if path.is_file() and path.suffix.lower() == ".mcap" else {}
    with reading(path, "a bag"):
        store = types.get_typestore(types.Stores.ROS2_HUMBLE)
        with rosbags.AnyReader([path], default_typestore=store) as bag:
            data_columns = [name for name in columns if name not in (LOG_TIME, SEGMENT)]
            topics = {name: _topic(name, sorted(bag.topics), path) for name in data_columns}
            tables = {
                topic: _table(bag, topic, [k for k in data_columns if topics[k] == topic]) for topic in topics.values()
            }
    sample_times = tables[topics[data_columns[0]]][LOG_TIME]
    sampled_columns = {LOG_TIME: sample_times}
    if segments := segments_in(record.get("segments", ""), len(sample_times)):
        sampled_columns[SEGMENT] = segment_numbers(segments, len(sample_times)).astype(float)
    for name, topic in topics.items():
        if name in tables[topic]:
            sampled_columns[name] = np.interp(
                sample_times, tables[topic][LOG_TIME], tables[topic][name], left=np.nan, right=np.nan
            )
        elif name not in optional:
            raise InputError(f"{path}: {name} holds no numbers in any message; check file and mapping")
    covered = _covered(path, sample_times, [table[LOG_TIME] for table in tables.values()])
    return {name: values[covered] for name, values in sampled_columns.items() if name in columns}


def _covered(path: Path, moments: Array, times: Sequence[Array]) -> NDArray[np.bool_]:
    """Mark the samples (K,) that all topics cover, and tell the user how much is left out.

    `moments` (K,) are the samples' times, and `times` those of each topic's messages, s.

    Raises:
        InputError: no sample is covered.
    """
    begin, end = max(topic_times[0] for topic_times in times), min(topic_times[-1] for topic_times in times)
    covered = (moments >= begin) & (moments <= end)
    if not covered.any():
        raise InputError(f"{path}: no time has values of all columns; map topics that were recorded together")
    if omitted := float(np.ptp(moments) - np.ptp(moments[covered])):
        remark(f"{path}: left out {quantity(omitted, 's')}, for which some topics have no values")
    return covered


def _topic(name: str, topics: Sequence[str], path: Path) -> str:
    """Return the topic with which a column's name begins; the longest, if several do.

    `topics` are the names of the bag's topics.

    Raises:
        InputError: there is none.
    """
    matching_topics = [topic for topic in topics if name.startswith((f"{topic}/", f"{topic}."))]
    if not matching_topics:
        raise InputError(f"{path}: no topic holds the column {name!r}; {suggest(name, topics)}; check file and mapping")
    return max(matching_topics, key=len)


def _table(bag: Any, topic: str, names: Sequence[str]) -> dict[str, Array]:
    """Return the times of a topic's messages, s, in order, and its columns (K,) that hold numbers, by name.

    `bag` is the open reader of rosbags. Times are counted from the start of the bag. `names` are the columns' names,
    each beginning with the topic. A column without any number is left out.

    Raises:
        ValueError: the topic has no messages.
    """
    connections, start = bag.topics[topic].connections, bag.start_time
    checked_size(8.0 * bag.topics[topic].msgcount * (len(names) + 1))
    rows = []
    for connection, time, data in bag.messages(connections):
        message = bag.deserialize(data, connection.msgtype)
        # In double precision today's clock times resolve 0.2 µs; times since the start resolve far less than 1 ns.
        rows.append([(time - start) / 1e9, *(_number(message, name.removeprefix(topic), start) for name in names)])
    if not rows:
        raise ValueError(f"{topic} has no messages")
    columns = dict(zip((LOG_TIME, *names), np.array(sorted(rows, key=lambda row: row[0])).T, strict=True))
    return {name: values for name, values in columns.items() if not np.isnan(values).all()}


def _number(message: Any, path: str, start: int) -> float:
    """Return the number at the end of a column's path in a message, NaN if there is none.

    `message` is an object of rosbags with the message's fields as attributes. `path` is "/JOINT/FIELD" in joint states,
    else fields and indices such as ".data[1]". A time stamp becomes seconds since `start` ns.
    """
    joint, _, field = path[1:].rpartition("/")
    try:
        if joint:
            return float(getattr(message, field)[list(message.name).index(joint)])
        for name_or_index in re.findall(r"\w+", path):
            message = message[int(name_or_index)] if name_or_index.isdigit() else getattr(message, name_or_index)
        return (message.sec * 10**9 + message.nanosec - start) / 1e9 if hasattr(message, "nanosec") else float(message)
    except (AttributeError, LookupError, TypeError, ValueError):
        return np.nan
