"""Contents of a log (topics, joint names, fields of the control message) and the byte layout of its messages.

One tick is one block of bytes: the MCAP message records of all topics at loop rate, stored in sequence as a numpy
structured type. Writer and reader share this type, so neither handles single messages. The layout alone determines
numbers and order of the channels, so a log that lost them can be rebuilt.

Schemas are ROS 2 message definitions ("ros2msg" in MCAP's registry). The definition of the message comes first,
followed by those of all messages it contains, each under a line of equals signs and `MSG: package/Name`. Source: MCAP's
registry of well-known encodings, and the definitions of ROS 2's `common_interfaces`, `geometry2` and `rcl_interfaces`.

Messages use CDR, the serialisation of ROS 2. They are built once as templates and then patched.

Each message has a fixed length as long as its names and counts do not change. A template of bytes and the offsets of
its numbers describe it completely, and numpy reads and writes whole blocks of messages through them.
Numbers are little-endian and aligned to their own size, counted from the end of the four-byte header.
Source: OMG DDS-RTPS 2.3, section 10 (CDR, representation identifier CDR_LE).
"""

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.causes import Cause
from dpcontrol.foundation.document import plain
from dpcontrol.words.runs import told

ENCAPSULATION = b"\x00\x01\x00\x00"
"""The first four bytes of every message."""


Part = tuple[str, str, Any]
"""Name, numpy format and value of a part of a message; the name is "" if the value is fixed."""


class Message(NamedTuple):
    """Message of fixed length, as a template.

    Attributes:
        data: the whole message, with zeros in place of the varying numbers.
        fields: numpy format and byte offset of each varying number.
    """

    data: bytes
    fields: dict[str, tuple[Any, int]]


def message(*parts: Part) -> Message:
    """Return the message of these parts as a template, aligned as in CDR: each number to its own size.

    Args:
        *parts: parts in order.
    """
    names = [name or f"fixed {k}" for k, (name, _, _) in enumerate(parts)]
    structure = np.dtype([(name, form) for name, (_, form, _) in zip(names, parts, strict=True)], align=True)
    values, data_start = np.zeros(1, structure), len(ENCAPSULATION)
    fields: Any = structure.fields
    for name, (_, _, value) in zip(names, parts, strict=True):
        values[name] = value
    last_format, offset = fields[names[-1]][:2]
    field_places = {name: (fields[name][0], data_start + fields[name][1]) for name, *_ in parts if name}
    # CDR has no padding after the last part.
    return Message(ENCAPSULATION + values.tobytes()[: offset + last_format.itemsize], field_places)


def _text(text: str) -> list[Part]:
    """Return the parts of a string in CDR: its length with the final NUL, then its bytes."""
    # NUL ends a string of CDR, so it is removed.
    content = text.replace("\0", "").encode() + b"\0"
    return [("", "<u4", len(content)), ("", f"S{len(content)}", content)]


def _stamp(name: str, time_ns: int = 0) -> list[Part]:
    """Return the parts of a ROS time stamp with the fields `name.sec` and `name.nanosec`."""
    seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
    return [(f"{name}.sec", "<i4", seconds), (f"{name}.nanosec", "<u4", nanoseconds)]


def _sequence(name: str, count: int) -> list[Part]:
    """Return the parts of a sequence of `count` doubles: the count, then the field of the numbers if there are any."""
    return [("", "<u4", count), (name, f"({count},)<f8", 0)][: 1 + (count > 0)]


def joint_state(names: Sequence[str], *, velocities: bool) -> Message:
    """Return sensor_msgs/JointState with the fields `stamp.*`, `position` and, if requested, `velocity`.

    Args:
        names: names of the joints.
        velocities: True for a field `velocity`.
    """
    joints = [("", "<u4", len(names)), *chain.from_iterable(map(_text, names))]
    numbers = [*_sequence("position", len(names)), *_sequence("velocity", len(names) * velocities)]
    return message(*_stamp("stamp"), *_text(""), *joints, *numbers, *_sequence("effort", 0))


def transforms(frames: Sequence[tuple[str, str]]) -> Message:
    """Return tf2_msgs/TFMessage for (parent, child) frames, with which viewers draw the moving arms.

    Fields of the i-th transform: `i.stamp.*`, and `i.pose` with x, y, z and the quaternion's x, y, z, w.

    Args:
        frames: parent and child of each transform.
    """
    parts: list[Part] = [("", "<u4", len(frames))]
    for i, (parent, child) in enumerate(frames):
        parts += [*_stamp(f"{i}.stamp"), *_text(parent), *_text(child), (f"{i}.pose", "(7,)<f8", 0)]
    return message(*parts)


