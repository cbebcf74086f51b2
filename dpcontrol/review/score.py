"""Did the run do what the itinerary asked? Decided from the log alone, by the true state where it is known.

Stops are decoded from the angles (see `dpcontrol.review.stops`).

A run is completed when every symbol was realised in order with its winding, wraps are as asked, the cart kept inside
its limits, and over the last full period the angles stay within 0.1 rad of the last orbit (least over phase).
"""

import io
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.consistency import chi_square_band
from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import RunLog
from dpcontrol.references.reference import Reference, load_reference
from dpcontrol.review.last_orbit import NEAR_LAST_ORBIT, far_from_orbit
from dpcontrol.review.stops import REST, Visit, decode_run, orbit_index

Array = NDArray[np.float64]

REFERENCE_ATTACHMENT = "reference.npz"
MODEL_METADATA = "model_parameters"
"""Metadata that holds the arms' parameters as JSON."""


@dataclass(frozen=True)
class Score:
    """A run's verdict.

    completed: None where the true state is not known. wraps: at each interior stop that was reached, None beside a
    transfer. rms_tracking_error rad, over the angles; max_cart_position m; rms_cart_acceleration m/s²; nis_inside_95:
    share of ticks. real_time_factor: None where the log does not say. reason: a sentence.
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

    @property
    def sentence(self) -> str:
        """The verdict in one line."""
        done = {True: "completed", False: "NOT completed", None: "completion unknown"}[self.completed]
        symbols = f"{self.symbols_completed} of {self.symbols_total} symbols; " if self.symbols_total else ""
        return f"{done}: {symbols}{self.reason}"

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
    try:
        reference = load_reference(io.BytesIO(data))
    except InputError as error:
        raise InputError(
            f"{log.path}: its attachment {REFERENCE_ATTACHMENT} is damaged; run the itinerary again"
        ) from error
    if not _whole(reference, log):
        raise InputError(f"{log.path}: its attachment {REFERENCE_ATTACHMENT} holds no plan; run the itinerary again")
    return reference


def _whole(reference: Reference, log: RunLog) -> bool:
    """Tell whether a reference carries all of a plan's notes, for the arms of this log."""
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
    run: position m, velocity m/s, acceleration m/s²; None without a cart.
    """

    time: Array
    states: Array
    reference_angles: Array
    applied: Array
    rate_hz: float
    limits: tuple[float, float, float] | None
    ended: str = ""

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


def verdict_on(flown: Flown, plan: Reference) -> Verdict:
    """Judge a run by its plan."""
    notes: dict[str, Any] = dict(plan.notes)
    decoded = decode_run(flown.time, flown.angles, flown.reference_angles, notes=notes, rate_hz=flown.rate_hz)
    visits, matched, wraps = list(decoded.visits), decoded.matched, decoded.wraps
    problem = _problem(flown, plan, visits=visits, matched=matched, wraps=wraps)
    return Verdict(max(0, matched - 1), wraps, problem)


def flown_of(log: RunLog) -> Flown:
    """Return what a log's run is judged by: the true states where they are logged, else the estimated ones."""
    bad = [e for e in log.events if e.level in ("error", "fatal")]
    return Flown(
        time=log.time,
        states=log.estimate if log.truth is None else log.truth,
        reference_angles=log.reference[:, : len(log.arm_lengths)],
        applied=log.control["applied"],
        rate_hz=log.rate_hz,
        limits=log.limits if log.has_cart else None,
        ended=bad[-1].text if bad else "",
    )


