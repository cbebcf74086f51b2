"""Did the run do what the itinerary asked? Decided from the log alone, by the true state where it is known.

A run is completed when every symbol was realised in order with its winding, wraps are as asked, the cart kept inside
its limits, and over the last full period the angles stay within 0.1 rad of the last orbit (least over phase).

Stops are decoded from the angles: the lattice of saddles (each saddle's angles plus whole turns) is searched for the
point nearest to the pendulum, and a point counts as visited once it has been nearest for half a period of the quickest
orbit. Boxes at the equilibria would not do: at H = 0.2 the Down-Up orbit swings the inner arm by 1.8 rad, and a turning
arm passes near other lattice points on its way, but quickly. While a plan has it on a transfer, it is nowhere.
"""

import io
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.estimator_settings import NisMeans, nis_means
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import CATCH, LAP, RESUME, RETURN, Flight, RunLog, joined_at
from dpcontrol.loop.result import inside_95
from dpcontrol.references.reference import PlanNotes, Reference, StopNote, load_reference, plan_notes

Number = TypeVar("Number", int, float)

_SAME = 1e-4
"""rad."""


@dataclass(frozen=True)
class Visit:
    """A stay at one lattice point: its angles (n,), first and last tick."""

    angles: tuple[float, ...]
    first: int
    last: int


def _same(a: Sequence[float], b: Sequence[float]) -> bool:
    """Return whether two lattice points are the same; those of one lattice are a fair part of a turn apart."""
    return all(abs(x - y) <= _SAME for x, y in zip(a, b, strict=True))


def settled_ticks(time: Array, notes: PlanNotes) -> NDArray[np.bool_]:
    """Return at which ticks (K,) a plan has the pendulum on an orbit, a connection or at rest: not on a transfer."""
    settled = np.ones(len(time), dtype=bool)
    for begin, end in notes.get("transfers", []):
        settled &= (time <= begin) | (time >= end)
    return settled


def decode_stops(angles: Array, saddles: Array, *, dwell: int, settled: NDArray[np.bool_] | None = None) -> list[Visit]:
    """Return the lattice points visited by angles (K, n), in order.

    saddles (S, n): angles of the saddles; any whole turns of them are lattice points. dwell: ticks for which a point
    must stay nearest to count; shorter stays belong to the way between. settled (K,): ticks that are looked at.
    """
    ticks = np.arange(len(angles)) if settled is None else np.flatnonzero(settled)
    if not ticks.size:
        return []
    # One row for each arm: rows are worked on several times as fast as columns of two or three.
    seen = np.ascontiguousarray(angles[ticks].T)
    distances = np.empty((len(saddles), len(ticks)))
    turns = np.empty((*saddles.shape, len(ticks)))
    for k, saddle in enumerate(saddles):
        np.rint((seen - saddle[:, None]) / (2 * np.pi), out=turns[k])
        distances[k] = np.sqrt(np.add.reduce((seen - (saddle[:, None] + 2 * np.pi * turns[k])) ** 2, axis=0))
    nearest = np.argmin(distances, axis=0)
    turned = np.take_along_axis(turns, nearest[None, None], axis=0)[0]
    changed = nearest[1:] != nearest[:-1]
    for arm in turned:
        changed |= arm[1:] != arm[:-1]
    starts = np.r_[0, np.flatnonzero(changed) + 1]
    ends = np.r_[starts[1:], len(ticks)] - 1
    visits: list[Visit] = []
    for first, last in zip(starts, ends, strict=True):
        point = tuple((saddles[nearest[first]] + 2 * np.pi * turned[:, first]).tolist())
        if visits and _same(visits[-1].angles, point):
            visits[-1] = Visit(point, visits[-1].first, int(ticks[last]))
        elif last - first + 1 >= dwell:
            visits.append(Visit(point, int(ticks[first]), int(ticks[last])))
    return visits


def without_detours(visits: list[Visit], planned: list[Visit], wanted: list[tuple[float, ...]]) -> list[Visit]:
    """Return a run's visits without those that the reference makes too, although they are no stops of its plan.

    A connection may pass close by another saddle for as long as a stop takes. planned: the visits decoded from the
    reference itself; wanted: the angles of the plan's stops. A run need not make a detour that the reference makes.
    """
    stops: list[bool] = []
    for visit in planned:
        due = sum(stops)
        stops.append(due < len(wanted) and _same(visit.angles, wanted[due]))
    if sum(stops) < len(wanted):
        return visits
    kept: list[Visit] = []
    place = 0
    for k, visit in enumerate(visits):
        ahead = place
        while ahead < len(planned) and not stops[ahead] and not _same(planned[ahead].angles, visit.angles):
            ahead += 1
        if ahead == len(planned) or not _same(planned[ahead].angles, visit.angles):
            return kept + visits[k:]
        if stops[ahead]:
            kept.append(visit)
        place = ahead + 1
    return kept


