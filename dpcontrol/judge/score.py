"""Score a run from its log, by whether the itinerary was completed.

The true state is used if it is known.

A run is completed if every symbol was realised in order with its winding, wraps are as required and the cart stayed
inside its limits. Over the last full period the angles must also stay within 0.1 rad of the last orbit (least over
phase).

Symbols and wraps are decoded from the angles, see `dpcontrol.judge.decoding`.
"""

import io
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.estimator_settings import NisMeans, nis_means
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import frozen
from dpcontrol.foundation.shown import Brief
from dpcontrol.judge.decoding import FOLLOWS, NEAR_LAST_ORBIT, Decoded, decode_run, last_gap
from dpcontrol.logs import CATCH, LAP, RESUME, RETURN, Flight, RunLog, joined_at
from dpcontrol.logs.layout import CONTROL, ESTIMATE, REFERENCE
from dpcontrol.logs.rolling import NIGHT_METADATA
from dpcontrol.loop.result import Ending, inside_95
from dpcontrol.references.content import PlanContent
from dpcontrol.references.reference import Reference, load_reference

Number = TypeVar("Number", int, float)

REFERENCE_ATTACHMENT = "reference.npz"
MODEL_METADATA = "model_parameters"
"""Metadata key of the arms' parameters, JSON."""
PLANT_METADATA, DRAWN_METADATA = "plant_parameters", "drawn"
"""Metadata key of a simulated run: the plant's parameters and other random draws, JSON."""
THINKING_METADATA = ("thinking_median", "thinking_99")
"""Metadata key of a run: duration of a tick of controller and estimator, s."""
HARDEST_METADATA = "hardest_acceleration"
"""Metadata key of a simulated run: greatest acceleration applied by the drive, m/s²."""


@dataclass(frozen=True)
class Thinking:
    """Duration of a tick, s: median and 99th percentile.

    A tick consists of controller and estimator.
    """

    median: float
    within_99: float


@dataclass(frozen=True)
class Score(Documented):
    """Completion, tracking error, consistency and cart use of a run.

    Attributes:
        completed: None if the true state is unknown, or if the log covers only a part of the run.
        wraps: at each interior stop reached, None beside a transfer.
        rms_tracking_error: over the angles, rad.
        max_cart_position: m.
        rms_cart_acceleration: m/s².
        nis_inside_95: share of ticks.
        nis_means: share of means, None for a run too short for one.
        real_time_factor: None if the log lacks it.
        thinking: duration of a tick, None if the log lacks it.
        reason: a sentence.
        falls: number of falls, with or without return.
        attempts: of each symbol, if returns were possible; 0 for symbols not started.
        catches: number of times the run continued from an earlier place before it fell.
        transfers: number of transfers, most of which are counted with the symbols.
        judged_by: "truth" (plant states and drive acceleration, in simulation) or "estimate" (the loop's, on a rig).
        whole: False if the log covers only a part of the run.
    """

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
    reason: str
    nis_means: NisMeans | None = None
    thinking: Thinking | None = None
    falls: int = 0
    attempts: tuple[int, ...] = ()
    catches: int = 0
    transfers: int = 0
    judged_by: str = "truth"
    whole: bool = True

    @property
    def sentence(self) -> str:
        """Verdict in one line."""
        done = {True: "completed", False: "NOT completed", None: "completion unknown"}[self.completed]
        symbols = (
            f"{self.symbols_completed} of {self.symbols_total} {_motions(self.symbols_total, self.transfers)}; "
            if self.symbols_total
            else ""
        )
        after = [(self.falls, "fall", "s"), (self.catches, "catch", "es")]
        borne = " and ".join(f"{count} {what}{more * (count > 1)}" for count, what, more in after if count)
        return f"{done}{f' after {borne}' if borne else ''}: {symbols}{self.reason}"

    def __repr__(self) -> str:
        return f"<score: {self.sentence}>"


