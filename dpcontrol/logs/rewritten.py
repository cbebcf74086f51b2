"""Read logs that another program has rewritten, by topic.

Filters, mergers and converters renumber channels, repack messages and may drop topics or messages. The messages
themselves do not change: each is the template of its topic, with other numbers. The metadata tell the template. A tick
is a time with a message in every state topic of the log. The contents of the original file are unknown, so neither
integrity nor completeness can be checked.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dpcontrol.logs import layout


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

    Attributes:
        name: name of the topic.
        schema: type of the messages.
        times: times, ns.
        bodies: contents in CDR.
    """

    name: str
    schema: str
    times: list[int] = field(default_factory=list)
    bodies: list[bytes] = field(default_factory=list)

    def table(self, message: layout.Message) -> NDArray:
        """Return the messages (K,) as `layout.record_type` structures them, in order of time.

        Args:
            message: template of the messages.

        Raises:
            ValueError: a message is not the template with other numbers, or differs from another of the same time.
        """
        structure, start = layout.record_type(message), layout.RECORD_HEADER.itemsize
        if {len(body) for body in self.bodies} != {len(message.data)}:
            raise ValueError(f"a message of {self.name} has another length than those of the log")
        raw = np.zeros((len(self.times), structure.itemsize), np.uint8)
        raw[:, start:] = np.frombuffer(b"".join(self.bodies), np.uint8).reshape(len(raw), -1)
        without_numbers, table = raw.copy(), raw.view(structure)[:, 0]
        for name in message.fields:
            without_numbers.view(structure)[name] = 0
        if (without_numbers[:, start:] != np.frombuffer(message.data, np.uint8)).any():
            raise ValueError(f"a message of {self.name} has other joints or fields than those of the log")
        table["log_time"] = self.times
        times, first_rows = np.unique(table["log_time"], return_index=True)
        if len(set(zip(self.times, self.bodies, strict=True))) > len(times):
            raise ValueError(f"{self.name} has different messages at one time, as of two runs")
        return table[first_rows]


def by_topic(messages: Iterable[tuple[Any, Any, Any]]) -> dict[str, Topic]:
    """Return the topics whose messages are in CDR, with the times of the run.

    Recorders stamp messages with their own clock, but keep the stamp in the header of a joint state. If both differ by
    the same amount in all measured joint states, the times of all topics are shifted by it; otherwise they are left.

    Args:
        messages: schema, channel and record of each message, as the mcap package reads them.
    """
    topics: dict[str, Topic] = {}
    for schema, channel, message in messages:
        if schema is not None and channel.message_encoding == "cdr":
            topic = topics.setdefault(channel.topic, Topic(channel.topic, schema.name))
            topic.times.append(message.log_time)
            topic.bodies.append(message.data)
    measured = topics.get(layout.MEASURED)
    if measured is not None and measured.schema == layout.JOINT_STATE[0]:
        # Seconds and nanoseconds follow the four bytes at the beginning of every message.
        stamps = np.frombuffer(b"".join(body[4:12] for body in measured.bodies), "<u4").reshape(-1, 2)
        clock_shifts = set((np.array(measured.times) - stamps @ [10**9, 1]).tolist())
        for topic in topics.values() if len(clock_shifts) == 1 else ():
            topic.times = [time - min(clock_shifts) for time in topic.times]
    return topics


def ticks_in(topics: Mapping[str, Topic], described: layout.TickLayout) -> tuple[layout.TickLayout, Batch]:
    """Return the layout of the topics that are left in a rewritten log, and their messages.

    The rate of the layout is that of the ticks, which may be lower than in the original log.

    Args:
        topics: messages of each topic that is left, by its name.
        described: layout of the original log, from its metadata.

    Raises:
        ValueError: the measured joint states are missing, messages are not those of a log, or fewer than two ticks are
            left.
    """
    topic_of_part = {**layout.STATE_TOPICS, "control": layout.CONTROL, "rates": layout.MEASURED}
    present_parts = frozenset(part for part in described.parts if topic_of_part[part] in topics)
    extras = described.extras if layout.EXTRAS in topics else ()
    tick = replace(described, parts=present_parts, extras=extras)
    if layout.MEASURED not in topics:
        raise ValueError(f"it lacks {layout.MEASURED} in cdr")
    tables = {name: topics[name].table(message) for name, message in tick.messages.items()}
    tick_times = reduce(np.intersect1d, [table["log_time"] for table in tables.values()])
    if len(tick_times) < 2:
        raise ValueError(
            f"it has {len(tick_times)} ticks, times with a message in every state topic, and two are needed"
        )
    tables = {name: table[np.isin(table["log_time"], tick_times)] for name, table in tables.items()}
    if extras:
        tables[layout.EXTRAS] = topics[layout.EXTRAS].table(tick.extras_message)
    events = topics.get(layout.EVENTS, Topic("", ""))
    times = {name: np.array(topic.times) for name, topic in topics.items()}
    rate = 1e9 / float(np.median(np.diff(tick_times)))
    return replace(tick, rate_hz=rate), Batch(tables, times, list(zip(events.times, events.bodies, strict=True)))