def orbit_index(notes: PlanNotes, stop: StopNote) -> int:
    """Return the index of a stop's orbit among the plan's."""
    if "orbit" in stop:
        return int(stop["orbit"])
    return [o["saddle"] for o in notes["orbits"]].index(stop["saddle"])


def section_crossings(time: Array, angles: Array, notes: PlanNotes, visits: list[Visit]) -> tuple[float | None, ...]:
    """Return when each symbol between `visits`, the stops that were reached, crossed its section, in s.

    None for a transfer, which has no section. It ends before the first symbol whose crossing is not found.
    """
    symbols = notes["symbols"]
    crossings: list[float | None] = []
    for k, (before, after) in enumerate(pairwise(visits)):
        section = symbols[k]["section"]
        if section is None:
            crossings.append(None)
            continue
        height = angles @ np.asarray(section["normal"][: angles.shape[1]]) - section["value"]
        middle, end = (before.first + before.last) // 2, (after.first + after.last) // 2
        signs = np.flatnonzero(height[middle:end] * height[middle + 1 : end + 1] <= 0) + middle
        if signs.size == 0:
            break
        if "program" in notes:
            # Stays last as long as the plant's own period makes them: the place of a crossing identifies it.
            i = signs[np.argmin(np.abs(angles[signs] - section["angles"]).max(axis=1))]
        else:
            i = signs[np.argmin(np.abs(time[signs] - symbols[k]["time"]))]
        share = height[i] / (height[i] - height[i + 1]) if height[i] != height[i + 1] else 0.0
        crossings.append(float(time[i] + share * (time[i + 1] - time[i])))
    return tuple(crossings)


def count_wraps(crossings: tuple[float | None, ...], notes: PlanNotes) -> tuple[int | None, ...]:
    """Count the wraps at each interior stop that was reached, from the times of the sections' crossings.

    None beside a transfer, and where the orbit is changed at a stop.
    """
    symbols, stops = notes["symbols"], notes["stops"]
    counts: list[int | None] = []
    for k, (arrived, left) in enumerate(pairwise(crossings)):
        stop = stops[k + 1]
        if arrived is None or left is None or "arrived_on" in stop:
            counts.append(None)
            continue
        arriving, leaving = symbols[k], symbols[k + 1]
        gap = (leaving["phase_out"] - arriving["phase_in"]) % 1.0
        spare = left - arrived - arriving["time_in"] - leaving["time_out"]
        counts.append(round(spare / notes["orbits"][orbit_index(notes, stop)]["period"] - gap))
    return tuple(counts)


@dataclass(frozen=True)
class Decoded:
    """What a run's angles say: visits in order, how many of the plan's stops they match from the first on, when each
    symbol crossed its section (s, None for a transfer) and the wraps at each interior stop that was reached. lost: the
    tick at which the run ceased to follow its reference, None where it did to the end: what it visits then is chance.
    """

    visits: tuple[Visit, ...]
    matched: int
    crossings: tuple[float | None, ...]
    wraps: tuple[int | None, ...]
    lost: int | None


FOLLOWS = 1.5
"""rad: farther than that from its reference no run comes back. What it does then is no attempt to follow."""


def _shortest_stay(notes: PlanNotes) -> float:
    """Return for how long a point must be nearest to count as a stop, s."""
    return 0.5 * min(orbit["period"] for orbit in notes["orbits"])