def plan_of(log: RunLog) -> Reference:
    """Return the reference in the log, with its plan.

    Args:
        log: log of a run.

    Raises:
        InputError: the reference is missing or damaged.
    """
    data = log.attachments.get(REFERENCE_ATTACHMENT)
    if data is None:
        why = "another program has left out its attachments" if log.rewritten else "it is a recording, not a run"
        raise InputError(f"{log.path} carries no {REFERENCE_ATTACHMENT}: {why}; give a log as `dpcontrol run` wrote it")
    place = f"{log.path}: its attachment {REFERENCE_ATTACHMENT}"
    try:
        reference = load_reference(io.BytesIO(data))
    except InputError as error:
        raise InputError(f"{place} is damaged; run the itinerary again") from error
    fits = reference.states.shape[-1] == 2 * len(log.arm_lengths) + 2
    if not (reference.converged and fits and reference.plan is not None):
        raise InputError(f"{place} holds no plan; run the itinerary again")
    return reference


def arms_in(log: RunLog, name: str) -> ArmChainParameters | None:
    """Return the arms' parameters in a log's metadata, or None without them.

    Args:
        log: log of a run.
        name: `MODEL_METADATA` or `PLANT_METADATA`.

    Raises:
        InputError: this part of the log is damaged.
    """
    text = log.metadata.get(name)
    try:
        return None if text is None else ArmChainParameters(**frozen(json.loads(text)))
    except (TypeError, ValueError, AttributeError, RecursionError) as error:
        raise InputError(f"{log.path}: its {name} do not read: {error}; run it again") from error


def lacking(log: RunLog) -> tuple[str, ...]:
    """Return the parts that a score needs and a log lacks.

    Args:
        log: log of a run or a recording.
    """
    if REFERENCE_ATTACHMENT not in log.attachments:
        return ("plan",)
    needed = {REFERENCE: {"reference"}, CONTROL: {"control"}, ESTIMATE: {"estimate", "truth"}}
    return tuple(topic for topic, parts in needed.items() if not parts & log.parts)


@dataclass(frozen=True, eq=False)
class Flown(Brief):
    """Basis of the verdict on a run: K ticks, n arms.

    Attributes:
        time: (K,) s.
        states: (K, 2n+2), true ones if known.
        reference_angles: (K, n) rad.
        applied: (K,) acceleration of the cart, m/s².
        ended: reason for a run's end before that of its reference.
        limits: of the cart in this run: position m, velocity m/s, acceleration m/s². None without a cart.
        flights: periods on the itinerary. Empty for a run that could not recover and was on it throughout.
        hardest: greatest acceleration applied by a simulated drive, m/s². None if only `applied` is known.
    """

    time: Array
    states: Array
    reference_angles: Array
    applied: Array
    rate_hz: float
    limits: tuple[float, float, float] | None
    ended: str = ""
    flights: tuple[Flight, ...] = ()
    hardest: float | None = None

    @property
    def angles(self) -> Array:
        """The arms' angles (K, n), rad."""
        return self.states[:, : self.reference_angles.shape[1]]


@dataclass(frozen=True)
class Verdict:
    """Verdict on a plan.

    It holds completion, symbols done, wraps at the stops reached, and a sentence on the fault, or "".
    """

    symbols: int
    wraps: tuple[int | None, ...]
    problem: str


def counted(flights: Sequence[Flight], *, rate_hz: float) -> list[tuple[NDArray[np.intp], Array]]:
    """Return the ticks of each flight that count, and their times.

    Times are those of the plan's reference, s. No flight is omitted.

    Ticks after the restart point of a later flight do not count.

    Args:
        flights: flights in order.
        rate_hz: rate of the ticks, Hz.
    """
    again, out = [flight.at for flight in flights], []
    for k, flight in enumerate(flights):
        rows = np.arange(flight.first, flight.end)
        times = flight.at + (rows - flight.first) / rate_hz
        mine = times < min(again[k + 1 :], default=np.inf)
        if mine.any():
            out.append((rows[mine], times[mine]))
    return out


def spliced(flown: Flown, plan: Reference) -> Flown:
    """Return the counted part of a run on the plan's clock.

    It consists of each flight up to the restart of a later one.

    Symbols completed before a fall remain completed; of a repeated part the last flight counts.

    Args:
        flown: run with flights.
        plan: reference of the plan.
    """
    n, pieces = flown.reference_angles.shape[1], []
    for rows, times in counted(flown.flights, rate_hz=flown.rate_hz):
        turns = flown.reference_angles[rows[0]] - plan.state(plan.mesh[0] + times[0])[:n]
        turns = np.rint(turns / (2 * np.pi)) * 2 * np.pi
        states = flown.states[rows]
        states[:, :n] -= turns
        pieces.append((times, states, flown.reference_angles[rows] - turns, flown.applied[rows]))
    if not pieces:
        return flown
    time, states, references, applied = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    return replace(flown, time=time, states=states, reference_angles=references, applied=applied, flights=())


