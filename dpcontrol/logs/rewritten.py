"""Read logs that another program has rewritten, by topic.

Filters, mergers and converters renumber channels, repack messages and may drop topics, messages, metadata or
attachments. The messages themselves do not change: each is the template of its topic, with other numbers. A tick is a
time with a message in every state topic of the log. The contents of the original file are unknown, so neither integrity
nor completeness can be checked.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dpcontrol.logs import layout
from dpcontrol.logs.layout import Message, TickLayout, texts_in

_ARM = re.compile(r'<box size="\S+ \S+ (\S+)"/></geometry><material name="arm"/>')
"""Shape of an arm in the robot description."""
_MOST_ARMS = 9


class Batch(NamedTuple):
    """Messages of a part of a log.

    Attributes:
        tables: messages (K,) of each topic with ticks and of the extras, structured like `layout.record_type`.
        times: times of all messages of each topic, ns.
        events: time, ns, and content of each event.
    """

    tables: dict[str, NDArray]
    times: dict[str, NDArray]
    events: list[tuple[int, bytes]]


@dataclass
class Topic:
    """Messages of one topic in file order.

    Times are in ns, bodies in CDR.
    """

    name: str
    schema: str
    times: list[int] = field(default_factory=list)
    bodies: list[bytes] = field(default_factory=list)

    def table(self, message: Message) -> NDArray:
        """Return the messages (K,) as `layout.record_type` structures them, in order of time.

        Args:
            message: template of the messages.

        Raises:
            ValueError: a message is not the template with other numbers, or differs from another of the same time.
        """
        kind, start = layout.record_type(message), layout.RECORD_HEADER.itemsize
        data, size = b"".join(self.bodies), len(message.data)
        if len(set(zip(self.times, self.bodies, strict=True))) > len(set(self.times)):
            raise ValueError(f"{self.name} has different messages at one time, as of two runs")
        raw = np.zeros((len(self.times), kind.itemsize), np.uint8)
        raw[:, start:] = np.frombuffer(data, np.uint8).reshape(len(raw), size)
        blank, table = raw.copy(), raw.view(kind)[:, 0]
        for name in message.fields:
            blank.view(kind)[name] = 0
        if (blank[:, start:] != np.frombuffer(message.data, np.uint8)).any():
            raise ValueError(f"a message of {self.name} has other joints or fields than those of a log")
        table["log_time"] = self.times
        return table[np.unique(table["log_time"], return_index=True)[1]]


def by_topic(messages: Iterable[tuple[Any, Any, Any]]) -> dict[str, Topic]:
    """Return the CDR topics of messages, with the times of the run.

    Recorders stamp messages with their own clock, but keep the stamp in the header of a joint state.

    Args:
        messages: schema, channel and record of each message.
    """
    found: dict[str, Topic] = {}
    for schema, channel, message in messages:
        if schema is not None and channel.message_encoding == "cdr":
            topic = found.setdefault(channel.topic, Topic(channel.topic, schema.name))
            topic.times.append(message.log_time)
            topic.bodies.append(message.data)
    measured = found.get(layout.MEASURED)
    if measured is not None and measured.schema == layout.JOINT_STATE[0]:
        stamps = np.frombuffer(b"".join(body[4:12] for body in measured.bodies), "<u4").reshape(-1, 2)
        shifts = set((np.array(measured.times) - stamps @ [10**9, 1]).tolist())
        for topic in found.values() if len(shifts) == 1 else ():
            topic.times = [time - min(shifts) for time in topic.times]
    return found


def ticks_in(topics: Mapping[str, Topic], described: TickLayout | None) -> tuple[TickLayout, Batch]:
    """Return layout and messages of the log in these topics.

    Args:
        topics: messages by topic.
        described: layout in the metadata. If the file has none, arm lengths come from the robot description.

    Raises:
        ValueError: there are no joints of a pendulum, or messages are not those of a log.
    """
    tick = _layout(topics, described.extras if described and layout.EXTRAS in topics else ())
    lengths = described.arm_lengths if described else _drawn_lengths(topics)
    if len(lengths) != tick.arms:
        raise ValueError(f"{layout.MEASURED} has {tick.arms} arms, and the description {len(lengths)}")
    tables = {name: topics[name].table(message) for name, message in tick.messages.items()}
    common = reduce(np.intersect1d, [table["log_time"] for table in tables.values()])
    if len(common) < 2:
        raise ValueError(f"it has {len(common)} ticks, times with a message in every state topic, and two are needed")
    tables = {name: table[np.isin(table["log_time"], common)] for name, table in tables.items()}
    if tick.extras:
        tables[layout.EXTRAS] = topics[layout.EXTRAS].table(tick.extras_message)
    rate, limits = 1e9 / float(np.median(np.diff(common))), described.limits if described else None
    events = topics.get(layout.EVENTS, Topic("", ""))
    logged = list(zip(events.times, events.bodies, strict=True)) if events.schema == layout.LOG[0] else []
    times = {name: np.array(topic.times) for name, topic in topics.items()}
    return replace(tick, arm_lengths=lengths, rate_hz=rate, limits=limits), Batch(tables, times, logged)


def _layout(topics: Mapping[str, Topic], extras: tuple[str, ...]) -> TickLayout:
    """Return the layout whose joints are those of the first measurement."""
    measured = topics.get(layout.MEASURED)
    if measured is None or measured.schema != layout.JOINT_STATE[0]:
        raise ValueError(f"it lacks {layout.MEASURED} as {layout.JOINT_STATE[0]} in cdr")
    parts = {part for part, topic in {**layout.STATE_TOPICS, "control": layout.CONTROL}.items() if topic in topics}
    for arms, has_cart, rates in product(range(1, _MOST_ARMS + 1), (True, False), ({"rates"}, set[str]())):
        tick = TickLayout((1.0,) * arms, has_cart, 1.0, frozenset(parts | rates), extras=extras)
        message, body = tick.messages[layout.MEASURED], measured.bodies[0]
        start, end = 12, message.fields["position"][1] - 4
        if len(body) == len(message.data) and body[start:end] == message.data[start:end]:
            return tick
    raise ValueError(f"the joints of {layout.MEASURED} are not arm_1, … and perhaps cart")


def _drawn_lengths(topics: Mapping[str, Topic]) -> tuple[float, ...]:
    """Return the arm lengths drawn in the robot description, m, which have six digits, or none."""
    robot = topics.get(layout.ROBOT)
    return () if robot is None else tuple(map(float, _ARM.findall(texts_in(robot.bodies[0], 4, 1)[0])))
