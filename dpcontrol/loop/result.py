"""What stands at the loop's ends: the rig that it runs on, the sink that takes its ticks, and the result of a run."""

import math
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.estimator_settings import share_inside
from dpcontrol.control.interface import Action, Estimate
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.logs import LogWriter

Array = NDArray[np.float64]


class Reading(NamedTuple):
    """What came from the sensors at one tick.

    time s since the first reading; positions (n+1,): absolute angles, summed from relative encoders, then the cart;
    present (n+1,): which of them are new, or None when all are (those that are not hold their last value); switch:
    -1 or +1 while the limit switch at the left or right end of the track is touched, else 0; late s: by how much the
    deadline was missed.
    """

    time: float
    positions: Array
    present: NDArray[np.bool_] | None = None
    switch: int = 0
    late: float = 0.0


class Rig(Protocol):
    """A bench. Each period: one `read`, which waits for the tick, then one `command`."""

    @property
    def period(self) -> float:
        """Return the time between ticks, s."""
        ...

    def read(self) -> Reading:
        """Return the next tick's reading; the first call gives the start.

        Raises:
            ArithmeticError: the bench failed, in one sentence.
        """
        ...

    def command(self, acceleration: float) -> None:
        """Send the cart's wanted acceleration, m/s² to the right."""
        ...

    def stop(self) -> None:
        """Brake the cart to a standstill and ignore further commands."""
        ...

    @property
    def truth(self) -> Array | None:
        """Return the true state (2n+2,) at the last reading's tick, None where nobody knows it."""
        ...

    @property
    def acted(self) -> float | None:
        """Return the acceleration that really acted on the cart over the last period, None where nobody knows it."""
        ...

    @property
    def fault(self) -> str:
        """Return why the bench has failed, such as the end of its track, or "" while it works."""
        ...


CONTROL_HEAD = 7
"""Columns of `control` before the standard deviations: see `dpcontrol.logs.layout.control_fields`."""


class Ending(StrEnum):
    """How a run ended."""

    FINISHED = "finished"
    """It came to the reference's end. Whether the itinerary was completed is for the score to say."""
    FELL_BACK = "fell back"
    """The reference was given up and the nearest orbit held instead, to the end."""
    CART_STOP = "cart at its stop"
    ESTIMATE_LOST = "estimate lost"
    TRACKING_LOST = "tracking lost"
    PLANT_FAILED = "plant failed"


@dataclass(frozen=True, eq=False)
class Ticks:
    """K ticks, n arms.

    times (K,) s; measured (K, n+1), not-a-number where an encoder gave nothing; estimates, references (K, 2n+2) in
    state order; truth the same, or None where it is not known; control (K, 9+2n) with the columns of
    `dpcontrol.logs.layout.control_fields`.
    """

    times: Array
    measured: Array
    estimates: Array
    references: Array
    truth: Array | None
    control: Array

    @classmethod
    def empty(cls, count: int, arms: int, *, has_truth: bool, period: float) -> "Ticks":
        """Return room for `count` ticks, `period` s apart."""
        n = 2 * arms + 2
        measured, estimates, references, control = (
            np.empty((count, size)) for size in (arms + 1, n, n, CONTROL_HEAD + n)
        )
        times = np.asarray(np.arange(count) * period, dtype=np.float64)
        return cls(times, measured, estimates, references, np.empty((count, n)) if has_truth else None, control)

    def take(
        self,
        k: int,
        reading: Reading,
        estimate: Estimate,
        action: Action,
        wanted: Array,
        acted: tuple[float, bool, int],
        truth: Array | None,
    ) -> None:
        """Write tick k; wanted (N,): its reference; acted: acceleration in m/s², whether it was cut, mode."""
        self.measured[k] = reading.positions
        if reading.present is not None:
            self.measured[k, ~reading.present] = math.nan
        self.estimates[k] = estimate.state
        self.references[k] = wanted
        if self.truth is not None:
            self.truth[k] = truth
        applied, saturated, mode = acted
        feedforward, feedback = action.feedforward, action.feedback
        heads, sigmas = self._control_parts
        heads[k] = feedforward + feedback, feedforward, feedback, applied, saturated, estimate.nis, mode
        sigmas[k] = estimate.sigmas[: sigmas.shape[1]]

    @cached_property
    def _control_parts(self) -> tuple[Array, Array]:
        """The columns of `control` before the standard deviations, and those."""
        return self.control[:, :CONTROL_HEAD], self.control[:, CONTROL_HEAD:]

    def between(self, first: int, end: int) -> "Ticks":
        """Return the ticks from `first` up to `end`, sharing memory."""
        rows = slice(first, end)
        truth = None if self.truth is None else self.truth[rows]
        return Ticks(
            self.times[rows], self.measured[rows], self.estimates[rows], self.references[rows], truth,
            self.control[rows],
        )  # fmt: skip


