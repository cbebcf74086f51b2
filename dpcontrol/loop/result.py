"""Ends of the loop: the rig, its sinks, and a run's ending.

The supervisor has these outcomes: continue, restart the estimator, resynchronise the reference's clock, hold the
nearest orbit, or stop the cart in time. The tick itself decides (`dpcontrol.control.tick`). This module has its
settings and endings. A run that cannot be saved ends with the cart at rest inside its limits.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, Protocol

import numpy as np

from dpcontrol.control.estimator_settings import share_inside
from dpcontrol.control.tick import Report
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import Cause
from dpcontrol.foundation.settings import Setting, Settings
from dpcontrol.foundation.shown import Brief
from dpcontrol.logs import Event, LogWriter, Stretch
from dpcontrol.logs.rolling import RollingLog
from dpcontrol.loop.protocols import Reading, UserRig


class Rig(UserRig, Protocol):
    """Interface between the loop and a simulated or real bench.

    Each period: one `read`, which waits for the tick, then one `command`. After `stop`, the cart brakes to a standstill
    and further commands are ignored.
    """

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

    @property
    def truth(self) -> Array | None:
        """Return the true state (2n+2,) at the last reading's tick, or None if it is unknown.

        A simulated bench knows it. Logs and scores use it, the loop does not.
        """

    @property
    def fault(self) -> Event | None:
        """Return the event of a bench's failure, such as the end of its track, or None."""


CONTROL_HEAD = 7
"""Columns of `control` before the standard deviations: see `dpcontrol.logs.layout.control_fields`."""


class Ending(StrEnum):
    """Reason why a run ended."""

    FINISHED = "finished"
    """The reference was followed to its end. The score decides if the itinerary was completed."""
    FELL_BACK = "fell back"
    """The nearest orbit was held after tracking was lost, to the end."""
    CART_STOP = "cart at its stop"
    ESTIMATE_LOST = "estimate lost"
    TRACKING_LOST = "tracking lost"
    DRIVE_FAILED = "drive failed"
    PLANT_FAILED = "plant failed"
    OBJECT_FAILED = "object failed"
    """A user's law, estimator, plant or rig raised, took too long, or returned an invalid value."""


HOLDS = ("none", "nearest")
"""Motions that can be held after tracking is lost."""

ON_FALL = ("stop", "resume", "restart")
"""Actions after a fall: end the run, repeat the failed symbol, or restart the itinerary."""


@dataclass(frozen=True)
class SupervisorSettings(Settings, table="supervisor"):
    """Limits of the supervisor, and its actions.

    Attributes:
        lost_tracking: mean distance of an angle from the reference beyond which feedback cannot return, rad. Half a
            turn is π, and a completed period requires 0.1.
        resynchronise: distance at which the clock moves to the nearest phase, rad, 0 for never.
        lost_estimate: mean NIS per degree of freedom. It reaches thousands if encoders are exact to a count and the
            model is wrong by a tenth, without harm. 1e5 is about 0.04 rad.
        restarts: restarts of the estimator within a second before it counts as lost.
        missing: longest time without a measurement of a position, s.
        braking: share of the largest acceleration that stopping assumes. The actual braking is harder.
        margin: free track that must remain after stopping, m.
        hold: "nearest" to hold the nearest orbit or equilibrium once if tracking is lost, "none" to stop.
        on_fall: action after a fall: "stop" ends the run, "resume" flies back to a stop and repeats the failed
            symbol, "restart" flies to the first stop and begins the itinerary again.
        attempts: attempts of one symbol until the run ends.
    """

    lost_tracking: Annotated[
        float,
        Setting(
            least=0.05,
            most=100,
            unit="rad",
            usual=(0.05, 4 * np.pi),
            help="Mean error of an angle from which tracking is lost.",
        ),
    ] = 1.5
    resynchronise: Annotated[
        float,
        Setting(
            least=0,
            most=100,
            unit="rad",
            usual=(0.0, 4 * np.pi),
            help="Error from which the reference's clock moves to the nearest phase.",
        ),
    ] = 0.0
    lost_estimate: Annotated[
        float, Setting(least=5, most=1e12, help="Mean NIS per degree of freedom from which the estimate is lost.")
    ] = 100_000.0
    restarts: Annotated[int, Setting(least=0, most=1000, help="Restarts of the estimator within a second.")] = 2
    missing: Annotated[
        float,
        Setting(
            least=1e-4, most=60, unit="s", usual=(1e-3, 5.0), help="Longest time without a measurement of a position."
        ),
    ] = 0.1
    braking: Annotated[
        float, Setting(least=0.01, most=1, help="Share of the largest acceleration that stopping assumes.")
    ] = 0.5
    margin: Annotated[float, Setting(least=0, most=1, unit="m", help="Free track that must remain after stopping.")] = (
        0.002
    )
    hold: Annotated[str, Setting(choices=HOLDS, help="Motion to hold after lost tracking.")] = "none"
    on_fall: Annotated[str, Setting(choices=ON_FALL, help="Action after a fall.")] = "stop"
    attempts: Annotated[
        int, Setting(least=1, most=1_000_000, zero="no limit", help="Attempts of one symbol until the run ends.")
    ] = 10


