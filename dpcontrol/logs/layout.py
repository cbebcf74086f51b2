"""Contents of a log and the byte layout of its messages.

The contents are topics, joint names and the fields of the control message.

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
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from dpcontrol.foundation.causes import Cause
from dpcontrol.foundation.document import plain
from dpcontrol.words.runs import told

ENCAPSULATION = b"\x00\x01\x00\x00"
"""The first four bytes of every message."""


@dataclass
class Message:
    """Message of fixed length. Values are appended in order, with CDR's alignment.

    Attributes:
        data: the whole message, with zeros in place of the varying numbers.
        fields: numpy format and byte offset of each varying number.
    """

    data: bytearray = field(default_factory=lambda: bytearray(ENCAPSULATION))
    fields: dict[str, tuple[str, int]] = field(default_factory=dict)

    def _aligned(self, size: int) -> None:
        self.data.extend(bytes(-(len(self.data) - len(ENCAPSULATION)) % size))

    def number(self, kind: str, value: int = 0, *, name: str | None = None) -> None:
        """Append an integer.

        Args:
            kind: numpy format, "<u4", "<i4" or "u1".
            value: the integer, default 0.
            name: name of the field that it becomes; None for no field.
        """
        size = int(kind[-1])
        self._aligned(size)
        if name is not None:
            self.fields[name] = (kind, len(self.data))
        self.data += value.to_bytes(size, "little", signed=kind[-2] == "i")

    def doubles(self, count: int, *, name: str) -> None:
        """Append float64 zeros as one field, without a length prefix.

        Args:
            count: number of zeros.
            name: name of the field.
        """
        self._aligned(8)
        self.fields[name] = (f"({count},)<f8", len(self.data))
        self.data += bytes(8 * count)

    def double_sequence(self, count: int, *, name: str) -> None:
        """Append a sequence of float64 zeros with a length prefix.

        Args:
            count: number of zeros.
            name: name of the field.
        """
        self.number("<u4", count)
        if count:
            self.doubles(count, name=name)

    def string(self, text: str) -> None:
        """Append a string.

        Args:
            text: any text; NUL is removed, since it ends a CDR string.
        """
        content = text.replace("\0", "").encode() + b"\0"
        self.number("<u4", len(content))
        self.data += content

    def stamp(self, name: str, time_ns: int = 0) -> None:
        """Append a time as two fields, `name.sec` and `name.nanosec`.

        Args:
            name: beginning of the fields' names.
            time_ns: time, ns, default 0.
        """
        seconds, rest = divmod(time_ns, 1_000_000_000)
        self.number("<i4", seconds, name=f"{name}.sec")
        self.number("<u4", rest, name=f"{name}.nanosec")


def texts_in(data: bytes, place: int, count: int) -> list[str]:
    """Return the strings of a message that follow each other.

    Args:
        data: message in CDR.
        place: end of what precedes them.
        count: number of strings.

    Raises:
        struct.error: the message ends before.
    """
    texts = []
    for _ in range(count):
        place += -(place - len(ENCAPSULATION)) % 4
        (length,) = struct.unpack_from("<I", data, place)
        place += 4 + length
        texts.append(data[place - length : place].rstrip(b"\0").decode())
    return texts


def joint_state(names: Sequence[str], *, velocities: bool) -> Message:
    """Return sensor_msgs/JointState.

    Its fields are `stamp.*`, `position` and, if requested, `velocity`.

    Args:
        names: names of the joints.
        velocities: True for a field `velocity`.
    """
    message = Message()
    message.stamp("stamp")
    message.string("")
    message.number("<u4", len(names))
    for name in names:
        message.string(name)
    message.double_sequence(len(names), name="position")
    message.double_sequence(len(names) if velocities else 0, name="velocity")
    message.double_sequence(0, name="effort")
    return message


def transforms(frames: Sequence[tuple[str, str]]) -> Message:
    """Return tf2_msgs/TFMessage for (parent, child) frames.

    Fields of the i-th transform: `i.stamp.*`, and `i.pose` with x, y, z and the quaternion's x, y, z, w.

    Args:
        frames: parent and child of each transform.
    """
    message = Message()
    message.number("<u4", len(frames))
    for i, (parent, child) in enumerate(frames):
        message.stamp(f"{i}.stamp")
        message.string(parent)
        message.string(child)
        message.doubles(7, name=f"{i}.pose")
    return message


def string(text: str) -> bytes:
    """Return std_msgs/String.

    Args:
        text: content of the message.
    """
    message = Message()
    message.string(text)
    return bytes(message.data)


@dataclass(frozen=True)
class Event:
    """An event of a run.

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
    """Return an event as rcl_interfaces/Log.

    The cause is in `function`, and its figures, as JSON, in `file`, which survive all tools that copy messages.

    Args:
        event: the event.
    """
    message = Message()
    message.stamp("stamp", round(event.time * 1e9))
    message.number("u1", LEVELS[event.level])
    for part in (event.name, event.text, json.dumps(plain(event.figures)) if event.cause else "", event.cause):
        message.string(part)
    message.number("<u4")
    return bytes(message.data)


