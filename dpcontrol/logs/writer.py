"""Write a log of ticks and events.

`ticks` writes periods of the loop, `event` everything between them.

One writer serves simulation, rig, import and replay. A tick requires only the measured positions. Rates, estimate,
reference, truth and control are each present in every tick of a log or in none; the first tick decides.
A log has one rate. Slower signals are events, or are repeated in each tick. Times may jump forward.

Ticks are collected as rows of numbers and converted to messages about every twenty milliseconds, so a killed run loses
no more than that. The file grows as `NAME.mcap.partial` and is renamed when it is complete and on the disk.

The layout and the arms' descriptions for viewers precede the first tick. Both depend on the contents of a tick, which
are known from the first one on (`layout.TickLayout`).

Apart from its numbers, every message's bytes are known in advance. A block of K ticks is therefore one numpy structured
array of K copies of a template, filled column by column.

For viewers of ROS 2 logs the arms are described as a URDF, with the poses of its links. The plane of motion is x to the
right and z up, seen along +y. A joint's coordinate is the arm's *absolute* angle from hanging, counter-clockwise. At
each elbow a link turns back by the inner arm's angle (a mimic joint with multiplier -1), so the next arm hangs at zero.
Source: the URDF specification (joint, mimic, origin).
"""

import json
import struct
from collections.abc import Mapping, Sequence
from contextlib import suppress
from io import FileIO
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import checked_target, unwritable
from dpcontrol.foundation.version import PROGRAM
from dpcontrol.logs import layout
from dpcontrol.logs.container import McapFile, open_partial, sealed
from dpcontrol.logs.layout import Event, TickLayout

WORLD = "world"
_THICKNESS = 0.012
_INK = {
    "robot": {
        "track": "0.45 0.45 0.47 1",
        "cart": "0.20 0.22 0.26 1",
        "arm": "0.10 0.42 0.72 1",
        "tip": "0.90 0.45 0.10 1",
    },
    "ghost": dict.fromkeys(("track", "cart", "arm", "tip"), "0.6 0.6 0.6 0.35"),
}


def link_frames(arms: int, *, has_cart: bool, prefix: str = "") -> tuple[tuple[str, str], ...]:
    """Return (parent, child) of every moving frame.

    The order is that of `link_poses`, starting with `world` to base.

    Args:
        arms: number of arms.
        has_cart: True if the pivot is on a cart.
        prefix: beginning of all names but `world`.
    """
    names = ["base", *(["cart_link"] if has_cart else [])]
    for i in range(1, arms + 1):
        names += [f"arm_{i}_link", f"elbow_{i}_link"]
    chain = [WORLD, *(prefix + name for name in names[:-1])]
    return tuple(pairwise(chain))


def link_poses(states: NDArray[np.float64], *, arm_lengths: Sequence[float], has_cart: bool) -> NDArray[np.float64]:
    """Return the pose of each of `link_frames` in its parent.

    Args:
        states: (K, 2n+2), or (K, 2n) without a cart; rad, rad/s, m, m/s.
        arm_lengths: (n,), m.
        has_cart: True if the pivot is on a cart.

    Returns:
        (K, F, 7): x, y, z in m and the quaternion's x, y, z, w.
    """
    arms = len(arm_lengths)
    first = 1 + has_cart
    half = states[:, :arms] / 2
    sine, cosine = np.sin(half), np.cos(half)
    found = np.zeros((len(states), first + 2 * arms - 1, 7))
    found[:, :first, 6] = 1.0
    if has_cart:
        found[:, 1, 0] = states[:, 2 * arms]
    # Counter-clockwise with x right and z up is a turn about -y; arms and elbows alternate.
    found[:, first::2, 4], found[:, first::2, 6] = -sine, cosine
    found[:, first + 1 :: 2, 4], found[:, first + 1 :: 2, 6] = sine[:, :-1], cosine[:, :-1]
    found[:, first + 1 :: 2, 2] = -np.asarray(arm_lengths[:-1])
    return found


