"""Write a log of ticks and events.

`ticks` writes periods of the loop, `event` everything between them.

One writer serves simulation, rig, import and replay. A tick requires only the measured positions. Rates, estimate,
reference, truth and control are each present in every tick of a log or in none; the first tick decides.
A log has one rate. Slower signals are events, or are repeated in each tick. Times may jump forward.

Ticks are collected as rows of numbers and converted to messages about every twenty milliseconds, or as many at once as
arrive together, up to a fifth of a second. A killed run loses no more than that. The file grows as
`NAME.mcap.partial` and is renamed when it is complete and on the disk.

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
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
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
from dpcontrol.logs.container import McapFile, open_partial

WORLD = "world"
REFERENCE_PREFIX = "reference/"
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
    """Return (parent, child) of every moving frame in the order of `link_poses`, from world to base onwards.

    Args:
        arms: number of arms.
        has_cart: True if the pivot is on a cart.
        prefix: beginning of all names but `world`.
    """
    names = ["base", *(["cart_link"] if has_cart else [])]
    names += [f"{part}_{i}_link" for i in range(1, arms + 1) for part in ("arm", "elbow")]
    chain = [WORLD, *(prefix + name for name in names[:-1])]
    return tuple(pairwise(chain))


def link_poses(states: NDArray[np.float64], *, arm_lengths: Sequence[float], has_cart: bool) -> NDArray[np.float64]:
    """Return the pose of each of `link_frames` in its parent, with which viewers draw the arms.

    Args:
        states: (K, 2n+2), or (K, 2n) without a cart; rad, rad/s, m, m/s.
        arm_lengths: (n,), m.
        has_cart: True if the pivot is on a cart.

    Returns:
        (K, F, 7) for F frames: x, y, z in m and the quaternion's x, y, z, w.
    """
    arms = len(arm_lengths)
    first_arm = 1 + has_cart
    half_angles = states[:, :arms] / 2
    sine, cosine = np.sin(half_angles), np.cos(half_angles)
    poses = np.zeros((len(states), first_arm + 2 * arms - 1, 7))
    poses[:, :first_arm, 6] = 1.0
    if has_cart:
        poses[:, 1, 0] = states[:, 2 * arms]
    # Counter-clockwise with x right and z up is a turn about -y; arms and elbows alternate.
    poses[:, first_arm::2, 4], poses[:, first_arm::2, 6] = -sine, cosine
    poses[:, first_arm + 1 :: 2, 4], poses[:, first_arm + 1 :: 2, 6] = sine[:, :-1], cosine[:, :-1]
    poses[:, first_arm + 1 :: 2, 2] = -np.asarray(arm_lengths[:-1])
    return poses


def robot_description(
    arm_lengths: Sequence[float],
    *,
    has_cart: bool = True,
    limits: tuple[float, float, float] | None = None,
    ghost: bool = False,
) -> str:
    """Return the URDF of the pendulum, from which viewers take the shapes of its links.

    Args:
        arm_lengths: (n,) in m.
        has_cart: True for a cart on a track.
        limits: of position m, velocity m/s, acceleration m/s².
        ghost: True for the reference: grey arms without track, whose names have a prefix.
    """
    prefix = REFERENCE_PREFIX if ghost else ""
    # URDF needs limits of the cart: without given ones, the track is as long as the arms on either side.
    track_end, speed = (limits[0], limits[1]) if limits else (max(sum(arm_lengths), 0.1), 3.0)
    colours = _INK["ghost" if ghost else "robot"]
    # The ghost swings just behind the robot; in one plane the two would flicker.
    depth = 1.5 * _THICKNESS if ghost else 0.0
    frames = link_frames(len(arm_lengths), has_cart=has_cart, prefix=prefix)
    visuals = _visuals(arm_lengths, reach=track_end, drawn=not ghost and has_cart, has_cart=has_cart)
    track_limit = f'<limit lower="{-track_end:g}" upper="{track_end:g}" velocity="{speed:g}" effort="0"/>'
    joints = [("prismatic", f'<axis xyz="1 0 0"/>{track_limit}')] if has_cart else []
    for i, length in enumerate(arm_lengths, start=1):
        origin = f'<origin xyz="0 0 {-length:g}" rpy="0 0 0"/>'
        mimic = f'<mimic joint="{prefix}arm_{i}" multiplier="-1" offset="0"/>'
        joints += [("continuous", _AXIS), ("continuous", origin + _AXIS + mimic)]
    lines = ['<?xml version="1.0"?>', f'<robot name="{"reference_" if ghost else ""}pendulum">']
    lines += [
        f'  <material name="{prefix}{part}"><color rgba="{colour}"/></material>' for part, colour in colours.items()
    ]
    for (_, link), shapes in zip(frames, visuals, strict=True):
        drawn_shapes = [
            f'    <visual><origin xyz="{x:g} {y + depth:g} {z:g}" rpy="{rotation}"/><geometry>{shape}</geometry>'
            f'<material name="{prefix}{part}"/></visual>'
            for (shape, rotation), (x, y, z), part in shapes
        ]
        lines += [f'  <link name="{link}">', *drawn_shapes, "  </link>"]
    # The outermost arm has no elbow, so the last joint is left over.
    for (parent, child), (kind, body) in zip(frames[1:], joints, strict=False):
        parent_and_child = f'<parent link="{parent}"/><child link="{child}"/>'
        lines.append(f'  <joint name="{child.removesuffix("_link")}" type="{kind}">{parent_and_child}{body}</joint>')
    return "\n".join([*lines, "</robot>"]) + "\n"


_AXIS = '<axis xyz="0 -1 0"/>'
_Visual = tuple[tuple[str, str], tuple[float, float, float], str]
"""Shape and its turn, place (x, y, z) in m, and the material."""


def _box(x: float, y: float, z: float) -> tuple[str, str]:
    """Return the URDF of a box with edges x, y, z in m, and its rotation (roll, pitch, yaw)."""
    return f'<box size="{x:g} {y:g} {z:g}"/>', "0 0 0"


def _disc(radius: float) -> tuple[str, str]:
    """Return the URDF of a disc in the plane of motion with a radius in m, and its rotation (roll, pitch, yaw)."""
    return f'<cylinder radius="{radius:g}" length="{1.4 * _THICKNESS:g}"/>', "1.5707963 0 0"


def _visuals(arm_lengths: Sequence[float], *, reach: float, drawn: bool, has_cart: bool) -> list[list[_Visual]]:
    """Return the shapes of each link, in the order of `link_frames`.

    The links are the base, which has the shapes of the track if `drawn` is True, the cart if there is one, and each arm
    with its elbow, which has no shape. `reach` is the largest distance of the cart from the centre, m.
    """
    width, stop_place, hub = 0.06, reach + 0.05, _disc(1.3 * _THICKNESS)
    track: list[_Visual] = [(_box(2 * reach + 0.1, width, 0.01), (0, 0.06, -0.02), "track")]
    track += [(_box(_THICKNESS, width, 0.03), (x, 0.06, 0), "track") for x in (-stop_place, stop_place)]
    cart: list[_Visual] = [
        (_box(0.1, width, 0.03), (0, 0.06, 0), "cart"),
        (_disc(0.6 * _THICKNESS), (0, 0.02, 0), "cart"),
    ]
    visuals = [track if drawn else [], *([cart] if has_cart else [])]
    for i, length in enumerate(arm_lengths):
        # Each arm swings in front of the previous one, as on the rig, so it is drawn in full.
        depth = -1.6 * _THICKNESS * i
        end_material = "tip" if i + 1 == len(arm_lengths) else "cart"
        arm = (_box(1.6 * _THICKNESS, _THICKNESS, length), (0, depth, -length / 2), "arm")
        visuals += [[arm, (hub, (0, depth, 0), "cart"), (hub, (0, depth, -length), end_material)], []]
    return visuals[:-1]


Row = NDArray[np.float64]


class Note(NamedTuple):
    """A single message that is logged in addition to the ticks, such as an event.

    Attributes:
        topic: its topic.
        time_ns: its time, ns.
        content: its content in CDR.
    """

    topic: str
    time_ns: int
    content: bytes


class ChunkEncoder:
    """Encodes the chunks of a log in order, with the numbers of their messages.

    Args:
        tick: layout of the ticks.
    """

    def __init__(self, tick: layout.TickLayout):
        self.tick = tick
        self._counts = dict.fromkeys(tick.channels, 0)
        prefixes = ("", REFERENCE_PREFIX) if "reference" in tick.parts else ("",)
        frames = [
            frame for prefix in prefixes for frame in link_frames(tick.arms, has_cart=tick.has_cart, prefix=prefix)
        ]
        messages = {layout.TRANSFORMS: layout.transforms(frames), layout.EXTRAS: tick.extras_message}
        # Messages that are logged at the lower rate of viewing, by topic.
        self._slow = {
            topic: layout.Block({topic: messages[topic]}, tick.channels) for topic in messages if topic in tick.channels
        }
        # Number of the last slow message.
        self._last_due = -1

    def encode(self, times: NDArray[np.int64], rows: Mapping[str, Row], notes: Sequence[Note]) -> bytes:
        """Return the bytes of a chunk: single messages in order of arrival, slow ones, then those of ticks.

        Args:
            times: (K,) of the ticks, ns.
            rows: (K, width) of the measured positions and of each logged part.
            notes: single messages, such as events, in order of arrival.
        """
        block = self.tick.block.filled(times, self._counts[layout.MEASURED])
        self._counts[layout.MEASURED] += len(times)
        for topic, field, joints, part, columns in self.tick.rooms:
            block[topic][field][:, joints] = rows[part][:, columns]
        records = []
        for note in notes:
            channel_and_number = self.tick.channels[note.topic], self._counts[note.topic]
            records.append(layout.record(*channel_and_number, note.time_ns, note.content))
            self._counts[note.topic] += 1
        slow_message_numbers = slow_numbers(times)
        is_due = np.diff(slow_message_numbers, prepend=self._last_due) > 0
        self._last_due = max(slow_message_numbers.tolist(), default=self._last_due)
        times, rows = times[is_due], {part: values[is_due] for part, values in rows.items()}
        records.append(self._transforms(times, rows))
        if "extras" in rows:
            records.append(self._records(layout.EXTRAS, times, {"row": rows["extras"]}))
        return b"".join([*records, block.tobytes()])

    def _records(self, topic: str, times: NDArray[np.int64], values: Mapping[str, Row]) -> bytes:
        """Return the message records of a slow topic at `times` (K,), ns, with `values` (K, …) of its fields."""
        records = self._slow[topic].filled(times, self._counts[topic])
        for name, numbers in values.items():
            records[topic][name] = numbers
        self._counts[topic] += len(times)
        return records.tobytes()

    def _transforms(self, times: NDArray[np.int64], rows: Mapping[str, Row]) -> bytes:
        """Return the records of /tf at `times` (K,), ns: poses of the arms and, behind them, of the reference.

        The arms have the true states, else the estimate, else the measured positions; `rows` (K, width) are the parts.
        """
        measured, arms = rows["measured"], self.tick.arms
        states = np.zeros((len(measured), self.tick.widths["truth"]))
        states[:, :arms], states[:, 2 * arms : 2 * arms + 1] = measured[:, :arms], measured[:, arms:]
        robots = [rows.get("truth", rows.get("estimate", states))]
        robots += [rows["reference"]] if "reference" in rows else []
        # Readers of transforms reject poses that are not finite.
        is_finite = np.isfinite(np.hstack(robots)).all(axis=1)
        states = np.stack([robot[is_finite] for robot in robots], axis=1).reshape(-1, states.shape[1])
        poses = link_poses(states, arm_lengths=self.tick.arm_lengths, has_cart=self.tick.has_cart)
        poses_by_frame = poses.reshape(int(is_finite.sum()), len(robots) * poses.shape[1], 7).swapaxes(0, 1)
        return self._records(
            layout.TRANSFORMS, times[is_finite], {f"{i}.pose": pose for i, pose in enumerate(poses_by_frame)}
        )


def slow_numbers(times: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number, from 0, of the last slow message due at each time.

    A tick gets a slow message if its number is new, which gives the rate `SLOW_RATE`.

    Args:
        times: times (K,), ns.
    """
    return np.floor(times * (layout.SLOW_RATE / 1e9) + 1e-6).astype(np.int64)


