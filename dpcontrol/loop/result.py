"""What stands at the loop's ends: the rig that it runs on, the sink that takes its ticks, how a run ended, and why.

The supervisor's outcomes: go on; restart the estimator; re-synchronise the reference's clock; hold the nearest orbit;
stop the cart in time. The tick itself decides (`dpcontrol.control.tick`); here are its settings, and the words for it.
A run that cannot be saved ends with the cart at rest inside its limits.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.estimator_settings import share_inside
from dpcontrol.control.tick import Outcome
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import Settings, setting
from dpcontrol.foundation.shown import Brief
from dpcontrol.logs import Flight, LogWriter
from dpcontrol.logs.rolling import RollingLog


class Reading(NamedTuple):
    """What came from the sensors at one tick.

    time s since the first reading; positions (n+1,): absolute angles, summed from relative encoders, then the cart;
    present (n+1,): which of them are new, or None when all are (those that are not hold their last value); switch:
    -1 or +1 while the limit switch at the left or right end of the track is touched, else 0; late s: by how much the
    deadline was missed; age s: how long before its tick the reading was taken, None if the rig does not report it. Of S
    runs side by side: positions and present (n+1, S), age (S,), and switch (S,): whether one is touched.
    """

    time: float
    positions: Array
    present: NDArray[np.bool_] | None = None
    switch: Any = 0
    late: float = 0.0
    age: Any = None


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
    OBJECT_FAILED = "object failed"
    """A user's law, estimator, plant or rig raised, took too long, or returned what it may not."""


HOLDS = ("none", "nearest")
"""What may be held where the reference was given up."""

ON_FALL = ("stop", "resume", "restart")
"""What a run does after a fall: it ends, does the symbol that failed again, or the itinerary from its beginning."""


@dataclass(frozen=True)
class SupervisorSettings(Settings, table="supervisor"):
    """When to step in.

    lost_tracking rad: mean distance of an angle from the reference from which no feedback returns (half a turn is π,
    and a completed period asks for 0.1); resynchronise rad: distance from which the clock is moved to the nearest
    phase, 0 for never. lost_estimate: mean NIS per degree of freedom; encoders that agree to a count make it thousands
    where the model is wrong by a tenth, and nothing is lost; 1e5 is some 0.04 rad. restarts: how often within a second
    the estimator is restarted before it counts as lost. missing s: longest time without a measurement. braking: share
    of the greatest acceleration that is counted on to stop the cart (it brakes harder), and margin m: what must be
    left of the track then. hold: "nearest" to hold the nearest orbit or equilibrium, once, where tracking is lost;
    "none" to stop. on_fall: what a run does whose cart had to be stopped: "stop" ends it; "resume" calms the arms,
    starts from rest and does the symbol that failed again; "restart" begins the itinerary anew. attempts: of one symbol
    until the run ends all the same.
    """

    lost_tracking: float = setting(
        1.5, least=0.05, most=100, unit="rad", help="Mean error of an angle from which tracking is lost."
    )
    resynchronise: float = setting(
        0.0, least=0, most=100, unit="rad", help="Error from which the reference's clock moves to the nearest phase."
    )
    lost_estimate: float = setting(
        100_000.0, least=5, most=1e12, help="Mean NIS per degree of freedom from which the estimate is lost."
    )
    restarts: int = setting(2, least=0, most=1000, help="Restarts of the estimator within a second.")
    missing: float = setting(0.1, least=1e-4, most=60, unit="s", help="Longest time without a measurement.")
    braking: float = setting(0.5, least=0.01, most=1, help="Share of the largest acceleration that stopping assumes.")
    margin: float = setting(0.002, least=0, most=1, unit="m", help="Free track that must remain after stopping.")
    hold: str = setting("none", choices=HOLDS, help="Motion to hold after lost tracking.")
    on_fall: str = setting("stop", choices=ON_FALL, help="Action after a fall.")
    attempts: int = setting(
        10, least=1, most=1_000_000, zero="no limit", help="Attempts of one symbol until the run ends."
    )


EVENTS = {
    Outcome.RESTART: "restart the estimator",
    Outcome.RESYNCHRONISE: "re-synchronise",
    Outcome.HOLD: "hold",
}
"""What an outcome is called in a log; all others: stop."""