def robot_description(
    arm_lengths: Sequence[float],
    *,
    has_cart: bool = True,
    limits: tuple[float, float, float] | None = None,
    prefix: str = "",
    ghost: bool = False,
) -> str:
    """Return the URDF of the pendulum.

    Args:
        arm_lengths: (n,) in m.
        has_cart: True for a cart on a track.
        limits: of position m, velocity m/s, acceleration m/s².
        prefix: of all names.
        ghost: True for grey arms without track.
    """
    reach, speed = (limits[0], limits[1]) if limits else (max(sum(arm_lengths), 0.1), 3.0)
    ink = _INK["ghost" if ghost else "robot"]
    # The ghost swings just behind the robot; in one plane the two would flicker.
    depth = 1.5 * _THICKNESS if ghost else 0.0
    frames = link_frames(len(arm_lengths), has_cart=has_cart, prefix=prefix)
    visuals = _visuals(arm_lengths, reach=reach, drawn=not ghost and has_cart, has_cart=has_cart)
    rail = f'<limit lower="{-reach:g}" upper="{reach:g}" velocity="{speed:g}" effort="0"/>'
    joints = [("prismatic", f'<axis xyz="1 0 0"/>{rail}')] if has_cart else []
    for i, length in enumerate(arm_lengths, start=1):
        origin = f'<origin xyz="0 0 {-length:g}" rpy="0 0 0"/>'
        mimic = f'<mimic joint="{prefix}arm_{i}" multiplier="-1" offset="0"/>'
        joints += [("continuous", _AXIS), ("continuous", origin + _AXIS + mimic)]
    lines = ['<?xml version="1.0"?>', f'<robot name="{"reference_" if ghost else ""}pendulum">']
    lines += [f'  <material name="{prefix}{part}"><color rgba="{colour}"/></material>' for part, colour in ink.items()]
    for (_, link), shapes in zip(frames, visuals, strict=True):
        drawn = [
            f'    <visual><origin xyz="{x:g} {y + depth:g} {z:g}" rpy="{turn}"/><geometry>{shape}</geometry>'
            f'<material name="{prefix}{part}"/></visual>'
            for (shape, turn), (x, y, z), part in shapes
        ]
        lines += [f'  <link name="{link}">', *drawn, "  </link>"]
    for (parent, child), (kind, body) in zip(frames[1:], joints, strict=False):
        ends = f'<parent link="{parent}"/><child link="{child}"/>'
        lines.append(f'  <joint name="{child.removesuffix("_link")}" type="{kind}">{ends}{body}</joint>')
    return "\n".join([*lines, "</robot>"]) + "\n"


_AXIS = '<axis xyz="0 -1 0"/>'
_Visual = tuple[tuple[str, str], tuple[float, float, float], str]
"""Shape and its turn, place (x, y, z) in m, and the material."""


def _box(x: float, y: float, z: float) -> tuple[str, str]:
    return f'<box size="{x:g} {y:g} {z:g}"/>', "0 0 0"


def _disc(radius: float) -> tuple[str, str]:
    return f'<cylinder radius="{radius:g}" length="{1.4 * _THICKNESS:g}"/>', "1.5707963 0 0"


