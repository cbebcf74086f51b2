"""Score a run from its log by whether the itinerary was completed, from the true state if it is known.

A run is completed if every symbol was realised in order with its winding, wraps are as required and the cart stayed
inside its limits. Over the last full period the angles must also stay within 0.1 rad of the last orbit (least over
phase).

Symbols and wraps are decoded from the angles, see `dpcontrol.judge.decoding`.
"""

import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.estimator_settings import NisMeans, nis_means
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import Cause, Fault
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import frozen
from dpcontrol.foundation.shown import Brief
from dpcontrol.judge.decoding import FOLLOWS, NEAR_LAST_ORBIT, Decoded, decode_run, last_gap
from dpcontrol.logs import CATCH, FLIGHT, LAP, RESUME, RETURN, Event, RunLog, Stretch
from dpcontrol.logs.layout import CONTROL, ESTIMATE, REFERENCE
from dpcontrol.logs.rolling import NIGHT_METADATA
from dpcontrol.loop.result import BatchRun, Ending, inside_95, sensors_of
from dpcontrol.references.content import PlanSymbol, symbol_figures
from dpcontrol.references.problem import Limits
from dpcontrol.references.reference import Reference, load_reference
from dpcontrol.words import runs as words

Number = TypeVar("Number", int, float)
FaultFigures = tuple[Fault, Mapping[str, Any]]
"""A fault and its figures."""

REFERENCE_ATTACHMENT = "reference.npz"
"""Name of the attachment of a run's log that holds its plan."""
MODEL_METADATA = "model_parameters"
"""Metadata key of the arms' parameters, JSON."""
PLANT_METADATA, DRAWN_METADATA = "plant_parameters", "drawn"
"""Metadata key of a simulated run: the plant's parameters and other random draws, JSON."""
THINKING_METADATA = ("thinking_median", "thinking_99")
"""Metadata key of a run: duration of a tick of controller and estimator, s."""
CONSTANTS_METADATA = "model_errors"
"""Metadata key of a run: constant errors of its model at its end, JSON; see `Ticker.constants`."""
HARDEST_METADATA = "hardest_acceleration"
"""Metadata key of a simulated run: greatest acceleration applied by the drive, m/s²."""


@dataclass(frozen=True)
class Thinking:
    """Computing time of controller and estimator in a tick, s: median and 99th percentile (`within_99`)."""

    median: float
    within_99: float


_BY_END = frozenset((Fault.AT_ONCE, Fault.FIRST_LEFT, Fault.NOT_BEGUN, Fault.SYMBOL, Fault.LAST_LEFT, Fault.LAST_ENDED))
"""Faults that a run's end may explain."""


@dataclass(frozen=True)
class Verdict:
    """Verdict on a plan.

    Attributes:
        symbols: number of completed symbols.
        wraps: number of wraps at each stop that was reached.
        fault: fault of the run, `Fault.NONE` if it completed its plan.
        figures: numbers and names of the fault. `short` is the time by which the run ended early, s.
        end: event that ended the run early, or from which on another orbit was held, or None.
    """

    symbols: int
    wraps: tuple[int | None, ...]
    fault: Fault
    figures: Mapping[str, Any] = field(default_factory=dict)
    end: Event | None = None

    @property
    def completed(self) -> bool:
        """True if the run completed its plan."""
        return self.fault is Fault.NONE

    @property
    def cause(self) -> str:
        """Cause of a failure: that of an early end, otherwise the fault, as a name for tables."""
        early = self.end if "short" in self.figures else None
        return (early and early.cause) or self.fault

    @property
    def reason(self) -> str:
        """Reason of the verdict, a sentence."""
        ended = self.end.text if self.end is not None and self.fault in _BY_END else ""
        return words.verdict(self.fault, self.figures, ended)