def _row(count: int) -> Message:
    """Return a message of `count` doubles only, in the field "row"."""
    return message(("row", f"({count},)<f8", 0))


def string(text: str) -> bytes:
    """Return std_msgs/String in CDR, as viewers read the arms' description from it.

    Args:
        text: content of the message.
    """
    return message(*_text(text)).data


@dataclass(frozen=True)
class Event:
    """An event of a run: a decision of the loop, a fault or the end.

    Attributes:
        time: s.
        level: a key of `LEVELS`.
        name: originating part.
        cause: value of a `Cause`, or "" if the event has only words.
        figures: numbers and names that belong to the cause.
        words: the logged sentence, or that of an event without a cause.
    """

    time: float
    level: str
    name: str
    cause: str = ""
    figures: Mapping[str, Any] = field(default_factory=dict)
    words: str = ""

    @property
    def text(self) -> str:
        """The event as a sentence."""
        return self.words or told(self.cause, self.figures)


_CAUSES = frozenset(Cause)


def log(event: Event) -> bytes:
    """Return an event as rcl_interfaces/Log, which viewers of ROS 2 logs show.

    The cause is in `function`, and its figures, as JSON, in `file`, which survive all tools that copy messages.

    Args:
        event: the event.
    """
    figures = json.dumps(plain(event.figures)) if event.cause else ""
    texts = chain.from_iterable(map(_text, (event.name, event.text, figures, event.cause)))
    stamp = _stamp("stamp", round(event.time * 1e9))
    return message(*stamp, ("", "u1", LEVELS[event.level]), *texts, ("", "<u4", 0)).data


def logged_event(time: float, data: bytes) -> Event:
    """Return the event in an rcl_interfaces/Log message, the inverse of `log`.

    Args:
        time: time of the event, s.
        data: message in CDR.

    Raises:
        LookupError, struct.error, ValueError: the message has a different layout.
    """
    level = {number: name for name, number in LEVELS.items()}.get(data[_LEVEL], "info")
    position, texts = _LEVEL + 1, []
    for _ in range(4):
        # The length of a string is aligned to four bytes.
        position += -(position - len(ENCAPSULATION)) % 4
        (length,) = struct.unpack_from("<I", data, position)
        position += 4 + length
        texts.append(data[position - length : position].rstrip(b"\0").decode())
    name, words, figures, cause = texts
    # Other programs log their functions and files there.
    if cause not in _CAUSES or not words:
        return Event(time, level, name, words=words)
    return Event(time, level, name, cause, json.loads(figures), words)


_PARTS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
    ),
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
}
"""Definitions of nested message types, by name."""


def _with_parts(definition: str, *names: str) -> bytes:
    """Return a message definition followed by those of the nested messages that it names, as MCAP's schemas require."""
    return "".join([definition, *(f"{'=' * 80}\nMSG: {name}\n{_PARTS[name]}" for name in names)]).encode()


JOINT_STATE = (
    "sensor_msgs/msg/JointState",
    _with_parts(
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
        "std_msgs/Header",
        "builtin_interfaces/Time",
    ),
)
TF_MESSAGE = (
    "tf2_msgs/msg/TFMessage",
    _with_parts(
        "geometry_msgs/TransformStamped[] transforms\n",
        "geometry_msgs/TransformStamped", "std_msgs/Header", "builtin_interfaces/Time",
        "geometry_msgs/Transform", "geometry_msgs/Vector3", "geometry_msgs/Quaternion",
    ),
)  # fmt: skip
STRING = ("std_msgs/msg/String", b"string data\n")
LOG = (
    "rcl_interfaces/msg/Log",
    _with_parts(
        "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\n"
        "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\n"
        "uint32 line\n",
        "builtin_interfaces/Time",
    ),
)


MEASURED = "/joint_states"
ESTIMATE = "/estimate/joint_states"
REFERENCE = "/reference/joint_states"
TRUTH = "/truth/joint_states"
CONTROL = "/control"
EXTRAS = "/estimate/extras"
TRANSFORMS = "/tf"
ROBOT = "/robot_description"
GHOST = "/reference/robot_description"
EVENTS = "/rosout"
LATCHED = frozenset({ROBOT, GHOST})
"""Topics with one message at the start, delivered to late subscribers."""

SLOW_RATE = 50.0
"""Rate of /tf and of /estimate/extras in Hz: sufficient for viewing, a twentieth of the loop's."""

