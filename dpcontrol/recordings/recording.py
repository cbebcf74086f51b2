"""Recordings from the bench in memory and as logs: measurements in segments, with nothing added.

A recording uses the layout of simulated logs, restricted to the measurements: angles and, if available, the rig's
filtered rates as /joint_states, and a command as /control. One log holds all segments of a file in sequence. Its
metadata contains their first and last rows, and the time may jump between two segments.

The cart acceleration comes from its command or from its position:

    u_k = (a_k + a_{k+1}) / 2,      a = d²/dt² of cubics through 20 ms of the position (Savitzky–Golay)

A command is sharper, but a drive may lag, saturate or deliver less than commanded. The command is used if it explains
the position: the smoothed accelerations of its integral match those of the position to a tenth of their rms.

Simulated recordings of swings with known truth are integrated to machine precision from rest, on a clamped cart. They
are read by relative encoders with zero errors ζ:

    y_i = Σ_{j≤i} q round((θ_j - θ_{j-1} + ζ_j - ζ_{j-1}) / q),      q = 2π / counts

Source: Savitzky & Golay, Smoothing and Differentiation of Data (1964).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.checked import Count, Index, checked
from dpcontrol.foundation.document import Documented, picked
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import content_hash
from dpcontrol.foundation.progress import Cost
from dpcontrol.foundation.rendering import DataFrame
from dpcontrol.foundation.shown import Brief, Timed, checked_times, data_frame
from dpcontrol.logs import Event, LogWriter, Mode, RunLog, check_replaced, control_fields, read_log
from dpcontrol.logs.reader import segment_numbers

KIND, REPLAYED = "recording", "replay"
"""The metadata `kind` of an imported log, and of a replay's log."""
SUMMARY = "summary"
"""Metadata key of a replay: a sentence on the quality of the model's prediction."""


@dataclass(frozen=True, eq=False)
class Recording(Timed):
    """K samples of n arms in SI units.

    Angles are absolute from hanging, counter-clockwise and unwrapped.

    Attributes:
        name: name of the recording.
        source: file of origin.
        dt: sampling period, s.
        time: (K,) s.
        angles: (K, n) rad.
        rates: (K, n) rad/s from the rig's filter, or None.
        cart: (K,) m, or None for a clamped cart.
        command: (K,) m/s², or None for a clamped cart.
        segments: (first, end) rows in file order, 0-based, end excluded; samples of a segment are dt apart.
        arm_lengths: lengths (n,) of the arms, m, with which logs and pictures show them; a fit does not use them.
        notes: sentences on repairs and changes made by the import.
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

    def __repr__(self) -> str:
        return f"<recording {self.name!r}: {len(self.segments)} segments, {len(self.time)} samples>"

    @property
    def time_range(self) -> tuple[float, float]:
        """First and last time, s."""
        return float(self.time[0]), float(self.time[-1])

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the measured columns."""
        return (*(f"angle_{arm + 1}" for arm in range(self.arms)), *(["cart"] if self.cart is not None else []))

    def states(self, times: Any = None) -> Array:
        """Return the measured angles and, if the cart moved, its position, interpolated linearly.

        Args:
            times: times (K,) of the recording, s; by default 200 from the first to the last.

        Returns:
            Angles, rad, and position, m (K, N). Times outside count as the nearest end.

        Raises:
            InputError: the times are not finite numbers.
        """
        if times is None:
            return self.sample()
        measured = [*self.angles.T, *([] if self.cart is None else [self.cart])]
        return np.stack([np.interp(checked_times(times), self.time, column) for column in measured], axis=-1)

    @checked
    def frame(self, count: Count | None = None) -> DataFrame:
        """Return a pandas table of angles, cart and segments.

        Args:
            count: number of interpolated rows without segments. None, the default, for one row per sample, with the
                column `segment` that `dpcontrol import` reads from CSV.

        Raises:
            PartMissing: pandas is not installed.
        """
        if count is not None:
            return super().frame(count)
        table = data_frame(self.states(self.time), self.columns, times=self.time)
        table["segment"] = segment_numbers(self.segments, len(self.time))
        return table

    @property
    def arms(self) -> int:
        """Number of arms."""
        return self.angles.shape[1]

    @checked
    def segment(self, index: Index) -> "Recording":
        """Return one segment as a recording, in its original times.

        Args:
            index: index of the segment, from 0.

        Raises:
            InputError: there is no such segment.
        """
        if index >= len(self.segments):
            raise InputError(f"index = {index}: {self.name} has segments 0 to {len(self.segments) - 1}")
        rows = slice(*self.segments[index])
        columns = {name: getattr(self, name) for name in ("time", "angles", "rates", "cart", "command")}
        cut = {name: None if values is None else values[rows] for name, values in columns.items()}
        return replace(self, **cut, segments=((0, rows.stop - rows.start),))

    def split(self) -> "list[Recording]":
        """Return all segments, in order."""
        return [self.segment(index) for index in range(len(self.segments))]

    def document(self) -> dict[str, Any]:
        """Return the output of `dpcontrol import --json`, without the names of log and source."""
        segments = [
            {"index": k, "start": float(part.time[0]), "samples": len(part.time), "duration": float(np.ptp(part.time))}
            for k, part in enumerate(self.split())
        ]
        return {
            **picked(self, "arms", "notes"),
            "samples": len(self.time),
            "sampling_period": self.dt,
            "duration": sum(segment["duration"] for segment in segments),
            "rates": self.rates is not None,
            "cart": self.cart is not None,
            "segments": segments,
        }