def verdict_on(flown: Flown, plan: Reference) -> Verdict:
    """Judge a run against its plan.

    Args:
        flown: basis of the verdict.
        plan: reference of the plan.
    """
    if flown.flights:
        verdict = verdict_on(spliced(flown, plan), plan)
        return verdict if verdict.problem else replace(verdict, problem=_limits(flown))
    decoded = decode_run(flown.time, flown.angles, plan)
    return Verdict(max(0, decoded.matched - 1), decoded.wraps, _problem(flown, plan, decoded))


def score(log: RunLog) -> Score:
    """Score a run from its log.

    Args:
        log: log of a run.

    Raises:
        InputError: the log has no plan.
    """
    plan = plan_of(log)
    known = log.truth is not None
    bad = [event for event in log.events if event.level in ("error", "fatal")]
    flown = Flown(
        time=log.time,
        states=log.estimate if log.truth is None else log.truth,
        reference_angles=log.reference[:, : len(log.arm_lengths)],
        applied=log.control["applied"],
        rate_hz=log.rate_hz,
        limits=log.limits if log.has_cart else None,
        ended=bad[-1].text if bad else "",
        flights=flights_of(log),
        hardest=_hardest(log),
    )
    verdict = verdict_on(flown, plan)
    judged = spliced(flown, plan) if flown.flights else flown
    away = judged.angles - judged.reference_angles
    falls = sum(event.name == RETURN and event.level == "warn" for event in log.events)
    factor, seed = _noted(log, "real_time_factor", float), _noted(log, "seed", int)
    reason = verdict.problem or _done(verdict.wraps, plan.content)
    if not known:
        reason = f"the true state is not known, so completion cannot be judged; by the estimate: {reason}"
    if part := _part(log, flown, plan):
        known, reason = False, part
    if log.recovered:
        reason += f"; {recovered_note(log)}"
    return Score(
        log=str(log.path),
        seed=seed,
        completed=(not verdict.problem) if known else None,
        symbols_completed=verdict.symbols,
        symbols_total=len(plan.content.stops) - 1,
        transfers=len(plan.content.transfers),
        wraps=verdict.wraps,
        rms_tracking_error=float(np.sqrt(np.mean(away**2))),
        max_cart_position=float(np.abs(flown.states[:, 2 * flown.angles.shape[1]]).max()) if log.has_cart else 0.0,
        rms_cart_acceleration=float(np.sqrt(np.mean(flown.applied**2))),
        nis_inside_95=inside_95(log.control["nis"], log.measured.shape[1]),
        real_time_factor=factor,
        reason=reason,
        nis_means=nis_means(log.control["nis"], log.measured.shape[1]),
        thinking=_thinking(log),
        falls=falls,
        attempts=_attempts(log, verdict.symbols, len(plan.content.symbols)) if flown.flights else (),
        catches=sum(event.name == CATCH for event in log.events),
        judged_by="estimate" if log.truth is None else "truth",
        whole=not part,
    )


_ENDINGS = frozenset(ending.value for ending in Ending)


def _part(log: RunLog, flown: Flown, plan: Reference) -> str:
    """Return a note on the part that a log covers.

    The result is "" for a log of the whole run. On a rig, stamps that jump belong to the run itself.
    """
    if NIGHT_METADATA in log.metadata:
        return ""
    if (log.rewritten or log.truth is not None) and (unknown := _unobserved(flown)):
        return f"{unknown}, so completion cannot be judged"
    if not log.rewritten:
        return ""
    first, last, slack = float(log.time[0]), float(log.time[-1]), 1.5 / log.rate_hz
    noted = plan.duration if log.end_s is None else log.end_s
    # A rig's clock differs from the nominal one, so the event counts first.
    end = max((event.time for event in log.events if event.name in _ENDINGS), default=noted)
    if first <= slack and last >= end - slack:
        return ""
    covers = f"the log covers only {first:.3f} to {last:.3f} s of the run's {max(end, last):.3f} s"
    if first > noted:
        covers = f"the log's times, {first:.3f} to {last:.3f} s, are not those of the run, which lasted {noted:.3f} s"
    return f"{covers}, so completion cannot be judged"