def explained(outcome: Outcome, now: float, figures: Mapping[str, float], *, arms: int, period: float) -> str:
    """Return why a tick at `now` s decided so, in one sentence; figures: see `Ticker.figures`."""
    error, distance = figures["error"], figures["distance"]
    away = f"an angle has stayed {error:.2g} rad from the reference"
    lost, shown = f"estimate lost at t = {now:.3f} s:", _lost(figures)
    speed = f" with {velocity:.2f} m/s" if math.isfinite(velocity := figures["velocity"]) else ""
    cart = f"at {figures['position']:.3f} m{speed} it must brake now to stay on the track"
    match outcome:
        case Outcome.RESTART:
            return f"{shown}: the estimator restarts from the encoders"
        case Outcome.RESYNCHRONISE:
            return f"an angle is {error:.2g} rad from the reference"
        case Outcome.HOLD | Outcome.TRACKING_LOST:
            return f"tracking lost at t = {now:.3f} s: {away}"
        case Outcome.ESTIMATE_LOST:
            return f"{lost} {shown}; check the encoders and the model's parameters"
        case Outcome.SILENT:
            return f"{lost} no measurement for {figures['silent']:.3f} s; check the encoders' cables"
        case Outcome.FALLEN:
            far = f"an angle is {distance:.2g} rad from the reference"
            return f"tracking lost at t = {now:.3f} s: {far}, and the cart runs off after it: {cart}"
        case Outcome.CART:
            # No remedy: of such runs a longer track saves a third, and of those near their reference half.
            return f"cart at its stop at t = {now:.3f} s: {cart}, with an angle {distance:.2g} rad from the reference"
        case Outcome.STUCK:
            which = int(figures["sensor"])
            name = "the cart's scale" if which > arms else f"the encoder of joint {which}"
            same = f"it has given the same reading for {figures['repeats'] * period:.3g} s"
            return f"{lost} {name} is stuck: {same}; check its cable and its head"
        case Outcome.SWITCH:
            return (
                f"cart at its stop at t = {now:.3f} s: a limit switch answered, with an angle {distance:.2g} rad from "
                "the reference"
            )
        case Outcome.GO_ON:
            return ""


_ASTRAY = 1.0
"""rad: an estimate that is so far from the encoders has slipped, whatever its NIS."""
_LEAST_LOST = 5.0
"""Mean NIS from which an estimate may be said to be lost: see `SupervisorSettings`."""


def _lost(figures: Mapping[str, float]) -> str:
    """Return what is wrong with the estimate."""
    nis, apart = figures["mean_nis"], figures["apart"]
    if not math.isfinite(nis + apart):
        return "it is no longer finite"
    if apart > _ASTRAY:
        return f"it is {apart:.3g} rad from the encoders"
    if nis < _LEAST_LOST:
        return "its rates have run away"
    return f"mean NIS {nis:.3g} for each position, where 1 or so is expected"


def ending(outcome: Outcome) -> Ending:
    """Return how a run ends that is stopped by this outcome."""
    if outcome in (Outcome.CART, Outcome.SWITCH):
        return Ending.CART_STOP
    return Ending.TRACKING_LOST if outcome in (Outcome.TRACKING_LOST, Outcome.FALLEN) else Ending.ESTIMATE_LOST