class LoopSink(Protocol):
    """Takes ticks and events as they happen; a log writer is made into one."""

    def ticks(self, rows: Ticks) -> None:
        """Take the next ticks; the arrays are reused afterwards."""
        ...

    def event(self, time_s: float, level: str, name: str, text: str) -> None:
        """Take one event: level info, warn or error, its name, and what happened."""
        ...


class NoSink:
    """Takes nothing: the result holds every tick anyway."""

    def ticks(self, rows: Ticks) -> None:
        """Ignore ticks."""

    def event(self, time_s: float, level: str, name: str, text: str) -> None:
        """Ignore an event."""


@dataclass(frozen=True, eq=False)
class LoopResult:
    """A run of K ticks, n arms.

    ticks: its rows. ending, and reason, a sentence. late: ticks that began too late; elapsed s. plant: the parameters
    that were simulated, if any.
    """

    ticks: Ticks
    ending: Ending
    reason: str
    late: int
    elapsed: float
    plant: ArmChainParameters | None = None

    @property
    def finished(self) -> bool:
        """Tell whether the run came to the reference's end."""
        return self.ending is Ending.FINISHED

    @property
    def _states(self) -> Array:
        return self.ticks.estimates if self.ticks.truth is None else self.ticks.truth

    @property
    def nis_inside_95(self) -> float:
        """Return the share of the ticks whose NIS lies in its two-sided 95 % band."""
        return inside_95(self.ticks.control[:, 5], self.ticks.measured.shape[1])

    @property
    def rms_tracking_error(self) -> float:
        """Return the rms over all angles, rad, of the truth (where known, else the estimate) less the reference."""
        n = self.ticks.measured.shape[1] - 1
        return rms(self._states[:, :n] - self.ticks.references[:, :n])

    @property
    def max_cart_position(self) -> float:
        """Return the cart's greatest distance from the centre, m."""
        return float(np.abs(self._states[:, -2]).max())

    @property
    def rms_cart_acceleration(self) -> float:
        """Return the rms of the cart's acceleration as applied, m/s²."""
        return rms(self.ticks.control[:, 3])

    @property
    def rms_feedback(self) -> float:
        """Return the rms of the feedback, m/s²."""
        return rms(self.ticks.control[:, 2])

    @property
    def real_time_factor(self) -> float:
        """Return simulated over elapsed time."""
        times = self.ticks.times
        period = float(times[1]) if len(times) > 1 else 0.0
        return (float(times[-1]) + period) / max(self.elapsed, 1e-9)


def inside_95(nis: Array, freedom: int) -> float:
    """Return the share of the known NIS (K,) of so many positions that lies in its two-sided 95 % band."""
    known = nis[np.isfinite(nis)]
    return share_inside(known, freedom) if known.size else math.nan


def rms(values: Array) -> float:
    """Return the root mean square of values of any shape."""
    return float(np.sqrt((values**2).mean()))


class LogSink:
    """Hands the loop's ticks and events to a log's writer."""

    def __init__(self, writer: LogWriter) -> None:
        self._writer = writer

    def ticks(self, rows: Ticks) -> None:
        """Write the next ticks."""
        self._writer.ticks(
            rows.times, measured=rows.measured, estimate=rows.estimates, reference=rows.references,
            truth=rows.truth, control=rows.control,
        )  # fmt: skip

    def event(self, time_s: float, level: str, name: str, text: str) -> None:
        """Write one event."""
        self._writer.event(time_s, level, name, text)