def decode_run(time: Array, angles: Array, reference: Array, *, notes: PlanNotes, rate_hz: float) -> Decoded:
    """Decode angles (K, n) at times (K,) s that were to follow reference angles (K, n) by a plan's notes."""
    used = {stop["saddle"] for stop in notes["stops"]}
    lattice = np.array([s["angles"] for name, s in notes["saddles"].items() if name in used])
    dwell = max(1, int(_shortest_stay(notes) * rate_hz))
    settled = settled_ticks(time, notes)
    visits = decode_stops(angles, lattice, dwell=dwell, settled=settled)
    wanted = [tuple(stop["angles"]) for stop in notes["stops"]]
    # Decoding the reference takes as long as the run; a run that made the plan's stops and no other has no detours.
    if len(visits) != len(wanted) or not all(_same(v.angles, w) for v, w in zip(visits, wanted, strict=True)):
        # What the reference barely visits, a run may visit a little longer.
        planned = decode_stops(reference, lattice, dwell=int(0.8 * dwell), settled=settled)
        visits = without_detours(visits, planned, wanted)
    matched = 0
    far = np.flatnonzero(np.abs(angles - reference).max(axis=1) > FOLLOWS)
    lost = int(far[0]) if far.size else None
    until = len(angles) if lost is None else lost
    while (
        matched < min(len(visits), len(wanted))
        and _same(visits[matched].angles, wanted[matched])
        and (visits[matched].first + dwell <= until or matched == 0)
    ):
        matched += 1
    crossings = section_crossings(time, angles, notes, visits[:matched])
    return Decoded(tuple(visits), matched, crossings, count_wraps(crossings, notes), lost)


NEAR_LAST_ORBIT = 0.1  # rad
_DENSER = 8
"""Points on each chord between an orbit's samples from which the distance is measured."""


def _leaves(orbit: Array, angles: Array, *, ticks: float) -> float:
    """Return by how many rad angles (K, n) leave those (M, n) of an orbit whose period takes `ticks`; 0 if near enough.

    Infinite where the angles are no numbers.
    """
    if not np.isfinite(angles).all():
        return np.inf
    # The point of the same phase is no nearer than the nearest one, and much sooner found.
    closed = max(len(orbit) - bool(np.abs(orbit[0] - orbit[-1]).max() < 1e-6), 1)
    first = int(np.argmin(np.abs(orbit - angles[0]).max(axis=1)))
    ahead = np.rint(np.arange(len(angles)) * (closed / ticks)).astype(np.intp)
    late = angles[np.abs(orbit[(first + ahead) % closed] - angles).max(axis=1) > NEAR_LAST_ORBIT]
    far = [place for place in late if np.abs(orbit - place).max(axis=1).min() > NEAR_LAST_ORBIT]
    if not far:
        return 0.0
    share = np.arange(_DENSER)[:, None, None] / _DENSER
    points = (orbit * (1 - share) + np.roll(orbit, -1, axis=0) * share).reshape(-1, orbit.shape[1])
    gap = max(float(np.abs(points - place).max(axis=1).min()) for place in far)
    return gap if gap > NEAR_LAST_ORBIT else 0.0


REFERENCE_ATTACHMENT = "reference.npz"
MODEL_METADATA = "model_parameters"
"""Metadata that holds the arms' parameters as JSON."""
PLANT_METADATA, DRAWN_METADATA = "plant_parameters", "drawn"
"""Metadata of a simulated run, as JSON: the plant's own parameters, and what else was drawn once for the run."""
THINKING_METADATA = ("thinking_median", "thinking_99")
"""Metadata of a run: s of a tick of controller and estimator."""


@dataclass(frozen=True)
class Thinking:
    """What a tick of controller and estimator took, s: the median, and what 99 % were within."""

    median: float
    within_99: float