@dataclass(frozen=True, eq=False)
class ImportedRecording(Documented):
    """A recording that was imported or simulated, with the log that holds it.

    Attributes:
        recording: imported recording.
        source: its file, or its origin.
        log: log that was written, or None.
        remarks: sentences on unusual data.
    """

    KEYS: ClassVar[str] = "log source **recording.document remarks"

    recording: Recording
    source: str
    log: Path | None
    remarks: tuple[str, ...]


def described(recording: Recording, *, kind: str = KIND) -> dict[str, str]:
    """Return the log metadata of a recording, which `recording_of` reads.

    Args:
        recording: the recording.
        kind: kind of the log, by default that of an imported recording.
    """
    measured = (recording.time, recording.angles, recording.rates, recording.cart, recording.command)
    return {
        "kind": kind,
        "title": recording.name,
        "source": recording.source,
        "sampling_period": repr(recording.dt),
        "segments": " ".join(f"{first}:{end}" for first, end in recording.segments),
        "command": "" if recording.command is None else "cart acceleration, in /control",
        "notes": "\n".join(recording.notes),
        "content": content_hash(*(np.ascontiguousarray(part).tobytes() for part in measured if part is not None)),
    }


def write_recording(recording: Recording, path: Path | str, *, force: bool = False) -> Path:
    """Write a recording as a log and return its path.

    Args:
        recording: the recording.
        path: log to write.
        force: True to replace any file, default False.

    Raises:
        InputError: the file cannot be written.
    """
    command = recording.command
    pieces = [
        (first, end, "info", f"segment {index}: {end - first} samples")
        for index, (first, end) in enumerate(recording.segments)
    ]
    control = {} if command is None else {"command": command, "applied": command}
    return write_samples(recording, path, "import", pieces, metadata=described(recording), control=control, force=force)


def write_samples(
    recording: Recording,
    path: Path | str,
    verb: str,
    pieces: Sequence[tuple[int, int, str, str]],
    *,
    metadata: Mapping[str, str],
    states: Mapping[str, Array] | None = None,
    control: Mapping[str, Array] | None = None,
    sigmas: Array | None = None,
    attachments: Mapping[str, bytes] | None = None,
    force: bool = False,
) -> Path:
    """Write measurements, states and control fields as a log, for imported recordings and for replays.

    Args:
        recording: measurements (K samples).
        path: log to write.
        verb: name of the events, "import" or "replay".
        pieces: first row, end row, level and text of the event of each segment.
        metadata: text by name, stored in the log's metadata record of the run.
        states: states (K, N) by "estimate" or "reference", default none.
        control: some of `control_fields` (K,) by name, default none. Without them, NIS is NaN, the mode is idle, and
            other fields are zero.
        sigmas: (K, N) standard deviations of the estimate.
        attachments: attachments by name, default none.
        force: True to replace another log at `path`.

    Returns:
        Path of the log.

    Raises:
        InputError: the file cannot be written, or another log exists.
    """
    check_replaced(path, metadata, force=force)
    measured, rates = recording.angles, recording.rates
    has_cart = recording.cart is not None
    if recording.cart is not None:
        measured = np.column_stack([measured, recording.cart])
        # Rigs do not report the cart's velocity; it is differentiated from the position.
        carts = [part.cart for part in recording.split() if part.cart is not None]
        velocity = [np.gradient(cart, recording.dt) if len(cart) > 1 else np.zeros(len(cart)) for cart in carts]
        rates = None if rates is None else np.column_stack([rates, np.concatenate(velocity)])
    parts: dict[str, Array | None] = {"rates": rates, **(states or {})}
    if control:
        fields = control_fields(recording.arms, has_cart=has_cart)
        control_rows = np.zeros((len(recording.time), len(fields)))
        for name, values in {"nis": np.nan, "mode": Mode.IDLE, **control}.items():
            control_rows[:, fields.index(name)] = values
        if sigmas is not None:
            control_rows[:, fields.index("sigma_1") :] = sigmas
        parts["control"] = control_rows
    with LogWriter(
        path, arm_lengths=recording.arm_lengths, rate_hz=1 / recording.dt, has_cart=has_cart, metadata=metadata,
        attachments=attachments,
    ) as log:  # fmt: skip
        for first, end, level, text in pieces:
            log.event(Event(float(recording.time[first]), level, verb, words=text))
            log.ticks(
                recording.time[first:end],
                measured=measured[first:end],
                **{name: None if values is None else values[first:end] for name, values in parts.items()},
            )
    return Path(path)