ENDINGS = {
    Cause.FINISHED: Ending.FINISHED,
    Cause.TIME_OVER: Ending.FINISHED,
    Cause.HOLD: Ending.FELL_BACK,
    **dict.fromkeys((Cause.CART, Cause.SWITCH, Cause.HARD_STOP, Cause.RIG_FAULT), Ending.CART_STOP),
    **dict.fromkeys((Cause.ESTIMATE_LOST, Cause.SILENT, Cause.STUCK), Ending.ESTIMATE_LOST),
    **dict.fromkeys((Cause.TRACKING_LOST, Cause.FALLEN, Cause.TOO_FAST, Cause.NOT_HELD), Ending.TRACKING_LOST),
    **dict.fromkeys((Cause.DRIVE_OFF, Cause.DRIVE_REVERSED), Ending.DRIVE_FAILED),
    Cause.PLANT_FAILED: Ending.PLANT_FAILED,
    Cause.OBJECT_FAILED: Ending.OBJECT_FAILED,
}
"""Kind of ending by its cause."""


def ended(cause: Cause, figures: Mapping[str, Any] | None = None, words: str = "") -> Event:
    """Return the event that ends a run, whose time the loop sets.

    Args:
        cause: cause of the end.
        figures: numbers and names for the sentence on the end.
        words: sentence of an end that comes from outside, such as the message of a user's object.
    """
    ending = ENDINGS[cause]
    return Event(0.0, "info" if ending is Ending.FINISHED else "error", ending.value, cause, figures or {}, words)


@dataclass(frozen=True, eq=False)
class Ended(Brief):
    """A run that has ended.

    Attributes:
        end: event of its end.
    """

    end: Event

    @property
    def ending(self) -> Ending:
        """Kind of ending."""
        return Ending(self.end.name)

    @property
    def reason(self) -> str:
        """Reason of the ending, a sentence."""
        return self.end.text