@dataclass(frozen=True)
class Score(Documented):
    """Completion, tracking error, consistency and cart use of a run.

    Attributes:
        log: path or name of the log.
        seed: seed of the run, or None on a rig.
        completed: None if the true state is unknown, or if the log covers only a part of the run.
        symbols_completed: number of completed symbols and transfers.
        symbols_total: number of all symbols and transfers.
        wraps: at each interior stop reached, None beside a transfer.
        rms_tracking_error: over the angles, rad.
        max_cart_position: m.
        rms_cart_acceleration: m/s².
        nis_inside_95: share of ticks.
        real_time_factor: None if the log lacks it.
        verdict: on the plan.
        nis_means: share of means, None for a run too short for one.
        thinking: duration of a tick, None if the log lacks it.
        falls: number of falls, with or without return.
        returned: time from each fall, and from a start off the itinerary, until the run is on it (again), s.
        attempts: of each symbol, if returns were possible; 0 for symbols not started.
        catches: number of times the run continued from an earlier place before it fell.
        transfers: number of transfers, changes of energy included.
        transfers_between: numbers of completed and of all transfers that are counted with the symbols.
        judged_by: "truth" (plant states and drive acceleration, in simulation) or "estimate" (the loop's, on a rig).
        whole: False if the log covers only a part of the run.
        recovered: losses of a recovered log in words, or "".
    """

    KEYS: ClassVar[str] = "* reason cause"

    log: str
    seed: int | None
    completed: bool | None
    symbols_completed: int
    symbols_total: int
    wraps: tuple[int | None, ...]
    rms_tracking_error: float
    max_cart_position: float
    rms_cart_acceleration: float
    nis_inside_95: float
    real_time_factor: float | None
    verdict: Verdict
    nis_means: NisMeans | None = None
    thinking: Thinking | None = None
    falls: int = 0
    returned: tuple[float, ...] = ()
    attempts: tuple[int, ...] = ()
    catches: int = 0
    transfers: int = 0
    transfers_between: tuple[int, int] = (0, 0)
    judged_by: str = "truth"
    whole: bool = True
    recovered: str = ""

    @property
    def cause(self) -> str:
        """Cause of a failure, see `Verdict`."""
        return self.verdict.cause

    @property
    def reason(self) -> str:
        """Reason of the verdict and of its limits, a sentence."""
        return words.reason(self.verdict.reason, judged_by=self.judged_by, whole=self.whole, recovered=self.recovered)

    @property
    def missed(self) -> str:
        """Reason for a run not known to be completed, or ""; on a rig, the symbols decide without the true state.

        The exit code of the verbs depends on it.
        """
        unfinished = self.symbols_completed != self.symbols_total or not self.whole
        if self.completed is False or (self.completed is None and unfinished):
            return f"not completed: {self.reason}"
        return ""

    @property
    def sentence(self) -> str:
        """Verdict in one line, with falls, catches and symbols."""
        outcome = {True: "completed", False: "NOT completed", None: "completion unknown"}[self.completed]
        symbols = (
            f"{words.counted(self.symbols_completed, self.symbols_total, self.transfers_between)}; "
            if self.symbols_total
            else ""
        )
        interruptions = [(self.falls, "fall", "s"), (self.catches, "catch", "es")]
        interruption_text = " and ".join(
            f"{count} {noun}{plural * (count > 1)}" for count, noun, plural in interruptions if count
        )
        return f"{outcome}{f' after {interruption_text}' if interruption_text else ''}: {symbols}{self.reason}"

    def __repr__(self) -> str:
        return f"<score: {self.sentence}>"


@dataclass(frozen=True)
class Unscored(Documented):
    """A log that cannot be scored, such as a recording, with the reason."""

    log: str
    reason: str
    completed: None = None


