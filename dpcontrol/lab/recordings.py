"""Recordings from the bench in memory and as logs: what was measured, in segments, with nothing added.

A recording is written in the layout of simulated logs: the angles as /joint_states, the rig's own filtered rates, where
it gave any, beside them as /estimate/joint_states. One log holds all segments of a file, one after the other, and its
metadata says in which rows each begins and ends; between two segments the time jumps.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import LogWriter, RunLog, read_log
from dpcontrol.logs.layout import Mode, control_fields

Array = NDArray[np.float64]

KIND = "recording"
"""The metadata `kind` of a log that was imported."""


@dataclass(frozen=True, eq=False)
class Recording:
    """K samples of n arms, SI units; angles absolute from hanging, counter-clockwise, unwrapped.

    name; source: the file it came from. dt s: sampling period. time (K,) s; angles (K, n) rad; rates (K, n) rad/s as
    the rig's own filter gave them, or None; cart (K,) m and command (K,) m/s², or None where the cart was clamped.
    segments: (first, end) rows of each, end not included, 0-based in the order of the file; within a segment samples
    are dt apart. arm_lengths (n,) m, for pictures. notes: what was repaired or changed in reading, in sentences.
    """

    name: str
    source: str
    dt: float
    time: Array
    angles: Array
    rates: Array | None
    segments: tuple[tuple[int, int], ...]
    arm_lengths: tuple[float, ...]
    cart: Array | None = None
    command: Array | None = None
    notes: tuple[str, ...] = ()

    @property
    def arms(self) -> int:
        """Number of arms."""
        return self.angles.shape[1]

    def segment(self, index: int) -> "Recording":
        """Return the segment of this 0-based index as a recording of its own, its time as in the whole."""
        first, end = self.segments[index]
        rows = slice(first, end)
        return replace(
            self,
            time=self.time[rows],
            angles=self.angles[rows],
            rates=None if self.rates is None else self.rates[rows],
            cart=None if self.cart is None else self.cart[rows],
            command=None if self.command is None else self.command[rows],
            segments=((0, end - first),),
        )

    def split(self) -> "list[Recording]":
        """Return all segments, in order."""
        return [self.segment(index) for index in range(len(self.segments))]


def write_recording(recording: Recording, path: Path | str) -> Path:
    """Write a recording as a log and return its path.

    Raises:
        InputError: the file cannot be written.
    """
    k, n = recording.angles.shape
    has_cart = recording.cart is not None
    fields = control_fields(n, has_cart=has_cart)
    control = np.zeros((k, len(fields)))
    control[:, fields.index("nis")] = np.nan
    control[:, fields.index("mode")] = Mode.IDLE
    if recording.command is not None:
        control[:, fields.index("command")] = control[:, fields.index("applied")] = recording.command
    measured = recording.angles
    state = np.zeros((k, 2 * n + 2 * has_cart))
    state[:, :n] = recording.angles
    if recording.rates is not None:
        state[:, n : 2 * n] = recording.rates
    if recording.cart is not None:
        measured = np.column_stack([measured, recording.cart])
        state[:, 2 * n] = recording.cart
    metadata = {
        "kind": KIND,
        "title": recording.name,
        "source": recording.source,
        "sampling_period": repr(recording.dt),
        "segments": " ".join(f"{first}:{end}" for first, end in recording.segments),
        "rates": "" if recording.rates is None else "filtered by the rig, in /estimate/joint_states",
        "command": "" if recording.command is None else "cart acceleration, in /control",
        "notes": "\n".join(recording.notes),
    }
    with LogWriter(
        path,
        arm_lengths=recording.arm_lengths,
        rate_hz=1 / recording.dt,
        has_cart=has_cart,
        metadata=metadata,
    ) as log:
        for index, (first, end) in enumerate(recording.segments):
            log.event(float(recording.time[first]), "info", "import", f"segment {index}: {end - first} samples")
            rows = slice(first, end)
            log.ticks(
                recording.time[rows],
                measured=measured[rows],
                estimate=state[rows],
                reference=state[rows],
                truth=None,
                control=control[rows],
            )
    return Path(path)


def load_recording(path: Path | str) -> Recording:
    """Return the recording that `dpcontrol import` wrote to `path`.

    Raises:
        InputError: the file cannot be read, or is the log of a run.
    """
    log = read_log(path)
    if log.metadata.get("kind") != KIND:
        raise InputError(f"{path} is the log of a run, not a recording; give a log that `dpcontrol import` wrote")
    return recording_of(log)


def recording_of(log: RunLog) -> Recording:
    """Return the recording that an imported log holds.

    Raises:
        InputError: its segments do not fit its samples.
    """
    n, k = len(log.arm_lengths), len(log.time)
    segments = _segments(log.metadata.get("segments", ""))
    if not segments or any(not 0 <= first < end <= k for first, end in segments):
        raise InputError(f"{log.path}: its segments do not fit its {k} samples; import the recording again")
    rates = log.estimate[:, n : 2 * n] if log.metadata.get("rates") else None
    return Recording(
        name=log.metadata.get("title", log.path.stem),
        source=log.metadata.get("source", ""),
        dt=float(log.metadata.get("sampling_period", 1 / log.rate_hz)),
        time=log.time,
        angles=log.measured[:, :n],
        rates=rates,
        segments=segments,
        arm_lengths=log.arm_lengths,
        cart=log.measured[:, n] if log.has_cart else None,
        command=log.control["command"] if log.metadata.get("command") else None,
        notes=tuple(log.metadata.get("notes", "").splitlines()),
    )


def _segments(text: str) -> tuple[tuple[int, int], ...]:
    try:
        pairs = [tuple(int(number) for number in part.split(":")) for part in text.split()]
        return tuple((first, end) for first, end in pairs)
    except ValueError:
        return ()
