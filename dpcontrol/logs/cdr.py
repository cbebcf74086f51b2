"""Messages in CDR, the serialisation of ROS 2, built once as templates and then patched.

Every message here has a fixed length as long as its names and counts do not change, so a template of bytes and
the offsets of its numbers describe it completely; numpy writes and reads whole blocks of messages through them.
Numbers are little-endian and aligned to their own size, counted from the end of the four-byte header.
Source: OMG DDS-RTPS 2.3, section 10 (CDR, representation identifier CDR_LE).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

ENCAPSULATION = b"\x00\x01\x00\x00"
"""The first four bytes of every message."""


@dataclass(frozen=True)
class MessageLayout:
    """A message of fixed length.

    Attributes:
        template: the whole message, numbers zero.
        fields: for each number that changes, its numpy format and its offset in bytes.
    """

    template: bytes
    fields: dict[str, tuple[str, int]]


@dataclass
class CdrBuilder:
    """Appends values in order, with CDR's alignment."""

    data: bytearray = field(default_factory=lambda: bytearray(ENCAPSULATION))
    fields: dict[str, tuple[str, int]] = field(default_factory=dict)

    def _aligned(self, size: int) -> None:
        self.data.extend(bytes(-(len(self.data) - len(ENCAPSULATION)) % size))

    def number(self, kind: str, value: int = 0, *, name: str | None = None) -> None:
        """Append an integer of numpy format `kind` ("<u4", "<i4", "u1"), noted as a field if `name` is given."""
        size = int(kind[-1])
        self._aligned(size)
        if name is not None:
            self.fields[name] = (kind, len(self.data))
        self.data += value.to_bytes(size, "little", signed=kind[-2] == "i")

    def doubles(self, count: int, *, name: str) -> None:
        """Append `count` float64 zeros as one field, without a count in front."""
        self._aligned(8)
        self.fields[name] = (f"({count},)<f8", len(self.data))
        self.data += bytes(8 * count)

    def double_sequence(self, count: int, *, name: str) -> None:
        """Append a sequence of `count` float64 zeros; an empty one is only its count."""
        self.number("<u4", count)
        if count:
            self.doubles(count, name=name)

    def string(self, text: str) -> None:
        """Append a string; NUL ends a CDR string, so it is dropped from `text`."""
        content = text.replace("\0", "").encode() + b"\0"
        self.number("<u4", len(content))
        self.data += content

    def stamp(self, name: str) -> None:
        """Append a time as the fields `name.sec` and `name.nanosec`."""
        self.number("<i4", name=f"{name}.sec")
        self.number("<u4", name=f"{name}.nanosec")

    def layout(self) -> MessageLayout:
        """Return what was built."""
        return MessageLayout(template=bytes(self.data), fields=dict(self.fields))


def joint_state(names: Sequence[str], *, velocities: bool) -> MessageLayout:
    """Return the layout of sensor_msgs/JointState: fields `stamp.*`, `position` and, if asked, `velocity`."""
    builder = CdrBuilder()
    builder.stamp("stamp")
    builder.string("")
    builder.number("<u4", len(names))
    for name in names:
        builder.string(name)
    builder.double_sequence(len(names), name="position")
    builder.double_sequence(len(names) if velocities else 0, name="velocity")
    builder.double_sequence(0, name="effort")
    return builder.layout()


def transforms(frames: Sequence[tuple[str, str]]) -> MessageLayout:
    """Return the layout of tf2_msgs/TFMessage for (parent, child) frames.

    Fields of the i-th transform: `i.stamp.*`, and `i.pose` with x, y, z and the quaternion's x, y, z, w.
    """
    builder = CdrBuilder()
    builder.number("<u4", len(frames))
    for i, (parent, child) in enumerate(frames):
        builder.stamp(f"{i}.stamp")
        builder.string(parent)
        builder.string(child)
        builder.doubles(7, name=f"{i}.pose")
    return builder.layout()


def doubles(count: int) -> MessageLayout:
    """Return the layout of a message of `count` float64 fields: one field `row`."""
    builder = CdrBuilder()
    builder.doubles(count, name="row")
    return builder.layout()


def string(text: str) -> bytes:
    """Return std_msgs/String."""
    builder = CdrBuilder()
    builder.string(text)
    return bytes(builder.data)


def log(time_ns: int, level: int, *, name: str, text: str) -> bytes:
    """Return rcl_interfaces/Log at `time_ns`; file, function and line are left empty."""
    builder = CdrBuilder()
    builder.number("<i4", time_ns // 1_000_000_000)
    builder.number("<u4", time_ns % 1_000_000_000)
    builder.number("u1", level)
    builder.string(name)
    builder.string(text)
    builder.string("")
    builder.string("")
    builder.number("<u4", 0)
    return bytes(builder.data)


def read_log_message(data: bytes) -> tuple[int, str, str]:
    """Return level, name and text of an rcl_interfaces/Log message.

    Raises:
        ValueError: the message is not of that layout.
    """
    offset = len(ENCAPSULATION) + 9
    if len(data) < offset:
        raise ValueError("message too short")
    texts = []
    for _ in range(2):
        offset += -(offset - len(ENCAPSULATION)) % 4
        size = int.from_bytes(data[offset : offset + 4], "little")
        content = data[offset + 4 : offset + 4 + size]
        if len(content) != size or not content.endswith(b"\0"):
            raise ValueError("string runs over the message's end")
        texts.append(content[:-1].decode())
        offset += 4 + size
    return data[len(ENCAPSULATION) + 8], texts[0], texts[1]