CHUNK_SECONDS, LONGEST_CHUNK = 0.02, 0.2
"""Duration of a chunk that waits for ticks, and of the longest chunk, s.

A run that passes on its ticks one by one loses at most the first and one tick if it is killed. Many ticks that arrive
together form long chunks, which take a tenth of the time.
"""


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
        self.extras = tuple(extras)
        self._tick = layout.TickLayout(
            tuple(map(float, arm_lengths)), has_cart, float(rate_hz), limits=limits, extras=self.extras
        )
        self._metadata, self._attachments = dict(metadata or {}), dict(attachments or {})
        # Ticks of a chunk: as many as are written at least, and at most.
        self._least, self._size = (max(1, round(seconds * rate_hz)) for seconds in (CHUNK_SECONDS, LONGEST_CHUNK))
        self._times = np.zeros(self._size)
        # Rows of the ticks that wait for the next chunk.
        self._rooms = {name: np.zeros((self._size, width)) for name, width in self._tick.widths.items()}
        # The first tick decides which of these parts the log has.
        self._parts: frozenset[str] = frozenset()
        # Ticks that wait, ticks that are written, and the time of the last one, s.
        self._filled = self._ticks = 0
        self._last = 0.0
        # Events that wait for the next chunk, the results of the run so far, and the encoder from the first chunk on.
        self._notes: list[Note] = []
        self._result: dict[str, str] = {}
        self._encoder: ChunkEncoder | None = None

    def __enter__(self) -> "LogWriter":
        """Create the partial file, and write the caller's metadata and attachments.

        If these cannot be written, for example on a full disk, the partial file is removed.
        """
        try:
            self.path = checked_target(self.path)
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.partial, stream = open_partial(self.path)
            try:
                self._file = McapFile(stream, library=PROGRAM)
                self._file.add_metadata(layout.RUN_RECORD, self._metadata)
                for name, data in self._attachments.items():
                    self._file.add_attachment(name, data)
            except OSError:
                stream.close()
                self.partial.unlink()
                raise
        except OSError as error:
            raise unwritable(self.path, error) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Complete and rename the file, or keep the partial file if the block has raised `error`.

        A run that failed before its first tick leaves no file.
        """
        if self._file.stream.closed:
            return
        try:
            if error is None:
                self._write_chunk()
                self._file.add_metadata(layout.RESULT_RECORD, {**self._result, layout.TICKS: str(self._ticks)})
                self._file.finish()
                self.partial.replace(self.path)
            elif self._ticks or self._filled:
                # If this also fails, the current exception already reports the first error.
                with suppress(InputError):
                    self._write_chunk()
                error.add_note(
                    f"{self.partial} keeps the run up to {self._last:.3f} s at most; "
                    f"`dpcontrol recover {self.partial}` makes a log of it"
                )
            else:
                # A run that failed before its first tick leaves nothing to keep.
                self._file.stream.close()
                self.partial.unlink()
        except OSError as failure:
            raise unwritable(self.path, failure) from failure
        finally:
            self._file.stream.close()

    def ticks(self, time_s: ArrayLike, **parts: Row | None) -> None:
        """Log K periods of the loop with the same parts in every tick; only `measured` is required.

        Args:
            time_s: (K,) times since the start in s, not before the last tick's time.
            **parts: rows by name, None for a part without rows:

                measured: (K, n+1) positions from the sensors, rad, and m for the cart.
                rates: (K, n+1) rates from the sensors, rad/s and m/s.
                estimate, reference, truth: (K, 2n+2) states in order: rad, rad/s, m, m/s.
                control: (K, 13) for a double pendulum on a cart: rows of `layout.control_fields`.
                extras: (K, 2E) standard deviations of the E extras given to the constructor, then their values.

        Raises:
            ValueError: rows of another shape, or a part in some ticks only.
            InputError: the file cannot be written.
        """
        times = np.asarray(time_s, float)
        rows = {name: values for name, values in parts.items() if values is not None}
        if self._parts and self._parts != rows.keys():
            raise ValueError(f"{', '.join(self._parts ^ rows.keys())} must be given in every tick of a run or in none")
        self._parts, written = frozenset(rows), 0
        while written < len(times):
            count = min(self._size - self._filled, len(times) - written)
            free_rows, given_rows = slice(self._filled, self._filled + count), slice(written, written + count)
            self._times[free_rows] = times[given_rows]
            for name, values in rows.items():
                self._rooms[name][free_rows] = values[given_rows]
            self._filled, self._last, written = self._filled + count, float(times[written + count - 1]), written + count
            if self._filled == self._size:
                self._write_chunk()
        if self._filled >= self._least:
            self._write_chunk()

    def result(self, **values: str) -> None:
        """Add results, which may differ when the run is repeated, as metadata at the end of the log.

        Args:
            **values: results by name.
        """
        self._result.update(values)

    def event(self, event: layout.Event) -> None:
        """Log an event.

        Args:
            event: the event.
        """
        self._notes.append(Note(layout.EVENTS, round(event.time * 1e9), layout.log(event)))

    def _prepared(self) -> ChunkEncoder:
        """Write the records before the first chunk: the layout, the channels and the arms' descriptions.

        They wait for the first chunk because the parts of a tick are unknown before. Return the encoder of the chunks.
        """
        tick = replace(self._tick, parts=self._parts & set(layout.PARTS))
        described = {**tick.record(), "attachments": json.dumps(list(self._attachments)), "program": PROGRAM}
        self._file.add_metadata(layout.LAYOUT_RECORD, described)
        self._file.add_channels(tick)
        first = round(self._times[0] * 1e9)
        for topic in (topic for topic in tick.channels if topic in layout.LATCHED):
            text = robot_description(
                tick.arm_lengths, has_cart=tick.has_cart, limits=tick.limits, ghost=topic == layout.GHOST
            )
            self._notes.insert(0, Note(topic, first, layout.string(text)))
        return ChunkEncoder(tick)

    def _write_chunk(self) -> None:
        """Write the collected ticks and single messages as a chunk; before the first one, write the layout.

        Raises:
            InputError: the file cannot be written.
        """
        count = self._filled
        times = np.rint(self._times[:count] * 1e9).astype(np.int64)
        rows = {name: self._rooms[name][:count] for name in self._parts or {"measured"}}
        try:
            self._encoder = self._encoder or self._prepared()
            if count or self._notes:
                self._file.add_chunk(self._encoder.encode(times, rows, self._notes))
        except OSError as error:
            raise unwritable(self.path, error) from error
        self._notes.clear()
        self._ticks += count
        self._filled = 0
