"""Verification of a run's ending with data unavailable at a bench: true states and actual faults.

An ending is true if its class and every figure of its sentence agree with the true states, as `untrue` compares them.
Distances have a tolerance of 0.2 rad and a tenth, which is too small to confuse runs that could be saved with others.
A run that reached the reference's end is judged by its score, see `untrue_score`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from unittest import mock

import numpy as np

import dpcontrol.loop.lockstep as lockstep
from dpcontrol.control.tick_parts import Report
from dpcontrol.foundation.causes import Cause, Fault
from dpcontrol.judge.score import Flown, Verdict, verdict_on
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.result import BatchRun, Ending, JudgedTicks
from dpcontrol.plans.itinerary import Itinerary
from dpcontrol.references.reference import Reference

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Flight:
    """A run with its estimates (K, N), verdict, settings and faults.

    The times `due` (s) are those of the symbols' section crossings in the plan.
    """

    scene: str
    seed: int
    settings: LoopSettings
    run: BatchRun
    estimates: Array
    verdict: Verdict
    limits: tuple[float, float, float]
    due: tuple[float, ...]

    @property
    def arms(self) -> int:
        return self.run.references.shape[1]

    @property
    def away(self) -> Array:
        """Largest true distance of an angle from the reference at each tick (K,), rad."""
        return np.abs(self.run.truth[:, : self.arms] - self.run.references).max(axis=1)

    @property
    def wrong(self) -> Array:
        """Largest error of the estimated angles at each tick (K,), rad."""
        return np.abs(self.run.truth[:, : self.arms] - self.estimates[:, : self.arms]).max(axis=1)


class _WithEstimates(JudgedTicks):
    """Also store the estimates."""

    made: "_WithEstimates"

    def __init__(self, count: int, runs: int, arms: int) -> None:
        super().__init__(count, runs, arms)
        self.estimates = np.empty((count, 2 * arms + 2, runs))
        type(self).made = self

    def take(self, k: int, report: Report, truth: Array) -> None:
        super().take(k, report, truth)
        self.estimates[k] = report.state


def flights(itinerary: Itinerary, reference: Reference, seeds: Sequence[int]) -> list[Flight]:
    """Run these seeds in lockstep if possible, otherwise one by one."""
    loop, arms = itinerary.loop, itinerary.model.arms
    assembly, limits = Assembly(reference, arms, loop), loop.limits(reference.limits)
    if assembly.lockstep:
        with mock.patch.object(lockstep, "JudgedTicks", _WithEstimates):
            runs = assembly.batch(seeds)
        estimates = [_WithEstimates.made.estimates[: len(run.times), :, k] for k, run in enumerate(runs)]
    else:
        results = [assembly.simulate(draw=assembly.draw(seed=seed)) for seed in seeds]
        runs, estimates = [BatchRun.of(result) for result in results], [result.ticks.estimates for result in results]
    bounds = (limits.position, limits.velocity, limits.acceleration)
    due = tuple(symbol.time for symbol in reference.content.symbols)
    out = []
    for seed, run, estimate in zip(seeds, runs, estimates, strict=True):
        verdict = verdict_on(Flown.of(run, rate_hz=loop.rate, limits=limits), reference)
        out.append(Flight(itinerary.name, seed, loop, run, estimate, verdict, bounds, due))
    return out


LOST = 1.5
"""Distance from the reference beyond which no run recovers, rad."""
WRONG = 0.05
"""Largest error of an estimate for a law with a tolerance of 0.1 rad, rad."""


def untrue(flight: Flight) -> str:
    """Return the first false claim about a run's ending, or an empty string."""
    run, end = flight.run, flight.run.end
    if run.ending is Ending.FINISHED:
        return ""
    told, now = end.figures, end.figures.get("time", float(run.times[-1]))
    k = min(round(now * flight.settings.rate), len(run.times) - 1)
    before = slice(max(0, k - round(0.3 * flight.settings.rate)), k + 1)
    sensors, apart = flight.settings.sensors, told.get("apart", 0.0)
    if end.cause == Cause.STUCK:
        named = (told["sensor"] or 3) - 1
        really = sensors.stuck_at <= now and named == sensors.stuck_sensor
        return "" if really else f"sensor {named} is not stuck"
    if end.cause == Cause.SILENT:
        return "" if sensors.dropout else "readings came"
    if end.cause == Cause.ESTIMATE_LOST and not apart > 1.0:
        worst = np.nanmax(flight.wrong[before]) if np.isfinite(flight.wrong[before]).any() else np.inf
        cart = np.nanmax(np.abs(run.truth[before, -2] - flight.estimates[before, -2]))
        broken = sensors.stuck_at <= now or sensors.missed_counts > 0
        return "" if broken or worst > WRONG or cart > 0.02 else f"the estimate was right to {worst:.3f} rad"
    if end.cause == Cause.ESTIMATE_LOST:
        worst = flight.wrong[before].max()
        return "" if worst > WRONG else f"the estimate was right to {worst:.3f} rad, and not wrong by {apart}"
    if end.cause == Cause.SWITCH:
        own = drive_end(flight)
        return "" if abs(run.truth[k, -2]) > own - 1e-6 else f"the cart was at {run.truth[k, -2]:.3f} m"
    if end.cause == Cause.HARD_STOP:
        return "" if abs(abs(told["position"]) - drive_end(flight)) < 1e-3 else "the cart was not at its hard stop"
    if end.cause == Cause.TRACKING_LOST:
        # The figure is a mean over a second.
        mean, share = 0.0, 1 / flight.settings.rate
        for value in flight.away[: k + 1]:
            mean += (value - mean) * share
        return "" if _near(told["error"], mean) else f"the true angle stayed {mean:.2f} rad away"
    if run.ending in (Ending.TRACKING_LOST, Ending.CART_STOP):
        there, quick = run.truth[k, -2:]
        if abs(there - told["position"]) > 0.01 or abs(quick - told["velocity"]) > 0.1 + 0.1 * abs(quick):
            return f"the cart was at {there:.3f} m with {quick:.2f} m/s"
        if not _near(told["distance"], flight.away[k]):
            return f"the true angle was {flight.away[k]:.2f} rad away"
        if flight.away[k] > LOST + SLACK and run.ending is Ending.CART_STOP:
            return f"the arms were already {flight.away[k]:.1f} rad from the reference"
        reached = _stop(flight, k)
        room = ROOM + abs(quick) / flight.settings.rate
        return "" if reached > flight.limits[0] - room else f"the cart had room to stop, at {reached:.3f} m"
    return "" if run.ending is Ending.PLANT_FAILED else f"no such ending: {end.cause}"