@dataclass(frozen=True, eq=False)
class Ticks(Brief):
    """K ticks, n arms.

    times (K,) s; measured (K, n+1), not-a-number where an encoder gave nothing; estimates, references (K, 2n+2) in
    state order; truth the same, or None where it is not known; control (K, 9+2n) with the columns of
    `dpcontrol.logs.layout.control_fields`. told: estimates, control and extras in one, while they are written.
    extras (K, 2E): standard deviations of what is estimated besides the state, then the values.
    """

    times: Array
    measured: Array
    estimates: Array
    references: Array
    truth: Array | None
    control: Array
    told: Array | None = None
    extras: Array | None = None

    @classmethod
    def empty(
        cls, count: int, arms: int, *, has_truth: bool, period: float, extras: int = 0, first: int = 0
    ) -> "Ticks":
        """Return room for `count` ticks from `first` on, `period` s apart; extras: how many the estimator has."""
        n = 2 * arms + 2
        # What a report begins with stands together.
        end = n + CONTROL_HEAD + n
        told = np.empty((count, end + 2 * extras))
        times = np.asarray(np.arange(first, first + count) * period, dtype=np.float64)
        measured, references = np.empty((count, arms + 1)), np.empty((count, n))
        return cls(
            times, measured, told[:, :n], references, np.empty((count, n)) if has_truth else None, told[:, n:end], told,
            told[:, end:],
        )  # fmt: skip

    @classmethod
    def joined(cls, parts: "Sequence[Ticks]") -> "Ticks":
        """Return parts one after the other; of one part, itself."""
        if len(parts) == 1:
            return parts[0]

        def whole(name: str) -> Array | None:
            rows = [getattr(part, name) for part in parts]
            return None if rows[0] is None else np.concatenate(rows)

        names = ("times", "measured", "estimates", "references", "truth", "control")
        return cls(*(whole(name) for name in names), extras=whole("extras"))  # type: ignore[arg-type]

    def take(self, k: int, reading: Reading, report: Array, truth: Array | None, reference: Array) -> None:
        """Write tick k; report: see `TickEquations.report`; reference (N,)."""
        self.measured[k] = reading.positions
        self.references[k] = reference
        if reading.present is not None:
            self.measured[k, ~reading.present] = math.nan
        if self.truth is not None:
            self.truth[k] = truth
        told = self.told
        assert told is not None
        told[k] = report[: told.shape[1], 0]

    def without_nis(self, k: int) -> None:
        """Note that tick k has no NIS: the filter begins anew."""
        self.control[k, 5] = math.nan

    def between(self, first: int, end: int) -> "Ticks":
        """Return the ticks from `first` up to `end`, sharing memory."""
        rows = slice(first, end)
        truth = None if self.truth is None else self.truth[rows]
        return Ticks(
            self.times[rows], self.measured[rows], self.estimates[rows], self.references[rows], truth,
            self.control[rows], extras=None if self.extras is None else self.extras[rows],
        )  # fmt: skip


class LoopSink(Protocol):
    """Takes ticks and events as they happen; a log writer is made into one."""

    def ticks(self, rows: Ticks) -> None:
        """Take the next ticks; these rows change no more."""
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


class Sinks:
    """Passes ticks and events to several sinks in turn."""

    def __init__(self, *sinks: LoopSink) -> None:
        self._sinks = sinks

    def ticks(self, rows: Ticks) -> None:
        """Pass on the next ticks."""
        for sink in self._sinks:
            sink.ticks(rows)

    def event(self, time_s: float, level: str, name: str, text: str) -> None:
        """Pass on one event."""
        for sink in self._sinks:
            sink.event(time_s, level, name, text)


@dataclass(frozen=True, eq=False)
class LoopResult(Brief):
    """A run of K ticks, n arms.

    ticks: its rows. ending, and reason, a sentence. late: ticks that began too late; elapsed s. thinking (K,) s: what
    each tick of controller and estimator took. plant: the parameters that were simulated, if any. falls: from which it
    recovered, or not; flights: when it was on its itinerary, where it could recover. hardest: the largest acceleration
    that a simulated drive applied, m/s².
    """

    ticks: Ticks
    ending: Ending
    reason: str
    late: int
    elapsed: float
    thinking: Array
    plant: ArmChainParameters | None = None
    falls: int = 0
    flights: tuple[Flight, ...] = ()
    hardest: float | None = None

    @property
    def finished(self) -> bool:
        """Tell whether the run came to the reference's end."""
        return self.ending is Ending.FINISHED

    @property
    def nis_inside_95(self) -> float:
        """Return the share of the ticks whose NIS lies in its two-sided 95 % band."""
        return inside_95(self.ticks.control[:, 5], self.ticks.measured.shape[1])

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


@dataclass(frozen=True, eq=False)
class BatchRun(Brief):
    """One run of K ticks: what it is judged by, and a few of its figures.

    times (K,) s; truth (K, 2n+2); references (K, n): angles; applied (K,) m/s²; ending and why; falls, flights and
    hardest: see `LoopResult`. SI units.
    """

    times: Array
    truth: Array
    references: Array
    applied: Array
    ending: Ending
    reason: str
    nis_inside_95: float
    rms_feedback: float
    falls: int = 0
    flights: tuple[Flight, ...] = ()
    hardest: float | None = None

    @classmethod
    def of(cls, result: LoopResult) -> "BatchRun":
        """Return what the loop gave, in the same form.

        Raises:
            InputError: the true states of the run are not known.
        """
        ticks = result.ticks
        if ticks.truth is None:
            raise InputError("the true states are not known, so the run cannot be judged; run it in simulation")
        angles = ticks.references[:, : ticks.measured.shape[1] - 1]
        return cls(
            ticks.times, ticks.truth, angles, ticks.control[:, 3], result.ending, result.reason,
            result.nis_inside_95, result.rms_feedback, result.falls, result.flights, result.hardest,
        )  # fmt: skip