def _hardest(log: RunLog) -> float | None:
    """Return the greatest acceleration applied by the drive, m/s².

    The result is None if the true state is unknown.

    Logs of earlier versions lack it. In these, the loop's figure counts only if the cart's true velocity changed as
    much: blows change the velocity alone, and a wrong estimate changes the loop's figure alone.
    """
    noted = _noted(log, HARDEST_METADATA, float)
    if noted is not None or log.truth is None or not log.has_cart or len(log.time) < 2:
        return noted
    real = np.abs(np.diff(log.truth[:, -1])) * log.rate_hz
    return float(np.minimum(np.abs(log.control["applied"][:-1]), real).max())


def flights_of(log: RunLog) -> tuple[Flight, ...]:
    """Return the last lap's periods on the itinerary, from events.

    Without recovery the result is empty.

    Args:
        log: log of a run.
    """
    flights: list[Flight] = []
    under_way: Flight | None = None
    for event in log.events:
        tick = round((event.time - float(log.time[0])) * log.rate_hz) if len(log.time) else 0
        if event.name in (RESUME, LAP, CATCH) and (joined := joined_at(event.text)) is not None:
            if event.name == LAP:
                flights.clear()
            elif under_way is not None:
                flights.append(under_way._replace(end=tick))
            under_way = Flight(tick, len(log.time), joined[0])
        elif event.name == RETURN and under_way is not None:
            flights.append(under_way._replace(end=min(tick + 1, len(log.time))))
            under_way = None
    return (*flights, *([under_way] if under_way is not None and under_way.first < len(log.time) else ()))


def _attempts(log: RunLog, done: int, symbols: int) -> tuple[int, ...]:
    """Return the number of attempts of each symbol.

    The number is 0 for those not started; the first `done` were completed.
    """
    out = [0] * symbols
    for event in log.events:
        joined = joined_at(event.text) if event.name in (RESUME, CATCH) else None
        if joined is not None and 0 < joined[1] <= symbols:
            out[joined[1] - 1] = max(out[joined[1] - 1], joined[2])
    # A symbol flown directly after the previous one took one attempt.
    return tuple(count or int(k < done) for k, count in enumerate(out))


def _thinking(log: RunLog) -> Thinking | None:
    """Return the duration of a tick, None if the log lacks it."""
    found = [_noted(log, name, float) for name in THINKING_METADATA]
    return None if None in found else Thinking(*(value for value in found if value is not None))


def _noted(log: RunLog, name: str, kind: Callable[[str], Number]) -> Number | None:
    """Return a number from the log's metadata, None if it is missing.

    Raises:
        InputError: the value is not a number.
    """
    text = log.metadata.get(name)
    try:
        return None if text is None else kind(text)
    except ValueError as error:
        raise InputError(f"{log.path}: its {name} = {text!r:.80} is not a number; make the log again") from error


def recovered_note(log: RunLog) -> str:
    """Return a note on the losses of a recovered log.

    Args:
        log: recovered log.
    """
    return f"the log was recovered and lacks {log.recovered}"


def _motions(total: int, transfers: int) -> str:
    """Return the noun for all motions between stops, some of which are transfers."""
    return "symbols" if not transfers else "symbols and transfers" if transfers < total else "transfers"


def _done(wraps: tuple[int | None, ...], content: PlanContent) -> str:
    total, name = len(content.symbols), content.stops[-1].saddle
    if not total:
        return f"stayed {'on the orbit about' if content.segments else 'at'} {name} to the end"
    end = "at rest" if name == content.rest else "on the last orbit"
    motions = _motions(total, len(content.transfers))
    symbols = f"the {motions[:-1]} done" if total == 1 else f"all {total} {motions} done in order"
    counted = [count for count in wraps if count is not None]
    required = f", wraps {counted} as asked" if counted else ""
    return f"{symbols}{required}, and {end} to the end"