def _visuals(arm_lengths: Sequence[float], *, reach: float, drawn: bool, has_cart: bool) -> list[list[_Visual]]:
    """Return the shapes of each link, of the track only if it is drawn."""
    wide, stop, hub = 0.06, reach + 0.05, _disc(1.3 * _THICKNESS)
    track: list[_Visual] = [(_box(2 * reach + 0.1, wide, 0.01), (0, 0.06, -0.02), "track")]
    track += [(_box(_THICKNESS, wide, 0.03), (x, 0.06, 0), "track") for x in (-stop, stop)]
    cart: list[_Visual] = [
        (_box(0.1, wide, 0.03), (0, 0.06, 0), "cart"),
        (_disc(0.6 * _THICKNESS), (0, 0.02, 0), "cart"),
    ]
    found = [track if drawn else [], *([cart] if has_cart else [])]
    for i, length in enumerate(arm_lengths):
        # Each arm swings in front of the previous one, as on the rig, so it is drawn in full.
        y = -1.6 * _THICKNESS * i
        end = "tip" if i + 1 == len(arm_lengths) else "cart"
        arm = (_box(1.6 * _THICKNESS, _THICKNESS, length), (0, y, -length / 2), "arm")
        found += [[arm, (hub, (0, y, 0), "cart"), (hub, (0, y, -length), end)], []]
    return found[:-1]


REFERENCE_PREFIX = "reference/"
_SECOND = 1_000_000_000
_HEAD = struct.Struct("<BQHIQQ")
Row = NDArray[np.float64]


class Note(NamedTuple):
    """A single message before the tick in `row` of the chunk.

    Its time is in ns.
    """

    row: int
    topic: str
    time_ns: int
    content: bytes


class ChunkEncoder:
    """Encodes the chunks of a log in order.

    Args:
        tick: layout of the ticks.
        arm_lengths: (n,) in m.
    """

    def __init__(self, tick: TickLayout, arm_lengths: Sequence[float]):
        self.tick = tick
        self._lengths = tuple(arm_lengths)
        self._counts = dict.fromkeys(tick.channels, 0)
        self._ticks = 0
        prefixes = ("", REFERENCE_PREFIX) if "reference" in tick.parts else ("",)
        frames = [
            frame for prefix in prefixes for frame in link_frames(tick.arms, has_cart=tick.has_cart, prefix=prefix)
        ]
        self._transforms = layout.transforms(frames)
        self._transforms_type = layout.record_type(self._transforms)
        self._last_due = -1

    def encode(self, times: NDArray[np.int64], rows: Mapping[str, Row], notes: Sequence[Note]) -> bytes:
        """Return the bytes of a chunk.

        Messages are in order of arrival.

        Args:
            times: (K,) of the ticks, ns.
            rows: (K, width) of the measured positions and of each logged part.
            notes: single messages to insert.
        """
        block, due = self._fill(times, rows), self._due(times)
        slow = [*self._transform_notes(due, times, rows), *self._extra_notes(due, times, rows)]
        pieces, done = [], 0
        for note in sorted([*notes, *slow], key=lambda note: note.row):
            pieces += [block[done : note.row].tobytes(), self._record(note)]
            done = note.row
        return b"".join([*pieces, block[done:].tobytes()])

    def _fill(self, times: NDArray[np.int64], rows: Mapping[str, Row]) -> NDArray:
        """Return the messages of ticks: copies of the template with numbers."""
        tick, count = self.tick, len(times)
        block = np.frombuffer(bytearray(tick.block_template * count), tick.block_type)
        seconds, nanoseconds = np.divmod(times, _SECOND)
        for topic, message in tick.messages.items():
            records = block[topic]
            records["sequence"] = np.arange(self._ticks, self._ticks + count)
            records["log_time"] = records["publish_time"] = times
            if "stamp.sec" in message.fields:
                records["stamp.sec"], records["stamp.nanosec"] = seconds, nanoseconds
        for topic, field, joints, part, columns in tick.rooms:
            block[topic][field][:, joints] = rows[part][:, columns]
        self._ticks += count
        return block

    def _robot(self, rows: Mapping[str, Row]) -> Row:
        """Return the states for /tf.

        Truth, estimate or measured positions, in that order of preference.
        """
        measured, arms = rows["measured"], self.tick.arms
        states = np.zeros((len(measured), self.tick.widths["truth"]))
        states[:, :arms], states[:, 2 * arms : 2 * arms + 1] = measured[:, :arms], measured[:, arms:]
        return rows.get("truth", rows.get("estimate", states))

    def _due(self, times: NDArray[np.int64]) -> list[int]:
        """Return the rows at which messages of the slow rate are due."""
        numbers = slow_numbers(times)
        chosen = np.flatnonzero(np.diff(numbers, prepend=self._last_due) > 0).tolist()
        self._last_due = max(numbers.tolist(), default=self._last_due)
        return chosen

    def _extra_notes(self, chosen: list[int], times: NDArray[np.int64], rows: Mapping[str, Row]) -> list[Note]:
        if "extras" not in rows:
            return []
        numbers = rows["extras"].astype("<f8", copy=False)
        return [
            Note(row, layout.EXTRAS, int(times[row]), layout.ENCAPSULATION + numbers[row].tobytes()) for row in chosen
        ]

    def _transform_notes(self, chosen: list[int], times: NDArray[np.int64], rows: Mapping[str, Row]) -> list[Note]:
        robots = [self._robot(rows)] + ([rows["reference"]] if "reference" in rows else [])
        states = np.concatenate([robot[chosen] for robot in robots], axis=1)
        # Readers of transforms reject poses that are not finite.
        is_finite = np.isfinite(states).all(axis=1)
        chosen, states = np.array(chosen, int)[is_finite].tolist(), states[is_finite]
        if not chosen:
            return []
        states = states.reshape(len(chosen) * len(robots), -1)
        poses = link_poses(states, arm_lengths=self._lengths, has_cart=self.tick.has_cart)
        seconds, nanoseconds = np.divmod(times[chosen], _SECOND)
        template = bytes(layout.RECORD_HEADER.itemsize) + self._transforms.data
        records = np.frombuffer(bytearray(template * len(chosen)), self._transforms_type)
        for i, pose in enumerate(poses.reshape(len(chosen), -1, 7).swapaxes(0, 1)):
            records[f"{i}.stamp.sec"], records[f"{i}.stamp.nanosec"] = seconds, nanoseconds
            records[f"{i}.pose"] = pose
        return [
            Note(row, layout.TRANSFORMS, time, record.tobytes()[layout.RECORD_HEADER.itemsize :])
            for row, time, record in zip(chosen, times[chosen].tolist(), records, strict=True)
        ]

    def _record(self, note: Note) -> bytes:
        length = layout.RECORD_HEADER.itemsize - layout.LENGTH_FROM + len(note.content)
        number, channel = self._counts[note.topic], self.tick.channels[note.topic]
        self._counts[note.topic] += 1
        return _HEAD.pack(layout.MESSAGE_OPCODE, length, channel, number, note.time_ns, note.time_ns) + note.content