UNITS = {
    **dict.fromkeys((MEASURED, ESTIMATE, REFERENCE, TRUTH), "rad, rad/s; cart m, m/s"),
    CONTROL: "m/s²; σ in rad, rad/s, m, m/s",
    EXTRAS: "rad, rad/s², m/s², shares",
    TRANSFORMS: "m, quaternions",
    **dict.fromkeys((ROBOT, GHOST), "URDF"),
    EVENTS: "text",
}
"""Units of the numbers in each topic."""

LEVELS = {"debug": 10, "info": 20, "warn": 30, "error": 40, "fatal": 50}
"""Levels of an event, with their numbers in rcl_interfaces/Log."""
_LEVEL = 12
"""Place of the level in rcl_interfaces/Log, after its stamp."""

FORMAT = "2"
"""Version of the layout: increased when topics, messages or metadata change their meaning."""

LAYOUT_RECORD = "dpcontrol.layout"
RUN_RECORD = "dpcontrol.run"
RESULT_RECORD = "dpcontrol.result"
RECOVERY_RECORD = "dpcontrol.recovery"
"""Names of the metadata records: layout, the caller's metadata, result of the run (at the end), and losses of a
recovered log."""

_EXTRAS_KEY = "extras"
"""Key of the layout record: names of the estimated parameters, if the log has any."""
_SLOWEST, _FASTEST = 1e-6, 1e9
"""Limits of the loop's rate, Hz; no recording comes near them."""
TICKS = "ticks"
"""Key of the result record: number of ticks of the run."""
LOST = "lost"
"""Key of the recovery record: a sentence on the losses; empty if nothing was lost."""

PARTS = ("rates", "estimate", "reference", "truth", "control")
"""Optional parts of a tick; a log has each part in every tick or in none."""
STATE_TOPICS = {"estimate": ESTIMATE, "reference": REFERENCE, "truth": TRUTH}