def score(log: RunLog) -> Score:
    """Score a run from its log.

    Raises:
        InputError: the log carries no plan.
    """
    plan = plan_of(log)
    flown = flown_of(log)
    verdict = verdict_on(flown, plan)
    notes: dict[str, Any] = dict(plan.notes)
    problem, wraps = verdict.problem, verdict.wraps
    known = log.truth is not None
    low, high = chi_square_band(log.measured.shape[1])
    nis = log.control["nis"][np.isfinite(log.control["nis"])]
    away = flown.angles - flown.reference_angles
    factor = log.metadata.get("real_time_factor")
    seed = log.metadata.get("seed")
    total = len(notes["stops"]) - 1
    reason = problem or _done(total, wraps, notes)
    if not known:
        reason = f"the true state is not known, so completion cannot be judged; by the estimate: {reason}"
    if log.recovered:
        reason += f"; {recovered_note(log)}"
    return Score(
        log=str(log.path),
        seed=None if seed is None else int(seed),
        completed=(not problem) if known else None,
        symbols_completed=verdict.symbols,
        symbols_total=total,
        wraps=wraps,
        rms_tracking_error=float(np.sqrt(np.mean(away**2))),
        max_cart_position=float(np.abs(flown.states[:, 2 * flown.angles.shape[1]]).max()) if log.has_cart else 0.0,
        rms_cart_acceleration=float(np.sqrt(np.mean(flown.applied**2))),
        nis_inside_95=float(np.mean((nis >= low) & (nis <= high))) if nis.size else float("nan"),
        real_time_factor=None if factor is None else float(factor),
        reason=reason,
    )


def recovered_note(log: RunLog) -> str:
    """Return what is missing of a log that was recovered."""
    return f"the log was recovered and lacks {log.recovered}"


def _done(total: int, wraps: tuple[int | None, ...], notes: dict[str, Any]) -> str:
    name = notes["stops"][-1]["saddle"]
    if not total:
        kind = "at" if notes["stay"]["kind"] == "hold" else "on the orbit about"
        return f"stayed {kind} {name} to the end"
    end = "at rest" if name == REST else "on the last orbit"
    symbols = "the symbol done" if total == 1 else f"all {total} symbols done in order"
    counted = [count for count in wraps if count is not None]
    asked = f", wraps {counted} as asked" if counted else ""
    return f"{symbols}{asked}, and {end} to the end"


def _problem(flown: Flown, plan: Reference, *, visits: list[Visit], matched: int, wraps: tuple[int | None, ...]) -> str:
    """Return why the run is not completed, naming the symbol, or an empty string."""
    notes: dict[str, Any] = dict(plan.notes)
    stops, symbols = notes["stops"], notes["symbols"]
    early = _ended(flown, plan)
    # A run that fell back to something else goes on to its end.
    ended = early or (f"; {flown.ended}" if flown.ended else "")
    if matched == 0:
        return f"did not start on the orbit about {stops[0]['saddle']}{ended}"
    if matched < len(stops):
        name = symbols[matched - 1]["text"]
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
    for k, (asked, done) in enumerate(zip(notes["wraps"], wraps, strict=False)):
        if asked is not None and asked != done:
            return f"wraps at stop {k + 1} are {done} instead of {asked}, before symbol {k + 2}"
    return _limits(flown) or _last_orbit(flown, plan, last=last, ended=early)


def _ended(flown: Flown, plan: Reference) -> str:
    """Return "; the run ended …" where it stopped before the reference's end."""
    short = plan.duration - float(flown.time[-1])
    if short <= 1.5 / flown.rate_hz:
        return ""
    why = f": {flown.ended}" if flown.ended else ""
    return f"; the run ended {short:.2f} s early{why}"


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
    notes: dict[str, Any] = dict(plan.notes)
    stop = notes["stops"][-1]
    k = orbit_index(notes, stop)
    if ended:
        return f"the last orbit was not held to the end {last}{ended}"
    period = notes["orbits"][k]["period"]
    rows = flown.time >= flown.time[-1] - period
    home = np.asarray(notes["saddles"][stop["saddle"]]["angles"])
    angles = flown.angles[rows] - (np.asarray(stop["angles"]) - home)
    gap = far_from_orbit(plan, k, angles, ticks=period * flown.rate_hz)
    if gap is not None:
        return (
            f"over the last period the arms were up to {gap:.2f} rad from the orbit about {stop['saddle']} "
            f"{last} (allowed: {NEAR_LAST_ORBIT:g})"
        )
    return ""