def load_recording(path: Path | str) -> Recording:
    """Return the recording in a log of `dpcontrol import` or `replay`; a run's log becomes one segment.

    Args:
        path: the log.

    Raises:
        InputError: the file cannot be read, is not a log, or holds too few samples.
    """
    return recording_of(read_log(path))


def recording_of(log: RunLog) -> Recording:
    """Return the measurements and commands in a log, without estimates and references.

    Args:
        log: log of a run, a recording or a replay.

    Raises:
        InputError: segments and samples of the log do not match, or its time runs backward.
    """
    n, steps, period = len(log.arm_lengths), np.diff(log.time), 1 / log.rate_hz
    if (backward_steps := np.flatnonzero(steps < 0)).size:
        raise InputError(
            f"{log.path}: its time runs backward after {log.time[backward_steps[0]]:.3f} s; record it again, or import "
            "the original with `--repair time`"
        )
    is_recording = log.metadata.get("kind") in (KIND, REPLAYED)
    metadata = {"title": log.path.stem, "source": "" if is_recording else log.path.name}
    # A run is one segment, in which the arms felt the applied acceleration, not the controller's command.
    segments, command = ((0, len(log.time)),), log.controls.get("applied")
    if is_recording:
        segments, metadata = log.segments, {**metadata, **log.metadata}
        command = log.controls.get("command") if metadata.get("command") else None
    mean_periods = [float(np.mean(steps[first : end - 1])) / period for first, end in segments if end - first > 1]
    if not segments or any(not 0.5 <= mean <= 2 for mean in mean_periods):
        raise InputError(
            f"{log.path}: its segments do not fit its {len(log.time)} samples, or these have not the nominal period of "
            f"{period:g} s; import the recording again"
        )
    return Recording(
        name=metadata["title"],
        source=metadata["source"],
        dt=period,
        time=log.time,
        angles=log.measured[:, :n],
        rates=None if log.rates is None else log.rates[:, :n],
        segments=segments,
        arm_lengths=log.arm_lengths,
        cart=log.measured[:, n] if log.has_cart else None,
        command=command,
        notes=tuple(log.metadata.get("notes", "").splitlines()),
    )


STILL = 1e-3
"""Least travel of a moving cart, m; with less it counts as clamped."""
_SMOOTHED = 0.02
"""Window of each cubic, s. With micrometre noise the acceleration is accurate to some mm/s², up to 10 Hz."""
_EXPLAINED = 0.1


@dataclass(frozen=True, eq=False)
class CartMotion(Brief):
    """Cart motion at K samples, which is the input of the arms' equations.

    Attributes:
        position: position (K,), m.
        velocity: velocity (K,), m/s.
        acceleration: acceleration (K,), m/s², held until the next sample.
        commanded: True if the acceleration comes from the command, False if from the position.
    """

    position: Array
    velocity: Array
    acceleration: Array
    commanded: bool


def cart_motion(part: Recording) -> CartMotion | None:
    """Return the cart's motion in a recording of one segment, or None if the cart was clamped.

    A cart with a measured position is clamped if it travels less than `STILL`, a cart without one if there is no
    command or all commands are zero; else its position is the integral of the command. The acceleration is the command
    if it explains the measured position, and else follows from the position, see the head of this module.

    Args:
        part: recording of one segment.
    """
    from scipy.integrate import cumulative_trapezoid
    from scipy.interpolate import make_interp_spline

    period, command = part.dt, np.zeros(0) if part.command is None else part.command
    commanded_velocity = period * np.concatenate([[0.0], np.cumsum(command[:-1])])
    if part.cart is None:
        position = np.asarray(cumulative_trapezoid(commanded_velocity, dx=period, initial=0))
        return CartMotion(position, commanded_velocity, command, True) if command.any() else None
    finite = np.isfinite(part.cart)
    if finite.sum() < 2 or float(np.ptp(part.cart[finite])) < STILL:
        return None
    # A missing reading lies on the line through its neighbours, or through the first or last two.
    interpolant = make_interp_spline(part.time[finite], part.cart[finite], k=1)
    position = np.asarray(interpolant(part.time), dtype=np.float64)
    velocity, measured_acceleration = (smoothed_derivative(position, period, order) for order in (1, 2))
    if command.size:
        commanded_acceleration = smoothed_derivative(
            np.asarray(cumulative_trapezoid(commanded_velocity, dx=period, initial=0)), period, 2
        )
        difference_rms, acceleration_rms = (
            float(np.sqrt(np.mean(np.square(a))))
            for a in (commanded_acceleration - measured_acceleration, measured_acceleration)
        )
        if difference_rms <= _EXPLAINED * acceleration_rms:
            return CartMotion(position, velocity, command, True)
    # u_k at the head of this module, held until the next sample.
    acceleration = (measured_acceleration + np.append(measured_acceleration[1:], measured_acceleration[-1])) / 2
    return CartMotion(position, velocity, acceleration, False)