def logged_event(time: float, data: bytes) -> Event:
    """Return the event in an rcl_interfaces/Log message.

    Args:
        time: s.
        data: message in CDR.

    Raises:
        LookupError, struct.error, ValueError: the message has a different layout.
    """
    level = _LEVEL_NAMES.get(data[_LEVEL], "info")
    name, words, figures, cause = texts_in(data, _LEVEL + 1, 4)
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
    return "".join([definition, *(f"{'=' * 80}\nMSG: {name}\n{_PARTS[name]}" for name in names)]).encode()


_JOINT_STATE = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
_LOG = (
    "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\n"
    "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\n"
    "uint32 line\n"
)
JOINT_STATE = (
    "sensor_msgs/msg/JointState",
    _with_parts(_JOINT_STATE, "std_msgs/Header", "builtin_interfaces/Time"),
)
TF_MESSAGE = (
    "tf2_msgs/msg/TFMessage",
    _with_parts(
        "geometry_msgs/TransformStamped[] transforms\n",
        "geometry_msgs/TransformStamped", "std_msgs/Header", "builtin_interfaces/Time",
        "geometry_msgs/Transform", "geometry_msgs/Vector3", "geometry_msgs/Quaternion",
    ),
)  # fmt: skip
CONTROL_NAME = "dpcontrol_msgs/msg/Control"
EXTRAS_NAME = "dpcontrol_msgs/msg/Extras"
STRING = ("std_msgs/msg/String", b"string data\n")
LOG = ("rcl_interfaces/msg/Log", _with_parts(_LOG, "builtin_interfaces/Time"))


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
_LEVEL_NAMES = {number: name for name, number in LEVELS.items()}

FORMAT = "2"
"""Version of the layout: increased when topics, messages or metadata change their meaning."""

LAYOUT_RECORD = "dpcontrol.layout"
RUN_RECORD = "dpcontrol.run"
RESULT_RECORD = "dpcontrol.result"
RECOVERY_RECORD = "dpcontrol.recovery"
"""Names of the metadata records: layout, the caller's metadata, result of the run (at the end), and losses of a
recovered log."""

EXTRAS_KEY = "extras"
"""Key of the layout record: names of the estimated parameters, if the log has any."""
TICKS = "ticks"
"""Key of the result record: number of ticks of the run."""
LOST = "lost"
"""Key of the recovery record: a sentence on the losses; empty if nothing was lost."""

PARTS = ("rates", "estimate", "reference", "truth", "control")
"""Optional parts of a tick; a log has each part in every tick or in none."""
_FIELDS = ("position", "velocity")
STATE_TOPICS = {"estimate": ESTIMATE, "reference": REFERENCE, "truth": TRUTH}