@dataclass(frozen=True)
class Scores(Documented):
    """Scores of several logs or long runs.

    Attributes:
        results: `Score` of each log, or `Night` of each folder of a long run, in order.
        whys: `Why` of each run, with the options that complete it; empty if they were not searched.
    """

    results: tuple[Any, ...]
    whys: tuple[Any, ...] = ()

    def document(self) -> dict[str, Any]:
        """Return the document of the only score, or those of all runs."""
        documents = [result.document() for result in self.results]
        for document, why in zip(documents, self.whys, strict=False):
            document["why"] = why.document()
        return documents[0] if len(documents) == 1 else {"runs": documents}

    @property
    def missed(self) -> str:
        """Reason for which a run is not known to be completed, or ""."""
        failed = [result for result in self.results if isinstance(result, Score) and result.missed]
        if not failed:
            return ""
        knowledge = "" if all(result.completed is False for result in failed) else "known to be "
        return f"{len(failed)} of {len(self.results)} not {knowledge}completed; {failed[0].log}: {failed[0].reason}"


def plan_of(log: RunLog) -> Reference:
    """Return the reference that is attached to a log, with its plan, against which the run is scored.

    Args:
        log: log of a run.

    Raises:
        InputError: the reference is missing or damaged.
    """
    data = log.attachments.get(REFERENCE_ATTACHMENT)
    if data is None:
        explanation = (
            "another program has left out its attachments" if log.rewritten else "it is a recording, not a run"
        )
        raise InputError(
            f"{log.path} carries no {REFERENCE_ATTACHMENT}: {explanation}; give a log as `dpcontrol run` wrote it"
        )
    description = f"{log.path}: its attachment {REFERENCE_ATTACHMENT}"
    try:
        reference = load_reference(io.BytesIO(data))
    except InputError as error:
        raise InputError(f"{description} is damaged; run the itinerary again") from error
    has_right_size = reference.states.shape[-1] == 2 * len(log.arm_lengths) + 2
    if not (reference.converged and has_right_size and reference.plan is not None):
        raise InputError(f"{description} holds no plan; run the itinerary again")
    return reference


def arms_in(log: RunLog, name: str) -> ArmChainParameters | None:
    """Return the arms' parameters that a log's metadata hold, or None without them.

    Args:
        log: log of a run.
        name: `MODEL_METADATA` or `PLANT_METADATA`.
    """
    text = log.metadata.get(name)
    return None if text is None else ArmChainParameters(**frozen(json.loads(text)))


def lacking(log: RunLog) -> tuple[str, ...]:
    """Return the names of the parts that a score needs and a log lacks; a log without one of them is not judged.

    Args:
        log: log of a run or a recording.
    """
    if REFERENCE_ATTACHMENT not in log.attachments:
        return ("plan",)
    parts_by_topic = {REFERENCE: {"reference"}, CONTROL: {"control"}, ESTIMATE: {"estimate", "truth"}}
    return tuple(topic for topic, parts in parts_by_topic.items() if not parts & log.parts)


@dataclass(frozen=True, eq=False)
class Flown(Brief):
    """Motion of a run from which the verdict is derived: K ticks, n arms.

    Attributes:
        time: times (K,), s.
        states: states (K, 2n+2), true ones if known.
        reference_angles: angles (K, n) of the reference, rad.
        applied: acceleration (K,) of the cart, m/s².
        rate_hz: rate of the ticks, Hz.
        limits: of the cart in this run: position m, velocity m/s, acceleration m/s². None without a cart.
        end: event of a run's end before that of its reference, or None.
        stretches: periods on the itinerary. Empty for a run that could not recover and was on it throughout.
        hardest: greatest acceleration applied by a simulated drive, m/s². None if only `applied` is known.
    """

    time: Array
    states: Array
    reference_angles: Array
    applied: Array
    rate_hz: float
    limits: tuple[float, float, float] | None
    end: Event | None = None
    stretches: tuple[Stretch, ...] = ()
    hardest: float | None = None

    @classmethod
    def of(cls, run: BatchRun, *, rate_hz: float, limits: Limits) -> "Flown":
        """Return the motion of a simulated run, for a verdict without a log.

        Args:
            run: the run.
            rate_hz: rate of its ticks, Hz.
            limits: the cart's limits in this run.
        """
        cart_limits = (limits.position, limits.velocity, limits.acceleration)
        end = None if run.ending is Ending.FINISHED else run.end
        motion = (run.times, run.truth, run.references, run.applied)
        return cls(*motion, rate_hz, cart_limits, end, run.stretches, run.hardest)

    @property
    def angles(self) -> Array:
        """The arms' angles (K, n), rad."""
        return self.states[:, : self.reference_angles.shape[1]]