@dataclass(frozen=True, eq=False)
class Ticks(Brief):
    """Readings, estimates, references and commands of K ticks, n arms.

    Attributes:
        times: times (K,), s.
        measured: measured positions (K, n+1), NaN for missing ones.
        estimates: estimated states (K, 2n+2).
        references: reference states (K, 2n+2).
        truth: true states (K, 2n+2), or None if unknown.
        control: columns of `dpcontrol.logs.layout.control_fields` (K, 9+2n).
        packed: estimates, control and extras in one array, while they are written.
        extras: standard deviations of additionally estimated parameters, then their values (K, 2E).
    """

    times: Array
    measured: Array
    estimates: Array
    references: Array
    truth: Array | None
    control: Array
    packed: Array | None = None
    extras: Array | None = None

    @classmethod
    def empty(
        cls, count: int, arms: int, *, has_truth: bool, period: float, extras: int = 0, first: int = 0
    ) -> "Ticks":
        """Return arrays for K ticks that are not yet written.

        Estimates, control and extras share one array, so that the report of a tick is written in one copy.

        Args:
            count: number of ticks.
            arms: number of arms.
            has_truth: True for room for true states.
            period: time between ticks, s.
            extras: number of additionally estimated parameters, default 0.
            first: number of the first tick, default 0.
        """
        n = 2 * arms + 2
        # The first columns of a report are contiguous.
        end = n + CONTROL_HEAD + n
        packed = np.empty((count, end + 2 * extras))
        times = np.asarray(np.arange(first, first + count) * period, dtype=np.float64)
        measured, references = np.empty((count, arms + 1)), np.empty((count, n))
        return cls(
            times, measured, packed[:, :n], references, np.empty((count, n)) if has_truth else None, packed[:, n:end],
            packed, packed[:, end:],
        )  # fmt: skip

    @classmethod
    def joined(cls, parts: "Sequence[Ticks]") -> "Ticks":
        """Return successive blocks of one run as one, or the only block without a copy.

        Args:
            parts: blocks of ticks, in order.
        """
        if len(parts) == 1:
            return parts[0]

        def joined_array(name: str) -> Array | None:
            """Return an attribute of all blocks as one array, or None if the blocks lack it."""
            arrays = [getattr(part, name) for part in parts]
            return None if arrays[0] is None else np.concatenate(arrays)

        names = ("times", "measured", "estimates", "references", "truth", "control")
        return cls(*(joined_array(name) for name in names), extras=joined_array("extras"))  # type: ignore[arg-type]

    def take(self, k: int, reading: Reading, logged: Array, truth: Array | None, reference: Array) -> None:
        """Write tick k of a run into its row.

        Args:
            k: row of the tick.
            reading: reading of the tick, whose missing positions become NaN.
            logged: the report's part in a log, see `TickProgram.logged`.
            truth: true state (N,), None if unknown.
            reference: reference state (N,).
        """
        self.measured[k] = reading.positions
        self.references[k] = reference
        if reading.present is not None:
            self.measured[k, ~reading.present] = math.nan
        if self.truth is not None:
            self.truth[k] = truth
        packed = self.packed
        assert packed is not None
        packed[k] = logged

    def take_block(self, rows: slice, measured: Array, logged: Array, truth: Array, references: Array) -> None:
        """Write a block of K ticks that `Blocks` has computed into rows.

        Args:
            rows: range of the rows to write.
            measured: readings (K, n+1), NaN where missing.
            logged: reports (K, M), whose first columns are estimates, control and extras.
            truth: states of the plant (K, N), whose first columns are the true states.
            references: reference states (K, N).
        """
        packed, states = self.packed, self.truth
        assert packed is not None
        assert states is not None
        self.measured[rows], self.references[rows] = measured, references
        packed[rows], states[rows] = logged[:, : packed.shape[1]], truth[:, : states.shape[1]]

    def between(self, first: int, end: int) -> "Ticks":
        """Return a range of ticks, sharing memory: the rows that a sink has not yet received, or those of a result.

        Args:
            first: first row.
            end: row after the last one.
        """
        rows = slice(first, end)
        truth = None if self.truth is None else self.truth[rows]
        return Ticks(
            self.times[rows], self.measured[rows], self.estimates[rows], self.references[rows], truth,
            self.control[rows], extras=None if self.extras is None else self.extras[rows],
        )  # fmt: skip


class LoopSink:
    """Receiver of ticks and events, such as a log writer.

    This one discards everything, since the result holds every tick.
    """

    def ticks(self, rows: Ticks) -> None:
        """Receive the next ticks.

        Args:
            rows: next ticks, which are final.
        """

    def event(self, event: Event) -> None:
        """Receive one event.

        Args:
            event: the event.
        """


class Events(LoopSink):
    """A sink that stores the events of a run in `kept`; the result holds every tick."""

    def __init__(self) -> None:
        self.kept: list[Event] = []

    def event(self, event: Event) -> None:
        """Append one event.

        Args:
            event: the event.
        """
        self.kept.append(event)


class Sinks(LoopSink):
    """Passes ticks and events to several sinks in turn."""

    def __init__(self, *sinks: LoopSink) -> None:
        self._sinks = sinks

    def ticks(self, rows: Ticks) -> None:
        """Pass on the next ticks.

        Args:
            rows: next ticks.
        """
        for sink in self._sinks:
            sink.ticks(rows)

    def event(self, event: Event) -> None:
        """Pass on one event.

        Args:
            event: the event.
        """
        for sink in self._sinks:
            sink.event(event)


