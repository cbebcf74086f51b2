"""What a run of the loop leaves: every tick as arrays, how it ended, and a few figures.

A log as the loop's sink: blocks of ticks and events, written as they come.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.interface import Action, Estimate
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.logs import LogWriter
from dpcontrol.loop.rig import Reading

Array = NDArray[np.float64]

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
        measured, estimates, references = (np.empty((count, size)) for size in (arms + 1, n, n))
        return cls(
            times=np.asarray(np.arange(count) * period, dtype=np.float64),
            measured=measured,
            estimates=estimates,
            references=references,
            truth=np.empty((count, n)) if has_truth else None,
            control=np.empty((count, CONTROL_HEAD + n)),
        )

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
        return Ticks(
            times=self.times[rows],
            measured=self.measured[rows],
            estimates=self.estimates[rows],
            references=self.references[rows],
            truth=None if self.truth is None else self.truth[rows],
            control=self.control[rows],
        )

    def head(self, count: int) -> "Ticks":
        """Return the first `count` ticks."""
        return self.between(0, count)


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

    ticks: its rows. ending, and reason, a sentence. nis_inside_95: share of the ticks whose NIS lies in its two-sided
    95 % band. rms_tracking_error rad: over all angles, truth (where known, else the estimate) against reference.
    max_cart_position m; rms_cart_acceleration m/s², as applied; rms_feedback m/s². real_time_factor: simulated over
    elapsed time; thinking_median, thinking_99 s: what estimator, controller and supervisor took of a tick, its median
    and 99th percentile; late: ticks that began too late. plant: the parameters that were simulated, if any.
    """

    ticks: Ticks
    ending: Ending
    reason: str
    nis_inside_95: float
    rms_tracking_error: float
    max_cart_position: float
    rms_cart_acceleration: float
    rms_feedback: float
    real_time_factor: float
    thinking_median: float
    thinking_99: float
    late: int
    plant: ArmChainParameters | None = None

    @property
    def finished(self) -> bool:
        """Tell whether the run came to the reference's end."""
        return self.ending is Ending.FINISHED

    @property
    def status(self) -> str:
        """Return `reason`."""
        return self.reason

    @property
    def residual(self) -> float:
        """Return `rms_tracking_error`."""
        return self.rms_tracking_error

    @property
    def stats(self) -> dict[str, float]:
        """Return the run's size and pace."""
        return {"ticks": len(self.ticks.times), "real_time_factor": self.real_time_factor, "late": self.late}


class LogSink:
    """Hands the loop's ticks and events to a log's writer."""

    def __init__(self, writer: LogWriter) -> None:
        self._writer = writer

    def ticks(self, rows: Ticks) -> None:
        """Write the next ticks."""
        self._writer.ticks(
            rows.times,
            measured=rows.measured,
            estimate=rows.estimates,
            reference=rows.references,
            truth=rows.truth,
            control=rows.control,
        )

    def event(self, time_s: float, level: str, name: str, text: str) -> None:
        """Write one event."""
        self._writer.event(time_s, level, name, text)