RECORD_HEADER = np.dtype(
    [
        ("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)  # fmt: skip
"""An MCAP message record up to its data: packed, little-endian (MCAP specification, "Message")."""
MESSAGE_OPCODE = 5
LENGTH_FROM = 9
"""Bytes of a record that its length does not include."""

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
    size = 2 * arms + (2 if has_cart else 0)
    return (*_CONTROL_HEAD, *(f"sigma_{i + 1}" for i in range(size)))


def state_names(arms: int, *, has_cart: bool) -> tuple[str, ...]:
    """Return the names of the state's entries in order.

    The names are `angle_1 …`, `rate_1 …`, then the cart's.

    Args:
        arms: number of arms.
        has_cart: True if the rig has a cart.
    """
    arms_part = tuple(f"{what}_{i + 1}" for what in ("angle", "rate") for i in range(arms))
    return arms_part + (("cart_position", "cart_velocity") if has_cart else ())


@dataclass(frozen=True)
class TickLayout:
    """Messages of a tick in order of writing, and the channels.

    Attributes:
        arms: number of arms.
        has_cart: True if the pivot is on a cart.
        parts: members of `PARTS` that the log has.
        extras: names of the estimated parameters, in the estimator's order.
    """

    arms: int
    has_cart: bool
    parts: frozenset[str]
    extras: tuple[str, ...] = ()

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return joint_names(self.arms, has_cart=self.has_cart)

    @cached_property
    def fields(self) -> tuple[str, ...]:
        """Names of the control message's fields."""
        return control_fields(self.arms, has_cart=self.has_cart)

    @cached_property
    def widths(self) -> dict[str, int]:
        """Row widths of measured positions, parts and extras, by name."""
        joints = len(self.names)
        widths = dict.fromkeys(("measured", *PARTS), 2 * joints)
        widths |= {"measured": joints, "rates": joints, "control": len(self.fields)}
        return widths | ({"extras": 2 * len(self.extras)} if self.extras else {})

    @cached_property
    def rooms(self) -> tuple[tuple[str, str, slice, str, slice], ...]:
        """Places of the numbers in messages and rows.

        Each has topic, field and joints of its message, part ("measured" or of `PARTS`) and columns.

        All are slices, because indexing by number is too slow for the few ticks of a chunk.
        """
        n, every = self.arms, slice(None)
        arms = (slice(n), slice(n), slice(n, 2 * n))
        cart = (slice(n, n + 1), slice(2 * n, 2 * n + 1), slice(2 * n + 1, 2 * n + 2))
        found = [
            (MEASURED, "position", every, "measured", every),
            (MEASURED, "velocity", every, "rates", every),
            (CONTROL, "row", every, "control", every),
        ]
        for (part, topic), (joints, *columns) in product(STATE_TOPICS.items(), (arms, cart)[: 1 + self.has_cart]):
            found += [(topic, name, joints, part, place) for name, place in zip(_FIELDS, columns, strict=True)]
        return tuple(room for room in found if room[3] in {"measured", *self.parts})

    @cached_property
    def messages(self) -> dict[str, Message]:
        """Message of each topic, in the order of writing."""
        state = joint_state(self.names, velocities=True)
        found = {MEASURED: joint_state(self.names, velocities="rates" in self.parts)}
        found |= {topic: state for part, topic in STATE_TOPICS.items() if part in self.parts}
        if "control" in self.parts:
            found[CONTROL] = Message()
            found[CONTROL].doubles(len(self.fields), name="row")
        return found

    @cached_property
    def extras_message(self) -> Message:
        """Message of /estimate/extras, as field "row": all standard deviations, then all values."""
        message = Message()
        message.doubles(2 * len(self.extras), name="row")
        return message

    @cached_property
    def schemas(self) -> dict[str, tuple[str, bytes]]:
        """Name and definition of each topic's message, in channel order."""
        found: dict[str, tuple[str, bytes]] = dict.fromkeys(self.messages, JOINT_STATE)
        if CONTROL in found:
            found[CONTROL] = (CONTROL_NAME, "".join(f"float64 {name}\n" for name in self.fields).encode())
        found |= {TRANSFORMS: TF_MESSAGE, EVENTS: LOG, ROBOT: STRING}
        if "reference" in self.parts:
            found[GHOST] = STRING
        if self.extras:
            # ROS 2 requires field names in lower case.
            fields = (f"float64 {of}{name.lower()}\n" for of in ("sigma_", "") for name in self.extras)
            found[EXTRAS] = (EXTRAS_NAME, "".join(fields).encode())
        return found

    @cached_property
    def kinds(self) -> dict[str, str]:
        """Type of each topic's messages."""
        return {topic: kind for topic, (kind, _) in self.schemas.items()}

    @cached_property
    def channels(self) -> dict[str, int]:
        """Channel number of each topic."""
        return {topic: number for number, topic in enumerate(self.schemas, start=1)}

    @cached_property
    def block_type(self) -> np.dtype:
        """Structured type of a tick: a field for each topic, in order."""
        return np.dtype([(topic, record_type(message)) for topic, message in self.messages.items()])

    @cached_property
    def block_offsets(self) -> dict[str, int]:
        """Byte offset of each topic's message within a tick."""
        return {topic: int(self.block_type.fields[topic][1]) for topic in self.messages}  # type: ignore[index]

    @cached_property
    def block_template(self) -> bytes:
        """Message records of a tick, with times and numbers zero."""
        records = []
        for topic, message in self.messages.items():
            header = np.zeros(1, RECORD_HEADER)
            header["opcode"] = MESSAGE_OPCODE
            header["length"] = RECORD_HEADER.itemsize - LENGTH_FROM + len(message.data)
            header["channel"] = self.channels[topic]
            records.append(header.tobytes() + message.data)
        return b"".join(records)


def extras_of(described: Mapping[str, str]) -> tuple[str, ...]:
    """Return the names of the estimated parameters.

    Args:
        described: values of the layout record.
    """
    return tuple(described.get(EXTRAS_KEY, "").split())


def record_type(message: Message) -> np.dtype:
    """Return the structured type of the record of `message`.

    Args:
        message: message with its fields.
    """
    places = {name: (kind, offset) for name, (kind, offset, *_) in RECORD_HEADER.fields.items()}  # type: ignore[union-attr]
    places |= {name: (kind, RECORD_HEADER.itemsize + offset) for name, (kind, offset) in message.fields.items()}
    formats, offsets = zip(*places.values(), strict=True)
    size = RECORD_HEADER.itemsize + len(message.data)
    return np.dtype({"names": list(places), "formats": formats, "offsets": offsets, "itemsize": size})


RETURN, FLIGHT, RESUME, LAP, CATCH = "return", "flight", "resume", "lap", "catch"
"""Names of the events for leaving and rejoining the itinerary."""


class Stretch(NamedTuple):
    """Ticks `first` to `end` of a run on its itinerary.

    They start at time `at` s of the planned reference.
    """

    first: int
    end: int
    at: float