@dataclass(frozen=True, eq=False)
class LoopResult(Ended):
    """A run of K ticks, n arms.

    Attributes:
        ticks: its rows.
        late: number of ticks that began too late.
        elapsed: duration of the computation, s.
        thinking: computing time (K,) of controller and estimator, s; in blocks of ticks with that of the bench.
        plant: simulated parameters, if any.
        falls: falls with or without recovery.
        stretches: intervals on the itinerary, if recovery was possible.
        hardest: largest acceleration of a simulated drive, m/s².
        constants: the model's constant errors at the end, if they are estimated; see `Ticker.constants`.
    """

    ticks: Ticks
    late: int
    elapsed: float
    thinking: Array
    plant: ArmChainParameters | None = None
    falls: int = 0
    stretches: tuple[Stretch, ...] = ()
    hardest: float | None = None
    constants: tuple[list[Any], ...] | None = None

    @property
    def real_time_factor(self) -> float:
        """Simulated duration of the run over the computing time."""
        times = self.ticks.times
        period = float(times[1]) if len(times) > 1 else 0.0
        return (float(times[-1]) + period) / max(self.elapsed, 1e-9)


def inside_95(nis: Array, freedom: int) -> float:
    """Return the share of NIS values in their two-sided 95 % band, which is about 0.95 for a consistent filter.

    The degrees of freedom are the number of measured positions.

    Args:
        nis: NIS (K,), NaN where unknown.
        freedom: number of measured positions.
    """
    finite = nis[np.isfinite(nis)]
    return share_inside(finite, freedom) if finite.size else math.nan


def sensors_of(measured: Array) -> int:
    """Return the number of positions that a run measures, the degrees of freedom of its NIS.

    Args:
        measured: readings (K, n+1), NaN where missing.
    """
    return int(np.isfinite(measured).any(axis=0).sum())


def rms(values: Array) -> float:
    """Return the root mean square of all values.

    Args:
        values: values of any shape.
    """
    return float(np.sqrt((values**2).mean()))


@dataclass(frozen=True, eq=False)
class BatchRun(Ended):
    """One run of K ticks with the data from which it is scored, without readings and estimates.

    Attributes:
        times: times (K,), s.
        truth: true states (K, 2n+2).
        references: reference angles (K, n), rad.
        applied: accelerations (K,) of the cart, m/s².
        nis_inside_95: share of NIS values in their 95 % band.
        rms_feedback: root mean square of the feedback, m/s².
        stretches: intervals on the itinerary, see `LoopResult`.
        hardest: largest acceleration of the drive, m/s².
        departed: True for a run that is only known until its recovery would act.
    """

    times: Array
    truth: Array
    references: Array
    applied: Array
    nis_inside_95: float
    rms_feedback: float
    stretches: tuple[Stretch, ...] = ()
    hardest: float | None = None
    departed: bool = False

    @classmethod
    def of(cls, result: LoopResult) -> "BatchRun":
        """Return the data from which a run is scored, from the result of a loop that ran it alone.

        Args:
            result: result of a loop with true states.
        """
        ticks = result.ticks
        assert ticks.truth is not None
        angles = ticks.references[:, : ticks.measured.shape[1] - 1]
        # Columns of `control`: 2 the feedback, 3 the applied acceleration, m/s², 5 the NIS.
        return cls(
            result.end, ticks.times, ticks.truth, angles, ticks.control[:, 3],
            inside_95(ticks.control[:, 5], sensors_of(ticks.measured)), rms(ticks.control[:, 2]), result.stretches,
            result.hardest,
        )  # fmt: skip


_TURN = 32
"""Ticks transposed together from lanes to runs: one by one, each row would be fetched again."""


