"""Read logs that another program has rewritten, by topic and message name.

Filters, mergers and converters renumber channels, repack messages and may drop topics, messages, metadata or
attachments. The messages themselves do not change: they remain CDR with ROS 2's definitions. A tick is a time with
a message in every state topic of the log. The contents of the original file are unknown, so neither integrity nor
completeness can be checked.

Sources: OMG DDS-RTPS 2.3, section 10 (CDR); sensor_msgs/JointState, std_msgs/String of ROS 2's `common_interfaces`.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import reduce
from typing import Any, TypeVar

import numpy as np
from mcap.records import Channel, Schema

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.shown import Brief
from dpcontrol.logs import layout
from dpcontrol.logs.layout import MessageReader, TickLayout

T = TypeVar("T")
_LENGTH = re.compile(r'xyz="0 [-\d.e]+ (-[\d.e-]+)"')
"""Distance of a link's shape below its joint in the URDF. The last shape marks the link's far end."""
_LINK = re.compile(r'<link name="arm_(\d+)_link">(.*?)</link>', re.DOTALL)


@dataclass
class Topic:
    """Messages of one topic in file order.

    Times are in ns, bodies in CDR.
    """

    name: str
    schema: str
    definition: bytes
    times: list[int] = field(default_factory=list)
    bodies: list[bytes] = field(default_factory=list)

    def decoded(self, read: Callable[[bytes], T]) -> dict[int, T]:
        """Return the messages by time.

        Args:
            read: decodes a message.

        Raises:
            ValueError: a message does not decode; names the topic.
        """
        try:
            return dict(zip(self.times, map(read, self.bodies), strict=True))
        except ValueError as error:
            raise ValueError(f"a message of {self.name} does not decode ({error})") from error


def by_topic(
    messages: Iterable[tuple[int, int, bytes]], channels: Mapping[int, Channel], schemas: Mapping[int, Schema]
) -> dict[str, Topic]:
    """Return the CDR topics of messages, with the times of the run.

    Recorders stamp messages with their own clock, but keep the stamp in the header of a joint state. Channels may be
    added during iteration.

    Args:
        messages: channel, time in ns and body of each message.
        channels: channels by number.
        schemas: schemas by number.
    """
    found: dict[str, Topic] = {}
    for number, time, body in messages:
        channel = channels.get(number)
        schema = None if channel is None else schemas.get(channel.schema_id)
        if channel is None or schema is None or channel.message_encoding != "cdr":
            continue
        topic = found.setdefault(channel.topic, Topic(channel.topic, schema.name, schema.data))
        topic.times.append(time)
        topic.bodies.append(body)
    shift = _clock(found.get(layout.MEASURED))
    for topic in found.values() if shift else ():
        topic.times = [time - shift for time in topic.times]
    return found


def _clock(measured: Topic | None) -> int:
    """Return the recording time of stamp 0, ns, or 0."""
    shifts: set[int] = set()
    if measured is not None and measured.schema == layout.JOINT_STATE[0]:
        with suppress(ValueError):
            for time, body in zip(measured.times, measured.bodies, strict=True):
                seconds, nanoseconds = MessageReader(body).take("I", 4, 2)
                shifts.add(time - seconds * 10**9 - nanoseconds)
    return shifts.pop() if len(shifts) == 1 else 0


def mixed(topics: Mapping[str, Topic]) -> str:
    """Return a topic with different messages at one time, or "".

    Such a topic is a sign of two runs.

    Args:
        topics: messages of each topic.
    """
    for name in (one for one in _TICKED if one in topics):
        times, bodies = topics[name].times, topics[name].bodies
        if len(set(zip(times, bodies, strict=True))) > len(set(times)):
            return name
    return ""


_TICKED = (layout.MEASURED, *layout.STATE_TOPICS.values(), layout.CONTROL)
"""Topics that have one message in every tick."""


def _joints(body: bytes) -> tuple[tuple[str, ...], tuple[float, ...], tuple[float, ...]]:
    """Return names, positions and velocities of sensor_msgs/JointState."""
    cursor = MessageReader(body)
    cursor.take("I", 4, 2)
    cursor.text()
    (count,) = cursor.take("I", 4)
    names = tuple(cursor.text() for _ in range(count))
    return names, cursor.doubles(), cursor.doubles()


@dataclass(frozen=True)
class Rewritten(Brief):
    """A log read topic by topic.

    It consists of tick layout, rows and a description in the form of the layout record.
    """

    tick: TickLayout
    described: dict[str, str]
    rows: dict[str, Array]
    events: list[tuple[int, bytes]]
    extras: list[Array]
    topics: dict[str, Topic]


def found_in(topics: Mapping[str, Topic], described: Mapping[str, str]) -> Rewritten | None:
    """Return the log in these topics, or None for other contents.

    The topics must hold the joints of a pendulum.

    Args:
        topics: messages by topic.
        described: values of the layout record. If the file has none, arm lengths come from the robot description.

    Raises:
        ValueError: a message does not match its schema, or the joints or the times do not fit together.
    """
    measured = topics.get(layout.MEASURED)
    if measured is None or measured.schema != layout.JOINT_STATE[0]:
        return None
    joints = {
        part: topics[name].decoded(_joints)
        for part, name in {"measured": layout.MEASURED, **layout.STATE_TOPICS}.items()
        if name in topics and topics[name].schema == layout.JOINT_STATE[0]
    }
    decoded = joints.pop("measured")
    names = decoded[measured.times[0]][0]
    has_cart = names[-1:] == ("cart",)
    arms = len(names) - has_cart
    lengths = [float(text) for text in described.get("arm_lengths", "").split()] or _drawn_lengths(topics)
    if not arms or names != layout.joint_names(arms, has_cart=has_cart) or len(lengths) != arms:
        raise ValueError(f"the joints of {layout.MEASURED} are {', '.join(names) or 'none'}, for {len(lengths)} arms")
    parts: dict[str, dict[int, Any]] = {"measured": {time: values[1] for time, values in decoded.items()}}
    if all(len(values[2]) == len(names) for values in decoded.values()):
        parts["rates"] = {time: values[2] for time, values in decoded.items()}
    for part, states in joints.items():
        parts[part] = {
            time: (*at[:arms], *rates[:arms], *at[arms:], *rates[arms:]) for time, (_, at, rates) in states.items()
        }
    fields = layout.control_fields(arms, has_cart=has_cart)
    control = topics.get(layout.CONTROL)
    if control is not None and re.findall(r"float64 (\w+)", control.definition.decode()) == list(fields):
        parts["control"] = _rows(control, len(fields))
    times = np.array(sorted(reduce(set.intersection, (set(rows) for rows in parts.values()))))
    if len(times) < 2:
        ticks = "1 tick" if len(times) == 1 else "no ticks"
        raise ValueError(f"it has {ticks}, times with a message in every state topic, and two are needed")
    rows = {name: np.array([values[int(time)] for time in times], float) for name, values in parts.items()}
    extras = tuple(described.get(layout.EXTRAS_KEY, "").split()) if layout.EXTRAS in topics else ()
    values = sorted(_rows(topics[layout.EXTRAS], 2 * len(extras)).items()) if extras else []
    events = topics.get(layout.EVENTS)
    logged = [] if events is None or events.schema != layout.LOG[0] else zip(events.times, events.bodies, strict=True)
    own = {
        "format": layout.FORMAT, "program": "another program", "limits": "", **described,
        "arm_lengths": " ".join(map(repr, lengths)), "rate_hz": repr(1e9 / float(np.median(np.diff(times)))),
    }  # fmt: skip
    tick = TickLayout(arms, has_cart, frozenset(rows) - {"measured"}, extras)
    found = [np.array([(time / 1e9, *row) for time, row in values])] if extras else []
    return Rewritten(tick, own, {"time": times / 1e9, **rows}, list(logged), found, dict(topics))


def _rows(topic: Topic, width: int) -> dict[int, tuple[float, ...]]:
    return topic.decoded(lambda body: MessageReader(body).take("d", 8, width))


def _drawn_lengths(topics: Mapping[str, Topic]) -> list[float]:
    """Return the arm lengths drawn in the robot description, m.

    The arm lengths have six digits. Without a description there are none.
    """
    robot = topics.get(layout.ROBOT)
    if robot is None or robot.schema != layout.STRING[0]:
        return []
    links = dict(_LINK.findall(MessageReader(robot.bodies[0]).text()))
    ends = [_LENGTH.findall(links[number]) for number in sorted(links, key=int)]
    return [-float(found[-1]) for found in ends if found]