def smoothed_derivative(values: Array, period: float, order: int = 1, *, window: float = _SMOOTHED) -> Array:
    """Return the derivative of samples (K, …) by cubics through a window, zero for fewer than five samples.

    Differences of neighbouring samples would amplify the rounding of encoders.

    Args:
        values: samples (K, …).
        period: sampling period, s.
        order: order of the derivative, default 1.
        window: length of the window, s.
    """
    # The import is slow, and models not derived from recordings do not need it.
    from scipy.signal import savgol_filter

    # The filter needs an odd number of samples.
    width = min(max(round(window / period) | 1, 5), (len(values) - 1) | 1)
    if width < 5:
        return np.zeros_like(values)
    return np.asarray(savgol_filter(values, width, 3, deriv=order, delta=period, axis=0), dtype=np.float64)


_REACH = 1.2
"""Range of starting angles about hanging, rad; such swings are lively, not chaotic, and the most informative."""
_ZEROS = 2e-3
_PERIOD = 1e-3
"""Period of a simulated recording, s."""


_SAMPLE_SECONDS, _SAMPLE_BYTES = 17e-6, 150.0
"""Time in s, mostly of writing, and bytes per sample, measured over 3 million samples."""


def swings_cost(swings: int, seconds: float) -> Cost:
    """Return the expected cost of simulating swings and writing their log, by which too much work is refused.

    Args:
        swings: number of swings.
        seconds: duration of each swing, s.
    """
    samples = swings * seconds / _PERIOD
    key = f"swings = {swings}, seconds = {seconds:g}"
    return Cost(f"{samples:,.3g} samples", _SAMPLE_SECONDS * samples, _SAMPLE_BYTES * samples, key)


def random_swings(arms: ArmChainParameters, *, swings: int, seconds: float, seed: int, name: str) -> Recording:
    """Return a simulated recording for practice with identification, whose truth is known.

    Its swings are released at random angles, with encoder zeros wrong by up to 2 mrad.

    Args:
        arms: parameters of the arms.
        swings: number of swings.
        seconds: duration of each swing, s.
        seed: seed of the random numbers.
        name: name of the recording.
    """
    random = np.random.default_rng(seed)
    zeros = random.uniform(-_ZEROS, _ZEROS, arms.count)
    starts = list(random.uniform(-_REACH, _REACH, (swings, arms.count)))
    return simulated_recording(arms, starts, seconds=seconds, zeros=zeros, name=name)


def simulated_recording(
    arms: ArmChainParameters,
    starts: Sequence[Array],
    *,
    seconds: float,
    period: float = _PERIOD,
    counts: int = 40_000,
    zeros: Array | None = None,
    name: str = "simulated",
) -> Recording:
    """Return a recording of free swings of these arms from rest, one from each of `starts` (n,) rad.

    Args:
        arms: parameters of the arms.
        starts: (n,) angles of each release, rad.
        seconds: duration of each swing, s.
        period: time between samples, s.
        counts: per turn of the relative encoders; 0 for exact angles.
        zeros: (n,) readings at true zero, as absolute angles, rad.
        name: name of the recording.
    """
    # Importing the integrator is slow, and only simulated recordings need it.
    from dpcontrol.dynamics.propagator import Propagator

    n = arms.count
    propagator = Propagator(equations_of(arms, Level.DISSIPATIVE), arms.base())
    times = np.arange(round(seconds / period) + 1) * period
    swings: list[Array] = []
    for start in starts:
        state = np.concatenate([np.asarray(start, dtype=float), np.zeros(n)])
        angles = propagator.sample(state, times)[:, :n] + (0.0 if zeros is None else zeros)
        if counts:
            # Encoders at the joints round the angles between neighbouring arms.
            step = 2 * np.pi / counts
            relative = np.diff(angles, axis=1, prepend=0.0)
            angles = np.cumsum(step * np.rint(relative / step), axis=1)
        swings.append(angles)
    edges = np.arange(len(swings) + 1) * len(times)
    return Recording(
        name=name,
        source="simulated",
        dt=period,
        time=np.arange(edges[-1]) * period,
        angles=np.concatenate(swings),
        rates=None,
        segments=tuple((int(first), int(end)) for first, end in pairwise(edges)),
        arm_lengths=arms.length,
    )