def counted(stretches: Sequence[Stretch], *, rate_hz: float) -> list[tuple[NDArray[np.intp], Array]]:
    """Return the ticks (K,) of each stretch on the itinerary that count for the score, and their times on the plan, s.

    Ticks after the restart point of a later stretch do not count, because the run repeats them. Stretches without
    counted ticks are left out.

    Args:
        stretches: stretches in order.
        rate_hz: rate of the ticks, Hz.
    """
    restart_times, counted_parts = [stretch.at for stretch in stretches], []
    for k, stretch in enumerate(stretches):
        rows = np.arange(stretch.first, stretch.end)
        times = stretch.at + (rows - stretch.first) / rate_hz
        counts = times < min(restart_times[k + 1 :], default=np.inf)
        if counts.any():
            counted_parts.append((rows[counts], times[counts]))
    return counted_parts


def spliced(flown: Flown, plan: Reference) -> Flown:
    """Return the counted part of a run on the plan's clock: each stretch up to the restart of a later one.

    If no tick of the stretches counts, the whole motion counts.

    A stretch is an interval on the itinerary between falls. Symbols completed before a fall remain completed; of a
    repeated part the last stretch counts. Whole turns by which the arms were off the plan are removed.

    Args:
        flown: motion of a run with stretches.
        plan: reference of the plan.
    """
    n, pieces_by_stretch = flown.reference_angles.shape[1], []
    for rows, times in counted(flown.stretches, rate_hz=flown.rate_hz):
        turns = flown.reference_angles[rows[0]] - plan.state(plan.mesh[0] + times[0])[:n]
        turns = np.rint(turns / (2 * np.pi)) * 2 * np.pi
        states = flown.states[rows]
        states[:, :n] -= turns
        pieces_by_stretch.append((times, states, flown.reference_angles[rows] - turns, flown.applied[rows]))
    if not pieces_by_stretch:
        return replace(flown, stretches=())
    time, states, references, applied = (np.concatenate(parts) for parts in zip(*pieces_by_stretch, strict=True))
    return replace(flown, time=time, states=states, reference_angles=references, applied=applied, stretches=())


def verdict_on(flown: Flown, plan: Reference) -> Verdict:
    """Judge a run against its plan: decode the completed part, and find the first fault.

    Of a run with stretches, the counted part is judged; the cart's limits apply to the whole motion.

    Args:
        flown: motion of the run.
        plan: reference of the plan.
    """
    if flown.stretches:
        verdict = verdict_on(spliced(flown, plan), plan)
        limit_fault = _limits(flown) if verdict.completed else None
        return verdict if limit_fault is None else replace(verdict, fault=limit_fault[0], figures=limit_fault[1])
    decoded = decode_run(flown.time, flown.angles, plan)
    fault, figures = _unobserved(flown) or _fault(flown, plan, decoded)
    return Verdict(max(0, decoded.matched - 1), decoded.wraps, fault, figures, flown.end)