def slow_numbers(times: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number of the last slow message due at each time.

    Numbers count from 0.

    Args:
        times: times (K,), ns.
    """
    return np.floor(times * (layout.SLOW_RATE / _SECOND) + 1e-6).astype(np.int64)


CHUNK_SECONDS = 0.02
"""Duration of a chunk, s. A killed run loses at most this much and one tick."""


class LogWriter:
    """Writes one log, as a context manager.

    Leaving the block normally completes the file and renames it. Leaving it by an exception keeps the written part as
    `NAME.mcap.partial`, and adds a note to the exception that names `dpcontrol recover`.

    Args:
        path: the log, by convention `*.mcap`. An older one is replaced when this one is complete.
        arm_lengths: (n,) in m.
        rate_hz: rate of the loop in Hz.
        has_cart: True if the pivot is on a cart. Without one, states have 2n and measurements n entries.
        limits: the cart's greatest distance from the centre in m, velocity in m/s, acceleration in m/s².
        extras: names of the estimated parameters, if `ticks` receives them.
        metadata: text by name that identifies the run: version, commit, seed, hashes.
        attachments: content by file name: scene, model, reference.

    Raises:
        InputError: the file cannot be written.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        arm_lengths: Sequence[float],
        rate_hz: float,
        has_cart: bool = True,
        limits: tuple[float, float, float] | None = None,
        extras: Sequence[str] = (),
        metadata: Mapping[str, str] | None = None,
        attachments: Mapping[str, bytes] | None = None,
    ):
        self.path = Path(path)
        self._lengths = tuple(float(length) for length in arm_lengths)
        self._has_cart = has_cart
        self._limits = limits
        self._metadata = sealed(layout.RUN_RECORD, dict(metadata or {}))
        self._attachments = dict(attachments or {})
        self._rate = float(rate_hz)
        self.extras = tuple(extras)
        tick = TickLayout(len(self._lengths), has_cart, frozenset(layout.PARTS), self.extras)
        self._size, self._filled, self._last = max(1, round(CHUNK_SECONDS * self._rate)), 0, 0.0
        # The first tick decides which of these parts the log has.
        self._parts: frozenset[str] | None = None
        self._rooms = {name: np.zeros((self._size, width)) for name, width in tick.widths.items()}
        self._times = np.zeros(self._size)
        self._ticks = 0
        self._notes: list[Note] = []
        self._result: dict[str, str] = {}
        self._encoder: ChunkEncoder | None = None
        self._file: McapFile | None = None
        self._stream: FileIO | None = None

    def __enter__(self) -> "LogWriter":
        try:
            self.path = checked_target(self.path)
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.partial, self._stream = open_partial(self.path)
            self._file = McapFile(self._stream, library=PROGRAM)
            self._file.add_metadata(layout.RUN_RECORD, self._metadata)
            for name, data in self._attachments.items():
                self._file.add_attachment(name, data)
        except OSError as error:
            self._discard()
            raise unwritable(self.path, error) from error
        return self

    def _discard(self) -> None:
        """Remove a file without ticks."""
        if self._stream is not None:
            self._stream.close()
            self.partial.unlink(missing_ok=True)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is None:
            return
        try:
            if error is None:
                self._finish(self._file)
            else:
                self._give_up(error)
        except OSError as failure:
            raise unwritable(self.path, failure) from failure
        finally:
            self._file.stream.close()
            self._file = None

    def _finish(self, file: McapFile) -> None:
        if self._encoder is None:
            self._encoder = self._prepare(file)
        self._write_chunk()
        values = {**self._result, layout.TICKS: str(self._ticks)}
        file.add_metadata(layout.RESULT_RECORD, sealed(layout.RESULT_RECORD, values))
        file.finish()
        self.partial.replace(self.path)

    def _give_up(self, error: BaseException) -> None:
        """Keep the written part and note its path."""
        if self._encoder is None and not self._filled:
            # A run that failed before its first tick leaves nothing to keep.
            self._discard()
            return
        # If this also fails, the current exception already reports the first error.
        with suppress(InputError):
            self._write_chunk()
        error.add_note(
            f"{self.partial} keeps the run up to {self._last:.3f} s at most; "
            f"`dpcontrol recover {self.partial}` makes a log of it"
        )

    def ticks(
        self,
        time_s: ArrayLike,
        *,
        measured: Row,
        rates: Row | None = None,
        estimate: Row | None = None,
        reference: Row | None = None,
        truth: Row | None = None,
        control: Row | None = None,
        extras: Row | None = None,
    ) -> None:
        """Log K periods of the loop.

        Every tick of a log has the same parts; only `measured` is required.

        Args:
            time_s: (K,) times since the start in s, not before the last tick's time.
            measured: (K, n+1) positions from the sensors, rad, and m for the cart.
            rates: (K, n+1) rates from the sensors, rad/s and m/s, if available.
            estimate: (K, 2n+2) in state order: rad, rad/s, m, m/s.
            reference: (K, 2n+2) in the same units.
            truth: (K, 2n+2) states of the plant, in the same units.
            control: (K, 13) for a double pendulum on a cart: rows of `layout.control_fields`.
            extras: (K, 2E) standard deviations of the E extras given to the constructor, then their values.

        Raises:
            ValueError: rows of another shape, times that decrease, or a part in some ticks only.
            InputError: the file cannot be written.
        """
        times = np.asarray(time_s, float)
        given = {
            "measured": measured, "rates": rates, "estimate": estimate, "reference": reference, "truth": truth,
            "control": control, "extras": extras,
        }  # fmt: skip
        rows = {name: values for name, values in given.items() if values is not None}
        if (np.diff(times, prepend=self._last) < 0).any():
            raise ValueError("the times of ticks must not decrease")
        if self._parts is not None and self._parts != rows.keys():
            raise ValueError(f"{', '.join(self._parts ^ rows.keys())} must be given in every tick of a run or in none")
        self._parts, done = frozenset(rows), 0
        while done < len(times):
            count = min(self._size - self._filled, len(times) - done)
            into, taken = slice(self._filled, self._filled + count), slice(done, done + count)
            self._times[into] = times[taken]
            for name, values in rows.items():
                self._rooms[name][into] = values[taken]
            self._filled, self._last, done = self._filled + count, float(times[done + count - 1]), done + count
            if self._filled == self._size:
                self._write_chunk()

    def result(self, **values: str) -> None:
        """Add results as metadata at the end of the log.

        They may differ when the run is repeated.

        Args:
            **values: results by name.
        """
        self._result.update(values)

    def event(self, event: Event) -> None:
        """Log an event.

        Args:
            event: the event.
        """
        self._notes.append(Note(self._filled, layout.EVENTS, round(event.time * 1e9), layout.log(event)))

    def _prepare(self, file: McapFile) -> ChunkEncoder:
        # This waits for the first chunk, because the contents of a tick are unknown before.
        parts = (self._parts or frozenset()) & set(layout.PARTS)
        tick = TickLayout(len(self._lengths), self._has_cart, parts, self.extras)
        described = {
            "format": layout.FORMAT,
            "arm_lengths": " ".join(repr(length) for length in self._lengths),
            "has_cart": "1" if tick.has_cart else "0",
            "rate_hz": repr(self._rate),
            "limits": " ".join(repr(float(limit)) for limit in self._limits or ()),
            "parts": " ".join(part for part in layout.PARTS if part in tick.parts),
            "attachments": json.dumps(list(self._attachments)),
            "program": PROGRAM,
            **({layout.EXTRAS_KEY: " ".join(tick.extras)} if tick.extras else {}),
        }
        file.add_metadata(layout.LAYOUT_RECORD, sealed(layout.LAYOUT_RECORD, described))
        file.add_channels(tick)
        first = round(self._times[0] * 1e9)
        for topic in (topic for topic in tick.channels if topic in layout.LATCHED):
            ghost = topic == layout.GHOST
            prefix = REFERENCE_PREFIX if ghost else ""
            text = robot_description(
                self._lengths, has_cart=tick.has_cart, limits=self._limits, prefix=prefix, ghost=ghost
            )
            self._notes.insert(0, Note(0, topic, first, layout.string(text)))
        return ChunkEncoder(tick, self._lengths)

    def _write_chunk(self) -> None:
        if self._file is None:
            raise ValueError(f"the log {self.path} is not open: use LogWriter in a with statement")
        count = self._filled
        if not count and not self._notes:
            return
        times = np.rint(self._times[:count] * 1e9).astype(np.int64)
        rows = {name: self._rooms[name][:count] for name in self._parts or {"measured"}}
        try:
            if self._encoder is None:
                self._encoder = self._prepare(self._file)
            self._file.add_chunk(self._encoder.encode(times, rows, self._notes))
        except OSError as error:
            raise unwritable(self.path, error) from error
        self._notes.clear()
        self._ticks += count
        self._filled = 0