@dataclass(frozen=True)
class Score:
    """A run's verdict.

    completed: None where the true state is not known. wraps: at each interior stop that was reached, None beside a
    transfer. rms_tracking_error rad, over the angles; max_cart_position m; rms_cart_acceleration m/s²; nis_inside_95:
    share of ticks; nis_means: of its means, None of a run too short for one. real_time_factor, thinking: None where the
    log does not say. reason: a sentence. falls: from which it came back, or not; attempts: of each symbol, where it
    could come back, 0 of one that was not begun; catches: how often it went on from an earlier place before it fell.
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

    @property
    def sentence(self) -> str:
        """The verdict in one line."""
        done = {True: "completed", False: "NOT completed", None: "completion unknown"}[self.completed]
        symbols = f"{self.symbols_completed} of {self.symbols_total} symbols; " if self.symbols_total else ""
        after = [(self.falls, "fall", "s"), (self.catches, "catch", "es")]
        borne = " and ".join(f"{count} {what}{more * (count > 1)}" for count, what, more in after if count)
        return f"{done}{f' after {borne}' if borne else ''}: {symbols}{self.reason}"

    def __repr__(self) -> str:
        return f"<score: {self.sentence}>"

    def document(self) -> dict[str, Any]:
        """Return what `dpcontrol score --json` prints."""
        return asdict(self)


def plan_of(log: RunLog) -> Reference:
    """Return the reference that the log carries, with the plan's notes.

    Raises:
        InputError: the log carries none, or it is damaged.
    """
    data = log.attachments.get(REFERENCE_ATTACHMENT)
    if data is None:
        raise InputError(f"{log.path} carries no {REFERENCE_ATTACHMENT}: only logs of `dpcontrol run` can be scored")
    place = f"{log.path}: its attachment {REFERENCE_ATTACHMENT}"
    try:
        reference = load_reference(io.BytesIO(data))
    except InputError as error:
        raise InputError(f"{place} is damaged; run the itinerary again") from error
    if not _whole(reference, log):
        raise InputError(f"{place} holds no plan; run the itinerary again")
    return reference


def _whole(reference: Reference, log: RunLog) -> bool:
    """Return whether a reference carries all of a plan's notes, for the arms of this log."""
    notes: Any = dict(reference.notes)
    n = len(log.arm_lengths)
    try:
        stops, symbols, orbits, saddles = (notes[key] for key in ("stops", "symbols", "orbits", "saddles"))
        homes = {stop["saddle"] for stop in stops} <= set(saddles) and len(stops) == len(symbols) + 1 >= 1
        angles = [entry["angles"] for entry in (*stops, *saddles.values())]
        curves = [reference.extra[f"orbit_{k}"] for k in range(len(orbits))]
        flown = [s for s in symbols if s["section"] is not None]
        numbers = [s[key] for s in flown for key in ("time_in", "time_out", "phase_in", "phase_out")]
        numbers += [s["time"] for s in symbols] + [t for pair in notes.get("transfers", []) for t in pair]
        numbers += [s["section"]["value"] for s in flown] + [saddle["energy"] for saddle in saddles.values()]
        known = {orbit["saddle"] for orbit in orbits} >= {stop["saddle"] for stop in stops}
        texts = [notes["title"], notes["itinerary"], *(s["text"] for s in symbols)]
        return bool(
            reference.converged
            and reference.states.shape[-1] == 2 * n + 2
            and homes
            and known
            and all(len(a) == n for a in angles)
            and all(c.ndim == 2 and c.shape[1] == 2 * n and len(c) > 1 for c in curves)
            and all(0 <= stop.get("orbit", 0) < len(orbits) for stop in stops)
            and all(o["period"] > 0 and np.isfinite(o["energy"]) for o in orbits)
            and np.isfinite(np.array(numbers, dtype=float)).all()
            and all(len(s["section"]["normal"]) == 2 * n for s in flown)
            and len(notes["wraps"]) == max(len(symbols) - 1, 0)
            and all(isinstance(text, str) for text in texts)
        )
    except (KeyError, IndexError, TypeError, ValueError, AttributeError):
        return False


@dataclass(frozen=True, eq=False)
class Flown:
    """What a run is judged by: K ticks, n arms.

    time (K,) s; states (K, 2n+2): true ones where they are known; reference_angles (K, n); applied (K,): the cart's
    acceleration, m/s². ended: why the run ended, for one that ended before its reference. limits: the cart's in this
    run: position m, velocity m/s, acceleration m/s²; None without a cart. flights: when it was on its itinerary; none
    of a run that could not recover, which was on it throughout.
    """

    time: Array
    states: Array
    reference_angles: Array
    applied: Array
    rate_hz: float
    limits: tuple[float, float, float] | None
    ended: str = ""
    flights: tuple[Flight, ...] = ()

    @property
    def angles(self) -> Array:
        """The arms' angles (K, n), rad."""
        return self.states[:, : self.reference_angles.shape[1]]


@dataclass(frozen=True)
class Verdict:
    """Whether a plan was flown: symbols done, wraps at the stops reached, and what was wrong, a sentence or ""."""

    symbols: int
    wraps: tuple[int | None, ...]
    problem: str


def counted(flights: Sequence[Flight], *, rate_hz: float) -> list[tuple[NDArray[np.intp], Array]]:
    """Return the ticks of each flight that count, and their times of the plan's reference, s; flights of none left out.

    Those from where a later flight begins anew do not count.
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
    """Return what of a run counts, by the plan's own time and turns: each flight up to where a later one begins anew.

    What was completed before a fall stays completed, and what was flown twice counts as it was flown last.
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
    """Judge a run by its plan."""
    if flown.flights:
        verdict = verdict_on(spliced(flown, plan), plan)
        return verdict if verdict.problem else replace(verdict, problem=_limits(flown))
    notes = plan_notes(plan)
    decoded = decode_run(flown.time, flown.angles, flown.reference_angles, notes=notes, rate_hz=flown.rate_hz)
    return Verdict(max(0, decoded.matched - 1), decoded.wraps, _problem(flown, plan, decoded))