def score(log: RunLog) -> Score:
    """Score a run from its log: its verdict, and figures of tracking, cart, filter and recoveries.

    Args:
        log: log of a run.

    Raises:
        InputError: the log has no plan.
    """
    plan = plan_of(log)
    truth_known = log.truth is not None
    errors = [event for event in log.events if event.level in ("error", "fatal")]
    motion = Flown(
        time=log.time,
        states=log.estimate if log.truth is None else log.truth,
        reference_angles=log.reference[:, : len(log.arm_lengths)],
        applied=log.control["applied"],
        rate_hz=log.rate_hz,
        limits=log.limits if log.has_cart else None,
        end=errors[-1] if errors else None,
        stretches=stretches_of(log),
        hardest=_noted(log, HARDEST_METADATA, float),
    )
    verdict = verdict_on(motion, plan)
    counted_motion = spliced(motion, plan) if motion.stretches else motion
    tracking_error = counted_motion.angles - counted_motion.reference_angles
    falls = sum(event.name == RETURN and event.level == "warn" for event in log.events)
    real_time_factor, seed = _noted(log, "real_time_factor", float), _noted(log, "seed", int)
    partial_fault = _part(log, motion, plan)
    completed = verdict.completed if truth_known and partial_fault is None else None
    if partial_fault is not None:
        verdict = replace(verdict, fault=partial_fault[0], figures=partial_fault[1])
    return Score(
        log=str(log.path),
        seed=seed,
        completed=completed,
        symbols_completed=verdict.symbols,
        symbols_total=len(plan.content.stops) - 1,
        transfers=len(plan.content.transfers),
        transfers_between=(_transfers(plan.content.symbols[: verdict.symbols]), _transfers(plan.content.symbols)),
        wraps=verdict.wraps,
        rms_tracking_error=float(np.sqrt(np.mean(tracking_error**2))),
        max_cart_position=float(np.abs(motion.states[:, 2 * motion.angles.shape[1]]).max()) if log.has_cart else 0.0,
        rms_cart_acceleration=float(np.sqrt(np.mean(motion.applied**2))),
        nis_inside_95=inside_95(log.control["nis"], sensors_of(log.measured)),
        real_time_factor=real_time_factor,
        verdict=verdict,
        nis_means=nis_means(log.control["nis"], sensors_of(log.measured)),
        thinking=_thinking(log),
        falls=falls,
        returned=returns(log.events),
        attempts=_attempts(log, verdict.symbols, len(plan.content.symbols)) if motion.stretches else (),
        catches=sum(event.name == CATCH for event in log.events),
        judged_by="estimate" if log.truth is None else "truth",
        whole=partial_fault is None,
        recovered=log.recovered or "",
    )


ENDINGS = frozenset(ending.value for ending in Ending)
"""Names of the events that end a run."""


def _part(log: RunLog, flown: Flown, plan: Reference) -> FaultFigures | None:
    """Return the fault of a log that covers only a part of its run or has gaps, or None for a whole log.

    Such a log cannot show that the run was completed. Only a log that another program has rewritten can be a part. On a
    rig, stamps that jump belong to the run itself, and files of a night are not checked.

    Args:
        log: log of a run.
        flown: motion in the log.
        plan: reference of the plan.
    """
    if NIGHT_METADATA in log.metadata:
        return None
    if (log.rewritten or log.truth is not None) and (gap_fault := _unobserved(flown)):
        return gap_fault
    if not log.rewritten:
        return None
    first, last, slack = float(log.time[0]), float(log.time[-1]), 1.5 / log.rate_hz
    planned_end = plan.duration if log.end_s is None else log.end_s
    # A rig's clock differs from the nominal one, so the event counts first.
    end = max((event.time for event in log.events if event.name in ENDINGS), default=planned_end)
    if first <= slack and last >= end - slack:
        return None
    figures = {"first": first, "last": last, "lasted": planned_end if first > planned_end else max(end, last)}
    return Fault.OTHER_TIMES if first > planned_end else Fault.PART, figures