def _problem(flown: Flown, plan: Reference, decoded: Decoded) -> str:
    """Return the reason why the run is not completed.

    It names the symbol. It is an empty string if the run is completed.
    """
    if unknown := _unobserved(flown):
        return unknown
    matched, lost = decoded.matched, decoded.lost
    stops, symbols = plan.content.stops, plan.content.symbols
    short = plan.duration - float(flown.time[-1])
    why = f": {flown.ended}" if flown.ended else ""
    early = f"; the run ended {short:.2f} s early{why}" if short > 1.5 / flown.rate_hz else ""
    # A run that switched to a fallback continues to its end.
    ended = early or (f"; {flown.ended}" if flown.ended else "")
    far = f"from t = {flown.time[lost or 0]:.2f} s an angle was more than {FOLLOWS:g} rad from the reference"
    if matched == 0 and lost is None:
        return f"ended within the first half period about {stops[0].saddle}{ended}"
    if matched == 0 and np.abs(flown.angles[0] - plan.state(plan.mesh[0])[: flown.angles.shape[1]]).max() < _BEGUN:
        return f"left the orbit about {stops[0].saddle} within its first half period: {far}{ended}"
    if matched == 0:
        return f"did not start on the orbit about {stops[0].saddle}{ended}"
    if matched < len(stops):
        undone = f"symbol {matched} of {len(symbols)} ({symbols[matched - 1].text!r}) was not done"
        return f"{undone}: {far}{ended}" if lost is not None else f"{undone}{ended}"
    last = f"after symbol {len(symbols)} of {len(symbols)} ({symbols[-1].text!r})" if symbols else "to be kept"
    if lost is not None:
        return f"left the last orbit {last}: {far}{ended}"
    for k, (required, done) in enumerate(zip(plan.content.wraps, decoded.wraps, strict=False)):
        if required is not None and required != done:
            return f"wraps at stop {k + 1} are {done} instead of {required}, before symbol {k + 2}"
    return _limits(flown) or _last_orbit(flown, plan, last=last, ended=early)


_BEGUN = 0.5
"""Greatest distance of a run from its reference at a valid start, rad."""
_UNSEEN = 0.05
"""Longest time without a possible half turn of an arm, s."""


def _unobserved(flown: Flown) -> str:
    """Return a note on gaps in the time stamps, or "".

    Such gaps hide the arms' motion.
    """
    steps = np.diff(flown.time)
    if not len(steps):
        return ""
    for index, fault in ((int(np.argmin(steps)), "go back by"), (int(np.argmax(steps)), "jump by")):
        step = float(steps[index])
        if (step < 0) if fault == "go back by" else (step > max(_UNSEEN, 1.5 / flown.rate_hz)):
            return (
                f"its stamps {fault} {abs(step):.3g} s at t = {flown.time[index]:.2f} s, where its period is "
                f"{1 / flown.rate_hz:g} s: the arms' motion between them is unknown"
            )
    return ""


def _limits(flown: Flown) -> str:
    """Return the cart limit that was exceeded, or an empty string."""
    states, n = flown.states, flown.angles.shape[1]
    if flown.limits is None:
        return ""
    position, velocity, acceleration = flown.limits
    if flown.hardest is not None and flown.hardest > acceleration + 1e-9:
        return f"the drive's acceleration of {flown.hardest:.3f} passed the limit of {acceleration:g}"
    for name, values, bound in (
        ("position", states[:, 2 * n], position),
        ("velocity", states[:, 2 * n + 1], velocity),
        *([("acceleration", flown.applied, acceleration)] if flown.hardest is None else []),
    ):
        worst = int(np.argmax(np.abs(values)))
        if abs(values[worst]) > bound + 1e-9:
            return f"cart {name} {values[worst]:.3f} passed its limit of {bound:g} at t = {flown.time[worst]:.2f} s"
    return ""


def _last_orbit(flown: Flown, plan: Reference, *, last: str, ended: str) -> str:
    """Return a note on a too distant last period, or "".

    The distance is that of the last full period from the last orbit.
    """
    if ended:
        return f"the last orbit was not held to the end {last}{ended}"
    gap = last_gap(flown.time, flown.angles, plan, rate_hz=flown.rate_hz)
    if gap:
        return (
            f"over the last period the arms were up to {gap:.2f} rad from the orbit about "
            f"{plan.content.stops[-1].saddle} "
            f"{last} (allowed: {NEAR_LAST_ORBIT:g})"
        )
    return ""