def score(log: RunLog) -> Score:
    """Score a run from its log.

    Raises:
        InputError: the log carries no plan.
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
    )
    verdict = verdict_on(flown, plan)
    judged = spliced(flown, plan) if flown.flights else flown
    away = judged.angles - judged.reference_angles
    falls = sum(event.name == RETURN and event.level == "warn" for event in log.events)
    factor, seed = _noted(log, "real_time_factor", float), _noted(log, "seed", int)
    reason = verdict.problem or _done(verdict.wraps, plan_notes(plan))
    if not known:
        reason = f"the true state is not known, so completion cannot be judged; by the estimate: {reason}"
    if log.recovered:
        reason += f"; {recovered_note(log)}"
    return Score(
        log=str(log.path),
        seed=seed,
        completed=(not verdict.problem) if known else None,
        symbols_completed=verdict.symbols,
        symbols_total=len(plan_notes(plan)["stops"]) - 1,
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
        attempts=_attempts(log, verdict.symbols, len(plan_notes(plan)["symbols"])) if flown.flights else (),
        catches=sum(event.name == CATCH for event in log.events),
    )


def flights_of(log: RunLog) -> tuple[Flight, ...]:
    """Return when a run was on its itinerary, by its events: of its last lap; none where it could not recover."""
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
    """Return how many attempts each symbol took, 0 of one that was not come to; done: how many were completed."""
    out = [0] * symbols
    for event in log.events:
        joined = joined_at(event.text) if event.name in (RESUME, CATCH) else None
        if joined is not None and 0 < joined[1] <= symbols:
            out[joined[1] - 1] = max(out[joined[1] - 1], joined[2])
    # One that was flown right after the one before it took one.
    return tuple(count or int(k < done) for k, count in enumerate(out))


def _thinking(log: RunLog) -> Thinking | None:
    """Return what a tick took, None where the log does not say."""
    found = [_noted(log, name, float) for name in THINKING_METADATA]
    return None if None in found else Thinking(*(value for value in found if value is not None))


def _noted(log: RunLog, name: str, kind: Callable[[str], Number]) -> Number | None:
    """Return a number that the log notes of its run, None where it notes none.

    Raises:
        InputError: it is no number.
    """
    text = log.metadata.get(name)
    try:
        return None if text is None else kind(text)
    except ValueError as error:
        raise InputError(f"{log.path}: its {name} = {text!r:.80} is no number; make the log again") from error


def recovered_note(log: RunLog) -> str:
    """Return what is missing of a log that was recovered."""
    return f"the log was recovered and lacks {log.recovered}"


def _done(wraps: tuple[int | None, ...], notes: PlanNotes) -> str:
    total, name = len(notes["stops"]) - 1, notes["stops"][-1]["saddle"]
    if not total and "stay" in notes:
        kind = "at" if notes["stay"]["kind"] == "hold" else "on the orbit about"
        return f"stayed {kind} {name} to the end"
    lowest = min(notes["saddles"].values(), key=lambda saddle: saddle["energy"])
    end = "at rest" if notes["saddles"].get(name) == lowest else "on the last orbit"
    symbols = "the symbol done" if total == 1 else f"all {total} symbols done in order"
    counted = [count for count in wraps if count is not None]
    asked = f", wraps {counted} as asked" if counted else ""
    return f"{symbols}{asked}, and {end} to the end"


def _problem(flown: Flown, plan: Reference, decoded: Decoded) -> str:
    """Return why the run is not completed, naming the symbol, or an empty string."""
    if unknown := _unseen(flown):
        return unknown
    notes, visits, matched = plan_notes(plan), decoded.visits, decoded.matched
    stops, symbols = notes["stops"], notes["symbols"]
    short = plan.duration - float(flown.time[-1])
    why = f": {flown.ended}" if flown.ended else ""
    early = f"; the run ended {short:.2f} s early{why}" if short > 1.5 / flown.rate_hz else ""
    # A run that fell back to something else goes on to its end.
    ended = early or (f"; {flown.ended}" if flown.ended else "")
    if matched == 0 and flown.time[-1] - flown.time[0] < _shortest_stay(notes):
        return f"ended within the first half period about {stops[0]['saddle']}{ended}"
    if matched == 0 and np.abs(flown.angles[0] - flown.reference_angles[0]).max() < _BEGUN:
        return f"left the orbit about {stops[0]['saddle']} within its first half period{ended}"
    if matched == 0:
        return f"did not start on the orbit about {stops[0]['saddle']}{ended}"
    if matched < len(stops):
        name = symbols[matched - 1]["text"]
        if decoded.lost is not None and (len(visits) <= matched or decoded.lost < visits[matched].last):
            far = f"an angle was more than {FOLLOWS:g} rad from the reference"
            undone = f"symbol {matched} of {len(symbols)} ({name!r}) was not done"
            return f"{undone}: from t = {flown.time[decoded.lost]:.2f} s {far}{ended}"
        if len(visits) > matched:
            found = ", ".join(f"{a / np.pi:+.0f}π" for a in visits[matched].angles)
            at = flown.time[visits[matched].first]
            return (
                f"symbol {matched} of {len(symbols)} ({name!r}) was not done: at t = {at:.2f} s the arms went to "
                f"({found}) instead of {stops[matched]['saddle']}{ended}"
            )
        return f"symbol {matched} of {len(symbols)} ({name!r}) was not done{ended}"
    last = (
        f"after symbol {len(symbols)} of {len(symbols)} ({symbols[-1]['text']!r})" if symbols else "that was to be kept"
    )
    if len(visits) > matched:
        return f"left the last orbit {last}, at t = {flown.time[visits[matched].first]:.2f} s{ended}"
    for k, (asked, done) in enumerate(zip(notes["wraps"], decoded.wraps, strict=False)):
        if asked is not None and asked != done:
            return f"wraps at stop {k + 1} are {done} instead of {asked}, before symbol {k + 2}"
    return _limits(flown) or _last_orbit(flown, plan, last=last, ended=early)


_BEGUN = 0.5
"""rad: a run that begins no farther from its reference has begun where it should."""
_UNSEEN = 0.05
"""s: in this time no arm of a bench makes half a turn."""


def _unseen(flown: Flown) -> str:
    """Return where the stamps leave open what the arms did, or an empty string."""
    steps = np.diff(flown.time)
    if not len(steps):
        return ""
    for index, fault in ((int(np.argmin(steps)), "go back by"), (int(np.argmax(steps)), "jump by")):
        step = float(steps[index])
        if (step < 0) if fault == "go back by" else (step > max(_UNSEEN, 1.5 / flown.rate_hz)):
            return (
                f"its stamps {fault} {abs(step):.3g} s at t = {flown.time[index]:.2f} s, where its period is "
                f"{1 / flown.rate_hz:g} s: what the arms did is not known"
            )
    return ""


def _limits(flown: Flown) -> str:
    """Return which of the cart's limits was passed, or an empty string."""
    states, n = flown.states, flown.angles.shape[1]
    if flown.limits is None:
        return ""
    position, velocity, acceleration = flown.limits
    for name, values, bound in (
        ("position", states[:, 2 * n], position),
        ("velocity", states[:, 2 * n + 1], velocity),
        ("acceleration", flown.applied, acceleration),
    ):
        worst = int(np.argmax(np.abs(values)))
        if abs(values[worst]) > bound + 1e-9:
            return f"cart {name} {values[worst]:.3f} passed its limit of {bound:g} at t = {flown.time[worst]:.2f} s"
    return ""


def _last_orbit(flown: Flown, plan: Reference, *, last: str, ended: str) -> str:
    """Return how far the last full period was from the last orbit where that is too far, or an empty string."""
    notes = plan_notes(plan)
    stop = notes["stops"][-1]
    k = orbit_index(notes, stop)
    if ended:
        return f"the last orbit was not held to the end {last}{ended}"
    period = notes["orbits"][k]["period"]
    rows = flown.time >= flown.time[-1] - period
    home = np.asarray(notes["saddles"][stop["saddle"]]["angles"])
    angles = flown.angles[rows] - (np.asarray(stop["angles"]) - home)
    gap = _leaves(plan.extra[f"orbit_{k}"][:, : angles.shape[1]], angles, ticks=period * flown.rate_hz)
    if gap:
        return (
            f"over the last period the arms were up to {gap:.2f} rad from the orbit about {stop['saddle']} "
            f"{last} (allowed: {NEAR_LAST_ORBIT:g})"
        )
    return ""