def stretches_of(log: RunLog) -> tuple[Stretch, ...]:
    """Return the last repetition's periods on the itinerary, from the log's events; without recovery none.

    A stretch begins when the run joins its itinerary, and ends with a fall or a catch.

    Args:
        log: log of a run.
    """
    stretches: list[Stretch] = []
    under_way: Stretch | None = None
    for event in log.events:
        tick = round((event.time - float(log.time[0])) * log.rate_hz) if len(log.time) else 0
        if event.name in (RESUME, LAP, CATCH):
            if event.cause != Cause.JOINED:
                raise InputError(f"{log.path} does not tell where its run joined the itinerary; run it again")
            if event.name == LAP:
                stretches.clear()
            elif under_way is not None:
                stretches.append(under_way._replace(end=tick))
            under_way = Stretch(tick, len(log.time), float(event.figures["at"]))
        elif event.name == RETURN and under_way is not None:
            stretches.append(under_way._replace(end=min(tick + 1, len(log.time))))
            under_way = None
    return (*stretches, *([under_way] if under_way is not None and under_way.first < len(log.time) else ()))


def returns(events: Sequence[Event]) -> tuple[float, ...]:
    """Return the time from each departure off the itinerary until the run was on it again, s, in order.

    A flight after which the law does not take over belongs to the departure before it.

    Args:
        events: events of a run.
    """
    times, departed_at, on_itinerary = list[float](), 0.0, True
    for event in events:
        if event.name == RETURN and event.cause != Cause.LAP_DONE and on_itinerary:
            departed_at, on_itinerary = event.time, False
        elif event.name == FLIGHT and event.level == "warn" and on_itinerary and times:
            # The law did not take over at the flight's end.
            times.pop()
            on_itinerary = False
        elif event.name in (RESUME, LAP) and not on_itinerary:
            times.append(event.time - departed_at)
            on_itinerary = True
    return tuple(times)


def _attempts(log: RunLog, done: int, symbols: int) -> tuple[int, ...]:
    """Return the number of attempts of each symbol, 0 for those not started, from the log's events.

    An event that joins the itinerary has the number of the next symbol, from 1, and its attempt.

    Args:
        log: log of a run that could recover.
        done: number of completed symbols.
        symbols: number of all symbols.
    """
    attempts = [0] * symbols
    for event in log.events:
        symbol = event.figures.get("symbol", 0) if event.name in (RESUME, CATCH) else 0
        if 0 < symbol <= symbols:
            attempts[symbol - 1] = max(attempts[symbol - 1], event.figures["attempt"])
    # A symbol flown directly after the previous one took one attempt.
    return tuple(count or int(k < done) for k, count in enumerate(attempts))


def _thinking(log: RunLog) -> Thinking | None:
    """Return the computing time of a tick from the log's metadata, or None if they lack it."""
    figures = [_noted(log, name, float) for name in THINKING_METADATA]
    return None if None in figures else Thinking(*(value for value in figures if value is not None))


def _noted(log: RunLog, name: str, kind: Callable[[str], Number]) -> Number | None:
    """Return the number `name` of the log's metadata, converted by `kind`, or None if it is missing."""
    text = log.metadata.get(name)
    return None if text is None else kind(text)