class JudgedTicks:
    """The ticks of S runs in lockstep, stored while they are computed, with the data from which runs are scored.

    Args:
        count: largest number of ticks of a run.
        runs: number S of runs.
        arms: number n of arms.
    """

    def __init__(self, count: int, runs: int, arms: int) -> None:
        """Allocate room for all ticks of all runs; `_latest` holds states that are not yet transposed.

        `_truth` are the states of each run, and `_applied`, `_feedback` and `_nis` (K, S) the acting accelerations,
        m/s², the feedback, m/s², and the NIS. `_done` is the number of stored ticks, and `_freedom` the number
        of measured positions, by which the NIS is judged.
        """
        n = 2 * arms + 2
        # A run's states are contiguous because they are read run by run.
        self._truth, self._latest = np.empty((runs, count, n)), np.empty((_TURN, n, runs))
        self._applied, self._feedback, self._nis = (np.empty((count, runs)) for _ in range(3))
        self._done = 0
        self._freedom = arms + 1

    def take(self, k: int, report: Report, truth: Array) -> None:
        """Store the states, accelerations, feedback and NIS of tick k of all runs.

        States are collected for `_TURN` ticks, then transposed to be contiguous for each run.

        Args:
            k: tick.
            report: its report, parts (length, S).
            truth: true states (N, S).
        """
        row = k % _TURN
        self._latest[row] = truth
        self._done = k + 1
        if row == _TURN - 1:
            self._truth[:, k - row : k + 1] = self._latest.transpose(2, 0, 1)
        self._applied[k], self._feedback[k], self._nis[k] = report.acting[0], report.feedback[0], report.nis[0]

    def without_nis(self, k: int, lane: int) -> None:
        """Clear the NIS of a tick at which the filter restarts, because its innovation has no meaning.

        Args:
            k: tick.
            lane: number of the run.
        """
        self._nis[k, lane] = math.nan

    def run(
        self,
        lane: int,
        count: int,
        references: Array,
        *,
        still_from: int,
        period: float,
        end: Event,
    ) -> BatchRun:
        """Return one run that has ended: its stored ticks, the share of NIS in its band, and the rms of its feedback.

        States that are not yet transposed are written first.

        Args:
            lane: number of the run.
            count: number of ticks until its end; at most those stored are returned.
            references: reference angles (K, n), rad, of all ticks.
            still_from: tick at which its cart was stopped, from which the references are constant.
            period: time between ticks, s.
            end: event of its end.
        """
        pending, count = self._done % _TURN, min(count, self._done)
        self._truth[lane, self._done - pending : self._done] = self._latest[:pending, :, lane]
        reference_angles = references[:count].copy()
        if still_from < count:
            reference_angles[still_from:] = reference_angles[still_from]
        times = np.asarray(np.arange(count) * period, dtype=np.float64)
        return BatchRun(
            end, times, self._truth[lane, :count], reference_angles, self._applied[:count, lane].copy(),
            inside_95(self._nis[:count, lane], self._freedom), rms(self._feedback[:count, lane]),
        )  # fmt: skip


class LogSink(LoopSink):
    """Writes the loop's ticks and events to a log."""

    def __init__(self, writer: LogWriter | RollingLog) -> None:
        self._writer = writer

    def ticks(self, rows: Ticks) -> None:
        """Write the next ticks to the log, with the extras if the log has room for them.

        Args:
            rows: next ticks.
        """
        self._writer.ticks(
            rows.times, measured=rows.measured, estimate=rows.estimates, reference=rows.references,
            truth=rows.truth, control=rows.control, extras=rows.extras if self._writer.extras else None,
        )  # fmt: skip

    def event(self, event: Event) -> None:
        """Write one event.

        Args:
            event: the event.
        """
        self._writer.event(event)


class SinkBeside(LoopSink):
    """Passes ticks and events to another sink in a thread, so that a slow disk does not delay a loop in real time.

    The context manager waits for pending rows. An error in the thread is raised with later rows or at the end.
    """

    def __init__(self, sink: LoopSink) -> None:
        # The thread starts at the first event, with the loop's priority at that time. A lower priority would block
        # the interpreter on a busy computer. `_under_way` are the transfers that may not be finished, oldest first.
        self._sink, self._thread = sink, ThreadPoolExecutor(1, "log")
        self._under_way = deque[Future[None]]()

    def __enter__(self) -> "SinkBeside":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._thread.shutdown()
        if kind is None:
            self._look()

    def ticks(self, rows: Ticks) -> None:
        """Pass the next ticks to the sink's thread, which writes them later.

        Args:
            rows: next ticks.
        """
        self._look()
        self._under_way.append(self._thread.submit(self._sink.ticks, rows))

    def event(self, event: Event) -> None:
        """Pass one event to the sink's thread, which writes it later.

        Args:
            event: the event.
        """
        self._look()
        self._under_way.append(self._thread.submit(self._sink.event, event))

    def _look(self) -> None:
        """Remove finished transfers from the queue, and raise the error of the first that failed."""
        while self._under_way and self._under_way[0].done():
            self._under_way.popleft().result()