def drive_end(flight: Flight) -> float:
    """Return the positions of the limit switches, m from the centre."""
    drive = flight.settings.drive
    return (drive.track if np.isfinite(drive.track) else flight.limits[0]) - drive.switch_margin


SLACK = 0.2
"""Allowed error of a useful estimate and of a second figure, rad."""


def _near(said: float, true: float) -> bool:
    return abs(said - true) <= SLACK + 0.1 * true


ROOM = 0.03
"""Allowed remaining travel of a cart that had to brake, m."""


def _stop(flight: Flight, k: int) -> float:
    """Return the stopping position of the cart for braking one tick after tick k, m.

    The drive first completes its queued commands and its lag. It applies its own gain to a
    command, and half of its limit is assumed.
    """
    drive, rate = flight.settings.drive, flight.settings.rate
    (x, v), (_, before) = flight.run.truth[k, -2:], flight.run.truth[max(k - 1, 0), -2:]
    ticks = round(drive.delay) + 1
    sent = flight.run.applied[k : k + ticks].sum() / rate * drive.response
    brakes = flight.limits[2] * min(drive.response, 1.0)
    speeds = (v, v + drive.lag * (v - before) * rate, v + drive.lag * (v - before) * rate + sent)
    return max(abs(x + w * (ticks / rate + drive.lag) + w * abs(w) / brakes) for w in speeds)


# Troubles.


def class_of(flight: Flight) -> str:
    """Return the class of an ending, with separate classes for faults and hard stops."""
    cause = flight.run.end.cause
    special = cause in (Cause.STUCK, Cause.SILENT, Cause.HARD_STOP, Cause.SWITCH)
    return cause if special else flight.run.ending.value


def untrue_score(flight: Flight) -> str:
    """Return the first false claim of a run's score, or an empty string."""
    symbols = flight.verdict.symbols
    far = np.flatnonzero(flight.away > LOST)
    if flight.verdict.completed:
        return f"completed, although {flight.away.max():.1f} rad off" if far.size else ""
    if flight.verdict.fault is Fault.NOT_BEGUN and flight.away[: round(0.05 * flight.settings.rate)].max() < 0.5:
        return "it did start there"
    if not far.size or not symbols:
        return ""
    # The last symbol was due by then.
    due = flight.due[symbols - 1] if symbols <= len(flight.due) else 0.0
    return "" if flight.run.times[far[0]] > due - 0.5 else f"symbol {symbols} was due at {due:.2f} s, when it was lost"