def _fault(flown: Flown, plan: Reference, decoded: Decoded) -> FaultFigures:
    """Return the fault that keeps a run from completing its plan, or `Fault.NONE`, with figures for its sentence.

    The first check that fails counts, in the order of start, symbols, wraps, limits, end, and distance from the last
    orbit. `decoded` is the part of the plan that the run has completed: `matched` is the number of stops that were
    reached, and `lost` the first tick farther than `FOLLOWS` from the plan, or None.
    """
    content, matched_stops, lost_tick = plan.content, decoded.matched, decoded.lost
    stops, symbols = content.stops, content.symbols
    short = plan.duration - float(flown.time[-1])
    early = {"short": short} if short > 1.5 / flown.rate_hz else {}
    departure = {} if lost_tick is None else {"far": float(flown.time[lost_tick]), "follows": FOLLOWS}
    first_stop = {"saddle": stops[0].saddle, **early}
    if matched_stops == 0 and lost_tick is None:
        return Fault.AT_ONCE, first_stop
    if (
        matched_stops == 0
        and np.abs(flown.angles[0] - plan.state(plan.mesh[0])[: flown.angles.shape[1]]).max() < _BEGUN
    ):
        return Fault.FIRST_LEFT, {**first_stop, **departure}
    if matched_stops == 0:
        return Fault.NOT_BEGUN, first_stop
    if matched_stops < len(stops):
        return Fault.SYMBOL, {**symbol_figures(symbols, matched_stops - 1), **departure, **early}
    last_symbol = symbol_figures(symbols, -1)
    if lost_tick is not None:
        return Fault.LAST_LEFT, {**last_symbol, **departure, **early}
    for k, (required, done) in enumerate(zip(content.wraps, decoded.wraps, strict=False)):
        if required is not None and required != done:
            return Fault.WRAPS, {"stop": k + 1, "wraps": done, "wanted": required, "before": k + 2}
    if (limit_fault := _limits(flown)) is not None:
        return limit_fault
    if early:
        return Fault.LAST_ENDED, {**last_symbol, **early}
    if gap := last_gap(flown.time, flown.angles, plan, rate_hz=flown.rate_hz):
        last_orbit = {"saddle": stops[-1].saddle, "allowed": NEAR_LAST_ORBIT}
        return Fault.LAST_FAR, {**last_symbol, **last_orbit, "gap": gap}
    done = {
        "motions": len(stops) - 1,
        "transfers": _transfers(symbols),
        "wraps": [count for count in decoded.wraps if count is not None],
        "stay": "" if symbols else "orbit" if content.segments else "hold",
        "saddle": stops[-1].saddle,
        "lowest": stops[-1].saddle == content.rest,
        "still": content.orbit(stops[-1]).multiplier == 1.0,
    }
    return Fault.NONE, done


def _transfers(symbols: Sequence[PlanSymbol]) -> int:
    """Return the number of transfers among symbols, which have no section."""
    return sum(symbol.section is None for symbol in symbols)


_BEGUN = 0.5
"""Greatest distance of a run from its reference at a valid start, rad."""
_UNSEEN = 0.05
"""Longest time without a possible half turn of an arm, s."""


def _unobserved(flown: Flown) -> FaultFigures | None:
    """Return the fault of time stamps that run backwards or have gaps, with the first such step, or None.

    In a gap an arm could turn unobserved, so symbols cannot be counted.
    """
    steps = np.diff(flown.time)
    gap_rows = np.flatnonzero((steps < 0) | (steps > max(_UNSEEN, 1.5 / flown.rate_hz)))
    if not gap_rows.size:
        return None
    row = int(gap_rows[0])
    return Fault.STAMPS, {"step": float(steps[row]), "time": float(flown.time[row]), "period": 1 / flown.rate_hz}


def _limits(flown: Flown) -> FaultFigures | None:
    """Return the fault of a run whose cart exceeded a limit, with value and time of the largest excess, or None.

    The drive's hardest acceleration is checked first if it is known, then the cart's position and velocity, then its
    acceleration if the drive's is unknown. The first limit that is exceeded counts.
    """
    states, n = flown.states, flown.angles.shape[1]
    if flown.limits is None:
        return None
    position, velocity, acceleration = flown.limits
    if flown.hardest is not None and flown.hardest > acceleration + 1e-9:
        return Fault.DRIVE_LIMIT, {"value": flown.hardest, "limit": acceleration}
    for name, values, bound in (
        ("position", states[:, 2 * n], position),
        ("velocity", states[:, 2 * n + 1], velocity),
        *([("acceleration", flown.applied, acceleration)] if flown.hardest is None else []),
    ):
        largest_row = int(np.argmax(np.abs(values)))
        if abs(values[largest_row]) > bound + 1e-9:
            figures = {"value": float(values[largest_row]), "limit": bound, "time": float(flown.time[largest_row])}
            return Fault.LIMIT, {"quantity": name, **figures}
    return None