_TURN = 32
"""Ticks turned at once from lanes side by side into one after the other: singly, each row would be fetched again."""


class JudgedTicks:
    """What S runs of up to K ticks are judged by, while they go on."""

    def __init__(self, count: int, runs: int, arms: int) -> None:
        n = 2 * arms + 2
        # A run's states stand together, for they are looked at run by run.
        self._truth, self._latest = np.empty((runs, count, n)), np.empty((_TURN, n, runs))
        self._applied, self._feedback, self._nis = (np.empty((count, runs)) for _ in range(3))
        self._done = 0
        self._freedom = arms + 1

    def take(self, k: int, report: Array, at: Mapping[str, int], truth: Array) -> None:
        """Take tick k: its report (size, S), see `TickEquations.report`, and the true states (N, S)."""
        turn = k % _TURN
        self._latest[turn] = truth
        self._done = k + 1
        if turn == _TURN - 1:
            self._truth[:, k - turn : k + 1] = self._latest.transpose(2, 0, 1)
        self._applied[k], self._feedback[k], self._nis[k] = (
            report[at["acting"]],
            report[at["feedback"]],
            report[at["nis"]],
        )

    def without_nis(self, k: int, lane: int) -> None:
        """Note that tick k of a run has no NIS: the filter begins anew."""
        self._nis[k, lane] = math.nan

    def run(
        self, lane: int, count: int, references: Array, *, stands_from: int, period: float, ending: Ending, reason: str
    ) -> BatchRun:
        """Return one run of `count` ticks; references (K, n), which stand from a tick on where it was stopped."""
        rest, count = self._done % _TURN, min(count, self._done)
        self._truth[lane, self._done - rest : self._done] = self._latest[:rest, :, lane]
        wanted = references[:count].copy()
        if stands_from < count:
            wanted[stands_from:] = wanted[stands_from]
        times = np.asarray(np.arange(count) * period, dtype=np.float64)
        return BatchRun(
            times, self._truth[lane, :count], wanted, self._applied[:count, lane].copy(), ending, reason,
            inside_95(self._nis[:count, lane], self._freedom), rms(self._feedback[:count, lane]),
        )  # fmt: skip


class LogSink:
    """Hands the loop's ticks and events to a log's writer."""

    def __init__(self, writer: LogWriter | RollingLog) -> None:
        self._writer = writer

    def ticks(self, rows: Ticks) -> None:
        """Write the next ticks."""
        self._writer.ticks(
            rows.times, measured=rows.measured, estimate=rows.estimates, reference=rows.references,
            truth=rows.truth, control=rows.control, extras=rows.extras if self._writer.extras else None,
        )  # fmt: skip

    def event(self, time_s: float, level: str, name: str, text: str) -> None:
        """Write one event."""
        self._writer.event(time_s, level, name, text)


class SinkBeside:
    """Hands ticks and events to another sink in a thread, so that no disk makes a loop in real time late.

    A context manager, which waits for what is under way; what failed there is raised with later rows, or at the end.
    """

    def __init__(self, sink: LoopSink) -> None:
        # The thread itself begins with the first event, by the priority that the loop has then: one that had less would
        # hold the interpreter up where the computer is busy.
        self._sink, self._thread = sink, ThreadPoolExecutor(1, "log")
        self._under_way = deque[Future[None]]()

    def __enter__(self) -> "SinkBeside":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._thread.shutdown()
        if kind is None:
            self._look()

    def ticks(self, rows: Ticks) -> None:
        """Write the next ticks."""
        self._look()
        self._under_way.append(self._thread.submit(self._sink.ticks, rows))

    def event(self, time_s: float, level: str, name: str, text: str) -> None:
        """Write one event."""
        self._look()
        self._under_way.append(self._thread.submit(self._sink.event, time_s, level, name, text))

    def _look(self) -> None:
        while self._under_way and self._under_way[0].done():
            self._under_way.popleft().result()