RECORD_HEADER = np.dtype(
    [
        ("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)  # fmt: skip
"""An MCAP message record up to its data: packed, little-endian (MCAP specification, "Message")."""
_HEAD = struct.Struct("<BQHIQQ")
LENGTH_FROM = 9
"""Bytes of a record that its length does not include."""


def record(channel: int, number: int, time_ns: int, content: bytes) -> bytes:
    """Return an MCAP message record, as chunks contain it.

    Args:
        channel: number of the channel.
        number: number of the message in its channel.
        time_ns: time of logging and of publishing, ns.
        content: message in CDR.
    """
    length = _HEAD.size - LENGTH_FROM + len(content)
    return _HEAD.pack(_MESSAGE, length, channel, number, time_ns, time_ns) + content


_MESSAGE = 5
"""Opcode of a message."""

_CONTROL_HEAD = ("command", "feedforward", "feedback", "applied", "saturated", "nis", "mode")


def joint_names(arms: int, *, has_cart: bool) -> tuple[str, ...]:
    """Return `arm_1 … arm_n`, followed by `cart` if the rig has one.

    Args:
        arms: number n of arms.
        has_cart: True if the rig has a cart.
    """
    return tuple(f"arm_{i + 1}" for i in range(arms)) + (("cart",) if has_cart else ())


def control_fields(arms: int, *, has_cart: bool) -> tuple[str, ...]:
    """Return the names of /control's float64 fields in order.

    `command`, `feedforward` and `feedback` are cart accelerations in m/s²: the controller's sum and its two parts
    before limits. `applied`, in m/s², is the acceleration from this tick to the next after the loop's limits and delay.
    Deviations of the drive from it appear in the cart velocity of the truth. `saturated` is 0 or 1, `nis` the
    normalised innovation squared (nan in a tick without a measurement), `mode` a number of `Mode`. `sigma_1 …` are
    the standard deviations of the estimate in state order, in rad, rad/s, m and m/s.

    Args:
        arms: number of arms.
        has_cart: True if the rig has a cart.
    """
    return (*_CONTROL_HEAD, *(f"sigma_{i + 1}" for i in range(2 * (arms + has_cart))))


def state_names(arms: int, *, has_cart: bool) -> tuple[str, ...]:
    """Return the names of the state's entries in order: `angle_1 …`, `rate_1 …`, then the cart's.

    Args:
        arms: number of arms.
        has_cart: True if the rig has a cart.
    """
    arms_part = tuple(f"{quantity}_{i + 1}" for quantity in ("angle", "rate") for i in range(arms))
    return arms_part + (("cart_position", "cart_velocity") if has_cart else ())


def record_type(message: Message) -> np.dtype:
    """Return the structured type of the record of `message`, through which numpy reads and writes its numbers.

    Args:
        message: message with its fields.
    """
    places = {name: (kind, offset) for name, (kind, offset, *_) in RECORD_HEADER.fields.items()}  # type: ignore[union-attr]
    places |= {name: (kind, RECORD_HEADER.itemsize + offset) for name, (kind, offset) in message.fields.items()}
    formats, offsets = zip(*places.values(), strict=True)
    size = RECORD_HEADER.itemsize + len(message.data)
    return np.dtype({"names": list(places), "formats": formats, "offsets": offsets, "itemsize": size})


_COUNTERS: tuple[str, ...] = ("sequence", "log_time", "publish_time", "sec", "nanosec")
"""Last names of the fields that follow from a message's number and time."""


class Block:
    """Message records that are written together, as one numpy type.

    Args:
        messages: template of each topic, in the order of writing.
        channels: channel number of each topic.

    Attributes:
        kind: structured type with a field for each topic.
        template: bytes of the records, with times and numbers zero.
    """

    def __init__(self, messages: Mapping[str, Message], channels: Mapping[str, int]) -> None:
        self.kind = np.dtype([(topic, record_type(message)) for topic, message in messages.items()])
        self.template = b"".join(record(channels[topic], 0, 0, message.data) for topic, message in messages.items())
        self._records = np.empty(0, self.kind)
        fields = ((topic, name, name.rpartition(".")[2]) for topic in messages for name in self.kind[topic].names or ())
        # Topic, field and last name of each field that follows from number and time.
        self._counters = tuple(field for field in fields if field[2] in _COUNTERS)

    def filled(self, times: NDArray[np.int64], first: int) -> NDArray[Any]:
        """Return copies (K,) of the template with times and numbers of sequence, which the next call overwrites.

        The caller then fills in the messages' own numbers.

        Args:
            times: times (K,) of the ticks, ns.
            first: number of the first message in its channel.
        """
        if len(self._records) < len(times):
            self._records = np.frombuffer(bytearray(self.template * len(times)), self.kind)
        block = self._records[: len(times)]
        # In the order of `_COUNTERS`: number, times of logging and of publishing, and the time stamp in s and ns.
        numbers = np.arange(first, first + len(times)), times, times, *np.divmod(times, 1_000_000_000)
        values = dict(zip(_COUNTERS, numbers, strict=True))
        for topic, name, counter in self._counters:
            block[topic][name] = values[counter]
        return block


@dataclass(frozen=True)
class TickLayout:
    """Messages of a tick in order of writing, and the channels: the log's layout, from which writer and reader work.

    Attributes:
        arm_lengths: (n,) m.
        has_cart: True if the pivot is on a cart.
        rate_hz: rate of the loop, Hz.
        parts: members of `PARTS` that the log has.
        limits: the cart's greatest distance from the centre in m, velocity in m/s, acceleration in m/s², or None.
        extras: names of the estimated parameters, in the estimator's order.
    """

    arm_lengths: tuple[float, ...]
    has_cart: bool
    rate_hz: float
    parts: frozenset[str] = frozenset(PARTS)
    limits: tuple[float, float, float] | None = None
    extras: tuple[str, ...] = ()

    @classmethod
    def of(cls, record: Mapping[str, str]) -> "TickLayout":
        """Return the layout in a log's metadata record.

        Args:
            record: values of the record `LAYOUT_RECORD`.

        Raises:
            LookupError, ValueError: a value is missing or impossible.
        """
        numbers = {key: tuple(map(float, record[key].split())) for key in ("arm_lengths", "rate_hz", "limits")}
        lengths, (rate,), limits = numbers.values()
        parts = frozenset(record["parts"].split())
        if not (
            parts <= set(PARTS) and all(0 < length < np.inf for length in lengths) and _SLOWEST <= rate <= _FASTEST
        ):
            raise ValueError("its layout has unknown parts, or impossible lengths or rates")
        return cls(
            lengths,
            record["has_cart"] == "1",
            rate,
            parts,
            (limits[0], limits[1], limits[2]) if limits else None,
            tuple(record.get(_EXTRAS_KEY, "").split()),
        )

    def record(self) -> dict[str, str]:
        """Return the values of the metadata record `LAYOUT_RECORD`, from which `of` makes the layout again."""
        return {
            "format": FORMAT,
            "arm_lengths": " ".join(map(repr, self.arm_lengths)),
            "has_cart": "1" if self.has_cart else "0",
            "rate_hz": repr(self.rate_hz),
            "limits": " ".join(map(repr, self.limits or ())),
            "parts": " ".join(part for part in PARTS if part in self.parts),
            **({_EXTRAS_KEY: " ".join(self.extras)} if self.extras else {}),
        }

    @property
    def arms(self) -> int:
        """Number of arms."""
        return len(self.arm_lengths)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the joints in the joint states."""
        return joint_names(self.arms, has_cart=self.has_cart)

    @cached_property
    def fields(self) -> tuple[str, ...]:
        """Names of the control message's fields."""
        return control_fields(self.arms, has_cart=self.has_cart)

    @cached_property
    def widths(self) -> dict[str, int]:
        """Number of columns in the rows of measured positions, of each part and of the extras, by name."""
        joints = len(self.names)
        widths = dict.fromkeys(("measured", *PARTS), 2 * joints)
        widths |= {"measured": joints, "rates": joints, "control": len(self.fields)}
        return widths | ({"extras": 2 * len(self.extras)} if self.extras else {})

    @cached_property
    def rooms(self) -> tuple[tuple[str, str, slice, str, slice], ...]:
        """Where each number of a tick lies, in a message and in the rows of the loop.

        Each entry has topic, field and joints of the message, then part ("measured" or of `PARTS`) and columns of the
        row.

        All are slices, because indexing by number is too slow for the few ticks of a chunk.
        """
        n, whole = self.arms, slice(None)
        arms = (slice(n), slice(n), slice(n, 2 * n))
        cart = (slice(n, n + 1), slice(2 * n, 2 * n + 1), slice(2 * n + 1, 2 * n + 2))
        rooms = [
            (MEASURED, "position", whole, "measured", whole),
            (MEASURED, "velocity", whole, "rates", whole),
            (CONTROL, "row", whole, "control", whole),
        ]
        for (part, topic), (joints, *columns) in product(STATE_TOPICS.items(), (arms, cart)[: 1 + self.has_cart]):
            rooms += [
                (topic, name, joints, part, columns_of_field)
                for name, columns_of_field in zip(("position", "velocity"), columns, strict=True)
            ]
        return tuple(room for room in rooms if room[3] in {"measured", *self.parts})

    @cached_property
    def messages(self) -> dict[str, Message]:
        """Template of each topic's message in a tick, in the order of writing."""
        state = joint_state(self.names, velocities=True)
        messages = {MEASURED: joint_state(self.names, velocities="rates" in self.parts)}
        messages |= {topic: state for part, topic in STATE_TOPICS.items() if part in self.parts}
        if "control" in self.parts:
            messages[CONTROL] = _row(len(self.fields))
        return messages

    @cached_property
    def extras_message(self) -> Message:
        """Message of /estimate/extras, as field "row": all standard deviations, then all values."""
        return _row(2 * len(self.extras))

    @cached_property
    def schemas(self) -> dict[str, tuple[str, bytes]]:
        """Name and definition of each topic's message type, in channel order."""
        schemas: dict[str, tuple[str, bytes]] = dict.fromkeys(self.messages, JOINT_STATE)
        if CONTROL in schemas:
            schemas[CONTROL] = (
                "dpcontrol_msgs/msg/Control",
                "".join(f"float64 {name}\n" for name in self.fields).encode(),
            )
        schemas |= {TRANSFORMS: TF_MESSAGE, EVENTS: LOG, ROBOT: STRING}
        if "reference" in self.parts:
            schemas[GHOST] = STRING
        if self.extras:
            # ROS 2 requires field names in lower case.
            fields = (f"float64 {prefix}{name.lower()}\n" for prefix in ("sigma_", "") for name in self.extras)
            schemas[EXTRAS] = ("dpcontrol_msgs/msg/Extras", "".join(fields).encode())
        return schemas

    @cached_property
    def kinds(self) -> dict[str, str]:
        """Name of the message type of each topic."""
        return {topic: kind for topic, (kind, _) in self.schemas.items()}

    @cached_property
    def channels(self) -> dict[str, int]:
        """Channel number of each topic."""
        return {topic: number for number, topic in enumerate(self.schemas, start=1)}

    @cached_property
    def types(self) -> dict[str, np.dtype]:
        """Structured type of each topic's records: of their heads, except for topics with ticks and for the extras."""
        described = {**self.messages, EXTRAS: self.extras_message}
        return {topic: record_type(described[topic]) if topic in described else RECORD_HEADER for topic in self.schemas}

    @cached_property
    def block(self) -> Block:
        """The messages of a tick as one block of records."""
        return Block(self.messages, self.channels)


RETURN, FLIGHT, RESUME, LAP, CATCH = "return", "flight", "resume", "lap", "catch"
"""Names of the events for leaving and rejoining the itinerary."""


class Stretch(NamedTuple):
    """Ticks `first` to `end` of a run on its itinerary, from time `at` s of the planned reference on."""

    first: int
    end: int
    at: float
